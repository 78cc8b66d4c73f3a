//! What is varied: the model's size and recipe, and where, how precisely and how many at a time it
//! is fitted.

use cophase::control::Control;
use cophase::device::{self, Choice, Precision};
use cophase::planner;
use cophase::scene::{Aperture, Optimizer, PupilModel, Scene};
use cophase::{Error, Result};
use std::str::FromStr;

/// Sizes of the default models, as fractions of the scene's samples: 72, 96 and 120 of 120. With
/// band-limited edges they run from an error of a nanometre to the Cramér-Rao bound.
const FRACTIONS: [f64; 3] = [0.6, 0.8, 1.0];

/// Which part of the image is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crop {
    /// What carries signal, as the scene's `image.crop_pixels = "auto"`.
    Auto,
    /// So many pixels along a side at the model's sampling, which is 2 pixels per λ/D where the
    /// image has more.
    Pixels(usize),
}

impl FromStr for Crop {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let pixels = text.parse().ok().filter(|pixels: &usize| pixels.is_multiple_of(2) && (8..=8192).contains(pixels));
        match (text, pixels) {
            ("auto", _) => Ok(Self::Auto),
            (_, Some(pixels)) => Ok(Self::Pixels(pixels)),
            _ => Err(Error::Value(format!(
                "a fitted image of '{text:.40}' pixels is not possible: auto, or an even number from 8 to 8192 is accepted"
            ))),
        }
    }
}

/// The points that are measured: every combination.
#[derive(Debug, Clone)]
pub struct Grid {
    /// Samples along a side of the pupil grid; empty for the default, which is the scene's own
    /// number and two smaller ones.
    pub samples: Vec<usize>,
    /// Parts of the image.
    pub crops: Vec<Crop>,
    /// Recipes of the fit; the paper's BFGS cannot run in a session.
    pub optimizers: Vec<Optimizer>,
    /// Devices; empty for the CPU and every OpenCL device that is here.
    pub devices: Vec<Choice>,
    /// Budgets for which the planner chooses a model, nm: one more model each.
    pub budgets_nm: Vec<f64>,
    /// Precisions.
    pub precisions: Vec<Precision>,
    /// Images that are fitted at a time.
    pub batches: Vec<usize>,
    /// Different images, each with a truth of its own.
    pub images: usize,
    /// How often each point is timed.
    pub repeats: usize,
}

impl Default for Grid {
    /// About a minute at the size of Keck on two cores.
    fn default() -> Self {
        Self {
            samples: Vec::new(),
            crops: vec![Crop::Auto],
            optimizers: vec![Optimizer::GaussNewton],
            devices: Vec::new(),
            budgets_nm: Vec::new(),
            precisions: vec![Precision::F32, Precision::F64],
            batches: vec![1, 100],
            images: 8,
            repeats: 3,
        }
    }
}

/// A model: how large, and how it is fitted.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModelPlan {
    pub samples: usize,
    pub crop: Crop,
    pub optimizer: Optimizer,
    /// The planner's choice for this budget, in place of all the others.
    pub budget_nm: Option<f64>,
}

/// Where a model runs.
#[derive(Debug, Clone, Copy)]
pub(super) struct Variant {
    pub device: Choice,
    pub precision: Precision,
    pub batch: usize,
}

impl Grid {
    /// # Errors
    /// [`Error::Value`] where there would be nothing to measure.
    pub(super) fn check(&self) -> Result<()> {
        let counts = [
            ("crops", self.crops.len()),
            ("optimizers", self.optimizers.len()),
            ("precisions", self.precisions.len()),
            ("batches", self.batches.len()),
            ("images", self.images),
            ("repeats", self.repeats),
            ("images of a batch", self.batches.iter().copied().min().unwrap_or(1)),
        ];
        match counts.iter().find(|(_, count)| *count == 0) {
            Some((what, _)) => Err(Error::Value(format!("0 {what} leave nothing to measure: at least 1 is needed"))),
            None => Ok(()),
        }
    }

