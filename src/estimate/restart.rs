//! Another try for a fit that ended in the wrong place.
//!
//! From the flat wavefront nearly every image leads to its minimum. What does not shows: its χ² is hundreds of times what
//! noise explains, or the fit has used up its evaluations. It is tried again from elsewhere, and the best is kept.

use super::Estimator;
use super::minimum::Minimum;
use super::prepare::Prepared;
use super::status::{Status, judged};
use crate::Result;
use crate::imaging::Chain;
use crate::optimize::{CancelFlag, StopReason};
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// What another start keeps of where a fit ended, and how far aside it steps, waves RMS a mode. Of 32 draws with pistons of
/// 500 nm behind a defocus of 0.5 and 0.25 waves this brought 28 to the right minimum; 27 with all of the wrong one kept, and
/// then 25 with steps of half the size, 21 of twice the size.
const KEPT: f64 = 0.5;
const SEGMENT_WAVES: f64 = 0.05;
/// See [`SEGMENT_WAVES`].
const NCPA_WAVES: f64 = 0.02;

/// Makes the image at a place among those that were prepared ready once more, with its first weights.
pub(super) type Again<'a> = dyn Fn(usize) -> Option<Prepared> + 'a;

impl Estimator {
    /// Tries again those of `minima` that are in the wrong place, and keeps what is better.
    ///
    /// # Errors
    /// As [`super::fit::Fitter::fit`].
    pub(super) fn restart(
        &self,
        chain: &mut Chain,
        again: &Again,
        prepared: &mut [Prepared],
        minima: &mut [Minimum],
        cancel: Option<&CancelFlag>,
    ) -> Result<()> {
        for attempt in 1..=self.recipe.restarts {
            let reports = judged(self, prepared, minima);
            let lost = (0..minima.len()).filter(|&place| is_lost(&reports[place].status));
            let (places, mut fresh): (Vec<usize>, Vec<Prepared>) =
                lost.filter_map(|place| Some((place, again(place)?))).unzip();
            if places.is_empty() {
                break;
            }
            let starts: Vec<Vec<f64>> = places.iter().map(|&place| self.start(&minima[place], attempt)).collect();
            let starts: Vec<&[f64]> = starts.iter().map(Vec::as_slice).collect();
            let found =
                self.fitter(cancel).fit(chain, &mut fresh.iter_mut().collect::<Vec<_>>(), &starts, &mut |_, _| {})?;
            for ((place, found), fresh) in places.into_iter().zip(found).zip(fresh) {
                let before = &mut minima[place];
                let evaluations = before.evaluations + found.evaluations;
                if found.reduced_chi2 < before.reduced_chi2 || before.reduced_chi2.is_nan() {
                    (*before, prepared[place]) = (found, fresh);
                }
                before.evaluations = evaluations;
            }
        }
        Ok(())
    }

    /// Where to begin another time: half way back, and aside. The same steps for every image, so that a fit depends on its own
    /// image alone.
    fn start(&self, minimum: &Minimum, attempt: usize) -> Vec<f64> {
        let mut rng = ChaCha12Rng::seed_from_u64(attempt as u64);
        let wavelength_nm = self.model.optics.parts().wavelength_nm;
        let aside = |(mode, &nm): (usize, &f64)| {
            let waves = if mode < self.model.segment_modes { SEGMENT_WAVES } else { NCPA_WAVES };
            let normal: f64 = StandardNormal.sample(&mut rng);
            let kept = if nm.is_finite() { KEPT * nm } else { 0.0 };
            kept + waves * wavelength_nm * normal
        };
        minimum.coefficients_nm.iter().enumerate().map(aside).collect()
    }
}

/// Whether a fit ended in the wrong place, and another could end elsewhere.
fn is_lost(status: &Status) -> bool {
    match status {
        Status::WrongMinimum => true,
        Status::NotConverged(reason) => *reason == StopReason::EvaluationLimit,
        Status::Ok | Status::Misfit | Status::Unusable(_) => false,
    }
}
