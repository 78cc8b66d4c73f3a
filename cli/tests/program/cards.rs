//! Cards, masks and tables as cameras, observatories and other programs write them.

use crate::{Desk, number};
use cophase::io::{Card, FitsReader, FitsWriter, Pixel};
use ndarray::Array2;

impl Desk {
    /// Writes the first of the images over `divisor`, with cards of these values and comments in
    /// the HDU and in the primary one.
    fn write_frame(&self, name: &str, divisor: f64, own: &[(&str, Card, &str)], primary: &[(&str, Card, &str)]) {
        let images = FitsReader::open(self.path("images.fits")).unwrap().cube("IMAGES").unwrap();
        let mut file = FitsWriter::create(self.path(name)).unwrap();
        file.image("SCI", &(images / divisor), Pixel::F32, "").unwrap();
        for (hdu, cards) in [("SCI", own), ("PRIMARY", primary)] {
            for (key, value, comment) in cards {
                file.card(hdu, key, value.clone(), comment).unwrap();
            }
        }
        file.finish().unwrap();
    }

    /// Replaces the bytes `from`, which are there once, of a file.
    fn replace_bytes(&self, name: &str, from: &[u8], to: &[u8]) {
        assert_eq!(from.len(), to.len());
        let mut bytes = std::fs::read(self.path(name)).unwrap();
        let at = bytes.windows(from.len()).position(|window| window == from).unwrap();
        bytes[at..at + to.len()].copy_from_slice(to);
        std::fs::write(self.path(name), bytes).unwrap();
    }

    /// The line of the key in the first scene of a file.
    fn first_scene(&self, name: &str, key: &str) -> String {
        let text = self.succeeds(&["scene", "--from", name]).out;
        text.lines().find(|line| line.starts_with(key)).unwrap_or_else(|| panic!("no {key}: {text}")).to_owned()
    }
}

const ESTIMATE: [&str; 5] = ["estimate", "--scene", "scene.toml", "-o", "est.fits"];

fn estimate(images: &str) -> Vec<&str> {
    [&ESTIMATE[..], &[images]].concat()
}

#[test]
fn units_outside_ascii_are_understood() {
    let desk = Desk::with_images(&[]);
    for (written, bytes) in [("1.640 @m", &b"1.640 \xb5m"[..]), ("1.640 @@m", "1.640 µm".as_bytes())] {
        desk.write_frame("frame.fits", 1.0, &[("BUNIT", "electron".into(), ""), ("WAVELEN", written.into(), "")], &[]);
        desk.replace_bytes("frame.fits", written.as_bytes(), bytes);
        let line = desk.first_scene("frame.fits", "wavelength_nm");
        assert!(line.starts_with("wavelength_nm = 1640.0 "), "{line}");
        desk.refuses(&estimate("frame.fits"), &["WAVELEN = 1.640 um", "image.wavelength_nm = 2000"]);
    }
    // In a comment.
    desk.write_frame("frame.fits", 1.0, &[("ITIME", 20_000.into(), "[@s] of a coadd")], &[]);
    desk.replace_bytes("frame.fits", b"[@s]", b"[\xb5s]");
    assert!(desk.first_scene("frame.fits", "exposure_s").starts_with("exposure_s = 0.02 "));
}

#[test]
fn units_of_values_and_comments_are_read() {
    let desk = Desk::with_images(&[]);
    let itime = |value: i64, comment: &'static str| ("ITIME", Card::Integer(value), comment);
    let coadds = ("COADDS", Card::Integer(10), "");
    for (cards, key, expected) in [
        (vec![itime(1476, "integration time (ms)"), coadds.clone()], "exposure_s", "exposure_s = 14.76 "),
        (
            vec![itime(1476, ""), ("TRUITIME", Card::Real(1.476), "true (s)"), coadds],
            "exposure_s",
            "exposure_s = 14.76 ",
        ),
        (vec![("EXPTIME", Card::Integer(10_000), "exposure in microseconds")], "exposure_s", "exposure_s = 0.01 "),
        (vec![("EXPTIME", Card::Integer(10), "[ms]")], "exposure_s", "exposure_s = 0.01 "),
        (vec![("EXPTIME", Card::Integer(2), "[min]")], "exposure_s", "exposure_s = 120.0 "),
        (vec![("GAIN", Card::Real(0.125), "[ADU/e-] conversion factor")], "gain_e_per_adu", "gain_e_per_adu = 8.0 "),
        (vec![("GAIN", "0.125 ADU per electron".into(), "")], "gain_e_per_adu", "gain_e_per_adu = 8.0 "),
        (vec![("GAIN", Card::Real(8.0), "[e-/ADU]")], "gain_e_per_adu", "gain_e_per_adu = 8.0 "),
        (vec![("GAIN", Card::Integer(120), "gain setting")], "gain_e_per_adu", "gain_e_per_adu = 1.0 "),
        (
            vec![("GAIN", Card::Integer(8), ""), ("RDNOISE", Card::Real(2.5), "[ADU]")],
            "read_noise_e",
            "read_noise_e = 20.0 ",
        ),
        (vec![("PIXSCALE", Card::Real(25.0), "[pix/arcsec]")], "pixel_mas", "pixel_mas = 40.0 "),
    ] {
        desk.write_frame("frame.fits", 1.0, &cards, &[]);
        let line = desk.first_scene("frame.fits", key);
        assert!(line.starts_with(expected), "{cards:?}: {line}");
    }
}