    pub(super) fn models(&self, scene: &Scene) -> Vec<ModelPlan> {
        let own = scene.pupil.samples;
        let samples = if !self.samples.is_empty() {
            self.samples.clone()
        } else if matches!(scene.pupil.aperture, Aperture::File(_)) {
            // A map may be too coarse for another grid.
            vec![own]
        } else {
            FRACTIONS.iter().map(|fraction| 2 * (own as f64 * fraction / 2.0).round() as usize).collect()
        };
        let plans = samples.iter().flat_map(|&samples| {
            self.crops.iter().flat_map(move |&crop| {
                self.optimizers.iter().map(move |&optimizer| ModelPlan { samples, crop, optimizer, budget_nm: None })
            })
        });
        let planned = self.budgets_nm.iter().map(|&budget_nm| ModelPlan {
            samples: own,
            crop: Crop::Auto,
            optimizer: Optimizer::GaussNewton,
            budget_nm: Some(budget_nm),
        });
        plans.chain(planned).collect()
    }

    pub(super) fn variants(&self) -> Vec<Variant> {
        let mut devices = self.devices.clone();
        if devices.is_empty() {
            // A machine whose OpenCL is broken still has its CPU.
            let present = device::devices().unwrap_or_default();
            devices.push(Choice::Cpu);
            devices.extend(present.iter().map(|info| Choice::OpenClAt(info.platform, info.device)));
        }
        let variants = devices.iter().flat_map(|&device| {
            self.precisions
                .iter()
                .flat_map(move |&precision| self.batches.iter().map(move |&batch| Variant { device, precision, batch }))
        });
        variants.collect()
    }
}

impl ModelPlan {
    /// `scene` with this model.
    pub fn scene(&self, scene: &Scene, control: &Control) -> Result<Scene> {
        if let Some(budget_nm) = self.budget_nm {
            return Ok(planner::plan(scene, budget_nm, control)?.scene);
        }
        let samples = self.samples.to_string();
        let crop = match self.crop {
            Crop::Auto => "auto".to_string(),
            Crop::Pixels(pixels) => native(scene, pixels).to_string(),
        };
        // Maps, modes and the truth stay on the scene's grid where only the fit is on another.
        let band_limited = scene.pupil.model.is_none_or(|model| model == PupilModel::BandLimited);
        let own = self.optimizer == Optimizer::GaussNewton && band_limited;
        scene.with(&[
            (if own { "estimate.samples" } else { "pupil.samples" }, samples.as_str()),
            ("image.crop_pixels", crop.as_str()),
            ("estimate.optimizer", self.optimizer.word()),
        ])
    }

    pub fn name(&self) -> String {
        if let Some(budget_nm) = self.budget_nm {
            return format!("planned for {budget_nm} nm");
        }
        let crop = match self.crop {
            Crop::Auto => String::new(),
            Crop::Pixels(pixels) => format!(", {pixels} pixels"),
        };
        format!("{} samples{crop}, {}", self.samples, self.optimizer.word())
    }
}

/// Native pixels of `pixels` at the model's sampling.
fn native(scene: &Scene, pixels: usize) -> usize {
    let ratio = (scene.image.samples_per_lambda_over_d / 2.0).max(1.0);
    2 * (pixels as f64 * ratio / 2.0).round() as usize
}

impl Variant {
    pub fn name(&self) -> String {
        format!("{}, {}, batches of {}", device_name(self.device), self.precision, self.batch)
    }
}

/// As `--device` names it.
pub(super) fn device_name(choice: Choice) -> String {
    match choice {
        Choice::Auto => "auto".into(),
        Choice::Cpu => "cpu".into(),
        Choice::OpenCl => "opencl".into(),
        Choice::OpenClAt(platform, device) => format!("opencl:{platform}:{device}"),
        Choice::All => "all".into(),
    }
}
