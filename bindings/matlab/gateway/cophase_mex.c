/* The one gateway from MATLAB and Octave to libcophase: cophase_mex(COMMAND, ...), for the classes in +cophase only.
 *
 * It uses nothing but the public header. What fails raises cophase:<STATUS> with the library's sentence. Arrays are
 * read and filled in MATLAB's column order through their strides, so nothing is copied or transposed. */
#include "gateway.h"
#include <string.h>

static void do_preset(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *name = text(in[0], "name"), *scene_text;

    check(cophase_scene_preset(name == NULL ? "" : name, &scene_text));
    out[0] = mxCreateString(scene_text);
}

static void do_version(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    out[0] = mxCreateString(cophase_version());
}

/* As text: a line for each device, its address and its name with a tab between. */
static void do_devices(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    char *lines;
    size_t length;

    check(cophase_device_list(NULL, 0, &length));
    lines = (char *)mxMalloc(length + 1);
    check(cophase_device_list(lines, length + 1, &length));
    out[0] = mxCreateString(lines);
}

/* (names, NAME, VALUE, ...): for each of the names which argument after `names` is its value; 0: none. */
static void do_options(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const size_t count = mxIsCell(in[0]) ? mxGetNumberOfElements(in[0]) : 0;
    const char **names = (const char **)mxCalloc(count + 1, sizeof(char *));
    const mxArray **values = (const mxArray **)mxCalloc(count + 1, sizeof(mxArray *));
    double *places;
    size_t i;
    int place;

    for (i = 0; i < count; i++)
        names[i] = text(mxGetCell(in[0], i), "the name of an option");
    options(inputs - 1, in + 1, names, values);
    out[0] = mxCreateDoubleMatrix(1, count, mxREAL);
    places = (double *)mxGetData(out[0]);
    for (i = 0; i < count; i++)
        for (place = 1; place < inputs; place++)
            if (values[i] != NULL && values[i] == in[place])
                places[i] = place;
}

static const command COMMANDS[] = {
    {"preset", 1, 1, do_preset},
    {"version", 0, 0, do_version},
    {"devices", 0, 0, do_devices},
    {"options", 1, ANY_NUMBER, do_options},
    {NULL, 0, 0, NULL},
};

static const command *const TABLES[] = {
    COMMANDS,          MODEL_COMMANDS,     SESSION_COMMANDS,    FIT_COMMANDS,
    SEQUENCE_COMMANDS, SIMULATOR_COMMANDS, FULL_PHASE_COMMANDS,
};

static const command *command_of(const char *name, int inputs)
{
    size_t table;
    const command *row;

    for (table = 0; table < sizeof TABLES / sizeof TABLES[0]; table++)
        for (row = TABLES[table]; row->name != NULL; row++)
            if (strcmp(name, row->name) == 0 && inputs >= row->least && inputs <= row->most)
                return row;
    fail(COPHASE_BAD_ARGUMENT, "cophase_mex knows no command '%s' with %d arguments", name, inputs);
    return NULL;
}

void mexFunction(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *name = inputs == 0 ? NULL : text(in[0], "the command");

    mexAtExit(handle_delete_all);
    if (cophase_abi_version() != COPHASE_ABI_VERSION)
        fail(COPHASE_BAD_FILE, "libcophase has the C interface %u where cophase_mex was built for %u: run build again",
             (unsigned)cophase_abi_version(), (unsigned)COPHASE_ABI_VERSION);
    if (name == NULL || outputs > 2)
        fail(COPHASE_BAD_ARGUMENT, "cophase_mex is for the classes in +cophase: use those");
    command_of(name, inputs - 1)->run(outputs, out, inputs - 1, in + 1);
}
