//! A value in the form in which a scene has its quantity.

use super::Scene;
use super::forms::{FOCUS, SAMPLING};

impl Scene {
    /// The key by which this scene names the quantity of `key`, and `value` in its unit: a sampling
    /// of 2 is `image.pixel_mas = 9.95` in a scene that names a pixel in milliarcseconds. A key of
    /// another quantity, or of one that the scene does not name, is returned unchanged. A pixel is
    /// inversely proportional to the sampling, a defocus proportional to that in waves; a defocus
    /// of 0 has no ratio.
    pub(crate) fn own_form(&self, key: &str, value: f64) -> (String, f64) {
        let image = &self.image;
        let own = key.strip_prefix("image.");
        let converted = if own == Some(SAMPLING[0]) {
            image.named_sampling().map(|(name, now)| (name, now * image.samples_per_lambda_over_d / value))
        } else if own == Some(FOCUS[0]) {
            image.named_focus().map(|(name, now)| (name, now * value / image.diversity_focus_waves_rms))
        } else {
            None
        };
        match converted.filter(|(_, value)| value.is_finite()) {
            Some((name, value)) => (format!("image.{name}"), value),
            None => (key.to_string(), value),
        }
    }

    /// The key of the focal length of a scene whose pixel is a pitch, its value, and whether the
    /// defocus of the scene depends on it, too.
    pub(crate) fn focal_form(&self) -> Option<(&'static str, f64, bool)> {
        let image = &self.image;
        image.pixel_pitch_um?;
        let (name, value) = image.named_focal()?;
        Some((name, value, image.diversity_stage_mm.is_some()))
    }
}

/// `value` to seven significant digits.
pub(crate) fn rounded(value: f64) -> f64 {
    format!("{value:.6e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_takes_the_form_of_the_scene() {
        let scene = |keys: &[(&str, &str)]| Scene::preset("keck-artificial").unwrap().with(keys).unwrap();
        let plain = scene(&[]);
        for key in ["image.samples_per_lambda_over_d", "image.diversity_focus_waves_rms", "pupil.rotation_deg"] {
            assert_eq!(plain.own_form(key, 1.25), (key.to_string(), 1.25));
        }
        // The scene that has the converted value has the value of the key that everything reads.
        for (key, now, read, value) in [
            ("image.pixel_mas", "10", "image.samples_per_lambda_over_d", 2.5),
            ("image.pixel_arcsec", "0.01", "image.samples_per_lambda_over_d", 2.5),
            ("image.diversity_focus_nm_rms", "-2000", "image.diversity_focus_waves_rms", 0.75),
            ("image.diversity_focus_waves_pv", "5", "image.diversity_focus_waves_rms", -1.5),
        ] {
            let own = scene(&[(key, now)]);
            let (name, converted) = own.own_form(read, value);
            assert_eq!(name, key);
            let image = own.with(&[(&name, &converted.to_string())]).unwrap().image.clone();
            let found = [image.samples_per_lambda_over_d, image.diversity_focus_waves_rms];
            assert!(found.iter().any(|found| (found / value - 1.0).abs() < 1e-12), "{key}: {found:?}");
        }
    }
}
