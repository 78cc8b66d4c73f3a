//! The report of a night as one HTML file: what is wrong first, then what was measured.

use crate::clock;
use crate::pointing;
use crate::store::{About, Reader, StoredCorrection, StoredFrame};
use cophase::Result;
use cophase::io::write_atomically;
use cophase_view::html::{self, Curve, SegmentValue};
use serde_json::Value;
use std::path::Path;

/// Kinds of events that a person must see.
const ALARMS: [&str; 4] = ["segment", "wavefront", "pointing", "disk"];
/// Points of a curve: what a screen shows. A longer night is thinned.
const MOST_POINTS: usize = 2000;

/// Writes the report of the night in the store `state`, with its `frames`, to `output`.
pub(super) fn write(output: &Path, state: &Path, about: &About, frames: &[StoredFrame], reader: &Reader) -> Result<()> {
    let all = usize::MAX >> 1;
    let mut events = reader.events(all)?;
    events.reverse();
    let mut corrections = reader.corrections(all)?;
    corrections.reverse();
    let done: Vec<&StoredFrame> = frames.iter().filter(|frame| frame.status == "done").collect();
    let refused: Vec<&StoredFrame> = frames.iter().filter(|frame| frame.status != "done").collect();
    let alarms = events.iter().filter(|event| ALARMS.contains(&event.kind.as_str()));
    let alarms: Vec<String> = alarms.map(|event| format!("{} {}", time(event.time_s), event.sentence)).collect();
    let mut sections = vec![
        html::section("Alarms", &html::list("alarm", &alarms, "None.")),
        html::section("Night", &figures(about, &done, refused.len(), corrections.len())),
    ];
    let segments = segments(about, done.last().copied());
    if !segments.is_empty() {
        let text = "After the last frame, tracked.";
        sections.push(html::section("Mirror", &format!("{}<p>{text}</p>", html::mirror(&segments))));
        let note = "Error bars hold noise and drift. Errors that all frames share, of the scene and of what the modes leave out, are \
                    not in them: cophase estimate has these.";
        sections.push(html::section("Segments", &format!("{}<p>{note}</p>", segment_table(&segments))));
    }
    sections.push(html::section("Trends", &trends(&done)));
    let rows: Vec<Vec<String>> =
        events.iter().map(|event| vec![time(event.time_s), event.kind.clone(), event.sentence.clone()]).collect();
    sections.push(html::section("Events", &html::table(&["time", "kind", "event"], 3, &rows, "None.")));
    sections.push(html::section("Corrections", &correction_table(&corrections)));
    let rows: Vec<Vec<String>> = refused
        .iter()
        .map(|frame| {
            let reason = frame.reason.clone().unwrap_or_default();
            vec![time(frame.observed_s), name(frame), frame.fit.clone().unwrap_or_default(), reason]
        })
        .collect();
    sections
        .push(html::section("Refused frames", &html::table(&["time", "frame", "fit", "reason"], 4, &rows, "None.")));
    sections.push(html::section("Settings", &html::folded("The scene", &about.scene)));
    let title = state.file_name().unwrap_or(state.as_os_str()).to_string_lossy();
    write_atomically(output, html::page(&format!("Night watch {title}"), &sections).as_bytes())
}

/// Date and time to the second, UTC.
fn time(seconds: f64) -> String {
    let iso = clock::to_iso(seconds);
    iso.get(..19).map_or(iso.clone(), |time| time.replace('T', " "))
}

fn name(frame: &StoredFrame) -> String {
    if frame.image > 0 { format!("{} image {}", frame.name, frame.image) } else { frame.name.clone() }
}

fn figures(about: &About, done: &[&StoredFrame], refused: usize, corrections: usize) -> String {
    let observed = |frame: Option<&&StoredFrame>| frame.map_or("–".into(), |frame| time(frame.observed_s));
    let last = |value: fn(&StoredFrame) -> Option<f64>| done.last().and_then(|frame| value(frame));
    let nm = |value: Option<f64>| value.map_or("–".into(), |nm| format!("{nm:.2} nm RMS"));
    let pointing = pointing::rms_pixels(done.iter().copied());
    let pointing = pointing.map_or("–".into(), |pixels| format!("{pixels:.3} pixels RMS"));
    html::figures(&[
        ("frames with an estimate", done.len().to_string()),
        ("frames refused", refused.to_string()),
        ("corrections written", corrections.to_string()),
        ("first frame", observed(done.first())),
        ("last frame", observed(done.last())),
        ("phasing of the last frame", nm(last(|frame| frame.phasing_rms_nm))),
        ("NCPA of the last frame", nm(last(|frame| frame.ncpa_rms_nm))),
        ("pointing", pointing),
        ("policy", about.policy.clone()),
        ("source", about.source.clone()),
    ])
}

