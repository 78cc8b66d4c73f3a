//! The report of an estimate as one HTML file.

use cophase::Result;
use cophase::Status;
use cophase::io::write_atomically;
use cophase::modal::FittedImage;
use cophase::pipeline::{Estimate, Figure};
use cophase::telescope::SegmentPlace;
use cophase_view::html::{self, Colours, SegmentValue};
use cophase_view::terminal::counted;
use std::path::Path;

/// Motions of a segment that are modes.
const MOTIONS: [&str; 3] = ["piston", "tip", "tilt"];

/// Writes the report on `estimate`, made from the file `name`, to `path`, whole or not at all.
pub(super) fn write(path: &Path, name: &Path, estimate: &Estimate) -> Result<()> {
    let name = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy();
    write_atomically(path, report(&name, estimate)?.as_bytes())
}

fn report(name: &str, estimate: &Estimate) -> Result<String> {
    let mut sections = vec![state(estimate), html::section("Result", &figures(estimate))];
    let segments = segments(estimate);
    if segments.iter().any(|segment| segment.value_nm.is_some()) {
        sections.push(html::section("Mirror", &html::mirror(&segments)));
    }
    sections.push(html::section("Maps", &maps(estimate)?));
    let compared = estimate.modal().map_or(&[][..], |modal| &modal.compared);
    for (number, image) in compared.iter().enumerate() {
        let heading = match estimate.channels.get(number) {
            Some(channel) => format!("First image of {channel}, its model and the residual"),
            None => "First image, its model and the residual".into(),
        };
        sections.push(html::section(&heading, &images(image)?));
    }
    sections.push(html::section("Segments", &segment_table(estimate, &segments)));
    sections.push(html::section("Modes", &mode_table(estimate)));
    let terms = estimate.error_budget.iter();
    let rows: Vec<Vec<String>> =
        terms.map(|term| vec![term.name.clone(), nm(term.phasing_nm), nm(term.ncpa_nm)]).collect();
    let budget = html::table(&["contribution", "phasing, nm RMS", "NCPA, nm RMS"], 1, &rows, "none");
    sections.push(html::section("Error budget", &budget));
    let texts = [("The report as text", estimate.report()), ("The scene", estimate.scene.text().to_owned())];
    let texts: String = texts.iter().map(|(summary, text)| html::folded(summary, text)).collect();
    sections.push(html::section("Settings", &texts));
    Ok(html::page(&format!("Estimate from {name}"), &sections))
}

/// Status, warnings and remarks, in this order.
fn state(estimate: &Estimate) -> String {
    let status = (estimate.status != Status::Ok).then(|| format!("The status is {}", estimate.status.word()));
    let warnings: Vec<String> = status.into_iter().chain(estimate.warnings.iter().cloned()).collect();
    let mut text = html::list("alarm", &warnings, "The status is ok, and there is no warning.");
    if !estimate.remarks.is_empty() {
        text += &html::list("remarks", &estimate.remarks, "");
    }
    html::section("Status", &text)
}

fn figures(estimate: &Estimate) -> String {
    let figure = |Figure { rms_nm, sigma_nm }: Figure| {
        if sigma_nm.is_finite() { format!("{rms_nm:.2} ± {sigma_nm:.2} nm") } else { format!("{rms_nm:.2} nm") }
    };
    let both = figure(estimate.figures.wavefront);
    // How the errors of both go together is not known there.
    let both = if estimate.full_phase().is_some() { both.replace('±', "± at most") } else { both };
    let mut pairs = vec![
        ("phasing RMS", figure(estimate.figures.phasing)),
        ("NCPA RMS", figure(estimate.figures.ncpa)),
        ("both RMS", both),
        ("reduced χ²", format!("{:.3}", estimate.reduced_chi2)),
        ("images used", format!("{} of {}", estimate.used(), estimate.images.len())),
        ("method", estimate.method.word().to_owned()),
        ("wavelength", format!("{} nm", estimate.scene.image.wavelength_nm)),
        ("model", if estimate.model.is_empty() { "the scene's".into() } else { estimate.model.clone() }),
        ("made", format!("in {:.1} s on {} in {}", estimate.run.seconds, estimate.run.device, estimate.run.precision)),
    ];
    if let Some((_, residual)) = &estimate.truth {
        let [phasing, ncpa, _] = residual.rms_nm;
        pairs.push(("residual against the truth", format!("{phasing:.2} nm phasing, {ncpa:.2} nm NCPA")));
    }
    if let Some(map) = estimate.full_phase() {
        let knowledge = format!("{}, {}", map.ao_knowledge.word(), counted(map.iterations.len(), "iteration"));
        pairs.push(("AO knowledge", knowledge));
    }
    html::figures(&pairs)
}

