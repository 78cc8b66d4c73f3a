//! The same frames give the same answer at every interface: the program, Rust, C, Python and
//! Octave, to the last bit of each coefficient, error bar and χ², with the same statuses, the same
//! rejected pixels and the same warnings.
//!
//! Where Python or Octave is not installed its part says so and passes, unless
//! `COPHASE_REQUIRE_PYTHON=1` or `COPHASE_REQUIRE_OCTAVE=1`.

use crate::{Desk, SMALL};
use cophase::Precision;
use cophase::ao::Stepper;
use cophase::io::{FitsReader, FitsWriter, Pixel};
use cophase::pipeline::{Control, Estimate, Estimator, Images, Policy};
use cophase::scene::Scene;
use ndarray::{Array2, Array3, s};
use std::path::{Path, PathBuf};
use std::process::Command;

#[path = "../../../tests/common/libraries.rs"]
mod libraries;
use libraries::libraries;

/// Frames of a scene, and the telemetry that came with them.
struct Case {
    scene: String,
    images_e: Array3<f64>,
    slopes_mas: Option<Array2<f64>>,
}

impl Case {
    /// An artificial source: `settings` on the small scene.
    fn of_source(settings: &[(&str, &str)]) -> Self {
        Self::of_source_seen_as(settings, &[])
    }

    /// Images of the small scene with `settings`, to be estimated by a scene with `assumed` as
    /// well.
    fn of_source_seen_as(settings: &[(&str, &str)], assumed: &[(&str, &str)]) -> Self {
        let made = Scene::from_text(SMALL, Path::new("")).unwrap().with(settings).unwrap();
        let images_e = cophase::source::simulate(&made).unwrap().remove(0).images_e;
        let scene = made.with(&[&[("estimate.device", "cpu")], assumed].concat()).unwrap();
        Self { scene: scene.text().into(), images_e, slopes_mas: None }
    }

    fn images(&self) -> Images {
        Images { slopes_mas: self.slopes_mas.clone(), ..Images::new(self.images_e.clone()) }
    }

    fn estimate(&self, policy: Policy) -> Estimate {
        let scene = Scene::from_text(&self.scene, Path::new("")).unwrap();
        let estimator = Estimator::with_policy(&scene, policy, Control::default()).unwrap();
        estimator.estimate(&self.images()).unwrap()
    }

    /// Compares all interfaces; returns what Rust found.
    fn is_the_same_everywhere(&self) -> Estimate {
        let estimate = self.estimate(Policy::default());
        let expected = of_rust(&estimate);
        let desk = Desk::with_scene();
        self.write(&desk);
        assert_eq!(of_program(&desk), expected, "the program");
        let mut arguments = vec!["scene.toml".into(), "frames.raw".into()];
        let (count, rows, columns) = self.images_e.dim();
        arguments.extend([count, rows, columns].map(|extent| extent.to_string()));
        if let Some(slopes_mas) = &self.slopes_mas {
            arguments.extend(["slopes.raw".into(), slopes_mas.ncols().to_string()]);
        }
        for (name, command) in [("C", in_c(&desk)), ("Python", in_python()), ("Octave", in_octave(&desk))] {
            let Some(mut command) = command else { continue };
            let output = command.args(&arguments).current_dir(desk.path("")).output().unwrap();
            let (said, printed) = (String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout));
            assert!(output.status.success(), "{name}: {}\n{printed}\n{said}", output.status);
            let lines: Vec<String> = printed.lines().map(String::from).collect();
            assert_eq!(lines, expected, "{name}");
        }
        estimate
    }

    fn write(&self, desk: &Desk) {
        std::fs::write(desk.path("scene.toml"), &self.scene).unwrap();
        let mut file = FitsWriter::create(desk.path("images.fits")).unwrap();
        let unit = if self.scene.contains("gain_e_per_adu") { "adu" } else { "electron" };
        file.image("IMAGES", &self.images_e, Pixel::F64, unit).unwrap();
        if let Some(slopes_mas) = &self.slopes_mas {
            file.image("SLOPES_MEAN", slopes_mas, Pixel::F64, "mas").unwrap();
        }
        file.finish().unwrap();
        let raw =
            |values: &mut dyn Iterator<Item = &f64>| values.flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
        std::fs::write(desk.path("frames.raw"), raw(&mut self.images_e.iter())).unwrap();
        if let Some(slopes_mas) = &self.slopes_mas {
            std::fs::write(desk.path("slopes.raw"), raw(&mut slopes_mas.iter())).unwrap();
        }
    }
}

