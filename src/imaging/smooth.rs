//! Amounts of the smooth modes to their phase at the lit samples, and back.
//!
//! Either mode by mode, a number for each mode and lit sample, read from memory twice in each evaluation; or, where the
//! modes are sums of products of functions of x and y, as three small matrix products over the whole grid, whose tables
//! stay in the second-level cache: 0.4 instead of 0.65 million multiply-adds each way for 86 modes on 108×108 samples,
//! and 0.4 MB instead of 5.2.

use super::optics::Optics;
use super::phasor::Polynomial;
use crate::fourier::{Factors, panel_len};

/// The smooth modes in a chain's precision, in turns per nm.
pub(super) struct SmoothModes<T> {
    lit: usize,
    /// `[mode][lit]`.
    maps: Vec<T>,
    products: Option<Products<T>>,
}

/// The modes as products.
struct Products<T> {
    samples: usize,
    /// Neighbouring lit samples: the flat place of the first on the grid, and how many.
    strips: Vec<(usize, usize)>,
    /// Functions of each group.
    groups: Vec<usize>,
    /// `[function][sample]`, and `[sample][function]`, of all groups.
    lines: Vec<T>,
    across: Vec<T>,
    /// `[sample][function]` of each group by itself.
    across_groups: Vec<Vec<T>>,
    /// `[mode][coefficient]`, turns per nm.
    matrix: Vec<T>,
    coefficients: usize,
}

/// One image's memory.
pub(super) struct SmoothScratch<T> {
    coefficients: Vec<T>,
    /// `[function][sample]`.
    middle: Vec<T>,
    /// `[sample][sample]`.
    grid: Vec<T>,
    panel: Vec<T>,
}

/// Lit samples that are worked on at once: 69 modes of them stay in a 256 kB cache.
const BLOCK: usize = 256;
/// Independent partial sums of a reduction, so that it runs in vector registers.
const LANES: usize = 32;

impl<T: Polynomial> SmoothModes<T> {
    pub(super) fn new(optics: &Optics) -> Self {
        let parts = optics.parts();
        let (modes, lit) = parts.basis.dim();
        let turns_per_nm = 1.0 / parts.wavelength_nm;
        let worth_it = |products: &&crate::modes::Separable| products.operations() < modes * lit;
        Self {
            lit,
            maps: parts.basis.iter().map(|&b| T::of(b * turns_per_nm)).collect(),
            products: parts.products.as_ref().filter(worth_it).map(|products| Products {
                samples: parts.sampling.samples,
                strips: strips(&parts.weights.lit),
                groups: products.groups.clone(),
                lines: products.lines.iter().map(|&v| T::of(v)).collect(),
                across: products.lines.t().iter().map(|&v| T::of(v)).collect(),
                across_groups: across_groups(products),
                matrix: products.matrix.iter().map(|&v| T::of(v * turns_per_nm)).collect(),
                coefficients: products.matrix.ncols(),
            }),
        }
    }

    /// Number of modes.
    pub(super) fn len(&self) -> usize {
        self.maps.len() / self.lit
    }

    /// A mode at the lit samples.
    pub(super) fn map(&self, mode: usize) -> &[T] {
        &self.maps[mode * self.lit..][..self.lit]
    }

    pub(super) fn scratch(&self) -> SmoothScratch<T> {
        let (mut coefficients, mut middle, mut grid, mut panel) = (0, 0, 0, 0);
        if let Some(products) = &self.products {
            let n = products.samples;
            (coefficients, middle, grid) = (products.coefficients, products.lines.len(), n * n);
            panel = panel_len(n.max(products.lines.len() / n));
        }
        let zeros = |size| vec![T::zero(); size];
        SmoothScratch {
            coefficients: zeros(coefficients),
            middle: zeros(middle),
            grid: zeros(grid),
            panel: zeros(panel),
        }
    }

    /// Adds the phase of `amounts_nm` to `turns`.
    #[inline(always)]
    pub(super) fn add(&self, amounts_nm: &[T], turns: &mut [T], scratch: &mut SmoothScratch<T>) {
        if let Some(products) = &self.products {
            return products.add(amounts_nm, turns, scratch);
        }
        for (block, turns) in turns.chunks_mut(BLOCK).enumerate() {
            for (row, &y) in amounts_nm.iter().enumerate() {
                let map = &self.map(row)[block * BLOCK..][..turns.len()];
                for (turns, &b) in turns.iter_mut().zip(map) {
                    *turns = b.mul_add(y, *turns);
                }
            }
        }
    }

