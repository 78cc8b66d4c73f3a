//! The table of draws, and its picture.

use super::HeldMap;
use super::draws::BeyondDraw;
use super::rows::{BeyondRow, NOMINAL};
use crate::reproduce::statistics::{mean, rms};
use crate::reproduce::{Cell, Report, Table};
use cophase::Result;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// χ² over that of the nominal row beyond which a draw is flagged. Between nominal draws it
/// scatters by a few per cent.
const FLAGGED: f64 = 1.3;

/// The whole table.
#[derive(Debug, Clone)]
pub struct Beyond {
    /// Rows, in order.
    pub rows: Vec<BeyondRow>,
    /// Draws.
    pub draws: Vec<BeyondDraw>,
    /// Draws that could not be made, and why.
    pub failed: Vec<String>,
}

impl Beyond {
    /// The rows that have draws, and their draws.
    fn filled(&self) -> Vec<(&BeyondRow, Vec<&BeyondDraw>)> {
        let of = |row| (row, self.of_row(row));
        self.rows.iter().map(of).filter(|(_, draws)| !draws.is_empty()).collect()
    }

    fn of_row(&self, row: &BeyondRow) -> Vec<&BeyondDraw> {
        self.draws.iter().filter(|draw| draw.row == row.name).collect()
    }

    /// Mean χ² of the nominal row; NaN without one.
    fn nominal_chi2(&self) -> f64 {
        let nominal = self.draws.iter().filter(|draw| draw.row == NOMINAL);
        mean(&nominal.map(BeyondDraw::chi2).collect::<Vec<_>>())
    }

