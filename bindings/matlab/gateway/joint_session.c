/* cophase.JointSession. */
#include "gateway.h"
#include <string.h>

static cophase_joint_session *session_of(const live *session) { return (cophase_joint_session *)session->object; }

/* (scene text, 'device', 'cpu', ...): a new session. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const mxArray *directory;
    const cophase_session_options chosen_options = session_options_of(inputs - 1, in + 1, &directory);
    const char *scene = text(in[0], "scene");
    cophase_joint_session *session;
    cophase_model *model;
    cophase_model_info info;

    check(cophase_joint_session_create(scene, text(directory, "directory"), &chosen_options, &session));
    /* A session has at least one channel. */
    out[0] = handle_new(JOINT_SESSION, session, 0);
    check(cophase_joint_session_model(session, 0, &model));
    memset(&info, 0, sizeof info);
    cophase_model_get_info(model, &info, sizeof info);
    cophase_model_destroy(model);
    handle_of(out[0], JOINT_SESSION)->modes = info.modes;
}

/* A channel, which MATLAB counts from 1. */
static size_t channel_of(const mxArray *value) { return whole(value, 1, "the channel") - 1; }

/* (session): number of channels. */
static void do_channels(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    size_t channels;

    check(cophase_joint_session_channels(session_of(handle_of(in[0], JOINT_SESSION)), &channels));
    out[0] = mxCreateDoubleScalar((double)channels);
}

/* (session, channel): its model. */
static void do_model(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], JOINT_SESSION);
    cophase_model *model;

    check(cophase_joint_session_model(session_of(session), channel_of(in[1]), &model));
    out[0] = handle_new(MODEL, model, session->modes);
}

/* (session, channel, 'dark', dark, ...); without options frames are electrons. */
static void do_calibrate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], JOINT_SESSION);
    const mxArray *given[5];
    cophase_calibration calibration;

    options(inputs - 2, in + 2, CALIBRATION, given);
    calibration = calibration_of(given[0], given[1], given[2], given[3], given[4]);
    check(cophase_joint_session_calibrate(session_of(session), channel_of(in[1]), &calibration));
}

typedef struct job {
    cophase_joint_session *session;
    cophase_input *frames;
    size_t channels;
    cophase_fit_options options;
    double *coefficients_nm, *sigma_nm;
    size_t modes;
    cophase_joint_report report;
    cophase_image_report *images;
} job;

static cophase_status work(void *argument)
{
    job *job = (struct job *)argument;

    return cophase_joint_session_fit(job->session, job->frames, job->channels, &job->options, job->coefficients_nm,
                                     job->sigma_nm, job->modes, &job->report, sizeof job->report, job->images,
                                     sizeof(cophase_image_report));
}

static cophase_status cancel(const void *session)
{
    return cophase_joint_session_cancel((const cophase_joint_session *)session);
}

#define T cophase_joint_report
static const field JOINT_REPORT[] = {
    FIELD(T, status, IS_STATUS), FIELD(T, is_contradictory, IS_LOGICAL), FIELD(T, reduced_chi2, IS_DOUBLE),
    FIELD(T, freedom, IS_DOUBLE), FIELD(T, piston_probability, IS_DOUBLE), FIELD(T, seconds, IS_DOUBLE), END_OF_FIELDS,
};
#undef T

/* (session, cell of frames, 'deadline_s', ...): coefficients beside their error bars; a cell of the joint report and those on the
 * images. */
static void do_fit(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], JOINT_SESSION);
    job job;
    size_t i;

    memset(&job, 0, sizeof job);
    job.session = session_of(session);
    job.channels = mxGetNumberOfElements(in[1]);
    job.frames = (cophase_input *)mxCalloc(job.channels + 1, sizeof *job.frames);
    for (i = 0; i < job.channels; i++)
        job.frames[i] = input(mxGetCell(in[1], i), "frames");
    job.modes = session->modes;
    job.options = fit_options_of(inputs - 2, in + 2, job.modes, 1);
    job.images = (cophase_image_report *)mxCalloc(job.channels + 1, sizeof(cophase_image_report));
    out[0] = mxCreateDoubleMatrix(job.modes, 2, mxREAL);
    job.coefficients_nm = mxGetPr(out[0]);
    job.sigma_nm = mxGetPr(out[0]) + job.modes;
    interruptible(cancel, job.session, work, &job);
    if (outputs > 1) {
        out[1] = mxCreateCellMatrix(1, 2);
        mxSetCell(out[1], 0, structs(JOINT_REPORT, &job.report, sizeof job.report, 1));
        mxSetCell(out[1], 1, structs(IMAGE_REPORT, job.images, sizeof(cophase_image_report), job.channels));
    }
}

/* (session): coefficients beside their covariance, modes x (1 + modes); the joint report. */
static void do_refine(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], JOINT_SESSION);
    cophase_joint_report report;

    memset(&report, 0, sizeof report);
    out[0] = mxCreateDoubleMatrix(session->modes, 1 + session->modes, mxREAL);
    /* Symmetric: rows are columns. */
    check(cophase_joint_session_refine(session_of(session), mxGetPr(out[0]), mxGetPr(out[0]) + session->modes,
                                       session->modes, &report, sizeof report));
    if (outputs > 1)
        out[1] = structs(JOINT_REPORT, &report, sizeof report, 1);
}

static cophase_status session_text(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                   size_t *length)
{
    return cophase_joint_session_text((const cophase_joint_session *)object, what, index, text, capacity, length);
}

static const constant_name TEXTS[] = {
    {"IMAGE_MESSAGE", COPHASE_TEXT_IMAGE_MESSAGE},
    {"CHANNEL_NAME", COPHASE_TEXT_CHANNEL_NAME},
    {"WARNINGS", COPHASE_TEXT_WARNINGS},
    {"DEVICE", COPHASE_TEXT_DEVICE},
    {"POLICY", COPHASE_TEXT_POLICY},
    {NULL, 0},
};

/* (session, 'IMAGE_MESSAGE', channel): a text. */
static void do_text(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], JOINT_SESSION);

    out[0] = long_text(session_text, session_of(session), choice(in[1], TEXTS, "the name"), channel_of(in[2]));
}

const command JOINT_SESSION_COMMANDS[] = {
    {"joint_session.create", 1, ANY_NUMBER, do_create},
    {"joint_session.channels", 1, 1, do_channels},
    {"joint_session.model", 2, 2, do_model},
    {"joint_session.calibrate", 2, ANY_NUMBER, do_calibrate},
    {"joint_session.fit", 2, ANY_NUMBER, do_fit},
    {"joint_session.refine", 1, 1, do_refine},
    {"joint_session.text", 3, 3, do_text},
    {NULL, 0, 0, NULL},
};
