//! What the header of an image file says: unit, gain, read noise, wavelength, pixel scale, and
//! whether the scene agrees.

use crate::{Desk, Done, SMALL, number, text_column};
use cophase::io::{Card, FitsReader, FitsWriter, Pixel};
use serde_json::Value;

const CLEAN: [&str; 5] = ["estimate", "images.fits", "-o", "clean.fits", "--json"];

impl Desk {
    /// Writes the images of `images.fits` over `divisor` in `unit` (no unit where it is empty),
    /// with these cards and the truth.
    fn write_images(&self, name: &str, divisor: f64, unit: &str, cards: &[(&str, Card)]) {
        let mut file = FitsReader::open(self.path("images.fits")).unwrap();
        let mut copy = FitsWriter::create(self.path(name)).unwrap();
        copy.image("IMAGES", &(file.cube("IMAGES").unwrap() / divisor), Pixel::F64, unit).unwrap();
        for (key, card) in cards {
            copy.card("IMAGES", key, card.clone(), "").unwrap();
        }
        copy.finish().unwrap();
    }

    fn estimate(&self, images: &str, options: &[&str]) -> (Value, Done) {
        let fixed = ["estimate", images, "-o", "est.fits", "--json", "--scene", "scene.toml"];
        let done = self.succeeds(&fixed.into_iter().chain(options.iter().copied()).collect::<Vec<_>>());
        (serde_json::from_str(&done.out).unwrap(), done)
    }

    /// Adds a companion to the images, six pixels away.
    fn add_companion(&self, name: &str, contrast: f64) {
        self.edit_images("images.fits", name, |images| {
            let star = images.clone();
            for ((i, y, x), value) in images.indexed_iter_mut() {
                *value += if x < 6 { 0.0 } else { contrast * star[[i, y, x - 6]] };
            }
        });
    }

    fn refuses_estimate(&self, images: &str, options: &[&str], words: &[&str]) {
        let fixed = ["estimate", images, "-o", "est2.fits", "--scene", "scene.toml"];
        self.refuses(&fixed.into_iter().chain(options.iter().copied()).collect::<Vec<_>>(), words);
    }
}

#[test]
fn counts_are_converted_to_electrons_with_their_gain() {
    let desk = Desk::with_images(&[]);
    let clean = number(&desk.json(&CLEAN), "phasing_rms_nm");
    let same = |images: &str, options: &[&str]| {
        let (json, done) = desk.estimate(images, options);
        let rms = number(&json, "phasing_rms_nm");
        assert!((rms - clean).abs() < 1e-6 && json["status"] == "ok", "{images}: {rms} nm, not {clean}: {json}");
        assert_eq!(done.err, "", "{images}");
    };
    for (unit, key, gain) in
        [("adu", "GAIN", 20.0.into()), ("DN", "EGAIN", "20 e-/DN".into()), ("Count", "GAIN", 20.into())]
    {
        desk.write_images("counts.fits", 20.0, unit, &[(key, gain)]);
        same("counts.fits", &[]);
    }
    // The report says so.
    let report = desk.succeeds(&["estimate", "counts.fits", "--scene", "scene.toml", "-o", "est.fits"]).out;
    assert!(report.contains("converted to electrons: 20 per count (card GAIN = 20)"), "{report}");
    for unit in ["electrons", "e-", "photon"] {
        desk.write_images("electrons.fits", 1.0, unit, &[("GAIN", 20.0.into())]);
        same("electrons.fits", &[]);
    }
    desk.write_images("bare.fits", 20.0, "adu", &[]);
    desk.refuses_estimate("bare.fits", &[], &["in counts", "image.gain_e_per_adu", "--gain", "EGAIN"]);
    same("bare.fits", &["--gain", "20"]);
    same("bare.fits", &["--set", "image.gain_e_per_adu=20"]);
    // Without a unit, a gain may be that of raw frames or that of frames long converted.
    desk.write_images("unclear.fits", 20.0, "", &[("GAIN", 20.0.into())]);
    desk.refuses_estimate("unclear.fits", &[], &["GAIN = 20", "BUNIT", "20 for counts and 1 for electrons"]);
    same("unclear.fits", &["--gain", "20"]);
    desk.write_images("rate.fits", 20.0, "electron/s", &[]);
    desk.refuses_estimate("rate.fits", &[], &["`electron/s`", "electrons", "counts"]);
    desk.write_images("other.fits", 20.0, "adu", &[("GAIN", 4.0.into())]);
    let scene = SMALL.replace("read_noise_e = 20", "read_noise_e = 20\ngain_e_per_adu = 20");
    std::fs::write(desk.path("scene.toml"), scene).unwrap();
    desk.refuses_estimate("other.fits", &[], &["card GAIN = 4", "image.gain_e_per_adu = 20", "--trust"]);
    same("other.fits", &["--trust", "scene"]);
    same("bare.fits", &[]);
    // A scene that simulates and estimates: what it simulates is in electrons.
    same("images.fits", &[]);
}

