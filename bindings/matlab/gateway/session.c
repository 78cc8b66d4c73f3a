/* cophase.Session: its life, and the calibration of its camera. Its fits are in fit.c. */
#include "gateway.h"
#include <string.h>

static const char *const OPTIONS[] = {"Capacity",       "Precision",        "Device", "Threads",
                                      "MaxEvaluations", "StepTolerance_nm", NULL};
enum { CAPACITY, PRECISION, DEVICE, THREADS, MAX_EVALUATIONS, STEP_TOLERANCE_NM, OPTION_COUNT };

static int32_t precision_of(const mxArray *value)
{
    const char *name = text(value, "Precision");

    if (strcmp(name, "double") == 0)
        return COPHASE_F64;
    if (strcmp(name, "single") == 0)
        return COPHASE_F32;
    fail(COPHASE_BAD_VALUE, "Precision is '%s': 'single' or 'double' is accepted", name);
    return 0;
}

static cophase_session_options options_of(const mxArray **given)
{
    cophase_session_options options;

    check(cophase_session_options_init(&options, sizeof options));
    if (given[CAPACITY] != NULL)
        options.capacity = whole(given[CAPACITY], 1, "Capacity");
    if (given[PRECISION] != NULL)
        options.precision = precision_of(given[PRECISION]);
    if (given[THREADS] != NULL) {
        const size_t threads = whole(given[THREADS], 0, "Threads");

        options.threads = threads > INT32_MAX ? INT32_MAX : (int32_t)threads;
    }
    if (given[MAX_EVALUATIONS] != NULL)
        options.max_evaluations = whole(given[MAX_EVALUATIONS], 0, "MaxEvaluations");
    if (given[STEP_TOLERANCE_NM] != NULL)
        options.step_tolerance_nm = number(given[STEP_TOLERANCE_NM], "StepTolerance_nm");
    return options;
}

/* (model, 'Capacity', 8, ...): the number of a new session, and its device's line in the list of all. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    const mxArray *given[OPTION_COUNT];
    cophase_session_options chosen;
    const char *address;
    char name[256];
    size_t length;
    cophase_device *device;
    cophase_session *session;
    cophase_status status;

    options(inputs - 1, in + 1, OPTIONS, given);
    chosen = options_of(given);
    address = text(given[DEVICE], "Device");
    check(cophase_device_open(address == NULL ? "cpu" : address, &device));
    status = cophase_device_name(device, name, sizeof name, &length);
    if (status == COPHASE_OK)
        status = cophase_session_create(device, (const cophase_model *)model->object, &chosen, &session);
    /* The session keeps what it needs of it. */
    cophase_device_close(device);
    check(status);
    out[0] = mxCreateDoubleScalar(handle_new(SESSION, session, model->modes)->id);
    if (outputs > 1)
        out[1] = mxCreateString(name);
}

static void do_delete(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    handle_delete(in[0], SESSION);
}

static const char *const CALIBRATION[] = {"Dark", "Flat", "Bad", "Gain_e", "Saturation", NULL};
enum { DARK, FLAT, BAD, GAIN_E, SATURATION, CALIBRATION_COUNT };

cophase_calibration calibration_of(int inputs, const mxArray **in)
{
    const mxArray *given[CALIBRATION_COUNT];
    cophase_calibration calibration;

    options(inputs, in, CALIBRATION, given);
    check(cophase_calibration_init(&calibration, sizeof calibration));
    if (given[DARK] != NULL)
        calibration.dark = input(given[DARK], "Dark");
    if (given[FLAT] != NULL)
        calibration.flat = input(given[FLAT], "Flat");
    if (given[BAD] != NULL)
        calibration.bad = input(given[BAD], "Bad");
    if (given[GAIN_E] != NULL)
        calibration.gain_e = number(given[GAIN_E], "Gain_e");
    if (given[SATURATION] != NULL)
        calibration.saturation = number(given[SATURATION], "Saturation");
    return calibration;
}

/* (session, 'Dark', dark, ...); without options there is none. */
static void do_calibrate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *session = handle_of(in[0], SESSION);
    const cophase_calibration calibration = calibration_of(inputs - 1, in + 1);

    check(cophase_session_calibrate((cophase_session *)session->object, &calibration));
}

const command SESSION_COMMANDS[] = {
    {"session.create", 1, ANY_NUMBER, do_create},
    {"session.delete", 1, 1, do_delete},
    {"session.calibrate", 1, ANY_NUMBER, do_calibrate},
    {NULL, 0, 0, NULL},
};
