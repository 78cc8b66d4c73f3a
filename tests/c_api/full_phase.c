/* Full-phase estimates through the public header alone; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   full_phase SCENE.toml DUMP
 */
#include "support.h"
#include <math.h>

enum { IMAGES = 4, SETTLED = 300, BETWEEN = 60 };

/* Exposures behind the loop of a scene, and what its sensor measured meanwhile. */
struct sky {
    size_t rows, cols, pixels, slope_count, side;
    float *frames;  /* IMAGES x rows x cols, electrons */
    float *slopes;  /* IMAGES x slope_count, mas */
    float *truth;   /* 2 x side x side, nm */
};

static struct sky sky_of(const char *scene)
{
    cophase_simulator *simulator = NULL;
    cophase_array_f32 out;
    struct sky s;
    size_t k;

    CHECK(cophase_simulator_create(scene, NULL, &simulator) == COPHASE_OK);
    if (simulator == NULL)
        exit(1);
    CHECK(cophase_simulator_image_shape(simulator, &s.rows, &s.cols) == COPHASE_OK);
    CHECK(cophase_simulator_slope_count(simulator, &s.slope_count) == COPHASE_OK);
    CHECK(cophase_simulator_truth_samples(simulator, &s.side) == COPHASE_OK);
    s.pixels = s.rows * s.cols;
    s.frames = floats(IMAGES * s.pixels);
    s.slopes = floats(IMAGES * s.slope_count);
    s.truth = floats(2 * s.side * s.side);
    for (k = 0; k < IMAGES; k++) {
        CHECK(cophase_simulator_step(simulator, k == 0 ? SETTLED : BETWEEN) == COPHASE_OK);
        out = output(s.frames + k * s.pixels, 1, s.rows, s.cols);
        CHECK(cophase_simulator_image_e(simulator, &out) == COPHASE_OK);
        CHECK(cophase_simulator_slopes_mas(simulator, s.slopes + k * s.slope_count, s.slope_count) == COPHASE_OK);
    }
    out = output(s.truth, 2, s.side, s.side);
    CHECK(cophase_simulator_truth_nm(simulator, &out) == COPHASE_OK);
    cophase_simulator_destroy(simulator);
    return s;
}

static cophase_input frames_of(const struct sky *s)
{
    return input(s->frames, COPHASE_F32, IMAGES, s->rows, s->cols);
}

static cophase_input slopes_of(const struct sky *s)
{
    return input(s->slopes, COPHASE_F32, 1, IMAGES, s->slope_count);
}

static cophase_full_phase *estimator_of(const char *scene)
{
    cophase_full_phase *full_phase = NULL;

    CHECK(cophase_full_phase_create(scene, NULL, &full_phase) == COPHASE_OK);
    if (full_phase == NULL)
        exit(1);
    return full_phase;
}

static cophase_full_phase_options defaults(void)
{
    cophase_full_phase_options options;

    CHECK(cophase_full_phase_options_init(&options, sizeof options) == COPHASE_OK);
    CHECK(options.struct_size == sizeof options && options.knows == COPHASE_KNOWS_MOST && options.threads == 0);
    CHECK(isnan(options.read_noise_e));
    return options;
}

/* What a program has that was built against a later header: three fields more. */
struct later_options {
    cophase_full_phase_options known;
    double more[3];
};

struct later_image {
    cophase_full_phase_image known;
    double more[3];
};

static struct later_options later_defaults(void)
{
    struct later_options options;

    memset(&options, 0x55, sizeof options);
    CHECK(cophase_full_phase_options_init(&options.known, sizeof options) == COPHASE_OK);
    CHECK(options.known.struct_size == sizeof options && options.more[0] == 0.0 && options.more[2] == 0.0);
    return options;
}

