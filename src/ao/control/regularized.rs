//! Sparse reconstructor: regularised least squares, solved in every frame.
//!
//! With D the interaction matrix, the commands of slopes s are
//!
//! `(DᵀD + α·(CᵀC/64 + δ))⁻¹ Dᵀ s`, α = (largest singular value of D / `condition_number`)²,
//!
//! where C takes the second differences of the commands between neighbouring actuators along x and along y. It stands for the inverse
//! covariance of the turbulence (Ellerbroek 2002, JOSA A 19, 1803), and is small for smooth commands and 64 for waffle, which the slopes
//! do not measure. D is local (an influence function reaches a few lenslets), so the matrix is a band over the actuators row by row.

use super::band::{BandSolver, SymmetricBand};
use super::plant::Plant;
use super::windows::{SlopeRow, Windows};
use crate::scene::{ControlScene, Fill, Loop};
use crate::{Error, Result};
use ndarray::Array2;
use rayon::prelude::*;
use std::sync::Arc;

/// δ: regularisation of piston, of which the second differences are 0, relative to that of waffle. It lowers the loop's gain on tilt,
/// whose singular value is about 2/(actuators across) of the largest, by less than 1 %.
const PISTON: f64 = 0.01;
/// Square of the largest eigenvalue of C: the second differences of waffle are ±4 along each axis.
const WAFFLE: f64 = 64.0;
/// Entries of D below this fraction of its largest one, over the condition number, are left out. With fifty of them in a row the gain of
/// a mode changes by at most ‖R‖·‖ΔD‖ ≤ 50·1e-3/2, reached only if they all have its sign; 1e-3 in practice.
const NEGLIGIBLE_RESPONSE: f64 = 1e-3;
/// Entries of the normal matrix beyond the band are left out if their sum in a row is below this fraction of α: they change the gain of
/// the weakest modes by this at most, and leave the matrix positive definite where the regularisation is more than this.
const NEGLIGIBLE_COUPLING: f64 = 0.25 * PISTON;

/// Sparse reconstructor of a plant.
#[derive(Debug)]
pub struct SparseReconstructor {
    windows: Windows,
    solver: BandSolver,
    actuators: usize,
    slopes: usize,
    controlled: usize,
}

impl SparseReconstructor {
    /// Factorises the normal equations of `plant`.
    ///
    /// # Errors
    /// [`Error::Value`] for a plant without the places of its actuators, or an interaction matrix of zeros.
    pub(super) fn new(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        let Some((across, places)) = plant.actuator_grid else {
            let sentence = "control.reconstructor = \"sparse\" needs the places of the actuators; none were given";
            return Err(Error::Value(sentence.into()));
        };
        let condition = scene.condition_number.unwrap_or(1.0);
        let rows = local_rows(plant, scene.fill, NEGLIGIBLE_RESPONSE / condition);
        let differences = second_differences(across, places);
        let actuators = plant.actuators();
        // Both matrices in one width, so that they can be added.
        let width = reach(&rows).max(reach(&differences));
        let response = normal(&rows, actuators, width);
        let strongest = response.largest_eigenvalue();
        if strongest <= 0.0 {
            let sentence =
                "the interaction matrix is 0, so that no mode can be controlled; one that is not 0 is needed";
            return Err(Error::Value(sentence.into()));
        }
        let strength = strongest / (condition * condition);
        let smoothness = normal(&differences, actuators, width);
        let sum = |sign: f64| {
            let mut band = response.clone();
            for column in 0..actuators {
                for (below, value) in smoothness.column(column).iter().enumerate() {
                    band.add(column + below, column, sign * strength * value / WAFFLE);
                }
                band.add(column, column, sign * strength * PISTON);
            }
            band
        };
        // A mode counts as controlled where its response exceeds its regularisation.
        let mut excess = sum(-1.0);
        excess.factorise();
        let controlled = excess.diagonal().filter(|pivot| *pivot > 0.0).count();
        let whole = sum(1.0);
        let kept = narrowest(&whole, NEGLIGIBLE_COUPLING * strength);
        let mut factors = whole.narrowed(kept);
        factors.factorise();
        if factors.diagonal().any(|pivot| !(pivot.is_finite() && pivot > 0.0)) {
            return Err(Error::Internal("the normal equations of the loop are not positive definite".into()));
        }
        Ok(Self {
            windows: Windows::new(plant.lenslets_across, plant.subapertures, &rows, actuators),
            solver: BandSolver::new(&factors),
            actuators,
            slopes: plant.interaction.nrows(),
            controlled,
        })
    }

    /// Number of modes whose response exceeds their regularisation: the loop has at least half of its gain on them.
    pub fn controlled(&self) -> usize {
        self.controlled
    }

    /// Command matrix, `[actuators, 2·subapertures]`, nm per slope: the commands of one slope after the other.
    pub fn command_matrix(&self) -> Array2<f64> {
        let columns: Vec<Vec<f32>> = (0..self.slopes)
            .into_par_iter()
            .map(|slope| {
                let mut slopes = vec![0.0; self.slopes];
                slopes[slope] = 1.0;
                let mut workspace = self.workspace();
                self.windows.spread(&slopes, &mut workspace.map);
                self.solve(&mut workspace);
                workspace.vector.truncate(self.actuators);
                workspace.vector
            })
            .collect();
        Array2::from_shape_fn((self.actuators, self.slopes), |(i, j)| f64::from(columns[j][i]))
    }

