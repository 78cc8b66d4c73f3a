/* Fitting through the public header alone; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   session SCENE.toml DUMP
 *
 * DUMP receives frames and what was made of them, for the comparison with Rust: COUNT frames; their coefficients; the
 * covariance of the first; objectives and gradients at the true coefficients, and those. */
#include "setting.h"

static void before_a_fit(const struct setting *s)
{
    double *values = doubles(s->modes * s->modes + 1);
    char text[64];
    size_t length = 7;

    REFUSED(COPHASE_BAD_VALUE, "fit", cophase_session_refine(s->session, 0, NULL, values, s->modes, NULL, 0));
    REFUSED(COPHASE_BAD_VALUE, "fit", cophase_session_text(s->session, COPHASE_TEXT_IMAGE_MESSAGE, 0, text, sizeof text, &length));
    REFUSED(COPHASE_BAD_VALUE, "load", cophase_session_evaluate(s->session, 0, NULL, NULL, s->truth_nm, 1, s->modes, values, values + 1));
    CHECK(untouched(values, s->modes * s->modes + 1) == s->modes * s->modes + 1 && length == 7);
    free(values);
}

/* The truth comes back, within its error bars. */
static void the_fit(struct setting *s, FILE *file)
{
    const cophase_input frames = frames_of(s, COUNT);
    double *covariance_nm2 = doubles(s->modes * s->modes);
    cophase_image_report reports[COUNT];
    cophase_model_info info;
    size_t k, i, side, missing;

    /* What is compared is a square as long as the frame's longer side; what the detector lacks of it takes no part. */
    CHECK(cophase_model_get_info(s->model, &info, sizeof info) == COPHASE_OK);
    side = info.pixels;
    CHECK(side >= s->rows && side >= s->cols);
    missing = side * side - s->rows * s->cols;
    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, reports, sizeof *reports, NULL, 0) == COPHASE_OK);
    for (k = 0; k < COUNT; k++) {
        const double *fitted_nm = s->fitted_nm + k * s->modes, *truth_nm = s->truth_nm + k * s->modes;
        double piston_nm = 0.0;

        CHECK(reports[k].status == COPHASE_IMAGE_OK && reports[k].evaluations > 1);
        CHECK((size_t)reports[k].bad_pixels == missing);
        /* Its scatter is sqrt(2 / 2304) = 0.03. */
        CHECK(reports[k].reduced_chi2 > 0.85 && reports[k].reduced_chi2 < 1.15);
        CHECK(fabs(reports[k].flux_e / FLUX_E - 1.0) < 0.01 && fabs(reports[k].background_e - BACKGROUND_E) < 3.0);
        CHECK(reports[k].seconds > 0.0);
        CHECK(cophase_session_refine(s->session, k, NULL, covariance_nm2, s->modes, NULL, 0) == COPHASE_OK);
        /* Nothing sees the piston of all segments together. */
        for (i = 0; i < s->segment_modes; i++)
            piston_nm += (fitted_nm[i] - truth_nm[i]) / (double)s->segment_modes;
        for (i = 0; i < s->modes; i++) {
            const double error_nm = fitted_nm[i] - truth_nm[i] - (i < s->segment_modes ? piston_nm : 0.0);

            /* Six sigma: not one in 10 million of the 45 errors is larger. */
            CHECK(error_nm * error_nm < 36.0 * covariance_nm2[i * s->modes + i]);
        }
    }
    REFUSED(COPHASE_BAD_VALUE, "3", cophase_session_refine(s->session, COUNT, NULL, covariance_nm2, s->modes, NULL, 0));
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_session_refine(s->session, 0, NULL, covariance_nm2, s->modes + 1, NULL, 0));
    CHECK(cophase_session_refine(s->session, 0, NULL, covariance_nm2, s->modes, NULL, 0) == COPHASE_OK);
    for (i = 0; i < COUNT * s->pixels; i++) {
        const double value = (double)s->frames[i];

        dump(file, &value, 1);
    }
    dump(file, s->fitted_nm, COUNT * s->modes);
    dump(file, covariance_nm2, s->modes * s->modes);
    free(covariance_nm2);
}

