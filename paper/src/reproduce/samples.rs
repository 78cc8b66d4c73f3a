//! What accuracy costs: error and time against pupil samples, and against the width of the fitted
//! image.

use super::statistics::{median, rms};
use super::{Bound, Case, Cell, Draw, Progress, Report, Table, Trial, draws};
use cophase::Result;
use cophase::scene::Scene;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// Pupil samples of the band-limited models.
const SAMPLES: [usize; 7] = [64, 72, 80, 90, 96, 108, 120];
/// Widths of the fitted image at 120 samples, native pixels (4 per λ/D; the geometric spot is 21
/// λ/D in radius).
const CROPS: [usize; 7] = [96, 128, 160, 192, 224, 288, 480];
/// The same, for a look at the shape.
const FEW_SAMPLES: [usize; 2] = [80, 120];
const FEW_CROPS: [usize; 2] = [128, 288];

/// The figures of all models on the same draws.
#[derive(Debug, Clone)]
pub struct Samples {
    /// Band-limited models with an automatic crop from few samples to 120, the usual models, then
    /// the crops.
    pub points: Vec<SamplesPoint>,
}

/// One model.
#[derive(Debug, Clone)]
pub struct SamplesPoint {
    /// `band-limited`, `area` or `hard`.
    pub model: &'static str,
    /// Samples along a side of the pupil grid.
    pub samples: usize,
    /// Pixels along a side of the fitted image, at the model's sampling.
    pub pixels: usize,
    /// Width of the fitted image, λ/grid_m.
    pub width_lambda_over_d: f64,
    /// Whether that width was set, rather than found.
    pub cropped: bool,
    /// Draws that were fitted.
    pub seeds: usize,
    /// Root of the mean square residual of the segment errors, nm.
    pub phasing_nm: f64,
    /// The same of the NCPA.
    pub ncpa_nm: f64,
    /// The Cramér-Rao bound of the first draw for this model and crop, phasing, nm.
    pub phasing_bound_nm: f64,
    /// The same of the NCPA.
    pub ncpa_bound_nm: f64,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Median evaluations.
    pub evaluations: f64,
    /// Median time of one evaluation on one core, ms.
    pub evaluation_ms: f64,
}

/// What is varied.
struct Plan {
    model: &'static str,
    samples: usize,
    crop: Option<usize>,
}

impl Plan {
    fn all(quick: bool) -> Vec<Self> {
        let (samples, crops): (&[usize], &[usize]) =
            if quick { (&FEW_SAMPLES, &FEW_CROPS) } else { (&SAMPLES, &CROPS) };
        let limited = samples.iter().map(|&samples| Plan { model: "band-limited", samples, crop: None });
        let usual = ["area", "hard"].map(|model| Plan { model, samples: 120, crop: None });
        let cropped = crops.iter().map(|&crop| Plan { model: "band-limited", samples: 120, crop: Some(crop) });
        limited.chain(usual).chain(cropped).collect()
    }

    /// `draws` are those of `scene`, which has this plan's samples.
    fn run(&self, scene: &Scene, draws: &[Draw], progress: &Progress) -> Result<SamplesPoint> {
        let mut settings = vec![("pupil.model", self.model)];
        let crop = self.crop.map(|crop| crop.to_string());
        settings.extend(crop.as_ref().map(|crop| ("image.crop_pixels", crop.as_str())));
        let case = Case::new(&scene.with(&settings)?)?;
        let trials = case.fit(draws, progress)?;
        let bounds = case.bounds(&trials[..1], draws, progress)?;
        let evaluation_ms = 1e3 * case.evaluation_s(&draws[0])?;
        let of = |f: fn(&Trial) -> f64| trials.iter().map(f).filter(|value| value.is_finite()).collect::<Vec<f64>>();
        let bound = |f: fn(&Bound) -> f64| bounds.first().map_or(f64::NAN, f);
        let preparation = case.estimator.model().preparation;
        let native = preparation.pixels as f64 * preparation.native_along(0);
        Ok(SamplesPoint {
            model: self.model,
            samples: self.samples,
            pixels: preparation.pixels,
            width_lambda_over_d: native / scene.image.samples_per_lambda_over_d,
            cropped: self.crop.is_some(),
            seeds: of(|trial| trial.phasing_nm).len(),
            phasing_nm: rms(&of(|trial| trial.phasing_nm)),
            ncpa_nm: rms(&of(|trial| trial.ncpa_nm)),
            phasing_bound_nm: bound(|bound| bound.phasing_nm),
            ncpa_bound_nm: bound(|bound| bound.ncpa_nm),
            reduced_chi2: median(&of(|trial| trial.reduced_chi2)),
            evaluations: median(&of(|trial| trial.evaluations as f64)),
            evaluation_ms,
        })
    }
}

/// The scene of section 3 with draws 1 to `seeds`, read by models of several sizes. The truth has
/// 960 samples.
///
/// # Errors
/// Those of the estimator, and [`cophase::Error::Interrupted`].
pub fn samples(seeds: usize, quick: bool, progress: &Progress) -> Result<Samples> {
    let plans = Plan::all(quick);
    progress.expect(plans.len() * seeds);
    let scene = Scene::preset("keck-artificial")?;
    // A scene measures the stated RMS of its defocus on its own samples: each size of the pupil
    // gets its own images, or a difference of 1e-4 in the defocus (0.3 nm of focus) would count as
    // an error of the model.
    let mut points = Vec::with_capacity(plans.len());
    for group in plans.chunk_by(|one, next| one.samples == next.samples) {
        let scene = scene.with_override("pupil.samples", &group[0].samples.to_string())?;
        let draws = draws(&scene, seeds, progress)?;
        for plan in group {
            points.push(plan.run(&scene, &draws, progress)?);
        }
    }
    Ok(Samples { points })
}

