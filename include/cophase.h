/* cophase: phasing errors and non-common path aberrations (NCPA) of segmented telescopes, from defocused images of a star.
 * Made from src/capi by cbindgen (tests/header.rs); do not edit.
 *
 * CONTRACT
 *
 * Order of use
 *   All images of a scene at once, as the program does it:
 *     cophase_estimator_create -> cophase_estimator_estimate -> cophase_estimate_get_info, _array, _text, _write
 *   Images as a camera delivers them, with a deadline, of one channel or of several (defocuses, filters):
 *     cophase_model_create -> cophase_session_create -> cophase_session_fit -> cophase_session_refine
 *   Running estimate of images of one channel:
 *     cophase_session_fit -> cophase_sequence_push -> cophase_sequence_estimate
 *
 * Objects
 *   cophase_model, cophase_estimator, cophase_estimate, cophase_session and cophase_sequence are opaque.
 *   A call that creates one writes its handle, and the caller destroys it; destroying NULL does nothing. Objects do not depend
 *   on the lifetime of those that they were made from. No call on an object may be running or follow when it is destroyed.
 *
 * Threads
 *   Calls on different objects never interfere. On one object, calls that take it as const may run in several threads at
 *   once, others only alone: a second call returns COPHASE_BUSY at once and does nothing. A session, also where const, and
 *   an estimator take one call at a time, except _cancel and _progress, which any thread may call at any time.
 *
 * Errors
 *   A call returns COPHASE_OK or the kind of failure; cophase_last_error has a sentence on it: what was wrong, the value,
 *   what is accepted. After a failure, outputs are as they were. What is wrong with single images is not a failure of the
 *   call: each image has its own status. A panic inside the library is caught: the call returns COPHASE_PANIC, and so does
 *   every later call on that object, which can only be destroyed.
 *
 * Structs
 *   Options begin with struct_size, which the caller sets to the sizeof of the struct; in all other fields 0 means the
 *   default: cophase_fit_options options = {.struct_size = sizeof options}; (in C++: cophase_fit_options options = {};
 *   options.struct_size = sizeof options;). A NULL pointer to options means all defaults. A struct that the library fills
 *   comes with its sizeof as the next argument. Later versions only append fields, so programs and libraries of different
 *   versions fit together. Numbers of constants are permanent; expect new ones.
 *
 * Arrays
 *   Inputs (cophase_input) have any strides and five element types, and are only read during the call. Outputs are doubles
 *   in C order, and `count` is the number of elements: any other than the shape's is COPHASE_BAD_SHAPE. Maps and frames are
 *   [row = y, col = x]; row and column of the optical axis are rows/2 and cols/2 in a frame, (samples - 1)/2 in a map.
 *
 * Units
 *   A unit ends each name: _nm of optical path difference (wavefront, not mirror surface), _nm2 its square, _m, _s, _mas on
 *   the sky, _e electrons. A segment coefficient is nm of piston, an NCPA coefficient nm RMS over the pupil. Segment pistons
 *   have zero mean over the pupil. A wavefront that grows along +x moves the spot along +column.
 *
 * Text
 *   UTF-8. Texts of the library are written to the caller's memory as by snprintf, or are static where it says so.
 *
 * [RT]
 *   Calls marked [RT] do not allocate, lock, log or format text while they succeed, on the CPU chain in the caller's own
 *   thread; their time is bounded by the number of evaluations and by the deadline. An OpenCL driver may allocate and lock.
 */

#ifndef COPHASE_H
#define COPHASE_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---------------------------------------- Names and text ---------------------------------------- */

/* Version of the C interface. It changes only where a program built against an older header could
 * break.
 */
#define COPHASE_ABI_VERSION 1

/* Version of the library, such as "0.1.0". A static string, never NULL. */
const char *cophase_version(void);

/* Version of the C interface of the library that is loaded; must be COPHASE_ABI_VERSION of the
 * header.
 */
uint32_t cophase_abi_version(void);

/* Success. */
#define COPHASE_OK 0

/* Scene that cannot be parsed, or with an impossible value. */
#define COPHASE_BAD_SCENE 1

/* File that cannot be read or written. */
#define COPHASE_BAD_FILE 2

/* Array of the wrong shape. */
#define COPHASE_BAD_SHAPE 3

/* Number out of range, or a call before the one that it needs. */
#define COPHASE_BAD_VALUE 4

/* No usable image. */
#define COPHASE_BAD_IMAGE 5

/* No OpenCL device, or a device that failed. */
#define COPHASE_DEVICE 6

/* Call stopped by a cancel call. */
#define COPHASE_INTERRUPTED 7

/* Error of the library itself; please report it. */
#define COPHASE_INTERNAL 8

/* Unusable argument: NULL, misaligned, not UTF-8, a struct_size that no version has. */
#define COPHASE_BAD_ARGUMENT 9

/* Object in use by another thread; nothing was done. */
#define COPHASE_BUSY 10

/* Panic inside the library, in this call or an earlier one on this object, which can only be
 * destroyed. Please report it.
 */
#define COPHASE_PANIC 11

/* Image status: fitted, and the model explains the image. */
#define COPHASE_IMAGE_OK 100

/* Image status: fitted, but the residual is larger or smaller than the noise. */
#define COPHASE_IMAGE_MISFIT 101

/* Image status: the residual is so large that the fit is probably in a wrong minimum. */
#define COPHASE_IMAGE_WRONG_MINIMUM 102

/* Image status: the optimizer stopped before it converged. */
#define COPHASE_IMAGE_NOT_CONVERGED 103

/* Image status: the image could not be used; its coefficients are NaN. */
#define COPHASE_IMAGE_UNUSABLE 104

/* Image status: the deadline passed; its coefficients are the best so far. */
#define COPHASE_IMAGE_DEADLINE 105

/* Status of an estimate alone: its images are of several wavefronts, and their mean is of none. */
#define COPHASE_IMAGE_CONTRADICTORY 106

/* Status of a call: COPHASE_OK, or why it failed. Numbers are permanent; later versions may have
 * more.
 */
typedef int32_t cophase_status;

/* Name of the status of a call or of an image, without its prefix: `OK`, `BAD_SCENE`, ..., `OK`,
 * `MISFIT`, ...; `UNKNOWN` for a number of a later version. A static string, never NULL.
 */
const char *cophase_status_name(int32_t status);

/* Sentence of the last call that failed in this thread, UTF-8; empty before the first. Calls that
 * succeed do not change it.
 *
 * text: receives at most `capacity` bytes, the terminating zero included, as with snprintf; may be
 *   NULL if capacity is 0.
 *
 * Returns the length of the whole sentence in bytes, without the zero. Sentences are cut after
 * 2048 bytes.
 */
size_t cophase_last_error(char *text, size_t capacity);

