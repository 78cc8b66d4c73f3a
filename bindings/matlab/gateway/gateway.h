/* What the files of the gateway share. Each noun of the C interface has one file, which ends in the table of its
 * commands; what a command receives and returns is said there.
 *
 * No function here returns where it fails: it raises cophase:<STATUS> in MATLAB, with one sentence. So a command holds
 * nothing that must be given back while it calls one of these, save memory of mxMalloc and arrays of mxCreate, which
 * MATLAB frees. */
#ifndef GATEWAY_H
#define GATEWAY_H

#include <cophase.h>
#include <mex.h>

/* ---- commands */

typedef struct command {
    const char *name; /* "noun.verb" */
    int least, most;  /* how many arguments it takes */
    void (*run)(int outputs, mxArray **out, int inputs, const mxArray **in);
} command;

/* Each ends with a name of NULL. */
extern const command MODEL_COMMANDS[], SESSION_COMMANDS[], FIT_COMMANDS[], SEQUENCE_COMMANDS[], SIMULATOR_COMMANDS[],
    FULL_PHASE_COMMANDS[];

/* Takes as many arguments as it is given: for `most`. */
#define ANY_NUMBER 1000

/* ---- failures (arguments.c) */

/* Raises the status with a sentence in printf's format. */
void fail(cophase_status status, const char *format, ...);

/* Raises what the library says of its last call in this thread, if that failed. */
void check(cophase_status status);

/* ---- arguments (arguments.c); `name` stands in the sentence of a failure */

/* A real scalar of any numeric class. */
double number(const mxArray *value, const char *name);

/* A whole number, from `least` on. */
size_t whole(const mxArray *value, size_t least, const char *name);

/* Text in UTF-8, of characters or of a MATLAB string; NULL if the value is NULL or empty. MATLAB frees it. */
const char *text(const mxArray *value, const char *name);

/* A rows x cols x count array as it lies in MATLAB's memory, of any class that cameras deliver. */
cophase_input input(const mxArray *value, const char *name);

/* Doubles of that many rows and columns; those of one column may lie in a row. */
const double *doubles(const mxArray *value, size_t rows, size_t cols, const char *name);

/* Reads NAME, VALUE, ... into `values`, which has a place for each of `names`, a list that ends with NULL: NULL for one
 * that was not given, or that is empty. As everywhere in MATLAB case does not matter, and the beginning of a name that
 * no other one has is enough. */
void options(int inputs, const mxArray **in, const char *const *names, const mxArray **values);

/* What raw values mean, from 'Dark', dark, ... (session.c). */
cophase_calibration calibration_of(int inputs, const mxArray **in);

/* ---- results (arguments.c) */

/* Single maps (y, x, k) of `side` x `side` samples, and the library's view of them. */
mxArray *maps(size_t rows, size_t cols, size_t count, cophase_array_f32 *view);

/* Sets a field of element `index` of a struct array. */
void set_number(mxArray *record, size_t index, const char *field, double value);

/* ---- handles (handles.c)
 *
 * MATLAB holds numbers that are never used again, not pointers: one that is stale, made up, or of another noun finds
 * nothing, instead of memory that is not what it was taken for. */

typedef enum noun { MODEL, SESSION, SEQUENCE, SIMULATOR, FULL_PHASE } noun;

typedef struct live {
    double id;
    noun noun;
    void *object;
    size_t modes;  /* of a model, a session, a sequence: how many coefficients there are */
    size_t images; /* of a session: how many the last fit had */
    struct live *next;
} live;

/* Takes an object over. Its number is in the result's `id`. */
live *handle_new(noun noun, void *object, size_t modes);

/* The living object that a number stands for. */
live *handle_of(const mxArray *value, noun noun);

/* Destroys it. */
void handle_delete(const mxArray *value, noun noun);

void handle_delete_all(void);

/* ---- Ctrl-C (interrupt.c) */

/* Does the work in a thread of its own, while this one waits for Ctrl-C and then cancels the object; returns when the
 * work is done. Raises what the work fails with, COPHASE_INTERRUPTED after Ctrl-C in any case. */
typedef cophase_status cancel_call(const void *object);
void interruptible(cancel_call *cancel, const void *object, cophase_status (*work)(void *), void *argument);

#endif
