//! Filter of a scene with the light of its star: the wavelengths of the photons that its camera
//! detects.
//!
//! | scene | light |
//! |---|---|
//! | neither `bandwidth_fraction` nor `filter_file` | one wavelength |
//! | `bandwidth_fraction` | a top hat, the same number of photons at each wavelength |
//! | `filter_file` | its curve, of a star with the same number of photons at each wavelength |
//! | either with `star_temperature_k` | the same, times the photons of a black body |
//!
//! Simulators and models sample it by Gauss quadrature, each with its own number of wavelengths.

use super::band::{band, wavelengths_to};
use super::diversity::Diversity;
use super::filter_file;
use super::model::Telescope;
use super::spectrum::Spectrum;
use crate::scene::System;
use crate::{Error, Result};

/// Largest width of a curve relative to `image.wavelength_nm`: twice that of a top hat, for a leak
/// far from the filter. Beyond it a model would need more wavelengths than it can have.
const MAX_WIDTH: f64 = 1.0;

/// Light of a scene's camera. Wavelengths are ratios to `image.wavelength_nm`.
#[derive(Debug, Clone)]
pub struct Filter {
    light: Light,
}

#[derive(Debug, Clone)]
enum Light {
    /// All wavelengths within this width are alike; 0 for one wavelength.
    TopHat(f64),
    /// Any other, with `image.wavelength_nm`.
    Spectrum(Spectrum, f64),
}

impl Filter {
    /// Filter and star of `scene`.
    ///
    /// # Errors
    /// [`Error::File`] for `image.filter_file` if it cannot be read, is not a table, or does not
    /// pass `image.wavelength_nm`.
    pub fn new(scene: &System) -> Result<Self> {
        let image = &scene.image;
        let (width, reference_nm) = (image.bandwidth_fraction, image.wavelength_nm);
        let Some(file) = &image.filter_file else {
            let star = image.star_temperature_k.filter(|_| width > 0.0);
            return Ok(star.map_or(Self::top_hat(width), |star| {
                let rows = [-0.5, 0.5].map(|end| (reference_nm * (1.0 + end * width), 1.0));
                Self { light: Light::Spectrum(Spectrum::new(rows.to_vec(), Some(star)), reference_nm) }
            }));
        };
        let path = scene.resolve(file);
        let spectrum = Spectrum::new(filter_file::read(&path)?, image.star_temperature_k);
        let [shortest_nm, longest_nm] = spectrum.range_nm();
        if !(shortest_nm..=longest_nm).contains(&reference_nm) {
            return Err(Error::file(
                path,
                format_args!(
                    "image.wavelength_nm = {reference_nm} is outside of its light, {shortest_nm} to {longest_nm} nm; a table of \
                     wavelengths in nm (10 Å are 1 nm) around image.wavelength_nm is needed"
                ),
            ));
        }
        let width = (longest_nm - shortest_nm) / reference_nm;
        if width > MAX_WIDTH {
            return Err(Error::file(
                path,
                format_args!(
                    "its light, {shortest_nm} to {longest_nm} nm, is {width:.2} times as wide as image.wavelength_nm = \
                     {reference_nm}; at most {MAX_WIDTH} is accepted"
                ),
            ));
        }
        Ok(Self { light: Light::Spectrum(spectrum, reference_nm) })
    }

    /// Filter of this width relative to its wavelength, within which all wavelengths are alike; 0
    /// for one wavelength.
    pub fn top_hat(width: f64) -> Self {
        Self { light: Light::TopHat(width) }
    }

    /// Whether the light has one wavelength.
    pub fn is_monochromatic(&self) -> bool {
        matches!(self.light, Light::TopHat(0.0))
    }

    /// Shortest and longest wavelength.
    pub fn range(&self) -> [f64; 2] {
        match &self.light {
            Light::TopHat(width) => [1.0 - 0.5 * width, 1.0 + 0.5 * width],
            Light::Spectrum(spectrum, reference_nm) => spectrum.range_nm().map(|nm| nm / reference_nm),
        }
    }

    /// Width from the shortest to the longest wavelength. With it the number of wavelengths of a
    /// curve follows the rule of the top hat (`wavelengths_to` in `band.rs`): the mean of a
    /// polynomial of degree 2K − 1 is exact for both, and the mean of what remains of cos and sin
    /// is at most the largest remainder over that width. A width by the standard deviation is too
    /// small: with a core and wings its nodes are spread over the wings, and for a Gaussian the
    /// mean is wrong by up to 1.
    pub fn width(&self) -> f64 {
        match &self.light {
            Light::TopHat(width) => *width,
            Light::Spectrum(..) => {
                let [shortest, longest] = self.range();
                longest - shortest
            }
        }
    }

    /// Mean wavelength of the photons.
    ///
    /// # Errors
    /// Those of [`Filter::wavelengths`].
    pub fn mean(&self) -> Result<f64> {
        match &self.light {
            Light::TopHat(_) => Ok(1.0),
            Light::Spectrum(..) => Ok(self.wavelengths(1)?.iter().map(|(ratio, share)| ratio * share).sum()),
        }
    }

    /// Gauss quadrature with at most `count` wavelengths, each with its share of the photons; the
    /// shares sum to 1. One wavelength is the mean.
    ///
    /// # Errors
    /// [`Error::Internal`] where the eigenvalues of the quadrature do not converge.
    pub fn wavelengths(&self, count: usize) -> Result<Vec<(f64, f64)>> {
        match &self.light {
            Light::TopHat(width) => Ok(band(*width, count)),
            Light::Spectrum(spectrum, reference_nm) => {
                let nodes = spectrum.quadrature(count)?;
                Ok(nodes.into_iter().map(|(nm, share)| (nm / reference_nm, share)).collect())
            }
        }
    }