/* Text of a scene that comes with the library, such as "keck-artificial", "keck-onsky" or
 * "jwst-pair", in `*scene_text`: a static string.
 *
 * COPHASE_BAD_SCENE for another name; the message lists all names.
 */
cophase_status cophase_scene_preset(const char *name, const char **scene_text);

/* A scene with another value for one key; its comments stay.
 *
 * scene_text: scene as TOML, UTF-8, as cophase_scene_preset gives one.
 * key: section and name, such as "image.peak_snr".
 * value: value in TOML, such as "50" or "[4, 18]"; words and file names may do without quotes. An
 *   empty value removes the key, which then has its default.
 * text: receives at most `capacity` bytes of the new scene, the terminating zero included, as with
 *   snprintf; may be NULL if capacity is 0. It must not overlap scene_text.
 * length: receives the length of the whole text in bytes, without the zero: a text is whole if it
 *   is less than capacity.
 *
 * COPHASE_BAD_SCENE for a key that does not exist or a value that it does not accept, with what is
 * accepted.
 */
cophase_status cophase_scene_set(const char *scene_text,
                                 const char *key,
                                 const char *value,
                                 char *text,
                                 size_t capacity,
                                 size_t *length);

/* Devices of this machine, one a line: the text for `device` in cophase_session_options or
 * estimate.device in a scene, a tab, and a description. The first line is always the CPU.
 *
 * text: receives at most `capacity` bytes, the terminating zero included, as with snprintf; may be
 *   NULL if capacity is 0.
 * length: receives the length of the whole text in bytes, without the zero.
 */
cophase_status cophase_device_list(char *text, size_t capacity, size_t *length);

/* Text of an estimate: its report, as the program prints it. */
#define COPHASE_TEXT_REPORT 1

/* Text of an estimate, a session or a simulator: what to know before using the numbers, one
 * sentence a line; empty without warnings.
 */
#define COPHASE_TEXT_WARNINGS 2

/* Text of an estimate: remarks that hold for every image of the scene, one sentence a line. */
#define COPHASE_TEXT_REMARKS 3

/* Text of an estimate or a session: the device that it ran on: "cpu", or an OpenCL device. */
#define COPHASE_TEXT_DEVICE 4

/* Text of an estimate or a session: its policy, "full" or "realtime". */
#define COPHASE_TEXT_POLICY 5

/* Text of an estimate: the modes that were added to the scene's. */
#define COPHASE_TEXT_MODEL 6

/* Text of an estimate: the scene that was used (TOML), with the choices of a plan and the optics
 * that were fitted.
 */
#define COPHASE_TEXT_SCENE 7

/* Text of an estimate or a session: why image `index` has its status, a sentence. */
#define COPHASE_TEXT_IMAGE_MESSAGE 8

/* Text of an estimate: name of mode `index`. */
#define COPHASE_TEXT_MODE_NAME 9

/* Text of an estimate: name of term `index` of the error budget. */
#define COPHASE_TEXT_ERROR_TERM_NAME 10

/* Text of an estimate: name of channel `index`. */
#define COPHASE_TEXT_CHANNEL_NAME 11

/* Text of an estimate, after cophase_estimate_correct: the controller's name of the channel of
 * command `index` to the segments.
 */
#define COPHASE_TEXT_SEGMENT_COMMAND_NAME 12

/* Text of an estimate, after cophase_estimate_correct: the controller's name of the channel of
 * command `index` to the mirror.
 */
#define COPHASE_TEXT_ACTUATOR_COMMAND_NAME 13

/* Text of an estimate, after cophase_estimate_correct: why piston `index`, then tip, then tilt of
 * the segments is held: deadband, no-benefit or never-corrected; empty for one that moves.
 */
#define COPHASE_TEXT_SEGMENT_HELD 14

/* Text of an estimate, after cophase_estimate_correct: the same of NCPA mode `index`. */
#define COPHASE_TEXT_NCPA_HELD 15

/* Text of an estimate, after cophase_estimate_correct: what to know before anything is moved, one
 * sentence a line.
 */
#define COPHASE_TEXT_CORRECTION_WARNINGS 16

/* Text of an estimate: what error `index` of COPHASE_ARRAY_MODEL_ERRORS is, with the unit of its
 * numbers where they are not relative.
 */
#define COPHASE_TEXT_MODEL_ERROR_NAME 17

/* Policy: what the program and every other interface do: modes with a prior, a search for outlier
 * pixels, restarts, optics fitted where the scene asks for it, a larger model where the scene does
 * not explain them (estimate.model).
 */
#define COPHASE_POLICY_FULL 0

/* Policy: one fit of the scene's modes, no retries; what a session does. */
#define COPHASE_POLICY_REALTIME 1

/* ------------------------------- Frames, calibration, image reports ------------------------------- */

/* Element type of a cophase_input: float. */
#define COPHASE_F32 1

/* Element type of a cophase_input: double. */
#define COPHASE_F64 2

/* Element type of a cophase_input: uint16_t. */
#define COPHASE_U16 3

/* Element type of a cophase_input: int32_t. */
#define COPHASE_I32 4

/* Element type of a cophase_input: uint8_t. */
#define COPHASE_U8 5

/* Input array: a stack of `count` frames or maps of `rows` x `cols` elements (row = y, col = x).
 * It is only read, and only during the call.
 *
 * Element (k, y, x) is at `data + k*count_stride + y*row_stride + x*col_stride`, in elements of
 * the given type. Strides may be negative, or 0 to repeat elements; the stride of an extent of 1
 * is ignored. C order is count_stride = rows*cols, row_stride = cols, col_stride = 1; MATLAB's
 * column order is row_stride = 1, col_stride = rows. The layout of this struct is permanent.
 */
typedef struct {
  /* Element (0, 0, 0); NULL for an optional array that is absent. */
  const void *data;
  /* COPHASE_F32, COPHASE_F64, COPHASE_U16, COPHASE_I32 or COPHASE_U8. */
  int32_t element;
  /* Frames or maps. */
  size_t count;
  /* Rows of each. */
  size_t rows;
  /* Columns of each. */
  size_t cols;
  /* Elements from one frame to the next. */
  ptrdiff_t count_stride;
  /* Elements from one row to the next. */
  ptrdiff_t row_stride;
  /* Elements from one column to the next. */
  ptrdiff_t col_stride;
} cophase_input;

/* Input array in C order, without padding: what cophase_input has for
 * `float frames[count][rows][cols]`.
 *
 * cophase_input frames = cophase_input_from_array(data, COPHASE_F32, 1, rows, cols);
 *
 * Nothing is checked here: the call that takes the array does.
 */
cophase_input cophase_input_from_array(const void *data,
                                       int32_t element,
                                       size_t count,
                                       size_t rows,
                                       size_t cols);