/* Scenes and handles that cannot be. */
static void misuse(const char *scene)
{
    cophase_full_phase *none = NULL;
    char *bad = joined(scene, "\n[estimate]\noptimizer = \"bfgs\"\n");
    uint64_t retrieved = 7;
    size_t rows = 7, cols = 7;

    REFUSED(COPHASE_BAD_SCENE, "estimate.optimizer = \"bfgs\"", cophase_full_phase_create(bad, NULL, &none));
    free(bad);
    bad = joined(scene, "\n[estimate]\nbudget_nm = 1\n");
    REFUSED(COPHASE_BAD_SCENE, "budget_nm", cophase_full_phase_create(bad, NULL, &none));
    free(bad);
    bad = joined(scene, "\n[estimate]\nmethod = \"full-face\"\n");
    REFUSED(COPHASE_BAD_SCENE, "\"full-phase\"", cophase_full_phase_create(bad, NULL, &none));
    free(bad);
    REFUSED(COPHASE_BAD_ARGUMENT, "scene_text", cophase_full_phase_create(NULL, NULL, &none));
    REFUSED(COPHASE_BAD_ARGUMENT, "full_phase", cophase_full_phase_create(scene, NULL, NULL));
    REFUSED(COPHASE_BAD_ARGUMENT, "full_phase is NULL", cophase_full_phase_estimate(NULL, NULL, NULL, NULL, NULL, 0));
    REFUSED(COPHASE_BAD_ARGUMENT, "full_phase is NULL", cophase_full_phase_cancel(NULL));
    REFUSED(COPHASE_BAD_ARGUMENT, "full_phase is NULL", cophase_full_phase_progress(NULL, &retrieved));
    REFUSED(COPHASE_BAD_ARGUMENT, "full_phase is NULL", cophase_full_phase_frame_shape(NULL, &rows, &cols));
    REFUSED(COPHASE_BAD_ARGUMENT, "full_phase is NULL", cophase_full_phase_calibrate(NULL, NULL));
    CHECK(none == NULL && retrieved == 7 && rows == 7 && cols == 7);
    cophase_full_phase_destroy(NULL);
}

/* Everything that asks for an estimate, before there is one. */
static void too_early(cophase_full_phase *full_phase)
{
    cophase_full_phase_image image;
    cophase_correction_report report;
    cophase_array_f32 out;
    const char *name = NULL;
    double number = UNTOUCHED;
    float pixel = 0.0f;
    uint64_t images = 7;
    size_t size = 7;

    out = output(&pixel, 1, 1, 1);
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_images(full_phase, &image, sizeof image, 1));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_image_message(full_phase, 0, NULL, 0, &size));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_warnings(full_phase, NULL, 0, &size));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_mode_count(full_phase, &size));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_segment_mode_count(full_phase, &size));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_mode_name(full_phase, 0, &name));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_coefficients_nm(full_phase, &number, NULL, 1));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_covariance_nm2(full_phase, &number, 1));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_samples(full_phase, &size));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_maps_nm(full_phase, &out));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_images_needed(full_phase, 1.0, 1.0, &images));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet", cophase_full_phase_correct(full_phase, NAN, &report, sizeof report));
    REFUSED(COPHASE_BAD_VALUE, "no estimate yet",
            cophase_full_phase_corrections(full_phase, &number, 1, NULL, NULL, 0, NULL, 0));
    CHECK(size == 7 && name == NULL && number == UNTOUCHED && pixel == 0.0f && images == 7);
}

