/* cophase.Sequence. */
#include "gateway.h"

static cophase_sequence *sequence_of(const live *sequence) { return (cophase_sequence *)sequence->object; }

/* (model, capacity): a new sequence. */
static void do_create(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *model = handle_of(in[0], MODEL);
    cophase_sequence *sequence;

    check(cophase_sequence_create((const cophase_model *)model->object, whole(in[1], 1, "capacity"), &sequence));
    out[0] = handle_new(SEQUENCE, sequence, model->modes);
}

/* (sequence, session): all images of its last fit. */
static void do_push(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    cophase_sequence *sequence = sequence_of(handle_of(in[0], SEQUENCE));

    check(cophase_sequence_push(sequence, (const cophase_session *)handle_of(in[1], SESSION)->object));
}

/* (sequence) */
static void do_clear(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    check(cophase_sequence_push(sequence_of(handle_of(in[0], SEQUENCE)), NULL));
}

#define T cophase_sequence_report
static const field REPORT[] = {
    FIELD(T, images, IS_SIZE), FIELD(T, used, IS_SIZE), FIELD(T, clipped, IS_SIZE),
    FIELD(T, phasing_rms_nm, IS_DOUBLE), FIELD(T, phasing_sigma_nm, IS_DOUBLE), FIELD(T, ncpa_rms_nm, IS_DOUBLE),
    FIELD(T, ncpa_sigma_nm, IS_DOUBLE), FIELD(T, reduced_chi2, IS_DOUBLE), END_OF_FIELDS,
};
#undef T

static void set(mxArray *record, const char *name, mxArray *value)
{
    mxAddField(record, name);
    mxSetField(record, 0, name, value);
}

/* (sequence): a struct. */
static void do_estimate(int outputs, mxArray **out, int inputs, const mxArray **in)
{
    const live *sequence = handle_of(in[0], SEQUENCE);
    const size_t modes = sequence->modes;
    mxArray *coefficients_nm = column(modes), *sigma_nm = column(modes);
    mxArray *covariance_nm2 = mxCreateDoubleMatrix(modes, modes, mxREAL);
    cophase_sequence_report report = {0};

    /* The covariance is symmetric: rows are columns. */
    check(cophase_sequence_estimate(sequence_of(sequence), mxGetPr(coefficients_nm), mxGetPr(sigma_nm),
                                    mxGetPr(covariance_nm2), modes, &report, sizeof report));
    out[0] = mxCreateStructMatrix(1, 1, 0, NULL);
    set(out[0], "coefficients_nm", coefficients_nm);
    set(out[0], "sigma_nm", sigma_nm);
    set(out[0], "covariance_nm2", covariance_nm2);
    set(out[0], "info", structs(REPORT, &report, sizeof report, 1));
}

/* (sequence, phasing_nm, ncpa_nm): number of further images. */
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
    {"sequence.push", 2, 2, do_push},
    {"sequence.clear", 1, 1, do_clear},
    {"sequence.estimate", 1, 1, do_estimate},
    {"sequence.images_needed", 3, 3, do_images_needed},
    {NULL, 0, 0, NULL},
};
