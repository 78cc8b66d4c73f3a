/* One image: segment pistons and NCPA, with error bars, from one defocused image of a point source. */
#include "tutorial.h"
#include <string.h>

#define PIXELS 128
#define READ_NOISE_E 60.0
#define CAPACITY (1 << 14) /* of a text */

/* Another value for a key of a scene. */
static void set(char *scene, const char *key, const char *value)
{
    static char changed[CAPACITY];
    size_t length;

    must(cophase_scene_set(scene, key, value, changed, CAPACITY, &length));
    if (length >= CAPACITY)
        exit(1);
    strcpy(scene, changed);
}

/* The true piston of a segment: 64 nm RMS over all. */
static double piston_nm(size_t segment)
{
    return 90 * sin(4.0 * segment);
}

/* In place of a camera: these pistons, and 73 nm RMS of NCPA in the Zernike modes 4 (focus) to 18. */
static void make_image(const char *scene, double *frame_e)
{
    static double psf[PIXELS * PIXELS];
    cophase_model *model;
    cophase_model_info info;
    const char *name;
    double *truth_nm, largest = 0.0;
    size_t i;
    int noll;

    must(cophase_model_create(scene, NULL, NULL, &model));
    must(cophase_model_get_info(model, &info, sizeof info));
    truth_nm = numbers(info.modes);
    for (i = 0; i < info.modes; i++) {
        must(cophase_model_mode_name(model, i, &name));
        if (i < info.segment_modes)
            truth_nm[i] = piston_nm(i);
        else if (sscanf(name, "noll-%d", &noll) == 1 && noll >= 4 && noll <= 18)
            truth_nm[i] = 27 * cos(5.0 * noll);
    }
    must(cophase_model_psf(model, truth_nm, info.modes, psf, PIXELS * PIXELS));
    for (i = 0; i < PIXELS * PIXELS; i++)
        largest = fmax(largest, psf[i]);
    expose(psf, PIXELS * PIXELS, 200 * 200 / largest, READ_NOISE_E, frame_e);
    free(truth_nm);
    cophase_model_destroy(model);
}

/* Scatter of (estimate - truth) / error bar over the pistons; an image does not show the mean of all pistons. */
static double scatter(const double *found_nm, const double *sigma_nm, size_t segments)
{
    double mean_nm = 0.0, sum = 0.0;
    size_t i;

    for (i = 0; i < segments; i++)
        mean_nm += piston_nm(i) / segments;
    for (i = 0; i < segments; i++)
        sum += pow((found_nm[i] - (piston_nm(i) - mean_nm)) / sigma_nm[i], 2);
    return sqrt(sum / segments);
}

int main(void)
{
    static double frame_e[PIXELS * PIXELS];
    static char scene[CAPACITY], report[CAPACITY];
    const cophase_input frame = cophase_input_from_array(frame_e, COPHASE_F64, 1, PIXELS, PIXELS);
    const cophase_estimate_options options = {.struct_size = sizeof options, .read_noise_e = READ_NOISE_E};
    const cophase_channel_images images = {.frames = &frame, .options = &options};
    cophase_estimator *estimator;
    cophase_estimate *estimate;
    cophase_estimate_info info;
    double *found_nm, *sigma_nm, normalised;
    const char *preset;
    size_t length;

    must(cophase_scene_preset("keck-artificial", &preset));
    if (strlen(preset) >= CAPACITY)
        return 1;
    strcpy(scene, preset);
    set(scene, "image.samples_per_lambda_over_d", "2");
    set(scene, "image.pixels", "128");
    set(scene, "image.crop_pixels", "128");
    make_image(scene, frame_e);

    must(cophase_estimator_create(scene, NULL, NULL, &estimator));
    must(cophase_estimator_estimate(estimator, &images, 1, &estimate));
    must(cophase_estimate_text(estimate, COPHASE_TEXT_REPORT, 0, report, sizeof report, &length));
    must(cophase_estimate_get_info(estimate, &info, sizeof info));
    printf("%s\n", report);
    printf("phasing: %.2f ± %.2f nm\n", info.phasing_rms_nm, info.phasing_sigma_nm);
    printf("NCPA: %.2f ± %.2f nm\n", info.ncpa_rms_nm, info.ncpa_sigma_nm);

    /* The call succeeds where an image is not explained by the model; the image's own status says so. */
    if (info.status != COPHASE_IMAGE_OK)
        printf("status of the image: %s\n", cophase_status_name(info.status));

    found_nm = numbers(info.modes);
    sigma_nm = numbers(info.modes);
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_COEFFICIENTS_NM, found_nm, info.modes));
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_SIGMA_NM, sigma_nm, info.modes));
    normalised = scatter(found_nm, sigma_nm, info.segment_modes);
    printf("scatter of the normalised residuals: %.2f\n", normalised);

    free(found_nm);
    free(sigma_nm);
    cophase_estimate_destroy(estimate);
    cophase_estimator_destroy(estimator);
    return normalised > 0.5 && normalised < 2.0 ? 0 : 1;
}
