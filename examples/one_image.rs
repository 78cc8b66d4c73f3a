//! The library in a page: images of an artificial source, the wavefront behind them, the residual
//! against the truth.
//!
//! `cargo run --release --example one_image`

use cophase::{Estimator, Images, Result, Scene};

fn main() -> Result<()> {
    // A scene is TOML text; this one is built in. Any key can be overridden.
    let scene = Scene::preset("keck-artificial")?.with(&[("aberrations.seed", "3")])?;
    // Your own images: Images::read("images.fits", None)?, or Images::new(array) in electrons.
    let images = Images::simulated(&scene)?;

    let estimate = Estimator::new(&scene)?.estimate(&images)?;
    println!("{}", estimate.report());

    let values = estimate.modes.coefficients_nm.iter().zip(estimate.modes.sigma_nm());
    for (name, (nm, sigma_nm)) in estimate.basis.names.iter().zip(values).take(6) {
        println!("{name}: {nm:8.2} ± {sigma_nm:.2} nm");
    }
    estimate.write(std::env::temp_dir().join("one_image.fits"))
}
