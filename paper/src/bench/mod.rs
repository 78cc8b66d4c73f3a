//! Speed against error: one scene fitted by models of several sizes, in every precision and on
//! every device, one image at a time and in batches; each point with its spread and its floor.
//!
//! ```text
//! Scene ─ draws ─┬─ Case (samples × pixels × optimizer) ─┬─ measure (device × precision × batch) ─ Point
//!                │        set-up, Cramér-Rao bound       │   Session: evaluation, fit, against the f64 CPU chain
//!                └─ images and truths, the same for all  └─ Floor: work over measured peak
//! ```
//!
//! [`run`] walks a [`Grid`]; what cannot be built or run is left out with its reason. [`table`] has
//! one column list for the terminal, CSV and JSON; [`picture`] draws error against time.

mod floor;
mod front;
mod grid;
mod measure;
mod point;
mod reference;
mod set_up;

pub use floor::{Floor, Rates};
pub use front::{pareto, picture};
pub use grid::{Crop, Grid};
pub use point::{Cell, Point, Spread, columns, record, table};

use crate::experiment::{Progress, draws_from};
use cophase::scene::Scene;
use cophase::{Error, Result};
use set_up::SetUp;

/// What came out.
#[derive(Debug, Clone)]
pub struct Bench {
    /// In the order of the grid: models, then devices, precisions and batches.
    pub points: Vec<Point>,
    /// What was asked for and could not be measured, with the reason.
    pub left_out: Vec<String>,
}

/// Measures every point of `grid` on `scene`; the draws begin with seed `first_seed`.
///
/// `progress` counts images and points.
///
/// # Errors
/// Those of making the images; that of the first point where none could be measured;
/// [`Error::Interrupted`].
pub fn run(scene: &Scene, grid: &Grid, first_seed: u64, progress: &Progress) -> Result<Bench> {
    grid.check()?;
    let (models, variants) = (grid.models(scene), grid.variants());
    progress.expect(grid.images + models.len() * variants.len());
    let draws = draws_from(scene, first_seed, grid.images, progress)?;
    progress.add(grid.images);
    let mut bench = Bench { points: Vec::new(), left_out: Vec::new() };
    let mut first_failure = None;
    for model in &models {
        let mut note = |what: String, error: Error| {
            bench.left_out.push(format!("{what}: {error}"));
            first_failure.get_or_insert(error);
        };
        let set_up = match SetUp::new(model, scene, &draws, progress) {
            Err(Error::Interrupted(state)) => return Err(Error::Interrupted(state)),
            Err(error) => {
                note(model.name(), error);
                progress.add(variants.len());
                continue;
            }
            Ok(set_up) => set_up,
        };
        for variant in &variants {
            progress.check()?;
            match measure::point(&set_up, model, variant, grid, &draws, progress) {
                Err(Error::Interrupted(state)) => return Err(Error::Interrupted(state)),
                Err(error) => note(format!("{}, {}", model.name(), variant.name()), error),
                Ok(point) => bench.points.push(point),
            }
            progress.add(1);
        }
    }
    match first_failure {
        Some(error) if bench.points.is_empty() => Err(error),
        _ => Ok(bench),
    }
}
