/* Ctrl-C during a long call.
 *
 * MATLAB and Octave hear Ctrl-C between statements only, and neither documents a way to hear it within one. In a terminal
 * it is a SIGINT, which is caught here while the work runs. MATLAB's desktop sends none, but its libut, undocumented and
 * unchanged for twenty years, tells that Ctrl-C was pressed; only the thread that MATLAB called may ask. So that thread
 * waits and asks, and the work is done in another. Windows has neither signal nor pthreads: there the work is done here,
 * and a deadline is what bounds it. */
#include "gateway.h"

#ifdef _WIN32

void interruptible(const cophase_session *session, cophase_status (*work)(void *), void *argument)
{
    (void)session;
    check(work(argument));
}

#else

#include <pthread.h>
#include <signal.h>
#include <string.h>
#include <time.h>

#ifdef MATLAB_MEX_FILE
extern bool utIsInterruptPending(void);
extern bool utSetInterruptPending(bool pending);
#endif

/* How often Ctrl-C is asked for: soon for a hand, seldom for a processor. */
#define POLL_NS 20000000L

/* What a new thread has on Linux; macOS would give it a sixteenth of this, too little for the library's frames. */
#define STACK_BYTES (8u << 20)

typedef struct job {
    cophase_status (*work)(void *);
    void *argument;
    cophase_status status;
    char sentence[2049]; /* of a failure: it is known to the thread alone that failed */
    int done;
    pthread_mutex_t lock;
    pthread_cond_t ended;
} job;

static volatile sig_atomic_t signalled;

static void on_sigint(int number)
{
    (void)number;
    signalled = 1;
}

static int ctrl_c(void)
{
#ifdef MATLAB_MEX_FILE
    if (utIsInterruptPending()) {
        utSetInterruptPending(false); /* heard: MATLAB would stop the script a second time */
        signalled = 1;
    }
#endif
    return signalled;
}

static void *do_work(void *argument)
{
    job *job = (struct job *)argument;
    const cophase_status status = job->work(job->argument);

    if (status != COPHASE_OK)
        cophase_last_error(job->sentence, sizeof job->sentence);
    pthread_mutex_lock(&job->lock);
    job->status = status;
    job->done = 1;
    pthread_cond_signal(&job->ended);
    pthread_mutex_unlock(&job->lock);
    return NULL;
}

/* Until the job is done; tells whether the session was cancelled. */
static int wait_for(job *job, const cophase_session *session)
{
    int cancelled = 0;

    pthread_mutex_lock(&job->lock);
    while (!job->done) {
        struct timespec until;

        clock_gettime(CLOCK_REALTIME, &until);
        until.tv_nsec += POLL_NS;
        until.tv_sec += until.tv_nsec / 1000000000L;
        until.tv_nsec %= 1000000000L;
        pthread_cond_timedwait(&job->ended, &job->lock, &until);
        if (!job->done && !cancelled && ctrl_c())
            cancelled = cophase_session_cancel(session) == COPHASE_OK;
    }
    pthread_mutex_unlock(&job->lock);
    return cancelled;
}

/* The job in a thread of its own, or where none is to be had in this one, deaf to Ctrl-C. */
static int run(job *job, const cophase_session *session)
{
    pthread_attr_t attributes;
    pthread_t thread;
    int cancelled = 0, failed;

    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, STACK_BYTES);
    failed = pthread_create(&thread, &attributes, do_work, job);
    pthread_attr_destroy(&attributes);
    if (failed) {
        do_work(job);
    } else {
        cancelled = wait_for(job, session);
        pthread_join(thread, NULL);
    }
    return cancelled;
}

void interruptible(const cophase_session *session, cophase_status (*work)(void *), void *argument)
{
    struct sigaction listen, before;
    job job;
    int cancelled;

    memset(&job, 0, sizeof job);
    job.work = work;
    job.argument = argument;
    pthread_mutex_init(&job.lock, NULL);
    pthread_cond_init(&job.ended, NULL);

    memset(&listen, 0, sizeof listen);
    listen.sa_handler = on_sigint;
    sigemptyset(&listen.sa_mask);
    signalled = 0;
    sigaction(SIGINT, &listen, &before);
    cancelled = run(&job, session);
    /* Cancelled when all was done but the end: that would fall on the next fit, which nobody wants to stop. The frames
     * are the same, so they can be what it falls on. */
    if (cancelled && job.status != COPHASE_INTERRUPTED)
        job.work(job.argument);
    sigaction(SIGINT, &before, NULL);

    pthread_cond_destroy(&job.ended);
    pthread_mutex_destroy(&job.lock);
    if (cancelled || signalled)
        fail(COPHASE_INTERRUPTED, "Ctrl-C stopped the fit: its images have no estimate");
    if (job.status != COPHASE_OK)
        fail(job.status, "%s", job.sentence);
}

#endif
