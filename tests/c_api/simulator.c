/* The simulator through the public headers alone; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   simulator SCENE.toml FRAMES DUMP
 *
 * Every misuse that can be provoked must be answered by its status and a sentence, and write nothing. DUMP receives, as
 * floats for the comparison with Rust, the arrays after FRAMES frames: slopes, commands, residual, image, truth, each in C
 * order. */
#include "support.h"
#include <cophase_simulator.h>

static void without_a_simulator(const char *scene)
{
    cophase_simulator *simulator = NULL;
    cophase_simulator *const before = (cophase_simulator *)(void *)&simulator;
    cophase_simulator_info info;
    const char *preset = NULL;
    char little[8];
    double value = UNTOUCHED;
    size_t length;

    CHECK(cophase_last_error(NULL, 0) == 0);
    CHECK(cophase_abi_version() == COPHASE_ABI_VERSION);
    simulator = before;
    REFUSED(COPHASE_BAD_SCENE, "apertur", cophase_simulator_create("[pupil]\napertur = 3\n", NULL, &simulator));
    /* As with snprintf: the whole length, as much as fits, always a zero. */
    memset(little, 'x', sizeof little);
    length = cophase_last_error(NULL, 0);
    CHECK(length > sizeof little);
    CHECK(cophase_last_error(little, 5) == length);
    CHECK(strlen(little) == 4 && little[5] == 'x');
    CHECK(cophase_last_error(little, 0) == length && strlen(little) == 4);

    REFUSED(COPHASE_BAD_ARGUMENT, "scene_text is NULL", cophase_simulator_create(NULL, NULL, &simulator));
    REFUSED(COPHASE_BAD_ARGUMENT, "scene_text", cophase_simulator_create("\xff", NULL, &simulator));
    REFUSED(COPHASE_BAD_ARGUMENT, "directory", cophase_simulator_create(scene, "\xc3(", &simulator));
    REFUSED(COPHASE_BAD_SCENE, "", cophase_simulator_create("", NULL, &simulator));
    REFUSED(COPHASE_BAD_ARGUMENT, "simulator", cophase_simulator_create(scene, NULL, NULL));
    /* A scene of an artificial source has no loop to close. */
    CHECK(cophase_scene_preset("keck-artificial", &preset) == COPHASE_OK);
    REFUSED(COPHASE_BAD_SCENE, "wavefront_sensor", cophase_simulator_create(preset, NULL, &simulator));
    CHECK(simulator == before);

    cophase_simulator_destroy(NULL);
    REFUSED(COPHASE_BAD_ARGUMENT, "simulator is NULL", cophase_simulator_step(NULL, 1));
    REFUSED(COPHASE_BAD_ARGUMENT, "simulator is NULL", cophase_simulator_get_info(NULL, &info, sizeof info));
    REFUSED(COPHASE_BAD_ARGUMENT, "simulator is NULL", cophase_simulator_array(NULL, COPHASE_ARRAY_IMAGE_E, &value, 1));
    CHECK(value == UNTOUCHED);
}

/* Arrays before the first frame, or with outputs that cannot be. */
static void refusals(cophase_simulator *simulator, const cophase_simulator_info *info)
{
    const size_t pixels = info->rows * info->cols;
    double *memory = doubles(pixels + info->slopes);
    double *odd = (double *)(void *)((char *)memory + 1);

    REFUSED(COPHASE_BAD_VALUE, "step first", cophase_simulator_array(simulator, COPHASE_ARRAY_SLOPES_MAS, memory, info->slopes));
    REFUSED(COPHASE_BAD_VALUE, "step first", cophase_simulator_array(simulator, COPHASE_ARRAY_COMMANDS_NM, memory, 1));
    REFUSED(COPHASE_BAD_VALUE, "step first", cophase_simulator_array(simulator, COPHASE_ARRAY_RESIDUAL_NM, memory, 1));
    REFUSED(COPHASE_BAD_VALUE, "step first", cophase_simulator_array(simulator, COPHASE_ARRAY_IMAGE_E, memory, pixels));
    CHECK(cophase_simulator_step(simulator, 0) == COPHASE_OK);
    CHECK(cophase_simulator_step(simulator, 1) == COPHASE_OK);
    REFUSED(COPHASE_BAD_SHAPE, "is accepted", cophase_simulator_array(simulator, COPHASE_ARRAY_SLOPES_MAS, memory, info->slopes - 1));
    REFUSED(COPHASE_BAD_SHAPE, "count", cophase_simulator_array(simulator, COPHASE_ARRAY_SLOPES_MAS, memory, (size_t)-1));
    REFUSED(COPHASE_BAD_SHAPE, "1920 is accepted (40 x 48)", cophase_simulator_array(simulator, COPHASE_ARRAY_IMAGE_E, memory, 0));
    REFUSED(COPHASE_BAD_SHAPE, "(2 x 60 x 60)", cophase_simulator_array(simulator, COPHASE_ARRAY_TRUTH_NM, memory, 3600));
    REFUSED(COPHASE_BAD_ARGUMENT, "out is NULL", cophase_simulator_array(simulator, COPHASE_ARRAY_IMAGE_E, NULL, pixels));
    REFUSED(COPHASE_BAD_ARGUMENT, "that 8 divides", cophase_simulator_array(simulator, COPHASE_ARRAY_IMAGE_E, odd, pixels));
    REFUSED(COPHASE_BAD_VALUE, "what is 1:", cophase_simulator_array(simulator, COPHASE_ARRAY_COEFFICIENTS_NM, memory, 1));
    REFUSED(COPHASE_BAD_ARGUMENT, "info", cophase_simulator_get_info(simulator, NULL, sizeof *info));
    CHECK(untouched(memory, pixels + info->slopes) == pixels + info->slopes);
    free(memory);
}

