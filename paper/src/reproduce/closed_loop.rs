//! Estimate, correct, repeat: rounds of images behind the plain zonal loop of `keck-onsky`, each
//! read by a MAP estimate whose corrections move segments and mirror before the next. What remains
//! is known, and so is the Strehl ratio in K, beside that of a perfect telescope.
//!
//! Images, telemetry and corrections pass through the same files as those of
//! `cophase simulate --corrections` and `cophase estimate --commands`.

use super::statistics::{mean, standard_deviation};
use super::{Cell, KeptDraw, Progress, Report, Table, to_cells, to_numbers};
use crate::experiment::metrics::centre;
use cophase::ao::{self, Shot, Simulator, View};
use cophase::pipeline::{Corrections, Estimator, Images, SentCorrections};
use cophase::scene::Scene;
use cophase::source::Truth;
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use cophase_view::plot::{CurvePicture, Series};
use ndarray::Array2;
use std::path::Path;

/// Rounds of images and corrections.
const ROUNDS: usize = 3;
/// The sequence of a round, and the errors before the first. All of each mode is corrected where
/// that is expected to lower the error: what a mode below its error bar leaves is as large as what
/// it would add.
const SETTINGS: [(&str, &str); 4] = [
    ("image.count", "25"),
    ("aberrations.segment_piston_rms_nm", "128.3"),
    ("estimate.method", "full-phase"),
    ("commands.deadband_sigma", "0"),
];
/// The turbulence of each round is another one: its seed is this much further.
const NEXT_TURBULENCE: usize = 1_000_000;
/// How long the Strehl ratio is measured after the loop has settled, s, and every how many frames:
/// 8 ms apart, where the residual needs 50 ms to cross an actuator's pitch.
const WATCHED_S: f64 = 0.5;
const IMAGE_EVERY: u64 = 8;
/// Image of the Strehl ratio: pixels per λ/11.25 m, and pixels a side, beyond which the peak's
/// interpolation does not depend on them.
const SAMPLES_PER_LAMBDA_OVER_D: f64 = 3.0;
const PIXELS: usize = 96;

/// A telescope before the first round (0) or after a round.
#[derive(Debug, Clone)]
pub struct Round {
    /// The draw.
    pub seed: usize,
    /// Rounds so far.
    pub round: usize,
    /// Segment errors, nm RMS, piston, tip and tilt removed.
    pub phasing_nm: f64,
    /// NCPA, nm RMS, piston, tip and tilt removed.
    pub ncpa_nm: f64,
    /// Strehl ratio in K with both.
    pub strehl: f64,
    /// That of a telescope without either, in the same turbulence.
    pub perfect_strehl: f64,
    /// Error bars of the estimate that ended the round, phasing and NCPA, nm.
    pub sigma_nm: [f64; 2],
    /// Seconds of that estimate.
    pub seconds: f64,
}

/// The rounds of one draw.
#[derive(Debug)]
struct Rounds(Vec<Round>);

impl KeptDraw for Rounds {
    fn cells(&self) -> Vec<String> {
        let numbers = self.0.iter().flat_map(|round| {
            let Round { seed, round, phasing_nm, ncpa_nm, strehl, perfect_strehl, sigma_nm: [p, n], seconds } = *round;
            [seed as f64, round as f64, phasing_nm, ncpa_nm, strehl, perfect_strehl, p, n, seconds]
        });
        to_cells(&numbers.collect::<Vec<_>>())
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let numbers = to_numbers(cells)?;
        let (rounds, rest) = numbers.as_chunks();
        let round = |&[seed, round, phasing_nm, ncpa_nm, strehl, perfect_strehl, p, n, seconds]: &[f64; 9]| Round {
            seed: seed as usize,
            round: round as usize,
            phasing_nm,
            ncpa_nm,
            strehl,
            perfect_strehl,
            sigma_nm: [p, n],
            seconds,
        };
        rest.is_empty().then(|| Self(rounds.iter().map(round).collect()))
    }
}

/// All rounds of all draws.
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    /// Draw by draw, round by round.
    pub rounds: Vec<Round>,
}

/// Draws 1 to `seeds`.
///
/// # Errors
/// Those of simulator and estimator; [`Error::Interrupted`].
pub fn closed_loop(seeds: usize, progress: &Progress) -> Result<ClosedLoop> {
    progress.expect(seeds * ROUNDS);
    let mut rounds = Vec::new();
    for seed in 1..=seeds {
        let draw = progress.draw(("", seed, seed), ROUNDS, || Ok(Rounds(one(seed, progress)?)))?;
        rounds.extend(draw.into_iter().flat_map(|draw| draw.0));
    }
    Ok(ClosedLoop { rounds })
}

