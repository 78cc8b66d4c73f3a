//! Models: telescope, modes, diversity and camera of a scene, to fit with.

use super::handle::{Handle, Object, fence, find, give_back};
use super::input::{Input, cophase_input};
use super::pointer::{numbers, place, put, put_array, put_if_wanted, text};
use super::sized::{self, Options, Outputs};
use super::status::cophase_status;
use crate::control::Control;
use crate::machine::start_threads;
use crate::modal::{Arrays, ChannelFitters, ModalFitter};
use crate::modes::Group;
use crate::scene::Scene;
use crate::{Error, Result, planner};
use ndarray::{Array2, ArrayView1};
use std::ffi::{CString, c_char};
use std::path::Path;
use std::sync::Arc;

/// Model of the images of a wavefront: telescope, modes, and of each channel ([[image.channel]])
/// diversity and camera; a scene that lists no channels has one. Immutable: any number of threads
/// may use it.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_model(Handle<Named>);

impl Object for cophase_model {
    const KIND: u64 = 2;
}

/// The model, with the names of its modes and its channels as C has them.
struct Named {
    fitters: ChannelFitters,
    modes: Vec<CString>,
    channels: Vec<CString>,
}

/// Telescope of the caller's, as maps of n x n samples, n even, over the scene's pupil.grid_m. A
/// pupil of at least twice pupil.samples is averaged onto that grid, which modes then have.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_model_arrays {
    /// sizeof(cophase_model_arrays).
    pub struct_size: usize,
    /// 1 x n x n: amplitude of the pupil, 0 to 1. Required.
    pub pupil: cophase_input,
    /// 1 x n x n: label of each sample's segment, whole numbers from 0 or 1, with gaps or without;
    /// negative, or 0 where they begin at 1, outside all segments. Segments are counted by
    /// ascending label. Data NULL: not segmented.
    pub segments: cophase_input,
    /// modes x n x n: wavefront of each NCPA mode, nm per nm of its coefficient. Data NULL: the
    /// scene's modes.
    pub modes: cophase_input,
    /// 1 x n x n: diversity, nm of wavefront. Data NULL: the scene's.
    pub diversity_nm: cophase_input,
}

unsafe impl Options for cophase_model_arrays {}

/// Sizes of a model.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_model_info {
    /// Number of modes, which is the number of coefficients of an image.
    pub modes: usize,
    /// Number of modes that move segments; they come first, the others are NCPA modes.
    pub segment_modes: usize,
    /// Rows of a frame; of several channels, those of the first.
    pub rows: usize,
    /// Columns of a frame; of several channels, those of the first.
    pub cols: usize,
    /// Rows, and columns, of a wavefront map.
    pub samples: usize,
    /// Rows, and columns, of a PSF: the pixels that are compared, after a frame is cut and reduced
    /// to the model's sampling; of several channels, those of the first.
    pub pixels: usize,
    /// Number of channels, which have the same modes; 1 for a scene that lists none.
    pub channels: usize,
}

impl Named {
    fn new(fitters: ChannelFitters) -> Result<Self> {
        let name = |name: &str| {
            CString::new(name).map_err(|error| Error::Internal(format!("a name of the model holds a zero: {error}")))
        };
        let modes = fitters.first().model().basis.names().iter().map(|mode| name(mode)).collect::<Result<_>>()?;
        let channels = fitters.iter().map(|(channel, _)| name(channel)).collect::<Result<_>>()?;
        Ok(Self { fitters, modes, channels })
    }

    fn info(&self) -> cophase_model_info {
        let model = self.fitters.first().model();
        let [cols, rows] = model.preparation.frame;
        cophase_model_info {
            modes: self.modes.len(),
            segment_modes: model.segment_modes,
            rows,
            cols,
            samples: model.telescope.pupil.grid.samples(),
            pixels: model.preparation.pixels,
            channels: self.channels.len(),
        }
    }

    /// The coefficients at `pointer`, of which there must be `modes`.
    unsafe fn coefficients<'a>(&self, pointer: *const f64, modes: usize) -> Result<&'a [f64]> {
        check_modes(modes, self.modes.len())?;
        unsafe { numbers(pointer, modes, "coefficients_nm") }
    }
}

