//! Channels: pairs of defocused images and pairs of colours, residual against error bar, whole
//! wavelengths against their probability.

use super::pulls::pull_cells;
use super::statistics::median;
use super::{Cell, KeptDraw, Progress, Report, Table, to_cells, to_numbers};
use cophase::pipeline::Estimate;
use cophase::scene::Scene;
use cophase::{Error, Estimator, Images, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use rayon::prelude::*;
use std::path::Path;

/// One case: scene, how its images are made, and how they are read.
#[derive(Debug, Clone, Copy)]
pub struct ChannelRow {
    /// Its name.
    pub name: &'static str,
    preset: &'static str,
    made: &'static [(&'static str, &'static str)],
    read: &'static [(&'static str, &'static str)],
}

/// The cases. Pistons are normal with the RMS of uniform ones within ±15 and ±3 µm.
pub const CHANNEL_ROWS: [ChannelRow; 6] = [
    ChannelRow {
        name: "pair, half the photons each",
        preset: "keck-pair",
        made: &[("image.peak_snr", "353.6")],
        read: &[],
    },
    ChannelRow {
        name: "pair, defocus 5 % off, fitted",
        preset: "keck-pair",
        made: &[
            ("image.channel.plus.diversity_focus_waves_rms", "1.575"),
            ("image.channel.minus.diversity_focus_waves_rms", "-1.575"),
        ],
        read: &[("estimate.fit_optics", "[\"defocus\"]")],
    },
    ChannelRow {
        name: "two colours, pistons 1500 nm",
        preset: "keck-two-colour",
        made: &[("aberrations.segment_piston_rms_nm", "1500")],
        read: &[],
    },
    ChannelRow {
        name: "two colours, pistons 8660 nm",
        preset: "keck-two-colour",
        made: &[("aberrations.segment_piston_rms_nm", "8660")],
        read: &[],
    },
    ChannelRow {
        name: "two colours, pistons 1732 nm, S/N 30",
        preset: "keck-two-colour",
        made: &[("aberrations.segment_piston_rms_nm", "1732"), ("image.peak_snr", "30")],
        read: &[],
    },
    ChannelRow {
        name: "two colours, pistons 1732 nm, S/N 10",
        preset: "keck-two-colour",
        made: &[("aberrations.segment_piston_rms_nm", "1732"), ("image.peak_snr", "10")],
        read: &[],
    },
];

impl ChannelRow {
    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        if let Some(odd) = texts.iter().find(|text| !CHANNEL_ROWS.iter().any(|row| row.name.contains(*text))) {
            let names = CHANNEL_ROWS.map(|row| row.name).join("; ");
            return Err(Error::Value(format!(
                "no row of channels contains '{odd:.60}': parts of {names} are accepted"
            )));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name.contains(text));
        Ok(CHANNEL_ROWS.into_iter().filter(is_wanted).collect())
    }
}

/// Estimate of one draw.
#[derive(Debug, Clone)]
pub struct ChannelDraw {
    /// Residuals of phasing and NCPA, nm.
    pub residual_nm: [f64; 2],
    /// Their error bars, nm.
    pub sigma_nm: [f64; 2],
    /// Time of the estimate with its model, s.
    pub seconds: f64,
    /// Whether there is a warning, or a status other than ok.
    pub is_flagged: bool,
    /// Of each segment, the probability of its integer, and whether it is right; empty for one
    /// colour.
    pub integers: Vec<(f64, bool)>,
}

impl ChannelDraw {
    fn new(found: &Estimate) -> Result<Self> {
        let Some((truth, residual)) = &found.truth else {
            return Err(Error::Internal("a simulated image has no truth".into()));
        };
        let errors_nm = segment_means(found, &(&found.maps.phasing_nm - &truth.phasing_nm));
        let off_nm = median(&errors_nm);
        // Another integer is a wavelength, 1,640 nm or more, away.
        let is_right = |nm: &f64| (nm - off_nm).abs() < 500.0;
        let integers = found.integers.iter().zip(&errors_nm).map(|(one, nm)| (one.probability, is_right(nm)));
        Ok(Self {
            residual_nm: [residual.rms_nm[0], residual.rms_nm[1]],
            sigma_nm: [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm],
            seconds: found.run.model_seconds + found.run.seconds,
            is_flagged: !found.is_sound(),
            integers: integers.collect(),
        })
    }

    fn is_right(&self) -> bool {
        self.integers.iter().all(|(_, is_right)| *is_right)
    }
}

impl KeptDraw for ChannelDraw {
    fn cells(&self) -> Vec<String> {
        let number = |is: bool| f64::from(u8::from(is));
        let Self { residual_nm: [p, n], sigma_nm: [sp, sn], seconds, is_flagged, integers } = self;
        let own = [*p, *n, *sp, *sn, *seconds, number(*is_flagged)];
        let integers = integers.iter().flat_map(|(probability, is_right)| [*probability, number(*is_right)]);
        to_cells(&own.into_iter().chain(integers).collect::<Vec<_>>())
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let numbers = to_numbers(cells)?;
        let ([p, n, sp, sn, seconds, flag], integers) = numbers.split_first_chunk()?;
        Some(Self {
            residual_nm: [*p, *n],
            sigma_nm: [*sp, *sn],
            seconds: *seconds,
            is_flagged: *flag != 0.0,
            integers: integers.chunks_exact(2).map(|pair| (pair[0], pair[1] != 0.0)).collect(),
        })
    }
}

