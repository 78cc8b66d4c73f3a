//! Table of a piston for each segment, from another program.

use crate::io::{FitsReader, read_text, text_rows};
use crate::telescope::SegmentPlace;
use crate::{Error, Result};
use std::path::Path;

/// Reads the piston of each of the segments `places`, nm, in their order. A text table (`.txt`, `.csv`, `.dat`) has rows of segment and
/// piston, separated by white space or a comma, and comments after `#`. A FITS file has them in the column `PISTON_NM` of a table
/// `SEGMENTS`, beside a column `LABEL` or `SEGMENT`, as an estimate has; without either, in the order of the segments. Segments are
/// addressed by their labels ([`SegmentPlace::label`]) or, all of them, by their numbers.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, and for one that does not have each segment once.
pub fn read_pistons(path: &Path, places: &[SegmentPlace]) -> Result<Vec<f64>> {
    let is_text =
        path.extension().is_some_and(|word| ["txt", "csv", "dat"].iter().any(|text| word.eq_ignore_ascii_case(text)));
    let rows = if is_text {
        parse(&read_text(path, "it holds the true pistons")?)
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

/// Segments and pistons of a text table, or why it is not accepted.
fn parse(text: &str) -> std::result::Result<Vec<(String, f64)>, String> {
    let rows = text_rows(text).into_iter().map(|row| {
        if row.words.len() != 2 {
            return Err(row.at("a segment's number or label and its piston in nm are needed"));
        }
        Ok((row.words[0].to_owned(), row.number(1, "a piston in nm")?))
    });
    rows.collect()
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
        let read = |text: &str, labels: &[&str]| ordered(&parse(text)?, &places(labels));
        assert_eq!(read("# nm\n1, -3.5\n0 2\n", &["0", "1"]).unwrap(), [2.0, -3.5]);
        // Labels from 1, and with a gap.
        assert_eq!(read("1 2\n2 -3.5\n", &["1", "2"]).unwrap(), [2.0, -3.5]);
        assert_eq!(read("9 4\n2 5\n", &["2", "9"]).unwrap(), [5.0, 4.0]);
        assert_eq!(read("0 4\n1 5\n", &["2", "9"]).unwrap(), [4.0, 5.0]);
        assert_eq!(read("B2 4\nA1 5\n", &["A1", "B2"]).unwrap(), [5.0, 4.0]);
        for (text, labels, expected) in [
            ("0 1\n", &["0", "1"], "segment 1 is missing | 0 to 1"),
            ("0 1\n0 2\n1 1\n", &["0", "1"], "segment 0 | twice"),
            ("1 1\n2 1\n", &["0", "1"], "no segment 2 | 0 to 1"),
            ("1 1\n2 1\n", &["2", "9"], "no segment 2 | 0 to 1 | labels 2 to 9"),
            ("0 1 2\n", &["0", "1"], "line 1 | number or label"),
            ("0 x\n", &["0", "1"], "line 1 | 'x' | finite number | nm"),
        ] {
            let reason = read(text, labels).unwrap_err();
            assert!(expected.split(" | ").all(|fact| reason.contains(fact)), "{text:?}: {reason}");
        }
    }
}
