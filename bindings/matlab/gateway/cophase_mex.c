/* Gateway from MATLAB and Octave to libcophase: cophase_mex(COMMAND, ...), for the classes in +cophase only.
 *
 * It uses the public headers only. A failure raises cophase:<STATUS> with the library's sentence. Inputs are read in
 * MATLAB's column order by their strides, without a copy. Outputs are columns of doubles in C order, which the classes
 * reshape and permute. */
#include "gateway.h"
#include <string.h>

static void do_preset(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *name = text(in[0], "name"), *scene_text;

    check(cophase_scene_preset(name == NULL ? "" : name, &scene_text));
    out[0] = mxCreateString(scene_text);
}

/* A scene, and a key with its value in TOML. */
typedef struct scene_change {
    const char *scene_text, *key, *value;
} scene_change;

static cophase_status scene_set(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                size_t *length)
{
    const scene_change *change = (const scene_change *)object;

    return cophase_scene_set(change->scene_text, change->key, change->value, text, capacity, length);
}

/* (scene_text, 'section.name', value): the scene with it; an empty value removes the key. */
static void do_scene_set(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene"), *key = text(in[1], "the key"), *value = text(in[2], "the value");
    const scene_change change = {scene_text == NULL ? "" : scene_text, key == NULL ? "" : key, value == NULL ? "" : value};

    out[0] = long_text(scene_set, &change, 0, 0);
}

static void do_version(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    out[0] = mxCreateString(cophase_version());
}

static cophase_status device_list(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                  size_t *length)
{
    return cophase_device_list(text, capacity, length);
}

/* A text: a line for each device, its name, a tab, and a description. */
static void do_devices(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    out[0] = long_text(device_list, NULL, 0, 0);
}

/* (object) */
static void do_delete(int outputs, mxArray **out, int inputs, const mxArray **in) { handle_delete(in[0]); }

/* (names, NAME, VALUE, ...): for each of the names, the index of its value among the arguments after `names`; 0: none. */
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
    {"scene_set", 3, 3, do_scene_set},
    {"version", 0, 0, do_version},
    {"devices", 0, 0, do_devices},
    {"options", 1, ANY_NUMBER, do_options},
    {"delete", 1, 1, do_delete},
    {NULL, 0, 0, NULL},
};

static const command *const TABLES[] = {
    COMMANDS, MODEL_COMMANDS, ESTIMATE_COMMANDS, SESSION_COMMANDS, SEQUENCE_COMMANDS, SIMULATOR_COMMANDS,
};

static const command *command_of(const char *name, int inputs)
{
    size_t table;
    const command *row;

    for (table = 0; table < sizeof TABLES / sizeof TABLES[0]; table++)
        for (row = TABLES[table]; row->name != NULL; row++)
            if (strcmp(name, row->name) == 0 && inputs >= row->least && inputs <= row->most)
                return row;
    fail(COPHASE_BAD_ARGUMENT, "cophase_mex has no command '%s' with %d arguments", name, inputs);
    return NULL;
}

void mexFunction(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *name = inputs == 0 ? NULL : text(in[0], "the command");

    mexAtExit(handle_delete_all);
    if (cophase_abi_version() != COPHASE_ABI_VERSION)
        fail(COPHASE_BAD_FILE, "libcophase has the C interface %u where cophase_mex was built for %u: run build again",
             (unsigned)cophase_abi_version(), (unsigned)COPHASE_ABI_VERSION);
    if (name == NULL || outputs > 4)
        fail(COPHASE_BAD_ARGUMENT, "cophase_mex is for the classes in +cophase only: use those");
    command_of(name, inputs - 1)->run(outputs, out, inputs - 1, in + 1);
}
