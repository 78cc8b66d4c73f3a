//! First scene of an instrument, from the header of one of its frames.

use super::aot_scene;
use super::cut_out::CutOut;
use super::frame::{Cards, FrameHeader};
use super::scene_text::{Lines, UNKNOWN, counted, float, printable};
use super::star;
use crate::io::{self, FitsReader, HeaderFact, PixelUnit, Quantity};
use crate::scene::{MAS_PER_RADIAN, Scene};
use crate::{Error, Result};
use ndarray::{ArrayView2, Axis};
use std::path::Path;

/// Telescopes that a preset describes: what their name begins with, the preset, what the preset
/// leaves out.
const TELESCOPES: [(&[&str], &str, &str); 6] = [
    (
        &["KECK", "W. M. KECK"],
        "keck-nirc2",
        "of a source on the bench neither the secondary nor its spider hides a part: 0 for both then",
    ),
    (&["JWST"], "jwst-pair", ""),
    (
        &["GTC", "GRANTECAN", "GRAN TELESCOPIO"],
        "gtc-artificial",
        "the vanes of the secondary mirror, which lie over gaps",
    ),
    (&["TMT", "THIRTY METER"], "tmt-onsky", ""),
    (&["ELT", "ESO-ELT", "E-ELT"], "elt-onsky", ""),
    (&["GMT", "GIANT MAGELLAN"], "gmt", ""),
];

/// Pixels of cameras whose headers do not have them: name of the instrument, of the camera, mas.
/// NIRC2: Yelda et al. 2010 (ApJ 725, 331) and Service et al. 2016 (PASP 128, 095004; 9.971 mas
/// since April 2015) for the narrow camera; its manual for the others.
const CAMERAS: [(&str, &str, f64); 3] =
    [("NIRC2", "NARROW", 9.952), ("NIRC2", "MEDIUM", 19.829), ("NIRC2", "WIDE", 39.686)];

/// Sections of a preset beside its pupil, and what is to be filled in where they stand for those of
/// an unknown telescope.
const OTHERS: [(&str, &str); 3] = [
    ("modes", "the modes; these are those of Keck, KL modes of the mirror below"),
    ("mirror", "the deformable mirror, which gives the KL modes; this is that of Keck"),
    ("turbulence", "the turbulence, which gives the order of the KL modes; this is that of Keck"),
];

/// Text of a scene for the frames of which `path` is one: the telescope of `TELESCOP`, and what the
/// header states of the camera; for a file of AOT telescope, camera, turbulence and loop as its
/// tables state them. A line on what is not known says so in its comment. The scene is valid as it
/// is.
///
/// # Errors
/// Those of [`io::read_images`]; [`Error::Scene`] for a header whose values a scene does not
/// accept.
pub fn first_scene(path: &Path) -> Result<String> {
    let mut file = FitsReader::open(path)?;
    let is_aot = io::aot::is_aot(&file);
    // Of several cameras of AOT the first.
    let images = if is_aot { io::read_channels(path, None)?.swap_remove(0) } else { io::read_images(path, None)? };
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let system = is_aot.then(|| aot_scene::sections(&mut file, &name)).transpose()?;
    let mut cards = Cards { file: &mut file, hdu: images.hdu_name };
    let header = cards.header(images.unit, images.facts, None);
    let instrument = ["CURRINST", "INSTRUME"].iter().find_map(|key| cards.text(key)).unwrap_or_default();
    let camera = cards.text("CAMNAME").unwrap_or_default();
    let (telescope, pupil, others, grid_m) = match system {
        Some(system) => (system.telescope, system.pupil, system.others, system.grid_m),
        None => of_preset(&cards.text("TELESCOP").unwrap_or_default())?,
    };
    let mut text = format!(
        "# First scene of {} at {}, from {} (cophase scene --from). What the file does not say is marked:\n\
         # {UNKNOWN}. \"cophase scene --reference\" describes every key.\n{pupil}",
        if instrument.is_empty() { "an unknown instrument" } else { &instrument },
        if telescope.is_empty() { "an unknown telescope" } else { &telescope },
        printable(&name),
    );
    text += &image(is_aot, &header, grid_m, images.data.index_axis(Axis(0), 0), (&instrument, &camera), &mut cards)?;
    text += &others;
    // The text is made of values that were read, which a scene need not accept.
    Scene::from_text(&text, Path::new("")).map(|_| text).map_err(|error| match error {
        Error::Scene(reason) => Error::Scene(format!("{} gives no scene: {reason}", path.display())),
        other => other,
    })
}