#[test]
fn unit_of_pixels_is_inherited_from_the_primary_hdu() {
    let desk = Desk::with_images(&[]);
    let rms = |images: &str| number(&desk.json(&[&estimate(images)[..], &["--json"]].concat()), "phasing_rms_nm");
    let clean = rms("images.fits");
    let (adu, gain) = (("BUNIT", Card::from("adu"), ""), ("GAIN", Card::Real(20.0), ""));
    desk.write_frame("frame.fits", 20.0, &[], &[adu.clone(), gain.clone()]);
    // Pixels are of single precision in this file.
    assert!((rms("frame.fits") - clean).abs() < 1e-3);
    desk.write_frame("frame.fits", 20.0, &[], std::slice::from_ref(&adu));
    desk.refuses(&estimate("frame.fits"), &["in counts", "image.gain_e_per_adu"]);
    // An HDU that inherits nothing has no unit.
    desk.write_frame("frame.fits", 20.0, &[("INHERIT", false.into(), "")], &[adu, gain]);
    desk.refuses(&estimate("frame.fits"), &["GAIN = 20", "BUNIT"]);
}

#[test]
fn cards_that_are_not_read_are_named() {
    let desk = Desk::with_images(&[]);
    let cards =
        [("BUNIT", "electron".into(), ""), ("WAVELEN", "see log".into(), ""), ("EXPTIME", "unknown".into(), "")];
    desk.write_frame("frame.fits", 1.0, &cards, &[]);
    let done = desk.succeeds(&estimate("frame.fits"));
    for card in ["WAVELEN = `see log`", "EXPTIME = `unknown`"] {
        assert!(done.out.contains(card) && done.out.contains("not used"), "{}", done.out);
    }
}

#[test]
fn masks_of_good_pixels_and_of_flags_are_refused() {
    let desk = Desk::with_images(&[]);
    let shape = (64, 64);
    let write = |name: &str, hdu: &str, value: &dyn Fn(usize) -> f64| {
        let map = Array2::from_shape_fn(shape, |(y, x)| value(64 * y + x));
        let mut file = FitsWriter::create(desk.path(name)).unwrap();
        file.image(hdu, &map, Pixel::I32, "").unwrap();
        file.finish().unwrap();
    };
    let is_bad = |pixel: usize| pixel % 512 == 7;
    write("good.fits", "MASK", &|pixel| f64::from(u8::from(!is_bad(pixel))));
    // 8 of 4096 pixels are bad.
    desk.refuses(
        &[&estimate("images.fits")[..], &["--mask", "good.fits"]].concat(),
        &["MASK", "99.8 %", "good pixels"],
    );
    let flags = |pixel: usize| f64::from(u8::from(is_bad(pixel))) + if pixel % 10 < 3 { 4.0 } else { 0.0 };
    write("dq.fits", "DQ", &flags);
    let with_flags = [&estimate("images.fits")[..], &["--mask", "dq.fits"]].concat();
    desk.refuses(&with_flags, &["DQ", "30.", "4: 30.0 %", "1: 0.2 %", "[DQ&1]"]);
    write("bad.fits", "MASK", &|pixel| f64::from(u8::from(is_bad(pixel))));
    let rms = |mask: &str| {
        number(&desk.json(&[&estimate("images.fits")[..], &["--mask", mask, "--json"]].concat()), "phasing_rms_nm")
    };
    assert_eq!(rms("dq.fits[DQ&1]"), rms("bad.fits"));
    desk.refuses(&[&estimate("images.fits")[..], &["--mask", "dq.fits[DQ&x]"]].concat(), &["`x`", "whole number"]);
}

