//! A session whose device is lost.

use super::super::fitter::ModalFitter;
use super::*;
use crate::device::tests::test_devices;
use crate::imaging::{Chain, Fallback, Precision};
use crate::modal::solve::engine::DeviceEngine;
use crate::scene::Scene;
use std::sync::Arc;

/// Warning of a session on a device that `auto` might have selected, before and after it is lost in
/// the midst of a fit; the result of the fit is the same.
#[test]
fn a_session_warns_of_a_lost_device() {
    let settings = [("pupil.samples", "64"), ("image.crop_pixels", "64"), ("modes.ncpa", "none"), ("image.count", "2")];
    let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
    let made = crate::source::simulate(&scene).unwrap().remove(0);
    let fitter = Arc::new(ModalFitter::new(&scene, true).unwrap());
    for info in test_devices().into_iter().filter(|info| info.supports(Precision::F64)) {
        let options = SessionOptions { capacity: 2, ..SessionOptions::default() };
        let mut session = Session::new(fitter.clone(), &options).unwrap();
        let optics = fitter.model().optics.clone();
        let chain = Chain::open(optics.clone(), info.address().parse().unwrap(), Precision::F64, 2).unwrap();
        let Chain::Device { chain: on_device, .. } = &chain else { panic!("a device that was named is opened") };
        let device = on_device.device().clone();
        let guarded = Chain::Auto(Fallback::new(chain, optics));
        session.channels[0].engine = Box::new(DeviceEngine::new(guarded));
        let mut fit = || {
            for (image, electrons) in made.images_e.outer_iter().enumerate() {
                let (mut frame, mut bad) = session.frame_mut(image, 0).unwrap();
                frame.assign(&electrons);
                bad.fill(false);
            }
            session.fit(2, &FitOptions::default()).unwrap();
            let found: Vec<f64> = session.results().iter().flat_map(|result| result.coefficients_nm.clone()).collect();
            (found, session.channels()[0].device_failure().map(str::to_owned))
        };
        let (before_nm, nothing) = fit();
        assert_eq!(nothing, None);
        let lost = device.fault().commands() + 20;
        device.fault().arm(lost, u64::MAX);
        let (after_nm, failure) = fit();
        let failure = failure.expect("a lost device gives a warning");
        assert!(failure.starts_with(&info.address()) && failure.contains("CPU has taken its place"), "{failure}");
        // The same fit to another chain's rounding, and to the step at which fits end.
        let apart = before_nm.iter().zip(&after_nm).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(apart < 1e-2, "{apart} nm");
    }
}
