//! What the program `cophase` adds to the library: pictures of results, and the experiments that hold the estimator against
//! the paper, against hard cases and against time.

pub mod bench;
pub mod experiment;
pub mod plot;
pub mod reproduce;
