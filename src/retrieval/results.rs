//! Results of MAP retrievals: wavefront and report of each image.

use crate::modal::Refusal;
use crate::optimize::StopReason;
use ndarray::{Array2, ArrayViewMut1, Axis};

/// Report of one image's retrieval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetrievalReport {
    /// χ² per degree of freedom under the noise and the model error of the fitted model; NaN for an
    /// unusable image.
    pub reduced_chi2: f64,
    /// Minimum of the objective, χ² under the data's weights plus the prior's term, over the same
    /// degrees of freedom. Optics that differ from the instrument's raise it where an improbable
    /// wavefront can still fit the image.
    pub reduced_objective: f64,
    /// Evaluations of objective and gradient.
    pub evaluations: usize,
    /// Reason why the optimiser stopped.
    pub reason: StopReason,
    /// Flux of the star, electrons.
    pub flux_e: f64,
    /// Background, electrons per pixel.
    pub background_e: f64,
    /// Reason why the image is unusable.
    pub refusal: Option<Refusal>,
}

impl RetrievalReport {
    /// That of an image without a wavefront.
    fn unfinished(refusal: Option<Refusal>) -> Self {
        Self {
            reduced_chi2: f64::NAN,
            reduced_objective: f64::NAN,
            evaluations: 0,
            reason: StopReason::Unfinished,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            refusal,
        }
    }
}

/// MAP estimate from one image.
pub(super) struct RetrievedImage {
    pub(super) wavefront_nm: Vec<f64>,
    pub(super) coefficients_nm: Vec<f64>,
    /// Logarithm of each segment's amplitude over the model's, where amplitudes are unknowns.
    pub(super) ln_amplitudes: Vec<f64>,
    /// What the blur of the exposure changes in the image, electrons; empty where it is not known.
    pub(super) blur_e: Vec<f32>,
    /// Coordinates of the optimiser at the estimate.
    pub(super) coordinates: Vec<f32>,
    pub(super) report: RetrievalReport,
}

/// Retrieved wavefronts of the images of a sequence.
#[derive(Debug, Clone)]
pub struct RetrievedWavefronts {
    /// Whole wavefront, static and dynamic, piston, tip and tilt included, nm,
    /// `[image, illuminated sample]`; NaN for an unusable image. A sample of several segments has
    /// their mean by weight.
    pub wavefront_nm: Array2<f64>,
    /// Coefficients in it: segments, then tip and tilt, nm, `[image, coefficient]`.
    pub coefficients_nm: Array2<f64>,
    /// Logarithm of each segment's amplitude over the model's, `[image, segment]`; no columns where
    /// amplitudes are known.
    pub ln_amplitudes: Array2<f64>,
    /// What the motion of the turbulence during each exposure changes in its image, electrons in
    /// the model's pixels; empty where it is not known. The next retrieval of the images takes it
    /// off.
    pub blur_e: Vec<Vec<f32>>,
    /// Coordinates of the optimiser at each image's estimate, for
    /// [`Retriever::retrieve_from`](super::Retriever::retrieve_from), which alone keeps them.
    pub(super) coordinates: Vec<Vec<f32>>,
    /// Report of each image.
    pub reports: Vec<RetrievalReport>,
}

impl RetrievedWavefronts {
    /// Unfinished results of `images`, with these numbers of illuminated samples, coefficients and
    /// unknown amplitudes.
    pub(super) fn unfinished(images: usize, [samples, coefficients, amplitudes]: [usize; 3]) -> Self {
        let unknown = |columns: usize| Array2::from_elem((images, columns), f64::NAN);
        Self {
            wavefront_nm: unknown(samples),
            coefficients_nm: unknown(coefficients),
            ln_amplitudes: unknown(amplitudes),
            blur_e: vec![Vec::new(); images],
            coordinates: vec![Vec::new(); images],
            reports: vec![RetrievalReport::unfinished(None); images],
        }
    }

    /// Mutable views of the images' results, in turn.
    pub(super) fn images_mut(&mut self) -> impl Iterator<Item = ImageResultMut<'_>> {
        let arrays = self.wavefront_nm.axis_iter_mut(Axis(0)).zip(self.coefficients_nm.axis_iter_mut(Axis(0)));
        let arrays = arrays
            .zip(self.ln_amplitudes.axis_iter_mut(Axis(0)))
            .zip(&mut self.blur_e)
            .zip(&mut self.coordinates)
            .zip(&mut self.reports);
        arrays.map(|(((((wavefront_nm, coefficients_nm), ln_amplitudes), blur_e), coordinates), report)| {
            ImageResultMut { wavefront_nm, coefficients_nm, ln_amplitudes, blur_e, coordinates, report }
        })
    }

    /// Stores the result of an image, or the reason why it is unusable.
    pub(super) fn store(&mut self, image: usize, result: Result<RetrievedImage, Refusal>) {
        ImageResultMut {
            wavefront_nm: self.wavefront_nm.row_mut(image),
            coefficients_nm: self.coefficients_nm.row_mut(image),
            ln_amplitudes: self.ln_amplitudes.row_mut(image),
            blur_e: &mut self.blur_e[image],
            coordinates: &mut self.coordinates[image],
            report: &mut self.reports[image],
        }
        .store(result);
    }
}

/// Mutable view of one image's result.
pub(super) struct ImageResultMut<'a> {
    wavefront_nm: ArrayViewMut1<'a, f64>,
    coefficients_nm: ArrayViewMut1<'a, f64>,
    ln_amplitudes: ArrayViewMut1<'a, f64>,
    blur_e: &'a mut Vec<f32>,
    coordinates: &'a mut Vec<f32>,
    report: &'a mut RetrievalReport,
}

impl ImageResultMut<'_> {
    /// Stores a result, or the reason why the image is unusable.
    pub(super) fn store(mut self, result: Result<RetrievedImage, Refusal>) {
        match result {
            Err(refusal) => *self.report = RetrievalReport::unfinished(Some(refusal)),
            Ok(image) => {
                self.wavefront_nm.iter_mut().zip(image.wavefront_nm).for_each(|(out, nm)| *out = nm);
                self.coefficients_nm.iter_mut().zip(image.coefficients_nm).for_each(|(out, nm)| *out = nm);
                self.ln_amplitudes.iter_mut().zip(image.ln_amplitudes).for_each(|(out, ln)| *out = ln);
                *self.blur_e = image.blur_e;
                *self.coordinates = image.coordinates;
                *self.report = image.report;
            }
        }
    }
}
