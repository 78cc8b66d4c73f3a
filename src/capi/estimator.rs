//! Estimators: the full pipeline, from the images of one scene to one estimate.

use super::calibration::{calibration, cophase_calibration, has_gain, read_noise_e};
use super::estimate_handle::{EstimateState, cophase_estimate};
use super::handle::{Handle, Object, fence, find, give_back};
use super::input::{Input, cophase_input};
use super::model::scene;
use super::pointer::{place, put_if_wanted, source, text};
use super::policy::{COPHASE_POLICY_FULL, COPHASE_POLICY_REALTIME};
use super::sized::{self, Options};
use super::status::{COPHASE_OK, cophase_status};
use crate::machine::{check_threads, most_threads, start_threads, thread_pool};
use crate::modal::{Calibration, cut_out_hint};
use crate::pipeline::{Control, Estimate, Estimator, Images, Policy};
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::{Array2, Array3};
use rayon::ThreadPool;
use std::ffi::c_char;

/// Stage of an estimate: none is running.
pub const COPHASE_STAGE_IDLE: i32 = 0;
/// Stage: the planner tries models on simulated images (estimate.budget_nm).
pub const COPHASE_STAGE_PLANNING: i32 = 1;
/// Stage: pupil, modes and metric are built, and optics fitted where the scene asks for it.
pub const COPHASE_STAGE_PREPARING: i32 = 2;
/// Stage: images are fitted.
pub const COPHASE_STAGE_FITTING: i32 = 3;
/// Stage: covariances are computed, and images combined.
pub const COPHASE_STAGE_COMBINING: i32 = 4;
/// Stage: wavefronts are retrieved (MAP).
pub const COPHASE_STAGE_RETRIEVING: i32 = 5;
/// Stage: static errors are separated from the turbulence (MAP).
pub const COPHASE_STAGE_SEPARATING: i32 = 6;

/// Estimator: the full pipeline for images of one scene, modal or maximum a posteriori (MAP,
/// estimate.method = "full-phase") as the scene says. It can be used again and again.
///
/// One call at a time (COPHASE_BUSY otherwise), except cophase_estimator_cancel and
/// cophase_estimator_progress, which any thread may call at any time.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_estimator(Handle<Working, Control>);

impl Object for cophase_estimator {
    const KIND: u64 = 0;
}

/// What a call works on.
struct Working {
    estimator: Estimator,
    /// The threads; `None` for those that all estimators share.
    pool: Option<ThreadPool>,
}

/// Options of an estimator.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_estimator_options {
    /// sizeof(cophase_estimator_options).
    pub struct_size: usize,
    /// COPHASE_POLICY_FULL (0) or COPHASE_POLICY_REALTIME.
    pub policy: i32,
    /// Number of threads, at most 64 or four for each processor; 0 or -1 for one per processor.
    /// Results do not depend on it.
    pub threads: i32,
}

unsafe impl Options for cophase_estimator_options {}

/// Options of one estimate.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_estimate_options {
    /// sizeof(cophase_estimate_options).
    pub struct_size: usize,
    /// Calibration of the frames; NULL: frames are electrons, or counts where the scene has
    /// image.gain_e_per_adu.
    pub calibration: *const cophase_calibration,
    /// Read noise of a pixel, electrons RMS; 0 for the scene's, unless has_read_noise is 1.
    pub read_noise_e: f64,
    /// 1: read_noise_e holds even if it is 0 (no read noise). 0: a read_noise_e of 0 means the
    /// scene's.
    pub has_read_noise: i64,
}

unsafe impl Options for cophase_estimate_options {}

fn policy(number: i32) -> Result<Policy> {
    match number {
        COPHASE_POLICY_FULL => Ok(Policy::default()),
        COPHASE_POLICY_REALTIME => Ok(Policy::realtime()),
        other => Err(Error::Value(format!(
            "options->policy is {other}: COPHASE_POLICY_FULL (0) or COPHASE_POLICY_REALTIME (1) is accepted"
        ))),
    }
}

