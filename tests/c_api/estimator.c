/* Estimators and their estimates through the public headers alone; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   estimator SCENE.toml DUMP
 *
 * The scene has a loop, and is given estimate.method = "full-phase": a MAP estimate. DUMP receives what Rust must see too: frames, slopes, coefficients and
 * their standard deviations, covariance, maps, error budget, corrections. */
#include "support.h"
#include <cophase_simulator.h>
#include <math.h>

enum { IMAGES = 4, SETTLED = 300, BETWEEN = 60 };

/* Exposures behind the loop of a scene, and what its sensor measured meanwhile. */
struct sky {
    size_t rows, cols, pixels, slope_count, side;
    double *frames;  /* IMAGES x rows x cols, electrons */
    double *slopes;  /* IMAGES x slope_count, mas */
    double *truth;   /* 2 x side x side, nm */
};

static struct sky sky_of(const char *scene)
{
    cophase_simulator *simulator = NULL;
    cophase_simulator_info info;
    struct sky s;
    size_t k;

    CHECK(cophase_simulator_create(scene, NULL, &simulator) == COPHASE_OK);
    if (simulator == NULL)
        exit(1);
    CHECK(cophase_simulator_get_info(simulator, &info, sizeof info) == COPHASE_OK);
    s.rows = info.rows, s.cols = info.cols, s.pixels = info.rows * info.cols;
    s.slope_count = info.slopes, s.side = info.truth_samples;
    s.frames = doubles(IMAGES * s.pixels);
    s.slopes = doubles(IMAGES * s.slope_count);
    s.truth = doubles(2 * s.side * s.side);
    for (k = 0; k < IMAGES; k++) {
        CHECK(cophase_simulator_step(simulator, k == 0 ? SETTLED : BETWEEN) == COPHASE_OK);
        CHECK(cophase_simulator_array(simulator, COPHASE_ARRAY_IMAGE_E, s.frames + k * s.pixels, s.pixels) == COPHASE_OK);
        CHECK(cophase_simulator_array(simulator, COPHASE_ARRAY_SLOPES_MAS, s.slopes + k * s.slope_count, s.slope_count) ==
              COPHASE_OK);
    }
    CHECK(cophase_simulator_array(simulator, COPHASE_ARRAY_TRUTH_NM, s.truth, 2 * s.side * s.side) == COPHASE_OK);
    cophase_simulator_destroy(simulator);
    return s;
}

static cophase_input frames_of(const struct sky *s)
{
    return input(s->frames, COPHASE_F64, IMAGES, s->rows, s->cols);
}

static cophase_input slopes_of(const struct sky *s)
{
    return input(s->slopes, COPHASE_F64, 1, IMAGES, s->slope_count);
}

static cophase_estimator *estimator_of(const char *scene, const cophase_estimator_options *options)
{
    cophase_estimator *estimator = NULL;

    CHECK(cophase_estimator_create(scene, NULL, options, &estimator) == COPHASE_OK);
    if (estimator == NULL)
        exit(1);
    return estimator;
}

/* Estimate from the images of the only channel. */
static cophase_status estimate_of(cophase_estimator *estimator, const cophase_input *frames, const cophase_input *slopes,
                                  const cophase_estimate_options *options, cophase_estimate **estimate)
{
    const cophase_channel_images images = {NULL, frames, options, slopes};

    return cophase_estimator_estimate(estimator, &images, 1, estimate);
}

/* Structs of a program that was built against a later header: three fields more. */
struct later_options {
    cophase_estimate_options known;
    double more[3];
};

struct later_image {
    cophase_image_report known;
    double more[3];
};

static struct later_options later_defaults(void)
{
    struct later_options options;

    memset(&options, 0, sizeof options);
    options.known.struct_size = sizeof options;
    return options;
}

/* Scenes that cannot be. */
static void misuse(const char *scene)
{
    static const char *const more[][2] = {
        {"optimizer = \"bfgs\"", "estimate.optimizer = \"bfgs\""}, {"budget_nm = 1", "budget_nm"}, {"fit_optics = [\"plate-scale\"]", ""}};
    cophase_estimator *none = NULL;
    size_t i;

    for (i = 0; i < sizeof more / sizeof *more; i++) {
        char *bad = (char *)memory(strlen(scene) + 128, 1), *estimate = strstr(scene, "[estimate]\n");

        CHECK(estimate != NULL);
        estimate += strlen("[estimate]\n");
        sprintf(bad, "%.*s%s\n%s", (int)(estimate - scene), scene, more[i][0], estimate);
        REFUSED(COPHASE_BAD_SCENE, more[i][1], cophase_estimator_create(bad, NULL, NULL, &none));
        free(bad);
    }
    CHECK(none == NULL);
}