/* Frames, slopes and options that do not fit: a sentence each, before any image is read. */
static void refusals(const struct sky *s, cophase_full_phase *full_phase)
{
    cophase_full_phase_options options = defaults();
    struct later_options later = later_defaults();
    cophase_input frames = frames_of(s), slopes = slopes_of(s);
    cophase_full_phase_report report;
    cophase_calibration calibration;
    float *spoilt;
    uint64_t retrieved = 7;

    memset(&report, 0x55, sizeof report);
    REFUSED(COPHASE_BAD_ARGUMENT, "frames is NULL",
            cophase_full_phase_estimate(full_phase, NULL, &slopes, NULL, &report, sizeof report));
    frames.rows--;
    REFUSED(COPHASE_BAD_SHAPE, "frames is 4 x 71 x 80",
            cophase_full_phase_estimate(full_phase, &frames, &slopes, NULL, &report, sizeof report));
    frames = frames_of(s);
    slopes.cols--;
    REFUSED(COPHASE_BAD_SHAPE, "slopes were given for each image",
            cophase_full_phase_estimate(full_phase, &frames, &slopes, NULL, &report, sizeof report));
    slopes = slopes_of(s);
    slopes.rows--;
    REFUSED(COPHASE_BAD_SHAPE, "slopes_mas is 1 x 3 x",
            cophase_full_phase_estimate(full_phase, &frames, &slopes, NULL, &report, sizeof report));
    slopes = slopes_of(s);
    spoilt = floats(IMAGES * s->slope_count);
    memcpy(spoilt, s->slopes, IMAGES * s->slope_count * sizeof *spoilt);
    spoilt[s->slope_count + 2] = NAN;
    slopes.data = spoilt;
    REFUSED(COPHASE_BAD_VALUE, "slope 3 of image 2 is NaN",
            cophase_full_phase_estimate(full_phase, &frames, &slopes, NULL, &report, sizeof report));
    free(spoilt);
    options.knows = COPHASE_KNOWS_TELEMETRY;
    REFUSED(COPHASE_BAD_SCENE, "images come without slopes",
            cophase_full_phase_estimate(full_phase, &frames, NULL, &options, &report, sizeof report));
    options.knows = 5;
    REFUSED(COPHASE_BAD_VALUE, "options->knows is 5",
            cophase_full_phase_estimate(full_phase, &frames, NULL, &options, &report, sizeof report));
    options = defaults();
    options.threads = -1;
    REFUSED(COPHASE_BAD_VALUE, "options->threads is -1",
            cophase_full_phase_estimate(full_phase, &frames, NULL, &options, &report, sizeof report));
    options = defaults();
    options.read_noise_e = -1.0;
    REFUSED(COPHASE_BAD_VALUE, "options->read_noise_e is -1",
            cophase_full_phase_estimate(full_phase, &frames, NULL, &options, &report, sizeof report));
    later.more[2] = 1.0;
    REFUSED(COPHASE_BAD_ARGUMENT, "options->struct_size is",
            cophase_full_phase_estimate(full_phase, &frames, NULL, &later.known, &report, sizeof report));
    REFUSED(COPHASE_BAD_ARGUMENT, "report_size", cophase_full_phase_estimate(full_phase, &frames, NULL, NULL, &report, 3));
    CHECK(cophase_calibration_init(&calibration, sizeof calibration) == COPHASE_OK);
    calibration.gain_e = 0.0;
    REFUSED(COPHASE_BAD_VALUE, "gain_e is 0", cophase_full_phase_calibrate(full_phase, &calibration));
    CHECK(cophase_full_phase_cancel(full_phase) == COPHASE_OK);
    slopes = slopes_of(s);
    REFUSED(COPHASE_INTERRUPTED, "stopped", cophase_full_phase_estimate(full_phase, &frames, &slopes, NULL, &report, sizeof report));
    CHECK(cophase_full_phase_progress(full_phase, &retrieved) == COPHASE_OK && retrieved == 0);
    CHECK(report.images == 0x5555555555555555u);
    too_early(full_phase);
}

/* A scene without a loop: its telemetry cannot be known. Empty frames: none can be used. */
static void without_a_loop(const struct sky *s, const char *scene)
{
    cophase_full_phase_options options = defaults();
    cophase_input frames = frames_of(s), slopes = slopes_of(s);
    float *nothing = (float *)memory(s->pixels, sizeof *nothing);
    char *short_scene = joined(scene, "");
    cophase_full_phase *full_phase;

    *strstr(short_scene, "[wavefront_sensor]") = '\0';
    full_phase = estimator_of(short_scene);
    free(short_scene);
    options.knows = COPHASE_KNOWS_TELEMETRY;
    REFUSED(COPHASE_BAD_SCENE, "scene has no [wavefront_sensor] and [control]",
            cophase_full_phase_estimate(full_phase, &frames, &slopes, &options, NULL, 0));
    cophase_full_phase_destroy(full_phase);

    full_phase = estimator_of(scene);
    frames.data = nothing;
    frames.count_stride = 0;
    REFUSED(COPHASE_BAD_IMAGE, "0 of 4 images", cophase_full_phase_estimate(full_phase, &frames, NULL, NULL, NULL, 0));
    cophase_full_phase_destroy(full_phase);
    free(nothing);
}

/* RMS of the difference of two maps on the glass, piston removed, nm. */
static double rms_nm(const float *one, const float *other, size_t count)
{
    double sum = 0.0, square = 0.0;
    size_t i, inside = 0;

    for (i = 0; i < count; i++) {
        const double difference = (double)one[i] - (other == NULL ? 0.0 : (double)other[i]);

        if (isnan(difference))
            continue;
        inside++;
        sum += difference;
        square += difference * difference;
    }
    CHECK(inside > count / 8);
    return sqrt(square / (double)inside - sum / (double)inside * (sum / (double)inside));
}