#[test]
fn noise_that_is_smaller_than_stated_is_a_misfit() {
    let desk = Desk::with_images(&[]);
    for (name, divisor) in [("counts.fits", 20.0), ("normalised.fits", 5e7)] {
        desk.write_images(name, divisor, "", &[]);
        let (json, done) = desk.estimate(name, &[]);
        assert_eq!(json["status"], "misfit", "{json}");
        assert!(
            done.err.contains("noise is smaller than the stated") && done.err.contains("electrons"),
            "{}",
            done.err
        );
    }
    // Also where the read noise is the scatter of the border.
    std::fs::write(desk.path("scene.toml"), SMALL.replace("read_noise_e = 20\n", "")).unwrap();
    let (json, _) = desk.estimate("normalised.fits", &[]);
    assert_eq!(json["status"], "misfit", "{json}");
}

#[test]
fn a_file_that_contradicts_the_scene_is_refused() {
    let desk = Desk::with_images(&[]);
    let clean = number(&desk.json(&CLEAN), "phasing_rms_nm");
    let agree = |key: &str, card: Card| {
        desk.write_images("other.fits", 1.0, "electron", &[(key, card)]);
        assert_eq!(number(&desk.estimate("other.fits", &[]).0, "phasing_rms_nm"), clean, "{key}");
    };
    for (key, card) in [("WAVELEN", 2000.0.into()), ("CENWAVE", 2.0.into()), ("EFFWAVE", "2.00 um".into())] {
        agree(key, card);
    }
    // λ/grid_m/2, in arcsec: `image_cards_agree_with_the_pixels` of verbs.rs has the width.
    agree("PIXSCALE", 0.0440.into());
    agree("RDNOISE", 20.0.into());
    agree("CDELT1", 1.0.into());
    agree("FILTER", "K' + clear".into());
    agree("FILTER", "Br_gamma".into());
    // World coordinates that are turned by 45°, of pixels of 48 mas, which are known to 2 %.
    let turned = [("CTYPE1", "RA---TAN".into()), ("CD1_1", 9.4281e-6.into()), ("CD2_1", 9.4281e-6.into())];
    desk.write_images("other.fits", 1.0, "electron", &turned);
    desk.refuses_estimate("other.fits", &[], &["card CD1_1", "image.samples_per_lambda_over_d = 2", "--trust"]);
    let contradicts = |card: (&str, Card), words: &[&str]| {
        desk.write_images("other.fits", 1.0, "electron", &[card]);
        desk.refuses_estimate("other.fits", &[], &[words, &["other.fits", "--trust"]].concat());
    };
    contradicts(
        ("PIXSCALE", 0.0480.into()),
        &["card PIXSCALE = 0.048", "image.samples_per_lambda_over_d = 2", "48.000 mas"],
    );
    contradicts(("READNOIS", 25.0.into()), &["card READNOIS = 25", "image.read_noise_e = 20"]);
    contradicts(("FILTER", "H".into()), &["card FILTER = H (1390 to 1924 nm)", "image.wavelength_nm = 2000"]);
    contradicts(("FILTNAME", "Lp + clear".into()), &["card FILTNAME = Lp + clear", "image.wavelength_nm = 2000"]);
    contradicts(("WAVELENG", 1.64.into()), &["card WAVELENG = 1.64", "image.wavelength_nm = 2000"]);
    contradicts(("WAVELEN", 1640.0.into()), &["card WAVELEN = 1640", "image.wavelength_nm = 2000"]);
    let (json, _) = desk.estimate("other.fits", &["--trust", "scene"]);
    assert_eq!(number(&json, "phasing_rms_nm"), clean);
    desk.estimate("other.fits", &["--trust", "file"]);
    let lines = text_column(&desk.path("est.fits"), "SCENE", "LINE");
    assert!(lines.iter().any(|line| line == "wavelength_nm = 1640.0"), "{lines:?}");
    // What the command line says goes before what the file says.
    let (json, _) = desk.estimate("other.fits", &["--set", "image.wavelength_nm=2000"]);
    assert_eq!(number(&json, "phasing_rms_nm"), clean);
    // The exposure counts where the scene names it, and for an estimate that reads it: no modal one
    // does.
    agree("EXPTIME", 30.0.into());
    std::fs::write(desk.path("scene.toml"), SMALL.replace("[image]", "[image]\nexposure_s = 10")).unwrap();
    agree("EXPTIME", 30.0.into());
    desk.write_images("other.fits", 1.0, "electron", &[("ITIME", 30.0.into())]);
    let full_phase = ["--set", "estimate.method=full-phase"];
    desk.refuses_estimate("other.fits", &full_phase, &["card ITIME = 30", "image.exposure_s = 10", "--trust"]);
}