#define ESTIMATE_REFUSED(status, part, frames, slopes, options) \
    REFUSED(status, part, estimate_of(estimator, frames, slopes, options, &none))

/* Frames, slopes and options that do not fit: a sentence each, before any image is used. */
static void refusals(const struct sky *s, cophase_estimator *estimator)
{
    cophase_estimate_options options = DEFAULTS(cophase_estimate_options);
    cophase_calibration calibration = DEFAULTS(cophase_calibration);
    struct later_options later = later_defaults();
    cophase_input frames = frames_of(s), slopes = slopes_of(s);
    cophase_estimate *none = NULL;
    int32_t stage = 7;
    uint64_t done = 7, total = 7;
    double *spoilt;
    size_t k;

    frames.rows--;
    ESTIMATE_REFUSED(COPHASE_BAD_SHAPE, "frames is 4 x 71 x 80", &frames, &slopes, NULL);
    frames = frames_of(s);
    slopes.cols--;
    ESTIMATE_REFUSED(COPHASE_BAD_SHAPE, "slopes were given for each image", &frames, &slopes, NULL);
    slopes = slopes_of(s);
    slopes.rows--;
    ESTIMATE_REFUSED(COPHASE_BAD_SHAPE, "slopes_mas is 1 x 3 x", &frames, &slopes, NULL);
    slopes = slopes_of(s);
    spoilt = doubles(IMAGES * s->slope_count);
    memcpy(spoilt, s->slopes, IMAGES * s->slope_count * sizeof *spoilt);
    spoilt[s->slope_count + 2] = NAN;
    slopes.data = spoilt;
    ESTIMATE_REFUSED(COPHASE_BAD_VALUE, "slope 3 of image 2 is NaN", &frames, &slopes, NULL);
    /* Slopes of the opposite sign: the sentence names the key of the scene, and no option of the program. */
    for (k = 0; k < IMAGES * s->slope_count; k++)
        spoilt[k] = -s->slopes[k];
    ESTIMATE_REFUSED(COPHASE_BAD_VALUE, "set estimate.telemetry of the scene", &frames, &slopes, NULL);
    free(spoilt);
    slopes = slopes_of(s);
    options.read_noise_e = -1.0;
    ESTIMATE_REFUSED(COPHASE_BAD_VALUE, "options->read_noise_e is -1", &frames, &slopes, &options);
    options.read_noise_e = 0.0, options.calibration = &calibration, calibration.gain_e = -1.0;
    ESTIMATE_REFUSED(COPHASE_BAD_VALUE, "gain_e is -1", &frames, &slopes, &options);
    calibration.struct_size = 3;
    ESTIMATE_REFUSED(COPHASE_BAD_ARGUMENT, "calibration->struct_size is 3", &frames, &slopes, &options);
    later.more[2] = 1.0;
    ESTIMATE_REFUSED(COPHASE_BAD_ARGUMENT, "options->struct_size is", &frames, &slopes, &later.known);
    CHECK(cophase_estimator_cancel(estimator) == COPHASE_OK);
    ESTIMATE_REFUSED(COPHASE_INTERRUPTED, "stopped", &frames, &slopes, NULL);
    CHECK(cophase_estimator_progress(estimator, &stage, &done, &total) == COPHASE_OK && stage == COPHASE_STAGE_IDLE);
    CHECK(none == NULL);
}

/* Empty frames: none can be used. */
static void without_a_star(const struct sky *s, cophase_estimator *estimator)
{
    double *nothing = (double *)memory(s->pixels, sizeof *nothing);
    cophase_input frames = frames_of(s);
    cophase_estimate *none = NULL;

    frames.data = nothing, frames.count_stride = 0;
    ESTIMATE_REFUSED(COPHASE_BAD_IMAGE, "0 of 4 images", &frames, NULL, NULL);
    CHECK(none == NULL);
    free(nothing);
}

