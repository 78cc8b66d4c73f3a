/* cophase.Estimator and cophase.Estimate. */
#include "gateway.h"
#include <string.h>

static const char *const ESTIMATOR_OPTIONS[] = {"policy", "threads", "directory", NULL};
enum { POLICY, THREADS, DIRECTORY, ESTIMATOR_OPTION_COUNT };

/* (scene_text, 'policy', 'full', ...): a new estimator. */
static void do_create_estimator(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene");
    const mxArray *given[ESTIMATOR_OPTION_COUNT];
    cophase_estimator_options chosen_options = {0};
    cophase_estimator *estimator;

    options(inputs - 1, in + 1, ESTIMATOR_OPTIONS, given);
    chosen_options.struct_size = sizeof chosen_options;
    if (given[POLICY] != NULL)
        chosen_options.policy = choice(given[POLICY], POLICIES, "policy");
    if (given[THREADS] != NULL)
        chosen_options.threads = threads(given[THREADS]);
    check(cophase_estimator_create(scene_text == NULL ? "" : scene_text, text(given[DIRECTORY], "directory"),
                                   &chosen_options, &estimator));
    out[0] = handle_new(ESTIMATOR, estimator, 0);
}

/* Images of one channel. */
typedef struct channel {
    cophase_input frames;
    cophase_calibration calibration;
    cophase_estimate_options options;
    cophase_input slopes_mas;
} channel;

typedef struct job {
    cophase_estimator *estimator;
    cophase_channel_images *channels;
    size_t count;
    cophase_estimate *estimate;
} job;

static cophase_status work(void *argument)
{
    job *job = (struct job *)argument;

    return cophase_estimator_estimate(job->estimator, job->channels, job->count, &job->estimate);
}

static cophase_status cancel(const void *estimator)
{
    return cophase_estimator_cancel((const cophase_estimator *)estimator);
}

/* Slopes with a column for each image; the library has a row for each. */
static cophase_input slopes_of(const mxArray *value)
{
    const cophase_input columns = input(value, "slopes_mas");
    cophase_input rows = columns;

    rows.rows = columns.cols, rows.row_stride = columns.col_stride;
    rows.cols = columns.rows, rows.col_stride = columns.row_stride;
    return rows;
}

/* Frames with a mask of the same size: one that is equal for all images becomes their map; of another the frames have NaN
   where it is not 0, and there is no map. */
static const mxArray *masked(const mxArray *frames, const mxArray **mask)
{
    const size_t count = mxGetNumberOfElements(frames), rows = mxGetDimensions(*mask)[0];
    const size_t columns = mxGetDimensions(*mask)[1], pixels = rows * columns;
    mxArray *converted, *result, *bad;
    size_t i;

    if (mxGetNumberOfElements(*mask) != count)
        fail(COPHASE_BAD_SHAPE, "mask has %lu elements: %lu, those of frames, or one map for all images is accepted",
             (unsigned long)mxGetNumberOfElements(*mask), (unsigned long)count);
    mexCallMATLAB(1, &bad, 1, (mxArray **)mask, "double");
    for (i = pixels; i < count && (mxGetPr(bad)[i] != 0.0) == (mxGetPr(bad)[i - pixels] != 0.0);)
        i++;
    if (i >= count) {
        result = mxCreateDoubleMatrix(rows, columns, mxREAL);
        memcpy(mxGetPr(result), mxGetPr(bad), pixels * sizeof(double));
        *mask = result;
        return frames;
    }
    *mask = NULL;
    mexCallMATLAB(1, &converted, 1, (mxArray **)&frames, "double");
    result = mxDuplicateArray(converted); /* which may share its memory with the frames */
    for (i = 0; i < count; i++)
        if (mxGetPr(bad)[i] != 0.0)
            mxGetPr(result)[i] = mxGetNaN();
    return result;
}

static const char *const ESTIMATE_OPTIONS[] = {"slopes_mas", "mask",   "read_noise_e", "dark",
                                               "flat",       "gain_e", "saturation",   NULL};
enum { SLOPES_MAS, MASK, READ_NOISE_E, DARK, FLAT, GAIN_E, SATURATION, ESTIMATE_OPTION_COUNT };

/* Frames with the options that were given for them. */
static void fill(channel *channel, const mxArray *frames, const mxArray **given)
{
    channel->frames = input(frames, "frames");
    if (given[MASK] != NULL && mxGetNumberOfDimensions(given[MASK]) > 2)
        channel->frames = input(masked(frames, &given[MASK]), "frames");
    channel->calibration = calibration_of(given[DARK], given[FLAT], given[MASK], given[GAIN_E], given[SATURATION]);
    channel->options.struct_size = sizeof channel->options;
    channel->options.calibration = &channel->calibration;
    if (given[READ_NOISE_E] != NULL)
        channel->options.read_noise_e = number(given[READ_NOISE_E], "read_noise_e"), channel->options.has_read_noise = 1;
}

