/* A model, a session of it, and frames of which the truth is known. */
#ifndef SETTING_H
#define SETTING_H

#include "frames.h"

enum { COUNT = 3 };

/* What every test of a session needs. */
struct setting {
    cophase_model *model;
    cophase_session *session; /* for up to COUNT images */
    size_t modes, segment_modes, rows, cols, pixels;
    double *truth_nm; /* COUNT x modes */
    float *frames;    /* COUNT x rows x cols, electrons */
    double *fitted_nm; /* COUNT x modes, of these frames once they are fitted */
};

static inline cophase_input frames_of(const struct setting *s, size_t count)
{
    return input(s->frames, COPHASE_F32, count, s->rows, s->cols);
}

static inline cophase_session *session_for(const cophase_model *model, size_t capacity)
{
    cophase_session_options options = DEFAULTS(cophase_session_options);
    cophase_session *session = NULL;

    options.capacity = capacity;
    CHECK(cophase_session_create(model, &options, &session) == COPHASE_OK);
    if (session == NULL)
        exit(1);
    return session;
}

static inline struct setting setting_of(const char *scene)
{
    cophase_model_info info;
    struct setting s;
    size_t k;

    memset(&s, 0, sizeof s);
    CHECK(cophase_model_create(scene, NULL, NULL, &s.model) == COPHASE_OK);
    if (s.model == NULL)
        exit(1);
    CHECK(cophase_model_get_info(s.model, &info, sizeof info) == COPHASE_OK);
    s.modes = info.modes, s.segment_modes = info.segment_modes, s.rows = info.rows, s.cols = info.cols;
    s.pixels = s.rows * s.cols;
    s.session = session_for(s.model, COUNT);
    s.truth_nm = doubles(COUNT * s.modes);
    s.fitted_nm = doubles(COUNT * s.modes);
    s.frames = floats(COUNT * s.pixels);
    draw_coefficients(s.truth_nm, COUNT * s.modes, 25.0, 7);
    for (k = 0; k < COUNT; k++)
        make_frame(s.model, s.truth_nm + k * s.modes, 100 + k, s.frames + k * s.pixels);
    return s;
}

static inline void done_with(struct setting *s)
{
    cophase_session_destroy(s->session);
    cophase_model_destroy(s->model);
    free(s->truth_nm);
    free(s->fitted_nm);
    free(s->frames);
}

/* Whether `frames` give to the last bit the coefficients of the setting's own. */
static inline int same_fit(const struct setting *s, cophase_session *session, const cophase_input *frames)
{
    double *coefficients_nm = doubles(COUNT * s->modes);
    const cophase_status status = cophase_session_fit(session, frames, 1, NULL, coefficients_nm, NULL, s->modes, NULL, 0, NULL, 0);
    const int same = memcmp(coefficients_nm, s->fitted_nm, frames->count * s->modes * sizeof *coefficients_nm) == 0;

    free(coefficients_nm);
    CHECK(status == COPHASE_OK);
    return status == COPHASE_OK && same;
}

#endif
