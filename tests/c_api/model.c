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
    char text[8192], little[4];
    size_t length = 7, other = 7;

    CHECK(cophase_device_list(text, sizeof text, &length) == COPHASE_OK);
    CHECK(length < sizeof text && ends_at(text, length));
    CHECK(strncmp(text, "cpu\t", 4) == 0);
    /* As with snprintf: the whole length, as much as fits, always a zero; no memory is needed for the length alone. */
    memset(little, 'x', sizeof little);
    CHECK(cophase_device_list(little, 3, &other) == COPHASE_OK && other == length);
    CHECK(strcmp(little, "cp") == 0 && little[3] == 'x');
    CHECK(cophase_device_list(NULL, 0, &other) == COPHASE_OK && other == length);
}

/* A preset with another value for one key, and frames without strides. */
static void settings(void)
{
    static char text[65536];
    const char *preset = NULL;
    cophase_input frames;
    double pixels[6] = {1, 2, 3, 4, 5, 6};
    size_t length = 7, other = 7;

    CHECK(cophase_scene_preset("keck-artificial", &preset) == COPHASE_OK);
    CHECK(cophase_scene_set(preset, "image.peak_snr", "37", NULL, 0, &length) == COPHASE_OK);
    CHECK(length < sizeof text);
    CHECK(cophase_scene_set(preset, "image.peak_snr", "37", text, sizeof text, &other) == COPHASE_OK);
    CHECK(other == length && ends_at(text, length) && strstr(strstr(text, "\npeak_snr"), "= 37") != NULL);
    text[0] = 'x';
    REFUSED(COPHASE_BAD_SCENE, "image.pixels = 7", cophase_scene_set(preset, "image.pixels", "7", text, 9, &other));
    REFUSED(COPHASE_BAD_SCENE, "did you mean 'pixels'", cophase_scene_set(preset, "image.pixel", "32", text, 9, &other));
    CHECK(text[0] == 'x' && other == length);
    frames = cophase_input_from_array(pixels, COPHASE_F64, 1, 2, 3);
    CHECK(frames.data == pixels && frames.count == 1 && frames.rows == 2 && frames.cols == 3);
    CHECK(frames.count_stride == 6 && frames.row_stride == 3 && frames.col_stride == 1);
}

/* A scene with `more` behind it, which the sentence on `key` gives to the estimator. */
static void only_for_an_estimator(const char *scene, const char *more, const char *key, cophase_model **model)
{
    char *both = joined(scene, more);

    REFUSED(COPHASE_BAD_SCENE, key, cophase_model_create(both, NULL, NULL, model));
    REFUSED(COPHASE_BAD_SCENE, "cophase_estimator_create", cophase_model_create(both, NULL, NULL, model));
    free(both);
}

static void refused_scenes(const char *scene)
{
    cophase_model *model = NULL;
    cophase_model *const before = (cophase_model *)(void *)&model;

    model = before;
    REFUSED(COPHASE_BAD_SCENE, "apertur", cophase_model_create("[pupil]\napertur = 3\n", NULL, NULL, &model));
    REFUSED(COPHASE_BAD_SCENE, "", cophase_model_create("", NULL, NULL, &model));
    REFUSED(COPHASE_BAD_SCENE, "", cophase_model_create("[[[", NULL, NULL, &model));
    REFUSED(COPHASE_BAD_SCENE, "'scene.toml' is a name", cophase_model_create("scene.toml", NULL, NULL, &model));
    REFUSED(COPHASE_BAD_ARGUMENT, "scene_text", cophase_model_create("\xff", NULL, NULL, &model));
    REFUSED(COPHASE_BAD_ARGUMENT, "directory", cophase_model_create(scene, "\xff", NULL, &model));
    REFUSED(COPHASE_BAD_FILE, "no-such-modes.fits",
            cophase_model_create("[image]\nwavelength_nm = 2168.6\npixels = 48\n"
                                 "[modes]\nfile = \"no-such-modes.fits\"\n",
                                 "/nowhere", NULL, &model));
    only_for_an_estimator(scene, "\n[estimate]\nmethod = \"full-phase\"\n", "estimate.method", &model);
    only_for_an_estimator(scene, "\n[estimate]\nfit_optics = [\"plate-scale\"]\n", "estimate.fit_optics", &model);
    CHECK(model == before);
}

