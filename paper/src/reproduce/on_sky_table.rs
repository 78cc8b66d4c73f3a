//! The paper's Table 2: residual phasing errors and NCPA behind each kind of loop, in the paper's
//! words, in its way here, and in ours.

use super::on_sky::{LoopRun, Reader, sequence_draws};
use super::row_draw::RowDraw;
use super::statistics::{mean, standard_deviation};
use super::table_rows::{Conditions, ROWS, Row, VARIANTS};
use super::{Cell, Progress, Report, Table, Way};
use cophase::Result;
use cophase::scene::Scene;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// Columns that scripts rely on.
const COLUMNS: [&str; 8] =
    ["row", "seeds", "phasing_nm", "phasing_sd_nm", "ncpa_nm", "ncpa_sd_nm", "strehl_k", "diverged"];

/// All rows, all seeds, both ways.
#[derive(Debug, Clone)]
pub struct OnSky {
    /// In the order of the rows that were asked for.
    pub rows: Vec<RowResult>,
}

/// One row.
#[derive(Debug, Clone)]
pub struct RowResult {
    /// Which.
    pub row: &'static Row,
    /// RMS that was put in, phasing and NCPA, nm.
    pub input_nm: [f64; 2],
    /// One for each seed.
    pub draws: Vec<RowDraw>,
}

