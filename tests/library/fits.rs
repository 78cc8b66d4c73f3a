//! FITS in, FITS out: round trips, every kind of pixel, files that need repair, malicious files,
//! and failed writes.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use cophase::io::{Card, Column, FitsReader, FitsWriter, Pixel, read_cube, read_images, read_map};
use ndarray::{Array1, Array2, Array3, s};

// ---- Files composed byte by byte, so that the tests of the reader do not depend on our own writer
// ----

const BLOCK: usize = 2880;

fn pad(bytes: &mut Vec<u8>, fill: u8) {
    bytes.resize(bytes.len().next_multiple_of(BLOCK), fill);
}

fn header(cards: &[&str]) -> Vec<u8> {
    let mut bytes: Vec<u8> = cards.iter().chain([&"END"]).flat_map(|card| format!("{card:<80}").into_bytes()).collect();
    pad(&mut bytes, b' ');
    bytes
}

fn number(key: &str, value: impl std::fmt::Display) -> String {
    format!("{key:<8}= {value:>20}")
}

/// A primary image, axes x first; `extra` cards follow the mandatory ones.
fn image_cards(first: &str, bitpix: i32, axes: &[usize], extra: &[&str]) -> Vec<String> {
    let mut cards = vec![first.to_string(), number("BITPIX", bitpix), number("NAXIS", axes.len())];
    cards.extend(axes.iter().enumerate().map(|(i, n)| number(&format!("NAXIS{}", i + 1), n)));
    cards.extend(extra.iter().map(|card| card.to_string()));
    cards
}

fn hdu(cards: &[String], data: &[u8]) -> Vec<u8> {
    let mut bytes = header(&cards.iter().map(String::as_str).collect::<Vec<_>>());
    bytes.extend_from_slice(data);
    pad(&mut bytes, 0);
    bytes
}

fn primary(bitpix: i32, axes: &[usize], extra: &[&str], data: &[u8]) -> Vec<u8> {
    hdu(&image_cards(&number("SIMPLE", "T"), bitpix, axes, extra), data)
}

fn extension(name: &str, bitpix: i32, axes: &[usize], data: &[u8]) -> Vec<u8> {
    let name = format!("EXTNAME = '{name}'");
    let (pcount, gcount) = (number("PCOUNT", 0), number("GCOUNT", 1));
    hdu(&image_cards("XTENSION= 'IMAGE   '", bitpix, axes, &[&pcount, &gcount, &name]), data)
}

fn big_endian_f32(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_be_bytes()).collect()
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn put(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    fs::write(&path, bytes).unwrap();
    path
}

/// The refusal of `path`, which must be one line that names the file.
fn refusal(path: &Path) -> String {
    let message = read_images(path, None).expect_err("the file must be refused").to_string();
    assert!(message.starts_with(&path.display().to_string()), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    message
}

/// Asymmetric in every axis, exact in f32 and in i32.
fn ramp(shape: (usize, usize, usize)) -> Array3<f64> {
    Array3::from_shape_fn(shape, |(k, y, x)| (1000 * k + 40 * y + x) as f64 - 700.0)
}

// ---- Round trips ----

#[test]
fn images_of_every_shape_and_type_come_back() {
    let folder = folder();
    let path = folder.path().join("round.fits");
    let cube = ramp((3, 5, 7));
    let awkward =
        Array2::from_shape_vec((1, 6), vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 5e-324, 0.1, -1e300]).unwrap();
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("cube64", &cube, Pixel::F64, "nm").unwrap();
    file.image("CUBE32", &cube.mapv(|v| v as f32), Pixel::F32, "nm").unwrap();
    file.image("CUBEI", &cube, Pixel::I32, "").unwrap();
    // A view whose memory is not in C order must be written in the order of its indices.
    file.image("TURNED", &cube.slice(s![1, .., ..;-1]).t(), Pixel::F64, "").unwrap();
    file.image("MASK", &cube.mapv(|v| u8::from(v > 0.0)), Pixel::I32, "").unwrap();
    file.image("LINE", &Array1::from_iter((0..9).map(f64::from)), Pixel::F64, "").unwrap();
    file.image("AWKWARD", &awkward, Pixel::F64, "").unwrap();
    file.finish().unwrap();

    for name in ["CUBE64", "cube32", "CubeI"] {
        assert_eq!(read_cube(&path, name).unwrap(), cube, "{name}");
    }
    assert_eq!(read_map(&path, Some("TURNED")).unwrap(), cube.slice(s![1, .., ..;-1]).t());
    assert_eq!(read_cube(&path, "MASK").unwrap(), cube.mapv(|v| f64::from(u8::from(v > 0.0))));
    let bits = |map: &Array2<f64>| map.mapv(f64::to_bits);
    assert_eq!(bits(&read_map(&path, Some("AWKWARD")).unwrap()), bits(&awkward));
    let mut reader = FitsReader::open(&path).unwrap();
    assert_eq!(reader.repaired(), None, "our own files are standard FITS");
    assert_eq!(reader.names(), ["PRIMARY", "CUBE64", "CUBE32", "CUBEI", "TURNED", "MASK", "LINE", "AWKWARD"]);
    assert_eq!(reader.card(Some("CUBE64"), "BUNIT").unwrap(), Some(Card::Text("nm".into())));
    let one_d = reader.map(Some("LINE")).unwrap_err().to_string();
    assert!(one_d.contains("1-D") && one_d.contains("`LINE`"), "{one_d}");
}

