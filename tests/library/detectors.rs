//! Detectors that are read by several amplifiers: an image HDU each, put together by their
//! sections.

use cophase::io::{FitsWriter, Pixel, read_images};
use ndarray::{Array2, s};

/// Rows and columns of the detector, columns of the overscan.
const SHAPE: (usize, usize) = (6, 8);
const OVERSCAN: usize = 3;

/// Writes two amplifiers, of the left and right halves, the right one read from right to left, with
/// these biases and gains. `right` is the section of the right one, and the card that has it.
fn write(path: &std::path::Path, counts: &Array2<f64>, bias: [f64; 2], gain: [f64; 2], (card, right): (&str, &str)) {
    let (rows, half) = (SHAPE.0, SHAPE.1 / 2);
    let mut file = FitsWriter::create(path).unwrap();
    for (at, name) in ["AMP0", "AMP1"].into_iter().enumerate() {
        let own = counts.slice(s![.., at * half..(at + 1) * half]);
        let own = if at == 1 { own.slice_move(s![.., ..;-1]) } else { own };
        let mut read = Array2::from_elem((rows, half + OVERSCAN), bias[at]);
        read.slice_mut(s![.., ..half]).assign(&own.mapv(|counts| counts / gain[at] + bias[at]));
        file.image(name, &read, Pixel::F64, "adu").unwrap();
        for (key, text) in [
            ("DATASEC", format!("[1:{half},1:{rows}]")),
            ("BIASSEC", format!("[{}:{},1:{rows}]", half + 1, half + OVERSCAN)),
            (card, if at == 0 { format!("[1:{half},1:{rows}]") } else { right.to_owned() }),
        ] {
            file.card(name, key, text.as_str(), "").unwrap();
        }
        file.card(name, "GAIN", gain[at], "").unwrap();
    }
    file.finish().unwrap();
}

#[test]
fn amplifiers_become_one_image() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("amps.fits");
    let counts = Array2::from_shape_fn(SHAPE, |(y, x)| (10 * y + x) as f64);
    write(&path, &counts, [1000.0, 1500.0], [1.0, 1.0], ("CCDSEC", "[8:5,1:6]"));
    assert_eq!(read_images(&path, None).unwrap().data.index_axis(ndarray::Axis(0), 0), counts);
    write(&path, &counts, [1000.0, 1500.0], [1.0, 1.0], ("DETSEC", "[8:5,1:6]"));
    let images = read_images(&path, None).unwrap();
    assert_eq!(images.data.index_axis(ndarray::Axis(0), 0), counts);
    assert!(images.remarks.iter().any(|remark| remark.contains("AMP1") && remark.contains("BIASSEC")));
    // Counts of the first amplifier.
    write(&path, &counts, [1000.0, 1500.0], [1.0, 2.0], ("DETSEC", "[8:5,1:6]"));
    assert_eq!(read_images(&path, None).unwrap().data.index_axis(ndarray::Axis(0), 0), counts);
    // One that the user names is read alone.
    let alone = format!("{}[AMP1]", path.display());
    assert_eq!(read_images(alone, None).unwrap().data.dim(), (1, 6, 7));
}

#[test]
fn images_of_one_section_are_no_amplifiers() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("same.fits");
    let counts = Array2::from_elem(SHAPE, 1.0);
    write(&path, &counts, [0.0, 0.0], [1.0, 1.0], ("DETSEC", "[1:4,1:6]"));
    let images = read_images(&path, None).unwrap();
    assert_eq!(images.data.dim(), (1, 6, 7));
    assert!(images.notes.iter().any(|note| note.contains("AMP0") && note.contains("AMP1")), "{:?}", images.notes);
}
