//! Numbers of the texts that a session, an estimate or a simulator has.

use crate::{Error, Result};

/// Text of an estimate: its report, as the program prints it.
pub const COPHASE_TEXT_REPORT: i32 = 1;
/// Text of an estimate, a session or a simulator: what to know before using the numbers, one
/// sentence a line; empty without warnings.
pub const COPHASE_TEXT_WARNINGS: i32 = 2;
/// Text of an estimate: remarks that hold for every image of the scene, one sentence a line.
pub const COPHASE_TEXT_REMARKS: i32 = 3;
/// Text of an estimate or a session: the device that it ran on: "cpu", or an OpenCL device.
pub const COPHASE_TEXT_DEVICE: i32 = 4;
/// Text of an estimate or a session: its policy, "full" or "realtime".
pub const COPHASE_TEXT_POLICY: i32 = 5;
/// Text of an estimate: the modes that were added to the scene's.
pub const COPHASE_TEXT_MODEL: i32 = 6;
/// Text of an estimate: the scene that was used (TOML), with the choices of a plan and the optics
/// that were fitted.
pub const COPHASE_TEXT_SCENE: i32 = 7;
/// Text of an estimate or a session: why image `index` has its status, a sentence.
pub const COPHASE_TEXT_IMAGE_MESSAGE: i32 = 8;
/// Text of an estimate: name of mode `index`.
pub const COPHASE_TEXT_MODE_NAME: i32 = 9;
/// Text of an estimate: name of term `index` of the error budget.
pub const COPHASE_TEXT_ERROR_TERM_NAME: i32 = 10;
/// Text of an estimate: name of channel `index`.
pub const COPHASE_TEXT_CHANNEL_NAME: i32 = 11;

/// Text of an estimate, after cophase_estimate_correct: the controller's name of the channel of
/// command `index` to the segments.
pub const COPHASE_TEXT_SEGMENT_COMMAND_NAME: i32 = 12;
/// Text of an estimate, after cophase_estimate_correct: the controller's name of the channel of
/// command `index` to the mirror.
pub const COPHASE_TEXT_ACTUATOR_COMMAND_NAME: i32 = 13;

/// Text of an estimate, after cophase_estimate_correct: why piston `index`, then tip, then tilt of
/// the segments is held: deadband, no-benefit or never-corrected; empty for one that moves.
pub const COPHASE_TEXT_SEGMENT_HELD: i32 = 14;
/// Text of an estimate, after cophase_estimate_correct: the same of NCPA mode `index`.
pub const COPHASE_TEXT_NCPA_HELD: i32 = 15;
/// Text of an estimate, after cophase_estimate_correct: what to know before anything is moved, one
/// sentence a line.
pub const COPHASE_TEXT_CORRECTION_WARNINGS: i32 = 16;

/// Text of an estimate: what error `index` of COPHASE_ARRAY_MODEL_ERRORS is, with the unit of its
/// numbers where they are not relative.
pub const COPHASE_TEXT_MODEL_ERROR_NAME: i32 = 17;

/// Element `index`.
///
/// # Errors
/// [`Error::Value`] where there is none.
pub(super) fn at<'a, T>(all: &'a [T], index: usize, noun: &str) -> Result<&'a T> {
    check_index(index, all.len(), noun)?;
    Ok(&all[index])
}

/// # Errors
/// [`Error::Value`] for an index that `count` elements do not have.
pub(super) fn check_index(index: usize, count: usize, noun: &str) -> Result<()> {
    if index >= count {
        return Err(Error::Value(format!("index is {index}: less than {count} is accepted, the number of {noun}")));
    }
    Ok(())
}
