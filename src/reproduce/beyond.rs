//! Beyond the paper: the full-phase estimate of the images behind each kind of loop, beside the paper's way.
//!
//! Every draw is kept in `beyond-draws.csv` as soon as it is done, and none that is there is made again: a long table can
//! be made in parts.

use super::on_sky::{Reader, Sequence};
use super::statistics::{mean, rms};
use super::table_rows::{Conditions, Row};
use super::{Cell, Progress, Report, Table, Way};
use crate::ao::{self, Simulator};
use crate::metrics::residual_nm;
use crate::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use crate::sky::{SkyImages, TruePhases, read};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3};
use std::io::Write;
use std::path::Path;

/// A row of the table.
#[derive(Debug, Clone, Copy)]
pub struct BeyondRow {
    /// Its name.
    pub name: &'static str,
    /// The row of the paper's table whose loop it has.
    pub row: &'static str,
    /// What is different in what makes the images, and in what reads them.
    pub made: &'static [(&'static str, &'static str)],
    /// Beside `made`, what is different in what reads them.
    pub read: &'static [(&'static str, &'static str)],
}

const fn same(name: &'static str, row: &'static str, made: &'static [(&'static str, &'static str)]) -> BeyondRow {
    BeyondRow { name, row, made, read: &[] }
}

/// All rows: sequences, what is known of the loop, and what may be wrong.
pub static BEYOND_ROWS: [BeyondRow; 26] = [
    same("75 images", "zonal", &[]),
    same("25 images", "zonal", &[("image.count", "25")]),
    same("10 images", "zonal", &[("image.count", "10")]),
    same("pol + mask", "pol-mask-inpaint", &[]),
    same("kl, 30 dropped", "kl", &[]),
    same("128 nm", "zonal", &[("aberrations.segment_piston_rms_nm", "128.3")]),
    same("star 100 times fainter", "zonal", &[("image.peak_snr", "40")]),
    BeyondRow { name: "knows loop", row: "zonal", made: &[], read: &[("estimate.knows", "loop")] },
    BeyondRow { name: "knows spectrum", row: "zonal", made: &[], read: &[("estimate.knows", "spectrum")] },
    BeyondRow { name: "knows nothing", row: "zonal", made: &[], read: &[("estimate.knows", "nothing")] },
    BeyondRow {
        name: "pol + mask, knows loop",
        row: "pol-mask-inpaint",
        made: &[],
        read: &[("estimate.knows", "loop")],
    },
    BeyondRow {
        name: "10 images, knows loop",
        row: "zonal",
        made: &[("image.count", "10")],
        read: &[("estimate.knows", "loop")],
    },
    BeyondRow { name: "r0 30 % too large", row: "zonal", made: &[], read: &[("turbulence.r0_m", "0.208")] },
    BeyondRow {
        name: "wind 50 % too fast",
        row: "zonal",
        made: &[],
        read: &[("turbulence.wind_m_s", "[10.2, 10.35, 10.65, 11.25, 15.0, 40.35, 27.75]")],
    },
    BeyondRow { name: "sensor shifted", row: "zonal", made: &[], read: &[("mirror.pitch_m", "0.568")] },
    same("10 ms exposures", "zonal", &[("image.exposure_s", "0.010")]),
    BeyondRow {
        name: "1.5 % bandwidth",
        row: "zonal",
        made: &[("image.bandwidth_fraction", "0.015")],
        read: &[("image.bandwidth_fraction", "0")],
    },
    BeyondRow {
        name: "2 % defocus error",
        row: "zonal",
        made: &[],
        read: &[("image.diversity_focus_waves_rms", "1.53")],
    },
    same("segment tilts of 20 nm", "zonal", &[("aberrations.segment_tip_tilt_rms_nm", "20")]),
    BeyondRow {
        name: "plate scale off 0.5 %",
        row: "zonal",
        made: &[],
        read: &[("image.samples_per_lambda_over_d", "2.01")],
    },
    BeyondRow {
        name: "plate scale off 1 %",
        row: "zonal",
        made: &[],
        read: &[("image.samples_per_lambda_over_d", "2.02")],
    },
    BeyondRow {
        name: "spiders not in the model",
        row: "zonal",
        made: &[("pupil.spider_width_m", "0.0254")],
        read: &[("pupil.spider_width_m", "0")],
    },
    BeyondRow {
        name: "obscuration not in the model",
        row: "zonal",
        made: &[("pupil.central_obscuration_m", "2.48")],
        read: &[("pupil.central_obscuration_m", "0")],
    },
    same("spiders in both", "zonal", &[("pupil.spider_width_m", "0.0254")]),
    same("obscuration in both", "zonal", &[("pupil.central_obscuration_m", "2.48")]),
    same("200 images", "zonal", &[("image.count", "200")]),
];

