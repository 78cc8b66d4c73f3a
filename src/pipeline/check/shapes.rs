//! Findings from what a fit leaves, and from the star that it found.

use super::finding::{CheckedQuantity, Finding, Verdict};
use crate::Result;
use crate::pipeline::modal_task::Fitted;
use crate::pipeline::residual_shape::{Shape, ShapeKind};
use crate::pipeline::warnings::{TOO_SMALL, shown_chi2};
use crate::scene::{Optic, Scene};

/// Smallest value of a shape that is a fault. The model's own error looks like a blur of 0.07
/// pixels, a response that falls by 0.1 % and, in one of six draws, a faint companion (Keck, 128
/// samples, peak S/N of 500); the area of a pixel is a blur of 0.41 pixels.
pub(super) fn least(kind: ShapeKind) -> f64 {
    match kind {
        ShapeKind::Companion => 2e-3,
        ShapeKind::NonLinearity => 3e-3,
        ShapeKind::Blur => 0.2,
        ShapeKind::Halo | ShapeKind::Gain => 3e-3,
        // Of hundreds of lines the smallest that is significant is larger.
        ShapeKind::Response | ShapeKind::Level => 0.0,
    }
}

/// Finding of a shape of the residual.
pub(super) fn finding(shape: &Shape, gain: f64, verdict: Verdict) -> Finding {
    let quantity = match shape.kind {
        ShapeKind::Companion => CheckedQuantity::Companion,
        ShapeKind::NonLinearity => CheckedQuantity::NonLinearity,
        ShapeKind::Blur => CheckedQuantity::Blur,
        ShapeKind::Halo => CheckedQuantity::Halo,
        ShapeKind::Gain => CheckedQuantity::Gains,
        ShapeKind::Response => CheckedQuantity::ResponseOfLines,
        ShapeKind::Level => CheckedQuantity::LevelOfLines,
    };
    let sentence = match verdict {
        Verdict::Fault => shape.sentence.replacen("of it", "of the residual", 1),
        Verdict::Agrees => "none found".into(),
        Verdict::NotDetermined => {
            let percent = 100.0 * shape.share;
            format!("it would explain {percent:.0} % of the residual, most of which has another cause")
        }
    };
    // Of a linear coefficient, whose square over its variance is the decrease; many have none.
    let is_one = !matches!(shape.kind, ShapeKind::Response | ShapeKind::Level | ShapeKind::Gain);
    let sigma = if is_one { shape.value.abs() / shape.decrease.max(f64::MIN_POSITIVE).sqrt() } else { f64::NAN };
    // Of a residual that has another cause the coefficient says nothing.
    let is_fault = verdict == Verdict::Fault;
    let (found, sigma) = (is_fault.then_some(shape.value), (is_fault && sigma.is_finite()).then_some(sigma));
    Finding { scene: Some(0.0), found, sigma, gain, ..Finding::new(quantity, verdict, sentence) }
}

/// Scatter of the pixels about the model over the stated noise: a fault where χ² is smaller than
/// noise explains. It changes error bars, and no χ² against another: its gain is 0.
pub(super) fn noise(fitted: &Fitted) -> Option<Finding> {
    let found = &fitted.fit.1;
    let used = found.combined.used_images.iter().filter_map(|&image| found.images.get(image));
    let (small, all) = used.fold((0, 0), |(small, all), image| (small + usize::from(image.is_too_small()), all + 1));
    let chi2 = found.reduced_chi2();
    (2 * small > all).then(|| Finding {
        scene: Some(1.0),
        found: Some(chi2.sqrt()),
        ..Finding::new(
            CheckedQuantity::Noise,
            Verdict::Fault,
            format!("reduced χ² is {}: {TOO_SMALL}", shown_chi2(chi2)),
        )
    })
}

/// Sampling, background and amplitude of the defocus, as the fit has them.
pub(super) fn photometry(scene: &Scene, fitted: &Fitted, has_fault_of_focus: bool) -> Result<Vec<Finding>> {
    let (fitter, found) = &fitted.fit;
    let mut findings = Vec::new();
    let sampling = scene.image.samples_per_lambda_over_d;
    let (verdict, text) = if sampling < 2.0 {
        (Verdict::NotDetermined, "fewer than 2 pixels per λ/D: the images do not hold all frequencies")
    } else {
        (Verdict::Agrees, "2 pixels per λ/D hold all frequencies of an image")
    };
    findings.push(Finding { scene: Some(sampling), ..Finding::new(CheckedQuantity::Sampling, verdict, text) });
    if let Some(report) = found.combined.used_images.first().and_then(|&image| found.images.get(image)) {
        findings.push(Finding {
            scene: Some(scene.image.background_e),
            found: Some(report.background_e),
            ..Finding::new(CheckedQuantity::Background, Verdict::Agrees, "electrons of a pixel; an estimate fits it")
        });
    }
    let diversity = fitter.diversity_projection()?;
    if !has_fault_of_focus && diversity.is_spanned() && scene.image.diversity_focus_waves_rms != 0.0 {
        findings.push(Finding {
            scene: Some(scene.image.diversity_focus_waves_rms),
            ..Finding::open(
                CheckedQuantity::Optic(Optic::DEFOCUS),
                "the NCPA have a defocus of their own, which an error of its amplitude looks like",
            )
        });
    }
    Ok(findings)
}
