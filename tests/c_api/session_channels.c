/* One frame of each channel, and their combination, by a session of a model with several channels:
 *
 *   session_channels SCENE.toml FRAMES.raw ROWS COLS
 *
 * FRAMES.raw holds CHANNELS x ROWS x COLS native doubles in C order, electrons. Prints lines of
 *
 *   channel NAME
 *   coefficient NAME VALUE SIGMA    (nm)
 *   image INDEX STATUS CHI2 USED CHANNEL
 *   joint STATUS CONTRADICTORY CHI2 FREEDOM
 *   warning SENTENCE
 *   refined NAME VALUE VARIANCE     (nm, nm^2)
 *   joint STATUS CONTRADICTORY CHI2 FREEDOM PROBABILITY
 *   policy NAME
 *
 * VALUE, SIGMA, CHI2, FREEDOM, VARIANCE and PROBABILITY are the bits of doubles, 16 hexadecimal digits: the same in every language.
 */
#include "support.h"
#include <inttypes.h>

static void must(cophase_status status)
{
    char sentence[512];

    if (status == COPHASE_OK)
        return;
    cophase_last_error(sentence, sizeof sentence);
    fprintf(stderr, "%s: %s\n", cophase_status_name(status), sentence);
    exit(1);
}

static uint64_t bits(double value)
{
    uint64_t bits;

    memcpy(&bits, &value, sizeof bits);
    return bits;
}

/* A text of the session; the caller frees it. */
static char *text_of(const cophase_session *session, int32_t what, size_t index)
{
    size_t length = 0;
    char *text;

    must(cophase_session_text(session, what, index, NULL, 0, &length));
    text = (char *)memory(length + 1, 1);
    must(cophase_session_text(session, what, index, text, length + 1, &length));
    return text;
}

static void print_group(const cophase_group_report *report)
{
    printf("joint %s %d %016" PRIx64 " %016" PRIx64, cophase_status_name(report->status), (int)report->is_contradictory,
           bits(report->reduced_chi2), bits(report->freedom));
}

/* The fit of one group, of which no reports are wanted. */
static cophase_status fit(cophase_session *session, const cophase_input *frames, size_t channels, double *numbers,
                          size_t modes)
{
    return cophase_session_fit(session, frames, channels, NULL, numbers, NULL, modes, NULL, 0, NULL, 0);
}

/* What a model of several channels and its session refuse. */
static void refuses(const cophase_model *model, cophase_session *session, const cophase_input *frames, double *numbers,
                    size_t modes)
{
    cophase_input wrong[2];
    cophase_model *channel = NULL;
    cophase_sequence *sequence = NULL;
    size_t length;

    REFUSED(COPHASE_BAD_VALUE, "cophase_model_psf is of one channel", cophase_model_psf(model, numbers, modes, numbers, 1));
    REFUSED(COPHASE_BAD_VALUE, "channel 2 does not exist", cophase_model_channel(model, 2, NULL, &channel));
    REFUSED(COPHASE_BAD_VALUE, "a sequence is of one channel", cophase_sequence_create(model, 1, &sequence));
    CHECK(channel == NULL && sequence == NULL);
    must(cophase_model_channel(model, 0, NULL, &channel));
    must(cophase_sequence_create(channel, 1, &sequence));
    REFUSED(COPHASE_BAD_VALUE, "the session has 2 channels", cophase_sequence_push(sequence, session));
    cophase_sequence_destroy(sequence);
    cophase_model_destroy(channel);
    REFUSED(COPHASE_BAD_VALUE, "fit them first", cophase_session_refine(session, 0, numbers, NULL, modes, NULL, 0));
    REFUSED(COPHASE_BAD_SHAPE, "channels is 1: 2", fit(session, frames, 1, numbers, modes));
    wrong[0] = frames[0], wrong[1] = frames[1];
    wrong[1].cols -= 1;
    REFUSED(COPHASE_BAD_SHAPE, "channel H: ", fit(session, wrong, 2, numbers, modes));
    wrong[1] = frames[1], wrong[1].count = 2, wrong[1].count_stride = 0;
    REFUSED(COPHASE_BAD_SHAPE, "channel H: frames is 2 x", fit(session, wrong, 2, numbers, modes));
    REFUSED(COPHASE_BAD_VALUE, "channel 7 does not exist", cophase_session_calibrate(session, 7, NULL));
    REFUSED(COPHASE_BAD_VALUE, "index is 0",
            cophase_session_text(session, COPHASE_TEXT_IMAGE_MESSAGE, 0, NULL, 0, &length));
    must(cophase_session_cancel(session));
    REFUSED(COPHASE_INTERRUPTED, "cancelled", fit(session, frames, 2, numbers, modes));
}

