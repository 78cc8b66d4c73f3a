/* cophase: phasing errors and non-common path aberrations of segmented telescopes.
 * Generated from src/capi by cbindgen; do not edit. */

#ifndef COPHASE_H
#define COPHASE_H

#include <stddef.h>
#include <stdint.h>

// What a full-phase estimate assumes of the adaptive optics: what the scene says (estimate.knows), or else the most that
// there is.
#define COPHASE_KNOWS_MOST 0

// Nothing: the mirror's pitch, and a spectrum of ordinary seeing.
#define COPHASE_KNOWS_NOTHING 1

// The spectrum of the residual wavefront, from the scene's turbulence and control.
#define COPHASE_KNOWS_SPECTRUM 2

// The loop as well: what it answers to the pistons is found by closing it on them alone.
#define COPHASE_KNOWS_LOOP 3

// What its wavefront sensor measured during each exposure as well.
#define COPHASE_KNOWS_TELEMETRY 4

// Element type of a cophase_input: float.
#define COPHASE_F32 1

// Element type of a cophase_input: double.
#define COPHASE_F64 2

// Element type of a cophase_input: uint16_t.
#define COPHASE_U16 3

// Element type of a cophase_input: int32_t.
#define COPHASE_I32 4

// Element type of a cophase_input: uint8_t.
#define COPHASE_U8 5

// Status of an image: fitted, and the model explains it.
#define COPHASE_IMAGE_OK 0

// Status of an image: fitted, but the residual is larger than the noise.
#define COPHASE_IMAGE_MISFIT 1

// Status of an image: the residual is so large that the fit probably sits in a wrong minimum.
#define COPHASE_IMAGE_WRONG_MINIMUM 2

// Status of an image: the optimiser gave up before it converged.
#define COPHASE_IMAGE_NOT_CONVERGED 3

// Status of an image: it could not be used, and its coefficients are NaN.
#define COPHASE_IMAGE_UNUSABLE 4

// Status of an image: time was up, and its coefficients are the best so far.
#define COPHASE_IMAGE_DEADLINE 5

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
#define COPHASE_ABI_VERSION 1

// Where a session's model runs: the CPU chain, or an OpenCL device. Immutable: any thread may use it.
typedef struct cophase_device cophase_device;

// The estimator of `cophase estimate --method full-phase`: the whole wavefront behind each exposure of a sequence, and
// static errors, pistons of the segments and non-common path aberrations (NCPA), from all of them together.
//
// Calls that take it as const may run in several threads at once; any other only while no other call runs
// (COPHASE_BUSY otherwise), but for cophase_full_phase_cancel and cophase_full_phase_progress, which are meant to race.
typedef struct cophase_full_phase cophase_full_phase;

// What images are compared with: a telescope, its modes and their names, the diversity, the camera. Immutable: any
// thread may use it at any time.
typedef struct cophase_model cophase_model;

// The images of one static wavefront, as they come: what they say together, how well, and how many more are needed.
//
// Calls that take it as const may run in several threads at once; any other only while no other call runs
// (COPHASE_BUSY otherwise).
typedef struct cophase_sequence cophase_sequence;

// One thread's workspace: its memory, its kernels, its queue. Making it pays every cost that comes once.
//
// One call at a time (COPHASE_BUSY otherwise), but for cophase_session_cancel. Calls marked [RT] allocate nothing, wait
// for no lock and format no text while they succeed, on the CPU chain with one thread; a driver of OpenCL may do as it
// likes. The same frame gives the same bits, whatever else is in the call, in every language.
typedef struct cophase_session cophase_session;

// A simulated AO system under a sky: turbulence, wavefront sensor, deformable mirror, control, science camera.
//
// Calls that take it as const may run in several threads at once; any other only while no other call runs
// (COPHASE_BUSY otherwise). The same scene gives the same bits, in every language.
typedef struct cophase_simulator cophase_simulator;

// What became of a call: COPHASE_OK, or why it failed. Numbers are permanent; a later version may have more.
typedef int32_t cophase_status;

// Corrections, in numbers. Later versions may append fields.
typedef struct cophase_correction_report {
  // Segments whose pistons are to be moved.
  uint64_t segments;
  // Actuators of the mirror; 0 without a loop in the scene.
  uint64_t actuators;
  // Slopes of the wavefront sensor; 0 without a loop in the scene.
  uint64_t slopes;
  // NCPA modes that are corrected: those whose estimate is above its error bar.
  uint64_t corrected_modes;
  // Commands that were cut at the limit.
  uint64_t limited;
} cophase_correction_report;

