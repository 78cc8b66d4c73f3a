//! Models: what images are compared with.

use super::array::{Output, cophase_array_f32};
use super::handle::{Handle, fence, give_back};
use super::input::{Input, cophase_input};
use super::pointer::{numbers, place, put, put_shape, text};
use super::sized::{self, Options};
use super::status::cophase_status;
use crate::estimate::{Arrays, Estimator};
use crate::modes::Group;
use crate::planner;
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1};
use std::ffi::{CString, c_char};
use std::path::Path;
use std::sync::Arc;

/// What images are compared with: a telescope, its modes and their names, the diversity, the camera. Immutable: any
/// thread may use it at any time.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_model(Handle<Named>);

/// The model, with the names of its modes as C has them.
struct Named {
    estimator: Arc<Estimator>,
    names: Vec<CString>,
}

impl Named {
    fn new(estimator: Estimator) -> Result<Self> {
        let name = |name: &String| {
            CString::new(name.as_str()).map_err(|error| Error::Internal(format!("a mode's name holds a zero: {error}")))
        };
        let names = estimator.model().basis.names().iter().map(name).collect::<Result<_>>()?;
        Ok(Self { estimator: Arc::new(estimator), names })
    }

    /// The coefficients at `pointer`, of which there must be `modes`.
    unsafe fn coefficients<'a>(&self, pointer: *const f64, modes: usize) -> Result<&'a [f64]> {
        check_modes(modes, self.names.len())?;
        unsafe { numbers(pointer, modes, "coefficients_nm") }
    }
}

/// Refuses arrays that were made for another number of modes.
pub(super) fn check_modes(given: usize, modes: usize) -> Result<()> {
    if given != modes {
        return Err(Error::Shape(format!("modes is {given}: {modes} is accepted, the number of the model's modes")));
    }
    Ok(())
}

/// The estimator behind a handle.
pub(super) unsafe fn estimator(model: *const cophase_model) -> Result<Arc<Estimator>> {
    let model = unsafe { model.as_ref() }.ok_or_else(|| super::handle::null("model"))?;
    model.0.look(|model| model.estimator.clone())
}

/// A call that reads the model.
unsafe fn read(model: *const cophase_model, body: impl FnOnce(&Named) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { model.as_ref() }.map(|model| &model.0), "model", body)
}

/// A caller's text of a scene, and where its files are.
unsafe fn scene<'a>(scene_text: *const c_char, directory: *const c_char) -> Result<(&'a str, &'a Path)> {
    let scene_text = unsafe { text(scene_text, "scene_text") }?;
    let directory = if directory.is_null() { "" } else { unsafe { text(directory, "directory") }? };
    Ok((scene_text, Path::new(directory)))
}

fn hand_out(estimator: Estimator, out: *mut *mut cophase_model) -> Result<()> {
    let made = Box::new(cophase_model(Handle::new(Named::new(estimator)?)));
    unsafe { out.write(Box::into_raw(made)) };
    Ok(())
}

/// Builds the model that a scene describes. This takes about half a second at the size of Keck.
///
/// scene_text: a scene as TOML, in UTF-8; it is copied. cophase_scene_preset has some, `cophase scene --reference` lists
///   the keys.
/// directory: where the files are looked for that the scene names; NULL for the working directory.
/// model: receives the handle, which the caller gives back with cophase_model_destroy.
///
/// Where the scene has estimate.budget_nm the model is planned, the cheapest whose error stays within it, which takes
/// some seconds more.
///
/// COPHASE_BAD_SCENE with the line, the key, its value and what is accepted; COPHASE_BAD_FILE for a file of the scene's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_create(
    scene_text: *const c_char,
    directory: *const c_char,
    model: *mut *mut cophase_model,
) -> cophase_status {
    fence(|| {
        let out = place(model, "model")?;
        let (scene_text, directory) = unsafe { scene(scene_text, directory) }?;
        let scene = planner::resolved(&Scene::from_text(scene_text, directory)?, None)?;
        // Bad pixels are known frame by frame only: who has them says so in the scene (estimate.sampling).
        hand_out(Estimator::new(&scene, false)?, out)
    })
}

/// A telescope, its modes and its diversity as maps of the caller's; see cophase_model_create_from_arrays.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_model_arrays {
    /// Filled in by cophase_model_arrays_init.
    pub struct_size: usize,
    /// 1 x n x n, n even: the amplitude of the pupil, 0 to 1, over the scene's pupil.grid_m. Needed.
    pub pupil: cophase_input,
    /// 1 x n x n: the segment that each sample belongs to, from 0, negative where there is no glass. Data NULL: the
    /// mirror is not segmented.
    pub segments: cophase_input,
    /// modes x n x n: wavefront of each mode, nm per nm of its coefficient. Data NULL: those of the scene.
    pub modes: cophase_input,
    /// 1 x n x n: the diversity, nm of wavefront. Data NULL: that of the scene.
    pub diversity_nm: cophase_input,
}

unsafe impl Options for cophase_model_arrays {
    fn defaults() -> Self {
        let none = cophase_input::NONE;
        Self { struct_size: size_of::<Self>(), pupil: none, segments: none, modes: none, diversity_nm: none }
    }
}

/// Fills in `struct_size`, and no arrays. struct_size: sizeof(cophase_model_arrays).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_arrays_init(
    arrays: *mut cophase_model_arrays,
    struct_size: usize,
) -> cophase_status {
    fence(|| unsafe { sized::init(arrays, "arrays", struct_size) })
}

