//! Telescope of a scene.

use crate::grid::Grid;
use crate::io;
use crate::modes::VonKarman;
use crate::pupil::{Aperture, BandLimit, FinePupil, HexagonalParameters, Pupil, PupilParts, SegmentWeights};
use crate::scene::{Aperture as SceneAperture, PupilModel, Purpose, System};
use crate::{Error, Result};
use ndarray::Array2;
use std::sync::{Arc, OnceLock};

/// Samples along a side of the grid on which the moments of a geometric pupil are computed: their
/// error falls as the square of the pitch, from 1e-4 at 120 samples.
const FINE_SAMPLES: usize = 960;
/// Most samples along a side of [`Telescope::finer_pupil`].
const MOST_FINE_SAMPLES: usize = 2048;

/// Source of the pupil amplitude.
#[derive(Debug, Clone)]
enum PupilSource {
    /// Geometry: exact on any grid.
    Exact(Aperture),
    /// Maps finer than the model's grid.
    Fine(FinePupil),
    /// Maps on the model's own grid, used without resampling.
    Coarse,
}

/// Telescope of a scene, on the scene's grid.
#[derive(Debug, Clone)]
pub struct Telescope {
    /// Pupil on the scene's grid (`pupil.samples` over `pupil.grid_m`), on which maps are reported,
    /// without a turn.
    pub pupil: Pupil,
    source: PupilSource,
    /// Turn of the pupil in the images, degrees, and the turned geometry; `None` where they show
    /// the pupil as it is.
    turned: Option<(f64, Aperture)>,
    /// Amplitude that each segment reflects, relative to the mean; empty if all are equal.
    amplitudes: Vec<f64>,
    /// Slopes along x and y and the rise to the edge of the illumination; `None` for an even one.
    illumination: Option<[f64; 3]>,
    /// Means of r² and of r⁴ over the finest pupil, once they are needed, m² and m⁴.
    moments: Arc<OnceLock<[f64; 2]>>,
}

impl Telescope {
    /// Builds the telescope of `scene`, reading its pupil's file if it names one.
    ///
    /// # Errors
    /// [`Error::File`] for a pupil file that cannot be read, [`Error::Value`] or [`Error::Shape`]
    /// for an impossible one.
    pub fn new(scene: &System) -> Result<Self> {
        Ok(Self { illumination: scene.pupil.illumination(), ..Self::evenly_illuminated(scene)? })
    }

    fn evenly_illuminated(scene: &System) -> Result<Self> {
        if scene.purpose() == Purpose::Arrays {
            let name = scene.name();
            return Err(Error::Scene(format!(
                "{name}: its pupil is an array of the caller's; use a call that takes that array"
            )));
        }
        if let SceneAperture::File(file) = &scene.pupil.aperture {
            return Self::from_file(scene, &scene.resolve(file));
        }
        let pupil = &scene.pupil;
        let parameters = HexagonalParameters {
            rings: pupil.rings,
            is_round: pupil.is_round(),
            segment_side_m: pupil.segment_side_m,
            gap_m: pupil.segment_gap_m,
            removed_rings: pupil.removed_rings,
            outer_radius_m: pupil.outer_radius_m,
            central_segment: pupil.central_segment,
            obscuration_diameter_m: pupil.central_obscuration_m,
            spider_width_m: pupil.spider_width_m,
            spider_angles_deg: if pupil.spider_width_m > 0.0 { pupil.spider_angles_deg.clone() } else { Vec::new() },
            spider_vanes_deg: pupil.spider_vanes_deg.clone().unwrap_or_default(),
            rotation_deg: pupil.rotation_deg,
            dark_segments: pupil.dark_segments.iter().map(|number| *number as usize).collect(),
            stop_diameter_m: pupil.stop_diameter_m,
            stop_centre_m: [pupil.stop_x_m, pupil.stop_y_m],
        };
        let aperture = Aperture::hexagonal(&parameters)?;
        let turned = |turn_deg: f64| {
            let rotation_deg = pupil.rotation_deg + turn_deg;
            Aperture::hexagonal(&HexagonalParameters { rotation_deg, ..parameters.clone() })
                .map(|turned| (turn_deg, turned))
        };
        let turn_deg = scene.image.pupil_turn_deg().filter(|turn_deg| *turn_deg != 0.0);
        let grid = Grid::new(pupil.samples, pupil.grid_m.unwrap_or(aperture.width_m()))?;
        Ok(Self {
            pupil: aperture.pupil(&grid)?,
            source: PupilSource::Exact(aperture),
            turned: turn_deg.map(turned).transpose()?,
            amplitudes: Vec::new(),
            illumination: None,
            moments: Arc::default(),
        })
    }

