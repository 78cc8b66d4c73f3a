//! Section 3 of the paper: residuals of one image of an artificial source, by the paper's method
//! and by ours.

use super::statistics::{mean, median, rms, standard_deviation};
use super::{Bound, Case, Cell, Draw, Progress, Pulls, Report, Table, Trial, Way, draws};
use cophase::Result;
use cophase::scene::Scene;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// Table 2, first row: residuals of the paper's one draw, phasing and NCPA, nm.
const PUBLISHED_NM: [f64; 2] = [4.4, 7.2];

/// Both ways on the same draws.
#[derive(Debug, Clone)]
pub struct ArtificialSource {
    /// In the order of [`Way::BOTH`].
    pub ways: Vec<WayResult>,
}

/// One way.
#[derive(Debug, Clone)]
pub struct WayResult {
    /// Which.
    pub way: Way,
    /// One for each draw.
    pub trials: Vec<Trial>,
    /// The Cramér-Rao bound of each draw, for this way's modes.
    pub bounds: Vec<Bound>,
    /// (estimate − truth)/σ of each draw; none for the paper's way, whose modes do not span the
    /// truth.
    pub pulls: Vec<Pulls>,
}

impl WayResult {
    /// Fits `draws` of `scene` this way.
    ///
    /// # Errors
    /// Those of the estimator.
    pub fn of(way: Way, scene: &Scene, draws: &[Draw], progress: &Progress) -> Result<Self> {
        let case = Case::new(&way.of(scene)?)?;
        let trials = case.fit(draws, progress)?;
        let bounds = case.bounds(&trials, draws, progress)?;
        let fitted =
            || trials.iter().zip(draws).zip(&bounds).filter(|((trial, _), _)| !trial.coefficients_nm.is_empty());
        let pulls = match way {
            Way::Paper => Vec::new(),
            Way::Ours => {
                fitted().map(|((trial, draw), bound)| case.pulls(trial, draw, bound)).collect::<Result<_>>()?
            }
        };
        Ok(Self { way, trials, bounds, pulls })
    }

    /// Phasing residuals, nm, of the draws that were fitted.
    pub fn phasing_nm(&self) -> Vec<f64> {
        finite(self.trials.iter().map(|trial| trial.phasing_nm))
    }

    /// The same of the NCPA residuals.
    pub fn ncpa_nm(&self) -> Vec<f64> {
        finite(self.trials.iter().map(|trial| trial.ncpa_nm))
    }

    /// Root of the mean square of the bounds of all draws, phasing and NCPA, nm.
    pub fn bound_nm(&self) -> [f64; 2] {
        let bounds = |of: fn(&Bound) -> f64| rms(&finite(self.bounds.iter().map(of)));
        [bounds(|bound| bound.phasing_nm), bounds(|bound| bound.ncpa_nm)]
    }

    /// Root of the mean square residual over that of the bound, phasing and NCPA: 1 where nothing
    /// but noise is left.
    pub fn over_bound(&self) -> [f64; 2] {
        let [phasing, ncpa] = self.bound_nm();
        [rms(&self.phasing_nm()) / phasing, rms(&self.ncpa_nm()) / ncpa]
    }

    /// RMS of the pulls of all modes and draws: segment modes, NCPA modes, principal directions.
    pub fn pull_scatter(&self) -> [f64; 3] {
        let all = |of: fn(&Pulls) -> &Vec<f64>| rms(&self.pulls.iter().flat_map(of).copied().collect::<Vec<f64>>());
        [all(|pulls| &pulls.phasing), all(|pulls| &pulls.ncpa), all(|pulls| &pulls.white)]
    }
}

fn finite(values: impl Iterator<Item = f64>) -> Vec<f64> {
    values.filter(|value| value.is_finite()).collect()
}

/// The scene of section 3 with draws 1 to `seeds`, both ways.
///
/// # Errors
/// Those of the estimator, and [`cophase::Error::Interrupted`].
pub fn artificial_source(seeds: usize, progress: &Progress) -> Result<ArtificialSource> {
    progress.expect(2 * seeds);
    let scene = Scene::preset("keck-artificial")?;
    let draws = draws(&scene, seeds, progress)?;
    let ways = Way::BOTH.map(|way| WayResult::of(way, &scene, &draws, progress));
    Ok(ArtificialSource { ways: ways.into_iter().collect::<Result<_>>()? })
}

