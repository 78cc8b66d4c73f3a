//! What the rows of a frame hold, in vectors.

/// What the good pixels of a row hold.
#[derive(Debug, Clone, Copy)]
pub(super) struct Extent {
    pub(super) good: usize,
    pub(super) least: f64,
    pub(super) most: f64,
    pub(super) sum: f64,
}

impl Extent {
    pub(super) const NOTHING: Self = Self { good: 0, least: f64::MAX, most: f64::MIN, sum: 0.0 };

    /// Of a row without a bad pixel: in eight parts, so that it runs in vectors.
    pub(super) fn of(row: &[f64]) -> Self {
        const LANES: usize = 8;
        let (mut least, mut most, mut sum) = ([f64::MAX; LANES], [f64::MIN; LANES], [0.0; LANES]);
        let (parts, rest) = row.as_chunks::<LANES>();
        for part in parts {
            for i in 0..LANES {
                least[i] = if part[i] < least[i] { part[i] } else { least[i] };
                most[i] = if part[i] > most[i] { part[i] } else { most[i] };
                sum[i] += part[i];
            }
        }
        let whole = Self {
            good: LANES * parts.len(),
            least: least.into_iter().fold(f64::MAX, f64::min),
            most: most.into_iter().fold(f64::MIN, f64::max),
            sum: sum.iter().sum(),
        };
        rest.iter().fold(whole, |extent, &value| extent.with(value))
    }

    pub(super) fn with(self, value: f64) -> Self {
        self.and(&Self { good: 1, least: value, most: value, sum: value })
    }

    pub(super) fn and(self, other: &Self) -> Self {
        Self {
            good: self.good + other.good,
            least: self.least.min(other.least),
            most: self.most.max(other.most),
            sum: self.sum + other.sum,
        }
    }
}

/// Whether all of a row are finite: 0 times a number that is not is no number.
pub(super) fn all_finite(row: &[f64]) -> bool {
    const LANES: usize = 8;
    let mut lanes = [0.0; LANES];
    let (parts, rest) = row.as_chunks::<LANES>();
    for part in parts {
        for i in 0..LANES {
            lanes[i] += 0.0 * part[i];
        }
    }
    lanes.iter().sum::<f64>() == 0.0 && rest.iter().all(|value| value.is_finite())
}
