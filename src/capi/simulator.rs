//! Simulator of adaptive optics.

use super::handle::{Handle, Object, fence, find, give_back};
use super::model::scene;
use super::pointer::{place, put_array, put_text};
use super::sized::Outputs;
use super::status::cophase_status;
use super::text::COPHASE_TEXT_WARNINGS;
use crate::ao::Stepper;
use crate::machine::start_threads;
use crate::scene::Scene;
use crate::{Error, Result};
use std::ffi::c_char;

/// Array of a simulator: slopes that were measured in the last frame, mas, along x for every
/// subaperture, then along y; slopes.
pub const COPHASE_ARRAY_SLOPES_MAS: i32 = 101;
/// Array of a simulator: commands that were on the mirror in the last frame, nm of wavefront;
/// actuators.
pub const COPHASE_ARRAY_COMMANDS_NM: i32 = 102;
/// Array of a simulator: residual wavefront of the last frame, nm: turbulence and segment errors
/// minus the mirror's surface, NaN where the pupil has no light; residual_samples x
/// residual_samples.
pub const COPHASE_ARRAY_RESIDUAL_NM: i32 = 103;
/// Array of a simulator: the camera's defocused image of the last frame, electrons: residual
/// wavefront frozen, NCPA and diversity, with the noise that the scene names; rows x cols. The same
/// frame always gives the same image. The optical axis is on row rows/2 and column cols/2.
pub const COPHASE_ARRAY_IMAGE_E: i32 = 104;
/// Array of a simulator: true static aberrations, nm, NaN outside the pupil: map 0 the phasing
/// errors of the segments, map 1 the NCPA; 2 x truth_samples x truth_samples.
pub const COPHASE_ARRAY_TRUTH_NM: i32 = 105;

/// Simulator of an AO system: turbulence, wavefront sensor, deformable mirror, control, science
/// camera. The same scene gives the same bits. Calls that take it as const may run in several
/// threads at once, any other only while no other call runs (COPHASE_BUSY otherwise).
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_simulator(Handle<Stepper>);

impl Object for cophase_simulator {
    const KIND: u64 = 5;
}

/// Sizes and state of a simulator.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_simulator_info {
    /// Slopes of the wavefront sensor: two for each subaperture.
    pub slopes: usize,
    /// Actuators of the mirror.
    pub actuators: usize,
    /// Rows, and columns, of the residual wavefront.
    pub residual_samples: usize,
    /// Rows, and columns, of the maps of the true aberrations.
    pub truth_samples: usize,
    /// Rows of an image.
    pub rows: usize,
    /// Columns of an image.
    pub cols: usize,
    /// Frames since the loop was closed.
    pub frames: u64,
    /// Duration of a frame, s.
    pub frame_s: f64,
    /// Time at which the loop diverged, s since it was closed; NaN while it has not.
    pub divergence_s: f64,
    /// RMS over the pupil of the residual wavefront of the last frame, piston removed, nm; NaN
    /// before the first.
    pub residual_rms_nm: f64,
}

/// A call that reads the simulator.
unsafe fn read(simulator: *const cophase_simulator, body: impl FnOnce(&Stepper) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { find(simulator, "simulator") }.map(|simulator| &simulator.0), body)
}

/// A call that changes it.
unsafe fn change(simulator: *mut cophase_simulator, body: impl FnOnce(&mut Stepper) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { find(simulator, "simulator") }.map(|simulator| &simulator.0), body)
}

/// Builds the AO system of a scene, before its first frame; about a second at the size of Keck.
///
/// scene_text: scene as TOML, UTF-8; see cophase_scene_preset. directory: directory of the files
/// that the scene names; NULL for the working directory. simulator: receives the handle.
///
/// COPHASE_BAD_SCENE with line, key, value and what is accepted. COPHASE_BAD_FILE for a file of the
/// scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_create(
    scene_text: *const c_char,
    directory: *const c_char,
    simulator: *mut *mut cophase_simulator,
) -> cophase_status {
    fence(|| {
        let out = place(simulator, "simulator")?;
        start_threads()?;
        let (scene_text, directory) = unsafe { scene(scene_text, directory) }?;
        let scene = Scene::from_text(scene_text, directory)?;
        let made = Box::new(cophase_simulator(Handle::new::<cophase_simulator>(Stepper::new(&scene)?, ())));
        unsafe { out.write(Box::into_raw(made)) };
        Ok(())
    })
}

