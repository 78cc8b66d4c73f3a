/* The whole pipeline on a file of raw doubles, printed for a comparison with the program and with Rust:
 *
 *   pipeline SCENE.toml FRAMES.raw COUNT ROWS COLS [SLOPES.raw SLOPES] [CHANNEL,CHANNEL]
 *
 * FRAMES.raw holds COUNT x ROWS x COLS native doubles in C order, electrons, NaN for a bad pixel; SLOPES.raw COUNT x SLOPES,
 * mas. For several channels both hold those of the COUNT images of each, one after the other. Files that the scene names are looked for
 * in the working directory. Prints lines of
 *
 *   coefficient NAME VALUE SIGMA         (nm)
 *   image INDEX STATUS CHI2 REJECTED CHANNEL
 *   channel NAME
 *   integer NUMBER PROBABILITY RUNNER_UP (nm)
 *   error NAME VALUE SIGMA TOLERANCE SIGNIFICANCE
 *   without PART RMS SIGMA               (nm, of phasing, ncpa and wavefront without staircases)
 *   without A B C D                      (nm, these maps and their error bars in one sample)
 *   warning SENTENCE
 *   policy NAME
 *   device TEXT
 *
 * All numbers but INDEX, REJECTED, CHANNEL and NUMBER are the bits of doubles, 16 hexadecimal digits: the same in every language.
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

/* A text of the estimate; the caller frees it. */
static char *text_of(const cophase_estimate *estimate, int32_t what, size_t index)
{
    size_t length = 0;
    char *text;

    must(cophase_estimate_text(estimate, what, index, NULL, 0, &length));
    text = (char *)memory(length + 1, 1);
    must(cophase_estimate_text(estimate, what, index, text, length + 1, &length));
    return text;
}

static void print_errors(const cophase_estimate *estimate, const cophase_estimate_info *info)
{
    double *numbers = doubles(4 * info->model_errors + 1);
    size_t i;

    if (info->model_errors > 0)
        must(cophase_estimate_array(estimate, COPHASE_ARRAY_MODEL_ERRORS, numbers, 4 * info->model_errors));
    for (i = 0; i < info->model_errors; i++) {
        char *name = text_of(estimate, COPHASE_TEXT_MODEL_ERROR_NAME, i);

        printf("error %s %016" PRIx64 " %016" PRIx64 " %016" PRIx64 " %016" PRIx64 "\n", name, bits(numbers[4 * i]),
               bits(numbers[4 * i + 1]), bits(numbers[4 * i + 2]), bits(numbers[4 * i + 3]));
        free(name);
    }
    free(numbers);
}

static void print_without_staircases(const cophase_estimate *estimate, size_t samples)
{
    static const char *const PARTS[] = {"phasing", "ncpa", "wavefront"};
    const size_t size = samples * samples, at = samples / 2 * samples + samples / 4;
    double figures[6], *maps = doubles(4 * size);
    size_t i;

    must(cophase_estimate_array(estimate, COPHASE_ARRAY_FIGURES_WITHOUT_STAIRCASES_NM, figures, 6));
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_MAPS_WITHOUT_STAIRCASES_NM, maps, 4 * size));
    for (i = 0; i < 3; i++)
        printf("without %s %016" PRIx64 " %016" PRIx64 "\n", PARTS[i], bits(figures[2 * i]), bits(figures[2 * i + 1]));
    printf("without %016" PRIx64 " %016" PRIx64 " %016" PRIx64 " %016" PRIx64 "\n", bits(maps[at]), bits(maps[size + at]),
           bits(maps[2 * size + at]), bits(maps[3 * size + at]));
    free(maps);
}

