//! Policy: the choices of an estimate that are not part of the scene.

use crate::modal::{Recipe, Session};
use crate::scene::{Scene, System};
use crate::{Error, Result};

/// Choices of an estimate. Every interface follows [`Policy::default`] unless it is given another;
/// a [`Session`](crate::modal::Session), which has a deadline and may not allocate, follows
/// [`Policy::realtime`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// Whether the Zernikes of Noll indices 22 to 45 are fitted too, with a prior whose level
    /// follows from the images, so that the error bars include them; and whether
    /// `estimate.posterior` is followed. Where the scene names `modes.exact_zernikes`, those modes
    /// are all.
    pub prior_modes: bool,
    /// Whether images that are reduced for the fit are searched for outlier pixels (cosmic rays,
    /// hot and dead pixels) where the model does not explain them, and fitted again. What a fit
    /// itself rejects it always does.
    pub search_outliers: bool,
    /// Whether a fit that ended in a wrong minimum is restarted from a perturbed start, as often as
    /// `estimate.restarts` says (6 unless named).
    pub restart: bool,
    /// Whether the optical parameters that `estimate.fit_optics` names may be fitted. Where not, a
    /// scene that names some is an error.
    pub fit_optics: bool,
    /// Whether the model of the scene is extended where it does not explain the images and an
    /// extension does. Not where `estimate.model` is "scene".
    pub select_model: bool,
}

impl Default for Policy {
    fn default() -> Self {
        Self { prior_modes: true, search_outliers: true, restart: true, fit_optics: true, select_model: true }
    }
}

impl Policy {
    /// No retries: the time of a fit is bounded by its own evaluations.
    pub const fn realtime() -> Self {
        Self { prior_modes: false, search_outliers: false, restart: false, fit_optics: false, select_model: false }
    }

    /// The word in reports and files: `full`, `realtime`, or `custom`.
    pub fn name(&self) -> &'static str {
        match self {
            policy if *policy == Self::default() => "full",
            policy if *policy == Self::realtime() => "realtime",
            _ => "custom",
        }
    }

    /// The recipe of the fits.
    pub(super) fn recipe(&self, scene: &System) -> Recipe {
        let mut recipe = if self.prior_modes { Recipe::with_prior(scene) } else { Recipe::from_scene(scene) };
        recipe.search_outliers &= self.search_outliers;
        if !self.restart {
            recipe.restarts = 0;
        }
        recipe
    }

    /// # Errors
    /// [`Error::Scene`] for keys of `scene` that this policy does not honour.
    pub(super) fn check(&self, scene: &Scene) -> Result<()> {
        if !self.fit_optics && !scene.estimate.fit_optics.is_empty() {
            return Err(Error::Scene(format!(
                "estimate.fit_optics is not honoured by the policy \"{}\": leave it out, or use one that fits optics",
                self.name()
            )));
        }
        Ok(())
    }
}

impl Session {
    /// The policy that it follows: [`Policy::realtime`].
    pub fn policy(&self) -> Policy {
        Policy::realtime()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::NollRange;

    #[test]
    fn a_policy_sets_the_recipe() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let (full, realtime) = (Policy::default(), Policy::realtime());
        assert_eq!((full.name(), realtime.name()), ("full", "realtime"));
        assert_eq!(Policy { restart: false, ..full }.name(), "custom");
        let (whole, quick) = (full.recipe(&scene), realtime.recipe(&scene));
        assert!(whole.restarts == 6 && whole.search_outliers && whole.prior_zernikes != NollRange::None);
        assert!(quick.restarts == 0 && !quick.search_outliers && quick.prior_zernikes == NollRange::None);
        assert_eq!(quick.exact_zernikes, whole.exact_zernikes);
        // Modes that the scene names are all that are fitted.
        let named = scene.with(&[("modes.exact_zernikes", "[2, 21]")]).unwrap();
        assert_eq!(full.recipe(&named), Recipe { prior_zernikes: NollRange::None, ..whole });
        let optics = scene.with(&[("estimate.fit_optics", "[\"plate-scale\"]")]).unwrap();
        full.check(&optics).unwrap();
        assert!(realtime.check(&optics).unwrap_err().to_string().contains("\"realtime\""));
    }
}
