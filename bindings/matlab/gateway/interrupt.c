/* Ctrl-C during a long call.
 *
 * MATLAB and Octave act on Ctrl-C between statements only. While a call runs they set a flag, also on SIGINT: in Octave it
 * is in quit.h, in MATLAB in libut, which is undocumented but has been the same for twenty years. Only the thread that was
 * called may read it. So this thread waits and reads the flag, and another one does the work. MATLAB's compilers for
 * Windows have no pthreads in common: there this thread does the work, and a deadline bounds it. */
#include "gateway.h"

#if defined(_WIN32) && defined(MATLAB_MEX_FILE)

void interruptible(cancel_call *cancel, const void *object, cophase_status (*work)(void *), void *argument)
{
    (void)cancel, (void)object;
    check(work(argument));
}

#else

#include <pthread.h>
#include <string.h>
#include <time.h>

/* Whether Ctrl-C was pressed. Clears the flag, so that nothing else stops because of it. */
#ifdef MATLAB_MEX_FILE

extern bool utIsInterruptPending(void);
extern bool utSetInterruptPending(bool pending);

static int ctrl_c(void)
{
    const int pressed = utIsInterruptPending();

    if (pressed)
        utSetInterruptPending(false);
    return pressed;
}

#else

#include <octave/quit.h>

static int ctrl_c(void)
{
    const int pressed = octave_interrupt_state > 0;

    if (pressed)
        octave_interrupt_state = 0;
    return pressed;
}

#endif

/* Interval between two looks at the flag: short for a person, long for a processor. */
#define POLL_NS 20000000L

/* Stack of a new thread on Linux. The default of macOS is a sixteenth of this, too little for the library. */
#define STACK_BYTES (8u << 20)

typedef struct job {
    cancel_call *cancel;
    const void *object; /* to be cancelled */
    cophase_status (*work)(void *);
    void *argument;
    cophase_status status;
    char sentence[SENTENCE_BYTES]; /* of a failure: only the thread that failed can read it */
    int done;
    pthread_mutex_t lock;
    pthread_cond_t ended;
} job;

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

/* Waits until the job is done; whether there was a Ctrl-C before. */
static int wait_for(job *job)
{
    int pressed = 0;

    pthread_mutex_lock(&job->lock);
    while (!job->done) {
        struct timespec until;

        clock_gettime(CLOCK_REALTIME, &until);
        until.tv_nsec += POLL_NS;
        until.tv_sec += until.tv_nsec / 1000000000L;
        until.tv_nsec %= 1000000000L;
        pthread_cond_timedwait(&job->ended, &job->lock, &until);
        if (!job->done && !pressed && ctrl_c()) {
            job->cancel(job->object);
            pressed = 1;
        }
    }
    pthread_mutex_unlock(&job->lock);
    return pressed;
}

/* Does the job in a thread of its own, or in this one, without Ctrl-C, if no thread can be started. */
static int run(job *job)
{
    pthread_attr_t attributes;
    pthread_t thread;
    int failed, pressed;

    pthread_attr_init(&attributes);
    pthread_attr_setstacksize(&attributes, STACK_BYTES);
    failed = pthread_create(&thread, &attributes, do_work, job);
    pthread_attr_destroy(&attributes);
    if (failed) {
        do_work(job);
        return 0;
    }
    pressed = wait_for(job);
    pthread_join(thread, NULL);
    return pressed;
}

void interruptible(cancel_call *cancel, const void *object, cophase_status (*work)(void *), void *argument)
{
    job job;
    int pressed;

    memset(&job, 0, sizeof job);
    job.cancel = cancel;
    job.object = object;
    job.work = work;
    job.argument = argument;
    pthread_mutex_init(&job.lock, NULL);
    pthread_cond_init(&job.ended, NULL);
    pressed = run(&job);
    pthread_cond_destroy(&job.ended);
    pthread_mutex_destroy(&job.lock);

    /* The work ended before it was cancelled: the cancellation would stop the next call. Make this call once more, which it
     * stops instead. */
    if (pressed && job.status != COPHASE_INTERRUPTED)
        work(argument);
    if (pressed)
        fail(COPHASE_INTERRUPTED, "Ctrl-C stopped it: these images have no estimate");
    if (job.status != COPHASE_OK)
        fail(job.status, "%s", job.sentence);
}

#endif
