//! Planned observations: the errors that they promise against those of images taken so.

use super::statistics::median;
use super::{Cell, Progress, Report, Table};
use cophase::pipeline::{ObservationPlan, plan_observation};
use cophase::scene::Scene;
use cophase::source::stream;
use cophase::{Error, Estimator, Images, Result};
use rand::RngExt;
use rayon::prelude::*;
use std::path::Path;

/// Number of random scenes.
const SCENES: u64 = 20;
/// Wavelengths of half of the scenes, nm.
const COLOURS_NM: [f64; 2] = [2168.6, 1640.0];

/// What one plan promised, and what came of it.
#[derive(Debug, Clone)]
pub struct PlannedScene {
    plan: ObservationPlan,
    /// RMS residuals of phasing and NCPA over the draws, nm; none where no observation is recommended.
    measured_nm: Option<[f64; 2]>,
    flagged: usize,
}

/// Plans of random scenes.
#[derive(Debug, Clone)]
pub struct Observations(Vec<PlannedScene>);

/// Star, errors, budget and wavelengths of the scene `number`.
fn random(number: u64) -> Result<(Scene, f64, &'static [f64])> {
    let mut rng = stream(number, 0);
    let mut between = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
    let settings = [
        ("image.samples_per_lambda_over_d", "2".to_string()),
        ("image.pixels", "240".to_string()),
        ("image.peak_snr", between(50.0, 500.0).to_string()),
        ("image.read_noise_e", between(5.0, 60.0).to_string()),
        ("aberrations.segment_piston_rms_nm", between(20.0, 150.0).to_string()),
        ("aberrations.ncpa_rms_nm", between(20.0, 100.0).to_string()),
        ("aberrations.seed", (1000 + number).to_string()),
    ];
    let settings: Vec<(&str, &str)> = settings.iter().map(|(key, value)| (*key, value.as_str())).collect();
    let colours = if number.is_multiple_of(2) { &COLOURS_NM[..1] } else { &COLOURS_NM };
    Ok((Scene::preset("keck-artificial")?.with(&settings)?, between(0.3, 1.5), colours))
}

/// Plans random scenes, and estimates `seeds` draws of each as planned.
///
/// # Errors
/// Those of the planner and of the estimator, and [`Error::Interrupted`].
pub fn observations(seeds: usize, progress: &Progress) -> Result<Observations> {
    progress.expect(SCENES as usize);
    let one = |number: u64| {
        progress.check()?;
        let (scene, budget_nm, wavelengths_nm) = random(number)?;
        let plan = plan_observation(&scene, wavelengths_nm, budget_nm, None, &mut |_, _| {})?;
        let mut found = PlannedScene { measured_nm: None, flagged: 0, plan };
        if let Some(observation) = found.plan.recommended() {
            let estimator = Estimator::new(&observation.scene)?;
            let mut squares = [0.0; 2];
            for seed in 1..=seeds {
                progress.check()?;
                let images = Images::simulated_channels(
                    &observation.scene.with_override("aberrations.seed", &seed.to_string())?,
                )?;
                let estimate = estimator.estimate_channels(&images)?;
                let Some((_, residual)) = &estimate.truth else {
                    return Err(Error::Internal("a simulated image has no truth".into()));
                };
                (0..2).for_each(|part| squares[part] += residual.rms_nm[part].powi(2) / seeds as f64);
                found.flagged += usize::from(!estimate.is_sound());
            }
            found.measured_nm = Some(squares.map(f64::sqrt));
        }
        progress.add(1);
        Ok(found)
    };
    Ok(Observations((0..SCENES).into_par_iter().map(one).collect::<Result<Vec<_>>>()?))
}

impl Observations {
    /// Measured over expected errors of all scenes that were planned, phasing and NCPA.
    pub fn ratios(&self) -> Vec<[f64; 2]> {
        let ratio = |one: &PlannedScene| {
            let (expected, measured) = (one.plan.recommended()?.expected_nm, one.measured_nm?);
            Some([measured[0] / expected[0], measured[1] / expected[1]])
        };
        self.0.iter().filter_map(ratio).collect()
    }

    /// One line a scene.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "scene",
            "budget_nm",
            "channels",
            "defocus_waves",
            "exposures",
            "phasing_nm",
            "measured",
            "ratio",
            "ncpa_nm",
            "measured_ncpa",
            "ratio_ncpa",
            "flagged",
        ]);
        for (number, one) in self.0.iter().enumerate() {
            let mut cells: Vec<Cell> = vec![number.into(), Cell::Number(one.plan.budget_nm, 2)];
            if let (Some(observation), Some(measured)) = (one.plan.recommended(), one.measured_nm) {
                let channels: Vec<String> = observation.channels.iter().map(|(nm, _)| nm.to_string()).collect();
                let waves: Vec<String> = observation.channels.iter().map(|(_, waves)| waves.to_string()).collect();
                cells.push(channels.join(" ").as_str().into());
                cells.push(waves.join(" ").as_str().into());
                cells.push(observation.exposures.unwrap_or(0).into());
                for (measured, expected) in measured.into_iter().zip(observation.expected_nm) {
                    cells.extend([
                        Cell::Number(expected, 3),
                        Cell::Number(measured, 3),
                        Cell::Number(measured / expected, 2),
                    ]);
                }
                cells.push(one.flagged.into());
            } else {
                cells.extend((0..10).map(|_| Cell::from("-")));
            }
            table.push(cells);
        }
        table
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let file = directory.join("observations.csv");
        self.table().write_csv(&file)?;
        let all: Vec<f64> = self.ratios().into_iter().flatten().collect();
        let [least, most] = [f64::min, f64::max].map(|choose| all.iter().copied().reduce(choose).unwrap_or(f64::NAN));
        let text = format!(
            "Observations as planned: expected and measured errors\n{}measured over expected: {least:.2} to {most:.2}, median {:.2}\n",
            self.table().text(),
            median(&all)
        );
        Ok(Report { text, files: vec![file] })
    }
}
