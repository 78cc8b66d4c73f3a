/* What no caller should do, and what must then be a sentence and not a crash; see tests/c_api/main.rs:
 *
 *   misuse SCENE.toml
 */
#include "setting.h"

#define NULL_IS_REFUSED(name, call) REFUSED(COPHASE_BAD_ARGUMENT, name, call)

/* NULL for every pointer that has no meaning as NULL, in the calls without a handle and on models. */
static void null_models(const struct setting *s, const char *scene)
{
    const cophase_model_arrays arrays = DEFAULTS(cophase_model_arrays);
    double pixel = UNTOUCHED;
    cophase_model_info info;
    cophase_model *model = NULL;
    const char *name = NULL;
    char text[16];
    size_t size = 7;

    NULL_IS_REFUSED("text", cophase_device_list(NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_device_list(text, sizeof text, NULL));
    NULL_IS_REFUSED("name", cophase_scene_preset(NULL, &name));
    NULL_IS_REFUSED("scene_text", cophase_scene_preset("keck-onsky", NULL));
    REFUSED(COPHASE_BAD_SCENE, "keck-onsky", cophase_scene_preset("keck-onsy", &name));

    NULL_IS_REFUSED("scene_text", cophase_scene_set(NULL, "image.pixels", "32", text, sizeof text, &size));
    NULL_IS_REFUSED("key", cophase_scene_set(scene, NULL, "32", text, sizeof text, &size));
    NULL_IS_REFUSED("value", cophase_scene_set(scene, "image.pixels", NULL, text, sizeof text, &size));
    NULL_IS_REFUSED("text", cophase_scene_set(scene, "image.pixels", "32", NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_scene_set(scene, "image.pixels", "32", text, sizeof text, NULL));

    NULL_IS_REFUSED("scene_text", cophase_model_create(NULL, NULL, NULL, &model));
    NULL_IS_REFUSED("model", cophase_model_create(scene, NULL, NULL, NULL));
    NULL_IS_REFUSED("pupil", cophase_model_create(scene, NULL, &arrays, &model));
    NULL_IS_REFUSED("scene_text", cophase_model_create(NULL, NULL, &arrays, &model));
    NULL_IS_REFUSED("model", cophase_model_create(scene, NULL, &arrays, NULL));

    NULL_IS_REFUSED("model", cophase_model_get_info(NULL, &info, sizeof info));
    NULL_IS_REFUSED("info", cophase_model_get_info(s->model, NULL, sizeof info));
    NULL_IS_REFUSED("model", cophase_model_channel(NULL, 0, &name, &model));
    REFUSED(COPHASE_BAD_VALUE, "channel 1 does not exist", cophase_model_channel(s->model, 1, &name, &model));
    CHECK(cophase_model_channel(s->model, 0, NULL, NULL) == COPHASE_OK);
    NULL_IS_REFUSED("model", cophase_model_mode_name(NULL, 0, &name));
    NULL_IS_REFUSED("name", cophase_model_mode_name(s->model, 0, NULL));
    NULL_IS_REFUSED("model", cophase_model_wavefront_nm(NULL, s->truth_nm, s->modes, &pixel, 1));
    NULL_IS_REFUSED("coefficients_nm", cophase_model_wavefront_nm(s->model, NULL, s->modes, &pixel, 1));
    NULL_IS_REFUSED("out", cophase_model_wavefront_nm(s->model, s->truth_nm, s->modes, NULL, 2 * 32 * 32));
    NULL_IS_REFUSED("model", cophase_model_psf(NULL, s->truth_nm, s->modes, &pixel, 1));
    NULL_IS_REFUSED("coefficients_nm", cophase_model_psf(s->model, NULL, s->modes, &pixel, 1));
    NULL_IS_REFUSED("out", cophase_model_psf(s->model, s->truth_nm, s->modes, NULL, 48 * 48));
    CHECK(size == 7 && name == NULL && model == NULL && pixel == UNTOUCHED);
}

static void null_sessions(const struct setting *s)
{
    const cophase_calibration calibration = DEFAULTS(cophase_calibration);
    const cophase_input frame = frames_of(s, 1);
    double *values = doubles(s->modes * s->modes), objective = UNTOUCHED;
    cophase_session *session = NULL;
    char text[16];
    size_t size = 7;

    NULL_IS_REFUSED("model", cophase_session_create(NULL, NULL, &session));
    NULL_IS_REFUSED("session", cophase_session_create(s->model, NULL, NULL));
    NULL_IS_REFUSED("session", cophase_session_cancel(NULL));
    NULL_IS_REFUSED("session", cophase_session_calibrate(NULL, 0, &calibration));
    NULL_IS_REFUSED("session", cophase_session_fit(NULL, &frame, 1, NULL, values, NULL, s->modes, NULL, 0, NULL, 0));
    NULL_IS_REFUSED("frames", cophase_session_fit(s->session, NULL, 1, NULL, values, NULL, s->modes, NULL, 0, NULL, 0));
    NULL_IS_REFUSED("coefficients_nm",
                    cophase_session_fit(s->session, &frame, 1, NULL, NULL, NULL, s->modes, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_SHAPE, "channels is 2: 1",
            cophase_session_fit(s->session, &frame, 2, NULL, values, NULL, s->modes, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_VALUE, "channel 1 does not exist", cophase_session_calibrate(s->session, 1, &calibration));
    REFUSED(COPHASE_BAD_VALUE, "channel 1 does not exist",
            cophase_session_evaluate(s->session, 1, &frame, NULL, s->truth_nm, 1, s->modes, &objective, values));
#define EVALUATE(session, coefficients_nm, objectives, gradients) \
    cophase_session_evaluate(session, 0, &frame, NULL, coefficients_nm, 1, s->modes, objectives, gradients)
    NULL_IS_REFUSED("session", EVALUATE(NULL, s->truth_nm, &objective, values));
    NULL_IS_REFUSED("coefficients_nm", EVALUATE(s->session, NULL, &objective, values));
    NULL_IS_REFUSED("objectives", EVALUATE(s->session, s->truth_nm, NULL, values));
    NULL_IS_REFUSED("gradients", EVALUATE(s->session, s->truth_nm, &objective, NULL));
    CHECK(untouched(values, s->modes * s->modes) == s->modes * s->modes && objective == UNTOUCHED);
    CHECK(cophase_session_fit(s->session, &frame, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    NULL_IS_REFUSED("session", cophase_session_text(NULL, COPHASE_TEXT_POLICY, 0, text, sizeof text, &size));
    NULL_IS_REFUSED("text", cophase_session_text(s->session, COPHASE_TEXT_POLICY, 0, NULL, 1, &size));
    NULL_IS_REFUSED("length", cophase_session_text(s->session, COPHASE_TEXT_POLICY, 0, text, sizeof text, NULL));
    NULL_IS_REFUSED("session", cophase_session_refine(NULL, 0, NULL, values, s->modes, NULL, 0));
    CHECK(cophase_session_refine(s->session, 0, NULL, NULL, s->modes, NULL, 0) == COPHASE_OK); /* nothing is wanted */
    CHECK(session == NULL && size == 7);
    free(values);
}

static void null_sequences(const struct setting *s)
{
    cophase_sequence *sequence = NULL;
    double *values = doubles(s->modes);
    uint64_t needed = 7;

    NULL_IS_REFUSED("model", cophase_sequence_create(NULL, 1, &sequence));
    NULL_IS_REFUSED("sequence", cophase_sequence_create(s->model, 1, NULL));
    NULL_IS_REFUSED("sequence", cophase_sequence_push(NULL, s->session));
    NULL_IS_REFUSED("sequence", cophase_sequence_push(NULL, NULL));
    NULL_IS_REFUSED("sequence", cophase_sequence_estimate(NULL, values, NULL, NULL, s->modes, NULL, 0));
    NULL_IS_REFUSED("sequence", cophase_sequence_images_needed(NULL, 1.0, 1.0, &needed));
    CHECK(cophase_sequence_create(s->model, 1, &sequence) == COPHASE_OK);
    CHECK(cophase_sequence_push(sequence, s->session) == COPHASE_OK);
    NULL_IS_REFUSED("images", cophase_sequence_images_needed(sequence, 1.0, 1.0, NULL));
    CHECK(untouched(values, s->modes) == s->modes && needed == 7);
    cophase_sequence_destroy(sequence);
    free(values);
}

/* A file that the scene names and that does not exist, although nothing reads it. */
static void missing_file(const char *scene)
{
    cophase_estimator *estimator = NULL;
    size_t length = 0;
    char *changed;

    CHECK(cophase_scene_set(scene, "mirror.actuator_file", "none.txt", NULL, 0, &length) == COPHASE_OK);
    changed = (char *)memory(length + 1, 1);
    CHECK(cophase_scene_set(scene, "mirror.actuator_file", "none.txt", changed, length + 1, &length) == COPHASE_OK);
    REFUSED(COPHASE_BAD_FILE, "none.txt", cophase_estimator_create(changed, NULL, NULL, &estimator));
    REFUSED(COPHASE_BAD_FILE, "mirror.actuator_file", cophase_estimator_create(changed, "/nowhere", NULL, &estimator));
    CHECK(estimator == NULL);
    free(changed);
}

/* NULL, and options out of range, where an estimator or its estimate is asked. */
static void estimators(const struct setting *s, const char *scene)
{
    cophase_estimator_options options = DEFAULTS(cophase_estimator_options);
    const cophase_input frame = frames_of(s, 1);
    cophase_estimator *estimator = NULL;
    cophase_estimate *estimate = NULL;
    cophase_estimate_info info;
    cophase_image_report report;
    double number = UNTOUCHED;
    char text[16];
    cophase_channel_images channel;
    size_t size = 7;

    NULL_IS_REFUSED("scene_text", cophase_estimator_create(NULL, NULL, NULL, &estimator));
    NULL_IS_REFUSED("estimator", cophase_estimator_create(scene, NULL, NULL, NULL));
    options.policy = 2;
    REFUSED(COPHASE_BAD_VALUE, "options->policy is 2", cophase_estimator_create(scene, NULL, &options, &estimator));
    options.policy = COPHASE_POLICY_REALTIME, options.threads = -2;
    REFUSED(COPHASE_BAD_VALUE, "options->threads is -2", cophase_estimator_create(scene, NULL, &options, &estimator));
    options.threads = 100000;
    REFUSED(COPHASE_BAD_VALUE, "options->threads is 100000", cophase_estimator_create(scene, NULL, &options, &estimator));
    NULL_IS_REFUSED("estimator", cophase_estimator_cancel(NULL));
    NULL_IS_REFUSED("estimator", cophase_estimator_progress(NULL, NULL, NULL, NULL));
    CHECK(estimator == NULL);
    missing_file(scene);
    CHECK(cophase_estimator_create(scene, NULL, NULL, &estimator) == COPHASE_OK);
    CHECK(cophase_estimator_progress(estimator, NULL, NULL, NULL) == COPHASE_OK);
    memset(&channel, 0, sizeof channel);
    NULL_IS_REFUSED("estimator", cophase_estimator_estimate(NULL, &channel, 1, &estimate));
    NULL_IS_REFUSED("channels", cophase_estimator_estimate(estimator, NULL, 1, &estimate));
    NULL_IS_REFUSED("frames", cophase_estimator_estimate(estimator, &channel, 1, &estimate));
    REFUSED(COPHASE_BAD_SHAPE, "count is 2: 1 is accepted", cophase_estimator_estimate(estimator, &channel, 2, &estimate));
    channel.frames = &frame, channel.channel = "H";
    REFUSED(COPHASE_BAD_SHAPE, "the channel 'H' is not in the scene",
            cophase_estimator_estimate(estimator, &channel, 1, &estimate));
    NULL_IS_REFUSED("estimate", cophase_estimator_estimate(estimator, &channel, 1, NULL));
    cophase_estimator_destroy(estimator);
    cophase_estimator_destroy(NULL);

    NULL_IS_REFUSED("estimate", cophase_estimate_get_info(NULL, &info, sizeof info));
    NULL_IS_REFUSED("estimate", cophase_estimate_images(NULL, &report, sizeof report, 1));
    NULL_IS_REFUSED("estimate", cophase_estimate_array(NULL, COPHASE_ARRAY_SIGMA_NM, &number, 1));
    NULL_IS_REFUSED("estimate", cophase_estimate_text(NULL, COPHASE_TEXT_REPORT, 0, text, sizeof text, &size));
    NULL_IS_REFUSED("estimate", cophase_estimate_write(NULL, "nothing.fits"));
    NULL_IS_REFUSED("estimate", cophase_estimate_correct(NULL, 0.0, NULL, NULL, 0));
    cophase_estimate_destroy(NULL);
    CHECK(estimate == NULL && number == UNTOUCHED && size == 7);
}

/* Sizes of structs that no version has: none, less than the size itself, more than memory. */
static void struct_sizes(const struct setting *s, const char *scene)
{
    static const size_t sizes[] = {0, 1, 7, (size_t)-1};
    const cophase_input frame = frames_of(s, 1);
    cophase_estimator_options estimator_options = DEFAULTS(cophase_estimator_options);
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_calibration calibration = DEFAULTS(cophase_calibration);
    cophase_model_arrays arrays = DEFAULTS(cophase_model_arrays);
    cophase_fit_options fit = DEFAULTS(cophase_fit_options);
    cophase_estimator *estimator = NULL;
    cophase_session *session = NULL;
    cophase_model *model = NULL;
    cophase_image_report report;
    cophase_group_report group;
    cophase_model_info info;
    double *values = doubles(s->modes), objective = UNTOUCHED;
    size_t i;

    memset(&report, 0x55, sizeof report);
    memset(&group, 0x55, sizeof group);
    memset(&info, 0x55, sizeof info);
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        const size_t size = sizes[i];

        options.struct_size = calibration.struct_size = arrays.struct_size = fit.struct_size = size;
        estimator_options.struct_size = size;
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_create(s->model, &options, &session));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_calibrate(s->session, 0, &calibration));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_model_create(scene, NULL, &arrays, &model));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_estimator_create(scene, NULL, &estimator_options, &estimator));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size", cophase_session_fit(s->session, &frame, 1, &fit, values, NULL, s->modes, NULL, 0, NULL, 0));
        REFUSED(COPHASE_BAD_ARGUMENT, "struct_size",
                cophase_session_evaluate(s->session, 0, &frame, &fit, s->truth_nm, 1, s->modes, &objective, values));
        REFUSED(COPHASE_BAD_ARGUMENT, "image_size",
                cophase_session_fit(s->session, &frame, 1, NULL, values, NULL, s->modes, &report, size, NULL, 0));
        REFUSED(COPHASE_BAD_ARGUMENT, "group_size",
                cophase_session_fit(s->session, &frame, 1, NULL, values, NULL, s->modes, NULL, 0, &group, size));
        REFUSED(COPHASE_BAD_ARGUMENT, "info_size", cophase_model_get_info(s->model, &info, size));
    }
    CHECK(session == NULL && model == NULL && estimator == NULL && untouched(values, s->modes) == s->modes);
    CHECK(report.evaluations == 0x5555555555555555u && group.status == 0x55555555 && info.modes == 0x5555555555555555u && objective == UNTOUCHED);
    free(values);
}

/* Values of options outside what is accepted. */
static void options(const struct setting *s)
{
    const cophase_session_options good = DEFAULTS(cophase_session_options);
    cophase_session_options bad;
    cophase_session *session = NULL;

    bad = good, bad.capacity = (size_t)-1;
    REFUSED(COPHASE_BAD_VALUE, "memory", cophase_session_create(s->model, &bad, &session));
    bad.capacity = (size_t)1 << 40;
    REFUSED(COPHASE_BAD_VALUE, "memory", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.precision = COPHASE_U16;
    REFUSED(COPHASE_BAD_VALUE, "precision", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.threads = 2;
    REFUSED(COPHASE_BAD_VALUE, "options->threads is 2", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.step_tolerance_nm = -1.0;
    REFUSED(COPHASE_BAD_VALUE, "-1", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.step_tolerance_nm = NAN;
    REFUSED(COPHASE_BAD_VALUE, "NaN", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.device = "gpu";
    REFUSED(COPHASE_BAD_VALUE, "gpu", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.device = "opencl:99:0";
    REFUSED(COPHASE_DEVICE, "device", cophase_session_create(s->model, &bad, &session));
    bad = good, bad.device = "\xff";
    REFUSED(COPHASE_BAD_ARGUMENT, "options->device", cophase_session_create(s->model, &bad, &session));
    CHECK(session == NULL);
    bad = good, bad.device = "auto";
    CHECK(cophase_session_create(s->model, &bad, &session) == COPHASE_OK);
    cophase_session_destroy(session);
}

/* Frames that are not there, not so many, not of this shape, or not where memory is. */
static void frames(const struct setting *s)
{
    const cophase_input good = frames_of(s, 1);
    double *values = doubles(2 * COUNT * s->modes);
    cophase_input bad;

#define FRAMES_REFUSED(status, part)                                                                          \
    REFUSED(status, part,                                                                                     \
            cophase_session_fit(s->session, &bad, 1, NULL, values, NULL, s->modes, NULL, 0, NULL, 0));        \
    REFUSED(status, part,                                                                                     \
            cophase_session_evaluate(s->session, 0, &bad, NULL, s->truth_nm,                                  \
                                     bad.count == 0 || bad.count > COUNT ? 1 : bad.count, s->modes, values,   \
                                     values + COUNT))

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

    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_session_fit(s->session, &good, 1, NULL, values, NULL, 0, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_session_fit(s->session, &good, 1, NULL, values, NULL, (size_t)-1, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_ARGUMENT, "coefficients_nm",
            cophase_session_fit(s->session, &good, 1, NULL, (double *)(void *)((char *)values + 4), NULL, s->modes, NULL, 0, NULL, 0));
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
    estimators(&s, scene);
    struct_sizes(&s, scene);
    options(&s);
    frames(&s);
    free(scene);
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