fn one(seed: usize, progress: &Progress) -> Result<Vec<Round>> {
    let scene_of = |round: usize| {
        let (aberrations, turbulence) = (seed.to_string(), (seed + round * NEXT_TURBULENCE).to_string());
        let scene = Scene::preset("keck-onsky")?.with(&SETTINGS)?;
        scene.with(&[("aberrations.seed", &aberrations), ("turbulence.seed", &turbulence)])
    };
    let scene = scene_of(0)?;
    let none = scene.with(&[("aberrations.segment_piston_rms_nm", "0"), ("aberrations.ncpa_rms_nm", "0")])?;
    let perfect_strehl = strehl(Simulator::new(&none)?, progress)?;
    let mut sent: Vec<SentCorrections> = Vec::new();
    let state = |sent: &[SentCorrections], round, sigma_nm, seconds| -> Result<Round> {
        let simulator = SentCorrections::system(sent, &scene)?;
        let [phasing_nm, ncpa_nm] = residuals_nm(&scene, simulator.truth())?;
        let strehl = strehl(simulator, progress)?;
        Ok(Round { seed, round, phasing_nm, ncpa_nm, strehl, perfect_strehl, sigma_nm, seconds })
    };
    let mut rounds = vec![state(&sent, 0, [f64::NAN; 2], f64::NAN)?];
    for round in 1..=ROUNDS {
        progress.check()?;
        let (corrections, sigma_nm, seconds) = measure(&scene_of(round)?, &sent, progress)?;
        sent.push(SentCorrections::from(&corrections));
        rounds.push(state(&sent, round, sigma_nm, seconds)?);
        progress.add(1);
    }
    Ok(rounds)
}

/// Corrections from the images of a round, with the error bars of phasing and NCPA, nm, and the
/// time of the estimate, s.
fn measure(scene: &Scene, sent: &[SentCorrections], progress: &Progress) -> Result<(Corrections, [f64; 2], f64)> {
    let mut simulator = SentCorrections::system(sent, scene)?;
    let mut shots: Vec<Shot> = Vec::new();
    let summary = simulator.run(&mut shots, progress.control())?;
    let folder = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
    let path = folder.path().join("images.fits");
    ao::write(&path, scene.text(), &simulator, &shots, &summary)?;
    let estimate = Estimator::new(scene)?.estimate(&Images::read(&path, None)?)?;
    let sigma_nm = [estimate.figures.phasing.sigma_nm, estimate.figures.ncpa.sigma_nm];
    Ok((estimate.corrections(None)?, sigma_nm, estimate.run.seconds))
}

fn residuals_nm(scene: &Scene, truth: &Truth) -> Result<[f64; 2]> {
    let pupil = Telescope::new(scene)?.pupil;
    let rms = |map_nm: &Array2<f64>| pupil.rms(pupil.remove_piston_tip_tilt(map_nm.view())?.view());
    Ok([rms(&truth.phasing_nm)?, rms(&truth.ncpa_nm)?])
}

/// Strehl ratio at the scene's wavelength in focus: peak of the mean image over that of a flat
/// wavefront.
fn strehl(mut simulator: Simulator, progress: &Progress) -> Result<f64> {
    let view = View {
        segments: true,
        ncpa: true,
        diversity: false,
        wavelength_nm: simulator.scene().image.wavelength_nm,
        rows: PIXELS,
        columns: PIXELS,
        samples_per_lambda_over_d: SAMPLES_PER_LAMBDA_OVER_D,
        bandwidth_fraction: 0.0,
        spectrum: false,
    };
    let flat = simulator.footprint().zeros();
    let perfect = simulator.camera(View { segments: false, ncpa: false, ..view })?.psf(&flat).mapv(f64::from);
    let mut camera = simulator.camera(view)?;
    let mut sum = vec![0.0; camera.pixels()];
    let settle_s = simulator.scene().control.as_ref().map_or(0.0, |control| control.settle_s);
    let frames = |seconds: f64| (seconds / simulator.frame_s()).round() as u64;
    let (settled, watched) = (frames(settle_s), frames(WATCHED_S));
    let mut images = 0.0;
    for number in 0..settled + watched {
        let frame = simulator.step()?;
        if number >= settled && number.is_multiple_of(IMAGE_EVERY) {
            progress.check()?;
            camera.add(frame.residual_nm, &mut sum);
            images += 1.0;
        }
    }
    let image = camera.to_image(&sum).mapv(f64::from) / images;
    let highest = |image: &Array2<f64>| image.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Ok(highest(&centre(image.view())?.image) / highest(&perfect))
}