/* Calibration of a camera: electrons = (raw - dark) * gain / flat. Zero in every field but
 * struct_size: frames are electrons, or counts where the scene has image.gain_e_per_adu.
 */
typedef struct {
  /* sizeof(cophase_calibration). */
  size_t struct_size;
  /* 1 x rows x cols: signal without light, raw units. Data NULL: none. */
  cophase_input dark;
  /* 1 x rows x cols: relative response, about 1. Data NULL: uniform. */
  cophase_input flat;
  /* 1 x rows x cols: bad pixels, which take no part, are not 0. Data NULL: none. */
  cophase_input bad;
  /* Electrons per raw unit; 0 means image.gain_e_per_adu of the scene, or 1 where it has none. */
  double gain_e;
  /* Raw value from which on a pixel is saturated, and bad; 0 means none. */
  double saturation;
} cophase_calibration;

/* Report on one image. */
typedef struct {
  /* COPHASE_IMAGE_OK or another COPHASE_IMAGE_ number. */
  int32_t status;
  /* 1 if the image was combined into the estimate, or with other channels into the result of a
   * session, else 0.
   */
  int32_t is_used;
  /* 1 if it was fitted and then left out as an outlier among the images, else 0; 0 in a session. */
  int32_t is_clipped;
  /* Pixels of the fitted part that were bad in the frame or in the calibration. */
  int32_t bad_pixels;
  /* Outlier pixels that were found and rejected. */
  int32_t rejected_pixels;
  /* Policy of the fit: COPHASE_POLICY_FULL, or COPHASE_POLICY_REALTIME, which a session follows. */
  int32_t policy;
  /* Evaluations of objective and gradient; of a MAP retrieval, in its last iteration. */
  uint64_t evaluations;
  /* Chi-square per degree of freedom, 1 where the model is right; NaN for an unusable image. */
  double reduced_chi2;
  /* Flux of the star, electrons. */
  double flux_e;
  /* Background, electrons per pixel of the frame. */
  double background_e;
  /* Tilt along x of the fitted wavefront and of the shift onto the axis, nm RMS over the pupil;
   * NaN in a MAP estimate.
   */
  double tip_nm;
  /* The same along y. */
  double tilt_nm;
  /* Duration of the fit, s; NaN in an estimate, which fits images together. */
  double seconds;
  /* Number of its channel in the scene, from 0; 0 for a scene without channels. */
  int64_t channel;
} cophase_image_report;

/* -------------------------------------------- Model -------------------------------------------- */

/* Model of the images of a wavefront: telescope, modes, and of each channel ([[image.channel]])
 * diversity and camera; a scene that lists no channels has one. Immutable: any number of threads
 * may use it.
 */
typedef struct cophase_model cophase_model;

/* Telescope of the caller's, as maps of n x n samples, n even, over the scene's pupil.grid_m. A
 * pupil of at least twice pupil.samples is averaged onto that grid, which modes then have.
 */
typedef struct {
  /* sizeof(cophase_model_arrays). */
  size_t struct_size;
  /* 1 x n x n: amplitude of the pupil, 0 to 1. Required. */
  cophase_input pupil;
  /* 1 x n x n: label of each sample's segment, whole numbers from 0 or 1, with gaps or without;
   * negative, or 0 where they begin at 1, outside all segments. Segments are counted by
   * ascending label. Data NULL: not segmented.
   */
  cophase_input segments;
  /* modes x n x n: wavefront of each NCPA mode, nm per nm of its coefficient. Data NULL: the
   * scene's modes.
   */
  cophase_input modes;
  /* 1 x n x n: diversity, nm of wavefront. Data NULL: the scene's. */
  cophase_input diversity_nm;
} cophase_model_arrays;

/* Sizes of a model. */
typedef struct {
  /* Number of modes, which is the number of coefficients of an image. */
  size_t modes;
  /* Number of modes that move segments; they come first, the others are NCPA modes. */
  size_t segment_modes;
  /* Rows of a frame; of several channels, those of the first. */
  size_t rows;
  /* Columns of a frame; of several channels, those of the first. */
  size_t cols;
  /* Rows, and columns, of a wavefront map. */
  size_t samples;
  /* Rows, and columns, of a PSF: the pixels that are compared, after a frame is cut and reduced
   * to the model's sampling; of several channels, those of the first.
   */
  size_t pixels;
  /* Number of channels, which have the same modes; 1 for a scene that lists none. */
  size_t channels;
} cophase_model_info;

/* Builds the model of a scene; about half a second for each channel at the size of Keck.
 *
 * scene_text: scene as TOML, UTF-8; see cophase_scene_preset. With estimate.budget_nm, the model
 *   is planned first, which takes some seconds.
 * directory: directory of the files that the scene names; NULL for the working directory.
 * arrays: telescope of the caller's instead of that of a scene with one channel; NULL for the
 *   scene's. The arrays are copied. They have the effect of the same maps in the files pupil.file,
 *   modes.file and image.diversity_file; the rest is the scene's. Segment pistons (modes.segment)
 *   come before the modes of the arrays, and Zernikes to Noll 21 follow them unless
 *   modes.exact_zernikes says otherwise.
 * model: receives the handle.
 *
 * COPHASE_BAD_SCENE with line, key, value and what is accepted: also for estimate.method =
 * "full-phase" and estimate.fit_optics, which only an estimator honours. COPHASE_BAD_FILE for a
 * file of the scene. COPHASE_BAD_SHAPE, COPHASE_BAD_VALUE for arrays that do not fit one another
 * or are no pupil or modes.
 */
cophase_status cophase_model_create(const char *scene_text,
                                    const char *directory,
                                    const cophase_model_arrays *arrays,
                                    cophase_model **model);

/* Frees a model; NULL is fine. Its sessions and sequences stay usable. */
void cophase_model_destroy(cophase_model *model);

/* Writes the sizes of a model. info_size: sizeof(cophase_model_info). */
cophase_status cophase_model_get_info(const cophase_model *model, cophase_model_info *info, size_t info_size);

/* Model of one of the channels of a model, in the order of the scene.
 *
 * channel: number of the channel, from 0.
 * name: receives its name, a text that lives as long as `model`, empty for a scene that lists no
 *   channels; NULL if it is not wanted.
 * channel_model: receives a handle, which the caller destroys; NULL if it is not wanted.
 *
 * COPHASE_BAD_VALUE for a channel that the model does not have.
 */
cophase_status cophase_model_channel(const cophase_model *model,
                                     size_t channel,
                                     const char **name,
                                     cophase_model **channel_model);

/* Name of mode `mode`, from 0, in `*name`: a text that lives as long as the model.
 * COPHASE_BAD_VALUE for no such mode.
 */