/* What became of the images, and what is to be said of it all. */
static void reports(cophase_full_phase *full_phase, const cophase_full_phase_report *report)
{
    cophase_full_phase_image images[IMAGES];
    struct later_image later[IMAGES];
    char text[256];
    size_t length = 7, k, used = 0;

    CHECK(report->images == IMAGES && report->used >= 2 && report->passes >= 2 && report->settled == 1);
    CHECK(report->knows == COPHASE_KNOWS_TELEMETRY && report->seconds > 0.0);
    CHECK(report->phasing_change_nm < report->phasing_sigma_nm && report->ncpa_change_nm < report->ncpa_sigma_nm);
    REFUSED(COPHASE_BAD_SHAPE, "count is 3", cophase_full_phase_images(full_phase, images, sizeof images[0], 3));
    REFUSED(COPHASE_BAD_ARGUMENT, "reports", cophase_full_phase_images(full_phase, NULL, sizeof images[0], IMAGES));
    CHECK(cophase_full_phase_images(full_phase, images, sizeof images[0], IMAGES) == COPHASE_OK);
    memset(later, 0x55, sizeof later);
    CHECK(cophase_full_phase_images(full_phase, &later[0].known, sizeof later[0], IMAGES) == COPHASE_OK);
    for (k = 0; k < IMAGES; k++) {
        CHECK(later[k].known.flux_e == images[k].flux_e && later[k].more[0] == 0.0 && later[k].more[2] == 0.0);
        CHECK(images[k].status == COPHASE_IMAGE_OK && images[k].evaluations > 1 && images[k].flux_e > 1e5);
        used += images[k].used == 1;
        CHECK(cophase_full_phase_image_message(full_phase, k, text, sizeof text, &length) == COPHASE_OK);
        CHECK(strstr(text, "reduced") != NULL && length == strlen(text));
    }
    CHECK(used == report->used);
    REFUSED(COPHASE_BAD_VALUE, "image is 4", cophase_full_phase_image_message(full_phase, IMAGES, text, sizeof text, &length));
    CHECK(cophase_full_phase_warnings(full_phase, text, sizeof text, &length) == COPHASE_OK);
    /* Nothing but what the numbers say. */
    CHECK((strstr(text, "left out") != NULL) == (used < IMAGES) && strstr(text, "settle") == NULL);
    CHECK(strstr(text, "loop's answer") == NULL);
}

static void dump_floats(FILE *file, const float *values, size_t count)
{
    size_t i;

    for (i = 0; i < count; i++) {
        const double value = values[i];

        dump(file, &value, 1);
    }
}