static void print(const cophase_estimate *estimate)
{
    cophase_estimate_info info;
    cophase_image_report *images;
    double *coefficients_nm, *sigma_nm, *integers;
    char *text, *line;
    size_t i;

    must(cophase_estimate_get_info(estimate, &info, sizeof info));
    coefficients_nm = doubles(info.modes), sigma_nm = doubles(info.modes);
    images = (cophase_image_report *)memory(info.images, sizeof *images);
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_COEFFICIENTS_NM, coefficients_nm, info.modes));
    must(cophase_estimate_array(estimate, COPHASE_ARRAY_SIGMA_NM, sigma_nm, info.modes));
    must(cophase_estimate_images(estimate, images, sizeof *images, info.images));
    for (i = 0; i < info.modes; i++) {
        text = text_of(estimate, COPHASE_TEXT_MODE_NAME, i);
        printf("coefficient %s %016" PRIx64 " %016" PRIx64 "\n", text, bits(coefficients_nm[i]), bits(sigma_nm[i]));
        free(text);
    }
    for (i = 0; i < info.images; i++)
        printf("image %d %s %016" PRIx64 " %d %d\n", (int)i, cophase_status_name(images[i].status),
               bits(images[i].reduced_chi2), (int)images[i].rejected_pixels, (int)images[i].channel);
    for (i = 0; i < info.channels; i++) {
        printf("channel %s\n", text = text_of(estimate, COPHASE_TEXT_CHANNEL_NAME, i));
        free(text);
    }
    integers = (double *)memory(3 * info.integers + 1, sizeof *integers);
    if (info.integers > 0)
        must(cophase_estimate_array(estimate, COPHASE_ARRAY_PISTON_INTEGERS, integers, 3 * info.integers));
    for (i = 0; i < info.integers; i++)
        printf("integer %d %016" PRIx64 " %016" PRIx64 "\n", (int)integers[3 * i], bits(integers[3 * i + 1]),
               bits(integers[3 * i + 2]));
    free(integers);
    print_errors(estimate, &info);
    if (info.has_maps_without_staircases)
        print_without_staircases(estimate, info.samples);
    text = text_of(estimate, COPHASE_TEXT_WARNINGS, 0);
    for (line = strtok(text, "\n"); line != NULL; line = strtok(NULL, "\n"))
        printf("warning %s\n", line);
    free(text);
    printf("policy %s\n", text = text_of(estimate, COPHASE_TEXT_POLICY, 0));
    free(text);
    printf("device %s\n", text = text_of(estimate, COPHASE_TEXT_DEVICE, 0));
    free(text), free(images), free(sigma_nm), free(coefficients_nm);
}

/* Estimate from `frames` and `slopes`, if any, of the first of the channels that `names` lists, which those of the others follow; of the
 * only channel, without a name, where `names` is NULL. */
static cophase_estimate *estimate_of(cophase_estimator *estimator, cophase_input frames, const cophase_input *slopes,
                                     char *names)
{
    cophase_input each[4], telemetry[4];
    cophase_channel_images channels[4];
    cophase_estimate *estimate = NULL;
    size_t count = 0;
    char *name;

    name = names == NULL ? NULL : strtok(names, ",");
    do {
        each[count] = frames;
        each[count].data = (const double *)frames.data + count * frames.count * frames.rows * frames.cols;
        channels[count].channel = name;
        channels[count].frames = &each[count];
        channels[count].options = NULL;
        channels[count].slopes_mas = NULL;
        if (slopes != NULL) {
            telemetry[count] = *slopes;
            telemetry[count].data = (const double *)slopes->data + count * slopes->rows * slopes->cols;
            channels[count].slopes_mas = &telemetry[count];
        }
        count++;
        name = name == NULL ? NULL : strtok(NULL, ",");
    } while (name != NULL && count < 4);
    must(cophase_estimator_estimate(estimator, channels, count, &estimate));
    return estimate;
}

int main(int argc, char **argv)
{
    cophase_estimator *estimator = NULL;
    cophase_estimate *estimate = NULL;
    cophase_input frames, slopes;
    size_t size, count, rows, cols;
    char *scene, *frame_bytes, *slope_bytes = NULL;

    if (argc < 6 || argc > 9)
        return 2;
    count = strtoul(argv[3], NULL, 10), rows = strtoul(argv[4], NULL, 10), cols = strtoul(argv[5], NULL, 10);
    scene = read_file(argv[1], &size);
    frame_bytes = read_file(argv[2], &size);
    if (size % (count * rows * cols * sizeof(double)) != 0)
        return 2;
    frames = slopes = input(frame_bytes, COPHASE_F64, count, rows, cols);
    if (argc >= 8) {
        slope_bytes = read_file(argv[6], &size);
        slopes = input(slope_bytes, COPHASE_F64, 1, count, strtoul(argv[7], NULL, 10));
        if (size % (slopes.rows * slopes.cols * sizeof(double)) != 0)
            return 2;
    }
    must(cophase_estimator_create(scene, NULL, NULL, &estimator));
    estimate = estimate_of(estimator, frames, argc >= 8 ? &slopes : NULL, argc % 2 == 1 ? argv[argc - 1] : NULL);
    cophase_estimator_destroy(estimator);
    print(estimate);
    cophase_estimate_destroy(estimate);
    free(slope_bytes), free(frame_bytes), free(scene);
    return 0;
}
