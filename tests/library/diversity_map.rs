//! A diversity as a map that has no values outside the pupil, as other programs write it.

use crate::common::simulated;
use crate::consistency::scene;
use cophase::io::{FitsWriter, Pixel};
use cophase::pipeline::Estimator;
use cophase::telescope::{Diversity, Telescope};
use ndarray::Array2;

#[test]
fn diversity_map_needs_no_values_outside_the_pupil() {
    let folder = tempfile::tempdir().unwrap();
    let focus = scene(&[]);
    let telescope = Telescope::new(&focus).unwrap();
    let diversity = Diversity::new(&focus, &telescope).unwrap();
    let images = simulated(&focus);
    let expected = Estimator::new(&focus).unwrap().estimate(&images).unwrap().modes.coefficients_nm;
    // On the samples of the pupil, and on others.
    for samples in [96, 250] {
        let pupil = telescope.pupil_on(cophase::pupil::Grid::new(samples, 4.8).unwrap()).unwrap();
        let at_m = |index: usize| pupil.grid.coordinate_m(index);
        for outside in [None, Some(0.0), Some(f64::NAN)] {
            let value = |(y, x): (usize, usize)| {
                let inside = diversity.at(at_m(x), at_m(y));
                outside.filter(|_| pupil.owner[[y, x]] < 0).unwrap_or(inside)
            };
            let path = folder.path().join("diversity.fits");
            let mut file = FitsWriter::create(&path).unwrap();
            file.image("OPD", &Array2::from_shape_fn((samples, samples), value), Pixel::F64, "nm").unwrap();
            file.finish().unwrap();
            let mapped =
                scene(&[("image.diversity_focus_waves_rms", ""), ("image.diversity_file", path.to_str().unwrap())]);
            let found = Estimator::new(&mapped).unwrap().estimate(&images).unwrap().modes.coefficients_nm;
            let errors_nm = found.iter().zip(&expected).map(|(found, expected)| (found - expected).abs());
            let worst_nm = errors_nm.fold(0.0f64, f64::max);
            // Interpolation between 96 samples is off by less; an edge without values was off by 6
            // to 30 nm.
            assert!(worst_nm < 1.0, "{samples} {outside:?}: {worst_nm} nm");
        }
    }
}
