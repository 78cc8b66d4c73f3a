//! Minimisation of smooth functions of many variables. This module knows vectors only.
//!
//! * [`QuasiNewton`] is the fast method: limited-memory BFGS in coordinates whitened by a
//!   Gauss-Newton matrix ([`Metric`]), with a reverse communication interface, so that many
//!   independent problems can advance in lock-step with one device call per step. [`minimize`] runs
//!   it on a closure.
//! * [`ArgminBfgs`] is the reference: full-memory BFGS of the `argmin` crate, in the caller's own
//!   coordinates.
//!
//! Every run ends with a [`StopReason`], a sentence that can be shown to a user.

mod line_search;
mod metric;
mod minimize;
mod outcome;
mod pairs;
mod problem;
mod quasi_newton;
mod reference;
mod settings;

pub use metric::Metric;
pub use minimize::minimize;
pub use outcome::{Outcome, StopReason};
pub use problem::Objective;
pub use quasi_newton::{Advance, QuasiNewton};
pub use reference::ArgminBfgs;
pub use settings::{RESOLUTION_F32, RESOLUTION_F64, Scaling, Settings};