/* Coefficients, error bars, covariance and maps, and how near they are to the truth. */
static void results(const struct sky *s, cophase_full_phase *full_phase, FILE *file)
{
    const size_t samples = s->side * s->side;
    float *maps = floats(4 * samples);
    double *coefficients_nm, *sigma_nm, *covariance_nm2, phasing_nm, ncpa_nm;
    cophase_array_f32 out;
    const char *name = NULL;
    size_t modes = 0, segments = 0, side = 0;
    uint64_t needed = 7;

    CHECK(cophase_full_phase_mode_count(full_phase, &modes) == COPHASE_OK && modes > 10);
    CHECK(cophase_full_phase_segment_mode_count(full_phase, &segments) == COPHASE_OK && segments == 7);
    CHECK(cophase_full_phase_mode_name(full_phase, 0, &name) == COPHASE_OK && strstr(name, "piston") != NULL);
    CHECK(cophase_full_phase_mode_name(full_phase, modes - 1, &name) == COPHASE_OK);
    /* The last is one of the NCPA: of Zernikes, or of the mirror where these are not enough. */
    CHECK(strncmp(name, "noll-", 5) == 0 || strncmp(name, "kl-", 3) == 0);
    REFUSED(COPHASE_BAD_VALUE, "mode is", cophase_full_phase_mode_name(full_phase, modes, &name));
    coefficients_nm = doubles(modes), sigma_nm = doubles(modes), covariance_nm2 = doubles(modes * modes);
    REFUSED(COPHASE_BAD_SHAPE, "modes is", cophase_full_phase_coefficients_nm(full_phase, coefficients_nm, NULL, modes - 1));
    REFUSED(COPHASE_BAD_SHAPE, "modes is", cophase_full_phase_covariance_nm2(full_phase, covariance_nm2, modes + 1));
    CHECK(untouched(coefficients_nm, modes) == modes);
    CHECK(cophase_full_phase_coefficients_nm(full_phase, coefficients_nm, NULL, modes) == COPHASE_OK);
    CHECK(cophase_full_phase_coefficients_nm(full_phase, coefficients_nm, sigma_nm, modes) == COPHASE_OK);
    CHECK(cophase_full_phase_covariance_nm2(full_phase, covariance_nm2, modes) == COPHASE_OK);
    CHECK(fabs(sigma_nm[modes - 1] - sqrt(covariance_nm2[modes * modes - 1])) <= 1e-12 * sigma_nm[modes - 1]);

    CHECK(cophase_full_phase_samples(full_phase, &side) == COPHASE_OK && side == s->side);
    out = output(maps, 2, side, side);
    REFUSED(COPHASE_BAD_SHAPE, "out is 2 x 64 x 64", cophase_full_phase_maps_nm(full_phase, &out));
    out = output(maps, 4, side, side);
    CHECK(cophase_full_phase_maps_nm(full_phase, &out) == COPHASE_OK);
    /* 60 and 50 nm are to be found; four exposures leave 8 and 7 nm. */
    phasing_nm = rms_nm(maps, s->truth, samples), ncpa_nm = rms_nm(maps + samples, s->truth + samples, samples);
    printf("residuals of %.1f and %.1f nm of phasing and NCPA\n", phasing_nm, ncpa_nm);
    CHECK(phasing_nm < 0.5 * rms_nm(s->truth, NULL, samples));
    CHECK(ncpa_nm < 0.5 * rms_nm(s->truth + samples, NULL, samples));

    CHECK(cophase_full_phase_images_needed(full_phase, INFINITY, INFINITY, &needed) == COPHASE_OK && needed == 0);
    CHECK(cophase_full_phase_images_needed(full_phase, 0.1, INFINITY, &needed) == COPHASE_OK && needed > IMAGES);
    REFUSED(COPHASE_BAD_VALUE, "ncpa_nm is -1", cophase_full_phase_images_needed(full_phase, 1.0, -1.0, &needed));

    dump(file, coefficients_nm, modes);
    dump(file, sigma_nm, modes);
    dump(file, covariance_nm2, modes * modes);
    dump_floats(file, maps, 4 * samples);
    free(coefficients_nm), free(sigma_nm), free(covariance_nm2), free(maps);
}