#[test]
fn the_scene_in_a_file_of_cophase_is_compared_with_the_scene() {
    let desk = Desk::with_images(&[]);
    for (line, other, words) in [
        ("wavelength_nm = 2000", "wavelength_nm = 1640", ["image.wavelength_nm = 2000", "image.wavelength_nm = 1640"]),
        ("waves_rms = 1.0", "waves_rms = 0.9", ["focus_waves_rms = 1 ", "focus_waves_rms = 0.9"]),
        ("rings = 1", "rings = 1\nspider_width_m = 0.1", ["pupil.spider_width_m = 0 ", "pupil.spider_width_m = 0.1"]),
        ("[image]", "[image]\nbandwidth_fraction = 0.05", ["bandwidth_fraction = 0 ", "bandwidth_fraction = 0.05"]),
    ] {
        std::fs::write(desk.path("scene.toml"), SMALL.replace(line, other)).unwrap();
        desk.refuses_estimate("images.fits", &[], &[words[0], words[1], "table SCENE", "--trust"]);
    }
    // A card that follows from a key is no contradiction of its own.
    std::fs::write(desk.path("scene.toml"), SMALL.replace("wavelength_nm = 2000", "wavelength_nm = 1640")).unwrap();
    let refused = desk.run(&["estimate", "images.fits", "-o", "est.fits", "--scene", "scene.toml"]);
    assert!(!refused.err.contains("PIXSCALE") && !refused.err.contains("WAVELEN"), "{}", refused.err);
    let (json, _) = desk.estimate("images.fits", &["--trust", "file"]);
    assert_eq!(number(&json, "phasing_rms_nm"), number(&desk.json(&CLEAN), "phasing_rms_nm"));
    // Nor does a card of another wavelength make one of the pixel scale, which is the scene's.
    std::fs::write(desk.path("scene.toml"), SMALL).unwrap();
    let pixel = FitsReader::open(desk.path("images.fits")).unwrap().card(Some("IMAGES"), "PIXSCALE").unwrap().unwrap();
    desk.write_images("other.fits", 1.0, "electron", &[("WAVELEN", 1640.0.into()), ("PIXSCALE", pixel)]);
    let refused = desk.run(&["estimate", "other.fits", "-o", "est.fits", "--scene", "scene.toml"]);
    assert!(refused.err.contains("WAVELEN") && !refused.err.contains("PIXSCALE"), "{}", refused.err);
    // What only a simulation or only an estimate reads may differ, and so may a key that is fitted.
    let scene = SMALL
        .replace("seed = 1", "seed = 2")
        .replace("peak_snr = 100", "peak_snr = 50")
        .replace("count = 14", "count = 12");
    std::fs::write(desk.path("scene.toml"), scene).unwrap();
    desk.estimate("images.fits", &[]);
    std::fs::write(desk.path("scene.toml"), SMALL.replace("lambda_over_d = 2", "lambda_over_d = 2.02")).unwrap();
    desk.refuses_estimate("images.fits", &[], &["image.samples_per_lambda_over_d = 2 where the scene has"]);
    desk.estimate("images.fits", &["--set", "estimate.fit_optics=[\"plate-scale\"]"]);
}

