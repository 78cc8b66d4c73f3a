//! What a scene says of the telescope, built: its pupil on any grid, how a model samples it, its mirror, its air.
//!
//! Shared by whatever makes images and whatever reads them, so that both mean the same telescope; how each samples it
//! is its own affair.

use crate::grid::Grid;
use crate::io;
use crate::modes::{InfluenceFunctions, Mirror, VonKarman};
use crate::pupil::{Aperture, BandLimit, FinePupil, HexagonalParameters, Pupil, SegmentWeights};
use crate::scene::{Aperture as SceneAperture, PupilModel, Purpose, Scene};
use crate::{Error, Result};
use ndarray::Array2;

/// Samples a side on which the moments of a geometric pupil are taken: their error falls as the square of the pitch,
/// from 1e-4 at 120 samples.
const FINE_SAMPLES: usize = 960;

/// Where the glass is known from.
enum Glass {
    /// Geometry: exact on any grid.
    Exact(Aperture),
    /// Maps finer than the model's grid.
    Fine(FinePupil),
    /// Maps on the model's own grid, used as they are.
    Coarse,
}

/// The telescope of a scene, on the scene's grid.
pub struct Telescope {
    /// The pupil on the scene's grid (`pupil.samples` over `pupil.grid_m`), on which maps are reported.
    pub pupil: Pupil,
    glass: Glass,
}

impl Telescope {
    /// Builds the telescope of `scene`, reading its pupil's file if it names one.
    ///
    /// # Errors
    /// [`Error::File`] for a pupil file that cannot be read, [`Error::Value`] or [`Error::Shape`] for an impossible one.
    pub fn of(scene: &Scene) -> Result<Self> {
        if scene.purpose() == Purpose::Arrays {
            let name = scene.name();
            return Err(Error::Scene(format!("{name}: its pupil is an array of the caller's, which is needed here")));
        }
        if let SceneAperture::File(file) = &scene.pupil.aperture {
            return Self::from_file(scene, &scene.resolve(file));
        }
        let pupil = &scene.pupil;
        let aperture = Aperture::hexagonal(&HexagonalParameters {
            rings: pupil.rings,
            segment_side_m: pupil.segment_side_m,
            gap_m: pupil.segment_gap_m,
            central_segment: pupil.central_segment,
            obscuration_diameter_m: pupil.central_obscuration_m,
            spider_width_m: pupil.spider_width_m,
            spider_angles_deg: if pupil.spider_width_m > 0.0 { pupil.spider_angles_deg.clone() } else { Vec::new() },
        })?;
        let grid = Grid::new(pupil.samples, pupil.grid_m.unwrap_or(aperture.width_m()))?;
        Ok(Self { pupil: aperture.pupil(&grid)?, glass: Glass::Exact(aperture) })
    }

    fn from_file(scene: &Scene, path: &std::path::Path) -> Result<Self> {
        let mut file = io::FitsReader::open(path)?;
        let named =
            |file: &io::FitsReader, name: &str| file.names().iter().any(|n| n == name).then(|| name.to_string());
        let amplitude_name = named(&file, "PUPIL");
        let amplitude = file.map(amplitude_name.as_deref())?;
        let labels = match named(&file, "SEGMENT") {
            Some(name) => Some(file.map(Some(&name))?.mapv(|label| label as i32)),
            None => None,
        };
        let in_file = |error: Error| Error::file(path, error);
        let size = even_side(&amplitude).map_err(in_file)?;
        let width_m = scene.pupil.grid_m.ok_or_else(|| Error::Scene("'pupil.grid_m' is missing".into()))?;
        if size >= 2 * scene.pupil.samples && scene.pupil.model != Some(PupilModel::Hard) {
            let fine = FinePupil::new(Grid::new(size, width_m)?, amplitude, labels).map_err(in_file)?;
            let pupil = binned(&fine, Grid::new(scene.pupil.samples, width_m)?)?;
            return Ok(Self { pupil, glass: Glass::Fine(fine) });
        }
        Self::from_maps(width_m, amplitude, labels).map_err(in_file)
    }

    /// A telescope of maps `[y, x]` over `width_m`, on their own grid: see [`Pupil::from_maps`].
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that are not square with an even side, and those of [`Pupil::from_maps`].
    pub fn from_maps(width_m: f64, amplitude: Array2<f64>, labels: Option<Array2<i32>>) -> Result<Self> {
        let grid = Grid::new(even_side(&amplitude)?, width_m)?;
        Ok(Self { pupil: Pupil::from_maps(grid, amplitude, labels)?, glass: Glass::Coarse })
    }