cophase_status cophase_model_mode_name(const cophase_model *model, size_t mode, const char **name);

/* Wavefront of some coefficients, nm; NaN outside the pupil.
 *
 * coefficients_nm: `modes` numbers. out: receives 2 x samples x samples numbers: map 0 the
 *   segments, map 1 the NCPA.
 * count: their number.
 */
cophase_status cophase_model_wavefront_nm(const cophase_model *model,
                                          const double *coefficients_nm,
                                          size_t modes,
                                          double *out,
                                          size_t count);

/* PSF of some coefficients with the diversity of a model with one channel, at the pixels that are
 * compared. Its sum over an unbounded detector would be 1. The optical axis is on row and column
 * pixels/2.
 *
 * coefficients_nm: `modes` numbers. out: receives pixels x pixels numbers. count: their number.
 *
 * COPHASE_BAD_VALUE for a model of several channels: see cophase_model_channel.
 */
cophase_status cophase_model_psf(const cophase_model *model,
                                 const double *coefficients_nm,
                                 size_t modes,
                                 double *out,
                                 size_t count);

/* ------------------------------------------ Estimator ------------------------------------------ */

/*
 Estimate of the static wavefront: modes, maps, error bars, reports on the images. Calls that take it as const may run in
 several threads at once; cophase_estimate_correct only while no other call runs (COPHASE_BUSY otherwise).
 */
typedef struct cophase_estimate cophase_estimate;

/* Stage of an estimate: none is running. */
#define COPHASE_STAGE_IDLE 0

/* Stage: the planner tries models on simulated images (estimate.budget_nm). */
#define COPHASE_STAGE_PLANNING 1

/* Stage: pupil, modes and metric are built, and optics fitted where the scene asks for it. */
#define COPHASE_STAGE_PREPARING 2

/* Stage: images are fitted. */
#define COPHASE_STAGE_FITTING 3

/* Stage: covariances are computed, and images combined. */
#define COPHASE_STAGE_COMBINING 4

/* Stage: wavefronts are retrieved (MAP). */
#define COPHASE_STAGE_RETRIEVING 5

/* Stage: static errors are separated from the turbulence (MAP). */
#define COPHASE_STAGE_SEPARATING 6

/* Estimator: the full pipeline for images of one scene, modal or maximum a posteriori (MAP,
 * estimate.method = "full-phase") as the scene says. It can be used again and again.
 *
 * One call at a time (COPHASE_BUSY otherwise), except cophase_estimator_cancel and
 * cophase_estimator_progress, which any thread may call at any time.
 */
typedef struct cophase_estimator cophase_estimator;

/* Options of an estimator. */
typedef struct {
  /* sizeof(cophase_estimator_options). */
  size_t struct_size;
  /* COPHASE_POLICY_FULL (0) or COPHASE_POLICY_REALTIME. */
  int32_t policy;
  /* Number of threads, at most 64 or four for each processor; 0 or -1 for one per processor.
   * Results do not depend on it.
   */
  int32_t threads;
} cophase_estimator_options;

/* Options of one estimate. */
typedef struct {
  /* sizeof(cophase_estimate_options). */
  size_t struct_size;
  /* Calibration of the frames; NULL: frames are electrons, or counts where the scene has
   * image.gain_e_per_adu.
   */
  const cophase_calibration *calibration;
  /* Read noise of a pixel, electrons RMS; 0 for the scene's, unless has_read_noise is 1. */
  double read_noise_e;
  /* 1: read_noise_e holds even if it is 0 (no read noise). 0: a read_noise_e of 0 means the
   * scene's.
   */
  int64_t has_read_noise;
} cophase_estimate_options;

/* Images of one channel: of the only one of a scene, or of one that it lists ([[image.channel]]).
 * The layout of this struct is permanent.
 */
typedef struct {
  /* Name of the channel, UTF-8; NULL for all: they are in the order of the scene. NULL where the
   * scene lists no channels.
   */
  const char *channel;
  /* Images of the same static errors, count x rows x cols as the channel says. Of frames with
   * one row or column more the last is left out, which COPHASE_TEXT_REMARKS says; the
   * calibration then has it, too. Bad pixels, which take no part, are those of the calibration,
   * values that are not finite, and saturated ones. The optical axis is on row rows/2 and column
   * cols/2, rounded down.
   */
  const cophase_input *frames;
  /* Its options; NULL for the defaults. */
  const cophase_estimate_options *options;
  /* Telemetry of a MAP estimate, 1 x count x slopes: slopes of the wavefront sensor, mean over
   * each exposure, along x for every subaperture, then along y; NaN for all of an image without
   * telemetry; NULL without any. Of its exposures, also where the channels are simultaneous.
   * Slopes are used where every channel has them.
   */
  const cophase_input *slopes_mas;
} cophase_channel_images;

/* Makes an estimator of a scene.
 *
 * scene_text: scene as TOML, UTF-8; see cophase_scene_preset. With estimate.budget_nm the model is
 *   planned here, which takes some seconds. Nothing else is built before the first estimate; its
 *   model is kept for the next ones, unless a file that the scene names changes.
 * directory: directory of the files that the scene names; NULL for the working directory.
 * options: NULL for the defaults.
 * estimator: receives the handle.
 *
 * COPHASE_BAD_SCENE with line, key, value and what is accepted: also for keys that the policy does
 * not honour. COPHASE_BAD_FILE for a file that the scene names and that does not exist.
 */
cophase_status cophase_estimator_create(const char *scene_text,
                                        const char *directory,
                                        const cophase_estimator_options *options,
                                        cophase_estimator **estimator);

/* Frees an estimator; NULL is fine. Its estimates stay usable. */
void cophase_estimator_destroy(cophase_estimator *estimator);

/* Makes the estimate that is running in another thread, or else the next one, return
 * COPHASE_INTERRUPTED at its next safe
 * place: within a second or two at the size of Keck. A signal handler may call it. [RT]
 */
cophase_status cophase_estimator_cancel(const cophase_estimator *estimator);

/* Progress of the estimate that is running in another thread. [RT]
 *
 * stage: receives a COPHASE_STAGE_ number. done, total: receive the steps (images) of this stage
 * that are done, and their number, 0 if it is unknown. Each may be NULL.
 */
cophase_status cophase_estimator_progress(const cophase_estimator *estimator,
                                          int32_t *stage,
                                          uint64_t *done,
                                          uint64_t *total);