/// Telescope, section `[pupil]`, other sections and grid of the preset for a telescope.
fn of_preset(telescope: &str) -> Result<(String, String, String, f64)> {
    let found =
        TELESCOPES.iter().find(|(names, ..)| names.iter().any(|name| telescope.to_uppercase().starts_with(name)));
    let (preset, remark) = found.map_or(("keck-artificial", ""), |(_, preset, remark)| (*preset, *remark));
    let whose = match found {
        None => format!(
            "# {UNKNOWN}: the pupil of the telescope; this is that of Keck, because TELESCOP = '{}' is not known\n",
            printable(telescope)
        ),
        Some(_) if remark.is_empty() => String::new(),
        Some(_) => format!("# {UNKNOWN}: {remark}\n"),
    };
    let pupil = format!("\n[pupil]\n{whose}{}", section(Scene::preset_text(preset)?, "pupil"));
    let mut others = String::new();
    for (part, what) in OTHERS {
        let keys = section(Scene::preset_text(preset)?, part);
        let whose = if found.is_none() { format!("# {UNKNOWN}: {what}\n") } else { String::new() };
        if !keys.is_empty() {
            others += &format!("\n[{part}]\n{whose}{keys}");
        }
    }
    Ok((telescope.to_owned(), pupil, others, Scene::preset(preset)?.pupil.grid_m.unwrap_or(1.0)))
}

