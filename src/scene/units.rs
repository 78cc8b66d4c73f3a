//! Pixel scale and defocus in an instrument's words, converted once to the keys that everything else reads.
//!
//! With the side `L` of the pupil's grid (`pupil.grid_m`), the wavelength λ, and the focal length `f = F·L` of the focal ratio `F`:
//!
//! * pixel of the angle θ: sampling λ/(L·θ); pixel of the pitch p: θ = p/f, sampling λ·F/p;
//! * focus `W(r) = a·r²` over the pupil: RMS |a|·σ, with σ the standard deviation of r² over the pupil (zero mean, weight A);
//!   peak to valley a·R² over the circle of radius R around the pupil, 2√3·RMS for a full circle (Noll 1976, JOSA 66, 207);
//! * detector displaced along the axis by ΔL: a = ΔL/(2f²), so ΔL/(8F²) at the edge r = L/2 (Goodman, Introduction to Fourier Optics,
//!   section 6.4, for ΔL ≪ f).

use super::Sections;
use super::table::{Reader, Source};
use super::telescope::PupilScene;
use crate::Result;

/// Ranges of the keys that the other forms are converted to.
const SAMPLINGS: std::ops::RangeInclusive<f64> = f64::MIN_POSITIVE..=64.0;
const WAVES: std::ops::RangeInclusive<f64> = -20.0..=20.0;

/// Milliarcseconds in a radian.
const RADIAN_MAS: f64 = 180.0 / std::f64::consts::PI * 3.6e6;

impl Sections {
    /// Converts the other forms of the sampling and of the defocus to `samples_per_lambda_over_d` and `diversity_focus_waves_rms`.
    pub(super) fn convert_units(&mut self, source: Source, document: &toml_edit::Table) -> Result<()> {
        let reader = Reader { source, section: "image", item: document.get("image") };
        self.convert_sampling(&reader)?;
        self.convert_focus(&reader)
    }

