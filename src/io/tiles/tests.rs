//! Tile-compressed images: cfitsio compresses, and unpacks the same bytes for comparison.

use crate::io::cfitsio::FitsHandle;
use crate::io::read_images;
use fitsio::sys;
use std::ffi::c_int;

/// x, y and images; no multiple of the tiles.
const AXES: [i64; 3] = [45, 37, 3];
const PIXELS: usize = 45 * 37 * 3;
const UNDEFINED: f64 = -9999.0;

/// Method of cfitsio for real pixels.
#[derive(Clone, Copy)]
struct Method {
    /// BITPIX; 20 is cfitsio's code of unsigned integers of 16 bits.
    bitpix: c_int,
    compression: u32,
    /// Rows of the image where there is none.
    tile: Option<[i64; 3]>,
    /// Steps of the quantisation in the noise, 0 for none, and cfitsio's code of its dithering.
    quantisation: (f32, c_int),
}

/// A file with `values`, compressed by cfitsio.
fn compressed(values: &[f64], method: Method) -> Vec<u8> {
    // cfitsio takes a descriptor of a tile that it has not written for 0: memory for the whole
    // file, which is.
    let mut file = FitsHandle::create_in(1 << 20).unwrap();
    let (mut axes, mut first) = (AXES, [1_i64; 3]);
    // cfitsio compresses pixels of the image's own type only.
    let (code, mut bytes): (u32, Vec<u8>) = match method.bitpix {
        8 => (sys::TBYTE, values.iter().map(|value| *value as u8).collect()),
        16 => (sys::TSHORT, values.iter().flat_map(|value| (*value as i16).to_ne_bytes()).collect()),
        20 => (sys::TUSHORT, values.iter().flat_map(|value| (*value as u16).to_ne_bytes()).collect()),
        32 => (sys::TINT, values.iter().flat_map(|value| (*value as i32).to_ne_bytes()).collect()),
        -32 => (sys::TFLOAT, values.iter().flat_map(|value| (value.max(UNDEFINED) as f32).to_ne_bytes()).collect()),
        _ => (sys::TDOUBLE, values.iter().flat_map(|value| value.max(UNDEFINED).to_ne_bytes()).collect()),
    };
    // The number that stands for a pixel without a value; `max` puts it in the place of NaN.
    let (mut real, mut double) = (UNDEFINED as f32, UNDEFINED);
    let undefined = match method.bitpix {
        -32 => (&raw mut real).cast(),
        -64 => (&raw mut double).cast(),
        _ => std::ptr::null_mut(),
    };
    // SAFETY: three axes and tile sizes; `bytes` holds as many numbers of type `code` as the axes
    // say.
    file.call(|file, status| unsafe {
        sys::fits_set_compression_type(file, method.compression as c_int, status);
        if let Some(mut tile) = method.tile {
            sys::fits_set_tile_dim(file, 3, tile.as_mut_ptr(), status);
        }
        if method.bitpix < 0 {
            sys::fits_set_quantize_level(file, method.quantisation.0, status);
            sys::fits_set_quantize_method(file, method.quantisation.1, status);
            sys::fits_set_dither_seed(file, 77, status);
        }
        sys::ffcrimll(file, method.bitpix, 3, axes.as_mut_ptr(), status);
        sys::ffukys(file, c"EXTNAME".as_ptr(), c"SCI".as_ptr(), c"".as_ptr(), status);
        let (first, start) = (first.as_mut_ptr(), bytes.as_mut_ptr().cast());
        sys::ffppxnll(file, code as c_int, first, PIXELS as i64, start, undefined, status)
    })
    .unwrap();
    file.into_bytes(2).unwrap()
}

/// Noise, a star, a row of zeros, and a pixel without a value where `has_nan`.
fn pixels(offset: f64, has_nan: bool) -> Vec<f64> {
    let mut state = 1_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 59) as f64
    };
    let mut values: Vec<f64> = (0..PIXELS).map(|_| (offset + noise()).round()).collect();
    values[45..90].fill(0.0);
    values[2000] += 90.0;
    if has_nan {
        values[3000] = f64::NAN;
    }
    values
}

fn read(bytes: &[u8], hdu: &str) -> crate::Result<Vec<f64>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.fits.fz");
    std::fs::write(&path, bytes).unwrap();
    let images = read_images(format!("{}{hdu}", path.display()), None)?;
    assert_eq!((images.data.dim(), images.repaired), ((3, 37, 45), None));
    Ok(images.data.into_raw_vec_and_offset().0)
}

/// Bits, those of one NaN for each.
fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|value| if value.is_nan() { f64::NAN } else { *value }.to_bits()).collect()
}

#[test]
fn integers_come_back_bit_for_bit() {
    for (bitpix, offset) in [(8, 100.0), (16, -500.0), (20, 50_000.0), (32, 3e6)] {
        let values = pixels(offset, false)
            .iter()
            .map(|value| value.max(if bitpix == 16 { -600.0 } else { 0.0 }))
            .collect::<Vec<_>>();
        for compression in [sys::RICE_1, sys::GZIP_1, sys::GZIP_2] {
            for tile in [None, Some([20, 10, 1]), Some([45, 37, 2])] {
                let bytes = compressed(&values, Method { bitpix, compression, tile, quantisation: (0.0, 0) });
                for hdu in ["", "[1]", "[SCI]"] {
                    assert_eq!(read(&bytes, hdu).unwrap(), values, "BITPIX {bitpix}, {compression}, {tile:?} {hdu}");
                }
            }
        }
    }
}