/* Sizes, and names of modes. */
static void facts(const cophase_model *model, const cophase_model_info *info)
{
    const char *name = NULL, *again = NULL;
    size_t mode;

    CHECK(info->modes == 15 && info->segment_modes == 7 && info->rows == 48 && info->cols == 48);
    CHECK(info->samples == 32 && info->pixels == 48);
    for (mode = 0; mode < info->modes; mode++) {
        CHECK(cophase_model_mode_name(model, mode, &name) == COPHASE_OK && name != NULL && name[0] != '\0');
        CHECK(mode == 0 || strcmp(name, again) != 0);
        again = name;
    }
    CHECK(cophase_model_mode_name(model, 0, &name) == COPHASE_OK);
    CHECK(cophase_model_mode_name(model, 0, &again) == COPHASE_OK && name == again);
    REFUSED(COPHASE_BAD_VALUE, "15", cophase_model_mode_name(model, info->modes, &name));
    REFUSED(COPHASE_BAD_VALUE, "mode", cophase_model_mode_name(model, (size_t)-1, &name));
    CHECK(name == again);
}

/* The maps at `coefficients_nm`, written to the dump, and refused where they cannot be. */
static void maps(const cophase_model *model, const double *coefficients_nm, size_t modes, FILE *file)
{
    enum { SAMPLES = 32, PIXELS = 48, WAVEFRONT = 2 * SAMPLES * SAMPLES, PSF = PIXELS * PIXELS };
    double *wavefront_nm = doubles(WAVEFRONT + PSF + 1), *psf = wavefront_nm + WAVEFRONT, sum = 0.0;
    double *odd = (double *)(void *)((char *)psf + 4);
    size_t i, inside = 0;

    REFUSED(COPHASE_BAD_SHAPE, "15", cophase_model_psf(model, coefficients_nm, modes - 1, psf, PSF));
    REFUSED(COPHASE_BAD_SHAPE, "15", cophase_model_wavefront_nm(model, coefficients_nm, (size_t)-1, wavefront_nm, WAVEFRONT));
    REFUSED(COPHASE_BAD_SHAPE, "count is 1024: 2048 is accepted (2 x 32 x 32)",
            cophase_model_wavefront_nm(model, coefficients_nm, modes, wavefront_nm, WAVEFRONT / 2));
    REFUSED(COPHASE_BAD_SHAPE, "48 x 48", cophase_model_psf(model, coefficients_nm, modes, psf, (size_t)-1));
    REFUSED(COPHASE_BAD_ARGUMENT, "that 8 divides", cophase_model_psf(model, coefficients_nm, modes, odd, PSF));
    CHECK(untouched(wavefront_nm, WAVEFRONT + PSF + 1) == WAVEFRONT + PSF + 1);

    CHECK(cophase_model_wavefront_nm(model, coefficients_nm, modes, wavefront_nm, WAVEFRONT) == COPHASE_OK);
    CHECK(cophase_model_psf(model, coefficients_nm, modes, psf, PSF) == COPHASE_OK);
    CHECK(psf[PSF] == UNTOUCHED);
    for (i = 0; i < SAMPLES * SAMPLES; i++) {
        const int is_inside = wavefront_nm[i] == wavefront_nm[i];
        CHECK(is_inside == (wavefront_nm[SAMPLES * SAMPLES + i] == wavefront_nm[SAMPLES * SAMPLES + i]));
        inside += (size_t)is_inside;
    }
    CHECK(inside > SAMPLES * SAMPLES / 3 && inside < SAMPLES * SAMPLES);
    for (i = 0; i < PSF; i++)
        sum += psf[i];
    CHECK(sum > 0.9 && sum < 1.0); /* the rest falls beside the detector */
    dump(file, wavefront_nm, WAVEFRONT + PSF);
    free(wavefront_nm);
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
    cophase_model_arrays arrays = DEFAULTS(cophase_model_arrays);

    arrays.pupil = input(made->amplitude, COPHASE_F32, 1, N, N);
    arrays.segments = input(made->segments, COPHASE_I32, 1, N, N);
    arrays.modes = input(made->modes, COPHASE_F64, MODES, N, N);
    arrays.diversity_nm = input(made->diversity_nm, COPHASE_F32, 1, N, N);
    return arrays;
}

static void psf_of(cophase_model *model, double *psf, size_t modes)
{
    enum { PIXELS = 48 };
    const double coefficients_nm[] = {40.0, -40.0, 30.0, -20.0, 10.0};
    cophase_model_info info;

    CHECK(cophase_model_get_info(model, &info, sizeof info) == COPHASE_OK && info.modes == modes);
    CHECK(cophase_model_psf(model, coefficients_nm, modes, psf, PIXELS * PIXELS) == COPHASE_OK);
    cophase_model_destroy(model);
}