impl Samples {
    /// One line a model.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "model",
            "samples",
            "crop",
            "pixels",
            "width_lambda_over_d",
            "seeds",
            "phasing_nm",
            "ncpa_nm",
            "phasing_bound_nm",
            "ncpa_bound_nm",
            "chi2",
            "evaluations",
            "evaluation_ms",
        ]);
        for point in &self.points {
            table.push(vec![
                point.model.into(),
                point.samples.into(),
                (if point.cropped { "set" } else { "auto" }).into(),
                point.pixels.into(),
                Cell::Number(point.width_lambda_over_d, 0),
                point.seeds.into(),
                Cell::Number(point.phasing_nm, 3),
                Cell::Number(point.ncpa_nm, 3),
                Cell::Number(point.phasing_bound_nm, 3),
                Cell::Number(point.ncpa_bound_nm, 3),
                Cell::Number(point.reduced_chi2, 2),
                Cell::Number(point.evaluations, 0),
                Cell::Number(point.evaluation_ms, 2),
            ]);
        }
        table
    }

    /// Error against samples: the band-limited models joined by lines, the usual ones as marks.
    pub fn samples_picture(&self) -> CurvePicture {
        let chosen = |model: &'static str| {
            self.points.iter().filter(move |point| !point.cropped && point.model == model).collect::<Vec<_>>()
        };
        let x = |point: &SamplesPoint| point.samples as f64;
        let mut series =
            pair(&chosen("band-limited"), "band-limited", x, Stroke::Solid, [Marker::Disc, Marker::Diamond]);
        series.extend(bounds(&chosen("band-limited"), x));
        series.extend(pair(&chosen("area"), "grey edges", x, Stroke::None, [Marker::Ring, Marker::Ring]));
        series.extend(pair(&chosen("hard"), "hard edges", x, Stroke::None, [Marker::Triangle, Marker::Triangle]));
        // Unseen: room for the legend beside the points.
        let unseen = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
        series.push(Series { x: vec![140.0], y: vec![1.0], style: unseen, ..Default::default() });
        CurvePicture {
            title: "Error against the samples across the pupil".into(),
            x_label: "samples across the pupil grid".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            ..Default::default()
        }
    }

    /// Error against the width of the fitted image at 120 samples.
    pub fn crop_picture(&self) -> CurvePicture {
        let chosen: Vec<&SamplesPoint> = self.points.iter().filter(|point| point.cropped).collect();
        let auto = self.points.iter().find(|point| !point.cropped && point.samples == 120);
        let x = |point: &SamplesPoint| point.width_lambda_over_d;
        let mut series = pair(&chosen, "120 samples", x, Stroke::Solid, [Marker::Disc, Marker::Diamond]);
        series.extend(bounds(&chosen, x));
        CurvePicture {
            title: "Error against the width of the fitted image".into(),
            x_label: "width of the fitted image (lambda/D)".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            vertical_lines: auto.map(|point| (point.width_lambda_over_d, "automatic".into())).into_iter().collect(),
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["samples.csv", "samples.png", "samples-crop.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.samples_picture().draw(&files[1])?;
        self.crop_picture().draw(&files[2])?;
        let text =
            "Error against the size of the model, nm RMS (root of the mean square over draws; truth on 960 samples)\n"
                .to_string()
                + &self.table().text();
        Ok(Report { text, files: files.to_vec() })
    }
}

/// Phasing and NCPA of some points.
fn pair(
    points: &[&SamplesPoint],
    name: &str,
    x: fn(&SamplesPoint) -> f64,
    stroke: Stroke,
    markers: [Marker; 2],
) -> Vec<Series> {
    let one = |what: &str, of: fn(&SamplesPoint) -> f64, colour: usize| Series {
        label: format!("{what}, {name}"),
        x: points.iter().map(|point| x(point)).collect(),
        y: points.iter().map(|point| of(point)).collect(),
        y_err: None,
        style: SeriesStyle { stroke, marker: markers[colour], colour: Some(colour) },
    };
    vec![one("phasing", |point| point.phasing_nm, 0), one("NCPA", |point| point.ncpa_nm, 1)]
}

fn bounds(points: &[&SamplesPoint], x: fn(&SamplesPoint) -> f64) -> Vec<Series> {
    let one = |what: &str, of: fn(&SamplesPoint) -> f64, colour: usize| Series {
        label: format!("{what}, bound"),
        x: points.iter().map(|point| x(point)).collect(),
        y: points.iter().map(|point| of(point)).collect(),
        y_err: None,
        style: SeriesStyle { stroke: Stroke::Dashed, marker: Marker::None, colour: Some(colour) },
    };
    vec![one("phasing", |point| point.phasing_bound_nm, 0), one("NCPA", |point| point.ncpa_bound_nm, 1)]
}
