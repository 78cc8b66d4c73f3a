//! Keys of a scene that describe the instrument behind an image: two scenes of one image agree in
//! them.

use crate::scene::{Scene, Setting, SettingValue};

/// Key of the side of the pupil's grid, by default the pupil's width.
const GRID: &str = "pupil.grid_m";

/// Equality up to the rounding of a number that is written with seven digits: a millionth of the
/// scale is no pixel in any image.
fn agrees(one: &SettingValue, other: &SettingValue) -> bool {
    match (one.number(), other.number()) {
        (Some(a), Some(b)) => (a - b).abs() <= 1e-6 * a.abs().max(b.abs()),
        _ => one == other,
    }
}

/// Values of the keys that describe the instrument. Keys that do not apply, such as hexagons where
/// the pupil comes from a file, are left out; what a file holds is not compared.
fn values(scene: &Scene) -> Vec<Setting> {
    let (pupil, image) = (&scene.pupil, &scene.image);
    let mut keys = vec![
        "image.wavelength_nm",
        "image.samples_per_lambda_over_d",
        "image.pixel_fill",
        "image.charge_diffusion_pixels",
    ];
    if image.filter_file.is_none() {
        keys.push("image.bandwidth_fraction");
    }
    keys.push("image.star_temperature_k");
    if image.diversity_file.is_none() {
        keys.push("image.diversity_focus_waves_rms");
    }
    let extent_m = pupil.extent_m();
    if extent_m.is_some() {
        keys.extend([
            "pupil.rings",
            "pupil.removed_rings",
            "pupil.segment_side_m",
            "pupil.segment_gap_m",
            "pupil.central_segment",
            "pupil.central_obscuration_m",
            "pupil.spider_width_m",
            "pupil.dark_segments",
            "pupil.stop_diameter_m",
            "pupil.stop_x_m",
            "pupil.stop_y_m",
            "pupil.rotation_deg",
            GRID,
            "pupil.outer_radius_m",
        ]);
        if pupil.spider_width_m > 0.0 {
            let has_vanes = pupil.spider_vanes_deg.is_some();
            keys.push(if has_vanes { "pupil.spider_vanes_deg" } else { "pupil.spider_angles_deg" });
        }
    }
    let of_extent = |key| extent_m.filter(|_| key == GRID).map(|extent_m| Setting::new(key, extent_m));
    keys.into_iter().filter_map(|key| scene.setting(key).or_else(|| of_extent(key))).collect()
}

/// Keys in which the scene of an image file differs from `scene`, with the scene's value and the
/// file's. A key that only one of them has, because the other reads a map from a file, is no
/// difference.
pub(super) fn differences(scene: &Scene, of_file: &Scene) -> Vec<[Setting; 2]> {
    let ours = values(scene);
    let both = values(of_file).into_iter().filter_map(|theirs| {
        let ours = ours.iter().find(|ours| ours.key() == theirs.key())?;
        (!agrees(theirs.value(), ours.value())).then(|| [ours.clone(), theirs])
    });
    both.collect()
}

/// Whether `estimate.fit_optics` fits `key`, whose value is then a start.
pub(super) fn is_fitted(scene: &Scene, key: &str) -> bool {
    scene.estimate.fit_optics.iter().any(|optic| optic.key() == Some(key))
}
