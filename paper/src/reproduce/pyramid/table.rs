//! Tables and pictures of the loops behind a pyramid.

use super::draws::FullPhaseReading;
use super::leak::PyramidLeak;
use crate::reproduce::statistics::{mean, rms, standard_deviation};
use crate::reproduce::{Cell, OnSky, Report, RowResult, Table, Way};
use cophase::Result;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// All rows of images, and the leak.
#[derive(Debug, Clone)]
pub struct PyramidTable {
    /// The loops and modal fits, row by row.
    pub modal: OnSky,
    /// The full-phase estimates, row by row, in the order of the draws of the modal fits.
    pub full_phase: Vec<Vec<FullPhaseReading>>,
    /// Leak of the segments into the mirror.
    pub leak: PyramidLeak,
}

/// Draws that could be estimated.
fn estimated(readings: &[FullPhaseReading]) -> impl Iterator<Item = &FullPhaseReading> {
    readings.iter().filter(|reading| reading.used > 0)
}

/// Residuals of one quantity (0: phasing, 1: NCPA), nm.
fn residuals_nm(readings: &[FullPhaseReading], quantity: usize) -> Vec<f64> {
    estimated(readings).map(|reading| reading.residuals_nm[quantity]).collect()
}

/// RMS over the draws of the residual over its error bar.
fn over_sigma(readings: &[FullPhaseReading], quantity: usize) -> f64 {
    let ratio = |reading: &FullPhaseReading| reading.residuals_nm[quantity] / reading.sigmas_nm[quantity];
    rms(&estimated(readings).map(ratio).collect::<Vec<_>>())
}

fn largest(values: &[f64]) -> f64 {
    values.iter().copied().fold(f64::NAN, f64::max)
}

impl PyramidTable {
    /// The rows that have draws.
    fn rows(&self) -> impl Iterator<Item = (&RowResult, &Vec<FullPhaseReading>)> {
        self.modal.rows.iter().zip(&self.full_phase).filter(|(_, readings)| !readings.is_empty())
    }

