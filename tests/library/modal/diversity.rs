//! What images cannot tell from the NCPA: an error of the diversity.

use super::scene;
use crate::common::source_images;
use cophase::Error;
use cophase::modal::{Accumulator, FitOptions, ModalFitter, Session, SessionOptions};
use ndarray::Axis;
use std::sync::Arc;

/// The least that a scene needs for its modes to hold a focus.
const HELD: (&str, &str) = ("modes.exact_zernikes", "[2, 4]");

#[test]
fn diversity_error_needs_a_focus_in_the_modes() {
    let with = |settings: &[(&str, &str)]| ModalFitter::new(&scene(settings), false).unwrap();
    let own = with(&[HELD]);
    let (held, image) = (own.diversity_projection().unwrap(), &own.scene().image);
    let rms_nm = image.diversity_focus_waves_rms * image.wavelength_nm;
    // Noll 4 is the diversity up to a constant, on the model's coarser grid: a part in a thousand
    // of its RMS.
    assert!((held.rms_nm / rms_nm - 1.0).abs() < 0.01, "{held:?}");
    assert!(held.is_spanned() && held.residual_share < 1e-3 && !held.is_too_small(image.wavelength_nm), "{held:?}");
    let none = with(&[("modes.ncpa", "none"), ("modes.exact_zernikes", "none")]).diversity_projection().unwrap();
    assert!(!none.is_spanned() && none.coefficients_nm.iter().all(|nm| *nm == 0.0), "{none:?}");
    // What no mode holds is there all the same.
    assert!(none.rms_nm == held.rms_nm && !none.is_too_small(image.wavelength_nm), "{none:?}");
    let focused = with(&[HELD, ("image.diversity_focus_waves_rms", "0")]).diversity_projection().unwrap();
    assert!(focused.is_too_small(image.wavelength_nm) && !focused.is_spanned(), "{focused:?}");
    let refused =
        scene(&[("modes.ncpa", "none"), ("modes.exact_zernikes", "none"), ("tolerance.defocus_fraction", "0.05")]);
    match ModalFitter::new(&refused, false).map(|_| ()) {
        Err(Error::Scene(sentence)) => assert!(sentence.contains("defocus_fraction = 0.05"), "{sentence}"),
        other => panic!("{other:?}"),
    }
}

#[test]
fn diversity_error_is_in_the_error_bars_of_any_sequence() {
    let known = scene(&[HELD, ("image.count", "3")]);
    let unsure = scene(&[HELD, ("image.count", "3"), ("tolerance.defocus_fraction", "0.02")]);
    let images_e = source_images(&known).images_e;
    let kept = |scene| {
        let estimator = Arc::new(ModalFitter::new(scene, false).unwrap());
        let mut session =
            Session::new(estimator.clone(), &SessionOptions { capacity: 3, ..SessionOptions::default() }).unwrap();
        let mut kept = Accumulator::new(estimator, 3).unwrap();
        for (i, image_e) in images_e.axis_iter(Axis(0)).enumerate() {
            session.frame_mut(i, 0).unwrap().0.assign(&image_e);
        }
        session.fit(3, &FitOptions::default()).unwrap();
        kept.push(&session).unwrap();
        (session.refine(0).unwrap().modes.covariance_nm2, kept)
    };
    let ((covariance, sure), (wider, unsure)) = (kept(&known), kept(&unsure));
    let image = &known.image;
    let shared_nm = 0.02 * image.diversity_focus_waves_rms * image.wavelength_nm;
    // A multiple of the diversity, and nothing else; rounding of variances of some 10³ nm².
    let along_nm = unsure.fitter().diversity_projection().unwrap().coefficients_nm * 0.02;
    for ((i, j), more_nm2) in (&wider - &covariance).indexed_iter() {
        assert!((more_nm2 - along_nm[i] * along_nm[j]).abs() < 1e-9, "{i} {j}: {more_nm2}");
    }
    let (sure_nm, unsure_nm) = (sure.estimate().unwrap(), unsure.estimate().unwrap());
    assert_eq!(sure_nm.modes.coefficients_nm, unsure_nm.modes.coefficients_nm);
    let expected_nm = sure_nm.ncpa_sigma_nm.hypot(shared_nm);
    assert!((unsure_nm.ncpa_sigma_nm / expected_nm - 1.0).abs() < 0.05, "{} {expected_nm}", unsure_nm.ncpa_sigma_nm);
    // What averages out is wanted at half of what it is: three times as many images again.
    let [sure_nm2, unsure_nm2] = [&sure_nm, &unsure_nm].map(|estimate| estimate.ncpa_sigma_nm.powi(2));
    let half_nm = (unsure_nm2 - 0.75 * sure_nm2).sqrt();
    assert_eq!(sure.images_needed(f64::INFINITY, 0.5 * sure_nm2.sqrt()).unwrap(), 9);
    // Rounded up, from a difference of squares.
    assert!((9..=10).contains(&unsure.images_needed(f64::INFINITY, half_nm).unwrap()));
    match unsure.images_needed(f64::INFINITY, 0.9 * shared_nm) {
        Err(Error::Value(sentence)) => assert!(sentence.contains("out of reach"), "{sentence}"),
        other => panic!("{other:?}"),
    }
}
