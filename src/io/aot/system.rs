//! What a file of AOT says of telescope, turbulence and loop, with the names of the images that it
//! refers to.

use super::read::{image, lists, reals, row, text_card, texts};
use super::version::check_version;
use crate::Result;
use crate::io::read::FitsReader;
use ndarray::s;

/// An image of the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AotImage {
    /// Name of its HDU.
    pub hdu: String,
    /// Card `BUNIT`; empty without one.
    pub unit: String,
}

/// Telescope, turbulence and loop of a file. A number that the file does not state is NaN.
#[derive(Debug, Clone, Default)]
pub struct AotSystem {
    /// The main telescope.
    pub telescope: AotTelescope,
    /// The turbulence, where there is a row of `AOT_ATMOSPHERIC_PARAMETERS`.
    pub turbulence: Option<AotTurbulence>,
    /// The Shack-Hartmann sensor, where there is one and no other.
    pub sensor: Option<AotSensor>,
    /// The deformable mirror, where there is one and no other.
    pub mirror: Option<AotMirror>,
    /// The loop of both.
    pub control: Option<AotControl>,
}

/// A row of `AOT_TELESCOPES`.
#[derive(Debug, Clone, Default)]
pub struct AotTelescope {
    /// Its name.
    pub uid: String,
    /// Kind of the segments: "Hexagon", "Circle", "Monolithic".
    pub segment_type: String,
    /// Diameter of the circle around a segment, m.
    pub segment_size_m: f64,
    /// Centres of the segments (x, y), m.
    pub segments_m: Vec<(f64, f64)>,
    /// Diameter of the circle around the pupil, m.
    pub enclosing_m: f64,
    /// Diameter of the central obscuration, m.
    pub obstruction_m: f64,
    /// Mask of the pupil.
    pub pupil: Option<AotImage>,
}

/// A row of `AOT_ATMOSPHERIC_PARAMETERS`.
#[derive(Debug, Clone)]
pub struct AotTurbulence {
    /// Wavelength of r0, m.
    pub wavelength_m: f64,
    /// Fried's parameter at that wavelength: mean over the times, m.
    pub r0_m: f64,
    /// Weights of the layers; empty where the file has no layers.
    pub weights: Vec<f64>,
    /// Heights, m; as many as weights, or none.
    pub heights_m: Vec<f64>,
    /// Outer scales, m; as many as weights, or none.
    pub outer_scales_m: Vec<f64>,
    /// Wind speeds, m/s; as many as weights, or none.
    pub wind_m_s: Vec<f64>,
    /// Azimuths of the wind, degrees from North over East; as many as weights, or none.
    pub wind_azimuth_deg: Vec<f64>,
}

/// A Shack-Hartmann sensor.
#[derive(Debug, Clone)]
pub struct AotSensor {
    /// Wavelength, m.
    pub wavelength_m: f64,
    /// Mask of the subapertures.
    pub mask: Option<AotImage>,
    /// Places of the grid along a side of the mask; 0 without one.
    pub across: usize,
    /// Whether the valid subapertures are numbered row by row of the mask, from the first row.
    pub is_row_by_row: bool,
    /// The measured slopes.
    pub measurements: Option<AotImage>,
    /// Scale of the sensor's pixels, rad.
    pub pixel_scale_rad: f64,
    /// How the centre of a spot is calculated.
    pub centroiding: String,
}

/// A deformable mirror.
#[derive(Debug, Clone)]
pub struct AotMirror {
    /// Places of the valid actuators (x, y), m.
    pub actuators_m: Vec<(f64, f64)>,
    /// Influence functions.
    pub influence: Option<AotImage>,
    /// Largest command, m.
    pub stroke_m: f64,
}

/// A control loop.
#[derive(Debug, Clone)]
pub struct AotControl {
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// Frames from a measurement to its correction.
    pub delay_frames: f64,
    /// Gain and leak of an integrator, if the filter of the loop is one and common to all modes.
    pub integrator: Option<(f64, f64)>,
    /// Interaction matrix, `[subaperture, dimension, actuator]`.
    pub interaction: Option<AotImage>,
    /// Control matrix, `[actuator, dimension, subaperture]`.
    pub command: Option<AotImage>,
}

