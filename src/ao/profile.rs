//! Where the time of a frame goes.

use std::time::{Duration, Instant};

/// A stage of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// New turbulence.
    Atmosphere,
    /// The mirror's surface, the residual wavefront and its RMS.
    Mirror,
    /// Spots and slopes.
    Sensor,
    /// The controller.
    Control,
}

impl Stage {
    /// All of them, in the order of a frame.
    pub const ALL: [Stage; 4] = [Stage::Atmosphere, Stage::Mirror, Stage::Sensor, Stage::Control];

    /// One word for tables.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Atmosphere => "atmosphere",
            Stage::Mirror => "mirror",
            Stage::Sensor => "sensor",
            Stage::Control => "control",
        }
    }
}

/// Time spent in each stage.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Profile {
    spent: [Duration; Stage::ALL.len()],
}

impl Profile {
    /// Time spent in `stage`, s.
    pub fn seconds(&self, stage: Stage) -> f64 {
        self.spent[stage as usize].as_secs_f64()
    }

    /// Counts the time since `from` to `stage`, and returns now.
    pub(super) fn lap(&mut self, stage: Stage, from: Instant) -> Instant {
        let now = Instant::now();
        self.spent[stage as usize] += now - from;
        now
    }

    /// Adds time spent elsewhere.
    pub(super) fn add(&mut self, stage: Stage, spent: Duration) {
        self.spent[stage as usize] += spent;
    }

    /// What was spent since `before`.
    pub(super) fn since(&self, before: &Self) -> Self {
        let spent = std::array::from_fn(|i| self.spent[i].saturating_sub(before.spent[i]));
        Self { spent }
    }
}
