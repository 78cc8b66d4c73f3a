//! Memory of an estimate, by a formula, and the tiles into which its work is divided to stay within
//! a limit.
//!
//! With n pupil samples and m pixels a side, M modes of which D fill the pupil, L illuminated
//! samples with E segment weights, C wavelengths, T threads and I images, in bytes and with S = 8
//! for a number:
//!
//! ```text
//! model     S·(D·n² + C·(3·D·L + 9·n² + 12·E + 24·L + 2·n·m)) + 2²⁶
//! threads   T·S·(C·(21·n² + 17·m² + 10·k² + 4·n·m + 40·L) + 8·frame),  k = max(n, m + 2)
//! matrices  S·M²·(26 + 7·min(T, 4))
//! kept      I·S·(3·m² + 3·M)
//! ─────────
//! tiles     derivatives: twice 2·S·m·(M + 2) for each row of pixels, four at least
//!           images:      S·(7·m² + 70·M) for each that is fitted at once, one at least
//! ```
//!
//! All but `kept` and the images themselves, which are the caller's, stays within
//! `estimate.memory_gb`: the tiles share what the rest leaves. Tiles change the sums over pixels by
//! their rounding, and no bit of the fits. A device holds its share of `images` in its own memory.

use crate::machine;
use crate::modal::model::recipe::Recipe;
use crate::scene::{NcpaBasis, NollRange, System};
use crate::{Error, Result};

/// Memory of a fit of any size: libraries, and the fine pupil on which the moments of a geometric
/// one are computed.
pub(in crate::modal) const BASE_BYTES: usize = 64 << 20;
/// Bytes of a number.
pub(in crate::modal) const NUMBER: usize = size_of::<f64>();
/// Square matrices that a call with several images keeps: ten metrics, and eight images' Fisher
/// matrix and covariance.
pub(in crate::modal) const KEPT_MATRICES: usize = 26;
/// Square matrices of one eigen-decomposition or inverse, its input and its result included.
pub(in crate::modal) const WORKING_MATRICES: usize = 7;
/// Most matrices that are decomposed at the same time, for any number of threads: their memory goes
/// as modes squared.
pub(in crate::modal) const MATRICES_AT_ONCE: usize = 4;

/// Memory of an estimate, bytes: upper bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Memory {
    /// The model, and what the threads share.
    pub model: usize,
    /// Memory of all threads together.
    pub threads: usize,
    /// Matrices of modes × modes.
    pub matrices: usize,
    /// Each image of the cube, without its frame.
    pub kept_image: usize,
    /// Derivatives at one row of pixels.
    pub derivative_row: usize,
    /// Number of rows of pixels.
    pub rows: usize,
    /// Each image that is fitted at the same time.
    pub fitted_image: usize,
}

/// Tiles: how much is worked on at once.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Tiles {
    /// Bytes of derivatives.
    pub derivative_bytes: usize,
    /// Images that are fitted in lock-step.
    pub images: usize,
}

impl Memory {
    /// The least with which a fit is possible, without `kept_image`.
    pub fn least_bytes(&self) -> usize {
        let tiles = 2 * MATRICES_AT_ONCE * self.derivative_row + self.fitted_image;
        [self.model, self.threads, self.matrices, tiles].into_iter().fold(0, usize::saturating_add)
    }

    /// The most that an estimate from `images` images takes within `limit` bytes; less than the
    /// limit where it needs no tiles.
    pub fn most_bytes(&self, images: usize, limit: usize) -> usize {
        let tiles = self.tiles(limit);
        let derivatives = 2 * tiles.derivative_bytes.min(self.rows * self.derivative_row);
        let fitted = images.min(tiles.images).saturating_mul(self.fitted_image);
        let kept = images.saturating_mul(self.kept_image);
        [self.model, self.threads, self.matrices, derivatives, fitted, kept].into_iter().fold(0, usize::saturating_add)
    }

    /// The tiles within `limit` bytes: half of what is left is for the images, a quarter for the
    /// metrics' derivatives, a quarter for those of the Fisher matrices.
    pub fn tiles(&self, limit: usize) -> Tiles {
        let spare = limit.saturating_sub(self.least_bytes());
        Tiles {
            derivative_bytes: MATRICES_AT_ONCE * self.derivative_row + spare / 4,
            images: 1 + spare / 2 / self.fitted_image,
        }
    }