// What became of an image of a full-phase estimate. Later versions may append fields.
typedef struct cophase_full_phase_image {
  // COPHASE_IMAGE_OK, COPHASE_IMAGE_NOT_CONVERGED or COPHASE_IMAGE_UNUSABLE.
  int32_t status;
  // 1 where the image was used; 0 where it could not be, or where its χ² is not like the others'.
  int32_t used;
  // Evaluations of the model in the last pass.
  uint64_t evaluations;
  // χ² per degree of freedom; NaN for an image that could not be used.
  double reduced_chi2;
  // The star, electrons.
  double flux_e;
  // Background, electrons per pixel of the frame.
  double background_e;
} cophase_full_phase_image;

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

// How a full-phase estimate is made.
typedef struct cophase_full_phase_options {
  // Filled in by cophase_full_phase_options_init.
  size_t struct_size;
  // What is assumed of the adaptive optics: COPHASE_KNOWS_MOST, or another of the COPHASE_KNOWS_ numbers. Default:
  // COPHASE_KNOWS_MOST.
  int32_t knows;
  // Threads that it runs on; 0 for as many as the machine has processors. Default: 0.
  int32_t threads;
  // Read noise of a pixel, RMS electrons; NaN for what the scene says. Default: NaN.
  double read_noise_e;
} cophase_full_phase_options;

// A stack of `count` frames or maps of `rows` × `cols` elements (row = y, col = x) in memory of the caller's, which is
// only read, and only during the call.
//
// Element (k, y, x) is at `data + k*count_stride + y*row_stride + x*col_stride`, in elements of the given type. Strides
// may be negative, and 0 where one element stands for many; that of an extent of 1 does not matter. The layout of this
// struct is permanent.
typedef struct cophase_input {
  // Element (0, 0, 0). NULL where an array is optional and absent.
  const void *data;
  // COPHASE_F32, COPHASE_F64, COPHASE_U16, COPHASE_I32 or COPHASE_U8.
  int32_t element;
  // Frames or maps.
  size_t count;
  // Rows of each.
  size_t rows;
  // Columns of each.
  size_t cols;
  // Elements from one frame to the next.
  ptrdiff_t count_stride;
  // Elements from one row to the next.
  ptrdiff_t row_stride;
  // Elements from one column to the next.
  ptrdiff_t col_stride;
} cophase_input;

// What a camera's raw values mean: electrons = (raw − dark)·gain/flat.
typedef struct cophase_calibration {
  // Filled in by cophase_calibration_init.
  size_t struct_size;
  // 1 x rows x cols: signal without light, raw units. Data NULL: none.
  struct cophase_input dark;
  // 1 x rows x cols: relative response, about 1. Data NULL: all alike.
  struct cophase_input flat;
  // 1 x rows x cols: pixels that are not 0 take no part. Data NULL: all do.
  struct cophase_input bad;
  // Electrons per raw unit. Default: 1.
  double gain_e;
  // Pixels that read as much or more take no part, raw units. Default: infinity.
  double saturation;
} cophase_calibration;

// What a full-phase estimate found. Later versions may append fields.
typedef struct cophase_full_phase_report {
  // Images that were read.
  uint64_t images;
  // Those that were used.
  uint64_t used;
  // Passes that were made, each about the static wavefront that the one before found.
  uint64_t passes;
  // 1 where the last pass changed less than a fraction of the error bars; 0 where there were no more to be had.
  int32_t settled;
  // What was assumed of the adaptive optics: one of the COPHASE_KNOWS_ numbers, not COPHASE_KNOWS_MOST.
  int32_t knows;
  // The segments' part of the wavefront, nm RMS over the pupil, piston, tip and tilt removed.
  double phasing_rms_nm;
  // Its error bar, nm RMS over the pupil.
  double phasing_sigma_nm;
  // The non-common path aberrations, likewise.
  double ncpa_rms_nm;
  // Their error bar, nm RMS over the pupil.
  double ncpa_sigma_nm;
  // By how much the last pass changed the phasing, nm RMS over the pupil; NaN if it was the only one.
  double phasing_change_nm;
  // By how much it changed the NCPA, likewise.
  double ncpa_change_nm;
  // Median χ² per degree of freedom of the images that were used: turbulence finer than the model's samples makes it 4
  // to 5 behind a bright star.
  double reduced_chi2;
  // Time that it took, s.
  double seconds;
} cophase_full_phase_report;