/// The section `[image]`; `is_cut_out`: the images are as an estimate takes them, and not raw
/// frames.
fn image(
    is_cut_out: bool,
    header: &FrameHeader,
    grid_m: f64,
    frame: ArrayView2<f64>,
    (instrument, camera): (&str, &str),
    cards: &mut Cards,
) -> Result<String> {
    let (rows, columns) = frame.dim();
    let mut lines = Lines::of_section("image");
    let mut line = |key: &str, value: String, comment: String| lines.add(key, value, &comment);
    let of = |quantity: Quantity| header.facts.iter().find(|fact| fact.quantity == quantity && fact.values.len() == 1);
    let card = |fact: &HeaderFact| format!("card {} = {}", fact.keyword, fact.written);
    let (wavelength_nm, comment) = match (of(Quantity::WavelengthNm), of(Quantity::BandNm)) {
        (Some(fact), _) => (fact.values[0], card(fact)),
        (None, Some(fact)) => {
            (fact.values[0], format!("{UNKNOWN}: the exact one; this is the centre of the band in {}", card(fact)))
        }
        (None, None) => (2168.6, format!("{UNKNOWN}: no card has the wavelength")),
    };
    line("wavelength_nm", float(wavelength_nm), comment);
    let width =
        cards.number("MINWAVE").zip(cards.number("MAXWAVE")).map(|(least, most)| 2.0 * (most - least) / (most + least));
    match width.filter(|width| (1e-4..=0.5).contains(width)) {
        Some(width) => line("bandwidth_fraction", format!("{width:.4}"), "cards MINWAVE, MAXWAVE".into()),
        None => line(
            "bandwidth_fraction",
            "0.0".into(),
            format!("{UNKNOWN}: width of the filter over its wavelength; 0 is monochromatic"),
        ),
    }
    let of_camera = CAMERAS
        .iter()
        .find(|(of, name, _)| instrument.to_uppercase().starts_with(of) && camera.to_uppercase() == *name);
    let (pixel_mas, comment) = match (of(Quantity::PixelMas), of_camera) {
        (Some(fact), _) => (fact.values[0], card(fact)),
        (None, Some((_, name, mas))) => (*mas, format!("{instrument}, camera {name}")),
        (None, None) => (10.0, format!("{UNKNOWN}: no card has the pixel scale; pixels of 10 mas are assumed")),
    };
    let sampling = wavelength_nm * 1e-9 / grid_m * MAS_PER_RADIAN / pixel_mas;
    line("pixel_mas", float(pixel_mas), format!("{comment}; {sampling:.3} pixels per lambda/grid_m"));
    if is_cut_out {
        line("pixels", columns.to_string(), String::new());
        if rows != columns {
            line("rows", rows.to_string(), String::new());
        }
    } else {
        // An even square that holds some 100 lambda/D, with the spot of 1.5 waves of defocus in it,
        // and fits about the star.
        let side = (rows.min(columns) / 2 * 2).min((100.0 * sampling / 2.0).ceil() as usize * 2);
        let fits = star::find(&frame.to_owned(), side)
            .map_or(side, |star| CutOut::largest_side((star.x, star.y), (rows, columns)));
        let side = side.min(fits).clamp(8, 8192);
        line("pixels", side.to_string(), format!("cut-out about the star; the frame has {columns}x{rows}"));
    }
    match (header.itime_s, of(Quantity::ExposureS).filter(|fact| fact.values[0] > 0.0)) {
        (Some(itime_s), _) => {
            let comment = format!("{} of {itime_s} s", counted(header.coadds as usize, "coadd"));
            line("exposure_s", float(itime_s * f64::from(header.coadds)), comment);
        }
        (None, Some(fact)) => line("exposure_s", float(fact.values[0]), card(fact)),
        (None, None) => line("exposure_s", "1.0".into(), format!("{UNKNOWN}: no card has the exposure")),
    }
    let focus = format!("{UNKNOWN}: defocus of the images, waves RMS over the pupil, positive at its edge");
    line("diversity_focus_waves_rms", "1.5".into(), focus);
    match of(Quantity::ReadNoiseE) {
        Some(fact) => line("read_noise_e", float(fact.values[0]), card(fact)),
        None => line(
            "read_noise_e",
            "60.0".into(),
            format!("{UNKNOWN}: read noise of one coadd; darks, where there are any, are used in its place"),
        ),
    }
    // Images in electrons have neither a gain nor a level in counts.
    if header.unit == PixelUnit::Electrons {
        return Ok(lines.text);
    }
    match of(Quantity::GainEPerAdu).filter(|fact| fact.values[0] > 0.0) {
        Some(fact) => {
            line("gain_e_per_adu", float(fact.values[0]), format!("{}; to be checked: it may be a setting", card(fact)))
        }
        None => line("gain_e_per_adu", "1.0".into(), format!("{UNKNOWN}: electrons per count")),
    }
    match header.saturation_adu {
        Some(counts) => line("saturation_adu", float(counts), "counts of one coadd, from the header".into()),
        None => line("saturation_adu", "1e9".into(), format!("{UNKNOWN}: counts of one coadd that are saturated")),
    }
    Ok(lines.text)
}

/// The lines of a section of a preset, without its header.
fn section(text: &str, name: &str) -> String {
    let header = format!("[{name}]");
    let lines = text.lines().skip_while(|line| !line.starts_with(&header)).skip(1);
    let own: Vec<&str> =
        lines.take_while(|line| !line.starts_with('[')).filter(|line| !line.trim().is_empty()).collect();
    own.iter().map(|line| format!("{line}\n")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_section_of_an_unknown_telescope_is_marked() {
        let marked = |telescope: &str| {
            let (_, pupil, others, _) = of_preset(telescope).unwrap();
            let text = pupil + &others;
            let sections: Vec<&str> = text.split("\n[").skip(1).collect();
            assert!(sections.len() > 3, "{text}");
            sections.iter().filter(|section| section.contains(UNKNOWN)).count() as f64 / sections.len() as f64
        };
        assert_eq!(marked("Mount Unknown"), 1.0);
        // Of a telescope that is known only the parts of its pupil are to be checked.
        assert!(marked("KECK II") < 0.5);
    }
}