/// Reads what `file` says of telescope, turbulence and loop.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for references without target, and a version that is not
/// known.
pub fn system(file: &mut FitsReader) -> Result<AotSystem> {
    check_version(file)?;
    let sensor = sensor(file)?;
    let mirror = mirror(file)?;
    let control = if sensor.is_some() && mirror.is_some() { control(file)? } else { None };
    Ok(AotSystem { telescope: telescope(file)?, turbulence: turbulence(file)?, sensor, mirror, control })
}

/// Rows of `table`; 0 where the file does not have it.
fn rows(file: &FitsReader, table: &str) -> usize {
    file.rows(table).unwrap_or(0)
}

/// The image to which a cell refers.
fn referred(file: &mut FitsReader, table: &str, column: &str, row: usize) -> Result<Option<AotImage>> {
    let cell = texts(file, table, column)?.swap_remove(row);
    let Some(at) = image(file, &cell, column)? else { return Ok(None) };
    Ok(Some(AotImage { hdu: file.name_of(at).to_owned(), unit: text_card(file, at, "BUNIT")? }))
}

/// The values of the image to which a cell refers; none where it refers to none.
fn values(file: &mut FitsReader, table: &str, column: &str, row: usize) -> Result<Vec<f64>> {
    let cell = texts(file, table, column)?.swap_remove(row);
    let Some(at) = image(file, &cell, column)? else { return Ok(Vec::new()) };
    Ok(file.cube_at(at)?.into_iter().collect())
}

/// The first row of the image to which a cell of the first row of `table` refers, a time of
/// several; none where it refers to none.
fn first_row(file: &mut FitsReader, table: &str, column: &str) -> Result<Vec<f64>> {
    let cell = texts(file, table, column)?.swap_remove(0);
    let Some(at) = image(file, &cell, column)? else { return Ok(Vec::new()) };
    Ok(file.cube_at(at)?.slice(s![0, 0, ..]).to_vec())
}

/// The number in a cell.
fn real(file: &mut FitsReader, table: &str, column: &str, row: usize) -> Result<f64> {
    Ok(reals(file, table, column)?[row])
}

/// The pairs of the lists in two cells.
fn places_m(file: &mut FitsReader, table: &str, columns: [&str; 2], row: usize) -> Result<Vec<(f64, f64)>> {
    let [x_m, y_m] =
        [lists(file, table, columns[0])?.swap_remove(row), lists(file, table, columns[1])?.swap_remove(row)];
    Ok(x_m.into_iter().zip(y_m).collect())
}

fn telescope(file: &mut FitsReader) -> Result<AotTelescope> {
    const TABLE: &str = "AOT_TELESCOPES";
    if rows(file, TABLE) == 0 {
        return Ok(AotTelescope {
            segment_size_m: f64::NAN,
            enclosing_m: f64::NAN,
            obstruction_m: f64::NAN,
            ..Default::default()
        });
    }
    let types = texts(file, TABLE, "TYPE")?;
    let row = types.iter().position(|kind| kind == "Main Telescope").unwrap_or(0);
    Ok(AotTelescope {
        uid: texts(file, TABLE, "UID")?.swap_remove(row),
        segment_type: texts(file, TABLE, "SEGMENT_TYPE")?.swap_remove(row),
        segment_size_m: real(file, TABLE, "SEGMENT_SIZE", row)?,
        segments_m: places_m(file, TABLE, ["SEGMENTS_X", "SEGMENTS_Y"], row)?,
        enclosing_m: real(file, TABLE, "ENCLOSING_D", row)?,
        obstruction_m: real(file, TABLE, "OBSTRUCTION_D", row)?,
        pupil: referred(file, TABLE, "PUPIL_MASK", row)?,
    })
}

fn turbulence(file: &mut FitsReader) -> Result<Option<AotTurbulence>> {
    const TABLE: &str = "AOT_ATMOSPHERIC_PARAMETERS";
    if rows(file, TABLE) == 0 {
        return Ok(None);
    }
    let r0_m = lists(file, TABLE, "R0")?.swap_remove(0);
    let known: Vec<f64> = r0_m.into_iter().filter(|r0_m| r0_m.is_finite()).collect();
    let weights = first_row(file, TABLE, "LAYERS_REL_WEIGHT")?;
    let mut of_layers = |column: &str| -> Result<Vec<f64>> {
        let found = first_row(file, TABLE, column)?;
        Ok(if found.len() == weights.len() { found } else { Vec::new() })
    };
    let (heights_m, outer_scales_m) = (of_layers("LAYERS_HEIGHT")?, of_layers("LAYERS_LO")?);
    let (wind_m_s, wind_azimuth_deg) = (of_layers("LAYERS_WIND_SPEED")?, of_layers("LAYERS_WIND_DIRECTION")?);
    Ok(Some(AotTurbulence {
        wavelength_m: real(file, TABLE, "WAVELENGTH", 0)?,
        r0_m: known.iter().sum::<f64>() / known.len() as f64,
        weights,
        heights_m,
        outer_scales_m,
        wind_m_s,
        wind_azimuth_deg,
    }))
}

