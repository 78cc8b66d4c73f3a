/*
 * Probe of the OpenCL drivers: a child process loads them and lists their devices, as discover.rs will do.
 *
 * A driver runs code of its own when it is loaded, and a broken one aborts the process or never returns: neither can be
 * caught. A program could execute itself with a hidden argument, but a library in C, Python or MATLAB has no program to
 * execute, so the child is a fork for all of them. What makes that safe enough:
 *   - The child calls nothing but this file and the loader, and ends with _exit: no handler of the parent runs, no buffer
 *     of the parent is written twice.
 *   - glibc makes its allocator usable in a forked child. A lock of another thread (of the dynamic linker, say) can be held
 *     in the child for ever; then the child does not answer, and is killed at the limit: the probe fails, nothing else.
 *   - A driver that is loaded already is not probed (probe.rs): its state may not survive a fork.
 * The answer comes through a pipe, so that a host's own handler of SIGCHLD may take the child's status.
 */
#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

int32_t clGetPlatformIDs(uint32_t num_entries, void **platforms, uint32_t *num_platforms);
int32_t clGetDeviceIDs(void *platform, uint64_t type, uint32_t num_entries, void **devices, uint32_t *num_devices);

#define ALL_DEVICES 0xFFFFFFFFu
#define MOST 64

/* Outcome of cophase_probe_opencl; a signal is PROBE_SIGNAL plus its number. */
#define PROBE_LOADED 0
#define PROBE_UNKNOWN 1
#define PROBE_HANGS 2
#define PROBE_EXITED 3
#define PROBE_SIGNAL 256

/* A driver that calls exit() would run the parent's handlers in the child: this one is registered last, and so runs first. */
static void leave(void) { _exit(1); }

static void load_and_report(int report) {
    atexit(leave);
    /* No core file, no output of the driver's, no signal that is meant for the parent. */
    struct rlimit none = {0, 0};
    setrlimit(RLIMIT_CORE, &none);
    for (int number = 1; number < 32; number++) signal(number, number == SIGINT ? SIG_IGN : SIG_DFL);
    sigset_t all;
    sigemptyset(&all);
    sigprocmask(SIG_SETMASK, &all, NULL);
    int null = open("/dev/null", O_RDWR);
    if (null >= 0) {
        dup2(null, STDIN_FILENO);
        dup2(null, STDOUT_FILENO);
        dup2(null, STDERR_FILENO);
    }
    void *platforms[MOST], *devices[MOST];
    uint32_t count = 0, found = 0;
    if (clGetPlatformIDs(MOST, platforms, &count) == 0)
        for (uint32_t i = 0; i < count && i < MOST; i++) clGetDeviceIDs(platforms[i], ALL_DEVICES, MOST, devices, &found);
    while (write(report, "k", 1) < 0 && errno == EINTR) {}
    _exit(0);
}

static int64_t now_ms(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

/* Loads the drivers in a child for at most limit_ms. */
int32_t cophase_probe_opencl(int32_t limit_ms) {
    int ends[2];
    if (pipe(ends) != 0) return PROBE_UNKNOWN;
    fcntl(ends[0], F_SETFD, FD_CLOEXEC);
    fcntl(ends[1], F_SETFD, FD_CLOEXEC);
    pid_t child = fork();
    if (child == 0) {
        close(ends[0]);
        load_and_report(ends[1]);
    }
    close(ends[1]);
    if (child < 0) {
        close(ends[0]);
        return PROBE_UNKNOWN;
    }
    int64_t end = now_ms() + limit_ms;
    int ready = 0;
    do {
        int64_t left = end - now_ms();
        struct pollfd waited = {ends[0], POLLIN, 0};
        ready = poll(&waited, 1, left > 0 ? (int)left : 0);
    } while (ready < 0 && errno == EINTR);
    char answer = 0;
    ssize_t got = 0;
    if (ready > 0) do got = read(ends[0], &answer, 1); while (got < 0 && errno == EINTR);
    close(ends[0]);
    if (ready == 0) kill(child, SIGKILL);
    int status = 0;
    pid_t ended;
    do ended = waitpid(child, &status, 0); while (ended < 0 && errno == EINTR);
    if (got == 1) return PROBE_LOADED;
    if (ready == 0) return PROBE_HANGS;
    if (ended != child) return PROBE_UNKNOWN;
    return WIFSIGNALED(status) ? PROBE_SIGNAL + WTERMSIG(status) : PROBE_EXITED;
}
