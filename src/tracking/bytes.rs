//! Bytes of a tracker: little-endian numbers, arrays after their sizes.

use crate::{Error, Result};
use ndarray::{Array1, Array2};

/// Writer of numbers and arrays.
#[derive(Default)]
pub(super) struct Writer(pub(super) Vec<u8>);

impl Writer {
    pub(super) fn number(&mut self, value: usize) {
        self.0.extend((value as u64).to_le_bytes());
    }

    pub(super) fn real(&mut self, value: f64) {
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn vector<'a>(&mut self, values: impl ExactSizeIterator<Item = &'a f64>) {
        self.number(values.len());
        values.for_each(|value| self.real(*value));
    }

    pub(super) fn matrix(&mut self, matrix: &Array2<f64>) {
        self.number(matrix.nrows());
        self.number(matrix.ncols());
        matrix.iter().for_each(|value| self.real(*value));
    }
}

/// Reader of what a [`Writer`] wrote.
pub(super) struct ByteReader<'a>(pub(super) &'a [u8]);

impl ByteReader<'_> {
    pub(super) fn number(&mut self) -> Result<usize> {
        let value = u64::from_le_bytes(self.eight()?);
        usize::try_from(value).map_err(|_| damaged())
    }

    pub(super) fn real(&mut self) -> Result<f64> {
        Ok(f64::from_le_bytes(self.eight()?))
    }

    pub(super) fn vector(&mut self) -> Result<Array1<f64>> {
        let length = self.number()?;
        self.reals(length).map(Array1::from)
    }

    pub(super) fn matrix(&mut self) -> Result<Array2<f64>> {
        let (rows, columns) = (self.number()?, self.number()?);
        let values = self.reals(rows.checked_mul(columns).ok_or_else(damaged)?)?;
        Array2::from_shape_vec((rows, columns), values).map_err(|_| damaged())
    }

    /// Whether all bytes were read.
    pub(super) fn finish(self) -> Result<()> {
        if self.0.is_empty() { Ok(()) } else { Err(damaged()) }
    }

    fn reals(&mut self, count: usize) -> Result<Vec<f64>> {
        // Checked before memory is taken.
        if count > self.0.len() / 8 {
            return Err(damaged());
        }
        (0..count).map(|_| self.real()).collect()
    }

    fn eight(&mut self) -> Result<[u8; 8]> {
        let (first, rest) = self.0.split_first_chunk::<8>().ok_or_else(damaged)?;
        self.0 = rest;
        Ok(*first)
    }
}

pub(super) fn damaged() -> Error {
    Error::Value("the state of a tracker is damaged: bytes as Tracker::to_bytes wrote them are needed".into())
}
