/* One frame of each channel, and their combination, by the calls of a session of several channels:
 *
 *   joint_session SCENE.toml FRAMES.raw ROWS COLS
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
static char *text_of(const cophase_joint_session *session, int32_t what, size_t index)
{
    size_t length = 0;
    char *text;

    must(cophase_joint_session_text(session, what, index, NULL, 0, &length));
    text = (char *)memory(length + 1, 1);
    must(cophase_joint_session_text(session, what, index, text, length + 1, &length));
    return text;
}

static void print_joint(const cophase_joint_report *report)
{
    printf("joint %s %d %016" PRIx64 " %016" PRIx64, cophase_status_name(report->status), (int)report->is_contradictory,
           bits(report->reduced_chi2), bits(report->freedom));
}

/* What it refuses. */
static void refuses(cophase_joint_session *session, const cophase_input *frames, double *numbers, size_t modes)
{
    cophase_input wrong[2];
    cophase_joint_session *none = NULL;
    const char *preset;
    size_t length;

    REFUSED(COPHASE_BAD_VALUE, "fit them first", cophase_joint_session_refine(session, numbers, NULL, modes, NULL, 0));
    REFUSED(COPHASE_BAD_SHAPE, "channels is 1: 2",
            cophase_joint_session_fit(session, frames, 1, NULL, numbers, NULL, modes, NULL, 0, NULL, 0));
    wrong[0] = frames[0], wrong[1] = frames[1];
    wrong[1].cols -= 1;
    REFUSED(COPHASE_BAD_SHAPE, "channel ",
            cophase_joint_session_fit(session, wrong, 2, NULL, numbers, NULL, modes, NULL, 0, NULL, 0));
    REFUSED(COPHASE_BAD_VALUE, "channel 7 does not exist", cophase_joint_session_calibrate(session, 7, NULL));
    REFUSED(COPHASE_BAD_VALUE, "index is 2",
            cophase_joint_session_text(session, COPHASE_TEXT_CHANNEL_NAME, 2, NULL, 0, &length));
    REFUSED(COPHASE_BAD_ARGUMENT, "session is NULL", cophase_joint_session_cancel(NULL));
    must(cophase_joint_session_cancel(session));
    REFUSED(COPHASE_INTERRUPTED, "cancelled",
            cophase_joint_session_fit(session, frames, 2, NULL, numbers, NULL, modes, NULL, 0, NULL, 0));
    must(cophase_scene_preset("keck-artificial", &preset));
    REFUSED(COPHASE_BAD_SCENE, "[[image.channel]]", cophase_joint_session_create(preset, NULL, NULL, &none));
    CHECK(none == NULL);
}

int main(int argc, char **argv)
{
    cophase_joint_session *session = NULL;
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_model *model = NULL;
    cophase_model_info info;
    cophase_joint_report report;
    cophase_image_report *images;
    cophase_input *frames;
    double *coefficients_nm, *sigma_nm, *covariance_nm2;
    size_t size, rows, cols, channels, i;
    char *scene, *bytes, *text, *line, **names;

    if (argc != 5)
        return 2;
    rows = strtoul(argv[3], NULL, 10), cols = strtoul(argv[4], NULL, 10);
    scene = read_file(argv[1], &size);
    bytes = read_file(argv[2], &size);
    options.device = "cpu";
    must(cophase_joint_session_create(scene, NULL, &options, &session));
    must(cophase_joint_session_channels(session, &channels));
    if (size != channels * rows * cols * sizeof(double))
        return 2;
    must(cophase_joint_session_model(session, 0, &model));
    must(cophase_model_get_info(model, &info, sizeof info));
    CHECK(info.rows == rows && info.cols == cols);
    frames = (cophase_input *)memory(channels, sizeof *frames);
    images = (cophase_image_report *)memory(channels, sizeof *images);
    coefficients_nm = (double *)memory(info.modes, sizeof *coefficients_nm);
    sigma_nm = (double *)memory(info.modes, sizeof *sigma_nm);
    covariance_nm2 = (double *)memory(info.modes * info.modes, sizeof *covariance_nm2);
    names = (char **)memory(info.modes, sizeof *names);
    for (i = 0; i < info.modes; i++)
        must(cophase_model_mode_name(model, i, (const char **)&names[i]));
    for (i = 0; i < channels; i++) {
        frames[i] = input((double *)bytes + i * rows * cols, COPHASE_F64, 1, rows, cols);
        printf("channel %s\n", text = text_of(session, COPHASE_TEXT_CHANNEL_NAME, i));
        free(text);
    }
    refuses(session, frames, coefficients_nm, info.modes);
    must(cophase_joint_session_fit(session, frames, channels, NULL, coefficients_nm, sigma_nm, info.modes, &report,
                                   sizeof report, images, sizeof *images));
    for (i = 0; i < info.modes; i++)
        printf("coefficient %s %016" PRIx64 " %016" PRIx64 "\n", names[i], bits(coefficients_nm[i]), bits(sigma_nm[i]));
    for (i = 0; i < channels; i++)
        printf("image %d %s %016" PRIx64 " %d %d\n", (int)i, cophase_status_name(images[i].status),
               bits(images[i].reduced_chi2), (int)images[i].is_used, (int)images[i].channel);
    print_joint(&report), printf("\n");
    text = text_of(session, COPHASE_TEXT_WARNINGS, 0);
    for (line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n"))
        printf("warning %s\n", line);
    free(text);
    must(cophase_joint_session_refine(session, coefficients_nm, covariance_nm2, info.modes, &report, sizeof report));
    for (i = 0; i < info.modes; i++)
        printf("refined %s %016" PRIx64 " %016" PRIx64 "\n", names[i], bits(coefficients_nm[i]),
               bits(covariance_nm2[i * info.modes + i]));
    print_joint(&report), printf(" %016" PRIx64 "\n", bits(report.piston_probability));
    printf("policy %s\n", text = text_of(session, COPHASE_TEXT_POLICY, 0));
    free(text), free(names), free(covariance_nm2), free(sigma_nm), free(coefficients_nm), free(images), free(frames);
    /* The model outlives its session. */
    cophase_joint_session_destroy(session);
    cophase_model_destroy(model);
    free(bytes), free(scene);
    return failures > 0;
}