// A telescope, its modes and its diversity as maps of the caller's; see cophase_model_create_from_arrays.
typedef struct cophase_model_arrays {
  // Filled in by cophase_model_arrays_init.
  size_t struct_size;
  // 1 x n x n, n even: the amplitude of the pupil, 0 to 1, over the scene's pupil.grid_m. Needed.
  struct cophase_input pupil;
  // 1 x n x n: the segment that each sample belongs to, from 0, negative where there is no glass. Data NULL: the
  // mirror is not segmented.
  struct cophase_input segments;
  // modes x n x n: wavefront of each mode, nm per nm of its coefficient. Data NULL: those of the scene.
  struct cophase_input modes;
  // 1 x n x n: the diversity, nm of wavefront. Data NULL: that of the scene.
  struct cophase_input diversity_nm;
} cophase_model_arrays;

// How a session is made.
typedef struct cophase_session_options {
  // Filled in by cophase_session_options_init.
  size_t struct_size;
  // Most images of a call. Default: 1.
  size_t capacity;
  // COPHASE_F64, or COPHASE_F32: half the memory, a third to half of the time, 0.02 nm. Default:
  // COPHASE_F64.
  int32_t precision;
  // Threads of the CPU chain: 1 for the caller's own, which calls marked [RT] need; 0 for all that there are.
  // Default: 1.
  int32_t threads;
  // Most evaluations of the model for one image; 0 for what the scene says. Default: 0.
  size_t max_evaluations;
  // A fit stops where neither a coefficient nor the RMS of the wavefront would move by more than this; 0 for what
  // the scene says. Default: 0.
  double step_tolerance_nm;
} cophase_session_options;

// How frames are fitted.
typedef struct cophase_fit_options {
  // Filled in by cophase_fit_options_init.
  size_t struct_size;
  // Time for the whole call, s; what is not done by then is reported as COPHASE_IMAGE_DEADLINE. 0 for no limit.
  // Default: 0.
  double deadline_s;
  // Read noise of a pixel, RMS electrons; NaN for what the scene says. Default: NaN.
  double read_noise_e;
  // Where the fits begin, nm: count x modes in C order. NULL for a flat wavefront. Default:
  // NULL.
  const double *start_nm;
} cophase_fit_options;

// What the images of a sequence say together. Later versions may append fields.
typedef struct cophase_sequence_report {
  // Images that are kept.
  uint64_t images;
  // Those that were combined.
  uint64_t used;
  // Those that were fitted but left out as outliers.
  uint64_t clipped;
  // The segments' part of the wavefront, nm RMS over the pupil.
  double phasing_rms_nm;
  // Its error bar, nm RMS over the pupil.
  double phasing_sigma_nm;
  // The non-common path aberrations, nm RMS over the pupil.
  double ncpa_rms_nm;
  // Their error bar, nm RMS over the pupil.
  double ncpa_sigma_nm;
  // Median χ² per degree of freedom of the images that were combined.
  double reduced_chi2;
} cophase_sequence_report;

// What became of an image. Later versions may append fields.
typedef struct cophase_report {
  // COPHASE_IMAGE_OK, or another of the COPHASE_IMAGE_ numbers.
  int32_t status;
  // Pixels of the fitted part that took no part.
  int32_t bad_pixels;
  // Evaluations of the model.
  uint64_t evaluations;
  // χ² per degree of freedom: 1 where the model is right.
  double reduced_chi2;
  // The star, electrons.
  double flux_e;
  // Background, electrons per pixel of the frame.
  double background_e;
  // Tilt of the fitted wavefront along x, nm RMS over the pupil, the shift onto the axis included.
  double tip_nm;
  // Likewise along y.
  double tilt_nm;
  // Time that its fit took, s.
  double seconds;
} cophase_report;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// Works out the corrections that the last estimate calls for: what to add to segments, mirror and reference slopes. Do
// no harm: a mode whose estimate is under its error bar is left alone. Where the scene has a loop this takes about a
// second at the size of Keck.
//
// limit_nm: no command is larger; NaN for the mirror's stroke and, for segments, a quarter of the wavelength.
// report: NULL if it is not wanted; report_size: sizeof(cophase_correction_report).
//
// COPHASE_BAD_VALUE before the first estimate.
cophase_status cophase_full_phase_correct(struct cophase_full_phase *full_phase,
                                          double limit_nm,
                                          struct cophase_correction_report *report,
                                          size_t report_size);