/// Mean of `map` over each segment.
fn segment_means(found: &Estimate, map: &ndarray::Array2<f64>) -> Vec<f64> {
    let pupil = &found.pupil;
    let mut sums = vec![[0.0; 2]; pupil.segments.len()];
    for (at, &owner) in pupil.owner.indexed_iter() {
        let Ok(owner) = usize::try_from(owner) else { continue };
        let a = pupil.amplitude[at];
        let [sum, weight] = &mut sums[owner];
        (*sum, *weight) = (*sum + a * map[at], *weight + a);
    }
    sums.iter().map(|[sum, weight]| sum / weight).collect()
}

/// The draws of some cases.
#[derive(Debug, Clone)]
pub struct ChannelTable(pub Vec<(ChannelRow, Vec<ChannelDraw>)>);

/// Estimates draws 1 to `seeds` of each case.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn channels(rows: &[ChannelRow], seeds: usize, progress: &Progress) -> Result<ChannelTable> {
    progress.expect(rows.len() * seeds);
    let table = rows.iter().enumerate().map(|(place, row)| {
        let made = Scene::preset(row.preset)?.with(row.made)?;
        let read = Scene::preset(row.preset)?.with(row.read)?;
        let estimator = Estimator::new(&read)?;
        let make = |seed: usize| {
            let images = Images::simulated(&made.with_override("aberrations.seed", &seed.to_string())?)?;
            let found = ChannelDraw::new(&estimator.estimate(&images)?)?;
            progress.add(1);
            Ok(found)
        };
        let draw = |seed: usize| progress.draw((row.name, seed, place * seeds + seed), 1, || make(seed)).transpose();
        Ok((*row, (1..=seeds).into_par_iter().filter_map(draw).collect::<Result<Vec<_>>>()?))
    });
    Ok(ChannelTable(table.collect::<Result<Vec<_>>>()?))
}

impl ChannelTable {
    /// One line a case. Residuals, error bars and pulls are those of draws whose integers are
    /// right.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "case",
            "draws",
            "phasing_nm",
            "phasing_sigma_nm",
            "phasing_pull",
            "ncpa_nm",
            "ncpa_sigma_nm",
            "ncpa_pull",
            "integers",
            "wrong",
            "wrong_above_0.99",
            "flagged",
            "wrong_unflagged",
            "seconds",
        ]);
        for (row, draws) in &self.0 {
            let mut cells: Vec<Cell> = vec![row.name.into(), draws.len().into()];
            let right = draws.iter().filter(|draw| draw.is_right());
            cells.extend(pull_cells(right.map(|draw| (draw.residual_nm, draw.sigma_nm))));
            let count = |is_counted: &dyn Fn(f64, bool) -> bool| -> usize {
                draws.iter().flat_map(|draw| &draw.integers).filter(|(p, is_right)| is_counted(*p, *is_right)).count()
            };
            cells.push(count(&|_, _| true).into());
            cells.push(count(&|_, is_right| !is_right).into());
            cells.push(count(&|probability, is_right| !is_right && probability > 0.99).into());
            cells.push(draws.iter().filter(|draw| draw.is_flagged).count().into());
            cells.push(draws.iter().filter(|draw| !draw.is_right() && !draw.is_flagged).count().into());
            cells.push(Cell::Number(median(&draws.iter().map(|draw| draw.seconds).collect::<Vec<_>>()), 2));
            table.push(cells);
        }
        table
    }

    /// Share of right integers against the probability that was claimed.
    pub fn picture(&self) -> CurvePicture {
        const EDGES: [f64; 8] = [0.0, 0.3, 0.5, 0.7, 0.9, 0.97, 0.99, 1.0 + f64::EPSILON];
        let all = self.0.iter().flat_map(|(_, draws)| draws).flat_map(|draw| &draw.integers);
        let all: Vec<(f64, bool)> = all.copied().collect();
        let (mut x, mut y) = (Vec::new(), Vec::new());
        for edges in EDGES.windows(2) {
            let inside: Vec<_> = all.iter().filter(|(p, _)| (edges[0]..edges[1]).contains(p)).collect();
            if !inside.is_empty() {
                let count = inside.len() as f64;
                x.push(inside.iter().map(|(p, _)| p).sum::<f64>() / count);
                y.push(inside.iter().filter(|(_, is_right)| *is_right).count() as f64 / count);
            }
        }
        let points = SeriesStyle { stroke: Stroke::Solid, marker: Marker::Disc, colour: Some(0) };
        let line = SeriesStyle { stroke: Stroke::Dotted, marker: Marker::None, colour: Some(7) };
        CurvePicture {
            title: "Whole wavelengths of pistons: right against claimed".into(),
            x_label: "claimed probability".into(),
            y_label: "share that is right".into(),
            series: vec![
                Series { label: "all draws".into(), x, y, y_err: None, style: points },
                Series { label: "as claimed".into(), x: vec![0.0, 1.0], y: vec![0.0, 1.0], y_err: None, style: line },
            ],
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["channels.csv", "channels.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text = "Channels: several images of one wavefront\n".to_string() + &self.table().text();
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_is_kept_to_the_bit() {
        for integers in [vec![], vec![(0.1, true), (1.0 / 3.0, false)]] {
            let (residual_nm, sigma_nm) = ([1.0 / 3.0, f64::NAN], [1e-9, 2.0]);
            let draw = ChannelDraw { residual_nm, sigma_nm, seconds: 0.1, is_flagged: true, integers };
            crate::experiment::assert_survives(&draw);
        }
    }
}