#[test]
fn the_bytes_written_are_fits() {
    let folder = folder();
    let path = folder.path().join("bytes.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("A", &ramp((1, 2, 3)).slice(s![0, .., ..]), Pixel::F32, "").unwrap();
    file.finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    assert_eq!(bytes.len() % BLOCK, 0);
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.starts_with("SIMPLE  =                    T"));
    // x is NAXIS1, and the last block starts with row 0.
    assert!(text.contains("NAXIS1  =                    3") && text.contains("NAXIS2  =                    2"));
    let data = big_endian_f32(&[-700.0, -699.0, -698.0, -660.0, -659.0, -658.0]);
    assert_eq!(bytes[bytes.len() - BLOCK..][..24], data[..]);
    assert!(bytes[bytes.len() - BLOCK + 24..].iter().all(|&byte| byte == 0));
}

#[test]
fn tables_and_cards_come_back() {
    let folder = folder();
    let path = folder.path().join("tables.fits");
    let names = ["segment 1", "", "  two leading", "a long name of a mode that sets the width of its column"];
    let reals = vec![0.1, f64::NAN, f64::INFINITY, -5e-324];
    let integers = vec![0, -1, i64::MAX, i64::MIN];
    let scene = "[pupil]\n\twidth_m = 10.9 # 10 µm “wide”\n\nname = \"a/b\"\n";
    let long = "0123456789 it's ".repeat(12);
    let mut file = FitsWriter::create(&path).unwrap();
    let columns = [
        Column::text("NAME", names),
        Column::f64("ESTIMATE_NM", "nm", reals.clone()),
        Column::i64("EVALUATIONS", integers.clone()),
    ];
    file.table("MODES", &columns).unwrap();
    file.table("EMPTY", &[Column::text("NAME", [""; 0]), Column::f64("X", "", vec![])]).unwrap();
    file.text("SCENE", scene).unwrap();
    file.card("PRIMARY", "ELAPSED", 0.1, "s").unwrap();
    file.card("PRIMARY", "THIRD", 1.0 / 3.0, "").unwrap();
    file.card("PRIMARY", "COUNT", 42, "").unwrap();
    file.card("PRIMARY", "DONE", true, "").unwrap();
    file.card("PRIMARY", "CHI2", f64::NAN, "").unwrap();
    file.card("PRIMARY", "VERSION", "it's 1.0 / µ", "").unwrap();
    file.card("modes", "LONG", long.as_str(), "").unwrap();
    file.card("PRIMARY", "COUNT", 43, "set again").unwrap();
    file.finish().unwrap();

    let mut reader = FitsReader::open(&path).unwrap();
    assert_eq!(reader.repaired(), None);
    assert_eq!(reader.text_column("modes", "name").unwrap(), names);
    let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&reader.f64_column("MODES", "ESTIMATE_NM").unwrap()), bits(&reals));
    assert_eq!(reader.i64_column("MODES", "EVALUATIONS").unwrap(), integers);
    assert_eq!(reader.text_column("EMPTY", "NAME").unwrap(), [""; 0]);
    assert_eq!(reader.f64_column("EMPTY", "X").unwrap(), [0.0; 0]);
    let lines = reader.text_column("SCENE", "LINE").unwrap();
    assert_eq!(lines, ["[pupil]", " width_m = 10.9 # 10 um `wide`", "", "name = \"a/b\""]);
    assert_eq!(reader.card(None, "ELAPSED").unwrap(), Some(Card::Real(0.1)));
    assert_eq!(reader.card(None, "third").unwrap(), Some(Card::Real(1.0 / 3.0)));
    assert_eq!(reader.card(None, "COUNT").unwrap(), Some(Card::Integer(43)));
    assert_eq!(reader.card(None, "DONE").unwrap(), Some(Card::Logical(true)));
    assert_eq!(reader.card(None, "CHI2").unwrap(), None, "a card without value");
    assert_eq!(reader.card(None, "ABSENT").unwrap(), None);
    assert_eq!(reader.card(None, "VERSION").unwrap(), Some(Card::Text("it's 1.0 / u".into())));
    assert_eq!(reader.card(Some("MODES"), "LONG").unwrap(), Some(Card::Text(long.trim_end().into())));

    let missing = reader.f64_column("MODES", "SIGMA_NM").unwrap_err().to_string();
    assert!(missing.contains("NAME, ESTIMATE_NM, EVALUATIONS"), "{missing}");
    assert!(reader.f64_column("MODES", "NAME").is_err());
    assert!(reader.i64_column("MODES", "ESTIMATE_NM").is_err());
    assert!(reader.text_column("MODES", "EVALUATIONS").is_err());
    assert!(reader.map(Some("MODES")).unwrap_err().to_string().contains("table"));
    let absent = reader.map(Some("NOSUCH")).unwrap_err().to_string();
    assert!(absent.contains("`NOSUCH`") && absent.contains("`MODES`, `EMPTY`, `SCENE`"), "{absent}");
}