#[test]
fn real_pixels_are_those_that_cfitsio_reads() {
    for bitpix in [-32, -64] {
        let values = pixels(1000.25, true);
        for compression in [sys::RICE_1, sys::GZIP_1, sys::GZIP_2] {
            // NO_DITHER, SUBTRACTIVE_DITHER_1 and _2 of fitsio.h.
            for dither in [-1, 1, 2] {
                for tile in [None, Some([20, 10, 1]), Some([45, 37, 3])] {
                    let method = Method { bitpix, compression, tile, quantisation: (16.0, dither) };
                    let bytes = compressed(&values, method);
                    let mut theirs = FitsHandle::from_bytes(&bytes).unwrap();
                    theirs.move_to(1).unwrap();
                    // As for integers, so that undefined pixels become NaN.
                    let theirs = theirs.image(3, PIXELS, true).unwrap();
                    // cfitsio does not round to the type of the image.
                    let theirs: Vec<f64> = if bitpix == -32 {
                        theirs.iter().map(|real| f64::from(*real as f32)).collect()
                    } else {
                        theirs
                    };
                    let ours = read(&bytes, "").unwrap();
                    let name = format!("BITPIX {bitpix}, {compression}, dithering {dither}, {tile:?}");
                    assert!(ours.iter().any(|value| value.is_nan()), "{name}");
                    assert!(bits(&ours) == bits(&theirs), "{name}");
                    // A step of the quantisation is a sixteenth of the noise, whose deviation is 9.
                    let worst = ours.iter().zip(&values).map(|(ours, value)| (ours - value).abs()).fold(0.0, f64::max);
                    assert!(worst < 1.0, "{name}: {worst}");
                }
            }
        }
        for compression in [sys::GZIP_1, sys::GZIP_2] {
            let method = Method { bitpix, compression, tile: None, quantisation: (0.0, 0) };
            let ours = read(&compressed(&values, method), "").unwrap();
            // Without quantisation cfitsio writes the number for an undefined pixel as it is, or as
            // NaN.
            let same = |(ours, value): (&f64, &f64)| ours == value || value.is_nan();
            assert!(ours.iter().zip(&values).all(same), "BITPIX {bitpix}, {compression}");
        }
    }
}

#[test]
fn invalid_tiles_are_refused_with_the_reason() {
    let method = Method { bitpix: 16, compression: sys::HCOMPRESS_1, tile: Some([45, 37, 1]), quantisation: (0.0, 0) };
    let values = pixels(100.0, false);
    let refusal = |bytes: &[u8], hdu: &str| read(bytes, hdu).map(|_| ()).unwrap_err().to_string();
    for hdu in ["", "[1]", "[SCI]"] {
        let sentence = refusal(&compressed(&values, method), hdu);
        assert!(
            sentence.contains("`SCI`") && sentence.contains("HCOMPRESS_1") && sentence.contains("funpack"),
            "{sentence}"
        );
    }
    // Cards that contradict the data; cfitsio divides by some of them.
    let good = compressed(&values, Method { compression: sys::RICE_1, tile: None, ..method });
    for (card, other, words) in [
        ("ZTILE1  =                   45", "ZTILE1  =                    0", "ZTILE1 is 0"),
        ("ZTILE1  =                   45", "ZTILE1  =                    1", "tiles"),
        ("ZNAXIS1 =                   45", "ZNAXIS1 =                99999", "compressed bytes"),
        ("ZNAXIS1 =                   45", "ZNAXIS1 =            999999999", "at most 1073741824"),
        ("ZNAXIS1 =                   45", "ZNAXIS1 =                   ''", "ZNAXIS1"),
        ("ZBITPIX =                   16", "ZBITPIX =                   17", "ZBITPIX is 17"),
        ("ZVAL1   =                   32", "ZVAL1   =                    0", "ZVAL1 is 0"),
        ("ZVAL2   =                    2", "ZVAL2   =                    3", "tile 1 of 111 is damaged"),
        ("1PB(", "1XB(", "format"),
    ] {
        let mut bytes = good.clone();
        let at = bytes.windows(card.len()).position(|window| window == card.as_bytes());
        let at = at.unwrap_or_else(|| panic!("{card}"));
        bytes[at..at + other.len()].copy_from_slice(other.as_bytes());
        let sentence = refusal(&bytes, "");
        assert!(sentence.contains("not unpacked") && sentence.contains(words), "{other}: {sentence}");
    }
    // Damaged streams give other pixels or a refusal, and no panic.
    for at in (good.len() - 2880..good.len()).step_by(7) {
        let mut bytes = good.clone();
        bytes[at] ^= 0x55;
        if let Err(error) = read(&bytes, "") {
            assert!(error.to_string().contains("damaged"), "{error}");
        }
    }
}
