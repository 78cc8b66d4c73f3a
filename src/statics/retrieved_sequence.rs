//! Phases that are retrieved from images, pass after pass about the static wavefront found before.

use super::iterations::{Measured, PhaseSource, StaticWavefront};
use crate::estimate::Cube;
use crate::optimize::CancelFlag;
use crate::retrieval::{LitSamples, Phases, RetrievalReport, Retriever, Spectrum, Statics};
use crate::{Error, Result};
use ndarray::{Array2, Array3};

/// Where phases come from for images of a sequence.
pub struct RetrievedPhases<'a> {
    retriever: &'a Retriever,
    prior: &'a Spectrum,
    lit: LitSamples,
    images_e: &'a Array3<f64>,
    bad: &'a Array3<bool>,
    read_noise_e: Option<f64>,
    slopes_mas: Option<Array2<f64>>,
    cancel: Option<&'a CancelFlag>,
    watch: &'a (dyn Fn(usize) + Sync),
    /// How each image's retrieval went in the last pass.
    pub reports: Vec<RetrievalReport>,
    /// Seconds in retrievals.
    pub seconds: f64,
}

impl<'a> RetrievedPhases<'a> {
    /// For images that `retriever` reads with `prior`, with what the wavefront sensor measured meanwhile, if that is known.
    ///
    /// # Errors
    /// [`Error::Shape`] for telemetry of another number of images.
    pub fn new(
        retriever: &'a Retriever,
        prior: &'a Spectrum,
        cube: (&'a Array3<f64>, &'a Array3<bool>, Option<f64>),
        slopes_mas: Option<Array2<f64>>,
        cancel: Option<&'a CancelFlag>,
        watch: &'a (dyn Fn(usize) + Sync),
    ) -> Result<Self> {
        let (images_e, bad, read_noise_e) = cube;
        let count = images_e.dim().0;
        if let Some(slopes_mas) = slopes_mas.as_ref().filter(|slopes_mas| slopes_mas.nrows() != count) {
            let rows = slopes_mas.nrows();
            return Err(Error::Shape(format!(
                "{rows} sets of slopes were given with {count} images: one each is needed"
            )));
        }
        let model = retriever.model();
        let samples = model.optics.sampling().samples;
        let pitch_m = model.width_ratio() * model.telescope.pupil.grid.width_m() / samples as f64;
        let lit = LitSamples::of(samples, pitch_m, &model.optics.parts().weights)?;
        Ok(Self {
            retriever,
            prior,
            lit,
            images_e,
            bad,
            read_noise_e,
            slopes_mas,
            cancel,
            watch,
            reports: Vec::new(),
            seconds: 0.0,
        })
    }
}

impl PhaseSource for RetrievedPhases<'_> {
    fn lit(&self) -> &LitSamples {
        &self.lit
    }

    fn least(&self) -> Option<&Spectrum> {
        Some(self.prior)
    }

    fn seen_to_per_m(&self) -> f64 {
        self.retriever.seen_to_per_m()
    }

    fn phases(&mut self, found: Option<&StaticWavefront>) -> Result<Option<Measured>> {
        let started = std::time::Instant::now();
        let statics =
            found.map(|found| Statics { segments_nm: found.pistons_nm.clone(), map_nm: found.smooth_nm.to_vec() });
        let cube = Cube { images_e: self.images_e.view(), bad: self.bad.view(), read_noise_e: self.read_noise_e };
        let Phases { phase_nm, reports, .. } =
            self.retriever.retrieve(cube, statics.as_ref(), self.cancel, self.watch)?;
        self.seconds += started.elapsed().as_secs_f64();
        let reduced_chi2 = reports.iter().map(|report| report.reduced_chi2).collect();
        self.reports = reports;
        Ok(Some(Measured { phase_nm, reduced_chi2, slopes_mas: self.slopes_mas.clone() }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::{RetrievalRecipe, Spectrum, Unknown};
    use crate::scene::Scene;

    #[test]
    fn pistons_are_sought_as_retrieved_phases_show_them() {
        let settings = [
            ("pupil.aperture", "hexagonal"),
            ("pupil.rings", "1"),
            ("pupil.grid_m", "5.625"),
            ("pupil.samples", "64"),
            ("image.pixels", "128"),
        ];
        let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
        let prior = Spectrum::of_scene(&scene, Unknown::default()).unwrap();
        let recipe = RetrievalRecipe { piston_rms_nm: 0.0, ..RetrievalRecipe::default() };
        let retriever = Retriever::new(&scene, &prior, recipe).unwrap();
        let (images_e, bad) = (Array3::zeros((2, 240, 240)), Array3::from_elem((2, 240, 240), false));
        let cube = (&images_e, &bad, None);
        let source = RetrievedPhases::new(&retriever, &prior, cube, None, None, &|_| {}).unwrap();
        let pistons_nm: Vec<f64> = (0..source.lit().pistons.nrows()).map(|s| 50.0 * (2.4 * s as f64).sin()).collect();
        let shown = retriever.shown_nm(&pistons_nm);
        let sought = ndarray::aview1(&pistons_nm).dot(&source.lit().pistons);
        // Edges that differ by a tenth put 15 nm into the phasing: rounding is all that may be between them. Where the weights
        // of several segments cancel to a tenth of their sizes it is magnified by some hundred.
        assert!(shown.iter().zip(&sought).all(|(shown, sought)| (shown - sought).abs() < 1e-10));
        let slopes = Some(Array2::zeros((3, 4)));
        assert!(RetrievedPhases::new(&retriever, &prior, cube, slopes, None, &|_| {}).is_err());
    }
}
