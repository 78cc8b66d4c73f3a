//! The pictures: read back as a reader sees them, pixel by pixel, and under the worst of data.

use cophase::Error;
use cophase_view::plot::{
    CaptionedMap, CurvePicture, EstimatePicture, ImageTriple, MapRms, MapScale, MapTriple, MapsPicture, Marker,
    ModalBars, ModeGroup, Series, SeriesStyle, Stroke,
};
use ndarray::{Array2, s};
use std::path::{Path, PathBuf};

/// The pictures stay here after the tests, to be looked at.
fn folder() -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("plot");
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// A number in −1..1 from `i`, the same at every run: SplitMix64's finaliser (Steele, Lea and
/// Flood, OOPSLA 2014).
fn noise(i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    (z ^ (z >> 31)) as f64 / u64::MAX as f64 * 2.0 - 1.0
}

const SAMPLES: usize = 256;
const WIDTH_M: f64 = 11.0;

fn coordinate(j: usize) -> f64 {
    (j as f64 - (SAMPLES as f64 - 1.0) / 2.0) * WIDTH_M / SAMPLES as f64
}

/// Centres of three rings of hexagons of 0.9 m side, without the central one: Keck's 36 segments.
fn centres() -> Vec<(f64, f64)> {
    let (side, mut centres) = (0.9, Vec::new());
    for q in -3i32..=3 {
        for r in -3i32..=3 {
            if (q + r).abs() <= 3 && (q, r) != (0, 0) {
                centres.push((1.5 * side * f64::from(q), 3f64.sqrt() * side * (f64::from(r) + f64::from(q) / 2.0)));
            }
        }
    }
    centres
}

/// Index of the hexagon that holds the point.
fn owner(x: f64, y: f64, centres: &[(f64, f64)]) -> Option<usize> {
    let apothem = 0.9 * 3f64.sqrt() / 2.0;
    centres.iter().position(|(u, v)| {
        let (u, v) = ((x - u).abs(), (y - v).abs());
        v <= apothem && u * 3f64.sqrt() / 2.0 + v / 2.0 <= apothem
    })
}

fn pistons(coefficients: &[f64]) -> Array2<f64> {
    let centres = centres();
    Array2::from_shape_fn((SAMPLES, SAMPLES), |(i, j)| {
        owner(coordinate(j), coordinate(i), &centres).map_or(f64::NAN, |segment| coefficients[segment])
    })
}

/// Smooth polynomials in the manner of Zernike's, over the segments.
fn smooth(c: &[f64]) -> Array2<f64> {
    let mask = pistons(&[0.0; 36]);
    Array2::from_shape_fn((SAMPLES, SAMPLES), |(i, j)| {
        let (x, y) = (coordinate(j) / 5.4, coordinate(i) / 5.4);
        let (rho, theta) = (x.hypot(y), y.atan2(x));
        let modes = (2..10).map(|n| rho.powi(n) * (f64::from(n % 4 + 1) * theta + f64::from(n)).cos());
        mask[[i, j]] + modes.zip(c).map(|(mode, c)| mode * c).sum::<f64>()
    })
}

fn triple(estimate: Array2<f64>, truth: Option<Array2<f64>>, sigma_nm: f64) -> MapTriple {
    MapTriple {
        sigma: Some(estimate.mapv(|v| if v.is_nan() { v } else { sigma_nm * (1.2 + (v / 50.0).sin() / 3.0) })),
        residual: truth.as_ref().map(|truth| &estimate - truth),
        truth,
        width_m: WIDTH_M,
        rms: MapRms::default(),
        estimate,
    }
}

