/* Writer of a stream, for tests: writer NAME COLUMNS ROWS SLOTS KIND FILE
 *
 * FILE has frames of float, which are written in turn; each line on standard input that holds a number N makes it write N more frames, a
 * second number is the pause after each, us. It answers with the counter. KIND: 0 one image, 1 an image with a circular buffer of SLOTS,
 * 2 a cube of SLOTS images that are times. "destroy" removes the stream; the end of the input leaves it. */

#include "ImageStreamIO.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

int main(int argc, char **argv)
{
    if (argc != 7) return 2;
    uint32_t size[3] = { atoi(argv[2]), atoi(argv[3]), atoi(argv[4]) };
    int slots = atoi(argv[4]), kind = atoi(argv[5]);
    size_t pixels = (size_t)size[0] * size[1], frames = 0;
    FILE *file = fopen(argv[6], "rb");
    if (!file) return 3;
    float *data = NULL;
    for (;;) {
        data = realloc(data, (frames + 1) * pixels * sizeof(float));
        if (fread(data + frames * pixels, sizeof(float), pixels, file) != pixels) break;
        frames++;
    }
    fclose(file);
    if (frames == 0) return 4;
    IMAGE image;
    memset(&image, 0, sizeof(image));
    uint64_t type = kind == 2 ? (CIRCULAR_BUFFER | ZAXIS_TEMPORAL) : 0;
    if (ImageStreamIO_createIm_gpu(&image, argv[1], kind == 2 ? 3 : 2, size, _DATATYPE_FLOAT, -1, 1, IMAGE_NB_SEMAPHORE, 10, type,
                                   kind == 1 ? slots : 0) != IMAGESTREAMIO_SUCCESS)
        return 5;
    char line[100];
    size_t next = 0;
    printf("ready\n");
    fflush(stdout);
    while (fgets(line, sizeof(line), stdin)) {
        if (strncmp(line, "destroy", 7) == 0) {
            ImageStreamIO_destroyIm(&image);
            return 0;
        }
        long count = 0, pause_us = 0;
        sscanf(line, "%ld %ld", &count, &pause_us);
        for (long i = 0; i < count; i++) {
            uint64_t slice = kind == 2 ? ImageStreamIO_writeIndex(&image) : 0;
            image.md->write = 1;
            memcpy(image.array.F + slice * pixels, data + next * pixels, pixels * sizeof(float));
            image.md->cnt1 = slice;
            ImageStreamIO_UpdateIm(&image);
            next = (next + 1) % frames;
            if (pause_us > 0) usleep(pause_us);
        }
        printf("%lu\n", (unsigned long)image.md->cnt0);
        fflush(stdout);
    }
    return 0;
}
