//! Device buffers whose precision is chosen at run time; the host side is always f64.

use super::buffer::Buffer;
use super::kernel::Kernel;
use super::precision::Precision;
use super::session::Device;
use crate::Result;

/// Array of real numbers on a device, in single or double precision.
pub(crate) enum Reals {
    F32(Buffer<f32>),
    F64(Buffer<f64>),
}

impl Reals {
    /// `len` zeros.
    pub fn zeros(device: &Device, precision: Precision, len: usize) -> Result<Self> {
        Ok(match precision {
            Precision::F32 => Reals::F32(device.buffer(len)?),
            Precision::F64 => Reals::F64(device.buffer(len)?),
        })
    }

    /// A copy of `values`.
    pub fn upload(device: &Device, precision: Precision, values: &[f64]) -> Result<Self> {
        let mut reals = Self::zeros(device, precision, values.len())?;
        reals.write(0, values)?;
        Ok(reals)
    }

    /// `count` numbers from `from` on: see [`Buffer::part`].
    pub fn part(&self, from: usize, count: usize) -> Result<Self> {
        Ok(match self {
            Reals::F32(buffer) => Reals::F32(buffer.part(from, count)?),
            Reals::F64(buffer) => Reals::F64(buffer.part(from, count)?),
        })
    }

    /// Rounds `values` to the precision and copies them to the elements from `offset` on.
    pub fn write(&mut self, offset: usize, values: &[f64]) -> Result<()> {
        match self {
            Reals::F32(buffer) => {
                let rounded: Vec<f32> = values.iter().map(|&v| v as f32).collect();
                buffer.write(offset, &rounded)
            }
            Reals::F64(buffer) => buffer.write(offset, values),
        }
    }

    /// Fills `values` from the elements from `offset` on.
    pub fn read(&self, offset: usize, values: &mut [f64]) -> Result<()> {
        match self {
            Reals::F32(buffer) => {
                let mut rounded = vec![0.0f32; values.len()];
                buffer.read(offset, &mut rounded)?;
                for (value, rounded) in values.iter_mut().zip(rounded) {
                    *value = f64::from(rounded);
                }
                Ok(())
            }
            Reals::F64(buffer) => buffer.read(offset, values),
        }
    }

    /// Binds the array to an argument of `kernel`.
    pub fn bind<'k>(&self, kernel: &'k mut Kernel, argument: &str) -> Result<&'k mut Kernel> {
        match self {
            Reals::F32(buffer) => kernel.buffer(argument, buffer),
            Reals::F64(buffer) => kernel.buffer(argument, buffer),
        }
    }
}