/// A new handle of a model.
fn handle_of(fitters: ChannelFitters) -> Result<*mut cophase_model> {
    Ok(Box::into_raw(Box::new(cophase_model(Handle::new::<cophase_model>(Named::new(fitters)?, ())))))
}

/// Refuses arrays that were made for another number of modes.
pub(super) fn check_modes(given: usize, modes: usize) -> Result<()> {
    if given != modes {
        return Err(Error::Shape(format!("modes is {given}: {modes} is accepted, the number of the model's modes")));
    }
    Ok(())
}

/// The fitters behind a handle.
pub(super) unsafe fn fitters(model: *const cophase_model) -> Result<ChannelFitters> {
    unsafe { find(model, "model") }?.0.look(|model| model.fitters.clone())
}

/// A call that reads the model.
unsafe fn read(model: *const cophase_model, body: impl FnOnce(&Named) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { find(model, "model") }.map(|model| &model.0), body)
}

/// Text of a caller's scene, and the directory of its files.
pub(super) unsafe fn scene<'a>(scene_text: *const c_char, directory: *const c_char) -> Result<(&'a str, &'a Path)> {
    let scene_text = unsafe { text(scene_text, "scene_text") }?;
    let directory = if directory.is_null() { "" } else { unsafe { text(directory, "directory") }? };
    Ok((scene_text, Path::new(directory)))
}

/// Builds the model of a scene; about half a second for each channel at the size of Keck.
///
/// scene_text: scene as TOML, UTF-8; see cophase_scene_preset. With estimate.budget_nm, the model
///   is planned first, which takes some seconds.
/// directory: directory of the files that the scene names; NULL for the working directory.
/// arrays: telescope of the caller's instead of that of a scene with one channel; NULL for the
///   scene's. The arrays are copied. They have the effect of the same maps in the files pupil.file,
///   modes.file and image.diversity_file; the rest is the scene's. Segment pistons (modes.segment)
///   come before the modes of the arrays, and Zernikes to Noll 21 follow them unless
///   modes.exact_zernikes says otherwise.
/// model: receives the handle.
///
/// COPHASE_BAD_SCENE with line, key, value and what is accepted: also for estimate.method =
/// "full-phase" and estimate.fit_optics, which only an estimator honours. COPHASE_BAD_FILE for a
/// file of the scene. COPHASE_BAD_SHAPE, COPHASE_BAD_VALUE for arrays that do not fit one another
/// or are no pupil or modes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_create(
    scene_text: *const c_char,
    directory: *const c_char,
    arrays: *const cophase_model_arrays,
    model: *mut *mut cophase_model,
) -> cophase_status {
    fence(|| {
        let out = place(model, "model")?;
        start_threads()?;
        let (scene_text, directory) = unsafe { scene(scene_text, directory) }?;
        let fitters = if arrays.is_null() {
            let scene = Scene::from_text(scene_text, directory)?;
            // Bad pixels are known frame by frame only: a scene for a camera that has some sets
            // estimate.sampling.
            let resolved = planner::resolve(&scene, &Control::default())?;
            ChannelFitters::new(&resolved, false)?
        } else {
            let scene = Scene::for_arrays(scene_text, directory)?;
            let arrays = unsafe { sized::read(arrays, "arrays") }?;
            Arc::new(ModalFitter::from_arrays(&scene, &unsafe { copied(&arrays) }?)?).into()
        };
        unsafe { out.write(handle_of(fitters)?) };
        Ok(())
    })
}

/// A caller's arrays as the estimator takes them.
unsafe fn copied(arrays: &cophase_model_arrays) -> Result<Arrays> {
    let pupil = unsafe { Input::new(&arrays.pupil, "arrays->pupil") }?;
    let [_, rows, cols] = pupil.shape();
    let amplitude = pupil.must_be([1, rows, cols])?.map()?;
    let map = |array: &cophase_input, name: &'static str| -> Result<Option<Array2<f64>>> {
        let Some(input) = (unsafe { Input::optional(array, name) })? else { return Ok(None) };
        input.must_be([1, rows, cols])?.map().map(Some)
    };
    let segments = map(&arrays.segments, "arrays->segments")?;
    if let Some(label) = segments.iter().flatten().find(|label| label.fract() != 0.0 || label.abs() > 1e9) {
        return Err(Error::Value(format!("a label of arrays->segments is {label}: whole numbers are accepted")));
    }
    let modes = unsafe { Input::optional(&arrays.modes, "arrays->modes") }?;
    Ok(Arrays {
        amplitude,
        segments: segments.map(|labels| labels.mapv(|label| label as i32)),
        modes: match modes {
            Some(modes) => Some(modes.must_be([modes.shape()[0], rows, cols])?.cube()?),
            None => None,
        },
        diversity_nm: map(&arrays.diversity_nm, "arrays->diversity_nm")?,
    })
}

