//! Tiles against the whole, and both against the definition, on seven segments that tilt.

use super::*;
use crate::modal::fitter::ModalFitter;
use crate::scene::Scene;
use ndarray::{Array1, Axis};

fn fitter() -> ModalFitter {
    let small = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "4.8"),
        ("pupil.samples", "64"),
        ("image.samples_per_lambda_over_d", "3"),
        ("image.pixels", "132"),
        ("image.diversity_focus_waves_rms", "0.8"),
        ("modes.segment", "piston-tip-tilt"),
        ("modes.ncpa", "zernike"),
        ("modes.ncpa_count", "5"),
        ("modes.exact_zernikes", "none"),
    ];
    ModalFitter::new(&Scene::preset("keck-artificial").unwrap().with(&small).unwrap(), false).unwrap()
}

/// Two lists of weights: of many sizes with bad pixels among them, and all the same.
fn weights(pixels: usize) -> Vec<Vec<f64>> {
    let uneven = |i: usize| if i % 13 == 5 { 0.0 } else { 1.0 / (0.01 + (0.37 * i as f64).sin().powi(2)) };
    vec![(0..pixels).map(uneven).collect(), vec![3.0; pixels]]
}

/// Largest difference of two matrices, entry [i, j] in units of √([i, i]·[j, j]) of the second.
fn difference(found: &Array2<f64>, wanted: &Array2<f64>) -> f64 {
    assert_eq!(found.dim(), wanted.dim());
    let size = |i: usize, j: usize| (wanted[[i, i]] * wanted[[j, j]]).sqrt();
    found.indexed_iter().map(|((i, j), v)| (v - wanted[[i, j]]).abs() / size(i, j)).fold(0.0, f64::max)
}

/// A sum of P products is off by P·ε/2 of Σ|a·b| ≤ √(Σa²·Σb²) at most, in any order; two sums
/// by twice that. The derivatives themselves are the same in all tiles but for the shape of the
/// products that make them, some ε·n² ≈ 1e-12 at worst.
fn rounding(pixels: usize) -> f64 {
    pixels as f64 * f64::EPSILON + 1e-12
}

#[test]
fn products_in_tiles_are_those_of_the_whole() {
    let fitter = fitter();
    let linear = fitter.reference_chain().linearise(Array1::from_elem(26, 17.0).view());
    let m = linear.pixels();
    let weights = weights(m * m);
    for nuisances in [Nuisances::None, Nuisances::Flux, Nuisances::FluxAndBackground] {
        let whole = products(&linear, &[], nuisances, &weights, m);
        let kept = StoredDerivatives::new(&linear, nuisances).products(&weights);
        assert_eq!(whole, kept, "the same work, twice");
        // Tiles that divide the image, that do not, and the smallest.
        for tile in [m / 2, 7, 1] {
            for (tiled, whole) in products(&linear, &[], nuisances, &weights, tile).iter().zip(&whole) {
                let off = difference(tiled, whole);
                assert!(off < rounding(m * m), "{nuisances:?}, {tile} rows: {off:e}");
            }
        }
    }
}

#[test]
fn projection_removes_flux_and_background() {
    let fitter = fitter();
    let at = Array1::from_elem(26, 17.0);
    let (psf, mut jacobian) = fitter.reference_chain().jacobian(at.view());
    let linear = fitter.reference_chain().linearise(at.view());
    let weights = weights(psf.len());
    // Gram-Schmidt on the derivatives themselves, in the product of the first weights.
    let weight = Array1::from(weights[0].clone());
    let mut directions: Vec<Array1<f64>> = Vec::new();
    for nuisance in [Array1::from(psf), Array1::ones(weight.len())] {
        let along = |v: &Array1<f64>, d: &Array1<f64>| (v * &weight).dot(d);
        let rest = directions.iter().fold(nuisance, |rest, d| &rest - &(d * along(&rest, d)));
        let norm = along(&rest, &rest).sqrt();
        directions.push(rest / norm);
    }
    for mut row in jacobian.axis_iter_mut(Axis(0)) {
        for direction in &directions {
            let along = (&row * &weight).dot(direction);
            row.scaled_add(-along, direction);
        }
    }
    let nuisances = Nuisances::FluxAndBackground;
    let found = products(&linear, &[], nuisances, &weights, 11);
    let shares = NuisanceShares::new(&found[0], nuisances);
    for (found, weight) in found.into_iter().zip(&weights) {
        let wanted = (&jacobian * &Array1::from(weight.clone())).dot(&jacobian.t());
        let found = shares.project_out(found);
        assert_eq!(found, found.t(), "symmetric to the last bit");
        // Taking out cancels at most the modes' own share of the nuisances: no entry is less than
        // 1e-3 of what it was.
        let off = difference(&found, &wanted);
        assert!(off < 1e3 * rounding(linear.psf().len()), "{off:e}");
    }
}

#[test]
fn duplicate_nuisance_is_projected_out_once() {
    // Rows: one mode, a nuisance, and the same nuisance doubled.
    let products = ndarray::array![[5.0, 2.0, 4.0], [2.0, 1.0, 2.0], [4.0, 2.0, 4.0]];
    let cleared = NuisanceShares::new(&products, Nuisances::FluxAndBackground).project_out(products);
    assert_eq!(cleared, ndarray::array![[1.0]]);
}
