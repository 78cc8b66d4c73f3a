//! The chain on a selected device in a selected precision: one interface for all of them.

use super::cpu::CpuChain;
use super::detector::{Evaluation, Exposure, Photometry};
use super::device_group::DeviceGroup;
use super::gpu::{GpuChain, GpuColour, GpuEvaluation, GpuLayout, GpuMode, GpuPhotometry};
use super::optics::{Mode, Optics};
use super::pixels::pixel_terms;
use super::work::Shapes;
use crate::device::{Device, all_devices};
use crate::{Error, Result};
use ndarray::ArrayView2;
use rayon::prelude::*;
use std::borrow::Borrow;
use std::sync::Arc;

pub use crate::device::{Choice, Precision};

/// Forward model and adjoint for a batch of images.
pub enum Chain {
    /// CPU, double precision: the reference.
    Cpu64(CpuChain<f64>),
    /// CPU, single precision.
    Cpu32(CpuChain<f32>),
    /// An OpenCL device.
    Device {
        /// The chain on the device.
        chain: Box<GpuChain>,
        /// The model.
        optics: Arc<Optics>,
        /// Its precision.
        precision: Precision,
        /// Name of the device in reports.
        name: String,
    },
    /// A device selected by `auto`, replaced by the CPU if it fails.
    Auto(Fallback),
    /// Several devices, for images that are shared among them.
    Several(DeviceGroup<Chain>),
}

impl Chain {
    /// A chain on the CPU.
    pub fn cpu(optics: Arc<Optics>, precision: Precision) -> Self {
        match precision {
            Precision::F64 => Self::Cpu64(CpuChain::new(optics)),
            Precision::F32 => Self::Cpu32(CpuChain::new(optics)),
        }
    }

    /// A chain on the device of `choice`, with memory for `capacity` images. `auto` selects a GPU
    /// if it supports the precision and has memory for the model, otherwise the CPU; if the GPU
    /// fails later, the CPU replaces it: see [`Fallback`].
    ///
    /// # Errors
    /// [`crate::Error::Device`] where an OpenCL device is required and there is none, or it cannot
    /// run this model.
    pub fn open(optics: Arc<Optics>, choice: Choice, precision: Precision, capacity: usize) -> Result<Self> {
        Self::open_as(optics, choice, precision, capacity, false)
    }

    /// As [`Chain::open`], for images that do not depend on each other: with `all` they are shared
    /// among several devices, no more than there are images. A device that cannot run the model is
    /// left out, and [`Chain::failure`] says so.
    ///
    /// # Errors
    /// As [`Chain::open`].
    pub fn open_shared(optics: Arc<Optics>, choice: Choice, precision: Precision, capacity: usize) -> Result<Self> {
        if choice != Choice::All {
            return Self::open(optics, choice, precision, capacity);
        }
        let (mut chains, mut left_out) = (Vec::new(), Vec::new());
        for info in all_devices()?.into_iter().take(capacity.max(1)) {
            match Self::open(optics.clone(), Choice::OpenClAt(info.platform, info.device), precision, capacity) {
                Ok(chain) => chains.push((chain.device_name(), chain)),
                Err(error) => left_out.push(format!("{} ({}): {error}", info.address(), info.name.trim())),
            }
        }
        DeviceGroup::new(chains, &left_out).map(Self::Several)
    }

    /// As [`Chain::open`], for [`Chain::evaluate_free`] too.
    ///
    /// # Errors
    /// As [`Chain::open`].
    pub fn open_free(optics: Arc<Optics>, choice: Choice, precision: Precision, capacity: usize) -> Result<Self> {
        Self::open_as(optics, choice, precision, capacity, true)
    }

    fn open_as(
        optics: Arc<Optics>,
        choice: Choice,
        precision: Precision,
        capacity: usize,
        free_phase: bool,
    ) -> Result<Self> {
        let Some(info) = choice.resolve()? else { return Ok(Self::cpu(optics, precision)) };
        let on_device = || -> Result<Self> {
            let layout = GpuLayout { free_phase, ..layout(&optics) };
            let device = Device::open(&info, false)?;
            let chain = Box::new(GpuChain::new(&device, precision, &layout, capacity)?);
            let name = format!("{} ({})", info.address(), info.name.trim());
            Ok(Self::Device { chain, optics: optics.clone(), precision, name })
        };
        match on_device() {
            Err(_) if choice == Choice::Auto => Ok(Self::cpu(optics, precision)),
            Ok(device) if choice == Choice::Auto => Ok(Self::Auto(Fallback::new(device, optics.clone()))),
            other => other,
        }
    }

