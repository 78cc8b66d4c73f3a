/* What no caller should do, and what must then be a sentence and not a crash; see tests/c_api/main.rs:
 *
 *   misuse SCENE.toml
 */
#include "setting.h"

#define NULL_IS_REFUSED(name, call) REFUSED(COPHASE_BAD_ARGUMENT, name, call)

/* NULL for every pointer that has no meaning as NULL, in the calls without a handle and on models. */
static void null_models(const struct setting *s, const char *scene)
{
    float pixel = 0.0f;
    const cophase_array_f32 out = output(&pixel, 1, 1, 1);
    cophase_model_arrays arrays;
    cophase_device *device = NULL;
    cophase_model *model = NULL;
    const char *name = NULL;
    char text[16];
    size_t size = 7, other = 7;

    NULL_IS_REFUSED("text", cophase_device_list(NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_device_list(text, sizeof text, NULL));
    NULL_IS_REFUSED("name", cophase_device_open(NULL, &device));
    NULL_IS_REFUSED("device", cophase_device_open("cpu", NULL));
    NULL_IS_REFUSED("device", cophase_device_name(NULL, text, sizeof text, &size));
    CHECK(cophase_device_open("cpu", &device) == COPHASE_OK);
    NULL_IS_REFUSED("text", cophase_device_name(device, NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_device_name(device, text, sizeof text, NULL));
    cophase_device_close(device);

    NULL_IS_REFUSED("scene_text", cophase_model_create(NULL, NULL, &model));
    NULL_IS_REFUSED("model", cophase_model_create(scene, NULL, NULL));
    NULL_IS_REFUSED("arrays", cophase_model_arrays_init(NULL, sizeof arrays));
    CHECK(cophase_model_arrays_init(&arrays, sizeof arrays) == COPHASE_OK);
    NULL_IS_REFUSED("pupil", cophase_model_create_from_arrays(scene, NULL, &arrays, &model));
    NULL_IS_REFUSED("scene_text", cophase_model_create_from_arrays(NULL, NULL, &arrays, &model));
    NULL_IS_REFUSED("arrays", cophase_model_create_from_arrays(scene, NULL, NULL, &model));
    NULL_IS_REFUSED("model", cophase_model_create_from_arrays(scene, NULL, &arrays, NULL));

    NULL_IS_REFUSED("model", cophase_model_mode_count(NULL, &size));
    NULL_IS_REFUSED("modes", cophase_model_mode_count(s->model, NULL));
    NULL_IS_REFUSED("model", cophase_model_segment_mode_count(NULL, &size));
    NULL_IS_REFUSED("modes", cophase_model_segment_mode_count(s->model, NULL));
    NULL_IS_REFUSED("model", cophase_model_mode_name(NULL, 0, &name));
    NULL_IS_REFUSED("name", cophase_model_mode_name(s->model, 0, NULL));
    NULL_IS_REFUSED("model", cophase_model_frame_shape(NULL, &size, &other));
    NULL_IS_REFUSED("rows", cophase_model_frame_shape(s->model, NULL, &other));
    NULL_IS_REFUSED("cols", cophase_model_frame_shape(s->model, &size, NULL));
    NULL_IS_REFUSED("model", cophase_model_samples(NULL, &size));
    NULL_IS_REFUSED("samples", cophase_model_samples(s->model, NULL));
    NULL_IS_REFUSED("model", cophase_model_pixels(NULL, &size));
    NULL_IS_REFUSED("pixels", cophase_model_pixels(s->model, NULL));
    NULL_IS_REFUSED("model", cophase_model_wavefront_nm(NULL, s->truth_nm, s->modes, &out));
    NULL_IS_REFUSED("coefficients_nm", cophase_model_wavefront_nm(s->model, NULL, s->modes, &out));
    NULL_IS_REFUSED("out", cophase_model_wavefront_nm(s->model, s->truth_nm, s->modes, NULL));
    NULL_IS_REFUSED("model", cophase_model_psf(NULL, s->truth_nm, s->modes, &out));
    NULL_IS_REFUSED("coefficients_nm", cophase_model_psf(s->model, NULL, s->modes, &out));
    NULL_IS_REFUSED("out", cophase_model_psf(s->model, s->truth_nm, s->modes, NULL));
    CHECK(size == 7 && other == 7 && name == NULL && model == NULL && pixel == 0.0f);
}

static void null_sessions(const struct setting *s)
{
    const cophase_input frame = frames_of(s, 1);
    double *values = doubles(s->modes * s->modes), objective = UNTOUCHED;
    cophase_session_options options;
    cophase_calibration calibration;
    cophase_fit_options fit;
    cophase_session *session = NULL;
    char text[16];
    size_t size = 7;

    NULL_IS_REFUSED("options", cophase_session_options_init(NULL, sizeof options));
    NULL_IS_REFUSED("calibration", cophase_calibration_init(NULL, sizeof calibration));
    NULL_IS_REFUSED("options", cophase_fit_options_init(NULL, sizeof fit));
    NULL_IS_REFUSED("model", cophase_session_create(NULL, NULL, NULL, &session));
    NULL_IS_REFUSED("session", cophase_session_create(NULL, s->model, NULL, NULL));
    NULL_IS_REFUSED("session", cophase_session_cancel(NULL));
    CHECK(cophase_calibration_init(&calibration, sizeof calibration) == COPHASE_OK);
    NULL_IS_REFUSED("session", cophase_session_calibrate(NULL, &calibration));
    NULL_IS_REFUSED("session", cophase_session_fit(NULL, &frame, NULL, values, s->modes, NULL, 0));
    NULL_IS_REFUSED("frames", cophase_session_fit(s->session, NULL, NULL, values, s->modes, NULL, 0));
    NULL_IS_REFUSED("coefficients_nm", cophase_session_fit(s->session, &frame, NULL, NULL, s->modes, NULL, 0));
    NULL_IS_REFUSED("session", cophase_session_load(NULL, &frame, NULL));
    NULL_IS_REFUSED("frames", cophase_session_load(s->session, NULL, NULL));
    CHECK(cophase_session_load(s->session, &frame, NULL) == COPHASE_OK);
    NULL_IS_REFUSED("session", cophase_session_evaluate(NULL, s->truth_nm, 1, s->modes, &objective, values));
    NULL_IS_REFUSED("coefficients_nm", cophase_session_evaluate(s->session, NULL, 1, s->modes, &objective, values));
    NULL_IS_REFUSED("objectives", cophase_session_evaluate(s->session, s->truth_nm, 1, s->modes, NULL, values));
    NULL_IS_REFUSED("gradients", cophase_session_evaluate(s->session, s->truth_nm, 1, s->modes, &objective, NULL));
    CHECK(untouched(values, s->modes * s->modes) == s->modes * s->modes && objective == UNTOUCHED);
    CHECK(cophase_session_fit(s->session, &frame, NULL, s->fitted_nm, s->modes, NULL, 0) == COPHASE_OK);
    NULL_IS_REFUSED("session", cophase_session_image_message(NULL, 0, text, sizeof text, &size));
    NULL_IS_REFUSED("text", cophase_session_image_message(s->session, 0, NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_session_image_message(s->session, 0, text, sizeof text, NULL));
    NULL_IS_REFUSED("session", cophase_session_device_failure(NULL, text, sizeof text, &size));
    NULL_IS_REFUSED("text", cophase_session_device_failure(s->session, NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_session_device_failure(s->session, text, sizeof text, NULL));
    NULL_IS_REFUSED("session", cophase_session_covariance_nm2(NULL, 0, values, s->modes));
    NULL_IS_REFUSED("covariance_nm2", cophase_session_covariance_nm2(s->session, 0, NULL, s->modes));
    CHECK(session == NULL && size == 7);
    free(values);
}

static void null_sequences(const struct setting *s)
{
    cophase_sequence *sequence = NULL;
    cophase_sequence_report report;
    double *values = doubles(s->modes * s->modes);
    uint64_t needed = 7;

    NULL_IS_REFUSED("model", cophase_sequence_create(NULL, 1, &sequence));
    NULL_IS_REFUSED("sequence", cophase_sequence_create(s->model, 1, NULL));
    NULL_IS_REFUSED("sequence", cophase_sequence_push(NULL, s->session));
    NULL_IS_REFUSED("sequence", cophase_sequence_clear(NULL));
    NULL_IS_REFUSED("sequence", cophase_sequence_estimate(NULL, values, NULL, s->modes, &report, sizeof report));
    NULL_IS_REFUSED("sequence", cophase_sequence_covariance_nm2(NULL, values, s->modes));
    NULL_IS_REFUSED("sequence", cophase_sequence_images_needed(NULL, 1.0, 1.0, &needed));
    CHECK(cophase_sequence_create(s->model, 1, &sequence) == COPHASE_OK);
    NULL_IS_REFUSED("session", cophase_sequence_push(sequence, NULL));
    CHECK(cophase_sequence_push(sequence, s->session) == COPHASE_OK);
    NULL_IS_REFUSED("coefficients_nm", cophase_sequence_estimate(sequence, NULL, NULL, s->modes, &report, sizeof report));
    NULL_IS_REFUSED("covariance_nm2", cophase_sequence_covariance_nm2(sequence, NULL, s->modes));
    NULL_IS_REFUSED("images", cophase_sequence_images_needed(sequence, 1.0, 1.0, NULL));
    CHECK(untouched(values, s->modes * s->modes) == s->modes * s->modes && needed == 7);
    cophase_sequence_destroy(sequence);
    free(values);
}

/* Sizes of structs that no version has: none, less than the size itself, more than memory. */
static void struct_sizes(const struct setting *s, const char *scene)
{
    static const size_t sizes[] = {0, 1, 7, (size_t)-1};
    const cophase_input frame = frames_of(s, 1);
    cophase_session_options options;
    cophase_calibration calibration;
    cophase_model_arrays arrays;
    cophase_fit_options fit;
    cophase_session *session = NULL;
    cophase_model *model = NULL;
    cophase_report report;
    double *values = doubles(s->modes);
    size_t i;

    CHECK(cophase_session_options_init(&options, sizeof options) == COPHASE_OK);
    CHECK(cophase_calibration_init(&calibration, sizeof calibration) == COPHASE_OK);
    CHECK(cophase_model_arrays_init(&arrays, sizeof arrays) == COPHASE_OK);
    CHECK(cophase_fit_options_init(&fit, sizeof fit) == COPHASE_OK);
    memset(&report, 0x55, sizeof report);
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        const size_t size = sizes[i];

        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_options_init(&options, size));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_calibration_init(&calibration, size));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_model_arrays_init(&arrays, size));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_fit_options_init(&fit, size));
        options.struct_size = calibration.struct_size = arrays.struct_size = fit.struct_size = size;
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_create(NULL, s->model, &options, &session));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_calibrate(s->session, &calibration));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_model_create_from_arrays(scene, NULL, &arrays, &model));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_fit(s->session, &frame, &fit, values, s->modes, NULL, 0));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_load(s->session, &frame, &fit));
        REFUSED(COPHASE_BAD_ARGUMENT, "report_size",
                cophase_session_fit(s->session, &frame, NULL, values, s->modes, &report, size));
    }
    CHECK(session == NULL && model == NULL && untouched(values, s->modes) == s->modes);
    CHECK(report.evaluations == 0x5555555555555555u);
    free(values);
}

