//! Response of the wavefront sensor to NCPA during exposures, from which the reference slopes of a correction follow.

use ndarray::{Array1, Array2, ArrayView1};

/// Slopes of NCPA as they are measured behind the turbulence of the exposures.
///
/// Turbulence blurs the spots of lenslets, whose slopes then change less, and not alike in all: a quad cell's by a half at Keck.
#[derive(Debug, Clone)]
pub struct SlopeResponse {
    /// Slopes for 1 nm of each mode, about some of the images, `[mode, slope]`, mas.
    pub(super) response_mas: Array2<f64>,
    /// NCPA that were estimated, nm.
    pub(super) ncpa_nm: Vec<f64>,
    /// Mean slopes of their opposite over all images, mas.
    pub(super) opposite_mas: Array1<f64>,
}

impl SlopeResponse {
    /// Increments of the reference slopes with which the loop puts the opposite of `ncpa_nm` on the mirror, `[all x, all y]`, mas. Those of the
    /// estimate itself are a mean over all images; what `ncpa_nm` differ from it is taken by the linear response.
    pub(super) fn reference_mas(&self, ncpa_nm: &[f64]) -> Vec<f64> {
        let left_nm = &ArrayView1::from(&self.ncpa_nm) - &ArrayView1::from(ncpa_nm);
        (left_nm.dot(&self.response_mas) + &self.opposite_mas).to_vec()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::arr2;

    #[test]
    fn modes_that_are_held_have_no_reference() {
        let response_mas = arr2(&[[1.0, 0.0], [0.0, 2.0]]);
        // A response that saturates by a tenth.
        let opposite_mas = Array1::from(vec![-2.7, -9.0]);
        let response = SlopeResponse { response_mas, ncpa_nm: vec![3.0, 5.0], opposite_mas };
        assert_eq!(response.reference_mas(&[3.0, 5.0]), [-2.7, -9.0]);
        let one = response.reference_mas(&[3.0, 0.0]);
        assert!((one[0] + 2.7).abs() < 1e-12 && (one[1] - 1.0).abs() < 1e-12, "{one:?}");
    }
}
