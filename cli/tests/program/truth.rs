//! `cophase compare` with the truth of another program, and maps of the optical path difference in
//! the convention of POPPY and STPSF.

use crate::{Desk, SMALL, number};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use cophase::pupil::Grid;
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use ndarray::Array2;
use serde_json::Value;

const ESTIMATE: [&str; 4] = ["estimate", "images.fits", "-o", "est.fits"];
const RESIDUALS: [&str; 3] = ["phasing_residual_nm", "ncpa_residual_nm", "wavefront_residual_nm"];

/// Residuals with these options, `None` where null, and the samples that were left out.
fn residuals(desk: &Desk, options: &[&str]) -> ([Option<f64>; 3], u64) {
    let json: Value = desk.json(&[&["compare", "est.fits", "--json"], options].concat());
    (RESIDUALS.map(|key| json[key].as_f64()), json["samples_left_out"].as_u64().unwrap())
}

/// A desk with an estimate.
fn estimated() -> Desk {
    let desk = Desk::with_images(&[]);
    desk.succeeds(&ESTIMATE);
    desk
}

/// Writes a map with these cards.
fn write_map(desk: &Desk, name: &str, map: &Array2<f64>, unit: &str, cards: &[(&str, f64)]) {
    let mut file = FitsWriter::create(desk.path(name)).unwrap();
    file.image("OPD", map, Pixel::F64, unit).unwrap();
    for &(key, value) in cards {
        file.card("OPD", key, value, "").unwrap();
    }
    file.finish().unwrap();
}

fn telescope() -> Telescope {
    Telescope::new(&Scene::from_text(SMALL, std::path::Path::new("")).unwrap()).unwrap()
}

#[test]
fn a_truth_of_pistons_is_the_truth_of_their_map() {
    let desk = estimated();
    let (of_maps, none) = residuals(&desk, &["--truth", "images.fits"]);
    assert_eq!(none, 0);
    let map_nm = FitsReader::open(desk.path("images.fits")).unwrap().map(Some("TRUTH_PHASING")).unwrap();
    let pupil = telescope().pupil;
    let piston_nm = |segment: i32| map_nm[pupil.owner.indexed_iter().find(|(_, owner)| **owner == segment).unwrap().0];
    let rows: Vec<String> = (0..7).rev().map(|segment| format!("{segment}, {}\n", piston_nm(segment))).collect();
    std::fs::write(desk.path("p.csv"), format!("# segment, nm\n{}", rows.concat())).unwrap();
    let (of_pistons, none) = residuals(&desk, &["--truth-pistons", "p.csv"]);
    // The same values at the same samples.
    assert!((of_pistons[0].unwrap() - of_maps[0].unwrap()).abs() < 1e-9, "{of_pistons:?} {of_maps:?}");
    assert_eq!((of_pistons[1], of_pistons[2], none), (None, None, 0));
    let shown = desk.succeeds(&["compare", "est.fits", "--truth-pistons", "p.csv"]).out;
    assert!(shown.contains("NCPA                 unknown"), "{shown}");
    // The table of an estimate of these images is one of pistons, too: its own, but for what the
    // pistons leave out of the map.
    let (own, _) = residuals(&desk, &["--truth-pistons", "est.fits"]);
    assert!(own[0].unwrap() < 0.5 * of_maps[0].unwrap(), "{own:?} {of_maps:?}");

    let ncpa = ["--truth-pistons", "p.csv", "--truth-ncpa", "images.fits[TRUTH_NCPA]"];
    let (both, _) = residuals(&desk, &ncpa);
    // Nothing is interpolated, and nearly all samples are compared.
    for (both, maps) in both.iter().zip(of_maps) {
        assert!((both.unwrap() / maps.unwrap() - 1.0).abs() < 0.03, "{both:?} {of_maps:?}");
    }
    desk.refuses(&["compare", "est.fits", "--truth-pistons", "images.fits"], &["images.fits", "SEGMENTS"]);
    std::fs::write(desk.path("p.csv"), rows[..6].concat()).unwrap();
    desk.refuses(&["compare", "est.fits", "--truth-pistons", "p.csv"], &["p.csv", "segment 0 is missing"]);
    let both = desk.run(&["compare", "est.fits", "--truth", "images.fits", "--truth-pistons", "p.csv"]);
    assert_eq!(both.status, 2, "{}", both.err);
}

