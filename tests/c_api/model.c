/* Devices and models through the public header alone; see tests/c_api/main.rs, which compiles and runs it:
 *
 *   model SCENE.toml DUMP
 *
 * DUMP receives what Rust must see too: coefficients, the wavefront of the segments and of the NCPA, the PSF. */
#include "frames.h"

static int ends_at(const char *text, size_t length)
{
    return strlen(text) == length;
}

static void devices(void)
{
    cophase_device *device = NULL;
    cophase_device *const before = (cophase_device *)(void *)&device;
    char text[8192], little[4];
    size_t length = 7, other = 7;

    CHECK(cophase_device_list(text, sizeof text, &length) == COPHASE_OK);
    CHECK(length < sizeof text && ends_at(text, length));
    CHECK(strncmp(text, "cpu\t", 4) == 0);
    /* snprintf's contract: the whole length, as much as fits, always a zero; none of it is needed. */
    memset(little, 'x', sizeof little);
    CHECK(cophase_device_list(little, 3, &other) == COPHASE_OK && other == length);
    CHECK(strcmp(little, "cp") == 0 && little[3] == 'x');
    CHECK(cophase_device_list(NULL, 0, &other) == COPHASE_OK && other == length);

    device = before;
    REFUSED(COPHASE_BAD_VALUE, "gpu", cophase_device_open("gpu", &device));
    REFUSED(COPHASE_DEVICE, "device", cophase_device_open("opencl:99:0", &device));
    REFUSED(COPHASE_BAD_ARGUMENT, "name", cophase_device_open("\xff", &device));
    CHECK(device == before);
    CHECK(cophase_device_open("cpu", &device) == COPHASE_OK);
    CHECK(cophase_device_name(device, text, sizeof text, &length) == COPHASE_OK);
    CHECK(length > 0 && ends_at(text, length));
    memset(little, 'x', sizeof little);
    CHECK(cophase_device_name(device, little, 2, &other) == COPHASE_OK && other == length);
    CHECK(little[0] == text[0] && little[1] == '\0' && little[2] == 'x');
    cophase_device_close(device);
    CHECK(cophase_device_open("auto", &device) == COPHASE_OK);
    cophase_device_close(device);
    cophase_device_close(NULL);
}

static void refused_scenes(const char *scene)
{
    cophase_model *model = NULL;
    cophase_model *const before = (cophase_model *)(void *)&model;

    model = before;
    REFUSED(COPHASE_BAD_SCENE, "apertur", cophase_model_create("[pupil]\napertur = 3\n", NULL, &model));
    REFUSED(COPHASE_BAD_SCENE, "", cophase_model_create("", NULL, &model));
    REFUSED(COPHASE_BAD_SCENE, "", cophase_model_create("[[[", NULL, &model));
    REFUSED(COPHASE_BAD_ARGUMENT, "scene_text", cophase_model_create("\xff", NULL, &model));
    REFUSED(COPHASE_BAD_ARGUMENT, "directory", cophase_model_create(scene, "\xff", &model));
    REFUSED(COPHASE_BAD_FILE, "no-such-modes.fits",
            cophase_model_create("[image]\nwavelength_nm = 2168.6\npixels = 48\n"
                                 "[modes]\nfile = \"no-such-modes.fits\"\n",
                                 "/nowhere", &model));
    CHECK(model == before);
}

/* What the model says of itself. */
static void facts(const cophase_model *model, size_t modes)
{
    const char *name = NULL, *again = NULL;
    size_t segment_modes = 0, rows = 0, cols = 0, samples = 0, pixels = 0, mode;

    CHECK(cophase_model_segment_mode_count(model, &segment_modes) == COPHASE_OK);
    CHECK(modes == 15 && segment_modes == 7);
    CHECK(cophase_model_frame_shape(model, &rows, &cols) == COPHASE_OK && rows == 48 && cols == 48);
    CHECK(cophase_model_samples(model, &samples) == COPHASE_OK && samples == 32);
    CHECK(cophase_model_pixels(model, &pixels) == COPHASE_OK && pixels == 48);
    for (mode = 0; mode < modes; mode++) {
        CHECK(cophase_model_mode_name(model, mode, &name) == COPHASE_OK && name != NULL && name[0] != '\0');
        CHECK(mode == 0 || strcmp(name, again) != 0);
        again = name;
    }
    CHECK(cophase_model_mode_name(model, 0, &name) == COPHASE_OK);
    CHECK(cophase_model_mode_name(model, 0, &again) == COPHASE_OK && name == again);
    REFUSED(COPHASE_BAD_VALUE, "15", cophase_model_mode_name(model, modes, &name));
    REFUSED(COPHASE_BAD_VALUE, "mode", cophase_model_mode_name(model, (size_t)-1, &name));
    CHECK(name == again);
}

