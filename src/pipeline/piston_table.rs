//! Table of a piston for each segment, from another program.

use crate::io::{FitsReader, TextTable, read_text};
use crate::telescope::{SegmentPlace, likely_unit};
use crate::{Error, Result};
use std::path::Path;

/// Reads the piston of each of the segments `places`, nm, in their order. A text table (`.txt`,
/// `.csv`, `.dat`; [`TextTable`]) has rows of segment and piston, or columns of these names. A FITS
/// file has them in the column `PISTON_NM` of a table `SEGMENTS`, beside a column `LABEL` or
/// `SEGMENT`, as an estimate has; without either, in the order of the segments. Segments are
/// addressed by their labels ([`SegmentPlace::label`]) or, all of them, by their numbers.
/// `wavelength_nm` is that of phases, in radians or waves.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, and for one that does not have each segment
/// once.
pub fn read_pistons(path: &Path, places: &[SegmentPlace], wavelength_nm: f64) -> Result<Vec<f64>> {
    let is_text =
        path.extension().is_some_and(|word| ["txt", "csv", "dat"].iter().any(|text| word.eq_ignore_ascii_case(text)));
    let rows = if is_text {
        parse(&read_text(path, "it holds the true pistons")?, wavelength_nm)
    } else {
        let mut file = FitsReader::open(path)?;
        let pistons_nm = file.f64_column("SEGMENTS", "PISTON_NM")?;
        let numbers = |file: &mut FitsReader, column: &str| {
            file.i64_column("SEGMENTS", column).ok().map(|all| all.iter().map(i64::to_string).collect::<Vec<_>>())
        };
        let words = |file: &mut FitsReader| file.text_column("SEGMENTS", "LABEL").ok();
        let named = numbers(&mut file, "LABEL").or_else(|| words(&mut file)).or_else(|| numbers(&mut file, "SEGMENT"));
        let named = named.unwrap_or_else(|| (0..pistons_nm.len()).map(|number| number.to_string()).collect());
        Ok(named.into_iter().map(|label| label.trim().to_owned()).zip(pistons_nm).collect())
    };
    rows.and_then(|rows| ordered(&rows, places)).map_err(|reason| Error::file(path, reason))
}

/// Segments and pistons of a text table, or why it is not accepted. Pistons are in the unit that
/// the name of their column ends with, radians and waves being those of `wavelength_nm`; else in
/// nm.
fn parse(text: &str, wavelength_nm: f64) -> std::result::Result<Vec<(String, f64)>, String> {
    let table = TextTable::new(text);
    let named = table.column(&["label", "segment"]).zip(table.column(&["piston"]));
    let (of_segment, of_piston) = named.unwrap_or((0, 1));
    let unit_nm = table.wavefront_unit_nm(of_piston, wavelength_nm);
    let rows = table.rows.iter().map(|row| {
        let word = row.words.get(of_segment).filter(|_| named.is_some() || row.words.len() == 2);
        let word = word.ok_or_else(|| row.at("a segment's number or label and its piston in nm are needed"))?;
        // A number as NumPy writes it is that number; other words are labels.
        let segment = row.integer(of_segment).map_or_else(|| word.clone(), |number| number.to_string());
        Ok((segment, row.number(of_piston, "a piston in nm")? * unit_nm.unwrap_or(1.0)))
    });
    let rows: Vec<(String, f64)> = rows.collect::<std::result::Result<_, String>>()?;
    match likely_unit(rows.iter().map(|(_, nm)| *nm)).filter(|_| unit_nm.is_none()) {
        Some(likely) => Err(format!("no unit of the pistons is named, and {likely}: a column piston_nm is needed")),
        None => Ok(rows),
    }
}

