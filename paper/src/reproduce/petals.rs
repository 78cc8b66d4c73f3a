//! Petals: pistons of the parts of a pupil behind a spider. Of `keck-nirc2`, which six vanes
//! divide, from one image in focus or out of focus; of a mirror of one piece behind four vanes,
//! whose petals take the place of segments, from one image in each of two wavelengths.

use super::statistics::{mean, rms, standard_deviation};
use super::{Cell, Progress, Report, Table};
use cophase::io::{FitsWriter, Pixel};
use cophase::modes::{Group, Petals};
use cophase::pipeline::Estimate;
use cophase::pupil::{Grid, Pupil};
use cophase::scene::{Scene, SegmentModes};
use cophase::telescope::Telescope;
use cophase::{Error, Estimator, Images, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use std::path::Path;

/// RMS of the pistons of the petals over the pupil, nm.
const AMPLITUDES_NM: [&str; 7] = ["0", "100", "200", "300", "400", "600", "800"];
/// The same for a quick look.
const FEW_AMPLITUDES_NM: [&str; 2] = ["100", "300"];
/// Images without and with diversity: name, and defocus, waves RMS. Exactly in focus a fit from a
/// flat wavefront has no direction in even modes.
const SINGLE: [(&str, &str); 2] = [("in focus", "0.02"), ("defocused", "1.5")];
const TWO_COLOURS: &str = "two colours, one piece";
/// Pixels at Nyquist sampling over the field of view of the preset, and 240 samples across the
/// pupil: with 120 the steps of petals of 300 nm, at the nearest sample, are a misfit of 2.7 times
/// the noise. Other models would not explain an image that has no diversity.
const SETTINGS: [(&str, &str); 5] = [
    ("image.samples_per_lambda_over_d", "2"),
    ("image.pixels", "240"),
    ("estimate.samples", "240"),
    ("estimate.model", "scene"),
    ("modes.petals", "piston"),
];
/// A mirror of 8.2 m with an obscuration of 1.1 m and four vanes.
const ONE_PIECE: [(&str, &str); 7] = [
    ("pupil.aperture", "round"),
    ("pupil.rings", "0"),
    ("pupil.segment_side_m", "4.1"),
    ("pupil.central_obscuration_m", "1.1"),
    ("pupil.spider_width_m", "0.05"),
    ("pupil.spider_angles_deg", "[45, 135]"),
    ("pupil.grid_m", "8.4"),
];
/// Samples across the map of its pupil: five of them are a vane.
const MAP_SAMPLES: usize = 768;

/// Estimate of one draw.
#[derive(Debug, Clone)]
pub struct PetalDraw {
    /// Error of the piston of each petal, nm, without piston, tip and tilt of the pupil.
    pub error_nm: Vec<f64>,
    /// Its expected standard deviation.
    pub sigma_nm: Vec<f64>,
    /// Whether there is a warning, or a status other than ok.
    pub is_flagged: bool,
    /// Whether all pistons are within a quarter of a wavelength of the truth, so that none is of
    /// another whole wavelength or sign.
    pub is_in_wave: bool,
}

/// Draws with one amplitude of the petals.
#[derive(Debug, Clone)]
pub struct PetalPoint {
    /// Name of the case.
    pub case: &'static str,
    /// RMS of the pistons over the pupil, nm.
    pub amplitude_nm: f64,
    /// The draws.
    pub draws: Vec<PetalDraw>,
}

/// Residual of the petals against their amplitude.
#[derive(Debug, Clone)]
pub struct PetalTable {
    /// Case by case, by amplitude.
    pub points: Vec<PetalPoint>,
}

/// A scene with the key of the amplitude, its petals, and the modes that hold them.
struct Case {
    name: &'static str,
    scene: Scene,
    key: &'static str,
    petals: Petals,
    group: Group,
}

/// Draws 1 to `seeds` of each case and amplitude.
///
/// # Errors
/// Those of the estimator, and [`Error::Interrupted`].
pub fn petals(seeds: usize, quick: bool, progress: &Progress) -> Result<PetalTable> {
    let amplitudes: &[&str] = if quick { &FEW_AMPLITUDES_NM } else { &AMPLITUDES_NM };
    progress.expect((SINGLE.len() + 1) * amplitudes.len() * seeds);
    let folder = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
    let mut cases = SINGLE.into_iter().map(single).collect::<Result<Vec<_>>>()?;
    cases.push(two_colours(&folder.path().join("pupil.fits"))?);
    let mut points = Vec::new();
    for case in &cases {
        let estimator = Estimator::new(&case.scene)?;
        for amplitude in amplitudes {
            let scene = case.scene.with_override(case.key, amplitude)?;
            let draw = |seed: usize| {
                progress.check()?;
                let images = Images::simulated(&scene.with_override("aberrations.seed", &seed.to_string())?)?;
                let found = PetalDraw::new(&estimator.estimate(&images)?, case)?;
                progress.add(1);
                Ok(found)
            };
            let draws = (1..=seeds).into_par_iter().map(draw).collect::<Result<Vec<_>>>()?;
            let amplitude_nm = amplitude.parse().map_err(|_| Error::Internal(format!("{amplitude} is no number")))?;
            points.push(PetalPoint { case: case.name, amplitude_nm, draws });
        }
    }
    Ok(PetalTable { points })
}

/// One image of `keck-nirc2`.
fn single((name, waves): (&'static str, &str)) -> Result<Case> {
    let scene = Scene::preset("keck-nirc2")?.with(&SETTINGS)?;
    let scene = scene.with_override("image.diversity_focus_waves_rms", waves)?;
    let (petals, key) = (petals_of(&Telescope::new(&scene)?)?, "aberrations.petal_piston_rms_nm");
    Ok(Case { name, scene, key, petals, group: Group::Ncpa })
}

/// Two wavelengths behind a mirror of one piece, whose petals are labelled as segments in the map
/// at `path`.
fn two_colours(path: &Path) -> Result<Case> {
    let geometry = Scene::preset("keck-two-colour")?.with(&ONE_PIECE)?;
    let telescope = Telescope::new(&geometry)?;
    let petals = petals_of(&telescope)?;
    let pupil = telescope.pupil_on(Grid::new(MAP_SAMPLES, telescope.pupil.grid.width_m())?)?;
    let at = |index: usize| pupil.grid.coordinate_m(index);
    let label = |(y, x): (usize, usize)| match pupil.amplitude[[y, x]] > 0.0 {
        true => petals.parts().part_at(at(x), at(y)) as f64,
        false => -1.0,
    };
    let mut file = FitsWriter::create(path)?;
    file.image("PUPIL", &pupil.amplitude, Pixel::F64, "")?;
    file.image("SEGMENT", &Array2::from_shape_fn(pupil.amplitude.dim(), label), Pixel::F64, "")?;
    file.finish()?;
    let (path, samples) = (path.display().to_string(), MAP_SAMPLES.to_string());
    let without_geometry = ONE_PIECE[..6].iter().map(|(key, _)| (*key, ""));
    let map = [("pupil.segment_gap_m", ""), ("pupil.file", &*path), ("aberrations.truth_samples", &*samples)];
    let scene = geometry.with(&without_geometry.chain(map).collect::<Vec<_>>())?;
    let key = "aberrations.segment_piston_rms_nm";
    Ok(Case { name: TWO_COLOURS, scene, key, petals, group: Group::Segment })
}

fn petals_of(telescope: &Telescope) -> Result<Petals> {
    let petals = telescope.petals(SegmentModes::Piston)?;
    petals.ok_or_else(|| Error::Internal("pistons of petals are no motions".into()))
}

impl PetalDraw {
    fn new(found: &Estimate, case: &Case) -> Result<Self> {
        let (Some((_, residual)), Some(modal)) = (&found.truth, found.modal()) else {
            return Err(Error::Internal("the estimate of a simulated image has no truth or is not modal".into()));
        };
        let model = modal.fitter.model();
        let (pupil, petals) = (&found.pupil, &case.petals);
        let modes = model.modes_of(case.group);
        let maps = model.basis.maps();
        // Mean of each mode over each petal, [petal, mode].
        let mut response = Array2::zeros((petals.len(), modes.len()));
        for (mut column, mode) in response.columns_mut().into_iter().zip(modes.clone()) {
            let map = pupil.remove_piston_tip_tilt(maps.index_axis(Axis(0), mode))?;
            column.iter_mut().zip(means(petals, pupil, map.view())).for_each(|(out, mean)| *out = mean);
        }
        let covariance_nm2 = found.modes.covariance_nm2.slice(s![modes.clone(), modes]);
        let variances_nm2 = response.dot(&covariance_nm2).dot(&response.t()).into_diag();
        let residual_nm = if case.group == Group::Ncpa { &residual.maps.ncpa_nm } else { &residual.maps.phasing_nm };
        let error_nm = means(petals, pupil, residual_nm.view());
        Ok(Self {
            is_in_wave: error_nm.iter().all(|nm| nm.abs() < case.scene.image.wavelength_nm / 4.0),
            error_nm,
            sigma_nm: variances_nm2.iter().map(|nm2| nm2.max(0.0).sqrt()).collect(),
            is_flagged: !found.is_sound(),
        })
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
    /// One line for each case and amplitude. Residuals are RMS over the petals of a draw, mean and
    /// standard deviation over the draws within a quarter of a wavelength.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "case",
            "petals_nm",
            "draws",
            "within_quarter_wave",
            "residual_nm",
            "residual_sd_nm",
            "sigma_nm",
            "worst_nm",
            "flagged",
            "beyond_unflagged",
        ]);
        for point in &self.points {
            let near: Vec<&PetalDraw> = point.draws.iter().filter(|draw| draw.is_in_wave).collect();
            let of = |values: fn(&PetalDraw) -> f64| near.iter().map(|draw| values(draw)).collect::<Vec<f64>>();
            let residuals_nm = of(|draw| rms(&draw.error_nm));
            let worst = near.iter().flat_map(|draw| &draw.error_nm).map(|nm| nm.abs()).reduce(f64::max);
            let flagged = |draw: &&PetalDraw| draw.is_flagged;
            let beyond_unflagged = |draw: &&PetalDraw| !draw.is_flagged && !draw.is_in_wave;
            table.push(vec![
                point.case.into(),
                Cell::Number(point.amplitude_nm, 0),
                point.draws.len().into(),
                near.len().into(),
                Cell::Number(mean(&residuals_nm), 2),
                Cell::Number(standard_deviation(&residuals_nm), 2),
                Cell::Number(rms(&of(|draw| rms(&draw.sigma_nm))), 2),
                Cell::Number(worst.unwrap_or(f64::NAN), 2),
                point.draws.iter().filter(flagged).count().into(),
                point.draws.iter().filter(beyond_unflagged).count().into(),
            ]);
        }
        table
    }

    /// Residual of all draws against amplitude, with the expected one.
    pub fn picture(&self) -> CurvePicture {
        let mut series = Vec::new();
        for (colour, chunk) in self.points.chunk_by(|a, b| a.case == b.case).enumerate() {
            let list = |of: &dyn Fn(&PetalPoint) -> f64| chunk.iter().map(of).collect::<Vec<f64>>();
            let all = |values: fn(&PetalDraw) -> f64| {
                move |point: &PetalPoint| rms(&point.draws.iter().map(values).collect::<Vec<f64>>())
            };
            let x = list(&|point| point.amplitude_nm);
            let solid = SeriesStyle { stroke: Stroke::Solid, marker: Marker::Disc, colour: Some(colour) };
            let dashed = SeriesStyle { stroke: Stroke::Dashed, marker: Marker::None, colour: Some(colour) };
            let (found, expected) = (list(&all(|draw| rms(&draw.error_nm))), list(&all(|draw| rms(&draw.sigma_nm))));
            series.push(Series { label: chunk[0].case.into(), x: x.clone(), y: found, y_err: None, style: solid });
            series.push(Series { label: String::new(), x, y: expected, y_err: None, style: dashed });
        }
        CurvePicture {
            title: "Pistons of petals: residual of all draws (dashed: error bar)".into(),
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
        let text = "Pistons of petals: residual and error bar of the draws within a quarter of a wavelength, nm\n"
            .to_string()
            + &self.table().text();
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}
