/* cophase.FullPhase. */
#include "gateway.h"
#include <string.h>

static cophase_full_phase *full_phase_of(const mxArray *value)
{
    return (cophase_full_phase *)handle_of(value, FULL_PHASE)->object;
}

/* What an estimate may know, in the order of the COPHASE_KNOWS_ numbers. */
static const char *const KNOWS[] = {"", "nothing", "spectrum", "loop", "telemetry"};

static int32_t knows_of(const mxArray *value)
{
    const char *word = text(value, "Knows");
    int32_t i;

    for (i = COPHASE_KNOWS_NOTHING; i <= COPHASE_KNOWS_TELEMETRY; i++)
        if (word != NULL && strcmp(word, KNOWS[i]) == 0)
            return i;
    fail(COPHASE_BAD_VALUE, "Knows is '%s': nothing, spectrum, loop or telemetry is accepted", word == NULL ? "" : word);
    return COPHASE_KNOWS_MOST;
}

/* (scene_text, directory): the number of a new estimator. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const char *scene_text = text(in[0], "scene_text"), *directory = text(in[1], "directory");
    cophase_full_phase *full_phase;

    check(cophase_full_phase_create(scene_text == NULL ? "" : scene_text, directory, &full_phase));
    out[0] = mxCreateDoubleScalar(handle_new(FULL_PHASE, full_phase, 0)->id);
}

static void do_delete(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    handle_delete(in[0], FULL_PHASE);
}

/* [rows, columns] of a frame. */
static void do_frame_size(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    size_t rows, cols;

    check(cophase_full_phase_frame_shape(full_phase_of(in[0]), &rows, &cols));
    out[0] = mxCreateDoubleMatrix(1, 2, mxREAL);
    ((double *)mxGetData(out[0]))[0] = (double)rows;
    ((double *)mxGetData(out[0]))[1] = (double)cols;
}

/* (full_phase, 'Dark', ...) */
static void do_calibrate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_full_phase *full_phase = full_phase_of(in[0]);
    cophase_calibration calibration = calibration_of(inputs - 1, in + 1);

    check(cophase_full_phase_calibrate(full_phase, &calibration));
}

typedef struct estimate {
    cophase_full_phase *full_phase;
    cophase_input frames, slopes_mas;
    cophase_full_phase_options options;
    cophase_full_phase_report report;
} estimate;

static cophase_status do_estimate_work(void *argument)
{
    estimate *estimate = (struct estimate *)argument;

    return cophase_full_phase_estimate(estimate->full_phase, &estimate->frames,
                                       estimate->slopes_mas.data == NULL ? NULL : &estimate->slopes_mas,
                                       &estimate->options, &estimate->report, sizeof estimate->report);
}

static cophase_status cancel(const void *full_phase)
{
    return cophase_full_phase_cancel((const cophase_full_phase *)full_phase);
}

/* Slopes with a column for each image, as the library wants them: a row for each. */
static cophase_input slopes_of(const mxArray *value)
{
    cophase_input columns = input(value, "slopes_mas"), rows = columns;

    rows.rows = columns.cols, rows.row_stride = columns.col_stride;
    rows.cols = columns.rows, rows.col_stride = columns.row_stride;
    return rows;
}

static mxArray *warnings_of(const cophase_full_phase *full_phase)
{
    char *lines;
    size_t length;

    check(cophase_full_phase_warnings(full_phase, NULL, 0, &length));
    lines = (char *)mxMalloc(length + 1);
    check(cophase_full_phase_warnings(full_phase, lines, length + 1, &length));
    return mxCreateString(lines);
}

static mxArray *message_of(const cophase_full_phase *full_phase, size_t image)
{
    char *sentence;
    size_t length;

    check(cophase_full_phase_image_message(full_phase, image, NULL, 0, &length));
    sentence = (char *)mxMalloc(length + 1);
    check(cophase_full_phase_image_message(full_phase, image, sentence, length + 1, &length));
    return mxCreateString(sentence);
}

