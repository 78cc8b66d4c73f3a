//! What was measured at one point, and the columns in which it is written.

use super::floor::{Floor, Rates};
use crate::experiment::Table;
use crate::experiment::statistics::quantile;
use cophase::device::Precision;
use cophase::imaging::EvaluationWork;

pub use crate::experiment::Cell;

/// Times of one thing, s per image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    /// A quarter of the repetitions was faster.
    pub lower_s: f64,
    /// Half were.
    pub median_s: f64,
    /// Three quarters were.
    pub upper_s: f64,
}

impl Spread {
    /// The quartiles of `seconds`.
    pub fn of(seconds: &[f64]) -> Self {
        let [lower_s, median_s, upper_s] = [0.25, 0.5, 0.75].map(|q| quantile(seconds, q));
        Self { lower_s, median_s, upper_s }
    }
}

/// One model, somewhere, in batches of some size.
#[derive(Debug, Clone)]
pub struct Point {
    /// As `--device` names it.
    pub device: String,
    /// Of the chain that fits.
    pub precision: Precision,
    /// Along a side of the pupil grid.
    pub samples: usize,
    /// Along a side of the fitted image, at the model's sampling.
    pub pixels: usize,
    /// Whether their number was asked for, rather than found.
    pub cropped: bool,
    /// The budget for which the planner chose this model, nm.
    pub budget_nm: Option<f64>,
    /// The recipe.
    pub optimizer: &'static str,
    /// That are estimated.
    pub modes: usize,
    /// Images at a time.
    pub batch: usize,
    /// Different images.
    pub images: usize,
    /// Of one objective with its gradient.
    pub evaluation: Spread,
    /// Of a whole estimate: preparation of the frame, fit, renewal of the weights.
    pub estimate: Spread,
    /// Median number in one estimate.
    pub evaluations: f64,
    /// Root of the mean square error over the images: segments, nm.
    pub phasing_nm: f64,
    /// The same of the NCPA.
    pub ncpa_nm: f64,
    /// The Cramér-Rao bound of the first image: segments and NCPA, nm.
    pub bound_nm: [f64; 2],
    /// Images with an estimate.
    pub fitted: usize,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Of one evaluation.
    pub work: EvaluationWork,
    /// Of the device.
    pub peak: Rates,
    /// Of one evaluation.
    pub floor: Floor,
    /// Modes, pupil, diversity: once per model.
    pub model_set_up_s: f64,
    /// Memory, metric, compiled kernels: once per session.
    pub session_set_up_s: f64,
    /// Largest deviation of a gradient from that of the f64 CPU chain, as a fraction of its largest
    /// element.
    pub gradient_error: f64,
    /// Largest deviation of an estimate from that of the f64 CPU chain, nm RMS over the modes.
    pub estimate_error_nm: f64,
}

impl Point {
    /// Error of segments and NCPA together, nm.
    pub fn error_nm(&self) -> f64 {
        self.phasing_nm.hypot(self.ncpa_nm)
    }

    /// The part of the time of an evaluation that its floor takes.
    pub fn floor_fraction(&self) -> f64 {
        self.floor.us / (1e6 * self.evaluation.median_s)
    }
}

/// A column: its name in files, what heads it on a terminal (nothing where it is not shown), its
/// cell.
struct Column(&'static str, &'static str, fn(&Point) -> Cell);

/// Microseconds with three digits or so.
fn us(seconds: f64) -> Cell {
    let us = 1e6 * seconds;
    Cell::Number(us, if us < 100.0 { 1 } else { 0 })
}