/// Frees a model; NULL is fine. Its sessions and sequences stay usable.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_destroy(model: *mut cophase_model) {
    unsafe { give_back(model) }
}

/// Writes the sizes of a model. info_size: sizeof(cophase_model_info).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_get_info(
    model: *const cophase_model,
    info: *mut cophase_model_info,
    info_size: usize,
) -> cophase_status {
    unsafe {
        read(model, |model| {
            Outputs::new(place(info, "info")?, info_size, ("info", "info_size"))?.put(0, &model.info());
            Ok(())
        })
    }
}

/// Model of one of the channels of a model, in the order of the scene.
///
/// channel: number of the channel, from 0.
/// name: receives its name, a text that lives as long as `model`, empty for a scene that lists no
///   channels; NULL if it is not wanted.
/// channel_model: receives a handle, which the caller destroys; NULL if it is not wanted.
///
/// COPHASE_BAD_VALUE for a channel that the model does not have.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_channel(
    model: *const cophase_model,
    channel: usize,
    name: *mut *const c_char,
    channel_model: *mut *mut cophase_model,
) -> cophase_status {
    unsafe {
        read(model, |model| {
            let of_channel = model.fitters.of_channel(channel)?;
            if !name.is_null() {
                place(name, "name")?;
            }
            if !channel_model.is_null() {
                place(channel_model, "channel_model")?.write(handle_of(of_channel)?);
            }
            put_if_wanted(name, "name", model.channels[channel].as_ptr())
        })
    }
}

/// Name of mode `mode`, from 0, in `*name`: a text that lives as long as the model.
/// COPHASE_BAD_VALUE for no such mode.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_mode_name(
    model: *const cophase_model,
    mode: usize,
    name: *mut *const c_char,
) -> cophase_status {
    unsafe {
        read(model, |model| {
            let found = model.modes.get(mode).ok_or_else(|| {
                Error::Value(format!("mode is {mode}: 0 to {} is accepted", model.modes.len().saturating_sub(1)))
            })?;
            put(name, "name", found.as_ptr())
        })
    }
}

/// Wavefront of some coefficients, nm; NaN outside the pupil.
///
/// coefficients_nm: `modes` numbers. out: receives 2 x samples x samples numbers: map 0 the
///   segments, map 1 the NCPA.
/// count: their number.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_wavefront_nm(
    model: *const cophase_model,
    coefficients_nm: *const f64,
    modes: usize,
    out: *mut f64,
    count: usize,
) -> cophase_status {
    unsafe {
        read(model, |named| {
            let coefficients_nm = named.coefficients(coefficients_nm, modes)?;
            let model = named.fitters.first().model();
            let samples = model.telescope.pupil.grid.samples();
            let maps = [Group::Segment, Group::Ncpa].map(|group| model.map_nm(coefficients_nm, group));
            put_array(out, count, &[2, samples, samples], maps.into_iter().flatten())
        })
    }
}

/// PSF of some coefficients with the diversity of a model with one channel, at the pixels that are
/// compared. Its sum over an unbounded detector would be 1. The optical axis is on row and column
/// pixels/2.
///
/// coefficients_nm: `modes` numbers. out: receives pixels x pixels numbers. count: their number.
///
/// COPHASE_BAD_VALUE for a model of several channels: see cophase_model_channel.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_psf(
    model: *const cophase_model,
    coefficients_nm: *const f64,
    modes: usize,
    out: *mut f64,
    count: usize,
) -> cophase_status {
    unsafe {
        read(model, |named| {
            let coefficients_nm = named.coefficients(coefficients_nm, modes)?;
            let fitter = named.fitters.only("cophase_model_psf")?;
            let pixels = fitter.model().preparation.pixels;
            let psf = fitter.reference_chain().psf(ArrayView1::from(coefficients_nm));
            put_array(out, count, &[pixels, pixels], psf)
        })
    }
}
