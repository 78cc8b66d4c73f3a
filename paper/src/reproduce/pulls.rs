//! Pulls: residual over error bar of `cophase estimate` against brightness and number of images, on
//! two sets of NCPA.
//!
//! A pull of 1 is an error bar that is right. The RMS over n draws of a residual of k independent
//! modes is known to 1/√(2nk): of 24 draws and 50 modes to 2 %, but systematic errors of the model
//! are common to all modes of a draw.

use super::statistics::rms;
use super::{Cell, KeptDraw, Progress, Report, Table, to_cells, to_numbers};
use cophase::scene::Scene;
use cophase::{Error, Estimator, Images, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use rayon::prelude::*;
use std::path::Path;

/// Peak signal-to-noise ratios.
const PEAK_SNR: [&str; 4] = ["20", "50", "100", "500"];
/// Numbers of images of one wavefront.
const IMAGES: [&str; 2] = ["1", "40"];
/// Last Noll index of the true NCPA: radial order 5, which most of the model's modes reach, and
/// radial order 8.
const LAST_NOLL: [&str; 2] = ["18", "45"];
/// Largest pull of an error bar that is right, with the smallest: the scatter of 24 draws, and 10
/// %.
const RIGHT: (f64, f64) = (0.9, 1.15);

/// One row: scene and images.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PullRow {
    last_noll: &'static str,
    images: &'static str,
    peak_snr: &'static str,
}

impl PullRow {
    /// Its name.
    pub fn name(&self) -> String {
        let Self { last_noll, images, peak_snr } = self;
        format!("NCPA to Noll {last_noll}, {images} images, S/N {peak_snr}")
    }

    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        let all: Vec<Self> = LAST_NOLL
            .into_iter()
            .flat_map(|last_noll| IMAGES.map(|images| (last_noll, images)))
            .flat_map(|(last_noll, images)| PEAK_SNR.map(|peak_snr| Self { last_noll, images, peak_snr }))
            .collect();
        if let Some(odd) = texts.iter().find(|text| !all.iter().any(|row| row.name().contains(*text))) {
            let names: Vec<String> = all.iter().map(Self::name).collect();
            return Err(Error::Value(format!(
                "no row of pulls contains '{odd:.60}': parts of {} are accepted",
                names.join("; ")
            )));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name().contains(text));
        Ok(all.into_iter().filter(is_wanted).collect())
    }

    fn scene(&self) -> Result<Scene> {
        let span = format!("[4, {}]", self.last_noll);
        Scene::preset("keck-artificial")?.with(super::hard_cases::BASE)?.with(&[
            ("aberrations.ncpa_zernikes", span.as_str()),
            ("image.count", self.images),
            ("image.peak_snr", self.peak_snr),
        ])
    }
}

/// Estimate of one draw.
#[derive(Debug, Clone, Copy)]
pub struct PullDraw {
    /// Residuals of phasing and NCPA, nm.
    pub residual_nm: [f64; 2],
    /// Their error bars, nm.
    pub sigma_nm: [f64; 2],
    /// Time of the estimate with its model, s.
    pub seconds: f64,
    /// Whether there is a warning, or a status other than ok.
    pub is_flagged: bool,
}

impl KeptDraw for PullDraw {
    fn cells(&self) -> Vec<String> {
        let Self { residual_nm: [p, n], sigma_nm: [sp, sn], seconds, is_flagged } = *self;
        to_cells(&[p, n, sp, sn, seconds, f64::from(u8::from(is_flagged))])
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let [p, n, sp, sn, seconds, flag] = to_numbers(cells)?[..] else { return None };
        Some(Self { residual_nm: [p, n], sigma_nm: [sp, sn], seconds, is_flagged: flag != 0.0 })
    }
}

/// The draws of some rows.
#[derive(Debug, Clone)]
pub struct PullTable(pub Vec<(PullRow, Vec<PullDraw>)>);

/// Estimates draws 1 to `seeds` of each row.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn pulls(rows: &[PullRow], seeds: usize, progress: &Progress) -> Result<PullTable> {
    progress.expect(rows.len() * seeds);
    let of_row = |(place, row): (usize, &PullRow)| Ok((row.clone(), row_draws(row, place * seeds, seeds, progress)?));
    let table = rows.iter().enumerate().map(of_row);
    Ok(PullTable(table.collect::<Result<Vec<_>>>()?))
}

