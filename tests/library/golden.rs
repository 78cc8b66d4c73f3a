//! Comparison with vectors from an independent program (`tests/golden/README.md`), on every
//! available chain.

use crate::common::{chains, relative_difference};
use cophase::Control;
use cophase::imaging::{Chain, CpuChain, Exposure, Precision};
use cophase::io;
use cophase::modal::{Cube, Frame, ModalEstimate, ModalFitter, ModelCache, Recipe, fitter_of};
use cophase::modes::Group;
use cophase::scene::Scene;
use ndarray::{Array1, Array2, ArrayView1, Axis};
use std::path::{Path, PathBuf};

/// The settings of that program: the modes as given, flux = Σd, no background, the whole image.
const CHOICES: [(&str, &str); 6] = [
    ("modes.exact_zernikes", "none"),
    ("image.crop_pixels", "240"),
    ("estimate.fit_flux", "false"),
    ("estimate.fit_background", "false"),
    ("estimate.recentre", "false"),
    // Far below the tolerance of 1e-3 nm.
    ("estimate.step_tolerance_nm", "1e-5"),
];

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn estimator(weighting: &str) -> ModalFitter {
    let scene = Scene::from_file(file("scene.toml")).unwrap().with(&CHOICES).unwrap();
    ModalFitter::new(&scene.with(&[("estimate.weighting", weighting)]).unwrap(), false).unwrap()
}

fn image(name: &str) -> Array2<f64> {
    io::read_map(file(name), Some("IMAGES")).unwrap()
}

fn exposure(estimator: &ModalFitter, name: &str) -> Exposure {
    let data = image(name);
    let bad = data.mapv(|_| false);
    let frame = Frame { data_e: data.view(), bad: bad.view(), read_noise_e: Some(120.0) };
    estimator.model().preparation.prepare(frame, estimator.recipe()).unwrap().exposure
}

/// A one-dimensional image HDU, as a cube of one row.
fn vector(name: &str, hdu: &str) -> Vec<f64> {
    io::FitsReader::open(file(name)).unwrap().vector(hdu).unwrap()
}

struct Objectives {
    coefficients_nm: Array2<f64>,
    objective: Vec<f64>,
    gradient: Array2<f64>,
}