    fn convert_sampling(&mut self, reader: &Reader) -> Result<()> {
        let image = &self.image;
        let (key, value) = match (image.pixel_mas, image.pixel_arcsec, image.pixel_pitch_um) {
            (Some(mas), ..) => ("pixel_mas", mas),
            (_, Some(arcsec), _) => ("pixel_arcsec", arcsec),
            (.., Some(um)) => ("pixel_pitch_um", um),
            _ => return Ok(()),
        };
        let lambda_m = image.wavelength_nm * 1e-9;
        let grid_m = || self.grid_m(reader, key, "samples_per_lambda_over_d");
        let sampling = match key {
            "pixel_mas" => lambda_m / grid_m()? * RADIAN_MAS / value,
            "pixel_arcsec" => lambda_m / grid_m()? * RADIAN_MAS / (1e3 * value),
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
        let (key, value) =
            match (image.diversity_focus_waves_pv, image.diversity_focus_nm_rms, image.diversity_stage_mm) {
                (Some(waves), ..) => ("diversity_focus_waves_pv", waves),
                (_, Some(nm), _) => ("diversity_focus_nm_rms", nm),
                (.., Some(mm)) => ("diversity_stage_mm", mm),
                _ => return Ok(()),
            };
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
                let focal_m = self.focal_ratio(reader, key)? * self.grid_m(reader, key, "diversity_focus_waves_rms")?;
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

    /// Side of the pupil's grid, m.
    fn grid_m(&self, reader: &Reader, key: &str, instead: &str) -> Result<f64> {
        self.pupil.grid_m.or(self.pupil.extent_m()).ok_or_else(|| {
            reader.error(
                key,
                format!("image.{key} needs the width of the pupil; give pupil.grid_m, or {instead} in its place"),
            )
        })
    }

    fn focal_ratio(&self, reader: &Reader, key: &str) -> Result<f64> {
        self.image.focal_ratio.ok_or_else(|| {
            reader.error(
                key,
                format!("image.{key} needs image.focal_ratio, the focal length over pupil.grid_m; it is missing"),
            )
        })
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
    /// Moments of the hexagons less the central obscuration and the spider's vanes; exact up to the overlap of these with each other and
    /// of the obscuration with gaps. `None` for a pupil from a file.
    fn focus_shape(&self) -> Option<FocusShape> {
        self.extent_m()?;
        let (side, pitch) = (self.segment_side_m, 3f64.sqrt() * self.segment_side_m + self.segment_gap_m);
        // Means of r² and r⁴ over a hexagon about its centre: 5s²/12 and 7s⁴/30.
        let (second, fourth) = (5.0 / 12.0 * side.powi(2), 7.0 / 30.0 * side.powi(4));
        let area = 1.5 * 3f64.sqrt() * side.powi(2);
        let rings = self.rings as i64;
        let mut sums = [0.0; 3];
        let mut add =
            |weight: f64, means: [f64; 3]| sums.iter_mut().zip(means).for_each(|(sum, mean)| *sum += weight * mean);
        for q in -rings..=rings {
            for r in (-rings).max(-rings - q)..=rings.min(rings - q) {
                if (q, r) == (0, 0) && !self.central_segment {
                    continue;
                }
                let centre = pitch.powi(2) * (q * q + q * r + r * r) as f64;
                // r = c + u: ⟨r²⟩ = c² + ⟨u²⟩, ⟨r⁴⟩ = c⁴ + 2c²⟨u²⟩ + 4⟨(c·u)²⟩ + ⟨u⁴⟩ with ⟨(c·u)²⟩ = c²⟨u²⟩/2.
                add(area, [1.0, centre + second, centre.powi(2) + 4.0 * centre * second + fourth]);
            }
        }
        let hidden = self.central_obscuration_m / 2.0;
        if self.central_segment || hidden >= side {
            let disc = std::f64::consts::PI * hidden.powi(2);
            add(-disc, [1.0, hidden.powi(2) / 2.0, hidden.powi(4) / 3.0]);
            if !self.central_segment {
                add(area, [1.0, second, fourth]);
            }
        }
        for [weight, square] in self.vane_points(pitch) {
            add(-weight, [1.0, square, square.powi(2)]);
        }
        let [area, second, fourth] = sums;
        let variance = fourth / area - (second / area).powi(2);
        // The farthest vertex is one of a corner hexagon, 30° off the direction to its centre.
        let corner = self.rings as f64 * pitch;
        let radius_m = (corner.powi(2) + side.powi(2) + 3f64.sqrt() * corner * side).sqrt();
        (area > 0.0 && variance > 0.0).then(|| FocusShape { radius_m, spread_m2: variance.sqrt() })
    }

    /// Points of the vanes that hide a segment: the area for which each stands, and its r². Points across the width, too: a vane of JWST
    /// runs along a gap, so that its middle line is on no segment. The spider turns with the segments.
    fn vane_points(&self, pitch: f64) -> Vec<[f64; 2]> {
        const POINTS: usize = 1000;
        const ACROSS: usize = 16;
        if self.spider_width_m <= 0.0 {
            return Vec::new();
        }
        let lines = self.spider_angles_deg.iter().flat_map(|deg| [*deg, deg + 180.0]);
        let vanes: Vec<f64> = self.spider_vanes_deg.clone().unwrap_or_else(|| lines.collect());
        let reach = self.rings as f64 * pitch + self.segment_side_m;
        let step = reach / POINTS as f64;
        let mut points = Vec::new();
        for (sin, cos) in vanes.iter().map(|deg| deg.to_radians().sin_cos()) {
            for point in 0..POINTS * ACROSS {
                let along = ((point / ACROSS) as f64 + 0.5) * step;
                let aside = (((point % ACROSS) as f64 + 0.5) / ACROSS as f64 - 0.5) * self.spider_width_m;
                let (x, y) = (along * cos - aside * sin, along * sin + aside * cos);
                if x.hypot(y) > self.central_obscuration_m / 2.0 && self.is_on_segment(x, y, pitch) {
                    points.push([self.spider_width_m * step / ACROSS as f64, x * x + y * y]);
                }
            }
        }
        points
    }

    /// Whether a point of the pupil, before its rotation, is on a segment. The nearest centres are those about the rounded axial
    /// coordinates q and r, with c = pitch·(q·(cos 30°, sin 30°) + r·(0, 1)).
    fn is_on_segment(&self, x: f64, y: f64, pitch: f64) -> bool {
        let root = 3f64.sqrt();
        let (rings, q) = (self.rings as i64, (2.0 * x / (root * pitch)).round() as i64);
        let r = (y / pitch - q as f64 / 2.0).round() as i64;
        let mut near = (q - 1..=q + 1).flat_map(|q| (r - 1..=r + 1).map(move |r| (q, r)));
        near.any(|(q, r)| {
            let is_there =
                q.abs().max(r.abs()).max((q + r).abs()) <= rings && (self.central_segment || (q, r) != (0, 0));
            // A hexagon with vertices on ±x.
            let u = (x - pitch * q as f64 * root / 2.0).abs();
            let v = (y - pitch * (r as f64 + q as f64 / 2.0)).abs();
            is_there && v <= root / 2.0 * self.segment_side_m && root * u + v <= root * self.segment_side_m
        })
    }
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
        ] {
            let read = scene(image).unwrap();
            let own = read.image.samples_per_lambda_over_d;
            assert!((own / sampling - 1.0).abs() < 1e-4, "{image}: {own}");
            assert!(read.text().ends_with(image));
        }
        let mas = crate::source::pixel_mas(&scene("pixel_mas = 9.952").unwrap()).unwrap();
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
        // The preset has the waves of a sampled pupil; the exact moments of its hexagons and struts give 1.9140.
        assert!((own / 1.9104 - 1.0).abs() < 3e-3, "{own}");
        // Stage: W = ΔL/(8F²) at the edge of the grid's circle, whose radius is 5.475 m: the RMS of that r² term over the pupil.
        let stage = scene("focal_ratio = 15\ndiversity_stage_mm = 20").unwrap().image.diversity_focus_waves_rms;
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
            // The overlap of the obscuration with the gaps, and 120 samples across.
            assert!((own / spread.sqrt() - 1.0).abs() < 2e-3, "{name} {settings:?}: {own} {}", spread.sqrt());
        }
    }

    #[test]
    fn forms_exclude_each_other_and_a_setting_replaces_one() {
        for (image, words) in [
            ("pixel_mas = 10\nsamples_per_lambda_over_d = 2", "'image.pixel_mas' are both given"),
            ("pixel_mas = 10\npixel_arcsec = 0.01", "both given"),
            ("pixel_pitch_um = 18", "needs image.focal_ratio"),
            ("pixel_mas = 0.1", "is a sampling of 408.4"),
            ("diversity_focus_waves_pv = 5\ndiversity_focus_waves_rms = 1.5", "both given"),
            ("diversity_focus_nm_rms = 5\ndiversity_file = \"a.fits\"", "both given"),
            ("diversity_stage_mm = 5", "needs image.focal_ratio"),
            ("diversity_focus_waves_pv = 79", "18.8"),
            ("pixel_mas = 30\npixel_fill = 1.0", "a sampling of 1.9 or more"),
        ] {
            match scene(image) {
                Err(error) => assert!(error.to_string().contains(words), "{image}: {error}"),
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
