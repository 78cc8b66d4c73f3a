//! Sparse reconstructor: regularised least squares, solved in every frame.
//!
//! With D the interaction matrix, the commands c of slopes s have no piston, Σc = 0, and the least
//!
//! `‖D c − s‖² + α·(‖C c‖²/64 + δ‖c‖²)`, α = (largest singular value of D / `condition_number`)²,
//!
//! where C takes the second differences of the commands between neighbouring actuators along x and
//! along y. It stands for the inverse covariance of the turbulence (Ellerbroek 2002, JOSA A 19,
//! 1803), and is small for smooth commands and 64 for waffle, which the slopes measure weakly. D is
//! local (an influence function reaches a few lenslets), so the matrix A of the normal equations is
//! a band over the actuators row by row. Without the constraint piston would be a random walk,
//! since only its edges are measured; with it the commands are x − u·Σx/Σu, where x = A⁻¹Dᵀs and u
//! = A⁻¹(1, 1, …).

use super::band::{BandSolver, SymmetricBand};
use super::plant::Plant;
use super::windows::{SlopeRow, Windows};
use crate::scene::{ControlScene, Fill, Loop};
use crate::{Error, Result};
use ndarray::Array2;
use rayon::prelude::*;
use std::sync::Arc;

/// δ: regularisation of piston, of which the second differences are 0, relative to that of waffle.
/// With a condition number of 10 it lowers the loop's gain on tilt, whose singular value is about
/// 2/(actuators across) of the largest, by less than 1 % up to 200 actuators across.
const PISTON: f64 = 1e-4;
/// Square of the largest eigenvalue of C: the second differences of waffle are ±4 along each axis.
const WAFFLE: f64 = 64.0;
/// Entries of D below this fraction of its largest one are left out: less than the slopes' single
/// precision adds up to over a window.
const NEGLIGIBLE_RESPONSE: f64 = 1e-5;
/// Entries of the normal matrix beyond the band are left out if their sum in a row is below this
/// fraction of the regularisation of piston, the least of all: the matrix stays positive definite,
/// and the regularisation of no mode changes by more.
const NEGLIGIBLE_COUPLING: f64 = 0.25;

/// Sparse reconstructor of a plant.
#[derive(Debug)]
pub struct SparseReconstructor {
    windows: Windows,
    solver: BandSolver,
    /// u/Σu.
    piston: Vec<f32>,
    actuators: usize,
    slopes: usize,
    controlled: usize,
}

impl SparseReconstructor {
    /// Factorises the normal equations of `plant`.
    ///
    /// # Errors
    /// [`Error::Value`] for a plant without the places of its actuators, or an interaction matrix
    /// of zeros.
    pub(super) fn new(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        let Some((across, places)) = plant.actuator_grid else {
            let sentence = "control.reconstructor = \"sparse\" needs the places of the actuators; none were given";
            return Err(Error::Value(sentence.into()));
        };
        let condition = scene.condition_number.unwrap_or(1.0);
        let rows = local_rows(plant, scene.fill);
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
        // Without piston there is one less, unless 1ᵀE⁻¹1 is negative (the inertia of a bordered
        // matrix).
        let positive = excess.diagonal().filter(|pivot| *pivot > 0.0).count();
        let ones = vec![1.0; actuators];
        let is_piston_negative = excess.solution(&ones).iter().sum::<f64>() < 0.0;
        let controlled = if is_piston_negative { positive } else { positive.saturating_sub(1) };
        let whole = sum(1.0);
        let kept = narrowest(&whole, NEGLIGIBLE_COUPLING * PISTON * strength);
        let mut factors = whole.narrowed(kept);
        factors.factorise();
        if factors.diagonal().any(|pivot| !(pivot.is_finite() && pivot > 0.0)) {
            return Err(Error::Internal("the normal equations of the loop are not positive definite".into()));
        }
        let piston = factors.solution(&ones);
        let sum: f64 = piston.iter().sum();
        Ok(Self {
            piston: piston.iter().map(|value| (value / sum) as f32).collect(),
            windows: Windows::new(plant.lenslets_across, plant.subapertures, &rows, actuators),
            solver: BandSolver::new(&factors),
            actuators,
            slopes: plant.interaction.nrows(),
            controlled,
        })
    }