    /// # Errors
    /// [`Error::Scene`] where not even the smallest tiles fit.
    pub(in crate::modal) fn check(&self, limit: usize) -> Result<()> {
        let least = self.least_bytes();
        if least <= limit { Ok(()) } else { Err(refusal("a fit of this scene", least, limit)) }
    }
}

/// `estimate.memory_gb` in bytes.
pub(in crate::modal) fn limit_bytes(scene: &System) -> usize {
    (scene.estimate.memory_gb * 1e9) as usize
}

/// Refuses a basis whose maps alone exceed the limit, before it is built.
///
/// # Errors
/// [`Error::Scene`].
pub(in crate::modal) fn check_maps(scene: &System, recipe: &Recipe) -> Result<()> {
    let own = match scene.modes.ncpa {
        NcpaBasis::Kl | NcpaBasis::Zernike => scene.modes.ncpa_count,
        // The number of a file's modes is not known yet: they are checked with the rest.
        NcpaBasis::None | NcpaBasis::File(_) => 0,
    };
    let count = |zernikes: NollRange| match zernikes {
        NollRange::Span { first, last } => last + 1 - first,
        NollRange::None => 0,
    };
    let added = count(recipe.exact_zernikes) + count(recipe.prior_zernikes);
    // The maps, and the values at the illuminated samples from which they are computed.
    let bytes = 2 * NUMBER * (own + added) * scene.pupil.samples.pow(2);
    let limit = limit_bytes(scene);
    let what = "the maps of this scene's modes";
    if bytes > limit {
        return Err(refusal(what, bytes, limit));
    }
    machine::check_memory(what, bytes as u64, "take fewer pupil.samples or modes.ncpa_count")
}

fn refusal(what: &str, wanted: usize, limit: usize) -> Error {
    Error::Scene(format!(
        "{what} would take {wanted} bytes of memory, where estimate.memory_gb allows {limit}: allow {} or more, or take \
         fewer samples, modes or pixels",
        (wanted as f64 / 1e8).ceil() / 10.0
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    const MEMORY: Memory = Memory {
        model: 1000,
        threads: 200,
        matrices: 300,
        kept_image: 10,
        derivative_row: 40,
        rows: 50,
        fitted_image: 100,
    };

    #[test]
    fn tiles_fill_the_limit_and_never_more() {
        assert_eq!(MEMORY.least_bytes(), 1920);
        assert_eq!(MEMORY.tiles(0), Tiles { derivative_bytes: 160, images: 1 });
        for limit in [1920, 2017, 5000, 100_000] {
            // For any number of images: what each adds is not part of the limit.
            for images in [1, 7, 4096] {
                let most = MEMORY.most_bytes(images, limit);
                assert!(most <= limit + images * MEMORY.kept_image, "{most} of {limit}");
            }
        }
        // No tile is larger than the whole.
        assert_eq!(MEMORY.most_bytes(3, usize::MAX), 1500 + 2 * 50 * 40 + 3 * 100 + 3 * 10);
    }

    #[test]
    fn a_limit_below_the_least_is_refused_in_bytes() {
        assert!(MEMORY.check(1920).is_ok());
        let sentence = MEMORY.check(1919).unwrap_err().to_string();
        assert!(sentence.contains("1920 bytes") && sentence.contains("allows 1919"), "{sentence}");
    }

    #[test]
    fn a_basis_that_memory_cannot_hold_is_refused_before_it_is_made() {
        let scene = Scene::preset("keck-artificial").unwrap();
        assert!(check_maps(&scene, &Recipe::with_prior(&scene)).is_ok());
        let many = scene
            .with(&[("modes.ncpa_count", "10000"), ("pupil.samples", "2048"), ("aberrations.truth_samples", "2048")])
            .unwrap();
        let sentence = crate::modal::ModalFitter::new(&many, false).err().unwrap().to_string();
        assert!(sentence.contains("672430817280 bytes") && sentence.contains("allows 8000000000"), "{sentence}");
    }
}