static void arrays(const char *scene)
{
    enum { PSF = 48 * 48 };
    struct telescope *made = telescope();
    const cophase_model_arrays good = arrays_of(made);
    double *psf = doubles(2 * PSF);
    float *turned = floats(N * N);
    cophase_model_arrays bad;
    cophase_model *model = NULL;
    size_t i;

    CHECK(cophase_model_create(scene, NULL, &good, &model) == COPHASE_OK);
    psf_of(model, psf, 5);
    /* The pupil in columns, and the modes one behind the other in every element: the same telescope. */
    for (i = 0; i < N * N; i++)
        turned[i % N * N + i / N] = made->amplitude[i];
    bad = good, bad.pupil.data = turned, bad.pupil.row_stride = 1, bad.pupil.col_stride = N;
    CHECK(cophase_model_create(scene, NULL, &bad, &model) == COPHASE_OK);
    psf_of(model, psf + PSF, 5);
    CHECK(memcmp(psf, psf + PSF, PSF * sizeof *psf) == 0);
    /* Without segments' labels there are no pistons. */
    bad = good, bad.segments.data = NULL;
    CHECK(cophase_model_create(scene, NULL, &bad, &model) == COPHASE_OK);
    psf_of(model, psf + PSF, MODES);
    CHECK(memcmp(psf, psf + PSF, PSF * sizeof *psf) != 0);

    model = NULL;
    bad = good, bad.pupil.data = NULL;
    REFUSED(COPHASE_BAD_ARGUMENT, "pupil", cophase_model_create(scene, NULL, &bad, &model));
    bad = good, bad.pupil.cols = N - 1;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_model_create(scene, NULL, &bad, &model));
    bad = good, bad.pupil.count = 2, bad.pupil.count_stride = 0;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_model_create(scene, NULL, &bad, &model));
    bad = good, bad.modes.rows = N - 2, bad.modes.cols = N - 2;
    REFUSED(COPHASE_BAD_SHAPE, "", cophase_model_create(scene, NULL, &bad, &model));
    bad = good, bad.pupil.element = 0;
    REFUSED(COPHASE_BAD_ARGUMENT, "element", cophase_model_create(scene, NULL, &bad, &model));
    bad = good, bad.segments = good.diversity_nm;
    REFUSED(COPHASE_BAD_VALUE, "label", cophase_model_create(scene, NULL, &bad, &model));
    bad = good, bad.modes.count = (size_t)-1;
    REFUSED(COPHASE_BAD_ARGUMENT, "address space", cophase_model_create(scene, NULL, &bad, &model));
    /* One mode for many: more than memory holds. */
    bad = good, bad.modes.count = (size_t)-1 / 2, bad.modes.count_stride = 0;
    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_model_create(scene, NULL, &bad, &model));
    bad.modes.count = (size_t)1 << 40;
    REFUSED(COPHASE_BAD_SHAPE, "modes", cophase_model_create(scene, NULL, &bad, &model));
    made->amplitude[N * N / 2 + 5] = 1.5f;
    REFUSED(COPHASE_BAD_VALUE, "1.5", cophase_model_create(scene, NULL, &good, &model));
    for (i = 0; i < N * N; i++)
        made->amplitude[i] = 0.0f;
    CHECK(cophase_model_create(scene, NULL, &good, &model) == COPHASE_BAD_VALUE);
    CHECK(model == NULL);
    free(turned);
    free(psf);
    free(made);
}

int main(int argc, char **argv)
{
    cophase_model *model = NULL;
    cophase_model_info info;
    double *coefficients_nm;
    size_t size;
    char *scene;
    FILE *file;

    if (argc != 3 || (file = fopen(argv[2], "wb")) == NULL)
        return 2;
    scene = read_file(argv[1], &size);
    devices();
    settings();
    refused_scenes(scene);
    arrays(scene);
    CHECK(cophase_model_create(scene, NULL, NULL, &model) == COPHASE_OK);
    free(scene); /* it was copied */
    if (model == NULL)
        return 1;
    CHECK(cophase_model_get_info(model, &info, sizeof info) == COPHASE_OK);
    coefficients_nm = doubles(info.modes);
    draw_coefficients(coefficients_nm, info.modes, 20.0, 1);
    facts(model, &info);
    dump(file, coefficients_nm, info.modes);
    maps(model, coefficients_nm, info.modes, file);
    cophase_model_destroy(model);
    cophase_model_destroy(NULL);
    free(coefficients_nm);
    return fclose(file) == 0 && failures == 0 ? 0 : 1;
}