const COLUMNS: [Column; 37] = [
    Column("device", "device", |point| point.device.as_str().into()),
    Column("precision", "type", |point| Cell::Text(point.precision.to_string())),
    Column("samples", "samples", |point| point.samples.into()),
    Column("pixels", "pixels", |point| point.pixels.into()),
    Column("crop", "", |point| (if point.cropped { "set" } else { "auto" }).into()),
    Column("budget_nm", "", |point| Cell::Number(point.budget_nm.unwrap_or(f64::NAN), 1)),
    Column("optimizer", "optimizer", |point| point.optimizer.into()),
    Column("modes", "", |point| point.modes.into()),
    Column("batch", "batch", |point| point.batch.into()),
    Column("images", "", |point| point.images.into()),
    Column("evaluation_us", "evaluation us", |point| us(point.evaluation.median_s)),
    Column("evaluation_lower_us", "", |point| us(point.evaluation.lower_s)),
    Column("evaluation_upper_us", "", |point| us(point.evaluation.upper_s)),
    Column("floor_us", "floor us", |point| us(1e-6 * point.floor.us)),
    Column("floor_fraction", "fraction", |point| Cell::Number(point.floor_fraction(), 2)),
    Column("floor_of", "", |point| (if point.floor.arithmetic { "arithmetic" } else { "memory" }).into()),
    Column("mflop", "", |point| Cell::Number(1e-6 * point.work.flops, 2)),
    Column("kilobytes", "", |point| Cell::Number(1e-3 * point.work.bytes, 1)),
    Column("peak_gflop_per_s", "", |point| Cell::Number(1e-9 * point.peak.flops_per_s, 1)),
    Column("peak_gb_per_s", "", |point| Cell::Number(1e-9 * point.peak.bytes_per_s, 1)),
    Column("estimate_us", "estimate us", |point| us(point.estimate.median_s)),
    Column("estimate_lower_us", "25 %", |point| us(point.estimate.lower_s)),
    Column("estimate_upper_us", "75 %", |point| us(point.estimate.upper_s)),
    Column("images_per_s", "", |point| Cell::Number(1.0 / point.estimate.median_s, 1)),
    Column("evaluations", "evaluations", |point| Cell::Number(point.evaluations, 0)),
    Column("phasing_nm", "phasing nm", |point| Cell::Number(point.phasing_nm, 3)),
    Column("phasing_bound_nm", "bound", |point| Cell::Number(point.bound_nm[0], 3)),
    Column("ncpa_nm", "NCPA nm", |point| Cell::Number(point.ncpa_nm, 3)),
    Column("ncpa_bound_nm", "bound", |point| Cell::Number(point.bound_nm[1], 3)),
    Column("fitted", "", |point| point.fitted.into()),
    Column("reduced_chi2", "", |point| Cell::Number(point.reduced_chi2, 2)),
    Column("model_set_up_s", "", |point| Cell::Number(point.model_set_up_s, 2)),
    Column("session_set_up_s", "", |point| Cell::Number(point.session_set_up_s, 3)),
    Column("gradient_error", "", |point| Cell::Number(point.gradient_error, 9)),
    Column("estimate_error_nm", "", |point| Cell::Number(point.estimate_error_nm, 6)),
    Column("error_nm", "", |point| Cell::Number(point.error_nm(), 3)),
    Column("error_bound_nm", "", |point| Cell::Number(point.bound_nm[0].hypot(point.bound_nm[1]), 3)),
];

/// The names of all columns: those of the CSV, and the keys of the JSON.
pub fn columns() -> impl Iterator<Item = &'static str> {
    COLUMNS.iter().map(|column| column.0)
}

/// A point's cells under their names.
pub fn record(point: &Point) -> Vec<(&'static str, Cell)> {
    COLUMNS.iter().map(|column| (column.0, (column.2)(point))).collect()
}

/// One line a point; all columns, or those that fit a terminal.
pub fn table(points: &[Point], all: bool) -> Table {
    let chosen: Vec<&Column> = COLUMNS.iter().filter(|column| all || !column.1.is_empty()).collect();
    let heads: Vec<&str> = chosen.iter().map(|column| if all { column.0 } else { column.1 }).collect();
    let mut table = Table::new(&heads);
    for point in points {
        table.push(chosen.iter().map(|column| (column.2)(point)).collect());
    }
    table
}
