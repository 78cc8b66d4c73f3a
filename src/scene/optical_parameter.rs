//! An optical parameter of the scene that images determine.

use super::{Optic, Scene};

/// An optical parameter that was fitted together with the modes, or searched for.
#[derive(Debug, Clone, PartialEq)]
pub struct OpticalParameter {
    /// What it is, or belongs to.
    pub optic: Optic,
    /// Key of the scene, or `reflectivity N` of segment N, from 0.
    pub key: String,
    /// The segment whose reflectivity it is, from 0; `None` for a number of the scene.
    pub segment: Option<usize>,
    /// Value in the scene, in the unit of the key.
    pub scene: f64,
    /// Fitted value; where it is not identifiable, the scene's, or that of the last iteration in
    /// which it was.
    pub value: f64,
    /// Error bar, 1σ: infinite where the modes reproduce its effect, NaN where it is not known.
    pub sigma: f64,
    /// Share of the parameter's effect on the image that neither the modes nor other parameters
    /// reproduce; NaN where it is not known.
    pub identifiable: f64,
}

impl OpticalParameter {
    /// A number of the scene, of the unit of `key`, which is `value` in place of `scene`. Nothing
    /// is known of its error.
    pub(crate) fn of_key(optic: Optic, key: &str, [scene, value]: [f64; 2]) -> Self {
        Self { optic, key: key.into(), segment: None, scene, value, sigma: f64::NAN, identifiable: f64::NAN }
    }

    /// The reflectivity of `segment`, which is 1 in a scene.
    pub(crate) fn of_segment(segment: usize, value: f64, sigma: f64, identifiable: f64) -> Self {
        let key = format!("reflectivity {segment}");
        Self { optic: Optic::REFLECTIVITIES, key, segment: Some(segment), scene: 1.0, value, sigma, identifiable }
    }

    /// With the error bar and the share of its effect that is its own.
    pub(crate) fn with_error(self, sigma: f64, identifiable: f64) -> Self {
        Self { sigma, identifiable, ..self }
    }

    /// Whether the images distinguish it from the modes.
    pub fn is_identifiable(&self) -> bool {
        !self.sigma.is_infinite()
    }

    /// Takes the key and the unit by which `scene` names the quantity.
    pub(crate) fn take_form_of(&mut self, scene: &Scene) {
        let own = |value: f64| scene.own_form(&self.key, value);
        let (key, value) = own(self.value);
        if key != self.key {
            let [of_scene, beyond] = [self.scene, self.value + self.sigma].map(|value| own(value).1);
            let sigma = if self.sigma.is_finite() { (beyond - value).abs() } else { self.sigma };
            (self.key, self.value, self.scene, self.sigma) = (key, value, of_scene, sigma);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fitted_defocus_has_the_unit_of_the_scene() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let key = "image.diversity_focus_waves_rms";
        let waves = || OpticalParameter::of_key(Optic::DEFOCUS, key, [1.5, 1.47]).with_error(0.001, 0.1);
        let mut same = waves();
        same.take_form_of(&scene);
        assert_eq!(same, waves());
        let mut converted = waves();
        // 1.5 waves of 2168.6 nm.
        converted.take_form_of(&scene.with(&[("image.diversity_focus_nm_rms", "3252.9")]).unwrap());
        let OpticalParameter { key, scene, value, sigma, .. } = &converted;
        assert_eq!(key, "image.diversity_focus_nm_rms");
        for (found, expected) in [(scene, 1.5), (value, 1.47), (sigma, 0.001)] {
            assert!((found / 2168.6 - expected).abs() < 1e-9 * expected, "{converted:?}");
        }
    }
}
