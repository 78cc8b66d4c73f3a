//! What a scene leaves out of the wavefront and of the camera: residual over error bar with the
//! step that marginalises it, beside those without.

use super::pulls::pull_cells;
use super::statistics::median;
use super::{Cell, KeptDraw, Progress, Report, Table, to_cells, to_numbers};
use cophase::pipeline::Estimate;
use cophase::scene::Scene;
use cophase::source::stream;
use cophase::{Error, Estimator, Images, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::path::Path;

/// Numbers of images of each channel, with the peak S/N of each.
const CONDITIONS: [[usize; 2]; 5] = [[1, 50], [1, 150], [1, 500], [20, 30], [40, 60]];
/// Telescopes, and their presets.
const TELESCOPES: [(&str, &str); 3] = [("Keck", "keck-artificial"), ("GTC", "gtc-artificial"), ("JWST", "jwst-pair")];
/// Standard deviations of plate scale and gains, which are the defaults of `[tolerance]`, and of
/// the amplitude of the defocus.
const SCALE: f64 = 1e-3;
const GAIN: f64 = 0.01;
const DEFOCUS: f64 = 0.01;
/// Stream of random numbers of a draw, beyond those of its images.
const OWN_STREAM: u64 = 1 << 20;

/// What the images have and the scene does not.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Truth {
    /// Nothing.
    Nominal,
    /// Aberrations: what they are called, the key of the scene, and its value, nm RMS.
    Aberration { name: &'static str, key: &'static str, rms_nm: f64 },
    /// Plate scale, amplitude of the defocus and gains of halves and quadrants, each drawn from its
    /// tolerance.
    Tolerances,
}

/// Truth of images of one telescope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOutRow {
    telescope: usize,
    condition: [usize; 2],
    truth: Truth,
}

/// The truths that are tried.
fn truths() -> Vec<Truth> {
    let kinds = [
        ("segment tilts", "aberrations.segment_tip_tilt_rms_nm", &[1.0, 2.0, 4.0, 10.0][..]),
        ("common figure", "aberrations.common_figure_rms_nm", &[1.0, 5.0, 15.0][..]),
        ("segment figures", "aberrations.segment_figure_rms_nm", &[1.0, 5.0][..]),
    ];
    let of_kind = |(name, key, sizes): (&'static str, &'static str, &'static [f64])| {
        sizes.iter().map(move |&rms_nm| Truth::Aberration { name, key, rms_nm })
    };
    [Truth::Nominal, Truth::Tolerances].into_iter().chain(kinds.into_iter().flat_map(of_kind)).collect()
}