#[test]
fn the_writer_refuses_values_that_fits_cannot_represent() {
    let folder = folder();
    let path = folder.path().join("refused.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    let map = Array2::from_elem((2, 3), 0.5);
    assert!(file.image("I", &map, Pixel::I32, "").unwrap_err().to_string().contains("0.5"));
    assert!(file.image("I", &map.mapv(|_| f64::NAN), Pixel::I32, "").is_err());
    assert!(file.image("F", &map.mapv(|_| 1e39), Pixel::F32, "").unwrap_err().to_string().contains("1e39"));
    assert!(file.image("E", &Array2::<f64>::zeros((0, 3)), Pixel::F64, "").is_err());
    assert!(file.image("", &map, Pixel::F64, "").is_err());
    assert!(file.image("µ", &map, Pixel::F64, "").is_err());
    file.image("A", &map, Pixel::F64, "").unwrap();
    assert!(file.image("a", &map, Pixel::F64, "").unwrap_err().to_string().contains("already"));
    assert!(file.table("T", &[]).is_err());
    assert!(file.table("T", &[Column::i64("A", vec![1]), Column::i64("B", vec![])]).is_err());
    assert!(file.card("PRIMARY", "TOO_LONG_A_KEY", 1, "").is_err());
    assert!(file.card("PRIMARY", "S P", 1, "").is_err());
    assert!(file.card("NOSUCH", "KEY", 1, "").is_err());
    drop(file);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "a writer that is dropped leaves nothing");
}

// ---- Every kind of pixel ----

#[test]
fn every_bitpix_is_read() {
    let folder = folder();
    let axes = [3, 2];
    let values: [i8; 6] = [0, 1, 2, 3, 100, 127];
    let expected = Array3::from_shape_fn((1, 2, 3), |(_, y, x)| f64::from(values[3 * y + x]));
    let as_bytes = |wide: &dyn Fn(i8) -> Vec<u8>| values.iter().flat_map(|&value| wide(value)).collect::<Vec<u8>>();
    let cases: [(i32, Vec<u8>); 6] = [
        (8, as_bytes(&|v| vec![v as u8])),
        (16, as_bytes(&|v| i16::from(v).to_be_bytes().to_vec())),
        (32, as_bytes(&|v| i32::from(v).to_be_bytes().to_vec())),
        (64, as_bytes(&|v| i64::from(v).to_be_bytes().to_vec())),
        (-32, as_bytes(&|v| f32::from(v).to_be_bytes().to_vec())),
        (-64, as_bytes(&|v| f64::from(v).to_be_bytes().to_vec())),
    ];
    for (bitpix, data) in cases {
        let path = put(&folder, "bitpix.fits", &primary(bitpix, &axes, &[], &data));
        let images = read_images(&path, None).unwrap();
        assert_eq!(images.data, expected, "BITPIX {bitpix}");
        assert_eq!((images.hdu_name.as_str(), images.non_finite, images.repaired), ("PRIMARY", 0, None));
    }
}

#[test]
fn scaled_unsigned_and_blank_pixels_are_read() {
    let folder = folder();
    let words = |values: [i16; 4]| values.iter().flat_map(|value| value.to_be_bytes()).collect::<Vec<u8>>();
    let read = |name: &str, extra: &[&str], values| {
        let path = put(&folder, name, &primary(16, &[4, 1], extra, &words(values)));
        read_images(&path, None).unwrap()
    };
    let unsigned = read("u16.fits", &[&number("BZERO", 32768), &number("BSCALE", 1)], [-32768, 0, 32767, 1]);
    assert_eq!(unsigned.data.as_slice().unwrap(), [0.0, 32768.0, 65535.0, 32769.0]);
    let scaled = read("scaled.fits", &["BSCALE  = 0.25 / free format", "BZERO   = -1.5E1"], [0, 4, -4, 100]);
    assert_eq!(scaled.data.as_slice().unwrap(), [-15.0, -14.0, -16.0, 10.0]);
    let blank = read("blank.fits", &[&number("BLANK", -9)], [1, -9, 3, -9]);
    assert_eq!(blank.non_finite, 2);
    assert_eq!(blank.bad.as_slice().unwrap(), [false, true, false, true]);
    assert!(blank.data[[0, 0, 1]].is_nan() && blank.data[[0, 0, 2]] == 3.0);
}

#[test]
fn pixels_that_are_not_finite_are_kept_counted_and_masked() {
    let folder = folder();
    // 1e-40 is denormal: cfitsio's own check for NaN would turn it into 0.
    let data = big_endian_f32(&[f32::NAN, f32::INFINITY, 1e-40, f32::NEG_INFINITY]);
    let images = read_images(put(&folder, "nan.fits", &primary(-32, &[2, 2], &[], &data)), None).unwrap();
    assert_eq!(images.non_finite, 3);
    assert_eq!(images.bad.as_slice().unwrap(), [true, true, false, true]);
    assert!(images.data[[0, 0, 0]].is_nan());
    assert_eq!(images.data[[0, 0, 1]], f64::INFINITY);
    assert_eq!(images.data[[0, 1, 0]], f64::from(1e-40_f32));
    assert_eq!(images.data[[0, 1, 1]], f64::NEG_INFINITY);
}

// ---- Which HDU, the mask, the read noise ----