/* Texts of the estimate. */
static int text_has(const cophase_estimate *estimate, int32_t what, size_t index, const char *part)
{
    static char text[1 << 16];
    size_t length = 0;

    CHECK(cophase_estimate_text(estimate, what, index, text, sizeof text, &length) == COPHASE_OK);
    CHECK(length == strlen(text));
    return strstr(text, part) != NULL;
}

/* RMS of the difference of two maps inside the pupil, piston removed, nm. */
static double rms_nm(const double *one, const double *other, size_t count)
{
    double sum = 0.0, square = 0.0;
    size_t i, inside = 0;

    for (i = 0; i < count; i++) {
        const double difference = one[i] - (other == NULL ? 0.0 : other[i]);

        if (isnan(difference))
            continue;
        inside++;
        sum += difference;
        square += difference * difference;
    }
    CHECK(inside > count / 8);
    return sqrt(square / (double)inside - sum / (double)inside * (sum / (double)inside));
}

/* Figures, reports on the images, texts. */
static void reports(const cophase_estimate *estimate, const cophase_estimate_info *info)
{
    cophase_image_report images[IMAGES];
    struct later_image later[IMAGES];
    size_t k, used = 0, length = 7;
    char text[8];

    CHECK(info->images == IMAGES && info->used >= 2 && info->iterations >= 2 && info->has_settled == 1);
    CHECK(info->method == COPHASE_METHOD_MAP && info->policy == COPHASE_POLICY_FULL);
    CHECK(info->precision == COPHASE_F32 || info->precision == COPHASE_F64);
    CHECK(info->ao_knowledge == COPHASE_AO_KNOWLEDGE_TELEMETRY && info->seconds > 0.0 && info->evaluations > IMAGES);
    CHECK(info->modes > 10 && info->segment_modes == 7 && info->phasing_sigma_nm > 0.0 && info->ncpa_sigma_nm > 0.0);
    CHECK(info->images_to_halve > (double)IMAGES && info->map_width_m > 0.0);
    REFUSED(COPHASE_BAD_SHAPE, "count is 3", cophase_estimate_images(estimate, images, sizeof images[0], 3));
    REFUSED(COPHASE_BAD_ARGUMENT, "reports", cophase_estimate_images(estimate, NULL, sizeof images[0], IMAGES));
    CHECK(cophase_estimate_images(estimate, images, sizeof images[0], IMAGES) == COPHASE_OK);
    memset(later, 0x55, sizeof later);
    CHECK(cophase_estimate_images(estimate, &later[0].known, sizeof later[0], IMAGES) == COPHASE_OK);
    for (k = 0; k < IMAGES; k++) {
        CHECK(later[k].known.flux_e == images[k].flux_e && later[k].more[0] == 0.0 && later[k].more[2] == 0.0);
        CHECK(images[k].status == COPHASE_IMAGE_OK && images[k].evaluations > 1 && images[k].flux_e > 1e5);
        CHECK(images[k].policy == COPHASE_POLICY_FULL && images[k].is_used + images[k].is_clipped == 1);
        used += images[k].is_used == 1;
        CHECK(text_has(estimate, COPHASE_TEXT_IMAGE_MESSAGE, k, "reduced"));
    }
    CHECK(used == info->used);
    REFUSED(COPHASE_BAD_VALUE, "index is 4",
            cophase_estimate_text(estimate, COPHASE_TEXT_IMAGE_MESSAGE, IMAGES, text, sizeof text, &length));
    REFUSED(COPHASE_BAD_VALUE, "what is 0", cophase_estimate_text(estimate, 0, 0, text, sizeof text, &length));
    CHECK(length == 7);
    CHECK(text_has(estimate, COPHASE_TEXT_REPORT, 0, "phasing") && text_has(estimate, COPHASE_TEXT_SCENE, 0, "[image]"));
    CHECK(text_has(estimate, COPHASE_TEXT_POLICY, 0, "full") && text_has(estimate, COPHASE_TEXT_DEVICE, 0, "cpu"));
    CHECK(text_has(estimate, COPHASE_TEXT_MODEL, 0, "Zernike modes to radial order")
          || text_has(estimate, COPHASE_TEXT_MODEL, 0, "modes of the deformable mirror"));
    CHECK(text_has(estimate, COPHASE_TEXT_REMARKS, 0, ""));
    CHECK(text_has(estimate, COPHASE_TEXT_MODE_NAME, 0, "piston"));
    CHECK(text_has(estimate, COPHASE_TEXT_ERROR_TERM_NAME, 0, "noise"));
    REFUSED(COPHASE_BAD_VALUE, "number of terms",
            cophase_estimate_text(estimate, COPHASE_TEXT_ERROR_TERM_NAME, info->error_terms, text, 8, &length));
    /* Nothing but what the numbers say. */
    CHECK(text_has(estimate, COPHASE_TEXT_WARNINGS, 0, "left out") == (used < IMAGES));
    CHECK(!text_has(estimate, COPHASE_TEXT_WARNINGS, 0, "settle"));
}

