//! Slopes of the Shack-Hartmann sensor of a file of AOT, matched to the images of its scoring
//! cameras; commands of its mirror.

use super::cameras::{MAS_PER_RADIAN, exposure_s, with_images};
use super::read::{image, lists, reals, row, text_card, texts};
use super::version::{TIME_REFERENCE, check_version};
use crate::Result;
use crate::io::read::FitsReader;
use ndarray::{Array1, Array2, Array3};

const SENSORS: &str = "AOT_WAVEFRONT_SENSORS";
const LOOPS: &str = "AOT_LOOPS";

/// Slopes of the images of a camera.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MatchedSlopes {
    /// `[image, slope]`: along x for every subaperture, row by row of the sensor's mask, then along
    /// y; mas, or without a unit as the file has them. `None` where there are none, or they are
    /// left out.
    pub slopes: Option<Array2<f64>>,
    /// Why slopes in the file are left out, as a sentence.
    pub left_out: Option<String>,
}

impl MatchedSlopes {
    fn left_out(reason: String) -> Self {
        Self { slopes: None, left_out: Some(format!("the telemetry is left out: {reason}")) }
    }
}

/// Slopes for the images of the scoring camera `camera`, counted from 0 among those with images,
/// which has `images` of them.
///
/// Where images and measurements have times (`TIME_UID`, `TIMESTAMPS`), an image has the mean of
/// the measurements from half an integration time before its time to half of one after it. Without
/// times there is one measurement for each image.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for measurements whose shape contradicts their mask, an
/// unknown unit, references without target.
pub fn slopes(file: &mut FitsReader, camera: usize, images: usize) -> Result<MatchedSlopes> {
    check_version(file)?;
    let cells = texts(file, SENSORS, "MEASUREMENTS")?;
    let types = texts(file, SENSORS, "TYPE")?;
    let measuring: Vec<usize> = (0..cells.len()).filter(|&sensor| !cells[sensor].is_empty()).collect();
    let sensor = match measuring[..] {
        [] => return Ok(MatchedSlopes::default()),
        [one] if types[one] == "Shack-Hartmann" => one,
        [one] => {
            return Ok(MatchedSlopes::left_out(format!(
                "it is of a {} sensor, not of a Shack-Hartmann one",
                types[one]
            )));
        }
        _ => return Ok(MatchedSlopes::left_out(format!("it is of {} wavefront sensors, not of one", measuring.len()))),
    };
    let Some(at) = image(file, &cells[sensor], "MEASUREMENTS")? else { return Ok(MatchedSlopes::default()) };
    let measured = measurements(file, sensor, at)?;
    let camera = with_images(file)?.swap_remove(camera);
    let [images_s, frames_s] = [times_s(file, camera.images, None)?, times_s(file, at, Some(sensor))?];
    let frames = measured.nrows();
    for (count, times_s, what) in [(images, &images_s, "images"), (frames, &frames_s, "measurements")] {
        if times_s.as_ref().is_some_and(|times_s| times_s.len() != count) {
            let times = times_s.as_ref().map_or(0, Vec::len);
            return Err(file.refuse(format!("has {count} {what} and {times} TIMESTAMPS of them: as many are accepted")));
        }
    }
    let (Some(images_s), Some(frames_s)) = (images_s, frames_s) else {
        if frames == images {
            return Ok(MatchedSlopes { slopes: Some(measured), left_out: None });
        }
        let reason = format!(
            "it has {frames} measurements for {images} images of `{}`, and times (TIME_UID with TIMESTAMPS) of both are needed \
             to match them",
            camera.uid
        );
        return Ok(MatchedSlopes::left_out(reason));
    };
    let half_s = exposure_s(file, &camera)? / 2.0;
    match means(&measured, &frames_s, &images_s, if half_s > 0.0 { half_s } else { 0.0 }) {
        Ok(slopes) => Ok(MatchedSlopes { slopes: Some(slopes), left_out: None }),
        Err(first) => {
            Ok(MatchedSlopes::left_out(format!("no measurement is within the exposure of image {}", first + 1)))
        }
    }
}