/* A struct for each image. */
static mxArray *images_of(const cophase_full_phase *full_phase, size_t count)
{
    static const char *FIELDS[] = {"Status", "Used", "Evaluations", "ReducedChi2", "Flux_e", "Background_e", "Message"};
    cophase_full_phase_image *images = (cophase_full_phase_image *)mxCalloc(count, sizeof *images);
    mxArray *result = mxCreateStructMatrix(count, 1, sizeof FIELDS / sizeof FIELDS[0], FIELDS);
    size_t i;

    check(cophase_full_phase_images(full_phase, images, sizeof *images, count));
    for (i = 0; i < count; i++) {
        mxSetField(result, i, "Status", mxCreateString(cophase_image_status_name(images[i].status)));
        mxSetField(result, i, "Used", mxCreateLogicalScalar(images[i].used != 0));
        set_number(result, i, "Evaluations", (double)images[i].evaluations);
        set_number(result, i, "ReducedChi2", images[i].reduced_chi2);
        set_number(result, i, "Flux_e", images[i].flux_e);
        set_number(result, i, "Background_e", images[i].background_e);
        mxSetField(result, i, "Message", message_of(full_phase, i));
    }
    return result;
}

static mxArray *names_of(const cophase_full_phase *full_phase, size_t modes)
{
    mxArray *names = mxCreateCellMatrix(modes, 1);
    const char *name;
    size_t mode;

    for (mode = 0; mode < modes; mode++) {
        check(cophase_full_phase_mode_name(full_phase, mode, &name));
        mxSetCell(names, mode, mxCreateString(name));
    }
    return names;
}

/* What there is of numbers for each mode. */
static void set_modes(mxArray *result, const cophase_full_phase *full_phase)
{
    mxArray *coefficients_nm, *sigma_nm, *covariance_nm2;
    size_t modes, segments;

    check(cophase_full_phase_mode_count(full_phase, &modes));
    check(cophase_full_phase_segment_mode_count(full_phase, &segments));
    coefficients_nm = mxCreateDoubleMatrix(modes, 1, mxREAL);
    sigma_nm = mxCreateDoubleMatrix(modes, 1, mxREAL);
    covariance_nm2 = mxCreateDoubleMatrix(modes, modes, mxREAL);
    check(cophase_full_phase_coefficients_nm(full_phase, (double *)mxGetData(coefficients_nm),
                                             (double *)mxGetData(sigma_nm), modes));
    /* Symmetric: rows are columns. */
    check(cophase_full_phase_covariance_nm2(full_phase, (double *)mxGetData(covariance_nm2), modes));
    mxSetField(result, 0, "Coefficients_nm", coefficients_nm);
    mxSetField(result, 0, "Sigma_nm", sigma_nm);
    mxSetField(result, 0, "Covariance_nm2", covariance_nm2);
    mxSetField(result, 0, "Names", names_of(full_phase, modes));
    set_number(result, 0, "SegmentModes", (double)segments);
}

/* The fields of cophase.FullPhase.estimate, which makes maps of Maps_nm. */
static mxArray *struct_of(const cophase_full_phase *full_phase, const cophase_full_phase_report *report)
{
    static const char *FIELDS[] = {
        "Coefficients_nm", "Sigma_nm", "Covariance_nm2", "Names",         "SegmentModes",     "Maps_nm",
        "Images",          "Used",     "Passes",         "Settled",       "Knows",            "PhasingRms_nm",
        "PhasingSigma_nm", "NcpaRms_nm", "NcpaSigma_nm", "ReducedChi2",   "PhasingChange_nm", "NcpaChange_nm",
        "Seconds",         "Reports",  "Warnings"};
    mxArray *result = mxCreateStructMatrix(1, 1, sizeof FIELDS / sizeof FIELDS[0], FIELDS);
    cophase_array_f32 view;
    size_t side;

    set_modes(result, full_phase);
    check(cophase_full_phase_samples(full_phase, &side));
    mxSetField(result, 0, "Maps_nm", maps(side, side, 4, &view));
    check(cophase_full_phase_maps_nm(full_phase, &view));
    set_number(result, 0, "Images", (double)report->images);
    set_number(result, 0, "Used", (double)report->used);
    set_number(result, 0, "Passes", (double)report->passes);
    mxSetField(result, 0, "Settled", mxCreateLogicalScalar(report->settled != 0));
    mxSetField(result, 0, "Knows", mxCreateString(KNOWS[report->knows]));
    set_number(result, 0, "PhasingRms_nm", report->phasing_rms_nm);
    set_number(result, 0, "PhasingSigma_nm", report->phasing_sigma_nm);
    set_number(result, 0, "NcpaRms_nm", report->ncpa_rms_nm);
    set_number(result, 0, "NcpaSigma_nm", report->ncpa_sigma_nm);
    set_number(result, 0, "ReducedChi2", report->reduced_chi2);
    set_number(result, 0, "PhasingChange_nm", report->phasing_change_nm);
    set_number(result, 0, "NcpaChange_nm", report->ncpa_change_nm);
    set_number(result, 0, "Seconds", report->seconds);
    mxSetField(result, 0, "Reports", images_of(full_phase, (size_t)report->images));
    mxSetField(result, 0, "Warnings", warnings_of(full_phase));
    return result;
}