    /// Sums over the lit samples of `slopes` times each mode.
    #[inline(always)]
    pub(super) fn project(&self, slopes: &[T], sums: &mut [f64], scratch: &mut SmoothScratch<T>) {
        if let Some(products) = &self.products {
            return products.project(slopes, sums, scratch);
        }
        sums.fill(0.0);
        for (block, values) in slopes.chunks(BLOCK).enumerate() {
            for (row, sum) in sums.iter_mut().enumerate() {
                *sum += dot(&self.map(row)[block * BLOCK..][..values.len()], values);
            }
        }
    }
}

impl<T: Polynomial> Products<T> {
    #[inline(always)]
    fn add(&self, amounts_nm: &[T], turns: &mut [T], scratch: &mut SmoothScratch<T>) {
        let SmoothScratch { coefficients, middle, grid, panel } = scratch;
        let n = self.samples;
        coefficients.fill(T::zero());
        for (row, &y) in self.matrix.chunks_exact(self.coefficients).zip(amounts_nm) {
            for (sum, &value) in coefficients.iter_mut().zip(row) {
                *sum = value.mul_add(y, *sum);
            }
        }
        let (mut function, mut entry) = (0, 0);
        for &k in &self.groups {
            let (left, right) = (&coefficients[entry..][..k * k], &self.lines[function * n..][..k * n]);
            let factors = Factors { left, right, rows: k, depth: k, cols: n };
            T::product(&factors, &mut middle[function * n..][..k * n], panel);
            (function, entry) = (function + k, entry + k * k);
        }
        let factors = Factors { left: &self.across, right: middle, rows: n, depth: function, cols: n };
        T::product(&factors, grid, panel);
        let mut rest = turns;
        for &(place, length) in &self.strips {
            let (turns, after) = rest.split_at_mut(length);
            for (turns, &sum) in turns.iter_mut().zip(&grid[place..][..length]) {
                *turns += sum;
            }
            rest = after;
        }
    }

    /// Its adjoint: the same products, read backwards.
    #[inline(always)]
    fn project(&self, slopes: &[T], sums: &mut [f64], scratch: &mut SmoothScratch<T>) {
        let SmoothScratch { coefficients, middle, grid, panel } = scratch;
        let n = self.samples;
        grid.fill(T::zero());
        let mut rest = slopes;
        for &(place, length) in &self.strips {
            let (slopes, after) = rest.split_at(length);
            grid[place..][..length].copy_from_slice(slopes);
            rest = after;
        }
        let functions = self.lines.len() / n;
        let factors = Factors { left: &self.lines, right: grid, rows: functions, depth: n, cols: n };
        T::product(&factors, middle, panel);
        let (mut function, mut entry) = (0, 0);
        for (&k, across) in self.groups.iter().zip(&self.across_groups) {
            let factors = Factors { left: &middle[function * n..][..k * n], right: across, rows: k, depth: n, cols: k };
            T::product(&factors, &mut coefficients[entry..][..k * k], panel);
            (function, entry) = (function + k, entry + k * k);
        }
        for (row, sum) in self.matrix.chunks_exact(self.coefficients).zip(sums) {
            *sum = dot(row, coefficients);
        }
    }
}

/// The stretches of neighbours among ascending places: their starts and lengths.
fn strips(places: &[u32]) -> Vec<(usize, usize)> {
    let mut strips = Vec::<(usize, usize)>::new();
    for &place in places {
        match strips.last_mut() {
            Some((first, length)) if *first + *length == place as usize => *length += 1,
            _ => strips.push((place as usize, 1)),
        }
    }
    strips
}

/// `[sample][function]` of each group.
fn across_groups<T: Polynomial>(products: &crate::modes::Separable) -> Vec<Vec<T>> {
    let mut first = 0;
    let group = |&k: &usize| {
        let lines = products.lines.slice(ndarray::s![first..first + k, ..]);
        first += k;
        lines.t().iter().map(|&v| T::of(v)).collect()
    };
    products.groups.iter().map(group).collect()
}

/// Sum of products, in `LANES` partial sums that are added in a fixed order: the same bits at any vector width.
#[inline(always)]
fn dot<T: Polynomial>(a: &[T], b: &[T]) -> f64 {
    let mut lanes = [T::zero(); LANES];
    let (a_blocks, b_blocks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: T = a_blocks.remainder().iter().zip(b_blocks.remainder()).fold(T::zero(), |sum, (&a, &b)| sum + a * b);
    for (a, b) in a_blocks.zip(b_blocks) {
        for i in 0..LANES {
            lanes[i] = a[i].mul_add(b[i], lanes[i]);
        }
    }
    lanes.iter().map(|lane| lane.wide()).sum::<f64>() + rest.wide()
}