fn objectives(weighting: &str) -> Objectives {
    let text = std::fs::read_to_string(file("objective.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let row = |value: &serde_json::Value| -> Vec<f64> {
        value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
    };
    let rows = |value: &serde_json::Value| -> Array2<f64> {
        let rows: Vec<Array1<f64>> = value.as_array().unwrap().iter().map(|v| Array1::from(row(v))).collect();
        ndarray::stack(Axis(0), &rows.iter().map(|r| r.view()).collect::<Vec<_>>()).unwrap()
    };
    Objectives {
        coefficients_nm: rows(&json["coefficients_nm"]),
        objective: row(&json[weighting]["J"]),
        gradient: rows(&json[weighting]["dJ_dnm"]),
    }
}

#[test]
fn the_bare_pupil_has_the_golden_psf() {
    let estimator = estimator("noise");
    let truth = io::read_map(file("psf_flat.fits.gz"), Some("DEFOCUS")).unwrap();
    let peak = truth.iter().copied().fold(0.0, f64::max);
    let zero = Array1::zeros(estimator.model().optics.modes());
    let worst = |psf: Vec<f64>| psf.iter().zip(&truth).map(|(a, b)| (a - b).abs() / peak).fold(0.0, f64::max);
    let wide = worst(CpuChain::<f64>::new(estimator.model().optics.clone()).psf(zero.view()));
    let narrow = CpuChain::<f32>::new(estimator.model().optics.clone()).psf(zero.view());
    let narrow = worst(narrow.into_iter().map(f64::from).collect());
    println!("PSF: {wide:.1e} of the peak in f64, {narrow:.1e} in f32");
    for (name, chain) in chains(&estimator, 1) {
        if let Chain::Device { mut chain, precision, .. } = chain {
            let error = worst(chain.psf(zero.as_slice().unwrap()).unwrap());
            println!("{name}: {error:.1e} of the peak");
            assert!(error < if precision == Precision::F64 { 1e-12 } else { 2e-6 }, "{name}: {error:e}");
        }
    }
    // Sums of 9,400 unit terms: a random walk of roundings is 1e-14 of the peak amplitude in f64;
    // the contract's 1e-12 and 2e-6 leave room for the way the golden program added up.
    assert!(wide < 1e-12);
    assert!(narrow < 2e-6);
}

#[test]
fn objectives_and_gradients_are_golden() {
    for (weighting, key) in [("none", "unweighted"), ("noise", "weighted")] {
        let estimator = estimator(weighting);
        let golden = objectives(key);
        let exposure = exposure(&estimator, "inspan.fits.gz");
        for (name, mut chain) in chains(&estimator, 5) {
            chain.load(&vec![exposure.clone(); 5]).unwrap();
            let found = chain.evaluate(&[0, 1, 2, 3, 4], golden.coefficients_nm.view()).unwrap();
            // The contract: f64 is limited by the rounding of 57,600 terms, f32 by 6e-8 of the
            // brightest pixel against residuals of its thousandth at the truth.
            let (objective_bound, gradient_bound) =
                if chain.precision() == Precision::F64 { (1e-12, 1e-11) } else { (1e-5, 1e-5) };
            for (i, found) in found.iter().enumerate() {
                let objective = (found.objective / golden.objective[i] - 1.0).abs();
                let gradient = relative_difference(&found.gradient, golden.gradient.row(i).as_slice().unwrap());
                println!("{name}, {key}, point {i}: objective {objective:.1e}, gradient {gradient:.1e}");
                // The last point is the truth: there the terms of the gradient cancel to a
                // thousandth and less, and the error in f32 is relative to the size of the terms,
                // that of the gradient elsewhere.
                let scale = if i == 4 && chain.precision() == Precision::F32 { noise_scale(&golden) } else { 1.0 };
                assert!(objective < objective_bound, "{name} {key} {i}: {objective:e}");
                assert!(gradient < gradient_bound * scale, "{name} {key} {i}: {gradient:e}");
            }
        }
    }
}

/// Norm of the gradient at a random point over that at the truth.
fn noise_scale(golden: &Objectives) -> f64 {
    let norm = |i: usize| golden.gradient.row(i).mapv(|g| g * g).sum().sqrt();
    norm(1) / norm(4)
}

#[test]
fn the_gauss_newton_matrix_is_golden() {
    let estimator = estimator("noise");
    let golden = io::read_map(file("gauss_newton.fits.gz"), Some("HESSIAN")).unwrap();
    let at = objectives("weighted").coefficients_nm.row(2).to_owned();
    let exposure = exposure(&estimator, "inspan.fits.gz");
    let (_, mut jacobian) = estimator.reference_chain().jacobian(at.view());
    jacobian *= exposure.data_e.iter().sum::<f64>();
    let weighted = &jacobian * &ArrayView1::from(&exposure.weight);
    let found = weighted.dot(&jacobian.t());
    let difference = relative_difference(found.as_slice().unwrap(), golden.as_standard_layout().as_slice().unwrap());
    println!("Gauss-Newton matrix: {difference:.1e}");
    // 57,600 products each of numbers that carry the transform's rounding of about 1e-14.
    assert!(difference < 1e-11);
}

fn run(estimator: &ModalFitter, chain: &mut Chain, name: &str) -> ModalEstimate {
    let data = image(name).insert_axis(Axis(0));
    let bad = data.mapv(|_| false);
    estimator
        .estimate(
            chain,
            Cube { images_e: data.view(), bad: bad.view(), read_noise_e: Some(120.0) },
            &Control::default(),
        )
        .unwrap()
}

#[test]
fn estimates_are_golden() {
    for (weighting, key) in [("none", "EST_LM_UNWEIGHTED"), ("noise", "EST_LM_WEIGHTED")] {
        let estimator = estimator(weighting);
        for name in ["inspan.fits.gz", "zern.fits.gz"] {
            let golden = vector(name, key);
            for (chain_name, mut chain) in chains(&estimator, 1) {
                let estimate = run(&estimator, &mut chain, name);
                let pistons = estimator.model().segment_modes;
                let mut found = estimate.combined.modes.coefficients_nm.clone();
                // The golden pistons are relative to their unweighted mean.
                let mean = found[..pistons].iter().sum::<f64>() / pistons as f64;
                found[..pistons].iter_mut().for_each(|nm| *nm -= mean);
                let worst = found.iter().zip(&golden).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                println!(
                    "{chain_name}, {name}, {weighting}: worst mode {worst:.1e} nm, {} evaluations",
                    estimate.images[0].evaluations
                );
                let bound = if chain.precision() == Precision::F64 { 1e-3 } else { 0.02 };
                assert!(worst < bound, "{chain_name} {name} {weighting}: {worst} nm");
            }
        }
    }
}

#[test]
fn our_default_is_at_least_as_close_to_the_truth() {
    let scene = Scene::from_file(file("scene.toml")).unwrap();
    let golden = estimator("noise");
    for name in ["inspan.fits.gz", "zern.fits.gz"] {
        let images = io::read_images(file(name), None).unwrap();
        let cube = Cube { images_e: images.data.view(), bad: images.bad.view(), read_noise_e: images.read_noise_e };
        let control = Control::default();
        let (recipe, cache) = (Recipe::with_prior(&scene), ModelCache::default());
        let ours = fitter_of(&scene, recipe, &cache, cube, &control).unwrap();
        let mut chain = Chain::cpu(ours.model().optics.clone(), Precision::F64);
        let estimate = ours.estimate(&mut chain, cube, &control).unwrap();
        let pupil = &ours.model().telescope.pupil;
        let theirs = vector(name, "EST_LM_WEIGHTED");
        let residuals = [
            ("TRUTH_PHASING", &estimate.combined.maps.phasing_nm, Group::Segment),
            ("TRUTH_NCPA", &estimate.combined.maps.ncpa_nm, Group::Ncpa),
        ]
        .map(|(hdu, found, group)| {
            let truth = io::read_map(file(name), Some(hdu)).unwrap();
            let residual = |map: &Array2<f64>| {
                pupil.rms(pupil.remove_piston_tip_tilt((map - &truth).view()).unwrap().view()).unwrap()
            };
            let (mine, golden) = (residual(found), residual(&golden.model().map_nm(&theirs, group)));
            println!("{name} {hdu}: ours {mine:.4} nm, golden {golden:.4} nm");
            (mine, golden)
        });
        for (mine, golden) in residuals {
            // Where the golden basis of 102 modes spans the truth, both errors are the noise of
            // this one image. Twenty modes more raise it by 4 % here (√(122/102) at most), and
            // those with a prior by as much in a bad draw.
            assert!(mine <= 1.15 * golden, "{name}: {mine} against {golden}");
        }
    }
}
