//! Plan: the scene with the choices of the planner, and what each choice costs.

use super::omission::Omission;
use super::price::Price;
use super::trial::DRAWS;
use crate::Result;
use crate::scene::{Scene, System};

/// Plan of the model of a scene.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The scene with the choices as keys.
    pub scene: Scene,
    /// Error budget: RMS error of the phasing, and of the NCPA, nm.
    pub budget_nm: f64,
    /// The scene's own model in double precision.
    pub reference: Price,
    /// The model of the plan.
    pub chosen: Price,
    /// Choices that were tried, in order.
    pub choices: Vec<TriedValue>,
    /// Effects that are not modelled, or modelled and perhaps not needed.
    pub omissions: Vec<Omission>,
    /// Number of wavefronts that were drawn.
    pub draws: usize,
}

/// What a search finds.
pub(super) struct FoundPlan {
    /// The system of the scene with the choices.
    pub(super) system: System,
    pub(super) reference: Price,
    pub(super) chosen: Price,
    pub(super) choices: Vec<TriedValue>,
    pub(super) omissions: Vec<Omission>,
}

/// One value of one key that was tried.
#[derive(Debug, Clone)]
pub struct TriedValue {
    /// Name of the channel whose images it was tried on; `None` for a scene without channels.
    pub channel: Option<String>,
    /// `section.key`.
    pub key: &'static str,
    /// Its value, as TOML.
    pub value: String,
    /// Whether the plan has it.
    pub kept: bool,
    /// Cost with all choices that were kept before; of a channel, its own, with the noise of all
    /// channels together.
    pub price: Price,
}

impl Plan {
    /// The plan of `scene`.
    ///
    /// # Errors
    /// Those of [`Scene::adopting`].
    pub(super) fn new(scene: &Scene, budget_nm: f64, found: FoundPlan) -> Result<Self> {
        let FoundPlan { system, reference, chosen, choices, omissions } = found;
        Ok(Self { scene: scene.adopting(&system)?, budget_nm, reference, chosen, choices, omissions, draws: DRAWS })
    }

    /// Writes the plan's scene to a file, whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) where it cannot be written.
    pub fn write(&self, path: &std::path::Path) -> Result<()> {
        crate::atomic::write(path, self.scene.text().as_bytes())
    }

    /// Whether the plan's error is within the budget.
    pub fn is_met(&self) -> bool {
        self.chosen.error_nm() <= self.budget_nm
    }

    /// Why the budget cannot be met, and what would help; `None` where it is met.
    pub fn shortfall(&self) -> Option<String> {
        if self.is_met() {
            return None;
        }
        let (budget_nm, noise_nm) = (self.budget_nm, self.chosen.noise_nm.into_iter().fold(0.0, f64::max));
        Some(if noise_nm > budget_nm {
            let images = (self.scene.image.count as f64 * (noise_nm / budget_nm).powi(2)).ceil();
            format!(
                "the noise alone leaves {noise_nm:.2} nm, more than the budget of {budget_nm} nm: about {images:.0} images, or a \
                 brighter star, are needed"
            )
        } else {
            format!(
                "no model that was tried keeps the error below {:.2} nm, and the budget is {budget_nm} nm",
                self.chosen.error_nm()
            )
        })
    }
}
