//! Wavelengths of a model of a filter with a width.
//!
//! The wavelength of the model is the mean of the photons, which `image.wavelength_nm` is for a
//! flat filter: pistons that differ by it look alike in a band, and one wavelength at the mean has
//! no error of the first order in the filter's width.

use crate::imaging::Colour;
use crate::scene::{Optimizer, System};
use crate::telescope::{Diversity, Filter, Telescope};
use crate::{Error, Result};

/// Most wavelengths where the scene does not name their number: enough for a band of 30 % behind
/// the paper's defocus.
const MAX_WAVELENGTHS: usize = 15;

/// Light of a model.
pub(in crate::modal) struct ModelLight {
    /// Mean wavelength of the photons over `image.wavelength_nm`: the wavelength of the model.
    pub(in crate::modal) mean: f64,
    /// The wavelengths, relative to the mean.
    pub(in crate::modal) colours: Vec<Colour>,
}

/// The light of the model of `scene`.
///
/// # Errors
/// [`Error::Scene`] for several wavelengths of a filter without width; those of [`Filter::new`].
pub(in crate::modal) fn light(scene: &System, telescope: &Telescope, diversity: &Diversity) -> Result<ModelLight> {
    let filter = Filter::new(scene)?;
    let count = match scene.estimate.wavelengths {
        Some(count) if count > 1 && filter.is_monochromatic() => {
            return Err(Error::Scene(format!(
                "estimate.wavelengths = {count} needs a filter with a width, and image.bandwidth_fraction is 0; leave one of \
                 them out"
            )));
        }
        Some(count) => count,
        // The paper's recipes have one wavelength.
        None if scene.estimate.optimizer != Optimizer::GaussNewton => 1,
        None => filter.wavelengths_needed(scene, telescope, diversity).min(MAX_WAVELENGTHS),
    };
    let mean = filter.mean()?;
    if count == 1 {
        return Ok(ModelLight { mean, colours: vec![Colour::MONOCHROMATIC] });
    }
    let wavelengths = filter.wavelengths(count)?.into_iter();
    Ok(ModelLight { mean, colours: wavelengths.map(|(ratio, share)| Colour { ratio: ratio / mean, share }).collect() })
}

/// Wavelengths that are enough for a filter half as wide again as that of `scene`.
///
/// # Errors
/// Those of building the telescope.
pub(in crate::modal) fn enough_beyond(scene: &System) -> Result<usize> {
    let telescope = Telescope::new(scene)?;
    let needed = Filter::new(scene)?.wavelengths_needed(scene, &telescope, &Diversity::new(scene, &telescope)?);
    Ok((needed + needed.div_ceil(2)).min(MAX_WAVELENGTHS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn number_of_wavelengths_comes_from_the_scene_or_its_filter() {
        let with = |settings: &[(&str, &str)]| {
            let scene = Scene::preset("keck-artificial").unwrap().with(settings).unwrap();
            let telescope = Telescope::new(&scene).unwrap();
            light(&scene, &telescope, &Diversity::new(&scene, &telescope).unwrap()).map(|light| light.colours)
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
