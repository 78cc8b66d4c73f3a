/* A pair of images, defocused to both sides, determines the amplitude of their defocus. */
#include "tutorial.h"
#include <string.h>

#define PIXELS 128

/* The scene: telescope, camera, modes; then its two channels, and the fit of the defocus. */
#define SCENE(DEFOCUS)                                                                                                 \
    "[pupil]\naperture = \"hexagonal\"\nrings = 1\nsamples = 120\n"                                                    \
    "[image]\nwavelength_nm = 2000\nsamples_per_lambda_over_d = 2\npixels = 128\ncrop_pixels = 128\n"                  \
    "diversity_focus_waves_rms = " DEFOCUS "\nread_noise_e = 20\n"                                                     \
    "[modes]\nncpa = \"zernike\"\nncpa_count = 14\nexact_zernikes = []\n"
#define CHANNELS                                                                                                       \
    "[[image.channel]]\nname = \"plus\"\ndiversity_focus_waves_rms = 1.0\n"                                            \
    "[[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -1.0\n"
#define FIT "[estimate]\nfit_optics = [\"defocus\"]\n"

static double true_focus_nm;
static size_t focus; /* its number among the modes */

/* In place of a camera: an image of the true wavefront with the defocus of this scene. */
static void make_image(const char *scene, double *frame_e)
{
    static double psf[PIXELS * PIXELS];
    cophase_model *model;
    cophase_model_info info;
    const char *name;
    double *truth_nm, mean_nm = 0.0, largest = 0.0;
    size_t i;

    must(cophase_model_create(scene, NULL, NULL, &model));
    must(cophase_model_get_info(model, &info, sizeof info));
    truth_nm = numbers(info.modes);
    for (i = 0; i < info.segment_modes; i++)
        mean_nm += 80 * sin(4.0 * i) / info.segment_modes;
    for (i = 0; i < info.modes; i++) {
        truth_nm[i] = i < info.segment_modes ? 80 * sin(4.0 * i) - mean_nm : 15 * cos(5.0 * i);
        must(cophase_model_mode_name(model, i, &name));
        if (strcmp(name, "noll-4") == 0)
            focus = i, true_focus_nm = truth_nm[i];
    }
    must(cophase_model_psf(model, truth_nm, info.modes, psf, PIXELS * PIXELS));
    for (i = 0; i < PIXELS * PIXELS; i++)
        largest = fmax(largest, psf[i]);
    expose(psf, PIXELS * PIXELS, 300 * 300 / largest, 20, frame_e);
    free(truth_nm);
    cophase_model_destroy(model);
}

/* Estimates from the images of `count` channels, prints the focus, and returns its error, nm. */
static double error_of_focus_nm(const char *title, const char *scene, const cophase_channel_images *images, size_t count)
{
    static char warnings[1 << 14];
    cophase_estimator *estimator;
    cophase_estimate *estimate;
    cophase_estimate_info info;
    double *found_nm, *sigma_nm, error_nm;
    size_t length;

    must(cophase_estimator_create(scene, NULL, NULL, &estimator));
    must(cophase_estimator_estimate(estimator, images, count, &estimate));
    must(cophase_estimate_get_info(estimate, &info, sizeof info));
    must(cophase_estimate_text(estimate, COPHASE_TEXT_WARNINGS, 0, warnings, sizeof warnings, &length));
    found_nm = numbers(info.modes);
    sigma_nm = numbers(info.modes);
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_COEFFICIENTS_NM, found_nm, info.modes));
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_SIGMA_NM, sigma_nm, info.modes));
    error_nm = found_nm[focus] - true_focus_nm;
    printf("error of focus, %s: %.3f ± %.3f nm\n", title, error_nm, sigma_nm[focus]);
    printf("   reduced χ² %.2f\n", info.reduced_chi2);
    if (info.warnings > 0)
        printf("   warning: %s\n", warnings);
    free(found_nm);
    free(sigma_nm);
    cophase_estimate_destroy(estimate);
    cophase_estimator_destroy(estimator);
    return error_nm;
}

int main(void)
{
    static double plus_e[PIXELS * PIXELS], minus_e[PIXELS * PIXELS];
    const cophase_input plus = cophase_input_from_array(plus_e, COPHASE_F64, 1, PIXELS, PIXELS);
    const cophase_input minus = cophase_input_from_array(minus_e, COPHASE_F64, 1, PIXELS, PIXELS);
    const cophase_channel_images single = {NULL, &plus, NULL, NULL};
    const cophase_channel_images pair[] = {{"plus", &plus, NULL, NULL}, {"minus", &minus, NULL, NULL}};
    double wrong_nm, right_nm;

    /* The true defocus is 2 % larger than that of the scene. */
    make_image(SCENE("1.02"), plus_e);
    make_image(SCENE("-1.02"), minus_e);

    wrong_nm = error_of_focus_nm("one image", SCENE("1.0"), &single, 1);
    error_of_focus_nm("pair", SCENE("1.0") CHANNELS, pair, 2);
    right_nm = error_of_focus_nm("pair, defocus fitted", SCENE("1.0") CHANNELS FIT, pair, 2);
    return fabs(wrong_nm) > 20 && fabs(right_nm) < 2 ? 0 : 1;
}
