//! Checksums of written files, by the definition: FITS standard 4.0, section 4.4.2.7 and appendix
//! J.

use cophase::io::{Column, ELECTRON, FitsReader, FitsWriter, Pixel};
use ndarray::{Array2, Array3};

const BLOCK: usize = 2880;

/// Sum of 32-bit big-endian words in ones' complement arithmetic.
fn sum(bytes: &[u8]) -> u32 {
    let (words, rest) = bytes.as_chunks::<4>();
    assert!(rest.is_empty());
    let mut sum: u64 = words.iter().map(|&word| u64::from(u32::from_be_bytes(word))).sum();
    while sum > u64::from(u32::MAX) {
        sum = (sum & u64::from(u32::MAX)) + (sum >> 32);
    }
    sum as u32
}

/// An HDU: its header and its data.
struct Hdu<'a> {
    header: &'a [u8],
    data: &'a [u8],
}

impl Hdu<'_> {
    /// The value of a card, without quotes.
    fn value(&self, key: &str) -> Option<String> {
        let cards = self.header.as_chunks::<80>().0.iter().map(|card| String::from_utf8_lossy(card).into_owned());
        let card = cards.into_iter().find(|card| card.starts_with(&format!("{key:<8}= ")))?;
        let value = card[10..].split('/').next()?.trim().trim_matches('\'').trim().to_string();
        Some(value)
    }

    fn integer(&self, key: &str) -> Option<usize> {
        self.value(key)?.trim_start_matches('-').parse().ok()
    }
}

/// The HDUs of a file in standard form.
fn hdus(bytes: &[u8]) -> Vec<Hdu<'_>> {
    let (mut hdus, mut at) = (Vec::new(), 0);
    while at < bytes.len() {
        let is_last = |block: &[u8]| block.chunks(80).any(|card| card.trim_ascii_end() == b"END");
        let blocks = bytes[at..].chunks(BLOCK).position(is_last).unwrap() + 1;
        let mut hdu = Hdu { header: &bytes[at..at + blocks * BLOCK], data: &[] };
        at += hdu.header.len();
        let axes = hdu.integer("NAXIS").unwrap();
        let sizes = (1..=axes).map(|axis| hdu.integer(&format!("NAXIS{axis}")).unwrap());
        let values = if axes == 0 { 0 } else { sizes.product::<usize>() };
        let length = hdu.integer("BITPIX").unwrap() / 8 * (values + hdu.integer("PCOUNT").unwrap_or(0));
        hdu.data = &bytes[at..at + length.next_multiple_of(BLOCK)];
        at += hdu.data.len();
        hdus.push(hdu);
    }
    hdus
}

/// Whether each HDU has the sum of its data in DATASUM, and by CHECKSUM a sum of its own that is
/// −0, all bits 1.
fn verify(bytes: &[u8]) -> bool {
    let is_right = |hdu: &Hdu| {
        let stated = hdu.value("DATASUM").and_then(|sum| sum.parse::<u32>().ok());
        hdu.value("CHECKSUM").is_some_and(|text| text.len() == 16)
            && stated == Some(sum(hdu.data))
            && sum(&[hdu.header, hdu.data].concat()) == u32::MAX
    };
    hdus(bytes).iter().all(is_right)
}

#[test]
fn the_checksums_of_written_files_verify() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sums.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    let cube = Array3::from_shape_fn((2, 9, 11), |(k, y, x)| (100 * k + 10 * y + x) as f64 - 3.25);
    file.image("IMAGES", &cube, Pixel::F32, ELECTRON).unwrap();
    file.map("PHASING", &Array2::from_elem((8, 8), f64::NAN), "nm", 10.95).unwrap();
    file.image("BADPIX", &Array2::from_elem((9, 11), 1.0), Pixel::I32, "").unwrap();
    let columns = [Column::text("NAME", ["a", "bc"]), Column::f64("X", "nm", vec![0.1, f64::NAN])];
    file.table("MODES", &columns).unwrap();
    file.text("SCENE", "[image]\npixels = 64\n").unwrap();
    // A card behind the data, and a long one: sums are made of the file as it is at last.
    file.card("IMAGES", "RON_E", 20.0, "").unwrap();
    file.card("PRIMARY", "LONG", "0123456789 ".repeat(20).as_str(), "").unwrap();
    file.finish().unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert_eq!(hdus(&bytes).len(), FitsReader::open(&path).unwrap().names().len());
    assert!(verify(&bytes));
    // The sums show a change of any one of some bytes, in headers and in data.
    for at in (0..bytes.len()).step_by(1009) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x01;
        // A card that is no longer found has no value, and no end of a header is damaged here.
        assert!(!verify(&damaged), "byte {at}");
    }
}
