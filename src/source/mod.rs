//! The artificial source of the paper's section 3: images of a point source with known aberrations and honest noise.
//!
//! The truth is made on a finer grid than any estimator's, with the exact share of each segment in each sample, so that
//! nothing an estimator gets wrong is wrong here in the same way.

mod camera;
pub(crate) mod file;
mod pixels;
mod truth;

pub use camera::{Camera, expose, flux_e};
pub use file::write;
pub(crate) use pixels::Pixels;
pub use truth::Truth;

use crate::scene::Scene;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::Array3;
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;

/// Simulated images with the truth behind them.
pub struct SourceImages {
    /// Electrons, `[image, y, x]`.
    pub images_e: Array3<f64>,
    /// Electrons of the star in each image.
    pub flux_e: f64,
    /// The aberrations.
    pub truth: Truth,
}

/// Makes the images of `scene`: one draw of aberrations, `image.count` draws of noise. The same scene gives the same
/// bits.
///
/// # Errors
/// Those of building the telescope, and [`Error::File`] for a map that cannot be read; [`Error::Scene`] for aberrations that
/// drift, for these images have no time.
pub fn images(scene: &Scene) -> Result<SourceImages> {
    if let Some(aberrations) = scene.aberrations.as_ref().filter(|aberrations| aberrations.drift_nm_per_min > 0.0) {
        return Err(Error::Scene(format!(
            "{}: aberrations.drift_nm_per_min = {} has no meaning for images without a loop; 0 is accepted",
            scene.name(),
            aberrations.drift_nm_per_min
        )));
    }
    let telescope = Telescope::of(scene)?;
    let seed = scene.aberrations.as_ref().map_or(1, |aberrations| aberrations.seed);
    let truth = Truth::draw(scene, &telescope, &mut stream(seed, 0))?;
    let camera = Camera::of(scene, &telescope)?;
    let psf = camera.psf(&truth)?;
    let flux_e = flux_e(&scene.image, psf.iter().copied().fold(0.0, f64::max));
    let (rows, columns) = psf.dim();
    let mut images_e = Array3::zeros((scene.image.count, rows, columns));
    for (image, mut out) in images_e.outer_iter_mut().enumerate() {
        let mut rng = stream(seed, 1 + image as u64);
        out.zip_mut_with(&psf, |out, &h| *out = expose(&scene.image, h, flux_e, &mut rng));
    }
    Ok(SourceImages { images_e, flux_e, truth })
}

/// Random numbers of the seed `aberrations.seed`: stream 0 draws the aberrations ([`Truth::draw`]), stream 1 + i the noise of
/// image i. The streams are independent.
pub fn stream(seed: u64, number: u64) -> ChaCha12Rng {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    rng.set_stream(number);
    rng
}
