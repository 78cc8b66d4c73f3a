//! Retrieval of a sequence of images, iteration after iteration about the last static wavefront.

use super::wavefront_source::{RetrievedSequence, WavefrontSource};
use crate::modal::Cube;
use crate::optimize::CancelFlag;
use crate::retrieval::{
    IlluminatedSamples, RadialPsd, RetrievalReport, RetrievedWavefronts, Retriever, StaticWavefront,
};
use crate::{Error, Result};
use ndarray::Array2;

/// Progress of an iteration.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SequenceProgress {
    /// Number of images whose wavefronts are retrieved: 0 where an iteration begins.
    Retrieved(usize),
    /// All are retrieved; their static errors are separated.
    Separating,
}

/// Retrieval of a sequence of images.
pub struct SequenceRetrieval<'a> {
    retriever: &'a Retriever,
    prior: &'a RadialPsd,
    samples: IlluminatedSamples,
    cube: Cube<'a>,
    slopes_mas: Option<Array2<f64>>,
    cancel: Option<&'a CancelFlag>,
    watch: &'a (dyn Fn(SequenceProgress) + Sync),
    /// Wavefronts about no static wavefront, until an iteration takes them.
    first: Option<RetrievedWavefronts>,
    /// Report of each image's last retrieval.
    pub reports: Vec<RetrievalReport>,
    /// Seconds in retrievals.
    pub seconds: f64,
}

impl<'a> SequenceRetrieval<'a> {
    /// For the images of `cube`, by `retriever` with `prior`, and the slopes that the wavefront sensor measured, if any.
    ///
    /// # Errors
    /// [`Error::Shape`] for telemetry of another number of images.
    pub fn new(
        retriever: &'a Retriever,
        prior: &'a RadialPsd,
        cube: Cube<'a>,
        slopes_mas: Option<Array2<f64>>,
        cancel: Option<&'a CancelFlag>,
        watch: &'a (dyn Fn(SequenceProgress) + Sync),
    ) -> Result<Self> {
        let count = cube.images_e.dim().0;
        if let Some(slopes_mas) = slopes_mas.as_ref().filter(|slopes_mas| slopes_mas.nrows() != count) {
            let rows = slopes_mas.nrows();
            return Err(Error::Shape(format!(
                "{rows} sets of slopes were given with {count} images: one each is needed"
            )));
        }
        let samples = retriever.illuminated_samples()?;
        Ok(Self {
            retriever,
            prior,
            samples,
            cube,
            slopes_mas,
            cancel,
            watch,
            first: None,
            reports: Vec::new(),
            seconds: 0.0,
        })
    }

    /// Retrieves the wavefronts of the first iteration, which do not depend on the slopes, `[image, sample]`, nm; NaN for
    /// unusable images.
    ///
    /// # Errors
    /// Those of [`Retriever::retrieve`].
    pub fn first_wavefronts_nm(&mut self) -> Result<&Array2<f64>> {
        let first = match self.first.take() {
            Some(first) => first,
            None => self.timed(None)?,
        };
        Ok(&self.first.insert(first).wavefront_nm)
    }

    /// Divides all slopes by `gain`.
    pub fn divide_slopes(&mut self, gain: f64) {
        if let Some(slopes_mas) = &mut self.slopes_mas {
            slopes_mas.mapv_inplace(|mas| mas / gain);
        }
    }

    fn timed(&mut self, about: Option<&StaticWavefront>) -> Result<RetrievedWavefronts> {
        (self.watch)(SequenceProgress::Retrieved(0));
        let started = std::time::Instant::now();
        let watch = |done: usize| (self.watch)(SequenceProgress::Retrieved(done));
        let wavefronts = self.retriever.retrieve(self.cube, about, self.cancel, &watch)?;
        self.seconds += started.elapsed().as_secs_f64();
        Ok(wavefronts)
    }
}

impl WavefrontSource for SequenceRetrieval<'_> {
    fn samples(&self) -> &IlluminatedSamples {
        &self.samples
    }

    fn prior(&self) -> Option<&RadialPsd> {
        Some(self.prior)
    }

    fn highest_frequency_per_m(&self) -> f64 {
        self.retriever.highest_frequency_per_m()
    }

    fn retrieve(&mut self, about: Option<&StaticWavefront>) -> Result<Option<RetrievedSequence>> {
        let first = self.first.take().filter(|_| about.is_none());
        let RetrievedWavefronts { wavefront_nm, reports, .. } = first.map_or_else(|| self.timed(about), Ok)?;
        let reduced_chi2 = reports.iter().map(|report| report.reduced_chi2).collect();
        self.reports = reports;
        (self.watch)(SequenceProgress::Separating);
        Ok(Some(RetrievedSequence { wavefront_nm, reduced_chi2, slopes_mas: self.slopes_mas.clone() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::{RetrievalSettings, StaticAberrationRms};
    use crate::scene::Scene;
    use crate::telescope::Telescope;
    use ndarray::Array3;

    #[test]
    fn piston_responses_agree_with_retrieved_wavefronts() {
        let settings = [
            ("pupil.aperture", "hexagonal"),
            ("pupil.rings", "1"),
            ("pupil.grid_m", "5.625"),
            ("pupil.samples", "64"),
            ("image.pixels", "128"),
        ];
        let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
        let prior = RadialPsd::ao_residual(&scene, StaticAberrationRms::default()).unwrap();
        let settings = RetrievalSettings { piston_rms_nm: 0.0, ..RetrievalSettings::default() };
        let retriever = Retriever::new(&scene, Telescope::new(&scene).unwrap(), &prior, settings).unwrap();
        let (images_e, bad) = (Array3::zeros((2, 240, 240)), Array3::from_elem((2, 240, 240), false));
        let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        let source = SequenceRetrieval::new(&retriever, &prior, cube, None, None, &|_| {}).unwrap();
        let pistons = &source.samples().pistons;
        let pistons_nm: Vec<f64> = (0..pistons.nrows()).map(|s| 50.0 * (2.4 * s as f64).sin()).collect();
        let retrieved = retriever.modal_wavefront_nm(&pistons_nm);
        let modelled = ndarray::aview1(&pistons_nm).dot(pistons);
        // Edges that differ by a tenth put 15 nm into the phasing, so only rounding is allowed. Where the weights of several
        // segments cancel to a tenth of their moduli it is magnified by some hundred.
        assert!(retrieved.iter().zip(&modelled).all(|(retrieved, modelled)| (retrieved - modelled).abs() < 1e-10));
        let slopes = Some(Array2::zeros((3, 4)));
        assert!(SequenceRetrieval::new(&retriever, &prior, cube, slopes, None, &|_| {}).is_err());
    }
}
