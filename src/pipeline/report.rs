//! Report: an estimate as text.

use super::estimate::{Estimate, Figure, Figures, FullPhaseSummary, Run};
use super::images::counted;
use super::telemetry::TelemetryCheck;
use crate::modal::{RejectedPixels, Status};
use crate::scene::{Combine, OpticalParameter};
use std::fmt::Write;

impl Estimate {
    /// The estimate as text: [`Estimate::summary`], and the warnings.
    pub fn report(&self) -> String {
        let warnings = self.warnings.iter().map(|warning| format!("Warning: {warning}.\n"));
        self.summary() + &warnings.collect::<String>()
    }

    /// The estimate as text without its warnings: a table, the error budget, fitted optics,
    /// remarks.
    pub fn summary(&self) -> String {
        summary(self)
    }
}

fn summary(estimate: &Estimate) -> String {
    let mut text = format!("{}, {}\n\n", combination(estimate), modes(estimate));
    text += &table(estimate);
    text += &format!("\nRMS over the pupil, tip and tilt removed. {}\n", quality(estimate));
    text += &effort(estimate);
    if estimate.error_budget.len() > 1 {
        text += &budget(estimate);
    }
    let (reflectivities, numbers): (Vec<_>, Vec<_>) =
        estimate.optics.iter().partition(|parameter| parameter.segment.is_some());
    numbers.into_iter().for_each(|parameter| text += &optics(parameter));
    if !reflectivities.is_empty() {
        let squares = reflectivities.iter().map(|parameter| (parameter.value - 1.0).powi(2));
        let rms = (squares.sum::<f64>() / reflectivities.len() as f64).sqrt();
        text += &format!("Reflectivities of {} segments differ by {:.1} % RMS.\n", reflectivities.len(), 100.0 * rms);
    }
    if !estimate.integers.is_empty() {
        let least = estimate.integers.iter().map(|found| found.probability).fold(1.0, f64::min);
        let _ = writeln!(text, "Whole wavelengths of the pistons: the least certain has a probability of {least:.4}.");
    }
    estimate.remarks.iter().for_each(|remark| text += &format!("{remark}\n"));
    text
}

/// Number of images that were combined, and how.
fn combination(estimate: &Estimate) -> String {
    let (count, used) = (estimate.images.len(), estimate.used());
    let all = counted(count, "image");
    if !estimate.channels.is_empty() {
        let (channels, names) = (counted(estimate.channels.len(), "channel"), estimate.channels.join(", "));
        return format!("{used} of {all} in {channels} ({names})");
    }
    let how = match estimate.modal().map(|modal| modal.combine) {
        Some(Combine::Median) if count > 1 => "median of ",
        Some(Combine::ClippedMean) if count > 1 && estimate.is_sequence => "clipped mean of ",
        Some(_) if count > 1 => "mean of ",
        _ => return format!("{used} of {all} used"),
    };
    match estimate.clipped() {
        0 => format!("{how}{used} of {all}"),
        clipped => format!("{how}{used} of {all} ({clipped} clipped)"),
    }
}

fn modes(estimate: &Estimate) -> String {
    let (modes, segments) = (estimate.basis.names.len(), estimate.segment_modes());
    let own = format!("{modes} modes ({segments} of the segments, {} of the NCPA)", modes - segments);
    match estimate.full_phase() {
        None => own,
        Some(map) => {
            let iterations = counted(map.iterations.len(), "iteration");
            format!("{own}, {iterations}, AO knowledge \"{}\"", map.ao_knowledge.word())
        }
    }
}

fn table(estimate: &Estimate) -> String {
    let residuals_nm = estimate.truth.as_ref().map(|(_, residual)| residual.rms_nm);
    let head = if residuals_nm.is_some() { "   residual [nm]" } else { "" };
    let mut text = format!("{:<12}{:>10}{:>12}{head}\n", "", "RMS [nm]", "1σ [nm]");
    let Figures { phasing, ncpa, wavefront } = estimate.figures;
    let rows = [("phasing", phasing), ("NCPA", ncpa), ("wavefront", wavefront)];
    for (i, (name, Figure { rms_nm, sigma_nm })) in rows.into_iter().enumerate() {
        let is_bound = i == 2 && estimate.full_phase().is_some();
        let sigma = match sigma_nm {
            _ if sigma_nm.is_nan() => "-".into(),
            _ if is_bound => format!("≤ {sigma_nm:.3}"),
            _ => format!("{sigma_nm:.3}"),
        };
        let residual = residuals_nm.map(|nm| format!("{:>16.3}", nm[i])).unwrap_or_default();
        // Writing into memory does not fail.
        let _ = writeln!(text, "{name:<12}{rms_nm:>10.3}{sigma:>12}{residual}");
    }
    text
}