impl ClosedLoop {
    /// Draws.
    fn seeds(&self) -> usize {
        self.rounds.iter().filter(|round| round.round == 0).count()
    }

    fn of(&self, round: usize, value: fn(&Round) -> f64) -> Vec<f64> {
        self.rounds.iter().filter(|one| one.round == round).map(value).collect()
    }

    /// Rounds after which phasing and NCPA together were worse than before.
    pub fn worse(&self) -> usize {
        let total_nm = |round: &Round| round.phasing_nm.hypot(round.ncpa_nm);
        let pairs = self.rounds.windows(2).filter(|pair| pair[0].seed == pair[1].seed);
        pairs.filter(|pair| total_nm(&pair[1]) > total_nm(&pair[0])).count()
    }

    /// One line a round.
    pub fn summary(&self) -> Table {
        let mut table = Table::new(&[
            "round",
            "seeds",
            "phasing_nm",
            "phasing_max_nm",
            "ncpa_nm",
            "ncpa_max_nm",
            "strehl_k",
            "strehl_sd",
            "perfect_strehl_k",
            "seconds",
        ]);
        for round in 0..=ROUNDS {
            let (phasing, ncpa) = (self.of(round, |one| one.phasing_nm), self.of(round, |one| one.ncpa_nm));
            let strehl = self.of(round, |one| one.strehl);
            let largest = |values: &[f64]| values.iter().copied().fold(0.0, f64::max);
            table.push(vec![
                round.into(),
                phasing.len().into(),
                Cell::Number(mean(&phasing), 2),
                Cell::Number(largest(&phasing), 2),
                Cell::Number(mean(&ncpa), 2),
                Cell::Number(largest(&ncpa), 2),
                Cell::Number(mean(&strehl), 4),
                Cell::Number(standard_deviation(&strehl), 4),
                Cell::Number(mean(&self.of(round, |one| one.perfect_strehl)), 4),
                Cell::Number(mean(&self.of(round, |one| one.seconds)), 1),
            ]);
        }
        table
    }

    /// One line for each round and draw.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "seed",
            "round",
            "phasing_nm",
            "phasing_sigma_nm",
            "ncpa_nm",
            "ncpa_sigma_nm",
            "strehl_k",
            "perfect_strehl_k",
        ]);
        for round in &self.rounds {
            table.push(vec![
                round.seed.into(),
                round.round.into(),
                Cell::Number(round.phasing_nm, 2),
                Cell::Number(round.sigma_nm[0], 2),
                Cell::Number(round.ncpa_nm, 2),
                Cell::Number(round.sigma_nm[1], 2),
                Cell::Number(round.strehl, 4),
                Cell::Number(round.perfect_strehl, 4),
            ]);
        }
        table
    }

    /// Residuals against the round.
    pub fn picture(&self) -> CurvePicture {
        let series = |label: &str, value: fn(&Round) -> f64| Series {
            label: label.into(),
            x: (0..=ROUNDS).map(|round| round as f64).collect(),
            y: (0..=ROUNDS).map(|round| mean(&self.of(round, value))).collect(),
            y_err: Some((0..=ROUNDS).map(|round| standard_deviation(&self.of(round, value))).collect()),
            ..Default::default()
        };
        CurvePicture {
            title: "Estimate, correct, repeat: 25 images a round behind the zonal loop".into(),
            x_label: "rounds".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series: vec![series("phasing", |one| one.phasing_nm), series("NCPA", |one| one.ncpa_nm)],
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["closed-loop.csv", "closed-loop-rounds.csv", "closed-loop.png"].map(|name| directory.join(name));
        self.summary().write_csv(&files[0])?;
        self.table().write_csv(&files[1])?;
        self.picture().draw(&files[2])?;
        let text = format!(
            "Closed loop: residuals after each round of 25 images, nm RMS, mean and largest of the draws, and Strehl ratio in K\n{}{} of {} rounds \
             left more than there was before\n\n",
            self.summary().text(),
            self.worse(),
            self.seeds() * ROUNDS
        );
        Ok(Report { text, files: files.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        let (phasing_nm, ncpa_nm, strehl, perfect_strehl) = (1.0 / 3.0, 0.1, 0.7, 0.8);
        let round = |round| Round {
            seed: 3,
            round,
            phasing_nm,
            ncpa_nm,
            strehl,
            perfect_strehl,
            sigma_nm: [f64::NAN; 2],
            seconds: 0.1,
        };
        crate::experiment::assert_survives(&Rounds((0..4).map(round).collect()));
    }
}