#[test]
fn a_read_noise_of_zero_is_zero() {
    let settings = ["image.read_noise_e=0", "image.peak_snr=", "image.flux_e=3e6"];
    let desk = Desk::with_images(&settings);
    let (json, err) = desk.estimates_well("images.fits", &[]);
    let chi2 = number(&json, "reduced_chi2");
    assert!((0.93..1.1).contains(&chi2) && json["status"] == "ok", "{json}");
    assert_eq!(err, "");
    // The scatter of the border, which the light of the star's wings dominates, is an upper limit.
    let border = desk.json(&["estimate", "images.fits", "-o", "est.fits", "--json", "--set", "image.read_noise_e="]);
    assert!(number(&border, "reduced_chi2") < chi2 - 0.05 && border["status"] == "ok", "{border}");
    assert!(number(&border, "phasing_sigma_nm") > 1.02 * number(&json, "phasing_sigma_nm"), "{border} {json}");
    // Few photons, and pixels without any.
    let desk = Desk::with_images(&["image.read_noise_e=0", "image.peak_snr=", "image.flux_e=2e4"]);
    let (json, _) = desk.estimates_well("images.fits", &[]);
    assert_eq!(json["status"], "ok", "{json}");
}

#[test]
fn small_faults_are_flagged() {
    let desk = Desk::with_images(&["pupil.samples=128", "image.peak_snr=500"]);
    let (json, err) = desk.estimates_well("images.fits", &[]);
    assert_eq!((&json["status"], err.as_str()), (&"ok".into(), ""), "{json}");
    // Six error bars of the phasing.
    desk.add_companion("companion.fits", 0.005);
    // A detector whose response falls by 2 % up to the brightest pixel: five error bars.
    desk.edit_images("images.fits", "curved.fits", |images| {
        let most = images.iter().fold(0.0f64, |most, &e| most.max(e));
        images.mapv_inplace(|e| e * (1.0 - 0.02 * e / most));
    });
    let estimate = |name: &str, more: &[&str]| {
        let done = desk.succeeds(&[&["estimate", name, "-o", "est.fits", "--json"], more].concat());
        (serde_json::from_str::<Value>(&done.out).unwrap(), done.err)
    };
    let noise_alone = ["--set", "estimate.posterior=false"];
    for (name, cause, more) in
        [("companion.fits", ": a second star", &[][..]), ("curved.fits", "a non-linear detector", &noise_alone)]
    {
        let (json, err) = estimate(name, more);
        let chi2 = number(&json, "reduced_chi2");
        assert!(json["status"] == "misfit" && chi2 < 2.0, "{name}: {json}");
        let named = err.lines().find(|line| line.contains("likely cause") && line.contains("image 1: "));
        assert!(named.is_some_and(|line| line.contains(cause)), "{err}");
    }
    // The response is one of the errors that the error bars hold, which a warning names where it is
    // larger than expected.
    let (json, err) = estimate("curved.fits", &["--set", "tolerance.response_fraction=0.01"]);
    let loss = err.split("the loss of response at the peak is off by ").nth(1).and_then(|of| of.split(' ').next());
    let loss: f64 = loss.unwrap_or_else(|| panic!("{json} {err}")).parse().unwrap();
    assert!(json["status"] == "ok" && (loss - 0.02).abs() < 0.001, "{json} {err}");
}

