/* A real-time controller in small. One thread stands for the camera: it delivers frames at a set rate and never waits.
 * Another estimates from them. The third, which may take its time, prints what is static in all of them.
 *
 *   rtc [-r HZ] [-n COUNT] [-d DEVICE] [-t DEADLINE_MS] SCENE.toml FRAMES
 *
 * FRAMES is a FITS file of floats, such as `cophase image` writes, or shm:/NAME, shared memory full of frames of native
 * floats; after its last frame comes the first again. DEVICE is one of those that `cophase devices` lists.
 *
 *   cc -std=c11 -O2 rtc.c -o rtc $(pkg-config --cflags --libs cophase) -pthread -lm
 */
#define _POSIX_C_SOURCE 200809L
#include "frames.h"
#include <cophase.h>
#include <errno.h>
#include <libgen.h>
#include <math.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <time.h>

enum { SLOTS = 4, KEPT = 200, PRINT_S = 5 }; /* frames that may wait; images behind the running estimate; its period */

/* One thread writes, one reads, and each changes its own counter only: no lock is needed. */
static struct {
    struct { double arrived_s; float *pixels; } slots[SLOTS];
    atomic_size_t written, read;
    sem_t news;
} queue;

static struct cube cube;
static double rate_hz = 10.0;
static size_t count = 1000, dropped; /* of the camera, as of here: frames */
static cophase_session *session;     /* of the estimator */
static cophase_fit_options options = {.struct_size = sizeof options};
static double *coefficients_nm, *latency_s;
static size_t modes, done, late, skipped;
static sem_t finished;
static cophase_sequence *sequence; /* of the estimator and of the printer */

static void check(cophase_status status)
{
    char sentence[512];

    cophase_last_error(sentence, sizeof sentence);
    if (status != COPHASE_OK)
        die("%s: %s", cophase_status_name(status), sentence);
}

static double now_s(void)
{
    struct timespec now;

    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* The thread that calls this goes before all others but those of a higher priority: what bounds the latency. */
static void ask_for_priority(int priority)
{
    const struct sched_param wanted = {.sched_priority = priority};
    const int refused = pthread_setschedparam(pthread_self(), SCHED_FIFO, &wanted);

    if (refused != 0)
        fprintf(stderr, "rtc: SCHED_FIFO is refused (%s): other programs may delay a frame\n", strerror(refused));
}

/* Your frame grabber goes here. Nothing in it waits for the estimator: a frame that finds all slots taken is dropped. */
static void *camera(void *unused)
{
    const double start_s = now_s();
    size_t k;

    ask_for_priority(41);
    for (k = 0; k < count; k++) {
        const double due_s = start_s + (double)k / rate_hz;
        const struct timespec due = {(time_t)due_s, (long)(1e9 * fmod(due_s, 1.0))};
        const size_t written = queue.written;

        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, NULL);
        if (written - queue.read == SLOTS) {
            dropped++;
            continue;
        }
        queue.slots[written % SLOTS].arrived_s = now_s();
        copy_frame(&cube, k, queue.slots[written % SLOTS].pixels);
        queue.written = written + 1;
        sem_post(&queue.news);
    }
    sem_post(&queue.news); /* news without a frame: there will be none */
    return unused;
}

/* Fits every frame that comes, until the camera is done. On the CPU chain nothing here allocates or waits for a lock. */
static void *estimator(void *unused)
{
    cophase_input frame = {NULL, COPHASE_F32, 1, cube.rows, cube.cols, 0, (ptrdiff_t)cube.cols, 1};

    ask_for_priority(40);
    for (;;) {
        const size_t next = queue.read;
        cophase_image_report report;
        cophase_status pushed;

        while (sem_wait(&queue.news) != 0) {} /* a signal may end the wait early */
        if (queue.written == next)
            break;
        frame.data = queue.slots[next % SLOTS].pixels;
        check(cophase_session_fit(session, &frame, 1, &options, coefficients_nm, NULL, modes, &report, sizeof report,
                                  NULL, 0));
        pushed = cophase_sequence_push(sequence, session);
        if (pushed == COPHASE_BUSY) /* it is being read: do not wait, push the next image instead */
            skipped++;
        else
            check(pushed);
        latency_s[done++] = now_s() - queue.slots[next % SLOTS].arrived_s;
        late += report.status == COPHASE_IMAGE_DEADLINE;
        queue.read = next + 1;
    }
    sem_post(&finished);
    return unused;
}

