/* The objects that are alive, by number. */
#include "gateway.h"
#include <stdlib.h>

static live *all_live = NULL;
static double last_id = 0.0;

static const char *const CLASSES[] = {"Model", "Session", "Sequence", "Simulator", "FullPhase"};

static void destroy_object(noun noun, void *object)
{
    switch (noun) {
    case MODEL:
        cophase_model_destroy((cophase_model *)object);
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
    case FULL_PHASE:
        cophase_full_phase_destroy((cophase_full_phase *)object);
        break;
    }
}

live *handle_new(noun noun, void *object, size_t modes)
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
    born->images = 0;
    born->next = all_live;
    all_live = born;
    /* `clear mex` must not unload a library whose objects are in use. */
    mexLock();
    return born;
}

/* Where the pointer to an object stands in the list. */
static live **place_of(const mxArray *value, noun noun)
{
    live **place = &all_live;
    double id = 0.0; /* nobody's */

    if (mxIsDouble(value) && !mxIsComplex(value) && mxGetNumberOfElements(value) == 1)
        id = mxGetScalar(value);
    while (*place != NULL && (*place)->id != id)
        place = &(*place)->next;
    if (*place == NULL)
        fail(COPHASE_BAD_ARGUMENT, "there is no such %s, or it was deleted: a cophase.%s that is alive is accepted",
              CLASSES[noun], CLASSES[noun]);
    if ((*place)->noun != noun)
        fail(COPHASE_BAD_ARGUMENT, "this is a cophase.%s: a cophase.%s is accepted", CLASSES[(*place)->noun],
              CLASSES[noun]);
    return place;
}

live *handle_of(const mxArray *value, noun noun) { return *place_of(value, noun); }

static void delete_at(live **place)
{
    live *gone = *place;

    *place = gone->next;
    destroy_object(gone->noun, gone->object);
    free(gone);
}

void handle_delete(const mxArray *value, noun noun)
{
    delete_at(place_of(value, noun));
    mexUnlock();
}

void handle_delete_all(void)
{
    while (all_live != NULL)
        delete_at(&all_live);
}
