//! Checks: one planted fault each. Is the right cause named first, and nothing where there is none?

use super::faults::halo;
use super::hard_cases::{Spoil, flipped, made};
use super::{Cell, KeptDraw, Progress, Report, Table, to_cells, to_numbers};
use cophase::pipeline::{Check, CheckedQuantity, Control, Images, Poke, check};
use cophase::scene::{Optic, Scene};
use cophase::source::{Camera, Truth, expose, flux_e, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::{Array3, Axis, s};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// What the scene of a check does not say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Planted {
    Nothing,
    /// Sampling by 0.5 to 3 %.
    PlateScale,
    /// Wavelength by 0.5 to 3 %: sampling, and waves of the defocus.
    Wavelength,
    /// Rotation of the pupil by 0.5 to 3°.
    Rotation,
    /// Slope of 10 % of the light, along a direction drawn at random.
    Illumination,
    /// A clip at 0.5 of the peak.
    Saturation,
    /// A companion of 2 to 10 %, 12 to 30 pixels away.
    Companion,
    /// A response that is 2 to 10 % low at the peak.
    Response,
    /// A halo of 10 pixels with 1 to 5 % of the light.
    Halo,
    /// A quadrant whose gain is 1 to 5 % larger.
    Gain,
    /// One of seven wrong orientations, with a poke.
    Orientation,
    /// The opposite sign of the defocus, with a poke.
    DefocusSign,
}

/// One row: a planted fault, and the causes that are right.
#[derive(Debug, Clone, Copy)]
pub struct CheckRow {
    /// Its name.
    pub name: &'static str,
    planted: Planted,
    right: &'static [CheckedQuantity],
}

/// All rows.
pub const CHECK_ROWS: [CheckRow; 12] = [
    CheckRow { name: "clean", planted: Planted::Nothing, right: &[] },
    CheckRow {
        name: "plate scale 0.5 to 3 %",
        planted: Planted::PlateScale,
        right: &[CheckedQuantity::PlateScaleOrWavelength, CheckedQuantity::Optic(Optic::PLATE_SCALE)],
    },
    CheckRow {
        name: "wavelength 0.5 to 3 %",
        planted: Planted::Wavelength,
        right: &[CheckedQuantity::PlateScaleOrWavelength, CheckedQuantity::Wavelength],
    },
    CheckRow {
        name: "rotation 0.5 to 3 deg",
        planted: Planted::Rotation,
        right: &[CheckedQuantity::Optic(Optic::ROTATION)],
    },
    CheckRow {
        name: "illumination 10 %",
        planted: Planted::Illumination,
        right: &[CheckedQuantity::Optic(Optic::ILLUMINATION)],
    },
    CheckRow { name: "saturation", planted: Planted::Saturation, right: &[CheckedQuantity::Saturation] },
    CheckRow { name: "companion 2 to 10 %", planted: Planted::Companion, right: &[CheckedQuantity::Companion] },
    CheckRow { name: "response 2 to 10 % low", planted: Planted::Response, right: &[CheckedQuantity::NonLinearity] },
    CheckRow { name: "halo of 1 to 5 %", planted: Planted::Halo, right: &[CheckedQuantity::Halo] },
    CheckRow { name: "gain of a quadrant 1 to 5 %", planted: Planted::Gain, right: &[CheckedQuantity::Gains] },
    CheckRow { name: "orientation, poke", planted: Planted::Orientation, right: &[CheckedQuantity::Orientation] },
    CheckRow { name: "defocus sign, poke", planted: Planted::DefocusSign, right: &[CheckedQuantity::DefocusSign] },
];

impl CheckRow {
    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        if let Some(odd) = texts.iter().find(|text| !CHECK_ROWS.iter().any(|row| row.name.contains(*text))) {
            let names = CHECK_ROWS.map(|row| row.name).join("; ");
            return Err(Error::Value(format!("no row of checks contains '{odd:.60}': parts of {names} are accepted")));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name.contains(text));
        Ok(CHECK_ROWS.into_iter().filter(is_wanted).collect())
    }
}

