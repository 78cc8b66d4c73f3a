/* cophase.Simulator. */
#include "gateway.h"

static cophase_simulator *simulator_of(const mxArray *value)
{
    return (cophase_simulator *)handle_of(value, SIMULATOR)->object;
}

/* (scene_text, directory): a new simulator. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene"), *directory = text(in[1], "directory");
    cophase_simulator *simulator;

    check(cophase_simulator_create(scene_text == NULL ? "" : scene_text, directory, &simulator));
    out[0] = handle_new(SIMULATOR, simulator, 0);
}

/* (simulator, frames) */
static void do_step(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_simulator *simulator = simulator_of(in[0]);

    check(cophase_simulator_step(simulator, (uint64_t)whole(in[1], 0, "frames")));
}

#define T cophase_simulator_info
static const field INFO[] = {
    FIELD(T, slopes, IS_SIZE), FIELD(T, actuators, IS_SIZE), FIELD(T, residual_samples, IS_SIZE),
    FIELD(T, truth_samples, IS_SIZE), FIELD(T, rows, IS_SIZE), FIELD(T, cols, IS_SIZE), FIELD(T, frames, IS_COUNT),
    FIELD(T, frame_s, IS_DOUBLE), FIELD(T, divergence_s, IS_DOUBLE), FIELD(T, residual_rms_nm, IS_DOUBLE),
    END_OF_FIELDS,
};
#undef T

/* (simulator): a struct. */
static void do_info(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_simulator_info info = {0};

    check(cophase_simulator_get_info(simulator_of(in[0]), &info, sizeof info));
    out[0] = structs(INFO, &info, sizeof info, 1);
}

#define ARRAY(name) {#name, COPHASE_ARRAY_##name}
static const constant_name ARRAYS[] = {
    ARRAY(SLOPES_MAS), ARRAY(COMMANDS_NM), ARRAY(RESIDUAL_NM), ARRAY(IMAGE_E), ARRAY(TRUTH_NM), {NULL, 0},
};

/* (simulator, 'IMAGE_E', count): a column. */
static void do_array(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const size_t count = whole(in[2], 1, "count");

    out[0] = column(count);
    check(cophase_simulator_array(simulator_of(in[0]), choice(in[1], ARRAYS, "the name"), mxGetPr(out[0]), count));
}

static cophase_status simulator_text(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                     size_t *length)
{
    return cophase_simulator_text((const cophase_simulator *)object, what, text, capacity, length);
}

static const constant_name TEXTS[] = {{"WARNINGS", COPHASE_TEXT_WARNINGS}, {NULL, 0}};

/* (simulator, 'WARNINGS'): a text. */
static void do_text(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    out[0] = long_text(simulator_text, simulator_of(in[0]), choice(in[1], TEXTS, "the name"), 0);
}

const command SIMULATOR_COMMANDS[] = {
    {"simulator.create", 2, 2, do_create},
    {"simulator.step", 2, 2, do_step},
    {"simulator.info", 1, 1, do_info},
    {"simulator.array", 3, 3, do_array},
    {"simulator.text", 2, 2, do_text},
    {NULL, 0, 0, NULL},
};
