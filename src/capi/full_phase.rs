//! Full-phase estimates: static errors from all exposures of a sequence behind adaptive optics at once.

use super::found::{Found, cophase_full_phase_report};
use super::handle::{Handle, fence, give_back, given_back, null};
use super::input::{Input, cophase_input};
use super::options::{self, cophase_calibration};
use super::pointer::{place, put, put_shape, text};
use super::sized::{self, Options, Reports};
use super::status::{COPHASE_OK, cophase_status};
use crate::estimate::{Calibration, CameraMaps};
use crate::optimize::CancelFlag;
use crate::scene::{Knows, Scene};
use crate::sequence_estimate::{self, SkyImages};
use crate::{Error, Result};
use ndarray::Array3;
use std::ffi::c_char;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// What a full-phase estimate assumes of the adaptive optics: what the scene says (estimate.knows), or else the most that
/// there is.
pub const COPHASE_KNOWS_MOST: i32 = 0;
/// Nothing: the mirror's pitch, and a spectrum of ordinary seeing.
pub const COPHASE_KNOWS_NOTHING: i32 = 1;
/// The spectrum of the residual wavefront, from the scene's turbulence and control.
pub const COPHASE_KNOWS_SPECTRUM: i32 = 2;
/// The loop as well: what it answers to the pistons is found by closing it on them alone.
pub const COPHASE_KNOWS_LOOP: i32 = 3;
/// What its wavefront sensor measured during each exposure as well.
pub const COPHASE_KNOWS_TELEMETRY: i32 = 4;

/// The estimator of `cophase estimate --method full-phase`: the whole wavefront behind each exposure of a sequence, and
/// static errors, pistons of the segments and non-common path aberrations (NCPA), from all of them together.
///
/// Calls that take it as const may run in several threads at once; any other only while no other call runs
/// (COPHASE_BUSY otherwise), but for cophase_full_phase_cancel and cophase_full_phase_progress, which are meant to race.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_full_phase {
    inside: Handle<Working>,
    cancel: CancelFlag,
    retrieved: AtomicU64,
}

/// What a call works on.
pub(super) struct Working {
    scene: Scene,
    calibration: Calibration,
    found: Option<Found>,
}

/// How a full-phase estimate is made.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_full_phase_options {
    /// Filled in by cophase_full_phase_options_init.
    pub struct_size: usize,
    /// What is assumed of the adaptive optics: COPHASE_KNOWS_MOST, or another of the COPHASE_KNOWS_ numbers. Default:
    /// COPHASE_KNOWS_MOST.
    pub knows: i32,
    /// Threads that it runs on; 0 for as many as the machine has processors. Default: 0.
    pub threads: i32,
    /// Read noise of a pixel, RMS electrons; NaN for what the scene says. Default: NaN.
    pub read_noise_e: f64,
}

unsafe impl Options for cophase_full_phase_options {
    fn defaults() -> Self {
        let struct_size = size_of::<Self>();
        Self { struct_size, knows: COPHASE_KNOWS_MOST, threads: 0, read_noise_e: f64::NAN }
    }
}

/// The scene that knows as much as the number says.
fn with_knowledge(scene: &Scene, number: i32) -> Result<Scene> {
    let knows = match number {
        COPHASE_KNOWS_MOST => return Ok(scene.clone()),
        COPHASE_KNOWS_NOTHING => Knows::Nothing,
        COPHASE_KNOWS_SPECTRUM => Knows::Spectrum,
        COPHASE_KNOWS_LOOP => Knows::Loop,
        COPHASE_KNOWS_TELEMETRY => Knows::Telemetry,
        other => {
            return Err(Error::Value(format!(
                "options->knows is {other}: one of the COPHASE_KNOWS_ numbers, 0 to 4, is accepted"
            )));
        }
    };
    scene.with_override("estimate.knows", knows.word())
}

impl Working {
    pub(super) fn found_mut(&mut self) -> Result<&mut Found> {
        self.found.as_mut().ok_or_else(early)
    }