/// The rows of the paper's table and of its text with draws 1 to `seeds`, both ways.
///
/// # Errors
/// Those of the simulator and of the estimator; [`cophase::Error::Interrupted`].
pub fn on_sky(rows: &[&'static Row], conditions: &Conditions, seeds: usize, progress: &Progress) -> Result<OnSky> {
    progress.check()?;
    let scenes = rows.iter().map(|row| row.reading_scene(conditions)).collect::<Result<Vec<_>>>()?;
    progress.expect(Way::BOTH.len() * seeds * scenes.iter().map(|scene| scene.image.count).sum::<usize>());
    // One pair of readers behind every loop; one for the source inside.
    let pair = |behind_a_loop: bool| -> Result<Vec<Reader>> {
        let first = rows.iter().zip(&scenes).find(|(row, _)| row.has_loop() == behind_a_loop);
        first.map_or(Ok(Vec::new()), |(_, scene)| Reader::both(scene))
    };
    let (inside, behind) = (pair(false)?, pair(true)?);
    let steps = scenes.iter().map(|scene| Way::BOTH.len() * scene.image.count).max().unwrap_or(0);
    let mut draws = sequence_draws((rows, seeds), conditions, (progress, steps), |row, seed, sequence| {
        let readers = if row.has_loop() { &behind } else { &inside };
        RowDraw::read(seed, &sequence, readers, progress)
    })?
    .into_iter()
    .peekable();
    let result = |(&row, scene): (&&'static Row, &Scene)| {
        let of_row = std::iter::from_fn(|| draws.next_if(|(of, _)| *of == row).map(|(_, draw)| draw));
        RowResult::new(row, scene, of_row.collect())
    };
    Ok(OnSky { rows: rows.iter().zip(&scenes).map(result).collect() })
}

/// By how much `residual` is less than `input`, %.
pub fn reduction_percent(residual: f64, input: f64) -> f64 {
    100.0 * (1.0 - residual / input)
}

fn finite(values: impl Iterator<Item = f64>) -> Vec<f64> {
    values.filter(|value| value.is_finite()).collect()
}

impl RowResult {
    /// Draws of `row`, whose aberrations are those of `scene`.
    pub(super) fn new(row: &'static Row, scene: &Scene, draws: Vec<RowDraw>) -> Self {
        let put_in = scene.aberrations.as_ref();
        let input_nm = put_in.map_or([f64::NAN; 2], |truth| [truth.segment_piston_rms_nm, truth.ncpa_rms_nm]);
        Self { row, input_nm, draws }
    }

    /// Residuals of the seeds that could be fitted, phasing and NCPA, nm.
    pub fn residuals_nm(&self, way: Way) -> [Vec<f64>; 2] {
        let readings = || self.draws.iter().flat_map(|draw| &draw.readings).filter(|reading| reading.way == way);
        [finite(readings().map(|reading| reading.phasing_nm)), finite(readings().map(|reading| reading.ncpa_nm))]
    }

    /// K Strehl ratio, mean over the seeds; NaN without a loop.
    pub fn strehl(&self) -> f64 {
        mean(&finite(self.runs().map(|run| run.strehl)))
    }

    /// Seeds whose loop diverged.
    pub fn diverged(&self) -> usize {
        self.runs().filter(|run| run.diverged_at_s.is_some()).count()
    }

    /// How many of the loops diverged, in words; "-" without a loop.
    fn fate(&self) -> String {
        let loops = self.runs().count();
        if loops == 0 { "-".into() } else { format!("{} of {loops}", self.diverged()) }
    }

    fn runs(&self) -> impl Iterator<Item = &LoopRun> {
        self.draws.iter().filter_map(|draw| draw.run.as_ref())
    }

    fn line(&self, way: Way) -> Vec<Cell> {
        let [phasing, ncpa] = self.residuals_nm(way);
        vec![
            self.row.name.into(),
            self.draws.len().into(),
            Cell::Number(mean(&phasing), 2),
            Cell::Number(standard_deviation(&phasing), 2),
            Cell::Number(mean(&ncpa), 2),
            Cell::Number(standard_deviation(&ncpa), 2),
            Cell::Number(self.strehl(), 3),
            self.diverged().into(),
        ]
    }

    /// Mean and scatter of one quantity (0: phasing, 1: NCPA) with its reduction, as a reader wants
    /// it.
    fn shown(&self, way: Way, quantity: usize) -> String {
        let values = &self.residuals_nm(way)[quantity];
        let digits = if mean(values) < 1.0 { 2 } else { 1 };
        let scatter = standard_deviation(values);
        let scatter = if scatter.is_nan() { String::new() } else { format!(" ± {scatter:.digits$}") };
        with_percent(mean(values), format!("{:.digits$}{scatter}", mean(values)), self.input_nm[quantity])
    }

    fn published(&self, quantity: usize) -> String {
        let nm = self.row.published.residuals_nm()[quantity];
        match self.row.published {
            super::Published::Divergence => "diverges".into(),
            _ => with_percent(nm, format!("{nm:.1}"), self.input_nm[quantity]),
        }
    }
}

fn with_percent(nm: f64, text: String, input_nm: f64) -> String {
    if nm.is_nan() { "-".into() } else { format!("{text} ({:.0} %)", reduction_percent(nm, input_nm)) }
}

impl OnSky {
    /// One line a row, one way.
    pub fn table(&self, way: Way) -> Table {
        let mut table = Table::new(&COLUMNS);
        self.rows.iter().for_each(|row| table.push(row.line(way)));
        table
    }

    /// One line a row and a seed.
    pub fn draws(&self) -> Table {
        let mut table = Table::new(&[
            "row",
            "seed",
            "way",
            "phasing_nm",
            "ncpa_nm",
            "images",
            "used",
            "chi2",
            "evaluations",
            "seconds",
            "strehl_k",
            "residual_rms_nm",
            "diverged_at_s",
        ]);
        for (row, draw) in self.rows.iter().flat_map(|row| row.draws.iter().map(move |draw| (row.row, draw))) {
            let of_run = |of: fn(&LoopRun) -> f64| draw.run.as_ref().map_or(f64::NAN, of);
            for reading in &draw.readings {
                table.push(vec![
                    row.name.into(),
                    draw.seed.into(),
                    reading.way.name().into(),
                    Cell::Number(reading.phasing_nm, 2),
                    Cell::Number(reading.ncpa_nm, 2),
                    draw.images.into(),
                    reading.used.into(),
                    Cell::Number(reading.reduced_chi2, 0),
                    Cell::Number(reading.evaluations, 0),
                    Cell::Number(reading.seconds, 1),
                    Cell::Number(of_run(|run| run.strehl), 3),
                    Cell::Number(of_run(|run| run.residual_rms_nm), 1),
                    Cell::Number(of_run(|run| run.diverged_at_s.unwrap_or(f64::NAN)), 1),
                ]);
            }
        }
        table
    }

    /// The loops: one line a row that has one, means over the seeds.
    pub fn loops(&self) -> Table {
        let mut table = Table::new(&[
            "row",
            "controlled",
            "masked",
            "stable",
            "e_folding_s",
            "stable_to_gain",
            "diverged",
            "at_s",
            "images",
            "residual_rms_nm",
            "strehl_k",
            "frames_per_s",
        ]);
        for row in self.rows.iter().filter(|row| row.row.has_loop()) {
            let Some(first) = row.runs().next() else { continue };
            let of = |of: fn(&LoopRun) -> f64| mean(&finite(row.runs().map(of)));
            let images = row.draws.iter().map(|draw| draw.images as f64).collect::<Vec<_>>();
            table.push(vec![
                row.row.name.into(),
                first.controlled.into(),
                first.masked.into(),
                (if first.stable { "yes" } else { "no" }).into(),
                Cell::Number(first.e_folding_s, 2),
                Cell::Number(first.largest_stable_gain, 2),
                row.fate().as_str().into(),
                Cell::Number(of(|run| run.diverged_at_s.unwrap_or(f64::NAN)), 1),
                Cell::Number(mean(&images), 0),
                Cell::Number(of(|run| run.residual_rms_nm), 0),
                Cell::Number(row.strehl(), 3),
                Cell::Number(of(|run| run.frames_per_s), 0),
            ]);
        }
        table
    }

    /// As the paper prints it: residual in nm RMS, and reduction from what was put in.
    pub fn side_by_side(&self) -> Table {
        let mut table = Table::new(&[
            "method",
            "phasing: paper",
            "its way here",
            "ours",
            "NCPA: paper",
            "its way here",
            "ours",
            "K Strehl",
            "diverged",
        ]);
        for row in &self.rows {
            let mut cells = vec![row.row.method.into()];
            for quantity in 0..2 {
                let here = Way::BOTH.map(|way| row.shown(way, quantity));
                let texts = [row.published(quantity)].into_iter().chain(here);
                cells.extend(texts.map(Cell::Text));
            }
            cells.extend([Cell::Number(row.strehl(), 2), row.fate().as_str().into()]);
            table.push(cells);
        }
        table
    }

    /// Every row with its scatter over the seeds: the paper's figures, its way here, ours.
    pub fn picture(&self) -> CurvePicture {
        let place = |row: usize, offset: f64| row as f64 + 1.0 + offset;
        let mut series = Vec::new();
        for (quantity, (what, marker)) in [("phasing", Marker::Disc), ("NCPA", Marker::Diamond)].into_iter().enumerate()
        {
            let beside = 0.09 * quantity as f64;
            let mut one = |who: &str, offset: f64, colour, y: Vec<f64>, y_err: Option<Vec<f64>>| {
                let x = (0..y.len()).map(|row| place(row, offset + beside)).collect();
                let style = SeriesStyle { stroke: Stroke::None, marker, colour: Some(colour) };
                series.push(Series { label: format!("{what}, {who}"), x, y, y_err, style });
            };
            one("the paper", -0.3, 0, self.each(|row| row.row.published.residuals_nm()[quantity]), None);
            for (i, (way, who)) in Way::BOTH.into_iter().zip(["its way here", "ours"]).enumerate() {
                let of = |f: fn(&[f64]) -> f64| self.each(|row| f(&row.residuals_nm(way)[quantity]));
                one(who, -0.045 + 0.255 * i as f64, i + 1, of(mean), Some(of(standard_deviation)));
            }
        }
        // Unseen: room for the names of the rows, and for the legend, above the points.
        let highest = series.iter().flat_map(|series| &series.y).copied().filter(|y| y.is_finite());
        let highest = highest.fold(f64::MIN_POSITIVE, f64::max);
        let unseen = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
        let ends = vec![place(0, -0.6), place(self.rows.len(), -0.4)];
        series.push(Series { x: ends, y: vec![12.0 * highest; 2], style: unseen, ..Default::default() });
        let names = self.rows.iter().enumerate().map(|(i, row)| (place(i, 0.5), row.row.name.to_string()));
        CurvePicture {
            title: "The paper's table, row by row (mean and scatter over seeds)".into(),
            x_label: "row".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            vertical_lines: names.collect(),
            ..Default::default()
        }
    }

    fn each(&self, of: impl Fn(&RowResult) -> f64) -> Vec<f64> {
        self.rows.iter().map(of).collect()
    }

    /// The rows of the table, and those that only the text has.
    fn split(self) -> [Self; 2] {
        let (rows, variants) = self.rows.into_iter().partition(|result| ROWS.contains(result.row));
        [Self { rows }, Self { rows: variants }]
    }

    pub(super) fn report(self, directory: &Path) -> Result<Report> {
        let names = [
            "table.csv",
            "table-ours.csv",
            "table-variants.csv",
            "table-variants-ours.csv",
            "table-draws.csv",
            "table-loops.csv",
            "table.png",
        ];
        let files = names.map(|name| directory.join(name));
        let seeds = self.rows.first().map_or(0, |row| row.draws.len());
        let (draws, loops, text) = (self.draws(), self.loops(), self.side_by_side().text());
        let [rows, variants] = self.split();
        rows.table(Way::Paper).write_csv(&files[0])?;
        rows.table(Way::Ours).write_csv(&files[1])?;
        variants.table(Way::Paper).write_csv(&files[2])?;
        variants.table(Way::Ours).write_csv(&files[3])?;
        draws.write_csv(&files[4])?;
        loops.write_csv(&files[5])?;
        rows.picture().draw(&files[6])?;
        let text = format!(
            "Residual from the images of a minute, nm RMS (reduction), mean and scatter over {seeds} seeds; a loop that \
             diverged is read from the images taken until then\n{text}The loops: what their poles say, and what became of \
             them\n{}",
            loops.text()
        );
        Ok(Report { text, files: files.to_vec() })
    }
}

/// All rows, those of the text after those of the table.
pub(super) fn all_rows() -> Vec<&'static Row> {
    ROWS.iter().chain(&VARIANTS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reproduce::Reading;

    fn reading(way: Way, phasing_nm: f64, ncpa_nm: f64) -> Reading {
        Reading { way, phasing_nm, ncpa_nm, used: 1, reduced_chi2: 1.0, evaluations: 1.0, seconds: 1.0 }
    }

    fn result() -> RowResult {
        let run = |strehl, diverged_at_s| LoopRun {
            controlled: 294,
            masked: 0,
            stable: true,
            e_folding_s: f64::NAN,
            largest_stable_gain: 2.0,
            diverged_at_s,
            residual_rms_nm: 160.0,
            strehl,
            frames_per_s: 1e4,
        };
        let draw = |seed, phasing_nm, ncpa_nm, strehl, diverged_at_s| RowDraw {
            seed,
            images: 200,
            run: Some(run(strehl, diverged_at_s)),
            readings: vec![reading(Way::Paper, phasing_nm, ncpa_nm), reading(Way::Ours, f64::NAN, f64::NAN)],
        };
        let draws = vec![draw(1, 30.0, 24.0, 0.7, None), draw(2, 34.0, 28.0, 0.8, Some(9.0))];
        RowResult { row: &ROWS[1], input_nm: [64.15, 72.7], draws }
    }

    #[test]
    fn percents_are_the_papers() {
        // Table 2: 32.1 nm of 64.15 is 50.0 %, 25.7 nm of 72.7 is 64.6 %, 87.0 is −19.7 %.
        for (residual, input, percent) in [(32.1, 64.15, 50.0), (25.7, 72.7, 64.6), (87.0, 72.7, -19.7)] {
            assert_eq!(format!("{:.1}", reduction_percent(residual, input)), format!("{percent:.1}"));
        }
    }

    #[test]
    fn the_table_has_the_columns_that_scripts_rely_on() {
        let on_sky = OnSky { rows: vec![result()] };
        let sd = (8f64).sqrt();
        let head = "row,seeds,phasing_nm,phasing_sd_nm,ncpa_nm,ncpa_sd_nm,strehl_k,diverged\n";
        assert_eq!(on_sky.table(Way::Paper).csv(), format!("{head}zonal,2,32,{sd:.5},26,{sd:.5},0.75,1\n"));
        // Nothing could be fitted: empty fields, not zeros.
        assert_eq!(on_sky.table(Way::Ours).csv(), format!("{head}zonal,2,,,,,0.75,1\n"));
    }

    #[test]
    fn text_stands_side_by_side() {
        let text = OnSky { rows: vec![result()] }.side_by_side().text();
        assert!(text.contains("32.1 (50 %)") && text.contains("32.0 ± 2.8 (50 %)"), "{text}");
        assert!(text.contains("26.0 ± 2.8 (64 %)") && text.contains("0.75  1 of 2"), "{text}");
    }

    #[test]
    fn rows_of_the_text_have_tables_of_their_own() {
        let [rows, variants] = OnSky { rows: vec![result(), RowResult { row: &VARIANTS[0], ..result() }] }.split();
        assert_eq!((rows.rows[0].row.name, variants.rows[0].row.name), ("zonal", "pol-mask-inpaint-kl-2"));
    }
}