/// The lines that every interface prints: all bits of each number.
fn lines<'a>(
    modes: impl Iterator<Item = (&'a String, (f64, f64))>,
    images: impl Iterator<Item = (String, f64, i64)>,
    errors: impl Iterator<Item = (&'a String, [f64; 4])>,
    warnings: &[String],
    (policy, device): (&str, &str),
) -> Vec<String> {
    let bits = |value: f64| format!("{:016x}", value.to_bits());
    let modes = modes.map(|(name, (nm, sigma))| format!("coefficient {name} {} {}", bits(nm), bits(sigma)));
    let images = images.enumerate().map(|(image, (status, chi2, rejected))| {
        // The scenes here have one channel, number 0.
        format!("image {image} {} {} {rejected} 0", status.to_uppercase().replace('-', "_"), bits(chi2))
    });
    let errors = errors.map(|(name, numbers)| format!("error {name} {}", numbers.map(bits).join(" ")));
    let warnings = warnings.iter().map(|warning| format!("warning {warning}"));
    modes
        .chain(images)
        .chain(errors)
        .chain(warnings)
        .chain([format!("policy {policy}"), format!("device {device}")])
        .collect()
}

fn of_rust(estimate: &Estimate) -> Vec<String> {
    let sigma_nm = estimate.modes.sigma_nm();
    let numbers = estimate.modes.coefficients_nm.iter().copied().zip(sigma_nm);
    let images = estimate.images.iter();
    lines(
        estimate.basis.names.iter().zip(numbers),
        images.map(|image| {
            (image.report.status.word().into(), image.report.reduced_chi2, image.report.rejected.total() as i64)
        }),
        estimate
            .model_errors
            .iter()
            .map(|error| (&error.name, [error.value, error.sigma, error.tolerance, error.significance])),
        &estimate.warnings,
        (estimate.policy.name(), &estimate.run.device),
    )
}

/// What the program writes and prints.
fn of_program(desk: &Desk) -> Vec<String> {
    let json = desk.json(&["estimate", "images.fits", "--scene", "scene.toml", "-o", "est.fits", "--json"]);
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    let names = file.text_column("MODES", "NAME").unwrap();
    let numbers = ["ESTIMATE_NM", "SIGMA_NM"].map(|column| file.f64_column("MODES", column).unwrap());
    let statuses = file.text_column("IMAGES", "STATUS").unwrap();
    let chi2 = file.f64_column("IMAGES", "CHI2").unwrap();
    let rejected = file.i64_column("IMAGES", "REJECTED_PIXELS").unwrap();
    let warnings: Vec<String> =
        json["warnings"].as_array().unwrap().iter().map(|warning| warning.as_str().unwrap().into()).collect();
    let written = if warnings.is_empty() { Vec::new() } else { file.text_column("WARNINGS", "SENTENCE").unwrap() };
    assert_eq!(written, warnings);
    // Not of a full-phase estimate. A table has its names in ASCII, which is tested beside it.
    let has_errors = file.has("MODEL_ERRORS");
    let errors: Vec<String> = json["model_errors"]
        .as_array()
        .into_iter()
        .flatten()
        .map(|error| error["name"].as_str().unwrap().into())
        .collect();
    let written = if has_errors { file.text_column("MODEL_ERRORS", "NAME").unwrap() } else { Vec::new() };
    assert!(written.len() == errors.len() && written.iter().all(|name| !name.contains('?')), "{written:?}");
    let columns = ["VALUE", "SIGMA", "TOLERANCE", "SIGNIFICANCE"].map(|column| match errors.is_empty() {
        true => Vec::new(),
        false => file.f64_column("MODEL_ERRORS", column).unwrap(),
    });
    let [coefficients_nm, sigma_nm] = numbers;
    lines(
        names.iter().zip(coefficients_nm.into_iter().zip(sigma_nm)),
        statuses.into_iter().zip(chi2).zip(rejected).map(|((status, chi2), rejected)| (status, chi2, rejected)),
        errors.iter().enumerate().map(|(row, name)| (name, columns.each_ref().map(|column| column[row]))),
        &warnings,
        (json["policy"].as_str().unwrap(), json["device"].as_str().unwrap()),
    )
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().into()
}

fn in_c(desk: &Desk) -> Option<Command> {
    let program = desk.path("pipeline");
    let output = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(root().join("include"))
        .arg(root().join("tests/c_api/pipeline.c"))
        .arg("-L")
        .arg(libraries())
        .args(["-lcophase", "-lm"])
        .arg(format!("-Wl,-rpath,{}", libraries().display()))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut command = Command::new(program);
    command.env("LD_LIBRARY_PATH", libraries());
    Some(command)
}

/// Whether a command runs; where not, that is a failure if `variable` is 1.
fn runs(command: &mut Command, variable: &str) -> bool {
    let here = command.output().is_ok_and(|output| output.status.success());
    assert!(here || std::env::var_os(variable).is_none_or(|value| value != "1"), "{command:?} does not run");
    if !here {
        println!("skipped: {command:?} does not run here");
    }
    here
}

fn in_python() -> Option<Command> {
    let python = std::env::var("COPHASE_PYTHON").unwrap_or("python3".into());
    if !runs(Command::new(&python).args(["-c", "import numpy, cffi"]), "COPHASE_REQUIRE_PYTHON") {
        return None;
    }
    let library = format!("{}cophase{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX);
    let mut command = Command::new(python);
    command.env("PYTHONPATH", root().join("bindings/python")).env("PYTHONDONTWRITEBYTECODE", "1");
    command.env("COPHASE_LIBRARY", libraries().join(library)).env("COPHASE_HEADER", root().join("include/cophase.h"));
    command.env("LD_LIBRARY_PATH", libraries()).arg(root().join("tests/c_api/pipeline.py"));
    Some(command)
}

fn in_octave(desk: &Desk) -> Option<Command> {
    let required = "COPHASE_REQUIRE_OCTAVE";
    if !(runs(Command::new("octave-cli").arg("--version"), required)
        && runs(Command::new("mkoctfile").arg("--version"), required))
    {
        return None;
    }
    let mut command = Command::new("octave-cli");
    command.env("HOME", desk.path("")).env("LD_LIBRARY_PATH", libraries());
    command.args(["--norc", "--quiet"]).arg(root().join("tests/c_api/pipeline.m"));
    command.env("COPHASE_LIBRARIES", libraries()).env("COPHASE_SCRATCH", desk.path(""));
    Some(command)
}

#[test]
fn a_plain_image() {
    let found = Case::of_source(&[]).is_the_same_everywhere();
    assert!(found.is_sound(), "{}", found.report());
}

#[test]
fn counts_with_a_gain_and_no_read_noise_in_the_scene() {
    let assumed = [("image.gain_e_per_adu", "3.3"), ("image.read_noise_e", "")];
    let mut case = Case::of_source_seen_as(&[], &assumed);
    case.images_e /= 3.3;
    let found = case.is_the_same_everywhere();
    assert!(found.remarks[0].contains("3.3 per count"), "{:?}", found.remarks);
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn hot_pixels() {
    let mut case = Case::of_source(&[("image.pixels", "96")]);
    case.images_e[[0, 30, 40]] += 1e6;
    case.images_e[[0, 60, 52]] += 1e6;
    let found = case.is_the_same_everywhere();
    assert_eq!(found.images[0].report.rejected.total(), 2);
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn frames_with_one_row_and_one_column_more() {
    let mut case = Case::of_source(&[]);
    let even = case.estimate(Policy::default());
    let (count, rows, columns) = case.images_e.dim();
    let mut odd = Array3::from_elem((count, rows + 1, columns + 1), 1e6);
    odd.slice_mut(s![.., ..rows, ..columns]).assign(&case.images_e);
    case.images_e = odd;
    let found = case.is_the_same_everywhere();
    assert!(["row", "column", "left out"].iter().all(|fact| found.remarks[0].contains(fact)), "{:?}", found.remarks);
    assert_eq!(found.modes.coefficients_nm, even.modes.coefficients_nm);
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn modes_with_a_prior() {
    // The model adds Zernikes of its own where the scene leaves that open: to Noll 45, for any
    // images.
    let open_scene = |last: &str| {
        let case = Case::of_source(&[("aberrations.ncpa_zernikes", last)]);
        let without = |line: &&str| !line.contains("exact_zernikes") && !line.contains("ncpa_count");
        let scene: String = case.scene.lines().filter(without).map(|line| format!("{line}\n")).collect();
        Case { scene: scene.replace("ncpa = \"zernike\"", "ncpa = \"zernike\"\nncpa_count = 3"), ..case }
    };
    let [few, many] = ["[4, 4]", "[4, 15]"].map(|last| open_scene(last).is_the_same_everywhere());
    assert_eq!(few.basis, many.basis);
    assert_eq!(many.model, "Zernikes 2 to 21 added, 22 to 45 with a prior");
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn a_fit_that_is_restarted() {
    // Too few evaluations to converge: each restart begins elsewhere, and the best fit is kept.
    let case = Case::of_source(&[("estimate.max_evaluations", "6")]);
    let found = case.is_the_same_everywhere();
    let at_once = case.estimate(Policy { restart: false, ..Policy::default() });
    assert!(found.evaluations() > at_once.evaluations(), "{}", at_once.report());
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn a_plan_for_a_budget_in_single_precision() {
    let found = Case::of_source(&[("estimate.budget_nm", "3")]).is_the_same_everywhere();
    assert_eq!(found.run.precision, Precision::F32, "{}", found.scene.text());
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn a_sequence_of_images() {
    Case::of_source(&[("image.count", "9"), ("image.peak_snr", "40")]).is_the_same_everywhere();
}

#[test]
fn a_map_sequence_with_telemetry() {
    let found = is_the_same_map_sequence(&[]);
    assert_eq!(found.segment_modes(), 7);
}

#[test]
#[ignore = "merge: one of the cases beyond three"]
fn a_map_sequence_with_more_modes_of_segments_than_segments() {
    let found = is_the_same_map_sequence(&[("modes.segment", "piston-tip-tilt")]);
    assert_eq!(found.segment_modes(), 21);
}

/// Compares all interfaces on a sequence behind a loop, by a scene with `settings`; returns what
/// Rust found.
fn is_the_same_map_sequence(settings: &[(&str, &str)]) -> Estimate {
    let path = root().join("tests/c_api/sky.toml");
    let scene = Scene::from_file(&path).unwrap().with(settings).unwrap();
    let mut stepper = Stepper::new(&scene).unwrap();
    let (mut images, mut slopes) = (Vec::new(), Vec::new());
    for _ in 0..4 {
        stepper.step(300).unwrap();
        images.push(stepper.image_e().unwrap().mapv(f64::from));
        slopes.push(stepper.last().unwrap().slopes_mas.iter().map(|&mas| f64::from(mas)).collect::<Vec<f64>>());
    }
    let views: Vec<_> = images.iter().map(|image| image.view()).collect();
    let slopes_mas = Array2::from_shape_vec((4, slopes[0].len()), slopes.concat()).unwrap();
    let settings = [("estimate.method", "full-phase"), ("estimate.precision", "f64"), ("estimate.device", "cpu")];
    let case = Case {
        scene: scene.with(&settings).unwrap().text().into(),
        images_e: ndarray::stack(ndarray::Axis(0), &views).unwrap(),
        slopes_mas: Some(slopes_mas),
    };
    let found = case.is_the_same_everywhere();
    assert!(found.full_phase().is_some());
    found
}
