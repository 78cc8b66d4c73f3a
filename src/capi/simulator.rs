//! The simulator of adaptive optics.

use super::array::{Output, cophase_array_f32};
use super::handle::{Handle, fence, give_back};
use super::pointer::{place, put, put_all, put_shape, text};
use super::status::cophase_status;
use crate::Result;
use crate::ao::Stepper;
use crate::scene::Scene;
use std::ffi::c_char;
use std::path::Path;

/// A simulated AO system under a sky: turbulence, wavefront sensor, deformable mirror, control, science camera.
///
/// Calls that take it as const may run in several threads at once; any other only while no other call runs
/// (COPHASE_BUSY otherwise). The same scene gives the same bits, in every language.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_simulator(Handle<Stepper>);

/// A call that reads the simulator.
unsafe fn read(simulator: *const cophase_simulator, body: impl FnOnce(&Stepper) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { simulator.as_ref() }.map(|simulator| &simulator.0), "simulator", body)
}

/// A call that changes it.
unsafe fn change(simulator: *mut cophase_simulator, body: impl FnOnce(&mut Stepper) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { simulator.as_ref() }.map(|simulator| &simulator.0), "simulator", body)
}

/// Builds the AO system that a scene describes, ready for its first frame. This takes about a second at the size of Keck.
///
/// scene_text: a scene as TOML, in UTF-8; it is copied. cophase_scene_preset has some, `cophase scene --reference` lists
///   the keys.
/// directory: where the files are looked for that the scene names; NULL for the working directory.
/// simulator: receives the handle, which the caller gives back with cophase_simulator_destroy.
///
/// COPHASE_BAD_SCENE with the line, the key, its value and what is accepted; COPHASE_BAD_FILE for a file of the scene's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_create(
    scene_text: *const c_char,
    directory: *const c_char,
    simulator: *mut *mut cophase_simulator,
) -> cophase_status {
    fence(|| {
        let out = place(simulator, "simulator")?;
        let scene_text = unsafe { text(scene_text, "scene_text") }?;
        let directory = if directory.is_null() { "" } else { unsafe { text(directory, "directory") }? };
        let scene = Scene::from_text(scene_text, Path::new(directory))?;
        let made = Box::new(cophase_simulator(Handle::new(Stepper::new(&scene)?)));
        unsafe { out.write(Box::into_raw(made)) };
        Ok(())
    })
}

/// Frees a simulator; NULL is fine. No other call on it may be running, and none may follow.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_destroy(simulator: *mut cophase_simulator) {
    unsafe { give_back(simulator, |simulator| &simulator.0) }
}

/// Advances the loop by a number of frames, in this thread.
///
/// A loop that diverges is no failure, and goes on: cophase_simulator_divergence_s tells.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_step(simulator: *mut cophase_simulator, frames: u64) -> cophase_status {
    unsafe { change(simulator, |stepper| stepper.step(frames)) }
}

/// Frames since the loop was closed.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_frames(
    simulator: *const cophase_simulator,
    frames: *mut u64,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(frames, "frames", stepper.simulator().frames())) }
}

/// Duration of a frame, s.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_frame_s(
    simulator: *const cophase_simulator,
    frame_s: *mut f64,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(frame_s, "frame_s", stepper.simulator().frame_s())) }
}

/// Time at which the loop was seen to diverge, s since it was closed; NaN while it has not.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_divergence_s(
    simulator: *const cophase_simulator,
    divergence_s: *mut f64,
) -> cophase_status {
    unsafe {
        read(simulator, |stepper| {
            put(divergence_s, "divergence_s", stepper.divergence().map_or(f64::NAN, |divergence| divergence.time_s))
        })
    }
}

/// Number of slopes that the wavefront sensor measures: two for each subaperture.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_slope_count(
    simulator: *const cophase_simulator,
    slopes: *mut usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(slopes, "slopes", stepper.simulator().interaction().nrows())) }
}

/// Number of the mirror's actuators.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_actuator_count(
    simulator: *const cophase_simulator,
    actuators: *mut usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(actuators, "actuators", stepper.simulator().interaction().ncols())) }
}

