//! Petals: pistons of the parts of the pupil of `keck-nirc2`, which six vanes separate, from one image in focus or out of focus.

use super::statistics::{mean, rms, standard_deviation};
use super::{Cell, Progress, Report, Table};
use crate::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use cophase::modes::Petals;
use cophase::pipeline::Estimate;
use cophase::pupil::Pupil;
use cophase::scene::{Scene, SegmentModes};
use cophase::telescope::Telescope;
use cophase::{Error, Estimator, Images, Result};
use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use std::path::Path;

/// RMS of the pistons of the petals over the pupil, nm.
const AMPLITUDES_NM: [&str; 7] = ["0", "100", "200", "300", "400", "600", "800"];
/// The same for a quick look.
const FEW_AMPLITUDES_NM: [&str; 2] = ["100", "300"];
/// Images without and with diversity: defocus, waves RMS. Exactly in focus the first step of a fit from a flat wavefront has no direction in
/// even modes.
const DEFOCUS_WAVES_RMS: [&str; 2] = ["0.02", "1.5"];
/// Pixels at Nyquist sampling over the field of view of the preset, and 240 samples across the pupil: with 120 the steps of petals of 300 nm, at
/// the nearest sample, are a misfit of 2.7 times the noise.
const SETTINGS: [(&str, &str); 4] = [
    ("image.samples_per_lambda_over_d", "2"),
    ("image.pixels", "240"),
    ("estimate.samples", "240"),
    ("modes.petals", "piston"),
];

/// Estimate of one draw.
#[derive(Debug, Clone)]
pub struct PetalDraw {
    /// Error of the piston of each petal, nm, without piston, tip and tilt of the pupil.
    pub error_nm: Vec<f64>,
    /// Its expected standard deviation.
    pub sigma_nm: Vec<f64>,
    /// Whether there is a warning, or a status other than ok.
    pub is_flagged: bool,
}

/// Draws with one amplitude of the petals and one diversity.
#[derive(Debug, Clone)]
pub struct PetalPoint {
    /// RMS of the pistons over the pupil, nm.
    pub amplitude_nm: f64,
    /// Defocus, waves RMS.
    pub defocus_waves_rms: f64,
    /// The draws.
    pub draws: Vec<PetalDraw>,
}

/// Residual of the petals against their amplitude.
#[derive(Debug, Clone)]
pub struct PetalTable {
    /// Without diversity, then with it; by amplitude.
    pub points: Vec<PetalPoint>,
    half_wave_nm: f64,
}

/// Draws 1 to `seeds` of each amplitude, without and with diversity.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn petals(seeds: usize, quick: bool, progress: &Progress) -> Result<PetalTable> {
    let amplitudes: &[&str] = if quick { &FEW_AMPLITUDES_NM } else { &AMPLITUDES_NM };
    progress.expect(DEFOCUS_WAVES_RMS.len() * amplitudes.len() * seeds);
    let preset = Scene::preset("keck-nirc2")?.with(&SETTINGS)?;
    let mut points = Vec::new();
    for waves in DEFOCUS_WAVES_RMS {
        let scene = preset.with_override("image.diversity_focus_waves_rms", waves)?;
        let estimator = Estimator::new(&scene)?;
        for amplitude in amplitudes {
            let scene = scene.with_override("aberrations.petal_piston_rms_nm", amplitude)?;
            let draw = |seed: usize| {
                progress.check()?;
                let images = Images::simulated(&scene.with_override("aberrations.seed", &seed.to_string())?)?;
                let found = PetalDraw::new(&estimator.estimate(&images)?)?;
                progress.add(1);
                Ok(found)
            };
            points.push(PetalPoint {
                amplitude_nm: scene.aberrations.as_ref().map_or(0.0, |truth| truth.petal_piston_rms_nm),
                defocus_waves_rms: scene.image.diversity_focus_waves_rms,
                draws: (1..=seeds).into_par_iter().map(draw).collect::<Result<Vec<_>>>()?,
            });
        }
    }
    Ok(PetalTable { points, half_wave_nm: preset.image.wavelength_nm / 2.0 })
}

impl PetalDraw {
    fn new(found: &Estimate) -> Result<Self> {
        let (Some((_, residual)), Some(fitter)) = (&found.truth, &found.fitter) else {
            return Err(Error::Internal("a modal estimate of a simulated image has no truth or no model".into()));
        };
        let Some(petals) = Telescope::new(&found.scene)?.petals(SegmentModes::Piston)? else {
            return Err(Error::Internal("pistons of petals are no motions".into()));
        };
        let pupil = &found.pupil;
        let model = fitter.model();
        // Response of the pistons to each NCPA mode, [petal, mode].
        let ncpa = model.segment_modes..model.basis.len();
        let maps = model.basis.maps();
        let mut response = Array2::zeros((petals.len(), ncpa.len()));
        for (mut column, mode) in response.columns_mut().into_iter().zip(ncpa.clone()) {
            let map = pupil.remove_piston_tip_tilt(maps.index_axis(ndarray::Axis(0), mode))?;
            column.iter_mut().zip(means(&petals, pupil, map.view())).for_each(|(out, mean)| *out = mean);
        }
        let covariance_nm2 = found.covariance_nm2.slice(ndarray::s![ncpa.clone(), ncpa]);
        let variances_nm2 = response.dot(&covariance_nm2).dot(&response.t()).into_diag();
        Ok(Self {
            error_nm: means(&petals, pupil, residual.ncpa_nm.view()),
            sigma_nm: variances_nm2.iter().map(|nm2| nm2.max(0.0).sqrt()).collect(),
            is_flagged: !found.is_sound(),
        })
    }

