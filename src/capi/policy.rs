//! Policies of an estimate.

use crate::pipeline::Policy;

/// Policy: what the program and every other interface do: modes with a prior, a search for outlier
/// pixels, restarts, optics fitted where the scene asks for it, a larger model where the scene does
/// not explain them (estimate.model).
pub const COPHASE_POLICY_FULL: i32 = 0;
/// Policy: one fit of the scene's modes, no retries; what a session does.
pub const COPHASE_POLICY_REALTIME: i32 = 1;

/// The number of a policy.
pub(super) fn policy_number(policy: &Policy) -> i32 {
    if *policy == Policy::realtime() { COPHASE_POLICY_REALTIME } else { COPHASE_POLICY_FULL }
}
