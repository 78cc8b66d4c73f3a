//! Figure that all segments have in common (scalloping), an unknown of the estimate where segments
//! have tips and tilts.
//!
//! Pistons, tips and tilts that follow a paraboloid (the focus mode of a segmented mirror, and its
//! astigmatisms) differ from it by a curvature within each segment, the same in all. The loop
//! removes the paraboloid. What remains in the wavefront is this curvature alone, 0.02 nm for 1 nm
//! of a paraboloid over Keck's segments, and images cannot distinguish it from a figure error that
//! all segments have. If the model has no figure, half a nanometre of it, or an error of the mean
//! wavefront of the same shape, becomes 25 nm of pistons and tilts.

use crate::Result;
use crate::linear_algebra::SpdInverse;
use crate::retrieval::IlluminatedSamples;
use ndarray::{Array2, ArrayView1, ArrayView2, Axis};

/// Prior RMS of each of the three figures over the pupil, nm: twice the error of the mean wavefront
/// that four simulated nights with ideal segments showed in these shapes. On Keck it corresponds to
/// 50 nm of a paraboloid, several times what pistons of 64 nm and tilts of 20 nm contain of one, so
/// that a larger prior changes no estimate.
pub(super) const COMMON_FIGURE_RMS_NM: f64 = 1.0;

/// Wavefronts, `[figure, sample]`, of 1 nm RMS of each figure behind the loop: focus and two
/// astigmatisms of every segment. `segments` are the wavefronts of pistons, tips and tilts without
/// the loop's response, `columns` those with it, `[mode, sample]`; both are the same where the loop
/// is not known.
///
/// The loop's response to a figure is minus that to the pistons and tilts of its paraboloid, but
/// for what it leaves of the paraboloid itself.
///
/// # Errors
/// Where the equations cannot be solved.
pub(super) fn common_figures(
    segments: ArrayView2<f64>,
    columns: ArrayView2<f64>,
    samples: &IlluminatedSamples,
) -> Result<Array2<f64>> {
    let paraboloids = Array2::from_shape_fn((3, samples.len()), |(figure, sample)| {
        let (x_m, y_m) = (samples.xs_m[sample], samples.ys_m[sample]);
        [x_m * x_m + y_m * y_m, x_m * x_m - y_m * y_m, 2.0 * x_m * y_m][figure]
    });
    let amplitude = ArrayView1::from(&samples.amplitude);
    let weight = &amplitude / amplitude.sum();
    let weighted = &segments * &weight;
    let normal = SpdInverse::of_normal_equations(segments.dot(&weighted.t()))?;
    let coefficients = paraboloids.dot(&weighted.t()).dot(&normal.inverse);
    let curvatures = paraboloids - coefficients.dot(&segments);
    let rms = (&curvatures * &curvatures).dot(&weight).mapv(f64::sqrt).insert_axis(Axis(1));
    let response = coefficients.dot(&(&columns - &segments));
    Ok((curvatures - response) / rms)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modes::tilt_frames;
    use crate::retrieval::tests::scene;
    use crate::telescope::Telescope;
    use ndarray::{Array1, concatenate};

    #[test]
    fn figures_are_curvatures_that_all_segments_have_in_common() {
        let telescope = Telescope::new(&scene()).unwrap();
        let grid = telescope.pupil.grid;
        let weights = telescope.area_weights(grid).unwrap();
        let samples = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &weights).unwrap();
        let samples = samples.subset(&samples.select_bright(0.5));
        let tilts = samples.tilts(&tilt_frames(&telescope.pupil).unwrap());
        let segments = concatenate(Axis(0), &[samples.pistons.view(), tilts.view()]).unwrap();
        let figures = common_figures(segments.view(), segments.view(), &samples).unwrap();
        let amplitude: Array1<f64> = samples.amplitude.iter().copied().collect();
        let dot = |a: ArrayView1<f64>, b: ArrayView1<f64>| (&a * &b).dot(&amplitude) / amplitude.sum();
        for figure in figures.rows() {
            assert!((dot(figure, figure) - 1.0).abs() < 1e-9);
            // Neither piston nor tilt of any segment, to the regularisation of faint segments.
            assert!(segments.rows().into_iter().all(|segment| dot(segment, figure).abs() < 1e-6));
        }
        // Behind a loop that takes out half of each segment mode, less than of the figure, which
        // has pistons and tilts of its paraboloid.
        let half = common_figures(segments.view(), (&segments * 0.5).view(), &samples).unwrap();
        assert!(
            half.rows().into_iter().zip(figures.rows()).all(|(half, figure)| (dot(half, figure) - 1.0).abs() < 1e-6)
        );
        assert!(half.rows().into_iter().all(|half| dot(half, half) > 1.5));
    }
}
