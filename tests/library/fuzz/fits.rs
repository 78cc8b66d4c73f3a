//! FITS files: what a user would expect to be read is, what is hostile is refused in a sentence,
//! and no change of bits, lengths or cards does anything else.

use super::{generator, pick, probes, seeds};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use std::io::Write;

const CARD: usize = 80;

#[test]
fn the_quirks_of_real_files_are_read_and_hostile_ones_refused() {
    let file = probes::File::new("seeds");
    for (name, bytes) in seeds("fits") {
        let read = probes::fits(&file, &bytes);
        match name.split('-').next().unwrap() {
            "ok" => assert!(read, "{name} was refused"),
            "bad" => assert!(!read, "{name} was read"),
            // Its image is read; what is odd is in a table, or in what its pixels are worth.
            _ => assert!(read, "{name} was refused"),
        }
    }
}

/// Values that a hostile or broken header gives a card.
const VALUES: [&str; 30] = [
    "0",
    "1",
    "-1",
    "2",
    "7",
    "8",
    "12",
    "16",
    "-32",
    "-64",
    "999",
    "1000",
    "1000000000",
    "2147483647",
    "2147483648",
    "4294967296",
    "9223372036854775807",
    "-9223372036854775808",
    "99999999999999999999",
    "1E9",
    "1E999",
    "NaN",
    "-0.0",
    "1.5",
    "T",
    "F",
    "''",
    "'16'",
    "'IMAGE   '",
    "'999999999D'",
];

/// Cards that decide what is read.
const KEYS: [&str; 29] = [
    "SIMPLE", "XTENSION", "BITPIX", "NAXIS", "NAXIS1", "NAXIS2", "NAXIS3", "PCOUNT", "GCOUNT", "GROUPS", "TFIELDS",
    "TFORM1", "TTYPE1", "TSCAL1", "TZERO1", "TNULL1", "THEAP", "TBCOL1", "BSCALE", "BZERO", "BLANK", "EXTNAME",
    "RON_E", "ZIMAGE", "ZBITPIX", "ZNAXIS1", "ZTILE1", "ZVAL1", "ZCMPTYPE",
];

/// One change to a file: bits, its length, a card's value, a card more or less, a block moved.
fn mutate(bytes: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    if bytes.len() < CARD {
        return bytes.extend_from_slice(b"SIMPLE  =                    T");
    }
    let at = rng.random_range(0..bytes.len());
    let cards = bytes.len() / CARD;
    let card = rng.random_range(0..cards) * CARD;
    match rng.random_range(0..8) {
        0 => bytes[at] ^= 1 << rng.random_range(0..8),
        1 => bytes.truncate(at),
        2 => {
            let value = pick(rng, &VALUES);
            bytes[card + 10..card + 30].copy_from_slice(format!("{value:>20.20}").as_bytes());
        }
        3 | 4 => {
            let line = format!("{:<8}= {:>20}", pick(rng, &KEYS), pick(rng, &VALUES));
            bytes[card..card + CARD].copy_from_slice(format!("{line:<80.80}").as_bytes());
        }
        5 => bytes[card..card + CARD].fill(*pick(rng, &[b' ', 0, b'\'', 0xff])),
        6 => {
            let blocks = bytes.len().div_ceil(2880);
            let from = rng.random_range(0..blocks) * 2880;
            let block = bytes[from..bytes.len().min(from + 2880)].to_vec();
            bytes.extend(block);
        }
        _ => {
            let other = rng.random_range(0..cards) * CARD;
            let line = bytes[other..other + CARD].to_vec();
            bytes[card..card + CARD].copy_from_slice(&line);
        }
    }
}

#[test]
fn changed_files_are_read_or_refused() {
    let file = probes::File::new("changed");
    let seeds = seeds("fits");
    let mut rng = generator(40);
    let (mut read, mut refused) = (0, 0);
    for _ in 0..4000 {
        let mut bytes = pick(&mut rng, &seeds).1.clone();
        for _ in 0..rng.random_range(1..5) {
            mutate(&mut bytes, &mut rng);
        }
        // Blocks that repeat add up; a file of this size has been through all there is.
        bytes.truncate(60_000);
        if probes::fits(&file, &bytes) { read += 1 } else { refused += 1 }
    }
    // The changes are mild enough to pass the first checks, and wild enough to fail them.
    assert!(read > 400 && refused > 400, "{read} read, {refused} refused");
}

/// A header can ask for 8 GB in 2880 bytes. It is refused for the bytes that are not there, before
/// memory is asked for them: the peak of this process does not move by as much as a hundredth of
/// that.
#[test]
fn a_header_of_a_billion_pixels_takes_no_memory() {
    let file = probes::File::new("billion");
    let peak_kb = || {
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:").map(str::to_owned)).unwrap_or_default();
        line.trim().trim_end_matches(" kB").parse::<u64>().unwrap_or(0)
    };
    let header = |axis: &str| {
        let cards = [
            "SIMPLE  =                    T".into(),
            "BITPIX  =                  -64".into(),
            card("NAXIS", "2"),
            card("NAXIS1", axis),
            card("NAXIS2", "1"),
            "END".to_string(),
        ];
        let mut bytes: Vec<u8> = cards.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
        bytes.resize(2880, b' ');
        bytes
    };
    let before = peak_kb();
    // What needs too much memory is refused by its size already, where it is packed.
    let words = [
        ("1000000000", "needs 8000002880 bytes", "unpacks to 8000003520 bytes"),
        ("3000000000", "3000000000×1 pixels: at most 2147483648", "at most"),
    ];
    for (axis, word, packed_word) in words {
        let bytes = header(axis);
        let sentence = probes::refusal(&file, &bytes);
        assert!(sentence.contains(word), "{sentence}");
        // Packed it asks for no more.
        let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::best());
        packer.write_all(&bytes).unwrap();
        let sentence = probes::refusal(&file, &packer.finish().unwrap());
        assert!(sentence.contains(packed_word), "{sentence}");
    }
    // Other tests of this process run beside this one, and take some ten MB each.
    let grown_kb = peak_kb() - before;
    assert!(grown_kb < 400_000, "the address space grew by {grown_kb} kB of the 8,000,000 that the header asks for");
}

fn card(key: &str, value: &str) -> String {
    format!("{key:<8}= {value:>20}")
}