#[test]
fn a_truth_on_another_grid_is_resampled_without_its_edges() {
    let desk = estimated();
    let (own, _) = residuals(&desk, &["--truth", "images.fits"]);
    let all = number(&desk.json(&["compare", "est.fits", "--json"]), "samples") as u64;
    // The same aberrations on a finer grid, a coarser one and a wider one: draws are scaled to the
    // RMS over the samples of a grid, which changes pistons of 60 nm by 0.1 %, and the
    // interpolation of Zernikes to Noll 10 from 32 samples has errors of some 0.1 nm.
    let grids =
        [("fine", "pupil.samples=250", 0.15), ("coarse", "pupil.samples=32", 0.6), ("wide", "pupil.grid_m=6.5", 0.45)];
    for (name, setting, most_out) in grids {
        let file = format!("{name}.fits");
        desk.succeeds(&["image", "scene.toml", "-o", &file, "--set", setting]);
        let (found, left_out) = residuals(&desk, &["--truth", &file]);
        println!("{name}: {found:?}, {left_out} of {all} left out, own {own:?}");
        for (found, own) in found.iter().zip(own) {
            assert!((found.unwrap() - own.unwrap()).abs() < 0.3, "{name}: {found:?} {own:?}");
        }
        assert!(left_out > 0 && (left_out as f64) < most_out * all as f64, "{name}: {left_out} of {all}");
    }
    // In micrometres and with the distance of samples in place of the width: the same truth.
    let mut fine = FitsReader::open(desk.path("fine.fits")).unwrap();
    let width_m = fine.card(Some("TRUTH_PHASING"), "GRID_M").unwrap().unwrap().number().unwrap();
    for (name, hdu) in [("p.fits", "TRUTH_PHASING"), ("n.fits", "TRUTH_NCPA")] {
        write_map(&desk, name, &(fine.map(Some(hdu)).unwrap() * 1e-3), "micron", &[("PUPLSCAL", width_m / 250.0)]);
    }
    let (converted, left_out) = residuals(&desk, &["--truth-phasing", "p.fits[OPD]", "--truth-ncpa", "n.fits"]);
    let (direct, same) = residuals(&desk, &["--truth", "fine.fits"]);
    assert_eq!(left_out, same);
    for (converted, direct) in converted.iter().zip(direct) {
        assert!((converted.unwrap() - direct.unwrap()).abs() < 1e-6, "{converted:?} {direct:?}");
    }

    write_map(&desk, "radian.fits", &Array2::zeros((64, 64)), "radian", &[]);
    desk.refuses(&["compare", "est.fits", "--truth-opd", "radian.fits"], &["radian.fits", "BUNIT", "nm, um, m"]);
    write_map(&desk, "small.fits", &Array2::zeros((64, 64)), "m", &[("PUPLSCAL", 0.01)]);
    desk.refuses(&["compare", "est.fits", "--truth-opd", "small.fits"], &["est.fits", "no value at"]);
    write_map(&desk, "four.fits", &Array2::zeros((4, 4)), "m", &[]);
    desk.refuses(&["compare", "est.fits", "--truth-opd", "four.fits"], &["this coarse"]);
    write_map(&desk, "flat.fits", &Array2::zeros((4, 8)), "m", &[]);
    desk.refuses(&["compare", "est.fits", "--truth-opd", "flat.fits"], &["flat.fits", "8x4", "square"]);
}

