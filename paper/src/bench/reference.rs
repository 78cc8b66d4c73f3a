//! What the f64 CPU chain finds on the draws, and how a session gets them.

use crate::experiment::{Case, Draw};
use cophase::Result;
use cophase::modal::{FitOptions, Session, SessionOptions};
use ndarray::Array2;

/// RMS of the coefficients at which objectives are evaluated, nm: within the capture range of every
/// scene, and not flat.
const PLACE_NM: f64 = 40.0;

/// Estimates and gradients of the reference (f64 CPU) chain for each draw, against which every
/// variant is held.
pub(super) struct Reference {
    /// The estimates, nm; `None` where a fit gave none.
    pub coefficients_nm: Vec<Option<Vec<f64>>>,
    /// Gradients at the first place, `[draw, mode]`, per nm.
    pub gradients: Array2<f64>,
}

impl Reference {
    pub fn new(case: &Case, draws: &[Draw]) -> Result<Self> {
        let options = SessionOptions { capacity: draws.len(), threads: 0, ..SessionOptions::default() };
        let mut session = Session::new(case.estimator.clone(), &options)?;
        write(&mut session, draws, 0, draws.len())?;
        session.load(0, draws.len(), None)?;
        let modes = case.estimator.model().optics.modes();
        let (mut objectives, mut gradients) = (vec![0.0; draws.len()], Array2::zeros((draws.len(), modes)));
        let at = place(0, draws.len(), modes);
        session.evaluate(0, at.view(), &mut objectives, gradients.as_slice_mut().unwrap_or_default())?;
        session.fit(draws.len(), &FitOptions::default())?;
        let coefficients_nm = (0..draws.len()).map(|image| fitted(&session, image)).collect();
        Ok(Self { coefficients_nm, gradients })
    }
}

/// Writes `count` frames: the draws from number `first` on, over and over.
pub(super) fn write(session: &mut Session, draws: &[Draw], first: usize, count: usize) -> Result<()> {
    for image in 0..count {
        let (mut frame_e, mut bad) = session.frame_mut(image, 0)?;
        frame_e.assign(&draws[(first + image) % draws.len()].image_e);
        bad.fill(false);
    }
    Ok(())
}

/// Place `number` for each of `images`, `[image, mode]`, nm.
pub(super) fn place(number: usize, images: usize, modes: usize) -> Array2<f64> {
    // Of unit variance, and no two images or modes alike.
    let value = |image: usize, mode: usize| ((7 * image + 3 * mode + 11 * number) as f64).sin() * 2f64.sqrt();
    Array2::from_shape_fn((images, modes), |(image, mode)| PLACE_NM * value(image, mode))
}

/// The estimate of an image of the last fit, nm; `None` where the image could not be used.
pub(super) fn fitted(session: &Session, image: usize) -> Option<Vec<f64>> {
    let found = &session.results()[image].coefficients_nm;
    found.iter().all(|nm| nm.is_finite()).then(|| found.clone())
}
