//! Identity of an estimate: a hash of all that its fits depend on, by which parts of another one
//! are refused.

use crate::io::file_of;
use crate::pipeline::channels::ChannelImages;
use crate::pipeline::policy::Policy;
use crate::pipeline::scene_files::check_file;
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::Array3;
use std::io::Read;
use std::path::Path;
use twox_hash::xxhash3_128::Hasher;

/// Values that are hashed at once: a call for every eight bytes takes longer than the hash itself.
const VALUES_AT_ONCE: usize = 512;
/// Bytes of a file that are read at once.
const BYTES_AT_ONCE: usize = 1 << 20;

/// XXH3 in 128 bits of the version, the policy, the scene with its files, and scene and images of
/// each channel. It distinguishes estimates; it is no protection against someone who constructs two
/// with one hash.
///
/// # Errors
/// [`Error::File`] for a file that is there and cannot be read.
pub(super) fn identity(policy: &Policy, scene: &Scene, channels: &[ChannelImages]) -> Result<u128> {
    let mut hasher = Hasher::new();
    bytes(&mut hasher, env!("CARGO_PKG_VERSION").as_bytes());
    bytes(&mut hasher, format!("{policy:?}").as_bytes());
    bytes(&mut hasher, scene.text().as_bytes());
    for (key, path) in scene.files() {
        let path = file_of(path);
        // An estimate needs not all of them.
        if path.exists() {
            bytes(&mut hasher, key.as_bytes());
            content(&mut hasher, &path)?;
        }
    }
    for ChannelImages { scene, images, .. } in channels {
        bytes(&mut hasher, scene.text().as_bytes());
        bytes(&mut hasher, &images.read_noise_e.unwrap_or(-1.0).to_le_bytes());
        cube(&mut hasher, &images.images_e, |electrons| electrons.to_le_bytes());
        cube(&mut hasher, &images.bad, |is_bad| [u8::from(is_bad)]);
    }
    Ok(hasher.finish_128())
}

/// Adds the content of a file, after its length.
fn content(hasher: &mut Hasher, path: &Path) -> Result<()> {
    let failed = |error: std::io::Error| Error::file(path, error);
    let length = check_file(path)?;
    hasher.write(&length.to_le_bytes());
    // Not beyond the length that was accepted, where the file grows.
    let mut file = std::fs::File::open(path).map_err(failed)?.take(length);
    let mut buffer = vec![0; BYTES_AT_ONCE];
    loop {
        match file.read(&mut buffer).map_err(failed)? {
            0 => return Ok(()),
            count => hasher.write(&buffer[..count]),
        }
    }
}

/// Adds some bytes, after their number: "ab", "c" and "a", "bc" differ.
fn bytes(hasher: &mut Hasher, bytes: &[u8]) {
    hasher.write(&(bytes.len() as u64).to_le_bytes());
    hasher.write(bytes);
}

/// Adds the shape of a cube and its values.
fn cube<T: Copy, const N: usize>(hasher: &mut Hasher, cube: &Array3<T>, bytes_of: impl Fn(T) -> [u8; N]) {
    bytes(hasher, format!("{:?}", cube.dim()).as_bytes());
    let cube = cube.as_standard_layout();
    let mut buffer = [[0; N]; VALUES_AT_ONCE];
    for values in cube.as_slice().unwrap_or_default().chunks(VALUES_AT_ONCE) {
        let buffer = &mut buffer[..values.len()];
        buffer.iter_mut().zip(values).for_each(|(bytes, value)| *bytes = bytes_of(*value));
        hasher.write(buffer.as_flattened());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modal::ModelCache;
    use crate::pipeline::consistency::Electrons;
    use std::borrow::Cow;

    #[test]
    fn identities_tell_estimates_apart() {
        let pupil = tempfile::NamedTempFile::new().unwrap();
        let scene = Scene::preset("keck-artificial").unwrap();
        let name = format!("\"{}\"", pupil.path().display());
        let with_file = scene.with_override("image.filter_file", &name).unwrap();
        let images_e = Array3::from_shape_fn((2, 30, 20), |(i, y, x)| (i + 20 * y + x) as f64);
        let bad = images_e.mapv(|_| false);
        let of = |scene: &Scene, images_e: &Array3<f64>, bad: &Array3<bool>, read_noise_e| {
            let (images_e, bad) = (Cow::Borrowed(images_e), Cow::Borrowed(bad));
            let images = Electrons { images_e, bad, read_noise_e, slopes_mas: None, moved_reference_mas: None };
            let channel = ChannelImages { name: None, scene: scene.clone(), images, cache: ModelCache::default() };
            identity(&Policy::default(), scene, &[channel]).unwrap()
        };
        let (mut negated, mut marked) = (images_e.clone(), bad.clone());
        // Only the sign bit changes.
        negated[[1, 29, 19]] *= -1.0;
        marked[[0, 5, 3]] = true;
        let wide = images_e.clone().into_shape_with_order((2, 20, 30)).unwrap();
        let mut all = vec![
            of(&scene, &images_e, &bad, None),
            of(&scene, &negated, &bad, None),
            of(&scene, &images_e, &marked, None),
            of(&scene, &wide, &bad, None),
            of(&scene, &images_e, &bad, Some(1.0)),
            identity(&Policy::realtime(), &scene, &[]).unwrap(),
            of(&with_file, &images_e, &bad, None),
        ];
        std::fs::write(pupil.path(), "another content").unwrap();
        all.push(of(&with_file, &images_e, &bad, None));
        assert!((0..all.len()).all(|i| all[..i].iter().all(|other| *other != all[i])), "{all:x?}");
        // The order of the numbers in memory has no effect.
        let mut turned = Array3::zeros((20, 30, 2)).reversed_axes();
        turned.assign(&images_e);
        assert!(!turned.is_standard_layout() && of(&scene, &turned, &bad, None) == all[0]);
    }
}
