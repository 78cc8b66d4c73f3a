//! Keys of a scene that describe the instrument behind an image: two scenes of one image agree in them.

use crate::scene::Scene;

/// Value of a key.
#[derive(PartialEq)]
enum Value {
    Number(f64),
    Numbers(Vec<f64>),
    Flag(bool),
}

impl Value {
    /// In the syntax of TOML.
    fn text(&self) -> String {
        match self {
            Self::Number(number) => number.to_string(),
            Self::Numbers(numbers) => format!("{numbers:?}"),
            Self::Flag(flag) => flag.to_string(),
        }
    }

    /// Equality up to the rounding of a number that is written with seven digits: a millionth of the scale is no pixel in any image.
    fn agrees(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Number(a), Self::Number(b)) => (a - b).abs() <= 1e-6 * a.abs().max(b.abs()),
            _ => self == other,
        }
    }
}

/// Values of the keys that describe the instrument. Keys that do not apply, such as hexagons where the pupil comes from a file,
/// are left out; what a file holds is not compared.
fn values(scene: &Scene) -> Vec<(&'static str, Value)> {
    use Value::{Flag, Number, Numbers};
    let (pupil, image) = (&scene.pupil, &scene.image);
    let mut values = vec![
        ("image.wavelength_nm", Number(image.wavelength_nm)),
        ("image.samples_per_lambda_over_d", Number(image.samples_per_lambda_over_d)),
        ("image.pixel_fill", Number(image.pixel_fill)),
        ("image.charge_diffusion_pixels", Number(image.charge_diffusion_pixels)),
    ];
    if image.filter_file.is_none() {
        values.push(("image.bandwidth_fraction", Number(image.bandwidth_fraction)));
    }
    values.extend(image.star_temperature_k.map(|kelvin| ("image.star_temperature_k", Number(kelvin))));
    if image.diversity_file.is_none() {
        values.push(("image.diversity_focus_waves_rms", Number(image.diversity_focus_waves_rms)));
    }
    let Some(extent_m) = pupil.extent_m() else { return values };
    values.extend([
        ("pupil.rings", Number(pupil.rings as f64)),
        ("pupil.removed_rings", Number(pupil.removed_rings as f64)),
        ("pupil.segment_side_m", Number(pupil.segment_side_m)),
        ("pupil.segment_gap_m", Number(pupil.segment_gap_m)),
        ("pupil.central_segment", Flag(pupil.central_segment)),
        ("pupil.central_obscuration_m", Number(pupil.central_obscuration_m)),
        ("pupil.spider_width_m", Number(pupil.spider_width_m)),
        ("pupil.rotation_deg", Number(pupil.rotation_deg)),
        ("pupil.grid_m", Number(pupil.grid_m.unwrap_or(extent_m))),
    ]);
    values.extend(pupil.outer_radius_m.map(|radius_m| ("pupil.outer_radius_m", Number(radius_m))));
    if pupil.spider_width_m > 0.0 {
        let vanes = pupil.spider_vanes_deg.clone().map(|vanes| ("pupil.spider_vanes_deg", Numbers(vanes)));
        values.push(vanes.unwrap_or_else(|| ("pupil.spider_angles_deg", Numbers(pupil.spider_angles_deg.clone()))));
    }
    values
}

/// Keys in which the scene of an image file differs from `scene`, with the file's value and the scene's. A key that only one of
/// them has, because the other reads a map from a file, is no difference.
pub(super) fn differences(of_file: &Scene, scene: &Scene) -> Vec<(&'static str, String, String)> {
    let ours = values(scene);
    let both = values(of_file).into_iter().filter_map(|(key, theirs)| {
        let (_, ours) = ours.iter().find(|(known, _)| *known == key)?;
        (!theirs.agrees(ours)).then(|| (key, theirs.text(), ours.text()))
    });
    both.collect()
}

/// Whether `estimate.fit_optics` fits `key`, whose value is then a start.
pub(super) fn is_fitted(scene: &Scene, key: &str) -> bool {
    scene.estimate.fit_optics.iter().any(|optic| optic.key() == Some(key))
}
