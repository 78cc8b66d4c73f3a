//! Replacement for the chain in a build without OpenCL.

use super::evaluation::{GpuEvaluation, GpuPhotometry};
use super::layout::GpuLayout;
use crate::device::{Device, Precision};
use crate::{Error, Result};

/// The chain on a device. No value of this type exists in a build without OpenCL.
#[derive(Debug)]
pub enum GpuChain {}

impl GpuChain {
    /// Always fails.
    ///
    /// # Errors
    /// [`Error::Device`] always.
    pub fn new(_: &Device, _: Precision, _: &GpuLayout, _: usize) -> Result<Self> {
        Err(Error::Device(crate::device::advice(&[]).unwrap_or_default()))
    }

    /// Number of coefficients of the model.
    pub fn modes(&self) -> usize {
        match *self {}
    }

    /// Points of the FFT.
    pub fn fft_points(&self) -> Option<usize> {
        match *self {}
    }

    /// Device memory that the chain takes, bytes.
    pub fn bytes(&self) -> u64 {
        match *self {}
    }

    /// Largest number of images.
    pub fn capacity(&self) -> usize {
        match *self {}
    }

    /// Uploads images.
    ///
    /// # Errors
    /// Never called: no value of this type exists.
    pub fn load_images(&mut self, _: &[(&[f64], &[f64], GpuPhotometry)]) -> Result<()> {
        match *self {}
    }

    /// Replaces images.
    ///
    /// # Errors
    /// Never called: no value of this type exists.
    pub fn replace_all(&mut self, _: &[(usize, &[f64], &[f64], GpuPhotometry)]) -> Result<()> {
        match *self {}
    }

    /// Objective, gradient and photometry.
    ///
    /// # Errors
    /// Never called: no value of this type exists.
    pub fn evaluate(&mut self, _: &[usize], _: &[f64]) -> Result<GpuEvaluation> {
        match *self {}
    }

    /// The same with a free phase.
    ///
    /// # Errors
    /// Never called: no value of this type exists.
    pub fn evaluate_free(&mut self, _: &[usize], _: &[f64], _: &[f64], _: &mut [f64]) -> Result<GpuEvaluation> {
        match *self {}
    }

    /// The PSFs.
    ///
    /// # Errors
    /// Never called: no value of this type exists.
    pub fn psf(&mut self, _: &[f64]) -> Result<Vec<f64>> {
        match *self {}
    }
}
