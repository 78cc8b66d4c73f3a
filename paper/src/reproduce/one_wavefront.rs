//! Images that are taken to be of one wavefront: how often clean ones are flagged, and whether
//! those of another wavefront are said.

use super::groups::shapes_in;
use super::{Cell, Progress, Report, Table};
use cophase::pipeline::Estimate;
use cophase::scene::Scene;
use cophase::{Error, Estimator, Images, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use ndarray::Axis;
use std::path::Path;

/// RMS of the pistons of the scene, nm.
const PISTONS_NM: f64 = 64.15;
/// RMS of the shapes of the mirror between images in focus, nm.
const SHAPES_NM: f64 = 100.0;
/// Residual over error bar beyond which a draw is wrong, where it is beyond a nanometre, too.
const WRONG: f64 = 3.0;
/// See [`WRONG`].
const WRONG_NM: f64 = 1.0;

/// One case.
#[derive(Debug, Clone, PartialEq)]
pub struct WavefrontRow {
    /// Its name.
    pub name: String,
    images: usize,
    /// Whether the images are in focus, with shapes of a mirror, and fitted together.
    is_group: bool,
    peak_snr: f64,
    /// How many images are of another wavefront, by how many nm RMS of pistons.
    foreign: usize,
    by_nm: f64,
}

impl WavefrontRow {
    fn clean(images: usize, is_group: bool, peak_snr: f64) -> Self {
        let what = if is_group { "in focus" } else { "images" };
        let name = format!("clean: {images} {what}, S/N {peak_snr}");
        Self { name, images, is_group, peak_snr, foreign: 0, by_nm: 0.0 }
    }

    fn foreign(foreign: usize, images: usize, is_group: bool, by_nm: f64) -> Self {
        let what = if is_group { " in focus" } else { "" };
        let name = format!("foreign: {foreign} of {images}{what}, {by_nm} nm");
        Self { name, images, is_group, peak_snr: 200.0, foreign, by_nm }
    }

    /// All cases.
    pub fn all() -> Vec<Self> {
        let mut rows = Vec::new();
        for (images, is_group) in [(2, false), (3, false), (7, false), (20, false), (4, true), (7, true)] {
            rows.extend([20.0, 100.0, 500.0].map(|peak_snr| Self::clean(images, is_group, peak_snr)));
        }
        for (foreign, images) in [(1, 2), (1, 3), (1, 7), (3, 7), (1, 20), (3, 20), (11, 20)] {
            rows.extend([5.0, 20.0, 64.0].map(|by_nm| Self::foreign(foreign, images, false, by_nm)));
        }
        for (foreign, images) in [(1, 4), (2, 7), (3, 7)] {
            rows.extend([5.0, 20.0, 64.0].map(|by_nm| Self::foreign(foreign, images, true, by_nm)));
        }
        rows
    }

    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        let all = Self::all();
        if let Some(odd) = texts.iter().find(|text| !all.iter().any(|row| row.name.contains(*text))) {
            let names: Vec<&str> = all.iter().map(|row| row.name.as_str()).collect();
            let names = names.join("; ");
            return Err(Error::Value(format!(
                "no row of one-wavefront contains '{odd:.60}': parts of {names} are accepted"
            )));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name.contains(text));
        Ok(all.into_iter().filter(is_wanted).collect())
    }

    /// The scene of a draw: seven hexagons and twelve Zernikes, with pistons `more_nm` RMS larger.
    fn scene(&self, seed: usize, more_nm: f64, directory: &Path) -> Result<Scene> {
        let scene = Scene::preset("keck-artificial")?.with(&[
            ("pupil.aperture", "hexagonal"),
            ("pupil.rings", "1"),
            ("pupil.grid_m", "4.8"),
            ("pupil.samples", "96"),
            ("image.samples_per_lambda_over_d", "2"),
            ("image.pixels", "96"),
            ("image.peak_snr", &self.peak_snr.to_string()),
            ("image.count", &self.images.to_string()),
            ("image.diversity_focus_waves_rms", "0.8"),
            ("aberrations.truth_samples", "768"),
            ("aberrations.ncpa_zernikes", "[4, 11]"),
            ("aberrations.segment_piston_rms_nm", &(PISTONS_NM + more_nm).to_string()),
            ("aberrations.seed", &seed.to_string()),
            ("modes.ncpa", "zernike"),
            ("modes.ncpa_count", "12"),
            ("modes.exact_zernikes", "[2, 4]"),
        ])?;
        if !self.is_group {
            return Ok(scene);
        }
        let path = shapes_in(directory, SHAPES_NM)?;
        let planes: Vec<usize> = (0..self.images).collect();
        scene.with(&[
            ("image.diversity_focus_waves_rms", ""),
            ("image.diversity_file", &path.display().to_string()),
            ("image.diversity_planes", &format!("{planes:?}")),
            ("estimate.group", "all"),
        ])
    }

    /// The images of a draw, of which the last ones are of another wavefront.
    fn images(&self, scene: &Scene, seed: usize, directory: &Path) -> Result<Images> {
        let mut images = Images::only(Images::simulated(scene)?)?;
        if self.foreign > 0 {
            let other = Images::only(Images::simulated(&self.scene(seed, self.by_nm, directory)?)?)?;
            for image in self.images - self.foreign..self.images {
                images.images_e.index_axis_mut(Axis(0), image).assign(&other.images_e.index_axis(Axis(0), image));
            }
        }
        Ok(images)
    }
}

