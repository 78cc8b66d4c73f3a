//! Calibration of a camera: from raw values to electrons.

use super::input::{Input, cophase_input};
use super::sized::{self, Options};
use crate::modal::{Calibration, CameraMaps};
use crate::{Error, Result};
use ndarray::Array2;

/// Calibration of a camera: electrons = (raw - dark) * gain / flat. Zero in every field but
/// struct_size: frames are electrons, or counts where the scene has image.gain_e_per_adu.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_calibration {
    /// sizeof(cophase_calibration).
    pub struct_size: usize,
    /// 1 x rows x cols: signal without light, raw units. Data NULL: none.
    pub dark: cophase_input,
    /// 1 x rows x cols: relative response, about 1. Data NULL: uniform.
    pub flat: cophase_input,
    /// 1 x rows x cols: bad pixels, which take no part, are not 0. Data NULL: none.
    pub bad: cophase_input,
    /// Electrons per raw unit; 0 means image.gain_e_per_adu of the scene, or 1 where it has none.
    pub gain_e: f64,
    /// Raw value from which on a pixel is saturated, and bad; 0 means none.
    pub saturation: f64,
}

unsafe impl Options for cophase_calibration {}

/// Whether a caller gives a gain.
pub(super) unsafe fn has_gain(calibration: *const cophase_calibration) -> Result<bool> {
    Ok(unsafe { sized::read(calibration, "calibration") }?.gain_e != 0.0)
}

/// A caller's calibration for frames of `shape` (rows, columns), with `scene_gain` where it gives
/// no gain; electrons for NULL.
pub(super) unsafe fn calibration(
    calibration: *const cophase_calibration,
    shape @ (rows, cols): (usize, usize),
    scene_gain: Option<f64>,
) -> Result<Calibration> {
    let given = unsafe { sized::read(calibration, "calibration") }?;
    let map = |array: &cophase_input, name: &'static str| -> Result<Option<Array2<f64>>> {
        let Some(input) = (unsafe { Input::optional(array, name) })? else { return Ok(None) };
        input.must_be([1, rows, cols])?.map().map(Some)
    };
    let maps = CameraMaps {
        dark: map(&given.dark, "calibration->dark")?,
        flat: map(&given.flat, "calibration->flat")?,
        bad: map(&given.bad, "calibration->bad")?.map(|bad| bad.mapv(|value| value != 0.0)),
    };
    let gain_e = if given.gain_e == 0.0 { scene_gain.unwrap_or(1.0) } else { given.gain_e };
    let saturation = if given.saturation == 0.0 { f64::INFINITY } else { given.saturation };
    Calibration::new(shape, maps, gain_e, saturation)
}

/// A caller's read noise, checked; `None`, for 0 without `has_read_noise`, is the scene's.
pub(super) fn read_noise_e(given: f64, has_read_noise: i64) -> Result<Option<f64>> {
    if !(given.is_finite() && given >= 0.0) {
        return Err(Error::Value(format!(
            "options->read_noise_e is {given}: a number of electrons, or 0 for the scene's, is accepted"
        )));
    }
    match has_read_noise {
        0 => Ok((given > 0.0).then_some(given)),
        1 => Ok(Some(given)),
        other => Err(Error::Value(format!("options->has_read_noise is {other}: 0 or 1 is accepted"))),
    }
}