    /// Whether the pupil is known finely enough to be band-limited.
    pub fn is_fine(&self) -> bool {
        !matches!(self.glass, Glass::Coarse)
    }

    /// The pupil on another grid: exact or averaged; a coarse map has only its own.
    ///
    /// # Errors
    /// [`Error::Value`] where a coarse map is asked for another grid.
    pub fn pupil_on(&self, grid: Grid) -> Result<Pupil> {
        match &self.glass {
            _ if grid == self.pupil.grid => Ok(self.pupil.clone()),
            Glass::Exact(aperture) => aperture.pupil(&grid),
            Glass::Fine(fine) if grid == *fine.grid() => Ok(fine.pupil().clone()),
            Glass::Fine(fine) if fine.resolves(&grid) => binned(fine, grid),
            _ => Err(Error::Value(format!(
                "the pupil is a map of {} samples a side and cannot be refined to {}",
                self.pupil.grid.samples(),
                grid.samples()
            ))),
        }
    }

    /// Samples a side on which a truth is made unless the scene says otherwise: 8 times the scene's where the geometry
    /// is exact, those of the map where there is one.
    pub fn truth_samples(&self) -> usize {
        match &self.glass {
            Glass::Exact(_) => 8 * self.pupil.grid.samples(),
            Glass::Fine(fine) => fine.grid().samples(),
            Glass::Coarse => self.pupil.grid.samples(),
        }
    }

    /// The pupil as finely as it is known; exact geometry on a grid on which its moments are good to 1e-6.
    fn finest_pupil(&self) -> Result<Pupil> {
        match &self.glass {
            Glass::Exact(_) => self.pupil_on(Grid::new(FINE_SAMPLES, self.pupil.grid.width_m())?),
            Glass::Fine(fine) => Ok(fine.pupil().clone()),
            Glass::Coarse => Ok(self.pupil.clone()),
        }
    }

    /// How the segments show in the samples of `grid` when edges are not filtered: by exact area where the geometry is
    /// known, by the owner of each sample elsewhere.
    ///
    /// # Errors
    /// As [`Telescope::pupil_on`].
    pub fn area_weights(&self, grid: Grid) -> Result<SegmentWeights> {
        match &self.glass {
            Glass::Exact(aperture) => SegmentWeights::area(aperture, &grid),
            _ => Ok(SegmentWeights::hard(&self.pupil_on(grid)?)),
        }
    }

    /// Low-passed weights on `grid`.
    ///
    /// # Errors
    /// [`Error::Value`] for a coarse pupil map, or an impossible `limit`.
    pub fn band_limited_weights(&self, grid: Grid, limit: &BandLimit) -> Result<SegmentWeights> {
        match &self.glass {
            Glass::Exact(aperture) => SegmentWeights::band_limited(aperture, &grid, limit),
            Glass::Fine(fine) => SegmentWeights::band_limited_maps(fine, &grid, limit),
            Glass::Coarse => Err(Error::Value("a coarse pupil map cannot be band-limited: give a finer one".into())),
        }
    }

    /// The influence functions of the scene's mirror that matter on this pupil.
    ///
    /// # Errors
    /// Those of [`Mirror::new`] and [`Mirror::near`].
    pub fn influence(&self, scene: &Scene) -> Result<InfluenceFunctions> {
        Mirror::new(scene.mirror.actuators_across, scene.mirror.pitch_m, scene.mirror.coupling)?
            .near(&self.pupil, Mirror::DEFAULT_MARGIN_PITCHES)
    }

    /// The statistics of the scene's turbulence.
    ///
    /// # Errors
    /// Those of [`VonKarman::new`].
    pub fn turbulence(scene: &Scene) -> Result<VonKarman> {
        VonKarman::new(scene.turbulence.r0_m, scene.turbulence.outer_scale_m)
    }
}

/// Samples along a side of a pupil's map.
fn even_side(amplitude: &Array2<f64>) -> Result<usize> {
    let (rows, columns) = amplitude.dim();
    if rows != columns || rows % 2 != 0 {
        return Err(Error::Shape(format!(
            "the pupil has {columns}x{rows} samples; a square with an even side is needed"
        )));
    }
    Ok(rows)
}

