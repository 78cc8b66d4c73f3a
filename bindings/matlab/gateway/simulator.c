/* cophase.Simulator. */
#include "gateway.h"

typedef cophase_status size_call(const cophase_simulator *, size_t *);
typedef cophase_status number_call(const cophase_simulator *, double *);
typedef cophase_status values_call(const cophase_simulator *, float *, size_t);
typedef cophase_status maps_call(const cophase_simulator *, const cophase_array_f32 *);

static cophase_simulator *simulator_of(const mxArray *value)
{
    return (cophase_simulator *)handle_of(value, SIMULATOR)->object;
}

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

static mxArray *stack(const mxArray *simulator, size_t count, size_call *size, maps_call *call)
{
    size_t side;
    mxArray *result;
    cophase_array_f32 view;

    check(size(simulator_of(simulator), &side));
    result = maps(side, side, count, &view);
    check(call(simulator_of(simulator), &view));
    return result;
}

/* (scene_text, directory): the number of a new simulator. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene_text"), *directory = text(in[1], "directory");
    cophase_simulator *simulator;

    check(cophase_simulator_create(scene_text == NULL ? "" : scene_text, directory, &simulator));
    out[0] = mxCreateDoubleScalar(handle_new(SIMULATOR, simulator, 0)->id);
}

static void do_delete(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    handle_delete(in[0], SIMULATOR);
}

/* (simulator, frames) */
static void do_step(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_simulator *simulator = simulator_of(in[0]);

    check(cophase_simulator_step(simulator, (uint64_t)whole(in[1], 0, "frames")));
}

static void do_frames(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    uint64_t frames;

    check(cophase_simulator_frames(simulator_of(in[0]), &frames));
    out[0] = mxCreateDoubleScalar((double)frames);
}

static void do_image_e(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_simulator *simulator = simulator_of(in[0]);
    size_t rows, cols;
    cophase_array_f32 view;

    check(cophase_simulator_image_shape(simulator, &rows, &cols));
    out[0] = maps(rows, cols, 1, &view);
    check(cophase_simulator_image_e(simulator, &view));
}

/* A command that takes a simulator and returns one value. */
#define GET(name, value)                                                                                               \
    static void do_##name(int outputs, mxArray **out, int inputs, const mxArray **in) { out[0] = value; }

GET(frame_s, scalar(in[0], cophase_simulator_frame_s))
GET(divergence_s, scalar(in[0], cophase_simulator_divergence_s))
GET(residual_rms_nm, scalar(in[0], cophase_simulator_residual_rms_nm))
GET(slopes_mas, values(in[0], cophase_simulator_slope_count, cophase_simulator_slopes_mas))
GET(commands_nm, values(in[0], cophase_simulator_actuator_count, cophase_simulator_commands_nm))
GET(residual_nm, stack(in[0], 1, cophase_simulator_residual_samples, cophase_simulator_residual_nm))
GET(truth_nm, stack(in[0], 2, cophase_simulator_truth_samples, cophase_simulator_truth_nm))

const command SIMULATOR_COMMANDS[] = {
    {"simulator.create", 2, 2, do_create},
    {"simulator.delete", 1, 1, do_delete},
    {"simulator.step", 2, 2, do_step},
    {"simulator.frames", 1, 1, do_frames},
    {"simulator.frame_s", 1, 1, do_frame_s},
    {"simulator.divergence_s", 1, 1, do_divergence_s},
    {"simulator.slopes_mas", 1, 1, do_slopes_mas},
    {"simulator.commands_nm", 1, 1, do_commands_nm},
    {"simulator.residual_nm", 1, 1, do_residual_nm},
    {"simulator.residual_rms_nm", 1, 1, do_residual_rms_nm},
    {"simulator.image_e", 1, 1, do_image_e},
    {"simulator.truth_nm", 1, 1, do_truth_nm},
    {NULL, 0, 0, NULL},
};
