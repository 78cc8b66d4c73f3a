//! The library in a page: make an image of an artificial source, read the wavefront back, compare with the truth.
//!
//! `cargo run --release --example one_image`

use cophase::Result;
use cophase::estimate::{self, Cube, Estimator};
use cophase::imaging::{Chain, Precision};
use cophase::metrics;
use cophase::scene::Scene;
use cophase::source;

fn main() -> Result<()> {
    // A scene is TOML text; this one is built in. Any key can be overridden.
    let scene = Scene::preset("keck-artificial")?.with(&[("aberrations.seed", "3")])?;
    let made = source::images(&scene)?;

    // Your own images would come from `cophase::io::read_images`.
    let bad = made.images_e.mapv(|_| false);
    let cube = Cube { images_e: made.images_e.view(), bad: bad.view(), read_noise_e: None };
    let mut open = |estimator: &Estimator| Ok(Chain::cpu(estimator.model().optics.clone(), Precision::F64));
    let (estimator, found) = estimate::read(&scene, cube, &mut open, None, &mut |_done, _all| {})?;

    println!("reduced chi-square {:.2}, {} evaluations", found.reduced_chi2(), found.images[0].evaluations);
    for (name, (nm, sigma)) in estimator
        .model()
        .basis
        .names()
        .iter()
        .zip(found.combined.coefficients_nm.iter().zip(found.combined.sigma_nm()))
        .take(6)
    {
        println!("{name}: {nm:8.2} ± {sigma:.2} nm");
    }

    let pupil = &estimator.model().telescope.pupil;
    for (name, map, truth) in
        [("phasing", &found.phasing_nm, &made.truth.phasing_nm), ("NCPA", &found.ncpa_nm, &made.truth.ncpa_nm)]
    {
        let residual_nm = metrics::residual_nm(pupil, map.view(), truth.view())?;
        println!("{name}: residual {residual_nm:.3} nm RMS, tip and tilt removed");
    }
    Ok(())
}
