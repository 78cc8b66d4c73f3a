/* Handles that come and go leave nothing behind; see tests/c_api/main.rs:
 *
 *   lifetimes SCENE.toml TIMES
 *
 * From 2,000 times on, what is resident must not grow. Fewer are for tools that count leaks themselves, and that keep
 * freed memory for a while. Linux only: what is resident is read from /proc. */
#include "setting.h"

static char *scene;
static int counts; /* whether what is resident must not grow */

/* Pages of 4 KiB or more. */
static long resident_pages(void)
{
    FILE *statm = fopen("/proc/self/statm", "r");
    long size = 0, resident = 0;

    if (statm == NULL || fscanf(statm, "%ld %ld", &size, &resident) != 2)
        exit(2);
    fclose(statm);
    return resident;
}

static void sequence(const struct setting *s)
{
    cophase_sequence *made = NULL;

    CHECK(cophase_sequence_create(s->model, 8, &made) == COPHASE_OK);
    CHECK(cophase_sequence_push(made, s->session) == COPHASE_OK);
    cophase_sequence_destroy(made);
}

static void session(const struct setting *s)
{
    cophase_session_destroy(session_for(s->model, 1));
}

/* A session that works once. */
static void working_session(const struct setting *s)
{
    const cophase_input frames = frames_of(s, 1);
    cophase_session *made = session_for(s->model, 1);

    CHECK(cophase_session_fit(made, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    cophase_session_destroy(made);
}

static void model(const struct setting *s)
{
    cophase_model *made = NULL;

    (void)s;
    CHECK(cophase_model_create(scene, NULL, NULL, &made) == COPHASE_OK);
    cophase_model_destroy(made);
}

static void refused_model(const struct setting *s)
{
    cophase_model *made = NULL;

    (void)s;
    CHECK(cophase_model_create("[pupil]\napertur = 3\n", NULL, NULL, &made) == COPHASE_BAD_SCENE);
}

static void estimator(const struct setting *s)
{
    cophase_estimator *made = NULL;

    (void)s;
    CHECK(cophase_estimator_create(scene, NULL, NULL, &made) == COPHASE_OK);
    cophase_estimator_destroy(made);
}

/* An estimate of one frame by an estimator that is kept. */
static void estimate(const struct setting *s)
{
    static cophase_estimator *kept;
    const cophase_input frames = frames_of(s, 1);
    const cophase_channel_images images = {NULL, &frames, NULL, NULL};
    cophase_estimate *made = NULL;

    if (kept == NULL)
        CHECK(cophase_estimator_create(scene, NULL, NULL, &kept) == COPHASE_OK);
    CHECK(cophase_estimator_estimate(kept, &images, 1, &made) == COPHASE_OK);
    cophase_estimate_destroy(made);
}

/* Doing it `times` times leaves the memory flat: a tenth of that comes first, for what is made once and kept, and 20 times at least,
 * where it counts, until the heap of large objects has its size: on a busy machine more threads allocate at once. */
static void repeat(const char *what, void (*once)(const struct setting *), const struct setting *s, long times,
                   long most_pages)
{
    const long tenth = times / 10, first = counts && tenth < 20 ? 20 : tenth;
    long i, before = 0, grown;

    for (i = -first; i < times; i++) {
        if (i == 0)
            before = resident_pages();
        once(s);
    }
    grown = resident_pages() - before;
    printf("%s: %ld times, %ld pages more\n", what, times, grown);
    CHECK(!counts || grown < most_pages);
}

/* Half a megabyte: 2,000 leaks of 263 bytes, or 10,000 of 53, are more. Models take and give back so much that the heap's
 * upper end moves by megabytes: 20 leaks of 840 kB, a fraction of a model, are more than that. */
enum { FEW = 128, MANY = 4096 };

int main(int argc, char **argv)
{
    struct setting s;
    cophase_input frames;
    size_t size;
    long times;

    if (argc != 3)
        return 2;
    scene = read_file(argv[1], &size);
    times = strtol(argv[2], NULL, 10);
    counts = times >= 2000;
    s = setting_of(scene);
    frames = frames_of(&s, COUNT);
    CHECK(cophase_session_fit(s.session, &frames, 1, NULL, s.fitted_nm, NULL, s.modes, NULL, 0, NULL, 0) == COPHASE_OK);
    repeat("sequence", sequence, &s, times, FEW);
    repeat("refused model", refused_model, &s, times, FEW);
    repeat("model", model, &s, times / 100, MANY); /* each takes 50 ms */
    repeat("estimator", estimator, &s, times / 10, FEW); /* each reads a scene */
    repeat("estimate", estimate, &s, times / 200, MANY);
    repeat("session", session, &s, times, FEW);
    repeat("session with a fit", working_session, &s, times, FEW);
    done_with(&s);
    free(scene);
    return failures == 0 ? 0 : 1;
}
