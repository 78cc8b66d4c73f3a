//! Remarks on an estimate: information that does not question the result.

use super::estimate::Estimate;
use super::policy::Policy;
use crate::Result;
use crate::modal::{DiversityProjection, ModelError, WithLeftOut};
use crate::scene::{Aperture, Method, Scene};
use crate::statics::{ErrorSource, Iteration};
use crate::telescope::{Diversity, Telescope};
use ndarray::Array2;

/// First sentence of the remark on the diversity.
pub(super) const ON_DIVERSITY: &str = "The NCPA depend on the scene's diversity.";

/// Remark on the diversity, which holds for every image of a scene: how an error of it changes the
/// NCPA.
pub(super) fn diversity_remark(diversity: &DiversityProjection, scene: &Scene) -> Option<String> {
    (diversity.is_spanned() && scene.tolerance.defocus_fraction == 0.0).then(|| {
        format!(
            "{ON_DIVERSITY} An error of 1 % of it changes them by {:.1} nm (tolerance.defocus_fraction includes such an error in the \
             error bars).",
            0.01 * diversity.rms_nm
        )
    })
}

/// Remark on pistons that one wavelength determines up to whole ones, where one is beyond a quarter
/// of the wavelength from the mean.
pub(super) fn modulo_wavelength_remark(estimate: &Estimate) -> Option<String> {
    let modal = estimate.modal().filter(|_| estimate.integers.is_empty())?;
    let wavelength_nm = modal.fitter.model().optics.parts().wavelength_nm;
    let pistons_nm = &estimate.modes.coefficients_nm[..modal.fitter.model().pistons()];
    let farthest = pistons_nm.iter().enumerate().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let (segment, nm) = farthest.filter(|(_, nm)| nm.abs() > wavelength_nm / 4.0)?;
    Some(format!(
        "Pistons are modulo the wavelength of {wavelength_nm:.0} nm, of which one wavelength does not show whole ones: those of \
         the smallest spread are given. Segment {segment} is {nm:.0} nm from the mean, farther than any other; a second wavelength ([[image.channel]]) \
         determines them."
    ))
}

/// Largest RMS difference of a pupil's amplitude, and of the diversity in waves, from their mirror
/// images at which a flipped image looks the same: below it noise hides the difference.
const MIRROR_TOLERANCE: f64 = 0.02;

/// Remark on the map of a pupil, finer than the default of `pupil.samples`, whose samples are
/// averaged.
pub(super) fn averaged_pupil_remark(scene: &Scene, telescope: &Telescope) -> Option<String> {
    let (of_file, of_model) = (telescope.truth_samples(), telescope.pupil.grid.samples());
    let is_default = matches!(scene.pupil.aperture, Aperture::File(_)) && !scene.names("pupil.samples");
    (is_default && of_file > of_model).then(|| {
        format!(
            "The pupil's map has {of_file} samples a side, which are averaged to {of_model}, the default of pupil.samples: \
             {of_file} uses them as they are, at the cost of time."
        )
    })
}

/// Remark on segments that the scene has without light: their error bars are those of nothing.
pub(super) fn dark_segments_remark(scene: &Scene) -> Option<String> {
    let dark = &scene.pupil.dark_segments;
    let labels = scene.pupil.segment_labels.as_ref().map(|labels| {
        let of_dark = dark.iter().filter_map(|number| labels.get(*number as usize));
        format!(", with the labels {}", of_dark.collect::<Vec<_>>().join(", "))
    });
    (!dark.is_empty()).then(|| {
        format!(
            "No image shows the segments without light (pupil.dark_segments = {dark:?}{}): 0 stands for their modes, whose error bars in \
             the tables say nothing.",
            labels.unwrap_or_default()
        )
    })
}

/// Remark on the orientation of the images: where pupil and diversity equal their mirror images a
/// flipped image is that of the flipped wavefront. The image of A·exp(−i(W + d)), with the opposite
/// wavefront and diversity, is the turned one of A·exp(i(W + d)) for any pupil A.
///
/// # Errors
/// Those of reading the diversity.
pub(super) fn orientation_remark(scene: &Scene, telescope: &Telescope) -> Result<Option<String>> {
    let pupil = &telescope.pupil;
    // A focus equals its mirror images.
    let map = scene.image.diversity_file.as_ref().map(|_| Diversity::new(scene, telescope)).transpose()?;
    let (grid, last) = (&pupil.grid, pupil.grid.samples() - 1);
    let waves = |y: usize, x: usize| {
        let nm = map.as_ref().map_or(0.0, |map| map.at(grid.coordinate_m(x), grid.coordinate_m(y)));
        nm / scene.image.wavelength_nm
    };
    let is_symmetric = |[flip_x, flip_y]: [bool; 2]| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for ((y, x), &amplitude) in pupil.amplitude.indexed_iter() {
            let (v, u) = (if flip_y { last - y } else { y }, if flip_x { last - x } else { x });
            let other = pupil.amplitude[[v, u]];
            sum += (amplitude - other).powi(2) + amplitude * other * (waves(y, x) - waves(v, u)).powi(2);
            weight += amplitude;
        }
        sum < MIRROR_TOLERANCE.powi(2) * weight
    };
    let is_turned_equal = is_symmetric([true, true]);
    let is_flipped_equal = [[true, false], [false, true]].into_iter().any(is_symmetric);
    // A point-symmetric pupil with an even diversity has the same image with the opposite diversity
    // and the wavefront −W(−x, −y).
    let has_diversity = map.is_some() || scene.image.diversity_focus_waves_rms != 0.0;
    let sign = match (has_diversity, is_turned_equal) {
        (false, _) => None,
        (true, true) => Some("Nor can the sign of the diversity: with the opposite one the maps are −W(−x, −y)"),
        (true, false) => Some(TURNED),
    };
    Ok(match (is_turned_equal || is_flipped_equal, sign) {
        (true, Some(sign)) => Some(format!("{} {sign}.", flipped())),
        (true, None) => Some(flipped()),
        (false, sign) => sign.map(|sign| format!("{sign} ({POKE}).")),
    })
}

