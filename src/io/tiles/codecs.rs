//! Streams of tiles: gzip, shuffled bytes, and Rice's differences.

use flate2::read::MultiGzDecoder;
use std::io::Read;

/// At most `most` bytes of a gzip stream; `None` where it is damaged or longer.
pub(super) fn gunzip(stream: &[u8], most: usize) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    MultiGzDecoder::new(stream).take(most as u64 + 1).read_to_end(&mut bytes).ok()?;
    (bytes.len() <= most).then_some(bytes)
}

/// The bytes of each pixel together, from those of all pixels one after the other.
pub(super) fn unshuffled(bytes: &[u8], count: usize) -> Vec<u8> {
    let width = bytes.len() / count;
    (0..count * width).map(|i| bytes[i % width * count + i / width]).collect()
}

/// Big-endian integers of `width` bytes; single bytes have no sign.
pub(super) fn integers(bytes: &[u8], width: usize, count: usize) -> Option<Vec<i64>> {
    if !matches!(width, 1 | 2 | 4 | 8) || bytes.len() != width * count {
        return None;
    }
    let value = |pixel: &[u8]| pixel.iter().fold(0_u64, |value, &byte| value << 8 | u64::from(byte));
    Some(bytes.chunks_exact(width).map(|pixel| signed(value(pixel), width)).collect())
}

/// `value` of `width` bytes with its sign; single bytes have none.
fn signed(value: u64, width: usize) -> i64 {
    let unused = 64 - 8 * width as u32;
    if width == 1 { (value & 0xff) as i64 } else { (value << unused) as i64 >> unused }
}

/// `count` integers of a Rice stream (R. White, in cfitsio's `ricecomp.c`): the first integer, then
/// blocks of differences. A block starts with the number k + 1 of low bits that are written as they
/// are: 0 for differences that are all 0, the largest number for differences that are written
/// whole.
pub(super) fn rice(stream: &[u8], count: usize, width: usize, block: usize) -> Option<Vec<i64>> {
    let (k_bits, whole, bits) = match width {
        1 => (3, 7, 8),
        2 => (4, 15, 16),
        4 => (5, 26, 32),
        _ => return None,
    };
    // Each block has a number of bits: a stream that is shorter is damaged, and its pixels take no
    // memory.
    if (count.div_ceil(block) * k_bits as usize) > stream.len() * 8 {
        return None;
    }
    let mut stream = Bits { bytes: stream.iter(), buffer: 0, held: 0 };
    let mut last = stream.take(bits)?;
    let mut values = Vec::with_capacity(count);
    while values.len() < count {
        let k = stream.take(k_bits)?;
        for _ in 0..block.min(count - values.len()) {
            let difference = match k {
                0 => 0,
                _ if k == whole => stream.take(bits)?,
                _ if k > whole => return None,
                _ => stream.zeros()? << (k - 1) | stream.take(k as u32 - 1)?,
            };
            // Even numbers are differences from 0 on, odd ones those below.
            last = last.wrapping_add(if difference & 1 == 1 { !(difference >> 1) } else { difference >> 1 });
            values.push(signed(last, width));
        }
    }
    Some(values)
}

/// Bits of a stream, the most significant of each byte first.
struct Bits<'a> {
    bytes: std::slice::Iter<'a, u8>,
    /// The next bits, from the most significant on; 0 behind them.
    buffer: u64,
    held: u32,
}

impl Bits<'_> {
    fn fill(&mut self) {
        while self.held <= 56 {
            let Some(&byte) = self.bytes.next() else { break };
            self.buffer |= u64::from(byte) << (56 - self.held);
            self.held += 8;
        }
    }

    /// The next `count` bits, at most 32, as a number.
    fn take(&mut self, count: u32) -> Option<u64> {
        self.fill();
        if self.held < count {
            return None;
        }
        let value = if count == 0 { 0 } else { self.buffer >> (64 - count) };
        self.buffer <<= count;
        self.held -= count;
        Some(value)
    }

    /// The number of zeros before the next one, which is taken, too.
    fn zeros(&mut self) -> Option<u64> {
        let mut zeros = 0;
        loop {
            self.fill();
            if self.held == 0 {
                return None;
            }
            let more = self.buffer.leading_zeros().min(self.held);
            zeros += u64::from(more);
            self.buffer = self.buffer.checked_shl(more).unwrap_or(0);
            self.held -= more;
            if self.held > 0 {
                self.take(1)?;
                return Some(zeros);
            }
        }
    }
}
