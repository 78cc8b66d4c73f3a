//! Shared by the integration tests.
#![allow(dead_code)] // each test binary uses its part

use cophase::estimate::Estimator;
use cophase::imaging::{Chain, Precision};

/// Every chain that this machine has for an estimator's model, with its name.
pub fn chains(estimator: &Estimator, _capacity: usize) -> Vec<(String, Chain)> {
    let optics = || estimator.model().optics.clone();
    vec![
        ("CPU f64".into(), Chain::cpu(optics(), Precision::F64)),
        ("CPU f32".into(), Chain::cpu(optics(), Precision::F32)),
    ]
}

/// ‖a − b‖ / ‖b‖.
pub fn relative_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    let norm: f64 = b.iter().map(|b| b * b).sum();
    (difference / norm).sqrt()
}
