//! The loop as it was measured: slopes and matrices from files, in the observatory's order, sign
//! and units.

use crate::common::assert_facts;
use crate::full_phase::{exposures, sky};
use cophase::ao::{Simulator, SlopeFormat, Stepper};
use cophase::io::{FitsWriter, Pixel};
use cophase::pipeline::{Estimator, Images};
use cophase::scene::Scene;
use ndarray::Array2;
use std::path::Path;

/// Slopes of x and y in turn, of the opposite sign, where 1 is a quarter of a mas: the factor is
/// exact.
const FORM: [(&str, &str); 2] =
    [("wavefront_sensor.slope_order", "[\"interleaved\"]"), ("wavefront_sensor.slope_unit_mas", "-0.25")];

fn scene(settings: &[(&str, &str)]) -> Scene {
    let own = [("estimate.method", "full-phase"), ("estimate.device", "cpu")];
    Scene::from_file(sky()).unwrap().with(&[&own, settings].concat()).unwrap()
}

/// Slopes `[image, slope]` as the observatory has them, written out by hand.
fn in_form(slopes_mas: &Array2<f64>) -> Array2<f64> {
    let half = slopes_mas.ncols() / 2;
    Array2::from_shape_fn(slopes_mas.dim(), |(image, k)| -4.0 * slopes_mas[[image, k / 2 + k % 2 * half]])
}

#[test]
#[ignore = "merge: 5 s"]
fn slopes_are_read_in_the_form_that_the_scene_describes() {
    let right = exposures(&mut Stepper::new(&scene(&[])).unwrap(), 4);
    let expected = Estimator::new(&scene(&[])).unwrap().estimate(&right).unwrap();
    let measured = Images { slopes_mas: right.slopes_mas.as_ref().map(in_form), ..right };
    let refused = Estimator::new(&scene(&[])).unwrap().estimate(&measured).unwrap_err().to_string();
    assert_facts(&refused, "slope_order = [\"interleaved\"] | slope_unit_mas = -1.0000");
    let found = Estimator::new(&scene(&FORM)).unwrap().estimate(&measured).unwrap();
    assert_eq!(
        (&found.modes.coefficients_nm, found.modes.sigma_nm()),
        (&expected.modes.coefficients_nm, expected.modes.sigma_nm())
    );
}

fn write(path: &Path, name: &str, matrix: &Array2<f64>) {
    let mut file = FitsWriter::create(path).unwrap();
    file.image(name, matrix, Pixel::F64, "").unwrap();
    file.finish().unwrap();
}

/// Largest difference over the largest value.
fn off(found: &Array2<f64>, expected: &Array2<f64>) -> f64 {
    let largest = |matrix: &Array2<f64>| matrix.iter().fold(0.0f64, |most, value| most.max(value.abs()));
    largest(&(found - expected)) / largest(expected)
}

#[test]
fn measured_matrices_are_those_of_the_loop() {
    let folder = tempfile::tempdir().unwrap();
    let (interaction, command) = (folder.path().join("interaction.fits"), folder.path().join("command.fits"));
    let model = Simulator::new(&scene(&[])).unwrap();
    // A command of 1 makes 50 nm; rows of the interaction matrix and columns of the command matrix
    // are measured slopes.
    let measured = in_form(&(model.interaction().t().to_owned() * 50.0)).reversed_axes();
    write(&interaction, "INTERACTION", &measured.as_standard_layout().to_owned());
    let matrix = model.law().command_matrix();
    write(&command, "COMMAND_MATRIX", &(in_form(&matrix) / 16.0 / 50.0));
    let file = |path: &Path| format!("{:?}", path.display().to_string());
    let (own, commands) = (file(&interaction), file(&command));
    let keys = [("control.interaction_file", own.as_str()), ("control.matrix_command_nm", "50.0")];

    let found = Simulator::new(&scene(&[&FORM[..], &keys].concat())).unwrap();
    // Rounding of a product and a quotient.
    assert!(off(found.interaction(), model.interaction()) < 1e-14);
    // With a command matrix there is nothing to invert.
    let given =
        [("control.command_matrix_file", commands.as_str()), ("control.basis", ""), ("control.filtered_modes", "")];
    let mut found = Simulator::new(&scene(&[&FORM[..], &keys, &given].concat())).unwrap();
    assert!(off(&found.law().command_matrix(), &matrix) < 1e-14);
    assert!(found.stability().stable && found.stability().controlled == matrix.nrows());
    let mut model = model;
    for frame in 0..50 {
        let (one, other) = (model.step().unwrap(), found.step().unwrap());
        // Single precision in the sums of some hundred products, which the loop does not amplify.
        let apart = one.commands_nm.iter().zip(other.commands_nm).fold(0.0f32, |most, (a, b)| most.max((a - b).abs()));
        assert!(apart < 0.01, "frame {frame}: {apart} nm");
    }

    // Another order is named; a matrix on its side is recognised.
    let refused = Simulator::new(&scene(&keys)).map(|_| ()).unwrap_err().to_string();
    assert_facts(&refused, "wavefront_sensor.slope_order = [\"interleaved\"] | opposite sign | 1.00");
    let negated = [("wavefront_sensor.slope_unit_mas", "0.25"), FORM[0]];
    let refused = Simulator::new(&scene(&[&negated[..], &keys].concat())).map(|_| ()).unwrap_err().to_string();
    assert_facts(&refused, "opposite sign | wavefront_sensor.slope_unit_mas = -0.25");
    write(&interaction, "INTERACTION", &measured.t().as_standard_layout().to_owned());
    let refused = Simulator::new(&scene(&keys)).map(|_| ()).unwrap_err().to_string();
    assert!(refused.contains("this one is the transpose"), "{refused}");
    let mut broken = measured.as_standard_layout().to_owned();
    broken[[3, 2]] = f64::NAN;
    write(&interaction, "INTERACTION", &broken);
    let refused = Simulator::new(&scene(&keys)).map(|_| ()).unwrap_err().to_string();
    assert_facts(&refused, "NaN | row 3, column 2");
}