    /// Number of modes whose response exceeds their regularisation: the loop has at least half of
    /// its gain on them.
    pub fn controlled(&self) -> usize {
        self.controlled
    }

    /// Command matrix, `[actuators, 2·subapertures]`, nm per slope: the commands of one slope after
    /// the other.
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
        let commands = &mut workspace.vector[..self.actuators];
        let sum = commands.iter().map(|&command| f64::from(command)).sum::<f64>() as f32;
        commands.iter_mut().zip(&self.piston).for_each(|(command, piston)| *command -= sum * piston);
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

/// Rows of the interaction matrix without its negligible entries; those of masked subapertures are
/// empty for `fill = "mask-interaction-matrix"`.
fn local_rows(plant: &Plant, fill: Fill) -> Vec<SlopeRow> {
    let largest = plant.interaction.iter().fold(0.0f64, |largest, value| largest.max(value.abs()));
    let is_masked = |slope: usize| fill == Fill::MaskInteractionMatrix && plant.mask[slope % plant.mask.len()];
    let row = |(slope, row): (usize, ndarray::ArrayView1<f64>)| -> SlopeRow {
        if is_masked(slope) {
            return Vec::new();
        }
        let entries = row.iter().enumerate().filter(|(_, value)| value.abs() > NEGLIGIBLE_RESPONSE * largest);
        entries.map(|(actuator, &value)| (actuator as u32, value)).collect()
    };
    plant.interaction.rows().into_iter().enumerate().map(row).collect()
}

/// Second differences of the commands, along x and then along y, of every actuator whose two
/// neighbours are in use; added for one that has both.
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
        // Without a fill the mirror's slopes of "full-turbulence-slopes" are added and subtracted
        // unchanged, and cancel.
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

#[cfg(test)]
mod tests {
    use super::super::testing::{Bench, scene};
    use super::super::{ControlLaw, Stability};
    use super::*;
    use cophase_numerics::systems::least_squares;
    use ndarray::Array1;

    fn sparse(bench: &Bench, keys: &str) -> ControlLaw {
        ControlLaw::new(&scene(&format!("reconstructor = \"sparse\"\n{keys}")), &bench.plant()).unwrap()
    }

    /// The matrix of the formula, in double precision and without anything left out.
    fn formula(bench: &Bench, condition: f64) -> Array2<f64> {
        let interaction = &bench.interaction;
        let mut normal = interaction.t().dot(interaction);
        let strongest = super::super::svd(interaction).unwrap().values[0].powi(2);
        let strength = strongest / (condition * condition);
        let rows = second_differences(bench.mirror.0, &bench.mirror.1);
        for row in &rows {
            for (i, left) in row {
                for (j, right) in row {
                    normal[[*i as usize, *j as usize]] += strength * left * right / WAFFLE;
                }
            }
        }
        normal.diag_mut().iter_mut().for_each(|value| *value += strength * PISTON);
        let commands = least_squares(normal.view(), interaction.t()).unwrap();
        let ones = Array2::ones((normal.nrows(), 1));
        let piston = least_squares(normal.view(), ones.view()).unwrap();
        let sums = ones.t().dot(&commands);
        &commands - &(&piston / piston.sum()).dot(&sums)
    }

    #[test]
    fn the_commands_are_those_of_the_formula() {
        for (bench, condition) in [(&Bench::small(), 10.0), (Bench::keck(), 10.0), (Bench::keck(), 30.0)] {
            let law = sparse(bench, &format!("condition_number = {condition}"));
            let (found, known) = (law.command_matrix(), formula(bench, condition));
            let size = |matrix: &Array2<f64>| matrix.iter().map(|value| value * value).sum::<f64>().sqrt();
            let error = size(&(&found - &known)) / size(&known);
            println!("{error:.1e}");
            // What is left out of the band changes the few modes that have little more than
            // piston's regularisation by up to a quarter of it, and the power method that of all
            // modes by 1 %: a hundredth or two of the norm, which these modes dominate.
            assert!(error < 0.03, "{condition}: {error:.1e}");
        }
    }