/* (estimator, names, frames, options): a new estimate. Cells with an element for each channel: its name or [], its frames,
 * a cell of its NAME, VALUE, ... */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const size_t count = mxGetNumberOfElements(in[2]);
    channel *each = (channel *)mxCalloc(count + 1, sizeof *each);
    job job;
    size_t i, k;

    memset(&job, 0, sizeof job);
    job.estimator = (cophase_estimator *)handle_of(in[0], ESTIMATOR)->object;
    job.count = count;
    job.channels = (cophase_channel_images *)mxCalloc(count + 1, sizeof *job.channels);
    for (i = 0; i < count; i++) {
        const mxArray *pairs = mxGetCell(in[3], i), *given[ESTIMATE_OPTION_COUNT];
        const size_t length = mxGetNumberOfElements(pairs);
        const mxArray **list = (const mxArray **)mxCalloc(length + 1, sizeof *list);

        for (k = 0; k < length; k++)
            list[k] = mxGetCell(pairs, k);
        options((int)length, list, ESTIMATE_OPTIONS, given);
        if (given[SLOPES_MAS] != NULL)
            each[i].slopes_mas = slopes_of(given[SLOPES_MAS]), job.channels[i].slopes_mas = &each[i].slopes_mas;
        fill(&each[i], mxGetCell(in[2], i), given);
        job.channels[i].channel = text(mxGetCell(in[1], i), "the name of a channel");
        job.channels[i].frames = &each[i].frames;
        job.channels[i].options = &each[i].options;
    }
    interruptible(cancel, job.estimator, work, &job);
    out[0] = handle_new(ESTIMATE, job.estimate, 0);
}

static cophase_estimate *estimate_of(const mxArray *value)
{
    return (cophase_estimate *)handle_of(value, ESTIMATE)->object;
}

static const constant_name METHODS[] = {{"modal", COPHASE_METHOD_MODAL}, {"map", COPHASE_METHOD_MAP}, {NULL, 0}};
static const constant_name LEVELS[] = {
    {"nothing", COPHASE_AO_KNOWLEDGE_NOTHING}, {"spectrum", COPHASE_AO_KNOWLEDGE_SPECTRUM},
    {"loop", COPHASE_AO_KNOWLEDGE_LOOP},       {"telemetry", COPHASE_AO_KNOWLEDGE_TELEMETRY},
    {NULL, 0},
};
#define T cophase_estimate_info
static const field INFO[] = {
    FIELD(T, images, IS_SIZE), FIELD(T, used, IS_SIZE), FIELD(T, clipped, IS_SIZE), FIELD(T, modes, IS_SIZE),
    FIELD(T, segment_modes, IS_SIZE), FIELD(T, samples, IS_SIZE), FIELD(T, error_terms, IS_SIZE),
    FIELD(T, warnings, IS_SIZE), NAMED_FIELD(T, method, METHODS), NAMED_FIELD(T, policy, POLICIES),
    FIELD(T, status, IS_STATUS), FIELD(T, is_sequence, IS_LOGICAL), FIELD(T, iterations, IS_INT),
    FIELD(T, has_settled, IS_LOGICAL), NAMED_FIELD(T, ao_knowledge, LEVELS), NAMED_FIELD(T, precision, PRECISIONS),
    FIELD(T, evaluations, IS_COUNT), FIELD(T, phasing_rms_nm, IS_DOUBLE), FIELD(T, phasing_sigma_nm, IS_DOUBLE),
    FIELD(T, ncpa_rms_nm, IS_DOUBLE), FIELD(T, ncpa_sigma_nm, IS_DOUBLE), FIELD(T, wavefront_rms_nm, IS_DOUBLE),
    FIELD(T, wavefront_sigma_nm, IS_DOUBLE), FIELD(T, reduced_chi2, IS_DOUBLE), FIELD(T, images_to_halve, IS_DOUBLE),
    FIELD(T, map_width_m, IS_DOUBLE), FIELD(T, seconds, IS_DOUBLE), FIELD(T, model_seconds, IS_DOUBLE),
    FIELD(T, telemetry_gain, IS_DOUBLE), FIELD(T, telemetry_correlation, IS_DOUBLE), FIELD(T, channels, IS_SIZE),
    FIELD(T, integers, IS_SIZE), FIELD(T, model_errors, IS_SIZE), FIELD(T, has_maps_without_staircases, IS_SIZE),
    END_OF_FIELDS,
};
#undef T

/* (estimate): a struct. */
static void do_info(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_estimate_info info = {0};

    check(cophase_estimate_get_info(estimate_of(in[0]), &info, sizeof info));
    out[0] = structs(INFO, &info, sizeof info, 1);
}