    /// A caller's frames and slopes as the estimator takes them.
    fn taken(&self, frames: &Input, slopes_mas: Option<&Input>, read_noise_e: Option<f64>) -> Result<SkyImages> {
        let (rows, cols) = self.calibration.shape();
        let [count, ..] = frames.shape();
        let mut images_e = frames.must_be([count, rows, cols])?.cube()?;
        let mut bad = Array3::from_elem(images_e.dim(), false);
        for ((k, y, x), value) in images_e.indexed_iter_mut() {
            let electrons = self.calibration.electrons(y, x, *value);
            bad[[k, y, x]] = electrons.is_none();
            *value = electrons.unwrap_or(0.0);
        }
        let slopes_mas = match slopes_mas {
            None => None,
            Some(slopes) => {
                let [.., cols] = slopes.shape();
                Some(slopes.must_be([1, count, cols])?.map()?)
            }
        };
        Ok(SkyImages { images_e, bad, read_noise_e, slopes_mas })
    }
}

/// Does work on a number of threads; 0 for those that all estimates share, one for each processor.
fn on_threads<R: Send>(threads: i32, work: impl FnOnce() -> R + Send) -> Result<R> {
    let Ok(threads) = usize::try_from(threads) else {
        return Err(Error::Value(format!("options->threads is {threads}: 0 or more is accepted")));
    };
    if threads == 0 {
        return Ok(work());
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool =
        pool.map_err(|error| Error::Value(format!("options->threads is {threads}: they do not start: {error}")))?;
    Ok(pool.install(work))
}

fn early() -> Error {
    Error::Value("there is no estimate yet: cophase_full_phase_estimate comes first".into())
}

/// A call that reads the estimator.
unsafe fn read(full_phase: *const cophase_full_phase, body: impl FnOnce(&Working) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { full_phase.as_ref() }.map(|full_phase| &full_phase.inside), "full_phase", body)
}

/// A call that reads its last estimate.
pub(super) unsafe fn look(
    full_phase: *const cophase_full_phase,
    body: impl FnOnce(&Found) -> Result<()>,
) -> cophase_status {
    unsafe { read(full_phase, |working| body(working.found.as_ref().ok_or_else(early)?)) }
}

/// A call that changes the estimator.
pub(super) unsafe fn change(
    full_phase: *mut cophase_full_phase,
    body: impl FnOnce(&mut Working) -> Result<()>,
) -> cophase_status {
    Handle::change(unsafe { full_phase.as_ref() }.map(|full_phase| &full_phase.inside), "full_phase", body)
}

/// Fills in `struct_size` and the defaults. struct_size: sizeof(cophase_full_phase_options).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_options_init(
    options: *mut cophase_full_phase_options,
    struct_size: usize,
) -> cophase_status {
    fence(|| unsafe { sized::init(options, "options", struct_size) })
}

/// Makes a full-phase estimator of a scene, which its estimate.method need not name. Nothing is built yet.
///
/// scene_text: a scene as TOML, in UTF-8; it is copied. With [wavefront_sensor] and [control] it describes the loop in front
///   of the camera.
/// directory: where the files are looked for that the scene names; NULL for the working directory.
/// full_phase: receives the handle, which the caller gives back with cophase_full_phase_destroy.
///
/// COPHASE_BAD_SCENE with the line, the key, its value and what is accepted: also for keys that are for static modes alone,
/// such as estimate.optimizer.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_create(
    scene_text: *const c_char,
    directory: *const c_char,
    full_phase: *mut *mut cophase_full_phase,
) -> cophase_status {
    fence(|| {
        let out = place(full_phase, "full_phase")?;
        let scene_text = unsafe { text(scene_text, "scene_text") }?;
        let directory = if directory.is_null() { "" } else { unsafe { text(directory, "directory") }? };
        let scene = Scene::from_text(scene_text, Path::new(directory))?;
        let scene = scene.with_override("estimate.method", "full-phase")?;
        let calibration = Calibration::new(scene.image.frame_shape(), CameraMaps::default(), 1.0, f64::INFINITY)?;
        let inside = Handle::new(Working { scene, calibration, found: None });
        let made = cophase_full_phase { inside, cancel: CancelFlag::default(), retrieved: AtomicU64::new(0) };
        unsafe { out.write(Box::into_raw(Box::new(made))) };
        Ok(())
    })
}

/// Frees a full-phase estimator; NULL is fine. No other call on it may be running, and none may follow.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_destroy(full_phase: *mut cophase_full_phase) {
    unsafe { give_back(full_phase, |full_phase| &full_phase.inside) }
}