// The corrections that cophase_full_phase_correct worked out, in this library's order; a positive command raises the
// wavefront. Any of the pointers may be NULL for what is not wanted, and its number then does not matter.
//
// pistons_nm: receives segments numbers: what to add to each segment's piston, nm of wavefront.
// actuators_nm: receives actuators numbers: what to add to each command of the mirror, nm of wavefront.
// actuators_m: receives actuators x 2 numbers: where each actuator is, x and y, m.
// slopes_mas: receives slopes numbers: what to add to the sensor's reference, along x for every subaperture, then along y;
//   it keeps the mirror where the commands put it.
//
// COPHASE_BAD_VALUE before cophase_full_phase_correct, COPHASE_BAD_SHAPE for other numbers than its report's.
cophase_status cophase_full_phase_corrections(const struct cophase_full_phase *full_phase,
                                              double *pistons_nm,
                                              size_t segments,
                                              double *actuators_nm,
                                              double *actuators_m,
                                              size_t actuators,
                                              double *slopes_mas,
                                              size_t slopes);

// The devices of this machine, one line each: the name that cophase_device_open takes, a tab, and what it is. The CPU
// chain is always there, and the first.
//
// Writes at most `capacity` bytes to `text`, the terminating zero included, as snprintf does; `text` may be NULL where
// `capacity` is 0. `*length` receives the length of the whole text in bytes without the zero.
cophase_status cophase_device_list(char *text,
                                   size_t capacity,
                                   size_t *length);

// Opens a device: "cpu", "opencl" (a GPU before anything else), "opencl:P:D", or "auto" (a GPU where there is one and it
// can run the model, else the CPU chain).
//
// COPHASE_BAD_VALUE for a name that cannot be one, COPHASE_DEVICE where no such device is here.
cophase_status cophase_device_open(const char *name,
                                   struct cophase_device **device);

// Closes a device; NULL is fine. Sessions that were made on it go on.
void cophase_device_close(struct cophase_device *device);

// What a device is: its line of cophase_device_list. `text`, `capacity` and `length` are as there.
cophase_status cophase_device_name(const struct cophase_device *device,
                                   char *text,
                                   size_t capacity,
                                   size_t *length);

// The sentence of the last call that failed on this thread, in UTF-8; empty before the first. A call that succeeds
// leaves it as it was.
//
// Writes at most `capacity` bytes to `text`, the terminating zero included, as snprintf does; `text` may be NULL where
// `capacity` is 0. Returns the length of the whole sentence in bytes without the zero: less than `capacity` where all
// of it was written. Longer sentences than 2048 bytes are cut off.
size_t cophase_last_error(char *text,
                          size_t capacity);

// What became of each image of the last estimate.
//
// reports: receives count reports, each in report_size bytes; report_size: sizeof(cophase_full_phase_image). count: the
//   number of images in that estimate. COPHASE_BAD_VALUE before the first estimate, here and below.
cophase_status cophase_full_phase_images(const struct cophase_full_phase *full_phase,
                                         struct cophase_full_phase_image *reports,
                                         size_t report_size,
                                         size_t count);

// What became of an image of the last estimate, in a sentence. `text`, `capacity` and `length` are as in
// cophase_device_list.
//
// COPHASE_BAD_VALUE for an image that was not in it.
cophase_status cophase_full_phase_image_message(const struct cophase_full_phase *full_phase,
                                                size_t image,
                                                char *text,
                                                size_t capacity,
                                                size_t *length);

// What somebody should know before using the last estimate, a sentence in each line; empty where there is nothing: images
// that were left out, a scene that does not explain the images, passes that did not settle, a loop that is not known.
// `text`, `capacity` and `length` are as in cophase_device_list.
cophase_status cophase_full_phase_warnings(const struct cophase_full_phase *full_phase,
                                           char *text,
                                           size_t capacity,
                                           size_t *length);

