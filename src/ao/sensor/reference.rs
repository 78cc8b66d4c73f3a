//! Reference slopes, about which a loop is closed.

use super::slope_order::SlopeFormat;
use crate::io::FitsReader;
use crate::scene::{SensorScene, System};
use crate::{Error, Result};
use ndarray::{Array1, Axis};
use std::path::{Path, PathBuf};

/// HDU of an image file with the row by which corrections have moved the reference slopes.
pub(crate) const MOVED_REFERENCE: &str = "MOVED_REFERENCE";

/// The reference slopes of `scene`'s file in its own order and unit: HDU `REFERENCE` or the first
/// image, a row of `slopes` values; `None` where the scene names no file.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, another number of values, or one that is not
/// finite.
pub(crate) fn reference_slopes(scene: &System, sensing: &SensorScene, slopes: usize) -> Result<Option<Array1<f64>>> {
    let row = |file: &PathBuf| {
        let path = scene.resolve(file);
        let mut file = FitsReader::open(&path)?;
        let row = file.row(file.has("REFERENCE").then_some("REFERENCE"))?;
        checked(&path, row, slopes)
    };
    sensing.reference_file.as_ref().map(row).transpose()
}

/// By how much corrections have moved the reference slopes, as [`reference_slopes`]: HDU
/// [`MOVED_REFERENCE`] or the first image of `scene`'s file, or the columns `X_MAS` and `Y_MAS` of
/// its table `REFERENCE`, as corrections have them, which are in mas, all x then all y.
///
/// # Errors
/// As [`reference_slopes`].
pub(crate) fn moved_reference(
    scene: &System,
    sensing: &SensorScene,
    format: &SlopeFormat,
) -> Result<Option<Array1<f64>>> {
    let Some(file) = &sensing.moved_reference_file else { return Ok(None) };
    let path = scene.resolve(file);
    let mut file = FitsReader::open(&path)?;
    if file.has_column("REFERENCE", "X_MAS") {
        let all = [file.f64_column("REFERENCE", "X_MAS")?, file.f64_column("REFERENCE", "Y_MAS")?].concat();
        return checked(&path, all, format.slopes()).map(Some);
    }
    let row = file.row((file.is_whole() && file.has(MOVED_REFERENCE)).then_some(MOVED_REFERENCE))?;
    let row = checked(&path, row, format.slopes())?;
    Ok(Some(format.expected_mas(row.view().insert_axis(Axis(0)))?.row(0).to_owned()))
}

/// `row` of the file at `path`, which has to have `slopes` finite values.
fn checked(path: &Path, row: Vec<f64>, slopes: usize) -> Result<Array1<f64>> {
    if row.len() != slopes {
        let sentence = format!("it has {} reference slopes: one for each of the {slopes} slopes is needed", row.len());
        return Err(Error::file(path, sentence));
    }
    match row.iter().position(|slope| !slope.is_finite()) {
        Some(at) => {
            Err(Error::file(path, format_args!("reference slope {} is {}: a finite one is needed", at + 1, row[at])))
        }
        None => Ok(Array1::from(row)),
    }
}

/// The reference slopes of `scene`, `[all x, all y]`, mas; none where the scene names no file.
///
/// # Errors
/// As [`reference_slopes`].
pub(in crate::ao) fn reference_mas(scene: &System, sensing: &SensorScene, format: &SlopeFormat) -> Result<Vec<f32>> {
    let Some(row) = reference_slopes(scene, sensing, format.slopes())? else { return Ok(Vec::new()) };
    let mas = format.expected_mas(row.view().insert_axis(Axis(0)))?;
    Ok(mas.iter().map(|mas| *mas as f32).collect())
}