/* The maps at `coefficients_nm`, written to the dump, and refused where they cannot be. */
static void maps(const cophase_model *model, const double *coefficients_nm, size_t modes, FILE *file)
{
    enum { SAMPLES = 32, PIXELS = 48, WAVEFRONT = 2 * SAMPLES * SAMPLES, PSF = PIXELS * PIXELS };
    float *memory = floats(WAVEFRONT + PSF + 1);
    float *turned = floats(PSF);
    cophase_array_f32 wavefront = output(memory, 2, SAMPLES, SAMPLES);
    cophase_array_f32 psf = output(memory + WAVEFRONT, 1, PIXELS, PIXELS);
    cophase_array_f32 bad;
    double sum = 0.0, value;
    size_t i, lit = 0;

    REFUSED(COPHASE_BAD_SHAPE, "15", cophase_model_psf(model, coefficients_nm, modes - 1, &psf));
    REFUSED(COPHASE_BAD_SHAPE, "15", cophase_model_wavefront_nm(model, coefficients_nm, (size_t)-1, &wavefront));
    bad = wavefront, bad.count = 1;
    REFUSED(COPHASE_BAD_SHAPE, "2 x 32 x 32", cophase_model_wavefront_nm(model, coefficients_nm, modes, &bad));
    bad = psf, bad.rows = (size_t)-1, bad.cols = (size_t)-1;
    REFUSED(COPHASE_BAD_SHAPE, "1 x 48 x 48", cophase_model_psf(model, coefficients_nm, modes, &bad));
    bad = psf, bad.row_stride = 0;
    REFUSED(COPHASE_BAD_ARGUMENT, "overlap", cophase_model_psf(model, coefficients_nm, modes, &bad));
    bad = psf, bad.col_stride = PTRDIFF_MIN;
    REFUSED(COPHASE_BAD_ARGUMENT, "address space", cophase_model_psf(model, coefficients_nm, modes, &bad));
    bad = psf, bad.data = (float *)(void *)((char *)psf.data + 2);
    REFUSED(COPHASE_BAD_ARGUMENT, "data", cophase_model_psf(model, coefficients_nm, modes, &bad));
    for (i = 0; i <= WAVEFRONT + PSF; i++)
        CHECK(memory[i] == (float)UNTOUCHED);

    CHECK(cophase_model_wavefront_nm(model, coefficients_nm, modes, &wavefront) == COPHASE_OK);
    CHECK(cophase_model_psf(model, coefficients_nm, modes, &psf) == COPHASE_OK);
    CHECK(memory[WAVEFRONT + PSF] == (float)UNTOUCHED);
    for (i = 0; i < SAMPLES * SAMPLES; i++) {
        const int glass = memory[i] == memory[i];
        CHECK(glass == (memory[SAMPLES * SAMPLES + i] == memory[SAMPLES * SAMPLES + i]));
        lit += (size_t)glass;
    }
    CHECK(lit > SAMPLES * SAMPLES / 3 && lit < SAMPLES * SAMPLES);
    for (i = 0; i < PSF; i++)
        sum += (double)psf.data[i];
    CHECK(sum > 0.9 && sum < 1.0); /* the rest falls beside the detector */
    /* The same, turned over. */
    bad = output(turned + PSF - 1, 1, PIXELS, PIXELS);
    bad.row_stride = -bad.row_stride, bad.col_stride = -1;
    CHECK(cophase_model_psf(model, coefficients_nm, modes, &bad) == COPHASE_OK);
    for (i = 0; i < PSF; i++)
        CHECK(turned[PSF - 1 - i] == psf.data[i]);
    for (i = 0; i < WAVEFRONT + PSF; i++) {
        value = (double)memory[i];
        dump(file, &value, 1);
    }
    free(turned);
    free(memory);
}

enum { N = 32, MODES = 3 };

/* A telescope of the caller's: a disc of two halves with a notch, so that nothing about it is symmetric. */
struct telescope {
    float amplitude[N * N], diversity_nm[N * N];
    double modes[MODES * N * N];
    int32_t segments[N * N];
};

static struct telescope *telescope(void)
{
    struct telescope *made = (struct telescope *)memory(1, sizeof *made);
    size_t i;

    for (i = 0; i < N * N; i++) {
        const double y = ((double)(i / N) - 15.5) / 14.0, x = ((double)(i % N) - 15.5) / 14.0;
        const double r2 = x * x + y * y;
        const int glass = r2 < 1.0 && r2 > 0.05 && !(y > 0.6 && x > 0.2);

        made->amplitude[i] = glass ? 1.0f : 0.0f;
        made->segments[i] = glass ? x > 0.0 : -1;
        made->diversity_nm[i] = (float)(1200.0 * (2.0 * r2 - 1.0));
        made->modes[i] = 2.4 * (x * x - y * y);
        made->modes[N * N + i] = 4.9 * x * y;
        made->modes[2 * N * N + i] = 2.8 * (3.0 * r2 - 2.0) * x;
    }
    return made;
}

