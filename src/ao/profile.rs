//! Time spent in each stage of the loop.

use std::time::{Duration, Instant};

/// A stage of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoopStage {
    /// New turbulence.
    Atmosphere,
    /// The mirror's surface, the residual wavefront and its RMS.
    Mirror,
    /// Spots and slopes.
    Sensor,
    /// The controller.
    Control,
}

impl LoopStage {
    /// All stages, in the order of a frame.
    pub const ALL: [LoopStage; 4] = [LoopStage::Atmosphere, LoopStage::Mirror, LoopStage::Sensor, LoopStage::Control];

    /// Name of the stage, one word.
    pub fn name(self) -> &'static str {
        match self {
            LoopStage::Atmosphere => "atmosphere",
            LoopStage::Mirror => "mirror",
            LoopStage::Sensor => "sensor",
            LoopStage::Control => "control",
        }
    }
}

/// Time spent in each stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Profile {
    spent: [Duration; LoopStage::ALL.len()],
}

impl Profile {
    /// Time spent in `stage`, s.
    pub fn seconds(&self, stage: LoopStage) -> f64 {
        self.spent[stage as usize].as_secs_f64()
    }

    /// Adds the time since `from` to `stage`; returns the present time.
    pub(super) fn lap(&mut self, stage: LoopStage, from: Instant) -> Instant {
        let now = Instant::now();
        self.spent[stage as usize] += now - from;
        now
    }

    /// Adds time that was measured by the caller.
    pub(super) fn add(&mut self, stage: LoopStage, spent: Duration) {
        self.spent[stage as usize] += spent;
    }

    /// Time spent since `before`, stage by stage.
    pub(super) fn since(&self, before: &Self) -> Self {
        let spent = std::array::from_fn(|i| self.spent[i].saturating_sub(before.spent[i]));
        Self { spent }
    }
}