/* Values of options outside what is accepted. */
static void options(const struct setting *s)
{
    cophase_session *session = NULL;
    cophase_session_options good, bad;

    CHECK(cophase_session_options_init(&good, sizeof good) == COPHASE_OK);
    bad = good, bad.capacity = 0;
    REFUSED(COPHASE_BAD_VALUE, "0 images", cophase_session_create(NULL, s->model, &bad, &session));
    bad = good, bad.capacity = (size_t)-1;
    REFUSED(COPHASE_BAD_VALUE, "memory", cophase_session_create(NULL, s->model, &bad, &session));
    bad.capacity = (size_t)1 << 40;
    REFUSED(COPHASE_BAD_VALUE, "memory", cophase_session_create(NULL, s->model, &bad, &session));
    bad = good, bad.precision = COPHASE_U16;
    REFUSED(COPHASE_BAD_VALUE, "precision", cophase_session_create(NULL, s->model, &bad, &session));
    bad = good, bad.threads = -1;
    REFUSED(COPHASE_BAD_VALUE, "-1", cophase_session_create(NULL, s->model, &bad, &session));
    bad = good, bad.step_tolerance_nm = -1.0;
    REFUSED(COPHASE_BAD_VALUE, "-1", cophase_session_create(NULL, s->model, &bad, &session));
    bad = good, bad.step_tolerance_nm = NAN;
    REFUSED(COPHASE_BAD_VALUE, "NaN", cophase_session_create(NULL, s->model, &bad, &session));
    CHECK(session == NULL);
}

