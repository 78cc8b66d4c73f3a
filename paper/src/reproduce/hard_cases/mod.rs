//! Hard cases: strong aberrations, faint stars, models, files, telemetry and data that are wrong.
//! Of each draw: is the answer right, and where it is not, does the status say so?

mod cases;
mod file;
mod report;
mod spoil;
mod telemetry;
mod verdict;

pub(super) use cases::BASE;
pub use cases::{Draws, HARD_CASES, HardCase};
pub use spoil::{Mismatch, Spoil};
pub(super) use spoil::{flipped, made};
pub use verdict::Verdict;

use super::Progress;
use cophase::scene::Scene;
use cophase::{Estimate, Estimator, Images, Result};
use rayon::prelude::*;
use verdict::apart_nm;

/// The verdicts on all cases.
#[derive(Debug, Clone)]
pub struct HardCases {
    /// By case, the verdicts on its draws.
    pub cases: Vec<(HardCase, Vec<Verdict>)>,
}

/// Tries `cases`, each on as many draws from 1 on as its [`Draws`] make of `seeds`, by the pipeline
/// of `cophase estimate`.
///
/// Every draw is read in double precision on the CPU; of a case of single images the first eight
/// also in single precision, and the first on an OpenCL device where there is one, if they are
/// right. Telemetry is read in the precision of its method.
///
/// # Errors
/// Those of making images, and [`cophase::Error::Interrupted`]. An estimator that refuses is no
/// error but a verdict.
pub fn hard_cases(cases: &[HardCase], seeds: usize, progress: &Progress) -> Result<HardCases> {
    progress.expect(cases.iter().map(|case| case.draws.number(seeds)).sum());
    let base = Scene::preset("keck-artificial")?.with(BASE)?;
    // Its Karhunen-Loève basis, which takes the most time, is that of nearly all cases.
    let like = Estimator::new(&base)?;
    let numbers = cases.iter().scan(0, |place, case| Some(std::mem::replace(place, *place + case.draws.number(seeds))));
    let places: Vec<usize> = numbers.collect();
    let tried = |(case, place): (&HardCase, &usize)| Ok((*case, tried(case, *place, seeds, &base, &like, progress)?));
    Ok(HardCases { cases: cases.par_iter().zip(&places).map(tried).collect::<Result<Vec<_>>>()? })
}

/// The verdicts on the draws of `case`, the first of which is in place `place` of all.
fn tried(
    case: &HardCase,
    place: usize,
    seeds: usize,
    base: &Scene,
    like: &Estimator,
    progress: &Progress,
) -> Result<Vec<Verdict>> {
    let made = base.with(case.made)?;
    let readers = Readers::new(&made.with(case.read)?, like)?;
    let verdict = |number: usize| -> Result<Verdict> {
        let seed = 1 + number;
        let verdict = if let Spoil::Telemetry(mismatch) = case.spoil {
            telemetry::verdict(mismatch, seed, progress)?
        } else {
            let scene = made.with_override("aberrations.seed", &seed.to_string())?;
            readers.verdict(&spoil::made(&scene, case.spoil)?, case, number)?
        };
        progress.add(1);
        Ok(verdict)
    };
    let row = format!("{}: {}", case.group, case.name);
    let draw = |number: usize| progress.draw((&row, 1 + number, place + number), 1, || verdict(number)).transpose();
    (0..case.draws.number(seeds)).into_par_iter().filter_map(draw).collect()
}

/// Draws of a case that are read in single precision too.
const IN_SINGLE: usize = 8;

/// The estimators of one case.
struct Readers {
    double: Estimator,
    /// In single precision, and on a device in double precision; `None` for sequences and where
    /// optical parameters are fitted, which take too long to be repeated.
    others: Option<[Estimator; 2]>,
}

impl Readers {
    fn new(scene: &Scene, like: &Estimator) -> Result<Self> {
        let reader = |device: &str, precision: &str| {
            like.variant(&scene.with(&[("estimate.device", device), ("estimate.precision", precision)])?)
        };
        let double = reader("cpu", "f64")?;
        let repeats = scene.estimate.fit_optics.is_empty() && scene.image.count == 1;
        let others = repeats.then(|| Ok([reader("cpu", "f32")?, reader("opencl", "f64")?])).transpose()?;
        Ok(Self { double, others })
    }

    fn verdict(&self, made: &spoil::Made, case: &HardCase, number: usize) -> Result<Verdict> {
        let images = match case.cards {
            [] => Images::new(made.images_e.clone()),
            cards => file::read_back(&made.images_e, cards)?,
        };
        Verdict::of(self.double.estimate(&images), |found| {
            let mut verdict = Verdict::new(found, made)?;
            let Some([single, device]) = &self.others else { return Ok(verdict) };
            let off_nm = |reader: &Estimator| reader.estimate(&images).ok().and_then(|other| off_nm(&other, found));
            // The table has these differences of draws that are right.
            if number < IN_SINGLE && verdict.is_right() {
                verdict.f32_nm = off_nm(single).unwrap_or(f64::NAN);
            }
            if number == 0 && verdict.is_right() {
                verdict.opencl_nm = off_nm(device).unwrap_or(f64::NAN);
            }
            Ok(verdict)
        })
    }
}

/// Largest difference of a coefficient of two estimates of an image; `None` where the status
/// differs.
fn off_nm(other: &Estimate, found: &Estimate) -> Option<f64> {
    (other.status == found.status).then(|| apart_nm(other, found))
}