    fn workspace(&self) -> SparseWorkspace {
        SparseWorkspace { map: self.windows.map(), vector: vec![0.0; self.solver.length()] }
    }

    /// Commands of the slopes on the workspace's map.
    fn solve(&self, workspace: &mut SparseWorkspace) {
        let (unknowns, behind) = workspace.vector.split_at_mut(self.actuators);
        behind.fill(0.0);
        self.windows.project(&workspace.map, unknowns);
        self.solver.solve(&mut workspace.vector);
    }
}

/// The smallest width at which what is left out of each row sums to at most `least`.
fn narrowest(band: &SymmetricBand, least: f64) -> usize {
    let (mut low, mut high) = (0, band.width());
    while low < high {
        let middle = (low + high) / 2;
        if band.largest_rest(middle) <= least { high = middle } else { low = middle + 1 }
    }
    high
}

/// Rows of the interaction matrix without its entries below `negligible` times the largest; those of masked subapertures are empty for
/// `fill = "mask-interaction-matrix"`.
fn local_rows(plant: &Plant, fill: Fill, negligible: f64) -> Vec<SlopeRow> {
    let largest = plant.interaction.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
    let is_masked = |slope: usize| fill == Fill::MaskInteractionMatrix && plant.mask[slope % plant.mask.len()];
    let row = |(slope, row): (usize, ndarray::ArrayView1<f64>)| -> SlopeRow {
        if is_masked(slope) {
            return Vec::new();
        }
        let entries = row.iter().enumerate().filter(|(_, value)| value.abs() > negligible * largest);
        entries.map(|(actuator, &value)| (actuator as u32, value)).collect()
    };
    plant.interaction.rows().into_iter().enumerate().map(row).collect()
}

/// Second differences of the commands, along x and then along y, of every actuator whose two neighbours are in use; added for one that
/// has both.
fn second_differences(across: usize, places: &[usize]) -> Vec<SlopeRow> {
    let mut number = vec![None; across * across];
    places.iter().enumerate().for_each(|(i, &place)| number[place] = Some(i as u32));
    let row = |&place: &usize| {
        let mut terms: SlopeRow = Vec::with_capacity(5);
        for (along, step) in [(place / across, across), (place % across, 1)] {
            let neighbours = (along > 0 && along + 1 < across).then(|| [number[place - step], number[place + step]]);
            if let (Some([Some(before), Some(after)]), Some(own)) = (neighbours, number[place]) {
                terms.extend([(before, 1.0), (own, -2.0), (after, 1.0)]);
            }
        }
        terms.sort_by_key(|(actuator, _)| *actuator);
        // The actuator itself has a term along each axis.
        terms.dedup_by(|(next, value), (kept, sum)| {
            let is_same = next == kept;
            *sum += if is_same { *value } else { 0.0 };
            is_same
        });
        terms
    };
    places.iter().map(row).collect()
}

/// Largest distance between two actuators of a row.
fn reach(rows: &[SlopeRow]) -> usize {
    let ends = rows.iter().filter_map(|row| Some((row.first()?.0, row.last()?.0)));
    ends.map(|(first, last)| (last - first) as usize).max().unwrap_or(0)
}

/// Product of the transpose of a matrix with itself.
fn normal(rows: &[SlopeRow], size: usize, width: usize) -> SymmetricBand {
    let mut band = SymmetricBand::zeros(size, width);
    for row in rows {
        for (at, &(column, left)) in row.iter().enumerate() {
            for &(below, right) in &row[at..] {
                band.add(below as usize, column as usize, left * right);
            }
        }
    }
    band
}

/// Control law with a sparse reconstructor.
#[derive(Debug)]
pub(super) struct SparseStep {
    reconstructor: Arc<SparseReconstructor>,
    gain: f32,
    /// Whether the mirror's own slopes are added.
    is_open: bool,
}

/// Work arrays of a [`SparseStep`].
#[derive(Debug, Clone)]
pub(super) struct SparseWorkspace {
    map: Vec<f32>,
    vector: Vec<f32>,
}

impl SparseStep {
    pub(super) fn new(scene: &ControlScene, reconstructor: Arc<SparseReconstructor>) -> Self {
        // Without a fill the mirror's slopes of "full-turbulence-slopes" are added and subtracted unchanged, and cancel.
        Self { reconstructor, gain: scene.gain as f32, is_open: scene.r#loop == Loop::PseudoOpenLoop }
    }

    pub(super) fn workspace(&self) -> SparseWorkspace {
        self.reconstructor.workspace()
    }

    /// Least operations and bytes of a step.
    pub(super) fn work(&self) -> [f64; 2] {
        let SparseReconstructor { windows, solver, .. } = &*self.reconstructor;
        let times = if self.is_open { 2.0 } else { 1.0 };
        let bytes = times * windows.bytes() as f64 + 2.0 * solver.bytes() as f64;
        // Each number is multiplied and added once.
        [bytes / 2.0, bytes]
    }

    /// Change of the commands by `slopes`, which were measured with `commands` on the mirror.
    pub(super) fn apply<'a>(&self, slopes: &[f32], commands: &[f32], workspace: &'a mut SparseWorkspace) -> &'a [f32] {
        let reconstructor = &*self.reconstructor;
        reconstructor.windows.spread(slopes, &mut workspace.map);
        if self.is_open {
            reconstructor.windows.add_response(commands, &mut workspace.map);
        }
        reconstructor.solve(workspace);
        let change = &mut workspace.vector[..reconstructor.actuators];
        change.iter_mut().for_each(|command| *command *= self.gain);
        change
    }
}
