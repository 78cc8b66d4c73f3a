/*
 * libOpenCL, opened at run time.
 *
 * The crate `cl-sys` links `-lOpenCL`. `build.rs` compiles this file into a `libOpenCL.a` that precedes the
 * system's library in the search path, so that
 *   - a build needs no OpenCL development package, and
 *   - the program starts on a machine without OpenCL and reports zero platforms there.
 *
 * The first call opens the library that the variable COPHASE_OPENCL_LIBRARY names, or else libOpenCL.so.1, or else
 * libOpenCL.so, and looks up every entry point, once. Where the library or a symbol is absent, a call that
 * returns a status returns CL_PLATFORM_NOT_FOUND_KHR; one that returns a handle returns NULL and stores that status in
 * its last argument. The prototypes are those of the OpenCL 1.2 headers (Khronos registry), with enumerations,
 * bit fields and opaque handles replaced by the C types that represent them.
 */
#include <dlfcn.h>
#include <pthread.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

typedef int32_t cl_int;
typedef uint32_t cl_uint;
typedef uint64_t cl_flags; /* cl_bitfield */
typedef void *handle;      /* cl_context, cl_mem, ... */
typedef void (*callback)(void);

#define CL_PLATFORM_NOT_FOUND_KHR (-1001)

static pthread_once_t opened = PTHREAD_ONCE_INIT;
static void open_library(void);

/*
 * One slot per entry point: its address in the library, or NULL. The table below is expanded twice: here into the slots
 * and the functions that call through them, below into the list that `open_library` fills.
 */
#define SLOT(NAME) slot_##NAME

#define STATUS(NAME, PARAMETERS, ARGUMENTS)                                                                            \
    static cl_int(*SLOT(NAME)) PARAMETERS;                                                                             \
    cl_int NAME PARAMETERS {                                                                                           \
        pthread_once(&opened, open_library);                                                                           \
        return SLOT(NAME) ? SLOT(NAME) ARGUMENTS : CL_PLATFORM_NOT_FOUND_KHR;                                          \
    }

#define HANDLE(NAME, PARAMETERS, ARGUMENTS)                                                                            \
    static handle(*SLOT(NAME)) PARAMETERS;                                                                             \
    handle NAME PARAMETERS {                                                                                           \
        pthread_once(&opened, open_library);                                                                           \
        if (SLOT(NAME)) return SLOT(NAME) ARGUMENTS;                                                                   \
        if (error) *error = CL_PLATFORM_NOT_FOUND_KHR;                                                                 \
        return NULL;                                                                                                   \
    }

#define ADDRESS(NAME, PARAMETERS, ARGUMENTS)                                                                           \
    static void *(*SLOT(NAME)) PARAMETERS;                                                                             \
    void *NAME PARAMETERS {                                                                                            \
        pthread_once(&opened, open_library);                                                                           \
        return SLOT(NAME) ? SLOT(NAME) ARGUMENTS : NULL;                                                               \
    }

#include "loader_table.h"

#undef STATUS
#undef HANDLE
#undef ADDRESS

struct entry {
    const char *name;
    void *slot;
};
#define STATUS(NAME, PARAMETERS, ARGUMENTS) {#NAME, (void *)&SLOT(NAME)},
#define HANDLE STATUS
#define ADDRESS STATUS
static const struct entry entries[] = {
#include "loader_table.h"
};

static void open_library(void) {
    const char *chosen = getenv("COPHASE_OPENCL_LIBRARY");
    void *library = NULL;
    if (chosen && *chosen) {
        library = dlopen(chosen, RTLD_NOW | RTLD_LOCAL);
    } else {
        library = dlopen("libOpenCL.so.1", RTLD_NOW | RTLD_LOCAL);
        if (!library) library = dlopen("libOpenCL.so", RTLD_NOW | RTLD_LOCAL);
    }
    if (!library) return;
    for (size_t i = 0; i < sizeof entries / sizeof entries[0]; i++)
        *(void **)entries[i].slot = dlsym(library, entries[i].name);
}