/* Frames that are not there, not so many, not of this shape, or not where memory is. */
static void frames(const struct setting *s)
{
    const cophase_input good = frames_of(s, 1);
    double *values = doubles(2 * COUNT * s->modes);
    cophase_input bad;

#define FRAMES_REFUSED(status, part)                                                                          \
    REFUSED(status, part, cophase_session_fit(s->session, &bad, NULL, values, s->modes, NULL, 0));            \
    REFUSED(status, part, cophase_session_load(s->session, &bad, NULL))

    bad = good, bad.data = NULL;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "frames");
    bad = good, bad.data = (const char *)good.data + 1;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "frames");
    bad = good, bad.element = -1;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "-1");
    bad = good, bad.count = 0;
    FRAMES_REFUSED(COPHASE_BAD_SHAPE, "frames");
    bad = good, bad.count = COUNT + 1, bad.count_stride = 0;
    FRAMES_REFUSED(COPHASE_BAD_SHAPE, "4");
    bad = good, bad.count = (size_t)-1, bad.count_stride = 0;
    FRAMES_REFUSED(COPHASE_BAD_SHAPE, "frames");
    bad = good, bad.rows = 0;
    FRAMES_REFUSED(COPHASE_BAD_SHAPE, "frames");
    bad = good, bad.rows = (size_t)-1, bad.cols = (size_t)-1, bad.count = (size_t)-1;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "address space");
    bad = good, bad.cols = s->cols + 1;
    FRAMES_REFUSED(COPHASE_BAD_SHAPE, "frames");
    bad = good, bad.row_stride = PTRDIFF_MAX;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "address space");
    bad = good, bad.row_stride = PTRDIFF_MIN;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "address space");
    bad = good, bad.count = 2, bad.count_stride = PTRDIFF_MAX / 2;
    FRAMES_REFUSED(COPHASE_BAD_ARGUMENT, "address space");

    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_session_fit(s->session, &good, NULL, values, 0, NULL, 0));
    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_session_fit(s->session, &good, NULL, values, (size_t)-1, NULL, 0));
    REFUSED(COPHASE_BAD_ARGUMENT, "coefficients_nm",
            cophase_session_fit(s->session, &good, NULL, (double *)(void *)((char *)values + 4), s->modes, NULL, 0));
    CHECK(untouched(values, 2 * COUNT * s->modes) == 2 * COUNT * s->modes);
    free(values);
}

int main(int argc, char **argv)
{
    struct setting s;
    size_t size;
    char *scene;

    if (argc != 2)
        return 2;
    scene = read_file(argv[1], &size);
    s = setting_of(scene);
    null_models(&s, scene);
    null_sessions(&s);
    null_sequences(&s);
    struct_sizes(&s, scene);
    options(&s);
    frames(&s);
    free(scene);
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