/* The same frames, wherever their elements lie and however they come. */
static void layouts(const struct setting *s)
{
    float *other = floats(4 * COUNT * s->pixels);
    cophase_session *one = session_for(s->model, 1);
    cophase_input frames = frames_of(s, COUNT);
    size_t i;

    CHECK(same_fit(s, s->session, &frames));
    /* Columns, the images next to one another. */
    frames.data = other;
    frames.count_stride = 1, frames.row_stride = COUNT, frames.col_stride = (ptrdiff_t)(COUNT * s->rows);
    for (i = 0; i < COUNT * s->pixels; i++)
        other[i / s->pixels + COUNT * (i % s->pixels / s->cols) + COUNT * s->rows * (i % s->cols)] = s->frames[i];
    CHECK(same_fit(s, s->session, &frames));
    /* Backwards, in every fourth element. */
    frames = frames_of(s, COUNT);
    frames.data = other + 4 * (COUNT * s->pixels - 1);
    frames.count_stride *= -4, frames.row_stride *= -4, frames.col_stride = -4;
    for (i = 0; i < COUNT * s->pixels; i++)
        other[4 * (COUNT * s->pixels - 1 - i)] = s->frames[i];
    CHECK(same_fit(s, s->session, &frames));
    /* One at a time; a stride of 0 repeats an image. */
    frames = frames_of(s, 1);
    frames.count_stride = PTRDIFF_MIN; /* that of an extent of 1 does not matter */
    CHECK(same_fit(s, one, &frames));
    frames = frames_of(s, COUNT);
    frames.count_stride = 0;
    CHECK(!same_fit(s, s->session, &frames));
    cophase_session_destroy(one);
    free(other);
}

