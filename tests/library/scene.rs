//! Scenes: accepted and refused texts, messages, and random texts, on which the parser must not
//! panic.

use crate::common::assert_facts;
use cophase::Error;
use cophase::pupil::{Aperture as Mirror, HexagonalParameters};
use cophase::scene::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

/// Scene with pupil, modes and diversity from files.
const FROM_FILES: &str = r#"
[pupil]
file    = "pupil.fits"     # relative to this file
grid_m  = 10.95

[image]
wavelength_nm = 2168.6
samples_per_lambda_over_d = 2
pixels  = 240
diversity_file = "diversity.fits"
read_noise_e = 120.0

[modes]
file    = "modes.fits"
"#;

/// Other values for keys, as `Scene::with` takes them.
type Settings<'a> = &'a [(&'a str, &'a str)];

const SMALLEST: &str = "[image]\nwavelength_nm = 2000\npixels = 240\n";

fn parse(text: &str) -> cophase::Result<Scene> {
    Scene::from_text(text, Path::new("/scenes"))
}

/// Message of a refusal, after the checks common to all: status 1, one line, not empty.
#[track_caller]
fn refusal(text: &str) -> String {
    let error = parse(text).expect_err("the text should be refused");
    assert!(matches!(error, Error::Scene(_)) && error.status() == 1, "{error:?}");
    let message = error.to_string();
    assert!(!message.is_empty() && !message.contains('\n'), "{message:?}");
    message
}

/// Message of the refusal of a preset with other values.
#[track_caller]
fn refused_setting(preset: &str, settings: Settings) -> String {
    Scene::preset(preset).unwrap().with(settings).expect_err("the setting should be refused").to_string()
}

