//! Optical parameters of the scene that were fitted together with the modes.

use crate::scene::Optic;

/// An optical parameter of the scene, fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedOptic {
    /// The parameter.
    pub optic: Optic,
    /// Value of the scene, in the unit of [`FittedOptic::key`].
    pub scene: f64,
    /// Fitted value; where it is not identifiable, the scene's, or that of the last iteration in which it was.
    pub value: f64,
    /// Error bar, 1σ; infinite where the modes reproduce its effect.
    pub sigma: f64,
    /// Share of its effect on the image that neither the modes nor the other optical parameters reproduce.
    pub identifiable_share: f64,
}

impl FittedOptic {
    /// The key of the scene.
    pub fn key(&self) -> &'static str {
        key(self.optic)
    }

    /// Whether the images distinguish it from the modes.
    pub fn is_identifiable(&self) -> bool {
        self.sigma.is_finite()
    }
}

/// Key of the scene.
pub(super) fn key(optic: Optic) -> &'static str {
    match optic {
        Optic::PlateScale => "image.samples_per_lambda_over_d",
        Optic::Rotation => "pupil.rotation_deg",
        Optic::Defocus => "image.diversity_focus_waves_rms",
        Optic::Bandwidth => "image.bandwidth_fraction",
    }
}
