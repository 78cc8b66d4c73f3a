//! The seam: on which device, and in which precision, the chain runs. Decided in one `match`.

use super::cpu::CpuChain;
use super::detector::{Evaluation, Exposure, Photometry};
use super::fallback::Fallback;
use super::gpu::{GpuChain, GpuEvaluation, GpuLayout, GpuMode, GpuPhotometry};
use super::optics::{Mode, Optics};
use super::work::Shapes;
use crate::device::Device;
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::sync::Arc;

pub use crate::device::{Choice, Precision};

/// Forward model and adjoint for a batch of images, wherever they run.
pub enum Chain {
    /// CPU, double precision: the judge of the others.
    Cpu64(CpuChain<f64>),
    /// CPU, single precision.
    Cpu32(CpuChain<f32>),
    /// An OpenCL device.
    Device {
        /// The chain there.
        chain: Box<GpuChain>,
        /// The model.
        optics: Arc<Optics>,
        /// The precision that it was built for.
        precision: Precision,
        /// What reports call the device.
        name: String,
    },
    /// A device that `auto` took, and the CPU where it fails.
    Auto(Fallback),
}

impl Chain {
    /// A chain on the CPU.
    pub fn cpu(optics: Arc<Optics>, precision: Precision) -> Self {
        match precision {
            Precision::F64 => Self::Cpu64(CpuChain::new(optics)),
            Precision::F32 => Self::Cpu32(CpuChain::new(optics)),
        }
    }

    /// A chain where `choice` says, with room for `capacity` images. `auto` takes a GPU that has the precision and can
    /// hold the model, which has one wavelength, and the CPU otherwise and where the GPU fails later: see [`Fallback`].
    ///
    /// # Errors
    /// [`crate::Error::Device`] where OpenCL was asked for and there is no such device, or it cannot run this model.
    pub fn open(optics: Arc<Optics>, choice: Choice, precision: Precision, capacity: usize) -> Result<Self> {
        Self::open_as(optics, choice, precision, capacity, false)
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
        if !optics.has_one_wavelength() {
            if choice == Choice::Auto {
                return Ok(Self::cpu(optics, precision));
            }
            let count = optics.parts().colours.len();
            return Err(Error::Device(format!(
                "a model of {count} wavelengths runs on the CPU alone: device = \"cpu\" or \"auto\", or estimate.wavelengths = 1, \
                 is accepted"
            )));
        }
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
    pub fn load(&mut self, exposures: &[Exposure]) -> Result<()> {
        match self {
            Self::Cpu64(chain) => chain.load(exposures),
            Self::Cpu32(chain) => chain.load(exposures),
            Self::Auto(chain) => chain.load(exposures),
            Self::Device { chain, optics, .. } => {
                exposures.iter().try_for_each(|exposure| exposure.check(optics.sampling().pixels))?;
                let data: Vec<f64> = exposures.iter().flat_map(|exposure| exposure.data_e.iter().copied()).collect();
                let weight: Vec<f64> = exposures.iter().flat_map(|exposure| exposure.weight.iter().copied()).collect();
                let photometry: Vec<_> = exposures.iter().map(|exposure| exposure.photometry.into()).collect();
                chain.load(&data, &weight, &photometry)
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
    /// As [`Chain::replace`]; which images were replaced is not known then.
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
        }
    }

    /// Objectives and gradients of `images` at `coefficients_nm` (`[image, mode]`, nm), in that order.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] where the arrays do not fit; [`crate::Error::Device`] where a device fails.
    pub fn evaluate(&mut self, images: &[usize], coefficients_nm: ArrayView2<f64>) -> Result<Vec<Evaluation>> {
        match self {
            Self::Cpu64(chain) => chain.evaluate(images, coefficients_nm),
            Self::Cpu32(chain) => chain.evaluate(images, coefficients_nm),
            Self::Auto(chain) => chain.evaluate(images, coefficients_nm),
            Self::Device { chain, .. } => {
                let coefficients: Vec<f64> = coefficients_nm.iter().copied().collect();
                Ok(by_image(chain.evaluate(images, &coefficients)?, chain.modes()))
            }
        }
    }

    /// As [`Chain::evaluate`] with a phase of its own at each lit sample, turns, `[image][lit sample]`, beside the modes;
    /// the derivative by it, per turn, goes into `slopes`. For a chain that [`Chain::open_free`] made, or of the CPU.
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
            Self::Device { chain, .. } => {
                let coefficients: Vec<f64> = coefficients_nm.iter().copied().collect();
                Ok(by_image(chain.evaluate_free(images, &coefficients, free, slopes)?, chain.modes()))
            }
        }
    }

