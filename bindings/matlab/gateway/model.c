/* cophase.Model. */
#include "gateway.h"

typedef cophase_status size_call(const cophase_model *, size_t *);
typedef cophase_status maps_call(const cophase_model *, const double *, size_t, const cophase_array_f32 *);

static const cophase_model *model_of(const mxArray *value)
{
    return (const cophase_model *)handle_of(value, MODEL)->object;
}

static const char *const ARRAYS[] = {"Pupil", "Segments", "Modes", "Diversity_nm", NULL};
enum { PUPIL, SEGMENTS, MODES, DIVERSITY_NM, ARRAY_COUNT };

/* From arrays if there is one, else from the scene alone. */
static cophase_status create(const char *scene_text, const char *directory, const mxArray **given,
                             cophase_model **model)
{
    cophase_model_arrays arrays;

    if (given[PUPIL] == NULL && given[SEGMENTS] == NULL && given[MODES] == NULL && given[DIVERSITY_NM] == NULL)
        return cophase_model_create(scene_text, directory, model);
    check(cophase_model_arrays_init(&arrays, sizeof arrays));
    if (given[PUPIL] != NULL)
        arrays.pupil = input(given[PUPIL], "Pupil");
    if (given[SEGMENTS] != NULL)
        arrays.segments = input(given[SEGMENTS], "Segments");
    if (given[MODES] != NULL)
        arrays.modes = input(given[MODES], "Modes");
    if (given[DIVERSITY_NM] != NULL)
        arrays.diversity_nm = input(given[DIVERSITY_NM], "Diversity_nm");
    return cophase_model_create_from_arrays(scene_text, directory, &arrays, model);
}

/* (scene_text, directory, 'Pupil', pupil, ...): the number of a new model. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene_text"), *directory = text(in[1], "directory");
    const mxArray *given[ARRAY_COUNT];
    cophase_model *model;
    size_t modes = 0;
    cophase_status status;

    options(inputs - 2, in + 2, ARRAYS, given);
    check(create(scene_text == NULL ? "" : scene_text, directory, given, &model));
    status = cophase_model_mode_count(model, &modes);
    if (status != COPHASE_OK)
        cophase_model_destroy(model);
    check(status);
    out[0] = mxCreateDoubleScalar(handle_new(MODEL, model, modes)->id);
}

static void do_delete(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    handle_delete(in[0], MODEL);
}

/* A cell column of text. */
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

/* [rows columns] */
static void do_frame_size(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    size_t rows, cols;
    double *extents;

    check(cophase_model_frame_shape(model_of(in[0]), &rows, &cols));
    out[0] = mxCreateDoubleMatrix(1, 2, mxREAL);
    extents = (double *)mxGetData(out[0]);
    extents[0] = (double)rows;
    extents[1] = (double)cols;
}

static mxArray *size(const mxArray *model, size_call *call)
{
    size_t value;

    check(call(model_of(model), &value));
    return mxCreateDoubleScalar((double)value);
}

/* A command that returns one of its sizes. */
#define SIZE(name, call)                                                                                               \
    static void do_##name(int outputs, mxArray **out, int inputs, const mxArray **in) { out[0] = size(in[0], call); }

SIZE(modes, cophase_model_mode_count)
SIZE(segment_modes, cophase_model_segment_mode_count)
SIZE(samples, cophase_model_samples)
SIZE(pixels, cophase_model_pixels)

/* What the model makes of coefficients. */
static mxArray *made(const mxArray **in, size_t count, size_call *size, maps_call *call)
{
    const live *model = handle_of(in[0], MODEL);
    const double *coefficients_nm = doubles(in[1], model->modes, 1, "coefficients");
    size_t side;
    mxArray *result;
    cophase_array_f32 view;

    check(size((const cophase_model *)model->object, &side));
    result = maps(side, side, count, &view);
    check(call((const cophase_model *)model->object, coefficients_nm, model->modes, &view));
    return result;
}

/* (model, coefficients): maps (y, x) of the segments, and of the NCPA. */
static void do_wavefront(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    out[0] = made(in, 2, cophase_model_samples, cophase_model_wavefront_nm);
}

/* (model, coefficients): an image. */
static void do_psf(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    out[0] = made(in, 1, cophase_model_pixels, cophase_model_psf);
}

const command MODEL_COMMANDS[] = {
    {"model.create", 2, ANY_NUMBER, do_create},
    {"model.delete", 1, 1, do_delete},
    {"model.modes", 1, 1, do_modes},
    {"model.segment_modes", 1, 1, do_segment_modes},
    {"model.names", 1, 1, do_names},
    {"model.frame_size", 1, 1, do_frame_size},
    {"model.samples", 1, 1, do_samples},
    {"model.pixels", 1, 1, do_pixels},
    {"model.wavefront", 2, 2, do_wavefront},
    {"model.psf", 2, 2, do_psf},
    {NULL, 0, 0, NULL},
};
