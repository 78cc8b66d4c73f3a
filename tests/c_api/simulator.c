/* The simulator through the public header alone. Compiled as C99 and as C++17, and run, by tests/c_api/main.rs:
 *
 *   simulator SCENE.toml FRAMES DUMP
 *
 * Every misuse that can be provoked must be answered by its status and a sentence, and write nothing. DUMP receives what
 * the simulator showed after FRAMES frames, for the comparison with Rust: slopes, commands, residual, image, truth, each
 * in C order. */
#include <cophase.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int failures;

#define CHECK(condition)                                                                   \
    do {                                                                                   \
        if (!(condition)) {                                                                \
            char sentence[256];                                                            \
            cophase_last_error(sentence, sizeof sentence);                                 \
            fprintf(stderr, "%s:%d: %s\n  last error: %s\n", __FILE__, __LINE__, #condition, sentence); \
            failures++;                                                                    \
        }                                                                                  \
    } while (0)

/* What an output holds that nobody has written to. */
static const float UNTOUCHED = -12345.0f;

static float *floats(size_t count)
{
    float *memory = (float *)malloc(count * sizeof(float));
    size_t i;

    if (memory == NULL)
        exit(2);
    for (i = 0; i < count; i++)
        memory[i] = UNTOUCHED;
    return memory;
}

/* A stack in C order. */
static cophase_array_f32 c_order(float *data, size_t count, size_t rows, size_t cols)
{
    cophase_array_f32 array;

    array.data = data;
    array.count = count;
    array.rows = rows;
    array.cols = cols;
    array.count_stride = (ptrdiff_t)(rows * cols);
    array.row_stride = (ptrdiff_t)cols;
    array.col_stride = 1;
    return array;
}

/* The text of a file, which the caller frees. */
static char *text_of(const char *path)
{
    FILE *file = fopen(path, "rb");
    char *text = (char *)calloc(1, 65536);

    if (file == NULL || text == NULL || fread(text, 1, 65535, file) == 0)
        exit(2);
    fclose(file);
    return text;
}

static int last_error_says(const char *part)
{
    char sentence[1024];

    cophase_last_error(sentence, sizeof sentence);
    return strstr(sentence, part) != NULL;
}

static void without_a_simulator(const char *scene)
{
    cophase_simulator *simulator = NULL;
    cophase_simulator *const before = (cophase_simulator *)(void *)&simulator;
    const char *preset = NULL;
    char little[8];
    size_t length, size = 7;
    uint64_t frames = 7;
    double number = 7.0;
    float value = UNTOUCHED;
    cophase_array_f32 array = c_order(&value, 1, 1, 1);

    CHECK(cophase_last_error(NULL, 0) == 0);
    CHECK(cophase_abi_version() == COPHASE_ABI_VERSION);
    CHECK(strcmp(cophase_status_name(COPHASE_PANIC), "PANIC") == 0);

    simulator = before;
    CHECK(cophase_simulator_create("[pupil]\napertur = 3\n", NULL, &simulator) == COPHASE_BAD_SCENE);
    CHECK(simulator == before);
    CHECK(last_error_says("apertur"));
    /* snprintf's contract: the whole length, as much as fits, always a zero. */
    memset(little, 'x', sizeof little);
    length = cophase_last_error(NULL, 0);
    CHECK(length > sizeof little);
    CHECK(cophase_last_error(little, 5) == length);
    CHECK(strlen(little) == 4 && little[5] == 'x');
    CHECK(cophase_last_error(little, 0) == length && strlen(little) == 4);

    CHECK(cophase_simulator_create(NULL, NULL, &simulator) == COPHASE_BAD_ARGUMENT);
    CHECK(last_error_says("scene_text is NULL"));
    CHECK(cophase_simulator_create("\xff", NULL, &simulator) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_create(scene, "\xc3(", &simulator) == COPHASE_BAD_ARGUMENT);
    CHECK(last_error_says("directory"));
    CHECK(cophase_simulator_create("", NULL, &simulator) == COPHASE_BAD_SCENE);
    CHECK(simulator == before);
    CHECK(cophase_simulator_create(scene, NULL, NULL) == COPHASE_BAD_ARGUMENT);

    CHECK(cophase_scene_preset("keck-onsky", &preset) == COPHASE_OK);
    CHECK(preset != NULL && strstr(preset, "[wavefront_sensor]") != NULL);
    CHECK(cophase_scene_preset("keck-onsy", &preset) == COPHASE_BAD_SCENE);
    CHECK(last_error_says("keck-onsky"));
    CHECK(cophase_scene_preset(NULL, &preset) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_scene_preset("keck-onsky", NULL) == COPHASE_BAD_ARGUMENT);
    /* A scene of an artificial source has no loop to close. */
    CHECK(cophase_scene_preset("keck-artificial", &preset) == COPHASE_OK);
    CHECK(cophase_simulator_create(preset, NULL, &simulator) == COPHASE_BAD_SCENE);
    CHECK(last_error_says("wavefront_sensor"));

    cophase_simulator_destroy(NULL);
    CHECK(cophase_simulator_step(NULL, 1) == COPHASE_BAD_ARGUMENT);
    CHECK(last_error_says("simulator is NULL"));
    CHECK(cophase_simulator_frames(NULL, &frames) == COPHASE_BAD_ARGUMENT && frames == 7);
    CHECK(cophase_simulator_frame_s(NULL, &number) == COPHASE_BAD_ARGUMENT && number == 7.0);
    CHECK(cophase_simulator_divergence_s(NULL, &number) == COPHASE_BAD_ARGUMENT && number == 7.0);
    CHECK(cophase_simulator_residual_rms_nm(NULL, &number) == COPHASE_BAD_ARGUMENT && number == 7.0);
    CHECK(cophase_simulator_slope_count(NULL, &size) == COPHASE_BAD_ARGUMENT && size == 7);
    CHECK(cophase_simulator_actuator_count(NULL, &size) == COPHASE_BAD_ARGUMENT && size == 7);
    CHECK(cophase_simulator_residual_samples(NULL, &size) == COPHASE_BAD_ARGUMENT && size == 7);
    CHECK(cophase_simulator_image_shape(NULL, &size, &size) == COPHASE_BAD_ARGUMENT && size == 7);
    CHECK(cophase_simulator_truth_samples(NULL, &size) == COPHASE_BAD_ARGUMENT && size == 7);
    CHECK(cophase_simulator_slopes_mas(NULL, &value, 1) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_commands_nm(NULL, &value, 1) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_residual_nm(NULL, &array) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_image_e(NULL, &array) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_truth_nm(NULL, &array) == COPHASE_BAD_ARGUMENT);
    CHECK(value == UNTOUCHED);
}

/* What asks for a frame before there is one. */
static void before_the_first_frame(cophase_simulator *simulator, size_t slopes, size_t samples, size_t rows,
                                   size_t cols)
{
    float *memory = floats(slopes + samples * samples + rows * cols);
    cophase_array_f32 residual = c_order(memory, 1, samples, samples);
    cophase_array_f32 image = c_order(memory, 1, rows, cols);
    double number = 7.0;

    CHECK(cophase_simulator_slopes_mas(simulator, memory, slopes) == COPHASE_BAD_VALUE);
    CHECK(last_error_says("step first"));
    CHECK(cophase_simulator_residual_nm(simulator, &residual) == COPHASE_BAD_VALUE);
    CHECK(cophase_simulator_image_e(simulator, &image) == COPHASE_BAD_VALUE);
    CHECK(cophase_simulator_residual_rms_nm(simulator, &number) == COPHASE_BAD_VALUE && number == 7.0);
    CHECK(memory[0] == UNTOUCHED);
    free(memory);
}

static void bad_outputs(cophase_simulator *simulator, size_t slopes, size_t actuators, size_t rows, size_t cols)
{
    float *memory = floats(slopes + actuators + rows * cols + 1);
    const cophase_array_f32 good = c_order(memory, 1, rows, cols);
    cophase_array_f32 bad;

    CHECK(cophase_simulator_slopes_mas(simulator, memory, slopes - 1) == COPHASE_BAD_SHAPE);
    CHECK(last_error_says("values are accepted"));
    CHECK(cophase_simulator_slopes_mas(simulator, memory, (size_t)-1) == COPHASE_BAD_SHAPE);
    CHECK(cophase_simulator_slopes_mas(simulator, NULL, slopes) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_slopes_mas(simulator, (float *)((char *)memory + 1), slopes) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_commands_nm(simulator, memory, 0) == COPHASE_BAD_SHAPE);
    CHECK(cophase_simulator_commands_nm(simulator, NULL, actuators) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_frames(simulator, NULL) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_residual_rms_nm(simulator, NULL) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_image_shape(simulator, NULL, &cols) == COPHASE_BAD_ARGUMENT);
    CHECK(cophase_simulator_image_shape(simulator, &rows, NULL) == COPHASE_BAD_ARGUMENT);

    CHECK(cophase_simulator_image_e(simulator, NULL) == COPHASE_BAD_ARGUMENT);
    bad = good, bad.data = NULL;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_ARGUMENT);
    CHECK(last_error_says("out->data"));
    bad = good, bad.data = (float *)((char *)memory + 2);
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_ARGUMENT);
    bad = good, bad.count = 0;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_SHAPE);
    bad = good, bad.rows = rows + 1;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_SHAPE);
    bad = good, bad.cols = (size_t)-1;
    CHECK(cophase_simulator_residual_nm(simulator, &bad) == COPHASE_BAD_SHAPE);
    CHECK(cophase_simulator_truth_nm(simulator, &good) == COPHASE_BAD_SHAPE);
    bad = good, bad.row_stride = 0;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_ARGUMENT);
    CHECK(last_error_says("overlap"));
    bad = good, bad.row_stride = 1 - (ptrdiff_t)cols;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_ARGUMENT);
    bad = good, bad.row_stride = PTRDIFF_MAX;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_ARGUMENT);
    bad = good, bad.row_stride = PTRDIFF_MIN;
    CHECK(cophase_simulator_image_e(simulator, &bad) == COPHASE_BAD_ARGUMENT);
    CHECK(last_error_says("address space"));
    CHECK(memory[0] == UNTOUCHED && memory[slopes] == UNTOUCHED);
    free(memory);
}

