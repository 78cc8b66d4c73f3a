//! Slopes that do not belong to the images: a short sequence behind adaptive optics, read with its
//! telemetry.

use super::cases::Settings;
use super::spoil::{Mismatch, flipped};
use super::verdict::Verdict;
use crate::reproduce::Progress;
use crate::reproduce::on_sky::Sequence;
use cophase::Result;
use cophase::ao::Simulator;
use cophase::pipeline::StaticMaps;
use cophase::scene::Scene;
use cophase::{Estimator, Images};
use ndarray::{Array2, Axis, concatenate, s};

/// Beside the preset `keck-onsky`: seven segments behind a small sensor, so that five exposures are
/// made and read in seconds.
const SMALL: Settings = &[
    ("pupil.aperture", "hexagonal"),
    ("pupil.rings", "1"),
    ("pupil.grid_m", "5.625"),
    ("pupil.samples", "64"),
    ("image.pixels", "80"),
    ("image.exposure_s", "0"),
    ("image.diversity_focus_waves_rms", "1"),
    ("image.peak_snr", "300"),
    ("image.read_noise_e", "20"),
    ("image.count", "5"),
    ("image.interval_s", "0.1"),
    ("aberrations.segment_piston_rms_nm", "60"),
    ("aberrations.ncpa_rms_nm", "50"),
    ("aberrations.ncpa_zernikes", "[4, 11]"),
    ("wavefront_sensor.lenslets_across", "10"),
    ("wavefront_sensor.samples_per_lenslet", "8"),
    ("mirror.actuators_across", "11"),
    ("control.settle_s", "0.2"),
    ("estimate.method", "full-phase"),
    ("estimate.telemetry", "check"),
    ("estimate.device", "cpu"),
];

fn scene(seed: usize) -> Result<Scene> {
    let seed = seed.to_string();
    let seeds = [("aberrations.seed", &*seed), ("turbulence.seed", &*seed)];
    Scene::preset("keck-onsky")?.with(SMALL)?.with(&seeds)
}

/// The verdict on draw `seed` of such a sequence.
pub(super) fn verdict(mismatch: Mismatch, seed: usize, progress: &Progress) -> Result<Verdict> {
    let scene = scene(seed)?;
    let made = Sequence::behind(Simulator::new(&scene)?, progress)?;
    let images_e = match mismatch {
        Mismatch::FlippedImages => flipped(&made.images_e, Axis(2)),
        _ => made.images_e,
    };
    let truth = StaticMaps { phasing_nm: made.phasing_nm, ncpa_nm: made.ncpa_nm };
    let slopes_mas = Some(mismatched(made.slopes_mas, mismatch));
    let images = Images { slopes_mas, truth: Some(truth), ..Images::new(images_e) };
    Verdict::of(Estimator::new(&scene)?.estimate(&images), |found| Ok(Verdict::by_maps(found)))
}

/// The measured slopes, `[image, slope]`, all along x and then all along y, with what is wrong with
/// them.
fn mismatched(slopes_mas: Array2<f64>, mismatch: Mismatch) -> Array2<f64> {
    let (images, slopes) = slopes_mas.dim();
    match mismatch {
        Mismatch::None | Mismatch::FlippedImages => slopes_mas,
        Mismatch::OppositeSign => -slopes_mas,
        Mismatch::YBeforeX => {
            concatenate![Axis(1), slopes_mas.slice(s![.., slopes / 2..]), slopes_mas.slice(s![.., ..slopes / 2])]
        }
        Mismatch::Zero => slopes_mas * 0.0,
        Mismatch::OtherUnit => slopes_mas / 1000.0,
        Mismatch::ReversedTime => slopes_mas.slice(s![..;-1, ..]).to_owned(),
        Mismatch::ShiftedTime => {
            let before: Vec<usize> = (0..images).map(|image| (image + images - 1) % images).collect();
            slopes_mas.select(Axis(0), &before)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn a_scene_has_its_seed() {
        let scene = scene(7).unwrap();
        assert_eq!((scene.turbulence.seed, scene.image.count), (7, 5));
    }

    #[test]
    fn slopes_are_changed_as_they_are_described() {
        let right = array![[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0], [9.0, 10.0, 11.0, 12.0]];
        let rows = |order: [usize; 3]| right.select(Axis(0), &order);
        for (mismatch, wanted) in [
            (Mismatch::None, right.clone()),
            (Mismatch::FlippedImages, right.clone()),
            (Mismatch::OppositeSign, &right * -1.0),
            (Mismatch::YBeforeX, right.select(Axis(1), &[2, 3, 0, 1])),
            (Mismatch::Zero, Array2::zeros((3, 4))),
            (Mismatch::OtherUnit, &right / 1000.0),
            (Mismatch::ReversedTime, rows([2, 1, 0])),
            (Mismatch::ShiftedTime, rows([2, 0, 1])),
        ] {
            assert_eq!(mismatched(right.clone(), mismatch), wanted, "{mismatch:?}");
        }
    }
}
