//! What the fitted modes leave out: tips and tilts of the segments, their figures, Zernikes beyond
//! the fitted ones, amplitudes of the segments, errors of the camera. Each has a prior, and not a
//! silence.
//!
//! After the fit one linear Gaussian step marginalises them. With f the fitted modes, l those left
//! out (0 in the fit), H the Gauss-Newton matrix of the images and g = −½ of the gradient by l,
//!
//! ```text
//! S = H_ll − H_lf H_ff⁺ H_fl        l ~ N(0, diag λ), one λ for each group, by empirical Bayes from S and g
//! l̂ = (S + diag 1/λ)⁻¹ g,  C_l      f̂ = f − H_ff⁺ H_fl l̂        C_f = H_ff⁺ + H_ff⁺ H_fl C_l H_lf H_ff⁺
//! ```
//!
//! Tips and tilts that are fitted are among l, with their fitted values in g. So an error bar holds
//! what the images cannot tell from the fitted modes. A figure that all segments share has a prior
//! of its own: with pistons and tilts of the segments it is the same wavefront as a smooth NCPA,
//! and a prior of tilts alone would take one for the other.

mod camera;
mod equations;
mod groups;
mod result;
mod step;

use crate::empirical_bayes::VarianceRule;
use crate::grid::Grid;
use crate::imaging::{CpuChain, Mode, Optics, OpticsParts};
use crate::modal::model::{Model, slopes};
use crate::modes::{circle_zernikes, tilt_frames};
use crate::pupil::Pupil;
use crate::scene::{NollRange, ToleranceScene};
use crate::{Error, Result};
use groups::{Columns, Of};
use ndarray::{Array2, ArrayView1, Axis, concatenate};
use std::ops::Range;
use std::sync::Arc;

pub(in crate::modal) use groups::{Group, priors};
pub use result::ModelError;
pub(crate) use result::{LeftOutTerm, WithLeftOut};
pub(in crate::modal) use step::{Equations, Step};

/// Last Zernike, in Noll's order, that is marginalised where the fit ends before it.
const LAST_ZERNIKE: usize = 91;
/// Most figures of segments, three for each: their maps are on all samples.
const MOST_FIGURES: usize = 400;
/// Unit of the amplitudes of the segments, relative.
const AMPLITUDE_UNIT: f64 = 1e-3;
/// Prior standard deviation of an amplitude before the images say more, and its largest, in units.
const AMPLITUDES: [f64; 2] = [10.0, 100.0];
/// Patterns of the illumination, as the subjects of a sentence.
const ILLUMINATIONS: [&str; 3] = [
    "the slope of the illumination along x",
    "the slope of the illumination along y",
    "the illumination towards the rim",
];
/// Modes that a fit leaves out.
pub(in crate::modal) struct LeftOut {
    /// The model with these modes behind the fitted ones.
    chain: CpuChain<f64>,
    /// Number of the fitted modes, the amplitude of the diversity among them.
    fitted: usize,
    /// Tips and tilts of the segments among the fitted modes.
    tilts: Range<usize>,
    /// Number of all modes.
    modes: usize,
    /// Those of the camera come last.
    groups: Vec<Group>,
    /// Patterns of the illumination over the segments, `[pattern, segment]`, where the amplitudes
    /// of these are among the unknowns.
    illumination: Option<Array2<f64>>,
    tolerance: ToleranceScene,
}