/* The same image, turned over, in columns, and in every other element of a larger array. */
static void strides(cophase_simulator *simulator, const float *image, size_t rows, size_t cols)
{
    const size_t count = rows * cols;
    float *memory = floats(4 * count);
    cophase_array_f32 out = c_order(memory, 1, rows, cols);
    size_t x, y, untouched = 0;

    out.data = memory + count - 1;
    out.row_stride = -(ptrdiff_t)cols;
    out.col_stride = -1;
    CHECK(cophase_simulator_image_e(simulator, &out) == COPHASE_OK);
    for (y = 0; y < rows; y++)
        for (x = 0; x < cols; x++)
            CHECK(memory[count - 1 - (y * cols + x)] == image[y * cols + x]);

    out.data = memory;
    out.row_stride = 1;
    out.col_stride = (ptrdiff_t)rows;
    CHECK(cophase_simulator_image_e(simulator, &out) == COPHASE_OK);
    for (y = 0; y < rows; y++)
        for (x = 0; x < cols; x++)
            CHECK(memory[x * rows + y] == image[y * cols + x]);
    CHECK(memory[1] != image[1] && memory[count] == UNTOUCHED);

    for (x = 0; x < count; x++)
        memory[x] = UNTOUCHED;
    out.row_stride = (ptrdiff_t)(4 * cols);
    out.col_stride = 2;
    CHECK(cophase_simulator_image_e(simulator, &out) == COPHASE_OK);
    for (y = 0; y < 2 * rows; y++)
        for (x = 0; x < 2 * cols; x++) {
            if (x % 2 == 0 && y % 2 == 0)
                CHECK(memory[y * 2 * cols + x] == image[y / 2 * cols + x / 2]);
            else
                untouched += memory[y * 2 * cols + x] == UNTOUCHED;
        }
    CHECK(untouched == 3 * count);
    free(memory);
}