/// Rows, and columns, of a residual wavefront.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_residual_samples(
    simulator: *const cophase_simulator,
    samples: *mut usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(samples, "samples", stepper.simulator().footprint().samples())) }
}

/// Rows and columns of an image.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_image_shape(
    simulator: *const cophase_simulator,
    rows: *mut usize,
    cols: *mut usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put_shape(rows, cols, stepper.simulator().scene().image.frame_shape())) }
}

/// Rows, and columns, of the maps of the true aberrations: the scene's pupil.samples.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_truth_samples(
    simulator: *const cophase_simulator,
    samples: *mut usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(samples, "samples", stepper.simulator().truth().ncpa_nm.nrows())) }
}

/// The slopes that were measured in the last frame, mas: along x for every subaperture, then along y.
///
/// values: room for `count` elements; count: cophase_simulator_slope_count. COPHASE_BAD_VALUE before the first frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_slopes_mas(
    simulator: *const cophase_simulator,
    values: *mut f32,
    count: usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put_all(values, count, stepper.last()?.slopes_mas)) }
}

/// The commands that were on the mirror in the last frame, nm of wavefront.
///
/// values: room for `count` elements; count: cophase_simulator_actuator_count. COPHASE_BAD_VALUE before the first frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_commands_nm(
    simulator: *const cophase_simulator,
    values: *mut f32,
    count: usize,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put_all(values, count, stepper.last()?.commands_nm)) }
}

/// The residual wavefront of the last frame, nm: turbulence and segments' errors less the mirror's surface. NaN where
/// the pupil has no light.
///
/// out: 1 x samples x samples, see cophase_simulator_residual_samples. COPHASE_BAD_VALUE before the first frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_residual_nm(
    simulator: *const cophase_simulator,
    out: *const cophase_array_f32,
) -> cophase_status {
    unsafe {
        read(simulator, |stepper| {
            let map = stepper.residual_nm()?;
            Output::of(out, "out", [1, map.nrows(), map.ncols()])?.fill(|_, y, x| map[[y, x]]);
            Ok(())
        })
    }
}

/// RMS of that wavefront over the pupil (each sample weighed by its lit area, piston removed), nm.
///
/// COPHASE_BAD_VALUE before the first frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_residual_rms_nm(
    simulator: *const cophase_simulator,
    residual_rms_nm: *mut f64,
) -> cophase_status {
    unsafe { read(simulator, |stepper| put(residual_rms_nm, "residual_rms_nm", stepper.last()?.residual_rms_nm)) }
}

/// The camera's defocused image of the last frame, electrons, its turbulence frozen: residual wavefront, non-common path
/// aberrations and diversity, with the noise that the scene names. The same frame gives the same image, however often
/// and after whatever others it is taken. The optical axis is in row rows/2 and column cols/2.
///
/// out: 1 x rows x cols, see cophase_simulator_image_shape. COPHASE_BAD_VALUE before the first frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_image_e(
    simulator: *mut cophase_simulator,
    out: *const cophase_array_f32,
) -> cophase_status {
    unsafe {
        change(simulator, |stepper| {
            let (rows, cols) = stepper.simulator().scene().image.frame_shape();
            let output = Output::of(out, "out", [1, rows, cols])?;
            let image = stepper.image_e()?;
            output.fill(|_, y, x| image[[y, x]]);
            Ok(())
        })
    }
}

/// The true static aberrations, nm: map 0 the phasing errors of the segments, map 1 the non-common path aberrations. NaN
/// outside the pupil.
///
/// out: 2 x samples x samples, see cophase_simulator_truth_samples.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_simulator_truth_nm(
    simulator: *const cophase_simulator,
    out: *const cophase_array_f32,
) -> cophase_status {
    unsafe {
        read(simulator, |stepper| {
            let truth = stepper.simulator().truth();
            let (rows, cols) = truth.ncpa_nm.dim();
            let maps = [&truth.phasing_nm, &truth.ncpa_nm];
            Output::of(out, "out", [2, rows, cols])?.fill(|k, y, x| maps[k][[y, x]] as f32);
            Ok(())
        })
    }
}