fn sensor(file: &mut FitsReader) -> Result<Option<AotSensor>> {
    const TABLE: &str = "AOT_WAVEFRONT_SENSORS";
    const LENSLETS: &str = "AOT_WAVEFRONT_SENSORS_SHACK_HARTMANN";
    if rows(file, TABLE) != 1 || texts(file, TABLE, "TYPE")?[0] != "Shack-Hartmann" {
        return Ok(None);
    }
    let cell = texts(file, TABLE, "SUBAPERTURE_MASK")?.swap_remove(0);
    let (mut across, mut is_row_by_row) = (0, true);
    if let Some(at) = image(file, &cell, "SUBAPERTURE_MASK")? {
        let mask = file.cube_at(at)?;
        across = mask.dim().2;
        is_row_by_row =
            mask.iter().filter(|number| **number >= 0.0).enumerate().all(|(at, number)| *number == at as f64);
    }
    let detector = texts(file, TABLE, "DETECTOR_UID")?.swap_remove(0);
    let detector = row(file, &detector, "AOT_DETECTORS")?;
    let pixel_scale_rad = detector.map_or(Ok(f64::NAN), |at| real(file, "AOT_DETECTORS", "PIXEL_SCALE", at))?;
    let centroiding = if rows(file, LENSLETS) == 1 {
        texts(file, LENSLETS, "CENTROIDING_ALGORITHM")?.swap_remove(0)
    } else {
        String::new()
    };
    Ok(Some(AotSensor {
        wavelength_m: real(file, TABLE, "WAVELENGTH", 0)?,
        mask: referred(file, TABLE, "SUBAPERTURE_MASK", 0)?,
        across,
        is_row_by_row,
        measurements: referred(file, TABLE, "MEASUREMENTS", 0)?,
        pixel_scale_rad,
        centroiding,
    }))
}

fn mirror(file: &mut FitsReader) -> Result<Option<AotMirror>> {
    const TABLE: &str = "AOT_WAVEFRONT_CORRECTORS_DM";
    if rows(file, TABLE) != 1 {
        return Ok(None);
    }
    Ok(Some(AotMirror {
        actuators_m: places_m(file, TABLE, ["ACTUATORS_X", "ACTUATORS_Y"], 0)?,
        influence: referred(file, TABLE, "INFLUENCE_FUNCTION", 0)?,
        stroke_m: real(file, TABLE, "STROKE", 0)?,
    }))
}

fn control(file: &mut FitsReader) -> Result<Option<AotControl>> {
    const TABLE: &str = "AOT_LOOPS_CONTROL";
    const LOOPS: &str = "AOT_LOOPS";
    if rows(file, TABLE) != 1 {
        return Ok(None);
    }
    let uid = texts(file, TABLE, "UID")?.swap_remove(0);
    let Some(at) = texts(file, LOOPS, "UID")?.iter().position(|known| *known == uid) else { return Ok(None) };
    let numerator = values(file, LOOPS, "TIME_FILTER_NUM", at)?;
    let denominator = values(file, LOOPS, "TIME_FILTER_DEN", at)?;
    let integrator = match (&numerator[..], &denominator[..]) {
        // Rising powers of 1/z: gain / (1 − (1 − leak)/z).
        ([gain], [1.0, feedback]) => Some((*gain, feedback + 1.0)),
        _ => None,
    };
    Ok(Some(AotControl {
        frame_rate_hz: real(file, LOOPS, "FRAMERATE", at)?,
        delay_frames: real(file, LOOPS, "DELAY", at)?,
        integrator,
        interaction: referred(file, TABLE, "INTERACTION_MATRIX", 0)?,
        command: referred(file, TABLE, "CONTROL_MATRIX", 0)?,
    }))
}
