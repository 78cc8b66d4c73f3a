//! Export of a night from its store, also while a watch runs: FITS with all vectors, CSV with a row
//! for each frame, or an HTML report.

use crate::store::{About, Columns, Reader, StoredCorrection, StoredFrame};
use crate::{clock, report};
use cophase::io::{Column, FitsWriter, Pixel, write_atomically};
use cophase::{Error, Result};
use ndarray::Array2;
use std::path::Path;

/// Frames that are read at once.
const CHUNK: usize = 1000;

/// Writes the night in the file `state` to `output`, by its extension. Gives the number of frames,
/// and the sentence that some may be missing.
///
/// # Errors
/// [`Error::File`] for another extension than `.fits`, `.fits.gz`, `.csv` and `.html`, for a file
/// that is no store, and where the output cannot be written. What was there stays then.
pub fn export(state: &Path, output: &Path) -> Result<(usize, Option<String>)> {
    let name = output.file_name().map(|name| name.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let (is_csv, is_report) = (name.ends_with(".csv"), name.ends_with(".html"));
    if !is_csv && !is_report && !name.ends_with(".fits") && !name.ends_with(".fits.gz") {
        return Err(Error::file(output, "a night is exported to a .fits, .fits.gz, .csv or .html file"));
    }
    let reader = Reader::open(state)?;
    let (about, mut frames) = (reader.about()?, Vec::new());
    loop {
        let after = frames.last().map_or(0, |frame: &StoredFrame| frame.id);
        let chunk = reader.frames_after(after, CHUNK, Columns::All)?;
        if chunk.is_empty() {
            break;
        }
        frames.extend(chunk);
    }
    if is_report {
        report::write(output, state, &about, &frames, &reader)?
    } else if is_csv {
        write_csv(output, &about, &frames)?
    } else {
        write_fits(output, &about, &frames, &reader)?
    }
    Ok((frames.len(), reader.incomplete().map(str::to_owned)))
}

/// The vectors of a frame, with the word that their columns and HDUs end with.
type Vector = (&'static str, fn(&StoredFrame) -> &[f64]);
const VECTORS: [Vector; 4] = [
    ("nm", |frame| &frame.coefficients_nm),
    ("sigma_nm", |frame| &frame.sigma_nm),
    ("tracked_nm", |frame| &frame.tracked_nm),
    ("tracked_sigma_nm", |frame| &frame.tracked_sigma_nm),
];

fn write_csv(output: &Path, about: &About, frames: &[StoredFrame]) -> Result<()> {
    let mut text = String::from(
        "frame,name,image,observed,observed_s,status,reason,fit,reduced_chi2,flux_e,background_e,phasing_rms_nm,ncpa_rms_nm,pointing_x_pixels,\
         pointing_y_pixels,latency_s,warnings",
    );
    for (suffix, _) in VECTORS {
        for mode in &about.modes {
            text.push_str(&format!(",{}", quoted(&format!("{mode}_{suffix}"))));
        }
    }
    text.push_str("\r\n");
    for frame in frames {
        let number = |value: Option<f64>| value.map(|value| value.to_string()).unwrap_or_default();
        let cells = [
            frame.id.to_string(),
            quoted(&frame.name),
            frame.image.to_string(),
            clock::to_iso(frame.observed_s),
            frame.observed_s.to_string(),
            frame.status.clone(),
            quoted(frame.reason.as_deref().unwrap_or_default()),
            quoted(frame.fit.as_deref().unwrap_or_default()),
            number(frame.chi2),
            number(frame.flux_e),
            number(frame.background_e),
            number(frame.phasing_rms_nm),
            number(frame.ncpa_rms_nm),
            number(frame.pointing_x_pixels),
            number(frame.pointing_y_pixels),
            number(frame.latency_s),
            quoted(&frame.warnings.join("; ")),
        ];
        text.push_str(&cells.join(","));
        for (_, vector) in VECTORS {
            let values = vector(frame);
            for mode in 0..about.modes.len() {
                text.push(',');
                text.push_str(&number(values.get(mode).copied()));
            }
        }
        text.push_str("\r\n");
    }
    write_atomically(output, text.as_bytes())
}

/// A cell as RFC 4180 has it.
fn quoted(text: &str) -> String {
    if text.contains(['"', ',', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}

fn write_fits(output: &Path, about: &About, frames: &[StoredFrame], reader: &Reader) -> Result<()> {
    let mut file = FitsWriter::create(output)?;
    file.card("PRIMARY", "POLICY", about.policy.as_str(), "how frames were estimated")?;
    file.card("PRIMARY", "NSEGMODE", about.segment_modes as i64, "segment modes; they come first")?;
    let real = |value: fn(&StoredFrame) -> Option<f64>| frames.iter().map(|f| value(f).unwrap_or(f64::NAN)).collect();
    let text = |value: fn(&StoredFrame) -> &str| frames.iter().map(value).collect::<Vec<_>>();
    file.table(
        "FRAMES",
        &[
            Column::i64("FRAME", frames.iter().map(|frame| frame.id).collect()),
            Column::text("NAME", text(|frame| &frame.name)),
            Column::i64("IMAGE", frames.iter().map(|frame| frame.image).collect()),
            Column::text("DATE", frames.iter().map(|frame| clock::to_iso(frame.observed_s))),
            Column::f64("OBSERVED", "s", real(|frame| Some(frame.observed_s))),
            Column::text("STATUS", text(|frame| &frame.status)),
            Column::text("REASON", text(|frame| frame.reason.as_deref().unwrap_or_default())),
            Column::text("FIT", text(|frame| frame.fit.as_deref().unwrap_or_default())),
            Column::f64("CHI2", "", real(|frame| frame.chi2)),
            Column::f64("FLUX", cophase::io::ELECTRON, real(|frame| frame.flux_e)),
            Column::f64("PHASING", "nm", real(|frame| frame.phasing_rms_nm)),
            Column::f64("NCPA", "nm", real(|frame| frame.ncpa_rms_nm)),
            Column::f64("POINTING_X", "pixel", real(|frame| frame.pointing_x_pixels)),
            Column::f64("POINTING_Y", "pixel", real(|frame| frame.pointing_y_pixels)),
            Column::f64("LATENCY", "s", real(|frame| frame.latency_s)),
            Column::text("WARNINGS", frames.iter().map(|frame| frame.warnings.join("; "))),
        ],
    )?;
    file.table("MODES", &[Column::text("NAME", &about.modes)])?;
    for (hdu, (_, vector)) in ["COEFFICIENTS", "SIGMA", "TRACKED", "TRACKED_SIGMA"].into_iter().zip(VECTORS) {
        let value = |(frame, mode): (usize, usize)| vector(&frames[frame]).get(mode).copied().unwrap_or(f64::NAN);
        // An image has at least one row.
        if !frames.is_empty() {
            file.image(hdu, &Array2::from_shape_fn((frames.len(), about.modes.len()), value), Pixel::F64, "nm")?;
        }
    }
    let mut events = reader.events(usize::MAX >> 1)?;
    events.reverse();
    file.table(
        "EVENTS",
        &[
            Column::f64("TIME", "s", events.iter().map(|event| event.time_s).collect()),
            Column::text("KIND", events.iter().map(|event| &event.kind)),
            Column::text("SENTENCE", events.iter().map(|event| &event.sentence)),
            Column::i64("FRAME", events.iter().map(|event| event.frame.unwrap_or(0)).collect()),
            Column::i64("SEGMENT", events.iter().map(|event| event.segment.unwrap_or(-1)).collect()),
            Column::f64("SIZE", "nm", events.iter().map(|event| event.size_nm.unwrap_or(f64::NAN)).collect()),
            Column::f64("SIGMA", "nm", events.iter().map(|event| event.size_error_nm.unwrap_or(f64::NAN)).collect()),
            Column::f64("SINCE", "s", events.iter().map(|event| event.since_s.unwrap_or(f64::NAN)).collect()),
        ],
    )?;
    write_corrections(&mut file, about, reader)?;
    file.text("SCENE", &about.scene)?;
    file.finish()
}

/// The table `CORRECTIONS`, and the image `CORRECTION_CHANGES` of what each changes of the
/// coefficients.
fn write_corrections(file: &mut FitsWriter, about: &About, reader: &Reader) -> Result<()> {
    let mut corrections = reader.corrections(usize::MAX >> 1)?;
    corrections.reverse();
    let real = |value: fn(&StoredCorrection) -> f64| corrections.iter().map(value).collect();
    let integer = |value: fn(&StoredCorrection) -> i64| corrections.iter().map(value).collect();
    file.table(
        "CORRECTIONS",
        &[
            Column::i64("NUMBER", integer(|one| one.number)),
            Column::i64("FRAME", integer(|one| one.frame)),
            Column::f64("WRITTEN", "s", real(|one| one.written_s)),
            Column::f64("PHASING", "nm", real(|one| one.phasing_rms_nm)),
            Column::f64("NCPA", "nm", real(|one| one.ncpa_rms_nm)),
            Column::i64("SEGMODES", integer(|one| one.segment_modes)),
            Column::i64("NCPAMODE", integer(|one| one.ncpa_modes)),
            Column::i64("REPLACED", integer(|one| one.replaced_by.unwrap_or(0))),
            Column::i64("APPLIED", integer(|one| one.applied_frame.unwrap_or(0))),
            Column::f64("APPLIED_AT", "s", real(|one| one.applied_s.unwrap_or(f64::NAN))),
            Column::text("PART", corrections.iter().map(|one| one.applied_part.as_deref().unwrap_or_default())),
            Column::f64("FRACTION", "", real(|one| one.applied_fraction.unwrap_or(f64::NAN))),
            Column::f64("FRACTION_SIGMA", "", real(|one| one.applied_fraction_error.unwrap_or(f64::NAN))),
        ],
    )?;
    if !corrections.is_empty() {
        let value = |(row, mode): (usize, usize)| corrections[row].change_nm.get(mode).copied().unwrap_or(f64::NAN);
        let changes_nm = Array2::from_shape_fn((corrections.len(), about.modes.len()), value);
        file.image("CORRECTION_CHANGES", &changes_nm, Pixel::F64, "nm")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn cells_are_quoted() {
        for (text, cell) in
            [("plain", "plain"), ("a,b", "\"a,b\""), ("say \"a\"", "\"say \"\"a\"\"\""), ("a\nb", "\"a\nb\"")]
        {
            assert_eq!(super::quoted(text), cell);
        }
    }
}