fn pool(threads: i32) -> Result<Option<ThreadPool>> {
    match usize::try_from(threads) {
        Ok(0) => Ok(None),
        Ok(count) => {
            check_threads("options->threads", count)?;
            thread_pool(count).map(Some)
        }
        Err(_) if threads == -1 => Ok(None),
        Err(_) => {
            let most = most_threads();
            Err(Error::Value(format!("options->threads is {threads}: 1 to {most}, 0 or -1 is accepted")))
        }
    }
}

/// Makes an estimator of a scene.
///
/// scene_text: scene as TOML, UTF-8; see cophase_scene_preset. With estimate.budget_nm the model is
///   planned here, which takes some seconds. Nothing else is built before the first estimate; its
///   model is kept for the next ones, unless a file that the scene names changes.
/// directory: directory of the files that the scene names; NULL for the working directory.
/// options: NULL for the defaults.
/// estimator: receives the handle.
///
/// COPHASE_BAD_SCENE with line, key, value and what is accepted: also for keys that the policy does
/// not honour. COPHASE_BAD_FILE for a file that the scene names and that does not exist.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimator_create(
    scene_text: *const c_char,
    directory: *const c_char,
    options: *const cophase_estimator_options,
    estimator: *mut *mut cophase_estimator,
) -> cophase_status {
    fence(|| {
        let out = place(estimator, "estimator")?;
        let options = unsafe { sized::read(options, "options") }?;
        let (policy, pool) = (policy(options.policy)?, pool(options.threads)?);
        let (scene_text, directory) = unsafe { scene(scene_text, directory) }?;
        let scene = Scene::from_text(scene_text, directory)?;
        let control = Control::default();
        let make = || Estimator::with_policy(&scene, policy, control.clone());
        // Without a plan it only reads: no threads are started, which a child of fork() would lack.
        let estimator = if scene.estimate.budget_nm.is_some() { on_threads(pool.as_ref(), make)? } else { make()? };
        let handle = Handle::new::<cophase_estimator>(Working { estimator, pool }, control);
        unsafe { out.write(Box::into_raw(Box::new(cophase_estimator(handle)))) };
        Ok(())
    })
}

/// Does work on the threads of `pool`, or on those that all share.
fn on_threads<R: Send>(pool: Option<&ThreadPool>, work: impl FnOnce() -> Result<R> + Send) -> Result<R> {
    match pool {
        Some(pool) => pool.install(work),
        None => start_threads().and_then(|()| work()),
    }
}

/// Frees an estimator; NULL is fine. Its estimates stay usable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimator_destroy(estimator: *mut cophase_estimator) {
    unsafe { give_back(estimator) }
}

/// The control of an estimator, during any call on it.
unsafe fn control<'a>(estimator: *const cophase_estimator) -> Result<&'a Control> {
    Ok(&unsafe { find(estimator, "estimator") }?.0.aside)
}

/// Makes the estimate that is running in another thread, or else the next one, return
/// COPHASE_INTERRUPTED at its next safe
/// place: within a second or two at the size of Keck. A signal handler may call it. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimator_cancel(estimator: *const cophase_estimator) -> cophase_status {
    match unsafe { control(estimator) } {
        Ok(control) => {
            control.cancel();
            COPHASE_OK
        }
        Err(error) => fence(|| Err(error)),
    }
}

/// Progress of the estimate that is running in another thread. [RT]
///
/// stage: receives a COPHASE_STAGE_ number. done, total: receive the steps (images) of this stage
/// that are done, and their number, 0 if it is unknown. Each may be NULL.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimator_progress(
    estimator: *const cophase_estimator,
    stage: *mut i32,
    done: *mut u64,
    total: *mut u64,
) -> cophase_status {
    fence(|| unsafe {
        let progress = control(estimator)?.progress();
        put_if_wanted(stage, "stage", progress.stage as i32)?;
        put_if_wanted(done, "done", progress.done)?;
        put_if_wanted(total, "total", progress.total)
    })
}

