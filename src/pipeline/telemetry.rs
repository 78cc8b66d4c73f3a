//! Check of telemetry: whether the slopes that come with the images are those of the retrieved
//! wavefronts.

use super::images::counted;
use crate::loop_response::{ACCEPTED_GAIN, SensorModel, SlopeRegression, TelemetryFault, USUAL_GAIN};
use crate::modal::DiversityProjection;
use crate::retrieval::IlluminatedSamples;
use crate::scene::{Scene, SlopeOrder, Telemetry};
use crate::statics::{NcpaBasis, NcpaFamily};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Axis};

/// Amplitude of a sample below which its retrieved phase is not used.
const MIN_AMPLITUDE: f64 = 0.5;

/// Measured slopes against those of the retrieved wavefronts.
#[derive(Debug, Clone, PartialEq)]
pub struct TelemetryCheck {
    /// Measured over predicted slopes; 1 where the telemetry belongs to the images.
    pub gain: f64,
    /// Correlation of both.
    pub correlation: f64,
    /// Correlation of each image; NaN for unusable ones.
    pub image_correlations: Vec<f64>,
    /// Number by which the slopes were divided: 1 unless `estimate.telemetry = "use"`.
    pub divided_by: f64,
    /// Whether the slopes exclude that the images are flipped.
    pub excludes_flips: bool,
    /// What a user should know.
    pub(super) warnings: Vec<String>,
}

/// Compares the slopes (`[image, slope]`, mas, NaN for images without telemetry) with wavefronts
/// (`[image, sample]`, nm, NaN for unusable images) that were retrieved without them.
///
/// # Errors
/// [`Error::Value`] for slopes that do not belong to the images, where the scene says that they are
/// checked.
pub(super) fn check(
    scene: &Scene,
    samples: &IlluminatedSamples,
    wavefronts_nm: &Array2<f64>,
    slopes_mas: &Array2<f64>,
) -> Result<Option<TelemetryCheck>> {
    let is_usable = |image: &usize| {
        let row = [wavefronts_nm.row(*image), slopes_mas.row(*image)];
        row.iter().flatten().all(|value| value.is_finite())
    };
    let used: Vec<usize> = (0..wavefronts_nm.nrows()).filter(is_usable).collect();
    if used.len() < 2 {
        // Too few images for an estimate, too.
        return Ok(None);
    }
    let kept = samples.select_bright(MIN_AMPLITUDE);
    let telescope = Telescope::new(scene)?;
    let basis = NcpaBasis::new(NcpaFamily::Zernike { highest_order: 2 }, scene, &telescope)?;
    let sensor = SensorModel::new(scene, &telescope, &samples.subset(&kept), &basis.modes)?;
    let wavefronts_nm = wavefronts_nm.select(Axis(0), &used).select(Axis(1), &kept);
    let measured_mas = slopes_mas.select(Axis(0), &used);
    let found = sensor.compare_slopes(wavefronts_nm.view(), measured_mas.view())?;
    let mut image_correlations = vec![f64::NAN; slopes_mas.nrows()];
    used.iter().zip(&found.image_correlations).for_each(|(&image, value)| image_correlations[image] = *value);
    let mut check = TelemetryCheck {
        gain: found.gain,
        correlation: found.correlation,
        image_correlations,
        divided_by: 1.0,
        excludes_flips: found.excludes_flips,
        warnings: Vec::new(),
    };
    let is_forced = scene.estimate.telemetry == Telemetry::Use;
    if is_forced && found.has_significant_gain() {
        check.divided_by = found.gain;
    }
    let divided = match check.divided_by {
        1.0 => "they are used as they are, because estimate.telemetry is \"use\"".to_string(),
        gain => format!("they are divided by {gain:.3}, because estimate.telemetry is \"use\""),
    };
    let diversity = DiversityProjection::new(scene, &telescope, &basis.modes.sampled(&telescope.pupil)?, 0)?;
    match &found.fault {
        // Retrieved wavefronts have either sign.
        Some(TelemetryFault::Order(..) | TelemetryFault::Unrelated)
            if diversity.is_too_small(scene.image.wavelength_nm) =>
        {
            check.divided_by = 1.0;
            check.warnings.push(format!(
                "the telemetry cannot be compared with the images, whose diversity does not determine the signs of wavefronts \
                 (correlation {:.2}); it is used as it is",
                found.correlation
            ));
        }
        Some(fault) if is_forced => {
            let what = mismatch(scene, fault, &found, used.len());
            check.warnings.push(format!("{what}; {divided}"));
        }
        Some(fault) => {
            return Err(Error::Value(format!(
                "{}; {}set estimate.telemetry of the scene to \"ignore\", or to \"use\", which divides them by the gain",
                mismatch(scene, fault, &found, used.len()),
                remedy(scene, fault, found.gain)
                    .map_or(String::new(), |keys| format!("{keys} of the scene reads them so, else "))
            )));
        }
        None => {}
    }
    if found.fault.is_none() && !USUAL_GAIN.contains(&found.gain) {
        let how = if is_forced { divided } else { "estimate.telemetry = \"use\" divides them by it".into() };
        check.warnings.push(format!(
            "the measured slopes are {:.2} times those of the retrieved wavefronts (correlation {:.2}): the sensor's gain \
             differs from the scene's, and NCPA have an error of the same fraction; {how}",
            found.gain, found.correlation
        ));
    }
    if found.fault.is_none() {
        let odd: Vec<String> =
            found.odd_images(slopes_mas.ncols()).into_iter().map(|image| (used[image] + 1).to_string()).collect();
        if !odd.is_empty() {
            let (them, noun) = if odd.len() == 1 { ("it", "image") } else { ("them", "images") };
            check.warnings.push(format!(
                "the slopes of {noun} {} do not belong to {them}: their correlation with the retrieved wavefronts is less than \
                 half of the others' ({:.2})",
                odd.join(", "),
                found.correlation
            ));
        }
    }
    if !found.stuck.is_empty() {
        let places: Vec<String> = found.stuck.iter().map(|(row, column)| format!("{row}, {column}")).collect();
        let them = if places.len() == 1 { "it" } else { "they" };
        check.warnings.push(format!(
            "the slopes of {} (row, column from 0: {}) hardly change from image to image: the NCPA absorb what {them} should have \
             measured, beyond their error bars",
            counted(places.len(), "subaperture"),
            places.join("; ")
        ));
    }
    Ok(Some(check))
}

