//! Finding: one quantity of scene and images that a check looked at.

/// What is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CheckedQuantity {
    /// Pixels per λ/D where a card of the file confirms the wavelength.
    PlateScale,
    /// Pixels per λ/D: another angle of a pixel, another wavelength or another size of the pupil have the same effect.
    PlateScaleOrWavelength,
    /// Wavelength, where a card of the file has another one and the images agree with it.
    Wavelength,
    /// Rotation of the pupil.
    Rotation,
    /// Flips, and turns by 90°.
    Orientation,
    /// Sign of the defocus.
    DefocusSign,
    /// Amplitude of the defocus.
    Defocus,
    /// Slopes of the light over the pupil.
    Illumination,
    /// Width of the filter.
    Bandwidth,
    /// Side of a pixel's sensitive square.
    PixelFill,
    /// Diameter of the central obscuration.
    Obscuration,
    /// Width of the spider's vanes.
    Spiders,
    /// Pixels at the largest value.
    Saturation,
    /// A second star.
    Companion,
    /// Response of the detector.
    NonLinearity,
    /// A blur that the model lacks.
    Blur,
    /// Electrons of a pixel without the star.
    Background,
    /// Pixels per λ/D, against the two that hold all of an image.
    Sampling,
    /// Another value in the file.
    Header,
    /// A residual that none of the others explains.
    Unexplained,
}

impl CheckedQuantity {
    /// Its name in tables and JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::PlateScale => "plate scale",
            Self::PlateScaleOrWavelength => "plate scale or wavelength",
            Self::Wavelength => "wavelength",
            Self::Rotation => "rotation",
            Self::Orientation => "orientation",
            Self::DefocusSign => "sign of the defocus",
            Self::Defocus => "defocus",
            Self::Illumination => "illumination",
            Self::Bandwidth => "bandwidth",
            Self::PixelFill => "pixel fill",
            Self::Obscuration => "obscuration",
            Self::Spiders => "spiders",
            Self::Saturation => "saturation",
            Self::Companion => "companion",
            Self::NonLinearity => "non-linearity",
            Self::Blur => "blur",
            Self::Background => "background",
            Self::Sampling => "sampling",
            Self::Header => "header",
            Self::Unexplained => "unexplained residual",
        }
    }
}

/// What a finding says of the scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// The scene contradicts the images or their file.
    Fault,
    /// The scene agrees with the images.
    Agrees,
    /// These images do not determine it.
    NotDetermined,
}

impl Verdict {
    /// The words in tables and JSON.
    pub fn words(self) -> &'static str {
        match self {
            Self::Fault => "fault",
            Self::Agrees => "agrees",
            Self::NotDetermined => "not determined",
        }
    }
}

/// One quantity, what the scene says of it and what the images say.
#[derive(Debug, Clone)]
pub struct Finding {
    /// The quantity.
    pub quantity: CheckedQuantity,
    /// What it says of the scene.
    pub verdict: Verdict,
    /// Value of the scene, in the unit of its key.
    pub scene: Option<f64>,
    /// Value that was found, in the same unit.
    pub found: Option<f64>,
    /// Error bar of it, 1σ.
    pub sigma: Option<f64>,
    /// Decrease of Schwarz's criterion, Δχ²/s − k ln N, with which faults are ranked: see [`check`](super::check()). 0 for what changes no χ².
    pub gain: f64,
    /// Keys of the scene to set, with their values.
    pub settings: Vec<(String, String)>,
    /// A sentence.
    pub explanation: String,
}

impl Finding {
    /// A finding without numbers.
    pub(super) fn new(quantity: CheckedQuantity, verdict: Verdict, explanation: impl Into<String>) -> Self {
        let explanation = explanation.into();
        Self { quantity, verdict, scene: None, found: None, sigma: None, gain: 0.0, settings: Vec::new(), explanation }
    }

    /// As [`Finding::new`] for what is not determined.
    pub(super) fn open(quantity: CheckedQuantity, explanation: impl Into<String>) -> Self {
        Self::new(quantity, Verdict::NotDetermined, explanation)
    }
}
