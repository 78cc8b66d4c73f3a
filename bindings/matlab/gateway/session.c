/* cophase.Session. */
#include "gateway.h"

static cophase_session *session_of(const live *session) { return (cophase_session *)session->object; }

static const char *const SESSION_OPTIONS[] = {"capacity",        "precision",         "device", "threads",
                                              "max_evaluations", "step_tolerance_nm", NULL};
/* The session of several channels has another first option. */
static const char *const JOINT_SESSION_OPTIONS[] = {"directory",       "precision",         "device", "threads",
                                                    "max_evaluations", "step_tolerance_nm", NULL};
enum { CAPACITY, DIRECTORY = CAPACITY, PRECISION, DEVICE, THREADS, MAX_EVALUATIONS, STEP_TOLERANCE_NM, SESSION_OPTION_COUNT };

cophase_session_options session_options_of(int inputs, const mxArray **in, const mxArray **directory)
{
    const mxArray *given[SESSION_OPTION_COUNT];
    cophase_session_options chosen_options = {0};

    options(inputs, in, directory == NULL ? SESSION_OPTIONS : JOINT_SESSION_OPTIONS, given);
    if (directory != NULL)
        *directory = given[DIRECTORY];
    chosen_options.struct_size = sizeof chosen_options;
    chosen_options.device = text(given[DEVICE], "device");
    if (directory == NULL && given[CAPACITY] != NULL)
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
    const cophase_session_options chosen_options = session_options_of(inputs - 1, in + 1, NULL);
    cophase_session *session;

    check(cophase_session_create((const cophase_model *)model->object, &chosen_options, &session));
    out[0] = handle_new(SESSION, session, model->modes);
}

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

const char *const CALIBRATION[] = {"dark", "flat", "bad", "gain_e", "saturation", NULL};

/* (session, 'dark', dark, ...); without options frames are electrons. */
static void do_calibrate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const mxArray *given[5];
    cophase_calibration calibration;

    options(inputs - 1, in + 1, CALIBRATION, given);
    calibration = calibration_of(given[0], given[1], given[2], given[3], given[4]);
    check(cophase_session_calibrate(session_of(session), &calibration));
}

static const char *const FIT_OPTIONS[] = {"deadline_s", "read_noise_e", "start_nm", NULL};
enum { DEADLINE_S, READ_NOISE_E, START_NM, FIT_OPTION_COUNT };

cophase_fit_options fit_options_of(int inputs, const mxArray **in, size_t modes, size_t count)
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
    cophase_input frames;
    cophase_fit_options options;
    double *coefficients_nm;
    size_t modes;
    cophase_image_report *reports;
} job;

static cophase_status work(void *argument)
{
    const job *job = (const struct job *)argument;

    return cophase_session_fit(job->session, &job->frames, &job->options, job->coefficients_nm, job->modes, job->reports,
                               sizeof(cophase_image_report));
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

/* (session, frames, 'deadline_s', ...): coefficients, a column for each frame, and a report on each. */
static void do_fit(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    live *session = handle_of(in[0], SESSION);
    job job;

    job.session = session_of(session);
    job.frames = input(in[1], "frames");
    job.modes = session->modes;
    job.options = fit_options_of(inputs - 2, in + 2, job.modes, job.frames.count);
    job.reports = (cophase_image_report *)mxCalloc(job.frames.count, sizeof(cophase_image_report));
    out[0] = mxCreateDoubleMatrix(job.modes, job.frames.count, mxREAL);
    job.coefficients_nm = mxGetPr(out[0]);
    session->images = 0;
    interruptible(cancel, job.session, work, &job);
    session->images = job.frames.count;
    if (outputs > 1)
        out[1] = structs(IMAGE_REPORT, job.reports, sizeof(cophase_image_report), job.frames.count);
}

/* An image of the last fit, which MATLAB counts from 1. */
static size_t image_of(const live *session, const mxArray *value)
{
    const size_t image = whole(value, 1, "the image");

    if (session->images > 0 && image > session->images)
        fail(COPHASE_BAD_VALUE, "the image is %lu: up to %lu is accepted, the images of the last fit",
             (unsigned long)image, (unsigned long)session->images);
    return image - 1;
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

/* (session, 'IMAGE_MESSAGE', image): a text. */
static void do_text(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);

    out[0] = long_text(session_text, session_of(session), choice(in[1], TEXTS, "the name"), image_of(session, in[2]));
}

/* (session, image): modes x modes, nm^2. */
static void do_covariance_nm2(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const size_t image = image_of(session, in[1]);

    out[0] = mxCreateDoubleMatrix(session->modes, session->modes, mxREAL);
    /* Symmetric: rows are columns. */
    check(cophase_session_covariance_nm2(session_of(session), image, mxGetPr(out[0]), session->modes));
}

/* (session, coefficients_nm, frames or [], 'read_noise_e', ...): objectives in a row, and their gradients in columns. */
static void do_evaluate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const int row = mxGetM(in[1]) == 1 && mxGetN(in[1]) == session->modes;
    const size_t count = row ? 1 : mxGetN(in[1]);
    const double *coefficients_nm = doubles(in[1], session->modes, count, "coefficients_nm");
    const cophase_fit_options chosen_options = fit_options_of(inputs - 3, in + 3, session->modes, count);
    mxArray *gradients = mxCreateDoubleMatrix(session->modes, count, mxREAL);
    cophase_input frames;

    if (!mxIsEmpty(in[2]))
        frames = input(in[2], "frames");
    out[0] = mxCreateDoubleMatrix(1, count, mxREAL);
    check(cophase_session_evaluate(session_of(session), mxIsEmpty(in[2]) ? NULL : &frames, &chosen_options,
                                   coefficients_nm, count, session->modes, mxGetPr(out[0]), mxGetPr(gradients)));
    if (outputs > 1)
        out[1] = gradients;
}

const command SESSION_COMMANDS[] = {
    {"session.create", 1, ANY_NUMBER, do_create},
    {"session.calibrate", 1, ANY_NUMBER, do_calibrate},
    {"session.fit", 2, ANY_NUMBER, do_fit},
    {"session.text", 3, 3, do_text},
    {"session.covariance_nm2", 2, 2, do_covariance_nm2},
    {"session.evaluate", 3, ANY_NUMBER, do_evaluate},
    {NULL, 0, 0, NULL},
};