/* Estimates the static wavefront behind images: of one channel, or of several (defocuses,
 * wavelengths). What is wrong with single images is in their reports; what to know of the whole is
 * in COPHASE_TEXT_WARNINGS of the estimate.
 *
 * channels: images of each channel of the scene, in any order where they are named. count: number
 *   of channels; 1 for a scene that lists none.
 * estimate: receives the handle.
 *
 * COPHASE_BAD_SHAPE for images of other channels than the scene has, and for frames or slopes of
 * another shape. COPHASE_BAD_IMAGE if no image can be used (fewer than two in a MAP estimate).
 * COPHASE_BAD_SCENE, COPHASE_BAD_FILE if the telescope cannot be built. COPHASE_DEVICE if the
 * device that the scene names is absent or fails. COPHASE_INTERRUPTED after
 * cophase_estimator_cancel.
 */
cophase_status cophase_estimator_estimate(cophase_estimator *estimator,
                                          const cophase_channel_images *channels,
                                          size_t count,
                                          cophase_estimate **estimate);

/* ------------------------------------------ Estimate ------------------------------------------- */

/* Method of an estimate: static modes fitted to each image, images combined. */
#define COPHASE_METHOD_MODAL 1

/* Method of an estimate: maximum a posteriori (MAP) wavefront behind each exposure, static errors
 * separated from the turbulence.
 */
#define COPHASE_METHOD_MAP 2

/* Knowledge of the adaptive optics that a MAP estimate assumed (estimate.ao_knowledge): only the
 * mirror's pitch and ordinary seeing.
 */
#define COPHASE_AO_KNOWLEDGE_NOTHING 1

/* Knowledge: the power spectrum of the residual wavefront, from the scene's turbulence and
 * control.
 */
#define COPHASE_AO_KNOWLEDGE_SPECTRUM 2

/* Knowledge: also the closed loop's response to the segments. */
#define COPHASE_AO_KNOWLEDGE_LOOP 3

/* Knowledge: also the slopes of the wavefront sensor during each exposure. */
#define COPHASE_AO_KNOWLEDGE_TELEMETRY 4

/* Array of an estimate: coefficients, nm; modes. */
#define COPHASE_ARRAY_COEFFICIENTS_NM 1

/* Array: standard deviation of each coefficient, nm; modes. */
#define COPHASE_ARRAY_SIGMA_NM 2

/* Array: covariance of the coefficients, nm^2; modes x modes. */
#define COPHASE_ARRAY_COVARIANCE_NM2 3

/* Array: coefficients of each image, nm, NaN for unusable images; images x modes. Modal estimates
 * only.
 */
#define COPHASE_ARRAY_IMAGE_COEFFICIENTS_NM 4

/* Array: maps of phasing errors, NCPA, and the standard deviation of each, nm, NaN outside the
 * pupil; 4 x samples x samples.
 */
#define COPHASE_ARRAY_MAPS_NM 5

/* Array: contribution of each term of the error budget to the error bars of phasing and NCPA, nm
 * RMS over the pupil; error_terms x 2. Their squares add up to the squares of phasing_sigma_nm and
 * ncpa_sigma_nm.
 */
#define COPHASE_ARRAY_ERROR_BUDGET_NM 6

/* Array, after cophase_estimate_correct: what to add to the piston of each segment, nm of
 * wavefront, which a positive piston raises; segments.
 */
#define COPHASE_ARRAY_CORRECTION_PISTONS_NM 7

/* Array, after cophase_estimate_correct: what to add to the command of each actuator, nm of
 * wavefront, from which the mirror is subtracted; actuators.
 */
#define COPHASE_ARRAY_CORRECTION_ACTUATORS_NM 8

/* Array, after cophase_estimate_correct: position of each actuator, x and y, m; actuators x 2. */
#define COPHASE_ARRAY_CORRECTION_ACTUATORS_M 9

/* Array, after cophase_estimate_correct: what to add to the sensor's reference slopes, mas, along
 * x for every subaperture, then along y; slopes. The loop then puts the correction on the mirror.
 * Without elements in a modal estimate, and without measured slopes.
 */
#define COPHASE_ARRAY_CORRECTION_SLOPES_MAS 10

/* Array: whole wavelengths of the first channel that were added to the piston of each segment,
 * their probability, and the piston of the second most probable number relative to this one, nm;
 * integers x 3. For channels of several wavelengths.
 */
#define COPHASE_ARRAY_PISTON_INTEGERS 11

/* Array, after cophase_estimate_correct: what to add to each channel of the segments' controller
 * (scene section [commands]), in its unit; segment_commands.
 */
#define COPHASE_ARRAY_CORRECTION_SEGMENT_COMMANDS 12

/* Array, after cophase_estimate_correct: what to add to each channel of the mirror's controller,
 * in its unit; actuator_commands.
 */
#define COPHASE_ARRAY_CORRECTION_ACTUATOR_COMMANDS 13

/* Array, after cophase_estimate_correct: what to add to the tip of each segment, then to the tilt
 * of each, nm of wavefront RMS over the segment; tilts. Without elements where the estimate has no
 * tilts of segments.
 */
#define COPHASE_ARRAY_CORRECTION_TILTS_NM 14

/* Array: errors of the optics and the camera that the error bars hold, within the scene's
 * [tolerance]: value, its standard deviation, that before the images, and the value by the images
 * alone over its error bar; model_errors x 4.
 */
#define COPHASE_ARRAY_MODEL_ERRORS 15

/* Array: as COPHASE_ARRAY_MAPS_NM, without focus and astigmatisms of the whole pupil, which a
 * tolerance alone divides between segments and NCPA; 4 x samples x samples. Only where
 * has_maps_without_staircases is 1.
 */
#define COPHASE_ARRAY_MAPS_WITHOUT_STAIRCASES_NM 16

/* Array: RMS and expected error of phasing, NCPA and wavefront of these maps, nm; 3 x 2. */
#define COPHASE_ARRAY_FIGURES_WITHOUT_STAIRCASES_NM 17

/* Sizes, status and figures of an estimate. RMS values are over the pupil, piston, tip and tilt
 * removed.
 */