fn demonstration(with_truth: bool) -> EstimatePicture {
    let truth: Vec<f64> = (0..36).map(|i| 62.0 * noise(i)).collect();
    let estimate: Vec<f64> = truth.iter().enumerate().map(|(i, t)| t + 7.0 * noise(i + 100)).collect();
    let ncpa_truth: Vec<f64> = (0..24).map(|i| 60.0 * noise(i + 50) / (1.0 + i as f64 * 0.15)).collect();
    let ncpa_estimate: Vec<f64> = ncpa_truth.iter().enumerate().map(|(i, t)| t + 4.0 * noise(i + 200)).collect();
    let modes = 36 + 24;
    let names = (1..=36).map(|i| format!("segment {i}")).chain((4..28).map(|i| format!("Zernike {i}")));
    EstimatePicture {
        title: "Keck NIRC2, artificial source: phasing and NCPA from one defocused image".into(),
        subtitle: vec![
            "10⁶ e⁻ at 2200 nm, 200 nm RMS of focus; 36 segment pistons and 24 Zernike modes; χ² per pixel 1.02".into(),
        ],
        phasing: triple(pistons(&estimate), with_truth.then(|| pistons(&truth)), 4.0),
        ncpa: triple(smooth(&ncpa_estimate), with_truth.then(|| smooth(&ncpa_truth)), 2.5),
        bars: ModalBars {
            names: names.collect(),
            groups: (0..modes).map(|i| if i < 36 { ModeGroup::Segment } else { ModeGroup::Ncpa }).collect(),
            estimate_nm: estimate.iter().chain(&ncpa_estimate).copied().collect(),
            sigma_nm: (0..modes).map(|i| if i < 36 { 5.0 } else { 3.0 }).collect(),
            truth_nm: with_truth.then(|| truth.iter().chain(&ncpa_truth).copied().collect()),
        },
        images: vec![star()],
    }
}

/// Rings round a core, with noise; one bad column.
fn star() -> ImageTriple {
    let side = 128;
    let model = Array2::from_shape_fn((side, side), |(i, j)| {
        let (x, y) = (j as f64 - 64.0, i as f64 - 66.0);
        let r = x.hypot(y);
        let rings = (0.02 + (r / 2.6).cos().powi(2)) * (-(r / 17.0).powi(2)).exp();
        3e4 * rings * (1.0 + 0.3 * (3.0 * y.atan2(x)).sin()) + 12.0
    });
    let residual = Array2::from_shape_fn((side, side), |(i, j)| {
        let sum: f64 = (0..6).map(|k| noise(6 * (i * side + j) + k)).sum();
        if j == 20 { f64::NAN } else { sum / 2f64.sqrt() }
    });
    let data = &model + &(&residual * &model.mapv(|v| (v + 100.0).sqrt()));
    ImageTriple { name: String::new(), data, model, residual_in_sigma: residual }
}

fn curves() -> CurvePicture {
    let amplitude: Vec<f64> = (1..=12).map(|i| 25.0 * f64::from(i)).collect();
    let series = |label: &str, floor: f64, best: f64, style: SeriesStyle| Series {
        label: label.into(),
        y: amplitude.iter().map(|a| floor * (best / a).powi(2) + floor * (a / best).sqrt()).collect(),
        y_err: Some((0..12).map(|i| floor * (0.2 + 0.1 * noise(i))).collect()),
        x: amplitude.clone(),
        style,
    };
    let ring = SeriesStyle { marker: Marker::Ring, stroke: Stroke::Dashed, colour: None };
    let square = SeriesStyle { marker: Marker::Square, stroke: Stroke::Dotted, colour: None };
    CurvePicture {
        title: "Residual against the amplitude of the defocus".into(),
        x_label: "defocus (nm RMS)".into(),
        y_label: "residual (nm RMS)".into(),
        y_log: true,
        series: vec![
            series("phasing", 9.0, 120.0, SeriesStyle::default()),
            series("NCPA", 4.0, 160.0, ring),
            series("phasing, twice the flux", 5.0, 100.0, square),
        ],
        vertical_lines: vec![(200.0, "the paper's choice".into())],
        horizontal_lines: vec![(3.0, "photon noise".into())],
        ..Default::default()
    }
}

fn read(path: &Path) -> image::RgbImage {
    image::open(path).unwrap().to_rgb8()
}

/// The text is XML whose elements are closed in order and whose attributes are quoted.
fn assert_well_formed(svg: &str) {
    let mut open = Vec::new();
    for piece in svg.split('<').skip(1) {
        let (tag, text) = piece.split_once('>').expect("an element ends");
        if let Some(name) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(name), "closed in order");
        } else if !tag.ends_with('/') {
            open.push(tag.split_whitespace().next().unwrap());
        }
        assert!(tag.matches('"').count() % 2 == 0, "attributes are quoted: {tag}");
        assert!(text.split('&').skip(1).all(|rest| rest.contains(';')), "ampersands are escaped: {text}");
    }
    assert!(open.is_empty(), "left open: {open:?}");
    assert!(!svg.chars().any(|c| c.is_control() && c != '\n'), "XML forbids control characters");
}