    fn from_file(scene: &System, path: &std::path::Path) -> Result<Self> {
        let mut file = io::FitsReader::open(path)?;
        let named =
            |file: &io::FitsReader, name: &str| file.names().iter().any(|n| n == name).then(|| name.to_string());
        let amplitude_name = named(&file, "PUPIL");
        let amplitude = file.map(amplitude_name.as_deref())?;
        let labels = match named(&file, "SEGMENT") {
            Some(name) => Some(labels(&file.map(Some(&name))?).map_err(|error| Error::file(path, error))?),
            None => None,
        };
        let width_m = scene.pupil.grid_m.ok_or_else(|| Error::Scene("'pupil.grid_m' is missing".into()))?;
        Self::of_maps(scene, width_m, amplitude, labels).map_err(|error| Error::file(path, error))
    }

    /// Telescope of `scene` from the maps `[y, x]` over `width_m` of a file or of the caller's.
    /// Maps of at least twice `pupil.samples` are averaged onto that grid and band-limited for the
    /// model; others are used on their own grid, and with `pupil.model = "hard"` all.
    ///
    /// # Errors
    /// Those of [`Telescope::from_maps`].
    pub fn of_maps(scene: &System, width_m: f64, amplitude: Array2<f64>, labels: Option<Array2<i32>>) -> Result<Self> {
        let (size, samples) = (even_side(&amplitude)?, scene.pupil.samples);
        let illumination = scene.pupil.illumination();
        if size < 2 * samples || scene.pupil.model == Some(PupilModel::Hard) {
            return Ok(Self { illumination, ..Self::from_maps(width_m, amplitude, labels)? });
        }
        let fine = FinePupil::new(Grid::new(size, width_m)?, amplitude, labels)?;
        let pupil = binned(&fine, Grid::new(samples, width_m)?)?;
        let (source, moments) = (PupilSource::Fine(fine), Arc::default());
        Ok(Self { pupil, source, turned: None, amplitudes: Vec::new(), illumination, moments })
    }

    /// Builds a telescope from maps `[y, x]` over `width_m`, on their own grid: see
    /// [`Pupil::from_maps`].
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that are not square with an even side, and those of
    /// [`Pupil::from_maps`].
    pub fn from_maps(width_m: f64, amplitude: Array2<f64>, labels: Option<Array2<i32>>) -> Result<Self> {
        let grid = Grid::new(even_side(&amplitude)?, width_m)?;
        let pupil = Pupil::from_maps(grid, amplitude, labels)?;
        let (source, moments) = (PupilSource::Coarse, Arc::default());
        Ok(Self { pupil, source, turned: None, amplitudes: Vec::new(), illumination: None, moments })
    }

    /// This telescope with segments that reflect the given amplitudes, in any unit. The amplitudes
    /// are scaled so that the light of the whole pupil does not change; the pupil amplitude maps
    /// are not multiplied by them.
    ///
    /// # Errors
    /// [`Error::Value`] for amplitudes that are not positive, or not one for each segment.
    pub fn with_amplitudes(mut self, mut amplitudes: Vec<f64>) -> Result<Self> {
        let areas_m2 = self.pupil.segment_areas();
        if amplitudes.len() != areas_m2.len() {
            let (given, segments) = (amplitudes.len(), areas_m2.len());
            return Err(Error::Value(format!(
                "{given} amplitudes were given for {segments} segments; one each is needed"
            )));
        }
        if let Some(amplitude) = amplitudes.iter().find(|amplitude| !(amplitude.is_finite() && **amplitude > 0.0)) {
            return Err(Error::Value(format!(
                "a segment's amplitude of {amplitude} is impossible; a finite number above 0 is needed"
            )));
        }
        let light: f64 = areas_m2.iter().zip(&amplitudes).map(|(area, amplitude)| area * amplitude * amplitude).sum();
        let mean = (light / areas_m2.iter().sum::<f64>()).sqrt();
        amplitudes.iter_mut().for_each(|amplitude| *amplitude /= mean);
        self.amplitudes = amplitudes;
        Ok(self)
    }

