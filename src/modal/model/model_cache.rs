//! What is built for a scene and serves all estimates of it.

use crate::Result;
use crate::modal::fitter::{ModalFitter, same_basis};
use crate::modal::model::mode_set::SceneBasis;
use crate::modal::model::recipe::Recipe;
use crate::scene::System;
use std::sync::{Arc, Mutex, PoisonError};

/// Fitter for images with bad pixels (`true`), which are not reduced, or for others.
type KeptFitter = (bool, ModalFitter);

/// Karhunen-Loève basis of a scene, which takes most of the time of building a model, and the
/// fitter that an estimate used last. The files that a scene names are read when they are built.
#[derive(Clone, Default)]
pub struct ModelCache {
    pub(in crate::modal) basis: Arc<SceneBasis>,
    fitter: Arc<Mutex<Option<KeptFitter>>>,
}

impl ModelCache {
    /// The cache for the scene `other` of one that was made for `scene`: shared where both have the
    /// same basis.
    pub(crate) fn for_scene(&self, scene: &System, other: &System) -> Self {
        if same_basis(scene, other) { self.clone() } else { Self::default() }
    }

    /// The fitter of `scene` by `recipe`: that of the last call, with the metrics that it has
    /// computed, where that was for the same.
    ///
    /// # Errors
    /// Those of [`ModalFitter::new`].
    pub(in crate::modal) fn fitter(&self, scene: &System, recipe: Recipe, native: bool) -> Result<ModalFitter> {
        let slot = || self.fitter.lock().unwrap_or_else(PoisonError::into_inner);
        // Another one is dropped before this one is built: both may be large.
        let last = slot().take().filter(|(is_native, fitter)| *is_native == native && fitter.is_of(scene, &recipe));
        let (_, fitter) = match last {
            Some(last) => last,
            None => (native, ModalFitter::with_scene_basis(scene, recipe, native, self.basis.clone())?),
        };
        *slot() = Some((native, fitter.clone()));
        Ok(fitter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn fitter_is_rebuilt_only_for_another_scene_recipe_or_sampling() {
        let small =
            [("pupil.samples", "64"), ("image.pixels", "64"), ("modes.ncpa", "zernike"), ("modes.ncpa_count", "5")];
        let scene = Scene::preset("keck-artificial").unwrap().with(&small).unwrap();
        let cache = ModelCache::default();
        let own = || cache.fitter(&scene, Recipe::from_scene(&scene), false).unwrap();
        let is_shared = |one: &ModalFitter, other: &ModalFitter| {
            Arc::ptr_eq(&one.model, &other.model) && Arc::ptr_eq(&one.metrics, &other.metrics)
        };
        assert!(is_shared(&own(), &own()));
        let other = scene.with(&[("image.diversity_focus_waves_rms", "0.5")]).unwrap();
        let recipe = Recipe { restarts: 0, ..Recipe::from_scene(&scene) };
        for (scene, recipe, native) in [
            (&other, Recipe::from_scene(&other), false),
            (&scene, recipe, false),
            (&scene, Recipe::from_scene(&scene), true),
        ] {
            let before = own();
            let other = cache.fitter(scene, recipe, native).unwrap();
            assert!(!Arc::ptr_eq(&before.model, &other.model));
            assert!(!is_shared(&before, &own()), "the other has taken its place");
        }
    }
}
