//! Planned observations: the errors that they promise against those of images taken so.

use super::statistics::median;
use super::{Cell, KeptDraw, Progress, Report, Table, to_cells, to_numbers};
use cophase::pipeline::plan_observation;
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
    budget_nm: f64,
    /// None where no observation is recommended.
    observed: Option<Observed>,
}

/// The observation that a plan recommends, and its draws.
#[derive(Debug, Clone)]
struct Observed {
    /// Wavelength, nm, and defocus, waves RMS, of each channel.
    channels: Vec<(f64, f64)>,
    exposures: usize,
    /// Error bars of phasing and NCPA that the plan promises, nm.
    expected_nm: [f64; 2],
    /// RMS residuals of phasing and NCPA over the draws, nm.
    measured_nm: [f64; 2],
    flagged: usize,
}

impl KeptDraw for PlannedScene {
    fn cells(&self) -> Vec<String> {
        let observed = self.observed.iter().flat_map(|observed| {
            let Observed { channels, exposures, expected_nm, measured_nm, flagged } = observed;
            let channels = channels.iter().flat_map(|&(nm, waves)| [nm, waves]);
            let own = [[*exposures as f64, *flagged as f64], *expected_nm, *measured_nm].concat();
            own.into_iter().chain(channels)
        });
        to_cells(&std::iter::once(self.budget_nm).chain(observed).collect::<Vec<_>>())
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let numbers = to_numbers(cells)?;
        let (&budget_nm, rest) = numbers.split_first()?;
        let observed = rest.split_first_chunk().map(|(&[exposures, flagged, p, n, mp, mn], channels)| Observed {
            channels: channels.as_chunks().0.iter().map(|&[nm, waves]| (nm, waves)).collect(),
            exposures: exposures as usize,
            expected_nm: [p, n],
            measured_nm: [mp, mn],
            flagged: flagged as usize,
        });
        Some(Self { budget_nm, observed })
    }
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
    let make = |number: u64| {
        let (scene, budget_nm, wavelengths_nm) = random(number)?;
        let plan = plan_observation(&scene, wavelengths_nm, budget_nm, progress.control())?;
        let mut found = PlannedScene { budget_nm: plan.budget_nm, observed: None };
        if let Some(observation) = plan.recommended() {
            let estimator = Estimator::new(&observation.scene)?;
            let (mut squares, mut flagged) = ([0.0; 2], 0);
            for seed in 1..=seeds {
                progress.check()?;
                let images =
                    Images::simulated(&observation.scene.with_override("aberrations.seed", &seed.to_string())?)?;
                let estimate = estimator.estimate(&images)?;
                let Some((_, residual)) = &estimate.truth else {
                    return Err(Error::Internal("a simulated image has no truth".into()));
                };
                (0..2).for_each(|part| squares[part] += residual.rms_nm[part].powi(2) / seeds as f64);
                flagged += usize::from(!estimate.is_sound());
            }
            found.observed = Some(Observed {
                channels: observation.channels.clone(),
                exposures: observation.exposures.unwrap_or(0),
                expected_nm: observation.expected_nm,
                measured_nm: squares.map(f64::sqrt),
                flagged,
            });
        }
        progress.add(1);
        Ok(found)
    };
    // The number of draws of a scene is one of the things that its row depends on.
    let row = format!("{seeds} draws");
    let one = |number: u64| progress.draw((&row, number as usize, number as usize), 1, || make(number)).transpose();
    Ok(Observations((0..SCENES).into_par_iter().filter_map(one).collect::<Result<Vec<_>>>()?))
}

impl Observations {
    /// Measured over expected errors of all scenes that were planned, phasing and NCPA.
    pub fn ratios(&self) -> Vec<[f64; 2]> {
        let ratio = |one: &PlannedScene| {
            let Observed { expected_nm: expected, measured_nm: measured, .. } = one.observed.as_ref()?;
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
            let mut cells: Vec<Cell> = vec![number.into(), Cell::Number(one.budget_nm, 2)];
            if let Some(observation) = &one.observed {
                let channels: Vec<String> = observation.channels.iter().map(|(nm, _)| nm.to_string()).collect();
                let waves: Vec<String> = observation.channels.iter().map(|(_, waves)| waves.to_string()).collect();
                cells.push(channels.join(" ").as_str().into());
                cells.push(waves.join(" ").as_str().into());
                cells.push(observation.exposures.into());
                for (measured, expected) in observation.measured_nm.into_iter().zip(observation.expected_nm) {
                    cells.extend([
                        Cell::Number(expected, 3),
                        Cell::Number(measured, 3),
                        Cell::Number(measured / expected, 2),
                    ]);
                }
                cells.push(observation.flagged.into());
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_is_kept_to_the_bit() {
        let (expected_nm, measured_nm) = ([1.0 / 3.0, 0.1], [0.3, f64::NAN]);
        let channels = vec![(2168.6, 1.5), (1640.0, -0.75)];
        let observed = Observed { channels, exposures: 40, expected_nm, measured_nm, flagged: 1 };
        for observed in [None, Some(observed)] {
            crate::experiment::assert_survives(&PlannedScene { budget_nm: 0.7, observed });
        }
    }
}