    /// Turn of the pupil in the images, degrees counter-clockwise.
    pub fn turn_deg(&self) -> f64 {
        self.turned.as_ref().map_or(0.0, |(turn_deg, _)| *turn_deg)
    }

    /// Coordinates on the mirror, m, of a point of the pupil in the images.
    pub fn on_mirror(&self, (x, y): (f64, f64)) -> (f64, f64) {
        if self.turned.is_none() {
            return (x, y);
        }
        let (sin, cos) = self.turn_deg().to_radians().sin_cos();
        (cos * x + sin * y, cos * y - sin * x)
    }

    /// Amplitude that each segment reflects, relative to the RMS over the pupil; empty if all are
    /// equal.
    pub fn amplitudes(&self) -> &[f64] {
        &self.amplitudes
    }

    /// Multiplies `weights` on `grid` by the amplitude that each segment reflects, and by the root
    /// of the illumination, which is scaled so that the light of the whole pupil does not change.
    fn reflected(&self, mut weights: SegmentWeights, grid: &Grid) -> SegmentWeights {
        if !self.amplitudes.is_empty() {
            for (weight, &segment) in weights.weight.iter_mut().zip(&weights.segment) {
                *weight *= self.amplitudes[segment as usize];
            }
        }
        if let Some([slope_x, slope_y, edge]) = self.illumination {
            let half_m = 0.5 * self.pupil.grid.width_m();
            let light = |cell: usize| {
                let [x, y] = [cell % grid.samples(), cell / grid.samples()].map(|at| grid.coordinate_m(at) / half_m);
                // Beyond the edge, and for slopes that exceed it, there is no negative light.
                (1.0 + slope_x * x + slope_y * y + edge * (2.0 * (x * x + y * y) - 1.0)).max(0.0)
            };
            let squares = weights.rows().map(|(cell, _, own)| (light(cell), own.iter().sum::<f64>().powi(2)));
            let (with, without) = squares.fold((0.0, 0.0), |(a, b), (light, square)| (a + light * square, b + square));
            let scale = if with > 0.0 { without / with } else { 0.0 };
            let ends: Vec<(usize, std::ops::Range<usize>)> = weights
                .illuminated
                .iter()
                .zip(weights.offsets.windows(2))
                .map(|(&cell, ends)| (cell as usize, ends[0] as usize..ends[1] as usize))
                .collect();
            for (cell, entries) in ends {
                let root = (scale * light(cell)).sqrt();
                weights.weight[entries].iter_mut().for_each(|weight| *weight *= root);
            }
        }
        weights
    }

    /// Whether the pupil is known on a grid fine enough for a band limit.
    pub fn is_fine(&self) -> bool {
        !matches!(self.source, PupilSource::Coarse)
    }

    /// Pupil on another grid: exact from geometry, averaged from a fine map; a coarse map exists on
    /// its own grid only.
    ///
    /// # Errors
    /// [`Error::Value`] for a coarse map and another grid.
    pub fn pupil_on(&self, grid: Grid) -> Result<Pupil> {
        match &self.source {
            _ if grid == self.pupil.grid => Ok(self.pupil.clone()),
            PupilSource::Exact(aperture) => aperture.pupil(&grid),
            PupilSource::Fine(fine) if grid == *fine.grid() => Ok(fine.pupil().clone()),
            PupilSource::Fine(fine) if fine.resolves(&grid) => binned(fine, grid),
            _ => Err(Error::Value(format!(
                "the pupil is a map of {} samples a side and cannot be resampled to {}; a finer map is needed",
                self.pupil.grid.samples(),
                grid.samples()
            ))),
        }
    }

    /// Parts of the pupil that its spider separates, on the finest known grid.
    pub(super) fn parts(&self) -> PupilParts {
        match &self.source {
            PupilSource::Exact(aperture) => aperture.parts().clone(),
            PupilSource::Fine(fine) => PupilParts::of_maps(fine.pupil()),
            PupilSource::Coarse => PupilParts::of_maps(&self.pupil),
        }
    }

