//! Units of the files that the program writes: those of the FITS standard, so that strict readers such as astropy accept them.

use crate::Desk;
use cophase::io::{Card, FitsReader, PixelUnit, read_images};

/// Units with metric prefixes, FITS standard 4.0, tables 3 and 5.
const PREFIXED: &str = "m g s rad sr K A mol cd Hz J W V N Pa C Ohm S F Wb T H lm lx arcsec a yr eV pc Jy mag R G barn count \
                        ct photon ph adu D Sun pixel pix chan bin bit byte";
/// Units without, and those that have one already.
const PLAIN: &str = "kg deg arcmin mas min h d erg Ry solMass u solLum Angstrom solRad AU lyr voxel beam";

/// Whether `unit` is units of the standard, divided or multiplied.
fn is_standard(unit: &str) -> bool {
    let is_word = |word: &str| {
        let is_prefixed = |word: &str| PREFIXED.split_whitespace().any(|known| known == word);
        let rest = word.strip_prefix(|c| "yzafpnumcdhkMGTPEZY".contains(c));
        is_prefixed(word) || rest.is_some_and(is_prefixed) || PLAIN.split_whitespace().any(|known| known == word)
    };
    unit.split(['/', '.', ' ']).all(is_word)
}

/// The units in the file: HDU, keyword and unit.
fn units(desk: &Desk, name: &str) -> Vec<(String, String, String)> {
    let mut file = FitsReader::open(desk.path(name)).unwrap();
    let mut found = Vec::new();
    for hdu in file.names() {
        let fields = file.card(Some(&hdu), "TFIELDS").unwrap().and_then(|card| card.number()).unwrap_or(0.0) as usize;
        let columns = (1..=fields).map(|column| format!("TUNIT{column}"));
        for key in ["BUNIT", "CUNIT1", "CUNIT2"].map(String::from).into_iter().chain(columns) {
            if let Some(Card::Text(unit)) = file.card(Some(&hdu), &key).unwrap() {
                found.push((hdu.clone(), key, unit));
            }
        }
    }
    found
}

#[test]
fn every_unit_of_every_file_is_one_of_the_fits_standard() {
    assert!(["photon", "nm", "mas/nm", "um", "ms"].into_iter().all(is_standard));
    assert!(!["electron", "e-", "micron", "nanometer", ""].into_iter().any(is_standard));
    let desk = Desk::with_images(&[]);
    std::fs::write(desk.path("sky.toml"), include_str!("../../../tests/c_api/sky.toml")).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "sky.fits"]);
    desk.succeeds(&["estimate", "images.fits", "-o", "est.fits"]);
    let full_phase = ["estimate", "sky.fits", "-o", "map.fits", "--commands", "commands.fits", "--device", "cpu"];
    desk.succeeds(&[&full_phase[..], &["--method", "full-phase"]].concat());
    for (name, count) in
        [("images.fits", 10), ("sky.fits", 18), ("est.fits", 34), ("map.fits", 37), ("commands.fits", 10)]
    {
        let units = units(&desk, name);
        println!("{name}: {units:?}");
        // Cards that the reader does not find would pass.
        assert!(units.len() >= count, "{name}: {units:?}");
        for (hdu, key, unit) in units {
            assert!(is_standard(&unit), "{name}, {hdu}: {key} = '{unit}'");
        }
    }
    // The header says what the photons are.
    let header = std::fs::read(desk.path("images.fits")).unwrap();
    assert!(String::from_utf8_lossy(&header).contains("/ detected photons, which are electrons"));
    // Files of before, in the unit `electron`, and those of now are in electrons.
    desk.edit_images("images.fits", "before.fits", |_| ());
    for name in ["before.fits", "images.fits"] {
        assert_eq!(read_images(desk.path(name), None).unwrap().unit, PixelUnit::Electrons, "{name}");
    }
}
