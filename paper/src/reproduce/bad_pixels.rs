//! Pixels that are bad and not marked: residual over the bound of the pixels that are good, and
//! what was rejected.

use super::statistics::{median, rms};
use super::{Case, Cell, Draw, Progress, Report, Table, draws};
use cophase::Result;
use cophase::scene::Scene;
use cophase::source::stream;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use ndarray::Array2;
use rand::RngExt;
use std::path::Path;

/// Shares of bad pixels, half of them hot and half dead. Infrared detectors have 0.2 to 2 %.
const SHARES: [f64; 5] = [0.0, 1e-3, 5e-3, 1e-2, 2e-2];
/// Share of pixels that cosmic rays hit, in tracks of three.
const COSMIC_SHARE: f64 = 1e-3;
/// Pixels of a track.
const TRACK: usize = 3;
/// Samplings, pixels per λ/D, with the pixels of an image: one that is fitted as it is, and one
/// that is reduced for the fit.
const SAMPLINGS: [[usize; 2]; 2] = [[2, 240], [4, 480]];
/// Peak signal-to-noise ratios.
const PEAK_SNRS: [usize; 2] = [50, 500];
/// Excess of a hot pixel, read noises: at least, and the mean of what is added to it.
const HOT_NOISES: [f64; 2] = [10.0, 30.0];
/// Electrons in each pixel of a track, as powers of ten.
const TRACK_DECADES: [f64; 2] = [3.0, 5.0];

/// All rows.
#[derive(Debug, Clone)]
pub struct BadPixels {
    /// By sampling, brightness, cosmic rays and share.
    pub rows: Vec<BadPixelRow>,
}

/// Draws of one kind.
#[derive(Debug, Clone)]
pub struct BadPixelRow {
    /// Pixels per λ/D.
    pub sampling: usize,
    /// Peak signal-to-noise ratio.
    pub peak_snr: usize,
    /// Share of hot and dead pixels.
    pub share: f64,
    /// Share of pixels that cosmic rays hit.
    pub cosmic_share: f64,
    /// Draws that were fitted, of as many as were made.
    pub seeds: [usize; 2],
    /// Root of the mean square residual, phasing and NCPA, nm.
    pub residual_nm: [f64; 2],
    /// The same of the bound of the good pixels, nm: that of all, over the root of their share.
    pub bound_nm: [f64; 2],
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Draws whose status is not ok.
    pub flagged: usize,
}

impl BadPixelRow {
    /// Residual over bound, phasing and NCPA.
    pub fn over_bound(&self) -> [f64; 2] {
        [0, 1].map(|i| self.residual_nm[i] / self.bound_nm[i])
    }
}

/// Makes a share of the pixels of `image_e` hot or dead, and a share of tracks.
fn spoil(image_e: &mut Array2<f64>, [share, cosmic_share]: [f64; 2], read_noise_e: f64, rng: &mut impl RngExt) {
    let (rows, columns) = image_e.dim();
    let pixels = (rows * columns) as f64;
    let mut place = |margin: usize| {
        let [y, x] = [rows, columns].map(|size| margin + rng.random_range(0..size - 2 * margin));
        (y, x, rng.random::<f64>(), rng.random_range(0..4))
    };
    for number in 0..(share * pixels) as usize {
        let (y, x, uniform, _) = place(0);
        if number % 2 == 0 {
            image_e[(y, x)] += read_noise_e * (HOT_NOISES[0] - HOT_NOISES[1] * (1.0 - uniform).ln());
        } else {
            image_e[(y, x)] = 0.0;
        }
    }
    for _ in 0..(cosmic_share * pixels) as usize / TRACK {
        let (y, x, uniform, direction) = place(TRACK);
        let [dy, dx] = [[0, 1], [1, 0], [1, 1], [1, -1]][direction];
        let electrons = 10f64.powf(TRACK_DECADES[0] + uniform * (TRACK_DECADES[1] - TRACK_DECADES[0]));
        for step in 0..TRACK as isize {
            image_e[(y.wrapping_add_signed(step * dy), x.wrapping_add_signed(step * dx))] += electrons;
        }
    }
}

