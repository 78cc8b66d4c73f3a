/* What the tutorials in C share: the check of a status, and images in place of a camera. */
#ifndef TUTORIAL_H
#define TUTORIAL_H

#include <cophase.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* Stops at a failure. The library keeps the sentence on it for the thread that called. */
static void must(cophase_status status)
{
    char sentence[2048];

    if (status == COPHASE_OK)
        return;
    cophase_last_error(sentence, sizeof sentence);
    fprintf(stderr, "%s: %s\n", cophase_status_name(status), sentence);
    exit(1);
}

/* Memory for `count` numbers, 0 each. */
static double *numbers(size_t count)
{
    double *memory = calloc(count, sizeof *memory);

    if (memory == NULL) {
        fprintf(stderr, "no memory for %zu numbers\n", count);
        exit(1);
    }
    return memory;
}

/* A normally distributed number, by the method of Box and Muller. */
static double normal(void)
{
    const double radius = sqrt(-2.0 * log((rand() + 1.0) / (RAND_MAX + 1.0)));

    return radius * cos(6.283185307179586 * rand() / RAND_MAX);
}

/* Image of a star with the PSF `psf`: photon noise, which is normal in bright pixels, and read noise, electrons. */
static void expose(const double *psf, size_t pixels, double star_e, double read_noise_e, double *frame_e)
{
    size_t i;

    for (i = 0; i < pixels; i++)
        frame_e[i] = star_e * psf[i] + sqrt(star_e * psf[i] + read_noise_e * read_noise_e) * normal();
}

#endif
