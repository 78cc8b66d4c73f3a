/* cophase.Model. */
#include "gateway.h"

static const cophase_model *model_of(const mxArray *value)
{
    return (const cophase_model *)handle_of(value, MODEL)->object;
}

static const char *const ARRAYS[] = {"pupil", "segments", "modes", "diversity_nm", NULL};
enum { PUPIL, SEGMENTS, MODES, DIVERSITY_NM, ARRAY_COUNT };

/* (scene_text, directory, 'pupil', pupil, ...): a new model. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene"), *directory = text(in[1], "directory");
    const mxArray *given[ARRAY_COUNT];
    cophase_model_arrays arrays = {0};
    cophase_model_info info = {0};
    cophase_input *const inside[] = {&arrays.pupil, &arrays.segments, &arrays.modes, &arrays.diversity_nm};
    cophase_model *model;
    cophase_status status;
    int i, any = 0;

    options(inputs - 2, in + 2, ARRAYS, given);
    arrays.struct_size = sizeof arrays;
    for (i = 0; i < ARRAY_COUNT; i++)
        if (given[i] != NULL) {
            *inside[i] = input(given[i], ARRAYS[i]);
            any = 1;
        }
    check(cophase_model_create(scene_text == NULL ? "" : scene_text, directory, any ? &arrays : NULL, &model));
    status = cophase_model_get_info(model, &info, sizeof info);
    if (status != COPHASE_OK)
        cophase_model_destroy(model);
    check(status);
    out[0] = handle_new(MODEL, model, info.modes);
    handle_of(out[0], MODEL)->channels = info.channels;
}

/* (model, channel): the model of a channel, which MATLAB counts from 1. */
static void do_channel(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    cophase_model *channel;

    check(cophase_model_channel((const cophase_model *)model->object, whole(in[1], 1, "the channel") - 1, NULL, &channel));
    out[0] = handle_new(MODEL, channel, model->modes);
}

/* (model): names of its channels, a cell column. */
static void do_channels(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    const char *name;
    size_t channel;

    out[0] = mxCreateCellMatrix(model->channels, 1);
    for (channel = 0; channel < model->channels; channel++) {
        check(cophase_model_channel((const cophase_model *)model->object, channel, &name, NULL));
        mxSetCell(out[0], channel, mxCreateString(name));
    }
}

#define T cophase_model_info
static const field INFO[] = {
    FIELD(T, modes, IS_SIZE), FIELD(T, segment_modes, IS_SIZE), FIELD(T, rows, IS_SIZE), FIELD(T, cols, IS_SIZE),
    FIELD(T, samples, IS_SIZE), FIELD(T, pixels, IS_SIZE), END_OF_FIELDS,
};
#undef T

static cophase_model_info info_of(const mxArray *model)
{
    cophase_model_info info = {0};

    check(cophase_model_get_info(model_of(model), &info, sizeof info));
    return info;
}

/* (model): a struct. */
static void do_info(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const cophase_model_info info = info_of(in[0]);

    out[0] = structs(INFO, &info, sizeof info, 1);
}

/* (model): a cell column of text. */
static void do_names(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    const char *name;
    size_t mode;

    out[0] = mxCreateCellMatrix(model->modes, 1);
    for (mode = 0; mode < model->modes; mode++) {
        check(cophase_model_mode_name((const cophase_model *)model->object, mode, &name));
        mxSetCell(out[0], mode, mxCreateString(name));
    }
}

typedef cophase_status maps_call(const cophase_model *, const double *, size_t, double *, size_t);

static mxArray *maps_of(const mxArray **in, size_t modes, size_t count, maps_call *call)
{
    const double *coefficients_nm = doubles(in[1], modes, 1, "coefficients_nm");
    mxArray *maps = column(count);

    check(call(model_of(in[0]), coefficients_nm, modes, mxGetPr(maps), count));
    return maps;
}

/* (model, coefficients_nm): maps of the segments and of the NCPA. */
static void do_wavefront_nm(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const cophase_model_info info = info_of(in[0]);

    out[0] = maps_of(in, info.modes, 2 * info.samples * info.samples, cophase_model_wavefront_nm);
}

/* (model, coefficients_nm): an image. */
static void do_psf(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const cophase_model_info info = info_of(in[0]);

    out[0] = maps_of(in, info.modes, info.pixels * info.pixels, cophase_model_psf);
}

const command MODEL_COMMANDS[] = {
    {"model.create", 2, ANY_NUMBER, do_create},
    {"model.channel", 2, 2, do_channel},
    {"model.channels", 1, 1, do_channels},
    {"model.info", 1, 1, do_info},
    {"model.names", 1, 1, do_names},
    {"model.wavefront_nm", 2, 2, do_wavefront_nm},
    {"model.psf", 2, 2, do_psf},
    {NULL, 0, 0, NULL},
};