// Number of static modes of the last estimate: pistons of the segments, then NCPA.
cophase_status cophase_full_phase_mode_count(const struct cophase_full_phase *full_phase, size_t *modes);

// Number of those that move segments; they come first.
cophase_status cophase_full_phase_segment_mode_count(const struct cophase_full_phase *full_phase,
                                                     size_t *modes);

// Name of a mode, from 0. The text lives until the next estimate begins.
//
// COPHASE_BAD_VALUE for a mode that there is not.
cophase_status cophase_full_phase_mode_name(const struct cophase_full_phase *full_phase,
                                            size_t mode,
                                            const char **name);

// Coefficients of the static modes, nm.
//
// coefficients_nm, sigma_nm: receive modes numbers; sigma_nm (1σ of each) may be NULL. modes:
// cophase_full_phase_mode_count.
cophase_status cophase_full_phase_coefficients_nm(const struct cophase_full_phase *full_phase,
                                                  double *coefficients_nm,
                                                  double *sigma_nm,
                                                  size_t modes);

// Their covariance, nm². covariance_nm2: receives modes x modes numbers.
cophase_status cophase_full_phase_covariance_nm2(const struct cophase_full_phase *full_phase,
                                                 double *covariance_nm2,
                                                 size_t modes);

// Rows, and columns, of a map.
cophase_status cophase_full_phase_samples(const struct cophase_full_phase *full_phase, size_t *samples);

// The static errors as maps, nm: map 0 the phasing errors of the segments, map 1 the NCPA, maps 2 and 3 their error bars
// (1σ). NaN outside the pupil.
//
// out: 4 x samples x samples, see cophase_full_phase_samples.
cophase_status cophase_full_phase_maps_nm(const struct cophase_full_phase *full_phase,
                                          const struct cophase_array_f32 *out);

// How many further images like those so far bring both error bars (nm RMS over the pupil) down to the given ones, in
// `*images`; 0 where they are there. Infinity asks nothing. COPHASE_BAD_VALUE where what all images
// share (an error of the diversity, NCPA finer than the modes) alone makes more.
cophase_status cophase_full_phase_images_needed(const struct cophase_full_phase *full_phase,
                                                double phasing_nm,
                                                double ncpa_nm,
                                                uint64_t *images);

// Fills in `struct_size` and the defaults. struct_size: sizeof(cophase_full_phase_options).
cophase_status cophase_full_phase_options_init(struct cophase_full_phase_options *options,
                                               size_t struct_size);

// Makes a full-phase estimator of a scene, which its estimate.method need not name. Nothing is built yet.
//
// scene_text: a scene as TOML, in UTF-8; it is copied. With [wavefront_sensor] and [control] it describes the loop in front
//   of the camera.
// directory: where the files are looked for that the scene names; NULL for the working directory.
// full_phase: receives the handle, which the caller gives back with cophase_full_phase_destroy.
//
// COPHASE_BAD_SCENE with the line, the key, its value and what is accepted: also for keys that are for static modes alone,
// such as estimate.optimizer.
cophase_status cophase_full_phase_create(const char *scene_text,
                                         const char *directory,
                                         struct cophase_full_phase **full_phase);

// Frees a full-phase estimator; NULL is fine. No other call on it may be running, and none may follow.
void cophase_full_phase_destroy(struct cophase_full_phase *full_phase);

// Rows and columns of a detector frame.
cophase_status cophase_full_phase_frame_shape(const struct cophase_full_phase *full_phase,
                                              size_t *rows,
                                              size_t *cols);

// Says what the raw values of coming frames mean. The maps are copied. NULL: frames are electrons, as they are until the
// first call.
cophase_status cophase_full_phase_calibrate(struct cophase_full_phase *full_phase,
                                            const struct cophase_calibration *calibration);