#[test]
fn the_presets_have_the_expected_values() {
    let names = "keck-artificial, keck-nirc2, keck-pair, keck-two-colour, jwst-pair, gtc-artificial, tmt-artificial, elt-artificial, gmt, keck-onsky, keck-pyramid, tmt-onsky, elt-onsky";
    assert_eq!(Scene::preset_names().join(", "), names);
    let scene = Scene::preset("keck-artificial").unwrap();
    assert_eq!(scene.pupil.aperture, Aperture::Keck);
    assert_eq!(scene.pupil.grid_m, Some(10.95));
    assert_eq!(scene.pupil.model, Some(PupilModel::BandLimited));
    assert!(!scene.pupil.central_segment);
    assert_eq!((scene.image.pixels, scene.image.samples_per_lambda_over_d), (480, 4.0));
    assert_eq!((scene.image.peak_snr, scene.image.flux_e), (Some(500.0), None));
    let aberrations = scene.aberrations.as_ref().unwrap();
    assert_eq!(aberrations.ncpa_zernikes, NollRange::Span { first: 4, last: 18 });
    assert_eq!(aberrations.truth_samples, Some(960));
    assert_eq!((&scene.modes.segment, &scene.modes.ncpa), (&SegmentModes::Piston, &NcpaBasis::Kl));
    assert_eq!(scene.modes.exact_zernikes, None);
    assert!(scene.control.is_none() && scene.wavefront_sensor.is_none() && scene.turbulence.fractions.is_empty());

    let scene = Scene::preset("keck-onsky").unwrap();
    assert_eq!((scene.image.count, scene.image.interval_s), (200, 0.3));
    assert_eq!(scene.turbulence.fractions.len(), 7);
    let control = scene.control.as_ref().unwrap();
    assert_eq!((control.r#loop, control.filtered_modes, control.leak), (Loop::Closed, Some(2), 0.0));
    assert_eq!(scene.wavefront_sensor.as_ref().unwrap().mask, SensorMask::None);
    assert_eq!(scene.mirror.stroke_limit_nm, None);
    assert_eq!(control.reconstructor, ReconstructorKind::Dense);

    for (name, segments, lenslets) in [("tmt-onsky", 492, 60), ("elt-onsky", 798, 80)] {
        let scene = Scene::preset(name).unwrap();
        assert_eq!(scene.pupil.layout().unwrap().hexagons().len(), segments);
        let (sensing, control) = (scene.wavefront_sensor.as_ref().unwrap(), scene.control.as_ref().unwrap());
        assert_eq!((sensing.lenslets_across, scene.mirror.actuators_across), (lenslets, lenslets + 1));
        // Actuators at the corners of the lenslets.
        let pitch_m = scene.pupil.grid_m.unwrap() / lenslets as f64;
        assert!((scene.mirror.pitch_m - pitch_m).abs() < 1e-12, "{pitch_m}");
        assert_eq!(control.reconstructor, ReconstructorKind::Sparse);
    }
}

#[test]
fn sparse_reconstructor_accepts_its_own_keys_only() {
    let sparse = ("control.reconstructor", "sparse");
    let scene = Scene::preset("keck-onsky").unwrap().with(&[sparse, ("control.filtered_modes", "")]).unwrap();
    let control = scene.control.as_ref().unwrap();
    assert_eq!((control.condition_number, control.filtered_modes), (Some(10.0), None));
    for (settings, facts) in [
        ([].as_slice(), "control.filtered_modes | control.reconstructor = \"sparse\""),
        (&[("control.filtered_modes", ""), ("control.basis", "kl")], "basis = \"zonal\" | reconstructor = \"dense\""),
        (
            &[("control.filtered_modes", ""), ("control.fill", "inpaint")],
            "control.fill = \"inpaint\" | reconstructor = \"dense\"",
        ),
        (
            &[("control.filtered_modes", ""), ("control.interaction_file", "d.fits")],
            "'control.interaction_file' | no meaning",
        ),
    ] {
        assert_facts(&refused_setting("keck-onsky", &[settings, &[sparse]].concat()), facts);
    }
}

#[test]
fn pupil_modes_and_diversity_can_come_from_files() {
    let scene = parse(FROM_FILES).unwrap();
    assert_eq!(scene.pupil.aperture, Aperture::File("pupil.fits".into()));
    assert_eq!((scene.pupil.model, scene.pupil.extent_m()), (None, None));
    assert_eq!(scene.modes.ncpa, NcpaBasis::File("modes.fits".into()));
    assert_eq!(scene.modes.segment, SegmentModes::None);
    assert_eq!(scene.image.diversity_focus_waves_rms, 0.0);
    assert_eq!(scene.resolve("pupil.fits"), PathBuf::from("/scenes/pupil.fits"));
    assert_eq!(scene.resolve("/data/pupil.fits"), PathBuf::from("/data/pupil.fits"));
    assert!(scene.aberrations.is_none());
    assert_eq!(scene.text(), FROM_FILES);
}

#[test]
fn keys_that_a_scene_does_not_name_have_defaults() {
    let scene = parse(SMALLEST).unwrap();
    assert_eq!((scene.image.samples_per_lambda_over_d, scene.image.diversity_focus_waves_rms), (2.0, 1.5));
    assert_eq!((scene.image.peak_snr, scene.image.crop_pixels, scene.image.count), (Some(500.0), Crop::Auto, 1));
    assert_eq!((scene.pupil.samples, scene.pupil.grid_m), (120, None));
    assert_eq!(scene.image.frame_shape(), (scene.image.pixels, scene.image.pixels));
    assert_eq!(parse(&format!("{SMALLEST}rows = 8")).unwrap().image.frame_shape(), (8, scene.image.pixels));
    assert_eq!((scene.estimate.optimizer, scene.estimate.weighting), (Optimizer::GaussNewton, None));
    assert_eq!((scene.estimate.device, scene.estimate.precision()), (DeviceChoice::Auto, Precision::F64));
    assert!(parse(&format!("{SMALLEST}[pupil]\naperture = \"hexagonal\"")).unwrap().pupil.central_segment);
    let flux = parse(&format!("{SMALLEST}flux_e = 1e6")).unwrap();
    assert_eq!((flux.image.peak_snr, flux.image.flux_e), (None, Some(1e6)));
}

#[test]
fn the_extent_of_the_keck_pupil() {
    let mut text = format!("{SMALLEST}[pupil]\nrings = 3\nsegment_side_m = 0.9\nsegment_gap_m = 0.003\n");
    // By hand: 3 rings of centres √3·0.9 + 0.003 = 1.5618457 m apart along y, and half a hexagon's
    // height, 0.7794229 m, on either side: 2·(3·1.5618457 + 0.7794229) = 10.9299200; along x it is
    // 2·(3·1.5618457·0.8660254 + 0.9) = 9.9155.
    let extent_m = parse(&text).unwrap().pupil.extent_m().unwrap();
    assert!((extent_m - 10.929_920_0).abs() < 2e-7, "{extent_m}"); // seven decimals above
    text += "grid_m = 10.92";
    assert_facts(&refusal(&text), "line 8 | pupil.grid_m = 10.92 | 3 rings | side 0.9 m | 10.9299 m");
    // One hexagon is widest along x.
    let one = parse(&format!("{SMALLEST}[pupil]\nrings = 0\ncentral_segment = true\nsegment_side_m = 2")).unwrap();
    assert_eq!(one.pupil.extent_m(), Some(4.0));
    // For any rotation it is the extent of the outermost vertices, up to rounding.
    for (rings, rotation_deg) in [(0, 17.0), (1, -5.0), (3, 0.6), (3, 30.0), (4, 44.0)] {
        let text = format!("{SMALLEST}[pupil]\nrings = {rings}\ncentral_segment = true\nrotation_deg = {rotation_deg}");
        let parameters =
            HexagonalParameters { rings, central_segment: true, rotation_deg, ..HexagonalParameters::keck() };
        let width_m = Mirror::hexagonal(&parameters).unwrap().width_m();
        let extent_m = parse(&text).unwrap().pupil.extent_m().unwrap();
        assert!((extent_m - width_m).abs() < 1e-13 * width_m, "{rings} {rotation_deg}: {extent_m} {width_m}");
    }
}

#[test]
fn telescopes_of_the_presets_have_their_segments_and_labels() {
    for (preset, count, inner_ring) in [
        ("keck-nirc2", 36, 1),
        ("gtc-artificial", 36, 1),
        ("tmt-artificial", 492, 2),
        ("elt-artificial", 798, 5),
        ("gmt", 7, 0),
    ] {
        let scene = Scene::preset(preset).unwrap();
        let labels: Vec<usize> = (1..=count).rev().collect();
        let scene = scene.with(&[("pupil.segment_labels", &format!("{labels:?}"))]).unwrap();
        let telescope = cophase::telescope::Telescope::new(&scene).unwrap();
        let places = cophase::telescope::SegmentPlace::all(&scene, &telescope.pupil.segments);
        assert_eq!(
            (places.len(), places[0].ring, places[0].label.clone()),
            (count, Some(inner_ring), count.to_string())
        );
        assert_eq!((places[count - 1].number, places[count - 1].label.as_str()), (count - 1, "1"));
    }
    // Seven discs of GMT, of which the central one has a hole; the segments do not overlap.
    let scene = Scene::preset("gmt").unwrap();
    let telescope = cophase::telescope::Telescope::new(&scene).unwrap();
    let area_m2 = telescope.pupil.amplitude.sum() * telescope.pupil.grid.pitch_m().powi(2);
    let known_m2 = std::f64::consts::PI / 4.0 * (7.0 * 8.365f64.powi(2) - 3.6f64.powi(2));
    // The polygons have the area of the discs.
    assert!((area_m2 / known_m2 - 1.0).abs() < 1e-9, "{area_m2} {known_m2}");
    assert!((telescope.pupil.segments[1].x_m.hypot(telescope.pupil.segments[1].y_m) - 8.71).abs() < 1e-9);
    let message = refused_setting("gmt", &[("pupil.grid_m", "25.7")]);
    assert_facts(&message, "pupil.grid_m = 25.7 | 1 rings | 4.1825 m | 25.78");
    for (settings, facts) in [
        ([("pupil.segment_labels", "[1, 2]")].as_slice(), "pupil.segment_labels | 2 labels | 36 segments"),
        (&[("pupil.rings", "1"), ("pupil.segment_labels", "[1, 2, 3, 4, 5, 2]")], "pupil.segment_labels | 2 twice"),
        (&[("pupil.removed_rings", "3")], "pupil.removed_rings = 3 | less than rings = 3"),
        (&[("pupil.removed_rings", "1"), ("pupil.central_segment", "true")], "pupil.removed_rings | central segment"),
        (&[("pupil.outer_radius_m", "1.5")], "pupil.outer_radius_m = 1.5 | no segment"),
    ] {
        assert_facts(&refused_setting("keck-artificial", settings), facts);
    }
}

#[test]
fn messages_name_line_key_value_and_accepted_range() {
    let cases = [
        ("[image]\nwavelenght_nm = 2000", 2, "unknown key | 'image.wavelenght_nm' | 'wavelength_nm'"),
        ("\n[imag]\npixels = 2", 2, "unknown section | 'imag' | 'image'"),
        ("pixels = 2", 1, "'pixels' | outside its section | [image]"),
        ("[pupil]\npixels = 2", 2, "unknown key | 'pupil.pixels' | [image]"),
        ("[[image]]\npixels = 2", 1, "'image' | not a section | [image]"),
        ("[image]\npixels = 240", 1, "'image.wavelength_nm' | missing | number from 100 to 100000"),
        ("[image]\nwavelength_nm = \"K\"\npixels = 240", 2, "image.wavelength_nm = \"K\" | number from 100 to 100000"),
        ("[image]\nwavelength_nm = 2000\npixels = 7", 3, "image.pixels = 7  | integer from 8 to 8192"),
        ("[image]\nwavelength_nm = 2000\npixels = 240.0", 3, "image.pixels = 240.0 | integer from 8 to 8192"),
        ("[image]\nwavelength_nm = nan\npixels = 240", 2, "image.wavelength_nm = nan | number from 100 to 100000"),
        (
            "[modes]\nncpa = \"zernikes\"\n[image]\nwavelength_nm = 2000\npixels = 240",
            2,
            "modes.ncpa = \"zernikes\" | \"kl\", \"zernike\" or \"none\"",
        ),
        (
            "[estimate]\nmethod = \"full-fase\"\n[image]\nwavelength_nm = 2000\npixels = 240",
            2,
            "estimate.method = \"full-fase\" | \"modal\", \"full-phase\" or \"auto\"",
        ),
    ];
    for (text, line, facts) in cases {
        let message = refusal(text);
        assert!(message.starts_with(&format!("scene line {line}: ")), "{message}");
        assert_facts(&message, facts);
    }
    for broken in ["[image]\npixels = 2\npixels = 4", "[image]\npixels = ", "[image]\n[pupil]\n[image]"] {
        let message = refusal(broken);
        let line = broken.lines().count();
        assert!(message.starts_with(&format!("scene line {line}: not TOML: ")), "{message}");
    }
    for name in ["keck-artificial", "my scenes/keck.toml\n"] {
        assert_facts(&refusal(name), &format!("'{}' | is a name | not the text", name.trim()));
    }
}

#[test]
fn images_without_noise_need_a_flux() {
    let quiet = [("image.photon_noise", "false"), ("image.read_noise_e", "0")];
    let preset = Scene::preset("keck-artificial").unwrap();
    // Either form of the brightness replaces the other.
    let bright = preset.with(&[&quiet[..], &[("image.flux_e", "1e6")]].concat()).unwrap();
    assert_eq!((bright.image.flux_e, bright.image.peak_snr), (Some(1e6), None));
    let faint = bright.with(&[("image.peak_snr", "50")]);
    assert!(faint.is_err_and(|error| error.to_string().contains("peak_snr")));
    // Either noise is enough.
    for noise in quiet {
        assert_eq!(preset.with(&[noise]).unwrap().image.peak_snr, Some(500.0));
    }
}

#[test]
fn contradictions_are_refused() {
    let cases: [(&str, Settings, &str); 31] = [
        ("keck-artificial", &[("image.diversity_file", "d.fits")], "'image.diversity_file' | both"),
        ("keck-artificial", &[("image.crop_pixels", "482")], "image.crop_pixels = 482"),
        ("keck-artificial", &[("image.rows", "482")], "image.rows = 482 | at most image.pixels = 480"),
        ("keck-artificial", &[("image.columns", "7")], "an integer from 8"),
        (
            "keck-artificial",
            &[("image.rows", "240"), ("image.columns", "200"), ("image.crop_pixels", "242")],
            "image.crop_pixels = 242 | at most image.rows = 240",
        ),
        ("keck-artificial", &[("image.crop_pixels", "95")], "\"auto\" or an even integer"),
        ("keck-onsky", &[("image.interval_s", "0.001")], "image.interval_s = 0.001"),
        ("keck-artificial", &[("pupil.file", "p.fits")], "'pupil.aperture' | 'pupil.file' | both"),
        ("keck-artificial", &[("pupil.file", "p.fits"), ("pupil.aperture", "")], "'pupil.rings' has no meaning"),
        ("keck-artificial", &[("pupil.segment_side_m", "0")], "pupil.segment_side_m = 0"),
        ("keck-artificial", &[("pupil.segment_side_m", "-1")], "a number above 0"),
        ("keck-artificial", &[("pupil.segment_gap_m", "0.9")], "less than segment_side_m = 0.9"),
        ("keck-artificial", &[("pupil.rings", "4")], "14.05"),
        ("keck-artificial", &[("pupil.rings", "0")], "leaves no segment"),
        ("keck-artificial", &[("pupil.central_obscuration_m", "11")], "hides the whole pupil"),
        ("keck-artificial", &[("pupil.band_pass_cycles", "60")], "band_pass_cycles = 60 | samples = 120"),
        (
            "keck-artificial",
            &[("pupil.band_pass_cycles", "50"), ("pupil.band_stop_cycles", "40")],
            "band_stop_cycles = 40",
        ),
        (
            "keck-artificial",
            &[("pupil.band_pass_cycles", "50"), ("pupil.model", "area")],
            "'pupil.band_pass_cycles' | \"band-limited\"",
        ),
        ("keck-artificial", &[("aberrations.truth_samples", "100")], "pupil.samples = 120"),
        ("keck-artificial", &[("aberrations.ncpa_zernikes", "[18, 4]")], "ncpa_zernikes = [18, 4] | [first, last]"),
        ("keck-artificial", &[("aberrations.ncpa_zernikes", "[0, 4]")], "ncpa_zernikes = [0, 4]"),
        (
            "keck-artificial",
            &[("aberrations.ncpa_file", "n.fits"), ("aberrations.ncpa_rms_nm", "70")],
            "'aberrations.ncpa_rms_nm' | no meaning",
        ),
        ("keck-artificial", &[("modes.ncpa", "none"), ("modes.segment", "none")], "no mode"),
        ("keck-artificial", &[("mirror.coupling", "1")], "above 0 and below 1"),
        ("keck-onsky", &[("turbulence.wind_m_s", "[6.8]")], "turbulence.wind_m_s has 1 | turbulence.fractions has 7"),
        ("keck-onsky", &[("turbulence.fractions", "[0.5, 0.1, 0.1, 0.1, 0.05, 0.05, 0.05]")], "sum to 0.9500"),
        ("keck-onsky", &[("control.condition_number", "300")], "'control.condition_number' | both"),
        ("keck-artificial", &[("control.gain", "0.2")], "[wavefront_sensor]"),
        ("keck-artificial", &[("image.pixel_fill", "1.5")], "image.pixel_fill = 1.5"),
        (
            "keck-artificial",
            &[("image.photon_noise", "false"), ("image.read_noise_e", "0")],
            "image.peak_snr = 500 | no flux | image.photon_noise = false | image.read_noise_e = 0",
        ),
        (
            "keck-onsky",
            &[("image.photon_noise", "false"), ("image.read_noise_e", ""), ("image.peak_snr", "")],
            "image.peak_snr = 500 | no flux | image.photon_noise = false | no image.read_noise_e",
        ),
    ];
    for (preset, settings, facts) in cases {
        let message = refused_setting(preset, settings);
        assert_facts(&message, facts);
        assert!(message.starts_with(preset) && !message.contains('\n'), "{settings:?}: {message}");
    }
    let both = format!("{SMALLEST}flux_e = 1e6\npeak_snr = 50\n");
    assert_facts(&refusal(&both), "'image.peak_snr' | 'image.flux_e' | both");
    assert_facts(&refusal(&format!("{SMALLEST}[faults]\ndrift_nm_per_min = 1")), "[aberrations]");
    let without_grid = "[pupil]\nfile = \"p.fits\"\n[image]\nwavelength_nm = 2000\npixels = 8";
    assert_facts(&refusal(without_grid), "'pupil.grid_m' | missing");
}

#[test]
fn a_changed_scene_has_the_new_values_in_its_text() {
    let scene = Scene::preset("keck-artificial").unwrap();
    let varied = scene
        .with(&[
            ("image.flux_e", "1e6"),
            ("modes.ncpa", "zernike"),
            ("modes.exact_zernikes", "none"),
            ("estimate.device", "opencl:0:1"),
            ("estimate.optimizer", "\"bfgs\""),
        ])
        .unwrap();
    assert_eq!((varied.image.peak_snr, varied.image.flux_e), (None, Some(1e6)));
    assert_eq!((&varied.modes.ncpa, varied.modes.exact_zernikes), (&NcpaBasis::Zernike, Some(NollRange::None)));
    assert_eq!(varied.estimate.device, DeviceChoice::OpenClDevice { platform: 0, device: 1 });
    assert_eq!(varied.estimate.optimizer, Optimizer::Bfgs);
    assert!(varied.text().contains("wavelength_nm = 2168.6     # Br gamma"), "comments are kept");
    assert_eq!(*parse(varied.text()).unwrap(), *varied, "the text has the values of the scene");
    assert_eq!(scene.image.peak_snr, Some(500.0), "the first scene is unchanged");

    // Removing a key of an absent section has no effect.
    assert_eq!(scene.with_override("control.gain", "").unwrap().text(), scene.text());

    // Sections in every TOML syntax can be changed.
    for text in ["image = {wavelength_nm = 2000, pixels = 240}", "image.wavelength_nm = 2000\nimage.pixels = 240"] {
        assert_eq!(parse(text).unwrap().with_override("image.pixels", "96").unwrap().image.pixels, 96);
    }
}

#[test]
fn settings_with_unknown_keys_are_refused() {
    assert_eq!(split_setting("image.peak_snr = 50").unwrap(), ("image.peak_snr", "50"));
    assert!(split_setting("image.peak_snr").is_err());
    let cases = [
        ("peak_snr", "setting 'peak_snr' | no section | image.peak_snr"),
        ("image.peak_sn", "setting 'image.peak_sn' | unknown key 'image.peak_sn' | 'peak_snr'"),
        ("images.pixels", "setting 'images.pixels' | unknown section 'images' | 'image'"),
    ];
    for (key, facts) in cases {
        assert_facts(&refused_setting("keck-artificial", &[(key, "1")]), facts);
    }
    let error = Scene::preset("keck-onski").unwrap_err().to_string();
    let names = Scene::preset_names().join(", ");
    assert_facts(&error, &format!("preset 'keck-onski' | {names} | did you mean 'keck-onsky'"));
}

#[test]
fn keys_that_moved_to_another_section_are_named_in_the_message() {
    for (section, key) in [
        ("image", "pixel_response_rms"),
        ("aberrations", "segment_reflectivity_rms"),
        ("aberrations", "drift_nm_per_min"),
    ] {
        let message = refusal(&format!("[{section}]\n{key} = 0.01"));
        assert_facts(&message, &format!("scene line 2 | '{section}.{key}' | [faults]"));
    }
}

#[test]
fn file_names_are_relative_to_the_scene_and_named_in_messages() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mine.toml");
    std::fs::write(&path, FROM_FILES).unwrap();
    let scene = Scene::from_file(&path).unwrap();
    assert_eq!(scene.resolve("pupil.fits"), folder.path().join("pupil.fits"));

    std::fs::write(&path, "[image]\nmodes = 3").unwrap();
    let message = Scene::from_file(&path).unwrap_err().to_string();
    assert_facts(&message, "mine.toml line 2 | 'image.modes'");

    std::fs::write(&path, b"[image]\n\xff").unwrap();
    let message = Scene::from_file(&path).unwrap_err().to_string();
    assert_facts(&message, "mine.toml | UTF-8 | byte 8");
    assert_eq!(Scene::from_file(folder.path().join("absent.toml")).unwrap_err().status(), 2);
    assert_eq!(Scene::from_file(folder.path()).unwrap_err().status(), 2, "a folder is not a scene");
}

#[test]
fn device_words_are_parsed_strictly() {
    assert_eq!("opencl".parse::<DeviceChoice>().unwrap(), DeviceChoice::OpenCl);
    for word in
        ["", "gpu", "opencl:", "opencl:0", "opencl:0:", "opencl:+1:0", "opencl:0:1:2", "opencl:99999999999999999999:0"]
    {
        assert!(word.parse::<DeviceChoice>().is_err(), "{word}");
    }
}

#[test]
fn the_reference_describes_every_key_of_the_presets() {
    let reference = reference();
    for line in Scene::preset_names().iter().flat_map(|name| Scene::preset_text(name).unwrap().lines()) {
        if let Some((key, _)) =
            line.split_once(" = ").or_else(|| line.split_once("= ")).filter(|_| !line.starts_with('#'))
        {
            let key = key.trim().trim_end_matches('=').trim_end();
            assert!(
                reference.lines().any(|l| l.starts_with(&format!("  {key}:")) || l.starts_with(&format!("  {key} ("))),
                "{key}"
            );
        }
    }
    assert!(reference.contains("[wavefront_sensor]") && reference.contains("default: none, it is required"));
}

/// Changes a text at random: bytes deleted, replaced or inserted, lines deleted, duplicated or
/// swapped.
fn mutate(text: &mut Vec<u8>, rng: &mut ChaCha8Rng) {
    const FRAGMENTS: [&[u8]; 14] = [
        b"=",
        b"\"",
        b"[",
        b"]",
        b"\n",
        b"{",
        b"}",
        b".",
        b"-",
        b"nan",
        b"1e999",
        b"9223372036854775807",
        b"'''",
        "π".as_bytes(),
    ];
    if text.is_empty() {
        return text.extend(FRAGMENTS[rng.random_range(0..FRAGMENTS.len())]);
    }
    let at = rng.random_range(0..text.len());
    match rng.random_range(0..6) {
        0 => drop(text.drain(at..(at + rng.random_range(1..8)).min(text.len()))),
        1 => text[at] = (rng.next_u32() & 0x7f) as u8,
        2 => drop(text.splice(at..at, FRAGMENTS[rng.random_range(0..FRAGMENTS.len())].iter().copied())),
        kind => {
            let mut lines: Vec<Vec<u8>> = text.split(|&b| b == b'\n').map(<[u8]>::to_vec).collect();
            let (one, other) = (rng.random_range(0..lines.len()), rng.random_range(0..lines.len()));
            match kind {
                3 => drop(lines.remove(one)),
                4 => lines.insert(other, lines[one].clone()),
                _ => lines.swap(one, other),
            }
            *text = lines.join(&b'\n');
        }
    }
}

#[test]
fn the_parser_does_not_panic_on_random_texts() {
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let (mut accepted, mut refused) = (0, 0);
    for round in 0..6000 {
        let seed =
            [Scene::preset_text("keck-artificial").unwrap(), Scene::preset_text("keck-onsky").unwrap(), FROM_FILES]
                [round % 3];
        let mut text = seed.as_bytes().to_vec();
        for _ in 0..rng.random_range(1..6) {
            mutate(&mut text, &mut rng);
        }
        let text = String::from_utf8_lossy(&text);
        match parse(&text) {
            Ok(scene) => {
                accepted += 1;
                // An accepted scene can be changed, and has the new value.
                let again =
                    scene.with(&[("image.read_noise_e", "7")]).unwrap_or_else(|error| panic!("{error}\n{text}"));
                assert_eq!(again.image.read_noise_e, Some(7.0));
            }
            Err(error) => {
                refused += 1;
                let message = error.to_string();
                assert!(
                    matches!(error, Error::Scene(_)) && !message.contains('\n') && message.len() < 1200,
                    "{message}"
                );
            }
        }
    }
    // The mutations must produce both scenes that reach the checks behind the parser and texts that
    // are refused.
    assert!(accepted > 500 && refused > 500, "{accepted} accepted, {refused} refused");
}

#[test]
fn deeply_nested_and_long_texts_are_refused() {
    for text in [
        "[".repeat(100_000),
        format!("a = {}", "[".repeat(100_000)),
        format!("a{} = 1", ".a".repeat(100_000)),
        "{".repeat(9_999),
    ] {
        refusal(&text);
    }
}