/// A fine map averaged onto a coarser grid over the same axis; a sample belongs to the segment with most glass in it.
fn binned(fine: &FinePupil, grid: Grid) -> Result<Pupil> {
    let n = grid.samples();
    let cell = |j: usize| {
        let index = fine.grid().coordinate_m(j) / grid.pitch_m() + n as f64 / 2.0;
        (index >= 0.0 && index < n as f64).then_some(index as usize)
    };
    let share = (fine.grid().pitch_m() / grid.pitch_m()).powi(2);
    let mut amplitude = Array2::<f64>::zeros((n, n));
    let mut glass = vec![std::collections::BTreeMap::<i32, f64>::new(); n * n];
    for (((y, x), &a), &label) in fine.pupil().amplitude.indexed_iter().zip(&fine.pupil().owner) {
        if let (Some(v), Some(u), true) = (cell(y), cell(x), label >= 0) {
            amplitude[[v, u]] += a * share;
            *glass[v * n + u].entry(label).or_default() += a;
        }
    }
    // Fine cells that do not tile a coarse one exactly can overfill it by a fraction of a cell.
    amplitude.mapv_inplace(|a| a.min(1.0));
    let owner = |glass: &std::collections::BTreeMap<i32, f64>| {
        glass.iter().filter(|(_, a)| **a > 0.0).max_by(|a, b| a.1.total_cmp(b.1)).map_or(-1, |(label, _)| *label)
    };
    let owners = Array2::from_shape_vec((n, n), glass.iter().map(owner).collect())
        .map_err(|error| Error::Internal(error.to_string()))?;
    Ok(Pupil { grid, amplitude, owner: owners, segments: fine.pupil().segments.clone() })
}

/// A map over the pupil grid's width that can be read at any point.
pub struct MapOnGrid {
    values: Array2<f64>,
    width_m: f64,
}

impl MapOnGrid {
    /// A map `[y, x]` whose samples tile `width_m`; values that are not finite count as 0.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map that is not square.
    pub fn new(values: Array2<f64>, width_m: f64) -> Result<Self> {
        if values.nrows() != values.ncols() || values.is_empty() {
            let (rows, columns) = values.dim();
            return Err(Error::Shape(format!("a map over the pupil has {columns}x{rows} samples; a square is needed")));
        }
        Ok(Self { values: values.mapv(|v| if v.is_finite() { v } else { 0.0 }), width_m })
    }

    /// Samples along a side.
    pub fn samples(&self) -> usize {
        self.values.nrows()
    }

    /// Bilinear interpolation at (x, y), m; beyond the outermost samples, their values.
    pub fn at(&self, x_m: f64, y_m: f64) -> f64 {
        let n = self.values.nrows();
        let index = |c: f64| (c / self.width_m * n as f64 + (n as f64 - 1.0) / 2.0).clamp(0.0, n as f64 - 1.0);
        let (x, y) = (index(x_m), index(y_m));
        let (u, v) = ((x as usize).min(n.saturating_sub(2)), (y as usize).min(n.saturating_sub(2)));
        let (right, up) = ((u + 1).min(n - 1), (v + 1).min(n - 1));
        let (fx, fy) = (x - u as f64, y - v as f64);
        let row = |v: usize| self.values[[v, u]] * (1.0 - fx) + self.values[[v, right]] * fx;
        row(v) * (1.0 - fy) + row(up) * fy
    }
}

/// The diversity of a scene, known at any point of the pupil plane.
pub enum Diversity {
    /// `factor·(x² + y²) + offset`, nm.
    Focus {
        /// nm per m².
        factor_nm_m2: f64,
        /// nm.
        offset_nm: f64,
    },
    /// A map.
    Map(MapOnGrid),
}

impl Diversity {
    /// The diversity of `scene`: focus of the stated RMS over the pupil (weight A, zero mean, positive at the edge), or
    /// the map of its file.
    ///
    /// The RMS is that of the finest pupil that is known, not of the scene's grid: 120 samples and 108 would differ by
    /// 1e-4 of it, which an estimate would show as 0.3 nm of focus.
    ///
    /// # Errors
    /// [`Error::File`] for a map that cannot be read.
    pub fn of(scene: &Scene, telescope: &Telescope) -> Result<Self> {
        let pupil = &telescope.pupil;
        if let Some(file) = &scene.image.diversity_file {
            let path = scene.resolve(file);
            let values = io::read_map(&path, None)?;
            return Ok(Self::Map(MapOnGrid::new(values, pupil.grid.width_m()).map_err(|e| Error::file(&path, e))?));
        }
        let pupil = telescope.finest_pupil()?;
        let (mut weight, mut mean, mut square) = (0.0, 0.0, 0.0);
        for ((y, x), &a) in pupil.amplitude.indexed_iter() {
            let r2 = pupil.grid.coordinate_m(x).powi(2) + pupil.grid.coordinate_m(y).powi(2);
            (weight, mean, square) = (weight + a, mean + a * r2, square + a * r2 * r2);
        }
        let (mean, square) = (mean / weight, square / weight);
        let rms_nm = scene.image.diversity_focus_waves_rms * scene.image.wavelength_nm;
        let factor_nm_m2 = rms_nm / (square - mean * mean).sqrt();
        Ok(Self::Focus { factor_nm_m2, offset_nm: -factor_nm_m2 * mean })
    }