/// One draw.
#[derive(Debug, Clone)]
pub struct CheckDraw {
    /// Peak S/N of the image.
    pub peak_snr: f64,
    /// Size of the planted fault, in its unit.
    pub planted: f64,
    /// The cause that was named first; `None` where nothing was, and "failed" where the check ended
    /// with an error.
    pub named: Option<String>,
    /// Whether it is right.
    pub is_right: bool,
    /// Seconds.
    pub seconds: f64,
}

impl KeptDraw for CheckDraw {
    fn cells(&self) -> Vec<String> {
        let Self { peak_snr, planted, named, is_right, seconds } = self;
        let numbers = to_cells(&[*peak_snr, *planted, f64::from(u8::from(*is_right)), *seconds]);
        numbers.into_iter().chain(named.clone()).collect()
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let (numbers, named) = cells.split_at_checked(4)?;
        let [peak_snr, planted, right, seconds] = to_numbers(numbers)?[..] else { return None };
        let named = named.first().map(|named| (*named).to_owned());
        Some(Self { peak_snr, planted, named, is_right: right != 0.0, seconds })
    }
}

/// Draws of rows.
#[derive(Debug, Clone)]
pub struct Checks(pub Vec<(CheckRow, Vec<CheckDraw>)>);

/// Scene of all draws, beside the preset.
const BASE: [(&str, &str); 5] = [
    ("image.samples_per_lambda_over_d", "2.5"),
    ("image.pixels", "160"),
    ("pupil.grid_m", "11.5"),
    ("pupil.samples", "128"),
    ("aberrations.truth_samples", "640"),
];
/// A segment of the third ring, 10.9° from +x and off every axis of the pupil's symmetry, and its
/// poke.
const POKE: Poke = Poke::Segment(18, 150.0);

/// Checks draws 1 to `seeds` of each row.
///
/// # Errors
/// Those of making images, and [`Error::Interrupted`].
pub fn checks(rows: &[CheckRow], seeds: usize, progress: &Progress) -> Result<Checks> {
    progress.expect(rows.len() * seeds);
    let base = Scene::preset("keck-artificial")?.with(&BASE)?;
    let of_row = |(place, row): (usize, &CheckRow)| {
        let make = |seed: usize| {
            let drawn = draw(&base, row, seed as u64)?;
            progress.add(1);
            Ok(drawn)
        };
        let draw = |seed: usize| progress.draw((row.name, seed, place * seeds + seed), 1, || make(seed)).transpose();
        Ok((*row, (1..=seeds).into_par_iter().filter_map(draw).collect::<Result<Vec<_>>>()?))
    };
    Ok(Checks(rows.iter().enumerate().map(of_row).collect::<Result<Vec<_>>>()?))
}

/// Uniform numbers of a seed in [0, 1): a sequence of low discrepancy (Weyl), so that few draws
/// cover the range.
fn uniform(seed: u64, which: u64) -> f64 {
    const STEPS: [f64; 4] = [0.754_877_666, 0.569_840_291, 0.438_579_021, 0.342_547_381];
    (0.37 + seed as f64 * STEPS[which as usize % STEPS.len()]).fract()
}

