//! Memory of L-BFGS: pairs of steps and gradient changes, and the two-loop product with the inverse
//! Hessian.

use pulp::{Arch, NullaryFnOnce};

/// Smallest cosine of the angle between step and gradient change of a pair: s·y > this·|s||y|.
/// Below, the pair is rounding or negative curvature, and would make the inverse Hessian indefinite
/// or huge.
const LEAST_COSINE: f64 = 1e-8;

/// The last `capacity` pairs s = z₁ − z₀, y = g₁ − g₀ in a ring buffer, and the scratch memory of
/// the product.
#[derive(Debug, Clone)]
pub(super) struct Pairs {
    dimension: usize,
    capacity: usize,
    steps: Vec<f64>,
    changes: Vec<f64>,
    /// 1 / s·y.
    rho: Vec<f64>,
    alpha: Vec<f64>,
    len: usize,
    /// Slot of the next pair.
    head: usize,
}

impl Pairs {
    pub fn new(dimension: usize, capacity: usize) -> Self {
        Pairs {
            dimension,
            capacity,
            steps: vec![0.0; dimension * capacity],
            changes: vec![0.0; dimension * capacity],
            rho: vec![0.0; capacity],
            alpha: vec![0.0; capacity],
            len: 0,
            head: 0,
        }
    }

    /// Removes all pairs and sets the number of components, at most that of [`Pairs::new`].
    pub fn restart(&mut self, dimension: usize) {
        debug_assert!(dimension * self.capacity <= self.steps.len(), "memory for the pairs");
        self.dimension = dimension;
        self.clear();
    }

    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    pub fn clear(&mut self) {
        self.len = 0;
        self.head = 0;
    }

    /// Stores the step `length · direction` and the gradient change `after − before` over it, if
    /// their curvature is positive.
    pub fn push(&mut self, length: f64, direction: &[f64], before: &[f64], after: &[f64]) {
        if self.capacity == 0 {
            return;
        }
        let range = self.range(self.head);
        let (s, y) = (&mut self.steps[range.clone()], &mut self.changes[range]);
        for i in 0..self.dimension {
            s[i] = length * direction[i];
            y[i] = after[i] - before[i];
        }
        let curvature = dot(s, y);
        if curvature.is_nan() || curvature <= LEAST_COSINE * (dot(s, s) * dot(y, y)).sqrt() {
            return;
        }
        self.rho[self.head] = 1.0 / curvature;
        self.head = (self.head + 1) % self.capacity;
        self.len = (self.len + 1).min(self.capacity);
    }

    /// s·y / y·y of the newest pair: an inverse curvature (Nocedal & Wright, *Numerical
    /// Optimization*, eq. 7.20).
    pub fn newest_inverse_curvature(&self) -> Option<f64> {
        let newest = self.newest_first().next()?;
        let y = &self.changes[self.range(newest)];
        Some(1.0 / (self.rho[newest] * dot(y, y)))
    }

    /// `vector` ← H·`vector`, H the inverse Hessian from the pairs and the initial
    /// `inverse_curvature`·I (Nocedal & Wright, algorithm 7.4).
    pub fn apply(&mut self, inverse_curvature: f64, vector: &mut [f64]) {
        Arch::new().dispatch(Apply { pairs: self, inverse_curvature, vector });
    }

    /// The slot of the pair of this age, 0 the newest.
    fn slot(&self, age: usize) -> usize {
        (self.head + self.capacity - 1 - age) % self.capacity
    }

    fn newest_first(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.len).map(|age| self.slot(age))
    }

    fn range(&self, slot: usize) -> std::ops::Range<usize> {
        slot * self.dimension..(slot + 1) * self.dimension
    }
}

/// [`Pairs::apply`], compiled for the widest vectors that this processor has; the sums are the same
/// bits at every width.
struct Apply<'a> {
    pairs: &'a mut Pairs,
    inverse_curvature: f64,
    vector: &'a mut [f64],
}

impl NullaryFnOnce for Apply<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { pairs, inverse_curvature, vector } = self;
        for age in 0..pairs.len {
            let k = pairs.slot(age);
            let alpha = pairs.rho[k] * dot(&pairs.steps[pairs.range(k)], vector);
            pairs.alpha[k] = alpha;
            add_scaled(vector, -alpha, &pairs.changes[pairs.range(k)]);
        }
        vector.iter_mut().for_each(|v| *v *= inverse_curvature);
        for age in (0..pairs.len).rev() {
            let k = pairs.slot(age);
            let beta = pairs.rho[k] * dot(&pairs.changes[pairs.range(k)], vector);
            add_scaled(vector, pairs.alpha[k] - beta, &pairs.steps[pairs.range(k)]);
        }
    }
}

/// a·b.
#[inline(always)]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Eight partial sums, added in a fixed order: a single sum would be limited by the latency of
    // the addition.
    const LANES: usize = 8;
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
    let mut lanes = [0.0; LANES];
    for (a, b) in a.iter().zip(b) {
        for i in 0..LANES {
            lanes[i] += a[i] * b[i];
        }
    }
    lanes.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

/// a ← a + scale·b.
#[inline(always)]
pub(super) fn add_scaled(a: &mut [f64], scale: f64, b: &[f64]) {
    a.iter_mut().zip(b).for_each(|(a, b)| *a += scale * b);
}

/// a ← scale·a.
pub(super) fn scale_by(vector: &mut [f64], scale: f64) {
    vector.iter_mut().for_each(|component| *component *= scale);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With n independent pairs of a quadratic, conjugate to one another, H is the inverse Hessian
    /// itself.
    #[test]
    fn conjugate_pairs_of_a_quadratic_invert_its_hessian() {
        let hessian = [[4.0, 1.0], [1.0, 3.0]];
        let times =
            |v: &[f64]| [hessian[0][0] * v[0] + hessian[0][1] * v[1], hessian[1][0] * v[0] + hessian[1][1] * v[1]];
        // The second direction is H-conjugate to the first: e0·H·d1 = 4·1 + 1·(−4) = 0.
        let directions = [[1.0, 0.0], [1.0, -4.0]];
        let mut pairs = Pairs::new(2, 3);
        for d in &directions {
            let step: Vec<f64> = d.iter().map(|v| 0.5 * v).collect();
            pairs.push(0.5, d, &[0.0, 0.0], &times(&step));
        }
        let v = [0.7, -1.3];
        let mut product = times(&v);
        // The initial scale has no effect.
        pairs.apply(17.0, &mut product);
        // Five products of numbers below 100 in f64: 1e-13 is a hundred roundings of room.
        assert!((product[0] - v[0]).abs() < 1e-13 && (product[1] - v[1]).abs() < 1e-13, "{product:?}");
    }

    #[test]
    fn pairs_of_negative_curvature_are_skipped_and_old_replaced() {
        let mut pairs = Pairs::new(1, 2);
        pairs.push(1.0, &[1.0], &[0.0], &[-1.0]);
        assert!(pairs.is_empty());
        pairs.push(1.0, &[1.0], &[0.0], &[f64::NAN]);
        assert!(pairs.is_empty());
        for curvature in [2.0, 4.0, 8.0] {
            pairs.push(1.0, &[1.0], &[0.0], &[curvature]);
            assert_eq!(pairs.newest_inverse_curvature(), Some(1.0 / curvature));
        }
        assert_eq!(pairs.len, 2);
    }
}