/// Images of a sequence unless the row says otherwise.
const IMAGES: &str = "75";

/// Columns of the file of draws.
const HEAD: &str = "row,seed,images,used,passes,phasing_nm,ncpa_nm,phasing_sigma_nm,ncpa_sigma_nm,chi2,first_phasing_nm,\
                    first_ncpa_nm,paper_phasing_nm,paper_ncpa_nm,seconds,retrieval_ms";

/// One draw of one row.
#[derive(Debug, Clone, PartialEq)]
pub struct BeyondDraw {
    /// Name of the row.
    pub row: String,
    /// Seed of aberrations, turbulence and noise.
    pub seed: usize,
    /// The numbers of the columns after them, in order.
    pub numbers: [f64; 14],
}

impl BeyondDraw {
    fn line(&self) -> String {
        let numbers: Vec<String> = self.numbers.iter().map(|number| format!("{number:.4}")).collect();
        // A comma in a name would be a column.
        format!("{},{},{}", self.row.replace(',', ";"), self.seed, numbers.join(","))
    }

    fn parse(line: &str) -> Option<Self> {
        let mut cells = line.split(',');
        let (row, seed) = (cells.next()?.replace(';', ","), cells.next()?.parse().ok()?);
        let numbers: Vec<f64> = cells.map(|cell| cell.parse().ok()).collect::<Option<_>>()?;
        Some(Self { row, seed, numbers: numbers.try_into().ok()? })
    }

    fn residuals_nm(&self) -> [f64; 2] {
        [self.numbers[3], self.numbers[4]]
    }

    fn sigmas_nm(&self) -> [f64; 2] {
        [self.numbers[5], self.numbers[6]]
    }

    fn paper_nm(&self) -> [f64; 2] {
        [self.numbers[10], self.numbers[11]]
    }
}

/// The whole table.
#[derive(Debug, Clone)]
pub struct Beyond {
    /// Draws, row by row.
    pub draws: Vec<BeyondDraw>,
}

/// Draws 1 to `seeds` of `rows`; those in `directory` are taken from there, and new ones added to them.
///
/// # Errors
/// Those of the simulator and of the estimator; [`Error::File`]; [`Error::Interrupted`].
pub fn beyond(
    rows: &[&BeyondRow],
    conditions: &Conditions,
    seeds: usize,
    directory: &Path,
    progress: &Progress,
) -> Result<Beyond> {
    let path = directory.join("beyond-draws.csv");
    let kept = std::fs::read_to_string(&path).unwrap_or_default();
    let mut draws: Vec<BeyondDraw> = kept.lines().skip(1).filter_map(BeyondDraw::parse).collect();
    progress.expect(rows.len() * seeds);
    for row in rows {
        for seed in 1..=seeds {
            if !draws.iter().any(|draw| draw.row == row.name && draw.seed == seed) {
                progress.check()?;
                let draw = row.draw(conditions, seed, progress)?;
                let mut file = std::fs::OpenOptions::new()
                    .create(true)
                    .append(true)
                    .open(&path)
                    .map_err(|error| Error::file(&path, error))?;
                let head = if draws.is_empty() { format!("{HEAD}\n") } else { String::new() };
                writeln!(file, "{head}{}", draw.line()).map_err(|error| Error::file(&path, error))?;
                draws.push(draw);
            }
            progress.add(1);
        }
    }
    draws.retain(|draw| draw.seed <= seeds && rows.iter().any(|row| row.name == draw.row));
    Ok(Beyond { draws })
}