/// Segments with the tracked pistons of `frame`.
fn segments(about: &About, frame: Option<&StoredFrame>) -> Vec<SegmentValue> {
    let geometry: Value = serde_json::from_str(&about.segments).unwrap_or_default();
    let centres = geometry["centres_m"].as_array().cloned().unwrap_or_default();
    let value_nm = |segment: usize| {
        let mode = about.modes.iter().position(|name| {
            let number = name.strip_prefix("segment-").and_then(|rest| rest.strip_suffix("-piston"));
            number.and_then(|number| number.parse().ok()) == Some(segment)
        })?;
        let frame = frame?;
        Some([*frame.tracked_nm.get(mode)?, *frame.tracked_sigma_nm.get(mode)?])
    };
    let each = centres.iter().enumerate();
    each.map(|(segment, centre)| SegmentValue {
        label: match &geometry["labels"][segment] {
            Value::String(word) => word.clone(),
            Value::Number(number) => number.to_string(),
            _ => segment.to_string(),
        },
        centre_m: [0, 1].map(|axis| centre[axis].as_f64().unwrap_or(0.0)),
        value_nm: value_nm(segment),
    })
    .collect()
}

fn segment_table(segments: &[SegmentValue]) -> String {
    let row = |segment: &SegmentValue| {
        let [nm, sigma_nm] =
            segment.value_nm.map_or(["–".into(), "–".into()], |pair| pair.map(|nm| format!("{nm:.3}")));
        vec![segment.label.clone(), nm, sigma_nm]
    };
    let rows: Vec<Vec<String>> = segments.iter().map(row).collect();
    html::table(&["segment", "tracked piston, nm", "error bar, nm"], 0, &rows, "None.")
}

fn trends(done: &[&StoredFrame]) -> String {
    let step = done.len().div_ceil(MOST_POINTS).max(1);
    let thinned: Vec<&StoredFrame> = done.iter().step_by(step).copied().collect();
    let times_s: Vec<f64> = thinned.iter().map(|frame| frame.observed_s).collect();
    let clock = |seconds: f64| clock::to_iso(seconds).get(11..19).unwrap_or_default().to_owned();
    let trend = |title: &str, value: fn(&StoredFrame) -> Option<f64>| {
        let values: Vec<Option<f64>> = thinned.iter().map(|frame| value(frame)).collect();
        html::curve(title, &times_s, &[Curve { values: &values, dotted: true }], &clock)
    };
    let mut figures = vec![
        trend("Phasing of single frames, nm RMS", |frame| frame.phasing_rms_nm),
        trend("NCPA of single frames, nm RMS", |frame| frame.ncpa_rms_nm),
        trend("Reduced χ²", |frame| frame.chi2),
        trend("Flux, electrons", |frame| frame.flux_e),
        trend("Pointing along x, pixels", |frame| frame.pointing_x_pixels),
        trend("Pointing along y, pixels", |frame| frame.pointing_y_pixels),
    ];
    if step > 1 {
        figures.push(format!("<p class=\"none\">Every {step}th frame is shown.</p>"));
    }
    html::row(&figures)
}

fn correction_table(corrections: &[StoredCorrection]) -> String {
    let row = |one: &StoredCorrection| {
        let applied = match (one.applied_s, one.replaced_by) {
            (Some(applied_s), _) => {
                let percent = |fraction: Option<f64>| fraction.map_or(f64::NAN, |fraction| 100.0 * fraction);
                let [part, error] = [one.applied_fraction, one.applied_fraction_error].map(percent);
                let what = one.applied_part.as_deref().unwrap_or_default();
                format!("{} ({what}, {part:.1} ± {error:.1} %)", time(applied_s))
            }
            (None, Some(number)) => format!("replaced by {number}"),
            (None, None) => "not yet".into(),
        };
        vec![
            one.number.to_string(),
            time(one.written_s),
            applied,
            one.frame.to_string(),
            format!("{:.2}", one.phasing_rms_nm),
            format!("{:.2}", one.ncpa_rms_nm),
        ]
    };
    let rows: Vec<Vec<String>> = corrections.iter().map(row).collect();
    let headers = ["number", "written", "applied", "after frame", "phasing, nm RMS", "NCPA, nm RMS"];
    html::table(&headers, 3, &rows, "None.")
}