    /// The shapes that the work of an evaluation follows from: see [`Shapes::work`].
    pub fn shapes(&self) -> Shapes {
        match self {
            Self::Cpu64(chain) => Shapes::of(chain.optics(), chain.fft_points()),
            Self::Cpu32(chain) => Shapes::of(chain.optics(), chain.fft_points()),
            Self::Device { chain, optics, .. } => Shapes::of(optics, chain.fft_points()),
            Self::Auto(fallback) => fallback.chain().shapes(),
        }
    }

    /// The precision in which it runs.
    pub fn precision(&self) -> Precision {
        match self {
            Self::Cpu64(_) => Precision::F64,
            Self::Cpu32(_) => Precision::F32,
            Self::Device { precision, .. } => *precision,
            Self::Auto(fallback) => fallback.chain().precision(),
        }
    }

    /// What reports call the device.
    pub fn device_name(&self) -> String {
        match self {
            Self::Cpu64(_) | Self::Cpu32(_) => "cpu".into(),
            Self::Device { name, .. } => name.clone(),
            Self::Auto(fallback) => fallback.chain().device_name(),
        }
    }

    /// Why the device that `auto` took does not compute any more, as a sentence.
    pub fn failure(&self) -> Option<&str> {
        if let Self::Auto(fallback) = self { fallback.failure() } else { None }
    }

    /// The CPU's chain, where it has taken a device's place for good; else this one.
    pub fn running(&mut self) -> &mut Self {
        if self.failure().is_none() {
            return self;
        }
        match self {
            Self::Auto(fallback) => fallback.chain_mut(),
            other => other,
        }
    }
}

/// What a device found, image by image.
fn by_image(found: GpuEvaluation, modes: usize) -> Vec<Evaluation> {
    let evaluation = |i: usize| Evaluation {
        objective: found.objective[i],
        flux_e: found.flux_e[i],
        background_e: found.background_e[i],
        gradient: found.gradient[i * modes..(i + 1) * modes].to_vec(),
    };
    (0..found.objective.len()).map(evaluation).collect()
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

/// The model as the device takes it.
pub(super) fn layout(optics: &Optics) -> GpuLayout {
    let parts = optics.parts();
    let indices = |list: &[u32]| list.iter().map(|&i| i as usize).collect::<Vec<usize>>();
    let mode = |mode: &Mode| match *mode {
        Mode::Piston(segment) => GpuMode::Segment(segment),
        Mode::Tip(segment) => GpuMode::Tip(segment),
        Mode::Tilt(segment) => GpuMode::Tilt(segment),
        Mode::Smooth(row) => GpuMode::Smooth(row),
    };
    GpuLayout {
        samples: parts.sampling.samples,
        pixels: parts.sampling.pixels,
        samples_per_lambda_over_d: parts.sampling.pixels_per_lambda_over_d,
        wavelength_nm: parts.wavelength_nm,
        intensity_scale: optics.intensity_scale(),
        lit: indices(&parts.weights.lit),
        diversity_turns: optics.diversity_turns(),
        smooth: parts.basis.outer_iter().map(|row| row.to_vec()).collect(),
        segments: parts.weights.segments,
        segment_start: indices(&parts.weights.offsets),
        segment_index: indices(&parts.weights.segment),
        segment_weight: parts.weights.weight.clone(),
        segment_slopes: parts.slopes.clone(),
        modes: parts.modes.iter().map(mode).collect(),
        free_phase: false,
    }
}