    /// Number of wavelengths for the spot of `scene`: the error is a thousandth of the effect of
    /// the filter's width. 1 for a monochromatic scene.
    pub(crate) fn wavelengths_needed(&self, scene: &System, telescope: &Telescope, diversity: &Diversity) -> usize {
        wavelengths_to(diversity.spot(&telescope.pupil, scene.image.wavelength_nm), self.width())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use std::path::Path;

    fn keck(settings: &[(&str, &str)]) -> Scene {
        Scene::preset("keck-artificial").unwrap().with(settings).unwrap()
    }

    #[test]
    fn a_wider_filter_needs_more_wavelengths() {
        let count = |width: &str| {
            let scene = keck(&[("image.bandwidth_fraction", width)]);
            let telescope = Telescope::new(&scene).unwrap();
            let diversity = Diversity::new(&scene, &telescope).unwrap();
            Filter::new(&scene).unwrap().wavelengths_needed(&scene, &telescope, &diversity)
        };
        // A spot between 20 and 25 λ/D: 2 + 0.6 to 0.75, 2 + 2 to 2.5, 2 + 8 to 10, each rounded
        // up.
        assert_eq!(["0", "0.015", "0.05"].map(count), [1, 3, 5]);
        assert!((11..=12).contains(&count("0.2")), "{}", count("0.2"));
    }

    #[test]
    fn without_the_keys_the_nodes_are_those_of_gauss_and_legendre() {
        for (width, count) in [(0.0, 1), (0.015, 3), (0.2, 12)] {
            let filter = Filter::new(&keck(&[("image.bandwidth_fraction", &f64::to_string(&width))])).unwrap();
            assert_eq!(filter.wavelengths(count).unwrap(), band(width, count));
            assert_eq!((filter.width(), filter.mean().unwrap()), (width, 1.0));
        }
        // A star has no effect on one wavelength.
        assert!(Filter::new(&keck(&[("image.star_temperature_k", "3000")])).unwrap().is_monochromatic());
    }

    #[test]
    fn a_spectrum_has_enough_nodes_at_the_rim_of_the_spot() {
        let gaussian: Vec<(f64, f64)> =
            (-100..=100).map(|i| (2000.0 + 2.0 * f64::from(i), (-0.5 * (0.05 * f64::from(i)).powi(2)).exp())).collect();
        let curves = [
            vec![(1900.0, 0.0), (2100.0, 1.0)],
            vec![(1900.0, 0.0), (2000.0, 1.0), (2100.0, 0.0)],
            vec![(1900.0, 1.0), (1920.0, 1.0), (1921.0, 0.0), (2050.0, 0.0), (2051.0, 1.0), (2100.0, 1.0)],
            vec![(1900.0, 0.01), (1979.0, 0.01), (1980.0, 1.0), (2020.0, 1.0), (2021.0, 0.01), (2100.0, 0.01)],
            gaussian,
        ];
        for (number, rows) in curves.into_iter().enumerate() {
            for star in [None, Some(4000.0)] {
                let whole = Spectrum::new(rows.clone(), star);
                let filter = Filter { light: Light::Spectrum(whole, 2000.0) };
                // The truth: as many nodes as make the phase from one to the next small.
                let fine = filter.wavelengths(200).unwrap();
                for step in 1..=60 {
                    let reach = 2.0 * f64::from(step);
                    let nodes = filter.wavelengths(wavelengths_to(reach, filter.width())).unwrap();
                    let mean = |nodes: &[(f64, f64)]| {
                        let turn = |ratio: f64| std::f64::consts::TAU * reach * (ratio - 1.0);
                        let sum = |f: fn(f64) -> f64| nodes.iter().map(|(r, s)| s * f(turn(*r))).sum::<f64>();
                        (sum(f64::cos), sum(f64::sin))
                    };
                    let (found, known) = (mean(&nodes), mean(&fine));
                    let error = (found.0 - known.0).hypot(found.1 - known.1);
                    assert!(error < 2e-3, "curve {number}, {star:?}, {reach} λ/D: {error:.1e}");
                }
            }
        }
    }

    #[test]
    fn a_curve_that_is_not_around_the_wavelength_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let filter = |table: &str| {
            std::fs::write(folder.path().join("k.txt"), table).unwrap();
            let scene = keck(&[("image.filter_file", "k.txt")]);
            Filter::new(&Scene::from_text(scene.text(), folder.path()).unwrap())
        };
        let sentence = |table: &str| filter(table).unwrap_err().to_string();
        let mean = filter("2100 1\n2200 1\n").unwrap().mean().unwrap();
        assert!((mean - 2150.0 / 2168.6).abs() < 1e-14, "{mean}");
        let angstrom = sentence("21000 1\n22000 1\n");
        for words in ["k.txt", "image.wavelength_nm = 2168.6", "21000 to 22000 nm", "10 Å are 1 nm"] {
            assert!(angstrom.contains(words), "{angstrom}");
        }
        // Where its light is, not where the table ends.
        assert!(sentence("1000 0\n1500 0\n1600 1\n1700 0\n3000 0\n").contains("1500 to 1700 nm"));
        assert!(sentence("1000 1\n4000 1\n").contains("1.38 times as wide"));
        let missing = Scene::from_text(keck(&[("image.filter_file", "none.txt")]).text(), Path::new("")).unwrap();
        let sentence = Filter::new(&missing).unwrap_err().to_string();
        assert!(sentence.contains("none.txt") && sentence.contains("image.filter_file"), "{sentence}");
    }
}