#[test]
fn an_estimate_becomes_an_opd_map_and_a_truth_comes_from_one() {
    let desk = Desk::with_images(&[]);
    desk.succeeds(&[&ESTIMATE[..], &["--opd", "opd.fits"]].concat());
    // What another program sees: metres, 0 outside the pupil, the distance of samples.
    let mut opd = FitsReader::open(desk.path("opd.fits")).unwrap();
    let wavefront_nm = FitsReader::open(desk.path("est.fits")).unwrap().map(Some("WAVEFRONT")).unwrap();
    let opd_m = opd.map(None).unwrap();
    assert!(
        opd_m.iter().zip(&wavefront_nm).all(|(m, nm)| (m * 1e9 - if nm.is_nan() { 0.0 } else { *nm }).abs() < 1e-9)
    );
    let pupil = telescope().pupil;
    assert_eq!(opd.image_card("PUPLSCAL").unwrap().unwrap().number(), Some(pupil.grid.pitch_m()));
    assert_eq!(opd.image_card("BUNIT").unwrap().unwrap().text(), Some("m"));
    assert_eq!(opd.map(Some("AMPLITUDE")).unwrap(), pupil.amplitude);
    let (own, _) = residuals(&desk, &["--truth-opd", "opd.fits"]);
    assert!(own[0].is_none() && own[1].is_none() && own[2].unwrap() < 1e-6, "{own:?}");

    // A map of focus, nm, without the segments' pistons and tilts, which its cards have: in metres,
    // the tilts over half of a segment.
    let grid = Grid::new(256, pupil.grid.width_m()).unwrap();
    let focus_m = Array2::from_shape_fn((256, 256), |(y, x)| {
        1e-8 * (grid.coordinate_m(x).powi(2) + grid.coordinate_m(y).powi(2))
    });
    let mut cards = vec![("PUPLSCAL".to_string(), grid.pitch_m())];
    for segment in 0..7 {
        cards.push((format!("S{:02}PISTN", segment + 1), 1e-8 * segment as f64));
        cards.push((format!("S{:02}XTILT", segment + 1), 2e-9));
        cards.push((format!("S{:02}YTILT", segment + 1), -1e-9 * segment as f64));
    }
    let cards: Vec<(&str, f64)> = cards.iter().map(|(key, value)| (key.as_str(), *value)).collect();
    write_map(&desk, "stpsf.fits", &focus_m, "meters", &cards);
    let text = SMALL.replace("ncpa_rms_nm = 50\nncpa_zernikes = [4, 10]", "ncpa_file = \"stpsf.fits\"");
    std::fs::write(desk.path("scene.toml"), &text).unwrap();
    desk.refuses(&["image", "scene.toml", "-o", "no.fits"], &["stpsf.fits", "S01PISTN", "segment_piston_rms_nm"]);
    std::fs::write(desk.path("scene.toml"), text.replace("segment_piston_rms_nm = 60\n", "")).unwrap();
    let narrow = text.replace("stpsf.fits", "narrow.fits");
    std::fs::write(desk.path("narrow.toml"), narrow).unwrap();
    write_map(&desk, "narrow.fits", &focus_m, "m", &[("PIXELSCL", 0.001)]);
    desk.refuses(&["image", "narrow.toml", "-o", "no.fits"], &["narrow.fits", "0.256 m wide", "the pupil is"]);
    desk.succeeds(&["image", "scene.toml", "-o", "images.fits"]);
    let mut images = FitsReader::open(desk.path("images.fits")).unwrap();
    let (phasing_nm, ncpa_nm) = (images.map(Some("TRUTH_PHASING")).unwrap(), images.map(Some("TRUTH_NCPA")).unwrap());
    // Half of the extent along x of a hexagon with vertices on ±x is its side, less half a sample.
    let side_m = Scene::from_text(SMALL, std::path::Path::new("")).unwrap().pupil.segment_side_m;
    let mut offsets_nm = Vec::new();
    for ((y, x), &owner) in pupil.owner.indexed_iter().filter(|(_, owner)| **owner >= 0) {
        let centre = pupil.segments[owner as usize];
        let [u, v] =
            [pupil.grid.coordinate_m(x) - centre.x_m, pupil.grid.coordinate_m(y) - centre.y_m].map(|m| m / side_m);
        let expected_nm = 10.0 * owner as f64 - owner as f64 * u + 2.0 * v;
        offsets_nm.push(phasing_nm[[y, x]] - expected_nm);
        let r2 = pupil.grid.coordinate_m(x).powi(2) + pupil.grid.coordinate_m(y).powi(2);
        // Interpolated between samples 1/53 of a segment apart.
        assert!((ncpa_nm[[y, x]] - 10.0 * r2).abs() < 0.01, "{} {}", ncpa_nm[[y, x]], 10.0 * r2);
    }
    // All by one piston, the mean; the radius is that of samples: 1/20 of 6 nm.
    let mean = offsets_nm.iter().sum::<f64>() / offsets_nm.len() as f64;
    let most = offsets_nm.iter().map(|nm| (nm - mean).abs()).fold(0.0, f64::max);
    assert!((mean + 30.0).abs() < 0.5 && most < 0.6, "{mean} {most}");

    desk.succeeds(&ESTIMATE);
    let ((by_opd, _), (by_maps, _)) =
        (residuals(&desk, &["--truth-opd", "stpsf.fits"]), residuals(&desk, &["--truth", "images.fits"]));
    // The estimate has no tilts of segments: what is left of both truths is the same, some nm, but
    // for the samples at edges.
    println!("{by_opd:?} {by_maps:?}");
    for (opd, maps) in by_opd.iter().zip(by_maps) {
        assert!((opd.unwrap() - maps.unwrap()).abs() < 0.1 * maps.unwrap(), "{by_opd:?} {by_maps:?}");
    }
    write_map(&desk, "two.fits", &focus_m, "m", &[("S01PISTN", 0.0), ("S02PISTN", 0.0)]);
    desk.refuses(&["compare", "est.fits", "--truth-opd", "two.fits"], &["cards of 2 segments", "the pupil has 7"]);
    write_map(&desk, "gap.fits", &focus_m, "m", &[("S01PISTN", 0.0), ("S03PISTN", 0.0)]);
    desk.refuses(&["compare", "est.fits", "--truth-opd", "gap.fits"], &["gap.fits", "none of segment 02"]);
}
