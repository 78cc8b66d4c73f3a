/* Arguments from MATLAB, checked, and results for it. */
#include "gateway.h"
#include <ctype.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static void fail_with(cophase_status status, const char *sentence)
{
    char id[64];

    snprintf(id, sizeof id, "cophase:%s", cophase_status_name(status));
    mexErrMsgIdAndTxt(id, "%s", sentence);
}

void fail(cophase_status status, const char *format, ...)
{
    char sentence[SENTENCE_BYTES];
    va_list arguments;

    va_start(arguments, format);
    vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    fail_with(status, sentence);
}

void check(cophase_status status)
{
    char sentence[SENTENCE_BYTES];

    if (status == COPHASE_OK)
        return;
    cophase_last_error(sentence, sizeof sentence);
    fail_with(status, sentence);
}

double number(const mxArray *value, const char *name)
{
    if (!mxIsNumeric(value) || mxIsComplex(value) || mxGetNumberOfElements(value) != 1)
        fail(COPHASE_BAD_ARGUMENT, "%s is no number: a real scalar is accepted", name);
    return mxGetScalar(value);
}

double chosen(const mxArray *value, const char *name)
{
    const double given = number(value, name);

    if (given == 0.0)
        fail(COPHASE_BAD_VALUE, "%s is 0: another number is accepted, or [] for the default", name);
    return given;
}

size_t whole(const mxArray *value, size_t least, const char *name)
{
    const double given = number(value, name);

    /* Up to 2^53 every whole number is a double. */
    if (!(given >= (double)least && given <= 9007199254740992.0) || given != (double)(uint64_t)given)
        fail(COPHASE_BAD_VALUE, "%s is %g: a whole number from %lu on is accepted", name, given, (unsigned long)least);
    return (size_t)given;
}

int32_t threads(const mxArray *value)
{
    const double given = chosen(value, "threads");

    if (!(given >= -1.0 && given <= 65536.0) || given != (double)(int32_t)given)
        fail(COPHASE_BAD_VALUE, "threads is %g: a number of threads, or -1 for one per processor, is accepted", given);
    return (int32_t)given;
}

const char *text(const mxArray *value, const char *name)
{
    mxArray *characters = (mxArray *)value;
    const char *result = NULL;

    if (value == NULL || (mxIsEmpty(value) && (mxIsChar(value) || mxIsDouble(value))))
        return NULL;
    if (mxIsClass(value, "string") && mxGetNumberOfElements(value) == 1)
        mexCallMATLAB(1, &characters, 1, (mxArray **)&value, "char");
    if (mxIsChar(characters) && mxGetM(characters) <= 1) {
#ifdef MATLAB_MEX_FILE
        result = mxArrayToUTF8String(characters);
#else
        result = mxArrayToString(characters); /* Octave's characters are the bytes of UTF-8. */
#endif
    }
    if (result == NULL)
        fail(COPHASE_BAD_ARGUMENT, "%s is no text: a row of characters is accepted", name);
    return result;
}

/* The extents of an array as text, such as 120x120x3. */
static const char *shape(const mxArray *value)
{
    static char result[128];
    const mwSize *extents = mxGetDimensions(value), dimensions = mxGetNumberOfDimensions(value);
    size_t length = 0;
    mwSize i;

    for (i = 0; i < dimensions && length < sizeof result; i++)
        length += (size_t)snprintf(result + length, sizeof result - length, i == 0 ? "%lu" : "x%lu",
                                   (unsigned long)extents[i]);
    return result;
}

static int32_t element_of(const mxArray *value)
{
    switch (mxGetClassID(value)) {
    case mxSINGLE_CLASS:
        return COPHASE_F32;
    case mxDOUBLE_CLASS:
        return COPHASE_F64;
    case mxUINT16_CLASS:
        return COPHASE_U16;
    case mxINT32_CLASS:
        return COPHASE_I32;
    case mxUINT8_CLASS:
    case mxLOGICAL_CLASS: /* a byte, 0 or 1 */
        return COPHASE_U8;
    default:
        return 0;
    }
}

cophase_input input(const mxArray *value, const char *name)
{
    const int32_t element = element_of(value);
    const mwSize *extents = mxGetDimensions(value), dimensions = mxGetNumberOfDimensions(value);
    cophase_input view;

    if (element == 0 || mxIsComplex(value) || mxIsSparse(value))
        fail(COPHASE_BAD_ARGUMENT,
              "%s is a %s%s%s array: a full, real array of class single, double, uint16, int32, uint8 or logical is "
              "accepted",
              name, mxIsSparse(value) ? "sparse " : "", mxIsComplex(value) ? "complex " : "", mxGetClassName(value));
    if (dimensions > 3 || mxIsEmpty(value))
        fail(COPHASE_BAD_SHAPE, "%s is %s: rows x columns, or rows x columns x images, none of them 0, is accepted",
              name, shape(value));
    view.data = mxGetData(value);
    view.element = element;
    view.rows = extents[0], view.cols = extents[1], view.count = dimensions == 3 ? extents[2] : 1;
    view.row_stride = 1;
    view.col_stride = (ptrdiff_t)view.rows;
    view.count_stride = (ptrdiff_t)(view.rows * view.cols);
    return view;
}

