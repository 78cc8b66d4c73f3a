//! What each verb does when all is well.

use crate::{Desk, Done, SMALL, number, text_column};
use cophase::io::{FitsReader, read_images, read_map};
use cophase::scene::Scene;
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;

fn keys(json: &Value) -> Vec<&str> {
    json.as_object().unwrap().keys().map(String::as_str).collect()
}

#[test]
fn fitted_optics_are_reported_and_written() {
    let desk = Desk::with_images(&["image.samples_per_lambda_over_d=2.01"]);
    let set =
        ["--set", "image.samples_per_lambda_over_d=2", "--set", "estimate.fit_optics=[\"plate-scale\", \"defocus\"]"];
    let done = desk.succeeds(&[&["estimate", "images.fits", "-o", "est.fits"], &set[..]].concat());
    assert!(done.out.contains("image.samples_per_lambda_over_d = 2.01"), "{}", done.out);
    assert!(done.out.contains("(the scene says 2)"), "{}", done.out);
    // Zernikes hold the focus.
    let unidentifiable = |line: &str| {
        ["image.diversity_focus_waves_rms = 1 ", "not identifiable"].iter().all(|fact| line.contains(fact))
    };
    assert!(done.out.lines().any(unidentifiable), "{}", done.out);
    assert!(["estimate.fit_optics", "\"defocus\""].iter().all(|fact| done.err.contains(fact)), "{}", done.err);
    let path = desk.path("est.fits");
    let mut file = FitsReader::open(&path).unwrap();
    let number = |file: &mut FitsReader, column: &str| file.f64_column("OPTICS", column).unwrap();
    let (found, sigma) = (number(&mut file, "VALUE"), number(&mut file, "SIGMA"));
    assert_eq!(number(&mut file, "SCENE"), [2.0, 1.0]);
    // The model's own error is a tenth of the noise.
    assert!((found[0] - 2.01).abs() < 5.0 * sigma[0] && sigma[0] < 1e-3 && found[1] == 1.0, "{found:?} {sigma:?}");
    let scene = text_column(&path, "SCENE", "LINE").join("\n");
    assert!(scene.contains(&found[0].to_string()), "{scene}");
}

