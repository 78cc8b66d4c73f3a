//! The seam: on which device, and in which precision, the chain runs. Decided in one `match`.

use super::cpu::CpuChain;
use super::detector::{Evaluation, Exposure};
use super::optics::Optics;
use crate::Result;
use ndarray::ArrayView2;
use std::sync::Arc;

/// The floating-point type of a chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// Single: errors of about 0.001 nm, twice the speed.
    F32,
    /// Double.
    #[default]
    F64,
}

/// Forward model and adjoint for a batch of images, wherever they run.
pub enum Chain {
    /// CPU, double precision: the judge of the others.
    Cpu64(CpuChain<f64>),
    /// CPU, single precision.
    Cpu32(CpuChain<f32>),
}

impl Chain {
    /// A chain on the CPU.
    pub fn cpu(optics: Arc<Optics>, precision: Precision) -> Self {
        match precision {
            Precision::F64 => Self::Cpu64(CpuChain::new(optics)),
            Precision::F32 => Self::Cpu32(CpuChain::new(optics)),
        }
    }

    /// Replaces the batch of images.
    ///
    /// # Errors
    /// As [`Exposure::check`].
    pub fn load(&mut self, exposures: &[Exposure]) -> Result<()> {
        match self {
            Self::Cpu64(chain) => chain.load(exposures),
            Self::Cpu32(chain) => chain.load(exposures),
        }
    }

    /// Replaces one image of the batch.
    ///
    /// # Errors
    /// As [`Exposure::check`].
    pub fn replace(&mut self, image: usize, exposure: &Exposure) -> Result<()> {
        match self {
            Self::Cpu64(chain) => chain.replace(image, exposure),
            Self::Cpu32(chain) => chain.replace(image, exposure),
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
        }
    }

    /// The precision in which it runs.
    pub fn precision(&self) -> Precision {
        match self {
            Self::Cpu64(_) => Precision::F64,
            Self::Cpu32(_) => Precision::F32,
        }
    }

    /// One word for reports.
    pub fn device_name(&self) -> String {
        "cpu".into()
    }
}
