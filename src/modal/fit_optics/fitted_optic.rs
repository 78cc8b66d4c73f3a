//! Optical parameters of the scene that were fitted together with the modes.

use crate::scene::Optic;

/// An optical parameter of the scene, fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedOptic {
    /// The parameter.
    pub optic: Optic,
    /// The key of the scene that it is, where the optic has several.
    pub number: Option<&'static str>,
    /// The segment whose reflectivity it is, from 0; `None` for a number of the scene.
    pub segment: Option<usize>,
    /// Value of the scene, in the unit of [`FittedOptic::key`].
    pub scene: f64,
    /// Fitted value; where it is not identifiable, the scene's, or that of the last iteration in
    /// which it was.
    pub value: f64,
    /// Error bar, 1σ; infinite where the modes reproduce its effect.
    pub sigma: f64,
    /// Share of its effect on the image that neither the modes nor the other optical parameters
    /// reproduce.
    pub identifiable_share: f64,
}

impl FittedOptic {
    /// The key of the scene, or `reflectivity N` of segment N, from 0.
    pub fn key(&self) -> String {
        match (self.number.or(self.optic.key()), self.segment) {
            (_, Some(segment)) => format!("reflectivity {segment}"),
            (Some(key), None) => key.into(),
            (None, None) => self.optic.word().into(),
        }
    }

    /// Whether the images distinguish it from the modes.
    pub fn is_identifiable(&self) -> bool {
        self.sigma.is_finite()
    }
}