impl LeftOut {
    /// What `model` leaves out; the last of the fitted modes is the amplitude of its diversity,
    /// in nm of `amplitude_unit_nm`, where that is given.
    ///
    /// # Errors
    /// Those of [`Optics::new`].
    pub(in crate::modal) fn new(
        model: &Model,
        last_zernike: usize,
        tolerance: &ToleranceScene,
        amplitude_unit_nm: Option<f64>,
    ) -> Result<Self> {
        let (parts, pupil) = (model.optics.parts().clone(), &model.telescope.pupil);
        let grid = Grid::new(parts.sampling.samples, pupil.grid.width_m() * model.width_ratio())?;
        let samples = grid.samples();
        let point =
            |&cell: &u32| (grid.coordinate_m(cell as usize % samples), grid.coordinate_m(cell as usize / samples));
        let points: Vec<(f64, f64)> = parts.weights.illuminated.iter().map(point).collect();
        let mut columns = Columns { smooth: parts.basis.nrows(), ..Columns::default() };
        let amplitude = amplitude_unit_nm.map(|unit_nm| {
            let diversity = ArrayView1::from(&parts.diversity_nm).to_owned() / unit_nm;
            columns.rows.push(diversity.insert_axis(Axis(0)));
            columns.smooth += 1;
            Mode::Smooth(columns.smooth - 1)
        });
        let segments = pupil.segments.len();
        let (mut own_slopes, mut tilts) = (parts.slopes.clone(), 0..0);
        if model.pistons() == segments && segments > 1 {
            let name = "tips and tilts of the segments";
            if own_slopes.is_none() {
                own_slopes = Some(slopes(&parts.weights, &points, pupil)?);
                let own = (0..segments).map(Mode::Tip).chain((0..segments).map(Mode::Tilt)).collect();
                columns.push(name, own, [3.0, 30.0], (VarianceRule::UniformRms, Of::Tilts));
            } else {
                tilts = segments..model.segment_modes;
                columns.fitted = tilts.len();
                columns.push(name, Vec::new(), [3.0, 30.0], (VarianceRule::UniformRms, Of::FittedTilts));
            }
            let (common, owner) = common_figures(&parts, &points, model)?;
            if 3 * segments <= MOST_FIGURES {
                let figures = Array2::from_shape_fn((3 * segments, points.len()), |(row, sample)| {
                    if owner[sample] == row / 3 { common[[row % 3, sample]] } else { 0.0 }
                });
                columns.push_rows(
                    "figures of the segments",
                    figures,
                    [2.0, 20.0],
                    (VarianceRule::UniformRms, Of::Figures),
                );
            }
            // Mirrors are polished and warped in series.
            if tolerance.common_figure_nm > 0.0 {
                let sizes_nm = [tolerance.common_figure_nm; 2];
                let of = (VarianceRule::Fixed, Of::AllSegments);
                columns.push_rows("figure that all segments share", common, sizes_nm, of);
            }
        }
        if last_zernike > 1 && last_zernike < LAST_ZERNIKE {
            let (xs, ys): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
            let zernikes = circle_zernikes(last_zernike + 1, LAST_ZERNIKE, pupil)?.evaluate(&xs, &ys)?;
            let name = format!("Zernikes {} to {LAST_ZERNIKE}", last_zernike + 1);
            columns.push_rows(name, zernikes, [1.0, 3.0], (VarianceRule::UniformRms, Of::Ncpa));
        }
        let illumination = (model.pistons() == segments && segments > 1 && 3 * segments <= MOST_FIGURES).then(|| {
            columns.push_further(
                "amplitudes of the segments",
                segments,
                AMPLITUDES,
                (VarianceRule::UniformRms, Of::Amplitudes),
            );
            for name in ILLUMINATIONS {
                columns.push_error(name, tolerance.illumination_fraction);
            }
            illumination(pupil)
        });
        for (name, tolerance) in camera::errors(tolerance) {
            columns.push_error(name, tolerance);
        }
        let fitted = parts.modes.len() + usize::from(amplitude.is_some());
        let modes: Vec<Mode> = parts.modes.iter().copied().chain(amplitude).chain(columns.modes).collect();
        let count = modes.len();
        let rows: Vec<_> =
            std::iter::once(parts.basis.view()).chain(columns.rows.iter().map(|rows| rows.view())).collect();
        let basis = concatenate(Axis(0), &rows).map_err(|error| Error::Internal(error.to_string()))?;
        let optics = Optics::new(OpticsParts { basis, modes, products: None, slopes: own_slopes, ..parts })?;
        let (chain, groups) = (CpuChain::new(Arc::new(optics)), columns.groups);
        Ok(Self { chain, fitted, tilts, modes: count, groups, illumination, tolerance: tolerance.clone() })
    }