#[test]
fn matrices_of_a_sensor_that_is_somewhat_another_are_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("interaction.fits");
    let file = format!("{:?}", path.display().to_string());
    for other in [
        [("wavefront_sensor.detector", "pixels"), ("mirror.coupling", "0.1458")],
        [("wavefront_sensor.detector", "geometric"), ("mirror.coupling", "0.3")],
    ] {
        write(&path, "INTERACTION", Simulator::new(&scene(&other)).unwrap().interaction());
        Simulator::new(&scene(&[("control.interaction_file", &file)])).unwrap();
    }
}

#[test]
fn a_symmetry_that_the_subapertures_do_not_have_is_refused() {
    let scene = scene(&[("wavefront_sensor.slope_order", "[\"rotated-180\"]")]);
    let model = Simulator::new(&scene).unwrap();
    let mut lenslets = model.lenslets().clone();
    assert!(SlopeFormat::new(scene.wavefront_sensor.as_ref().unwrap(), &lenslets).is_ok());
    lenslets.subapertures.remove(0);
    let refused = SlopeFormat::new(scene.wavefront_sensor.as_ref().unwrap(), &lenslets).unwrap_err().to_string();
    assert_facts(&refused, "wavefront_sensor.slope_order = \"rotated-180\"");
}

/// A loop about reference slopes of a focus, whose telemetry is relative to them.
#[test]
#[ignore = "merge: 8 s"]
fn slopes_relative_to_reference_slopes_are_those_that_were_seen() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reference.fits");
    let plain = Simulator::new(&scene(&[])).unwrap();
    let lenslets = plain.lenslets();
    let middle = (lenslets.across as f64 - 1.0) / 2.0;
    let along = |at: usize| 4.0 * (at as f64 - middle);
    let x_mas = lenslets.subapertures.iter().map(|cell| along(cell % lenslets.across));
    let y_mas = lenslets.subapertures.iter().map(|cell| along(cell / lenslets.across));
    let reference_mas = Array2::from_shape_vec((1, plain.interaction().nrows()), x_mas.chain(y_mas).collect()).unwrap();
    write(&path, "REFERENCE", &in_form(&reference_mas));
    let file = format!("\"{}\"", path.display());
    let about = scene(&[&FORM[..], &[("wavefront_sensor.reference_file", &file)]].concat());
    let mut stepper = Stepper::new(&about).unwrap();
    let images = exposures(&mut stepper, 8);
    // As a file has them: in the form of the scene, relative to the references.
    let images = Images { slopes_mas: images.slopes_mas.as_ref().map(in_form), ..images };
    let truth = stepper.simulator().truth();
    let left_over_sigma = |scene: &Scene| {
        let found = Estimator::new(scene).unwrap().estimate(&images).unwrap();
        let left_nm =
            cophase::metrics::residual_nm(&found.pupil, found.maps.ncpa_nm.view(), truth.ncpa_nm.view()).unwrap();
        left_nm / found.figures.ncpa.sigma_nm
    };
    let (with, without) = (left_over_sigma(&about), left_over_sigma(&scene(&FORM)));
    // Without them the focus is taken for one of the NCPA: 4 mas in a lenslet of 0.56 m, and ten
    // times the error bar.
    assert!(with < 2.5 && without > 10.0, "{with} {without}");

    write(&path, "REFERENCE", &Array2::zeros((1, 5)));
    let sentence = Estimator::new(&about).and_then(|made| made.estimate(&images)).map(|_| ()).unwrap_err().to_string();
    assert_facts(&sentence, "5 reference slopes");
    write(&path, "REFERENCE", &Array2::zeros((2, 5)));
    let sentence = Simulator::new(&about).map(|_| ()).unwrap_err().to_string();
    assert_facts(&sentence, "2 rows | one is needed");
}
