//! Engines: run the fits of a batch of images, on CPU threads, on a device or on several. A fit
//! depends on its own image alone, so that every engine of one precision finds the same, for any
//! number of threads or images.

mod cpu;
mod device;
mod dispatch;
mod lane;
mod paper;
mod several;
mod task;

pub(in crate::modal) use cpu::CpuEngine;
pub(in crate::modal) use device::{DeviceEngine, prepare_frames};
pub(in crate::modal) use dispatch::fit;
pub(in crate::modal) use task::{Engine, FitState, FitTask, ImageFit, check_usable, reason_of_none};