    /// One line a row: mean and worst of the residuals, the paper's way beside and how often it is
    /// worse in both, the residual over its error bar, and whether χ² says that something is wrong.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "row",
            "seeds",
            "phasing_nm",
            "worst",
            "ncpa_nm",
            "worst_ncpa",
            "paper_phasing_nm",
            "paper_ncpa_nm",
            "not_worse",
            "phasing_over_sigma",
            "ncpa_over_sigma",
            "first_phasing_nm",
            "first_ncpa_nm",
            "passes",
            "chi2",
            "over_nominal",
            "flagged",
            "ms_per_image",
        ]);
        let nominal = self.nominal_chi2();
        for (row, draws) in self.filled() {
            let of = |value: &dyn Fn(&BeyondDraw) -> f64| draws.iter().map(|draw| value(draw)).collect::<Vec<f64>>();
            let worst = |i: usize| of(&|draw| draw.residuals_nm()[i]).into_iter().fold(f64::NAN, f64::max);
            // Error bars are of all that is there.
            let beyond_nm = [0.0, row.map.as_ref().map_or(0.0, |map| map.left_nm)];
            let pull = |i: usize| rms(&of(&|draw| draw.residuals_nm()[i].hypot(beyond_nm[i]) / draw.sigmas_nm()[i]));
            let average = |value: &dyn Fn(&BeyondDraw) -> f64| mean(&of(value));
            let count = |test: &dyn Fn(&BeyondDraw) -> bool| {
                Cell::Text(format!("{}/{}", draws.iter().filter(|draw| test(draw)).count(), draws.len()))
            };
            // A loop that leaves the paper's way nothing to fit leaves no number that would be
            // better.
            let not_worse = |draw: &BeyondDraw| {
                let worse = |(ours, paper): (f64, f64)| ours > paper;
                !draw.residuals_nm().into_iter().zip(draw.paper_nm()).any(worse)
            };
            table.push(vec![
                (&*row.name).into(),
                draws.len().into(),
                Cell::Number(average(&|draw| draw.residuals_nm()[0]), 1),
                Cell::Number(worst(0), 1),
                Cell::Number(average(&|draw| draw.residuals_nm()[1]), 1),
                Cell::Number(worst(1), 1),
                Cell::Number(average(&|draw| draw.paper_nm()[0]), 1),
                Cell::Number(average(&|draw| draw.paper_nm()[1]), 1),
                count(&not_worse),
                Cell::Number(pull(0), 2),
                Cell::Number(pull(1), 2),
                Cell::Number(average(&|draw| draw.first_nm()[0]), 1),
                Cell::Number(average(&|draw| draw.first_nm()[1]), 1),
                Cell::Number(average(&BeyondDraw::passes), 1),
                Cell::Number(average(&BeyondDraw::chi2), 2),
                Cell::Number(average(&BeyondDraw::chi2) / nominal, 2),
                if nominal.is_nan() { "-".into() } else { count(&|draw| draw.chi2() > FLAGGED * nominal) },
                Cell::Number(average(&BeyondDraw::retrieval_ms), 1),
            ]);
        }
        table
    }

    /// Every draw of every row, ours and the paper's way.
    pub fn picture(&self) -> CurvePicture {
        let rows = self.filled();
        let mut series = Vec::new();
        let mut one = |label: &str, colour, marker, offset: f64, value: &dyn Fn(&BeyondDraw) -> f64| {
            let points = rows
                .iter()
                .enumerate()
                .flat_map(|(i, (_, draws))| draws.iter().map(move |draw| (i as f64 + 1.0 + offset, *draw)));
            let (x, y) = points.map(|(x, draw)| (x, value(draw))).unzip();
            let style = SeriesStyle { stroke: Stroke::None, marker, colour: Some(colour) };
            series.push(Series { label: label.into(), x, y, y_err: None, style });
        };
        one("phasing, its way", 1, Marker::Disc, -0.3, &|draw| draw.paper_nm()[0]);
        one("NCPA, its way", 1, Marker::Diamond, -0.15, &|draw| draw.paper_nm()[1]);
        one("phasing, full-phase", 2, Marker::Disc, 0.1, &|draw| draw.residuals_nm()[0]);
        one("NCPA, full-phase", 2, Marker::Diamond, 0.25, &|draw| draw.residuals_nm()[1]);
        let highest = series.iter().flat_map(|series| &series.y).copied().filter(|y| y.is_finite());
        let highest = highest.fold(f64::MIN_POSITIVE, f64::max);
        // Unseen: room for the names of the rows, and for the legend, above the points.
        let unseen = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
        series.push(Series {
            x: vec![0.4, rows.len() as f64 + 0.6],
            y: vec![12.0 * highest; 2],
            style: unseen,
            ..Default::default()
        });
        CurvePicture {
            title: "Beyond the paper, draw by draw".into(),
            x_label: "row".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            vertical_lines: rows
                .iter()
                .enumerate()
                .map(|(i, (row, _))| (i as f64 + 0.5, row.name.to_string()))
                .collect(),
            ..Default::default()
        }
    }

    /// Writes the table, its picture, and what the mirror held of measured `maps`.
    pub(in crate::reproduce) fn report(&self, maps: &[HeldMap], directory: &Path) -> Result<Report> {
        let mut files = ["beyond.csv", "beyond.png", "beyond-draws.csv"].map(|name| directory.join(name)).to_vec();
        let table = self.table();
        table.write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let mut text = format!(
            "Full-phase estimates, nm RMS, mean and worst over seeds, the paper's way beside\n{}",
            table.text()
        );
        if maps.is_empty() {
            text += "Rows of measured NCPA are left out: --maps names a folder of maps, NCPA*.fits\n";
        } else {
            let mut held = Table::new(&["map", "rms_nm", "not_held_nm", "turned"]);
            for map in maps {
                let turned = if map.turned { "yes" } else { "no" };
                held.push(vec![
                    (&*map.name).into(),
                    Cell::Number(map.rms_nm, 1),
                    Cell::Number(map.left_nm, 1),
                    turned.into(),
                ]);
            }
            files.push(directory.join("beyond-maps.csv"));
            held.write_csv(&directory.join("beyond-maps.csv"))?;
            text += &format!("Measured NCPA, nm RMS, and what the mirror cannot hold of them\n{}", held.text());
        }
        for failure in &self.failed {
            text += &format!("Not made: {failure}\n");
        }
        Ok(Report { text, files })
    }
}

#[cfg(test)]
mod tests {
    use super::super::BEYOND_ROWS;
    use super::*;

    fn draw(row: &str, seed: usize, residual: f64, chi2: f64) -> BeyondDraw {
        let mut numbers = [1.0; 14];
        (numbers[3], numbers[4], numbers[7], numbers[10], numbers[11]) = (residual, 2.0, chi2, 30.0, f64::NAN);
        BeyondDraw { row: row.into(), seed, numbers }
    }

    #[test]
    fn row_reports_worse_and_wrong_estimates() {
        let rows = vec![BEYOND_ROWS[0].clone(), BEYOND_ROWS[1].clone()];
        let draws = vec![draw(NOMINAL, 1, 5.0, 1.0), draw("25 images", 1, 31.0, 2.0), draw("25 images", 2, 7.0, 1.1)];
        let text = Beyond { rows, draws, failed: Vec::new() }.table().csv();
        let lines: Vec<Vec<&str>> = text.lines().map(|line| line.split(',').collect()).collect();
        let column = |name: &str| lines[0].iter().position(|head| *head == name).unwrap();
        assert_eq!((lines[1][column("not_worse")], lines[1][column("flagged")]), ("1/1", "0/1"));
        assert_eq!((lines[2][column("not_worse")], lines[2][column("flagged")]), ("1/2", "1/2"));
        assert_eq!((lines[2][column("worst")], lines[2][column("phasing_nm")]), ("31", "19"));
        assert_eq!(lines[2][column("over_nominal")], "1.55");
    }
}