/* What to add to segments, mirror and reference slopes. */
static void corrections(const struct sky *s, cophase_full_phase *full_phase, FILE *file)
{
    double *pistons_nm, *actuators_nm, *actuators_m, *slopes_mas;
    cophase_correction_report report;
    size_t i;

    REFUSED(COPHASE_BAD_VALUE, "no corrections yet",
            cophase_full_phase_corrections(full_phase, NULL, 0, NULL, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_VALUE, "a limit of -1 nm", cophase_full_phase_correct(full_phase, -1.0, NULL, 0));
    CHECK(cophase_full_phase_correct(full_phase, 5.0, &report, sizeof report) == COPHASE_OK);
    CHECK(report.segments == 7 && report.actuators > 40 && report.slopes == s->slope_count);
    CHECK(report.corrected_modes > 0 && report.limited > 0);
    pistons_nm = doubles(report.segments), slopes_mas = doubles(report.slopes);
    actuators_nm = doubles(report.actuators), actuators_m = doubles(2 * report.actuators);
    CHECK(cophase_full_phase_corrections(full_phase, pistons_nm, 7, NULL, NULL, 0, NULL, 0) == COPHASE_OK);
    for (i = 0; i < 7; i++)
        CHECK(fabs(pistons_nm[i]) <= 5.0);

    CHECK(cophase_full_phase_correct(full_phase, NAN, &report, sizeof report) == COPHASE_OK);
    REFUSED(COPHASE_BAD_SHAPE, "slopes is 1",
            cophase_full_phase_corrections(full_phase, pistons_nm, 7, NULL, NULL, 0, slopes_mas, 1));
    CHECK(untouched(slopes_mas, report.slopes) == report.slopes && fabs(pistons_nm[0]) <= 5.0);
    CHECK(cophase_full_phase_corrections(full_phase, pistons_nm, report.segments, actuators_nm, actuators_m,
                                         report.actuators, slopes_mas, report.slopes) == COPHASE_OK);
    dump(file, pistons_nm, report.segments);
    dump(file, actuators_nm, report.actuators);
    dump(file, actuators_m, 2 * report.actuators);
    dump(file, slopes_mas, report.slopes);
    free(pistons_nm), free(actuators_nm), free(actuators_m), free(slopes_mas);
}

/* The same frames as raw values, on one thread: the same bits. */
static void as_a_camera_delivers_them(const struct sky *s, const char *scene, const cophase_full_phase *other)
{
    cophase_full_phase *full_phase = estimator_of(scene);
    cophase_full_phase_options options = defaults();
    cophase_input frames = frames_of(s), slopes = slopes_of(s);
    cophase_calibration calibration;
    double *halves = doubles(IMAGES * s->pixels), *one_nm, *other_nm;
    float dark = 8.0f;
    size_t i, modes = 0;
    uint64_t retrieved = 0;
    cophase_full_phase_report report;

    /* Powers of two: nothing is rounded. */
    for (i = 0; i < IMAGES * s->pixels; i++)
        halves[IMAGES * s->pixels - 1 - i] = 0.5 * (double)s->frames[i] + 8.0;
    frames = input(halves + IMAGES * s->pixels - 1, COPHASE_F64, IMAGES, s->rows, s->cols);
    frames.count_stride *= -1, frames.row_stride *= -1, frames.col_stride *= -1;
    CHECK(cophase_calibration_init(&calibration, sizeof calibration) == COPHASE_OK);
    calibration.dark = input(&dark, COPHASE_F32, 1, s->rows, s->cols);
    calibration.dark.row_stride = calibration.dark.col_stride = 0;
    calibration.gain_e = 2.0;
    CHECK(cophase_full_phase_calibrate(full_phase, &calibration) == COPHASE_OK);
    options.threads = 1;
    CHECK(cophase_full_phase_estimate(full_phase, &frames, &slopes, &options, &report, sizeof report) == COPHASE_OK);
    CHECK(cophase_full_phase_progress(full_phase, &retrieved) == COPHASE_OK && retrieved == IMAGES * report.passes);
    CHECK(cophase_full_phase_mode_count(full_phase, &modes) == COPHASE_OK);
    one_nm = doubles(modes), other_nm = doubles(modes);
    CHECK(cophase_full_phase_coefficients_nm(full_phase, one_nm, NULL, modes) == COPHASE_OK);
    CHECK(cophase_full_phase_coefficients_nm(other, other_nm, NULL, modes) == COPHASE_OK);
    CHECK(memcmp(one_nm, other_nm, modes * sizeof *one_nm) == 0);

    /* A failure leaves the estimate. */
    frames.rows--;
    REFUSED(COPHASE_BAD_SHAPE, "frames", cophase_full_phase_estimate(full_phase, &frames, NULL, NULL, NULL, 0));
    CHECK(cophase_full_phase_coefficients_nm(full_phase, other_nm, NULL, modes) == COPHASE_OK);
    CHECK(memcmp(one_nm, other_nm, modes * sizeof *one_nm) == 0);
    free(one_nm), free(other_nm), free(halves);
    cophase_full_phase_destroy(full_phase);
}

int main(int argc, char **argv)
{
    cophase_full_phase *full_phase;
    cophase_full_phase_report report;
    struct later_options later = later_defaults();
    cophase_input frames, slopes;
    size_t size, rows = 0, cols = 0;
    struct sky s;
    char *scene;
    FILE *file;

    if (argc != 3 || (file = fopen(argv[2], "wb")) == NULL)
        return 2;
    scene = read_file(argv[1], &size);
    misuse(scene);
    s = sky_of(scene);
    without_a_loop(&s, scene);
    full_phase = estimator_of(scene);
    CHECK(cophase_full_phase_frame_shape(full_phase, &rows, &cols) == COPHASE_OK && rows == s.rows && cols == s.cols);
    too_early(full_phase);
    refusals(&s, full_phase);

    frames = frames_of(&s), slopes = slopes_of(&s);
    CHECK(cophase_full_phase_estimate(full_phase, &frames, &slopes, &later.known, &report, sizeof report) == COPHASE_OK);
    reports(full_phase, &report);
    dump_floats(file, s.frames, IMAGES * s.pixels);
    dump_floats(file, s.slopes, IMAGES * s.slope_count);
    results(&s, full_phase, file);
    corrections(&s, full_phase, file);
    as_a_camera_delivers_them(&s, scene, full_phase);

    if (fclose(file) != 0)
        return 2;
    cophase_full_phase_destroy(full_phase);
    free(s.frames), free(s.slopes), free(s.truth);
    free(scene);
    return failures == 0 ? 0 : 1;
}