    /// Replaces the batch of images.
    ///
    /// # Errors
    /// As [`Exposure::check`]; [`crate::Error::Device`] where a device fails.
    pub fn load<E: Borrow<Exposure> + Sync>(&mut self, exposures: &[E]) -> Result<()> {
        match self {
            Self::Cpu64(chain) => chain.load(exposures),
            Self::Cpu32(chain) => chain.load(exposures),
            Self::Auto(chain) => chain.load(exposures),
            Self::Several(group) => group.first_mut().load(exposures),
            Self::Device { chain, optics, .. } => {
                let exposures = || exposures.iter().map(Borrow::borrow);
                exposures().try_for_each(|exposure| exposure.check(optics.sampling().pixels))?;
                let parts = exposures().map(|exposure| {
                    (exposure.data_e.as_slice(), exposure.weight.as_slice(), exposure.photometry.into())
                });
                chain.load_images(&parts.collect::<Vec<_>>())
            }
        }
    }

    /// Replaces one image of the batch.
    ///
    /// # Errors
    /// As [`Chain::load`], and [`crate::Error::Shape`] where there is no such image.
    pub fn replace(&mut self, image: usize, exposure: &Exposure) -> Result<()> {
        self.replace_all(&[(image, exposure)])
    }

    /// Replaces some images of the batch.
    ///
    /// # Errors
    /// As [`Chain::replace`]; some of the images may have been replaced then.
    pub fn replace_all(&mut self, exposures: &[(usize, &Exposure)]) -> Result<()> {
        match self {
            Self::Device { chain, optics, .. } => {
                exposures.iter().try_for_each(|(_, exposure)| exposure.check(optics.sampling().pixels))?;
                let parts = exposures.iter().map(|(image, exposure)| {
                    (*image, exposure.data_e.as_slice(), exposure.weight.as_slice(), exposure.photometry.into())
                });
                chain.replace_all(&parts.collect::<Vec<_>>())
            }
            Self::Cpu64(chain) => exposures.iter().try_for_each(|&(image, exposure)| chain.replace(image, exposure)),
            Self::Cpu32(chain) => exposures.iter().try_for_each(|&(image, exposure)| chain.replace(image, exposure)),
            Self::Auto(chain) => chain.replace_all(exposures),
            Self::Several(group) => group.first_mut().replace_all(exposures),
        }
    }

    /// Objectives and gradients of `images` at `coefficients_nm` (`[image, mode]`, nm), in that
    /// order.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] where the arrays do not fit; [`crate::Error::Device`] where a device
    /// fails.
    pub fn evaluate(&mut self, images: &[usize], coefficients_nm: ArrayView2<f64>) -> Result<Vec<Evaluation>> {
        match self {
            Self::Cpu64(chain) => chain.evaluate(images, coefficients_nm),
            Self::Cpu32(chain) => chain.evaluate(images, coefficients_nm),
            Self::Auto(chain) => chain.evaluate(images, coefficients_nm),
            Self::Several(group) => group.first_mut().evaluate(images, coefficients_nm),
            Self::Device { chain, .. } => {
                let coefficients: Vec<f64> = coefficients_nm.iter().copied().collect();
                Ok(by_image(chain.evaluate(images, &coefficients)?, chain.modes()))
            }
        }
    }