/* What to know before using the images: nothing with this scene, one sentence with fewer samples. */
static void warnings(const cophase_simulator *simulator, const char *scene)
{
    const char *const key = "wavefront_sensor.samples_per_lenslet";
    cophase_simulator *coarse = NULL;
    char sentence[512], changed[4096];
    size_t length = 7;

    REFUSED(COPHASE_BAD_VALUE, "what is 4:", cophase_simulator_text(simulator, COPHASE_TEXT_DEVICE, sentence, sizeof sentence, &length));
    REFUSED(COPHASE_BAD_ARGUMENT, "simulator is NULL", cophase_simulator_text(NULL, COPHASE_TEXT_WARNINGS, NULL, 0, &length));
    CHECK(length == 7);
    CHECK(cophase_simulator_text(simulator, COPHASE_TEXT_WARNINGS, sentence, sizeof sentence, &length) == COPHASE_OK);
    CHECK(length == 0 && sentence[0] == '\0');
    CHECK(cophase_scene_set(scene, key, "6", changed, sizeof changed, &length) == COPHASE_OK && length < sizeof changed);
    CHECK(cophase_simulator_create(changed, NULL, &coarse) == COPHASE_OK);
    CHECK(cophase_simulator_text(coarse, COPHASE_TEXT_WARNINGS, sentence, sizeof sentence, &length) == COPHASE_OK);
    CHECK(length > 0 && length < sizeof sentence && strstr(sentence, "60 samples across") == sentence);
    CHECK(strstr(sentence, key) != NULL && strchr(sentence, '\n') == NULL);
    cophase_simulator_destroy(coarse);
}

static void dump_array(cophase_simulator *simulator, int32_t what, size_t count, FILE *file)
{
    double *values = doubles(count);
    size_t i;

    CHECK(cophase_simulator_array(simulator, what, values, count) == COPHASE_OK);
    for (i = 0; i < count; i++) {
        const float value = (float)values[i];

        if (fwrite(&value, sizeof value, 1, file) != 1)
            exit(2);
    }
    free(values);
}

int main(int argc, char **argv)
{
    cophase_simulator *simulator = NULL;
    cophase_simulator_info info;
    uint64_t frames;
    size_t size;
    char *scene;
    FILE *file;

    if (argc != 4 || (file = fopen(argv[3], "wb")) == NULL)
        return 2;
    scene = read_file(argv[1], &size);
    frames = (uint64_t)strtoul(argv[2], NULL, 10);
    without_a_simulator(scene);

    CHECK(cophase_simulator_create(scene, NULL, &simulator) == COPHASE_OK);
    if (simulator == NULL)
        return 1;
    warnings(simulator, scene);
    free(scene); /* it was copied */
    CHECK(cophase_simulator_get_info(simulator, &info, sizeof info) == COPHASE_OK);
    CHECK(info.residual_samples == 80 && info.rows == 40 && info.cols == 48 && info.truth_samples == 60);
    CHECK(info.frames == 0 && info.residual_rms_nm != info.residual_rms_nm);
    refusals(simulator, &info);
    CHECK(cophase_simulator_step(simulator, frames - 1) == COPHASE_OK);
    CHECK(cophase_simulator_get_info(simulator, &info, sizeof info) == COPHASE_OK);
    CHECK(info.frames == frames && info.frame_s == 1.0 / 1054.0);
    CHECK(info.residual_rms_nm > 0.0 && info.divergence_s != info.divergence_s);

    dump_array(simulator, COPHASE_ARRAY_SLOPES_MAS, info.slopes, file);
    dump_array(simulator, COPHASE_ARRAY_COMMANDS_NM, info.actuators, file);
    dump_array(simulator, COPHASE_ARRAY_RESIDUAL_NM, info.residual_samples * info.residual_samples, file);
    dump_array(simulator, COPHASE_ARRAY_IMAGE_E, info.rows * info.cols, file);
    dump_array(simulator, COPHASE_ARRAY_TRUTH_NM, 2 * info.truth_samples * info.truth_samples, file);
    cophase_simulator_destroy(simulator);
    return fclose(file) == 0 && failures == 0 ? 0 : 1;
}