impl BeyondRow {
    fn draw(&self, conditions: &Conditions, seed: usize, progress: &Progress) -> Result<BeyondDraw> {
        let row = Row::named(self.row).ok_or_else(|| Error::Internal(format!("there is no row {}", self.row)))?;
        let seed_word = seed.to_string();
        let plain = row.scene(conditions)?.with(&[
            ("image.count", IMAGES),
            ("aberrations.seed", &seed_word),
            ("turbulence.seed", &seed_word),
        ])?;
        let made = plain.with(self.made)?;
        let read_by = made.with(&[("estimate.method", "full-phase")])?.with(self.read)?;
        let mut simulator = Simulator::new(&made)?;
        let mut run = TruePhases::of(&simulator)?;
        simulator.run(&mut run, &mut ao::Progress { watch: None, cancel: progress.cancel().map(|flag| &**flag) })?;
        let (rows, columns) = made.image.frame_shape();
        let mut images_e = Array3::zeros((run.shots.len(), rows, columns));
        for (mut image, shot) in images_e.outer_iter_mut().zip(&run.shots) {
            image.zip_mut_with(&shot.image_e, |out, &electrons| *out = f64::from(electrons));
        }
        let slopes = run.shots.first().map_or(0, |shot| shot.mean_slopes_mas.len());
        let slopes_mas =
            Array2::from_shape_fn((run.shots.len(), slopes), |(i, k)| f64::from(run.shots[i].mean_slopes_mas[k]));
        let heard = read_by.estimate.knows.is_none_or(|knows| knows >= crate::scene::Knows::Telemetry);
        let bad = images_e.mapv(|_| false);
        let images = SkyImages { images_e, bad, read_noise_e: None, slopes_mas: heard.then_some(slopes_mas) };
        let found = read(&read_by, &images, progress.cancel(), &|_| {})?;
        let (pass, first) = (found.result()?, &found.passes[0]);
        let pupil = &Telescope::of(&plain)?.pupil;
        let truth = simulator.truth();
        let residuals = |phasing_nm: &Array2<f64>, ncpa_nm: &Array2<f64>| -> Result<[f64; 2]> {
            // Where one of the pupils has no glass there is nothing to compare.
            let on = |map: &Array2<f64>| map.mapv(|nm| if nm.is_finite() { nm } else { 0.0 });
            Ok([
                residual_nm(pupil, on(phasing_nm).view(), on(&truth.phasing_nm).view())?,
                residual_nm(pupil, on(ncpa_nm).view(), on(&truth.ncpa_nm).view())?,
            ])
        };
        let [phasing_nm, ncpa_nm] = residuals(&pass.phasing_nm, &pass.ncpa_nm)?;
        let [first_phasing_nm, first_ncpa_nm] = residuals(&first.phasing_nm, &first.ncpa_nm)?;
        let reader = Reader::new(Way::Paper, &read_by.with(&[("estimate.method", "modal"), ("estimate.knows", "")])?)?;
        let sequence = Sequence {
            images_e: images.images_e,
            phasing_nm: truth.phasing_nm.clone(),
            ncpa_nm: truth.ncpa_nm.clone(),
            run: None,
        };
        let paper = reader.fit(&sequence, &Progress::new(&|_, _| {}, progress.cancel()))?;
        let paper_nm =
            paper.map_or(Ok([f64::NAN; 2]), |estimate| residuals(&estimate.phasing_nm, &estimate.ncpa_nm))?;
        let count = run.shots.len() as f64;
        let numbers = [
            count,
            pass.used_images.len() as f64,
            found.passes.len() as f64,
            phasing_nm,
            ncpa_nm,
            pass.expected_nm[0],
            pass.expected_nm[1],
            pass.reduced_chi2,
            first_phasing_nm,
            first_ncpa_nm,
            paper_nm[0],
            paper_nm[1],
            found.seconds,
            1e3 * found.retrieval_seconds / (count * found.passes.len() as f64),
        ];
        Ok(BeyondDraw { row: self.name.into(), seed, numbers })
    }
}

