//! Part of the segments' error that the closed loop leaves in the wavefront.
//!
//! Pistons, tips and tilts that together follow a smooth surface have no edges: the mirror
//! compensates them, and images hold next to no information on them. Their error is that of the
//! prior, in no wavefront behind the loop, and no number of images removes it.

use crate::retrieval::IlluminatedSamples;
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

/// Expected RMS over the pupil, piston, tip and tilt removed, of the wavefront that segment modes
/// of covariance `covariance_nm2` leave behind the loop, nm: `columns` are the modes with the
/// loop's response to them, `[mode, sample]`.
pub(super) fn uncompensated_rms_nm(
    columns: ArrayView2<f64>,
    covariance_nm2: ArrayView2<f64>,
    samples: &IlluminatedSamples,
) -> f64 {
    let amplitude = ArrayView1::from(&samples.amplitude);
    let weight = &amplitude / amplitude.sum();
    let left = without_planes(columns, &weight, samples);
    let variance_nm2 = (&covariance_nm2.dot(&left) * &left).sum_axis(Axis(0));
    variance_nm2.dot(&weight).max(0.0).sqrt()
}

/// Columns without their piston, tip and tilt under `weight`.
fn without_planes(columns: ArrayView2<f64>, weight: &Array1<f64>, samples: &IlluminatedSamples) -> Array2<f64> {
    let mut left = columns.to_owned();
    let mut planes: Vec<Array1<f64>> = Vec::new();
    for plane in [&vec![1.0; samples.len()], &samples.xs_m, &samples.ys_m] {
        let mut plane = Array1::from(plane.clone());
        for before in &planes {
            let share = (before * weight).dot(&plane);
            plane.scaled_add(-share, before);
        }
        let norm = (&plane * &plane).dot(weight).sqrt();
        plane /= norm;
        let shares = left.dot(&(&plane * weight)).insert_axis(Axis(1));
        left -= &shares.dot(&plane.view().insert_axis(Axis(0)));
        planes.push(plane);
    }
    left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::tests::scene;
    use crate::telescope::Telescope;

    #[test]
    fn planes_count_for_nothing_and_steps_for_their_rms() {
        let telescope = Telescope::new(&scene()).unwrap();
        let grid = telescope.pupil.grid;
        let weights = telescope.area_weights(grid).unwrap();
        let samples = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &weights).unwrap();
        let mut columns = Array2::zeros((2, samples.len()));
        for (sample, (x_m, y_m)) in samples.xs_m.iter().zip(&samples.ys_m).enumerate() {
            columns[[0, sample]] = 3.0 + 2.0 * x_m - 5.0 * y_m;
            // Even along both axes, so without a plane but for its mean, which is 0.
            columns[[1, sample]] = if (x_m * y_m) > 0.0 { 1.0 } else { -1.0 };
        }
        let rms_nm =
            uncompensated_rms_nm(columns.view(), Array2::from_diag(&ndarray::arr1(&[9.0, 4.0])).view(), &samples);
        // The pupil is symmetric to its samples' rounding.
        assert!((rms_nm - 2.0).abs() < 0.02, "{rms_nm}");
    }
}
