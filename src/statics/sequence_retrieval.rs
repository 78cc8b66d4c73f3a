//! Retrieval of a sequence of images, of one channel or of several, iteration after iteration about
//! the last static wavefront.

use super::wavefront_source::{RetrievedSequence, WavefrontSource};
use crate::control::{Control, Stage};
use crate::modal::Cube;
use crate::retrieval::{
    IlluminatedSamples, RadialPsd, RetrievalReport, RetrievedWavefronts, Retriever, StaticWavefront,
};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis, concatenate};

/// Images of one channel, and the retriever of their wavefronts.
#[derive(Clone, Copy)]
pub struct ChannelSequence<'a> {
    /// By the scene of the channel.
    pub retriever: &'a Retriever,
    /// Its images.
    pub cube: Cube<'a>,
}

/// Retrieval of a sequence of images, of one channel or of several.
///
/// The wavefront of an exposure is that of its image, or the mean over its images where all
/// channels took it at once.
pub struct SequenceRetrieval<'a> {
    channels: Vec<ChannelSequence<'a>>,
    /// Whether image i of every channel is of exposure i.
    is_simultaneous: bool,
    prior: &'a RadialPsd,
    samples: IlluminatedSamples,
    slopes_mas: Option<Array2<f64>>,
    /// By how much corrections have moved the reference slopes, mas.
    moved_reference_mas: Option<Array1<f64>>,
    control: &'a Control,
    /// Static wavefront about which the first wavefronts are retrieved.
    start: Option<StaticWavefront>,
    /// Wavefronts of the first iteration, until it takes them.
    first: Option<Exposures>,
    /// What the blur of each exposure changes in its image, by the last retrievals of each channel,
    /// electrons.
    blur_e: Vec<Vec<Vec<f32>>>,
    /// Report of each image's last retrieval, channel after channel.
    pub reports: Vec<RetrievalReport>,
    /// Seconds in retrievals.
    pub seconds: f64,
}

/// Wavefronts of the exposures.
struct Exposures {
    /// `[exposure, sample]`, nm; NaN where no image can be used.
    wavefront_nm: Array2<f64>,
    reduced_chi2: Vec<f64>,
    /// Of each image, channel after channel.
    reports: Vec<RetrievalReport>,
}

impl<'a> SequenceRetrieval<'a> {
    /// For the images of `channels`, whose retrievers have the same samples, with the wavefronts'
    /// `prior` and the slopes that the wavefront sensor measured in each exposure, if any.
    ///
    /// # Errors
    /// [`Error::Shape`] for telemetry of another number of exposures, and for simultaneous channels
    /// with different numbers of images.
    pub fn new(
        channels: Vec<ChannelSequence<'a>>,
        is_simultaneous: bool,
        prior: &'a RadialPsd,
        slopes_mas: Option<Array2<f64>>,
        control: &'a Control,
    ) -> Result<Self> {
        let Some(first) = channels.first() else { return Err(Error::Internal("a sequence without channels".into())) };
        let counts: Vec<usize> = channels.iter().map(ChannelSequence::images).collect();
        if is_simultaneous && counts.iter().any(|&count| count != counts[0]) {
            return Err(Error::Shape(format!(
                "the channels have {counts:?} images: as many of each are needed where image.simultaneous is true"
            )));
        }
        let exposures = if is_simultaneous { counts[0] } else { counts.iter().sum() };
        if let Some(slopes_mas) = slopes_mas.as_ref().filter(|slopes_mas| slopes_mas.nrows() != exposures) {
            let rows = slopes_mas.nrows();
            return Err(Error::Shape(format!(
                "{rows} sets of slopes were given with {exposures} exposures: one each is needed"
            )));
        }
        Ok(Self {
            samples: first.retriever.illuminated_samples()?,
            blur_e: vec![Vec::new(); channels.len()],
            channels,
            is_simultaneous,
            prior,
            slopes_mas,
            moved_reference_mas: None,
            control,
            start: None,
            first: None,
            reports: Vec::new(),
            seconds: 0.0,
        })
    }

    /// This sequence, whose first wavefronts are retrieved about `start`.
    pub fn about(self, start: Option<StaticWavefront>) -> Self {
        Self { start, ..self }
    }

    /// This sequence, whose slopes are relative to a reference that corrections have moved by
    /// `moved_mas`, mas for each slope.
    pub fn with_moved_reference(self, moved_mas: Option<Array1<f64>>) -> Self {
        Self { moved_reference_mas: moved_mas, ..self }
    }

    /// Retrieves the wavefronts of the first iteration, which do not depend on the slopes,
    /// `[exposure, sample]`, nm; NaN for unusable images.
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

    /// Divides all slopes, and the move of the reference, by `gain`.
    pub fn divide_slopes(&mut self, gain: f64) {
        if let Some(slopes_mas) = &mut self.slopes_mas {
            slopes_mas.mapv_inplace(|mas| mas / gain);
        }
        if let Some(moved_mas) = &mut self.moved_reference_mas {
            moved_mas.mapv_inplace(|mas| mas / gain);
        }
    }

