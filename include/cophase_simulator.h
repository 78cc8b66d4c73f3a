/* cophase: simulator of adaptive optics, for tests and demonstrations.
 * Made from src/capi by cbindgen (tests/header.rs); do not edit. The contract is that of cophase.h.
 */

#ifndef COPHASE_SIMULATOR_H
#define COPHASE_SIMULATOR_H

#include "cophase.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Array of a simulator: slopes that were measured in the last frame, mas, along x for every
 * subaperture, then along y; slopes.
 */
#define COPHASE_ARRAY_SLOPES_MAS 101

/* Array of a simulator: commands that were on the mirror in the last frame, nm of wavefront;
 * actuators.
 */
#define COPHASE_ARRAY_COMMANDS_NM 102

/* Array of a simulator: residual wavefront of the last frame, nm: turbulence and segment errors
 * minus the mirror's surface, NaN where the pupil has no light; residual_samples x
 * residual_samples.
 */
#define COPHASE_ARRAY_RESIDUAL_NM 103

/* Array of a simulator: the camera's defocused image of the last frame, electrons: residual
 * wavefront frozen, NCPA and diversity, with the noise that the scene names; rows x cols. The same
 * frame always gives the same image. The optical axis is on row rows/2 and column cols/2.
 */
#define COPHASE_ARRAY_IMAGE_E 104

/* Array of a simulator: true static aberrations, nm, NaN outside the pupil: map 0 the phasing
 * errors of the segments, map 1 the NCPA; 2 x truth_samples x truth_samples.
 */
#define COPHASE_ARRAY_TRUTH_NM 105

/* Simulator of an AO system: turbulence, wavefront sensor, deformable mirror, control, science
 * camera. The same scene gives the same bits. Calls that take it as const may run in several
 * threads at once, any other only while no other call runs (COPHASE_BUSY otherwise).
 */
typedef struct cophase_simulator cophase_simulator;

/* Sizes and state of a simulator. */
typedef struct {
  /* Slopes of the wavefront sensor: two for each subaperture. */
  size_t slopes;
  /* Actuators of the mirror. */
  size_t actuators;
  /* Rows, and columns, of the residual wavefront. */
  size_t residual_samples;
  /* Rows, and columns, of the maps of the true aberrations. */
  size_t truth_samples;
  /* Rows of an image. */
  size_t rows;
  /* Columns of an image. */
  size_t cols;
  /* Frames since the loop was closed. */
  uint64_t frames;
  /* Duration of a frame, s. */
  double frame_s;
  /* Time at which the loop diverged, s since it was closed; NaN while it has not. */
  double divergence_s;
  /* RMS over the pupil of the residual wavefront of the last frame, piston removed, nm; NaN
   * before the first.
   */
  double residual_rms_nm;
} cophase_simulator_info;

/* Builds the AO system of a scene, before its first frame; about a second at the size of Keck.
 *
 * scene_text: scene as TOML, UTF-8; see cophase_scene_preset. directory: directory of the files
 * that the scene names; NULL for the working directory. simulator: receives the handle.
 *
 * COPHASE_BAD_SCENE with line, key, value and what is accepted. COPHASE_BAD_FILE for a file of the
 * scene.
 */
cophase_status cophase_simulator_create(const char *scene_text,
                                        const char *directory,
                                        cophase_simulator **simulator);

/* Frees a simulator; NULL is fine. */
void cophase_simulator_destroy(cophase_simulator *simulator);

/* Advances the loop by a number of frames, in this thread. A loop that diverges goes on; see
 * divergence_s.
 */
cophase_status cophase_simulator_step(cophase_simulator *simulator, uint64_t frames);

/* Writes sizes and state of a simulator. info_size: sizeof(cophase_simulator_info). */
cophase_status cophase_simulator_get_info(const cophase_simulator *simulator,
                                          cophase_simulator_info *info,
                                          size_t info_size);

/* Writes an array of a simulator in C order.
 *
 * what: COPHASE_ARRAY_SLOPES_MAS to COPHASE_ARRAY_TRUTH_NM, which say shape and unit. out:
 *   receives `count` numbers.
 *
 * COPHASE_BAD_SHAPE for another count than the shape's; the sentence has the right one.
 * COPHASE_BAD_VALUE before the first frame.
 */
cophase_status cophase_simulator_array(cophase_simulator *simulator, int32_t what, double *out, size_t count);

/* Writes a text of a simulator.
 *
 * what: COPHASE_TEXT_WARNINGS: a sentence where the images have errors because the simulator's
 *   grid is too coarse for them.
 * text, capacity, length: as in cophase_device_list.
 */
cophase_status cophase_simulator_text(const cophase_simulator *simulator,
                                      int32_t what,
                                      char *text,
                                      size_t capacity,
                                      size_t *length);

#ifdef __cplusplus
} /* extern "C" */
#endif

#endif /* COPHASE_SIMULATOR_H */