/// Frees a simulator; NULL is fine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_destroy(simulator: *mut cophase_simulator) {
    unsafe { give_back(simulator) }
}

/// Advances the loop by a number of frames, in this thread. A loop that diverges goes on; see
/// divergence_s.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_step(simulator: *mut cophase_simulator, frames: u64) -> cophase_status {
    unsafe { change(simulator, |stepper| stepper.step(frames)) }
}

/// Writes sizes and state of a simulator. info_size: sizeof(cophase_simulator_info).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_get_info(
    simulator: *const cophase_simulator,
    info: *mut cophase_simulator_info,
    info_size: usize,
) -> cophase_status {
    unsafe {
        read(simulator, |stepper| {
            Outputs::new(place(info, "info")?, info_size, ("info", "info_size"))?.put(0, &state(stepper));
            Ok(())
        })
    }
}

fn state(stepper: &Stepper) -> cophase_simulator_info {
    let simulator = stepper.simulator();
    let (slopes, actuators) = simulator.interaction().dim();
    let (rows, cols) = simulator.scene().image.frame_shape();
    cophase_simulator_info {
        slopes,
        actuators,
        residual_samples: simulator.footprint().samples(),
        truth_samples: simulator.truth().ncpa_nm.nrows(),
        rows,
        cols,
        frames: simulator.frames(),
        frame_s: simulator.frame_s(),
        divergence_s: stepper.divergence().map_or(f64::NAN, |divergence| divergence.time_s),
        residual_rms_nm: stepper.last().map_or(f64::NAN, |last| last.residual_rms_nm),
    }
}

/// Writes an array of a simulator in C order.
///
/// what: COPHASE_ARRAY_SLOPES_MAS to COPHASE_ARRAY_TRUTH_NM, which say shape and unit. out:
///   receives `count` numbers.
///
/// COPHASE_BAD_SHAPE for another count than the shape's; the sentence has the right one.
/// COPHASE_BAD_VALUE before the first frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_array(
    simulator: *mut cophase_simulator,
    what: i32,
    out: *mut f64,
    count: usize,
) -> cophase_status {
    unsafe {
        change(simulator, |stepper| match what {
            COPHASE_ARRAY_SLOPES_MAS => {
                let values = stepper.last()?.slopes_mas;
                put_array(out, count, &[values.len()], values.iter().copied().map(f64::from))
            }
            COPHASE_ARRAY_COMMANDS_NM => {
                let values = stepper.last()?.commands_nm;
                put_array(out, count, &[values.len()], values.iter().copied().map(f64::from))
            }
            COPHASE_ARRAY_RESIDUAL_NM => {
                let map = stepper.residual_nm()?;
                put_array(out, count, map.shape(), map.iter().copied().map(f64::from))
            }
            COPHASE_ARRAY_IMAGE_E => {
                let image = stepper.image_e()?;
                put_array(out, count, image.shape(), image.iter().copied().map(f64::from))
            }
            COPHASE_ARRAY_TRUTH_NM => {
                let truth = stepper.simulator().truth();
                let (rows, cols) = truth.ncpa_nm.dim();
                let values = truth.phasing_nm.iter().chain(&truth.ncpa_nm).copied();
                put_array(out, count, &[2, rows, cols], values)
            }
            other => Err(Error::Value(format!("what is {other}: a COPHASE_ARRAY_ number of simulators is accepted"))),
        })
    }
}

/// Writes a text of a simulator.
///
/// what: COPHASE_TEXT_WARNINGS: a sentence where the images have errors because the simulator's
///   grid is too coarse for them.
/// text, capacity, length: as in cophase_device_list.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_text(
    simulator: *const cophase_simulator,
    what: i32,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe {
        read(simulator, |stepper| match what {
            COPHASE_TEXT_WARNINGS => put_text(text, capacity, length, &stepper.simulator().warnings().join("\n")),
            other => Err(Error::Value(format!(
                "what is {other}: COPHASE_TEXT_WARNINGS ({COPHASE_TEXT_WARNINGS}) is accepted"
            ))),
        })
    }
}
