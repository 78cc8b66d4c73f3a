/* Fits with a deadline, frame by frame, and their running estimate. */
#include "tutorial.h"

#define PIXELS 96
#define FRAMES 50

static const char scene[] = "[pupil]\naperture = \"keck\"\ngrid_m = 10.95\nsamples = 60\n"
                            "[image]\nwavelength_nm = 2168.6\nsamples_per_lambda_over_d = 2\npixels = 96\n"
                            "crop_pixels = 96\ndiversity_focus_waves_rms = 0.7\nread_noise_e = 10\n"
                            "[estimate]\nsampling = \"native\"\n";

/* RMS error of the pistons; their mean is in no image. */
static double error_nm(const double *found_nm, const double *truth_nm, size_t segments)
{
    double mean = 0.0, squares = 0.0;
    size_t i;

    for (i = 0; i < segments; i++) {
        const double difference = found_nm[i] - truth_nm[i];

        mean += difference / segments;
        squares += difference * difference / segments;
    }
    return sqrt(squares - mean * mean);
}

int main(void)
{
    static double psf[PIXELS * PIXELS], frame_e[PIXELS * PIXELS];
    const cophase_input frame = cophase_input_from_array(frame_e, COPHASE_F64, 1, PIXELS, PIXELS);
    const cophase_session_options options = {
        .struct_size = sizeof options, .device = "cpu", .precision = COPHASE_F32, .threads = 1};
    cophase_fit_options fit = {.struct_size = sizeof fit, .deadline_s = 1.0};
    cophase_model *model;
    cophase_model_info info;
    cophase_session *session;
    cophase_sequence *sequence;
    cophase_sequence_report running;
    cophase_image_report report;
    double *truth_nm, *found_nm, single_nm = 0.0, running_nm;
    size_t i;

    must(cophase_model_create(scene, NULL, NULL, &model));
    must(cophase_model_get_info(model, &info, sizeof info));
    must(cophase_session_create(model, &options, &session));
    must(cophase_sequence_create(model, FRAMES, &sequence));
    truth_nm = numbers(info.modes);
    found_nm = numbers(info.modes);

    /* In place of a camera: frames of a million electrons; the pistons are 40 nm RMS. */
    for (i = 0; i < info.segment_modes; i++)
        truth_nm[i] = 57 * sin(4.0 * i);
    must(cophase_model_psf(model, truth_nm, info.modes, psf, PIXELS * PIXELS));

    for (i = 0; i < FRAMES; i++) {
        expose(psf, PIXELS * PIXELS, 1e6, 10, frame_e);
        must(cophase_session_fit(session, &frame, 1, &fit, found_nm, NULL, info.modes, &report, sizeof report,
                                 NULL, 0));
        if (report.status == COPHASE_IMAGE_OK)
            must(cophase_sequence_push(sequence, session));
        single_nm += error_nm(found_nm, truth_nm, info.segment_modes) / FRAMES;
    }

    must(cophase_sequence_estimate(sequence, found_nm, NULL, NULL, info.modes, &running, sizeof running));
    running_nm = error_nm(found_nm, truth_nm, info.segment_modes);
    printf("%zu of %zu frames used\n", running.used, running.images);
    printf("phasing: %.2f ± %.2f nm\n", running.phasing_rms_nm, running.phasing_sigma_nm);
    printf("NCPA: %.2f ± %.2f nm\n", running.ncpa_rms_nm, running.ncpa_sigma_nm);
    printf("error of the pistons: one frame %.2f nm, running estimate %.2f nm\n", single_nm, running_nm);

    fit.deadline_s = 1e-3;
    must(cophase_session_fit(session, &frame, 1, &fit, found_nm, NULL, info.modes, &report, sizeof report,
                             NULL, 0));
    printf("%s after %llu evaluations\n", cophase_status_name(report.status), (unsigned long long)report.evaluations);

    cophase_sequence_destroy(sequence);
    cophase_session_destroy(session);
    cophase_model_destroy(model);
    free(found_nm);
    free(truth_nm);
    return running_nm < 0.5 * single_nm ? 0 : 1;
}
