//! Optical parameters that were fitted beside the modes.

use crate::scene::Optic;

/// A number of the scene, fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedOptic {
    /// Which.
    pub optic: Optic,
    /// What the scene says, in the unit of [`FittedOptic::key`].
    pub scene: f64,
    /// What the images say; where they say nothing it is not moved, and the scene's but for rounds that thought otherwise.
    pub value: f64,
    /// Its error bar, 1σ; infinite where the modes hold it.
    pub sigma: f64,
    /// Share of what it does to the image that neither the modes nor the other optics can do.
    pub told: f64,
}

impl FittedOptic {
    /// The key of the scene.
    pub fn key(&self) -> &'static str {
        key(self.optic)
    }

    /// Whether the images tell it from the modes.
    pub fn is_told(&self) -> bool {
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