/// The measurements `[frame, slope]` of a sensor, in the HDU `at`: all x, then all y, row by row of
/// the mask; in mas where the file states the unit.
fn measurements(file: &mut FitsReader, sensor: usize, at: usize) -> Result<Array2<f64>> {
    let cube: Array3<f64> = file.cube_at(at)?;
    let (frames, dimensions, subapertures) = cube.dim();
    if dimensions != 2 {
        let shape = cube.dim();
        return Err(file.refuse(format!(
            "has measurements of the shape {shape:?}: [frame, dimension, subaperture] with 2 dimensions, x and y, is accepted"
        )));
    }
    let order = order(file, sensor, subapertures)?;
    let factor = mas_per_unit(file, sensor, at)?;
    // All x, then all y: row k of the result is the plane of frame k, row by row.
    let ordered = Array2::from_shape_fn((frames, 2 * subapertures), |(frame, slope)| {
        cube[[frame, slope / subapertures, order[slope % subapertures]]]
    });
    Ok(match factor {
        // Not even a product with 1: the slopes keep their bits.
        None => ordered,
        Some(factor) => ordered * factor,
    })
}

/// The place among the measured subapertures of each subaperture, row by row. The mask has, for
/// each place of the grid, its number among the measured ones, −1 outside; without a mask they are
/// measured row by row.
fn order(file: &mut FitsReader, sensor: usize, subapertures: usize) -> Result<Vec<usize>> {
    let cells = texts(file, SENSORS, "SUBAPERTURE_MASK")?;
    let Some(at) = image(file, &cells[sensor], "SUBAPERTURE_MASK")? else { return Ok((0..subapertures).collect()) };
    let mask = file.cube_at(at)?;
    let order: Vec<usize> = mask.iter().filter(|number| **number >= 0.0).map(|number| *number as usize).collect();
    let mut sorted = order.clone();
    sorted.sort_unstable();
    if sorted.into_iter().eq(0..subapertures) {
        return Ok(order);
    }
    let name = file.name_of(at).to_owned();
    Err(file.refuse(format!(
        "has the subaperture mask {name} with {} valid subapertures and measurements of {subapertures}: the numbers 0 to {} are accepted, \
         each once",
        order.len(),
        subapertures.saturating_sub(1)
    )))
}

/// Angle on the sky of a slope of 1, mas; `None` for slopes in mas or without a unit.
fn mas_per_unit(file: &mut FitsReader, sensor: usize, at: usize) -> Result<Option<f64>> {
    let unit = text_card(file, at, "BUNIT")?;
    match unit.to_ascii_lowercase().as_str() {
        "" | "mas" => Ok(None),
        "arcsec" => Ok(Some(1e3)),
        "rad" => Ok(Some(MAS_PER_RADIAN)),
        "pix" | "pixel" | "pixels" => {
            let references = texts(file, SENSORS, "DETECTOR_UID")?;
            let scales_rad = reals(file, "AOT_DETECTORS", "PIXEL_SCALE")?;
            let scale_rad = row(file, &references[sensor], "AOT_DETECTORS")?.map(|detector| scales_rad[detector]);
            let scale_rad = scale_rad.filter(|scale_rad| scale_rad.is_finite());
            scale_rad.map(|scale_rad| Some(scale_rad * MAS_PER_RADIAN)).ok_or_else(|| {
                file.refuse(
                    "has slopes in pixels: the PIXEL_SCALE of the wavefront sensor's detector is needed with them",
                )
            })
        }
        _ => Err(file.refuse(format!(
            "has slopes in the unit `{unit}` (card BUNIT): mas, arcsec, rad, pix or no unit is accepted"
        ))),
    }
}