fn draw(base: &Scene, row: &CheckRow, seed: u64) -> Result<CheckDraw> {
    let peak_snr = 200.0 + 300.0 * uniform(seed, 0);
    let snr = peak_snr.to_string();
    let scene = base.with(&[("aberrations.seed", &seed.to_string()), ("image.peak_snr", &snr)])?;
    let sign = if seed.is_multiple_of(2) { 1.0 } else { -1.0 };
    let size = uniform(seed, 1);
    let between = |low: f64, high: f64| low + (high - low) * size;
    let image = |keys: &[(&str, String)], spoil: Spoil| -> Result<Images> {
        let keys: Vec<(&str, &str)> = keys.iter().map(|(key, value)| (*key, value.as_str())).collect();
        Ok(Images::new(made(&scene.with(&keys)?, spoil)?.images_e))
    };
    let sampling = scene.image.samples_per_lambda_over_d;
    let waves = scene.image.diversity_focus_waves_rms;
    let mut before = None;
    let (planted, images) = match row.planted {
        Planted::Nothing => (0.0, image(&[], Spoil::None)?),
        Planted::PlateScale => {
            let part = sign * between(0.005, 0.03);
            (part, image(&[("image.samples_per_lambda_over_d", (sampling * (1.0 + part)).to_string())], Spoil::None)?)
        }
        Planted::Wavelength => {
            let part = sign * between(0.005, 0.03);
            let keys = [
                ("image.samples_per_lambda_over_d", (sampling * (1.0 + part)).to_string()),
                ("image.diversity_focus_waves_rms", (waves / (1.0 + part)).to_string()),
                ("image.wavelength_nm", (scene.image.wavelength_nm * (1.0 + part)).to_string()),
            ];
            (part, image(&keys, Spoil::None)?)
        }
        Planted::Rotation => {
            let degrees = sign * between(0.5, 3.0);
            (degrees, image(&[("pupil.rotation_deg", degrees.to_string())], Spoil::None)?)
        }
        Planted::Illumination => {
            let (sin, cos) = (std::f64::consts::TAU * size).sin_cos();
            let keys =
                [("pupil.illumination_x", (0.1 * cos).to_string()), ("pupil.illumination_y", (0.1 * sin).to_string())];
            (0.1, image(&keys, Spoil::None)?)
        }
        Planted::Saturation => (0.5, image(&[], Spoil::Saturated)?),
        Planted::Companion => {
            let share = between(0.02, 0.1);
            let (sin, cos) = (std::f64::consts::TAU * uniform(seed, 2)).sin_cos();
            let far = 12.0 + 18.0 * uniform(seed, 3);
            (share, image(&[], Spoil::Companion { share, pixels: [far * cos, far * sin] })?)
        }
        Planted::Response => {
            let share = between(0.02, 0.1);
            (share, image(&[], Spoil::NonLinear(share))?)
        }
        Planted::Halo => {
            let (share, mut images) = (between(0.01, 0.05), image(&[], Spoil::None)?);
            for mut frame_e in images.images_e.outer_iter_mut() {
                let with_halo = halo(&frame_e.to_owned(), share, 10.0);
                frame_e.assign(&with_halo);
            }
            (share, images)
        }
        Planted::Gain => {
            let (share, mut images) = (between(0.01, 0.05), image(&[], Spoil::None)?);
            let (_, rows, columns) = images.images_e.dim();
            images.images_e.slice_mut(s![.., rows / 2.., columns / 2..]).mapv_inplace(|e| e * (1.0 + share));
            (share, images)
        }
        Planted::Orientation => {
            let which = 1 + (seed as usize - 1) % 7;
            let pair = poked(&scene)?.map(|images_e| Images::new(oriented(images_e, which)));
            let [old, new] = pair;
            before = Some(old);
            (which as f64, new)
        }
        Planted::DefocusSign => {
            let other = scene.with(&[("image.diversity_focus_waves_rms", &(-waves).to_string())])?;
            let [old, new] = poked(&other)?.map(Images::new);
            before = Some(old);
            (-1.0, new)
        }
    };
    let started = Instant::now();
    let poke = before.as_ref().map(|before| (Some(before), POKE));
    let (named, is_right) = match check(&scene, &images, poke, &Control::default()) {
        Ok(found) => verdict(row, &found),
        Err(error @ Error::Interrupted(_)) => return Err(error),
        Err(_) => (Some("failed".into()), false),
    };
    Ok(CheckDraw { peak_snr, planted, named, is_right, seconds: started.elapsed().as_secs_f64() })
}