    /// Whether all pistons are within half of half a wave: a whole wavelength or another sign is farther away.
    fn is_right(&self, half_wave_nm: f64) -> bool {
        self.error_nm.iter().all(|nm| nm.abs() < half_wave_nm / 2.0)
    }
}

/// Mean of `map` over each petal (weight A).
fn means(petals: &Petals, pupil: &Pupil, map: ArrayView2<f64>) -> Vec<f64> {
    let mut sums = vec![[0.0; 2]; petals.parts().count()];
    for ((y, x), &a) in pupil.amplitude.indexed_iter().filter(|(_, a)| **a > 0.0) {
        let part = petals.parts().part_at(pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
        let [sum, weight] = &mut sums[part];
        (*sum, *weight) = (*sum + a * map[[y, x]], *weight + a);
    }
    sums.iter().map(|[sum, weight]| sum / weight).collect()
}

impl PetalTable {
    /// One line for each amplitude, without and with diversity. Residuals are RMS over the petals of a draw, mean and standard deviation over
    /// the draws that are right.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "defocus_waves",
            "petals_nm",
            "draws",
            "right",
            "residual_nm",
            "residual_sd_nm",
            "sigma_nm",
            "worst_nm",
            "flagged",
            "wrong_unflagged",
        ]);
        for point in &self.points {
            let right: Vec<&PetalDraw> = self.right(point);
            let of = |values: fn(&PetalDraw) -> f64| right.iter().map(|draw| values(draw)).collect::<Vec<f64>>();
            let residuals_nm = of(|draw| rms(&draw.error_nm));
            let worst = right.iter().flat_map(|draw| &draw.error_nm).map(|nm| nm.abs()).reduce(f64::max);
            let flagged = |draw: &&PetalDraw| draw.is_flagged;
            let wrong_unflagged = |draw: &&PetalDraw| !draw.is_flagged && !draw.is_right(self.half_wave_nm);
            table.push(vec![
                Cell::Number(point.defocus_waves_rms, 2),
                Cell::Number(point.amplitude_nm, 0),
                point.draws.len().into(),
                right.len().into(),
                Cell::Number(mean(&residuals_nm), 2),
                Cell::Number(standard_deviation(&residuals_nm), 2),
                Cell::Number(rms(&of(|draw| rms(&draw.sigma_nm))), 2),
                Cell::Number(worst.unwrap_or(f64::NAN), 2),
                point.draws.iter().filter(flagged).count().into(),
                point.draws.iter().filter(wrong_unflagged).count().into(),
            ]);
        }
        table
    }

    fn right<'a>(&self, point: &'a PetalPoint) -> Vec<&'a PetalDraw> {
        point.draws.iter().filter(|draw| draw.is_right(self.half_wave_nm)).collect()
    }

    /// Residual of all draws against amplitude, with the expected one.
    pub fn picture(&self) -> CurvePicture {
        let mut series = Vec::new();
        for (colour, chunk) in self.points.chunk_by(|a, b| a.defocus_waves_rms == b.defocus_waves_rms).enumerate() {
            let list = |of: &dyn Fn(&PetalPoint) -> f64| chunk.iter().map(of).collect::<Vec<f64>>();
            let all = |values: fn(&PetalDraw) -> f64| {
                move |point: &PetalPoint| rms(&point.draws.iter().map(values).collect::<Vec<f64>>())
            };
            let x = list(&|point| point.amplitude_nm);
            let waves = chunk[0].defocus_waves_rms;
            let solid = SeriesStyle { stroke: Stroke::Solid, marker: Marker::Disc, colour: Some(colour) };
            let dashed = SeriesStyle { stroke: Stroke::Dashed, marker: Marker::None, colour: Some(colour) };
            let (found, expected) = (list(&all(|draw| rms(&draw.error_nm))), list(&all(|draw| rms(&draw.sigma_nm))));
            let label = format!("defocus of {waves} waves RMS");
            series.push(Series { label, x: x.clone(), y: found, y_err: None, style: solid });
            series.push(Series { label: "its error bar".into(), x, y: expected, y_err: None, style: dashed });
        }
        CurvePicture {
            title: "Pistons of six petals: residual of all draws".into(),
            x_label: "pistons of the petals (nm RMS)".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["petals.csv", "petals.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let text = "Pistons of the petals, one image each: residual and error bar of the draws that are right, nm\n"
            .to_string()
            + &self.table().text();
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}
