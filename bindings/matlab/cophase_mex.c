/* The one gateway from MATLAB and Octave to libcophase: cophase_mex(COMMAND, ...), for the classes in +cophase only.
 *
 * It uses nothing but the public header. What fails raises cophase:<STATUS> with the library's sentence. Matrices are
 * filled in MATLAB's column order through their strides, so nothing is copied or transposed. */
#include <cophase.h>
#include <mex.h>
#include <stdlib.h>
#include <string.h>

/* The simulators that are alive. MATLAB holds numbers that are never used again, not pointers: one that is stale finds
 * nothing, instead of freed memory. */
typedef struct live {
    double id;
    cophase_simulator *simulator;
    struct live *next;
} live;

static live *all_live = NULL;
static double last_id = 0.0;

static void check(cophase_status status)
{
    char id[64], sentence[2049];

    if (status == COPHASE_OK)
        return;
    strcpy(id, "cophase:");
    strncat(id, cophase_status_name(status), sizeof id - strlen(id) - 1);
    cophase_last_error(sentence, sizeof sentence);
    mexErrMsgIdAndTxt(id, "%s", sentence);
}

static double number(const mxArray *value, const char *name)
{
    if (!mxIsDouble(value) || mxIsComplex(value) || mxGetNumberOfElements(value) != 1)
        mexErrMsgIdAndTxt("cophase:BAD_VALUE", "%s is no number: a real double scalar is accepted", name);
    return mxGetScalar(value);
}

/* Text in UTF-8; freed when the gateway returns or raises. Octave's characters are its bytes. */
static char *text(const mxArray *value, const char *name)
{
    char *result = NULL;

    if (mxIsChar(value)) {
#ifdef MATLAB_MEX_FILE
        result = mxArrayToUTF8String(value);
#else
        result = mxArrayToString(value);
#endif
    }
    if (result == NULL)
        mexErrMsgIdAndTxt("cophase:BAD_VALUE", "%s is no text: a row of characters is accepted", name);
    return result;
}

/* Where the pointer to a simulator stands in the list. */
static live **place_of(const mxArray *value)
{
    const double id = number(value, "the simulator");
    live **place;

    for (place = &all_live; *place != NULL; place = &(*place)->next)
        if ((*place)->id == id)
            return place;
    mexErrMsgIdAndTxt("cophase:BAD_ARGUMENT", "the simulator was deleted: one that is alive is accepted");
    return NULL;
}

static cophase_simulator *simulator_of(const mxArray *value)
{
    return (*place_of(value))->simulator;
}

static void destroy(live **place)
{
    live *gone = *place;

    *place = gone->next;
    cophase_simulator_destroy(gone->simulator);
    free(gone);
}

static void destroy_all(void)
{
    while (all_live != NULL)
        destroy(&all_live);
}

typedef cophase_status size_call(const cophase_simulator *, size_t *);
typedef cophase_status number_call(const cophase_simulator *, double *);
typedef cophase_status values_call(const cophase_simulator *, float *, size_t);
typedef cophase_status maps_call(const cophase_simulator *, const cophase_array_f32 *);

static mxArray *scalar(const mxArray *simulator, number_call *call)
{
    double value;

    check(call(simulator_of(simulator), &value));
    return mxCreateDoubleScalar(value);
}

/* A column of single values. */
static mxArray *values(const mxArray *simulator, size_call *size, values_call *call)
{
    size_t count;
    mxArray *column;

    check(size(simulator_of(simulator), &count));
    column = mxCreateNumericMatrix(count, 1, mxSINGLE_CLASS, mxREAL);
    check(call(simulator_of(simulator), (float *)mxGetData(column), count));
    return column;
}

/* Single maps (y, x, k). */
static mxArray *maps(const mxArray *simulator, size_t count, size_call *size, maps_call *call)
{
    size_t side;
    mwSize extents[3];
    mxArray *stack;
    cophase_array_f32 out;

    check(size(simulator_of(simulator), &side));
    extents[0] = side, extents[1] = side, extents[2] = count;
    stack = mxCreateNumericArray(3, extents, mxSINGLE_CLASS, mxREAL);
    out.data = (float *)mxGetData(stack);
    out.count = count, out.rows = side, out.cols = side;
    out.count_stride = (ptrdiff_t)(side * side), out.row_stride = 1, out.col_stride = (ptrdiff_t)side;
    check(call(simulator_of(simulator), &out));
    return stack;
}