    /// Default number of samples a side for a truth: 8 times the scene's for an exact geometry,
    /// those of the map for a fine or coarse map.
    pub fn truth_samples(&self) -> usize {
        match &self.source {
            PupilSource::Exact(_) => 8 * self.pupil.grid.samples(),
            PupilSource::Fine(fine) => fine.grid().samples(),
            PupilSource::Coarse => self.pupil.grid.samples(),
        }
    }

    /// Segments on a grid up to eight times as fine as the scene's, as far as they are known on one
    /// and it stays small.
    ///
    /// # Errors
    /// Those of [`Telescope::pupil_on`].
    pub fn finer_pupil(&self) -> Result<Pupil> {
        let samples = self.pupil.grid.samples();
        match &self.source {
            PupilSource::Exact(_) => {
                let times = (1..=8).rev().find(|times| times * samples <= MOST_FINE_SAMPLES).unwrap_or(1);
                self.pupil_on(Grid::new(times * samples, self.pupil.grid.width_m())?)
            }
            PupilSource::Fine(fine) => Ok(fine.pupil().clone()),
            PupilSource::Coarse => Ok(self.pupil.clone()),
        }
    }

    /// This with what `other`, whose pupil has the same geometry, has computed of it.
    pub(crate) fn with_moments_of(self, other: &Self) -> Self {
        Self { moments: other.moments.clone(), ..self }
    }

    /// Means of r² and of r⁴ over the finest pupil, weighted by its amplitude, m² and m⁴. That
    /// pupil is drawn once: a search for the optics needs them several times for each trial.
    pub(super) fn moments(&self) -> Result<[f64; 2]> {
        if let Some(moments) = self.moments.get() {
            return Ok(*moments);
        }
        let pupil = self.finest_pupil()?;
        let (mut weight, mut mean, mut square) = (0.0, 0.0, 0.0);
        for ((y, x), &a) in pupil.amplitude.indexed_iter() {
            let r2 = pupil.grid.coordinate_m(x).powi(2) + pupil.grid.coordinate_m(y).powi(2);
            (weight, mean, square) = (weight + a, mean + a * r2, square + a * r2 * r2);
        }
        Ok(*self.moments.get_or_init(|| [mean / weight, square / weight]))
    }

    /// Pupil on the finest known grid; exact geometry on a grid on which its moments have errors of
    /// about 1e-6.
    fn finest_pupil(&self) -> Result<Pupil> {
        match &self.source {
            PupilSource::Exact(_) => self.pupil_on(Grid::new(FINE_SAMPLES, self.pupil.grid.width_m())?),
            PupilSource::Fine(fine) => Ok(fine.pupil().clone()),
            PupilSource::Coarse => Ok(self.pupil.clone()),
        }
    }

    /// The geometry that images show.
    fn shown<'a>(&'a self, aperture: &'a Aperture) -> &'a Aperture {
        self.turned.as_ref().map_or(aperture, |(_, turned)| turned)
    }

    /// Weights of the segments in the samples of `grid` of the pupil in the images without a low
    /// pass: by exact area for a known geometry, by the owner of each sample for a map.
    ///
    /// # Errors
    /// As [`Telescope::pupil_on`].
    pub fn area_weights(&self, grid: Grid) -> Result<SegmentWeights> {
        let weights = match &self.source {
            PupilSource::Exact(aperture) => SegmentWeights::area(self.shown(aperture), &grid)?,
            _ => SegmentWeights::hard(&self.pupil_on(grid)?),
        };
        Ok(self.reflected(weights, &grid))
    }

    /// Weights on the scene's grid by the owner of each sample.
    pub fn hard_weights(&self) -> SegmentWeights {
        self.reflected(SegmentWeights::hard(&self.pupil), &self.pupil.grid)
    }

    /// Low-passed weights on `grid` of the pupil in the images.
    ///
    /// # Errors
    /// [`Error::Value`] for a coarse pupil map, or an impossible `limit`.
    pub fn band_limited_weights(&self, grid: Grid, limit: &BandLimit) -> Result<SegmentWeights> {
        let weights = match &self.source {
            PupilSource::Exact(aperture) => SegmentWeights::band_limited(self.shown(aperture), &grid, limit)?,
            PupilSource::Fine(fine) => SegmentWeights::band_limited_maps(fine, &grid, limit)?,
            PupilSource::Coarse => {
                return Err(Error::Value(
                    "a coarse pupil map cannot be band-limited; a map of at least twice pupil.samples is needed".into(),
                ));
            }
        };
        Ok(self.reflected(weights, &grid))
    }

