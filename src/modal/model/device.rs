//! Conversions of the scene's device and precision to those of the imaging chain.

use crate::imaging::{Choice, Precision};
use crate::scene;

impl From<scene::DeviceChoice> for Choice {
    fn from(word: scene::DeviceChoice) -> Self {
        match word {
            scene::DeviceChoice::Auto => Choice::Auto,
            scene::DeviceChoice::Cpu => Choice::Cpu,
            scene::DeviceChoice::OpenCl => Choice::OpenCl,
            scene::DeviceChoice::All => Choice::All,
            scene::DeviceChoice::OpenClDevice { platform, device } => Choice::OpenClAt(platform, device),
        }
    }
}

impl From<scene::Precision> for Precision {
    fn from(word: scene::Precision) -> Self {
        match word {
            scene::Precision::F32 => Precision::F32,
            scene::Precision::F64 => Precision::F64,
        }
    }
}
