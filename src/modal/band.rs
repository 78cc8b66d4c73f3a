//! Wavelengths of a model of a filter with a width.

use crate::imaging::Colour;
use crate::scene::{Optimizer, Scene};
use crate::telescope::{Diversity, Telescope, band, wavelengths_needed};
use crate::{Error, Result};

/// Most wavelengths where the scene does not name their number: enough for a band of 30 % behind the paper's defocus.
const MAX_WAVELENGTHS: usize = 15;

/// The wavelengths of the model of `scene`.
///
/// # Errors
/// [`Error::Scene`] for several wavelengths of a filter without width.
pub(super) fn colours(scene: &Scene, telescope: &Telescope, diversity: &Diversity) -> Result<Vec<Colour>> {
    let width = scene.image.bandwidth_fraction;
    let count = match scene.estimate.wavelengths {
        Some(count) if count > 1 && width == 0.0 => {
            return Err(Error::Scene(format!(
                "estimate.wavelengths = {count} needs a filter with a width, and image.bandwidth_fraction is 0; leave one of \
                 them out"
            )));
        }
        Some(count) => count,
        // The paper's recipes have one wavelength.
        None if scene.estimate.optimizer != Optimizer::GaussNewton => 1,
        None => wavelengths_needed(scene, telescope, diversity).min(MAX_WAVELENGTHS),
    };
    if count == 1 {
        return Ok(vec![Colour::MONOCHROMATIC]);
    }
    Ok(band(width, count).into_iter().map(|(ratio, share)| Colour { ratio, share }).collect())
}

/// Wavelengths that are enough for a filter half as wide again as that of `scene`.
///
/// # Errors
/// Those of building the telescope.
pub(super) fn enough_beyond(scene: &Scene) -> Result<usize> {
    let telescope = Telescope::new(scene)?;
    let needed = wavelengths_needed(scene, &telescope, &Diversity::new(scene, &telescope)?);
    Ok((needed + needed.div_ceil(2)).min(MAX_WAVELENGTHS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_wavelengths_comes_from_the_scene_or_from_its_filter() {
        let with = |settings: &[(&str, &str)]| {
            let scene = Scene::preset("keck-artificial").unwrap().with(settings).unwrap();
            let telescope = Telescope::new(&scene).unwrap();
            colours(&scene, &telescope, &Diversity::new(&scene, &telescope).unwrap())
        };
        assert_eq!(with(&[]).unwrap(), [Colour::MONOCHROMATIC]);
        assert_eq!(with(&[("image.bandwidth_fraction", "0.5")]).unwrap().len(), MAX_WAVELENGTHS);
        let broad = ("image.bandwidth_fraction", "0.1");
        assert_eq!(with(&[broad, ("estimate.wavelengths", "1")]).unwrap(), [Colour::MONOCHROMATIC]);
        let named = with(&[broad, ("estimate.wavelengths", "2")]).unwrap();
        assert!((named[0].ratio - (1.0 - 0.05 / 3f64.sqrt())).abs() < 1e-12 && named[0].share == named[1].share);
        let sentence = with(&[("estimate.wavelengths", "3")]).unwrap_err().to_string();
        assert!(sentence.contains("image.bandwidth_fraction"), "{sentence}");
    }
}