static mxArray *do_create(const mxArray **in)
{
    const char *scene_text = text(in[0], "scene_text"), *directory = text(in[1], "directory");
    live *born = (live *)malloc(sizeof(live));
    cophase_simulator *simulator;
    cophase_status status;

    if (born == NULL)
        mexErrMsgIdAndTxt("cophase:INTERNAL", "no memory is left for a simulator");
    status = cophase_simulator_create(scene_text, directory, &simulator);
    if (status != COPHASE_OK)
        free(born);
    check(status);
    born->id = ++last_id;
    born->simulator = simulator;
    born->next = all_live;
    all_live = born;
    /* `clear mex` must not unload a library whose objects are in use. */
    mexLock();
    return mxCreateDoubleScalar(born->id);
}

static mxArray *do_destroy(const mxArray **in)
{
    destroy(place_of(in[0]));
    mexUnlock();
    return NULL;
}

static mxArray *do_step(const mxArray **in)
{
    const double frames = number(in[1], "frames");

    /* Up to 2^53 every whole number is a double. */
    if (!(frames >= 0.0 && frames <= 9007199254740992.0) || frames != (double)(uint64_t)frames)
        mexErrMsgIdAndTxt("cophase:BAD_VALUE", "frames is %g: a whole number from 0 on is accepted", frames);
    check(cophase_simulator_step(simulator_of(in[0]), (uint64_t)frames));
    return NULL;
}

static mxArray *do_frames(const mxArray **in)
{
    uint64_t frames;

    check(cophase_simulator_frames(simulator_of(in[0]), &frames));
    return mxCreateDoubleScalar((double)frames);
}

static mxArray *do_frame_s(const mxArray **in) { return scalar(in[0], cophase_simulator_frame_s); }

static mxArray *do_divergence_s(const mxArray **in) { return scalar(in[0], cophase_simulator_divergence_s); }

static mxArray *do_residual_rms_nm(const mxArray **in) { return scalar(in[0], cophase_simulator_residual_rms_nm); }

static mxArray *do_slopes_mas(const mxArray **in)
{
    return values(in[0], cophase_simulator_slope_count, cophase_simulator_slopes_mas);
}

static mxArray *do_commands_nm(const mxArray **in)
{
    return values(in[0], cophase_simulator_actuator_count, cophase_simulator_commands_nm);
}

static mxArray *do_residual_nm(const mxArray **in)
{
    return maps(in[0], 1, cophase_simulator_residual_samples, cophase_simulator_residual_nm);
}

static cophase_status image_e(const cophase_simulator *simulator, const cophase_array_f32 *out)
{
    return cophase_simulator_image_e((cophase_simulator *)simulator, out);
}

static mxArray *do_image_e(const mxArray **in) { return maps(in[0], 1, cophase_simulator_image_pixels, image_e); }

static mxArray *do_truth_nm(const mxArray **in)
{
    return maps(in[0], 2, cophase_simulator_truth_samples, cophase_simulator_truth_nm);
}

static mxArray *do_preset(const mxArray **in)
{
    const char *scene_text;

    check(cophase_scene_preset(text(in[0], "name"), &scene_text));
    return mxCreateString(scene_text);
}

static const struct {
    const char *name;
    int inputs;
    mxArray *(*run)(const mxArray **in);
} COMMANDS[] = {
    {"preset", 1, do_preset},
    {"create", 2, do_create},
    {"destroy", 1, do_destroy},
    {"step", 2, do_step},
    {"frames", 1, do_frames},
    {"frame_s", 1, do_frame_s},
    {"divergence_s", 1, do_divergence_s},
    {"slopes_mas", 1, do_slopes_mas},
    {"commands_nm", 1, do_commands_nm},
    {"residual_nm", 1, do_residual_nm},
    {"residual_rms_nm", 1, do_residual_rms_nm},
    {"image_e", 1, do_image_e},
    {"truth_nm", 1, do_truth_nm},
};

void mexFunction(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *name;
    size_t i;

    mexAtExit(destroy_all);
    if (inputs == 0 || outputs > 1)
        mexErrMsgIdAndTxt("cophase:BAD_ARGUMENT", "cophase_mex is for the classes in +cophase: use those");
    name = text(in[0], "the command");
    for (i = 0; i < sizeof COMMANDS / sizeof COMMANDS[0]; i++)
        if (strcmp(name, COMMANDS[i].name) == 0 && inputs - 1 == COMMANDS[i].inputs) {
            mxArray *result = COMMANDS[i].run(in + 1);

            if (result != NULL)
                out[0] = result;
            return;
        }
    mexErrMsgIdAndTxt("cophase:BAD_ARGUMENT", "cophase_mex knows no command '%s' with %d arguments", name, inputs - 1);
}