/* An array, which is dumped, and refused with any other count; the caller frees it. */
static double *array_of(const cophase_estimate *estimate, int32_t what, size_t count, FILE *file)
{
    double *values = doubles(count + 1);

    REFUSED(COPHASE_BAD_SHAPE, "is accepted", cophase_estimate_array(estimate, what, values, count + 1));
    REFUSED(COPHASE_BAD_SHAPE, "count is 0", cophase_estimate_array(estimate, what, values, 0));
    CHECK(untouched(values, count) == count);
    CHECK(cophase_estimate_array(estimate, what, values, count) == COPHASE_OK && values[count] == UNTOUCHED);
    dump(file, values, count);
    return values;
}

/* Coefficients, error bars, covariance and maps, and how near they are to the truth. */
static void results(const struct sky *s, const cophase_estimate *estimate, const cophase_estimate_info *info, FILE *file)
{
    const size_t modes = info->modes, samples = info->samples * info->samples;
    double *coefficients_nm = array_of(estimate, COPHASE_ARRAY_COEFFICIENTS_NM, modes, file);
    double *sigma_nm = array_of(estimate, COPHASE_ARRAY_SIGMA_NM, modes, file);
    double *covariance_nm2 = array_of(estimate, COPHASE_ARRAY_COVARIANCE_NM2, modes * modes, file);
    double *maps = array_of(estimate, COPHASE_ARRAY_MAPS_NM, 4 * samples, file);
    double *budget = array_of(estimate, COPHASE_ARRAY_ERROR_BUDGET_NM, 2 * info->error_terms, file);
    double phasing_nm, ncpa_nm, sum_nm2 = 0.0;
    size_t i;

    CHECK(info->samples == s->side);
    CHECK(fabs(sigma_nm[modes - 1] - sqrt(covariance_nm2[modes * modes - 1])) <= 1e-12 * sigma_nm[modes - 1]);
    for (i = 0; i < info->error_terms; i++)
        sum_nm2 += budget[2 * i] * budget[2 * i];
    CHECK(fabs(sqrt(sum_nm2) - info->phasing_sigma_nm) <= 1e-9 * info->phasing_sigma_nm);
    /* 60 and 50 nm are to be found; four exposures leave 8 and 7 nm. */
    phasing_nm = rms_nm(maps, s->truth, samples), ncpa_nm = rms_nm(maps + samples, s->truth + samples, samples);
    printf("residuals of %.1f and %.1f nm of phasing and NCPA\n", phasing_nm, ncpa_nm);
    CHECK(phasing_nm < 0.5 * rms_nm(s->truth, NULL, samples));
    CHECK(ncpa_nm < 0.5 * rms_nm(s->truth + samples, NULL, samples));
    REFUSED(COPHASE_BAD_VALUE, "MAP", cophase_estimate_array(estimate, COPHASE_ARRAY_IMAGE_COEFFICIENTS_NM, maps, modes));
    REFUSED(COPHASE_BAD_VALUE, "what is 99", cophase_estimate_array(estimate, 99, maps, modes));
    REFUSED(COPHASE_BAD_ARGUMENT, "out is NULL", cophase_estimate_array(estimate, COPHASE_ARRAY_SIGMA_NM, NULL, modes));
    free(coefficients_nm), free(sigma_nm), free(covariance_nm2), free(maps), free(budget);
}

/* Whether a file is there, which is removed. */
static int was_written(const char *path)
{
    FILE *file = fopen(path, "rb");
    char card[7] = "";
    const int is_fits = file != NULL && fread(card, 1, 6, file) == 6 && strcmp(card, "SIMPLE") == 0;

    if (file != NULL)
        fclose(file), remove(path);
    return is_fits;
}