typedef struct {
  /* Number of images. */
  size_t images;
  /* Images that were combined. */
  size_t used;
  /* Images that were fitted and left out as outliers. */
  size_t clipped;
  /* Number of modes. */
  size_t modes;
  /* Number of modes that move segments; they come first, the others are NCPA modes. */
  size_t segment_modes;
  /* Rows, and columns, of a map. */
  size_t samples;
  /* Terms of the error budget. */
  size_t error_terms;
  /* Number of warnings: lines of COPHASE_TEXT_WARNINGS. */
  size_t warnings;
  /* COPHASE_METHOD_MODAL or COPHASE_METHOD_MAP. */
  int32_t method;
  /* COPHASE_POLICY_FULL or COPHASE_POLICY_REALTIME. */
  int32_t policy;
  /* Worst COPHASE_IMAGE_ status that counts for the whole. */
  int32_t status;
  /* 1 if error bars are from the scatter between images, as from eight images on, else 0. */
  int32_t is_sequence;
  /* Iterations of a MAP estimate; 0 in a modal one. */
  int32_t iterations;
  /* 1 if the last iteration of a MAP estimate changed next to nothing, else 0; 1 in a modal one. */
  int32_t has_settled;
  /* COPHASE_AO_KNOWLEDGE_ number of a MAP estimate; 0 in a modal one. */
  int32_t ao_knowledge;
  /* Precision of the imaging chain: COPHASE_F64 or COPHASE_F32. */
  int32_t precision;
  /* Evaluations of objective and gradient, all images together. */
  uint64_t evaluations;
  /* Phasing errors, nm RMS. */
  double phasing_rms_nm;
  /* Expected error of the phasing map, nm RMS. */
  double phasing_sigma_nm;
  /* Non-common path aberrations, nm RMS. */
  double ncpa_rms_nm;
  /* Expected error of the NCPA map, nm RMS. */
  double ncpa_sigma_nm;
  /* Phasing and NCPA together, nm RMS. */
  double wavefront_rms_nm;
  /* Expected error of both together, nm RMS; in a MAP estimate the most that it can be, the sum
   * of both.
   */
  double wavefront_sigma_nm;
  /* Median reduced chi-square of the images that were used. Turbulence finer than the model's
   * samples makes it 4 to 5 behind a bright star in a MAP estimate.
   */
  double reduced_chi2;
  /* Further images like these that halve both error bars; infinity if no number does; NaN if
   * unknown, as in a modal estimate.
   */
  double images_to_halve;
  /* Side of a map, m. */
  double map_width_m;
  /* Duration of the estimate, s. */
  double seconds;
  /* Duration of building the model, s, where that is apart. */
  double model_seconds;
  /* Measured slopes over those of the retrieved wavefronts, about 1 if the telemetry belongs to
   * the images; NaN without telemetry.
   */
  double telemetry_gain;
  /* Their correlation; NaN without telemetry. */
  double telemetry_correlation;
  /* Number of channels; 0 for a scene without ([[image.channel]]). */
  size_t channels;
  /* Number of segments whose whole wavelengths were determined, rows of
   * COPHASE_ARRAY_PISTON_INTEGERS; 0 for one wavelength.
   */
  size_t integers;
  /* Rows of COPHASE_ARRAY_MODEL_ERRORS; 0 where the error bars hold the noise alone. */
  size_t model_errors;
  /* 1 if COPHASE_ARRAY_MAPS_WITHOUT_STAIRCASES_NM is there, else 0. */
  size_t has_maps_without_staircases;
} cophase_estimate_info;

/* Frees an estimate; NULL is fine. */
void cophase_estimate_destroy(cophase_estimate *estimate);

/* Writes sizes, status and figures of an estimate. info_size: sizeof(cophase_estimate_info). */
cophase_status cophase_estimate_get_info(const cophase_estimate *estimate,
                                         cophase_estimate_info *info,
                                         size_t info_size);

/* Writes the reports on all images.
 *
 * reports: receives `count` reports of report_size bytes each. report_size:
 * sizeof(cophase_image_report). count: images of the estimate.
 */
cophase_status cophase_estimate_images(const cophase_estimate *estimate,
                                       cophase_image_report *reports,
                                       size_t report_size,
                                       size_t count);

/* Writes an array of an estimate in C order.
 *
 * what: a COPHASE_ARRAY_ number, which says shape and unit. out: receives `count` numbers.
 *
 * COPHASE_BAD_SHAPE for another count than the shape's; the sentence has the right one.
 * COPHASE_BAD_VALUE for an array that this estimate does not have, and for
 * COPHASE_ARRAY_CORRECTION_ arrays before cophase_estimate_correct.
 */
cophase_status cophase_estimate_array(const cophase_estimate *estimate,
                                      int32_t what,
                                      double *out,
                                      size_t count);

/* Writes a text of an estimate.
 *
 * what: a COPHASE_TEXT_ number. index: which image, mode, term, channel or command; ignored for
 * the other texts. text, capacity, length: as in cophase_device_list.
 *
 * COPHASE_BAD_VALUE for an index out of range.
 */
cophase_status cophase_estimate_text(const cophase_estimate *estimate,
                                     int32_t what,
                                     size_t index,
                                     char *text,
                                     size_t capacity,
                                     size_t *length);

/* Writes the estimate as FITS, whole or not at all. path: UTF-8. COPHASE_BAD_FILE if it cannot be
 * written.
 */
cophase_status cophase_estimate_write(const cophase_estimate *estimate, const char *path);

/* Sizes of a correction. */
typedef struct {
  /* Number of segments. */
  size_t segments;
  /* Number of the mirror's actuators; 0 where the scene names no mirror. */
  size_t actuators;
  /* Number of slopes of the wavefront sensor; 0 where no slopes were measured, and in a modal
   * estimate.
   */
  size_t slopes;
  /* NCPA modes that are corrected. */
  size_t corrected_modes;
  /* Commands that were cut at a limit. */
  size_t limited;
  /* Channels of the segments' controller; 0 where the scene describes none ([commands]). */
  size_t segment_commands;
  /* Channels of the mirror's controller; 0 where the scene describes none. */
  size_t actuator_commands;
  /* Tips and tilts of segments that are corrected, two of each; 0 where there are none. */
  size_t tilts;
  /* NCPA modes, corrected or held. */
  size_t ncpa_modes;
  /* Pistons, tips and tilts of segments that are held. */
  size_t held_segment_modes;
  /* NCPA modes that are held. */
  size_t held_ncpa_modes;
  /* Expected drop of the sum of squares of the segment modes (of the steps at edges by the
   * convention edge-minimising), nm2.
   */
  double segments_drop_nm2;
  /* Expected drop of the sum of squares of the NCPA modes, nm2. */
  double ncpa_drop_nm2;
} cophase_correction_report;

/* Computes what to add to segments, mirror and (MAP estimates) reference slopes to correct the
 * estimated errors, also in the terms of the controllers that the scene describes. The scene's
 * section [commands] has gain, deadband and convention; errors whose correction is not expected to
 * lower them are held, and tips and tilts of segments of a modal estimate are not corrected. About
 * a second at the size of Keck where the scene has a loop. Then cophase_estimate_array has the
 * COPHASE_ARRAY_CORRECTION_ arrays, and cophase_estimate_text says why a mode is held.
 *
 * limit_nm: largest command, nm; 0 for the mirror's stroke and, for segments, a quarter of the
 * wavelength (none where the whole wavelengths are known), or commands.max_step_nm of the scene.
 * The limits of the controllers' channels hold in addition.
 * path: FITS file to write, or text for a name that ends in .txt, UTF-8; NULL for none.
 * report: NULL if it is not wanted. report_size: sizeof(cophase_correction_report).
 *
 * COPHASE_BAD_VALUE for a negative limit, for segment modes that are not pistons, and for a piston
 * that would move by more than commands.max_step_nm (unset and with one wavelength: half of it);
 * COPHASE_BAD_FILE for a controller's table or matrix that cannot be read or does not fit.
 * COPHASE_BUSY while other threads read the estimate.
 */