/// The draws of `row`, the first of which is in place `place` of all.
fn row_draws(row: &PullRow, place: usize, seeds: usize, progress: &Progress) -> Result<Vec<PullDraw>> {
    let scene = row.scene()?;
    let estimator = Estimator::new(&scene)?;
    let make = |seed: usize| {
        let images = Images::simulated(&scene.with_override("aberrations.seed", &seed.to_string())?)?;
        let found = estimator.estimate(&images)?;
        progress.add(1);
        let Some((_, residual)) = &found.truth else {
            return Err(Error::Internal("a simulated image has no truth".into()));
        };
        Ok(PullDraw {
            residual_nm: [residual.rms_nm[0], residual.rms_nm[1]],
            sigma_nm: [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm],
            seconds: found.run.model_seconds + found.run.seconds,
            is_flagged: !found.is_sound(),
        })
    };
    let draw = |seed: usize| progress.draw((&row.name(), seed, place + seed), 1, || make(seed)).transpose();
    (1..=seeds).into_par_iter().filter_map(draw).collect()
}

/// RMS over the draws of residual over error bar, of phasing (0) or NCPA (1).
fn pull(draws: &[PullDraw], part: usize) -> f64 {
    rms(&draws.iter().map(|draw| draw.residual_nm[part] / draw.sigma_nm[part]).collect::<Vec<_>>())
}

/// RMS over the draws of residual, error bar and their ratio, of phasing and of NCPA, from the
/// residuals and error bars of each.
pub(super) fn pull_cells(draws: impl Iterator<Item = ([f64; 2], [f64; 2])>) -> Vec<Cell> {
    let (residuals_nm, sigmas_nm): (Vec<_>, Vec<_>) = draws.unzip();
    let part = |part: usize| {
        let of = |values: &[[f64; 2]]| values.iter().map(|both| both[part]).collect::<Vec<_>>();
        let (residual_nm, sigma_nm) = (of(&residuals_nm), of(&sigmas_nm));
        let ratio: Vec<f64> = residual_nm.iter().zip(&sigma_nm).map(|(residual, sigma)| residual / sigma).collect();
        [Cell::Number(rms(&residual_nm), 4), Cell::Number(rms(&sigma_nm), 4), Cell::Number(rms(&ratio), 3)]
    };
    [0, 1].into_iter().flat_map(part).collect()
}

impl PullTable {
    /// One line a row.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "ncpa_last_noll",
            "images",
            "peak_snr",
            "draws",
            "phasing_nm",
            "phasing_sigma_nm",
            "phasing_pull",
            "ncpa_nm",
            "ncpa_sigma_nm",
            "ncpa_pull",
            "flagged",
            "seconds",
        ]);
        for (row, draws) in &self.0 {
            let of = |f: &dyn Fn(&PullDraw) -> f64| rms(&draws.iter().map(f).collect::<Vec<_>>());
            let mut cells: Vec<Cell> = [row.last_noll, row.images, row.peak_snr].map(Cell::from).into();
            cells.push(draws.len().into());
            cells.extend(pull_cells(draws.iter().map(|draw| (draw.residual_nm, draw.sigma_nm))));
            cells.push(draws.iter().filter(|draw| draw.is_flagged).count().into());
            cells.push(Cell::Number(of(&|draw| draw.seconds), 2));
            table.push(cells);
        }
        table
    }

    /// Pull against brightness.
    pub fn picture(&self) -> CurvePicture {
        let mut series = Vec::new();
        for (colour, last_noll) in LAST_NOLL.into_iter().enumerate() {
            for (images, marker) in IMAGES.into_iter().zip([Marker::Ring, Marker::Disc]) {
                for (part, (name, stroke)) in
                    [("phasing", Stroke::Solid), ("NCPA", Stroke::Dashed)].into_iter().enumerate()
                {
                    let rows = self.0.iter().filter(|(row, _)| row.last_noll == last_noll && row.images == images);
                    let points = rows.map(|(row, draws)| (row.peak_snr.parse().unwrap_or(f64::NAN), pull(draws, part)));
                    let (x, y): (Vec<f64>, Vec<f64>) = points.unzip();
                    if !x.is_empty() {
                        let label = format!("{name}, NCPA to Noll {last_noll}, images: {images}");
                        let style = SeriesStyle { stroke, marker, colour: Some(colour) };
                        series.push(Series { label, x, y, y_err: None, style });
                    }
                }
            }
        }
        for level in [RIGHT.0, RIGHT.1] {
            let style = SeriesStyle { stroke: Stroke::Dotted, marker: Marker::None, colour: Some(7) };
            let (label, x, y) = (format!("{level}"), vec![20.0, 500.0], vec![level; 2]);
            series.push(Series { label, x, y, y_err: None, style });
        }
        CurvePicture {
            title: "Residual over error bar, RMS over the draws".into(),
            x_label: "peak signal-to-noise ratio".into(),
            y_label: "pull".into(),
            x_log: true,
            series,
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["pulls.csv", "pulls.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text =
            "Pulls: residual over error bar, RMS over the draws; 1 is right\n".to_string() + &self.table().text();
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        crate::experiment::assert_survives(&PullDraw {
            residual_nm: [1.0 / 3.0, f64::NAN],
            sigma_nm: [1e-9, f64::INFINITY],
            seconds: 0.1,
            is_flagged: true,
        });
    }
}