#[test]
fn the_image_hdu_is_searched_in_order() {
    let folder = folder();
    let (one, two) = (big_endian_f32(&[1.0; 6]), big_endian_f32(&[2.0; 6]));
    let badpix = extension("BADPIX", -32, &[3, 2], &big_endian_f32(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    let empty = primary(8, &[], &[], &[]);
    let found = |parts: &[&[u8]]| {
        let images = read_images(put(&folder, "order.fits", &parts.concat()), None).unwrap();
        assert_eq!(images.repaired, None);
        (images.hdu_name, images.data[[0, 0, 0]])
    };
    let full = primary(-32, &[3, 2], &[], &one);
    assert_eq!(found(&[&full, &extension("images", -32, &[3, 2], &two)]), ("IMAGES".into(), 2.0));
    assert_eq!(found(&[&full, &extension("OTHER", -32, &[3, 2], &two)]), ("PRIMARY".into(), 1.0));
    assert_eq!(found(&[&empty, &badpix, &extension("OTHER", -32, &[3, 2], &two)]), ("OTHER".into(), 2.0));
    let path = put(&folder, "only-mask.fits", &[empty, badpix].concat());
    assert!(refusal(&path).contains("holds no image"));
    // An estimate file: its table IMAGES must not lead to its maps being taken for images.
    let path = folder.path().join("estimate.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("PHASING", &Array2::<f64>::zeros((4, 4)), Pixel::F64, "nm").unwrap();
    file.table("IMAGES", &[Column::f64("CHI2", "", vec![1.0])]).unwrap();
    file.finish().unwrap();
    assert!(refusal(&path).contains("table"));
}

#[test]
fn bad_pixels_are_read_from_the_file_and_from_the_mask() {
    let folder = folder();
    let path = folder.path().join("images.fits");
    let (mask, wrong) = (folder.path().join("mask.fits"), folder.path().join("wrong.fits"));
    let cube = ramp((2, 3, 4));
    let mut flat = Array2::<f64>::zeros((3, 4));
    flat[[2, 1]] = 1.0;
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("IMAGES", &cube, Pixel::F32, "electron").unwrap();
    file.image("BADPIX", &flat, Pixel::I32, "").unwrap();
    file.card("PRIMARY", "RON_E", 3.5, "read noise").unwrap();
    file.finish().unwrap();
    let mut deep = Array3::<f64>::zeros((2, 3, 4));
    deep[[1, 0, 3]] = -2.0;
    let mut file = FitsWriter::create(&mask).unwrap();
    file.image("ANY", &deep, Pixel::F64, "").unwrap();
    file.finish().unwrap();
    let mut file = FitsWriter::create(&wrong).unwrap();
    file.image("BADPIX", &flat.t(), Pixel::F64, "").unwrap();
    file.finish().unwrap();

    let marked = |images: &cophase::io::HduImages| {
        images.bad.indexed_iter().filter(|(_, bad)| **bad).map(|(at, _)| at).collect::<Vec<_>>()
    };
    let images = read_images(&path, None).unwrap();
    assert_eq!(marked(&images), [(0, 2, 1), (1, 2, 1)]);
    assert_eq!((images.read_noise_e, images.non_finite), (Some(3.5), 0));
    assert_eq!(images.data, cube);
    let images = read_images(&path, Some(&mask)).unwrap();
    assert_eq!(marked(&images), [(0, 2, 1), (1, 0, 3), (1, 2, 1)]);
    let message = read_images(&path, Some(&wrong)).unwrap_err().to_string();
    assert!(message.contains("wrong.fits") && message.contains("(3, 4)"), "{message}");
}

#[test]
fn read_noise_of_the_image_hdu_comes_first_and_is_a_number() {
    let folder = folder();
    let data = big_endian_f32(&[1.0; 6]);
    let noise = |card: &str| {
        let path = put(&folder, "noise.fits", &primary(-32, &[3, 2], &[card], &data));
        read_images(path, None).map(|images| images.read_noise_e).map_err(|error| error.to_string())
    };
    assert_eq!(noise("RON_E   = 5"), Ok(Some(5.0)));
    assert_eq!(noise("RON_E   = 2.5D0"), Ok(Some(2.5)));
    assert_eq!(noise("RON_E   = '4.5'"), Ok(Some(4.5)));
    assert_eq!(noise("OTHER   = 1"), Ok(None));
    for wrong in ["RON_E   = -1", "RON_E   = T", "RON_E   = 'high'"] {
        assert!(noise(wrong).unwrap_err().contains("RON_E"), "{wrong}");
    }
}

// ---- Names, packed files, and missing files ----

#[test]
fn special_characters_in_names_are_not_interpreted() {
    let folder = folder();
    fs::create_dir(folder.path().join("http:")).unwrap();
    let names = [
        "a[1].fits",
        "b(copy).fits",
        "c+1",
        "!d.fits",
        "mem:",
        "e.fits[10:20,*]",
        "-",
        "http:/f.fits",
        " g .fits",
        "h.fits.gz",
    ];
    for (i, name) in names.iter().enumerate() {
        let path = folder.path().join(name);
        let map = Array2::from_elem((2, 3), i as f64);
        let mut file = FitsWriter::create(&path).unwrap();
        file.image("IMAGES", &map, Pixel::F32, "").unwrap();
        file.finish().unwrap();
        assert_eq!(read_map(&path, None).unwrap(), map, "{name}");
    }
    let long = folder
        .path()
        .join("x".repeat(200))
        .join("y".repeat(200))
        .join("z".repeat(200))
        .join("w".repeat(200))
        .join("v".repeat(200));
    fs::create_dir_all(&long).unwrap();
    let path = long.join("u.fits");
    fs::write(&path, primary(-32, &[3, 2], &[], &big_endian_f32(&[7.0; 6]))).unwrap();
    assert_eq!(read_map(&path, None).unwrap(), Array2::from_elem((2, 3), 7.0));
}

#[test]
fn packed_files_are_read_and_bounded() {
    let folder = folder();
    let plain = primary(-32, &[3, 2], &[], &big_endian_f32(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    let mut packer = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    packer.write_all(&plain).unwrap();
    let packed = packer.finish().unwrap();
    let path = put(&folder, "image.fits.gz", &packed);
    assert_eq!(read_images(&path, None).unwrap().data[[0, 1, 0]], 4.0);
    for cut in 2..packed.len() {
        refusal(&put(&folder, "cut.fits.gz", &packed[..cut]));
    }
    assert!(refusal(&put(&folder, "junk.gz", &[0x1f, 0x8b, 1, 2, 3])).contains("gzip"));
}

#[test]
fn files_without_images_are_refused_with_a_sentence() {
    let folder = folder();
    let refuses = |path: &Path, words: &[&str]| {
        let message = refusal(path);
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    refuses(&folder.path().join("missing.fits"), &["no such file"]);
    refuses(folder.path(), &["directory"]);
    refuses(Path::new("/dev/zero"), &["device"]);
    refuses(&put(&folder, "empty.fits", b""), &["empty"]);
    refuses(&put(&folder, "text.fits", b"hello world"), &["not a FITS file", "`hello wo`"]);
    refuses(&put(&folder, "png.fits", b"\x89PNG\r\n\x1a\n"), &["not a FITS file"]);
    refuses(&put(&folder, "head.fits", &primary(8, &[], &[], &[])), &["no image", "`PRIMARY`"]);
    refuses(&put(&folder, "line.fits", &primary(8, &[5], &[], &[0; 5])), &["1-D"]);
    refuses(&put(&folder, "deep.fits", &primary(8, &[2, 2, 1, 1], &[], &[0; 4])), &["4-D"]);
    refuses(&put(&folder, "zero.fits", &primary(8, &[0, 4], &[], &[])), &["no pixels"]);
    let whole = primary(-32, &[30, 40], &[], &big_endian_f32(&[0.0; 1200]));
    refuses(&put(&folder, "cut.fits", &whole[..5000]), &["truncated", "7680", "5000"]);
}

#[test]
fn impossible_headers_are_refused_before_allocation() {
    let folder = folder();
    let huge = |axes: &[usize]| primary(-64, axes, &[], &[0; 64]);
    let cases: [(&str, Vec<u8>, &str); 10] = [
        ("pixels", huge(&[1 << 20, 1 << 20]), "pixels"),
        ("overflow", huge(&[usize::MAX / 2, usize::MAX / 2, 1 << 40]), "pixels"),
        ("larger than the file", huge(&[1 << 15, 1 << 15]), "truncated"),
        ("bitpix", primary(17, &[3, 2], &[], &[0; 64]), "BITPIX"),
        ("groups", primary(8, &[3, 2], &[&number("GCOUNT", 7)], &[0; 64]), "GCOUNT"),
        ("negative", header(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 1", "NAXIS1  = -5"]), "byte 240"),
        ("naxis", header(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 100000"]), "NAXIS"),
        ("no axis", header(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 2", "NAXIS1  = 5"]), "NAXIS2"),
        ("two sizes", header(&["SIMPLE  = T", "BITPIX  = 8", "NAXIS   = 1", "NAXIS1  = 5", "NAXIS1  = 6"]), "twice"),
        ("no end", header(&["SIMPLE  = T"])[..80].repeat(72), "END"),
    ];
    for (what, bytes, word) in cases {
        let message = refusal(&put(&folder, "malicious.fits", &bytes));
        assert!(message.contains(word), "{what}: {message}");
    }
}

#[test]
fn malicious_tables_are_refused() {
    let folder = folder();
    let table = |row: usize, rows: usize, form: &str, bytes: usize| {
        let mut cards = vec!["XTENSION= 'BINTABLE'".to_string(), number("BITPIX", 8), number("NAXIS", 2)];
        cards.extend([number("NAXIS1", row), number("NAXIS2", rows), number("PCOUNT", 0), number("GCOUNT", 1)]);
        cards.extend([
            number("TFIELDS", 1),
            "TTYPE1  = 'A'".into(),
            format!("TFORM1  = '{form}'"),
            "EXTNAME = 'T'".into(),
        ]);
        let bytes = [primary(8, &[], &[], &[]), hdu(&cards, &vec![b'x'; bytes])].concat();
        let path = put(&folder, "table.fits", &bytes);
        let mut reader = FitsReader::open(path).map_err(|error| error.to_string())?;
        let texts = reader.text_column("T", "A").map_err(|error| error.to_string());
        let reals = reader.f64_column("T", "A").map_err(|error| error.to_string());
        texts.map(|texts| texts.len()).or(reals.map(|reals| reals.len()))
    };
    assert_eq!(table(8, 3, "1D", 24), Ok(3));
    assert_eq!(table(8, 3, "8A", 24), Ok(3));
    for form in ["99999999999A", "0D", "2E", "1PE(9)", "1QD", "junk", "", "8A4", "-1D"] {
        assert!(table(8, 3, form, 24).is_err(), "{form}");
    }
    assert!(table(0, 1 << 50, "1D", 0).is_err(), "rows without bytes");
    assert!(table(8, 1 << 40, "1D", 24).is_err(), "more rows than the file holds");
}

// ---- Files that are not standard FITS ----

fn ramp_bytes() -> Vec<u8> {
    big_endian_f32(&(0..20).map(|i| i as f32).collect::<Vec<_>>())
}

fn assert_repaired(bytes: &[u8], words: &[&str]) {
    let folder = folder();
    let path = put(&folder, "irregular.fits", bytes);
    let images = read_images(&path, None).unwrap();
    assert_eq!(images.data, Array3::from_shape_fn((1, 4, 5), |(_, y, x)| (5 * y + x) as f64));
    let sentence = images.repaired.unwrap_or_default();
    assert!(words.iter().all(|word| sentence.contains(word)), "{words:?} in {sentence}");
    assert_eq!(fs::read(&path).unwrap(), bytes, "reading never touches the file");
}

#[test]
fn irregular_headers_are_repaired_and_reported() {
    let head = |cards: &[&str]| [header(cards), ramp_bytes(), vec![0; BLOCK - 80]].concat();
    let loose =
        ["SIMPLE  = T /Tape", "BITPIX  = -32 /Bits", "NAXIS   = 2", "NAXIS1  = 5", "NAXIS2  = 4", "CAMNAME = 'NARROW'"];
    assert_repaired(&head(&loose), &["mandatory card", "at byte 0"]);
    assert_repaired(
        &head(&loose.map(|card| card.replace("= ", "=")).each_ref().map(String::as_str)),
        &["columns 9 and 10"],
    );
    assert_repaired(
        &head(&loose.map(|card| card.replace(" ", "")).each_ref().map(String::as_str)),
        &["columns 9 and 10"],
    );
    assert_repaired(
        &head(&loose.map(|card| card.to_lowercase().replace("= t", "= T")).each_ref().map(String::as_str)),
        &["capitals"],
    );
    let mixed = ["SIMPLE  = T", "NAXIS   = '2'", "NAXIS2  = 4.0", "OBJECT  = 'x'", "NAXIS1  = +5", "BITPIX  = -32"];
    assert_repaired(&head(&mixed), &["mandatory card"]);
    assert_repaired(&head(&[&mixed[..], &["NAXIS1  = 5"]].concat()), &["repeated"]);
    let mut zeros = head(&loose);
    zeros[..BLOCK].iter_mut().filter(|byte| **byte == b' ').for_each(|byte| *byte = 0);
    assert_repaired(&zeros, &["control bytes"]);
    let mut latin = head(&loose);
    latin[20] = 0xb0;
    assert_repaired(&latin, &["ASCII", "at byte 0"]);
}

#[test]
fn irregular_ends_are_repaired_and_reported() {
    let whole = primary(-32, &[5, 4], &[], &ramp_bytes());
    assert_repaired(&whole[..BLOCK + 80], &["padding at the end", "byte 2960"]);
    assert_repaired(&whole[..BLOCK + 1000], &["padding at the end"]);
    assert_repaired(&[&whole[..], &[0xff; 37]].concat(), &["37 bytes after the last HDU", "byte 5760"]);
    assert_repaired(&[&whole[..], &[0; 2 * BLOCK]].concat(), &["5760 bytes after"]);
    let mut fill = whole.clone();
    fill[2000..BLOCK].fill(0);
    assert_repaired(&fill, &["padding of a header", "byte 2000"]);
    // A last HDU that is a header alone may end at its END card.
    let lone = [whole, extension("LONE", 8, &[], &[])].concat();
    assert_repaired(&lone[..2 * BLOCK + 640], &["padding of a header added"]);
}

/// Cards of a repaired file are read, long ones across CONTINUE cards.
#[test]
fn cards_of_a_repaired_file_are_read() {
    let folder = folder();
    let cards =
        ["SIMPLE  = T /Tape", "BITPIX  = 8", "NAXIS   = 0", "ron_e   = 4.5", "LONG    = 'one &'", "CONTINUE  'two'"];
    let mut file = FitsReader::open(put(&folder, "cards.fits", &header(&cards))).unwrap();
    assert_eq!(file.card(None, "RON_E").unwrap(), Some(Card::Real(4.5)));
    assert_eq!(file.card(None, "LONG").unwrap(), Some(Card::Text("one two".into())));
}

// ---- Arbitrary bytes ----

/// A file with an image, a mask and a table, from our own writer.
fn rich_file(folder: &tempfile::TempDir) -> Vec<u8> {
    let path = folder.path().join("rich.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("IMAGES", &ramp((2, 9, 11)), Pixel::F32, "electron").unwrap();
    file.image("BADPIX", &Array2::<f64>::zeros((9, 11)), Pixel::I32, "").unwrap();
    let columns =
        [Column::text("NAME", ["a", "bc"]), Column::f64("X", "", vec![1.0, 2.0]), Column::i64("N", vec![1, 2])];
    file.table("T", &columns).unwrap();
    file.card("IMAGES", "RON_E", 2.0, "").unwrap();
    file.finish().unwrap();
    fs::read(path).unwrap()
}

/// Reads everything; the test is that it returns.
fn read_all(path: &Path) -> bool {
    let images = read_images(path, None);
    if let Err(error) = &images {
        assert_eq!(error.to_string().lines().count(), 1, "{error}");
    }
    if let Ok(mut reader) = FitsReader::open(path) {
        for name in reader.names() {
            let _ = (reader.map(Some(&name)), reader.cube(&name), reader.card(Some(&name), "EXTNAME"));
        }
        let _ = (reader.text_column("T", "NAME"), reader.f64_column("T", "X"), reader.i64_column("T", "N"));
    }
    images.is_ok()
}

#[test]
fn no_truncation_panics_or_is_read_as_complete() {
    let folder = folder();
    let whole = rich_file(&folder);
    for length in (0..whole.len()).step_by(97) {
        let path = put(&folder, "cut.fits", &whole[..length]);
        let complete = read_all(&path);
        // Only padding, or whole HDUs at the end, may be missing from a file that is read.
        let needed = 2 * BLOCK + 2 * 9 * 11 * 4;
        assert!(!complete || length >= needed, "{length} of {needed} bytes were read as whole images");
    }
}

#[test]
fn no_mutation_panics() {
    let folder = folder();
    let whole = rich_file(&folder);
    // A fixed linear congruential generator (Knuth's MMIX constants): the same files on every run.
    let mut state = 1_u64;
    let mut random = move |bound: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % bound
    };
    for at in (0..whole.len()).step_by(41) {
        let mut bytes = whole.clone();
        bytes[at] = random(256) as u8;
        // Digits and blanks hit sizes and forms far more often than random bytes do.
        for _ in 0..random(4) {
            let place = random(whole.len());
            bytes[place] = b"0123456789 =-'TAPQ\0"[random(19)];
        }
        read_all(&put(&folder, "mutated.fits", &bytes));
    }
    for length in [1, 79, 80, 81, 2879, 2880, 2881, 9000] {
        let mut bytes: Vec<u8> = (0..length).map(|_| random(256) as u8).collect();
        assert!(!read_all(&put(&folder, "random.fits", &bytes)));
        let start = b"SIMPLE  =                    T";
        let shared = start.len().min(length);
        bytes[..shared].copy_from_slice(&start[..shared]);
        assert!(!read_all(&put(&folder, "random.fits", &bytes)));
    }
}

#[test]
fn threads_read_and_write_concurrently() {
    let folder = folder();
    let shared = folder.path().join("shared.fits");
    let mut file = FitsWriter::create(&shared).unwrap();
    file.image("IMAGES", &ramp((4, 20, 30)), Pixel::F64, "").unwrap();
    file.finish().unwrap();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (folder, shared) = (&folder, &shared);
            scope.spawn(move || {
                for round in 0..20 {
                    assert_eq!(read_cube(shared, "IMAGES").unwrap(), ramp((4, 20, 30)));
                    let own = folder.path().join(format!("{thread}.fits"));
                    let map = Array2::from_elem((3, 2), f64::from(100 * thread + round));
                    let mut file = FitsWriter::create(&own).unwrap();
                    file.image("MAP", &map, Pixel::F32, "").unwrap();
                    file.finish().unwrap();
                    assert_eq!(read_map(&own, Some("MAP")).unwrap(), map);
                }
            });
        }
    });
}

// ---- Writes that fail ----

#[test]
fn targets_that_cannot_be_written_are_refused_at_once() {
    let folder = folder();
    let refused = |path: &Path, word: &str| {
        let message = FitsWriter::create(path).err().expect("must be refused").to_string();
        assert!(message.contains(word) && message.lines().count() == 1, "{message}");
    };
    refused(&folder.path().join("no/such/out.fits"), "does not exist");
    refused(folder.path(), "is a directory");
    refused(Path::new("/dev/null"), "is a device or a pipe");
    refused(&put(&folder, "file", b"x").join("out.fits"), "cannot be written");
    // The proc file system takes no new files, even from root.
    if Path::new("/proc/self").exists() {
        refused(Path::new("/proc/out.fits"), "");
    }
}

#[test]
fn finished_file_replaces_the_target_of_a_link() {
    use std::os::unix::fs::PermissionsExt;
    let folder = folder();
    let real = put(&folder, "real.fits", b"old");
    let link = folder.path().join("link.fits");
    std::os::unix::fs::symlink(&real, &link).unwrap();
    let mut file = FitsWriter::create(&link).unwrap();
    file.image("A", &Array2::<f64>::zeros((2, 3)), Pixel::F32, "").unwrap();
    assert_eq!(fs::read(&real).unwrap(), b"old", "nothing is visible before `finish`");
    file.finish().unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(read_map(&real, None).unwrap().dim(), (2, 3));
    let plain = put(&folder, "plain", b"");
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&real), mode(&plain), "as any new file");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 3);
}

/// A full disk, simulated by a limit on the file size in a child process (this test again, with a
/// variable set).
#[test]
fn a_full_disk_leaves_the_old_file_and_nothing_else() {
    const FOLDER: &str = "COPHASE_TEST_FULL_DISK";
    if let Ok(folder) = std::env::var(FOLDER) {
        let limit = libc::rlimit { rlim_cur: 4096, rlim_max: 4096 };
        // SAFETY: plain system calls; without the signal a write beyond the limit fails as it does
        // on a full disk.
        unsafe {
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
            assert_eq!(libc::setrlimit(libc::RLIMIT_FSIZE, &limit), 0);
        }
        let mut file = FitsWriter::create(Path::new(&folder).join("out.fits")).unwrap();
        file.image("A", &Array2::<f64>::zeros((100, 100)), Pixel::F64, "").unwrap();
        let message = file.finish().unwrap_err().to_string();
        assert!(message.contains("cannot be written") && message.contains("no partial file is left"), "{message}");
        assert_eq!(message.lines().count(), 1);
        return;
    }
    let folder = folder();
    let old = put(&folder, "out.fits", b"old");
    let name = "fits::a_full_disk_leaves_the_old_file_and_nothing_else";
    let mut child = std::process::Command::new(std::env::current_exe().unwrap());
    let done = child.args([name, "--exact"]).env(FOLDER, folder.path()).output().unwrap();
    // A name that no test has would succeed, too.
    let said = String::from_utf8_lossy(&done.stdout);
    assert!(done.status.success() && said.contains("1 passed"), "{said}");
    assert_eq!(fs::read(old).unwrap(), b"old");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

// ---- Real frames, if present ----

#[test]
fn real_keck_files_are_read() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let Some(data) = ["../shared/data", "../../shared/data"].iter().map(|at| package.join(at)).find(|at| at.is_dir())
    else {
        println!("skipped: no folder of real frames beside the project");
        return;
    };
    let frame = read_images(data.join("20130801_n0004.fits"), None).unwrap();
    assert_eq!(frame.data.dim(), (1, 150, 150));
    assert_eq!(frame.non_finite, 0);
    println!("{}", frame.repaired.as_deref().unwrap_or("nothing repaired"));
    assert!(frame.repaired.is_some_and(|sentence| sentence.contains("mandatory card") && sentence.contains("byte 0")));
    // Compared with the bytes of the file: the data of this frame start at byte 17280, as
    // big-endian f32.
    let bytes = fs::read(data.join("20130801_n0004.fits")).unwrap();
    let word = |i: usize| f64::from(f32::from_be_bytes(bytes[17280 + 4 * i..][..4].try_into().unwrap()));
    for (i, &value) in frame.data.iter().enumerate() {
        assert_eq!(value, word(i), "pixel {i}");
    }
    let mut reader = FitsReader::open(data.join("20130801_n0004.fits")).unwrap();
    assert_eq!(reader.card(None, "CAMNAME").unwrap(), Some(Card::Text("NARROW".into())));
    assert_eq!(reader.card(None, "CENWAVE").unwrap(), Some(Card::Real(1.6455)));
    for (name, side) in [("keck_pupil_open_240px.fits", 240), ("NCPA_Keck_14March2017_PD1.fits", 80)] {
        let map = read_map(data.join(name), None).unwrap();
        assert_eq!(map.dim(), (side, side));
        assert!(map.iter().all(|value| value.is_finite()) && map.iter().any(|&value| value != 0.0));
    }
}

#[test]
fn an_hdu_in_brackets_is_read() {
    let folder = folder();
    let path = folder.path().join("many.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    for (name, value) in [("SCI", 1.0), ("ERR", 2.0), ("IMAGES", 3.0)] {
        file.image(name, &Array2::from_elem((4, 6), value), Pixel::F32, "electron").unwrap();
    }
    file.table("LIST", &[Column::i64("N", vec![1])]).unwrap();
    file.finish().unwrap();
    let with = |hdu: &str| folder.path().join(format!("many.fits[{hdu}]"));
    for (hdu, value) in [("SCI", 1.0), ("err", 2.0), ("1", 1.0), ("2", 2.0), ("3", 3.0)] {
        assert_eq!(read_images(with(hdu), None).unwrap().data[[0, 0, 0]], value, "{hdu}");
        assert_eq!(read_map(with(hdu), None).unwrap()[[0, 0]], value, "{hdu}");
    }
    assert_eq!(read_images(&path, None).unwrap().data[[0, 0, 0]], 3.0);
    for (hdu, words) in [("DQ", "`SCI`"), ("5", "0 to 4"), ("LIST", "no image"), ("0", "no image")] {
        let sentence = read_images(with(hdu), None).unwrap_err().to_string();
        assert!(sentence.contains(words), "{hdu}: {sentence}");
    }
    // The brackets of a mask go before its HDU BADPIX.
    let mut mask = FitsWriter::create(folder.path().join("mask.fits")).unwrap();
    mask.image("BADPIX", &Array2::from_elem((4, 6), 0.0), Pixel::I32, "").unwrap();
    let one_marked = Array2::from_shape_fn((4, 6), |at| f64::from(u8::from(at == (0, 0))));
    mask.image("DQ", &one_marked, Pixel::I32, "").unwrap();
    mask.finish().unwrap();
    for (name, is_bad) in [("mask.fits", false), ("mask.fits[DQ]", true), ("mask.fits[1]", false)] {
        let marked = read_images(with("SCI"), Some(&folder.path().join(name))).unwrap();
        let count = marked.bad.iter().filter(|bad| **bad).count();
        assert_eq!((marked.bad[[0, 0, 0]], count), (is_bad, usize::from(is_bad)), "{name}");
    }
    // A file of that very name is itself.
    fs::copy(&path, with("SCI")).unwrap();
    assert_eq!(read_images(with("SCI"), None).unwrap().data[[0, 0, 0]], 3.0);
}

#[test]
fn files_have_origin_date_checksums_and_coordinates() {
    let folder = folder();
    let path = folder.path().join("map.fits.gz");
    let mut file = FitsWriter::create(&path).unwrap();
    file.map("MAP", &Array2::from_elem((4, 4), 1.5), "nm", 8.0).unwrap();
    file.text("LINES", "one\ntwo").unwrap();
    file.finish().unwrap();
    assert_eq!(fs::read(&path).unwrap()[..2], [0x1f, 0x8b]);
    let mut reader = FitsReader::open(&path).unwrap();
    let origin = reader.card(None, "ORIGIN").unwrap().unwrap();
    assert_eq!(origin.text(), Some(concat!("cophase ", env!("CARGO_PKG_VERSION"))));
    let date = reader.card(None, "DATE").unwrap().unwrap();
    assert!(date.text().is_some_and(|date| date.len() == 19 && date.as_bytes()[10] == b'T'), "{date}");
    for hdu in [None, Some("MAP"), Some("LINES")] {
        for key in ["DATASUM", "CHECKSUM"] {
            assert!(reader.card(hdu, key).unwrap().is_some(), "{hdu:?} {key}");
        }
    }
    let mut number = |key: &str| reader.card(Some("MAP"), key).unwrap().and_then(|card| card.number());
    assert_eq!(number("GRID_M"), Some(8.0));
    // The axis lies between samples 2 and 3, which are 2 m apart.
    assert_eq!((number("CRPIX1"), number("CDELT1"), number("CRVAL1")), (Some(2.5), Some(2.0), Some(0.0)));
    assert_eq!((number("CRPIX2"), number("CDELT2"), number("CRVAL2")), (Some(2.5), Some(2.0), Some(0.0)));
}
