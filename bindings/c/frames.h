/* Where the frames of rtc.c come from: a FITS file or shared memory, mapped. */
#ifndef FRAMES_H
#define FRAMES_H

#include <fcntl.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

struct cube {
    const unsigned char *data;
    size_t frames, rows, cols;
    bool big_endian; /* FITS is */
};

static void die(const char *format, ...)
{
    va_list rest;

    va_start(rest, format);
    fputs("rtc: ", stderr);
    vfprintf(stderr, format, rest);
    fputs("\n", stderr);
    exit(1);
}

/* The bytes of a file, or of the shared memory shm:/NAME. */
static const unsigned char *mapped(const char *path, size_t *size)
{
    const int file = strncmp(path, "shm:", 4) == 0 ? shm_open(path + 4, O_RDONLY, 0) : open(path, O_RDONLY);
    void *memory = MAP_FAILED;
    struct stat about;

    if (file >= 0 && fstat(file, &about) == 0)
        memory = mmap(NULL, *size = (size_t)about.st_size, PROT_READ, MAP_SHARED, file, 0);
    if (memory == MAP_FAILED)
        die("%s cannot be opened, or is empty", path);
    close(file);
    return memory;
}

/* The first image of a FITS file: headers are cards of 80 characters in blocks of 2880, then come the pixels. */
static struct cube fits_image(const char *path, const unsigned char *bytes, size_t size)
{
    struct cube cube = {NULL, 1, 0, 0, true};
    size_t at = 0, axis, length;
    char card[81] = "";
    int bitpix = 0;

    for (; cube.cols == 0; at = (at + 2879) / 2880 * 2880) /* a header without axes has no data after it */
        do {
            if (at + 80 > size)
                die("%s is no FITS file, or has no image", path);
            memcpy(card, bytes + at, 80);
            at += 80;
            sscanf(card, "BITPIX = %d", &bitpix);
            if (sscanf(card, "NAXIS%zu = %zu", &axis, &length) == 2 && axis >= 1 && axis <= 3)
                *(axis == 1 ? &cube.cols : axis == 2 ? &cube.rows : &cube.frames) = length;
        } while (strncmp(card, "END     ", 8) != 0);
    if (bitpix != -32)
        die("the first image of %s has BITPIX %d: -32 is accepted, floats", path, bitpix);
    if (cube.rows == 0 || cube.frames == 0 || at > size || (size - at) / 4 / cube.cols / cube.rows < cube.frames)
        die("%s ends within its first image", path);
    cube.data = bytes + at;
    return cube;
}

/* The frames in `path`, which must have this shape. */
static struct cube open_cube(const char *path, size_t rows, size_t cols)
{
    size_t size;
    const unsigned char *bytes = mapped(path, &size);
    struct cube cube = {bytes, size / (4 * rows * cols), rows, cols, false};

    if (strncmp(path, "shm:", 4) != 0)
        cube = fits_image(path, bytes, size);
    if (cube.rows != rows || cube.cols != cols || cube.frames == 0)
        die("%s has %zu frames of %zu x %zu pixels: one or more of %zu x %zu are accepted, as the scene says", path,
            cube.frames, cube.rows, cube.cols, rows, cols);
    return cube;
}

/* Frame k, as native floats; after the last comes the first. */
static void copy_frame(const struct cube *cube, size_t k, float *to)
{
    const size_t pixels = cube->rows * cube->cols;
    const unsigned char *from = cube->data + 4 * pixels * (k % cube->frames);
    size_t i;

    if (!cube->big_endian)
        memcpy(to, from, 4 * pixels);
    for (i = 0; cube->big_endian && i < pixels; i++, from += 4) {
        const uint32_t bits = (uint32_t)from[0] << 24 | (uint32_t)from[1] << 16 | (uint32_t)from[2] << 8 | from[3];
        memcpy(&to[i], &bits, 4);
    }
}

#endif