    /// Its value at (x, y) m, nm.
    pub fn at(&self, x_m: f64, y_m: f64) -> f64 {
        match self {
            Self::Focus { factor_nm_m2, offset_nm } => factor_nm_m2 * (x_m * x_m + y_m * y_m) + offset_nm,
            Self::Map(map) => map.at(x_m, y_m),
        }
    }

    /// Steepest slope over the pupil, nm/m: it says how far the light spreads. Differences across the pupil's edge do not
    /// count: a map may be anything outside.
    pub fn steepest_nm_m(&self, pupil: &Pupil) -> f64 {
        let (grid, last) = (&pupil.grid, pupil.grid.samples() - 1);
        let lit = |y: usize, x: usize| pupil.amplitude[[y, x]] > 0.0;
        let value = |y: usize, x: usize| self.at(grid.coordinate_m(x), grid.coordinate_m(y));
        let mut steepest = 0.0f64;
        for y in 1..last {
            for x in 1..last {
                if lit(y, x) && lit(y, x - 1) && lit(y, x + 1) && lit(y - 1, x) && lit(y + 1, x) {
                    let along_x = value(y, x + 1) - value(y, x - 1);
                    let along_y = value(y + 1, x) - value(y - 1, x);
                    steepest = steepest.max(along_x.hypot(along_y) / (2.0 * grid.pitch_m()));
                }
            }
        }
        steepest
    }

    /// Half-width of the spot that it makes of a point, by geometry, λ over the width of the grid of `pupil`.
    pub fn spot(&self, pupil: &Pupil, wavelength_nm: f64) -> f64 {
        self.steepest_nm_m(pupil) * pupil.grid.width_m() / wavelength_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_focus_has_the_stated_rms_and_no_mean_over_the_pupil() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let telescope = Telescope::of(&scene).unwrap();
        let diversity = Diversity::of(&scene, &telescope).unwrap();
        // On a grid that shares no sample with the one it was normalised on.
        let pupil = telescope.pupil_on(Grid::new(700, 10.95).unwrap()).unwrap();
        let grid = pupil.grid;
        let map = Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| {
            diversity.at(grid.coordinate_m(x), grid.coordinate_m(y))
        });
        let mean = (&map * &pupil.amplitude).sum() / pupil.weight_sum();
        // Moments on 700 samples are good to a few parts in 10⁶ (1e-4 at 120, falling as the square of the pitch).
        assert_relative_eq!(pupil.rms(map.view()).unwrap(), 1.5 * 2168.6, max_relative = 1e-5);
        assert!(mean.abs() < 1e-5 * 1.5 * 2168.6, "{mean}");
        assert!(diversity.at(5.0, 0.0) > 0.0 && diversity.at(0.0, 0.0) < 0.0);
    }

    #[test]
    fn a_map_is_read_between_its_samples_and_held_beyond_them() {
        let plane = |x: f64, y: f64| 3.0 + 2.0 * x - y;
        let grid = Grid::new(6, 3.0).unwrap();
        let values = Array2::from_shape_fn((6, 6), |(y, x)| plane(grid.coordinate_m(x), grid.coordinate_m(y)));
        let map = MapOnGrid::new(values, 3.0).unwrap();
        for (x, y) in [(0.0, 0.0), (0.31, -0.9), (1.25, 1.25), (-1.2, 0.7)] {
            assert_relative_eq!(map.at(x, y), plane(x, y), max_relative = 1e-14);
        }
        assert_relative_eq!(map.at(9.0, 0.25), plane(1.25, 0.25), max_relative = 1e-14);
        assert!(MapOnGrid::new(Array2::zeros((3, 4)), 1.0).is_err());
    }
}
