//! Groups: images in focus with known shapes of a mirror between them, pairs with a small defocus
//! and faint images, fitted together: residual against error bar, and wrong minima that are not
//! flagged.

use super::statistics::{median, rms};
use super::{Cell, Progress, Report, Table};
use cophase::io::{FitsWriter, Pixel};
use cophase::pipeline::Estimate;
use cophase::scene::Scene;
use cophase::source::stream;
use cophase::{Error, Estimator, Images, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use ndarray::Array3;
use rand_distr::{Distribution, StandardNormal};
use std::path::{Path, PathBuf};

/// Residual of the wavefront over its error bar from which a draw is a wrong minimum: a right one
/// of 36 directions and more is below two.
const WRONG: f64 = 4.0;
/// Shapes of the mirror that a file has.
const SHAPES: usize = 8;
/// Samples of a shape.
const SAMPLES: usize = 120;

/// How the images of a group differ.
#[derive(Debug, Clone, Copy)]
enum Differences {
    /// Shapes of a mirror, nm RMS, between images in focus.
    Shapes { images: usize, rms_nm: f64, is_scale_fitted: bool },
    /// Two defocuses of opposite signs, waves RMS, and how many images of each; a group is one of
    /// each.
    Pair { waves: f64, exposures: usize },
    /// None: images of one defocus and this peak S/N, fitted together or each alone.
    Noise { images: usize, peak_snr: f64, is_together: bool },
}

/// One case.
#[derive(Debug, Clone, Copy)]
pub struct GroupRow {
    /// Its name.
    pub name: &'static str,
    differences: Differences,
    /// Factor of the usual aberrations.
    factor: f64,
}

const fn shapes(name: &'static str, images: usize, rms_nm: f64, factor: f64) -> GroupRow {
    GroupRow { name, differences: Differences::Shapes { images, rms_nm, is_scale_fitted: false }, factor }
}

const fn pairs(name: &'static str, waves: f64, exposures: usize) -> GroupRow {
    GroupRow { name, differences: Differences::Pair { waves, exposures }, factor: 1.0 }
}

const fn faint(name: &'static str, peak_snr: f64, is_together: bool) -> GroupRow {
    GroupRow { name, differences: Differences::Noise { images: 40, peak_snr, is_together }, factor: 1.0 }
}

/// The cases, at a peak S/N of 200 but for those that name another.
pub const GROUP_ROWS: [GroupRow; 17] = [
    shapes("5 in focus, shapes 150 nm", 5, 150.0, 1.0),
    GroupRow {
        name: "5 in focus, shapes 150 nm, scale fitted",
        differences: Differences::Shapes { images: 5, rms_nm: 150.0, is_scale_fitted: true },
        factor: 1.0,
    },
    shapes("3 in focus, shapes 50 nm", 3, 50.0, 1.0),
    shapes("3 in focus, shapes 200 nm", 3, 200.0, 1.0),
    shapes("8 in focus, shapes 100 nm", 8, 100.0, 1.0),
    shapes("5 in focus, shapes 100 nm, twice the aberrations", 5, 100.0, 2.0),
    pairs("pair of 0.1 waves", 0.1, 1),
    pairs("pair of 0.2 waves", 0.2, 1),
    pairs("pair of 0.3 waves", 0.3, 1),
    pairs("4 pairs of 0.2 waves, each a group", 0.2, 4),
    pairs("10 pairs of 0.2 waves, each a group", 0.2, 10),
    faint("40 images at S/N 2, together", 2.0, true),
    faint("40 images at S/N 2, one by one", 2.0, false),
    faint("40 images at S/N 10, together", 10.0, true),
    faint("40 images at S/N 10, one by one", 10.0, false),
    faint("40 images at S/N 60, together", 60.0, true),
    faint("40 images at S/N 60, one by one", 60.0, false),
];

impl GroupRow {
    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        if let Some(odd) = texts.iter().find(|text| !GROUP_ROWS.iter().any(|row| row.name.contains(*text))) {
            let names = GROUP_ROWS.map(|row| row.name).join("; ");
            return Err(Error::Value(format!("no row of groups contains '{odd:.60}': parts of {names} are accepted")));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name.contains(text));
        Ok(GROUP_ROWS.into_iter().filter(is_wanted).collect())
    }

    /// The scene of a draw; its shapes are in a file in `directory`.
    fn scene(&self, seed: usize, directory: &Path) -> Result<Scene> {
        let usual = Scene::preset("keck-artificial")?;
        let Some(aberrations) = &usual.aberrations else {
            return Err(Error::Internal("a preset without aberrations".into()));
        };
        let scene = usual.with(&[
            ("image.samples_per_lambda_over_d", "2"),
            ("image.pixels", "128"),
            ("image.peak_snr", "200"),
            ("aberrations.seed", &seed.to_string()),
            ("aberrations.segment_piston_rms_nm", &(self.factor * aberrations.segment_piston_rms_nm).to_string()),
            ("aberrations.ncpa_rms_nm", &(self.factor * aberrations.ncpa_rms_nm).to_string()),
        ])?;
        match self.differences {
            Differences::Shapes { images, rms_nm, is_scale_fitted } => {
                let path = shapes_in(directory, rms_nm)?;
                let planes: Vec<usize> = (0..images).map(|image| (seed + image) % SHAPES).collect();
                let words = if is_scale_fitted { "[\"diversity\"]" } else { "[]" };
                scene.with(&[
                    ("image.diversity_focus_waves_rms", ""),
                    ("image.diversity_file", &path.display().to_string()),
                    ("image.diversity_planes", &format!("{planes:?}")),
                    ("image.count", &images.to_string()),
                    ("estimate.group", "all"),
                    ("estimate.fit_optics", words),
                ])
            }
            Differences::Noise { images, peak_snr, is_together } => scene.with(&[
                ("image.peak_snr", &peak_snr.to_string()),
                ("image.count", &images.to_string()),
                ("estimate.group", if is_together { "all" } else { "each" }),
            ]),
            Differences::Pair { waves, exposures } => {
                let channels = format!(
                    "[[image.channel]]\nname = \"plus\"\ndiversity_focus_waves_rms = {waves}\n\
                     [[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -{waves}\n[aberrations]"
                );
                let pair = Scene::from_text(&scene.text().replacen("[aberrations]", &channels, 1), Path::new(""))?;
                let group = if exposures > 1 { "channels" } else { "auto" };
                pair.with(&[("image.count", &exposures.to_string()), ("estimate.group", group)])
            }
        }
    }
}