    /// Number of the unknowns.
    pub(in crate::modal) fn unknowns(&self) -> usize {
        self.fitted + self.groups.last().map_or(0, |group| group.columns.end) - self.tilts.len()
    }

    /// Tips and tilts of the segments among the fitted modes, which have a prior here.
    pub(in crate::modal) fn tilts(&self) -> Range<usize> {
        self.tilts.clone()
    }

    /// The unknowns that are an error of the camera, the last ones.
    pub(in crate::modal) fn of_camera(&self) -> Range<usize> {
        let errors = camera::errors(&self.tolerance).iter().filter(|(_, tolerance)| *tolerance > 0.0).count();
        self.unknowns() - errors..self.unknowns()
    }

    /// The groups of images with several `cameras`, whose errors come one camera after the other.
    pub(in crate::modal) fn groups_of(&self, cameras: &[String]) -> Vec<Group> {
        let (common, own) = self.groups.split_at(self.groups.len() - self.of_camera().len());
        let each = cameras.iter().enumerate().flat_map(|(number, camera)| {
            own.iter().map(move |group| {
                let Range { start, end } = group.columns;
                let columns = start + number * own.len()..end + number * own.len();
                let name = if camera.is_empty() { group.name.clone() } else { format!("{} ({camera})", group.name) };
                Group { name, columns, ..group.clone() }
            })
        });
        common.iter().cloned().chain(each).collect()
    }
}

/// Slopes along x and y, and squares of the distance from the centre, of the segments' centres, at
/// most 1: `[pattern, segment]`.
fn illumination(pupil: &Pupil) -> Array2<f64> {
    let radius_m = pupil.segments.iter().map(|segment| segment.x_m.hypot(segment.y_m)).fold(0.0, f64::max);
    Array2::from_shape_fn((ILLUMINATIONS.len(), pupil.segments.len()), |(pattern, segment)| {
        let [x, y] = [pupil.segments[segment].x_m, pupil.segments[segment].y_m].map(|m| m / radius_m);
        [x, y, x * x + y * y][pattern]
    })
}

/// Focus and two astigmatisms of every segment, of unit RMS over each, `[figure, sample]`, and the
/// segment of each sample: that with most of its light.
fn common_figures(parts: &OpticsParts, points: &[(f64, f64)], model: &Model) -> Result<(Array2<f64>, Vec<usize>)> {
    let frames = tilt_frames(&model.telescope.pupil)?;
    let brightest = |segments: &[u32], weights: &[f64]| {
        let entries = segments.iter().zip(weights).map(|(&segment, weight)| (segment as usize, weight * weight));
        entries.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0))
    };
    let owner: Vec<(usize, f64)> = parts.weights.rows().map(|(_, of, weights)| brightest(of, weights)).collect();
    let mut figures = Array2::from_shape_fn((3, points.len()), |(kind, sample)| {
        let [x, y] = frames[owner[sample].0].tilts(points[sample].into());
        [x * x + y * y, x * x - y * y, 2.0 * x * y][kind]
    });
    for mut figure in figures.outer_iter_mut() {
        // Light, and means over it of the figure and of its square.
        let mut sums = vec![[0.0; 3]; frames.len()];
        for (&(segment, light), value) in owner.iter().zip(&figure) {
            let terms = [light, light * value, light * value * value];
            sums[segment].iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        for (&(segment, _), value) in owner.iter().zip(&mut figure) {
            let [light, mean, square] = sums[segment];
            let variance = square / light - (mean / light).powi(2);
            *value = if variance > 0.0 { (*value - mean / light) / variance.sqrt() } else { 0.0 };
        }
    }
    Ok((figures, owner.into_iter().map(|(segment, _)| segment).collect()))
}

/// The last Zernike, in Noll's order, that the exact ones or those with a prior of a recipe end
/// with; 0 where it has none.
pub(in crate::modal) fn last_zernike(ranges: [NollRange; 2]) -> usize {
    let last = |range: NollRange| match range {
        NollRange::None => 0,
        NollRange::Span { last, .. } => last,
    };
    ranges.map(last).into_iter().max().unwrap_or(0)
}