cophase_status cophase_estimate_correct(cophase_estimate *estimate,
                                        double limit_nm,
                                        const char *path,
                                        cophase_correction_report *report,
                                        size_t report_size);

/* ------------------------------------------- Session ------------------------------------------- */

/* Report on a group: one frame of each channel of a model. */
typedef struct {
  /* The worst status of its images, a COPHASE_IMAGE_ number; of several channels there is no
   * joint result above COPHASE_IMAGE_WRONG_MINIMUM.
   */
  int32_t status;
  /* 1 if the channels differ by more than their noise: one is flipped, of another wavelength or
   * diversity than the scene says, of another wavefront, or in another minimum; in several
   * wavelengths also where a piston is more than half a wavelength from the start.
   */
  int32_t is_contradictory;
  /* Chi-square per degree of freedom of the differences of the channels, 1 where they agree; NaN
   * for one channel, and without a joint result.
   */
  double reduced_chi2;
  /* Its degrees of freedom; 0 where the channels have no mode in common that both determine. */
  double freedom;
  /* The smallest probability of the whole wavelengths of a piston; NaN where they were not
   * sought: in one wavelength, and in a fit.
   */
  double piston_probability;
  /* Duration of the fits, s; NaN of a refinement. */
  double seconds;
} cophase_group_report;

/* Options of a session. */
typedef struct {
  /* sizeof(cophase_session_options). */
  size_t struct_size;
  /* Largest number of groups of a call, which are images of a model with one channel; 0 means 1. */
  size_t capacity;
  /* Where it runs: "auto", "cpu", "opencl" or "opencl:P:D", see cophase_device_list; NULL for
   * the scene's estimate.device. [RT] calls need "cpu".
   */
  const char *device;
  /* COPHASE_F64 or COPHASE_F32 (half the memory, a third to half of the time, errors of 0.02
   * nm); 0 for the scene's estimate.precision.
   */
  int32_t precision;
  /* Threads of the CPU chain: 0 or 1 for the caller's own, which [RT] calls need; -1 for one per
   * processor.
   */
  int32_t threads;
  /* Largest number of evaluations for one image; 0 for the scene's. */
  size_t max_evaluations;
  /* A fit stops where neither a coefficient nor the RMS of the wavefront would change by more
   * than this, nm; 0 for the scene's.
   */
  double step_tolerance_nm;
} cophase_session_options;

/* Options of a fit. */
typedef struct {
  /* sizeof(cophase_fit_options). */
  size_t struct_size;
  /* Time for the whole call, s; images that are not done by then have COPHASE_IMAGE_DEADLINE. 0
   * for no limit.
   */
  double deadline_s;
  /* Read noise of a pixel, electrons RMS; 0 for the scene's, unless has_read_noise is 1. */
  double read_noise_e;
  /* Starts of the fits, nm: count x modes in C order, each that of all channels of a group. NULL
   * for a flat wavefront.
   */
  const double *start_nm;
  /* 1: read_noise_e holds even if it is 0 (no read noise). 0: a read_noise_e of 0 means the
   * scene's.
   */
  int64_t has_read_noise;
} cophase_fit_options;

/* Session: fits of images with a model, in memory that is allocated when it is created. It follows
 * the policy COPHASE_POLICY_REALTIME: no modes with a prior, but for channels none of which
 * determines the wavefront by itself, no restarts; outlier pixels are rejected in the fit. The
 * same group gives the same bits, with any other groups in the call.
 *
 * A group is what sees one wavefront: one frame of each channel of the model, which is one image
 * of a model with one channel. The frames of a group are fitted together, with the modes in common
 * and each its own tip, tilt, flux and background.
 *
 * One call at a time (COPHASE_BUSY otherwise), except cophase_session_cancel, which any thread may
 * call at any time.
 */
typedef struct cophase_session cophase_session;

/* Creates a session of a model, which need not outlive this call.
 *
 * options: NULL for the defaults. session: receives the handle.
 *
 * COPHASE_DEVICE if the device is absent or cannot run the model. COPHASE_BAD_VALUE for an option
 * out of range, and for a scene with estimate.optimizer = "bfgs". COPHASE_BAD_SCENE for several
 * channels of which one is in focus, which an estimator takes.
 */
cophase_status cophase_session_create(const cophase_model *model,
                                      const cophase_session_options *options,
                                      cophase_session **session);

/* Frees a session; NULL is fine. */
void cophase_session_destroy(cophase_session *session);

/* Sets the calibration of later frames of a channel; the maps are copied. channel: its number in
 * the model, from 0. calibration: NULL where frames are electrons, or counts where the scene has
 * image.gain_e_per_adu, as before the first call.
 *
 * COPHASE_BAD_VALUE for a channel that the model does not have, and for bad pixels if the model
 * reduces the sampling of frames, which would smear them: such a camera needs estimate.sampling =
 * "native" in its scene.
 */
cophase_status cophase_session_calibrate(cophase_session *session,
                                         size_t channel,
                                         const cophase_calibration *calibration);

/* Makes the fit that is running in another thread, or else the next one, return
 * COPHASE_INTERRUPTED within one evaluation. A signal handler may call it. [RT]
 */
cophase_status cophase_session_cancel(const cophase_session *session);

/* Fits the model to frames, those of a group together. [RT]
 *
 * frames: an array for each channel, in the order of the model, each count x rows x cols of its
 *   channel, count up to the session's capacity: frames k of all channels are group k. Values that
 *   are not finite are bad pixels. The optical axis is on row rows/2 and column cols/2.
 * channels: number of channels of the model.
 * options: NULL for the defaults. The deadline holds for all frames together.
 * coefficients_nm: receives count x modes numbers in C order: of one channel those of each image,
 *   NaN for an unusable one; of several the modes that they have in common, NaN unless all frames
 *   of the group can be used and the fit converged.
 * sigma_nm: receives count x modes error bars (1 sigma) of the common modes of several channels;
 *   NULL if they are not wanted. They are those of a flat wavefront with the flux and the noise of
 *   the frames, scaled by chi-square where a model misfits and where the channels contradict each
 *   other. They hold the noise, and not what the scene
 *   does not know (plate scale, defocus, gains) nor what the modes leave out:
 *   cophase_estimator_estimate has these. NaN for one channel, whose covariance
 *   cophase_session_refine has.
 * modes: the model's number of modes.
 * images: receives count x channels reports in C order, of image_size bytes each; NULL if they are
 *   not wanted. image_size: sizeof(cophase_image_report).
 * groups: receives count reports of group_size bytes each; NULL if they are not wanted.
 *   group_size: sizeof(cophase_group_report).
 *
 * The call succeeds where single images fail: their status is in their reports.
 * COPHASE_INTERRUPTED after cophase_session_cancel; nothing is written then.
 */