/// The file of the shapes of `rms_nm` in `directory`, written where it is not there.
pub(super) fn shapes_in(directory: &Path, rms_nm: f64) -> Result<PathBuf> {
    let path = std::path::absolute(directory.join(format!("shapes-{rms_nm:.0}nm.fits")))
        .map_err(|error| Error::file(directory, error))?;
    if !path.exists() {
        write_shapes(&path, rms_nm)?;
    }
    Ok(path)
}

/// Writes shapes of `rms_nm`, random combinations of the Zernikes of Noll 4 to 11.
fn write_shapes(path: &Path, rms_nm: f64) -> Result<()> {
    let mut rng = stream(1, 0);
    let mut shapes = Array3::zeros((SHAPES, SAMPLES, SAMPLES));
    for mut shape in shapes.outer_iter_mut() {
        let weights: [f64; 8] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
        let norm = weights.iter().map(|weight| weight * weight).sum::<f64>().sqrt();
        for ((y, x), value) in shape.indexed_iter_mut() {
            let [x, y] = [x, y].map(|at| (2.0 * at as f64 + 1.0) / SAMPLES as f64 - 1.0);
            let square = x * x + y * y;
            let zernikes = [
                3f64.sqrt() * (2.0 * square - 1.0),
                6f64.sqrt() * 2.0 * x * y,
                6f64.sqrt() * (x * x - y * y),
                8f64.sqrt() * (3.0 * square - 2.0) * y,
                8f64.sqrt() * (3.0 * square - 2.0) * x,
                8f64.sqrt() * (3.0 * x * x - y * y) * y,
                8f64.sqrt() * (x * x - 3.0 * y * y) * x,
                5f64.sqrt() * (6.0 * square * square - 6.0 * square + 1.0),
            ];
            let sum: f64 = zernikes.iter().zip(weights).map(|(zernike, weight)| zernike * weight).sum();
            *value = rms_nm / norm * sum;
        }
    }
    let mut file = FitsWriter::create(path)?;
    file.image("SHAPES", &shapes, Pixel::F64, "nm")?;
    file.finish()
}

/// Draws of one case.
#[derive(Debug, Clone)]
pub struct GroupDraws {
    /// The case.
    pub name: &'static str,
    /// Residual of phasing, NCPA and wavefront of each draw, nm.
    pub residual_nm: Vec<[f64; 3]>,
    /// Their error bars, nm.
    pub sigma_nm: Vec<[f64; 3]>,
    /// Whether there is a warning, or a status other than ok.
    pub is_flagged: Vec<bool>,
    /// Time of each estimate with its models, s.
    pub seconds: Vec<f64>,
}