    /// As [`Chain::evaluate`] with a free phase in addition to the modes, turns,
    /// `[image][illuminated sample]`. The gradient by it, per turn, is written into `slopes`. For a
    /// chain from [`Chain::open_free`], or on the CPU.
    ///
    /// # Errors
    /// As [`Chain::evaluate`].
    pub fn evaluate_free(
        &mut self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        free: &[f64],
        slopes: &mut [f64],
    ) -> Result<Vec<Evaluation>> {
        match self {
            Self::Cpu64(chain) => chain.evaluate_free_all(images, coefficients_nm, free, slopes),
            Self::Cpu32(chain) => chain.evaluate_free_all(images, coefficients_nm, free, slopes),
            Self::Auto(chain) => chain.evaluate_free(images, coefficients_nm, free, slopes),
            Self::Several(group) => group.first_mut().evaluate_free(images, coefficients_nm, free, slopes),
            Self::Device { chain, .. } => {
                let coefficients: Vec<f64> = coefficients_nm.iter().copied().collect();
                Ok(by_image(chain.evaluate_free(images, &coefficients, free, slopes)?, chain.modes()))
            }
        }
    }

    /// The sizes that determine the work of an evaluation: see [`Shapes::work`].
    pub fn shapes(&self) -> Shapes {
        match self {
            Self::Cpu64(chain) => Shapes::new(chain.optics(), chain.fft_points()),
            Self::Cpu32(chain) => Shapes::new(chain.optics(), chain.fft_points()),
            Self::Device { chain, optics, .. } => Shapes::new(optics, chain.fft_points()),
            Self::Auto(fallback) => fallback.chain().shapes(),
            Self::Several(group) => group.first().shapes(),
        }
    }

    /// Its precision.
    pub fn precision(&self) -> Precision {
        match self {
            Self::Cpu64(_) => Precision::F64,
            Self::Cpu32(_) => Precision::F32,
            Self::Device { precision, .. } => *precision,
            Self::Auto(fallback) => fallback.chain().precision(),
            Self::Several(group) => group.first().precision(),
        }
    }

    /// Name of the device in reports.
    pub fn device_name(&self) -> String {
        match self {
            Self::Cpu64(_) | Self::Cpu32(_) => "cpu".into(),
            Self::Device { name, .. } => name.clone(),
            Self::Auto(fallback) => fallback.chain().device_name(),
            Self::Several(group) => group.names(),
        }
    }

    /// Why the device selected by `auto` was replaced, or which of several devices are not used, as
    /// a sentence; `None` if all is as selected.
    pub fn failure(&self) -> Option<&str> {
        match self {
            Self::Auto(fallback) => fallback.failure(),
            Self::Several(group) => group.failure(),
            _ => None,
        }
    }

    /// The chain that computes: the CPU chain if it has replaced a failed device, otherwise this
    /// one.
    pub fn active_chain(&mut self) -> &mut Self {
        if self.failure().is_none() {
            return self;
        }
        match self {
            Self::Auto(fallback) => fallback.chain_mut(),
            other => other,
        }
    }
}

/// A chain on a device that may fail during a batch: out of memory, reset by its driver, unplugged.
/// A copy of the images is kept on the host (16 bytes a pixel); after a failure the call is
/// repeated on the CPU in the same precision. All further calls run on the CPU: a device that
/// failed once is not used again.
pub struct Fallback {
    chain: Box<Chain>,
    optics: Arc<Optics>,
    exposures: Vec<Exposure>,
    failure: Option<String>,
}

impl Fallback {
    /// A chain on `device` for the model `optics`.
    pub(crate) fn new(device: Chain, optics: Arc<Optics>) -> Self {
        Self { chain: Box::new(device), optics, exposures: Vec::new(), failure: None }
    }

    /// The failure and the replacement by the CPU, as a sentence.
    pub fn failure(&self) -> Option<&str> {
        self.failure.as_deref()
    }

    /// The chain that computes.
    fn chain(&self) -> &Chain {
        &self.chain
    }

    fn chain_mut(&mut self) -> &mut Chain {
        &mut self.chain
    }

    fn load<E: Borrow<Exposure> + Sync>(&mut self, exposures: &[E]) -> Result<()> {
        // No image counts as loaded until all are.
        self.exposures.clear();
        self.with_fallback(|chain| chain.load(exposures))?;
        exposures.par_iter().map(|exposure| exposure.borrow().clone()).collect_into_vec(&mut self.exposures);
        Ok(())
    }

