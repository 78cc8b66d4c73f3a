//! Effects that the plan does not model, and effects that it models although this scene may not
//! need them, each with its cost.

use super::price::Price;
use super::trial::{Trials, recipe};
use crate::Result;
use crate::control::Control;
use crate::modal::ModalFitter;
use crate::scene::{Sections, System};
use crate::telescope::Filter;

/// An effect that a model may leave out.
#[derive(Debug, Clone)]
pub struct Omission {
    /// Name of the channel; `None` for a scene without channels.
    pub channel: Option<String>,
    /// The effect.
    pub what: &'static str,
    /// Whether the plan models it.
    pub modelled: bool,
    /// Error of the plan's model with it, nm.
    pub with_nm: f64,
    /// Error without it, nm.
    pub without_nm: f64,
    /// Why it is or is not modelled, as a sentence.
    pub because: String,
}

/// Computes the cost of what `planned` models or leaves out, on the wavefronts of `trials`.
pub(super) fn omissions(
    asked: &System,
    planned: &System,
    like: &ModalFitter,
    chosen: Price,
    trials: &Trials,
    control: &Control,
) -> Result<Vec<Omission>> {
    let mut omissions = Vec::new();
    let own = chosen.error_nm();
    let filter = Filter::new(asked)?;
    if !filter.is_monochromatic() {
        // The images have the filter's width; the plan may model it or not, and the other choice is
        // tried here.
        let modelled = !like.model().optics.has_one_wavelength();
        let other = planned.with(|sections| sections.estimate.wavelengths = modelled.then_some(1))?;
        let model = like.variant(&other, recipe(&other))?;
        let other_nm = trials.price(&model, control)?.error_nm();
        let [with_nm, without_nm] = if modelled { [own, other_nm] } else { [other_nm, own] };
        let broad = if modelled { like.model() } else { model.model() };
        let times = broad.optics.parts().colours.len();
        let because =
            format!("the filter of {} takes {times} wavelengths, and {times} times the time", percent(asked, &filter));
        omissions.push(Omission {
            channel: None,
            what: "bandwidth of the filter",
            modelled,
            with_nm,
            without_nm,
            because,
        });
    }
    let mut alternative = |what, without: fn(&mut Sections), because: String| -> Result<()> {
        let scene = planned.with(without)?;
        let price = trials.price(&like.variant(&scene, recipe(&scene))?, control)?;
        omissions.push(Omission {
            channel: None,
            what,
            modelled: true,
            with_nm: own,
            without_nm: price.error_nm(),
            because,
        });
        Ok(())
    };
    if like.recipe().fit_background {
        let background_e = asked.image.background_e;
        let because = format!("it costs no time; the scene's background is {background_e} e a pixel");
        alternative("background of the image", |sections| sections.estimate.fit_background = Some(false), because)?;
    }
    if like.recipe().fit_flux {
        let because = "it costs no time; without it the flux is the sum of the pixels that are compared".into();
        alternative("flux of the star", |sections| sections.estimate.fit_flux = Some(false), because)?;
    }
    Ok(omissions)
}

/// Width of the filter of `scene`, for a message: that of a curve is measured and has no round
/// value.
fn percent(scene: &System, filter: &Filter) -> String {
    if scene.image.filter_file.is_some() {
        format!("{:.1} %", 100.0 * filter.width())
    } else {
        format!("{} %", 100.0 * scene.image.bandwidth_fraction)
    }
}
