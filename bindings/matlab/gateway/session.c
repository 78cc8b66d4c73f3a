/* cophase.Session. */
#include "gateway.h"

static cophase_session *session_of(const live *session) { return (cophase_session *)session->object; }

static const char *const SESSION_OPTIONS[] = {"capacity",        "precision",         "device", "threads",
                                              "max_evaluations", "step_tolerance_nm", NULL};
enum { CAPACITY, PRECISION, DEVICE, THREADS, MAX_EVALUATIONS, STEP_TOLERANCE_NM, SESSION_OPTION_COUNT };

static cophase_session_options session_options_of(int inputs, const mxArray **in)
{
    const mxArray *given[SESSION_OPTION_COUNT];
    cophase_session_options chosen_options = {0};

    options(inputs, in, SESSION_OPTIONS, given);
    chosen_options.struct_size = sizeof chosen_options;
    chosen_options.device = text(given[DEVICE], "device");
    if (given[CAPACITY] != NULL)
        chosen_options.capacity = whole(given[CAPACITY], 1, "capacity");
    if (given[PRECISION] != NULL)
        chosen_options.precision = choice(given[PRECISION], PRECISIONS, "precision");
    if (given[THREADS] != NULL)
        chosen_options.threads = threads(given[THREADS]);
    if (given[MAX_EVALUATIONS] != NULL)
        chosen_options.max_evaluations = whole(given[MAX_EVALUATIONS], 1, "max_evaluations");
    if (given[STEP_TOLERANCE_NM] != NULL)
        chosen_options.step_tolerance_nm = chosen(given[STEP_TOLERANCE_NM], "step_tolerance_nm");
    return chosen_options;
}

/* (model, 'capacity', 8, ...): a new session. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    const cophase_session_options chosen_options = session_options_of(inputs - 1, in + 1);
    cophase_session *session;

    check(cophase_session_create((const cophase_model *)model->object, &chosen_options, &session));
    out[0] = handle_new(SESSION, session, model->modes);
    handle_of(out[0], SESSION)->channels = model->channels;
}

/* A channel, which MATLAB counts from 1. */
static size_t channel_of(const mxArray *value) { return whole(value, 1, "the channel") - 1; }

cophase_calibration calibration_of(const mxArray *dark, const mxArray *flat, const mxArray *bad, const mxArray *gain_e,
                                   const mxArray *saturation)
{
    cophase_calibration calibration = {0};

    calibration.struct_size = sizeof calibration;
    if (dark != NULL)
        calibration.dark = input(dark, "dark");
    if (flat != NULL)
        calibration.flat = input(flat, "flat");
    if (bad != NULL)
        calibration.bad = input(bad, "bad");
    if (gain_e != NULL)
        calibration.gain_e = chosen(gain_e, "gain_e");
    if (saturation != NULL)
        calibration.saturation = chosen(saturation, "saturation");
    return calibration;
}

static const char *const CALIBRATION[] = {"dark", "flat", "bad", "gain_e", "saturation", NULL};

/* (session, channel, 'dark', dark, ...); without options frames are electrons. */
static void do_calibrate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const mxArray *given[5];
    cophase_calibration calibration;

    options(inputs - 2, in + 2, CALIBRATION, given);
    calibration = calibration_of(given[0], given[1], given[2], given[3], given[4]);
    check(cophase_session_calibrate(session_of(session), channel_of(in[1]), &calibration));
}

static const char *const FIT_OPTIONS[] = {"deadline_s", "read_noise_e", "start_nm", NULL};
enum { DEADLINE_S, READ_NOISE_E, START_NM, FIT_OPTION_COUNT };

