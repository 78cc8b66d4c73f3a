//! How well an image fixes the modes: the Gauss-Newton (Fisher) matrix, and the covariance that follows from it.

use crate::Result;
use crate::imaging::{CpuChain, Photometry};
use crate::optimize::Metric;
use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Eigenvalues below this fraction of the largest are null directions (global piston: exactly null up to rounding,
/// about 1e-15; the weakest real direction of 36 pistons and 66 modes has 1e-3).
pub(super) const NULL_FLOOR: f64 = 1e-11;

/// The model's sensitivity at one point: derivatives of the image with respect to every mode, e⁻ per nm, cleared of
/// what a fitted flux and background would absorb.
pub(super) struct Sensitivity {
    /// `[mode, pixel]`.
    jacobian: Array2<f64>,
    weight: Array1<f64>,
}

impl Sensitivity {
    /// At `coefficients_nm`, for a star of `flux_e` and the given weights.
    pub(super) fn at(
        judge: &CpuChain<f64>,
        coefficients_nm: ArrayView1<f64>,
        flux_e: f64,
        weight: &[f64],
        photometry: Photometry,
    ) -> Self {
        let (psf, mut jacobian) = judge.jacobian(coefficients_nm);
        jacobian *= flux_e;
        let weight = Array1::from(weight.to_vec());
        let nuisances = match photometry {
            Photometry::Fixed { .. } => Vec::new(),
            Photometry::FitFlux { .. } => vec![Array1::from(psf)],
            Photometry::FitBoth => vec![Array1::from(psf), Array1::ones(weight.len())],
        };
        // Gram-Schmidt in the weighted inner product: what is left of each derivative is what only the mode can do.
        let mut directions: Vec<Array1<f64>> = Vec::new();
        for mut nuisance in nuisances {
            for direction in &directions {
                let along = (&nuisance * &weight).dot(direction);
                nuisance.scaled_add(-along, direction);
            }
            let norm = (&nuisance * &weight).dot(&nuisance).sqrt();
            if norm > 0.0 {
                directions.push(nuisance / norm);
            }
        }
        for mut row in jacobian.axis_iter_mut(Axis(0)) {
            for direction in &directions {
                let along = (&row * &weight).dot(direction);
                row.scaled_add(-along, direction);
            }
        }
        Self { jacobian, weight }
    }

    /// Jᵀ W J, `[mode, mode]`, per nm².
    pub(super) fn fisher(&self) -> Array2<f64> {
        gram(&(&self.jacobian * &self.weight), &self.jacobian)
    }

    /// Covariance of the modes, nm². Where the weights are the inverse variances it is the inverse of `fisher`;
    /// otherwise, for noise of `variance_e2` (infinite where the weight is 0), F⁻¹ (Jᵀ W V W J) F⁻¹. Null directions
    /// carry no error: nothing moves along them.
    pub(super) fn covariance(&self, fisher: &Array2<f64>, variance_e2: Option<&[f64]>) -> Result<Array2<f64>> {
        let inverse = pseudo_inverse(fisher)?;
        let Some(variance_e2) = variance_e2 else { return Ok(inverse) };
        let spread = self.weight.iter().zip(variance_e2).map(|(&w, &v)| if w > 0.0 { w * w * v } else { 0.0 });
        let spread: Array1<f64> = spread.collect();
        let noise = gram(&(&self.jacobian * &spread), &self.jacobian);
        Ok(inverse.dot(&noise).dot(&inverse))
    }
}

/// a·bᵀ of two `[mode, pixel]` arrays, at the speed of a vectorised matrix product.
fn gram(a: &Array2<f64>, b: &Array2<f64>) -> Array2<f64> {
    let (rows, pixels) = a.dim();
    let mut product = Array2::zeros((rows, b.nrows()));
    let columns = b.nrows();
    if let (Some(a), Some(b), Some(out)) = (a.as_slice(), b.as_slice(), product.as_slice_mut()) {
        let (a, b) = (MatRef::from_row_major_slice(a, rows, pixels), MatRef::from_row_major_slice(b, columns, pixels));
        let out = MatMut::from_row_major_slice_mut(out, rows, columns);
        matmul(out, Accum::Replace, a, b.transpose(), 1.0, Par::Seq);
        return product;
    }
    a.dot(&b.t())
}

/// F⁻¹ in the directions that the data see.
fn pseudo_inverse(fisher: &Array2<f64>) -> Result<Array2<f64>> {
    // Scaled to a unit diagonal, so that "null" does not depend on the units of a mode.
    let scale = fisher.diag().mapv(|f| if f > 0.0 { f.sqrt().recip() } else { 0.0 });
    let scaled = fisher * &scale.view().insert_axis(Axis(1)) * scale.view().insert_axis(Axis(0));
    let metric = Metric::from_gauss_newton(&scaled, NULL_FLOOR)?;
    let modes = fisher.nrows();
    let mut root = Array2::zeros((metric.rank(), modes));
    let mut unit = vec![0.0; metric.rank()];
    let mut x = vec![0.0; modes];
    for (i, mut row) in root.outer_iter_mut().enumerate() {
        unit.fill(0.0);
        unit[i] = 1.0;
        metric.to_x(&unit, &mut x);
        row.assign(&(&ArrayView1::from(&x) * &scale));
    }
    Ok(root.t().dot(&root))
}
