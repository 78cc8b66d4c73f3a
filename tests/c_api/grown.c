/* Programs that were built against another header than the library: older ones, whose structs end early, and newer ones,
 * whose structs go on. Both are played with the structs of today: what a program has of a struct lies in front of a guard,
 * which the library must neither write nor take for fields.
 *
 * grown SCENE: a scene as a TOML file. Nothing is printed where all is well.
 */
#include <cophase.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define GUARD 0xa5
#define GUARD_BYTES 64
/* What structs of a later library have more: three fields. */
#define GROWN_BYTES 24
#define FRAMES 2
#define PUPIL 32

static void fail(const char *what, int line)
{
    char sentence[512];

    cophase_last_error(sentence, sizeof sentence);
    fprintf(stderr, "grown.c:%d: not so: %s\nlast error: %s\n", line, what, sentence);
    exit(1);
}

#define HOLDS(condition) ((condition) ? (void)0 : fail(#condition, __LINE__))
#define WORKS(call) HOLDS((call) == COPHASE_OK)

/* ---- memory with a guard behind it */

static void *guarded(size_t size)
{
    void *memory = malloc(size + GUARD_BYTES);

    HOLDS(memory != NULL);
    memset(memory, GUARD, size + GUARD_BYTES);
    return memory;
}

static int all_are(const void *memory, size_t size, int byte)
{
    const unsigned char *bytes = (const unsigned char *)memory;
    size_t i;

    for (i = 0; i < size; i++)
        if (bytes[i] != byte)
            return 0;
    return 1;
}

static int guard_stands(const void *memory, size_t size)
{
    return all_are((const unsigned char *)memory + size, GUARD_BYTES, GUARD);
}

/* ---- options */

/* Options of a program whose struct has `size` bytes: nothing but defaults, and a guard behind them. */
static unsigned char *options_of(size_t size)
{
    unsigned char *options = (unsigned char *)guarded(size);

    memset(options, 0, size);
    memcpy(options, &size, sizeof size);
    return options;
}

/* ---- what the structs are used for */

static char scene[1 << 16];
static cophase_model *model;
static size_t modes, rows, cols;
static float *frames_e;
/* What a program of today gets: coefficients and reports of FRAMES frames. */
static double *expected_nm;
static cophase_image_report expected[FRAMES];

static cophase_input input(const void *data, int32_t element, size_t count, size_t height, size_t width)
{
    cophase_input whole;

    whole.data = data;
    whole.element = element;
    whole.count = count;
    whole.rows = height;
    whole.cols = width;
    whole.count_stride = (ptrdiff_t)(height * width);
    whole.row_stride = (ptrdiff_t)width;
    whole.col_stride = 1;
    return whole;
}

/* A star in the middle of each frame, wider along the columns in the second: something to fit, if not well. */
static void make_frames(void)
{
    size_t k, y, x;

    frames_e = (float *)malloc(FRAMES * rows * cols * sizeof *frames_e);
    HOLDS(frames_e != NULL);
    for (k = 0; k < FRAMES; k++)
        for (y = 0; y < rows; y++)
            for (x = 0; x < cols; x++) {
                double dy = (double)y - (double)(rows / 2), dx = ((double)x - (double)(cols / 2)) / (1.0 + 0.2 * (double)k);

                frames_e[(k * rows + y) * cols + x] = (float)(1e4 * exp(-(dx * dx + dy * dy) / 50.0));
            }
}

/* The same fit as expected[], or the first `count` frames of it; 1 where all that was asked for has the same bits. */
static int fits_as_expected(cophase_session *session, const cophase_fit_options *options, size_t count)
{
    cophase_input frames = input(frames_e, COPHASE_F32, count, rows, cols);
    double *found_nm = (double *)malloc(count * modes * sizeof *found_nm);
    int same;

    HOLDS(found_nm != NULL);
    WORKS(cophase_session_fit(session, &frames, 1, options, found_nm, NULL, modes, NULL, 0, NULL, 0));
    same = memcmp(found_nm, expected_nm, count * modes * sizeof *found_nm) == 0;
    free(found_nm);
    return same;
}

static cophase_session *session_for(size_t capacity)
{
    cophase_session_options options = {.struct_size = sizeof options};
    cophase_session *session = NULL;

    options.capacity = capacity;
    WORKS(cophase_session_create(model, &options, &session));
    return session;
}

/* ---- one test for each struct */