/* Modes that are held have a reason, the others none; as many as the report counts. */
static void check_held(const cophase_estimate *estimate, const cophase_correction_report *report)
{
    const int32_t texts[] = {COPHASE_TEXT_SEGMENT_HELD, COPHASE_TEXT_NCPA_HELD};
    const size_t modes[] = {report->segments + report->tilts, report->ncpa_modes};
    const size_t held[] = {report->held_segment_modes, report->held_ncpa_modes};
    size_t i, k;

    for (i = 0; i < 2; i++) {
        size_t found = 0;
        char word[32];
        size_t length;

        for (k = 0; k < modes[i]; k++) {
            CHECK(cophase_estimate_text(estimate, texts[i], k, word, sizeof word, &length) == COPHASE_OK);
            CHECK(length == strlen(word));
            CHECK(word[0] == '\0' || strcmp(word, "deadband") == 0 || strcmp(word, "no-benefit") == 0 ||
                  strcmp(word, "never-corrected") == 0);
            found += word[0] != '\0';
        }
        CHECK(found == held[i]);
    }
    CHECK(report->held_ncpa_modes + report->corrected_modes == report->ncpa_modes);
    CHECK(report->segments_drop_nm2 >= 0.0 && report->ncpa_drop_nm2 > 0.0);
}

/* What to add to segments, mirror and reference slopes; files. */
static void corrections(const struct sky *s, cophase_estimate *estimate, const char *dump_path, FILE *file)
{
    char *path = joined(dump_path, ".fits");
    cophase_correction_report report;
    double pistons_nm[7];
    size_t i;

    REFUSED(COPHASE_BAD_VALUE, "no corrections yet",
            cophase_estimate_array(estimate, COPHASE_ARRAY_CORRECTION_PISTONS_NM, pistons_nm, 7));
    REFUSED(COPHASE_BAD_VALUE, "limit_nm is -1", cophase_estimate_correct(estimate, -1.0, NULL, NULL, 0));
    REFUSED(COPHASE_BAD_VALUE, "limit_nm is NaN", cophase_estimate_correct(estimate, NAN, NULL, NULL, 0));
    CHECK(cophase_estimate_correct(estimate, 5.0, path, &report, sizeof report) == COPHASE_OK && was_written(path));
    CHECK(report.segments == 7 && report.actuators > 40 && report.slopes == s->slope_count);
    CHECK(report.corrected_modes > 0 && report.limited > 0);
    CHECK(cophase_estimate_array(estimate, COPHASE_ARRAY_CORRECTION_PISTONS_NM, pistons_nm, 7) == COPHASE_OK);
    for (i = 0; i < 7; i++)
        CHECK(fabs(pistons_nm[i]) <= 5.0);
    check_held(estimate, &report);
    CHECK(cophase_estimate_correct(estimate, 0.0, NULL, NULL, 0) == COPHASE_OK);
    free(array_of(estimate, COPHASE_ARRAY_CORRECTION_PISTONS_NM, report.segments, file));
    free(array_of(estimate, COPHASE_ARRAY_CORRECTION_ACTUATORS_NM, report.actuators, file));
    free(array_of(estimate, COPHASE_ARRAY_CORRECTION_ACTUATORS_M, 2 * report.actuators, file));
    free(array_of(estimate, COPHASE_ARRAY_CORRECTION_SLOPES_MAS, report.slopes, file));

    CHECK(cophase_estimate_write(estimate, path) == COPHASE_OK && was_written(path));
    REFUSED(COPHASE_BAD_FILE, "/nowhere", cophase_estimate_write(estimate, "/nowhere/estimate.fits"));
    REFUSED(COPHASE_BAD_ARGUMENT, "path", cophase_estimate_write(estimate, NULL));
    free(path);
}

