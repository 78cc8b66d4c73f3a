//! Numbers that start at a line of the cache.

use std::ops::{Deref, DerefMut};

/// Bytes of a line of the cache, and of the longest vector.
const LINE: usize = 64;
/// Numbers that may have to be skipped to get to one.
const SKIP: usize = LINE / size_of::<f32>() - 1;

/// Numbers in single precision whose first one starts a line of the cache, so that no vector of a row crosses two: such a
/// load costs twice.
#[derive(Debug)]
pub struct Lines {
    values: Vec<f32>,
    start: usize,
    length: usize,
}

impl Lines {
    /// `length` zeros.
    pub fn zeros(length: usize) -> Self {
        let values = vec![0.0; length + SKIP];
        // Where the allocator's address cannot be asked, any start is right, and only slower.
        let start = values.as_ptr().align_offset(LINE);
        Self { values, start: if start <= SKIP { start } else { 0 }, length }
    }
}

impl From<&[f32]> for Lines {
    fn from(values: &[f32]) -> Self {
        let mut lines = Self::zeros(values.len());
        lines.copy_from_slice(values);
        lines
    }
}

impl Clone for Lines {
    fn clone(&self) -> Self {
        Self::from(&**self)
    }
}

impl PartialEq for Lines {
    fn eq(&self, other: &Self) -> bool {
        self[..] == other[..]
    }
}

impl Deref for Lines {
    type Target = [f32];

    #[inline]
    fn deref(&self) -> &[f32] {
        &self.values[self.start..self.start + self.length]
    }
}

impl DerefMut for Lines {
    #[inline]
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.values[self.start..self.start + self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_copy_starts_a_line() {
        for length in [0, 1, 15, 16, 1000] {
            let mut lines = Lines::zeros(length);
            lines.iter_mut().enumerate().for_each(|(i, value)| *value = i as f32);
            let copy = lines.clone();
            assert_eq!(lines[..], copy[..]);
            assert!([&lines, &copy].iter().all(|lines| lines.as_ptr().addr() % LINE == 0 && lines.len() == length));
        }
    }
}