static const char *const OPTIONS[] = {"Slopes_mas", "Knows", "ReadNoise_e", "Threads", NULL};
enum { SLOPES_MAS, KNOWN, READ_NOISE_E, THREADS, OPTION_COUNT };

/* (full_phase, frames, 'Slopes_mas', ...): a struct. */
static void do_estimate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const mxArray *given[OPTION_COUNT];
    estimate estimate;

    memset(&estimate, 0, sizeof estimate);
    estimate.full_phase = full_phase_of(in[0]);
    estimate.frames = input(in[1], "frames");
    options(inputs - 2, in + 2, OPTIONS, given);
    check(cophase_full_phase_options_init(&estimate.options, sizeof estimate.options));
    if (given[SLOPES_MAS] != NULL)
        estimate.slopes_mas = slopes_of(given[SLOPES_MAS]);
    if (given[KNOWN] != NULL)
        estimate.options.knows = knows_of(given[KNOWN]);
    if (given[READ_NOISE_E] != NULL)
        estimate.options.read_noise_e = number(given[READ_NOISE_E], "ReadNoise_e");
    if (given[THREADS] != NULL)
        estimate.options.threads = (int32_t)whole(given[THREADS], 0, "Threads");
    interruptible(cancel, estimate.full_phase, do_estimate_work, &estimate);
    out[0] = struct_of(estimate.full_phase, &estimate.report);
}

/* (full_phase, limit_nm): a struct. */
static void do_corrections(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    static const char *FIELDS[] = {"Pistons_nm", "Actuators_nm", "Actuators_m", "Slopes_mas", "CorrectedModes", "Limited"};
    cophase_full_phase *full_phase = full_phase_of(in[0]);
    cophase_correction_report report;
    mxArray *pistons_nm, *actuators_nm, *actuators_m, *slopes_mas;

    check(cophase_full_phase_correct(full_phase, number(in[1], "limit_nm"), &report, sizeof report));
    pistons_nm = mxCreateDoubleMatrix(report.segments, 1, mxREAL);
    actuators_nm = mxCreateDoubleMatrix(report.actuators, 1, mxREAL);
    actuators_m = mxCreateDoubleMatrix(2, report.actuators, mxREAL);
    slopes_mas = mxCreateDoubleMatrix(report.slopes, 1, mxREAL);
    /* Without a loop some are empty, and have no memory. */
    check(cophase_full_phase_corrections(full_phase, (double *)mxGetData(pistons_nm), report.segments,
                                         (double *)mxGetData(actuators_nm), (double *)mxGetData(actuators_m),
                                         report.actuators, (double *)mxGetData(slopes_mas), report.slopes));
    out[0] = mxCreateStructMatrix(1, 1, sizeof FIELDS / sizeof FIELDS[0], FIELDS);
    mxSetField(out[0], 0, "Pistons_nm", pistons_nm);
    mxSetField(out[0], 0, "Actuators_nm", actuators_nm);
    mxSetField(out[0], 0, "Actuators_m", actuators_m);
    mxSetField(out[0], 0, "Slopes_mas", slopes_mas);
    set_number(out[0], 0, "CorrectedModes", (double)report.corrected_modes);
    set_number(out[0], 0, "Limited", (double)report.limited);
}

/* (full_phase, phasing_nm, ncpa_nm): further images that the error bars ask for. */
static void do_images_needed(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const cophase_full_phase *full_phase = full_phase_of(in[0]);
    uint64_t images;

    check(cophase_full_phase_images_needed(full_phase, number(in[1], "phasing_nm"), number(in[2], "ncpa_nm"), &images));
    out[0] = mxCreateDoubleScalar(images == UINT64_MAX ? mxGetInf() : (double)images);
}

const command FULL_PHASE_COMMANDS[] = {
    {"full_phase.create", 2, 2, do_create},
    {"full_phase.delete", 1, 1, do_delete},
    {"full_phase.frame_size", 1, 1, do_frame_size},
    {"full_phase.calibrate", 1, ANY_NUMBER, do_calibrate},
    {"full_phase.estimate", 2, ANY_NUMBER, do_estimate},
    {"full_phase.corrections", 2, 2, do_corrections},
    {"full_phase.images_needed", 3, 3, do_images_needed},
    {NULL, 0, 0, NULL},
};