    fn replace_all(&mut self, exposures: &[(usize, &Exposure)]) -> Result<()> {
        self.with_fallback(|chain| chain.replace_all(exposures))?;
        let mut replaced: Vec<Option<&Exposure>> = vec![None; self.exposures.len()];
        exposures.iter().for_each(|&(image, exposure)| replaced[image] = Some(exposure));
        let copies = self.exposures.par_iter_mut().zip(replaced).filter_map(|(own, new)| Some((own, new?)));
        copies.for_each(|(own, new)| own.clone_from(new));
        Ok(())
    }

    fn evaluate(&mut self, images: &[usize], coefficients_nm: ArrayView2<f64>) -> Result<Vec<Evaluation>> {
        self.with_fallback(|chain| chain.evaluate(images, coefficients_nm))
    }

    fn evaluate_free(
        &mut self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        free: &[f64],
        slopes: &mut [f64],
    ) -> Result<Vec<Evaluation>> {
        self.with_fallback(|chain| chain.evaluate_free(images, coefficients_nm, free, slopes))
    }

    /// Runs `call`, and repeats it on the CPU if the device fails.
    fn with_fallback<R>(&mut self, mut call: impl FnMut(&mut Chain) -> Result<R>) -> Result<R> {
        match call(&mut self.chain) {
            Err(Error::Device(reason)) if self.failure.is_none() => {
                let mut cpu = Chain::cpu(self.optics.clone(), self.chain.precision());
                cpu.load(&self.exposures)?;
                let device = self.chain.device_name();
                self.failure = Some(format!("{device} failed, and the CPU has taken its place: {reason}"));
                *self.chain = cpu;
                call(&mut self.chain)
            }
            other => other,
        }
    }
}

/// The results of a device, image by image.
fn by_image(results: GpuEvaluation, modes: usize) -> Vec<Evaluation> {
    let evaluation = |i: usize| Evaluation {
        objective: results.objective[i],
        flux_e: results.flux_e[i],
        background_e: results.background_e[i],
        gradient: results.gradient[i * modes..(i + 1) * modes].to_vec(),
    };
    (0..results.objective.len()).map(evaluation).collect()
}

impl From<Photometry> for GpuPhotometry {
    fn from(photometry: Photometry) -> Self {
        match photometry {
            Photometry::Fixed { flux_e, background_e } => Self::Known { flux_e, background_e },
            Photometry::FitFlux { background_e } => Self::FitFlux { background_e },
            Photometry::FitBoth => Self::FitBoth,
        }
    }
}

/// The model as plain arrays for the device.
pub(super) fn layout(optics: &Optics) -> GpuLayout {
    let parts = optics.parts();
    let indices = |list: &[u32]| list.iter().map(|&i| i as usize).collect::<Vec<usize>>();
    let mode = |mode: &Mode| match *mode {
        Mode::Piston(segment) => GpuMode::Segment(segment),
        Mode::Tip(segment) => GpuMode::Tip(segment),
        Mode::Tilt(segment) => GpuMode::Tilt(segment),
        Mode::Smooth(row) => GpuMode::Smooth(row),
    };
    let colour = |optics: &Optics| GpuColour {
        samples_per_lambda_over_d: optics.sampling().pixels_per_lambda_over_d,
        wavelength_nm: optics.parts().wavelength_nm,
        intensity_scale: optics.intensity_scale(),
        diversity_turns: optics.diversity_turns(),
    };
    GpuLayout {
        samples: parts.sampling.samples,
        pixels: parts.sampling.pixels,
        colours: optics.colours().iter().map(|own| colour(own)).collect(),
        pixel_terms: pixel_terms(optics),
        illuminated: indices(&parts.weights.illuminated),
        smooth: parts.basis.outer_iter().map(|row| row.to_vec()).collect(),
        segments: parts.weights.segments,
        segment_start: indices(&parts.weights.offsets),
        segment_index: indices(&parts.weights.segment),
        segment_weight: parts.weights.weight.clone(),
        segment_slopes: parts.slopes.clone(),
        modes: parts.modes.iter().map(mode).collect(),
        free_phase: false,
        free_wavelength_nm: parts.wavelength_nm,
    }
}