/// Where an unknown orientation is found.
const POKE: &str = "'cophase check --before' finds it from a known poke of a segment or an actuator";
/// Beginning of the sentence that no image of one star shows a flip.
const FLIPPED: &str = "The orientation cannot be verified from these images";
/// What holds for every image of a star.
const TURNED: &str = "Images turned by 180° would fit with the opposite diversity, and the maps −W(x, y): the sign of the maps is that of \
     the scene's orientation and diversity together";

fn flipped() -> String {
    format!(
        "{FLIPPED}: flipped ones would fit as well, with maps that are flipped ({POKE}; image.flip_x and image.flip_y set it)."
    )
}

/// Whether a remark is an [`orientation_remark`].
pub(super) fn is_on_orientation(remark: &str) -> bool {
    remark.starts_with(FLIPPED) || remark.starts_with(TURNED)
}

/// The [`orientation_remark`] of images of several channels, from those of each: together they show
/// what one of them shows.
pub(super) fn common_orientation_remark(each: &[Option<&str>]) -> Option<String> {
    let is_flipped = |remark: &Option<&str>| remark.is_some_and(|remark| remark.starts_with(FLIPPED));
    let first = each.first()?;
    if each.iter().all(|remark| remark == first) {
        return first.map(str::to_owned);
    }
    if each.iter().all(is_flipped) {
        return Some(format!("{} {TURNED}.", flipped()));
    }
    Some(format!("{TURNED} ({POKE})."))
}

/// Remark on images without telemetry, whose slopes (`[image, slope]`) are NaN.
pub(super) fn missing_telemetry_remark(slopes_mas: &Array2<f64>) -> Option<String> {
    let missing = slopes_mas.outer_iter().filter(|row| row.iter().all(|mas| mas.is_nan())).count();
    (missing > 0).then(|| {
        let images = slopes_mas.nrows();
        format!(
            "{missing} of {images} images have no telemetry: they determine the segments, the others the NCPA, too."
        )
    })
}

/// Remarks on tilts of the segments in a MAP estimate, whose last iteration is `last`: that they
/// were added to the model, and what images behind a loop do not show of them.
pub(super) fn segment_tilts_remarks(last: &Iteration) -> Vec<String> {
    let added = last.segment_tilts.filter(|_| last.has_tilts()).map(|tilts| {
        format!(
            "The model was extended by tip and tilt of each segment: each lowers the χ² of the mean wavefront by {:.1}, where \
             turbulence explains 1 (estimate.model = \"scene\" keeps that of the scene).",
            tilts.chi2
        )
    });
    let compensated_nm = last.error_budget.term_nm(ErrorSource::CompensatedSegments)[0];
    let unseen = (compensated_nm > last.error_budget.averaged_nm()[0]).then(|| {
        format!(
            "The error bars of the phasing include {compensated_nm:.0} nm of smooth shapes of many segments, which the loop compensates: they \
             are in no image, and no number of images determines them. Behind the loop {:.1} nm remain.",
            last.error_budget.averaged_nm()[0]
        )
    });
    added.into_iter().chain(unseen).collect()
}

/// Size of what was left out that is shown with one digit.
const LEAST_SIZE: f64 = 0.05;

/// What the modes leave out, and errors within their tolerances, where the images show any.
pub(super) fn left_out_remarks(left_out: &WithLeftOut) -> Vec<String> {
    let seen = left_out.terms.iter().filter(|term| term.size >= LEAST_SIZE);
    let sizes: Vec<String> = seen.map(|term| format!("{} {:.1} {}", term.name, term.size, term.unit)).collect();
    let of_modes = (!sizes.is_empty()).then(|| {
        format!(
            "Not fitted, but in the maps and the error bars, with the RMS that the images show: {}.",
            sizes.join(", ")
        )
    });
    let sentence = |error: &ModelError| {
        format!("The images show an error within its tolerance, which the error bars hold: {error}.")
    };
    of_modes.into_iter().chain(left_out.shown_errors(false).map(sentence)).collect()
}

/// Remark on a modal estimate of `scene` whose error bars hold no more than the noise.
pub(super) fn noise_alone_remark(scene: &Scene, policy: &Policy) -> Option<String> {
    let reason = if scene.estimate.method == Method::FullPhase {
        return None;
    } else if scene.estimate.posterior == Some(false) {
        "estimate.posterior = false"
    } else if !scene.estimate.has_posterior() {
        "weights that are not those of the noise"
    } else if !policy.prior_modes {
        "a policy without further modes"
    } else {
        return None;
    };
    Some(format!(
        "The error bars hold the noise, and not what the modes leave out of the wavefront and of the camera ({reason})."
    ))
}