/* The same frames as raw values, on one thread, with a bad pixel marked in two ways: the same bits. */
static void as_a_camera_delivers_them(const struct sky *s, const char *scene)
{
    cophase_estimator_options one_thread = DEFAULTS(cophase_estimator_options);
    cophase_estimate_options options = DEFAULTS(cophase_estimate_options);
    cophase_calibration calibration = DEFAULTS(cophase_calibration);
    cophase_input frames = frames_of(s), slopes = slopes_of(s);
    double *halves = doubles(IMAGES * s->pixels), *marked = doubles(IMAGES * s->pixels), *one_nm, *other_nm;
    uint8_t *bad = (uint8_t *)memory(s->pixels, 1);
    cophase_estimate *one = NULL, *other = NULL;
    cophase_estimator *estimator;
    cophase_estimate_info info;
    const size_t hot = s->pixels / 2 + 3;
    double dark = 8.0;
    size_t i;

    one_thread.threads = 1;
    estimator = estimator_of(scene, &one_thread);
    memcpy(marked, s->frames, IMAGES * s->pixels * sizeof *marked);
    for (i = 0; i < IMAGES; i++)
        marked[i * s->pixels + hot] = NAN;
    frames.data = marked;
    CHECK(estimate_of(estimator, &frames, &slopes, NULL, &one) == COPHASE_OK);
    CHECK(text_has(one, COPHASE_TEXT_WARNINGS, 0, "4 pixels are not finite and were masked"));

    /* Powers of two: nothing is rounded. */
    for (i = 0; i < IMAGES * s->pixels; i++)
        halves[IMAGES * s->pixels - 1 - i] = 0.5 * s->frames[i] + 8.0;
    frames = input(halves + IMAGES * s->pixels - 1, COPHASE_F64, IMAGES, s->rows, s->cols);
    frames.count_stride *= -1, frames.row_stride *= -1, frames.col_stride *= -1;
    calibration.dark = input(&dark, COPHASE_F64, 1, s->rows, s->cols);
    calibration.dark.row_stride = calibration.dark.col_stride = 0;
    calibration.bad = input(bad, COPHASE_U8, 1, s->rows, s->cols);
    calibration.gain_e = 2.0;
    bad[hot] = 1;
    options.calibration = &calibration;
    CHECK(estimate_of(estimator, &frames, &slopes, &options, &other) == COPHASE_OK);
    CHECK(!text_has(other, COPHASE_TEXT_WARNINGS, 0, "not finite"));
    cophase_estimator_destroy(estimator); /* its estimates stay */
    CHECK(cophase_estimate_get_info(one, &info, sizeof info) == COPHASE_OK);
    one_nm = doubles(info.modes), other_nm = doubles(info.modes);
    CHECK(cophase_estimate_array(one, COPHASE_ARRAY_COEFFICIENTS_NM, one_nm, info.modes) == COPHASE_OK);
    CHECK(cophase_estimate_array(other, COPHASE_ARRAY_COEFFICIENTS_NM, other_nm, info.modes) == COPHASE_OK);
    CHECK(memcmp(one_nm, other_nm, info.modes * sizeof *one_nm) == 0);
    cophase_estimate_destroy(one), cophase_estimate_destroy(other);
    free(one_nm), free(other_nm), free(halves), free(marked), free(bad);
}

static void write_table(const char *path)
{
    FILE *file = fopen(path, "w");
    int i;

    CHECK(file != NULL);
    for (i = 0; i < 7 && file != NULL; i++)
        fprintf(file, "%d 10%d 0.5\n", i, i);
    if (file != NULL)
        fclose(file);
}

/* What to add to each channel of the segments' controller, which numbers them from 100 and takes half a unit for each nm. */
static void commands(cophase_estimate *estimate)
{
    cophase_correction_report report;
    double pistons_nm[7], values[7], *actuators_nm;
    char name[4];
    size_t i, length;

    CHECK(cophase_estimate_correct(estimate, 0.0, NULL, &report, sizeof report) == COPHASE_OK);
    CHECK(report.segments == 7 && report.segment_commands == 7 && report.actuator_commands == 0);
    CHECK(report.actuators > 40 && report.slopes == 0);
    CHECK(cophase_estimate_array(estimate, COPHASE_ARRAY_CORRECTION_PISTONS_NM, pistons_nm, 7) == COPHASE_OK);
    CHECK(cophase_estimate_array(estimate, COPHASE_ARRAY_CORRECTION_SEGMENT_COMMANDS, values, 7) == COPHASE_OK);
    for (i = 0; i < 7; i++) {
        const char expected[] = {'1', '0', (char)('0' + i), '\0'};

        CHECK(cophase_estimate_text(estimate, COPHASE_TEXT_SEGMENT_COMMAND_NAME, i, name, sizeof name, &length) == COPHASE_OK);
        CHECK(length == 3 && strcmp(name, expected) == 0 && values[i] == 0.5 * pistons_nm[i]);
    }
    REFUSED(COPHASE_BAD_VALUE, "index is 7",
            cophase_estimate_text(estimate, COPHASE_TEXT_SEGMENT_COMMAND_NAME, 7, name, sizeof name, &length));
    actuators_nm = doubles(report.actuators);
    CHECK(cophase_estimate_array(estimate, COPHASE_ARRAY_CORRECTION_ACTUATORS_NM, actuators_nm, report.actuators) == COPHASE_OK);
    free(actuators_nm);
}