/// Draws the picture as PNG and as SVG; returns what a reader gets.
fn both(name: &str, draw: impl Fn(&Path) -> cophase::Result<()>) -> (image::RgbImage, String) {
    let (png, svg) = (folder().join(format!("{name}.png")), folder().join(format!("{name}.svg")));
    draw(&png).unwrap();
    draw(&svg).unwrap();
    let (picture, text) = (read(&png), std::fs::read_to_string(&svg).unwrap());
    assert_well_formed(&text);
    let (w, h) = picture.dimensions();
    let size = format!("<svg width=\"{w}\" height=\"{h}\" viewBox=\"0 0 {} {}\"", 2 * w, 2 * h);
    assert!(text.starts_with(&size), "one size for both: {size}");
    (picture, text)
}

#[test]
fn an_estimate_with_truth_shows_maps_bars_and_image() {
    let (picture, text) = both("estimate", |path| demonstration(true).draw(path));
    assert_eq!(picture.width(), 1800);
    assert!((1800..2400).contains(&picture.height()), "{}", picture.height());
    // Two rows of three maps and one of three images, each with its colour bar.
    assert_eq!(text.matches("<image ").count(), 18);
    for words in ["Phasing estimate", "NCPA residual", "Image − model", "e⁻", "sans-serif"] {
        assert!(text.contains(words), "{words}");
    }
}

#[test]
fn an_estimate_without_truth_shows_its_sigma_instead() {
    let (picture, text) = both("estimate-no-truth", |path| demonstration(false).draw(path));
    assert!(picture.height() < 1600, "one row of maps, not two: {}", picture.height());
    assert!(text.contains("Phasing 1σ") && text.contains("NCPA 1σ") && !text.contains("truth"));
}

#[test]
fn curves_have_a_legend_and_named_lines() {
    let (picture, text) = both("curves", |path| curves().draw(path));
    assert_eq!(picture.dimensions(), (1400, 950));
    assert!(text.contains("photon noise") && text.contains("phasing, twice the flux"));
}

#[test]
fn the_name_of_a_line_makes_way_for_the_legend() {
    // Many points along the bottom and the right edge: the legend is at the top left, above the
    // first of two lines, whose name counts least.
    let bottom = (0..=1000).map(|x| (f64::from(x) / 10.0, -1.0));
    let right = (0..=1000).map(|y| (95.0, f64::from(y) / 500.0 - 1.0));
    let (x, y): (Vec<f64>, Vec<f64>) = bottom.chain(right).unzip();
    let style = SeriesStyle { stroke: Stroke::None, ..Default::default() };
    let drawn = |label: &str| {
        let series = Series { label: label.into(), x: x.clone(), y: y.clone(), style, ..Default::default() };
        let vertical_lines = vec![(8.0, "covered".into()), (60.0, "free".into())];
        let picture = CurvePicture { series: vec![series], vertical_lines, ..Default::default() };
        both(&format!("names-{label}"), |path| picture.draw(path)).1
    };
    let element = |svg: &str, name: &str| {
        let end = svg.find(name).unwrap();
        svg[svg[..end].rfind("<text").unwrap()..end].to_owned()
    };
    let (with, without) = (drawn("a series with a name"), drawn(""));
    assert_ne!(element(&with, "covered"), element(&without, "covered"));
    assert_eq!(element(&with, "free"), element(&without, "free"));
}

fn lone_map(values: Array2<f64>, scale: MapScale) -> MapsPicture {
    let (caption, unit, labels) = ("a map".into(), "nm".into(), Vec::new());
    let map = CaptionedMap { caption, values, unit, width_m: Some(4.0), scale, labels };
    MapsPicture { title: "Colours".into(), columns: 1, maps: vec![map] }
}