const double *doubles(const mxArray *value, size_t rows, size_t cols, const char *name)
{
    if (!mxIsDouble(value) || mxIsComplex(value) || mxIsSparse(value))
        fail(COPHASE_BAD_ARGUMENT, "%s is of class %s%s: a full, real array of class double is accepted", name,
              mxIsComplex(value) ? "complex " : "", mxGetClassName(value));
    if (mxGetNumberOfDimensions(value) > 2 ||
        !((mxGetM(value) == rows && mxGetN(value) == cols) ||
          (mxGetM(value) == 1 && mxGetN(value) == rows && cols == 1)))
        fail(COPHASE_BAD_SHAPE, "%s is %s: %lux%lu is accepted, a row for each mode", name, shape(value),
              (unsigned long)rows, (unsigned long)cols);
    return (const double *)mxGetData(value);
}

/* Whether a name of `length` letters begins with `beginning`, in upper or lower case. */
static int begins(const char *name, const char *beginning)
{
    for (; *beginning != '\0'; name++, beginning++)
        if (tolower((unsigned char)*name) != tolower((unsigned char)*beginning))
            return 0;
    return 1;
}

/* Which of the names is meant; raises if none or several. */
static size_t option_of(const char *given, const char *const *names)
{
    char accepted[256] = "";
    size_t i, found = 0, matches = 0;

    for (i = 0; names[i] != NULL; i++) {
        if (begins(names[i], given)) {
            found = i;
            matches++;
            if (strlen(names[i]) == strlen(given))
                return i;
        }
        snprintf(accepted + strlen(accepted), sizeof accepted - strlen(accepted), "%s%s",
                 i == 0 ? "" : names[i + 1] == NULL ? " or " : ", ", names[i]);
    }
    if (matches != 1 || *given == '\0')
        fail(COPHASE_BAD_ARGUMENT, "'%s' %s: %s is accepted", given,
              matches > 1 && *given != '\0' ? "may be several options" : "is no option here", accepted);
    return found;
}

void options(int inputs, const mxArray **in, const char *const *names, const mxArray **values)
{
    size_t place;
    int i;

    for (place = 0; names[place] != NULL; place++)
        values[place] = NULL;
    for (i = 0; i < inputs; i += 2) {
        const char *given = text(in[i], "the name of an option");

        place = option_of(given == NULL ? "" : given, names);
        if (i + 1 == inputs)
            fail(COPHASE_BAD_ARGUMENT, "%s has no value: name and value in turn are accepted", names[place]);
        values[place] = mxIsEmpty(in[i + 1]) ? NULL : in[i + 1];
    }
}

mxArray *column(size_t count) { return mxCreateDoubleMatrix(count, 1, mxREAL); }

mxArray *long_text(text_call *call, const void *object, int32_t what, size_t index)
{
    char *memory;
    size_t length;

    check(call(object, what, index, NULL, 0, &length));
    memory = (char *)mxMalloc(length + 1);
    check(call(object, what, index, memory, length + 1, &length));
    return mxCreateString(memory);
}

const constant_name POLICIES[] = {{"full", COPHASE_POLICY_FULL}, {"realtime", COPHASE_POLICY_REALTIME}, {NULL, 0}};
const constant_name PRECISIONS[] = {{"f32", COPHASE_F32}, {"f64", COPHASE_F64}, {NULL, 0}};

int32_t choice(const mxArray *value, const constant_name *choices, const char *name)
{
    const char *given = text(value, name);
    char accepted[512] = "";

    for (; choices->name != NULL; choices++) {
        if (given != NULL && strcmp(given, choices->name) == 0)
            return choices->number;
        snprintf(accepted + strlen(accepted), sizeof accepted - strlen(accepted), "%s'%s'",
                 *accepted == '\0' ? "" : " or ", choices->name);
    }
    fail(COPHASE_BAD_VALUE, "%s is '%s': %s is accepted", name, given == NULL ? "" : given, accepted);
    return 0;
}

/* A field of a struct of the library in MATLAB's terms. */
static mxArray *value_of(const field *field, const char *item)
{
    const void *at = item + field->offset;
    const constant_name *name = field->names;

    switch (field->kind) {
    case IS_SIZE:
        return mxCreateDoubleScalar((double)*(const size_t *)at);
    case IS_COUNT:
        return mxCreateDoubleScalar((double)*(const uint64_t *)at);
    case IS_INT:
        return mxCreateDoubleScalar(*(const int32_t *)at);
    case IS_DOUBLE:
        return mxCreateDoubleScalar(*(const double *)at);
    case IS_LOGICAL:
        return mxCreateLogicalScalar(*(const int32_t *)at != 0);
    case IS_STATUS:
        return mxCreateString(cophase_status_name(*(const int32_t *)at));
    case IS_NAMED:
        while (name->name != NULL && name->number != *(const int32_t *)at)
            name++;
        return mxCreateString(name->name == NULL ? "" : name->name);
    }
    return NULL;
}

mxArray *structs(const field *fields, const void *items, size_t size, size_t count)
{
    mxArray *result = mxCreateStructMatrix(count, 1, 0, NULL);
    size_t i;

    for (; fields->name != NULL; fields++) {
        mxAddField(result, fields->name);
        for (i = 0; i < count; i++)
            mxSetField(result, i, fields->name, value_of(fields, (const char *)items + i * size));
    }
    return result;
}
