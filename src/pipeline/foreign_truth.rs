//! Truth of another program: a piston for each segment, or maps on grids of their own.
//!
//! Two programs do not agree on the samples at an edge: which segment owns one, what a map holds
//! beyond the illuminated area. With maps, such samples are left out: a sample counts where all
//! points around it, as far as the interpolation of the map reaches, are of its segment (for a map
//! of NCPA: are illuminated). The points are those of a pupil on a finer grid, so that on the
//! estimate's own grid only samples are left out whose centre is on an edge.

use super::estimate::check_on_pupil;
use super::images::counted;
use crate::modal::StaticMaps;
use crate::pupil::Pupil;
use crate::telescope::{OpdMap, Telescope};
use crate::{Error, Result};
use ndarray::Array2;

/// Least share of the pupil's light in the samples that are compared.
const LEAST_SHARE: f64 = 0.3;
/// Largest share of the light of these samples at which a map may have no value, as another program
/// may have its own obscuration.
const MOST_MISSING: f64 = 0.05;

/// Truth of another program, as far as it is known.
#[derive(Debug, Clone, Default)]
pub struct ForeignTruth {
    /// Piston of each segment, nm: in place of a map of the segment errors.
    pub pistons_nm: Option<Vec<f64>>,
    /// Segment errors.
    pub phasing: Option<OpdMap>,
    /// Non-common path aberrations.
    pub ncpa: Option<OpdMap>,
    /// The whole wavefront; with cards of the segments, their pistons and tilts are the segment
    /// errors and the map is the NCPA.
    pub wavefront: Option<OpdMap>,
}

/// Estimate minus truth, piston, tip and tilt removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForeignComparison {
    /// RMS of the residual of phasing, NCPA and their sum, nm; `None` where the truth does not have
    /// it.
    pub rms_nm: [Option<f64>; 3],
    /// Illuminated samples of the pupil.
    pub samples: usize,
    /// Those among them that were left out.
    pub left_out: usize,
}

/// A truth on the grid of the estimate, nm, NaN where it has no value.
struct Part {
    values_nm: Array2<f64>,
    /// Distance to the farthest sample of its map that a value is interpolated from, along rows and
    /// columns, m; `None` for what has no map.
    reach_m: Option<f64>,
    /// Whether it changes from segment to segment.
    is_stepped: bool,
}

impl Part {
    /// The map on the grid of `pupil`, interpolated bilinearly where it has another.
    fn of_map(name: &str, map: &OpdMap, pupil: &Pupil, is_stepped: bool) -> Result<Self> {
        let (grid, samples) = (&pupil.grid, map.values_nm.ncols());
        let width_m = map.width_m.unwrap_or(grid.width_m());
        // A card may have been rounded to single precision.
        if samples == grid.samples() && (width_m / grid.width_m() - 1.0).abs() < 1e-6 {
            return Ok(Self { values_nm: map.values_nm.clone(), reach_m: Some(0.0), is_stepped });
        }
        let within = |error| Error::Value(format!("{name}: {error}"));
        let values_nm = map.on_width(grid.width_m()).map_err(within)?;
        let missing = OpdMap { values_nm: map.values_nm.mapv(|nm| f64::from(!nm.is_finite())), ..map.clone() };
        let missing = missing.on_width(grid.width_m())?;
        let at = |(row, column): (usize, usize)| {
            let (x_m, y_m) = (grid.coordinate_m(column), grid.coordinate_m(row));
            let is_known = x_m.abs().max(y_m.abs()) <= width_m / 2.0 && missing.at(x_m, y_m) == 0.0;
            if is_known { values_nm.at(x_m, y_m) } else { f64::NAN }
        };
        let values_nm = Array2::from_shape_fn(pupil.amplitude.dim(), at);
        Ok(Self { values_nm, reach_m: Some(width_m / samples as f64), is_stepped })
    }

    /// Pistons, and slopes about the centre, of the segments of `pupil`.
    fn of_segments(pupil: &Pupil, nm: impl Fn(usize, f64, f64) -> f64) -> Self {
        let mut values_nm = Array2::from_elem(pupil.owner.dim(), f64::NAN);
        for ((row, column), segment) in pupil.owned_samples() {
            let centre = pupil.segments[segment];
            let [x_m, y_m] = [pupil.grid.coordinate_m(column) - centre.x_m, pupil.grid.coordinate_m(row) - centre.y_m];
            values_nm[[row, column]] = nm(segment, x_m, y_m);
        }
        Self { values_nm, reach_m: None, is_stepped: true }
    }
}

impl ForeignTruth {
    /// Phasing, NCPA and the whole wavefront, as far as they are known.
    fn parts(&self, pupil: &Pupil) -> Result<[Option<Part>; 3]> {
        let mapped = |name: &str, map: &Option<OpdMap>, is_stepped: bool| {
            map.as_ref().map(|map| Part::of_map(name, map, pupil, is_stepped)).transpose()
        };
        let mut phasing = mapped("the true phasing", &self.phasing, true)?;
        if let Some(pistons_nm) = &self.pistons_nm {
            let (given, needed) = (pistons_nm.len(), pupil.segments.len());
            if given != needed {
                return Err(Error::Shape(format!(
                    "{given} true pistons are given for {needed} segments: one each is needed"
                )));
            }
            phasing = Some(Part::of_segments(pupil, |segment, _, _| pistons_nm[segment]));
        }
        let mut ncpa = mapped("the true NCPA", &self.ncpa, false)?;
        let mut wavefront = None;
        if let Some(map) = &self.wavefront {
            let part = Part::of_map("the true wavefront", map, pupil, true)?;
            match map.segment_planes(pupil)? {
                Some(planes) => {
                    phasing = Some(Part::of_segments(pupil, |segment, x_m, y_m| {
                        let [piston_nm, along_x, along_y] = planes[segment];
                        piston_nm + along_x * x_m + along_y * y_m
                    }));
                    ncpa = Some(part);
                }
                None => wavefront = Some(part),
            }
        }
        Ok([phasing, ncpa, wavefront])
    }