    #[test]
    fn smooth_commands_are_kept_and_waffle_is_not() {
        let bench = Bench::keck();
        let response = sparse(bench, "").command_matrix().dot(&bench.interaction);
        let (across, places) = (bench.mirror.0, &bench.mirror.1);
        let shape = |f: &dyn Fn(f64, f64) -> f64| {
            places
                .iter()
                .map(|place| f((place % across) as f64 - 10.0, (place / across) as f64 - 10.0))
                .collect::<Array1<f64>>()
        };
        let gain = |commands: &Array1<f64>| response.dot(commands).dot(commands) / commands.dot(commands);
        // PISTON's comment allows 1 %; a wave of eight actuators has 0.6 % of waffle's
        // regularisation.
        for (smooth, least) in
            [(shape(&|x, _| x), 0.99), (shape(&|x, y| x * y), 0.99), (shape(&|x, _| (0.8 * x).sin()), 0.99)]
        {
            let gain = gain(&smooth);
            assert!(gain > least && gain < 1.001, "{gain}");
        }
        // The slopes between corners measure waffle at the border of the pupil only: it is not one
        // of the controlled modes.
        let waffle = gain(&shape(&|x, y| if (x + y) as i32 % 2 == 0 { 1.0 } else { -1.0 }));
        println!("{waffle:.3}");
        assert!((0.0..0.5).contains(&waffle), "{waffle}");
    }

    #[test]
    fn laws_with_a_sparse_reconstructor_agree_and_are_stable() {
        // c + gR(s − Dc) and (1 − g)c + gR(s − Dc + Dc) have the same fixed point up to the modes
        // that are regularised.
        let bench = Bench::keck();
        let turbulence: Array1<f64> = {
            let commands: Array1<f64> =
                (0..bench.interaction.ncols()).map(|i| (i as f64 * 0.05).sin() * 100.0).collect();
            bench.interaction.dot(&commands)
        };
        let residuals = ["closed", "pseudo-open-loop", "full-turbulence-slopes"].map(|r#loop| {
            let law = sparse(bench, &format!("loop = {:?}", r#loop));
            let Stability { stable, largest_stable_gain, controlled, uncontrolled, .. } = *law.stability();
            assert!(stable && (largest_stable_gain - 2.0).abs() < 1e-9);
            assert_eq!(controlled + uncontrolled, bench.interaction.ncols());
            // Piston and waffle are not, and at most a few at the border.
            assert!((1..20).contains(&uncontrolled), "{uncontrolled}");
            let mut controller = law.start();
            let mut rms = f64::NAN;
            for _ in 0..60 {
                let commands: Array1<f64> = controller.commands_nm().iter().map(|&c| f64::from(c)).collect();
                let slopes = &turbulence - &bench.interaction.dot(&commands);
                rms = (slopes.dot(&slopes) / turbulence.dot(&turbulence)).sqrt();
                controller.step(&slopes.iter().map(|&slope| slope as f32).collect::<Vec<_>>()).unwrap();
            }
            rms
        });
        println!("{residuals:?}");
        // 0.7^60 = 5e-10 of a mode with all of the gain is left; what the regularisation holds back
        // is below 1 %.
        assert!(residuals.iter().all(|rms| *rms < 0.01), "{residuals:?}");
        assert_eq!(residuals[0].to_bits(), residuals[2].to_bits());
    }

    #[test]
    fn masked_slopes_are_unused_and_invalid_plants_refused() {
        let bench = Bench::keck();
        let matrix = sparse(bench, "fill = \"mask-interaction-matrix\"").command_matrix();
        for (column, masked) in bench.mask.iter().chain(&bench.mask).enumerate() {
            assert_eq!(*masked, matrix.column(column).iter().all(|&value| value == 0.0));
        }
        let scene = scene("reconstructor = \"sparse\"");
        let plant = bench.plant();
        let blind = Array2::zeros(bench.interaction.dim());
        let backwards: Vec<usize> = bench.mirror.1.iter().rev().copied().collect();
        for (plant, reason) in [
            (Plant { actuator_grid: None, ..plant }, "places of the actuators"),
            (Plant { actuator_grid: Some((bench.mirror.0, &backwards)), ..plant }, "ascending"),
            (Plant { interaction: &blind, ..plant }, "interaction matrix is 0"),
        ] {
            let sentence = ControlLaw::new(&scene, &plant).unwrap_err().to_string();
            assert!(sentence.contains(reason), "{sentence}");
        }
    }
}
