/* Frames of a star, made with the library's own PSF: the same bits wherever they are made, for they need nothing of
 * <math.h> but the root. */
#ifndef FRAMES_H
#define FRAMES_H

#include "support.h"
#include <math.h>
#include <stdint.h>

static const double READ_NOISE_E = 10.0, BACKGROUND_E = 30.0, FLUX_E = 2e6;

/* Uniform in [0, 1): the high bits of a linear congruence (Knuth's MMIX). */
static inline double uniform(uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return (double)(*state >> 11) / 9007199254740992.0;
}

/* Normal to the third digit: the sum of twelve uniforms has variance 1. */
static inline double normal(uint64_t *state)
{
    double sum = -6.0;
    int i;

    for (i = 0; i < 12; i++)
        sum += uniform(state);
    return sum;
}

/* Some nm for every mode, the same for the same seed; the RMS is `rms_nm`. */
static inline void draw_coefficients(double *coefficients_nm, size_t modes, double rms_nm, uint64_t seed)
{
    size_t i;

    for (i = 0; i < modes; i++)
        coefficients_nm[i] = rms_nm * normal(&seed);
}

/* One frame, rows x cols electrons in C order: the PSF about the optical axis, which is in row rows/2 and column cols/2,
 * over a background, with photon and read noise. */
static inline void make_frame(const cophase_model *model, const double *coefficients_nm, uint64_t seed, float *frame)
{
    cophase_model_info info;
    size_t pixels, y, x;
    double *psf;

    CHECK(cophase_model_get_info(model, &info, sizeof info) == COPHASE_OK);
    pixels = info.pixels;
    psf = doubles(pixels * pixels);
    CHECK(cophase_model_psf(model, coefficients_nm, info.modes, psf, pixels * pixels) == COPHASE_OK);
    for (y = 0; y < info.rows; y++)
        for (x = 0; x < info.cols; x++) {
            /* Wraps around where the frame is the larger one, and is out of bounds then too. */
            const size_t v = y + pixels / 2 - info.rows / 2, u = x + pixels / 2 - info.cols / 2;
            const double star_e = v < pixels && u < pixels ? FLUX_E * psf[v * pixels + u] : 0.0;
            const double variance_e2 = star_e + BACKGROUND_E + READ_NOISE_E * READ_NOISE_E;

            frame[y * info.cols + x] = (float)(star_e + BACKGROUND_E + sqrt(variance_e2) * normal(&seed));
        }
    free(psf);
}

#endif
