//! What the simulated loop makes of the reference slopes.

use super::*;
use crate::ao::{Simulator, undisturb};
use crate::modes::Zernikes;
use crate::retrieval::tests::scene;
use crate::source::{Truth, stream};
use ndarray::Axis;

/// NCPA of which the mirror can make a part only: Zernike polynomials of high order, nm RMS over
/// the circle.
const NCPA_NM: [(usize, f64); 3] = [(24, 20.0), (62, 20.0), (80, 20.0)];

#[test]
#[ignore = "merge: 7 s"]
fn loop_about_reference_slopes_nearly_makes_the_nearest_shape() {
    // Steps between segments would lower the gain of the quad cells that see them, and there is no
    // turbulence to blur spots.
    let even = ["aberrations.segment_piston_rms_nm", "aberrations.segment_tip_tilt_rms_nm"].map(|key| (key, "0"));
    let scene = scene().with(&even).unwrap().system().with(undisturb).unwrap();
    let telescope = Telescope::new(&scene).unwrap();
    let pupil = telescope.pupil.clone();
    let weights = telescope.area_weights(pupil.grid).unwrap();
    let retrieved = IlluminatedSamples::new(pupil.grid.samples(), pupil.grid.pitch_m(), &weights).unwrap();
    let (nolls, ncpa_nm): (Vec<usize>, Vec<f64>) = NCPA_NM.into_iter().unzip();
    let basis = SmoothBasis::zernike(Zernikes::new(nolls, pupil.grid.width_m() / 2.0).unwrap());
    let mut sensor = SensorModel::new(&scene, &telescope, &retrieved, &basis).unwrap();

    let samples = Samples::from_pupil(&pupil).unwrap();
    let ncpa_nm = Array1::from(ncpa_nm);
    let wanted_nm = ncpa_nm.dot(&basis.evaluate(&samples.xs_m, &samples.ys_m).unwrap());
    let influence = actuators(&scene, sensor.sensor.lenslets(), &telescope).unwrap();
    let nearest_nm =
        MirrorFit::new(&influence, &samples, pupil.grid).unwrap().shapes_nm(wanted_nm.view().insert_axis(Axis(0)));
    let nearest_nm = nearest_nm.row(0).to_owned();
    let truth = Truth::draw(&scene, &telescope, &mut stream(3, 0)).unwrap();
    let columns = truth.ncpa_nm.ncols();
    let unused_mas = Array2::zeros((NCPA_NM.len(), sensor.slopes()));
    let flat_nm = Array2::zeros((1, sensor.modes.ncols()));
    let references_mas = sensor.measure_references(&unused_mas, flat_nm.view()).unwrap();
    // RMS of the shape that the loop makes less the nearest one. The sensor does not see piston.
    let mut off_nm = || {
        let moved_mas = -ncpa_nm.dot(&sensor.measure_references(&unused_mas, flat_nm.view()).unwrap());
        let system =
            Simulator::with_moved_reference(&scene, telescope.clone(), truth.clone(), &moved_mas.to_vec()).unwrap();
        let lost_nm = |at: [usize; 2]| truth.ncpa_nm[at] - system.truth().ncpa_nm[at];
        let lost_nm: Array1<f64> = samples.indices.iter().map(|&at| lost_nm([at / columns, at % columns])).collect();
        let off_nm = (&lost_nm - &nearest_nm).std(0.0);
        // From now on the slopes are those of the NCPA themselves.
        sensor.mirror = None;
        off_nm
    };
    let (of_the_mirror_nm, of_the_ncpa_nm) = (off_nm(), off_nm());
    // The modes are found again from the move.
    sensor.reference_mas_per_nm = Some(references_mas.clone());
    let sensor = sensor.with_moved_reference(Some(-ncpa_nm.dot(&references_mas))).unwrap();
    let moved_nm = sensor.moved_shape_nm().unwrap().unwrap();
    // LEAST_RESPONSE takes a millionth off.
    assert!((&moved_nm + &ncpa_nm).iter().all(|nm| nm.abs() < 1e-3), "{moved_nm}");
    println!(
        "off the nearest shape of {:.1} nm by {of_the_mirror_nm:.2} nm about its slopes, {of_the_ncpa_nm:.2} about those of the NCPA",
        nearest_nm.std(0.0)
    );
    // The loop leaves out the modes that its reconstructor filters, and slopes are averages over
    // subapertures: 2.6 nm, where the slopes of the NCPA lead 9.6 nm away.
    assert!(of_the_mirror_nm < 0.1 * nearest_nm.std(0.0), "{of_the_mirror_nm}");
    assert!(of_the_mirror_nm < 0.5 * of_the_ncpa_nm, "{of_the_mirror_nm} {of_the_ncpa_nm}");
}