/// The edges of the largest axis-parallel box of the axes' colour: left, top, right, bottom of a
/// lone map.
fn outline(picture: &image::RgbImage) -> (u32, u32, u32, u32) {
    // A line 1.5 pixels wide leaves at least one row of full colour or two of more than a half:
    // darker than any grey.
    let dark = |x: u32, y: u32| picture.get_pixel(x, y).0.iter().all(|&c| c < 0xb0);
    let (w, h) = picture.dimensions();
    let long = |n: usize, of: u32| n as f64 > 0.6 * f64::from(of);
    let columns: Vec<u32> = (0..w).filter(|&x| long((0..h).filter(|&y| dark(x, y)).count(), h)).collect();
    let rows: Vec<u32> = (0..h).filter(|&y| long((0..w).filter(|&x| dark(x, y)).count(), w)).collect();
    // The colour bar's edges stand at the right of the map's, as high: the map is as wide as it is
    // high.
    let (left, top, bottom) = (columns[0], rows[0], *rows.last().unwrap());
    (left, top, left + bottom - top, bottom)
}

#[test]
fn plus_is_red_minus_is_blue_zero_is_white_and_y_points_up() {
    // Row 0 is the bottom of the telescope: +100 nm stands in the last row.
    let mut values = Array2::zeros((4, 4));
    values[[3, 0]] = 100.0;
    values[[0, 3]] = -100.0;
    values[[1, 1]] = f64::NAN;
    let path = folder().join("colours.png");
    lone_map(values, MapScale::Diverging).draw(&path).unwrap();
    let picture = read(&path);
    let (left, _, right, bottom) = outline(&picture);
    let side = right - left;
    assert!((600..800).contains(&side), "the outline of the map was found: {side}");
    let cell = |i: u32, j: u32| picture.get_pixel(left + (2 * j + 1) * side / 8, bottom - (2 * i + 1) * side / 8).0;
    assert_eq!(cell(3, 0), [0x67, 0x00, 0x1f], "the bump at +y is at the top, in the red end");
    assert_eq!(cell(0, 3), [0x05, 0x30, 0x61], "the dip at +x is at the right, in the blue end");
    assert_eq!(cell(2, 2), [0xf7, 0xf7, 0xf7], "zero is neutral");
    assert_eq!(cell(1, 1), [0xd9, 0xdb, 0xde], "nothing is grey");
}

#[test]
fn estimate_and_truth_share_one_scale() {
    let constant = |v: f64| Array2::from_elem((4, 4), v);
    let (estimate, truth) = (constant(100.0), Some(constant(40.0)));
    let map = MapTriple { estimate, truth, residual: None, sigma: None, width_m: 1.0, rms: MapRms::default() };
    let (title, subtitle, bars) = ("Shared".into(), vec![], ModalBars::default());
    let picture = EstimatePicture { title, subtitle, phasing: map.clone(), ncpa: map, bars, images: vec![] };
    let path = folder().join("shared.png");
    picture.draw(&path).unwrap();
    let picture = read(&path);
    // Any point of the three maps of the first row will do.
    let colours = [300, 885, 1470].map(|x| picture.get_pixel(x, 330).0);
    // 40/100 of the way from white to the end is the second of the palette's five classes; the
    // residual, 60 nm everywhere, has its own scale.
    assert_eq!(colours, [[0x67, 0x00, 0x1f], [0xf4, 0xa5, 0x82], [0x67, 0x00, 0x1f]]);
}

#[test]
fn maps_of_every_scale_stand_in_a_grid() {
    let ImageTriple { data, residual_in_sigma, .. } = star();
    let map = |caption: &str, values, unit: &str, width_m, scale| CaptionedMap {
        caption: caption.into(),
        values,
        unit: unit.into(),
        width_m,
        scale,
        labels: if caption == "Segment pistons" { vec![((0.5, -1.0), "A17".into())] } else { Vec::new() },
    };
    let coefficients: Vec<f64> = (0..36).map(|i| 50.0 * noise(i)).collect();
    let maps = vec![
        map("Pupil", pistons(&[1.0; 36]), "", Some(WIDTH_M), MapScale::Sequential),
        map("Segment pistons", pistons(&coefficients), "nm", Some(WIDTH_M), MapScale::Diverging),
        map("Image", data, "e⁻", None, MapScale::Stretched),
        map("A long map", residual_in_sigma.slice(s![..32, ..]).to_owned(), "σ", None, MapScale::Diverging),
    ];
    let picture = MapsPicture { title: "What goes in".into(), columns: 3, maps };
    let (png, text) = both("maps", |path| picture.draw(path));
    assert_eq!(png.width(), 1800);
    assert!(["Pupil", "Segment pistons", "Image", "A long map", "A17"].iter().all(|caption| text.contains(caption)));
}

