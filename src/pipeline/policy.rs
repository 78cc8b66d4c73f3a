//! Policy: the choices of an estimate that are not part of the scene.

use crate::modal::{Recipe, Session};
use crate::scene::Scene;
use crate::{Error, Result};

/// Choices of an estimate. Every interface follows [`Policy::default`] unless told otherwise; a
/// [`Session`](crate::modal::Session), which has a deadline and may not allocate, follows [`Policy::realtime`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Policy {
    /// Whether the smallest basis that explains the images is selected: the scene's modes with tip, tilt and focus first,
    /// with Zernikes to Noll 21 where χ² is too large. Otherwise the largest is fitted at once. Without effect where the
    /// scene names `modes.exact_zernikes`.
    pub select_basis: bool,
    /// Whether outlier pixels (cosmic rays, hot and dead pixels) are sought in images that the model does not explain,
    /// and rejected.
    pub reject_outliers: bool,
    /// Whether a fit that ended in a wrong minimum is restarted from a perturbed start, as often as `estimate.restarts`
    /// says (3 unless named).
    pub restart: bool,
    /// Whether the optical parameters that `estimate.fit_optics` names may be fitted. Where not, a scene that names some
    /// is an error.
    pub fit_optics: bool,
}

impl Default for Policy {
    fn default() -> Self {
        Self { select_basis: true, reject_outliers: true, restart: true, fit_optics: true }
    }
}

impl Policy {
    /// No retries: the time of a fit is bounded by its own evaluations.
    pub const fn realtime() -> Self {
        Self { select_basis: false, reject_outliers: false, restart: false, fit_optics: false }
    }

    /// The word in reports and files: `full`, `realtime`, or `custom`.
    pub fn name(&self) -> &'static str {
        match self {
            policy if *policy == Self::default() => "full",
            policy if *policy == Self::realtime() => "realtime",
            _ => "custom",
        }
    }

    /// The recipes to fit in turn, the smallest basis first.
    pub(super) fn recipes(&self, scene: &Scene) -> Vec<Recipe> {
        let mut recipes = if self.select_basis { Recipe::ladder(scene) } else { vec![Recipe::from_scene(scene)] };
        for recipe in &mut recipes {
            recipe.reject_outliers &= self.reject_outliers;
            if !self.restart {
                recipe.restarts = 0;
            }
        }
        recipes
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

    #[test]
    fn a_policy_sets_the_recipes() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let (full, realtime) = (Policy::default(), Policy::realtime());
        assert_eq!((full.name(), realtime.name()), ("full", "realtime"));
        assert_eq!(Policy { restart: false, ..full }.name(), "custom");
        let (ladder, one) = (full.recipes(&scene), realtime.recipes(&scene));
        assert_eq!((ladder.len(), one.len()), (2, 1));
        assert!(ladder.iter().all(|recipe| recipe.restarts == 3 && recipe.reject_outliers));
        assert!(one[0].restarts == 0 && !one[0].reject_outliers);
        assert_eq!(one[0].exact_zernikes, ladder[1].exact_zernikes);
        let optics = scene.with(&[("estimate.fit_optics", "[\"plate-scale\"]")]).unwrap();
        full.check(&optics).unwrap();
        assert!(realtime.check(&optics).unwrap_err().to_string().contains("\"realtime\""));
    }
}