/// What is wrong with the telemetry, with the figures and the likely cause.
fn mismatch(scene: &Scene, fault: &TelemetryFault, found: &SlopeRegression, images: usize) -> String {
    let of_images = counted(images, "image");
    let sentence = format!("the telemetry does not belong to the images: {}", cause(scene, fault));
    let (least, most) = (ACCEPTED_GAIN.start(), ACCEPTED_GAIN.end());
    let figures = format!(
        "the measured slopes of {of_images} are {:.3} times those of the retrieved wavefronts, with a correlation of {:.2}",
        found.gain, found.correlation
    );
    match fault {
        TelemetryFault::Zero | TelemetryFault::Constant => sentence,
        TelemetryFault::Unit(_) => format!("{sentence} ({figures}; a gain of {least} to {most} is accepted)"),
        TelemetryFault::Unrelated => {
            format!("{sentence} ({figures}; {:.2} or more is accepted)", found.significant_correlation)
        }
        _ => format!("{sentence} ({figures}; corrected for this, of {:.2})", found.explained_correlation),
    }
}

/// Key of the scene that describes the slopes of a mismatch, and its value.
fn remedy(scene: &Scene, fault: &TelemetryFault, gain: f64) -> Option<String> {
    let sensing = scene.wavefront_sensor.as_ref()?;
    let unit = |unit_mas: f64| format!("wavefront_sensor.slope_unit_mas = {unit_mas:.4}");
    match fault {
        TelemetryFault::Order(SlopeOrder::Expected, _) => Some(unit(-sensing.slope_unit_mas)),
        TelemetryFault::Order(order, opposite) => {
            let words = sensing.slope_order.iter().chain([order]).map(|order| format!("{:?}", order.word()));
            let order = format!("wavefront_sensor.slope_order = [{}]", words.collect::<Vec<_>>().join(", "));
            let sign = opposite.then(|| format!(" with {}", unit(-sensing.slope_unit_mas)));
            Some(order + &sign.unwrap_or_default())
        }
        TelemetryFault::Unit(_) if gain > 0.0 => Some(unit(sensing.slope_unit_mas / gain)),
        _ => None,
    }
}

/// Likely cause of a mismatch.
fn cause(scene: &Scene, fault: &TelemetryFault) -> String {
    let opposite = |opposite: &bool| if *opposite { ", and have the opposite sign" } else { "" };
    match fault {
        TelemetryFault::Zero => "all slopes are 0".into(),
        TelemetryFault::Constant => "every image has the same slopes".into(),
        TelemetryFault::Order(SlopeOrder::Expected, _) => "the slopes have the opposite sign".into(),
        TelemetryFault::Order(order, sign) => {
            let image = &scene.image;
            let flips = |key: &str, now: bool| format!("image.{key} = {}", !now);
            let [x, y] = [flips("flip_x", image.flip_x), flips("flip_y", image.flip_y)];
            let what = match order {
                SlopeOrder::Expected => String::new(),
                SlopeOrder::YBeforeX => "the slopes along y come before those along x".into(),
                SlopeOrder::Interleaved => {
                    "the slopes along x and y of each subaperture come in turn, where all x and then \
                                            all y are accepted"
                        .into()
                }
                SlopeOrder::ColumnMajor => {
                    "the subapertures come column by column, where row by row is accepted".into()
                }
                SlopeOrder::OppositeX => "the slopes along x have the opposite sign".into(),
                SlopeOrder::OppositeY => "the slopes along y have the opposite sign".into(),
                SlopeOrder::FlippedX => {
                    format!("the images, or else the slopes, are flipped left to right ({x} where it is the images)")
                }
                SlopeOrder::FlippedY => {
                    format!("the images, or else the slopes, are flipped up to down ({y} where it is the images)")
                }
                SlopeOrder::Rotated180 => {
                    format!("the images, or else the slopes, are rotated by 180° ({x} and {y} where it is the images)")
                }
                SlopeOrder::Transposed | SlopeOrder::TransposedBack => {
                    "x and y are exchanged in the slopes, their positions included".into()
                }
                SlopeOrder::Rotated90 | SlopeOrder::Rotated270 => "the slopes are rotated by 90°".into(),
            };
            what + opposite(sign)
        }
        TelemetryFault::Unit(_) => "the slopes have another unit or scale, where mas on the sky are accepted".into(),
        TelemetryFault::ReversedTime => "the slopes are in the reverse order of the images".into(),
        TelemetryFault::ShiftedTime(shift) => {
            let (by, way) = (shift.unsigned_abs(), if *shift > 0 { "later" } else { "earlier" });
            format!("each image matches the slopes {by} {way} in the list")
        }
        TelemetryFault::OtherTime => "the slopes are in another order than the images".into(),
        TelemetryFault::Unrelated => {
            "no order, sign or time of the slopes makes them those of the images: they are of another night or sensor, or \
             the scene does not describe the images"
                .into()
        }
    }
}
