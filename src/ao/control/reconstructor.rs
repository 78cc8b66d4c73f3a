//! Reconstructor: truncated least-squares inverse of the interaction matrix, from slopes to
//! commands.

use super::linalg::svd;
use super::plant::Plant;
use crate::scene::{ControlBasis, ControlScene, Fill};
use crate::{Error, Result};
use ndarray::{Array2, s};

/// Reconstructor as a product, `commands = modes · inverse · slopes`. With D the interaction matrix
/// (without the rows of masked subapertures if `fill = "mask-interaction-matrix"`),
/// `inverse · D · modes` is the identity.
#[derive(Debug, Clone)]
pub struct Reconstructor {
    modes: Array2<f64>,
    inverse: Array2<f64>,
    singular_values: Vec<f64>,
    dropped: usize,
}

impl Reconstructor {
    /// Computes the truncated inverse of the plant's interaction matrix.
    ///
    /// `basis = "zonal"`: the singular value decomposition of D without its `filtered_modes`
    /// smallest values. `basis = "kl"`: the last `filtered_modes` Karhunen-Loève modes are removed,
    /// and D times the others is inverted. In both, `condition_number` removes singular values
    /// below the largest divided by it. Singular values at the level of rounding are never
    /// inverted.
    ///
    /// # Errors
    /// [`Error::Value`] if no mode is left, or the Karhunen-Loève modes are missing.
    pub(super) fn new(scene: &ControlScene, plant: &Plant) -> Result<Self> {
        if let Some(matrix) = plant.command_matrix {
            return Self::from_command_matrix(matrix, plant);
        }
        let filtered = scene.filtered_modes.unwrap_or(0);
        let interaction = interaction_without_masked(plant, scene.fill);
        let (basis, sensed, available) = match scene.basis {
            ControlBasis::Zonal => (None, interaction, plant.interaction.ncols()),
            ControlBasis::Kl => {
                let Some(modes) = plant.kl else {
                    let text = "control.basis = \"kl\" needs the mirror's Karhunen-Loève modes; none were given";
                    return Err(Error::Value(text.into()));
                };
                let kept = modes.slice(s![.., ..modes.ncols().saturating_sub(filtered)]).to_owned();
                let sensed = interaction.dot(&kept);
                (Some(kept), sensed, modes.ncols())
            }
        };
        let svd = svd(&sensed)?;
        let strongest = svd.values.first().copied().unwrap_or(0.0);
        let (rows, columns) = sensed.dim();
        // Size of a zero singular value after rounding.
        let rounding = rows.max(columns) as f64 * f64::EPSILON;
        let smallest = strongest * scene.condition_number.map_or(0.0, f64::recip).max(rounding);
        let strong = svd.values.iter().take_while(|&&value| value > 0.0 && value >= smallest).count();
        let kept = strong.min(available.saturating_sub(filtered));
        if kept == 0 {
            return Err(Error::Value(format!(
                "control.filtered_modes = {filtered} leaves none of {available} modes to control; fewer filtered modes are \
                 needed, and an interaction matrix that is not 0"
            )));
        }
        let right = svd.right.slice(s![.., ..kept]);
        let modes = basis.map_or_else(|| right.to_owned(), |basis| basis.dot(&right));
        let mut inverse = svd.left.slice(s![.., ..kept]).t().to_owned();
        for (mut row, value) in inverse.rows_mut().into_iter().zip(&svd.values) {
            row /= *value;
        }
        if scene.fill == Fill::MaskInteractionMatrix {
            // These columns are 0 up to rounding, which the inversion has amplified.
            for (mut column, _) in inverse.columns_mut().into_iter().zip(masks(plant)).filter(|(_, masked)| **masked) {
                column.fill(0.0);
            }
        }
        Ok(Self { modes, inverse, singular_values: svd.values, dropped: available - kept })
    }

    /// The command matrix of a loop that computes its own, with a mode for each actuator.
    fn from_command_matrix(matrix: &Array2<f64>, plant: &Plant) -> Result<Self> {
        let needed = (plant.actuators(), plant.interaction.nrows());
        if matrix.dim() != needed {
            let given = matrix.dim();
            return Err(Error::Shape(format!(
                "a command matrix of the shape {given:?} was given; {needed:?} is needed"
            )));
        }
        let modes = Array2::eye(plant.actuators());
        Ok(Self { modes, inverse: matrix.clone(), singular_values: Vec::new(), dropped: 0 })
    }

    /// Whether it inverts the interaction matrix on its modes.
    pub(super) fn is_inverse(&self) -> bool {
        !self.singular_values.is_empty()
    }

    /// Commands of each controlled mode, `[actuators, controlled]`, nm.
    pub fn modes(&self) -> &Array2<f64> {
        &self.modes
    }

    /// Matrix from slopes to controlled modes, `[controlled, 2·subapertures]`. The columns of
    /// subapertures that are masked in the interaction matrix are zero.
    pub fn inverse(&self) -> &Array2<f64> {
        &self.inverse
    }

    /// Command matrix R = modes · inverse, `[actuators, 2·subapertures]`, nm per slope.
    pub fn command_matrix(&self) -> Array2<f64> {
        self.modes.dot(&self.inverse)
    }

