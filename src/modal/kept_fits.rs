//! Kept fits: fits of single images that were made before, in this process or in another, found by what goes into them.
//!
//! The key of a fit is a hash of everything that its result depends on: the model and the recipe, the precision and the kind of
//! chain, the frame with its bad pixels and read noise, and the start. A fit that is found is therefore equal, bit for bit, to the one that
//! would be made here; a fit that is not found is made. So the processes that fit parts of an estimate need not know which fits the
//! whole estimate needs.

use super::chi2::ReducedChi2;
use super::cube::has_true;
use super::engine::{FitState, ImageFit};
use super::minimum::Minimum;
use crate::optimize::StopReason;
use ndarray::ArrayView2;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use twox_hash::xxhash3_128::Hasher;

/// Numbers that are hashed at once.
const NUMBERS_AT_ONCE: usize = 512;

/// XXH3 in 128 bits, of numbers, texts and images one after the other. It distinguishes fits; it is no protection against someone who
/// constructs two with one hash. In a box, because its hundreds of bytes are moved with each word.
#[derive(Clone)]
pub(crate) struct Hash(Box<Hasher>);

impl Hash {
    pub(crate) fn new() -> Self {
        Self(Box::new(Hasher::new()))
    }

    fn word(mut self, word: u64) -> Self {
        self.0.write(&word.to_le_bytes());
        self
    }

    pub(crate) fn text(self, text: &str) -> Self {
        let mut hash = self.word(text.len() as u64);
        hash.0.write(text.as_bytes());
        hash
    }

    /// Each as the word of its bits. They are hashed many at a time: a call for every eight bytes takes longer than the hash itself.
    pub(crate) fn numbers(mut self, numbers: &[f64]) -> Self {
        let mut bytes = [[0; 8]; NUMBERS_AT_ONCE];
        for some in numbers.chunks(NUMBERS_AT_ONCE) {
            let bytes = &mut bytes[..some.len()];
            bytes.iter_mut().zip(some).for_each(|(bytes, number)| *bytes = number.to_bits().to_le_bytes());
            self.0.write(bytes.as_flattened());
        }
        self
    }

    /// An image and its bad pixels.
    pub(crate) fn frame(self, data_e: ArrayView2<f64>, bad: ArrayView2<bool>) -> Self {
        let (rows, columns) = data_e.dim();
        let mut hash = self.word(rows as u64).word(columns as u64);
        for row in data_e.rows() {
            hash = match row.as_slice() {
                Some(row) => hash.numbers(row),
                None => hash.numbers(&row.to_vec()),
            };
        }
        if has_true(bad) {
            let places = bad.iter().enumerate().filter(|(_, bad)| **bad).map(|(place, _)| place as u64);
            hash = places.fold(hash, Self::word);
        }
        hash.word(u64::MAX)
    }

    pub(crate) fn value(&self) -> u128 {
        self.0.finish_128()
    }
}

/// Result of the fit of one image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct KeptFit {
    /// Coefficients, nm.
    pub(crate) coefficients_nm: Vec<f64>,
    /// Weight of each pixel after the last renewal, e⁻².
    pub(crate) weights: Vec<f64>,
    pub(crate) evaluations: usize,
    pub(crate) reason: StopReason,
    /// Flux and background, e⁻, and of χ² its value, least expectation, scatter, square of the S/N and degrees of freedom.
    pub(crate) numbers: [f64; 7],
}

impl KeptFit {
    fn of(fit: &ImageFit) -> Self {
        let Minimum { coefficients_nm, flux_e, background_e, evaluations, reason, chi2, .. } = &fit.minimum;
        let ReducedChi2 { value, least, scatter, square_snr, freedom } = *chi2;
        Self {
            coefficients_nm: coefficients_nm.clone(),
            weights: fit.prepared.exposure.weight.clone(),
            evaluations: *evaluations,
            reason: *reason,
            numbers: [*flux_e, *background_e, value, least, scatter, square_snr, freedom],
        }
    }

    /// Writes the result into `fit`, whose frame is prepared.
    pub(super) fn write(&self, fit: &mut ImageFit) {
        let [flux_e, background_e, value, least, scatter, square_snr, freedom] = self.numbers;
        fit.prepared.exposure.weight.copy_from_slice(&self.weights);
        fit.minimum = Minimum {
            coefficients_nm: self.coefficients_nm.clone(),
            flux_e,
            background_e,
            evaluations: self.evaluations,
            reason: self.reason,
            chi2: ReducedChi2 { value, least, scatter, square_snr, freedom },
            is_unconfirmed: false,
        };
        fit.state = FitState::Fitted;
    }
}