fn verdict(row: &CheckRow, found: &Check) -> (Option<String>, bool) {
    let cause = found.cause().map(|cause| cause.quantity);
    let is_right = cause.map_or(row.right.is_empty(), |cause| row.right.contains(&cause));
    (cause.map(|cause| cause.name().to_owned()), is_right)
}

/// Images without and with the poke.
fn poked(scene: &Scene) -> Result<[Array3<f64>; 2]> {
    let telescope = Telescope::new(scene)?;
    let seed = scene.seed();
    let Poke::Segment(segment, nm) = POKE else { return Err(Error::Internal("the poke is one of a segment".into())) };
    let camera = Camera::new(scene, &telescope)?;
    let one = |number: u64, nm: f64| -> Result<Array3<f64>> {
        let truth = Truth::draw(scene, &telescope, &mut stream(seed, 0))?;
        let mut pistons_nm = truth.piston_nm.clone();
        pistons_nm[segment] += nm;
        let psf = camera.psf(&truth.with_pistons(&telescope, pistons_nm)?)?;
        let flux_e = flux_e(&scene.image, psf.iter().copied().fold(0.0, f64::max));
        let mut rng = stream(seed, 1 + number);
        Ok(psf.mapv(|h| expose(&scene.image, h, flux_e, &mut rng)).insert_axis(Axis(0)))
    };
    Ok([one(0, 0.0)?, one(1, nm)?])
}

/// One of the eight orientations about the axis, pixel N/2.
fn oriented(images_e: Array3<f64>, which: usize) -> Array3<f64> {
    let mut images_e = images_e;
    if which & 1 != 0 {
        images_e = flipped(&images_e, Axis(2));
    }
    if which & 2 != 0 {
        images_e = flipped(&images_e, Axis(1));
    }
    if which & 4 != 0 {
        images_e = images_e.permuted_axes([0, 2, 1]).as_standard_layout().into_owned();
    }
    images_e
}

impl Checks {
    /// One line a row: draws, those whose first cause is right, and what was named.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&["planted", "draws", "right", "right_percent", "named", "seconds"]);
        for (row, draws) in &self.0 {
            let right = draws.iter().filter(|draw| draw.is_right).count();
            let mut named = BTreeMap::<&str, usize>::new();
            for draw in draws {
                *named.entry(draw.named.as_deref().unwrap_or("nothing")).or_default() += 1;
            }
            let named: Vec<String> = named.iter().map(|(name, count)| format!("{name}: {count}")).collect();
            let seconds = draws.iter().map(|draw| draw.seconds).sum::<f64>() / draws.len().max(1) as f64;
            table.push(vec![
                row.name.into(),
                draws.len().into(),
                right.into(),
                Cell::Number(100.0 * right as f64 / draws.len().max(1) as f64, 1),
                named.join("; ").as_str().into(),
                Cell::Number(seconds, 1),
            ]);
        }
        table
    }

    /// One line a draw.
    fn draws(&self) -> Table {
        let mut table = Table::new(&["row", "peak_snr", "planted", "named", "right", "seconds"]);
        for (row, draw) in self.0.iter().flat_map(|(row, draws)| draws.iter().map(move |draw| (row, draw))) {
            table.push(vec![
                row.name.into(),
                Cell::Number(draw.peak_snr, 0),
                Cell::Number(draw.planted, 4),
                draw.named.as_deref().unwrap_or("nothing").into(),
                usize::from(draw.is_right).into(),
                Cell::Number(draw.seconds, 1),
            ]);
        }
        table
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["checks.csv", "checks-draws.csv"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.draws().write_csv(&files[1])?;
        let text = "Checks: the first cause that is named, by planted fault\n".to_string() + &self.table().text();
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        for named in [None, Some("sign of the defocus".to_owned())] {
            let draw = CheckDraw { peak_snr: 1.0 / 3.0, planted: -1.0, named, is_right: true, seconds: 0.1 };
            crate::experiment::assert_survives(&draw);
        }
    }
}
