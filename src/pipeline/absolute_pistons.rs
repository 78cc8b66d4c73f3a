//! Pistons of a sequence in several wavelengths with their whole wavelengths, before its wavefronts
//! are retrieved.
//!
//! A wavefront is retrieved about a static one, and pistons beyond a quarter of a wavelength need
//! one that is near. That of each wavelength comes from modal fits: turbulence leaves them tens of
//! nm off, and whole wavelengths. The static errors from the wavefronts of each wavelength about it
//! determine the whole wavelengths. In these the loop is taken as unknown: its response to a piston
//! depends on whole wavelengths of the image, because its sensor has another wavelength.

use super::consistency::Electrons;
use super::modal_task::ModalTask;
use super::policy::Policy;
use super::sequence_channel::SequenceChannel;
use crate::control::Control;
use crate::modal::{ColourEstimate, ModelCache, PistonInteger, pistons_near, resolve_estimates};
use crate::retrieval::{IlluminatedSamples, RadialPsd, StaticWavefront};
use crate::scene::{self, AoKnowledge, Method, Scene, Telemetry};
use crate::statics::{
    ChannelSequence, Iteration, NcpaBasis, SequenceRetrieval, StaticsSettings, TiltSelection, estimate_static_errors,
};
use crate::statistics::median;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, s};

/// Images whose modal fits give the first pistons.
const MODAL_IMAGES: usize = 12;
/// Iterations of the static errors of one wavelength: their pistons need to be known to a tenth of
/// a wavelength only.
const ITERATIONS: usize = 3;

/// Static wavefront with the whole wavelengths of its pistons.
pub(super) struct AbsolutePistons {
    pub(super) wavefront: StaticWavefront,
    pub(super) integers: Vec<PistonInteger>,
}

/// A sequence in several wavelengths: its images, their retrievers, and how they are read.
pub(super) struct SequenceInColours<'a, 'b> {
    /// The channels, with images and retrievers.
    pub(super) channels: &'a [SequenceChannel<'a>],
    pub(super) sequences: &'a [ChannelSequence<'b>],
    pub(super) prior: &'a RadialPsd,
    pub(super) is_simultaneous: bool,
    pub(super) settings: &'a StaticsSettings,
    pub(super) policy: &'a Policy,
    pub(super) control: &'a Control,
}

impl SequenceInColours<'_, '_> {
    /// Estimates the pistons, with whole wavelengths from all channels together.
    ///
    /// # Errors
    /// Those of the fits and of the static errors; [`Error::Interrupted`].
    pub(super) fn absolute_pistons(&self) -> Result<AbsolutePistons> {
        let scene = self.channels[0].scene;
        let mut colours: Vec<(f64, Vec<usize>)> = Vec::new();
        for (number, channel) in self.channels.iter().enumerate() {
            let wavelength_nm = channel.scene.image.wavelength_nm;
            match colours.iter_mut().find(|(known_nm, _)| *known_nm == wavelength_nm) {
                Some((_, numbers)) => numbers.push(number),
                None => colours.push((wavelength_nm, vec![number])),
            }
        }
        let (mut estimates, mut family) = (Vec::new(), None);
        for (wavelength_nm, numbers) in colours {
            let Iteration { errors, family: own, .. } = self.static_errors(&numbers)?;
            family = Some(own);
            let coefficients_nm = errors.coefficients_nm();
            estimates.push(ColourEstimate { wavelength_nm, coefficients_nm, covariance_nm2: errors.covariance_nm2 });
        }
        let Some(family) = family else { return Err(Error::Internal("there is no channel".into())) };
        let samples = self.samples()?;
        let segments = samples.pistons.nrows();
        let (integers, common_nm) = resolve_estimates(&mut estimates, segments, scene.modes.piston_range_nm)?;
        let basis = NcpaBasis::new(family, scene, &Telescope::new(scene)?)?.modes;
        let smooth_nm = common_nm.slice(s![segments..]).dot(&basis.evaluate(&samples.xs_m, &samples.ys_m)?);
        let segments_nm = common_nm.slice(s![..segments]).to_vec();
        Ok(AbsolutePistons { wavefront: StaticWavefront { segments_nm, smooth_nm: smooth_nm.to_vec() }, integers })
    }