// Reads a sequence. 75 exposures of Keck take some ten seconds on two.
//
// frames: count x rows x cols, see cophase_full_phase_frame_shape; 2 or more exposures of the same static errors. Values
//   that are not finite are bad pixels. The optical axis is in row rows/2 and column cols/2.
// slopes_mas: telemetry, 1 x count x slopes: what the wavefront sensor measured meanwhile, mean over each exposure, along x
//   for every subaperture, then along y; NULL without.
// options: NULL for the defaults.
// report: NULL if it is not wanted; report_size: sizeof(cophase_full_phase_report). All else that was found is asked for
//   by the calls below.
//
// COPHASE_BAD_SCENE where more is to be known than there is, such as the loop in a scene without one; COPHASE_BAD_SHAPE
// for frames or slopes of another shape; COPHASE_BAD_IMAGE where fewer than two images can be used; COPHASE_INTERRUPTED
// after cophase_full_phase_cancel. A call that fails leaves the estimate before it as it was.
cophase_status cophase_full_phase_estimate(struct cophase_full_phase *full_phase,
                                           const struct cophase_input *frames,
                                           const struct cophase_input *slopes_mas,
                                           const struct cophase_full_phase_options *options,
                                           struct cophase_full_phase_report *report,
                                           size_t report_size);

// Makes the estimate that is running in another thread, or else the next one, return COPHASE_INTERRUPTED, before the next
// image or the next pass: within a second or two at the size of Keck. [RT]
cophase_status cophase_full_phase_cancel(const struct cophase_full_phase *full_phase);

// Wavefronts that the estimate running in another thread, or else the last one, has retrieved so far, in all passes
// together; each pass has one for each image. [RT]
cophase_status cophase_full_phase_progress(const struct cophase_full_phase *full_phase,
                                           uint64_t *retrieved);

// Builds the model that a scene describes. This takes about half a second at the size of Keck.
//
// scene_text: a scene as TOML, in UTF-8; it is copied. cophase_scene_preset has some, `cophase scene --reference` lists
//   the keys.
// directory: where the files are looked for that the scene names; NULL for the working directory.
// model: receives the handle, which the caller gives back with cophase_model_destroy.
//
// Where the scene has estimate.budget_nm the model is planned, the cheapest whose error stays within it, which takes
// some seconds more.
//
// COPHASE_BAD_SCENE with the line, the key, its value and what is accepted; COPHASE_BAD_FILE for a file of the scene's.
cophase_status cophase_model_create(const char *scene_text,
                                    const char *directory,
                                    struct cophase_model **model);

// Fills in `struct_size`, and no arrays. struct_size: sizeof(cophase_model_arrays).
cophase_status cophase_model_arrays_init(struct cophase_model_arrays *arrays, size_t struct_size);

// As cophase_model_create, with pupil, modes and diversity of the caller's in place of the scene's. The arrays are
// copied. Of the scene this leaves the camera ([image]), how the fit is done ([estimate]), and whether the pistons of
// the segments are estimated (modes.segment); they come before the caller's modes.
//
// COPHASE_BAD_SHAPE for maps that do not fit one another, COPHASE_BAD_VALUE for what cannot be a pupil or a mode.
cophase_status cophase_model_create_from_arrays(const char *scene_text,
                                                const char *directory,
                                                const struct cophase_model_arrays *arrays,
                                                struct cophase_model **model);

// Frees a model; NULL is fine. Sessions and sequences that were made of it go on.
void cophase_model_destroy(struct cophase_model *model);

// Number of modes that are estimated: the coefficients of an image.
cophase_status cophase_model_mode_count(const struct cophase_model *model, size_t *modes);

// Number of those that move segments; they come first.
cophase_status cophase_model_segment_mode_count(const struct cophase_model *model, size_t *modes);

// Name of a mode, from 0. The text lives as long as the model.
//
// COPHASE_BAD_VALUE for a mode that there is not.
cophase_status cophase_model_mode_name(const struct cophase_model *model, size_t mode, const char **name);

// Rows and columns of a detector frame.
cophase_status cophase_model_frame_shape(const struct cophase_model *model, size_t *rows, size_t *cols);

// Rows, and columns, of a wavefront map.
cophase_status cophase_model_samples(const struct cophase_model *model, size_t *samples);

// Rows, and columns, of a PSF: the pixels that are compared, after the reduction of a frame to the model's sampling and
// to what carries signal.
cophase_status cophase_model_pixels(const struct cophase_model *model,
                                    size_t *pixels);

// The wavefront of some coefficients, nm: map 0 the segments, map 1 the non-common path aberrations. NaN outside the
// pupil.
//
// modes: the number of coefficients, see cophase_model_mode_count. out: 2 x samples x samples, see
// cophase_model_samples.
cophase_status cophase_model_wavefront_nm(const struct cophase_model *model,
                                          const double *coefficients_nm,
                                          size_t modes,
                                          const struct cophase_array_f32 *out);