static void session_options(void)
{
    const size_t known = sizeof(cophase_session_options);
    const size_t sizes[] = {sizeof(size_t), offsetof(cophase_session_options, device),
                            offsetof(cophase_session_options, max_evaluations), known, known + GROWN_BYTES};
    cophase_session *session = NULL;
    unsigned char *options;
    size_t i;

    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        /* A program without the field gets one image. */
        size_t capacity = sizes[i] > sizeof(size_t) ? FRAMES : 1;

        options = options_of(sizes[i]);
        if (capacity > 1)
            ((cophase_session_options *)options)->capacity = capacity;
        WORKS(cophase_session_create(model, (cophase_session_options *)options, &session));
        HOLDS(guard_stands(options, sizes[i]));
        HOLDS(fits_as_expected(session, NULL, capacity));
        cophase_session_destroy(session);
        free(options);
    }
    /* A field that this library does not know, and that asks for something. */
    options = options_of(known + GROWN_BYTES);
    options[known + GROWN_BYTES - 1] = 1;
    session = NULL;
    HOLDS(cophase_session_create(model, (cophase_session_options *)options, &session) == COPHASE_BAD_ARGUMENT);
    HOLDS(session == NULL);
    free(options);
}

static void fit_options(void)
{
    const size_t known = sizeof(cophase_fit_options);
    /* The guard in place of a pointer or of a noise would not go unseen. */
    const size_t sizes[] = {sizeof(size_t), offsetof(cophase_fit_options, read_noise_e),
                            offsetof(cophase_fit_options, start_nm), offsetof(cophase_fit_options, has_read_noise),
                            known, known + GROWN_BYTES};
    cophase_session *session = session_for(FRAMES);
    cophase_input frames = input(frames_e, COPHASE_F32, FRAMES, rows, cols);
    double *untouched = (double *)guarded(FRAMES * modes * sizeof *untouched);
    double *values = (double *)guarded(FRAMES * (modes + 1) * sizeof *values);
    unsigned char *options;
    size_t i;

    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        options = options_of(sizes[i]);
        HOLDS(fits_as_expected(session, (cophase_fit_options *)options, FRAMES));
        WORKS(cophase_session_evaluate(session, 0, &frames, (cophase_fit_options *)options, expected_nm, FRAMES, modes, values,
                                       values + FRAMES));
        HOLDS(guard_stands(options, sizes[i]));
        free(options);
    }
    options = options_of(known + GROWN_BYTES);
    options[known] = 1;
    HOLDS(cophase_session_fit(session, &frames, 1, (cophase_fit_options *)options, untouched, NULL, modes, NULL, 0, NULL, 0) ==
          COPHASE_BAD_ARGUMENT);
    HOLDS(all_are(untouched, FRAMES * modes * sizeof *untouched, GUARD));
    free(options);
    free(values);
    free(untouched);
    cophase_session_destroy(session);
}

static void calibration(void)
{
    const size_t known = sizeof(cophase_calibration);
    const size_t sizes[] = {offsetof(cophase_calibration, flat), offsetof(cophase_calibration, bad),
                            offsetof(cophase_calibration, gain_e), known, known + GROWN_BYTES};
    cophase_session *session = session_for(FRAMES);
    float *zeros = (float *)calloc(rows * cols, sizeof *zeros);
    unsigned char *options;
    size_t i;

    HOLDS(zeros != NULL);
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        options = options_of(sizes[i]);
        /* A dark of zeros, which every one of these programs has the field for, changes nothing. */
        ((cophase_calibration *)options)->dark = input(zeros, COPHASE_F32, 1, rows, cols);
        WORKS(cophase_session_calibrate(session, 0, (cophase_calibration *)options));
        HOLDS(guard_stands(options, sizes[i]));
        HOLDS(fits_as_expected(session, NULL, FRAMES));
        free(options);
    }
    options = options_of(known + GROWN_BYTES);
    options[known + 8] = 1;
    HOLDS(cophase_session_calibrate(session, 0, (cophase_calibration *)options) == COPHASE_BAD_ARGUMENT);
    /* The one before is still in use. */
    HOLDS(fits_as_expected(session, NULL, FRAMES));
    free(options);
    free(zeros);
    cophase_session_destroy(session);
}

static size_t modes_of(const cophase_model *of)
{
    cophase_model_info info;

    WORKS(cophase_model_get_info(of, &info, sizeof info));
    return info.modes;
}