static void print_estimate(double *static_nm)
{
    cophase_sequence_report all;

    /* BAD_IMAGE while none could be used, BUSY while one is pushed. */
    if (cophase_sequence_estimate(sequence, static_nm, NULL, NULL, modes, &all, sizeof all) == COPHASE_OK)
        printf("%llu of %llu images: phasing %.2f +- %.2f nm, NCPA %.2f +- %.2f nm RMS\n", (unsigned long long)all.used,
               (unsigned long long)all.images, all.phasing_rms_nm, all.phasing_sigma_nm, all.ncpa_rms_nm,
               all.ncpa_sigma_nm);
    fflush(stdout);
}

/* A line every few seconds until the estimator is done, and one at the end. */
static void print_estimates(void)
{
    double *static_nm = calloc(modes, sizeof *static_nm);
    struct timespec until;
    int again;

    do {
        clock_gettime(CLOCK_REALTIME, &until); /* the clock of sem_timedwait */
        until.tv_sec += PRINT_S;
        while ((again = sem_timedwait(&finished, &until)) != 0 && errno == EINTR) {}
        print_estimate(static_nm);
    } while (again != 0);
    free(static_nm);
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;

    return (x > y) - (x < y);
}

static double latency_ms(double fraction)
{
    return 1e3 * latency_s[(size_t)(fraction * (double)(done - 1))];
}

int main(int argc, char **argv)
{
    cophase_session_options session_options = {.struct_size = sizeof session_options, .device = "cpu"};
    const unsigned char *bytes;
    char *scene;
    size_t i, length;
    cophase_model_info info;
    cophase_model *model;
    pthread_t threads[2];

    for (int option; (option = getopt(argc, argv, "r:n:d:t:")) != -1;)
        switch (option) {
        case 'r': rate_hz = atof(optarg); break;
        case 'n': count = strtoul(optarg, NULL, 10); break;
        case 'd': session_options.device = optarg; break;
        case 't': options.deadline_s = 1e-3 * atof(optarg); break;
        default: return 2;
        }
    if (argc - optind != 2 || !(rate_hz > 0.0) || count == 0)
        die("usage: rtc [-r HZ] [-n COUNT] [-d DEVICE] [-t DEADLINE_MS] SCENE.toml FRAMES");

    /* All that takes long or allocates comes before the first frame. */
    bytes = mapped(argv[optind], &length);
    scene = strndup((const char *)bytes, length);
    check(cophase_model_create(scene, dirname(argv[optind]), NULL, &model));
    free(scene);
    check(cophase_session_create(model, &session_options, &session));
    check(cophase_sequence_create(model, KEPT, &sequence));
    check(cophase_model_get_info(model, &info, sizeof info));
    modes = info.modes;
    cube = open_cube(argv[optind + 1], info.rows, info.cols);
    coefficients_nm = calloc(modes, sizeof *coefficients_nm);
    latency_s = calloc(count, sizeof *latency_s);
    for (i = 0; i < SLOTS; i++)
        queue.slots[i].pixels = calloc(info.rows * info.cols, sizeof(float));
    if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0)
        fprintf(stderr, "rtc: memory is not locked (%s): page faults may delay a frame\n", strerror(errno));
    if (sem_init(&queue.news, 0, 0) != 0 || sem_init(&finished, 0, 0) != 0 ||
        pthread_create(&threads[0], NULL, estimator, NULL) != 0 || pthread_create(&threads[1], NULL, camera, NULL) != 0)
        die("a thread cannot be started");
    print_estimates();
    pthread_join(threads[0], NULL);
    pthread_join(threads[1], NULL);

    qsort(latency_s, done, sizeof *latency_s, ascending);
    printf("%zu frames: %zu estimated, %zu dropped, %zu past the deadline, %zu not in the running estimate\n", count, done,
           dropped, late, skipped);
    printf("latency from arrival to estimate: p50 %.3f ms, p99 %.3f ms, max %.3f ms\n", latency_ms(0.5),
           latency_ms(0.99), latency_ms(1.0));
    cophase_sequence_destroy(sequence);
    cophase_session_destroy(session);
    cophase_model_destroy(model);
    for (i = 0; i < SLOTS; i++)
        free(queue.slots[i].pixels);
    free(latency_s);
    free(coefficients_nm);
    return 0;
}