#[test]
fn data_that_are_not_those_of_their_sum_are_refused() {
    let desk = Desk::with_images(&[]);
    desk.write_frame("frame.fits", 1.0, &[("BUNIT", "electron".into(), "")], &[]);
    desk.succeeds(&estimate("frame.fits"));
    let mut bytes = std::fs::read(desk.path("frame.fits")).unwrap();
    let end = bytes.len();
    bytes[end - 2 * 2880..end - 2880].fill(0);
    std::fs::write(desk.path("frame.fits"), bytes).unwrap();
    desk.refuses(&estimate("frame.fits"), &["frame.fits", "damaged", "SCI", "DATASUM"]);
}

#[test]
fn counts_padded_to_more_bits_contradict_a_gain_of_fewer() {
    let desk = Desk::with_images(&[]);
    let write = |factor: f64| {
        let images = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
        let counts = images.mapv(|electrons| factor * (electrons / 10.0 + 8.0).round());
        let mut file = FitsWriter::create(desk.path("counts.fits")).unwrap();
        file.image("SCI", &counts, Pixel::I32, "adu").unwrap();
        file.card("SCI", "EGAIN", 10.0, "").unwrap();
        file.finish().unwrap();
    };
    write(1.0);
    desk.succeeds(&estimate("counts.fits"));
    write(16.0);
    desk.refuses(&estimate("counts.fits"), &["multiples of 16", "EGAIN = 10", "image.gain_e_per_adu = 0.625"]);
    let done = desk.succeeds(&[&estimate("counts.fits")[..], &["--gain", "0.625"]].concat());
    assert!(done.out.contains("multiples of 16"), "{}", done.out);
}

#[test]
fn images_of_one_shape_beside_the_one_that_is_read_are_named() {
    let desk = Desk::with_images(&[]);
    let images = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    let mut file = FitsWriter::create(desk.path("two.fits")).unwrap();
    for name in ["LEFT", "RIGHT", "ERR"] {
        file.image(name, &images, Pixel::F32, "electron").unwrap();
    }
    file.finish().unwrap();
    let done = desk.succeeds(&estimate("two.fits"));
    assert!(done.err.contains("LEFT") && done.err.contains("RIGHT") && !done.err.contains("ERR"), "{}", done.err);
    assert!(done.out.contains("`ERR` was not used"), "{}", done.out);
    let done = desk.succeeds(&estimate("two.fits[RIGHT]"));
    assert!(!done.err.contains("LEFT"), "{}", done.err);
}

#[test]
fn maps_and_pistons_of_an_unlikely_unit_are_refused() {
    let desk = Desk::with_images(&[]);
    desk.succeeds(&["estimate", "images.fits", "-o", "est.fits"]);
    let truth = FitsReader::open(desk.path("images.fits")).unwrap().map(Some("TRUTH_NCPA")).unwrap();
    let compare = |unit: &str, scale: f64| {
        let mut file = FitsWriter::create(desk.path("opd.fits")).unwrap();
        file.image("OPD", &(scale * &truth), Pixel::F64, unit).unwrap();
        file.finish().unwrap();
        ["compare", "est.fits", "--truth-ncpa", "opd.fits"]
    };
    let expected = desk.succeeds(&compare("nm", 1.0)).out;
    for (unit, scale) in [("", 1.0), ("m", 1e-9), ("Angstrom", 10.0), ("mm", 1e-6), ("microns", 1e-3)] {
        assert_eq!(desk.succeeds(&compare(unit, scale)).out, expected, "{unit}");
    }
    desk.refuses(&compare("", 1e-9), &["opd.fits", "BUNIT", "in m"]);
    desk.refuses(&compare("", 1e-3), &["opd.fits", "BUNIT", "in um"]);
    desk.refuses(&compare("rad", 6e-3), &["opd.fits", "rad", "nm"]);
    let rows: Vec<String> = (0..7).map(|segment| format!("{segment} {}e-9\n", 10 * segment - 30)).collect();
    std::fs::write(desk.path("p.txt"), rows.concat()).unwrap();
    desk.refuses(&["compare", "est.fits", "--truth-pistons", "p.txt"], &["p.txt", "unit", "in m"]);
}