/// Draws of one case.
#[derive(Debug, Clone)]
pub struct WavefrontDraws {
    /// The case.
    pub row: WavefrontRow,
    /// Residual over error bar of phasing and NCPA of each draw, and whether it is wrong.
    pub draws: Vec<([f64; 2], bool)>,
    /// Draws in which images are said to be of another wavefront: left out, or contradictory.
    pub said: usize,
    /// Seed of each draw with a warning or a status other than ok, and its first warning.
    pub flagged: Vec<(usize, String)>,
    /// Draws that are wrong without a word.
    pub silent: usize,
}

impl WavefrontDraws {
    fn push(&mut self, seed: usize, found: &Estimate) -> Result<()> {
        let Some((_, residual)) = &found.truth else {
            return Err(Error::Internal("a simulated image has no truth".into()));
        };
        let sigma_nm = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
        let pulls = [0, 1].map(|part: usize| residual.rms_nm[part] / sigma_nm[part]);
        let is_wrong = (0..2).any(|part: usize| pulls[part] > WRONG && residual.rms_nm[part] > WRONG_NM);
        let says = |part: &str| found.warnings.iter().any(|warning| warning.contains(part));
        let is_said = found.clipped() > 0 || says("contradict each other");
        self.draws.push((pulls, is_wrong));
        self.said += usize::from(is_said);
        if !found.is_sound() {
            let status = || format!("the status is {}", found.status.word());
            self.flagged.push((seed, found.warnings.first().cloned().unwrap_or_else(status)));
        }
        self.silent += usize::from(is_wrong && found.is_sound());
        Ok(())
    }

    /// Largest residual over error bar of all draws.
    fn largest_pull(&self) -> f64 {
        self.draws.iter().flat_map(|(pulls, _)| pulls).copied().fold(0.0, f64::max)
    }
}

/// All cases.
#[derive(Debug, Clone)]
pub struct OneWavefront {
    /// One for each row.
    pub rows: Vec<WavefrontDraws>,
}

/// `seeds` draws of each row; the file of the shapes is in `directory`.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn one_wavefront(
    rows: &[WavefrontRow],
    seeds: usize,
    directory: &Path,
    progress: &Progress,
) -> Result<OneWavefront> {
    progress.expect(rows.len() * seeds);
    let draws = |row: &WavefrontRow| {
        let mut found = WavefrontDraws { row: row.clone(), draws: Vec::new(), said: 0, flagged: Vec::new(), silent: 0 };
        for seed in 1..=seeds {
            progress.check()?;
            let scene = row.scene(seed, 0.0, directory)?;
            let images = row.images(&scene, seed, directory)?;
            found.push(seed, &Estimator::new(&scene)?.estimate(&images)?)?;
            progress.add(1);
        }
        Ok(found)
    };
    Ok(OneWavefront { rows: rows.iter().map(draws).collect::<Result<_>>()? })
}

impl OneWavefront {
    fn table(&self) -> Table {
        let mut table = Table::new(&["images", "draws", "said", "flagged", "largest_pull", "wrong", "silent"]);
        for found in &self.rows {
            table.push(vec![
                found.row.name.as_str().into(),
                found.draws.len().into(),
                found.said.into(),
                found.flagged.len().into(),
                Cell::Number(found.largest_pull(), 2),
                found.draws.iter().filter(|(_, is_wrong)| *is_wrong).count().into(),
                found.silent.into(),
            ]);
        }
        table
    }

    /// Residual over error bar of the phasing, draw by draw.
    fn picture(&self) -> CurvePicture {
        let series = self.rows.iter().enumerate().map(|(number, found)| Series {
            label: found.row.name.clone(),
            x: (1..=found.draws.len()).map(|draw| draw as f64).collect(),
            y: found.draws.iter().map(|(pulls, _)| pulls[0]).collect(),
            y_err: None,
            style: SeriesStyle { stroke: Stroke::None, marker: Marker::Disc, colour: Some(number) },
        });
        CurvePicture {
            title: "Images of one wavefront, and of others: phasing".into(),
            x_label: "draw".into(),
            y_label: "residual over error bar".into(),
            series: series.collect(),
            horizontal_lines: vec![(1.0, "error bar".into())],
            ..CurvePicture::default()
        }
    }

    /// Writes table and picture.
    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["one-wavefront.csv", "one-wavefront.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let sum = |is_clean: bool, of: fn(&WavefrontDraws) -> usize| -> usize {
            self.rows.iter().filter(|found| (found.row.foreign == 0) == is_clean).map(of).sum()
        };
        let why = self.rows.iter().filter(|found| found.row.foreign == 0).flat_map(|found| {
            let line = |(seed, warning): &(usize, String)| format!("{}, seed {seed}: {warning}\n", found.row.name);
            found.flagged.iter().map(line).collect::<Vec<_>>()
        });
        let text = format!(
            "Images of one wavefront, and of others\n{}\nclean: {} of {} flagged\nforeign: {} of {} said, {} wrong without a word\n{}",
            self.table().text(),
            sum(true, |found| found.flagged.len()),
            sum(true, |found| found.draws.len()),
            sum(false, |found| found.said),
            sum(false, |found| found.draws.len()),
            sum(false, |found| found.silent),
            why.collect::<String>(),
        );
        Ok(Report { text, files: files.to_vec() })
    }
}
