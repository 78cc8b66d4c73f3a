/* Threads that come at the wrong time, cancellation, lifetimes and panics; see tests/c_api/main.rs:
 *
 *   threads SCENE.toml
 *
 * The library must be one with debug assertions: only there does COPHASE_FAULT make a call fail from within. */
#if !defined(_POSIX_C_SOURCE)
#define _POSIX_C_SOURCE 200809L
#endif
#include "setting.h"
#include <pthread.h>
#include <sched.h>

/* What a second thread does with the setting's session, and what it counted. */
struct worker {
    const struct setting *s;
    pthread_mutex_t mutex; /* of `over` */
    int over;
    size_t fits, busy, interrupted;
};

static int is_over(struct worker *w)
{
    int over;

    pthread_mutex_lock(&w->mutex);
    over = w->over;
    pthread_mutex_unlock(&w->mutex);
    return over;
}

/* Fits until it is told that it is over, or until it is interrupted. */
static void *fit_on(void *argument)
{
    struct worker *w = (struct worker *)argument;
    const cophase_input frames = frames_of(w->s, COUNT);
    double *found_nm = doubles(COUNT * w->s->modes);

    while (!is_over(w) && w->interrupted == 0) {
        const cophase_status status = cophase_session_fit(w->s->session, &frames, 1, NULL, found_nm, NULL, w->s->modes, NULL, 0, NULL, 0);

        w->fits += status == COPHASE_OK;
        w->busy += status == COPHASE_BUSY;
        w->interrupted += status == COPHASE_INTERRUPTED;
        CHECK(status == COPHASE_OK || status == COPHASE_BUSY || status == COPHASE_INTERRUPTED);
    }
    free(found_nm);
    return NULL;
}

static void start(struct worker *w, const struct setting *s, pthread_t *thread)
{
    memset(w, 0, sizeof *w);
    w->s = s;
    if (pthread_mutex_init(&w->mutex, NULL) != 0 || pthread_create(thread, NULL, fit_on, w) != 0)
        exit(2);
}

static void finish(struct worker *w, pthread_t thread)
{
    pthread_mutex_lock(&w->mutex);
    w->over = 1;
    pthread_mutex_unlock(&w->mutex);
    pthread_join(thread, NULL);
    pthread_mutex_destroy(&w->mutex);
}

/* Two threads on one session: one of them is sent away, and nothing is done for it. */
static void two_on_one_session(const struct setting *s)
{
    const cophase_input frames = frames_of(s, 1);
    double *found_nm = doubles(s->modes);
    cophase_sequence *sequence = NULL;
    cophase_status status;
    struct worker other;
    pthread_t thread;

    CHECK(cophase_sequence_create(s->model, 4, &sequence) == COPHASE_OK);
    start(&other, s, &thread);
    /* The other thread is nearly always inside: this ends. */
    do {
        found_nm[0] = UNTOUCHED;
        status = cophase_session_fit(s->session, &frames, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0);
        CHECK(status == COPHASE_OK || status == COPHASE_BUSY);
        sched_yield();
    } while (status == COPHASE_OK);
    REFUSED(COPHASE_BUSY, "another thread", status);
    CHECK(found_nm[0] == UNTOUCHED);
    /* A push reads what a fit writes. */
    do {
        status = cophase_sequence_push(sequence, s->session);
        CHECK(status == COPHASE_OK || status == COPHASE_BUSY || status == COPHASE_BAD_VALUE);
        sched_yield();
    } while (status != COPHASE_BUSY);
    finish(&other, thread);
    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    cophase_sequence_destroy(sequence);
    free(found_nm);
}

/* One cancel, one fit that is interrupted, whether it was running or came next. */
static void cancel(const struct setting *s)
{
    const cophase_input frames = frames_of(s, COUNT);
    double *found_nm = doubles(COUNT * s->modes);
    struct worker other;
    pthread_t thread;

    start(&other, s, &thread);
    CHECK(cophase_session_cancel(s->session) == COPHASE_OK);
    pthread_join(thread, NULL); /* it ends by itself */
    CHECK(other.interrupted == 1);
    pthread_mutex_destroy(&other.mutex);

    CHECK(cophase_session_cancel(s->session) == COPHASE_OK);
    CHECK(cophase_session_cancel(s->session) == COPHASE_OK);
    REFUSED(COPHASE_INTERRUPTED, "", cophase_session_fit(s->session, &frames, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0));
    CHECK(untouched(found_nm, COUNT * s->modes) == COUNT * s->modes);
    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    free(found_nm);
}

