/* What the C tests share. A test goes on after a failure, and its program ends with 1 if there was one. */
#ifndef SUPPORT_H
#define SUPPORT_H

#include <cophase.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int failures;

static inline void failed(const char *file, int line, const char *what)
{
    char sentence[512];

    cophase_last_error(sentence, sizeof sentence);
    fprintf(stderr, "%s:%d: %s\n  last error: %s\n", file, line, what, sentence);
    failures++;
}

/* Options of this type with nothing but defaults. */
#define DEFAULTS(type) ((type){.struct_size = sizeof(type)})

#define CHECK(condition) ((condition) ? (void)0 : failed(__FILE__, __LINE__, #condition))

/* The call must be answered by this status, and by one sentence that holds `part`. */
#define REFUSED(status, part, call) refused(__FILE__, __LINE__, #call, (status), (part), (call))

static inline void refused(const char *file, int line, const char *call, cophase_status wanted, const char *part,
                           cophase_status status)
{
    char sentence[512];

    cophase_last_error(sentence, sizeof sentence);
    if (status != wanted) {
        fprintf(stderr, "%s where %s is right\n", cophase_status_name(status), cophase_status_name(wanted));
        failed(file, line, call);
    } else if (strstr(sentence, part) == NULL || strchr(sentence, '\n') != NULL) {
        failed(file, line, call);
    }
}

/* What an output holds that nobody has written to. */
static const double UNTOUCHED = -12345.0;

static inline void *memory(size_t count, size_t size)
{
    void *memory = calloc(count, size);

    if (memory == NULL)
        exit(2);
    return memory;
}

static inline float *floats(size_t count)
{
    float *values = (float *)memory(count, sizeof *values);
    size_t i;

    for (i = 0; i < count; i++)
        values[i] = (float)UNTOUCHED;
    return values;
}

static inline double *doubles(size_t count)
{
    double *values = (double *)memory(count, sizeof *values);
    size_t i;

    for (i = 0; i < count; i++)
        values[i] = UNTOUCHED;
    return values;
}

static inline size_t untouched(const double *values, size_t count)
{
    size_t i, same = 0;

    for (i = 0; i < count; i++)
        same += values[i] == UNTOUCHED;
    return same;
}

/* A stack in C order to read from. */
static inline cophase_input input(const void *data, int32_t element, size_t count, size_t rows, size_t cols)
{
    cophase_input array;

    array.data = data;
    array.element = element;
    array.count = count;
    array.rows = rows;
    array.cols = cols;
    array.count_stride = (ptrdiff_t)(rows * cols);
    array.row_stride = (ptrdiff_t)cols;
    array.col_stride = 1;
    return array;
}

/* A file as a whole, with a zero behind it; the caller frees it. */
static inline char *read_file(const char *path, size_t *size)
{
    FILE *file = fopen(path, "rb");
    char *bytes;
    long length;

    if (file == NULL || fseek(file, 0, SEEK_END) != 0 || (length = ftell(file)) < 0)
        exit(2);
    rewind(file);
    bytes = (char *)memory((size_t)length + 1, 1);
    *size = fread(bytes, 1, (size_t)length, file);
    if (*size != (size_t)length)
        exit(2);
    fclose(file);
    return bytes;
}

/* `text` with `more` behind it; the caller frees it. */
static inline char *joined(const char *text, const char *more)
{
    char *both = (char *)memory(strlen(text) + strlen(more) + 1, 1);

    strcpy(both, text);
    strcat(both, more);
    return both;
}

static inline void dump(FILE *file, const double *values, size_t count)
{
    if (fwrite(values, sizeof *values, count, file) != count)
        exit(2);
}

#endif
