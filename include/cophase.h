/* cophase: phasing errors and non-common path aberrations of segmented telescopes.
 * Generated from src/capi by cbindgen; do not edit. */

#ifndef COPHASE_H
#define COPHASE_H

#include <stddef.h>
#include <stdint.h>

// The call did what it says.
#define COPHASE_OK 0

// A scene that cannot be parsed, or that names something impossible.
#define COPHASE_BAD_SCENE 1

// A file that cannot be read or written.
#define COPHASE_BAD_FILE 2

// An array whose shape does not fit.
#define COPHASE_BAD_SHAPE 3

// A number out of its range, or a call that comes too early.
#define COPHASE_BAD_VALUE 4

// An image that holds nothing to fit.
#define COPHASE_BAD_IMAGE 5

// OpenCL is absent, or a device failed.
#define COPHASE_DEVICE 6

// The user asked to stop.
#define COPHASE_INTERRUPTED 7

// A broken promise of the library's own; please report it.
#define COPHASE_INTERNAL 8

// An argument that cannot be used: NULL, misaligned, not UTF-8, an output that overlaps itself.
#define COPHASE_BAD_ARGUMENT 9

// The object is in use by another thread; nothing was done.
#define COPHASE_BUSY 10

// The library panicked, now or earlier, in a call on this object: it can only be destroyed. Please report it.
#define COPHASE_PANIC 11

// Version of the C interface: it changes only when a program built against an older header could break.
#define COPHASE_ABI_VERSION 0

// A simulated AO system under a sky: turbulence, wavefront sensor, deformable mirror, control, science camera.
//
// Calls that take it as const may run in several threads at once; any other only while no other call runs
// (COPHASE_BUSY otherwise). The same scene gives the same bits, in every language.
typedef struct cophase_simulator cophase_simulator;

// What became of a call: COPHASE_OK, or why it failed. Numbers are permanent; a later version may have more.
typedef int32_t cophase_status;

// A stack of `count` maps or images of `rows` × `cols` float elements (row = y, col = x) in memory of the caller's.
//
// Element (k, y, x) is at `data + k*count_stride + y*row_stride + x*col_stride`. Strides count elements, not bytes, and
// may be negative; that of an extent of 1 does not matter. So C order has row_stride = cols and col_stride = 1, MATLAB's
// column order row_stride = 1 and col_stride = rows, and a map can be turned over or put into a larger one without a
// copy. The elements of an output must not overlap. The layout of this struct is permanent.
typedef struct cophase_array_f32 {
  // Element (0, 0, 0).
  float *data;
  // Maps or images.
  size_t count;
  // Rows of each.
  size_t rows;
  // Columns of each.
  size_t cols;
  // Elements from one map to the next.
  ptrdiff_t count_stride;
  // Elements from one row to the next.
  ptrdiff_t row_stride;
  // Elements from one column to the next.
  ptrdiff_t col_stride;
} cophase_array_f32;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// The sentence of the last call that failed on this thread, in UTF-8; empty before the first. A call that succeeds
// leaves it as it was.
//
// Writes at most `capacity` bytes to `text`, the terminating zero included, as snprintf does; `text` may be NULL where
// `capacity` is 0. Returns the length of the whole sentence in bytes without the zero: less than `capacity` where all
// of it was written. Longer sentences than 2048 bytes are cut off.
size_t cophase_last_error(char *text,
                          size_t capacity);

// The text of a scene that comes with the library: "keck-artificial" or "keck-onsky", in `*scene_text`.
//
// It is a static string that the caller must not free. COPHASE_BAD_SCENE for another name.
cophase_status cophase_scene_preset(const char *name, const char **scene_text);

// Builds the AO system that a scene describes, ready for its first frame. This takes about a second at the size of Keck.
//
// scene_text: a scene as TOML, in UTF-8; it is copied. cophase_scene_preset has some, `cophase scene --reference` lists
//   the keys.
// directory: where the files are looked for that the scene names; NULL for the working directory.
// simulator: receives the handle, which the caller gives back with cophase_simulator_destroy.
//
// COPHASE_BAD_SCENE with the line, the key, its value and what is accepted; COPHASE_BAD_FILE for a file of the scene's.
cophase_status cophase_simulator_create(const char *scene_text,
                                        const char *directory,
                                        struct cophase_simulator **simulator);

