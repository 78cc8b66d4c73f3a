//! The paper's optimiser: BFGS from zero, image by image, coefficients in radians, tolerance 1e-6
//! on the gradient.

use crate::Result;
use crate::imaging::{Chain, Exposure};
use crate::modal::assess::chi2::ReducedChi2;
use crate::modal::assess::residual::photometry;
use crate::modal::solve::engine::device::prepare_all;
use crate::modal::solve::engine::task::{FitState, FitTask, ImageFit, Prepare, stop_if_cancelled};
use crate::modal::solve::minimum::Minimum;
use crate::optimize::ArgminBfgs;
use ndarray::{Array1, ArrayView1};

/// The paper's BFGS also stops where the objective, in units of the brightest pixel squared,
/// changes by no more than this: a few roundings. Where the residual is large the gradient stays
/// above its tolerance because of rounding, and a fit takes all 2,000 evaluations; with this limit
/// 330 lead to within 1e-4 nm of the same point (150 nm of turbulence).
const COST_TOLERANCE: f64 = 1e-13;

pub(super) fn fit(chain: &mut Chain, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()> {
    prepare_all(task, prepare, images);
    let all = images.len();
    let mut ready: Vec<&mut ImageFit> = images.iter_mut().filter(|image| image.state == FitState::NotBegun).collect();
    let (count, mut done) = (ready.len(), 0);
    task.control.step(all - count);
    for images in ready.chunks_mut(task.model.tiles().images) {
        let exposures: Vec<Exposure> = images.iter().map(|image| image.prepared.exposure.clone()).collect();
        chain.load(&exposures)?;
        for (place, (image, exposure)) in images.iter_mut().zip(&exposures).enumerate() {
            image.minimum = minimum(
                chain,
                task,
                (place, exposure),
                (&image.prepared.floor_variance_e2, image.prepared.stated_share),
            )?;
            stop_if_cancelled(image.minimum.reason, done, count)?;
            image.state = FitState::Fitted;
            done += 1;
            task.control.step(1);
        }
    }
    Ok(())
}

fn minimum(
    chain: &mut Chain,
    task: &FitTask,
    (place, exposure): (usize, &Exposure),
    noise: (&[f64], f64),
) -> Result<Minimum> {
    let (nm, modes) = (task.model.optics.parts().wavelength_nm / std::f64::consts::TAU, task.model.optics.modes());
    let solver = ArgminBfgs {
        gradient_tolerance: 1e-6,
        cost_tolerance: COST_TOLERANCE,
        initial_scale: 1.0,
        max_evaluations: task.recipe.max_evaluations,
        cancel: Some(task.control.flag().clone()),
    };
    let mut objective = |radians: &[f64]| -> Result<(f64, Vec<f64>)> {
        let x = Array1::from(radians.to_vec()) * nm;
        let found = chain.evaluate(&[place], x.view().insert_axis(ndarray::Axis(0)))?.remove(0);
        Ok((found.objective, found.gradient.iter().map(|g| g * nm).collect()))
    };
    let outcome = solver.minimize(&mut objective, &vec![0.0; modes])?;
    let (evaluations, reason) = (outcome.evaluations, outcome.reason);
    let coefficients_nm: Vec<f64> = outcome.x.iter().map(|x| x * nm).collect();
    let psf = task.reference.psf(ArrayView1::from(&coefficients_nm));
    let (flux_e, background_e) = photometry(exposure, &psf);
    let chi2 = ReducedChi2::new(&psf, (flux_e, background_e), exposure, noise, modes);
    Ok(Minimum { coefficients_nm, flux_e, background_e, evaluations, reason, chi2, images: 1, is_unconfirmed: false })
}
