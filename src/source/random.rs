//! Independent streams of random numbers.

use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;

/// Random numbers of the stream `number` under `seed`: stream 0 draws the aberrations, the others
/// the noise of each image.
pub fn stream(seed: u64, number: u64) -> ChaCha12Rng {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    rng.set_stream(number);
    rng
}
