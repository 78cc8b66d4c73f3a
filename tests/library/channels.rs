//! Channels: several images of one wavefront, fitted together.

use crate::common::{assert_facts, images_of};
use crate::consistency::{scene, shown};
use cophase::Control;
use cophase::ao::{self, Shot, Simulator};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use cophase::modal::Model;
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::Scene;
use ndarray::{Array2, Array3};
use std::path::Path;

pub(crate) const PAIR: &str =
    "[[image.channel]]\nname = \"plus\"\n[[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -0.8\n";
pub(crate) const COLOURS: &str =
    "[[image.channel]]\nname = \"K\"\n[[image.channel]]\nname = \"H\"\nwavelength_nm = 1640.0\n";

/// The small scene with `channels` and `settings`.
pub(crate) fn with_channels(channels: &str, settings: &[(&str, &str)]) -> Scene {
    let text = scene(settings).text().replacen("[aberrations]", &format!("{channels}\n[aberrations]"), 1);
    Scene::from_text(&text, Path::new("")).unwrap()
}

fn estimate(scene: &Scene, images: &[Images]) -> Estimate {
    shown(Estimator::new(scene).unwrap().estimate(images).unwrap())
}

/// Whether the residuals are within three error bars: those of 7 pistons and some ten Zernikes
/// exceed them once in 1,000 draws.
pub(crate) fn is_right(found: &Estimate) -> bool {
    let residual = &found.truth.as_ref().unwrap().1;
    residual.rms_nm[0] < 3.0 * found.figures.phasing.sigma_nm && residual.rms_nm[1] < 3.0 * found.figures.ncpa.sigma_nm
}

#[test]
fn a_pair_is_better_than_either_image_and_needs_no_order() {
    let scene = with_channels(PAIR, &[]);
    let images = Images::simulated(&scene).unwrap();
    // The noise differs, the wavefront does not.
    assert_ne!(images[0].images_e, images[1].images_e);
    let [one, other] = [0, 1].map(|channel| images[channel].truth.clone().unwrap().phasing_nm);
    assert!(one.iter().zip(&other).all(|(a, b)| a == b || (a.is_nan() && b.is_nan())));
    let both = estimate(&scene, &images);
    assert!(both.is_sound() && is_right(&both));
    assert_eq!((both.channels.as_slice(), both.images.len()), (&["plus".to_string(), "minus".into()][..], 2));
    assert_eq!(both.images.iter().map(|image| image.channel).collect::<Vec<_>>(), [0, 1]);
    // Two images of one brightness: error bars are smaller by √2 where both determine a mode as
    // well, and by more where they differ.
    for (images, channel) in images.iter().zip(scene.channels()) {
        let one = Estimator::new(&channel.scene).unwrap().estimate(images).unwrap();
        assert!(
            both.figures.phasing.sigma_nm < 0.8 * one.figures.phasing.sigma_nm,
            "{} {}",
            both.figures.phasing.sigma_nm,
            one.figures.phasing.sigma_nm
        );
        assert!(
            both.figures.ncpa.sigma_nm < 0.8 * one.figures.ncpa.sigma_nm,
            "{} {}",
            both.figures.ncpa.sigma_nm,
            one.figures.ncpa.sigma_nm
        );
    }
    let [plus, minus] = images.try_into().unwrap();
    let swapped = Estimator::new(&scene).unwrap().estimate(&[minus, plus]).unwrap();
    assert_eq!(swapped.modes.coefficients_nm, both.modes.coefficients_nm);
}

#[test]
#[ignore = "merge: 10 s"]
fn defocus_amplitude_is_determined_by_a_pair_not_by_one_image() {
    let made = with_channels(PAIR, &[("image.diversity_focus_waves_rms", "0.84")]);
    let made = Scene::from_text(&made.text().replace("= -0.8\n", "= -0.84\n"), Path::new("")).unwrap();
    let images: Vec<Images> = Images::simulated(&made).unwrap();
    // 5 % of 0.8 waves are 85 nm, which each channel has as NCPA of its own sign.
    let wrong = estimate(&with_channels(PAIR, &[]), &images);
    assert!(wrong.warnings.iter().any(|warning| warning.contains("the channels contradict each other")));
    let fitted = estimate(&with_channels(PAIR, &[("estimate.fit_optics", "[\"defocus\"]")]), &images);
    assert!(fitted.is_sound() && is_right(&fitted), "{:?}", fitted.warnings);
    let [defocus] = fitted.optics.as_slice() else { panic!("{:?}", fitted.optics) };
    assert!((defocus.value - 0.84).abs() < 4.0 * defocus.sigma.max(1e-5), "{defocus:?}");
    // Two images behind one defocus say no more of it than one.
    let same = with_channels("[[image.channel]]\n[[image.channel]]\n", &[("estimate.fit_optics", "[\"defocus\"]")]);
    let found = estimate(&same, &Images::simulated(&same).unwrap());
    assert!(found.optics[0].sigma.is_infinite() && is_right(&found), "{:?}", found.optics);
    assert!(
        found.warnings.iter().any(|warning| warning.contains("do not determine the amplitude")),
        "{:?}",
        found.warnings
    );
}

