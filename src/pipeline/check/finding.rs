//! Finding: one quantity of scene and images that a check looked at.

use crate::scene::{Optic, Scene, Setting};

/// Keys of the sampling and the defocus, as everything reads them.
pub(super) const SAMPLING: &str = "image.samples_per_lambda_over_d";
pub(super) const FOCUS: &str = "image.diversity_focus_waves_rms";
/// Key of the wavelength.
pub(super) const WAVELENGTH: &str = "image.wavelength_nm";
/// Part of a pixel's angle within which a wavelength alone explains a sampling: some error bars of
/// the images, and less than any wavelength of a file is from another.
const SAME_PIXEL: f64 = 2e-3;

/// What is looked at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CheckedQuantity {
    /// An optical parameter. Of the plate scale, where a card of the file confirms the wavelength.
    Optic(Optic),
    /// Pixels per λ/D: another angle of a pixel, another wavelength or another size of the pupil
    /// have the same effect.
    PlateScaleOrWavelength,
    /// Wavelength, where a card of the file has another one and the images agree with it.
    Wavelength,
    /// Flips, and turns by 90°.
    Orientation,
    /// Sign of the defocus.
    DefocusSign,
    /// One of the two: both have the same images.
    OrientationOrDefocusSign,
    /// Pixels at the largest value.
    Saturation,
    /// A second star.
    Companion,
    /// Response of the detector.
    NonLinearity,
    /// A blur that the model lacks.
    Blur,
    /// Light spread far beyond the star.
    Halo,
    /// Gains of halves and quadrants of the detector.
    Gains,
    /// Response of each column, or of each row: bad ones, gains of amplifiers.
    ResponseOfLines,
    /// Electrons of each column, or of each row: warm ones, biases of amplifiers.
    LevelOfLines,
    /// Scatter of the pixels, against photon and read noise.
    Noise,
    /// Electrons of a pixel without the star.
    Background,
    /// Pixels per λ/D, against the two that hold all of an image.
    Sampling,
    /// Another value in the file.
    Header,
    /// The segment or actuator that was poked.
    Poke,
    /// A residual that none of the others explains.
    Unexplained,
}

impl CheckedQuantity {
    /// Its name in tables and JSON.
    pub fn name(self) -> String {
        let name = match self {
            Self::Optic(optic) => return optic.name(),
            Self::PlateScaleOrWavelength => "plate scale or wavelength",
            Self::Wavelength => "wavelength",
            Self::Orientation => "orientation",
            Self::DefocusSign => "sign of the defocus",
            Self::OrientationOrDefocusSign => "orientation or sign of the defocus",
            Self::Saturation => "saturation",
            Self::Companion => "companion",
            Self::NonLinearity => "non-linearity",
            Self::Blur => "blur",
            Self::Halo => "halo",
            Self::Gains => "gains of halves and quadrants",
            Self::ResponseOfLines => "response of columns and rows",
            Self::LevelOfLines => "level of columns and rows",
            Self::Noise => "noise",
            Self::Background => "background",
            Self::Sampling => "sampling",
            Self::Header => "header",
            Self::Poke => "poke",
            Self::Unexplained => "unexplained residual",
        };
        name.into()
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
    /// Its name in tables and JSON.
    pub fn name(self) -> &'static str {
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
    /// Decrease of Schwarz's criterion, Δχ²/s − k ln N, with which faults are ranked: see
    /// [`check`](super::check()). 0 for what changes no χ².
    pub gain: f64,
    /// Keys of the scene to set, with their values.
    pub settings: Vec<Setting>,
    /// A sentence.
    pub explanation: String,
}

impl Finding {
    /// A finding without numbers.
    pub(super) fn new(quantity: CheckedQuantity, verdict: Verdict, explanation: impl Into<String>) -> Self {
        let explanation = explanation.into();
        Self { quantity, verdict, scene: None, found: None, sigma: None, gain: 0.0, settings: Vec::new(), explanation }
    }

    /// Writes values and settings in the units of the keys that `scene` names: a pixel in
    /// milliarcseconds, a defocus in nm. A wavelength is in nm, in place of the sampling that shows
    /// it. Settings that `scene` does not accept without others stay as they are.
    pub(super) fn take_form_of(&mut self, scene: &Scene) {
        let key = match self.quantity {
            CheckedQuantity::Optic(optic) => optic.key().unwrap_or_default(),
            CheckedQuantity::PlateScaleOrWavelength => SAMPLING,
            _ => "",
        };
        let own = |value: f64| scene.own_form(key, value).1;
        if let (Some(sigma), Some(found)) = (&mut self.sigma, self.found)
            && own(found) != found
        {
            // A power law of one form to another: relative errors are equal.
            *sigma *= (own(found) / found).abs();
        }
        self.found = self.found.map(own);
        self.scene = self.scene.map(own);
        if self.quantity == CheckedQuantity::Wavelength {
            let nm_of_sampling = scene.image.wavelength_nm / scene.image.samples_per_lambda_over_d;
            [&mut self.scene, &mut self.found, &mut self.sigma]
                .into_iter()
                .flatten()
                .for_each(|value| *value *= nm_of_sampling);
        }
        let is_other = |setting: &&Setting| ![SAMPLING, FOCUS].contains(&setting.key());
        let others: Vec<Setting> = self.settings.iter().filter(is_other).cloned().collect();
        // A pixel of an angle is another sampling at another wavelength.
        let Ok(scene) = scene.with_settings(&others) else { return };
        let quantity = self.quantity;
        // Where the wavelength alone is wrong, the angle of the pixel stays.
        let stays = |setting: &Setting, own: &Setting| {
            let factor = setting.value().number().map(|sampling| sampling / scene.image.samples_per_lambda_over_d);
            quantity == CheckedQuantity::Wavelength
                && own.key() != setting.key()
                && factor.is_some_and(|factor| (factor - 1.0).abs() < SAME_PIXEL)
        };
        let converted = self.settings.drain(..).filter_map(|setting| {
            let own = setting.clone().in_form_of(&scene);
            (!stays(&setting, &own)).then_some(own)
        });
        self.settings = converted.collect();
    }

    /// As [`Finding::new`] for what is not determined.
    pub(super) fn open(quantity: CheckedQuantity, explanation: impl Into<String>) -> Self {
        Self::new(quantity, Verdict::NotDetermined, explanation)
    }
}
