//! Cache of the Karhunen-Loève basis of a scene.

use super::fitter::same_basis;
use super::mode_set::SceneBasis;
use crate::scene::Scene;
use std::sync::Arc;

/// Karhunen-Loève basis of a scene, which takes most of the time of building a model: computed once for all models of one scene.
#[derive(Clone, Default)]
pub struct BasisCache(pub(super) Arc<SceneBasis>);

impl BasisCache {
    /// The cache for the scene `other` of one that was made for `scene`: shared where both have the same basis.
    pub(crate) fn for_scene(&self, scene: &Scene, other: &Scene) -> Self {
        if same_basis(scene, other) { self.clone() } else { Self::default() }
    }
}