#[test]
#[ignore = "merge: 9 s"]
fn a_channel_that_is_flipped_contradicts_the_other() {
    let scene = with_channels(PAIR, &[]);
    let mut images = Images::simulated(&scene).unwrap();
    // About the axis, which is on column 48 of 96.
    let flipped = images[1].images_e.slice(ndarray::s![.., .., 1..;-1]).to_owned();
    images[1].images_e.slice_mut(ndarray::s![.., .., 1..]).assign(&flipped);
    let found = estimate(&scene, &images);
    assert!(found.warnings.iter().any(|warning| warning.contains("the channels contradict each other")));
    assert_eq!(found.status, cophase::Status::Contradictory);
}

/// An image in focus adds what it knows to a pair, and error bars stay those of the errors.
#[test]
#[ignore = "merge: 33 s"]
fn a_channel_in_focus_is_fitted_with_the_others() {
    // The same exposure of each, so that the image in focus has a higher peak.
    let pair = PAIR.replace("[[image.channel]]\n", "[[image.channel]]\nflux_e = 1e8\n");
    let set = format!("[[image.channel]]\nname = \"focus\"\nflux_e = 1e8\ndiversity_focus_waves_rms = 0.0\n{pair}");
    let (mut squares, mut gain) = ([0.0; 2], 0.0);
    const DRAWS: usize = 24;
    for seed in 0..DRAWS {
        let scene = with_channels(&set, &[("aberrations.seed", &(300 + seed).to_string())]);
        let images = Images::simulated(&scene).unwrap();
        let all = Estimator::new(&scene).unwrap().estimate(&images).unwrap();
        assert!(all.is_sound(), "{seed}: {:?}", all.warnings);
        assert_eq!(all.channels, ["focus", "plus", "minus"]);
        let pair = with_channels(&pair, &[("aberrations.seed", &(300 + seed).to_string())]);
        let pair = Estimator::new(&pair).unwrap().estimate(&images[1..]).unwrap();
        gain += (all.figures.phasing.sigma_nm / pair.figures.phasing.sigma_nm).ln() / DRAWS as f64;
        let residual = all.truth.as_ref().unwrap().1.rms_nm;
        for (square, (rms_nm, figure)) in
            squares.iter_mut().zip(residual.iter().zip([&all.figures.phasing, &all.figures.ncpa]))
        {
            *square += (rms_nm / figure.sigma_nm).powi(2) / DRAWS as f64;
        }
    }
    let pulls = squares.map(f64::sqrt);
    println!("pulls {pulls:?}, error bars of the phasing {:.3} of the pair's", gain.exp());
    // 24 draws of six pistons: a pull scatters by 1/√(2·144), 0.06.
    assert!(pulls.iter().all(|pull| (0.8..1.2).contains(pull)), "{pulls:?}");
    // 0.82 where the third image had as much information on every mode as each of the two, 1 where
    // it had none.
    assert!((0.8..0.97).contains(&gain.exp()), "{}", gain.exp());
}

#[test]
fn a_channel_in_focus_of_another_wavefront_is_named() {
    let set = format!("{PAIR}[[image.channel]]\nname = \"focus\"\ndiversity_focus_waves_rms = 0.0\n");
    let scene = with_channels(&set, &[]);
    let mut images = Images::simulated(&scene).unwrap();
    images[2] = Images::simulated(&with_channels(&set, &[("aberrations.seed", "77")])).unwrap().swap_remove(2);
    let found = estimate(&scene, &images);
    let named = |word: &str| found.warnings.iter().any(|warning| warning.contains(word));
    assert!(named("contradict each other") || named("not explained within their noise"), "{:?}", found.warnings);
}