impl GroupDraws {
    fn push(&mut self, found: &Estimate) -> Result<()> {
        let Some((_, residual)) = &found.truth else {
            return Err(Error::Internal("a simulated image has no truth".into()));
        };
        let figures = &found.figures;
        self.residual_nm.push(residual.rms_nm);
        self.sigma_nm.push([figures.phasing.sigma_nm, figures.ncpa.sigma_nm, figures.wavefront.sigma_nm]);
        self.is_flagged.push(!found.is_sound());
        self.seconds.push(found.run.model_seconds + found.run.seconds);
        Ok(())
    }

    /// Draws in a wrong minimum, as places of them.
    fn wrong(&self) -> Vec<usize> {
        let is_wrong = |&draw: &usize| self.residual_nm[draw][2] > WRONG * self.sigma_nm[draw][2];
        (0..self.residual_nm.len()).filter(is_wrong).collect()
    }

    /// Draws in a wrong minimum without a word.
    pub fn silent(&self) -> usize {
        self.wrong().into_iter().filter(|&draw| !self.is_flagged[draw]).count()
    }

    /// Root of the mean square of residual over error bar, phasing, NCPA and wavefront, of draws in
    /// the right minimum.
    pub fn pulls(&self) -> [f64; 3] {
        let wrong = self.wrong();
        let right: Vec<usize> = (0..self.residual_nm.len()).filter(|draw| !wrong.contains(draw)).collect();
        [0, 1, 2].map(|k| {
            rms(&right.iter().map(|&draw| self.residual_nm[draw][k] / self.sigma_nm[draw][k]).collect::<Vec<_>>())
        })
    }
}

/// All cases.
#[derive(Debug, Clone)]
pub struct Groups {
    /// One for each row.
    pub rows: Vec<GroupDraws>,
}

/// `seeds` draws of each row; the files of the shapes are in `directory`.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn groups(rows: &[GroupRow], seeds: usize, directory: &Path, progress: &Progress) -> Result<Groups> {
    progress.expect(rows.len() * seeds);
    let draws = |row: &GroupRow| {
        let (name, [residual_nm, sigma_nm]) = (row.name, [Vec::new(), Vec::new()]);
        let mut found = GroupDraws { name, residual_nm, sigma_nm, is_flagged: Vec::new(), seconds: Vec::new() };
        for seed in 1..=seeds {
            progress.check()?;
            let scene = row.scene(seed, directory)?;
            let images = Images::simulated(&scene)?;
            found.push(&Estimator::new(&scene)?.estimate(&images)?)?;
            progress.add(1);
        }
        Ok(found)
    };
    Ok(Groups { rows: rows.iter().map(draws).collect::<Result<_>>()? })
}

impl Groups {
    fn table(&self) -> Table {
        let mut table = Table::new(&[
            "group",
            "draws",
            "phasing_nm",
            "ncpa_nm",
            "wavefront_nm",
            "phasing_pull",
            "ncpa_pull",
            "wavefront_pull",
            "wrong",
            "silent",
            "flagged",
            "seconds",
        ]);
        for row in &self.rows {
            let residual_nm = [0, 1, 2].map(|k| median(&row.residual_nm.iter().map(|nm| nm[k]).collect::<Vec<_>>()));
            let mut cells = vec![row.name.into(), row.residual_nm.len().into()];
            cells.extend(residual_nm.map(|nm| Cell::Number(nm, 2)));
            cells.extend(row.pulls().map(|pull| Cell::Number(pull, 2)));
            cells.push(row.wrong().len().into());
            cells.push(row.silent().into());
            cells.push(row.is_flagged.iter().filter(|flagged| **flagged).count().into());
            cells.push(Cell::Number(median(&row.seconds), 1));
            table.push(cells);
        }
        table
    }

    /// Residual over error bar of the wavefront, draw by draw.
    fn picture(&self) -> CurvePicture {
        let series = self.rows.iter().enumerate().map(|(number, row)| {
            let pulls = row.residual_nm.iter().zip(&row.sigma_nm).map(|(residual, sigma)| residual[2] / sigma[2]);
            Series {
                label: row.name.into(),
                x: (1..=row.residual_nm.len()).map(|draw| draw as f64).collect(),
                y: pulls.collect(),
                y_err: None,
                style: SeriesStyle { stroke: Stroke::None, marker: Marker::Disc, colour: Some(number) },
            }
        });
        CurvePicture {
            title: "Images fitted together: residual over error bar".into(),
            x_label: "draw".into(),
            y_label: "wavefront, residual over error bar".into(),
            series: series.collect(),
            horizontal_lines: vec![(1.0, "error bar".into())],
            ..CurvePicture::default()
        }
    }

    /// Writes table and picture.
    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["groups.csv", "groups.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text = "Images that are fitted together: median residual, nm RMS, and residual over error bar\n"
            .to_string()
            + &self.table().text();
        Ok(Report { text, files: files.to_vec() })
    }
}