/// Reduced χ² of a full-phase estimate from which on the report says why it is above 1: bright
/// stars behind frozen turbulence leave 1.4 to 1.6, exposures of 10 ms 4.2.
const NOTABLE_CHI2: f64 = 1.1;

fn quality(estimate: &Estimate) -> String {
    let pixels = |what: &dyn Fn(&super::ImageOutcome) -> usize| estimate.images.iter().map(what).sum::<usize>();
    let mut text = format!("Reduced χ² {:.3}", estimate.reduced_chi2);
    let is_notable = estimate.status == Status::Ok && estimate.reduced_chi2 > NOTABLE_CHI2;
    if is_notable && estimate.full_phase().is_some() {
        text += " (above 1 by turbulence that is too fine or too fast to be retrieved; a misfit would be a warning)";
    }
    let masked = pixels(&|image| image.report.bad_pixels);
    let rejected = estimate.images.iter().fold(RejectedPixels::default(), |all, image| all.and(image.report.rejected));
    if masked > 0 {
        text += &format!(", {} masked", counted(masked, "pixel"));
    }
    if rejected.total() > 0 {
        text += &format!(", {} rejected ({})", counted(rejected.total(), "outlier pixel"), rejected.kinds());
    }
    let scatter = estimate.error_budget.first().filter(|_| estimate.is_sequence);
    match scatter.map(|term| term.name.as_str()) {
        Some("scatter between groups") => text + ". Error bars from the scatter between groups.",
        Some(_) => text + ". Error bars from the scatter between images.",
        None => text + ".",
    }
}

/// Evaluations, time, device.
fn effort(estimate: &Estimate) -> String {
    let Run { device, precision, seconds, model_seconds } = &estimate.run;
    match estimate.full_phase() {
        None => format!(
            "{} in {seconds:.2} s on {device} in {precision}; the model took {model_seconds:.2} s. Policy {}, {}.\n",
            counted(estimate.evaluations(), "evaluation"),
            estimate.policy.name(),
            estimate.model,
        ),
        Some(map) => format!(
            "{seconds:.1} s, {:.1} of them in {} retrievals, on {device} in {precision}.\n{}{}",
            map.retrieval_seconds,
            estimate.images.len() * map.iterations.len(),
            map.telemetry.as_ref().map(telemetry).unwrap_or_default(),
            more_images(map),
        ),
    }
}

/// Measured slopes against predicted ones.
fn telemetry(check: &TelemetryCheck) -> String {
    let TelemetryCheck { gain, correlation, .. } = check;
    format!(
        "Measured slopes are {gain:.2} times those of the retrieved wavefronts, with a correlation of {correlation:.2}.\n"
    )
}

fn more_images(map: &FullPhaseSummary) -> String {
    let Some(last) = map.iterations.last() else { return String::new() };
    match last.further_images(last.error_budget.total_nm.map(|nm| nm / 2.0)) {
        Ok(further) => format!("{} images would halve the error bars.\n", last.used_images.len() + further),
        Err(_) => "No number of images halves the error bars: they include errors that all images share.\n".into(),
    }
}

fn budget(estimate: &Estimate) -> String {
    let mut text = format!("\n{:<34}{:>14}{:>11}\n", "Error budget [nm RMS]", "phasing", "NCPA");
    for term in &estimate.error_budget {
        let _ = writeln!(text, "{:<34}{:>14.3}{:>11.3}", term.name, term.phasing_nm, term.ncpa_nm);
    }
    text
}

fn optics(parameter: &OpticalParameter) -> String {
    let OpticalParameter { key, scene, value, sigma, .. } = parameter;
    if sigma.is_infinite() {
        format!("{key} = {value} (the scene says {scene}): not identifiable, the modes reproduce its effect\n")
    } else if sigma.is_nan() {
        format!("{key} = {value:.6} (the scene says {scene})\n")
    } else {
        format!("{key} = {value:.6} ± {sigma:.1e} (the scene says {scene})\n")
    }
}