/// Value and error bar of the mode `motion` of `segment`.
fn of_segment(estimate: &Estimate, segment: usize, motion: &str) -> Option<[f64; 2]> {
    let is_it = |name: &String| {
        let rest = name.strip_prefix("segment-").and_then(|rest| rest.split_once('-'));
        rest.is_some_and(|(number, what)| what == motion && number.parse() == Ok(segment))
    };
    let mode = estimate.basis.names.iter().position(is_it)?;
    Some([estimate.modes.coefficients_nm[mode], estimate.modes.covariance_nm2[[mode, mode]].max(0.0).sqrt()])
}

fn segments(estimate: &Estimate) -> Vec<SegmentValue> {
    let places = SegmentPlace::all(&estimate.scene, &estimate.pupil.segments);
    let each = places.into_iter().map(|place| SegmentValue {
        label: place.label,
        centre_m: [place.x_m, place.y_m],
        value_nm: of_segment(estimate, place.number, MOTIONS[0]),
    });
    each.collect()
}

fn maps(estimate: &Estimate) -> Result<String> {
    let mut figures = vec![
        html::map("Phasing", estimate.maps.phasing_nm.view(), Colours::Diverging(0.0), "nm")?,
        html::map("Phasing, error bar", estimate.sigma_maps.phasing_nm.view(), Colours::Sequential, "nm")?,
        html::map("NCPA", estimate.maps.ncpa_nm.view(), Colours::Diverging(0.0), "nm")?,
        html::map("NCPA, error bar", estimate.sigma_maps.ncpa_nm.view(), Colours::Sequential, "nm")?,
    ];
    if let Some((_, residual)) = &estimate.truth {
        for (title, map) in [
            ("Phasing, estimate less truth", &residual.maps.phasing_nm),
            ("NCPA, estimate less truth", &residual.maps.ncpa_nm),
        ] {
            figures.push(html::map(title, map.view(), Colours::Diverging(0.0), "nm")?);
        }
    }
    Ok(html::row(&figures))
}

fn images(image: &FittedImage) -> Result<String> {
    let both = [image.data_e.view(), image.model_e.view()];
    Ok(html::row(&[
        html::map("Image", both[0], Colours::Light(&both), "electrons")?,
        html::map("Model", both[1], Colours::Light(&both), "electrons")?,
        html::map("Residual", image.residual_sigma.view(), Colours::Diverging(3.0), "σ")?,
    ]))
}

fn segment_table(estimate: &Estimate, segments: &[SegmentValue]) -> String {
    let motions: Vec<&str> = MOTIONS.into_iter().filter(|motion| of_segment(estimate, 0, motion).is_some()).collect();
    if motions.is_empty() {
        return html::table(&[], 0, &[], "The estimate has no modes of single segments.");
    }
    let columns: Vec<String> =
        motions.iter().flat_map(|motion| [format!("{motion}, nm"), "error bar, nm".into()]).collect();
    let headers: Vec<&str> = ["segment", "label"].into_iter().chain(columns.iter().map(String::as_str)).collect();
    let row = |(number, segment): (usize, &SegmentValue)| {
        let values = motions.iter().flat_map(|motion| of_segment(estimate, number, motion).unwrap_or([f64::NAN; 2]));
        [number.to_string(), segment.label.clone()].into_iter().chain(values.map(nm)).collect()
    };
    let rows: Vec<Vec<String>> = segments.iter().enumerate().map(row).collect();
    html::table(&headers, 0, &rows, "none")
}

fn mode_table(estimate: &Estimate) -> String {
    let modes = estimate.basis.names.iter().zip(&estimate.modes.coefficients_nm).zip(estimate.modes.sigma_nm());
    let rows: Vec<Vec<String>> =
        modes.map(|((name, value), sigma_nm)| vec![name.clone(), nm(*value), nm(sigma_nm)]).collect();
    html::table(&["mode", "coefficient, nm", "error bar, nm"], 1, &rows, "none")
}

/// A number of a table; picometres are below all error bars.
fn nm(value: f64) -> String {
    if value.is_finite() { format!("{value:.3}") } else { "–".into() }
}