/// As cophase_model_create, with pupil, modes and diversity of the caller's in place of the scene's. The arrays are
/// copied. Of the scene this leaves the camera ([image]), how the fit is done ([estimate]), and whether the pistons of
/// the segments are estimated (modes.segment); they come before the caller's modes.
///
/// COPHASE_BAD_SHAPE for maps that do not fit one another, COPHASE_BAD_VALUE for what cannot be a pupil or a mode.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_create_from_arrays(
    scene_text: *const c_char,
    directory: *const c_char,
    arrays: *const cophase_model_arrays,
    model: *mut *mut cophase_model,
) -> cophase_status {
    fence(|| {
        let out = place(model, "model")?;
        let (scene_text, directory) = unsafe { scene(scene_text, directory) }?;
        let scene = Scene::for_arrays(scene_text, directory)?;
        if arrays.is_null() {
            return Err(Error::Argument("arrays is NULL: a cophase_model_arrays with a pupil is accepted".into()));
        }
        let arrays = unsafe { sized::read(arrays, "arrays") }?;
        let arrays = unsafe { copied(&arrays) }?;
        hand_out(Estimator::from_arrays(&scene, &arrays)?, out)
    })
}

/// A caller's arrays as the estimator takes them.
unsafe fn copied(arrays: &cophase_model_arrays) -> Result<Arrays> {
    let pupil = unsafe { Input::of(&arrays.pupil, "arrays->pupil") }?;
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

/// Frees a model; NULL is fine. Sessions and sequences that were made of it go on.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_destroy(model: *mut cophase_model) {
    unsafe { give_back(model, |model| &model.0) }
}

/// Number of modes that are estimated: the coefficients of an image.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_mode_count(model: *const cophase_model, modes: *mut usize) -> cophase_status {
    unsafe { read(model, |model| put(modes, "modes", model.names.len())) }
}

/// Number of those that move segments; they come first.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_segment_mode_count(
    model: *const cophase_model,
    modes: *mut usize,
) -> cophase_status {
    unsafe { read(model, |model| put(modes, "modes", model.estimator.model().segment_modes)) }
}

/// Name of a mode, from 0. The text lives as long as the model.
///
/// COPHASE_BAD_VALUE for a mode that there is not.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_mode_name(
    model: *const cophase_model,
    mode: usize,
    name: *mut *const c_char,
) -> cophase_status {
    unsafe {
        read(model, |model| {
            let found = model.names.get(mode).ok_or_else(|| {
                Error::Value(format!("mode is {mode}: 0 to {} is accepted", model.names.len().saturating_sub(1)))
            })?;
            put(name, "name", found.as_ptr())
        })
    }
}

/// Rows and columns of a detector frame.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_frame_shape(
    model: *const cophase_model,
    rows: *mut usize,
    cols: *mut usize,
) -> cophase_status {
    unsafe {
        read(model, |model| {
            let [x, y] = model.estimator.model().preparation.frame;
            put_shape(rows, cols, (y, x))
        })
    }
}

/// Rows, and columns, of a wavefront map.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_samples(model: *const cophase_model, samples: *mut usize) -> cophase_status {
    unsafe { read(model, |model| put(samples, "samples", model.estimator.model().telescope.pupil.grid.samples())) }
}

/// Rows, and columns, of a PSF: the pixels that are compared, after the reduction of a frame to the model's sampling and
/// to what carries signal.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_pixels(model: *const cophase_model, pixels: *mut usize) -> cophase_status {
    unsafe { read(model, |model| put(pixels, "pixels", model.estimator.model().preparation.pixels)) }
}

/// The wavefront of some coefficients, nm: map 0 the segments, map 1 the non-common path aberrations. NaN outside the
/// pupil.
///
/// modes: the number of coefficients, see cophase_model_mode_count. out: 2 x samples x samples, see
/// cophase_model_samples.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_wavefront_nm(
    model: *const cophase_model,
    coefficients_nm: *const f64,
    modes: usize,
    out: *const cophase_array_f32,
) -> cophase_status {
    unsafe {
        read(model, |named| {
            let coefficients_nm = named.coefficients(coefficients_nm, modes)?;
            let model = named.estimator.model();
            let samples = model.telescope.pupil.grid.samples();
            let out = Output::of(out, "out", [2, samples, samples])?;
            let maps = [Group::Segment, Group::Ncpa].map(|group| model.map_nm(coefficients_nm, group));
            out.fill(|k, y, x| maps[k][[y, x]] as f32);
            Ok(())
        })
    }
}

/// The PSF of some coefficients with the diversity, at the pixels that are compared: its sum over an unbounded detector
/// would be 1. The optical axis is in row and column pixels/2.
///
/// modes: as above. out: 1 x pixels x pixels, see cophase_model_pixels.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_model_psf(
    model: *const cophase_model,
    coefficients_nm: *const f64,
    modes: usize,
    out: *const cophase_array_f32,
) -> cophase_status {
    unsafe {
        read(model, |named| {
            let coefficients_nm = named.coefficients(coefficients_nm, modes)?;
            let pixels = named.estimator.model().preparation.pixels;
            let out = Output::of(out, "out", [1, pixels, pixels])?;
            let psf = named.estimator.judge().psf(ArrayView1::from(coefficients_nm));
            out.fill(|_, y, x| psf[y * pixels + x] as f32);
            Ok(())
        })
    }
}