/* A round pupil, and what the scene says of modes and diversity. */
static void model_arrays(void)
{
    const size_t known = sizeof(cophase_model_arrays);
    const size_t sizes[] = {offsetof(cophase_model_arrays, segments), offsetof(cophase_model_arrays, diversity_nm), known,
                            known + GROWN_BYTES};
    static double pupil[PUPIL * PUPIL], tilt[PUPIL * PUPIL];
    cophase_model *own = NULL;
    unsigned char *arrays;
    size_t i, j, count, expected_count = 0;

    for (i = 0; i < PUPIL * PUPIL; i++) {
        double y = (double)(i / PUPIL) - 15.5, x = (double)(i % PUPIL) - 15.5;

        pupil[i] = y * y + x * x < 15.0 * 15.0 ? 1.0 : 0.0;
        tilt[i] = x * y;
    }
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        cophase_model_arrays *fields;

        arrays = options_of(sizes[i]);
        fields = (cophase_model_arrays *)arrays;
        fields->pupil = input(pupil, COPHASE_F64, 1, PUPIL, PUPIL);
        own = NULL;
        if (sizes[i] < known) {
            /* The oldest has no field for modes: those of the scene, as for one that leaves the field as it is. */
            WORKS(cophase_model_create(scene, NULL, fields, &own));
            count = modes_of(own);
            HOLDS(expected_count == 0 || count == expected_count);
            expected_count = count;
        } else {
            fields->modes = input(tilt, COPHASE_F64, 1, PUPIL, PUPIL);
            WORKS(cophase_model_create(scene, NULL, fields, &own));
            count = modes_of(own);
            HOLDS(count < expected_count);
        }
        HOLDS(guard_stands(arrays, sizes[i]));
        cophase_model_destroy(own);
        free(arrays);
    }
    for (j = 0; j < GROWN_BYTES; j += GROWN_BYTES - 1) {
        arrays = options_of(known + GROWN_BYTES);
        ((cophase_model_arrays *)arrays)->pupil = input(pupil, COPHASE_F64, 1, PUPIL, PUPIL);
        arrays[known + j] = 1;
        own = NULL;
        HOLDS(cophase_model_create(scene, NULL, (cophase_model_arrays *)arrays, &own) == COPHASE_BAD_ARGUMENT);
        HOLDS(own == NULL);
        free(arrays);
    }
}

/* The struct of sizes, in programs of other versions. */
static void infos(void)
{
    const size_t known = sizeof(cophase_model_info);
    const size_t sizes[] = {8, offsetof(cophase_model_info, cols), known, known + GROWN_BYTES};
    cophase_model_info whole;
    size_t i;

    WORKS(cophase_model_get_info(model, &whole, sizeof whole));
    modes = whole.modes, rows = whole.rows, cols = whole.cols;
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        size_t shared = sizes[i] < known ? sizes[i] : known;
        unsigned char *info = (unsigned char *)guarded(sizes[i]);

        WORKS(cophase_model_get_info(model, (cophase_model_info *)info, sizes[i]));
        HOLDS(guard_stands(info, sizes[i]));
        HOLDS(memcmp(info, &whole, shared) == 0 && all_are(info + shared, sizes[i] - shared, 0));
        free(info);
    }
}

/* Reports of other sizes: each in its place, what a program does not know left out, what the library does not know 0. */
static void reports(void)
{
    const size_t known = sizeof(cophase_image_report);
    const size_t sizes[] = {8, offsetof(cophase_image_report, flux_e), known, known + GROWN_BYTES};
    cophase_session *session = session_for(FRAMES);
    cophase_input frames = input(frames_e, COPHASE_F32, FRAMES, rows, cols);
    double *found_nm = (double *)malloc(FRAMES * modes * sizeof *found_nm);
    size_t i, k;

    HOLDS(found_nm != NULL);
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        size_t shared = sizes[i] < known ? sizes[i] : known;
        unsigned char *array = (unsigned char *)guarded(FRAMES * sizes[i]);

        WORKS(cophase_session_fit(session, &frames, 1, NULL, found_nm, NULL, modes, (cophase_image_report *)array, sizes[i],
                                  NULL, 0));
        HOLDS(guard_stands(array, FRAMES * sizes[i]));
        for (k = 0; k < FRAMES; k++) {
            const unsigned char *report = array + k * sizes[i];
            /* The time that it took is the one field that differs from run to run. */
            size_t same = shared < offsetof(cophase_image_report, seconds) ? shared : offsetof(cophase_image_report, seconds);

            HOLDS(memcmp(report, &expected[k], same) == 0);
            HOLDS(all_are(report + shared, sizes[i] - shared, 0));
        }
        free(array);
    }
    free(found_nm);
    cophase_session_destroy(session);
}