    /// Singular values of the inverted matrix, descending, slope per nm; the first
    /// [`controlled`](Self::controlled) are kept. Empty for a command matrix that was given.
    pub fn singular_values(&self) -> &[f64] {
        &self.singular_values
    }

    /// Number of controlled modes.
    pub fn controlled(&self) -> usize {
        self.modes.ncols()
    }

    /// Number of modes removed, out of the actuators ("zonal") or the Karhunen-Loève modes ("kl").
    pub fn dropped(&self) -> usize {
        self.dropped
    }
}

/// Interaction matrix; for `fill = "mask-interaction-matrix"` with the rows of masked subapertures
/// set to zero. For least squares this equals removing the rows, and the inverse has zero columns
/// for them.
fn interaction_without_masked(plant: &Plant, fill: Fill) -> Array2<f64> {
    let mut interaction = plant.interaction.clone();
    if fill == Fill::MaskInteractionMatrix {
        for (mut row, _) in interaction.rows_mut().into_iter().zip(masks(plant)).filter(|(_, masked)| **masked) {
            row.fill(0.0);
        }
    }
    interaction
}

/// Mask of the slopes, x and then y.
fn masks<'a>(plant: &Plant<'a>) -> impl Iterator<Item = &'a bool> + use<'a> {
    plant.mask.iter().chain(plant.mask)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Bench, scene};
    use super::*;

    /// Largest entry of |matrix − identity|.
    fn off_identity(matrix: &Array2<f64>) -> f64 {
        let eye = Array2::<f64>::eye(matrix.nrows());
        (matrix - &eye).iter().fold(0.0, |worst, value| value.abs().max(worst))
    }

    /// Rounding of products that equal the identity: ε times a condition number of up to 30, times
    /// √496 for the sums, and a margin of ten.
    const IDENTITY: f64 = 2e-12;

    #[test]
    fn inverse_is_the_identity_on_kept_modes_and_counts_dropped() {
        let bench = Bench::keck();
        for (keys, dropped) in [
            ("filtered_modes = 2", 2),
            // Corner differences do not measure piston and waffle: two singular values are
            // rounding.
            ("filtered_modes = 0", 2),
            ("filtered_modes = 40", 40),
            ("filtered_modes = 2\nfill = \"mask-interaction-matrix\"", 2),
            ("filtered_modes = 20\nbasis = \"kl\"", 20),
            ("filtered_modes = 100\nbasis = \"kl\"\nfill = \"mask-interaction-matrix\"", 100),
        ] {
            let scene = scene(keys);
            let reconstructor = Reconstructor::new(&scene, &bench.plant()).unwrap();
            let interaction = interaction_without_masked(&bench.plant(), scene.fill);
            let identity = reconstructor.inverse().dot(&interaction).dot(reconstructor.modes());
            let error = off_identity(&identity);
            println!("{keys:?}: {} controlled, {error:.1e}", reconstructor.controlled());
            assert!(error < IDENTITY, "{keys}");
            let all = if scene.basis == ControlBasis::Kl { bench.kl.ncols() } else { bench.interaction.ncols() };
            assert!(reconstructor.dropped() >= dropped, "{keys}: {}", reconstructor.dropped());
            if scene.fill == Fill::None {
                assert_eq!(reconstructor.dropped(), dropped, "{keys}");
            }
            assert_eq!(reconstructor.controlled() + reconstructor.dropped(), all, "{keys}");
        }
    }

    #[test]
    fn masked_slopes_do_not_reach_the_mirror() {
        let bench = Bench::keck();
        let scene = scene("filtered_modes = 2\nfill = \"mask-interaction-matrix\"");
        let matrix = Reconstructor::new(&scene, &bench.plant()).unwrap().command_matrix();
        for (column, masked) in bench.mask.iter().chain(&bench.mask).enumerate() {
            assert_eq!(*masked, matrix.column(column).iter().all(|&value| value == 0.0));
        }
    }

    #[test]
    fn the_condition_number_limits_the_singular_values() {
        let bench = Bench::keck();
        for basis in ["zonal", "kl"] {
            let all = Reconstructor::new(&scene(&format!("basis = {basis:?}")), &bench.plant()).unwrap();
            let values = all.singular_values().to_vec();
            let keys = format!("basis = {basis:?}\ncondition_number = 10.0");
            let some = Reconstructor::new(&scene(&keys), &bench.plant()).unwrap();
            let strong = values.iter().filter(|&&value| value >= values[0] / 10.0).count();
            assert_eq!(some.controlled(), strong);
            assert!(strong < all.controlled() && strong > 0, "{strong}");
        }
    }

    #[test]
    fn a_loop_without_controlled_modes_is_refused() {
        let bench = Bench::keck();
        for keys in ["filtered_modes = 10000", "basis = \"kl\"\nfiltered_modes = 10000"] {
            let error = Reconstructor::new(&scene(keys), &bench.plant()).unwrap_err();
            assert!(matches!(error, Error::Value(_)) && error.to_string().contains("10000"), "{error}");
        }
        let without = Plant { kl: None, ..bench.plant() };
        assert!(Reconstructor::new(&scene("basis = \"kl\""), &without).is_err());
        let blind = Array2::zeros(bench.interaction.dim());
        assert!(Reconstructor::new(&scene(""), &Plant { interaction: &blind, ..bench.plant() }).is_err());
    }
}