/// Images of one channel: of the only one of a scene, or of one that it lists ([[image.channel]]).
/// The layout of this struct is permanent.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_channel_images {
    /// Name of the channel, UTF-8; NULL for all: they are in the order of the scene. NULL where the
    /// scene lists no channels.
    pub channel: *const c_char,
    /// Images of the same static errors, count x rows x cols as the channel says. Of frames with
    /// one row or column more the last is left out, which COPHASE_TEXT_REMARKS says; the
    /// calibration then has it, too. Bad pixels, which take no part, are those of the calibration,
    /// values that are not finite, and saturated ones. The optical axis is on row rows/2 and column
    /// cols/2, rounded down.
    pub frames: *const cophase_input,
    /// Its options; NULL for the defaults.
    pub options: *const cophase_estimate_options,
    /// Telemetry of a MAP estimate, 1 x count x slopes: slopes of the wavefront sensor, mean over
    /// each exposure, along x for every subaperture, then along y; NaN for all of an image without
    /// telemetry; NULL without any. Of its exposures, also where the channels are simultaneous.
    /// Slopes are used where every channel has them.
    pub slopes_mas: *const cophase_input,
}

/// Estimates the static wavefront behind images: of one channel, or of several (defocuses,
/// wavelengths). What is wrong with single images is in their reports; what to know of the whole is
/// in COPHASE_TEXT_WARNINGS of the estimate.
///
/// channels: images of each channel of the scene, in any order where they are named. count: number
///   of channels; 1 for a scene that lists none.
/// estimate: receives the handle.
///
/// COPHASE_BAD_SHAPE for images of other channels than the scene has, and for frames or slopes of
/// another shape. COPHASE_BAD_IMAGE if no image can be used (fewer than two in a MAP estimate).
/// COPHASE_BAD_SCENE, COPHASE_BAD_FILE if the telescope cannot be built. COPHASE_DEVICE if the
/// device that the scene names is absent or fails. COPHASE_INTERRUPTED after
/// cophase_estimator_cancel.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimator_estimate(
    estimator: *mut cophase_estimator,
    channels: *const cophase_channel_images,
    count: usize,
    estimate: *mut *mut cophase_estimate,
) -> cophase_status {
    let handle = unsafe { find(estimator, "estimator") }.map(|estimator| &estimator.0);
    Handle::change(handle, |working| {
        let out = place(estimate, "estimate")?;
        let first = source(channels, "channels")?;
        let known = working.estimator.scene().each_channel();
        if count != known.len() {
            let wanted = known.len();
            return Err(Error::Shape(format!(
                "count is {count}: {wanted} is accepted, the number of channels of the scene"
            )));
        }
        let each = (0..count).map(|index| unsafe { images_of_channel(&*first.add(index), index, &known) });
        let each = each.collect::<Result<Vec<_>>>()?;
        let made = on_threads(working.pool.as_ref(), || working.estimator.estimate(&each))?;
        unsafe { out.write(handle_of(made)) };
        Ok(())
    })
}

fn handle_of(estimate: Estimate) -> *mut cophase_estimate {
    Box::into_raw(Box::new(cophase_estimate(Handle::new::<cophase_estimate>(EstimateState::new(estimate), ()))))
}

