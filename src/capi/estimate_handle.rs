//! Handle of an estimate.

use super::handle::{Handle, Object};
use crate::loop_response::Corrections;
use crate::pipeline::Estimate;

/// Estimate of the static wavefront: modes, maps, error bars, reports on the images. Calls that
/// take it as const may run in several threads at once; cophase_estimate_correct only while no
/// other call runs (COPHASE_BUSY otherwise).
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_estimate(pub(super) Handle<EstimateState>);

impl Object for cophase_estimate {
    const KIND: u64 = 1;
}

/// The estimate, and the corrections that were computed from it.
pub(super) struct EstimateState {
    pub(super) estimate: Estimate,
    pub(super) corrections: Option<Corrections>,
}

impl EstimateState {
    pub(super) fn new(estimate: Estimate) -> Self {
        Self { estimate, corrections: None }
    }
}
