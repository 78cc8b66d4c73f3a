//! Pixel scale and defocus in an instrument's words, converted once to the keys that everything
//! else reads.
//!
//! With the side `L` of the pupil's grid (`pupil.grid_m`), the wavelength λ, and the focal length
//! `f = F·L` of the focal ratio `F`:
//!
//! * pixel of the angle θ: sampling λ/(L·θ); pixel of the pitch p: θ = p/f, sampling λ·F/p;
//! * focus `W(r) = a·r²` over the pupil: RMS |a|·σ, with σ the standard deviation of r² over the
//!   pupil (zero mean, weight A); peak to valley a·R² over the circle of radius R around the pupil,
//!   2√3·RMS for a full circle (Noll 1976, JOSA 66, 207);
//! * detector displaced along the axis by ΔL: a = ΔL/(2f²), so ΔL/(8F²) at the edge r = L/2
//!   (Goodman, Introduction to Fourier Optics, section 6.4, for ΔL ≪ f).

use super::pupil::PupilScene;
use super::sections::Sections;
use super::system::System;
use super::table::Reader;
use crate::Result;
use crate::hexagons::{Hexagon, HexagonLayout};

/// Ranges of the keys that the other forms are converted to.
const SAMPLINGS: std::ops::RangeInclusive<f64> = f64::MIN_POSITIVE..=64.0;
const WAVES: std::ops::RangeInclusive<f64> = -20.0..=20.0;

/// Milliarcseconds in a radian.
pub(crate) const MAS_PER_RADIAN: f64 = 180.0 / std::f64::consts::PI * 3.6e6;

impl Sections {
    /// Converts the other forms of the sampling and of the defocus to `samples_per_lambda_over_d`
    /// and `diversity_focus_waves_rms`.
    pub(super) fn convert_units<'r>(&mut self, reader: &dyn Fn(&'static str) -> Reader<'r>) -> Result<()> {
        let reader = reader("image");
        self.convert_sampling(&reader)?;
        self.convert_focus(&reader)
    }

    fn convert_sampling(&mut self, reader: &Reader) -> Result<()> {
        let image = &self.image;
        let Some((key, value)) = image.named_sampling() else { return Ok(()) };
        let lambda_m = image.wavelength_nm * 1e-9;
        let grid_m = || self.grid_m_for(reader, key, "samples_per_lambda_over_d");
        let sampling = match key {
            "pixel_mas" => lambda_m / grid_m()? * MAS_PER_RADIAN / value,
            "pixel_arcsec" => lambda_m / grid_m()? * MAS_PER_RADIAN / (1e3 * value),
            _ => lambda_m * self.focal_ratio(reader, key)? / (value * 1e-6),
        };
        if !SAMPLINGS.contains(&sampling) {
            let sentence = format!(
                "image.{key} = {value} is a sampling of {sampling:.4} pixels per λ/grid_m; above 0 and up to 64 is needed"
            );
            return Err(reader.error(key, sentence));
        }
        self.image.samples_per_lambda_over_d = sampling;
        self.image.check_sampling(reader)
    }

    fn convert_focus(&mut self, reader: &Reader) -> Result<()> {
        let image = &self.image;
        let Some((key, value)) = image.named_focus() else { return Ok(()) };
        let lambda_m = image.wavelength_nm * 1e-9;
        let shape = || {
            self.pupil.focus_shape().ok_or_else(|| {
                let sentence = format!(
                    "image.{key} = {value} needs hexagons, whose second moments are known; give diversity_focus_waves_rms or \
                     diversity_focus_nm_rms for a pupil from a file or an array"
                );
                reader.error(key, sentence)
            })
        };
        let waves = match key {
            "diversity_focus_waves_pv" => {
                let FocusShape { radius_m, spread_m2 } = shape()?;
                value * spread_m2 / radius_m.powi(2)
            }
            "diversity_focus_nm_rms" => value / image.wavelength_nm,
            _ => {
                let focal_m =
                    self.focal_ratio(reader, key)? * self.grid_m_for(reader, key, "diversity_focus_waves_rms")?;
                value * 1e-3 / (2.0 * focal_m.powi(2)) * shape()?.spread_m2 / lambda_m
            }
        };
        if !WAVES.contains(&waves) {
            let sentence =
                format!("image.{key} = {value} is a defocus of {waves:.4} waves RMS; from -20 to 20 is needed");
            return Err(reader.error(key, sentence));
        }
        self.image.diversity_focus_waves_rms = waves;
        Ok(())
    }

    /// Side of the pupil's grid, m, without which `key` cannot be converted.
    fn grid_m_for(&self, reader: &Reader, key: &str, instead: &str) -> Result<f64> {
        self.pupil.grid_m.or(self.pupil.extent_m()).ok_or_else(|| {
            reader.error(
                key,
                format!("image.{key} needs the width of the pupil; give pupil.grid_m, or {instead} in its place"),
            )
        })
    }

    /// Focal length over the side of the pupil's grid.
    fn focal_ratio(&self, reader: &Reader, key: &str) -> Result<f64> {
        match (self.image.focal_ratio, self.image.focal_length_m) {
            (Some(ratio), None) => Ok(ratio),
            (None, Some(focal_length_m)) => Ok(focal_length_m / self.grid_m_for(reader, key, "image.focal_ratio")?),
            (Some(ratio), Some(focal_length_m)) => {
                let sentence = format!(
                    "image.focal_ratio = {ratio} and image.focal_length_m = {focal_length_m} are two forms of one quantity: one of them \
                     is accepted"
                );
                Err(reader.error("focal_length_m", sentence))
            }
            (None, None) => Err(reader.error(
                key,
                format!(
                    "image.{key} needs image.focal_length_m, or image.focal_ratio, the focal length over pupil.grid_m; both are missing"
                ),
            )),
        }
    }
}