    /// Compares the `maps` of an estimate on the grid of `telescope` with the truth.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] for maps, pistons or cards of another number of samples
    /// or segments; [`Error::Value`] where the samples that can be compared have less than 30 % of
    /// the light, and for a map that has no value at more than 5 % of it.
    pub fn compare(&self, telescope: &Telescope, maps: &StaticMaps) -> Result<ForeignComparison> {
        let pupil = &telescope.pupil;
        check_on_pupil(pupil, "the estimate's", maps)?;
        let [phasing, ncpa, wavefront] = self.parts(pupil)?;
        let parts = || [&phasing, &ncpa, &wavefront].into_iter().flatten();
        let mut inner = pupil.clone();
        let fine = telescope.finer_pupil()?;
        for part in parts() {
            if let Some(reach_m) = part.reach_m {
                leave_out(&mut inner, |at| !is_clear(pupil, &fine, at, reach_m, part.is_stepped));
            }
        }
        let count = |pupil: &Pupil| pupil.amplitude.iter().filter(|amplitude| **amplitude > 0.0).count();
        let (samples, clear) = (count(pupil), inner.weight_sum());
        if clear < LEAST_SHARE * pupil.weight_sum() {
            return Err(Error::Value(format!(
                "{} of {samples} samples of the pupil are at an edge for maps this coarse: finer maps of the truth are needed",
                samples - count(&inner)
            )));
        }
        let at_edges = samples - count(&inner);
        leave_out(&mut inner, |at| parts().any(|part| !part.values_nm[at].is_finite()));
        let left_out = samples - count(&inner);
        if inner.weight_sum() < (1.0 - MOST_MISSING) * clear {
            return Err(Error::Value(format!(
                "the truth has no value at {} of the {samples} samples of the estimate's pupil, edges apart: maps of the same pupil are \
                 needed, in the same orientation",
                left_out - at_edges
            )));
        }
        let residual_nm = |map_nm: &Array2<f64>, part: &Option<Part>| -> Result<Option<Array2<f64>>> {
            let Some(part) = part else { return Ok(None) };
            let mut off_nm = map_nm - &part.values_nm;
            off_nm.zip_mut_with(&inner.amplitude, |nm, amplitude| *nm = if *amplitude > 0.0 { *nm } else { f64::NAN });
            inner.remove_piston_tip_tilt(off_nm.view()).map(Some)
        };
        let (phasing, ncpa) = (residual_nm(&maps.phasing_nm, &phasing)?, residual_nm(&maps.ncpa_nm, &ncpa)?);
        let sum = phasing.as_ref().zip(ncpa.as_ref()).map(|(phasing, ncpa)| phasing + ncpa);
        let whole = match sum {
            None => residual_nm(&maps.wavefront_nm(), &wavefront)?,
            sum => sum,
        };
        let rms = |map: Option<Array2<f64>>| map.map(|map| inner.rms(map.view())).transpose();
        Ok(ForeignComparison { rms_nm: [rms(phasing)?, rms(ncpa)?, rms(whole)?], samples, left_out })
    }
}

impl ForeignComparison {
    /// Sentence on the samples that were left out; `None` where all were compared.
    pub fn remark(&self) -> Option<String> {
        let (left_out, samples) = (self.left_out, counted(self.samples, "sample"));
        let verb = if left_out == 1 { "is" } else { "are" };
        (left_out > 0).then(|| {
            format!("{left_out} of {samples} {verb} left out: at an edge, where two programs may differ on the segment, or without a value")
        })
    }
}

/// Takes the illuminated samples that `is_out` names out of `pupil`.
fn leave_out(pupil: &mut Pupil, is_out: impl Fn([usize; 2]) -> bool) {
    for ((row, column), amplitude) in pupil.amplitude.indexed_iter_mut() {
        if *amplitude > 0.0 && is_out([row, column]) {
            *amplitude = 0.0;
        }
    }
}

/// Whether all samples of `fine` as far as `reach_m` along rows and columns, and the nearest in any
/// case, are illuminated, and of the segment of the sample `at` of `pupil` for a part that changes
/// from segment to segment.
fn is_clear(pupil: &Pupil, fine: &Pupil, at: [usize; 2], reach_m: f64, is_stepped: bool) -> bool {
    let (grid, owner) = (&fine.grid, pupil.owner[at]);
    // Half a sample reaches the nearest, between which a sample of a coarser grid may lie.
    let reach = reach_m / grid.pitch_m() + 0.51;
    let around = |index: usize| {
        let centre = pupil.grid.coordinate_m(index) / grid.pitch_m() + (grid.samples() as f64 - 1.0) / 2.0;
        let (low, high) = ((centre - reach).ceil(), (centre + reach).floor());
        (low >= 0.0 && high < grid.samples() as f64).then_some(low as usize..high as usize + 1)
    };
    let (Some(rows), Some(columns)) = (around(at[0]), around(at[1])) else { return false };
    rows.into_iter().all(|row| {
        columns.clone().all(|column| match fine.owner[[row, column]] {
            found if is_stepped => found == owner,
            found => found >= 0,
        })
    })
}
