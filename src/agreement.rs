//! What the cards of an image file state against what a scene says: which keys are compared, and
//! with which cards.
//!
//! An estimate and a reduction read this one list, so that no reduction makes images of frames that
//! an estimate then refuses.

pub(crate) mod padded_counts;
pub(crate) mod wrapped;

use crate::io::{HeaderFact, Quantity};
use crate::scene::{Method, Scene};

/// Key of the gain.
pub(crate) const GAIN: &str = "image.gain_e_per_adu";

/// Value of a scene with which cards are compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Compared {
    pub(crate) quantity: Quantity,
    /// Key that gives the value, which is another quantity for the pixel on the sky.
    pub(crate) key: &'static str,
    /// Value in the unit of the quantity.
    pub(crate) value: f64,
    /// Value of the key.
    key_value: f64,
}

/// A card that states another value.
pub(crate) struct Disagreement {
    /// The card, with what it states.
    pub(crate) card: String,
    /// The value nearest to the scene's among those that the card may mean, in the unit of the
    /// quantity.
    pub(crate) stated: f64,
}

impl Compared {
    /// What `scene` says of `quantity`; `None` where an estimate does not read it, or the scene
    /// leaves it to the file.
    pub(crate) fn new(scene: &Scene, quantity: Quantity) -> Option<Self> {
        let image = &scene.image;
        // A modal estimate fits the background, and does not read the exposure.
        let is_full_phase = scene.estimate.method != Method::Modal;
        let of = |key: &'static str, value: f64| Some(Self { quantity, key, value, key_value: value });
        match quantity {
            Quantity::WavelengthNm | Quantity::BandNm => of("image.wavelength_nm", image.wavelength_nm),
            Quantity::PixelMas => {
                let key_value = image.samples_per_lambda_over_d;
                scene.pixel_mas().map(|value| Self {
                    quantity,
                    key: "image.samples_per_lambda_over_d",
                    value,
                    key_value,
                })
            }
            Quantity::ReadNoiseE => image.read_noise_e.and_then(|read_noise_e| of("image.read_noise_e", read_noise_e)),
            Quantity::ExposureS if is_full_phase && scene.names("image.exposure_s") => {
                of("image.exposure_s", image.exposure_s)
            }
            Quantity::BackgroundE if is_full_phase && scene.names("image.background_e") => {
                of("image.background_e", image.background_e)
            }
            Quantity::ExposureS | Quantity::BackgroundE => None,
            Quantity::GainEPerAdu => image.gain_e_per_adu.and_then(|gain| of(GAIN, gain)),
        }
    }

    /// The first of the cards of this quantity where none agrees: of several, such as a central and
    /// an effective wavelength, one is enough.
    pub(crate) fn disagreement(&self, facts: &[HeaderFact]) -> Option<Disagreement> {
        let of_it = || facts.iter().filter(|fact| fact.quantity == self.quantity);
        let first = of_it().next().filter(|_| !of_it().any(|fact| fact.agrees(self.value)))?;
        let distance = |stated: f64| (stated / self.value).ln().abs();
        let stated = first.values.iter().copied().min_by(|a, b| distance(*a).total_cmp(&distance(*b)))?;
        let shown = match self.quantity {
            Quantity::PixelMas => format!(" ({stated:.3} mas, not {:.3})", self.value),
            Quantity::BandNm => {
                let least_over_centre = 1.0 - first.tolerance;
                format!(" ({:.0} to {:.0} nm)", stated * least_over_centre, stated / least_over_centre)
            }
            _ => String::new(),
        };
        Some(Disagreement { card: format!("card {} = {}{shown}", first.keyword, first.written), stated })
    }

    /// Value of the key for a value of the quantity. The pixel on the sky is λ/`grid_m` over the
    /// sampling, so the sampling is as much larger as the pixel is smaller.
    pub(crate) fn of_key(&self, value: f64) -> f64 {
        match self.quantity {
            Quantity::PixelMas if value != self.value => self.key_value * (self.value / value),
            Quantity::PixelMas => self.key_value,
            _ => value,
        }
    }
}