/// The pistons in the order of `places`, or why they are not accepted.
fn ordered(rows: &[(String, f64)], places: &[SegmentPlace]) -> std::result::Result<Vec<f64>, String> {
    let has = |segment: &String| rows.iter().any(|(named, _)| named == segment);
    let by_label = places.iter().all(|place| has(&place.label));
    let labels: Vec<String> = places.iter().map(|place| place.label.clone()).collect();
    let names = if by_label { labels.clone() } else { places.iter().map(|place| place.number.to_string()).collect() };
    let span = |names: &[String]| match names {
        [first, .., last] => format!("{first} to {last}"),
        names => names.concat(),
    };
    let accepted = match (span(&names), span(&labels)) {
        (numbers, labels) if numbers == labels => numbers,
        (numbers, labels) => format!("{numbers}, or the labels {labels},"),
    };
    for (place, (segment, nm)) in rows.iter().enumerate() {
        if !names.contains(segment) {
            return Err(format!("there is no segment {segment}: each of {accepted} is needed once"));
        }
        if rows[..place].iter().any(|(before, _)| before == segment) {
            return Err(format!("segment {segment} is there twice: each of {accepted} is needed once"));
        }
        if !nm.is_finite() {
            return Err(format!("the piston of segment {segment} is {nm}: a finite number of nm is needed"));
        }
    }
    let piston = |name: &String| rows.iter().find(|(segment, _)| segment == name).map(|(_, nm)| *nm);
    let missing = |name: &String| format!("segment {name} is missing: each of {accepted} is needed once");
    names.iter().map(|name| piston(name).ok_or_else(|| missing(name))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(labels: &[&str]) -> Vec<SegmentPlace> {
        let place = |(number, label): (usize, &&str)| SegmentPlace {
            number,
            ring: None,
            label: label.to_string(),
            x_m: 0.0,
            y_m: 0.0,
        };
        labels.iter().enumerate().map(place).collect()
    }

    #[test]
    fn segments_are_addressed_by_number_or_by_label() {
        let read = |text: &str, labels: &[&str]| ordered(&parse(text, 2000.0)?, &places(labels));
        assert_eq!(read("# nm\n1, -3.5\n0 2\n", &["0", "1"]).unwrap(), [2.0, -3.5]);
        // Labels from 1, and with a gap.
        assert_eq!(read("1 2\n2 -3.5\n", &["1", "2"]).unwrap(), [2.0, -3.5]);
        assert_eq!(read("9 4\n2 5\n", &["2", "9"]).unwrap(), [5.0, 4.0]);
        assert_eq!(read("0 4\n1 5\n", &["2", "9"]).unwrap(), [4.0, 5.0]);
        // As pandas writes the table of an estimate, and as NumPy writes numbers.
        assert_eq!(read(",RING,LABEL,PISTON_UM\n0,1,2,0.5\n1,1,9,-0.25\n", &["2", "9"]).unwrap(), [500.0, -250.0]);
        assert_eq!(read("segment,piston_waves\n0,0.25\n1,-0.5\n", &["0", "1"]).unwrap(), [500.0, -1000.0]);
        let of_phase = read("segment piston_rad\n0 3.14159265\n1 0\n", &["0", "1"]).unwrap();
        assert!((of_phase[0] - 1000.0).abs() < 1e-5, "{of_phase:?}");
        assert_eq!(read("0.0e+00 4.0e+00\n1.0e+00 5.0D0\n", &["0", "1"]).unwrap(), [4.0, 5.0]);
        assert_eq!(read("B2 4\nA1 5\n", &["A1", "B2"]).unwrap(), [5.0, 4.0]);
        for (text, labels, expected) in [
            ("0 1\n", &["0", "1"], "segment 1 is missing | 0 to 1"),
            ("0 1\n0 2\n1 1\n", &["0", "1"], "segment 0 | twice"),
            ("1 1\n2 1\n", &["0", "1"], "no segment 2 | 0 to 1"),
            ("1 1\n2 1\n", &["2", "9"], "no segment 2 | 0 to 1 | labels 2 to 9"),
            ("0 1 2\n", &["0", "1"], "line 1 | number or label"),
            ("0 8e-8\n1 -5e-8\n", &["0", "1"], "no unit | RMS | m"),
            ("0 x\n", &["0", "1"], "line 1 | 'x' | finite number | nm"),
        ] {
            let reason = read(text, labels).unwrap_err();
            assert!(expected.split(" | ").all(|fact| reason.contains(fact)), "{text:?}: {reason}");
        }
    }
}