/// Times of the frames of the image `at`, s: those that its card names, else of the control loop of
/// the sensor `sensor`. `None` where the file has none.
fn times_s(file: &mut FitsReader, at: usize, sensor: Option<usize>) -> Result<Option<Vec<f64>>> {
    let mut cell = text_card(file, at, TIME_REFERENCE)?;
    if let Some(sensor) = sensor.filter(|_| cell.is_empty()) {
        cell = loop_time(file, sensor)?;
    }
    let Some(row) = row(file, &cell, "AOT_TIME")? else { return Ok(None) };
    let times_s = lists(file, "AOT_TIME", "TIMESTAMPS")?.swap_remove(row);
    Ok(Some(times_s).filter(|times_s| !times_s.is_empty()))
}

/// The reference to the times of the control loop of a sensor; empty where there is none.
fn loop_time(file: &mut FitsReader, sensor: usize) -> Result<String> {
    if !file.has("AOT_LOOPS_CONTROL") {
        return Ok(String::new());
    }
    let (inputs, loops) =
        (texts(file, "AOT_LOOPS_CONTROL", "INPUT_SENSOR_UID")?, texts(file, "AOT_LOOPS_CONTROL", "UID")?);
    let (uids, cells) = (texts(file, LOOPS, "UID")?, texts(file, LOOPS, "TIME_UID")?);
    for (input, uid) in inputs.iter().zip(&loops) {
        if row(file, input, SENSORS)? == Some(sensor)
            && let Some(at) = uids.iter().position(|known| known == uid)
            && !cells[at].is_empty()
        {
            return Ok(cells[at].clone());
        }
    }
    Ok(String::new())
}

/// The mean of the frames within `half_s` of the time of each image.
///
/// # Errors
/// The first image without any.
fn means(
    measured: &Array2<f64>,
    frames_s: &[f64],
    images_s: &[f64],
    half_s: f64,
) -> std::result::Result<Array2<f64>, usize> {
    let mut slopes = Array2::zeros((images_s.len(), measured.ncols()));
    for (image, image_s) in images_s.iter().enumerate() {
        let within: Vec<usize> =
            (0..frames_s.len()).filter(|&frame| (frames_s[frame] - image_s).abs() <= half_s).collect();
        match within[..] {
            [] => return Err(image),
            [one] => slopes.row_mut(image).assign(&measured.row(one)),
            _ => {
                let mut sum = Array1::<f64>::zeros(measured.ncols());
                within.iter().for_each(|&frame| sum += &measured.row(frame));
                slopes.row_mut(image).assign(&(sum / within.len() as f64));
            }
        }
    }
    Ok(slopes)
}

/// Commands of the mirror in the loop that has any, `[frame, actuator]`, nm, of the file's m;
/// `None` where no loop has them.
///
/// # Errors
/// [`Error::File`](crate::Error::File) where several loops have commands, or for commands that are
/// not 2-D.
pub fn commands_nm(file: &mut FitsReader) -> Result<Option<Array2<f64>>> {
    check_version(file)?;
    let cells: Vec<String> = texts(file, LOOPS, "COMMANDS")?.into_iter().filter(|cell| !cell.is_empty()).collect();
    let cell = match &cells[..] {
        [] => return Ok(None),
        [one] => one,
        several => {
            let loops = several.len();
            return Err(file.refuse(format!("has the commands of {loops} loops, where those of one are read")));
        }
    };
    let Some(at) = image(file, cell, "COMMANDS")? else { return Ok(None) };
    let name = file.name_of(at).to_owned();
    Ok(Some(file.map(Some(&name))? * 1e9))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn image_is_the_mean_of_its_frames_exactly_for_one_frame() {
        let measured = array![[0.1, 1.0], [0.3, 3.0], [0.7, 5.0], [0.9, 7.0]];
        let times_s = [0.0, 1.0, 2.0, 3.0];
        // 0.3 + 0.7 is exact here, and so are halves.
        assert_eq!(means(&measured, &times_s, &[1.5, 0.25], 0.5), Ok(array![[0.5, 4.0], [0.1, 1.0]]));
        assert_eq!(means(&measured, &times_s, &[3.0, 0.0], 0.0), Ok(array![[0.9, 7.0], [0.1, 1.0]]));
        assert_eq!(means(&measured, &times_s, &[3.0, 9.0], 0.5), Err(1));
    }
}