int main(int argc, char **argv)
{
    cophase_simulator *simulator = NULL;
    size_t slopes = 0, actuators = 0, samples = 0, rows = 0, cols = 0, maps = 0, total;
    uint64_t wanted, frames = 7;
    double rms_nm = 0.0, frame_s = 0.0, divergence_s = 0.0;
    float *all, *commands, *residual, *image, *truth;
    cophase_array_f32 residual_out, image_out, truth_out;
    char *scene;
    FILE *dump;

    if (argc != 4)
        return 2;
    scene = text_of(argv[1]);
    wanted = (uint64_t)strtoul(argv[2], NULL, 10);
    without_a_simulator(scene);

    CHECK(cophase_simulator_create(scene, NULL, &simulator) == COPHASE_OK);
    free(scene); /* it was copied */
    if (simulator == NULL)
        return 1;
    CHECK(cophase_simulator_slope_count(simulator, &slopes) == COPHASE_OK);
    CHECK(cophase_simulator_actuator_count(simulator, &actuators) == COPHASE_OK);
    CHECK(cophase_simulator_residual_samples(simulator, &samples) == COPHASE_OK);
    CHECK(cophase_simulator_image_shape(simulator, &rows, &cols) == COPHASE_OK);
    CHECK(cophase_simulator_truth_samples(simulator, &maps) == COPHASE_OK);
    CHECK(samples == 80 && rows == 40 && cols == 48 && maps == 60);
    CHECK(cophase_simulator_frames(simulator, &frames) == COPHASE_OK && frames == 0);
    before_the_first_frame(simulator, slopes, samples, rows, cols);

    CHECK(cophase_simulator_step(simulator, 0) == COPHASE_OK);
    CHECK(cophase_simulator_step(simulator, 1) == COPHASE_OK);
    CHECK(cophase_simulator_step(simulator, wanted - 1) == COPHASE_OK);
    CHECK(cophase_simulator_frames(simulator, &frames) == COPHASE_OK && frames == wanted);
    CHECK(cophase_simulator_frame_s(simulator, &frame_s) == COPHASE_OK && frame_s == 1.0 / 1054.0);
    CHECK(cophase_simulator_residual_rms_nm(simulator, &rms_nm) == COPHASE_OK && rms_nm > 0.0);
    CHECK(cophase_simulator_divergence_s(simulator, &divergence_s) == COPHASE_OK);
    CHECK(divergence_s != divergence_s);
    bad_outputs(simulator, slopes, actuators, rows, cols);

    total = slopes + actuators + samples * samples + rows * cols + 2 * maps * maps;
    all = floats(total);
    commands = all + slopes;
    residual = commands + actuators;
    image = residual + samples * samples;
    truth = image + rows * cols;
    residual_out = c_order(residual, 1, samples, samples);
    image_out = c_order(image, 1, rows, cols);
    truth_out = c_order(truth, 2, maps, maps);
    CHECK(cophase_simulator_slopes_mas(simulator, all, slopes) == COPHASE_OK);
    CHECK(cophase_simulator_commands_nm(simulator, commands, actuators) == COPHASE_OK);
    CHECK(cophase_simulator_residual_nm(simulator, &residual_out) == COPHASE_OK);
    CHECK(cophase_simulator_image_e(simulator, &image_out) == COPHASE_OK);
    CHECK(cophase_simulator_truth_nm(simulator, &truth_out) == COPHASE_OK);
    strides(simulator, image, rows, cols);
    cophase_simulator_destroy(simulator);

    dump = fopen(argv[3], "wb");
    CHECK(dump != NULL && fwrite(all, sizeof(float), total, dump) == total && fclose(dump) == 0);
    free(all);
    return failures == 0 ? 0 : 1;
}
