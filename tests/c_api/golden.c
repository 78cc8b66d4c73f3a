/* The golden vectors (tests/golden/README.md) through the public header alone; see tests/c_api/main.rs:
 *
 *   golden FILES.toml ARRAYS.toml DIRECTORY DATA DUMP
 *
 * FILES.toml names its pupil, modes and diversity, which lie in DIRECTORY; for ARRAYS.toml they come from DATA, doubles in
 * C order: five points, the golden objective and gradient at each, an image, the pupil's amplitude, the labels of its
 * segments, the modes of the NCPA, the diversity. DUMP receives objectives and gradients of FILES.toml. */
#include "frames.h"

enum { POINTS = 5, N = 120, PIXELS = 240, PISTONS = 36, NCPA = 66, MODES = PISTONS + NCPA };

/* |found - golden| / |golden|, Euclidean. */
static double relative_difference(const double *found, const double *golden, size_t count)
{
    double difference = 0.0, norm = 0.0;
    size_t i;

    for (i = 0; i < count; i++) {
        difference += (found[i] - golden[i]) * (found[i] - golden[i]);
        norm += golden[i] * golden[i];
    }
    return sqrt(difference / norm);
}

/* Objective and gradient of the image at all points, which must be the golden ones. */
static void evaluate(const char *name, cophase_model *model, const double *data, double *objectives, double *gradients)
{
    const double *points_nm = data, *golden_objectives = points_nm + POINTS * MODES;
    const double *golden_gradients = golden_objectives + POINTS, *image = golden_gradients + POINTS * MODES;
    cophase_input frames = input(image, COPHASE_F64, POINTS, PIXELS, PIXELS);
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_model_info info;
    cophase_session *session = NULL;
    size_t i;

    CHECK(cophase_model_get_info(model, &info, sizeof info) == COPHASE_OK);
    CHECK(info.modes == MODES && info.segment_modes == PISTONS);
    options.capacity = POINTS;
    CHECK(cophase_session_create(model, &options, &session) == COPHASE_OK);
    frames.count_stride = 0; /* the same image for each point */
    CHECK(cophase_session_evaluate(session, 0, &frames, NULL, points_nm, POINTS, MODES, objectives, gradients) == COPHASE_OK);
    for (i = 0; i < POINTS; i++) {
        const double objective = fabs(objectives[i] / golden_objectives[i] - 1.0);
        const double gradient = relative_difference(gradients + i * MODES, golden_gradients + i * MODES, MODES);

        printf("%s, point %d: objective %.1e, gradient %.1e\n", name, (int)i, objective, gradient);
        /* As in tests/golden.rs: the rounding of 57,600 terms. */
        CHECK(objective < 1e-12 && gradient < 1e-11);
    }
    cophase_session_destroy(session);
    cophase_model_destroy(model);
}

static cophase_model *from_arrays(const char *scene, const double *image)
{
    const double *pupil = image + PIXELS * PIXELS, *labels = pupil + N * N, *modes = labels + N * N;
    int32_t *segments = (int32_t *)memory(N * N, sizeof *segments);
    cophase_model_arrays arrays = DEFAULTS(cophase_model_arrays);
    cophase_model *model = NULL;
    size_t i;

    for (i = 0; i < N * N; i++)
        segments[i] = (int32_t)labels[i];
    arrays.pupil = input(pupil, COPHASE_F64, 1, N, N);
    arrays.segments = input(segments, COPHASE_I32, 1, N, N);
    arrays.modes = input(modes, COPHASE_F64, NCPA, N, N);
    arrays.diversity_nm = input(modes + NCPA * N * N, COPHASE_F64, 1, N, N);
    CHECK(cophase_model_create(scene, NULL, &arrays, &model) == COPHASE_OK);
    free(segments);
    return model;
}

int main(int argc, char **argv)
{
    const size_t image = 2 * POINTS * MODES + POINTS;
    const size_t wanted = image + PIXELS * PIXELS + 3 * N * N + NCPA * N * N;
    double *gradients = doubles(POINTS * MODES), *objectives = doubles(POINTS), *data;
    cophase_model *model = NULL;
    char *scene;
    size_t size;
    FILE *file;

    if (argc != 6 || (file = fopen(argv[5], "wb")) == NULL)
        return 2;
    data = (double *)(void *)read_file(argv[4], &size);
    if (size != wanted * sizeof *data)
        return 2;
    scene = read_file(argv[1], &size);
    CHECK(cophase_model_create(scene, argv[3], NULL, &model) == COPHASE_OK);
    evaluate("from files", model, data, objectives, gradients);
    dump(file, objectives, POINTS);
    dump(file, gradients, POINTS * MODES);
    free(scene);
    scene = read_file(argv[2], &size);
    evaluate("from arrays", from_arrays(scene, data + image), data, objectives, gradients);
    free(scene), free(data), free(objectives), free(gradients);
    return fclose(file) == 0 && failures == 0 ? 0 : 1;
}