/// A caller's images of one of the channels `known`, names and scenes: of that with their name or,
/// without one, the channel `index`.
unsafe fn images_of_channel(
    given: &cophase_channel_images,
    index: usize,
    known: &[(Option<&str>, &Scene)],
) -> Result<Images> {
    let name = if given.channel.is_null() { None } else { Some(unsafe { text(given.channel, "channels->channel") }?) };
    let (own_name, own) = match name {
        None => known[index],
        Some(name) => *known.iter().find(|(own, _)| *own == Some(name)).ok_or_else(|| no_channel(name, known))?,
    };
    let images = unsafe { images(given.frames, given.options, own) };
    let images = images.and_then(|images| {
        let slopes_mas = unsafe { slopes(given.slopes_mas, images.len()) }?;
        Ok(Images { slopes_mas, channel: name.map(str::to_owned), ..images })
    });
    images.map_err(|error| match own_name {
        Some(_) => error.of_channel(name.unwrap_or(&index.to_string())),
        None => error,
    })
}

/// Refuses a name that no channel has.
fn no_channel(name: &str, known: &[(Option<&str>, &Scene)]) -> Error {
    let names: Vec<&str> = known.iter().filter_map(|(name, _)| *name).collect();
    let accepted =
        if names.is_empty() { "NULL, because it has no [[image.channel]],".into() } else { names.join(", ") };
    Error::Shape(format!("the channel '{name:.60}' is not in the scene: {accepted} is accepted"))
}

/// A caller's telemetry of `count` exposures, `[image, slope]`, mas; none where it is NULL.
unsafe fn slopes(slopes_mas: *const cophase_input, count: usize) -> Result<Option<Array2<f64>>> {
    if slopes_mas.is_null() {
        return Ok(None);
    }
    let slopes = unsafe { Input::new(slopes_mas, "slopes_mas") }?;
    let [.., slope_count] = slopes.shape();
    slopes.must_be([1, count, slope_count])?.map().map(Some)
}

/// A caller's images of `scene`, without telemetry.
unsafe fn images(
    frames: *const cophase_input,
    options: *const cophase_estimate_options,
    scene: &Scene,
) -> Result<Images> {
    let options = unsafe { sized::read(options, "options") }?;
    let frames = unsafe { Input::new(frames, "frames") }?;
    let shape = taken_shape(&frames, scene.image.fitted_shape());
    let has_gain = unsafe { has_gain(options.calibration) }?;
    // Where the caller gives no gain, the estimate converts with the scene's.
    let calibration = unsafe { calibration(options.calibration, shape, None) }?;
    let images = taken(&frames, &calibration)?;
    let images = if has_gain { images.in_electrons() } else { images };
    let read_noise_e = read_noise_e(options.read_noise_e, options.has_read_noise)?;
    Ok(Images { read_noise_e, ..images })
}

/// Rows and columns of a frame and its calibration: those of the scene or, of odd frames, one more,
/// which the estimate leaves out.
fn taken_shape(frames: &Input, (rows, cols): (usize, usize)) -> (usize, usize) {
    let [_, given_rows, given_cols] = frames.shape();
    let is_taken = |given: usize, wanted: usize| given == wanted || given == wanted + 1;
    if is_taken(given_rows, rows) && is_taken(given_cols, cols) { (given_rows, given_cols) } else { (rows, cols) }
}

/// A caller's frames as electrons.
fn taken(frames: &Input, calibration: &Calibration) -> Result<Images> {
    let (rows, cols) = calibration.shape();
    let [count, ..] = frames.shape();
    let hint = |error| match error {
        Error::Shape(sentence) => {
            let [_, given_rows, given_cols] = frames.shape();
            Error::Shape(sentence + cut_out_hint((given_rows, given_cols), (rows, cols)))
        }
        other => other,
    };
    let mut images_e = frames.must_be([count, rows, cols]).map_err(hint)?.cube()?;
    let mut bad = Array3::from_elem(images_e.dim(), false);
    for ((k, y, x), value) in images_e.indexed_iter_mut() {
        match calibration.electrons(y, x, *value) {
            Some(electrons) => *value = electrons,
            // Its value takes no part. One that is not finite, and that no map marks, stays so,
            // because Images counts those.
            None => bad[[k, y, x]] = value.is_finite() || calibration.is_bad(y, x),
        }
    }
    Ok(Images::with_bad(images_e, bad))
}
