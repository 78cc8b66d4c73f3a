//! One seed of one row of the paper's table.

use super::on_sky::{LoopRun, Reader, Reading, Sequence};
use super::{KeptDraw, Progress, Way, to_cells, to_numbers};
use cophase::Result;

/// One seed of one row.
#[derive(Debug, Clone)]
pub struct RowDraw {
    /// The seed of aberrations, turbulence and noise.
    pub seed: usize,
    /// Images that there were.
    pub images: usize,
    /// How the loop did; none without a loop.
    pub run: Option<LoopRun>,
    /// In the order of [`Way::BOTH`].
    pub readings: Vec<Reading>,
}

impl RowDraw {
    /// What `readers` make of the sequence of draw `seed`.
    ///
    /// # Errors
    /// As [`Reader::read`].
    pub(super) fn read(seed: usize, sequence: &Sequence, readers: &[Reader], progress: &Progress) -> Result<Self> {
        let readings = readers.iter().map(|reader| reader.read(sequence, progress)).collect::<Result<_>>()?;
        Ok(Self { seed, images: sequence.images(), run: sequence.run.clone(), readings })
    }
}

impl KeptDraw for RowDraw {
    fn cells(&self) -> Vec<String> {
        let number = |is: bool| f64::from(u8::from(is));
        let readings = self.readings.iter().flat_map(|reading| {
            let &Reading { way: _, phasing_nm, ncpa_nm, used, reduced_chi2, evaluations, seconds } = reading;
            [phasing_nm, ncpa_nm, used as f64, reduced_chi2, evaluations, seconds]
        });
        let run = self.run.iter().flat_map(|run| {
            let counts = [run.controlled as f64, run.masked as f64, number(run.stable)];
            let poles = [run.e_folding_s, run.largest_stable_gain, run.diverged_at_s.unwrap_or(f64::NAN)];
            [counts, poles, [run.residual_rms_nm, run.strehl, run.frames_per_s]].concat()
        });
        to_cells(&[self.seed as f64, self.images as f64].into_iter().chain(readings).chain(run).collect::<Vec<_>>())
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let numbers = to_numbers(cells)?;
        let ([seed, images], rest) = numbers.split_first_chunk()?;
        let (readings, run) = rest.split_at_checked(6 * Way::BOTH.len())?;
        let reading = |(way, &[phasing_nm, ncpa_nm, used, reduced_chi2, evaluations, seconds]): (Way, &[f64; 6])| {
            Reading { way, phasing_nm, ncpa_nm, used: used as usize, reduced_chi2, evaluations, seconds }
        };
        let run = match *run {
            [] => None,
            [controlled, masked, stable, e_folding_s, largest_stable_gain, diverged_at_s, residual, strehl, rate] => {
                Some(LoopRun {
                    controlled: controlled as usize,
                    masked: masked as usize,
                    stable: stable != 0.0,
                    e_folding_s,
                    largest_stable_gain,
                    diverged_at_s: (!diverged_at_s.is_nan()).then_some(diverged_at_s),
                    residual_rms_nm: residual,
                    strehl,
                    frames_per_s: rate,
                })
            }
            _ => return None,
        };
        let readings = Way::BOTH.into_iter().zip(readings.as_chunks().0).map(reading).collect();
        Some(Self { seed: *seed as usize, images: *images as usize, run, readings })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        let (phasing_nm, used, evaluations) = (1.0 / 3.0, 39, 12.5);
        let reading =
            |way| Reading { way, phasing_nm, ncpa_nm: f64::NAN, used, reduced_chi2: 1.1, evaluations, seconds: 0.1 };
        let run = |diverged_at_s| LoopRun {
            controlled: 294,
            masked: 12,
            stable: false,
            e_folding_s: f64::NAN,
            largest_stable_gain: 0.4,
            diverged_at_s,
            residual_rms_nm: 160.0,
            strehl: 0.1,
            frames_per_s: 1e4 / 3.0,
        };
        for run in [None, Some(run(None)), Some(run(Some(2.5)))] {
            let readings = Way::BOTH.map(reading).into();
            crate::experiment::assert_survives(&RowDraw { seed: 2, images: 40, run, readings });
        }
    }
}
