//! What stands in for the chain in a build without OpenCL.

use super::{GpuEvaluation, GpuLayout, GpuPhotometry};
use crate::device::{Device, Precision};
use crate::{Error, Result};

/// The chain on a device: this build has none, so that no value of this type exists.
#[derive(Debug)]
pub enum GpuChain {}

impl GpuChain {
    /// Refuses.
    ///
    /// # Errors
    /// [`Error::Device`] always.
    pub fn new(_: &Device, _: Precision, _: &GpuLayout, _: usize) -> Result<Self> {
        Err(Error::Device(crate::device::advice(&[]).unwrap_or_default().to_string()))
    }

    /// Coefficients of the model.
    pub fn modes(&self) -> usize {
        match *self {}
    }

    /// Points of the FFT that transforms.
    pub fn fft_points(&self) -> Option<usize> {
        match *self {}
    }

    /// Bytes of the device that the chain takes.
    pub fn bytes(&self) -> u64 {
        match *self {}
    }

    /// Room for images.
    pub fn capacity(&self) -> usize {
        match *self {}
    }

    /// Brings images to the device.
    ///
    /// # Errors
    /// Never: there is no chain to call it on.
    pub fn load<D, W>(&mut self, _: &[D], _: &[W], _: &[GpuPhotometry]) -> Result<()> {
        match *self {}
    }

    /// Replaces images.
    ///
    /// # Errors
    /// Never: there is no chain to call it on.
    pub fn replace_all(&mut self, _: &[(usize, &[f64], &[f64], GpuPhotometry)]) -> Result<()> {
        match *self {}
    }

    /// Objective, gradient and photometry.
    ///
    /// # Errors
    /// Never: there is no chain to call it on.
    pub fn evaluate(&mut self, _: &[usize], _: &[f64]) -> Result<GpuEvaluation> {
        match *self {}
    }

    /// The same at free phases.
    ///
    /// # Errors
    /// Never: there is no chain to call it on.
    pub fn evaluate_free(&mut self, _: &[usize], _: &[f64], _: &[f64], _: &mut [f64]) -> Result<GpuEvaluation> {
        match *self {}
    }

    /// The PSFs.
    ///
    /// # Errors
    /// Never: there is no chain to call it on.
    pub fn psf(&mut self, _: &[f64]) -> Result<Vec<f64>> {
        match *self {}
    }
}