impl LeftOutRow {
    /// Its name.
    pub fn name(&self) -> String {
        let [images, snr] = self.condition;
        let truth = match self.truth {
            Truth::Nominal => "nothing".into(),
            Truth::Tolerances => "tolerances".into(),
            Truth::Aberration { name, rms_nm, .. } => format!("{name} {rms_nm} nm"),
        };
        format!("{}, {images} x S/N {snr}, {truth}", TELESCOPES[self.telescope].0)
    }

    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        let of_telescope = |telescope: usize| {
            CONDITIONS
                .into_iter()
                .flat_map(move |condition| truths().into_iter().map(move |truth| Self { telescope, condition, truth }))
        };
        // The scene of JWST fits the tilts of its segments.
        let is_fitted = |row: &Self| TELESCOPES[row.telescope].0 == "JWST" && row.name().contains("segment tilts");
        let all: Vec<Self> = (0..TELESCOPES.len()).flat_map(of_telescope).filter(|row| !is_fitted(row)).collect();
        if let Some(odd) = texts.iter().find(|text| !all.iter().any(|row| row.name().contains(*text))) {
            return Err(Error::Value(format!(
                "no row of left-out contains '{odd:.60}': parts of names like {} and {} are accepted",
                all[0].name(),
                all[all.len() - 1].name()
            )));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name().contains(text));
        Ok(all.into_iter().filter(is_wanted).collect())
    }

    /// The scenes that read the images, without the step and with it.
    fn scenes(&self) -> Result<[Scene; 2]> {
        let [images, snr] = self.condition.map(|number| number.to_string());
        let preset = Scene::preset(TELESCOPES[self.telescope].1)?;
        let preset = if self.telescope == 0 { preset.with(super::hard_cases::BASE)? } else { preset };
        let own = [("image.count", images.as_str()), ("image.peak_snr", &snr), ("estimate.model", "scene")];
        let usual = preset.with(&own)?;
        let known = match self.truth {
            Truth::Tolerances => usual.with(&[("tolerance.defocus_fraction", &DEFOCUS.to_string())])?,
            _ => usual.clone(),
        };
        Ok([usual.with(&[("estimate.posterior", "false")])?, known])
    }

    /// Images of draw `seed` that a scene like `read` reads.
    fn images(&self, read: &Scene, seed: usize) -> Result<Vec<Images>> {
        let made = read.with(&[("aberrations.seed", &seed.to_string())])?;
        let mut rng = stream(seed as u64, OWN_STREAM);
        let normal: [f64; 5] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
        let made = match self.truth {
            Truth::Nominal => made,
            Truth::Aberration { key, rms_nm, .. } => made.with(&[(key, &rms_nm.to_string())])?,
            Truth::Tolerances => {
                let image = &made.each_channel()[0].1.image;
                let sampling = image.samples_per_lambda_over_d * (1.0 + SCALE * normal[0]);
                let waves = image.diversity_focus_waves_rms * (1.0 + DEFOCUS * normal[1]);
                made.with(&[
                    ("image.samples_per_lambda_over_d", &sampling.to_string()),
                    ("image.diversity_focus_waves_rms", &waves.to_string()),
                ])?
            }
        };
        let mut all = Images::simulated(&made)?;
        for images in &mut all {
            images.scene = None;
            if self.truth != Truth::Tolerances {
                continue;
            }
            let (_, rows, columns) = images.images_e.dim();
            for ((_, y, x), value) in images.images_e.indexed_iter_mut() {
                let half = |is_first: bool| if is_first { 0.5 } else { -0.5 };
                let (right, up) = (x >= columns / 2, y >= rows / 2);
                let gains = [half(right), half(up), half(right == up)];
                *value *= 1.0 + gains.iter().zip(&normal[2..]).map(|(gain, by)| GAIN * gain * by).sum::<f64>();
            }
        }
        Ok(all)
    }
}

/// One draw, estimated without the step and with it.
#[derive(Debug, Clone, Copy)]
pub struct LeftOutDraw {
    /// Residuals of phasing and NCPA, nm.
    pub residual_nm: [[f64; 2]; 2],
    /// Their error bars, nm.
    pub sigma_nm: [[f64; 2]; 2],
    /// Time of each estimate with its model, s.
    pub seconds: [f64; 2],
    /// Whether the estimate with the step has a warning, or a status other than ok.
    pub is_flagged: bool,
}

impl KeptDraw for LeftOutDraw {
    fn cells(&self) -> Vec<String> {
        let numbers = self.residual_nm.iter().chain(&self.sigma_nm).flatten().chain(&self.seconds).copied();
        to_cells(&numbers.chain([f64::from(u8::from(self.is_flagged))]).collect::<Vec<_>>())
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let [a, b, c, d, e, f, g, h, without, with, flag] = to_numbers(cells)?[..] else { return None };
        Some(Self {
            residual_nm: [[a, b], [c, d]],
            sigma_nm: [[e, f], [g, h]],
            seconds: [without, with],
            is_flagged: flag != 0.0,
        })
    }
}

impl LeftOutDraw {
    fn new(found: &[Estimate; 2]) -> Result<Self> {
        let residual = |one: &Estimate| match &one.truth {
            Some((_, residual)) => Ok([residual.rms_nm[0], residual.rms_nm[1]]),
            None => Err(Error::Internal("a simulated image has no truth".into())),
        };
        let [without, with] = found;
        Ok(Self {
            residual_nm: [residual(without)?, residual(with)?],
            sigma_nm: found.each_ref().map(|one| [one.figures.phasing.sigma_nm, one.figures.ncpa.sigma_nm]),
            seconds: found.each_ref().map(|one| one.run.model_seconds + one.run.seconds),
            is_flagged: !with.is_sound(),
        })
    }
}

/// The draws of some rows.
#[derive(Debug, Clone)]
pub struct LeftOutTable(pub Vec<(LeftOutRow, Vec<LeftOutDraw>)>);

