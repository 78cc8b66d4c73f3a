//! Tile-compressed images (`.fits.fz`), as `fpack` writes them.

use crate::{Desk, number};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use ndarray::{Array3, ArrayView3};

/// Pixels of a block of differences that share their number of low bits.
const BLOCK: usize = 32;

/// Bits, the most significant of each byte first.
#[derive(Default)]
struct Bits {
    bytes: Vec<u8>,
    held: usize,
}

impl Bits {
    fn put(&mut self, value: u64, count: u32) {
        for bit in (0..count).rev() {
            if self.held.is_multiple_of(8) {
                self.bytes.push(0);
            }
            let last = self.bytes.len() - 1;
            self.bytes[last] |= ((value >> bit & 1) as u8) << (7 - self.held % 8);
            self.held += 1;
        }
    }
}

/// The Rice stream of 32-bit integers (FITS standard 4.0, section 10.4.1): the first one, then
/// blocks of differences, each as the number of zeros that its high bits say, a one, and its low
/// bits. The number of low bits is that of half the mean difference.
fn rice(pixels: &[i32]) -> Vec<u8> {
    let mut bits = Bits::default();
    let mut last = pixels[0];
    bits.put(u64::from(last as u32), 32);
    for block in pixels.chunks(BLOCK) {
        let differences = block.iter().map(|&pixel| {
            let difference = i64::from(pixel) - i64::from(std::mem::replace(&mut last, pixel));
            if difference < 0 { !(difference << 1) as u64 } else { (difference << 1) as u64 }
        });
        let differences: Vec<u64> = differences.collect();
        let mean = differences.iter().sum::<u64>() / block.len() as u64;
        let low = (64 - (mean / 2).leading_zeros()).min(24);
        bits.put(u64::from(low) + 1, 5);
        for difference in differences {
            (0..difference >> low).for_each(|_| bits.put(0, 1));
            bits.put(1, 1);
            bits.put(difference & ((1 << low) - 1), low);
        }
    }
    bits.bytes
}

/// A file with a compressed image whose tiles are its rows, and nothing else.
fn compressed(images: ArrayView3<i32>, cards: &[&str]) -> Vec<u8> {
    let (count, rows, columns) = images.dim();
    let streams: Vec<Vec<u8>> = images.rows().into_iter().map(|row| rice(&row.to_vec())).collect();
    let heap: usize = streams.iter().map(Vec::len).sum();
    let most = streams.iter().map(Vec::len).max().unwrap();
    let header = |cards: &[String]| {
        let mut bytes: Vec<u8> = cards.iter().flat_map(|card| format!("{card:<80}").into_bytes()).collect();
        bytes.extend(format!("{:<80}", "END").into_bytes());
        bytes.resize(bytes.len().next_multiple_of(2880), b' ');
        bytes
    };
    let number = |key: &str, value: usize| format!("{key:<8}= {value:>20}");
    let mut file = header(&["SIMPLE  =                    T".into(), number("BITPIX", 8), number("NAXIS", 0)]);
    let mut table = vec!["XTENSION= 'BINTABLE'".to_string(), number("BITPIX", 8), number("NAXIS", 2)];
    table.extend([number("NAXIS1", 8), number("NAXIS2", streams.len()), number("PCOUNT", heap), number("GCOUNT", 1)]);
    table.extend([number("TFIELDS", 1), "TTYPE1  = 'COMPRESSED_DATA'".into(), format!("TFORM1  = '1PB({most})'")]);
    table.extend(["ZIMAGE  =                    T".into(), "ZCMPTYPE= 'RICE_1  '".into(), number("ZBITPIX", 32)]);
    table.extend([number("ZNAXIS", 3), number("ZNAXIS1", columns), number("ZNAXIS2", rows), number("ZNAXIS3", count)]);
    table.extend([number("ZTILE1", columns), number("ZTILE2", 1), number("ZTILE3", 1)]);
    table.extend(["ZNAME1  = 'BLOCKSIZE'".into(), number("ZVAL1", BLOCK)]);
    table.extend(["ZNAME2  = 'BYTEPIX '".into(), number("ZVAL2", 4)]);
    table.extend(cards.iter().map(|card| card.to_string()));
    file.extend(header(&table));
    // The table: length and place of each stream in the heap behind it.
    let mut place = 0;
    for stream in &streams {
        file.extend((stream.len() as u32).to_be_bytes());
        file.extend((place as u32).to_be_bytes());
        place += stream.len();
    }
    file.extend(streams.concat());
    file.resize(file.len().next_multiple_of(2880), 0);
    file
}

#[test]
fn a_compressed_file_gives_the_same_answer() {
    let desk = Desk::with_images(&["image.count=2"]);
    let electrons = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    // Rounded to electrons, of which the read noise has 20.
    let whole: Array3<i32> = electrons.mapv(|e| e.round() as i32);
    let mut plain = FitsWriter::create(desk.path("plain.fits")).unwrap();
    plain.image("SCI", &whole, Pixel::I32, "electron").unwrap();
    plain.finish().unwrap();
    let bytes = compressed(whole.view(), &["EXTNAME = 'SCI     '", "BUNIT   = 'electron'"]);
    // 4 bytes a pixel before, and fewer than 3 with the headers now.
    assert!(bytes.len() < 3 * whole.len(), "{} bytes of {} pixels", bytes.len(), whole.len());
    std::fs::write(desk.path("packed.fits.fz"), bytes).unwrap();
    let estimate = |name: &str| {
        let fixed = ["estimate", name, "--scene", "scene.toml", "-o", "est.fits", "--json"];
        let json = desk.json(&fixed);
        assert_eq!((&json["status"], &json["used"]), (&"ok".into(), &2.into()), "{name}: {json}");
        ["phasing_rms_nm", "ncpa_rms_nm", "reduced_chi2"].map(|key| number(&json, key))
    };
    let expected = estimate("plain.fits");
    for name in ["packed.fits.fz", "packed.fits.fz[1]", "packed.fits.fz[SCI]"] {
        // The same pixels, bit for bit.
        assert_eq!(estimate(name), expected, "{name}");
    }
    let refused = ["estimate", "packed.fits.fz[2]", "--scene", "scene.toml", "-o", "other.fits"];
    desk.refuses(&refused, &["packed.fits.fz", "`2`"]);
}