// Frees a simulator; NULL is fine. No other call on it may be running, and none may follow.
void cophase_simulator_destroy(struct cophase_simulator *simulator);

// Advances the loop by a number of frames, in this thread.
//
// A loop that diverges is no failure, and goes on: cophase_simulator_divergence_s tells.
cophase_status cophase_simulator_step(struct cophase_simulator *simulator, uint64_t frames);

// Frames since the loop was closed.
cophase_status cophase_simulator_frames(const struct cophase_simulator *simulator, uint64_t *frames);

// Duration of a frame, s.
cophase_status cophase_simulator_frame_s(const struct cophase_simulator *simulator, double *frame_s);

// Time at which the loop was seen to diverge, s since it was closed; NaN while it has not.
cophase_status cophase_simulator_divergence_s(const struct cophase_simulator *simulator,
                                              double *divergence_s);

// Number of slopes that the wavefront sensor measures: two for each subaperture.
cophase_status cophase_simulator_slope_count(const struct cophase_simulator *simulator, size_t *slopes);

// Number of the mirror's actuators.
cophase_status cophase_simulator_actuator_count(const struct cophase_simulator *simulator, size_t *actuators);

// Rows, and columns, of a residual wavefront.
cophase_status cophase_simulator_residual_samples(const struct cophase_simulator *simulator, size_t *samples);

// Rows, and columns, of an image.
cophase_status cophase_simulator_image_pixels(const struct cophase_simulator *simulator, size_t *pixels);

// Rows, and columns, of the maps of the true aberrations: the scene's pupil.samples.
cophase_status cophase_simulator_truth_samples(const struct cophase_simulator *simulator, size_t *samples);

// The slopes that were measured in the last frame, mas: along x for every subaperture, then along y.
//
// values: room for `count` elements; count: cophase_simulator_slope_count. COPHASE_BAD_VALUE before the first frame.
cophase_status cophase_simulator_slopes_mas(const struct cophase_simulator *simulator,
                                            float *values,
                                            size_t count);

// The commands that were on the mirror in the last frame, nm of wavefront.
//
// values: room for `count` elements; count: cophase_simulator_actuator_count. COPHASE_BAD_VALUE before the first frame.
cophase_status cophase_simulator_commands_nm(const struct cophase_simulator *simulator,
                                             float *values,
                                             size_t count);

// The residual wavefront of the last frame, nm: turbulence and segments' errors less the mirror's surface. NaN where
// the pupil has no light.
//
// out: 1 x samples x samples, see cophase_simulator_residual_samples. COPHASE_BAD_VALUE before the first frame.
cophase_status cophase_simulator_residual_nm(const struct cophase_simulator *simulator,
                                             const struct cophase_array_f32 *out);

// RMS of that wavefront over the pupil (each sample weighed by its lit area, piston removed), nm.
//
// COPHASE_BAD_VALUE before the first frame.
cophase_status cophase_simulator_residual_rms_nm(const struct cophase_simulator *simulator,
                                                 double *residual_rms_nm);

// The camera's defocused image of the last frame, electrons, its turbulence frozen: residual wavefront, non-common path
// aberrations and diversity, with the noise that the scene names. The same frame gives the same image, however often
// and after whatever others it is taken. The optical axis is in row and column pixels/2.
//
// out: 1 x pixels x pixels, see cophase_simulator_image_pixels. COPHASE_BAD_VALUE before the first frame.
cophase_status cophase_simulator_image_e(struct cophase_simulator *simulator,
                                         const struct cophase_array_f32 *out);

// The true static aberrations, nm: map 0 the phasing errors of the segments, map 1 the non-common path aberrations. NaN
// outside the pupil.
//
// out: 2 x samples x samples, see cophase_simulator_truth_samples.
cophase_status cophase_simulator_truth_nm(const struct cophase_simulator *simulator,
                                          const struct cophase_array_f32 *out);

// Name of a status number: `OK`, `BAD_SCENE`, …; `UNKNOWN` for a number of a later version.
//
// Returns a static string that the caller must not free. Never NULL.
const char *cophase_status_name(cophase_status status);

// Version of the library as text, such as "0.1.0".
//
// Returns a static string that the caller must not free. Never NULL.
const char *cophase_version(void);

// Version of the C interface of the library that is loaded; compare it with COPHASE_ABI_VERSION of the header.
uint32_t cophase_abi_version(void);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* COPHASE_H */