    /// One line a row: residuals of modal fits as means over the draws; of full-phase estimates
    /// mean and worst, and the RMS of residual over error bar.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "row",
            "seeds",
            "strehl_k",
            "paper_phasing_nm",
            "paper_ncpa_nm",
            "modal_phasing_nm",
            "modal_ncpa_nm",
            "phasing_nm",
            "worst",
            "phasing_over_sigma",
            "ncpa_nm",
            "worst_ncpa",
            "ncpa_over_sigma",
            "slope_gain",
            "diverged",
        ]);
        for (row, readings) in self.rows() {
            let mut cells = vec![row.row.name.into(), readings.len().into(), Cell::Number(row.strehl(), 3)];
            let modal = Way::BOTH.into_iter().flat_map(|way| row.residuals_nm(way));
            cells.extend(modal.map(|nm| Cell::Number(mean(&nm), 1)));
            for quantity in 0..2 {
                let nm = residuals_nm(readings, quantity);
                cells.extend([
                    Cell::Number(mean(&nm), 1),
                    Cell::Number(largest(&nm), 1),
                    Cell::Number(over_sigma(readings, quantity), 2),
                ]);
            }
            let gains: Vec<f64> = estimated(readings).map(|reading| reading.slope_gain).collect();
            cells.extend([Cell::Number(mean(&gains), 3), row.diverged().into()]);
            table.push(cells);
        }
        table
    }

    /// The full-phase estimates, one line a row and a seed; the modal fits are in the table of
    /// draws that the paper's table has, too.
    pub fn full_phase_draws(&self) -> Table {
        let mut table = Table::new(&[
            "row",
            "seed",
            "phasing_nm",
            "phasing_sigma_nm",
            "ncpa_nm",
            "ncpa_sigma_nm",
            "used",
            "iterations",
            "chi2",
            "slope_gain",
            "seconds",
        ]);
        for (row, readings) in self.rows() {
            for (draw, reading) in row.draws.iter().zip(readings) {
                table.push(vec![
                    row.row.name.into(),
                    draw.seed.into(),
                    Cell::Number(reading.residuals_nm[0], 2),
                    Cell::Number(reading.sigmas_nm[0], 2),
                    Cell::Number(reading.residuals_nm[1], 2),
                    Cell::Number(reading.sigmas_nm[1], 2),
                    reading.used.into(),
                    reading.iterations.into(),
                    Cell::Number(reading.reduced_chi2, 2),
                    Cell::Number(reading.slope_gain, 3),
                    Cell::Number(reading.seconds, 1),
                ]);
            }
        }
        table
    }

    /// Residuals row by row: the paper's way, modal fits with the defaults, full-phase estimates.
    pub fn picture(&self) -> CurvePicture {
        let rows: Vec<_> = self.rows().collect();
        let mut series = Vec::new();
        for (quantity, (what, marker)) in [("phasing", Marker::Disc), ("NCPA", Marker::Diamond)].into_iter().enumerate()
        {
            let nm_of_row = |estimator: usize, (row, readings): &(&RowResult, &Vec<FullPhaseReading>)| {
                let way = Way::BOTH.get(estimator);
                way.map_or_else(|| residuals_nm(readings, quantity), |&way| row.residuals_nm(way)[quantity].clone())
            };
            for (estimator, label) in ["the paper's way", "modal fits", "full-phase"].into_iter().enumerate() {
                let nm: Vec<Vec<f64>> = rows.iter().map(|row| nm_of_row(estimator, row)).collect();
                let x = |row: usize| row as f64 + 0.7 + 0.25 * estimator as f64 + 0.09 * quantity as f64;
                series.push(Series {
                    label: format!("{what}, {label}"),
                    x: (0..rows.len()).map(x).collect(),
                    y: nm.iter().map(|nm| mean(nm)).collect(),
                    y_err: Some(nm.iter().map(|nm| standard_deviation(nm)).collect()),
                    style: SeriesStyle { stroke: Stroke::None, marker, colour: Some(estimator) },
                });
            }
        }
        // Unseen: room for the names of the rows and the legend above the points.
        let highest = largest(&series.iter().flat_map(|series| series.y.clone()).collect::<Vec<_>>());
        let unseen = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
        let ends = vec![0.5, rows.len() as f64 + 0.5];
        series.push(Series { x: ends, y: vec![12.0 * highest; 2], style: unseen, ..Default::default() });
        let names = rows.iter().enumerate().map(|(place, (row, _))| (place as f64 + 0.5, row.row.name.to_string()));
        CurvePicture {
            title: "Behind a pyramid sensor (mean and scatter over seeds)".into(),
            x_label: "row".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            vertical_lines: names.collect(),
            ..Default::default()
        }
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let (mut text, mut files) = (String::new(), Vec::new());
        if self.rows().next().is_some() {
            let tables = [
                ("pyramid.csv", self.table()),
                ("pyramid-loops.csv", self.modal.loops()),
                ("pyramid-draws.csv", self.full_phase_draws()),
                ("pyramid-modal-draws.csv", self.modal.draws()),
            ];
            text += "Behind a pyramid sensor, nm RMS: modal fits (mean over seeds), full-phase estimates (mean, worst, RMS of residual over \
                     error bar)\n";
            text += &(tables[0].1.text() + "The loops\n" + &tables[1].1.text());
            for (name, table) in tables {
                files.push(directory.join(name));
                table.write_csv(&directory.join(name))?;
            }
            files.push(directory.join("pyramid.png"));
            self.picture().draw(directory.join("pyramid.png"))?;
        }
        if !self.leak.rows.is_empty() {
            text += "Segment pistons that leak into the mirror, nm RMS; change: what turbulence alters of it (RMS over seeds)\n";
            text += &self.leak.table().text();
            let names = ["pyramid-leak.csv", "pyramid-leak.png"].map(|name| directory.join(name));
            self.leak.table().write_csv(&names[0])?;
            self.leak.picture().draw(&names[1])?;
            files.extend(names);
        }
        Ok(Report { text, files })
    }
}