/// PSF of the reference chain at the end of a fit, by the hash of model and coefficients.
pub(crate) type KeptPsf = (u128, Arc<Vec<f64>>);

/// Fits by their keys. Those that a call uses or makes are [`KeptFits::used`] afterwards.
#[derive(Default)]
pub(crate) struct KeptFits {
    fits: Mutex<BTreeMap<u128, (Arc<KeptFit>, bool)>>,
    psfs: Mutex<BTreeMap<u128, Arc<Vec<f64>>>>,
    made: AtomicUsize,
}

impl KeptFits {
    /// A collection that begins with `fits` and `psfs`.
    pub(crate) fn new(
        fits: impl IntoIterator<Item = (u128, Arc<KeptFit>)>,
        psfs: impl IntoIterator<Item = KeptPsf>,
    ) -> Self {
        let fits = fits.into_iter().map(|(key, fit)| (key, (fit, false))).collect();
        Self { fits: Mutex::new(fits), psfs: Mutex::new(psfs.into_iter().collect()), made: AtomicUsize::new(0) }
    }

    /// The PSF with this key.
    pub(super) fn psf(&self, key: u128) -> Option<Arc<Vec<f64>>> {
        self.psfs.lock().unwrap_or_else(PoisonError::into_inner).get(&key).cloned()
    }

    /// Replaces all PSFs.
    pub(super) fn set_psfs(&self, psfs: impl IntoIterator<Item = KeptPsf>) {
        *self.psfs.lock().unwrap_or_else(PoisonError::into_inner) = psfs.into_iter().collect();
    }

    /// The PSFs, by ascending key.
    pub(crate) fn psfs(&self) -> Vec<KeptPsf> {
        let psfs = self.psfs.lock().unwrap_or_else(PoisonError::into_inner);
        psfs.iter().map(|(key, psf)| (*key, psf.clone())).collect()
    }

    /// The fits that were used or made, by ascending key.
    pub(crate) fn used(&self) -> Vec<(u128, Arc<KeptFit>)> {
        let fits = self.fits.lock().unwrap_or_else(PoisonError::into_inner);
        fits.iter().filter(|(_, (_, is_used))| *is_used).map(|(key, (fit, _))| (*key, fit.clone())).collect()
    }

    /// Number of fits that were not there and were made.
    pub(crate) fn made(&self) -> usize {
        self.made.load(Ordering::Relaxed)
    }

    /// The fit with this key, for a model of this size.
    pub(super) fn get(&self, key: u128, modes: usize, pixels: usize) -> Option<Arc<KeptFit>> {
        let mut fits = self.fits.lock().unwrap_or_else(PoisonError::into_inner);
        let (fit, is_used) = fits.get_mut(&key)?;
        if fit.coefficients_nm.len() != modes || fit.weights.len() != pixels {
            return None;
        }
        *is_used = true;
        Some(fit.clone())
    }

    pub(super) fn put(&self, key: u128, fit: &ImageFit) {
        let mut fits = self.fits.lock().unwrap_or_else(PoisonError::into_inner);
        fits.insert(key, (Arc::new(KeptFit::of(fit)), true));
        self.made.fetch_add(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    #[test]
    fn hash_differs_for_other_texts_numbers_and_bad_pixels() {
        let data_e = Array2::from_shape_fn((3, 4), |(y, x)| (y * 4 + x) as f64);
        let clean = Array2::from_elem((3, 4), false);
        let mut marked = clean.clone();
        marked[[1, 2]] = true;
        let mut negated = data_e.clone();
        // Only the sign bit changes.
        negated[[2, 3]] *= -1.0;
        let of = |data_e: &Array2<f64>, bad: &Array2<bool>| Hash::new().frame(data_e.view(), bad.view()).value();
        let all = [
            of(&data_e, &clean),
            of(&data_e, &marked),
            of(&negated, &clean),
            Hash::new().text("ab").text("c").value(),
            Hash::new().text("a").text("bc").value(),
            Hash::new().text("abc").value(),
        ];
        // Numbers are one stream, however many are hashed at once.
        let many: Vec<f64> = (0..NUMBERS_AT_ONCE + 3).map(|i| i as f64).collect();
        let words = many.iter().fold(Hash::new(), |hash, number| hash.word(number.to_bits()));
        assert_eq!(Hash::new().numbers(&many).value(), words.value());
        assert!((0..all.len()).all(|i| all[..i].iter().all(|other| *other != all[i])), "{all:x?}");
    }
}