/// Half of the segments of this draw are off by 4·1,640 − 3·2,168.6 nm in the first fits. What the
/// modes leave out explains that, to a reduced χ² of 1.04, and is not to be believed.
#[test]
#[ignore = "merge: 10 s"]
fn wrong_whole_wavelengths_are_not_explained_away() {
    let settings = [("aberrations.segment_piston_rms_nm", "1732"), ("image.peak_snr", "30"), ("aberrations.seed", "5")];
    let scene = Scene::preset("keck-two-colour").unwrap().with(&settings).unwrap();
    let found = estimate(&scene, &Images::simulated(&scene).unwrap());
    assert!(is_right(&found), "{:?}", found.truth.unwrap().1.rms_nm);
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
}

/// NCPA modes that are not there have next to no level beside pistons of 1.5 µm, too, which are
/// known to a tenth of a nanometre.
#[test]
#[ignore = "merge: 5 s"]
fn large_pistons_leave_the_prior_of_other_modes() {
    let settings =
        [("aberrations.segment_piston_rms_nm", "1500"), ("aberrations.seed", "1"), ("estimate.posterior", "false")];
    let scene = Scene::preset("keck-two-colour").unwrap().with(&settings).unwrap();
    let found = estimate(&scene, &Images::simulated(&scene).unwrap());
    // 0.134 nm; 0.171 where the bands beyond Noll 20 keep levels of some nanometres.
    assert!(is_right(&found) && found.figures.phasing.sigma_nm < 0.15, "{}", found.figures.phasing.sigma_nm);
}

#[test]
fn two_colours_find_the_whole_wavelengths_of_pistons() {
    let scene = with_channels(COLOURS, &[("aberrations.segment_piston_rms_nm", "3000")]);
    let images = Images::simulated(&scene).unwrap();
    let found = estimate(&scene, &images);
    assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
    assert_eq!(found.integers.len(), 7);
    // Pistons of 3,000 nm RMS are more than a wavelength apart.
    let first = found.integers[0].integer;
    assert!(found.integers.iter().any(|one| one.integer != first), "{:?}", found.integers);
    assert!(found.integers.iter().all(|found| found.probability > 0.99), "{:?}", found.integers);
}

#[test]
fn auto_gives_the_estimate_of_the_method_that_it_chooses() {
    let scene = with_channels(PAIR, &[]);
    let images = Images::simulated(&scene).unwrap();
    let found = estimate(&scene.with(&[("estimate.method", "auto")]).unwrap(), &images);
    assert_eq!(found.modes.coefficients_nm, estimate(&scene, &images).modes.coefficients_nm);
    assert!(found.remarks.iter().any(|remark| remark.contains("chose \"modal\"")), "{:?}", found.remarks);
}

#[test]
fn images_of_other_channels_than_the_scenes_are_refused() {
    let scene = with_channels(PAIR, &[]);
    let images = Images::simulated(&scene).unwrap();
    let estimator = Estimator::new(&scene).unwrap();
    for few in [&images[..1], images[0].as_ref()] {
        assert_facts(&estimator.estimate(few).unwrap_err().to_string(), "1 channel | 2 (plus, minus)");
    }
    let mut other = images.clone();
    other[1].channel = Some("blue".into());
    let unknown = estimator.estimate(&other).unwrap_err().to_string();
    assert_facts(&unknown, "no images | 'minus'");
    let model =
        Model::new(&scene, &cophase::modal::Recipe::from_scene(&scene), false).map(drop).unwrap_err().to_string();
    assert_facts(&model, "sessions | one channel");
}

/// A strut moves the centroids of the segments that it shadows, where their tips and tilts are 0.
#[test]
fn tilted_segments_behind_a_strut_are_right() {
    let scene = with_channels(
        PAIR,
        &[
            ("pupil.spider_width_m", "0.25"),
            ("pupil.spider_vanes_deg", "[75, 200]"),
            ("aberrations.segment_tip_tilt_rms_nm", "60"),
            ("modes.segment", "piston-tip-tilt"),
        ],
    );
    let found = estimate(&scene, &Images::simulated(&scene).unwrap());
    assert!(found.is_sound() && is_right(&found));
}

/// Two channels behind adaptive optics, of one and of two images.
const BEHIND_AO: &str = "[[image.channel]]\nname = \"plus\"\n[[image.channel]]\nname = \"minus\"\ncount = 2\nrows = 44\n\
                         diversity_focus_waves_rms = -0.8\n";

