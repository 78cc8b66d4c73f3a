//! Cache-aligned buffer of f32 values.

use std::ops::{Deref, DerefMut};

/// Bytes of a cache line, and of the longest SIMD vector.
const LINE: usize = 64;
/// Most values between the start of an allocation and the next cache line.
const SKIP: usize = LINE / size_of::<f32>() - 1;

/// f32 values of which the first lies at the start of a cache line, so that no aligned vector
/// crosses two lines (such a load takes twice as long).
#[derive(Debug)]
pub struct AlignedBuffer {
    values: Vec<f32>,
    start: usize,
    length: usize,
}

impl AlignedBuffer {
    /// `length` zeros.
    pub fn zeros(length: usize) -> Self {
        let values = vec![0.0; length + SKIP];
        // `align_offset` may fail (it returns usize::MAX): then the buffer is only slower.
        let start = values.as_ptr().align_offset(LINE);
        Self { values, start: if start <= SKIP { start } else { 0 }, length }
    }
}

impl From<&[f32]> for AlignedBuffer {
    fn from(values: &[f32]) -> Self {
        let mut lines = Self::zeros(values.len());
        lines.copy_from_slice(values);
        lines
    }
}

impl Clone for AlignedBuffer {
    fn clone(&self) -> Self {
        Self::from(&**self)
    }
}

impl PartialEq for AlignedBuffer {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl Deref for AlignedBuffer {
    type Target = [f32];

    #[inline]
    fn deref(&self) -> &[f32] {
        &self.values[self.start..self.start + self.length]
    }
}

impl DerefMut for AlignedBuffer {
    #[inline]
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values[self.start..self.start + self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_copy_starts_at_a_cache_line() {
        for length in [0, 1, 15, 16, 1000] {
            let mut lines = AlignedBuffer::zeros(length);
            lines.iter_mut().enumerate().for_each(|(i, value)| *value = i as f32);
            let copy = lines.clone();
            assert_eq!(lines[..], copy[..]);
            assert!([&lines, &copy].iter().all(|lines| lines.as_ptr().addr() % LINE == 0 && lines.len() == length));
        }
    }
}