impl ArtificialSource {
    /// One line a way.
    pub fn summary(&self) -> Table {
        let mut table = Table::new(&[
            "way",
            "seeds",
            "phasing_nm",
            "phasing_sd_nm",
            "ncpa_nm",
            "ncpa_sd_nm",
            "phasing_bound_nm",
            "ncpa_bound_nm",
            "phasing_over_bound",
            "ncpa_over_bound",
            "chi2",
            "evaluations",
            "seconds",
        ]);
        for result in &self.ways {
            let (phasing, ncpa) = (result.phasing_nm(), result.ncpa_nm());
            let of = |f: fn(&Trial) -> f64| median(&finite(result.trials.iter().map(f)));
            let decimals = if result.way == Way::Paper { 1 } else { 4 };
            table.push(vec![
                result.way.name().into(),
                phasing.len().into(),
                Cell::Number(mean(&phasing), decimals),
                Cell::Number(standard_deviation(&phasing), decimals),
                Cell::Number(mean(&ncpa), decimals),
                Cell::Number(standard_deviation(&ncpa), decimals),
                Cell::Number(result.bound_nm()[0], 4),
                Cell::Number(result.bound_nm()[1], 4),
                Cell::Number(result.over_bound()[0], 2),
                Cell::Number(result.over_bound()[1], 2),
                Cell::Number(of(|trial| trial.reduced_chi2), 2),
                Cell::Number(of(|trial| trial.evaluations as f64), 0),
                Cell::Number(of(|trial| trial.seconds), 2),
            ]);
        }
        table
    }

    /// One line for each way and draw.
    pub fn trials(&self) -> Table {
        let mut table = Table::new(&[
            "way",
            "seed",
            "phasing_nm",
            "ncpa_nm",
            "phasing_bound_nm",
            "ncpa_bound_nm",
            "chi2",
            "evaluations",
            "seconds",
            "status",
        ]);
        for result in &self.ways {
            for (trial, bound) in result.trials.iter().zip(&result.bounds) {
                table.push(vec![
                    result.way.name().into(),
                    trial.seed.into(),
                    Cell::Number(trial.phasing_nm, 4),
                    Cell::Number(trial.ncpa_nm, 4),
                    Cell::Number(bound.phasing_nm, 4),
                    Cell::Number(bound.ncpa_nm, 4),
                    Cell::Number(trial.reduced_chi2, 3),
                    trial.evaluations.into(),
                    Cell::Number(trial.seconds, 3),
                    Cell::Text(trial.status.to_string()),
                ]);
            }
        }
        table
    }

    /// Residuals draw by draw, with the bound and the published figures.
    pub fn picture(&self) -> CurvePicture {
        let mut series = Vec::new();
        for (colour, result) in self.ways.iter().enumerate() {
            let x: Vec<f64> = result.trials.iter().map(|trial| trial.seed as f64).collect();
            let one = |what: &str, of: fn(&Trial) -> f64, marker, colour| Series {
                label: format!("{what}, {}", if result.way == Way::Paper { "the paper's way" } else { "ours" }),
                x: x.clone(),
                y: result.trials.iter().map(of).collect(),
                y_err: None,
                style: SeriesStyle { stroke: Stroke::None, marker, colour: Some(colour) },
            };
            series.push(one("phasing", |trial| trial.phasing_nm, Marker::Disc, 2 * colour));
            series.push(one("NCPA", |trial| trial.ncpa_nm, Marker::Diamond, 2 * colour + 1));
        }
        // Unseen: room for the legend above the points.
        let highest = self.ways.iter().flat_map(|result| result.phasing_nm().into_iter().chain(result.ncpa_nm()));
        let highest = highest.fold(f64::MIN_POSITIVE, f64::max);
        let unseen = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
        series.push(Series { x: vec![1.0], y: vec![10.0 * highest], style: unseen, ..Default::default() });
        let [phasing, ncpa] = self.ways.last().map_or([f64::NAN; 2], WayResult::bound_nm);
        CurvePicture {
            title: "One image of an artificial source: residual of each draw".into(),
            x_label: "draw".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            horizontal_lines: vec![
                (PUBLISHED_NM[0], "published: phasing".into()),
                (PUBLISHED_NM[1], "published: NCPA".into()),
                (phasing, "bound: phasing".into()),
                (ncpa, "bound: NCPA".into()),
            ],
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["artificial-source.csv", "artificial-source-draws.csv", "artificial-source.png"];
        let files = files.map(|name| directory.join(name));
        self.summary().write_csv(&files[0])?;
        self.trials().write_csv(&files[1])?;
        self.picture().draw(&files[2])?;
        let mut text = format!(
            "Artificial source: residual of one image, nm RMS (mean and scatter over draws; the paper has {} and {})\n",
            PUBLISHED_NM[0], PUBLISHED_NM[1]
        );
        text += &self.summary().text();
        if let Some(ours) = self.ways.iter().find(|result| !result.pulls.is_empty()) {
            let [phasing, ncpa, white] = ours.pull_scatter();
            text += &format!(
                "(estimate - truth)/sigma of ours, RMS over modes and draws: {phasing:.3} pistons, {ncpa:.3} NCPA modes, \
                 {white:.3} along the principal directions; 1 where the error bars are right\n\n"
            );
        }
        Ok(Report { text, files: files.to_vec() })
    }
}