#[test]
fn ao_channels_are_estimated_with_their_own_telemetry() {
    let text = include_str!("../c_api/small.toml").replacen("[aberrations]", &format!("{BEHIND_AO}\n[aberrations]"), 1);
    let scene = Scene::from_text(&text, Path::new("")).unwrap();
    let mut simulator = Simulator::new(&scene).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    let summary = simulator.run(&mut shots, &Control::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.fits");
    ao::write(&path, scene.text(), &simulator, &shots, &summary).unwrap();
    let read = Images::read(&path, None).unwrap();
    assert_eq!(read.iter().map(|images| images.channel.as_deref()).collect::<Vec<_>>(), [Some("plus"), Some("minus")]);
    let mut file = FitsReader::open(&path).unwrap();
    for (number, images) in read.iter().enumerate() {
        let own: Vec<&Shot> = shots.iter().filter(|shot| shot.channel == number).collect();
        let (rows, columns) = scene.channels()[number].scene.image.frame_shape();
        assert_eq!(images.images_e.dim(), (number + 1, rows, columns));
        assert_eq!(images.scene.as_ref().unwrap().image, scene.channels()[number].scene.image);
        let telemetry = |values: &dyn Fn(&Shot) -> &[f32]| {
            let all: Vec<f64> = own.iter().flat_map(|shot| values(shot)).map(|&value| f64::from(value)).collect();
            Array2::from_shape_vec((own.len(), all.len() / own.len()), all).unwrap()
        };
        assert_eq!(images.slopes_mas, Some(telemetry(&|shot| &shot.mean_slopes_mas)));
        let hdu = |name: &str| format!("{name},{}", number + 1);
        assert_eq!(file.map(Some(&hdu("SLOPES"))).unwrap(), telemetry(&|shot| &shot.slopes_mas));
        assert_eq!(file.map(Some(&hdu("COMMANDS"))).unwrap(), telemetry(&|shot| &shot.commands_nm));
        let times_s: Vec<f64> = own.iter().map(|shot| shot.time_s).collect();
        assert_eq!(file.f64_column(&hdu("SHOTS"), "TIME_S").unwrap(), times_s);
        let one = images_of(folder.path().join(format!("sky.fits[IMAGES,{}]", number + 1)), None);
        assert_eq!((one.images_e, one.slopes_mas), (images.images_e.clone(), images.slopes_mas.clone()));
    }
    let truth = &simulator.truth().phasing_nm;
    for images in &read {
        let written = &images.truth.as_ref().unwrap().phasing_nm;
        assert!(written.iter().zip(truth).all(|(a, b)| a == b || (a.is_nan() && b.is_nan())));
    }
    for name in ["TRUTH", "SUBAPERTURES", "ACTUATORS", "INTERACTION", "SCENE"] {
        assert!(file.has(name) && !file.has(&format!("{name},2")), "{name}");
    }
}

#[test]
fn telemetry_without_a_number_is_that_of_the_first_channel() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.fits");
    let slopes_mas = Array2::from_shape_fn((1, 6), |(_, slope)| slope as f64);
    for (images, telemetry, expected) in [
        (&["IMAGES"][..], &["SLOPES", "SLOPES_MEAN"][..], &[Some(2.0)][..]),
        (&["IMAGES"], &["SLOPES,2"], &[Some(1.0)]),
        (&["IMAGES", "IMAGES,2"], &["SLOPES_MEAN"], &[Some(1.0), None]),
        (&["IMAGES", "IMAGES,2"], &["SLOPES_MEAN", "SLOPES,2"], &[Some(1.0), Some(2.0)]),
        (&["IMAGES", "IMAGES,2"], &["SLOPES_MEAN,2"], &[None, Some(1.0)]),
    ] {
        let mut file = FitsWriter::create(&path).unwrap();
        for name in images {
            file.image(name, &Array3::<f64>::ones((1, 4, 4)), Pixel::F64, "").unwrap();
        }
        for (number, name) in telemetry.iter().enumerate() {
            file.image(name, &(&slopes_mas * (number + 1) as f64), Pixel::F64, "mas").unwrap();
        }
        file.finish().unwrap();
        let read = Images::read(&path, None).unwrap();
        let found: Vec<_> = read.into_iter().map(|images| images.slopes_mas).collect();
        let expected: Vec<_> = expected.iter().map(|factor| factor.map(|factor| &slopes_mas * factor)).collect();
        assert_eq!(found, expected, "{images:?} {telemetry:?}");
    }
}