/// Rows and columns of a detector frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_frame_shape(
    full_phase: *const cophase_full_phase,
    rows: *mut usize,
    cols: *mut usize,
) -> cophase_status {
    unsafe { read(full_phase, |working| put_shape(rows, cols, working.scene.image.frame_shape())) }
}

/// Says what the raw values of coming frames mean. The maps are copied. NULL: frames are electrons, as they are until the
/// first call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_calibrate(
    full_phase: *mut cophase_full_phase,
    calibration: *const cophase_calibration,
) -> cophase_status {
    unsafe {
        change(full_phase, |working| {
            working.calibration = options::calibration(calibration, working.calibration.shape())?;
            Ok(())
        })
    }
}

/// Reads a sequence. 75 exposures of Keck take some ten seconds on two.
///
/// frames: count x rows x cols, see cophase_full_phase_frame_shape; 2 or more exposures of the same static errors. Values
///   that are not finite are bad pixels. The optical axis is in row rows/2 and column cols/2.
/// slopes_mas: telemetry, 1 x count x slopes: what the wavefront sensor measured meanwhile, mean over each exposure, along x
///   for every subaperture, then along y; NULL without.
/// options: NULL for the defaults.
/// report: NULL if it is not wanted; report_size: sizeof(cophase_full_phase_report). All else that was found is asked for
///   by the calls below.
///
/// COPHASE_BAD_SCENE where more is to be known than there is, such as the loop in a scene without one; COPHASE_BAD_SHAPE
/// for frames or slopes of another shape; COPHASE_BAD_IMAGE where fewer than two images can be used; COPHASE_INTERRUPTED
/// after cophase_full_phase_cancel. A call that fails leaves the estimate before it as it was.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_estimate(
    full_phase: *mut cophase_full_phase,
    frames: *const cophase_input,
    slopes_mas: *const cophase_input,
    options: *const cophase_full_phase_options,
    report: *mut cophase_full_phase_report,
    report_size: usize,
) -> cophase_status {
    let Some(full_phase) = (unsafe { full_phase.as_ref() }) else { return fence(|| Err(null("full_phase"))) };
    Handle::change(Some(&full_phase.inside), "full_phase", |working| {
        let frames = unsafe { Input::of(frames, "frames") }?;
        let slopes_mas =
            if slopes_mas.is_null() { None } else { Some(unsafe { Input::of(slopes_mas, "slopes_mas") }?) };
        let options = unsafe { sized::read(options, "options") }?;
        let report = Reports::at(report, report_size)?;
        let scene = with_knowledge(&working.scene, options.knows)?;
        let images = working.taken(&frames, slopes_mas.as_ref(), options::read_noise_e(options.read_noise_e)?)?;
        full_phase.retrieved.store(0, Ordering::Relaxed);
        let watch = |_| {
            full_phase.retrieved.fetch_add(1, Ordering::Relaxed);
        };
        let found =
            on_threads(options.threads, || sequence_estimate::read(&scene, &images, Some(&full_phase.cancel), &watch))?;
        if let Err(Error::Interrupted(_)) = found {
            full_phase.cancel.store(false, Ordering::Relaxed);
        }
        let found = Found::new(found?)?;
        unsafe { report.put(0, &found.report()?) };
        working.found = Some(found);
        Ok(())
    })
}

/// Makes the estimate that is running in another thread, or else the next one, return COPHASE_INTERRUPTED, before the next
/// image or the next pass: within a second or two at the size of Keck. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_cancel(full_phase: *const cophase_full_phase) -> cophase_status {
    match unsafe { full_phase.as_ref() } {
        Some(full_phase) if !full_phase.inside.is_alive() => fence(|| Err(given_back())),
        Some(full_phase) => {
            full_phase.cancel.store(true, Ordering::Relaxed);
            COPHASE_OK
        }
        None => fence(|| Err(null("full_phase"))),
    }
}

/// Wavefronts that the estimate running in another thread, or else the last one, has retrieved so far, in all passes
/// together; each pass has one for each image. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_progress(
    full_phase: *const cophase_full_phase,
    retrieved: *mut u64,
) -> cophase_status {
    match unsafe { full_phase.as_ref() } {
        Some(full_phase) if !full_phase.inside.is_alive() => fence(|| Err(given_back())),
        Some(full_phase) => {
            fence(|| unsafe { put(retrieved, "retrieved", full_phase.retrieved.load(Ordering::Relaxed)) })
        }
        None => fence(|| Err(null("full_phase"))),
    }
}
