/* The objects of the library that MATLAB holds, by number. */
#include "gateway.h"
#include <stdlib.h>

static live *all_live = NULL;
static double last_id = 0.0;

static const char *const CLASSES[] = {"Model", "Estimator", "Estimate", "Session", "Sequence", "Simulator"};

static void destroy_object(noun noun, void *object)
{
    switch (noun) {
    case MODEL:
        cophase_model_destroy((cophase_model *)object);
        break;
    case ESTIMATOR:
        cophase_estimator_destroy((cophase_estimator *)object);
        break;
    case ESTIMATE:
        cophase_estimate_destroy((cophase_estimate *)object);
        break;
    case SESSION:
        cophase_session_destroy((cophase_session *)object);
        break;
    case SEQUENCE:
        cophase_sequence_destroy((cophase_sequence *)object);
        break;
    case SIMULATOR:
        cophase_simulator_destroy((cophase_simulator *)object);
        break;
    }
}

mxArray *handle_new(noun noun, void *object, size_t modes)
{
    live *born = (live *)malloc(sizeof(live));

    if (born == NULL) {
        destroy_object(noun, object);
        fail(COPHASE_INTERNAL, "no memory is left for a cophase.%s", CLASSES[noun]);
        return NULL;
    }
    born->id = ++last_id;
    born->noun = noun;
    born->object = object;
    born->modes = modes;
    born->channels = 1;
    born->groups = 0;
    born->next = all_live;
    all_live = born;
    /* `clear mex` must not unload a library whose objects are in use. */
    mexLock();
    return mxCreateDoubleScalar(born->id);
}

/* The pointer in the list to the object of a number; NULL if there is none. */
static live **place_of(const mxArray *value)
{
    live **place = &all_live;
    double id = 0.0; /* of no object */

    if (mxIsDouble(value) && !mxIsComplex(value) && mxGetNumberOfElements(value) == 1)
        id = mxGetScalar(value);
    while (*place != NULL && (*place)->id != id)
        place = &(*place)->next;
    return *place == NULL ? NULL : place;
}

live *handle_of(const mxArray *value, noun noun)
{
    live **place = place_of(value);

    if (place == NULL)
        fail(COPHASE_BAD_ARGUMENT, "there is no such %s, or it was deleted: a cophase.%s that exists is accepted",
             CLASSES[noun], CLASSES[noun]);
    if ((*place)->noun != noun)
        fail(COPHASE_BAD_ARGUMENT, "this is a cophase.%s: a cophase.%s is accepted", CLASSES[(*place)->noun],
             CLASSES[noun]);
    return *place;
}

static void delete_at(live **place)
{
    live *gone = *place;

    *place = gone->next;
    destroy_object(gone->noun, gone->object);
    free(gone);
}

void handle_delete(const mxArray *value)
{
    live **place = place_of(value);

    if (place == NULL)
        fail(COPHASE_BAD_ARGUMENT, "there is no such object, or it was deleted");
    delete_at(place);
    mexUnlock();
}

void handle_delete_all(void)
{
    while (all_live != NULL)
        delete_at(&all_live);
}
