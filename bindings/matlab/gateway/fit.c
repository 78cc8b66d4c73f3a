/* cophase.Session: fits and what they leave, and the objective for an optimizer of the caller's. */
#include "gateway.h"

static cophase_session *session_of(const live *session) { return (cophase_session *)session->object; }

static const char *const OPTIONS[] = {"Deadline_s", "ReadNoise_e", "Start_nm", NULL};
enum { DEADLINE_S, READ_NOISE_E, START_NM, OPTION_COUNT };

/* The options of `count` frames, from NAME, VALUE, ... */
static cophase_fit_options options_of(int inputs, const mxArray **in, size_t modes, size_t count)
{
    const mxArray *given[OPTION_COUNT];
    cophase_fit_options chosen;

    options(inputs, in, OPTIONS, given);
    check(cophase_fit_options_init(&chosen, sizeof chosen));
    if (given[DEADLINE_S] != NULL)
        chosen.deadline_s = number(given[DEADLINE_S], "Deadline_s");
    if (given[READ_NOISE_E] != NULL)
        chosen.read_noise_e = number(given[READ_NOISE_E], "ReadNoise_e");
    if (given[START_NM] != NULL)
        chosen.start_nm = doubles(given[START_NM], modes, count, "Start_nm");
    return chosen;
}

typedef struct fit {
    cophase_session *session;
    cophase_input frames;
    cophase_fit_options options;
    double *coefficients_nm;
    size_t modes;
    cophase_report *reports;
} fit;

static cophase_status do_fit_work(void *argument)
{
    const fit *fit = (const struct fit *)argument;

    return cophase_session_fit(fit->session, &fit->frames, &fit->options, fit->coefficients_nm, fit->modes,
                               fit->reports, sizeof(cophase_report));
}

static cophase_status cancel(const void *session)
{
    return cophase_session_cancel((const cophase_session *)session);
}

static mxArray *struct_of(const cophase_report *reports, size_t count)
{
    static const char *FIELDS[] = {"Status",       "BadPixels", "Evaluations", "ReducedChi2", "Flux_e",
                                   "Background_e", "Tip_nm",    "Tilt_nm",     "Seconds"};
    mxArray *result = mxCreateStructMatrix(count, 1, sizeof FIELDS / sizeof FIELDS[0], FIELDS);
    size_t i;

    for (i = 0; i < count; i++) {
        const cophase_report *report = &reports[i];

        mxSetField(result, i, "Status", mxCreateString(cophase_image_status_name(report->status)));
        set_number(result, i, "BadPixels", report->bad_pixels);
        set_number(result, i, "Evaluations", (double)report->evaluations);
        set_number(result, i, "ReducedChi2", report->reduced_chi2);
        set_number(result, i, "Flux_e", report->flux_e);
        set_number(result, i, "Background_e", report->background_e);
        set_number(result, i, "Tip_nm", report->tip_nm);
        set_number(result, i, "Tilt_nm", report->tilt_nm);
        set_number(result, i, "Seconds", report->seconds);
    }
    return result;
}

/* (session, frames, 'Deadline_s', ...): coefficients, a column for each frame, and a report for each. */
static void do_fit(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    live *session = handle_of(in[0], SESSION);
    fit fit;

    fit.session = session_of(session);
    fit.frames = input(in[1], "frames");
    fit.modes = session->modes;
    fit.options = options_of(inputs - 2, in + 2, fit.modes, fit.frames.count);
    fit.reports = (cophase_report *)mxCalloc(fit.frames.count, sizeof(cophase_report));
    out[0] = mxCreateDoubleMatrix(fit.modes, fit.frames.count, mxREAL);
    fit.coefficients_nm = (double *)mxGetData(out[0]);
    session->images = 0;
    interruptible(cancel, fit.session, do_fit_work, &fit);
    session->images = fit.frames.count;
    if (outputs > 1)
        out[1] = struct_of(fit.reports, fit.frames.count);
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

/* (session, image): why it has the status that it has. */
static void do_message(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    char sentence[2049];
    size_t length;
    const size_t image = image_of(session, in[1]);

    check(cophase_session_image_message(session_of(session), image, sentence, sizeof sentence, &length));
    out[0] = mxCreateString(sentence);
}

/* (session): that its device was lost, and the CPU has taken its place; empty where it was not. */
static void do_device_failure(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    char sentence[2049];
    size_t length;

    check(cophase_session_device_failure(session_of(session), sentence, sizeof sentence, &length));
    out[0] = mxCreateString(sentence);
}

/* (session, image): modes x modes, nm^2. */
static void do_covariance(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const size_t image = image_of(session, in[1]);

    out[0] = mxCreateDoubleMatrix(session->modes, session->modes, mxREAL);
    /* Symmetric: rows are columns. */
    check(cophase_session_covariance_nm2(session_of(session), image, (double *)mxGetData(out[0]), session->modes));
}

/* (session, frames, 'ReadNoise_e', ...) */
static void do_load(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const cophase_input frames = input(in[1], "frames");
    const cophase_fit_options chosen = options_of(inputs - 2, in + 2, session->modes, frames.count);

    check(cophase_session_load(session_of(session), &frames, &chosen));
}

/* (session, coefficients): objectives in a row, and their gradients in columns. */
static void do_evaluate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const int row = mxGetM(in[1]) == 1 && mxGetN(in[1]) == session->modes;
    const size_t count = row ? 1 : mxGetN(in[1]);
    const double *coefficients_nm = doubles(in[1], session->modes, count, "coefficients");
    mxArray *gradients = mxCreateDoubleMatrix(session->modes, count, mxREAL);

    out[0] = mxCreateDoubleMatrix(1, count, mxREAL);
    check(cophase_session_evaluate(session_of(session), coefficients_nm, count, session->modes,
                                   (double *)mxGetData(out[0]), (double *)mxGetData(gradients)));
    if (outputs > 1)
        out[1] = gradients;
}

const command FIT_COMMANDS[] = {
    {"session.fit", 2, ANY_NUMBER, do_fit},
    {"session.message", 2, 2, do_message},
    {"session.device_failure", 1, 1, do_device_failure},
    {"session.covariance", 2, 2, do_covariance},
    {"session.load", 2, ANY_NUMBER, do_load},
    {"session.evaluate", 2, 2, do_evaluate},
    {NULL, 0, 0, NULL},
};