    fn timed(&mut self, about: Option<&StaticWavefront>) -> Result<Exposures> {
        self.control.enter(Stage::Retrieving, self.channels.iter().map(ChannelSequence::images).sum());
        let started = std::time::Instant::now();
        let mut retrieved = Vec::new();
        for (ChannelSequence { retriever, cube }, blur_e) in self.channels.iter().zip(&mut self.blur_e) {
            let about = about.or(self.start.as_ref());
            let mut found = retriever.retrieve_without(blur_e, *cube, about, self.control)?;
            *blur_e = std::mem::take(&mut found.blur_e);
            retrieved.push(found);
        }
        self.seconds += started.elapsed().as_secs_f64();
        if self.is_simultaneous { Ok(simultaneous(retrieved)) } else { successive(retrieved) }
    }
}

impl<'a> ChannelSequence<'a> {
    pub(crate) fn images(&self) -> usize {
        self.cube.images_e.dim().0
    }

    /// The same images, borrowed for less long: array views are invariant in their lifetime.
    pub(crate) fn reborrow<'b>(self) -> ChannelSequence<'b>
    where
        'a: 'b,
    {
        let Cube { images_e, bad, read_noise_e } = self.cube;
        let cube = Cube { images_e: images_e.reborrow(), bad: bad.reborrow(), read_noise_e };
        ChannelSequence { retriever: self.retriever, cube }
    }
}

/// An exposure for each image, channel after channel.
fn successive(channels: Vec<RetrievedWavefronts>) -> Result<Exposures> {
    let views: Vec<_> = channels.iter().map(|channel| channel.wavefront_nm.view()).collect();
    let wavefront_nm = concatenate(Axis(0), &views).map_err(|error| Error::Internal(error.to_string()))?;
    let reports: Vec<_> = channels.into_iter().flat_map(|channel| channel.reports).collect();
    let reduced_chi2 = reports.iter().map(|report| report.reduced_chi2).collect();
    Ok(Exposures { wavefront_nm, reduced_chi2, reports })
}

/// Means over the usable images of each exposure, one of each channel.
fn simultaneous(channels: Vec<RetrievedWavefronts>) -> Exposures {
    let mut wavefront_nm = Array2::zeros(channels[0].wavefront_nm.dim());
    let mut reduced_chi2 = vec![0.0; wavefront_nm.nrows()];
    for (exposure, mut mean_nm) in wavefront_nm.outer_iter_mut().enumerate() {
        let is_usable = |channel: &&RetrievedWavefronts| channel.reports[exposure].refusal.is_none();
        let usable: Vec<_> = channels.iter().filter(is_usable).collect();
        // Without any, 0/0 marks the exposure as unusable.
        let share = 1.0 / usable.len() as f64;
        for channel in &usable {
            mean_nm += &channel.wavefront_nm.row(exposure);
            reduced_chi2[exposure] += share * channel.reports[exposure].reduced_chi2;
        }
        mean_nm.mapv_inplace(|nm| nm * share);
    }
    Exposures {
        wavefront_nm,
        reduced_chi2,
        reports: channels.into_iter().flat_map(|channel| channel.reports).collect(),
    }
}

impl WavefrontSource for SequenceRetrieval<'_> {
    fn samples(&self) -> &IlluminatedSamples {
        &self.samples
    }

    fn prior(&self) -> Option<&RadialPsd> {
        Some(self.prior)
    }

    fn moved_reference_mas(&self) -> Option<&Array1<f64>> {
        self.moved_reference_mas.as_ref()
    }

    fn start_pistons_nm(&self) -> Option<&[f64]> {
        self.start.as_ref().map(|start| &start.segments_nm[..])
    }

    fn highest_frequency_per_m(&self) -> f64 {
        let each = self.channels.iter().map(|channel| channel.retriever.highest_frequency_per_m());
        each.fold(f64::INFINITY, f64::min)
    }

    fn retrieve(&mut self, about: Option<&StaticWavefront>) -> Result<Option<RetrievedSequence>> {
        let first = self.first.take().filter(|_| about.is_none());
        let Exposures { wavefront_nm, reduced_chi2, reports } = first.map_or_else(|| self.timed(about), Ok)?;
        self.reports = reports;
        self.control.enter(Stage::Separating, 0);
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
        let channel = ChannelSequence { retriever: &retriever, cube };
        let control = Control::default();
        let source = SequenceRetrieval::new(vec![channel], false, &prior, None, &control).unwrap();
        let pistons = &source.samples().pistons;
        let pistons_nm: Vec<f64> = (0..pistons.nrows()).map(|s| 50.0 * (2.4 * s as f64).sin()).collect();
        let retrieved = retriever.modal_wavefront_nm(&pistons_nm);
        let modelled = ndarray::aview1(&pistons_nm).dot(pistons);
        // Edges that differ by a tenth put 15 nm into the phasing, so only rounding is allowed.
        // Where the weights of several segments cancel to a tenth of their moduli it is magnified
        // by some hundred.
        assert!(retrieved.iter().zip(&modelled).all(|(retrieved, modelled)| (retrieved - modelled).abs() < 1e-10));
        let slopes = Some(Array2::zeros((3, 4)));
        assert!(SequenceRetrieval::new(vec![channel], false, &prior, slopes, &control).is_err());
    }
}