impl Beyond {
    /// The rows that are there, in the order of [`BEYOND_ROWS`], and their draws.
    fn rows(&self) -> Vec<(&'static BeyondRow, Vec<&BeyondDraw>)> {
        let of =
            |row: &'static BeyondRow| (row, self.draws.iter().filter(|draw| draw.row == row.name).collect::<Vec<_>>());
        BEYOND_ROWS.iter().map(of).filter(|(_, draws)| !draws.is_empty()).collect()
    }

    /// One line a row: mean and worst of the residuals, the paper's way beside, the residual over its error bar.
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
            "phasing_over_sigma",
            "ncpa_over_sigma",
            "first_phasing_nm",
            "first_ncpa_nm",
            "passes",
            "chi2",
            "ms_per_image",
        ]);
        for (row, draws) in self.rows() {
            let of = |value: &dyn Fn(&BeyondDraw) -> f64| draws.iter().map(|draw| value(draw)).collect::<Vec<f64>>();
            let worst = |i: usize| of(&|draw| draw.residuals_nm()[i]).into_iter().fold(f64::NAN, f64::max);
            let pull = |i: usize| rms(&of(&|draw| draw.residuals_nm()[i] / draw.sigmas_nm()[i]));
            let average = |value: &dyn Fn(&BeyondDraw) -> f64| mean(&of(value));
            table.push(vec![
                row.name.into(),
                draws.len().into(),
                Cell::Number(average(&|draw| draw.residuals_nm()[0]), 1),
                Cell::Number(worst(0), 1),
                Cell::Number(average(&|draw| draw.residuals_nm()[1]), 1),
                Cell::Number(worst(1), 1),
                Cell::Number(average(&|draw| draw.paper_nm()[0]), 1),
                Cell::Number(average(&|draw| draw.paper_nm()[1]), 1),
                Cell::Number(pull(0), 2),
                Cell::Number(pull(1), 2),
                Cell::Number(average(&|draw| draw.numbers[8]), 1),
                Cell::Number(average(&|draw| draw.numbers[9]), 1),
                Cell::Number(average(&|draw| draw.numbers[2]), 1),
                Cell::Number(average(&|draw| draw.numbers[7]), 1),
                Cell::Number(average(&|draw| draw.numbers[13]), 1),
            ]);
        }
        table
    }

    /// Every draw of every row, ours and the paper's way.
    pub fn picture(&self) -> CurvePicture {
        let rows = self.rows();
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

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["beyond.csv", "beyond.png", "beyond-draws.csv"].map(|name| directory.join(name));
        let table = self.table();
        table.write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text = format!(
            "Full-phase estimates, nm RMS, mean and worst over seeds, the paper's way beside\n{}",
            table.text()
        );
        Ok(Report { text, files: files.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_survives_its_line() {
        let numbers = std::array::from_fn(|i| i as f64 + 0.25);
        let draw = BeyondDraw { row: "kl, 30 dropped".into(), seed: 7, numbers };
        assert_eq!(BeyondDraw::parse(&draw.line()), Some(draw));
        assert_eq!(HEAD.split(',').count(), 16);
        assert_eq!(BeyondDraw::parse("a,1,2"), None);
    }

    #[test]
    fn every_row_is_a_scene_that_can_be_read() {
        for row in &BEYOND_ROWS {
            let scene = Row::named(row.row).unwrap().scene(&Conditions::default()).unwrap();
            let made = scene.with(row.made).unwrap();
            made.with(&[("estimate.method", "full-phase")]).unwrap().with(row.read).unwrap();
            assert!(BEYOND_ROWS.iter().filter(|other| other.name == row.name).count() == 1);
        }
    }
}