/* Two groups in one call, in C order: each has the bits of a call of its own. */
static void batch(const cophase_model *model, cophase_session_options options, const cophase_input *frames,
                  const double *expected_nm, const double *expected_sigma_nm, size_t modes)
{
    cophase_session *session = NULL;
    cophase_input twice[2];
    cophase_image_report images[4];
    cophase_group_report groups[2];
    double *found_nm = (double *)memory(2 * modes, sizeof *found_nm), *sigma_nm = (double *)memory(2 * modes, sizeof *found_nm);
    size_t i;

    options.capacity = 2;
    must(cophase_session_create(model, &options, &session));
    for (i = 0; i < 2; i++)
        twice[i] = frames[i], twice[i].count = 2, twice[i].count_stride = 0;
    must(cophase_session_fit(session, twice, 2, NULL, found_nm, sigma_nm, modes, images, sizeof *images, groups,
                             sizeof *groups));
    for (i = 0; i < 2; i++) {
        CHECK(memcmp(found_nm + i * modes, expected_nm, modes * sizeof *found_nm) == 0);
        CHECK(memcmp(sigma_nm + i * modes, expected_sigma_nm, modes * sizeof *sigma_nm) == 0);
        CHECK(groups[i].reduced_chi2 == groups[0].reduced_chi2);
        CHECK(images[2 * i].channel == 0 && images[2 * i + 1].channel == 1);
        CHECK(images[2 * i + 1].flux_e == images[1].flux_e && images[1].flux_e != images[0].flux_e);
        free(text_of(session, COPHASE_TEXT_IMAGE_MESSAGE, 2 * i + 1));
    }
    cophase_session_destroy(session);
    free(sigma_nm), free(found_nm);
}

int main(int argc, char **argv)
{
    cophase_session *session = NULL;
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_model *model = NULL, *channel = NULL;
    cophase_model_info info, of_channel;
    cophase_group_report report;
    cophase_image_report *images;
    cophase_input *frames;
    double *coefficients_nm, *sigma_nm, *covariance_nm2;
    const char **names, *name;
    size_t size, rows, cols, i;
    char *scene, *bytes, *text, *line;

    if (argc != 5)
        return 2;
    rows = strtoul(argv[3], NULL, 10), cols = strtoul(argv[4], NULL, 10);
    scene = read_file(argv[1], &size);
    bytes = read_file(argv[2], &size);
    options.device = "cpu";
    must(cophase_model_create(scene, NULL, NULL, &model));
    must(cophase_session_create(model, &options, &session));
    must(cophase_model_get_info(model, &info, sizeof info));
    if (size != info.channels * rows * cols * sizeof(double))
        return 2;
    CHECK(info.rows == rows && info.cols == cols);
    frames = (cophase_input *)memory(info.channels, sizeof *frames);
    images = (cophase_image_report *)memory(info.channels, sizeof *images);
    coefficients_nm = (double *)memory(info.modes, sizeof *coefficients_nm);
    sigma_nm = (double *)memory(info.modes, sizeof *sigma_nm);
    covariance_nm2 = (double *)memory(info.modes * info.modes, sizeof *covariance_nm2);
    names = (const char **)memory(info.modes, sizeof *names);
    for (i = 0; i < info.modes; i++)
        must(cophase_model_mode_name(model, i, &names[i]));
    for (i = 0; i < info.channels; i++) {
        frames[i] = input((double *)bytes + i * rows * cols, COPHASE_F64, 1, rows, cols);
        must(cophase_model_channel(model, i, &name, &channel));
        printf("channel %s\n", name);
        must(cophase_model_get_info(channel, &of_channel, sizeof of_channel));
        CHECK(of_channel.channels == 1 && of_channel.modes == info.modes && of_channel.rows == rows);
        cophase_model_destroy(channel);
    }
    refuses(model, session, frames, coefficients_nm, info.modes);
    must(cophase_session_fit(session, frames, info.channels, NULL, coefficients_nm, sigma_nm, info.modes, images,
                             sizeof *images, &report, sizeof report));
    for (i = 0; i < info.modes; i++)
        printf("coefficient %s %016" PRIx64 " %016" PRIx64 "\n", names[i], bits(coefficients_nm[i]), bits(sigma_nm[i]));
    for (i = 0; i < info.channels; i++)
        printf("image %d %s %016" PRIx64 " %d %d\n", (int)i, cophase_status_name(images[i].status),
               bits(images[i].reduced_chi2), (int)images[i].is_used, (int)images[i].channel);
    print_group(&report), printf("\n");
    text = text_of(session, COPHASE_TEXT_WARNINGS, 0);
    for (line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n"))
        printf("warning %s\n", line);
    free(text);
    batch(model, options, frames, coefficients_nm, sigma_nm, info.modes);
    must(cophase_session_refine(session, 0, coefficients_nm, covariance_nm2, info.modes, &report, sizeof report));
    for (i = 0; i < info.modes; i++)
        printf("refined %s %016" PRIx64 " %016" PRIx64 "\n", names[i], bits(coefficients_nm[i]),
               bits(covariance_nm2[i * info.modes + i]));
    print_group(&report), printf(" %016" PRIx64 "\n", bits(report.piston_probability));
    printf("policy %s\n", text = text_of(session, COPHASE_TEXT_POLICY, 0));
    free(text), free(names), free(covariance_nm2), free(sigma_nm), free(coefficients_nm), free(images), free(frames);
    /* The model outlives its session. */
    cophase_session_destroy(session);
    cophase_model_destroy(model);
    free(bytes), free(scene);
    return failures > 0;
}
