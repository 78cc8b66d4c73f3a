/* cophase.Sequence. */
#include "gateway.h"

static cophase_sequence *sequence_of(const live *sequence) { return (cophase_sequence *)sequence->object; }

/* (model, capacity): the number of a new sequence. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    cophase_sequence *sequence;

    check(cophase_sequence_create((const cophase_model *)model->object, whole(in[1], 1, "capacity"), &sequence));
    out[0] = mxCreateDoubleScalar(handle_new(SEQUENCE, sequence, model->modes)->id);
}

static void do_delete(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    handle_delete(in[0], SEQUENCE);
}

/* (sequence, session): all images of its last fit. */
static void do_push(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_sequence *sequence = sequence_of(handle_of(in[0], SEQUENCE));

    check(cophase_sequence_push(sequence, (const cophase_session *)handle_of(in[1], SESSION)->object));
}

static void do_clear(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    check(cophase_sequence_clear(sequence_of(handle_of(in[0], SEQUENCE))));
}

/* A struct. */
static void do_estimate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    static const char *FIELDS[] = {"Coefficients_nm", "Sigma_nm",         "Images",      "Used",         "Clipped",
                                   "PhasingRms_nm",   "PhasingSigma_nm", "NcpaRms_nm", "NcpaSigma_nm", "ReducedChi2"};
    const live *sequence = handle_of(in[0], SEQUENCE);
    mxArray *coefficients_nm = mxCreateDoubleMatrix(sequence->modes, 1, mxREAL);
    mxArray *sigma_nm = mxCreateDoubleMatrix(sequence->modes, 1, mxREAL);
    cophase_sequence_report report;

    check(cophase_sequence_estimate(sequence_of(sequence), (double *)mxGetData(coefficients_nm),
                                    (double *)mxGetData(sigma_nm), sequence->modes, &report, sizeof report));
    out[0] = mxCreateStructMatrix(1, 1, sizeof FIELDS / sizeof FIELDS[0], FIELDS);
    mxSetField(out[0], 0, "Coefficients_nm", coefficients_nm);
    mxSetField(out[0], 0, "Sigma_nm", sigma_nm);
    set_number(out[0], 0, "Images", (double)report.images);
    set_number(out[0], 0, "Used", (double)report.used);
    set_number(out[0], 0, "Clipped", (double)report.clipped);
    set_number(out[0], 0, "PhasingRms_nm", report.phasing_rms_nm);
    set_number(out[0], 0, "PhasingSigma_nm", report.phasing_sigma_nm);
    set_number(out[0], 0, "NcpaRms_nm", report.ncpa_rms_nm);
    set_number(out[0], 0, "NcpaSigma_nm", report.ncpa_sigma_nm);
    set_number(out[0], 0, "ReducedChi2", report.reduced_chi2);
}

/* modes x modes, nm^2. */
static void do_covariance(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *sequence = handle_of(in[0], SEQUENCE);

    out[0] = mxCreateDoubleMatrix(sequence->modes, sequence->modes, mxREAL);
    /* Symmetric: rows are columns. */
    check(cophase_sequence_covariance_nm2(sequence_of(sequence), (double *)mxGetData(out[0]), sequence->modes));
}

/* (sequence, phasing_nm, ncpa_nm): further images that the error bars ask for. */
static void do_images_needed(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *sequence = handle_of(in[0], SEQUENCE);
    uint64_t images;

    check(cophase_sequence_images_needed(sequence_of(sequence), number(in[1], "phasing_nm"), number(in[2], "ncpa_nm"),
                                         &images));
    out[0] = mxCreateDoubleScalar(images == UINT64_MAX ? mxGetInf() : (double)images);
}

const command SEQUENCE_COMMANDS[] = {
    {"sequence.create", 2, 2, do_create},
    {"sequence.delete", 1, 1, do_delete},
    {"sequence.push", 2, 2, do_push},
    {"sequence.clear", 1, 1, do_clear},
    {"sequence.estimate", 1, 1, do_estimate},
    {"sequence.covariance", 1, 1, do_covariance},
    {"sequence.images_needed", 3, 3, do_images_needed},
    {NULL, 0, 0, NULL},
};