cophase_status cophase_session_fit(cophase_session *session,
                                   const cophase_input *frames,
                                   size_t channels,
                                   const cophase_fit_options *options,
                                   double *coefficients_nm,
                                   double *sigma_nm,
                                   size_t modes,
                                   cophase_image_report *images,
                                   size_t image_size,
                                   cophase_group_report *groups,
                                   size_t group_size);

/* Objective and gradient for an optimizer of the caller's: sum of weight * (flux * PSF +
 * background - data)^2 over the pixels of each image, with the flux and background that minimize
 * it and the weights that a fit begins with. [RT]
 *
 * channel: number of the channel in the model, from 0, whose images they are.
 * frames: count x rows x cols of the channel; NULL for those of its last evaluation, if no fit
 *   came since.
 * options: only read_noise_e and has_read_noise are used, and only with frames; NULL for the
 *   defaults.
 * coefficients_nm: count x modes numbers in C order. count: number of frames.
 * objectives: receives count numbers. gradients: receives count x modes numbers, per nm.
 *
 * COPHASE_BAD_IMAGE for a frame that cannot be used. COPHASE_BAD_VALUE if frames is NULL and none
 * are loaded.
 */
cophase_status cophase_session_evaluate(cophase_session *session,
                                        size_t channel,
                                        const cophase_input *frames,
                                        const cophase_fit_options *options,
                                        const double *coefficients_nm,
                                        size_t count,
                                        size_t modes,
                                        double *objectives,
                                        double *gradients);

/* The result of a group of the last fit with its covariance, in some hundred evaluations of each
 * channel: of one channel that of the noise, scaled by chi-square where the model misfits. Of
 * several channels it is from the information at the fitted wavefront, with the whole wavelengths
 * of pistons found (modes.piston_range_nm): what cophase_estimator_estimate finds in these frames
 * by the policy COPHASE_POLICY_REALTIME.
 *
 * group: number of the group in the last fit, from 0.
 * coefficients_nm: receives `modes` numbers. covariance_nm2: receives modes x modes numbers. Each
 *   may be NULL. modes: the model's number of modes.
 * report: NULL if it is not wanted. report_size: sizeof(cophase_group_report).
 *
 * COPHASE_BAD_VALUE for a group that was not fitted, and unless the fit of several channels
 * converged.
 */
cophase_status cophase_session_refine(const cophase_session *session,
                                      size_t group,
                                      double *coefficients_nm,
                                      double *covariance_nm2,
                                      size_t modes,
                                      cophase_group_report *report,
                                      size_t report_size);

/* Writes a text of a session.
 *
 * what: COPHASE_TEXT_IMAGE_MESSAGE, COPHASE_TEXT_WARNINGS, with that of channels that contradict
 *   each other in the last fit, COPHASE_TEXT_DEVICE or COPHASE_TEXT_POLICY. index: image of the
 *   last fit, group * channels + channel; ignored for the other texts. text, capacity, length: as
 *   in cophase_device_list.
 *
 * COPHASE_BAD_VALUE for an image that was not in the last fit.
 */
cophase_status cophase_session_text(const cophase_session *session,
                                    int32_t what,
                                    size_t index,
                                    char *text,
                                    size_t capacity,
                                    size_t *length);

/* ------------------------------------------ Sequence ------------------------------------------- */

/* Sequence: the last images that sessions of a model fitted, and their running estimate. Calls
 * that take it as const may run in several threads at once, any other only while no other call
 * runs (COPHASE_BUSY otherwise).
 */
typedef struct cophase_sequence cophase_sequence;

/* Figures of a running estimate. RMS values are over the pupil. */
typedef struct {
  /* Images in the sequence. */
  size_t images;
  /* Images that were combined. */
  size_t used;
  /* Images that were fitted and left out as outliers. */
  size_t clipped;
  /* Phasing errors, nm RMS. */
  double phasing_rms_nm;
  /* Their error bar, nm RMS. */
  double phasing_sigma_nm;
  /* Non-common path aberrations, nm RMS. */
  double ncpa_rms_nm;
  /* Their error bar, nm RMS. */
  double ncpa_sigma_nm;
  /* Median chi-square per degree of freedom of the images that were combined. */
  double reduced_chi2;
} cophase_sequence_report;

/* Creates an empty sequence that keeps the last `capacity` images of sessions of a model, which
 * need not outlive this call. sequence: receives the handle.
 *
 * COPHASE_BAD_VALUE for a model of several channels.
 */
cophase_status cophase_sequence_create(const cophase_model *model,
                                       size_t capacity,
                                       cophase_sequence **sequence);

/* Frees a sequence; NULL is fine. */
void cophase_sequence_destroy(cophase_sequence *sequence);

/* Adds all images of a session's last fit, of any status; the oldest are dropped beyond the
 * capacity. session NULL: drops all images. [RT]
 *
 * COPHASE_BAD_VALUE for a session of another model, or of several channels. COPHASE_BUSY while the
 * session is in use.
 */
cophase_status cophase_sequence_push(cophase_sequence *sequence, const cophase_session *session);

/* The estimate from the images so far: their mean, clipped mean or median, as the scene says
 * (estimate.combine). From eight images on, outliers are found by comparing images, and error bars
 * are from the scatter between them.
 *
 * coefficients_nm: receives `modes` numbers. sigma_nm: receives `modes` standard deviations.
 *   covariance_nm2: receives modes x modes numbers. Each may be NULL.
 * modes: the model's number of modes.
 * report: NULL if it is not wanted. report_size: sizeof(cophase_sequence_report).
 *
 * COPHASE_BAD_IMAGE if no image of the sequence was fitted.
 */
cophase_status cophase_sequence_estimate(const cophase_sequence *sequence,
                                         double *coefficients_nm,
                                         double *sigma_nm,
                                         double *covariance_nm2,
                                         size_t modes,
                                         cophase_sequence_report *report,
                                         size_t report_size);

/* Number of further images like those so far that bring both error bars (nm RMS over the pupil)
 * down to the given ones, in `*images`; 0 if they are. Infinity accepts any error bar.
 *
 * COPHASE_BAD_VALUE if errors that all images share alone are larger. COPHASE_BAD_IMAGE if no
 * image was fitted.
 */
cophase_status cophase_sequence_images_needed(const cophase_sequence *sequence,
                                              double phasing_nm,
                                              double ncpa_nm,
                                              uint64_t *images);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* COPHASE_H */