/* Whole electrons, as five types of elements hold them: one estimate. */
static void elements(const struct setting *s)
{
    enum { TYPES = 4 };
    static const int32_t types[TYPES] = {COPHASE_F32, COPHASE_F64, COPHASE_U16, COPHASE_I32};
    float *f32 = floats(s->pixels);
    double *f64 = doubles(s->pixels), *found_nm = doubles(5 * s->modes);
    uint16_t *u16 = (uint16_t *)memory(s->pixels, sizeof *u16);
    int32_t *i32 = (int32_t *)memory(s->pixels, sizeof *i32);
    uint8_t *u8 = (uint8_t *)memory(s->pixels, sizeof *u8);
    const void *data[TYPES];
    cophase_input frame;
    cophase_image_report report;
    size_t i;

    data[0] = f32, data[1] = f64, data[2] = u16, data[3] = i32;
    for (i = 0; i < s->pixels; i++) {
        const float value = s->frames[i] > 0.0f ? s->frames[i] : 0.0f;

        u16[i] = (uint16_t)value;
        CHECK(value < 65535.0f);
        f32[i] = (float)u16[i], f64[i] = (double)u16[i], i32[i] = u16[i], u8[i] = (uint8_t)(u16[i] / 256);
    }
    for (i = 0; i < TYPES; i++) {
        frame = input(data[i], types[i], 1, s->rows, s->cols);
        CHECK(cophase_session_fit(s->session, &frame, 1, NULL, found_nm + i * s->modes, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
        CHECK(memcmp(found_nm, found_nm + i * s->modes, s->modes * sizeof *found_nm) == 0);
    }
    frame = input(u8, COPHASE_U8, 1, s->rows, s->cols);
    CHECK(cophase_session_fit(s->session, &frame, 1, NULL, found_nm, NULL, s->modes, &report, sizeof report, NULL, 0) == COPHASE_OK);
    frame.element = 0;
    REFUSED(COPHASE_BAD_ARGUMENT, "element", cophase_session_fit(s->session, &frame, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    frame.element = 6;
    REFUSED(COPHASE_BAD_ARGUMENT, "6", cophase_session_fit(s->session, &frame, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    free(u8), free(i32), free(u16), free(found_nm), free(f64), free(f32);
}

/* Objective and gradient for an optimizer of the caller's. */
static void evaluations(const struct setting *s, FILE *file)
{
    const double step_nm = 0.01;
    const cophase_input frames = frames_of(s, COUNT);
    double objectives[COUNT], above[1], below[1];
    double *gradients = doubles(COUNT * s->modes), *point_nm = doubles(s->modes);
    size_t i;

    CHECK(cophase_session_evaluate(s->session, 0, &frames, NULL, s->truth_nm, COUNT, s->modes, objectives, gradients) ==
          COPHASE_OK);
    dump(file, s->truth_nm, COUNT * s->modes);
    dump(file, objectives, COUNT);
    dump(file, gradients, COUNT * s->modes);
    for (i = 0; i < s->modes; i++) {
        double difference;

        memcpy(point_nm, s->truth_nm, s->modes * sizeof *point_nm);
        point_nm[i] += step_nm;
        CHECK(cophase_session_evaluate(s->session, 0, NULL, NULL, point_nm, 1, s->modes, above, gradients + s->modes) == COPHASE_OK);
        point_nm[i] -= 2.0 * step_nm;
        CHECK(cophase_session_evaluate(s->session, 0, NULL, NULL, point_nm, 1, s->modes, below, gradients + s->modes) == COPHASE_OK);
        difference = (above[0] - below[0]) / (2.0 * step_nm);
        /* The objective is some 2000 and rounds at 1e-16 of it: 2e-11 per nm after the division. The third derivative
         * is the curvature (1 over the error bar of about 0.5 nm, squared) over a radian of 345 nm: 0.01 per nm^3,
         * times step^2 / 6 is 2e-7. */
        CHECK(fabs(difference - gradients[i]) < 1e-5 * (1.0 + fabs(gradients[i])));
    }
    objectives[0] = UNTOUCHED;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_session_evaluate(s->session, 0, NULL, NULL, s->truth_nm, COUNT + 1, s->modes, objectives, gradients));
    REFUSED(COPHASE_BAD_SHAPE, "",
            cophase_session_evaluate(s->session, 0, NULL, NULL, s->truth_nm, 1, s->modes - 1, objectives, gradients));
    REFUSED(COPHASE_BAD_SHAPE, "frames is 3 x",
            cophase_session_evaluate(s->session, 0, &frames, NULL, s->truth_nm, 1, s->modes, objectives, gradients));
    CHECK(cophase_session_evaluate(s->session, 0, NULL, NULL, s->truth_nm, (size_t)-1, s->modes, objectives, gradients) !=
          COPHASE_OK);
    CHECK(objectives[0] == UNTOUCHED);
    free(point_nm);
    free(gradients);
}

/* A start of the caller's, other settings, f32: the same minimum by another way. */
static void other_ways(const struct setting *s)
{
    const cophase_input frames = frames_of(s, 1);
    double *found_nm = doubles(s->modes), *start_nm = doubles(s->modes);
    cophase_session *session = NULL;
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_fit_options fit = DEFAULTS(cophase_fit_options);
    cophase_image_report cold, warm;
    size_t i;

    CHECK(cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, &cold, sizeof cold, NULL, 0) == COPHASE_OK);
    CHECK(memcmp(found_nm, s->fitted_nm, s->modes * sizeof *found_nm) == 0);
    memcpy(start_nm, found_nm, s->modes * sizeof *start_nm);
    fit.start_nm = start_nm;
    CHECK(cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, &warm, sizeof warm, NULL, 0) == COPHASE_OK);
    CHECK(warm.evaluations < cold.evaluations && warm.status == COPHASE_IMAGE_OK);
    start_nm[0] = INFINITY;
    REFUSED(COPHASE_BAD_VALUE, "start", cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    fit.start_nm = NULL;
    fit.read_noise_e = -1.0;
    REFUSED(COPHASE_BAD_VALUE, "-1", cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    /* Noise that is said to be larger makes the residual small. */
    fit.read_noise_e = 1000.0;
    CHECK(cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, &warm, sizeof warm, NULL, 0) == COPHASE_OK);
    CHECK(warm.reduced_chi2 < 0.1 && warm.status == COPHASE_IMAGE_MISFIT);
    /* 0 is the scene's read noise, unless the caller says that it is none. */
    fit.read_noise_e = 0.0;
    CHECK(cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, &warm, sizeof warm, NULL, 0) == COPHASE_OK);
    CHECK(warm.status == COPHASE_IMAGE_OK);
    fit.has_read_noise = 1;
    CHECK(cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, &warm, sizeof warm, NULL, 0) == COPHASE_OK);
    CHECK(warm.reduced_chi2 > 1.1 && warm.status == COPHASE_IMAGE_MISFIT);
    fit.has_read_noise = 2;
    REFUSED(COPHASE_BAD_VALUE, "has_read_noise is 2",
            cophase_session_fit(s->session, &frames, 1, &fit, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    fit.has_read_noise = 0;

    options.precision = COPHASE_F32, options.threads = -1, options.device = "cpu";
    CHECK(cophase_session_create(s->model, &options, &session) == COPHASE_OK);
    CHECK(cophase_session_fit(session, &frames, 1, NULL, found_nm, NULL, s->modes, &warm, sizeof warm, NULL, 0) == COPHASE_OK);
    for (i = 0; i < s->modes; i++)
        CHECK(fabs(found_nm[i] - s->fitted_nm[i]) < 0.05); /* a tenth of an error bar */
    cophase_session_destroy(session);
    free(start_nm);
    free(found_nm);
}

int main(int argc, char **argv)
{
    struct setting s;
    size_t size;
    char *scene;
    FILE *file;

    if (argc != 3 || (file = fopen(argv[2], "wb")) == NULL)
        return 2;
    scene = read_file(argv[1], &size);
    s = setting_of(scene);
    free(scene);
    before_a_fit(&s);
    the_fit(&s, file);
    layouts(&s);
    elements(&s);
    other_ways(&s);
    evaluations(&s, file);
    done_with(&s);
    cophase_session_destroy(NULL);
    return fclose(file) == 0 && failures == 0 ? 0 : 1;
}
