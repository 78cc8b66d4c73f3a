/* Declarations that the files of the gateway share. Each object of the C interface has one file, which ends in the table
 * of its commands, with their arguments and results in comments.
 *
 * A function that fails does not return: it raises cophase:<STATUS> in MATLAB, with one sentence. So a command must not
 * hold resources when it calls one of these, except memory of mxMalloc and arrays of mxCreate, which MATLAB frees. */
#ifndef GATEWAY_H
#define GATEWAY_H

#include <cophase_simulator.h>
#include <mex.h>
#include <stddef.h>

/* ---- commands */

typedef struct command {
    const char *name; /* "noun.verb" */
    int least, most;  /* number of arguments */
    void (*run)(int outputs, mxArray **out, int inputs, const mxArray **in);
} command;

/* Each ends with a name of NULL. */
extern const command MODEL_COMMANDS[], ESTIMATE_COMMANDS[], SESSION_COMMANDS[], SEQUENCE_COMMANDS[], SIMULATOR_COMMANDS[];

/* For `most`: any number of arguments. */
#define ANY_NUMBER 1000

/* ---- failures (arguments.c) */

/* Bytes of the longest sentence of the library, its zero included. */
#define SENTENCE_BYTES 2049

/* Raises the status with a sentence in printf's format. */
void fail(cophase_status status, const char *format, ...);

/* Raises the failure of the library's last call in this thread, if it failed. */
void check(cophase_status status);

/* ---- arguments (arguments.c); `name` is part of the sentence of a failure */

/* A real scalar of any numeric class. */
double number(const mxArray *value, const char *name);

/* The number of an option, other than 0: that means the default in C. */
double chosen(const mxArray *value, const char *name);

/* A whole number, from `least` on. */
size_t whole(const mxArray *value, size_t least, const char *name);

/* A number of threads; -1 is one per processor. */
int32_t threads(const mxArray *value);

/* Text in UTF-8, of characters or of a MATLAB string; NULL if the value is NULL or empty. MATLAB frees it. */
const char *text(const mxArray *value, const char *name);

/* A rows x cols x count array in MATLAB's memory, of any class that the library reads. */
cophase_input input(const mxArray *value, const char *name);

/* Doubles of that many rows and columns; those of one column may lie in a row. */
const double *doubles(const mxArray *value, size_t rows, size_t cols, const char *name);

/* Reads NAME, VALUE, ... into `values`, which has an element for each of `names`, a list that ends with NULL: NULL for an
 * option that is absent or empty. As usual in MATLAB, case does not matter, and an unambiguous beginning of a name is
 * enough. */
void options(int inputs, const mxArray **in, const char *const *names, const mxArray **values);

/* A calibration; each part may be NULL (session.c). */
cophase_calibration calibration_of(const mxArray *dark, const mxArray *flat, const mxArray *bad, const mxArray *gain_e,
                                   const mxArray *saturation);

/* Numbers of the header by name; lists end with a name of NULL. */
typedef struct constant_name {
    const char *name;
    int32_t number;
} constant_name;

extern const constant_name POLICIES[], PRECISIONS[];

/* The number of the constant that a text names. */
int32_t choice(const mxArray *value, const constant_name *choices, const char *name);

/* ---- results (arguments.c) */

/* `count` doubles: an array of the library in C order, which the classes of +cophase reshape. */
mxArray *column(size_t count);

/* A text of the library of any length. */
typedef cophase_status text_call(const void *object, int32_t what, size_t index, char *text, size_t capacity,
                                 size_t *length);
mxArray *long_text(text_call *call, const void *object, int32_t what, size_t index);

/* A field of a struct of the library; lists end with a name of NULL. */
typedef struct field {
    const char *name;
    size_t offset;
    enum { IS_SIZE, IS_COUNT, IS_INT, IS_DOUBLE, IS_LOGICAL, IS_STATUS, IS_NAMED } kind;
    const constant_name *names; /* of IS_NAMED */
} field;

#define FIELD(type, member, kind) {#member, offsetof(type, member), kind, NULL}
#define NAMED_FIELD(type, member, names) {#member, offsetof(type, member), IS_NAMED, names}
#define END_OF_FIELDS {NULL, 0, IS_INT, NULL}

extern const field IMAGE_REPORT[]; /* session.c */

/* `count` structs of the library, of `size` bytes each, as a struct array. */
mxArray *structs(const field *fields, const void *items, size_t size, size_t count);

/* ---- handles (handles.c)
 *
 * MATLAB holds numbers that are never used again, not pointers. So a number that is stale, made up, or of an object of
 * another class is refused. */

typedef enum noun { MODEL, ESTIMATOR, ESTIMATE, SESSION, SEQUENCE, SIMULATOR } noun;

typedef struct live {
    double id;
    noun noun;
    void *object;
    size_t modes;    /* of a model, a session, a sequence: number of coefficients */
    size_t channels; /* of a model, a session */
    size_t groups;   /* of a session: number of groups of the last fit */
    struct live *next;
} live;

/* Takes an object over; its number for MATLAB. */
mxArray *handle_new(noun noun, void *object, size_t modes);

/* The object of a number. */
live *handle_of(const mxArray *value, noun noun);

/* Destroys the object of a number, of any class. */
void handle_delete(const mxArray *value);

void handle_delete_all(void);

/* ---- Ctrl-C (interrupt.c) */

/* Does the work in a thread of its own, while this one waits for Ctrl-C, which cancels the object; returns when the work
 * is done. Raises the failure of the work, and COPHASE_INTERRUPTED after Ctrl-C in any case. */
typedef cophase_status cancel_call(const void *object);
void interruptible(cancel_call *cancel, const void *object, cophase_status (*work)(void *), void *argument);

#endif
