/* What becomes of images: every status that a report can hold, calibration, deadline; see tests/c_api/main.rs:
 *
 *   images SCENE.toml
 */
#include "setting.h"

/* Fits one frame: its status. */
static int32_t fitted(const struct setting *s, const float *frame, const cophase_fit_options *options,
                      cophase_image_report *report, double *coefficients_nm)
{
    const cophase_input frames = input(frame, COPHASE_F32, 1, s->rows, s->cols);

    CHECK(cophase_session_fit(s->session, &frames, 1, options, coefficients_nm, NULL, s->modes, report, sizeof *report, NULL, 0) == COPHASE_OK);
    return report->status;
}

/* The sentence on image 0 of the last fit has `part` in it. */
static int message_says(const struct setting *s, const char *part)
{
    char text[1024], little[4] = "xxx";
    size_t length = 0, again = 0;

    CHECK(cophase_session_text(s->session, COPHASE_TEXT_IMAGE_MESSAGE, 0, text, sizeof text, &length) == COPHASE_OK);
    CHECK(strlen(text) == length);
    CHECK(cophase_session_text(s->session, COPHASE_TEXT_IMAGE_MESSAGE, 0, little, 2, &again) == COPHASE_OK);
    CHECK(again == length && little[2] == 'x' && strlen(little) == (length > 0 ? 1u : 0u));
    CHECK(cophase_session_text(s->session, COPHASE_TEXT_IMAGE_MESSAGE, 0, NULL, 0, &again) == COPHASE_OK && again == length);
    return strstr(text, part) != NULL;
}

/* The other texts of a session. */
static void texts(const struct setting *s)
{
    char text[16] = "xxx";
    size_t length = 7;

    CHECK(cophase_session_text(s->session, COPHASE_TEXT_WARNINGS, 7, text, sizeof text, &length) == COPHASE_OK);
    CHECK(length == 0 && text[0] == '\0' && text[1] == 'x');
    CHECK(cophase_session_text(s->session, COPHASE_TEXT_POLICY, 7, text, sizeof text, &length) == COPHASE_OK);
    CHECK(length == 8 && strcmp(text, "realtime") == 0);
    CHECK(cophase_session_text(s->session, COPHASE_TEXT_DEVICE, 7, text, sizeof text, &length) == COPHASE_OK);
    CHECK(strcmp(text, "cpu") == 0);
    REFUSED(COPHASE_BAD_VALUE, "what is 1:", cophase_session_text(s->session, COPHASE_TEXT_REPORT, 0, text, 16, &length));
    REFUSED(COPHASE_BAD_VALUE, "what is 0:", cophase_session_text(s->session, 0, 0, text, sizeof text, &length));
}

static void names(void)
{
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_OK), "OK") == 0);
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_MISFIT), "MISFIT") == 0);
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_WRONG_MINIMUM), "WRONG_MINIMUM") == 0);
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_NOT_CONVERGED), "NOT_CONVERGED") == 0);
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_UNUSABLE), "UNUSABLE") == 0);
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_DEADLINE), "DEADLINE") == 0);
    CHECK(strcmp(cophase_status_name(COPHASE_IMAGE_CONTRADICTORY), "CONTRADICTORY") == 0);
    CHECK(strcmp(cophase_status_name(107), "UNKNOWN") == 0);
    CHECK(strcmp(cophase_status_name(-1), "UNKNOWN") == 0);
}

