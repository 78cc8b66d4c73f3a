//! Hard cases: strong aberrations, faint stars, models and data that are wrong. Of each draw: is the answer right, and
//! where it is not, does the status say so?

mod cases;
mod report;
mod spoil;
mod verdict;

pub use cases::{HARD_CASES, HardCase};
pub use spoil::Spoil;
pub use verdict::Verdict;

use super::Progress;
use cophase::Result;
use cophase::device::Choice;
use cophase::imaging::{Chain, Precision};
use cophase::modal::{Cube, ModalFitter, Recipe};
use cophase::scene::Scene;
use cophase::{Error, modal};
use ndarray::Axis;
use rayon::prelude::*;
use verdict::Comparison;

/// The verdicts on all cases.
#[derive(Debug, Clone)]
pub struct HardCases {
    /// By case, the verdicts on its draws.
    pub cases: Vec<(HardCase, Vec<Verdict>)>,
}

/// Tries `cases`, each on the draws 1 to `seeds` times its own number.
///
/// Every draw is read in double precision on the CPU; the first eight of a case also in single precision, and the first
/// on an OpenCL device where there is one.
///
/// # Errors
/// Those of making images, and [`Error::Interrupted`]. An estimator that refuses is no error but a verdict.
pub fn hard_cases(cases: &[HardCase], seeds: usize, progress: &Progress) -> Result<HardCases> {
    progress.expect(cases.iter().map(|case| case.times * seeds).sum());
    let base = Scene::preset("keck-artificial")?.with(cases::BASE)?;
    // Its Karhunen-Loève basis, which takes the most time, is that of nearly all cases.
    let like = ModalFitter::new(&base, false)?;
    let tried = |case: &HardCase| Ok((*case, tried(case, seeds, &base, &like, progress)?));
    Ok(HardCases { cases: cases.iter().map(tried).collect::<Result<Vec<_>>>()? })
}

fn tried(case: &HardCase, seeds: usize, base: &Scene, like: &ModalFitter, progress: &Progress) -> Result<Vec<Verdict>> {
    let made = base.with(case.made)?;
    let read = made.with(case.read)?;
    let fits_optics = !read.estimate.fit_optics.is_empty();
    let comparison =
        if fits_optics { None } else { Some(like.variant(&read, Recipe::from_scene(&read)).and_then(Comparison::new)) };
    let verdict = |number: usize| -> Result<Verdict> {
        progress.check()?;
        let scene = made.with_override("aberrations.seed", &(1 + number).to_string())?;
        let image = spoil::made(&scene, case.spoil)?;
        let verdict = match &comparison {
            None => compared_with_optics(&read, &image, progress),
            Some(Ok(comparison)) => compared(comparison, &image, number, progress),
            Some(Err(error)) => Ok(Verdict::refused(error)),
        };
        progress.add(1);
        verdict
    };
    (0..case.times * seeds).into_par_iter().map(verdict).collect()
}

/// Draws of a case that are read in single precision too.
const IN_SINGLE: usize = 8;

fn compared(comparison: &Comparison, image: &spoil::Made, number: usize, progress: &Progress) -> Result<Verdict> {
    let optics = &comparison.estimator.model().optics;
    let mut double = Chain::cpu(optics.clone(), Precision::F64);
    let read = |chain: &mut Chain| read(&comparison.estimator, chain, image, progress);
    let found = match read(&mut double) {
        Ok(found) => found,
        Err(error @ Error::Interrupted(_)) => return Err(error),
        Err(error) => return Ok(Verdict::refused(&error)),
    };
    let mut verdict = comparison.verdict(&found, image)?;
    let off_nm = |chain: &mut Chain| {
        let other = read(chain).ok().filter(|other| other.images[0].status == found.images[0].status)?;
        Some(comparison.apart_nm(&other.combined.coefficients_nm, &found.combined.coefficients_nm))
    };
    if number < IN_SINGLE {
        verdict.f32_nm = off_nm(&mut Chain::cpu(optics.clone(), Precision::F32)).unwrap_or(f64::NAN);
    }
    if number == 0
        && let Ok(mut device) = Chain::open(optics.clone(), Choice::OpenCl, Precision::F64, 1)
    {
        verdict.opencl_nm = off_nm(&mut device).unwrap_or(f64::NAN);
    }
    Ok(verdict)
}

/// As [`compared`], by an estimator whose optics are those that this image shows; in double precision alone.
fn compared_with_optics(scene: &Scene, image: &spoil::Made, progress: &Progress) -> Result<Verdict> {
    let (image_e, bad) = spoil::marked(&image.image_e);
    let (image_e, bad) = (image_e.insert_axis(Axis(0)), bad.insert_axis(Axis(0)));
    let cube = Cube { images_e: image_e.view(), bad: bad.view(), read_noise_e: None };
    let mut open = |estimator: &ModalFitter| Ok(Chain::cpu(estimator.model().optics.clone(), Precision::F64));
    match modal::select_default(scene, cube, &mut open, progress.cancel(), &mut |_, _| {}) {
        Ok((estimator, found)) => Comparison::new(estimator)?.verdict(&found, image),
        Err(error @ Error::Interrupted(_)) => Err(error),
        Err(error) => Ok(Verdict::refused(&error)),
    }
}

/// What `cophase estimate` makes of the image.
fn read(
    estimator: &ModalFitter,
    chain: &mut Chain,
    image: &spoil::Made,
    progress: &Progress,
) -> Result<modal::ModalEstimate> {
    let (image_e, bad) = spoil::marked(&image.image_e);
    let (image_e, bad) = (image_e.insert_axis(Axis(0)), bad.insert_axis(Axis(0)));
    estimator.estimate(chain, image_e.view(), bad.view(), None, progress.cancel(), &mut |_, _| {})
}