static cophase_fit_options fit_options_of(int inputs, const mxArray **in, size_t modes, size_t count)
{
    const mxArray *given[FIT_OPTION_COUNT];
    cophase_fit_options chosen_options = {0};

    options(inputs, in, FIT_OPTIONS, given);
    chosen_options.struct_size = sizeof chosen_options;
    if (given[DEADLINE_S] != NULL)
        chosen_options.deadline_s = chosen(given[DEADLINE_S], "deadline_s");
    if (given[READ_NOISE_E] != NULL)
        chosen_options.read_noise_e = number(given[READ_NOISE_E], "read_noise_e"), chosen_options.has_read_noise = 1;
    if (given[START_NM] != NULL)
        chosen_options.start_nm = doubles(given[START_NM], modes, count, "start_nm");
    return chosen_options;
}

typedef struct job {
    cophase_session *session;
    cophase_input *frames;
    size_t channels;
    cophase_fit_options options;
    double *coefficients_nm, *sigma_nm;
    size_t modes;
    cophase_image_report *images;
    cophase_group_report *groups;
} job;

static cophase_status work(void *argument)
{
    const job *job = (const struct job *)argument;

    return cophase_session_fit(job->session, job->frames, job->channels, &job->options, job->coefficients_nm,
                               job->sigma_nm, job->modes, job->images, sizeof(cophase_image_report), job->groups,
                               sizeof(cophase_group_report));
}

static cophase_status cancel(const void *session)
{
    return cophase_session_cancel((const cophase_session *)session);
}

#define T cophase_image_report
const field IMAGE_REPORT[] = {
    FIELD(T, status, IS_STATUS), FIELD(T, is_used, IS_LOGICAL), FIELD(T, is_clipped, IS_LOGICAL),
    FIELD(T, bad_pixels, IS_INT), FIELD(T, rejected_pixels, IS_INT), NAMED_FIELD(T, policy, POLICIES),
    FIELD(T, evaluations, IS_COUNT), FIELD(T, reduced_chi2, IS_DOUBLE), FIELD(T, flux_e, IS_DOUBLE),
    FIELD(T, background_e, IS_DOUBLE), FIELD(T, tip_nm, IS_DOUBLE), FIELD(T, tilt_nm, IS_DOUBLE),
    FIELD(T, seconds, IS_DOUBLE), FIELD(T, channel, IS_COUNT), END_OF_FIELDS,
};
#undef T

#define T cophase_group_report
static const field GROUP_REPORT[] = {
    FIELD(T, status, IS_STATUS), FIELD(T, is_contradictory, IS_LOGICAL), FIELD(T, reduced_chi2, IS_DOUBLE),
    FIELD(T, freedom, IS_DOUBLE), FIELD(T, piston_probability, IS_DOUBLE), FIELD(T, seconds, IS_DOUBLE), END_OF_FIELDS,
};
#undef T

/* (session, cell of the frames of each channel, 'deadline_s', ...): coefficients, a column for each group; reports on the images, group by
 * group; reports on the groups; error bars, as the coefficients. */
static void do_fit(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    live *session = handle_of(in[0], SESSION);
    job job;
    mxArray *sigma_nm;
    size_t i, count;

    if (!mxIsCell(in[1]) || mxIsEmpty(in[1]))
        fail(COPHASE_BAD_ARGUMENT, "frames is no cell of the frames of each channel");
    job.session = session_of(session);
    job.channels = mxGetNumberOfElements(in[1]);
    job.frames = (cophase_input *)mxCalloc(job.channels, sizeof(cophase_input));
    for (i = 0; i < job.channels; i++)
        job.frames[i] = input(mxGetCell(in[1], i), "frames");
    count = job.frames[0].count;
    job.modes = session->modes;
    job.options = fit_options_of(inputs - 2, in + 2, job.modes, count);
    job.images = (cophase_image_report *)mxCalloc(count * job.channels, sizeof(cophase_image_report));
    job.groups = (cophase_group_report *)mxCalloc(count, sizeof(cophase_group_report));
    out[0] = mxCreateDoubleMatrix(job.modes, count, mxREAL);
    job.coefficients_nm = mxGetPr(out[0]);
    sigma_nm = mxCreateDoubleMatrix(job.modes, count, mxREAL);
    job.sigma_nm = mxGetPr(sigma_nm);
    session->groups = 0;
    interruptible(cancel, job.session, work, &job);
    session->groups = count;
    if (outputs > 1)
        out[1] = structs(IMAGE_REPORT, job.images, sizeof(cophase_image_report), count * job.channels);
    if (outputs > 2)
        out[2] = structs(GROUP_REPORT, job.groups, sizeof(cophase_group_report), count);
    if (outputs > 3)
        out[3] = sigma_nm;
}