impl System {
    /// Side of the pupil's grid, m; `None` where arrays of a caller replace the scene's pupil.
    pub(crate) fn grid_m(&self) -> Option<f64> {
        self.pupil.grid_m.or(self.pupil.extent_m())
    }

    /// Pixel on the sky, mas: λ/grid_m over the sampling; `None` where arrays of a caller replace
    /// the scene's pupil.
    pub fn pixel_mas(&self) -> Option<f64> {
        let (grid_m, image) = (self.grid_m()?, &self.image);
        Some(image.wavelength_nm * 1e-9 / grid_m / image.samples_per_lambda_over_d * MAS_PER_RADIAN)
    }
}

/// Second moments of a pupil.
struct FocusShape {
    /// Radius of the circle around the pupil, m.
    radius_m: f64,
    /// Standard deviation of r² over the pupil, m².
    spread_m2: f64,
}

impl PupilScene {
    /// Moments of the hexagons less the central obscuration and the spider's vanes, on the centres
    /// of small triangles; `None` for a pupil from a file. The spider turns with the segments, and
    /// moments do not depend on a rotation.
    fn focus_shape(&self) -> Option<FocusShape> {
        let (side, root) = (self.segment_side_m, 3f64.sqrt());
        let hexagons = HexagonLayout { rotation_deg: 0.0, ..self.layout()? }.hexagons();
        let lines = self.spider_angles_deg.iter().flat_map(|deg| [*deg, deg + 180.0]);
        let vanes: Vec<_> = self.spider_vanes_deg.clone().unwrap_or_else(|| lines.collect());
        let vanes: Vec<_> = vanes.iter().map(|deg| deg.to_radians().sin_cos()).collect();
        let is_open = |x: f64, y: f64| {
            let hides = |(sin, cos): &(f64, f64)| {
                x * cos + y * sin > 0.0 && 2.0 * (y * cos - x * sin).abs() < self.spider_width_m
            };
            2.0 * x.hypot(y) > self.central_obscuration_m && !vanes.iter().any(hides)
        };
        let within = points_of_hexagon(side);
        let (mut sums, mut farthest_m) = ([0.0; 3], 0f64);
        for Hexagon { x_m, y_m, .. } in hexagons {
            let open = within.iter().map(|(x, y)| (x_m + x, y_m + y)).filter(|(x, y)| is_open(*x, *y));
            for square in open.map(|(x, y)| x * x + y * y) {
                sums.iter_mut().zip([1.0, square, square * square]).for_each(|(sum, term)| *sum += term);
            }
            for (x, y) in
                [(1.0, 0.0), (0.5, root / 2.0)].into_iter().flat_map(|(x, y)| [(x, y), (-x, -y), (x, -y), (-x, y)])
            {
                farthest_m = farthest_m.max((x_m + side * x).hypot(y_m + side * y));
            }
        }
        let [count, second, fourth] = sums;
        let variance = fourth / count - (second / count).powi(2);
        (count > 0.0 && variance > 0.0).then(|| FocusShape { radius_m: farthest_m, spread_m2: variance.sqrt() })
    }
}

