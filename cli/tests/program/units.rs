//! Files that the program writes: units of the FITS standard, so that strict readers such as
//! astropy accept them, the scale of every map, and the segments of corrections.

use crate::{Desk, Done};
use cophase::io::{Card, FitsReader, PixelUnit, read_images};
use std::process::Command;

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
fn files_have_standard_units_map_scale_and_segment_positions() {
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
    maps_have_their_scale(&desk);
    corrections_name_their_segments(&desk);
    // The header says what the photons are.
    let header = std::fs::read(desk.path("images.fits")).unwrap();
    assert!(String::from_utf8_lossy(&header).contains("/ detected photons, which are electrons"));
    // Files of before, in the unit `electron`, and those of now are in electrons.
    desk.edit_images("images.fits", "before.fits", |_| ());
    for name in ["before.fits", "images.fits"] {
        assert_eq!(read_images(desk.path(name), None).unwrap().unit, PixelUnit::Electrons, "{name}");
    }
}

/// The number of a card in an HDU of a file.
fn number(file: &mut FitsReader, hdu: &str, key: &str) -> Option<f64> {
    file.card(Some(hdu), key).unwrap().and_then(|card| card.number())
}

/// That every map on the pupil's grid has its scale.
fn maps_have_their_scale(desk: &Desk) {
    // Simulated images have the true phasing and NCPA; an estimate of them has both, the maps, and
    // two of error bars.
    for (name, samples, count) in
        [("images.fits", 64, 2), ("sky.fits", 64, 2), ("est.fits", 64, 7), ("map.fits", 64, 5)]
    {
        let mut file = FitsReader::open(desk.path(name)).unwrap();
        let mut maps = 0;
        for hdu in file.names() {
            let is_nm = file.card(Some(&hdu), "BUNIT").unwrap().is_some_and(|unit| unit.text() == Some("nm"));
            let sides = ["NAXIS1", "NAXIS2"].map(|key| number(&mut file, &hdu, key));
            if !is_nm || number(&mut file, &hdu, "NAXIS") != Some(2.0) || sides != [Some(f64::from(samples)); 2] {
                continue;
            }
            maps += 1;
            let grid_m = number(&mut file, &hdu, "GRID_M").unwrap_or_else(|| panic!("{name}, {hdu}: no GRID_M"));
            assert!((4.0..7.0).contains(&grid_m), "{name}, {hdu}: {grid_m} m");
            for key in ["CDELT1", "CDELT2"] {
                assert_eq!(number(&mut file, &hdu, key), Some(grid_m / f64::from(samples)), "{name}, {hdu}: {key}");
            }
        }
        assert!(maps >= count, "{name}: {maps} maps in {:?}", file.names());
    }
}

/// That a correction has the number, the ring and the place of its segment, as the estimate has
/// them.
fn corrections_name_their_segments(desk: &Desk) {
    let [mut map, mut commands] = ["map.fits", "commands.fits"].map(|name| FitsReader::open(desk.path(name)).unwrap());
    for key in ["SEGMENT", "RING"] {
        let [places, expected] = [&mut commands, &mut map].map(|file| file.i64_column("SEGMENTS", key).unwrap());
        assert_eq!(places, expected, "{key}");
    }
    assert_eq!(commands.i64_column("SEGMENTS", "RING").unwrap(), [0, 1, 1, 1, 1, 1, 1]);
    for key in ["X_M", "Y_M"] {
        let [places, expected] = [&mut commands, &mut map].map(|file| file.f64_column("SEGMENTS", key).unwrap());
        assert!(places == expected && places.iter().any(|m| m.abs() > 1.0), "{key}: {places:?}");
    }
    let add_nm = commands.f64_column("SEGMENTS", "ADD_NM").unwrap();
    assert!(add_nm.len() == 7 && add_nm.iter().any(|nm| nm.abs() > 1.0), "{add_nm:?}");
}

/// What astropy says of the files: units of the standard, checksums, cards. Where it is not
/// installed nothing is checked.
#[test]
fn astropy_reads_the_files_without_a_warning() {
    const READ: &str = "
import sys, warnings
import astropy.units as units
from astropy.io import fits
warnings.simplefilter('error')
for name in sys.argv[1:]:
    with fits.open(name, checksum=True) as file:
        file.verify('exception')
        for hdu in file:
            columns = hdu.columns if isinstance(hdu, fits.BinTableHDU) else []
            for unit in [hdu.header.get('BUNIT'), *(column.unit for column in columns)]:
                if unit:
                    units.Unit(unit, format='fits')
            hdu.data
";
    let python = std::env::var("COPHASE_PYTHON").unwrap_or("python3".into());
    let has_astropy = Command::new(&python).args(["-c", "import astropy.io.fits, astropy.units"]).output();
    if !has_astropy.is_ok_and(|output| output.status.success()) {
        println!("skipped: {python} has no astropy");
        return;
    }
    let desk = Desk::with_images(&[]);
    desk.succeeds(&["estimate", "images.fits", "-o", "est.fits"]);
    let mut command = Command::new(python);
    let output = command.args(["-c", READ]).args(["images.fits", "est.fits"].map(|name| desk.path(name))).output();
    let done = Done::from(output.unwrap());
    assert_eq!(done.status, 0, "{}", done.err);
}