static void statuses(const struct setting *s)
{
    float *frame = floats(s->pixels);
    double *found_nm = doubles(s->modes + 1);
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_session *hasty = NULL;
    cophase_image_report report;
    size_t i;

    CHECK(fitted(s, s->frames, NULL, &report, s->fitted_nm) == COPHASE_IMAGE_OK);
    /* A second star beside the first is nothing that the modes can be. */
    for (i = 0; i < s->pixels; i++)
        frame[i] = s->frames[i] + 0.08f * s->frames[(i + s->pixels - 6) % s->pixels];
    CHECK(fitted(s, frame, NULL, &report, found_nm) == COPHASE_IMAGE_MISFIT);
    CHECK(report.reduced_chi2 > 2.0 && message_says(s, "noise"));
    for (i = 0; i < s->pixels; i++)
        frame[i] = 100.0f * (s->frames[i] + s->frames[(i + s->pixels - 12) % s->pixels]);
    CHECK(fitted(s, frame, NULL, &report, found_nm) == COPHASE_IMAGE_WRONG_MINIMUM);
    CHECK(report.reduced_chi2 > 300.0 && message_says(s, ""));

    /* Nothing in it. The coefficients are no numbers, so that nobody takes them for some. */
    for (i = 0; i < s->pixels; i++)
        frame[i] = 7.0f;
    CHECK(fitted(s, frame, NULL, &report, found_nm) == COPHASE_IMAGE_UNUSABLE);
    CHECK(message_says(s, "constant"));
    for (i = 0; i < s->modes; i++)
        CHECK(found_nm[i] != found_nm[i]);
    CHECK(cophase_session_refine(s->session, 0, NULL, found_nm, s->modes, NULL, 0) != COPHASE_OK);
    memset(frame, 0xff, s->pixels * sizeof *frame); /* NaN */
    CHECK(fitted(s, frame, NULL, &report, found_nm) == COPHASE_IMAGE_UNUSABLE);
    CHECK(message_says(s, "good pixel"));
    {
        const cophase_input nothing = input(frame, COPHASE_F32, 1, s->rows, s->cols);

        REFUSED(COPHASE_BAD_IMAGE, "good pixel",
                cophase_session_evaluate(s->session, 0, &nothing, NULL, s->truth_nm, 1, s->modes, found_nm, found_nm + 1));
    }

    options.max_evaluations = 1;
    CHECK(cophase_session_create(s->model, &options, &hasty) == COPHASE_OK);
    {
        const cophase_input one = frames_of(s, 1);

        CHECK(cophase_session_fit(hasty, &one, 1, NULL, found_nm, NULL, s->modes, &report, sizeof report, NULL, 0) == COPHASE_OK);
    }
    CHECK(report.status == COPHASE_IMAGE_NOT_CONVERGED && report.evaluations == 1);
    cophase_session_destroy(hasty);
    free(found_nm);
    free(frame);
}

/* A frame that cannot be used hides nothing of the others. */
static void one_bad_among_good(const struct setting *s)
{
    const cophase_input frames = frames_of(s, COUNT);
    double *clean_nm = doubles(COUNT * s->modes), *found_nm = doubles(COUNT * s->modes);
    const size_t bytes = s->modes * sizeof *found_nm;
    cophase_image_report reports[COUNT];
    float *kept = floats(s->pixels);

    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, clean_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    memcpy(kept, s->frames + s->pixels, s->pixels * sizeof *kept);
    memset(s->frames + s->pixels, 0, s->pixels * sizeof *kept);
    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, found_nm, NULL, s->modes, reports, sizeof *reports, NULL, 0) == COPHASE_OK);
    CHECK(reports[0].status == COPHASE_IMAGE_OK && reports[2].status == COPHASE_IMAGE_OK);
    CHECK(reports[1].status == COPHASE_IMAGE_UNUSABLE && found_nm[s->modes] != found_nm[s->modes]);
    CHECK(memcmp(found_nm, clean_nm, bytes) == 0);
    CHECK(memcmp(found_nm + 2 * s->modes, clean_nm + 2 * s->modes, bytes) == 0);
    memcpy(s->frames + s->pixels, kept, s->pixels * sizeof *kept);
    free(kept), free(found_nm), free(clean_nm);
}