    fn samples(&self) -> Result<IlluminatedSamples> {
        self.sequences[0].retriever.illuminated_samples()
    }

    /// Static errors by the channels `numbers`, which have one wavelength.
    fn static_errors(&self, numbers: &[usize]) -> Result<Iteration> {
        let channel = &self.channels[numbers[0]];
        let segments_nm = self.modal_pistons_nm(channel)?;
        let smooth_nm = vec![0.0; self.samples()?.len()];
        let sequences = numbers.iter().map(|&number| self.sequences[number].reborrow()).collect();
        let mut source = SequenceRetrieval::new(sequences, self.is_simultaneous, self.prior, None, self.control)?
            .about(Some(StaticWavefront { segments_nm, smooth_nm }));
        let ao_knowledge = self.settings.ao_knowledge.min(AoKnowledge::Spectrum);
        let tilts = TiltSelection::Never;
        let settings = StaticsSettings { ao_knowledge, tilts, max_iterations: ITERATIONS, ..self.settings.clone() };
        let last = estimate_static_errors(channel.scene, &mut source, &settings, self.control)?.pop();
        last.ok_or_else(|| Error::Internal("no iteration was made".into()))
    }

    /// Pistons by modal fits of some images of a channel: the median over the images, each moved by
    /// whole wavelengths towards the one that is explained best.
    fn modal_pistons_nm(&self, channel: &SequenceChannel) -> Result<Vec<f64>> {
        let scene = modal_scene(channel.scene)?;
        let images = channel.images.first(MODAL_IMAGES);
        let task = ModalTask {
            scene: &scene,
            policy: &Policy { restart: false, select_model: false, ..*self.policy },
            control: self.control,
            cache: &ModelCache::default(),
            images: &images,
        };
        let (fitter, found) = task.fit_by(&scene, None)?;
        let is_fitted = |image: &usize| found.images[*image].reduced_chi2.is_finite();
        let fitted: Vec<usize> = (0..images.len()).filter(is_fitted).collect();
        let by_chi2 =
            |a: &&usize, b: &&usize| found.images[**a].reduced_chi2.total_cmp(&found.images[**b].reduced_chi2);
        let Some(&best) = fitted.iter().min_by(by_chi2) else {
            return Err(Error::Image("no image of it can be fitted".into()));
        };
        let reference_nm = found.image_coefficients_nm.row(best).to_vec();
        let near: Vec<Vec<f64>> = fitted
            .iter()
            .map(|&image| pistons_near(found.image_coefficients_nm.row(image), &reference_nm, fitter.model()))
            .collect();
        let middle = |segment: usize| median(&near.iter().map(|pistons_nm| pistons_nm[segment]).collect::<Vec<_>>());
        let pistons_nm: Array1<f64> = (0..near[0].len()).map(middle).collect();
        Ok((&pistons_nm - pistons_nm.mean().unwrap_or(0.0)).to_vec())
    }
}

/// `scene` of a sequence, for modal fits of its images. Low-order turbulence is fitted with the
/// NCPA.
fn modal_scene(scene: &Scene) -> Result<Scene> {
    scene.changed(|sections| {
        let (estimate, modes) = (&mut sections.estimate, &mut sections.modes);
        estimate.method = Method::Modal;
        (estimate.ao_knowledge, estimate.telemetry) = (None, Telemetry::Check);
        (modes.file, modes.ncpa, modes.ncpa_count) = (None, scene::NcpaBasis::Zernike, 65);
    })
}

impl Electrons<'_> {
    /// The first `count` images, without telemetry.
    fn first(&self, count: usize) -> Electrons<'static> {
        let first = s![..count.min(self.len()), .., ..];
        Electrons {
            images_e: std::borrow::Cow::Owned(self.images_e.slice(first).to_owned()),
            bad: std::borrow::Cow::Owned(self.bad.slice(first).to_owned()),
            read_noise_e: self.read_noise_e,
            slopes_mas: None,
            moved_reference_mas: None,
        }
    }
}
