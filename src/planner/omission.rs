//! What is there and not modelled, and what is modelled though this scene may not need it: each with its price.

use super::Price;
use super::trial::Trials;
use crate::Result;
use crate::estimate::{Estimator, Recipe};
use crate::optimize::CancelFlag;
use crate::scene::Scene;

/// Something that a model may leave out.
#[derive(Debug, Clone)]
pub struct Omission {
    /// What it is.
    pub what: &'static str,
    /// Whether the plan models it.
    pub modelled: bool,
    /// Error of the plan's model with it, nm.
    pub with_nm: f64,
    /// Error without it, nm.
    pub without_nm: f64,
    /// Why it is or is not there, in a sentence.
    pub because: String,
}

/// Prices what `planned` leaves out, on the wavefronts of `trials`.
pub(super) fn omissions(
    asked: &Scene,
    planned: &Scene,
    like: &Estimator,
    chosen: Price,
    trials: &Trials,
    cancel: Option<&CancelFlag>,
) -> Result<Vec<Omission>> {
    let mut omissions = Vec::new();
    let own = chosen.error_nm();
    let width = asked.image.bandwidth_fraction;
    if width > 0.0 {
        // The images of the plan have the filter's width; the model never does. Without it the same model is priced on
        // images of one wavelength.
        let narrow = planned.with_override("image.bandwidth_fraction", "0")?;
        let one_wavelength =
            Trials::of(&narrow, cancel)?.price(&like.variant(&narrow, Recipe::of(&narrow))?, cancel)?;
        omissions.push(Omission {
            what: "bandwidth of the filter",
            modelled: false,
            with_nm: one_wavelength.error_nm(),
            without_nm: own,
            because: format!("the model has one wavelength, the images have a filter of {} %", 100.0 * width),
        });
    }
    let mut alternative = |what, key, value: &str, because: String| -> Result<()> {
        let scene = planned.with_override(key, value)?;
        let price = trials.price(&like.variant(&scene, Recipe::of(&scene))?, cancel)?;
        omissions.push(Omission { what, modelled: true, with_nm: own, without_nm: price.error_nm(), because });
        Ok(())
    };
    if like.recipe().fit_background {
        let background_e = asked.image.background_e;
        let because = format!("it costs no time; the scene's background is {background_e} e a pixel");
        alternative("background of the image", "estimate.fit_background", "false", because)?;
    }
    if like.recipe().fit_flux {
        let because = "it costs no time; without it the flux is the sum of the pixels that are compared".into();
        alternative("flux of the star", "estimate.fit_flux", "false", because)?;
    }
    Ok(omissions)
}