/// `seeds` draws of the artificial source with each kind of bad pixels.
///
/// # Errors
/// Those of the estimator, and [`cophase::Error::Interrupted`].
pub fn bad_pixels(seeds: usize, quick: bool, progress: &Progress) -> Result<BadPixels> {
    let shares: &[f64] = if quick { &[0.0, 2e-2] } else { &SHARES };
    progress.expect(SAMPLINGS.len() * PEAK_SNRS.len() * 2 * shares.len() * seeds);
    let mut rows = Vec::new();
    for ([sampling, pixels], peak_snr) in SAMPLINGS.iter().flat_map(|of| PEAK_SNRS.map(|snr| (*of, snr))) {
        let settings = [("samples_per_lambda_over_d", sampling), ("pixels", pixels), ("peak_snr", peak_snr)]
            .map(|(key, value)| (format!("image.{key}"), value.to_string()));
        let settings = settings.each_ref().map(|(key, value)| (key.as_str(), value.as_str()));
        let scene = Scene::preset("keck-artificial")?.with(&settings)?;
        let case = Case::new(&scene)?;
        let clean = draws(&scene, seeds, progress)?;
        for (cosmic_share, &share) in
            [0.0, COSMIC_SHARE].iter().flat_map(|&of| shares.iter().map(move |share| (of, share)))
        {
            let spoilt: Vec<Draw> = clean
                .iter()
                .map(|draw| {
                    let mut image_e = draw.image_e.clone();
                    // The same pixels in every row of a seed.
                    let mut rng = stream(draw.seed as u64, 700);
                    spoil(&mut image_e, [share, cosmic_share], scene.image.simulated_read_noise_e(), &mut rng);
                    Draw { image_e, seed: draw.seed, flux_e: draw.flux_e, truth: draw.truth.clone() }
                })
                .collect();
            let trials = case.fit_changed(&format!("{share} bad, {cosmic_share} hit"), &spoilt, progress)?;
            let fitted: Vec<_> = trials.iter().zip(&clean).filter(|(trial, _)| trial.phasing_nm.is_finite()).collect();
            let bounds = fitted.iter().map(|(trial, draw)| case.bound(trial, draw)).collect::<Result<Vec<_>>>()?;
            let good = (1.0 - share - cosmic_share).sqrt();
            let bound = |nm: Vec<f64>| rms(&nm) / good;
            rows.push(BadPixelRow {
                sampling,
                peak_snr,
                share,
                cosmic_share,
                seeds: [fitted.len(), trials.len()],
                residual_nm: [
                    rms(&fitted.iter().map(|(trial, _)| trial.phasing_nm).collect::<Vec<_>>()),
                    rms(&fitted.iter().map(|(trial, _)| trial.ncpa_nm).collect::<Vec<_>>()),
                ],
                bound_nm: [
                    bound(bounds.iter().map(|bound| bound.phasing_nm).collect()),
                    bound(bounds.iter().map(|bound| bound.ncpa_nm).collect()),
                ],
                reduced_chi2: median(&fitted.iter().map(|(trial, _)| trial.reduced_chi2).collect::<Vec<_>>()),
                flagged: trials.iter().filter(|trial| trial.status != "ok").count(),
            });
        }
    }
    Ok(BadPixels { rows })
}

impl BadPixels {
    /// One line a row.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "sampling",
            "peak_snr",
            "bad_percent",
            "hit_percent",
            "fitted",
            "seeds",
            "phasing_nm",
            "ncpa_nm",
            "phasing_over_bound",
            "ncpa_over_bound",
            "chi2",
            "flagged",
        ]);
        for row in &self.rows {
            let [phasing, ncpa] = row.over_bound();
            table.push(vec![
                row.sampling.into(),
                row.peak_snr.into(),
                Cell::Number(100.0 * row.share, 1),
                Cell::Number(100.0 * row.cosmic_share, 1),
                row.seeds[0].into(),
                row.seeds[1].into(),
                Cell::Number(row.residual_nm[0], 3),
                Cell::Number(row.residual_nm[1], 3),
                Cell::Number(phasing, 3),
                Cell::Number(ncpa, 3),
                Cell::Number(row.reduced_chi2, 3),
                row.flagged.into(),
            ]);
        }
        table
    }

    /// Residual over bound against the share of bad pixels.
    pub fn picture(&self) -> CurvePicture {
        let same = |a: &&BadPixelRow, b: &&BadPixelRow| {
            (a.sampling, a.peak_snr, a.cosmic_share) == (b.sampling, b.peak_snr, b.cosmic_share)
        };
        let rows: Vec<&BadPixelRow> = self.rows.iter().collect();
        let series = rows.chunk_by(|a, b| same(a, b)).enumerate().map(|(number, rows)| {
            let BadPixelRow { sampling, peak_snr, cosmic_share, .. } = rows[0];
            let hit = if *cosmic_share > 0.0 { ", cosmic rays" } else { "" };
            Series {
                label: format!("{sampling} pixels per lambda/D, S/N {peak_snr}{hit}"),
                x: rows.iter().map(|row| 100.0 * row.share).collect(),
                y: rows.iter().map(|row| row.over_bound()[0]).collect(),
                y_err: None,
                style: SeriesStyle { stroke: Stroke::Solid, marker: Marker::Disc, colour: Some(number) },
            }
        });
        CurvePicture {
            title: "Bad pixels that are not marked: phasing".into(),
            x_label: "hot and dead pixels (%)".into(),
            y_label: "residual over the bound of the good pixels".into(),
            series: series.collect(),
            horizontal_lines: vec![(1.0, "bound".into())],
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["bad-pixels.csv", "bad-pixels.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text = "Bad pixels that are not marked, nm RMS (root of the mean square over draws)\n".to_string()
            + &self.table().text();
        Ok(Report { text, files: files.to_vec() })
    }
}