/* A group of the last fit, which is an image with one channel, and which MATLAB counts from 1. */
static size_t group_of(const live *session, const mxArray *value)
{
    const char *const name = session->channels == 1 ? "the image" : "the group";
    const size_t group = whole(value, 1, name);

    if (session->groups > 0 && group > session->groups)
        fail(COPHASE_BAD_VALUE, "%s is %lu: up to %lu is accepted, those of the last fit", name, (unsigned long)group,
             (unsigned long)session->groups);
    return group - 1;
}

static cophase_status session_text(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                   size_t *length)
{
    return cophase_session_text((const cophase_session *)object, what, index, text, capacity, length);
}

static const constant_name TEXTS[] = {
    {"IMAGE_MESSAGE", COPHASE_TEXT_IMAGE_MESSAGE},
    {"WARNINGS", COPHASE_TEXT_WARNINGS},
    {"DEVICE", COPHASE_TEXT_DEVICE},
    {"POLICY", COPHASE_TEXT_POLICY},
    {NULL, 0},
};

/* (session, 'IMAGE_MESSAGE', group, channel): a text. */
static void do_text(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const size_t index = group_of(session, in[2]) * session->channels + channel_of(in[3]);

    out[0] = long_text(session_text, session_of(session), choice(in[1], TEXTS, "the name"), index);
}

/* (session, group): coefficients; covariance, modes x modes, nm^2; report. */
static void do_refine(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const size_t group = group_of(session, in[1]);
    mxArray *covariance_nm2 = mxCreateDoubleMatrix(session->modes, session->modes, mxREAL);
    cophase_group_report report;

    out[0] = mxCreateDoubleMatrix(session->modes, 1, mxREAL);
    /* Symmetric: rows are columns. */
    check(cophase_session_refine(session_of(session), group, mxGetPr(out[0]), mxGetPr(covariance_nm2), session->modes, &report,
                                 sizeof report));
    if (outputs > 1)
        out[1] = covariance_nm2;
    if (outputs > 2)
        out[2] = structs(GROUP_REPORT, &report, sizeof report, 1);
}

/* (session, channel, coefficients_nm, frames or [], 'read_noise_e', ...): objectives in a row, and their gradients in columns. */
static void do_evaluate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const int row = mxGetM(in[2]) == 1 && mxGetN(in[2]) == session->modes;
    const size_t count = row ? 1 : mxGetN(in[2]);
    const double *coefficients_nm = doubles(in[2], session->modes, count, "coefficients_nm");
    const cophase_fit_options chosen_options = fit_options_of(inputs - 4, in + 4, session->modes, count);
    mxArray *gradients = mxCreateDoubleMatrix(session->modes, count, mxREAL);
    cophase_input frames;

    if (!mxIsEmpty(in[3]))
        frames = input(in[3], "frames");
    out[0] = mxCreateDoubleMatrix(1, count, mxREAL);
    check(cophase_session_evaluate(session_of(session), channel_of(in[1]), mxIsEmpty(in[3]) ? NULL : &frames, &chosen_options,
                                   coefficients_nm, count, session->modes, mxGetPr(out[0]), mxGetPr(gradients)));
    if (outputs > 1)
        out[1] = gradients;
}

const command SESSION_COMMANDS[] = {
    {"session.create", 1, ANY_NUMBER, do_create},
    {"session.calibrate", 2, ANY_NUMBER, do_calibrate},
    {"session.fit", 2, ANY_NUMBER, do_fit},
    {"session.text", 4, 4, do_text},
    {"session.refine", 2, 2, do_refine},
    {"session.evaluate", 4, ANY_NUMBER, do_evaluate},
    {NULL, 0, 0, NULL},
};
