/* The running estimate through the public header alone; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   sequence SCENE.toml
 */
#include "setting.h"

enum { IMAGES = 12, CAPACITY = 10 };

/* Fits one more image of the same wavefront, with noise of its own, and pushes it. */
static void push_one(const struct setting *s, cophase_sequence *sequence, uint64_t seed)
{
    const cophase_input frame = frames_of(s, 1);

    make_frame(s->model, s->truth_nm, seed, s->frames);
    CHECK(cophase_session_fit(s->session, &frame, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    CHECK(cophase_sequence_push(sequence, s->session) == COPHASE_OK);
}

/* Fits an image of nothing, and pushes it. */
static void push_nothing(const struct setting *s, cophase_sequence *sequence)
{
    const cophase_input frame = frames_of(s, 1);
    cophase_image_report report;

    memset(s->frames, 0, s->pixels * sizeof *s->frames);
    CHECK(cophase_session_fit(s->session, &frame, 1, NULL, s->fitted_nm, NULL, s->modes, &report, sizeof report, NULL, 0) == COPHASE_OK);
    CHECK(report.status == COPHASE_IMAGE_UNUSABLE);
    CHECK(cophase_sequence_push(sequence, s->session) == COPHASE_OK);
}

static void without_images(const struct setting *s, cophase_sequence *sequence)
{
    double *values = doubles(s->modes * s->modes);
    cophase_sequence_report report;
    uint64_t needed = 7;

    memset(&report, 0x55, sizeof report);
    CHECK(cophase_sequence_push(sequence, s->session) == COPHASE_OK); /* nothing was fitted: no image more */
    REFUSED(COPHASE_BAD_IMAGE, "image",
            cophase_sequence_estimate(sequence, values, NULL, NULL, s->modes, &report, sizeof report));
    push_nothing(s, sequence);
    push_nothing(s, sequence);
    REFUSED(COPHASE_BAD_IMAGE, "image",
            cophase_sequence_estimate(sequence, values, values, values, s->modes, &report, sizeof report));
    REFUSED(COPHASE_BAD_IMAGE, "image", cophase_sequence_images_needed(sequence, 1.0, 1.0, &needed));
    CHECK(untouched(values, s->modes * s->modes) == s->modes * s->modes && needed == 7);
    CHECK(report.images == 0x5555555555555555u);
    CHECK(cophase_sequence_push(sequence, NULL) == COPHASE_OK);
    free(values);
}

/* The estimate closes in on the truth as its error bars say, and knows only the last CAPACITY images. */
static void with_images(const struct setting *s, cophase_sequence *sequence)
{
    double *estimate_nm = doubles(s->modes), *sigma_nm = doubles(s->modes);
    double *covariance_nm2 = doubles(s->modes * s->modes);
    cophase_sequence_report one, all;
    double piston_nm = 0.0;
    uint64_t needed = 7;
    size_t i;

    push_one(s, sequence, 1000);
    CHECK(cophase_sequence_estimate(sequence, estimate_nm, sigma_nm, NULL, s->modes, &one, sizeof one) == COPHASE_OK);
    CHECK(one.images == 1 && one.used == 1 && one.clipped == 0);
    for (i = 0; i < s->modes; i++)
        CHECK(fabs(estimate_nm[i] - s->fitted_nm[i]) < 1e-9); /* but for the rounding of a mean of one */
    for (i = 1; i < IMAGES; i++)
        push_one(s, sequence, 1000 + i);
    CHECK(cophase_sequence_estimate(sequence, estimate_nm, sigma_nm, covariance_nm2, s->modes, &all, sizeof all) == COPHASE_OK);
    CHECK(cophase_sequence_estimate(sequence, NULL, NULL, NULL, s->modes, NULL, 0) == COPHASE_OK);
    CHECK(all.images == CAPACITY && all.used + all.clipped == CAPACITY && all.used >= CAPACITY / 2);
    CHECK(all.reduced_chi2 > 0.85 && all.reduced_chi2 < 1.15);
    CHECK(all.phasing_sigma_nm < one.phasing_sigma_nm && all.ncpa_sigma_nm < one.ncpa_sigma_nm);
    CHECK(all.phasing_rms_nm > 0.0 && all.ncpa_rms_nm > 0.0);
    for (i = 0; i < s->segment_modes; i++)
        piston_nm += (estimate_nm[i] - s->truth_nm[i]) / (double)s->segment_modes;
    for (i = 0; i < s->modes; i++) {
        const double error_nm = estimate_nm[i] - s->truth_nm[i] - (i < s->segment_modes ? piston_nm : 0.0);

        /* Eight sigma: with the scatter of ten images for an error bar, Student's distribution has this as six. */
        CHECK(fabs(error_nm) < 8.0 * sigma_nm[i]);
        CHECK(fabs(sigma_nm[i] * sigma_nm[i] - covariance_nm2[i * s->modes + i]) <= 1e-12 * covariance_nm2[i * s->modes + i]);
    }

    CHECK(cophase_sequence_images_needed(sequence, INFINITY, INFINITY, &needed) == COPHASE_OK && needed == 0);
    CHECK(cophase_sequence_images_needed(sequence, all.phasing_sigma_nm, all.ncpa_sigma_nm, &needed) == COPHASE_OK);
    CHECK(needed == 0);
    /* Half the error takes four times the images. */
    CHECK(cophase_sequence_images_needed(sequence, all.phasing_sigma_nm / 2.0, INFINITY, &needed) == COPHASE_OK);
    CHECK(needed >= 3 * CAPACITY && needed <= 3 * CAPACITY + 1);
    needed = 7;
    REFUSED(COPHASE_BAD_VALUE, "phasing_nm", cophase_sequence_images_needed(sequence, 0.0, 1.0, &needed));
    REFUSED(COPHASE_BAD_VALUE, "ncpa_nm", cophase_sequence_images_needed(sequence, 1.0, -1.0, &needed));
    REFUSED(COPHASE_BAD_VALUE, "NaN", cophase_sequence_images_needed(sequence, NAN, 1.0, &needed));
    REFUSED(COPHASE_BAD_SHAPE, "",
            cophase_sequence_estimate(sequence, estimate_nm, sigma_nm, NULL, s->modes + 1, &all, sizeof all));
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_sequence_estimate(sequence, NULL, NULL, covariance_nm2, 0, NULL, 0));
    CHECK(needed == 7);

    /* An image of nothing takes a place and is not used. */
    push_nothing(s, sequence);
    CHECK(cophase_sequence_estimate(sequence, estimate_nm, NULL, NULL, s->modes, &all, sizeof all) == COPHASE_OK);
    CHECK(all.images == CAPACITY && all.used + all.clipped == CAPACITY - 1);
    CHECK(cophase_sequence_push(sequence, NULL) == COPHASE_OK);
    REFUSED(COPHASE_BAD_IMAGE, "image", cophase_sequence_estimate(sequence, estimate_nm, NULL, NULL, s->modes, NULL, 0));
    free(covariance_nm2), free(sigma_nm), free(estimate_nm);
}

/* A session of other modes has nothing to say to it, and no more images fit than it keeps. */
static void strangers(const struct setting *s, const char *scene)
{
    char *other_scene = joined(scene, "\n[estimate]\nfit_background = false\n");
    const cophase_input frames = frames_of(s, COUNT);
    cophase_sequence *sequence = NULL;
    cophase_sequence_report report;
    cophase_model *other = NULL;

    CHECK(cophase_model_create(other_scene, NULL, NULL, &other) == COPHASE_OK);
    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    CHECK(cophase_sequence_create(other, CAPACITY, &sequence) == COPHASE_OK);
    REFUSED(COPHASE_BAD_VALUE, "model", cophase_sequence_push(sequence, s->session));
    cophase_sequence_destroy(sequence);
    cophase_model_destroy(other);
    free(other_scene);

    sequence = NULL;
    REFUSED(COPHASE_BAD_VALUE, "capacity", cophase_sequence_create(s->model, 0, &sequence));
    REFUSED(COPHASE_BAD_VALUE, "capacity", cophase_sequence_create(s->model, (size_t)-1, &sequence));
    REFUSED(COPHASE_BAD_VALUE, "capacity", cophase_sequence_create(s->model, (size_t)-1 / 256, &sequence));
    CHECK(sequence == NULL);
    CHECK(cophase_sequence_create(s->model, 2, &sequence) == COPHASE_OK);
    CHECK(cophase_sequence_push(sequence, s->session) == COPHASE_OK); /* three images: the last two stay */
    CHECK(cophase_sequence_estimate(sequence, s->fitted_nm, NULL, NULL, s->modes, &report, sizeof report) == COPHASE_OK);
    CHECK(report.images == 2);
    cophase_sequence_destroy(sequence);
}

int main(int argc, char **argv)
{
    struct setting s;
    cophase_sequence *sequence = NULL;
    size_t size;
    char *scene;

    if (argc != 2)
        return 2;
    scene = read_file(argv[1], &size);
    s = setting_of(scene);
    strangers(&s, scene);
    free(scene);
    cophase_session_destroy(s.session);
    s.session = session_for(s.model, COUNT);
    CHECK(cophase_sequence_create(s.model, CAPACITY, &sequence) == COPHASE_OK);
    if (sequence == NULL)
        return 1;
    without_images(&s, sequence);
    with_images(&s, sequence);
    cophase_sequence_destroy(sequence);
    cophase_sequence_destroy(NULL);
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