static void deadlines(const struct setting *s)
{
    double *found_nm = doubles(s->modes);
    cophase_fit_options options = DEFAULTS(cophase_fit_options);
    cophase_image_report report;
    size_t i;

    options.deadline_s = 1e-9; /* it has passed before the first evaluation is done */
    CHECK(fitted(s, s->frames, &options, &report, found_nm) == COPHASE_IMAGE_DEADLINE);
    CHECK(report.evaluations <= 1 && message_says(s, "deadline"));
    for (i = 0; i < s->modes; i++)
        CHECK(found_nm[i] == found_nm[i]); /* the best so far, numbers in any case */
    options.deadline_s = 1e6;
    CHECK(fitted(s, s->frames, &options, &report, found_nm) == COPHASE_IMAGE_OK);
    CHECK(memcmp(found_nm, s->fitted_nm, s->modes * sizeof *found_nm) == 0);
    {
        const cophase_input one = frames_of(s, 1);

        options.deadline_s = -1.0;
        REFUSED(COPHASE_BAD_VALUE, "-1", cophase_session_fit(s->session, &one, 1, &options, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
        options.deadline_s = NAN;
        REFUSED(COPHASE_BAD_VALUE, "deadline_s", cophase_session_fit(s->session, &one, 1, &options, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    }
    free(found_nm);
}

/* electrons = (raw - dark) * gain / flat. Dark, gain and flat are such that nothing is rounded: the same bits. */
static void calibration(const struct setting *s)
{
    float *electrons = floats(s->pixels), *flat = floats(s->pixels), *raw = floats(s->pixels);
    uint16_t *dark = (uint16_t *)memory(s->pixels, sizeof *dark);
    uint8_t *bad = (uint8_t *)memory(s->pixels, 1);
    double *plain_nm = doubles(s->modes), *found_nm = doubles(s->modes);
    cophase_calibration maps = DEFAULTS(cophase_calibration);
    cophase_image_report report;
    size_t i;

    for (i = 0; i < s->pixels; i++) {
        electrons[i] = (float)(int)s->frames[i];
        dark[i] = (uint16_t)(100 + i % 7);
        flat[i] = i % 3 == 0 ? 0.5f : 1.0f;
        raw[i] = electrons[i] / 4.0f * flat[i] + (float)dark[i];
    }
    CHECK(fitted(s, electrons, NULL, &report, plain_nm) == COPHASE_IMAGE_OK);
    maps.dark = input(dark, COPHASE_U16, 1, s->rows, s->cols);
    maps.flat = input(flat, COPHASE_F32, 1, s->rows, s->cols);
    maps.bad = input(bad, COPHASE_U8, 1, s->rows, s->cols);
    maps.gain_e = 4.0;
    CHECK(cophase_session_calibrate(s->session, 0, &maps) == COPHASE_OK);
    CHECK(fitted(s, raw, NULL, &report, found_nm) == COPHASE_IMAGE_OK && report.bad_pixels == 0);
    CHECK(memcmp(found_nm, plain_nm, s->modes * sizeof *found_nm) == 0);

    /* A hot pixel: rejected, marked bad, or past saturation. */
    raw[s->pixels / 2 + 3] = 1e6f;
    CHECK(fitted(s, raw, NULL, &report, found_nm) == COPHASE_IMAGE_OK && report.rejected_pixels == 1);
    bad[s->pixels / 2 + 3] = 1;
    CHECK(cophase_session_calibrate(s->session, 0, &maps) == COPHASE_OK);
    CHECK(fitted(s, raw, NULL, &report, found_nm) == COPHASE_IMAGE_OK && report.bad_pixels == 1);
    maps.bad.data = NULL, maps.saturation = 1e6;
    CHECK(cophase_session_calibrate(s->session, 0, &maps) == COPHASE_OK);
    CHECK(fitted(s, raw, NULL, &report, plain_nm) == COPHASE_IMAGE_OK && report.bad_pixels == 1);
    CHECK(memcmp(found_nm, plain_nm, s->modes * sizeof *found_nm) == 0);

    maps.gain_e = -1.0;
    REFUSED(COPHASE_BAD_VALUE, "gain_e", cophase_session_calibrate(s->session, 0, &maps));
    maps.gain_e = 4.0, maps.dark.rows++;
    REFUSED(COPHASE_BAD_SHAPE, "dark", cophase_session_calibrate(s->session, 0, &maps));
    maps.dark.rows--, maps.flat.element = 77;
    REFUSED(COPHASE_BAD_ARGUMENT, "flat", cophase_session_calibrate(s->session, 0, &maps));
    maps.flat.element = COPHASE_F32, flat[0] = 0.0f;
    CHECK(cophase_session_calibrate(s->session, 0, &maps) != COPHASE_INTERNAL); /* a dead pixel: bad, or refused */
    /* None: as before. */
    CHECK(cophase_session_calibrate(s->session, 0, NULL) == COPHASE_OK);
    CHECK(fitted(s, s->frames, NULL, &report, found_nm) == COPHASE_IMAGE_OK);
    CHECK(memcmp(found_nm, s->fitted_nm, s->modes * sizeof *found_nm) == 0);
    free(found_nm), free(plain_nm), free(bad), free(dark), free(raw), free(flat), free(electrons);
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
    free(scene);
    names();
    texts(&s);
    statuses(&s);
    one_bad_among_good(&s);
    deadlines(&s);
    calibration(&s);
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
