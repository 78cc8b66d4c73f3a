//! Measured matrices of a loop: interaction and command matrix from files, in the units, order and
//! signs of the model.

use super::sensor::{Lenslets, OTHER_SLOPE_ORDERS, SlopeFormat, slope_sources};
use crate::io::FitsReader;
use crate::scene::{ControlScene, SensorScene, SlopeOrder, System};
use crate::{Error, Result};
use ndarray::{Array2, Array3, ArrayView2};
use std::path::Path;

/// Least correlation of a measured interaction matrix with that of the model. Other detectors, and
/// influence functions of twice the coupling, leave more; another order of slopes or actuators
/// less, since it puts most of a column elsewhere.
const LEAST_CORRELATION: f64 = 0.6;

/// The interaction matrix of `scene`'s file, `[slope, actuator]`, mas per nm; `None` where the
/// scene names none. It is compared with that of the model.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, or whose matrix does not fit, or is of other
/// slopes or actuators than the model's.
pub(super) fn interaction(scene: &System, lenslets: &Lenslets, modelled: &Array2<f64>) -> Result<Option<Array2<f64>>> {
    let Some((sensing, control)) = scene.wavefront_sensor.as_ref().zip(scene.control.as_ref()) else { return Ok(None) };
    let Some(file) = &control.interaction_file else { return Ok(None) };
    let path = scene.resolve(file);
    let matrix = read(&path, "INTERACTION", modelled.dim(), ["slope", "actuator"], |cube| {
        // AOT: [subaperture, dimension, actuator].
        let (subapertures, dimensions, actuators) = cube.dim();
        (cube.permuted_axes([1, 0, 2]), (dimensions * subapertures, actuators))
    })?;
    let format = SlopeFormat::new(sensing, lenslets)?;
    let measured = (format.expected_mas(matrix.t())? / control.matrix_command_nm).reversed_axes();
    match mismatch(sensing, lenslets, modelled.view(), measured.view()) {
        Some(sentence) => Err(Error::file(&path, sentence)),
        None => Ok(Some(measured)),
    }
}

/// The command matrix of `scene`'s file, `[actuator, slope]`, nm per mas; `None` where the scene
/// names none.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, or whose matrix does not fit.
pub(super) fn command_matrix(
    scene: &System,
    control: &ControlScene,
    lenslets: &Lenslets,
    actuators: usize,
) -> Result<Option<Array2<f64>>> {
    let Some((sensing, file)) = scene.wavefront_sensor.as_ref().zip(control.command_matrix_file.as_ref()) else {
        return Ok(None);
    };
    let path = scene.resolve(file);
    let shape = (actuators, 2 * lenslets.subapertures.len());
    let matrix = read(&path, "COMMAND_MATRIX", shape, ["actuator", "slope"], |cube| {
        // AOT: [actuator, dimension, subaperture].
        let (actuators, dimensions, subapertures) = cube.dim();
        (cube, (actuators, dimensions * subapertures))
    })?;
    // A command is a sum over measured slopes, so that a column is in commands per unit of a slope.
    let format = SlopeFormat::new(sensing, lenslets)?;
    let unit = control.matrix_command_nm / (sensing.slope_unit_mas * sensing.slope_unit_mas);
    Ok(Some(format.expected_mas(matrix.view())? * unit))
}

/// A matrix of `shape`: the HDU in brackets, HDU `name` of the file, or its first image. `flat`
/// orders the values of an image with three axes, as AOT has them, and says the shape of the matrix
/// that they are.
fn read(
    path: &Path,
    name: &str,
    shape: (usize, usize),
    of: [&str; 2],
    flat: impl FnOnce(Array3<f64>) -> (Array3<f64>, (usize, usize)),
) -> Result<Array2<f64>> {
    let mut file = FitsReader::open(path)?;
    let image = if file.is_whole() && file.has(name) { file.map(Some(name))?.into_dyn() } else { file.map_or_cube()? };
    let matrix = if image.ndim() == 3 {
        let (cube, dim) = flat(image.into_dimensionality().map_err(|error| Error::Internal(error.to_string()))?);
        cube.as_standard_layout().into_owned().into_shape_with_order(dim)
    } else {
        image.into_dimensionality()
    };
    let matrix: Array2<f64> = matrix.map_err(|error| Error::Internal(error.to_string()))?;
    let (rows, columns) = matrix.dim();
    if matrix.dim() != shape {
        let transposed = if (columns, rows) == shape { "; this one is the transpose" } else { "" };
        return Err(Error::file(
            path,
            format_args!(
                "its matrix has {rows} rows and {columns} columns: a row for each of {} {}s and a column for each of {} {}s in use are \
                 needed{transposed}",
                shape.0, of[0], shape.1, of[1]
            ),
        ));
    }
    match matrix.indexed_iter().find(|(_, value)| !value.is_finite()) {
        Some(((row, column), value)) => Err(Error::file(
            path,
            format_args!("its matrix is {value} at row {row}, column {column}: finite values are needed"),
        )),
        None => Ok(matrix),
    }
}

/// Why a measured interaction matrix is not that of the scene's sensor and mirror, if it is not.
fn mismatch(
    sensing: &SensorScene,
    lenslets: &Lenslets,
    modelled: ArrayView2<f64>,
    measured: ArrayView2<f64>,
) -> Option<String> {
    let found = correlation(modelled, |slope| (slope, 1.0), measured);
    if found >= LEAST_CORRELATION {
        return None;
    }
    let reordered = |&order: &SlopeOrder| {
        let sources = slope_sources(order, lenslets.across, &lenslets.subapertures)?;
        Some((order, correlation(modelled, |slope| sources[slope], measured)))
    };
    let orders = OTHER_SLOPE_ORDERS.iter().filter_map(reordered).chain([(SlopeOrder::Expected, found)]);
    let best = orders.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let advice = match best {
        Some((SlopeOrder::Expected, value)) if value <= -LEAST_CORRELATION => format!(
            "it has the opposite sign: wavefront_sensor.slope_unit_mas = {} or control.matrix_command_nm of the opposite sign is needed",
            -sensing.slope_unit_mas
        ),
        Some((order, value)) if value.abs() >= LEAST_CORRELATION => {
            let words = sensing.slope_order.iter().chain([&order]).map(|order| format!("{:?}", order.word()));
            let sign = if value < 0.0 { ", and the opposite sign," } else { "" };
            let words: Vec<String> = words.collect();
            format!("wavefront_sensor.slope_order = [{}]{sign} makes it {:.2}", words.join(", "), value.abs())
        }
        _ => "no other order or sign of the slopes does: the actuators may be in another order (row by row from the smallest y is \
              needed), or the sensor or the mirror are others than the scene's"
            .into(),
    };
    Some(format!(
        "its interaction matrix does not resemble that of the scene's sensor and mirror (correlation {found:.2}, {LEAST_CORRELATION} is \
         needed); {advice}"
    ))
}

/// Correlation of the entries of two matrices, rows of the second reordered.
fn correlation(modelled: ArrayView2<f64>, source: impl Fn(usize) -> (usize, f64), measured: ArrayView2<f64>) -> f64 {
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    for (slope, row) in modelled.outer_iter().enumerate() {
        let (at, sign) = source(slope);
        for (a, b) in row.iter().zip(measured.row(at)) {
            (aa, ab, bb) = (aa + a * a, ab + sign * a * b, bb + b * b);
        }
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}