#[test]
fn strict_sets_the_exit_status_for_a_warning() {
    // Without the search for larger models, which takes its time.
    let desk = Desk::with_images(&["estimate.model=scene"]);
    desk.add_companion("companion.fits", 0.03);
    let estimate = |images: &str, options: &[&str]| {
        let _ = std::fs::remove_file(desk.path("est.fits"));
        let done = desk.run(&[&["estimate", images, "-o", "est.fits", "--json"], options].concat());
        let json: Value = serde_json::from_str(&done.out).unwrap_or_else(|error| panic!("{error}: {}", done.err));
        // The output is written in any case.
        assert!(FitsReader::open(desk.path("est.fits")).is_ok(), "{images} {options:?}");
        let warnings = json["warnings"].as_array().unwrap().len();
        (done.status, warnings, done.err)
    };
    assert_eq!(estimate("images.fits", &["--strict"]), (0, 0, String::new()));
    let (status, warnings, err) = estimate("companion.fits", &["--strict"]);
    assert!(status == 3 && warnings > 0 && err.contains("warning: "), "{status} {warnings} {err}");
    assert_eq!(estimate("companion.fits", &[]), (0, warnings, err));
    // A fit that is not given the evaluations that it needs, some tens.
    let stopped = ["--set", "estimate.max_evaluations=1", "--set", "estimate.restarts=0"];
    for (strict, expected) in [(&[][..], 0), (&["--strict"], 3)] {
        let (status, warnings, err) = estimate("images.fits", &[&stopped[..], strict].concat());
        assert!(status == expected && warnings > 0, "{status} {warnings} {err}");
        assert!(err.contains("these maps are no estimate"), "{err}");
    }
}

#[test]
fn another_plate_scale_is_named_as_the_cause_of_a_misfit() {
    let desk = Desk::with_images(&["image.samples_per_lambda_over_d=2", "image.peak_snr=300"]);
    // Two per cent off, and the file's scene says so: --set decides.
    let read = |scale: &str| {
        let set = format!("image.samples_per_lambda_over_d={scale}");
        desk.succeeds(&["estimate", "images.fits", "-o", "est.fits", "--json", "--set", &set]).err
    };
    let err = read("2.04");
    assert!(err.contains("likely cause") && err.contains("image 1: "), "{err}");
    let found =
        err.split("plate scale: with image.samples_per_lambda_over_d = ").nth(1).unwrap_or_else(|| panic!("{err}"));
    let scale: f64 = found.split_whitespace().next().unwrap().parse().unwrap();
    assert!((scale - 2.0).abs() < 0.002 && found.contains("in place of 2.04"), "{err}");
    assert_eq!(read("2"), "");
}

#[test]
fn the_reference_names_who_reads_a_key() {
    // The area of pixels is read by both.
    let desk = Desk::with_images(&["image.pixel_fill=1"]);
    desk.succeeds(&["estimate", "images.fits", "-o", "est.fits", "--strict"]);
    desk.refuses(
        &["estimate", "images.fits", "-o", "other.fits", "--scene", "scene.toml"],
        &["image.pixel_fill", "--trust"],
    );
    let reference = desk.succeeds(&["scene", "--reference"]).out;
    let part =
        |key: &str| reference.split(&format!("\n  {key}")).nth(1).unwrap().split("\n  ").nth(1).unwrap().to_string();
    for (key, readers) in
        [("pixel_fill:", "both"), ("flip_x:", "estimates"), ("wavelength_nm ", "both"), ("ncpa_rms_nm ", "simulations")]
    {
        assert!(part(key).contains(&format!("read by: {readers}")), "{key}: {}", part(key));
    }
}