    /// Statistics of the scene's turbulence.
    ///
    /// # Errors
    /// Those of [`VonKarman::new`].
    pub fn turbulence(scene: &System) -> Result<VonKarman> {
        VonKarman::new(scene.turbulence.r0_m, scene.turbulence.outer_scale_m)
    }
}

/// The labels of a map of segments.
///
/// # Errors
/// [`Error::Value`] for one that is not a whole number.
fn labels(map: &Array2<f64>) -> Result<Array2<i32>> {
    let is_whole = |label: f64| label.fract() == 0.0 && label.abs() <= 1e9;
    match map.indexed_iter().find(|(_, label)| !is_whole(**label)) {
        Some(((y, x), label)) => Err(Error::Value(format!(
            "the segment label at row {y}, column {x} is {label}: whole numbers are accepted, and −1 where there is no segment"
        ))),
        None => Ok(map.mapv(|label| label as i32)),
    }
}

/// Samples along a side of a pupil's map.
fn even_side(amplitude: &Array2<f64>) -> Result<usize> {
    let (rows, columns) = amplitude.dim();
    if rows != columns || rows % 2 != 0 {
        return Err(Error::Shape(format!(
            "the pupil map has {columns}x{rows} samples; a square with an even side is needed"
        )));
    }
    Ok(rows)
}

/// Averages a fine map onto a coarser grid with the same axis. A sample belongs to the segment with
/// the largest area in it.
fn binned(fine: &FinePupil, grid: Grid) -> Result<Pupil> {
    let n = grid.samples();
    let cell = |j: usize| {
        let index = fine.grid().coordinate_m(j) / grid.pitch_m() + n as f64 / 2.0;
        (index >= 0.0 && index < n as f64).then_some(index as usize)
    };
    let share = (fine.grid().pitch_m() / grid.pitch_m()).powi(2);
    let mut amplitude = Array2::<f64>::zeros((n, n));
    let mut areas = vec![std::collections::BTreeMap::<i32, f64>::new(); n * n];
    for (((y, x), &a), &label) in fine.pupil().amplitude.indexed_iter().zip(&fine.pupil().owner) {
        if let (Some(v), Some(u), true) = (cell(y), cell(x), label >= 0) {
            amplitude[[v, u]] += a * share;
            *areas[v * n + u].entry(label).or_default() += a;
        }
    }
    // If fine cells do not tile a coarse one exactly, their sum can exceed 1 by a fraction of a
    // cell.
    amplitude.mapv_inplace(|a| a.min(1.0));
    let owner = |areas: &std::collections::BTreeMap<i32, f64>| {
        areas.iter().filter(|(_, a)| **a > 0.0).max_by(|a, b| a.1.total_cmp(b.1)).map_or(-1, |(label, _)| *label)
    };
    let owners = Array2::from_shape_vec((n, n), areas.iter().map(owner).collect())
        .map_err(|error| Error::Internal(error.to_string()))?;
    Ok(Pupil { grid, amplitude, owner: owners, segments: fine.pupil().segments.clone() })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn amplitudes_are_normalised_by_light_or_refused() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let telescope = Telescope::new(&scene.with(&[("pupil.rings", "1")]).unwrap()).unwrap();
        let equal = telescope.clone().with_amplitudes(vec![3.0; 6]).unwrap();
        // Equal areas: equal amplitudes are 1 in any unit, up to rounding.
        assert!(equal.amplitudes().iter().all(|amplitude| (amplitude - 1.0).abs() < 1e-12));
        let refused = |amplitudes: Vec<f64>| match telescope.clone().with_amplitudes(amplitudes) {
            Err(Error::Value(sentence)) => sentence,
            other => panic!("{other:?}"),
        };
        let few = refused(vec![1.0; 5]);
        assert!(few.contains("5 amplitudes") && few.contains("6 segments"), "{few}");
        for (bad, word) in [(0.0, "0"), (-1.0, "-1"), (f64::NAN, "NaN"), (f64::INFINITY, "inf")] {
            let mut amplitudes = vec![1.0; 6];
            amplitudes[4] = bad;
            let sentence = refused(amplitudes);
            assert!(sentence.contains(&format!("amplitude of {word} ")), "{sentence}");
        }
    }
}