/// Centres of equal triangles that fill a hexagon with vertices at ±`side` on x, about its centre.
/// Their own second moments, a part in 10⁵ of those of a pupil, are left out.
fn points_of_hexagon(side: f64) -> Vec<(f64, f64)> {
    const ALONG: i64 = 32;
    let step = side / ALONG as f64;
    let corner = |turn: i64| (turn as f64 * std::f64::consts::FRAC_PI_3).sin_cos();
    let mut points = Vec::new();
    for turn in 0..6 {
        let ((ys, xs), (yt, xt)) = (corner(turn), corner(turn + 1));
        let mut add = |a: f64, b: f64| points.push((step * (a * xs + b * xt), step * (a * ys + b * yt)));
        for a in 0..ALONG {
            for b in 0..ALONG - a {
                let (a, b) = (a as f64, b as f64);
                add(a + 1.0 / 3.0, b + 1.0 / 3.0);
                if a + b + 1.0 < ALONG as f64 {
                    add(a + 2.0 / 3.0, b + 2.0 / 3.0);
                }
            }
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use crate::scene::Scene;
    use crate::telescope::Telescope;
    use std::path::Path;

    fn scene(image: &str) -> crate::Result<Scene> {
        let pupil = "[pupil]\naperture = \"keck\"\ngrid_m = 10.95\nsamples = 120\n";
        Scene::from_text(&format!("{pupil}[image]\nwavelength_nm = 2168.6\npixels = 64\n{image}"), Path::new(""))
    }

    #[test]
    fn pixels_in_other_words_are_a_sampling() {
        // 2168.6 nm / 10.95 m is 40.850 mas.
        for (image, sampling) in [
            ("pixel_mas = 10.0", 4.0850),
            ("pixel_arcsec = 0.01", 4.0850),
            // f/15 with 27 um: 2.1686·15/27.
            ("focal_ratio = 15\npixel_pitch_um = 27", 1.20478),
            ("focal_length_m = 164.25\npixel_pitch_um = 27", 1.20478),
        ] {
            let read = scene(image).unwrap();
            let own = read.image.samples_per_lambda_over_d;
            assert!((own / sampling - 1.0).abs() < 1e-4, "{image}: {own}");
            assert!(read.text().ends_with(image));
        }
        let mas = scene("pixel_mas = 9.952").unwrap().pixel_mas().unwrap();
        assert!((mas / 9.952 - 1.0).abs() < 1e-12, "{mas}");
        let halved = scene("pixel_mas = 10.0").unwrap().with(&[("image.wavelength_nm", "1084.3")]).unwrap();
        assert!((halved.image.samples_per_lambda_over_d / 2.0425 - 1.0).abs() < 1e-4);
    }

    #[test]
    fn defocus_in_other_words_is_waves_rms() {
        for (image, waves, tolerance) in [
            ("diversity_focus_nm_rms = 3252.9", 1.5, 1e-12),
            // Of a full circle 1 in 2√3 = 0.2887, of 36 hexagons less.
            ("diversity_focus_waves_pv = -8", -8.0 * 0.2387, 0.02),
        ] {
            let own = scene(image).unwrap().image.diversity_focus_waves_rms;
            assert!((own / waves - 1.0).abs() < tolerance, "{image}: {own}");
        }
        // The preset's comment: 8 waves peak to valley.
        let jwst = Scene::preset("jwst-pair").unwrap();
        let channel = |key: &str, value: &str| {
            let settings = [("image.channel.plus.diversity_focus_waves_rms", ""), (key, value)];
            jwst.with(&settings).unwrap().channels()[0].scene.image.diversity_focus_waves_rms
        };
        let own = channel("image.channel.plus.diversity_focus_waves_pv", "8");
        // The preset has the waves of a sampled pupil, whose struts are as wide as its samples.
        assert!((own / 1.9104 - 1.0).abs() < 3e-3, "{own}");
        // Stage: W = ΔL/(8F²) at the edge of the grid's circle, whose radius is 5.475 m: the RMS of
        // that r² term over the pupil.
        let stage = scene("focal_ratio = 15\ndiversity_stage_mm = 20").unwrap().image.diversity_focus_waves_rms;
        let other = scene("focal_length_m = 164.25\ndiversity_stage_mm = 20").unwrap();
        assert_eq!(other.image.diversity_focus_waves_rms, stage);
        let set = &other.with(&[("image.focal_ratio", "30")]).unwrap().image;
        assert_eq!((set.focal_length_m, set.diversity_focus_waves_rms / stage), (None, 0.25));
        let edge_waves = 20e-3 / (8.0 * 225.0) / 2168.6e-9;
        let pv = scene(&format!("diversity_focus_waves_pv = {edge_waves}")).unwrap().image.diversity_focus_waves_rms;
        let radius_m = 5.4835f64;
        assert!((stage / (pv * (radius_m / 5.475).powi(2)) - 1.0).abs() < 1e-3, "{stage} {pv}");
    }

    /// The moments of the scene against the sampled pupil.
    #[test]
    fn the_spread_of_focus_is_that_of_the_sampled_pupil() {
        for (name, settings) in [
            ("keck-artificial", &[][..]),
            ("keck-artificial", &[("pupil.central_obscuration_m", "2.65")][..]),
            ("keck-artificial", &[("pupil.spider_width_m", "0.1"), ("pupil.central_obscuration_m", "2.65")]),
            ("jwst-pair", &[][..]),
            ("jwst-pair", &[("pupil.spider_width_m", "0")]),
        ] {
            let scene = Scene::preset(name).unwrap().with(settings).unwrap();
            let scene = scene.channels().first().map_or(scene.clone(), |channel| channel.scene.clone());
            let pupil = Telescope::new(&scene).unwrap().pupil;
            let n = pupil.amplitude.nrows();
            let at = |j: usize| (j as f64 - (n as f64 - 1.0) / 2.0) * scene.pupil.grid_m.unwrap() / n as f64;
            let squares = ndarray::Array2::from_shape_fn((n, n), |(y, x)| at(x).powi(2) + at(y).powi(2));
            let total: f64 = pupil.amplitude.sum();
            let mean = (&squares * &pupil.amplitude).sum() / total;
            let spread = (squares.mapv(|square| (square - mean).powi(2)) * &pupil.amplitude).sum() / total;
            let own = scene.pupil.focus_shape().unwrap().spread_m2;
            // 120 samples across, and struts no wider than one.
            assert!((own / spread.sqrt() - 1.0).abs() < 2e-3, "{name} {settings:?}: {own} {}", spread.sqrt());
        }
    }

    #[test]
    fn forms_exclude_each_other_and_a_setting_replaces_one() {
        for (image, words) in [
            ("pixel_mas = 10\nsamples_per_lambda_over_d = 2", "'image.pixel_mas' | both given"),
            ("pixel_mas = 10\npixel_arcsec = 0.01", "both given"),
            ("pixel_pitch_um = 18", "image.focal_length_m | image.focal_ratio"),
            (
                "focal_ratio = 15\nfocal_length_m = 150\npixel_pitch_um = 18",
                "image.focal_ratio = 15 | image.focal_length_m = 150",
            ),
            ("pixel_mas = 0.1", "is a sampling of 408.4"),
            ("diversity_focus_waves_pv = 5\ndiversity_focus_waves_rms = 1.5", "both given"),
            ("diversity_focus_nm_rms = 5\ndiversity_file = \"a.fits\"", "both given"),
            ("diversity_stage_mm = 5", "image.focal_length_m | image.focal_ratio"),
            ("diversity_focus_waves_pv = 79", "18.8"),
            ("pixel_mas = 30\npixel_fill = 1.0", "a sampling of 1.9 or more"),
        ] {
            match scene(image) {
                Err(error) => {
                    assert!(words.split(" | ").all(|fact| error.to_string().contains(fact)), "{image}: {error}");
                }
                Ok(read) => assert!(words == "18.8" && read.image.diversity_focus_waves_rms > 18.0, "{image}"),
            }
        }
        let replaced = scene("pixel_mas = 10.0").unwrap().with(&[("image.samples_per_lambda_over_d", "3")]).unwrap();
        assert_eq!(replaced.image.samples_per_lambda_over_d, 3.0);
        assert!(!replaced.names("image.pixel_mas"));
        let error =
            scene("").unwrap().with(&[("image.samples_per_lambda_over_d", "3"), ("image.pixel_mas", "9")]).unwrap_err();
        assert!(error.to_string().contains("both given"), "{error}");
    }
}