#[test]
fn no_data_stops_a_picture() {
    let odd: Vec<Array2<f64>> = vec![
        Array2::from_elem((8, 8), f64::NAN),
        Array2::zeros((8, 8)),
        Array2::from_elem((8, 8), 5.0),
        Array2::from_elem((1, 1), -1e-300),
        Array2::from_elem((1, 1), f64::INFINITY),
        Array2::from_shape_fn((4, 4), |(i, j)| if (i + j) % 2 == 0 { f64::MAX } else { f64::MIN }),
        Array2::from_shape_fn((4, 4), |(i, j)| if (i + j) % 2 == 0 { 1e300 } else { -1e300 }),
        Array2::from_shape_fn((1, 500), |(_, j)| noise(j) * 1e12),
        Array2::zeros((0, 0)),
    ];
    for (n, values) in odd.into_iter().enumerate() {
        let map = MapTriple {
            truth: Some(values.clone()),
            residual: None,
            sigma: Some(values.clone()),
            width_m: 11.0,
            rms: MapRms::default(),
            estimate: values.clone(),
        };
        let (data, model) = (values.clone(), values.clone());
        let image = ImageTriple { name: "c & <d>".into(), data, model, residual_in_sigma: values.clone() };
        let bars = ModalBars {
            names: vec!["focus <&> \u{1}\"of\" the camera".into()],
            groups: vec![ModeGroup::Ncpa],
            estimate_nm: vec![values.first().copied().unwrap_or(f64::NAN)],
            sigma_nm: vec![f64::INFINITY],
            truth_nm: None,
        };
        let picture = EstimatePicture {
            title: "Odd \u{0} & <end>".into(),
            subtitle: vec!["a very long subtitle that does not fit its line ".repeat(10)],
            phasing: map.clone(),
            ncpa: map,
            bars,
            images: vec![image.clone(), image],
        };
        let (_, text) = both(&format!("odd-{n}"), |path| picture.draw(path));
        assert!(!text.contains("NaN") && !text.contains("inf"), "no number that is none: picture {n}");
    }
}

#[test]
fn hundreds_of_modes_keep_their_labels_apart() {
    let (segments, all) = (492, 592);
    let mut picture = demonstration(true);
    picture.bars = ModalBars {
        names: (1..=segments).map(|i| format!("segment {i}")).chain((0..100).map(|i| format!("KL{i}"))).collect(),
        groups: (0..all).map(|i| if i < segments { ModeGroup::Segment } else { ModeGroup::Ncpa }).collect(),
        estimate_nm: (0..all).map(|i| if i == 7 { f64::NAN } else { 40.0 * noise(i) }).collect(),
        sigma_nm: vec![4.0; all],
        truth_nm: Some((0..all).map(|i| 40.0 * noise(i) + 3.0 * noise(i + 700)).collect()),
    };
    let (_, text) = both("many", |path| picture.draw(path));
    // At 17 pixels an em three digits are about 28 wide: 1200 pixels hold no more than 40 of them.
    let written = (100..=segments).filter(|i| text.contains(&format!(">\n{i}\n<"))).count();
    assert!((5..40).contains(&written), "{written}");
}