/// Estimates draws 1 to `seeds` of each row.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn left_out(rows: &[LeftOutRow], seeds: usize, progress: &Progress) -> Result<LeftOutTable> {
    progress.expect(rows.len() * seeds);
    let of_row = |(place, row): (usize, &LeftOutRow)| {
        let scenes = row.scenes()?;
        let [without, with] = [Estimator::new(&scenes[0])?, Estimator::new(&scenes[1])?];
        let make = |seed: usize| {
            let images = row.images(&scenes[1], seed)?;
            let draw = LeftOutDraw::new(&[without.estimate(&images)?, with.estimate(&images)?])?;
            progress.add(1);
            Ok(draw)
        };
        let number = |seed: usize| place * seeds + seed;
        let draw = |seed: usize| progress.draw((&row.name(), seed, number(seed)), 1, || make(seed)).transpose();
        Ok((*row, (1..=seeds).into_par_iter().filter_map(draw).collect::<Result<Vec<_>>>()?))
    };
    Ok(LeftOutTable(rows.iter().enumerate().map(of_row).collect::<Result<Vec<_>>>()?))
}

impl LeftOutTable {
    /// One line a row.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "case",
            "draws",
            "without_phasing_nm",
            "without_phasing_sigma_nm",
            "without_phasing_pull",
            "without_ncpa_nm",
            "without_ncpa_sigma_nm",
            "without_ncpa_pull",
            "phasing_nm",
            "phasing_sigma_nm",
            "phasing_pull",
            "ncpa_nm",
            "ncpa_sigma_nm",
            "ncpa_pull",
            "phasing_sigma_ratio",
            "ncpa_sigma_ratio",
            "seconds_ratio",
            "flagged",
        ]);
        for (row, draws) in &self.0 {
            let mut cells: Vec<Cell> = vec![row.name().as_str().into(), draws.len().into()];
            for step in 0..2 {
                cells.extend(pull_cells(draws.iter().map(|draw| (draw.residual_nm[step], draw.sigma_nm[step]))));
            }
            let ratio =
                |of: &dyn Fn(&LeftOutDraw) -> f64| Cell::Number(median(&draws.iter().map(of).collect::<Vec<_>>()), 3);
            cells.extend([0, 1].map(|part: usize| ratio(&|draw| draw.sigma_nm[1][part] / draw.sigma_nm[0][part])));
            cells.push(ratio(&|draw| draw.seconds[1] / draw.seconds[0]));
            cells.push(draws.iter().filter(|draw| draw.is_flagged).count().into());
            table.push(cells);
        }
        table
    }

    /// Residual over error bar of the phasing of each draw, row by row.
    fn picture(&self) -> CurvePicture {
        let series = [("without the step", Marker::Ring), ("with it", Marker::Disc)].into_iter().enumerate();
        let series = series.map(|(step, (label, marker))| {
            let points = self.0.iter().enumerate().flat_map(|(row, (_, draws))| {
                draws.iter().map(move |draw| (row as f64 + 1.0, draw.residual_nm[step][0] / draw.sigma_nm[step][0]))
            });
            let (x, y): (Vec<f64>, Vec<f64>) = points.unzip();
            let style = SeriesStyle { stroke: Stroke::None, marker, colour: Some(step) };
            Series { label: label.into(), x, y, y_err: None, style }
        });
        CurvePicture {
            title: "What the scene leaves out: residual over error bar of the phasing".into(),
            x_label: "row of the table".into(),
            y_label: "residual over error bar".into(),
            y_log: true,
            series: series.collect(),
            horizontal_lines: vec![(1.0, "error bar".into())],
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["left-out.csv", "left-out.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text = "What the scene leaves out: RMS over the draws of residual, error bar and their ratio; medians of what the step makes of \
                    error bars and time\n"
            .to_owned()
            + &self.table().text();
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        crate::experiment::assert_survives(&LeftOutDraw {
            residual_nm: [[1.0 / 3.0, f64::NAN], [2.0, 0.1]],
            sigma_nm: [[1e-9, f64::INFINITY], [3.0, 4.0]],
            seconds: [0.1, 0.2],
            is_flagged: true,
        });
    }
}