#[test]
fn image_estimate_compare() {
    let desk = Desk::with_images(&[]);
    let (json, err) = desk.estimates_well("images.fits", &["--plot", "est.png"]);
    assert_eq!(err, "");
    let mut promised = [
        "images",
        "used",
        "clipped",
        "channels",
        "combine",
        "seconds",
        "phasing_rms_nm",
        "ncpa_rms_nm",
        "phasing_sigma_nm",
        "ncpa_sigma_nm",
        "reduced_chi2",
        "evaluations",
        "device",
        "precision",
        "status",
        "warnings",
        "policy",
        "model",
        "method",
        "ao_knowledge",
        "iterations",
        "telemetry_gain",
        "telemetry_correlation",
        "phasing_residual_nm",
        "ncpa_residual_nm",
        "error_budget",
        "model_errors",
        "without_staircases",
    ];
    promised.sort();
    assert_eq!(keys(&json), promised);
    assert_eq!((&json["images"], &json["used"]), (&1.into(), &1.into()));
    assert_eq!((&json["status"], &json["device"], &json["precision"]), (&"ok".into(), &"cpu".into(), &"f64".into()));
    // Some 4,000 pixels: χ² scatters by √(2/4000) = 0.02; the model's own error adds 0.08 here.
    assert!((number(&json, "reduced_chi2") - 1.0).abs() < 0.2, "{json}");
    // Two terms are the whole error bar.
    let terms = json["error_budget"].as_array().unwrap();
    let names: Vec<&str> = terms.iter().map(|term| term["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["noise", "what is not fitted"]);
    for (term, sigma) in [("phasing_nm", "phasing_sigma_nm"), ("ncpa_nm", "ncpa_sigma_nm")] {
        let sum_nm2: f64 = terms.iter().map(|own| number(own, term).powi(2)).sum();
        assert!((sum_nm2.sqrt() / number(&json, sigma) - 1.0).abs() < 1e-9, "{json}");
    }
    let errors = json["model_errors"].as_array().unwrap();
    assert!(errors.len() == 15 && errors.iter().all(|error| number(error, "sigma") > 0.0), "{json}");
    // The phasing has what the scene says less the tilt that the figures take out.
    assert!((40.0..60.0).contains(&number(&json, "phasing_rms_nm")), "{json}");
    assert!((45.0..51.0).contains(&number(&json, "ncpa_rms_nm")), "{json}");

    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    for name in ["PHASING", "NCPA", "WAVEFRONT", "PHASING_SIGMA", "NCPA_SIGMA"] {
        assert_eq!(file.map(Some(name)).unwrap().dim(), (64, 64), "{name}");
    }
    assert_eq!(file.text_column("MODES", "NAME").unwrap().len(), 21);
    assert_eq!(file.text_column("SCENE", "LINE").unwrap().join("\n").trim(), SMALL.trim());
    assert!(std::fs::read(desk.path("est.png")).unwrap().starts_with(b"\x89PNG"));
    assert_eq!(desk.files(), ["est.fits", "est.png", "images.fits", "scene.toml"]);
    // Error bars of the noise alone have one term.
    let (alone, _) = desk.estimates_well("images.fits", &["--set", "estimate.posterior=false"]);
    assert_eq!(alone["error_budget"][0]["phasing_nm"], alone["phasing_sigma_nm"]);
    assert!(alone["error_budget"][0]["name"] == "noise" && alone["model_errors"] == serde_json::json!([]), "{alone}");
}

#[test]
fn the_table_shows_the_residuals_that_compare_shows() {
    let desk = Desk::with_images(&[]);
    let out = desk.succeeds(&["estimate", "images.fits", "-o", "est.fits", "--plot", "est.svg", "--verbose"]).out;
    let residuals = desk.residuals("est.fits", "images.fits");
    let compared = desk.succeeds(&["compare", "est.fits", "--truth", "images.fits"]).out;
    for (name, nm) in ["phasing", "NCPA", "wavefront"].iter().zip(residuals) {
        for table in [&out, &compared] {
            let row = table.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("no {name}: {table}"));
            assert!(row.ends_with(&format!(" {nm:.3}")), "{row} where {nm} is compared");
        }
    }
    let counts = ["1 of 1 image", "21 modes", "7 of the segments", "14 of the NCPA"];
    assert!(counts.iter().all(|fact| out.contains(fact)), "{out}");
    assert!(out.contains("global piston"), "{out}");
    assert!(std::fs::read_to_string(desk.path("est.svg")).unwrap().starts_with("<svg"));
}

#[test]
fn the_way_of_the_paper_and_single_precision_run() {
    let desk = Desk::with_images(&[]);
    let ours = desk.json(&["estimate", "images.fits", "-o", "ours.fits", "--json", "--precision", "f32"]);
    assert_eq!(ours["precision"], "f32");
    let options = ["--optimizer", "bfgs", "--device", "cpu", "--method", "modal"];
    let arguments: Vec<&str> =
        ["estimate", "images.fits", "-o", "paper.fits", "--json"].into_iter().chain(options).collect();
    let paper = desk.json(&arguments);
    // Without a metric it needs several times the evaluations of the default: 21 modes, so at least
    // 21 directions.
    assert!(number(&paper, "evaluations") > number(&ours, "evaluations") && number(&paper, "evaluations") > 21.0);
    // The scene in the output says how it was made.
    assert!(text_column(&desk.path("paper.fits"), "SCENE", "LINE").join("\n").contains("optimizer = \"bfgs\""));
    let creator = FitsReader::open(desk.path("paper.fits")).unwrap().card(None, "OPTIMIZE").unwrap().unwrap();
    assert_eq!(creator.text(), Some("bfgs"));
}

#[test]
fn image_cards_agree_with_the_pixels() {
    let desk = Desk::with_images(&["image.count=3"]);
    let images = read_images(desk.path("images.fits"), None).unwrap();
    assert_eq!((images.data.dim(), images.read_noise_e), ((3, 64, 64), Some(20.0)));
    let mut file = FitsReader::open(desk.path("images.fits")).unwrap();
    let mut card = |key: &str| file.card(Some("IMAGES"), key).unwrap().unwrap().number().unwrap();
    // A few per cent of the light falls outside the frame.
    let flux: f64 = images.data.index_axis(ndarray::Axis(0), 0).sum();
    assert!((flux / card("FLUX_E") - 1.0).abs() < 0.1, "{flux} of {}", card("FLUX_E"));
    // λ/(grid_m)/2 in mas; the hexagons are 2·(√3·0.9 + 0.003) m + √3·0.9 m high, which is their
    // widest.
    let grid_m = 2.0 * (3f64.sqrt() * 0.9 + 0.003) + 3f64.sqrt() * 0.9;
    let mas = 2e-6 / grid_m / 2.0 * 206_264_806.247;
    assert!((card("PIXSCALE") / mas - 1.0).abs() < 1e-9, "{} mas", card("PIXSCALE"));
    // The map shows the pistons of the table.
    let pistons = file.f64_column("TRUTH", "PISTON_NM").unwrap();
    let map = read_map(desk.path("images.fits"), Some("TRUTH_PHASING")).unwrap();
    assert_eq!((pistons.len(), map[[32, 32]]), (7, pistons[0]));
    assert!(map[[0, 0]].is_nan());
}

#[test]
fn seeds_and_settings_change_what_they_should() {
    let desk = Desk::with_scene();
    let image = |name: &str, options: &[&str]| {
        let arguments: Vec<&str> = ["image", "scene.toml", "-q", "-o", name].iter().chain(options).copied().collect();
        assert_eq!(desk.succeeds(&arguments).out, "");
        read_images(desk.path(name), None).unwrap().data
    };
    let (first, again, other) =
        (image("a.fits", &[]), image("b.fits", &["--seed", "1"]), image("c.fits", &["--seed", "2"]));
    assert_eq!(first, again);
    assert_ne!(first, other);
    let settings = ["--set", "image.count=2", "--set", "image.pixels=32", "--json"];
    let made = desk.json(&["image", "scene.toml", "-o", "d.fits"].into_iter().chain(settings).collect::<Vec<_>>());
    assert_eq!((&made["images"], &made["pixels"]), (&2.into(), &32.into()));
    assert_eq!(read_images(desk.path("d.fits"), None).unwrap().data.dim(), (2, 32, 32));
}

#[test]
fn the_command_line_goes_before_the_file() {
    let desk = Desk::with_images(&[]);
    let sigma = |options: &[&str]| {
        let arguments: Vec<&str> =
            ["estimate", "images.fits", "-o", "est.fits", "--json"].iter().chain(options).copied().collect();
        number(&desk.json(&arguments), "phasing_sigma_nm")
    };
    let card = sigma(&[]);
    // Ten times the read noise of the card: larger error bars, although the card is still there.
    assert!(sigma(&["--set", "image.read_noise_e=200"]) > 1.5 * card);
    // Another scene than the file's: five modes fewer have smaller error bars.
    let text = SMALL.replace("ncpa_count = 14", "ncpa_count = 9");
    std::fs::write(desk.path("fewer.toml"), text).unwrap();
    assert!(sigma(&["--scene", "fewer.toml"]) < card);
    assert_eq!(text_column(&desk.path("est.fits"), "MODES", "NAME").len(), 16);
}

#[test]
fn file_names_are_relative_to_the_scene_and_stored_in_images() {
    let desk = Desk::with_scene();
    std::fs::create_dir(desk.path("there")).unwrap();
    let mut file = cophase::io::FitsWriter::create(desk.path("there/ncpa.fits")).unwrap();
    let map = ndarray::Array2::from_shape_fn((64, 64), |(y, x)| x as f64 - 0.02 * (y as f64 - 31.5).powi(2));
    file.image("NCPA", &map, cophase::io::Pixel::F64, "nm").unwrap();
    file.finish().unwrap();
    let text = SMALL.replace("ncpa_rms_nm = 50\nncpa_zernikes = [4, 10]", "ncpa_file = \"ncpa.fits\"");
    std::fs::write(desk.path("there/scene.toml"), text).unwrap();
    desk.succeeds(&["image", "there/scene.toml", "-o", "images.fits"]);
    let scene = text_column(&desk.path("images.fits"), "SCENE", "LINE").join("\n");
    let scene = Scene::from_text(&scene, Path::new("/nowhere")).unwrap();
    let ncpa_file = scene.aberrations.as_ref().unwrap().ncpa_file.clone().unwrap();
    assert_eq!(ncpa_file.canonicalize().unwrap(), desk.path("there/ncpa.fits").canonicalize().unwrap());
}

#[test]
fn a_file_of_a_scene_may_name_its_hdu_in_brackets() {
    let desk = Desk::with_scene();
    let disc = ndarray::Array2::from_shape_fn((64, 64), |(y, x)| {
        let [x, y] = [x, y].map(|at| at as f64 - 31.5);
        f64::from(u8::from(x.hypot(y) < 28.0))
    });
    let mut file = cophase::io::FitsWriter::create(desk.path("pupil.fits")).unwrap();
    file.image("DARK", &(&disc * 0.0), cophase::io::Pixel::F64, "").unwrap();
    file.image("PUPIL", &disc, cophase::io::Pixel::F64, "").unwrap();
    file.finish().unwrap();
    let text = SMALL.replace("segment_piston_rms_nm = 60\n", "");
    for (hdu, accepted) in [("PUPIL", true), ("2", true), ("SCI", false)] {
        let keys = format!("file = \"pupil.fits[{hdu}]\"\ngrid_m = 5.0");
        std::fs::write(desk.path("pupil.toml"), text.replace("aperture = \"hexagonal\"\nrings = 1", &keys)).unwrap();
        if accepted {
            desk.succeeds(&["image", "pupil.toml", "-o", "images.fits"]);
            desk.refuses(&["image", "pupil.toml", "-o", "pupil.fits"], &["pupil.fits", "pupil.file"]);
        } else {
            desk.refuses(&["image", "pupil.toml", "-o", "other.fits"], &["has no HDU `SCI`", "`PUPIL`"]);
        }
    }
}

/// A map of 240 samples is averaged to the default of 120.
#[test]
fn pupil_averaged_by_default_is_reported() {
    let desk = Desk::with_scene();
    let disc = ndarray::Array2::from_shape_fn((240, 240), |(y, x)| {
        let [x, y] = [x, y].map(|at| at as f64 - 119.5);
        f64::from(u8::from(x.hypot(y) < 110.0))
    });
    let mut file = cophase::io::FitsWriter::create(desk.path("pupil.fits")).unwrap();
    file.image("PUPIL", &disc, cophase::io::Pixel::F64, "").unwrap();
    file.finish().unwrap();
    let keys = "file = \"pupil.fits\"\ngrid_m = 5.0\n";
    let text = SMALL.replace("aperture = \"hexagonal\"\nrings = 1\nsamples = 64\n", keys);
    let text = text.replace("segment_piston_rms_nm = 60\n", "") + "segment = \"none\"\n";
    std::fs::write(desk.path("pupil.toml"), text).unwrap();
    desk.succeeds(&["image", "pupil.toml", "-o", "images.fits"]);
    let said = |more: &[&str]| {
        let estimate = ["estimate", "images.fits", "--scene", "pupil.toml", "-o", "est.fits"];
        let out = desk.succeeds(&[&estimate[..], more].concat()).out;
        out.contains("240 samples") && out.contains("averaged to 120")
    };
    assert!(said(&[]) && !said(&["--set", "pupil.samples=240"]));
}

/// The README's first command, on the scene of the paper.
#[test]
fn demonstration_writes_its_picture() {
    let desk = Desk::with_scene();
    let json = desk.json(&["demo", "-o", "new/folder", "--json"]);
    assert_eq!((&json["used"], &json["status"]), (&1.into(), &"ok".into()));
    let [phasing, ncpa, _] = desk.residuals("new/folder/est.fits", "new/folder/images.fits");
    // 35 and 85 modes: the RMS of their errors stays within 1.5 of its expectation.
    assert!(phasing < 1.5 * number(&json, "phasing_sigma_nm"), "{phasing}: {json}");
    assert!(ncpa < 1.5 * number(&json, "ncpa_sigma_nm"), "{ncpa}: {json}");
    assert!(std::fs::read(desk.path("new/folder/est.png")).unwrap().starts_with(b"\x89PNG"));
}

#[test]
fn presets_are_printed_listed_and_usable_by_name() {
    let desk = Desk::with_scene();
    let list = desk.succeeds(&["scene"]).out;
    for name in Scene::preset_names() {
        assert!(list.lines().any(|line| line.starts_with(name)), "{list}");
        assert_eq!(desk.succeeds(&["scene", name]).out, Scene::preset_text(name).unwrap());
    }
    let reference = desk.succeeds(&["scene", "--reference"]).out;
    assert!(reference.contains("wavelength_nm") && reference.contains("[estimate]"));
    // Small enough for a test; the name is a preset where no file has it.
    let small = ["--set", "pupil.samples=32", "--set", "aberrations.truth_samples=64", "--set", "image.pixels=32"];
    let arguments: Vec<&str> = ["image", "keck-onsky", "-o", "images.fits"].into_iter().chain(small).collect();
    let arguments: Vec<&str> = arguments.into_iter().chain(["--set", "image.count=1"]).collect();
    let done = desk.succeeds(&arguments);
    // What is left out is said.
    assert!(done.err.contains("warning: keck-onsky") && done.err.contains("AO loop"), "{}", done.err);
}

#[test]
fn the_numbering_of_a_scene_is_drawn_in_place_of_its_text() {
    let desk = Desk::with_scene();
    assert_eq!(desk.succeeds(&["scene", "scene.toml"]).out, SMALL);
    let drawn = desk.succeeds(&["scene", "scene.toml", "--plot", "pupil.png"]);
    let [first, second] = drawn.out.lines().collect::<Vec<_>>()[..] else { panic!("{}", drawn.out) };
    assert_eq!((first, drawn.err.as_str()), ("pupil.png: 7 segments, 0 to 6", ""));
    // The spot of one wave at 2 pixels per λ/D: 32√3 pixels.
    let facts = ["2.000 pixels per λ/grid_m", "1.000 waves RMS (2000 nm)", "55 of 64 pixels"];
    assert!(facts.iter().all(|fact| second.contains(fact)), "{second}");
    assert_eq!(desk.succeeds(&["scene", "scene.toml", "--plot", "pupil.png", "--quiet"]).out, "");
    let png = std::fs::read(desk.path("pupil.png")).unwrap();
    assert!(png.starts_with(b"\x89PNG"));
    let side = |at: usize| u32::from_be_bytes(png[at..at + 4].try_into().unwrap());
    assert_eq!(side(16), 1152);
    assert!((1250..1500).contains(&side(20)), "{}", side(20));
    let turned = ["--set", "pupil.rotation_deg=10", "--set", "image.flip_x=true", "--plot", "turned.svg"];
    desk.succeeds(&[&["scene", "scene.toml"], &turned[..]].concat());
    let svg = std::fs::read_to_string(desk.path("turned.svg")).unwrap();
    for words in ["7 segments of scene.toml", "7 segments, 0 to 6", "pupil.rotation_deg = 10", "image.flip_x is set"] {
        assert!(svg.contains(words), "{words}");
    }
    assert!(!svg.contains("<circle"), "the scene names no mirror");
}

#[test]
fn devices_are_listed() {
    let desk = Desk::with_scene();
    let list = desk.json(&["devices", "--json"]);
    let cpu = list.as_array().unwrap().iter().find(|device| device["device"] == "cpu").unwrap();
    assert!(number(cpu, "units") >= 1.0 && cpu["f64"] == true && cpu["name"].as_str().is_some_and(|n| !n.is_empty()));
    assert!(desk.succeeds(&["devices"]).out.starts_with("cpu "));
}

#[test]
fn quiet_is_quiet() {
    let desk = Desk::with_images(&[]);
    let arguments = ["estimate", "images.fits", "-o", "est.fits", "--quiet"];
    let done = desk.succeeds(&arguments);
    assert_eq!((done.out.as_str(), done.err.as_str()), ("", ""));
    let json = desk.json(&[&arguments[..], &["--json"]].concat());
    assert_eq!(json["used"], 1);
}

#[test]
fn every_verb_helps_with_an_example() {
    let desk = Desk::with_scene();
    for verb in ["scene", "image", "reduce", "estimate", "compare", "check", "devices", "demo"] {
        let help = desk.succeeds(&[verb, "--help"]).out;
        assert!(help.contains("Example") && help.contains(&format!("  cophase {verb}")), "{verb}: {help}");
        assert!(help.contains("--quiet"), "{verb}");
        // Examples are there to be copied: none may wrap in a terminal of 80 columns.
        for line in help.lines().filter(|line| line.starts_with("  cophase ")) {
            assert!(line.chars().count() < 80, "{verb}: {line}");
        }
    }
}

#[test]
fn closed_pipe_is_no_failure() {
    let desk = Desk::with_scene();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = desk.command(&["scene", "--reference"]).stdout(writer).stderr(Stdio::piped()).output().unwrap();
    let done = Done::from(output);
    assert_eq!((done.status, done.err.as_str()), (0, ""));
}

#[test]
fn sequence_reports_its_combination() {
    let desk = Desk::with_images(&["image.count=9"]);
    let (json, err) = desk.estimates_well("images.fits", &[]);
    assert_eq!(err, "");
    assert_eq!((&json["images"], &json["used"], &json["clipped"]), (&9.into(), &9.into(), &0.into()));
    assert_eq!(json["combine"], "clipped-mean");
    let out = desk.succeeds(&["estimate", "images.fits", "-o", "est.fits", "--set", "estimate.combine=median"]).out;
    assert!(out.contains("median of 9 of 9 images"), "{out}");
    assert!(out.contains("scatter between images"), "{out}");
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    assert_eq!(file.i64_column("IMAGES", "USED").unwrap(), [1; 9]);
}

#[test]
#[ignore = "merge: 12 s"]
fn a_budget_is_planned_and_estimated() {
    let desk = Desk::with_images(&[]);
    let planned = desk.succeeds(&["plan", "scene.toml", "--budget-nm", "3", "-o", "planned.toml", "--json"]);
    let json: Value = serde_json::from_str(&planned.out).unwrap();
    let mut promised = ["budget_nm", "met", "shortfall", "reference", "chosen", "choices", "omissions"];
    promised.sort();
    assert_eq!(keys(&json), promised);
    assert_eq!((&json["budget_nm"], &json["met"]), (&3.0.into(), &true.into()), "{json}");
    let (chosen, reference) = (&json["chosen"], &json["reference"]);
    assert!(
        number(chosen, "error_nm") <= 3.0 && number(chosen, "megaflops") < number(reference, "megaflops"),
        "{json}"
    );
    assert!(json["choices"].as_array().unwrap().iter().any(|choice| choice["kept"] == true), "{json}");
    // The file is a scene like any other, and leads to the same estimate as the option.
    let (with_file, _) = desk.estimates_well("images.fits", &["--scene", "planned.toml"]);
    let (with_option, _) = desk.estimates_well("images.fits", &["--budget-nm", "3"]);
    assert_eq!(number(&with_file, "phasing_rms_nm"), number(&with_option, "phasing_rms_nm"));
    assert_eq!(with_file["precision"], "f32", "{with_file}");
    // The maps stay on the scene's grid, so that the truth is told beside them.
    let table = desk.succeeds(&["plan", "scene.toml", "--budget-nm", "3"]).out;
    assert!(table.contains("the plan") && table.contains("estimate.samples"), "{table}");
    let estimate = desk.succeeds(&["estimate", "images.fits", "-o", "est.fits", "--budget-nm", "3"]).out;
    assert!(estimate.contains("residual [nm]"), "{estimate}");
    // Noise that is more than the budget is said, and is no failure.
    let short = desk.succeeds(&["plan", "scene.toml", "--budget-nm", "0.01"]);
    assert!(short.err.contains("noise alone"), "{}", short.err);
}

#[test]
fn a_plan_without_a_budget_is_refused() {
    let desk = Desk::with_scene();
    let refused = desk.run(&["plan", "scene.toml"]);
    assert_eq!(refused.status, 1);
    assert!(refused.err.contains("--budget-nm"), "{}", refused.err);
    let refused = desk.run(&["plan", "scene.toml", "--budget-nm", "-2"]);
    assert!(refused.status != 0 && !refused.err.contains("panicked"), "{}", refused.err);
}

/// `scripts/test` builds the program so.
#[cfg(not(feature = "watch"))]
#[test]
fn program_without_the_watch_says_how_to_get_it() {
    let desk = Desk::with_scene();
    let facts = ["'cophase watch'", "feature 'watch'", "cargo install --path cli"];
    desk.refuses(&["watch", "frames", "--scene", "scene.toml", "--state", "night.db"], &facts);
    let help = desk.succeeds(&["watch", "--help"]).out.replace('\n', " ");
    assert!(facts.iter().all(|fact| help.contains(fact)), "{help}");
}
