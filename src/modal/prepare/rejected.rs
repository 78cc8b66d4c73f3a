//! Rejected pixels: a list for a fit, and their kinds for a report.

/// Largest share of rejected pixels. Beyond, the image is not the model's, or its noise is not the
/// stated one, and χ² shows it.
const MAX_SHARE: f64 = 0.1;

/// Rejected pixels of a prepared frame, in memory that is allocated with it.
#[derive(Debug)]
pub(in crate::modal) struct Rejected {
    /// Of which the first `count` are some.
    pixels: Vec<u32>,
    count: usize,
    /// Floor of pixels that are not bad, e².
    floor_e2: f64,
}

impl Clone for Rejected {
    fn clone(&self) -> Self {
        Self { pixels: self.pixels.clone(), ..*self }
    }

    /// Without another allocation where the frames have one size.
    fn clone_from(&mut self, source: &Self) {
        self.pixels.clone_from(&source.pixels);
        (self.count, self.floor_e2) = (source.count, source.floor_e2);
    }
}

impl Rejected {
    /// None of `pixels`.
    pub(in crate::modal) fn none_of(pixels: usize) -> Self {
        Self { pixels: vec![0; (MAX_SHARE * pixels as f64) as usize], count: 0, floor_e2: 0.0 }
    }

    /// Begins a frame whose good pixels have the floor `floor_e2`.
    pub(in crate::modal) fn begin(&mut self, floor_e2: f64) {
        (self.count, self.floor_e2) = (0, floor_e2);
    }

    /// Takes all back, whose floors `floor_variance_e2` then has again.
    pub(in crate::modal) fn restore(&mut self, floor_variance_e2: &mut [f64]) {
        self.pixels().iter().for_each(|&pixel| floor_variance_e2[pixel as usize] = self.floor_e2);
        self.count = 0;
    }

    /// Forgets all, whose floors are as they were.
    pub(in crate::modal) fn clear(&mut self) {
        self.count = 0;
    }

    pub(in crate::modal) fn pixels(&self) -> &[u32] {
        &self.pixels[..self.count]
    }

    /// Adds a pixel; `false` where there are too many.
    pub(in crate::modal) fn push(&mut self, pixel: usize) -> bool {
        let place = self.pixels.get_mut(self.count);
        self.count += usize::from(place.is_some());
        place.map(|place| *place = pixel as u32).is_some()
    }

    /// The pixels as one number.
    pub(in crate::modal) fn checksum(&self) -> u64 {
        self.pixels().iter().fold(self.count as u64, |sum, &pixel| {
            sum.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(u64::from(pixel) + 1)
        })
    }
}

/// Outlier pixels of an image that were rejected, by kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RejectedPixels {
    /// With too many electrons: hot pixels, cosmic rays.
    pub high: usize,
    /// With too few electrons: dead pixels.
    pub low: usize,
    /// Of columns and rows that are rejected as a whole.
    pub in_lines: usize,
    /// The first column, and the first row, that is; a place in the frame, from 0.
    pub line: [Option<usize>; 2],
}

impl RejectedPixels {
    /// All of them.
    pub fn total(&self) -> usize {
        self.high + self.low + self.in_lines
    }

    /// Both together.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        Self {
            high: self.high + other.high,
            low: self.low + other.low,
            in_lines: self.in_lines + other.in_lines,
            line: [0, 1].map(|axis| self.line[axis].or(other.line[axis])),
        }
    }

    /// The kinds, as `12 high, 3 low, 480 in column 230`.
    pub fn kinds(&self) -> String {
        let lines = match self.line {
            [Some(column), _] => format!("in column {column}"),
            [None, Some(row)] => format!("in row {row}"),
            [None, None] => "in columns and rows".into(),
        };
        let kinds = [(self.high, "high"), (self.low, "low"), (self.in_lines, lines.as_str())];
        let each = kinds.iter().filter(|(count, _)| *count > 0).map(|(count, kind)| format!("{count} {kind}"));
        each.collect::<Vec<_>>().join(", ")
    }
}
