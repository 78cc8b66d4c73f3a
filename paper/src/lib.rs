//! The experiments that compare the estimator with the paper, with hard cases and with time:
//! `cophase-paper` runs them.

pub mod bench;
pub mod experiment;
pub mod reproduce;
