//! What retrievals find, image by image.

use super::optimisation::Found;
use crate::optimize::StopReason;
use ndarray::{Array2, ArrayViewMut1, Axis};

/// What the images of a sequence show.
#[derive(Debug, Clone)]
pub struct Phases {
    /// The whole wavefront, static and dynamic, piston, tip and tilt included, nm, `[image, lit sample]`; NaN for an image
    /// that cannot be used. Where a sample belongs to several segments it shows their mean by weight.
    pub phase_nm: Array2<f64>,
    /// Of it, what the coefficients hold: segments, then tip and tilt, nm, `[image, coefficient]`.
    pub coefficients_nm: Array2<f64>,
    /// Logarithm of each segment's amplitude over the model's, `[image, segment]`; no columns where amplitudes are known.
    pub ln_amplitudes: Array2<f64>,
    /// One for each image.
    pub reports: Vec<RetrievalReport>,
}

/// How one image's retrieval went.
#[derive(Debug, Clone, PartialEq)]
pub struct RetrievalReport {
    /// χ² per degree of freedom under the noise and the model error of the fitted model; NaN for an image that cannot be
    /// used.
    pub reduced_chi2: f64,
    /// What was minimised, χ² under the data's weights and what the prior adds, over the same degrees of freedom: a model that
    /// is not the instrument's shows here where wavefronts could be found that explain the image, and are improbable.
    pub reduced_objective: f64,
    /// Evaluations of objective and gradient.
    pub evaluations: usize,
    /// Why it stopped.
    pub reason: StopReason,
    /// Electrons of the star.
    pub flux_e: f64,
    /// Electrons per pixel of the background.
    pub background_e: f64,
    /// Why the image cannot be used.
    pub refusal: Option<String>,
}

impl Phases {
    /// Room for `images` with so many lit samples, coefficients, and amplitudes that vary.
    pub(super) fn unfinished(images: usize, [lit, coefficients, varied]: [usize; 3]) -> Self {
        let unknown = |columns: usize| Array2::from_elem((images, columns), f64::NAN);
        Self {
            phase_nm: unknown(lit),
            coefficients_nm: unknown(coefficients),
            ln_amplitudes: unknown(varied),
            reports: vec![RetrievalReport::refused(String::new()); images],
        }
    }

    /// What is kept of each image, one after the other.
    pub(super) fn rows(&mut self) -> impl Iterator<Item = Row<'_>> {
        let arrays = self.phase_nm.axis_iter_mut(Axis(0)).zip(self.coefficients_nm.axis_iter_mut(Axis(0)));
        let arrays = arrays.zip(self.ln_amplitudes.axis_iter_mut(Axis(0))).zip(&mut self.reports);
        arrays.map(|(((phase_nm, coefficients_nm), ln_amplitudes), report)| Row {
            phase_nm,
            coefficients_nm,
            ln_amplitudes,
            report,
        })
    }

    /// Keeps what was found of an image, or why it cannot be used.
    pub(super) fn keep(&mut self, image: usize, found: Result<Found, String>) {
        Row {
            phase_nm: self.phase_nm.row_mut(image),
            coefficients_nm: self.coefficients_nm.row_mut(image),
            ln_amplitudes: self.ln_amplitudes.row_mut(image),
            report: &mut self.reports[image],
        }
        .keep(found);
    }
}

/// What is kept of one image.
pub(super) struct Row<'a> {
    phase_nm: ArrayViewMut1<'a, f64>,
    coefficients_nm: ArrayViewMut1<'a, f64>,
    ln_amplitudes: ArrayViewMut1<'a, f64>,
    report: &'a mut RetrievalReport,
}

impl Row<'_> {
    /// Keeps what was found, or why the image cannot be used.
    pub(super) fn keep(mut self, found: Result<Found, String>) {
        match found {
            Err(refusal) => *self.report = RetrievalReport::refused(refusal),
            Ok(found) => {
                self.phase_nm.iter_mut().zip(found.phase_nm).for_each(|(out, nm)| *out = nm);
                self.coefficients_nm.iter_mut().zip(found.coefficients_nm).for_each(|(out, nm)| *out = nm);
                self.ln_amplitudes.iter_mut().zip(found.ln_amplitudes).for_each(|(out, ln)| *out = ln);
                *self.report = found.report;
            }
        }
    }
}

impl RetrievalReport {
    fn refused(refusal: String) -> Self {
        Self {
            reduced_chi2: f64::NAN,
            reduced_objective: f64::NAN,
            evaluations: 0,
            reason: StopReason::Unfinished,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            refusal: Some(refusal),
        }
    }
}