// The PSF of some coefficients with the diversity, at the pixels that are compared: its sum over an unbounded detector
// would be 1. The optical axis is in row and column pixels/2.
//
// modes: as above. out: 1 x pixels x pixels, see cophase_model_pixels.
cophase_status cophase_model_psf(const struct cophase_model *model,
                                 const double *coefficients_nm,
                                 size_t modes,
                                 const struct cophase_array_f32 *out);

// Fills in `struct_size` and the defaults. struct_size:
// sizeof(cophase_session_options).
cophase_status cophase_session_options_init(struct cophase_session_options *options, size_t struct_size);

// Fills in `struct_size` and the defaults. struct_size: sizeof(cophase_calibration).
cophase_status cophase_calibration_init(struct cophase_calibration *calibration, size_t struct_size);

// Fills in `struct_size` and the defaults. struct_size: sizeof(cophase_fit_options).
cophase_status cophase_fit_options_init(struct cophase_fit_options *options, size_t struct_size);

// Name of an image's status: `OK`, `MISFIT`, …; `UNKNOWN` for a number of a later version.
//
// Returns a static string that the caller must not free. Never NULL.
const char *cophase_image_status_name(int32_t status);

// The text of a scene that comes with the library: "keck-artificial" or "keck-onsky", in `*scene_text`.
//
// It is a static string that the caller must not free. COPHASE_BAD_SCENE for another name.
cophase_status cophase_scene_preset(const char *name, const char **scene_text);

// Makes an empty sequence of images of a model, which keeps the last `capacity` of them. The model need not outlive this
// call.
cophase_status cophase_sequence_create(const struct cophase_model *model,
                                       size_t capacity,
                                       struct cophase_sequence **sequence);

// Frees a sequence; NULL is fine. No other call on it may be running, and none may follow.
void cophase_sequence_destroy(struct cophase_sequence *sequence);

// Takes all images of a session's last fit, whatever became of them; the oldest make way. [RT]
//
// COPHASE_BAD_VALUE for a session of another model, COPHASE_BUSY while the session fits in another thread.
cophase_status cophase_sequence_push(struct cophase_sequence *sequence,
                                     const struct cophase_session *session);

// Forgets all images. [RT]
cophase_status cophase_sequence_clear(struct cophase_sequence *sequence);

// The static estimate so far: mean or median of the images as the scene says (estimate.combine). Up to seven images are
// judged one by one; from eight on by one another, and error bars are from the scatter between them.
//
// coefficients_nm, sigma_nm: receive modes numbers; sigma_nm (1σ of each) may be NULL. report: NULL if it is not wanted;
// report_size: sizeof(cophase_sequence_report). COPHASE_BAD_IMAGE where no image was fitted yet.
cophase_status cophase_sequence_estimate(const struct cophase_sequence *sequence,
                                         double *coefficients_nm,
                                         double *sigma_nm,
                                         size_t modes,
                                         struct cophase_sequence_report *report,
                                         size_t report_size);

// Covariance of the static estimate so far, nm². covariance_nm2: receives modes x modes numbers. COPHASE_BAD_IMAGE where
// no image was fitted yet.
cophase_status cophase_sequence_covariance_nm2(const struct cophase_sequence *sequence,
                                               double *covariance_nm2,
                                               size_t modes);

// How many further images like those so far bring both error bars (nm RMS over the pupil) down to the given ones, in
// `*images`; 0 where they are there. Infinity asks nothing. COPHASE_BAD_IMAGE where no image was fitted yet.
cophase_status cophase_sequence_images_needed(const struct cophase_sequence *sequence,
                                              double phasing_nm,
                                              double ncpa_nm,
                                              uint64_t *images);

// Makes a workspace for images of a model.
//
// device: where it runs; NULL for the CPU chain. options: NULL for the defaults. session: receives the handle, which the
// caller gives back with cophase_session_destroy. Neither device nor model need outlive this call.
//
// COPHASE_DEVICE where the device cannot run the model.
cophase_status cophase_session_create(const struct cophase_device *device,
                                      const struct cophase_model *model,
                                      const struct cophase_session_options *options,
                                      struct cophase_session **session);