#[test]
fn logarithmic_axes_leave_out_what_has_no_logarithm() {
    let series = Series {
        label: "with zeros".into(),
        x: vec![0.0, 1.0, 10.0, -3.0, 100.0, 1e3, f64::NAN, 1e4],
        y: vec![1.0, 0.1, 0.0, 2.0, 3.0, f64::INFINITY, 1.0, 1e-7],
        y_err: Some(vec![1.0, 0.2, 0.1, f64::NAN, -1.0, 1.0, 1.0, 1e-8]),
        style: SeriesStyle { stroke: Stroke::None, ..Default::default() },
    };
    let mut picture = CurvePicture { x_log: true, y_log: true, series: vec![series], ..Default::default() };
    picture.vertical_lines = vec![(0.0, "nowhere".into()), (f64::NAN, "nowhere".into()), (50.0, "fifty".into())];
    let (_, text) = both("log", |path| picture.draw(path));
    // (1, 0.1), (100, 3) and (10⁴, 10⁻⁷) remain, and the legend's own disc.
    assert_eq!(text.matches("<circle").count(), 4);
    assert!(text.contains("fifty") && !text.contains("nowhere"));
}

#[test]
fn curves_of_nothing_one_point_and_the_same_point_are_drawn() {
    let lists: [&[f64]; 4] = [&[], &[3.0], &[0.0, 0.0], &[f64::NAN, f64::INFINITY, 1e308, -1e308]];
    for (n, values) in lists.into_iter().enumerate() {
        for log in [false, true] {
            let one = Series { label: "same".into(), x: values.to_vec(), y: values.to_vec(), ..Default::default() };
            let picture = CurvePicture { x_log: log, y_log: log, series: vec![one; 20], ..Default::default() };
            let (_, text) = both(&format!("nothing-{n}-{log}"), |path| picture.draw(path));
            assert!(text.contains("and 5 more"), "twenty entries do not fit a legend");
        }
    }
}

#[test]
fn picture_replaces_the_old_one_and_leaves_no_temporary_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("curve.SVG");
    std::fs::write(&path, "old").unwrap();
    curves().draw(&path).unwrap();
    assert!(std::fs::read_to_string(&path).unwrap().ends_with("</svg>\n"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    // The target is a folder: the rename fails after the picture was drawn, and the temporary goes.
    let taken = folder.path().join("taken.png");
    std::fs::create_dir_all(taken.join("inside")).unwrap();
    let failure = curves().draw(&taken).unwrap_err();
    assert!(matches!(failure, Error::File { .. }), "{failure}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn errors_name_the_cause_in_one_sentence() {
    let sentence = |outcome: cophase::Result<()>| outcome.unwrap_err().to_string();
    let has_facts = |outcome: cophase::Result<()>, facts: &[&str]| {
        let sentence = sentence(outcome);
        assert!(facts.iter().all(|fact| sentence.contains(fact)), "{facts:?}: {sentence}");
    };
    has_facts(curves().draw("curve.jpg"), &["curve.jpg", "extension `jpg`", ".png or .svg"]);
    assert!(sentence(curves().draw("curve")).contains("no extension"));
    let nowhere = sentence(curves().draw(folder().join("absent/curve.png")));
    assert!(nowhere.contains("absent/curve.png: its directory") && nowhere.contains("does not exist"), "{nowhere}");

    let mut picture = demonstration(true);
    picture.bars.sigma_nm.pop();
    has_facts(picture.draw("a.png"), &["modal bars", "60 names", "59 entries", "`sigma_nm`"]);
    let mut picture = demonstration(true);
    picture.ncpa.truth = Some(Array2::zeros((3, 3)));
    has_facts(picture.draw("a.png"), &["NCPA truth", "(3, 3)", "estimate", "(256, 256)"]);
    let mut picture = demonstration(true);
    picture.phasing.width_m = 0.0;
    has_facts(picture.draw("a.png"), &["phasing map", "0 m wide", "positive width"]);

    let mut maps = lone_map(Array2::zeros((2, 2)), MapScale::Diverging);
    maps.columns = 0;
    has_facts(maps.draw("a.png"), &["0 columns", "1 to 8"]);
    maps.columns = 1;
    maps.maps = vec![maps.maps[0].clone(); 40];
    has_facts(maps.draw("a.png"), &["40 maps", "1 columns", "page"]);

    let series = Series { label: "short".into(), x: vec![1.0], ..Default::default() };
    let picture = CurvePicture { series: vec![series], ..Default::default() };
    has_facts(picture.draw("a.png"), &["series `short`", "1 x", "0 y ", "0 y_err"]);
}