/* (estimate, count): a struct for each image. */
static void do_images(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const size_t count = whole(in[1], 0, "count");
    cophase_image_report *reports = (cophase_image_report *)mxCalloc(count, sizeof *reports);

    check(cophase_estimate_images(estimate_of(in[0]), reports, sizeof *reports, count));
    out[0] = structs(IMAGE_REPORT, reports, sizeof *reports, count);
}

#define ARRAY(name) {#name, COPHASE_ARRAY_##name}
static const constant_name ARRAYS[] = {
    ARRAY(COEFFICIENTS_NM), ARRAY(SIGMA_NM), ARRAY(COVARIANCE_NM2), ARRAY(IMAGE_COEFFICIENTS_NM), ARRAY(MAPS_NM),
    ARRAY(ERROR_BUDGET_NM), ARRAY(CORRECTION_PISTONS_NM), ARRAY(CORRECTION_ACTUATORS_NM), ARRAY(CORRECTION_ACTUATORS_M),
    ARRAY(CORRECTION_SLOPES_MAS), ARRAY(CORRECTION_SEGMENT_COMMANDS), ARRAY(CORRECTION_ACTUATOR_COMMANDS),
    ARRAY(PISTON_INTEGERS), ARRAY(CORRECTION_TILTS_NM), ARRAY(MODEL_ERRORS), ARRAY(MAPS_WITHOUT_STAIRCASES_NM),
    ARRAY(FIGURES_WITHOUT_STAIRCASES_NM), {NULL, 0},
};

/* (estimate, 'MAPS_NM', count): a column. */
static void do_array(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const size_t count = whole(in[2], 0, "count");
    double empty = 0.0;

    out[0] = column(count);
    check(cophase_estimate_array(estimate_of(in[0]), choice(in[1], ARRAYS, "the name"),
                                 count == 0 ? &empty : mxGetPr(out[0]), count));
}

static cophase_status estimate_text(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                    size_t *length)
{
    return cophase_estimate_text((const cophase_estimate *)object, what, index, text, capacity, length);
}

#define TEXT(name) {#name, COPHASE_TEXT_##name}
static const constant_name TEXTS[] = {
    TEXT(REPORT), TEXT(WARNINGS), TEXT(REMARKS), TEXT(DEVICE), TEXT(POLICY), TEXT(MODEL), TEXT(SCENE), TEXT(IMAGE_MESSAGE),
    TEXT(MODE_NAME), TEXT(ERROR_TERM_NAME), TEXT(CHANNEL_NAME), TEXT(SEGMENT_COMMAND_NAME),
    TEXT(ACTUATOR_COMMAND_NAME), TEXT(SEGMENT_HELD), TEXT(NCPA_HELD),
    TEXT(CORRECTION_WARNINGS), TEXT(MODEL_ERROR_NAME), {NULL, 0},
};

/* (estimate, 'MODE_NAME', index): a text; index from 1. */
static void do_text(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const size_t index = whole(in[2], 1, "the index");

    out[0] = long_text(estimate_text, estimate_of(in[0]), choice(in[1], TEXTS, "the name"), index - 1);
}

/* (estimate, path) */
static void do_write(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *path = text(in[1], "path");

    check(cophase_estimate_write(estimate_of(in[0]), path == NULL ? "" : path));
}

#define T cophase_correction_report
static const field CORRECTION[] = {
    FIELD(T, segments, IS_SIZE), FIELD(T, actuators, IS_SIZE), FIELD(T, slopes, IS_SIZE),
    FIELD(T, corrected_modes, IS_SIZE), FIELD(T, limited, IS_SIZE), FIELD(T, segment_commands, IS_SIZE),
    FIELD(T, actuator_commands, IS_SIZE), FIELD(T, tilts, IS_SIZE), FIELD(T, ncpa_modes, IS_SIZE),
    FIELD(T, segments_drop_nm2, IS_DOUBLE), FIELD(T, ncpa_drop_nm2, IS_DOUBLE), END_OF_FIELDS,
};
#undef T

/* (estimate, limit_nm, path): a struct with the sizes of the CORRECTION_ arrays. */
static void do_correct(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const double limit_nm = mxIsEmpty(in[1]) ? 0.0 : chosen(in[1], "limit_nm");
    cophase_correction_report report = {0};

    check(cophase_estimate_correct(estimate_of(in[0]), limit_nm, text(in[2], "path"), &report, sizeof report));
    out[0] = structs(CORRECTION, &report, sizeof report, 1);
}

const command ESTIMATE_COMMANDS[] = {
    {"estimator.create", 1, ANY_NUMBER, do_create_estimator},
    {"estimate.create", 4, 4, do_create},
    {"estimate.info", 1, 1, do_info},
    {"estimate.images", 2, 2, do_images},
    {"estimate.array", 3, 3, do_array},
    {"estimate.text", 3, 3, do_text},
    {"estimate.write", 2, 2, do_write},
    {"estimate.correct", 3, 3, do_correct},
    {NULL, 0, 0, NULL},
};