/* Reports on groups, likewise. */
static void group_reports(void)
{
    const size_t known = sizeof(cophase_group_report);
    const size_t sizes[] = {8, offsetof(cophase_group_report, freedom), known, known + GROWN_BYTES};
    /* The time that it took differs from run to run. */
    const size_t fixed = offsetof(cophase_group_report, seconds);
    cophase_session *session = session_for(FRAMES);
    cophase_input frames = input(frames_e, COPHASE_F32, FRAMES, rows, cols);
    double *found_nm = (double *)malloc(FRAMES * modes * sizeof *found_nm);
    cophase_group_report whole[FRAMES];
    size_t i, k;

    HOLDS(found_nm != NULL);
    WORKS(cophase_session_fit(session, &frames, 1, NULL, found_nm, NULL, modes, NULL, 0, whole, sizeof *whole));
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        size_t shared = sizes[i] < known ? sizes[i] : known;
        unsigned char *array = (unsigned char *)guarded(FRAMES * sizes[i]);

        WORKS(cophase_session_fit(session, &frames, 1, NULL, found_nm, NULL, modes, NULL, 0, (cophase_group_report *)array,
                                  sizes[i]));
        HOLDS(guard_stands(array, FRAMES * sizes[i]));
        for (k = 0; k < FRAMES; k++) {
            const unsigned char *report = array + k * sizes[i];

            HOLDS(memcmp(report, &whole[k], shared < fixed ? shared : fixed) == 0);
            HOLDS(all_are(report + shared, sizes[i] - shared, 0));
        }
        free(array);
    }
    free(found_nm);
    cophase_session_destroy(session);
}

static void sequence_reports(void)
{
    const size_t known = sizeof(cophase_sequence_report);
    const size_t sizes[] = {8, offsetof(cophase_sequence_report, ncpa_rms_nm), known, known + GROWN_BYTES};
    cophase_session *session = session_for(FRAMES);
    cophase_sequence *sequence = NULL;
    cophase_sequence_report whole;
    double *estimate_nm = (double *)malloc(modes * sizeof *estimate_nm);
    size_t i;

    HOLDS(estimate_nm != NULL);
    HOLDS(fits_as_expected(session, NULL, FRAMES));
    WORKS(cophase_sequence_create(model, FRAMES, &sequence));
    WORKS(cophase_sequence_push(sequence, session));
    WORKS(cophase_sequence_estimate(sequence, estimate_nm, NULL, NULL, modes, &whole, sizeof whole));
    HOLDS(whole.images == FRAMES);
    for (i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        size_t shared = sizes[i] < known ? sizes[i] : known;
        unsigned char *report = (unsigned char *)guarded(sizes[i]);

        WORKS(cophase_sequence_estimate(sequence, estimate_nm, NULL, NULL, modes, (cophase_sequence_report *)report, sizes[i]));
        HOLDS(guard_stands(report, sizes[i]));
        HOLDS(memcmp(report, &whole, shared) == 0);
        HOLDS(all_are(report + shared, sizes[i] - shared, 0));
        free(report);
    }
    free(estimate_nm);
    cophase_sequence_destroy(sequence);
    cophase_session_destroy(session);
}

/* ---- */

static void read_scene(const char *path)
{
    FILE *file = fopen(path, "r");
    size_t length;

    HOLDS(file != NULL);
    length = fread(scene, 1, sizeof scene / 2, file);
    fclose(file);
    scene[length] = '\0';
}

int main(int argc, char **argv)
{
    cophase_session *session;
    cophase_input frames;

    HOLDS(argc == 2);
    read_scene(argv[1]);
    WORKS(cophase_model_create(scene, NULL, NULL, &model));
    infos();
    make_frames();
    expected_nm = (double *)malloc(FRAMES * modes * sizeof *expected_nm);
    HOLDS(expected_nm != NULL);
    frames = input(frames_e, COPHASE_F32, FRAMES, rows, cols);
    session = session_for(FRAMES);
    WORKS(cophase_session_fit(session, &frames, 1, NULL, expected_nm, NULL, modes, expected, sizeof *expected, NULL, 0));
    cophase_session_destroy(session);

    session_options();
    fit_options();
    calibration();
    model_arrays();
    reports();
    group_reports();
    sequence_reports();

    free(expected_nm);
    free(frames_e);
    cophase_model_destroy(model);
    return 0;
}
