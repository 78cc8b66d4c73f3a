//! Images that are taken to be of one wavefront, and some of which are of another.

use crate::common::{assert_facts, simulated};
use crate::consistency::scene;
use cophase::Status;
use cophase::pipeline::{Estimate, Estimator, Images};
use ndarray::Axis;

/// RMS of the pistons of the scene, nm.
const PISTONS_NM: f64 = 64.15;

/// `count` images of the scene's wavefront, with `read` of them in place of their own behind
/// pistons that are `more_nm` RMS larger; and settings of the estimate.
fn images(count: usize, others: &[usize], more_nm: f64, settings: &[(&str, &str)]) -> Images {
    let of = |pistons_nm: f64| {
        let own = [("aberrations.segment_piston_rms_nm", pistons_nm.to_string()), ("image.count", count.to_string())];
        let own = own.iter().map(|(key, value)| (*key, value.as_str()));
        simulated(&scene(&own.chain(settings.iter().copied()).collect::<Vec<_>>()))
    };
    let (mut mixed, other) = (of(PISTONS_NM), of(PISTONS_NM + more_nm));
    for &image in others {
        mixed.images_e.index_axis_mut(Axis(0), image).assign(&other.images_e.index_axis(Axis(0), image));
    }
    mixed
}

fn estimate(images: &Images, settings: &[(&str, &str)]) -> Estimate {
    let found = Estimator::new(&scene(settings)).unwrap().estimate(images).unwrap();
    let residual = &found.truth.as_ref().unwrap().1;
    println!(
        "{} images: {}, used {}, clipped {}, residual {:.3?} nm, error bars {:.3} and {:.3} nm, {:?}",
        found.images.len(),
        found.status.word(),
        found.used(),
        found.clipped(),
        residual.rms_nm,
        found.figures.phasing.sigma_nm,
        found.figures.ncpa.sigma_nm,
        found.warnings
    );
    found
}

fn clipped(found: &Estimate) -> Vec<usize> {
    (0..found.images.len()).filter(|&image| found.images[image].is_clipped).collect()
}

#[test]
#[ignore = "merge: 12 s"]
fn images_of_several_wavefronts_are_not_called_ok() {
    let half: Vec<usize> = (9..20).collect();
    for (count, others) in [(2, &[1][..]), (3, &[1]), (7, &[0, 2, 5]), (20, &half)] {
        for more_nm in [5.0, 20.0, 64.0] {
            println!("{} of {count} are {more_nm} nm off", others.len());
            let found = estimate(&images(count, others, more_nm, &[]), &[]);
            assert_eq!((found.status, found.is_sound()), (Status::Contradictory, false));
            let warning = found.warnings.iter().find(|warning| warning.contains("contradict each other")).unwrap();
            assert_facts(warning, "reduced χ² | noise gives 1 | error bars are scaled up to their scatter");
            assert_eq!(found.used(), count);
            // The mean is off by up to half of the difference.
            let off_nm = found.truth.as_ref().unwrap().1.rms_nm[0];
            assert!(off_nm > 0.15 * more_nm && off_nm < 2.0 * found.figures.phasing.sigma_nm, "{off_nm}");
        }
    }
}

#[test]
#[ignore = "merge: 9 s"]
fn a_few_images_of_another_wavefront_are_left_out_and_named() {
    for (count, others, named) in [
        (4, &[2][..], "image 3 of 4"),
        (7, &[1, 4], "images 2, 5 of 7"),
        (20, &[3, 4, 5, 6, 12], "images 4 to 7, 13 of 20"),
    ] {
        for more_nm in [5.0, 64.0] {
            println!("{} of {count} are {more_nm} nm off", others.len());
            let found = estimate(&images(count, others, more_nm, &[]), &[]);
            assert_eq!(clipped(&found), others);
            assert_facts(&found.warnings[0], &format!("{named} | another wavefront | left out | reduced χ²"));
            assert!(!found.is_sound());
            let off_nm = found.truth.as_ref().unwrap().1.rms_nm[0];
            assert!(off_nm < 3.0 * found.figures.phasing.sigma_nm, "{off_nm}");
        }
    }
    // A mean takes all images.
    let mean = [("estimate.combine", "mean")];
    let found = estimate(&images(7, &[1], 20.0, &mean), &mean);
    assert_eq!(found.used(), 7);
    assert_facts(&found.warnings[0], "image 2 of 7 | used as well | clipped-mean");
    assert!(found.figures.phasing.sigma_nm > 0.5 * 20.0 / 7.0);
}

/// What the modes leave out explains no difference of images, and its error bars hold it.
#[test]
fn differences_of_images_stay_in_the_error_bars() {
    let posterior = ("estimate.posterior", "true");
    for (count, others) in [(3, &[1][..]), (7, &[0, 2, 5])] {
        let found = estimate(&images(count, others, 20.0, &[]), &[posterior]);
        assert_eq!(found.status, Status::Contradictory);
        let off_nm = found.truth.as_ref().unwrap().1.rms_nm[0];
        assert!(off_nm > 3.0 && off_nm < 2.0 * found.figures.phasing.sigma_nm, "{off_nm} {:?}", found.figures);
    }
    let mean = [("estimate.combine", "mean"), posterior];
    let found = estimate(&images(7, &[1], 20.0, &mean), &mean);
    assert!(found.used() == 7 && found.figures.phasing.sigma_nm > 0.5 * 20.0 / 7.0, "{:?}", found.figures);
}

#[test]
fn images_of_one_wavefront_agree() {
    for count in [2, 3, 7, 20] {
        for snr in ["50", "500"] {
            let settings = [("image.peak_snr", snr)];
            let found = estimate(&images(count, &[], 0.0, &settings), &settings);
            assert!(found.is_sound(), "{:?}", found.warnings);
        }
    }
}

#[test]
fn a_scene_with_turbulence_expects_the_scatter() {
    let layer = [
        ("turbulence.fractions", "[1]"),
        ("turbulence.heights_m", "[0]"),
        ("turbulence.wind_m_s", "[10]"),
        ("turbulence.wind_dir_rad", "[0]"),
    ];
    for (count, others) in [(2, &[1][..]), (20, &[3])] {
        let mut images = images(count, others, 20.0, &[]);
        // The scene of the file has no turbulence.
        images.scene = None;
        let found = estimate(&images, &layer);
        assert!(found.is_sound(), "{:?}", found.warnings);
    }
}
