//! Sampling of a retrieval: field of view of the crop, samples over the pupil, and the highest
//! spatial frequency that both resolve.
//!
//! The edges of segments distinguish pistons from smooth aberrations. A ripple of f cycles over the
//! pupil diffracts copies of the defocused spot f λ/D to either side: an image resolves it as long
//! as a part of the copy lands on its pixels.

use crate::Result;
use crate::fourier::fast_side;
use crate::modal::{ABERRATION_CYCLES, LEAST_HALF_WIDTH, Model, SPOT_MARGIN};
use crate::scene::{Crop, PupilModel, System};
use crate::telescope::{Diversity, Telescope};

/// Margin on each side, in cycles: samples around the pupil and the bandwidth of the aberrations
/// together.
const MARGIN: f64 = 8.0;

/// Computes the half-width of the defocused spot, λ over the grid's width.
fn spot(scene: &System, telescope: &Telescope) -> Result<f64> {
    Ok(Diversity::new(scene, telescope)?.spot(&telescope.pupil, scene.image.wavelength_nm))
}

/// `scene` with the pixels and samples that resolve `cycles` across a segment, where it leaves them
/// open.
///
/// # Errors
/// Those of the diversity.
pub(super) fn with_retrieval_sampling(scene: &System, telescope: &Telescope, cycles: f64) -> Result<System> {
    let image = &scene.image;
    let (rows, columns) = image.fitted_shape();
    let larger = rows.max(columns);
    let areas_m2 = telescope.pupil.segment_areas();
    let segment_m = (areas_m2.iter().sum::<f64>() / areas_m2.len() as f64).sqrt();
    let spot = spot(scene, telescope)?;
    let field = cycles / segment_m * telescope.pupil.grid.width_m() - spot;
    let wanted = field.max(spot + SPOT_MARGIN).max(LEAST_HALF_WIDTH);
    let native = 8 * (2.0 * image.samples_per_lambda_over_d * wanted / 8.0).ceil() as usize;
    let pixels = match image.crop_pixels {
        Crop::Auto => native.min(larger / 2 * 2),
        Crop::Pixels(pixels) => pixels,
    };
    let half_width = pixels as f64 / (2.0 * image.samples_per_lambda_over_d);
    let own = scene.estimate.samples.unwrap_or(scene.pupil.samples);
    let free = scene.estimate.samples.is_none()
        && telescope.is_fine()
        && scene.pupil.model.is_none_or(|model| model == PupilModel::BandLimited);
    // A pupil map is to be twice as fine as the model made from it.
    let finest = telescope.truth_samples() / 2;
    let samples = fast_side((2.0 * (half_width + spot + MARGIN)).ceil() as usize).min(finest / 2 * 2).max(own);
    scene.with(|sections| {
        sections.image.crop_pixels = Crop::Pixels(pixels);
        if free {
            sections.estimate.samples = Some(samples);
        }
    })
}

/// The `scenes` of the channels of one telescope with the pixels that each needs, and the samples
/// of the pupil that the finest needs; and the pass band of the pupil that all need, cycles, with
/// which their wavefronts are on the same samples.
///
/// # Errors
/// Those of the diversity.
pub(super) fn with_common_sampling(
    scenes: &[System],
    telescope: &Telescope,
    cycles: f64,
) -> Result<(Vec<System>, f64)> {
    let each = scenes.iter().map(|scene| with_retrieval_sampling(scene, telescope, cycles));
    let scenes = each.collect::<Result<Vec<_>>>()?;
    let (mut samples, mut pass_cycles) = (None, 0.0f64);
    for scene in &scenes {
        let Crop::Pixels(pixels) = scene.image.crop_pixels else { continue };
        let half_width = pixels as f64 / (2.0 * scene.image.samples_per_lambda_over_d);
        samples = samples.max(scene.estimate.samples);
        pass_cycles = pass_cycles.max(half_width + spot(scene, telescope)? + ABERRATION_CYCLES);
    }
    if samples.is_none() {
        return Ok((scenes, pass_cycles));
    }
    let scenes = scenes.iter().map(|scene| scene.with(|sections| sections.estimate.samples = samples));
    Ok((scenes.collect::<Result<_>>()?, pass_cycles))
}

/// Computes the highest spatial frequency that images of `model` resolve, 1/m.
///
/// # Errors
/// Those of the diversity.
pub(super) fn highest_frequency_per_m(scene: &System, model: &Model) -> Result<f64> {
    let (sampling, width_m) = (model.optics.sampling(), model.telescope.pupil.grid.width_m());
    let (model_width_m, samples) = (model.width_ratio() * width_m, sampling.samples as f64);
    let half_width = sampling.pixels as f64 / (2.0 * sampling.pixels_per_lambda_over_d);
    let resolved_per_m = half_width / model_width_m + spot(scene, &model.telescope)? / width_m;
    Ok(resolved_per_m.min(0.5 * samples / model_width_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    fn sizes(settings: &[(&str, &str)]) -> (Option<usize>, Crop) {
        let scene = Scene::preset("keck-onsky").unwrap().with(settings).unwrap();
        let scene = with_retrieval_sampling(&scene, &Telescope::new(&scene).unwrap(), 8.0).unwrap();
        (scene.estimate.samples, scene.image.crop_pixels)
    }

    #[test]
    fn samples_and_pixels_left_open_follow_the_segments() {
        assert_eq!(sizes(&[]), (Some(144), Crop::Pixels(152)));
        assert_eq!(sizes(&[("estimate.samples", "120"), ("image.crop_pixels", "104")]), (Some(120), Crop::Pixels(104)));
        // Limited by the frame.
        assert_eq!(sizes(&[("image.pixels", "128")]).1, Crop::Pixels(128));
        // Large segments need few: the rest is the light around the spot, some 25 λ/D and 3 to
        // either side.
        let large = [("pupil.aperture", "hexagonal"), ("pupil.rings", "1"), ("pupil.segment_side_m", "2.0")];
        let (_, Crop::Pixels(pixels)) = sizes(&large) else { panic!("no crop") };
        assert!((104..=128).contains(&pixels), "{pixels}");
    }

    #[test]
    fn the_highest_frequency_is_that_of_the_copies_on_the_pixels() {
        let scene = Scene::preset("keck-onsky").unwrap().with(&[("image.crop_pixels", "152")]).unwrap();
        let scene = scene.with(&[("estimate.samples", "144")]).unwrap();
        let model = Model::new(&scene, &crate::modal::Recipe::from_scene(&scene), false).unwrap();
        let highest = highest_frequency_per_m(&scene, &model).unwrap();
        let spot = spot(&scene, &model.telescope).unwrap();
        assert!((highest - (38.0 + spot) / 11.25).abs() < 1e-9, "{highest}");
    }
}
