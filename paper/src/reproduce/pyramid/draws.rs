//! One draw of a row: modal fits and the full-phase estimate of the same images.

use super::super::on_sky::{Reader, Sequence};
use super::super::{KeptDraw, Progress, RowDraw, Way, to_cells, to_numbers};
use cophase::scene::Scene;
use cophase::{Error, Result};

/// Times that each image of a draw is read: modal fits both ways, and the full-phase estimate.
pub(super) const PASSES: usize = Way::BOTH.len() + 1;

/// One draw of a row.
#[derive(Debug, Clone)]
pub struct PyramidDraw {
    /// The loop, and modal fits both ways.
    pub modal: RowDraw,
    /// The full-phase estimate.
    pub full_phase: FullPhaseReading,
}

/// Full-phase estimate of a sequence against its truth.
#[derive(Debug, Clone, PartialEq)]
pub struct FullPhaseReading {
    /// Residuals of phasing and NCPA, nm.
    pub residuals_nm: [f64; 2],
    /// Their error bars, nm.
    pub sigmas_nm: [f64; 2],
    /// Images that were combined.
    pub used: usize,
    /// Iterations.
    pub iterations: usize,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Measured slopes over those of the retrieved wavefronts.
    pub slope_gain: f64,
    /// Wall-clock time, s.
    pub seconds: f64,
}

/// Numbers of a [`FullPhaseReading`].
const NUMBERS: usize = 9;

impl PyramidDraw {
    /// What `readers`, and the full-phase estimate of `scene`, make of the sequence of draw `seed`.
    ///
    /// # Errors
    /// Those of the estimators.
    pub(super) fn read(
        scene: &Scene,
        seed: usize,
        sequence: &Sequence,
        readers: &[Reader],
        progress: &Progress,
    ) -> Result<Self> {
        let full_phase = FullPhaseReading::new(scene, sequence, &readers[0], progress)?;
        progress.add(scene.image.count);
        Ok(Self { modal: RowDraw::read(seed, sequence, readers, progress)?, full_phase })
    }
}

impl FullPhaseReading {
    /// Where there are no images.
    fn none() -> Self {
        let none = f64::NAN;
        Self {
            residuals_nm: [none; 2],
            sigmas_nm: [none; 2],
            used: 0,
            iterations: 0,
            reduced_chi2: none,
            slope_gain: none,
            seconds: 0.0,
        }
    }

    fn new(scene: &Scene, sequence: &Sequence, reader: &Reader, progress: &Progress) -> Result<Self> {
        if sequence.images() == 0 {
            return Ok(Self::none());
        }
        let reading_scene = scene.with_override("estimate.method", "full-phase")?;
        let found = match sequence.full_phase(&reading_scene, sequence.images(), progress) {
            Ok(found) => found,
            // A lost loop leaves images that cannot be used.
            Err(Error::Image(_)) => return Ok(Self::none()),
            Err(error) => return Err(error),
        };
        let map = found.full_phase();
        Ok(Self {
            residuals_nm: reader.residuals_nm(sequence, found.maps.phasing_nm.view(), found.maps.ncpa_nm.view())?,
            sigmas_nm: [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm],
            used: found.used(),
            iterations: map.map_or(0, |map| map.iterations.len()),
            reduced_chi2: found.reduced_chi2,
            slope_gain: map.and_then(|map| map.telemetry.as_ref()).map_or(f64::NAN, |check| check.gain),
            seconds: found.run.seconds,
        })
    }
}

impl KeptDraw for PyramidDraw {
    fn cells(&self) -> Vec<String> {
        let &FullPhaseReading { residuals_nm, sigmas_nm, used, iterations, reduced_chi2, slope_gain, seconds } =
            &self.full_phase;
        let counts = [used as f64, iterations as f64];
        let numbers = [&residuals_nm[..], &sigmas_nm, &counts, &[reduced_chi2, slope_gain, seconds]].concat();
        to_cells(&numbers).into_iter().chain(self.modal.cells()).collect()
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let (numbers, modal) = cells.split_at_checked(NUMBERS)?;
        let [phasing, ncpa, sigma, ncpa_sigma, used, iterations, reduced_chi2, slope_gain, seconds] =
            to_numbers(numbers)?[..]
        else {
            return None;
        };
        let full_phase = FullPhaseReading {
            residuals_nm: [phasing, ncpa],
            sigmas_nm: [sigma, ncpa_sigma],
            used: used as usize,
            iterations: iterations as usize,
            reduced_chi2,
            slope_gain,
            seconds,
        };
        Some(Self { modal: RowDraw::from_cells(modal)?, full_phase })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::Reading;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        let full_phase = FullPhaseReading {
            residuals_nm: [1.0 / 3.0, 0.1],
            sigmas_nm: [4.1, 1.2e-9],
            used: 74,
            iterations: 5,
            reduced_chi2: 1.4,
            slope_gain: f64::NAN,
            seconds: 0.7,
        };
        let reading = |way| Reading {
            way,
            phasing_nm: 30.0,
            ncpa_nm: f64::NAN,
            used: 75,
            reduced_chi2: 2.0,
            evaluations: 12.5,
            seconds: 0.1,
        };
        let modal = RowDraw { seed: 3, images: 75, run: None, readings: Way::BOTH.map(reading).into() };
        crate::experiment::assert_survives(&PyramidDraw { modal, full_phase });
    }
}