/* A model is shared; each thread has a session of its own. */
static void *fit_alone(void *argument)
{
    const struct setting *s = (const struct setting *)argument;
    const cophase_input frames = frames_of(s, COUNT);
    double *found_nm = doubles(COUNT * s->modes);
    cophase_session *session = session_for(s->model, COUNT);
    size_t i;

    for (i = 0; i < 20; i++)
        CHECK(cophase_session_fit(session, &frames, 1, NULL, found_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    cophase_session_destroy(session);
    return found_nm;
}

static void one_model_for_all(struct setting *s)
{
    enum { THREADS = 3 };
    pthread_t threads[THREADS];
    void *found_nm = NULL;
    size_t i;

    s->fitted_nm = (double *)memcpy(s->fitted_nm, found_nm = fit_alone(s), COUNT * s->modes * sizeof *s->fitted_nm);
    free(found_nm);
    for (i = 0; i < THREADS; i++)
        if (pthread_create(&threads[i], NULL, fit_alone, s) != 0)
            exit(2);
    for (i = 0; i < THREADS; i++) {
        pthread_join(threads[i], &found_nm);
        CHECK(memcmp(found_nm, s->fitted_nm, COUNT * s->modes * sizeof *s->fitted_nm) == 0);
        free(found_nm);
    }
}

/* Children keep what they need of their parents. */
static void orphans(const char *scene)
{
    struct setting s = setting_of(scene);
    const cophase_input frames = frames_of(&s, 1);
    cophase_sequence *sequence = NULL;
    cophase_sequence_report report;
    const char *name = NULL;

    cophase_session_destroy(s.session);
    CHECK(cophase_session_create(s.model, NULL, &s.session) == COPHASE_OK);
    CHECK(cophase_sequence_create(s.model, 2, &sequence) == COPHASE_OK);
    CHECK(cophase_model_mode_name(s.model, 0, &name) == COPHASE_OK);
    cophase_model_destroy(s.model);
    s.model = NULL;
    CHECK(cophase_session_fit(s.session, &frames, 1, NULL, s.fitted_nm, NULL, s.modes, NULL, 0, NULL, 0) == COPHASE_OK);
    CHECK(cophase_sequence_push(sequence, s.session) == COPHASE_OK);
    cophase_session_destroy(s.session);
    s.session = NULL;
    CHECK(cophase_sequence_estimate(sequence, s.fitted_nm, NULL, NULL, s.modes, &report, sizeof report) == COPHASE_OK);
    CHECK(report.images == 1);
    cophase_sequence_destroy(sequence);
    done_with(&s);
}

static cophase_status with_fault(const char *kind, struct setting *s, const cophase_input *frames)
{
    cophase_status status;

    setenv("COPHASE_FAULT", kind, 1);
    status = cophase_session_fit(s->session, frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0);
    unsetenv("COPHASE_FAULT");
    return status;
}

/* A broken promise inside: a status and a sentence. After a panic the object can only be destroyed; all others live. */
static void faults(struct setting *s)
{
    const cophase_input frames = frames_of(s, 1);
    cophase_session *const other = session_for(s->model, 1);
    cophase_sequence *sequence = NULL;
    cophase_model_info info;

    CHECK(cophase_sequence_create(s->model, 2, &sequence) == COPHASE_OK);
    REFUSED(COPHASE_INTERNAL, "report", with_fault("internal", s, &frames));
    CHECK(cophase_session_fit(s->session, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);

    REFUSED(COPHASE_PANIC, "report", with_fault("panic", s, &frames));
    REFUSED(COPHASE_PANIC, "destroyed", cophase_session_fit(s->session, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0));
    REFUSED(COPHASE_PANIC, "destroyed", cophase_session_evaluate(s->session, 0, &frames, NULL, s->truth_nm, 1, s->modes, s->fitted_nm, s->fitted_nm));
    REFUSED(COPHASE_PANIC, "destroyed", cophase_session_calibrate(s->session, 0, NULL));
    REFUSED(COPHASE_PANIC, "destroyed", cophase_sequence_push(sequence, s->session));
    REFUSED(COPHASE_BAD_IMAGE, "", cophase_sequence_estimate(sequence, s->fitted_nm, NULL, NULL, s->modes, NULL, 0));
    CHECK(cophase_session_fit(other, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    CHECK(cophase_sequence_push(sequence, other) == COPHASE_OK);

    info.modes = 7;
    setenv("COPHASE_FAULT", "panic", 1);
    REFUSED(COPHASE_PANIC, "report", cophase_model_get_info(s->model, &info, sizeof info));
    REFUSED(COPHASE_PANIC, "report", cophase_sequence_push(sequence, NULL));
    unsetenv("COPHASE_FAULT");
    REFUSED(COPHASE_PANIC, "destroyed", cophase_model_get_info(s->model, &info, sizeof info));
    REFUSED(COPHASE_PANIC, "destroyed", cophase_sequence_push(sequence, NULL));
    CHECK(info.modes == 7);
    CHECK(cophase_session_fit(other, &frames, 1, NULL, s->fitted_nm, NULL, s->modes, NULL, 0, NULL, 0) == COPHASE_OK);
    cophase_session_destroy(other);
    cophase_sequence_destroy(sequence);
}

int main(int argc, char **argv)
{
    struct setting s;
    size_t size;
    char *scene;

    if (argc != 2)
        return 2;
    scene = read_file(argv[1], &size);
    s = setting_of(scene);
    one_model_for_all(&s);
    two_on_one_session(&s);
    cancel(&s);
    orphans(scene);
    faults(&s);
    free(scene);
    done_with(&s);
    return failures == 0 ? 0 : 1;
}
