//! Is a budget kept, and what does it save?
//! `cargo bench -p cophase-paper --bench plans [-- SCENES [BUDGET_NM]]`
//!
//! Random scenes of Keck (errors, star, defocus) are planned, and a wavefront that the planner has
//! not seen is read by the plan and by the scene's own model in double precision.

use cophase::Control;
use cophase::Result;
use cophase::imaging::{Chain, Precision};
use cophase::metrics::residual_nm;
use cophase::modal::{Cube, ImageFits, ModalFitter};
use cophase::modes::Group;
use cophase::planner;
use cophase::scene::{self, Scene};
use cophase::source;
use cophase_paper::reproduce::statistics::median;
use ndarray::{Array3, Axis, concatenate};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use std::time::Instant;

/// Images whose time is taken together.
const BATCH: usize = 16;

fn main() -> Result<()> {
    let mut words = std::env::args().filter_map(|word| word.parse::<f64>().ok());
    let (scenes, budget_nm) = (words.next().unwrap_or(20.0) as usize, words.next().unwrap_or(1.0));
    let mut rng = ChaCha12Rng::seed_from_u64(7);
    let (mut ratios, mut errors, mut noisy) = (Vec::new(), Vec::new(), 0);
    println!("scene  samples  crop  tolerance  plan s  error/budget  phasing   ncpa  (own model)  times faster");
    for number in 0..scenes {
        let scene = random(number, &mut rng)?;
        let began = Instant::now();
        let plan = planner::plan(&scene, budget_nm, &Control::default())?;
        let plan_s = began.elapsed().as_secs_f64();
        let (planned_s, planned_nm) = read(&plan.scene, &scene)?;
        let (own_s, own_nm) = read(&own_model(&scene)?, &scene)?;
        let error = planned_nm[0].max(planned_nm[1]) / budget_nm;
        println!(
            "{number:>5} {:>8} {:>5?} {:>9?} {plan_s:>7.1} {error:>13.2} {:>8.3} {:>6.3} ({:.3} {:.3}) {:>8.1} {}",
            plan.scene.estimate.samples.unwrap_or(scene.pupil.samples),
            plan.scene.image.crop_pixels,
            plan.scene.estimate.step_tolerance_nm,
            planned_nm[0],
            planned_nm[1],
            own_nm[0],
            own_nm[1],
            own_s / planned_s,
            plan.shortfall().unwrap_or_default()
        );
        ratios.push(own_s / planned_s);
        if plan.is_met() { errors.push(error) } else { noisy += 1 }
    }
    let over = errors.iter().filter(|&&error| error > 1.0).count();
    println!(
        "median {:.1} times faster than the scene's own model in f64 (least {:.1}); error over budget: median {:.2}, largest {:.2}, \
         {over} of {} above 1; {noisy} scenes whose noise alone is above the budget",
        median(&ratios),
        ratios.iter().copied().fold(f64::INFINITY, f64::min),
        median(&errors),
        errors.iter().copied().fold(0.0, f64::max),
        errors.len(),
    );
    Ok(())
}

/// Errors, star and defocus of one scene.
fn random(number: usize, rng: &mut ChaCha12Rng) -> Result<Scene> {
    let mut between = |low: f64, high: f64| (low + (high - low) * rng.random::<f64>()).to_string();
    let settings = [
        ("image.samples_per_lambda_over_d", "2".to_string()),
        ("image.pixels", "240".to_string()),
        ("image.peak_snr", between(200.0, 1000.0)),
        ("image.diversity_focus_waves_rms", between(1.0, 2.0)),
        ("aberrations.segment_piston_rms_nm", between(20.0, 100.0)),
        ("aberrations.ncpa_rms_nm", between(20.0, 100.0)),
        ("aberrations.seed", (1000 + number).to_string()),
    ];
    let settings: Vec<(&str, &str)> = settings.iter().map(|(key, value)| (*key, value.as_str())).collect();
    Scene::preset("keck-artificial")?.with(&settings)
}

/// The scene as it is, in double precision; the basis that spans its NCPA.
fn own_model(scene: &Scene) -> Result<Scene> {
    scene.with(&[("modes.exact_zernikes", "[2, 21]"), ("estimate.precision", "f64")])
}

/// Seconds an image in a batch, and the residuals of phasing and NCPA, nm, where `model` reads the
/// image of `scene`.
fn read(model: &Scene, scene: &Scene) -> Result<(f64, [f64; 2])> {
    let made = source::simulate(scene)?.remove(0);
    let estimator = ModalFitter::new(model, false)?;
    let precision = match model.estimate.precision() {
        scene::Precision::F32 => Precision::F32,
        scene::Precision::F64 => Precision::F64,
    };
    let mut chain = Chain::cpu(estimator.model().optics.clone(), precision);
    let mut fit = |images_e: &Array3<f64>| -> Result<ImageFits> {
        let bad = images_e.mapv(|_| false);
        let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
        estimator.fit_each(&mut chain, cube, &Control::default())
    };
    let found = fit(&made.images_e)?;
    let many = concatenate(Axis(0), &vec![made.images_e.view(); BATCH]).expect("the images have one shape");
    let mut seconds = Vec::new();
    for _ in 0..5 {
        let began = Instant::now();
        fit(&many)?;
        seconds.push(began.elapsed().as_secs_f64() / BATCH as f64);
    }
    let (model, coefficients_nm) = (estimator.model(), found.coefficients_nm.row(0).to_vec());
    let pupil = &model.telescope.pupil;
    let truth = made.truth.maps_on(pupil)?;
    let part = |group, truth| residual_nm(pupil, model.map_nm(&coefficients_nm, group).view(), truth);
    Ok((median(&seconds), [part(Group::Segment, truth[0].view())?, part(Group::Ncpa, truth[1].view())?]))
}
