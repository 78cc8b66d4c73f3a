//! Plans of observations: what they promise, and what they refuse.

use crate::consistency::{scene, shown};
use cophase::Control;
use cophase::pipeline::{Estimator, Images, plan_observation};
use cophase::scene::Scene;

fn plan(scene: &Scene, wavelengths_nm: &[f64], budget_nm: f64) -> cophase::pipeline::ObservationPlan {
    let control = Control::default();
    let plan = plan_observation(scene, wavelengths_nm, budget_nm, &control).unwrap();
    let progress = control.progress();
    assert!(progress.done > 0 && progress.done == progress.total, "{progress:?}");
    plan
}

#[test]
#[ignore = "merge: 6 s"]
fn an_observation_reaches_its_budget_when_it_is_taken() {
    let scene = scene(&[("image.peak_snr", "60"), ("image.read_noise_e", "10")]);
    let plan = plan(&scene, &[], 0.5);
    let best = plan.recommended().unwrap();
    assert!(best.expected_nm.iter().all(|nm| *nm <= 0.5), "{best:?}");
    assert!(best.exposures.unwrap() > 1 && best.flaw.is_none() && best.channels.len() <= 2);
    let is_dearer = |total: usize| Some(total) >= best.total_exposures();
    assert!(plan.observations.iter().all(|one| one.flaw.is_some() || one.total_exposures().is_none_or(is_dearer)));
    // Half a wavelength about the mean.
    assert_eq!(best.piston_range_nm, scene.image.wavelength_nm / 2.0);
    let again = Scene::from_text(best.scene.text(), best.scene.directory()).unwrap();
    let images = Images::simulated(&again.with_override("aberrations.seed", "5").unwrap()).unwrap();
    let found = shown(Estimator::new(&again).unwrap().estimate(&images).unwrap());
    // Some ten modes each: their RMS exceeds twice its expectation once in 10⁴ draws. Error bars
    // are those of one noise and one wavefront.
    let residual_nm = found.truth.as_ref().unwrap().1.rms_nm;
    assert!((0..2).all(|part| residual_nm[part] < 2.0 * best.expected_nm[part]), "{residual_nm:?} {best:?}");
    let bars_nm = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
    assert!((0..2).all(|part| (bars_nm[part] / best.expected_nm[part] - 1.0).abs() < 0.2), "{bars_nm:?} {best:?}");
}

#[test]
#[ignore = "merge: 25 s"]
fn two_wavelengths_extend_range_and_tiny_budgets_have_no_plan() {
    let scene = scene(&[]);
    let two = plan(&scene, &[2168.6, 1640.0], 1.0);
    let colours = two.observations.iter().find(|one| one.channels[0].0 != one.channels.last().unwrap().0).unwrap();
    assert!(colours.piston_range_nm > 2000.0, "{colours:?}");
    let images = Images::simulated(&colours.scene).unwrap();
    assert_eq!(images.len(), 2);
    let none = plan(&scene, &[], 1e-6);
    assert!(none.recommended().is_none() && none.observations.iter().all(|one| one.exposures.is_none()));
}

#[test]
fn scenes_that_are_not_planned_are_refused() {
    let refused = |scene: &Scene, budget_nm: f64| {
        plan_observation(scene, &[], budget_nm, &Control::default()).map(drop).unwrap_err().to_string()
    };
    assert!(refused(&Scene::preset("keck-onsky").unwrap(), 1.0).contains("behind an AO loop"));
    assert!(refused(&scene(&[]), 0.0).contains("budget of 0 nm"));
    let odd = plan_observation(&scene(&[]), &[2000.0, f64::NAN], 1.0, &Control::default()).unwrap_err().to_string();
    assert!(odd.contains("a wavelength of NaN nm"), "{odd}");
}