// Frees a session; NULL is fine. No other call on it may be running, and none may follow.
void cophase_session_destroy(struct cophase_session *session);

// Makes the fit that is running in another thread, or else the next one, return COPHASE_INTERRUPTED within one
// evaluation of the model. [RT], and the one call that is meant to race; a signal handler may make it.
cophase_status cophase_session_cancel(const struct cophase_session *session);

// Says what the raw values of coming frames mean. The maps are copied. NULL: frames are electrons, as they are until the
// first call.
//
// COPHASE_BAD_VALUE for bad pixels where the model reduces frames to its own sampling, which would smear them: a scene
// with estimate.sampling = "native" does not.
cophase_status cophase_session_calibrate(struct cophase_session *session,
                                         const struct cophase_calibration *calibration);

// Fits the model to frames. [RT]
//
// frames: count x rows x cols, see cophase_model_frame_shape; count up to the session's capacity. Values that are not
//   finite are bad pixels. The optical axis is in row rows/2 and column cols/2.
// options: NULL for the defaults.
// coefficients_nm: receives count x modes numbers in C order; NaN for an image that could not be used.
// reports: receives count reports, each in report_size bytes; NULL if they are not wanted. report_size:
//   sizeof(cophase_report).
//
// The call succeeds where an image does not: what became of each is in its report. COPHASE_INTERRUPTED after
// cophase_session_cancel, and then nothing is written.
cophase_status cophase_session_fit(struct cophase_session *session,
                                   const struct cophase_input *frames,
                                   const struct cophase_fit_options *options,
                                   double *coefficients_nm,
                                   size_t modes,
                                   struct cophase_report *reports,
                                   size_t report_size);

// Why an image of the last fit has the status that it has, in a sentence. `text`, `capacity` and `length` are as in
// cophase_device_list.
//
// COPHASE_BAD_VALUE for an image that was not in that fit.
cophase_status cophase_session_image_message(const struct cophase_session *session,
                                             size_t image,
                                             char *text,
                                             size_t capacity,
                                             size_t *length);

// That the device which "auto" chose was lost, and that the session goes on on the CPU, in a sentence; empty where it was
// not. A device that was named fails with COPHASE_DEVICE instead. `text`, `capacity` and `length` are as in
// cophase_device_list.
cophase_status cophase_session_device_failure(const struct cophase_session *session,
                                              char *text,
                                              size_t capacity,
                                              size_t *length);

// Covariance of the coefficients of an image of the last fit, nm²: as its noise makes it, scaled by its χ² where the
// model misfits. Takes as long as some hundred evaluations.
//
// covariance_nm2: receives modes x modes numbers. COPHASE_BAD_VALUE for an image that was not fitted.
cophase_status cophase_session_covariance_nm2(const struct cophase_session *session,
                                              size_t image,
                                              double *covariance_nm2,
                                              size_t modes);

// Loads frames for cophase_session_evaluate, with the weights that a fit begins with. [RT]
//
// frames, options: as for cophase_session_fit; of the options only read_noise_e counts. COPHASE_BAD_IMAGE where a frame
// holds nothing to fit.
cophase_status cophase_session_load(struct cophase_session *session,
                                    const struct cophase_input *frames,
                                    const struct cophase_fit_options *options);

// The objective and its gradient, for an optimizer of the caller's: Σ weight·(flux·PSF + background − data)² over the
// pixels of each image that was loaded, flux and background being those that minimise it. [RT]
//
// coefficients_nm: count x modes in C order, count being the number of frames that were loaded. objectives: receives
// count numbers. gradients: receives count x modes, per nm. COPHASE_BAD_VALUE before cophase_session_load.
cophase_status cophase_session_evaluate(struct cophase_session *session,
                                        const double *coefficients_nm,
                                        size_t count,
                                        size_t modes,
                                        double *objectives,
                                        double *gradients);

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

// Rows and columns of an image.
cophase_status cophase_simulator_image_shape(const struct cophase_simulator *simulator,
                                             size_t *rows,
                                             size_t *cols);

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
// and after whatever others it is taken. The optical axis is in row rows/2 and column cols/2.
//
// out: 1 x rows x cols, see cophase_simulator_image_shape. COPHASE_BAD_VALUE before the first frame.
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