static cophase_model_arrays arrays_of(const struct telescope *made)
{
    cophase_model_arrays arrays;

    CHECK(cophase_model_arrays_init(&arrays, sizeof arrays) == COPHASE_OK);
    CHECK(arrays.struct_size == sizeof arrays && arrays.segments.data == NULL && arrays.modes.data == NULL);
    arrays.pupil = input(made->amplitude, COPHASE_F32, 1, N, N);
    arrays.segments = input(made->segments, COPHASE_I32, 1, N, N);
    arrays.modes = input(made->modes, COPHASE_F64, MODES, N, N);
    arrays.diversity_nm = input(made->diversity_nm, COPHASE_F32, 1, N, N);
    return arrays;
}

static void psf_of(cophase_model *model, float *psf, size_t modes)
{
    enum { PIXELS = 48 };
    const double coefficients_nm[] = {40.0, -40.0, 30.0, -20.0, 10.0};
    const cophase_array_f32 out = output(psf, 1, PIXELS, PIXELS);
    size_t count = 0;

    CHECK(cophase_model_mode_count(model, &count) == COPHASE_OK && count == modes);
    CHECK(cophase_model_psf(model, coefficients_nm, modes, &out) == COPHASE_OK);
    cophase_model_destroy(model);
}

static void arrays(const char *scene)
{
    enum { PSF = 48 * 48 };
    struct telescope *made = telescope();
    const cophase_model_arrays good = arrays_of(made);
    float *psf = floats(2 * PSF), *turned = floats(N * N);
    cophase_model_arrays bad;
    cophase_model *model = NULL;
    size_t i;

    CHECK(cophase_model_create_from_arrays(scene, NULL, &good, &model) == COPHASE_OK);
    psf_of(model, psf, 5);
    /* The pupil in columns, and the modes one behind the other in every element: the same telescope. */
    for (i = 0; i < N * N; i++)
        turned[i % N * N + i / N] = made->amplitude[i];
    bad = good, bad.pupil.data = turned, bad.pupil.row_stride = 1, bad.pupil.col_stride = N;
    CHECK(cophase_model_create_from_arrays(scene, NULL, &bad, &model) == COPHASE_OK);
    psf_of(model, psf + PSF, 5);
    CHECK(memcmp(psf, psf + PSF, PSF * sizeof *psf) == 0);
    /* Without segments' labels there are no pistons. */
    bad = good, bad.segments.data = NULL;
    CHECK(cophase_model_create_from_arrays(scene, NULL, &bad, &model) == COPHASE_OK);
    psf_of(model, psf + PSF, MODES);
    CHECK(memcmp(psf, psf + PSF, PSF * sizeof *psf) != 0);

    model = NULL;
    bad = good, bad.pupil.data = NULL;
    REFUSED(COPHASE_BAD_ARGUMENT, "pupil", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad = good, bad.pupil.cols = N - 1;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad = good, bad.pupil.count = 2, bad.pupil.count_stride = 0;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad = good, bad.modes.rows = N - 2, bad.modes.cols = N - 2;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad = good, bad.pupil.element = 0;
    REFUSED(COPHASE_BAD_ARGUMENT, "element", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad = good, bad.segments = good.diversity_nm;
    REFUSED(COPHASE_BAD_VALUE, "label", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad = good, bad.modes.count = (size_t)-1;
    REFUSED(COPHASE_BAD_ARGUMENT, "address space", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    /* One mode for many: more than memory holds. */
    bad = good, bad.modes.count = (size_t)-1 / 2, bad.modes.count_stride = 0;
    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    bad.modes.count = (size_t)1 << 40;
    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_model_create_from_arrays(scene, NULL, &bad, &model));
    made->amplitude[N * N / 2 + 5] = 1.5f;
    REFUSED(COPHASE_BAD_VALUE, "1.5", cophase_model_create_from_arrays(scene, NULL, &good, &model));
    for (i = 0; i < N * N; i++)
        made->amplitude[i] = 0.0f;
    CHECK(cophase_model_create_from_arrays(scene, NULL, &good, &model) == COPHASE_BAD_VALUE);
    CHECK(model == NULL);
    free(turned);
    free(psf);
    free(made);
}

int main(int argc, char **argv)
{
    cophase_model *model = NULL;
    double *coefficients_nm;
    size_t size, modes = 0;
    char *scene;
    FILE *file;

    if (argc != 3 || (file = fopen(argv[2], "wb")) == NULL)
        return 2;
    scene = read_file(argv[1], &size);
    devices();
    refused_scenes(scene);
    arrays(scene);
    CHECK(cophase_model_create(scene, NULL, &model) == COPHASE_OK);
    free(scene); /* it was copied */
    if (model == NULL)
        return 1;
    CHECK(cophase_model_mode_count(model, &modes) == COPHASE_OK);
    coefficients_nm = doubles(modes);
    draw_coefficients(coefficients_nm, modes, 20.0, 1);
    facts(model, modes);
    dump(file, coefficients_nm, modes);
    maps(model, coefficients_nm, modes, file);
    cophase_model_destroy(model);
    cophase_model_destroy(NULL);
    free(coefficients_nm);
    return fclose(file) == 0 && failures == 0 ? 0 : 1;
}