/* A modal estimate of the first frame by the realtime policy, which has what a MAP estimate lacks. */
static void modal(const struct sky *s, const char *scene, const char *table)
{
    /* More Karhunen-Loeve modes than this mirror makes are the default. */
    char *text = joined(scene, strstr(scene, "[modes]") != NULL ? "" : "\n[modes]\nncpa = \"zernike\"\nncpa_count = 8\n");
    char *named = joined(text, "\n[commands]\nsegment_file = \""), *quoted = joined(named, table), *whole = joined(quoted, "\"\n");
    char *method = strstr(whole, "method = \"full-phase\"");
    cophase_estimator_options options = DEFAULTS(cophase_estimator_options);
    const cophase_input frame = input(s->frames, COPHASE_F64, 1, s->rows, s->cols);
    cophase_estimate *estimate = NULL;
    cophase_estimator *estimator;
    cophase_estimate_info info;
    double *each_nm, *all_nm;

    CHECK(method != NULL);
    memcpy(method, "method = \"modal\"     ", strlen("method = \"full-phase\""));
    options.policy = COPHASE_POLICY_REALTIME;
    write_table(table);
    estimator = estimator_of(whole, &options);
    free(text), free(named), free(quoted), free(whole);
    CHECK(estimate_of(estimator, &frame, NULL, NULL, &estimate) == COPHASE_OK);
    CHECK(cophase_estimate_get_info(estimate, &info, sizeof info) == COPHASE_OK);
    CHECK(info.method == COPHASE_METHOD_MODAL && info.policy == COPHASE_POLICY_REALTIME && info.ao_knowledge == 0);
    CHECK(info.images == 1 && info.used == 1 && info.iterations == 0 && isnan(info.images_to_halve));
    CHECK(text_has(estimate, COPHASE_TEXT_POLICY, 0, "realtime"));
    each_nm = doubles(info.modes), all_nm = doubles(info.modes);
    CHECK(cophase_estimate_array(estimate, COPHASE_ARRAY_IMAGE_COEFFICIENTS_NM, each_nm, info.modes) == COPHASE_OK);
    CHECK(cophase_estimate_array(estimate, COPHASE_ARRAY_COEFFICIENTS_NM, all_nm, info.modes) == COPHASE_OK);
    CHECK(fabs(each_nm[0] - all_nm[0]) < 1e-9);
    commands(estimate);
    cophase_estimate_destroy(estimate);
    cophase_estimator_destroy(estimator);
    free(each_nm), free(all_nm);
}

int main(int argc, char **argv)
{
    struct later_options later = later_defaults();
    cophase_estimate *estimate = NULL;
    cophase_estimator *estimator;
    cophase_estimate_info info;
    cophase_input frames, slopes;
    struct sky s;
    char *text, *scene, *table;
    size_t size;
    FILE *file;

    if (argc != 3 || (file = fopen(argv[2], "wb")) == NULL)
        return 2;
    text = read_file(argv[1], &size);
    scene = joined(text, "\n[estimate]\nmethod = \"full-phase\"\n");
    free(text);
    misuse(scene);
    s = sky_of(scene);
    estimator = estimator_of(scene, NULL);
    without_a_star(&s, estimator);
    refusals(&s, estimator);

    frames = frames_of(&s), slopes = slopes_of(&s);
    CHECK(estimate_of(estimator, &frames, &slopes, &later.known, &estimate) == COPHASE_OK);
    cophase_estimator_destroy(estimator);
    if (estimate == NULL)
        return 1;
    CHECK(cophase_estimate_get_info(estimate, &info, sizeof info) == COPHASE_OK);
    reports(estimate, &info);
    dump(file, s.frames, IMAGES * s.pixels);
    dump(file, s.slopes, IMAGES * s.slope_count);
    results(&s, estimate, &info, file);
    corrections(&s, estimate, argv[2], file);
    cophase_estimate_destroy(estimate);
    as_a_camera_delivers_them(&s, scene);
    table = joined(argv[2], ".txt");
    modal(&s, scene, table);
    remove(table), free(table);

    free(s.frames), free(s.slopes), free(s.truth), free(scene);
    return fclose(file) == 0 && failures == 0 ? 0 : 1;
}
