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

pub(crate) mod camera;
mod equations;
mod groups;
mod result;
mod step;
mod whole;

use crate::empirical_bayes::VarianceRule;
use crate::grid::Grid;
use crate::imaging::{CpuChain, Mode, Optics, OpticsParts, SegmentFigure};
use crate::modal::model::{Model, slopes};
use crate::modes::{TiltFrame, circle_zernikes, tilt_frames_of_lit};
use crate::pupil::Pupil;
use crate::scene::{ImageScene, NollRange, ToleranceScene};
use crate::{Error, Result};
use groups::{Columns, Of};
use ndarray::{Array2, ArrayView1, Axis, concatenate};
use std::ops::Range;
use std::sync::Arc;
use whole::WholeBasis;

pub(in crate::modal) use equations::{NormalEquations, OwnEquations};
pub(in crate::modal) use groups::{Group, priors};
pub use result::ModelError;
pub(crate) use result::{SharedFigure, WithLeftOut};
pub(in crate::modal) use step::{Equations, SAME, Step};
pub(crate) use whole::WholeWavefront;

/// Last Zernike, in Noll's order, that is marginalised where the fit ends before it.
const LAST_ZERNIKE: usize = 91;
/// Most figures of segments, three for each.
const MOST_FIGURES: usize = 400;
/// Unit of amplitudes of the light, relative.
const AMPLITUDE_UNIT: f64 = 1e-3;
/// Prior standard deviation of an amplitude before the images say more, and its largest, in units.
const AMPLITUDES: [f64; 2] = [10.0, 100.0];
/// Zernikes, in Noll's order, that patterns of the amplitude of a pupil without segments have,
/// behind those of the illumination.
const LIGHT_ZERNIKES: [usize; 2] = [5, 45];
/// Patterns of the illumination, as the subjects of a sentence.
const ILLUMINATIONS: [&str; 3] = [
    "the slope of the illumination along x",
    "the slope of the illumination along y",
    "the rise of the illumination to the rim",
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
    /// Figures of the segments, unknowns behind the modes.
    figures: Vec<Vec<SegmentFigure>>,
    /// RMS of the smooth surfaces of the whole pupil whose parts on the segments are, but for
    /// pistons, tips and tilts, figures of unit RMS: one of each kind.
    surfaces: [f64; 3],
    /// Patterns of the logarithm of the amplitude, unknowns behind the figures: rows of the basis.
    light: Range<usize>,
    /// Those of the camera come last.
    groups: Vec<Group>,
    /// Maps of these and of the fitted modes.
    whole: Arc<WholeBasis>,
    /// Whether the amplitude of each segment is among the unknowns, behind the patterns.
    has_amplitudes: bool,
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
        let (parts, pupil) = (model.optics.parts(), &model.telescope.pupil);
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
        let has_segments = model.pistons() == segments && segments > 1;
        let (mut own_slopes, mut tilts) = (parts.slopes.clone(), 0..0);
        if has_segments {
            let name = "tips and tilts of the segments";
            if own_slopes.is_none() {
                own_slopes = Some(slopes(&parts.weights, &points, pupil)?);
                let own = (0..segments).map(Mode::Tip).chain((0..segments).map(Mode::Tilt)).collect();
                columns.push(name, own, [3.0, 30.0], (VarianceRule::MostLikely, Of::Tilts));
            } else {
                tilts = segments..model.segment_modes;
                columns.fitted = tilts.len();
                columns.push(name, Vec::new(), [3.0, 30.0], (VarianceRule::MostLikely, Of::FittedTilts));
            }
        }
        if last_zernike > 1 && last_zernike < LAST_ZERNIKE {
            let (xs, ys): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
            let zernikes = circle_zernikes(last_zernike + 1, LAST_ZERNIKE, pupil)?.evaluate(&xs, &ys)?;
            let name = format!("Zernikes {} to {LAST_ZERNIKE}", last_zernike + 1);
            columns.push_rows(name, zernikes, [1.0, 3.0], (VarianceRule::MostLikely, Of::Ncpa));
        }
        let (mut figures, mut surfaces) = (Vec::new(), [0.0; 3]);
        if has_segments {
            let each;
            (each, surfaces) = segment_figures(parts, &points, model)?;
            if 3 * segments <= MOST_FIGURES {
                figures.extend(each.iter().flatten().map(|figure| vec![*figure]));
                let of = (VarianceRule::MostLikely, Of::Figures);
                columns.push_further("figures of the segments", figures.len(), [2.0, 20.0], of);
            }
            // Mirrors are polished and warped in series.
            if tolerance.common_figure_nm > 0.0 {
                figures.extend((0..3).map(|kind| each.iter().map(|own| own[kind]).collect()));
                let of = (VarianceRule::Fixed, Of::AllSegments);
                columns.push_further("figure that all segments share", 3, [tolerance.common_figure_nm; 2], of);
            }
        }
        let first_light = columns.smooth;
        if tolerance.illumination_fraction > 0.0 {
            for name in ILLUMINATIONS {
                columns.push_error(name, tolerance.illumination_fraction);
            }
            columns.push_patterns(illuminations(pupil, &points, tolerance.illumination_fraction));
            if !has_segments {
                let (xs, ys): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
                let [first, last] = LIGHT_ZERNIKES;
                let patterns = circle_zernikes(first, last, pupil)?.evaluate(&xs, &ys)? * AMPLITUDE_UNIT;
                let of = (VarianceRule::MostLikely, Of::Amplitudes);
                columns.push_further("patterns of the light over the pupil", patterns.nrows(), AMPLITUDES, of);
                columns.push_patterns(patterns);
            }
        }
        let light = first_light..columns.smooth;
        let has_amplitudes = has_segments && 3 * segments <= MOST_FIGURES;
        if has_amplitudes {
            let of = (VarianceRule::MostLikely, Of::Amplitudes);
            columns.push_further("amplitudes of the segments", segments, AMPLITUDES, of);
        }
        for (name, tolerance) in camera::errors(tolerance) {
            columns.push_error(name, tolerance);
        }
        let fitted = parts.modes.len() + usize::from(amplitude.is_some());
        let modes: Vec<Mode> = parts.modes.iter().copied().chain(amplitude).chain(columns.modes).collect();
        let count = modes.len();
        let rows: Vec<_> =
            std::iter::once(parts.basis.view()).chain(columns.rows.iter().map(|rows| rows.view())).collect();
        let basis = concatenate(Axis(0), &rows).map_err(|error| Error::Internal(error.to_string()))?;
        let optics = Optics::new(OpticsParts {
            basis,
            modes,
            products: None,
            slopes: own_slopes,
            sampling: parts.sampling,
            wavelength_nm: parts.wavelength_nm,
            colours: parts.colours.clone(),
            pixel: parts.pixel,
            diversity_nm: parts.diversity_nm.clone(),
            weights: parts.weights.clone(),
        })?;
        let (chain, groups) = (CpuChain::new(Arc::new(optics)), columns.groups);
        let whole = Arc::new(WholeBasis::new(model, &groups, &figures, [last_zernike + 1, LAST_ZERNIKE])?);
        let tolerance = tolerance.clone();
        Ok(Self {
            chain,
            fitted,
            tilts,
            modes: count,
            figures,
            surfaces,
            light,
            groups,
            whole,
            has_amplitudes,
            tolerance,
        })
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

    /// The groups of images of the cameras of these names, whose errors come one camera after the
    /// other; none where all have one camera.
    pub(in crate::modal) fn groups_of(&self, cameras: &[String]) -> Vec<Group> {
        if cameras.is_empty() {
            return self.groups.clone();
        }
        let (common, own) = self.groups.split_at(self.groups.len() - self.of_camera().len());
        let each = cameras.iter().enumerate().flat_map(|(number, camera)| {
            own.iter().map(move |group| {
                let Range { start, end } = group.columns;
                let columns = start + number * own.len()..end + number * own.len();
                Group { name: format!("{} ({camera})", group.name), columns, ..group.clone() }
            })
        });
        common.iter().cloned().chain(each).collect()
    }
}

/// Whether all channels have one camera: one wavelength and one sampling.
pub(in crate::modal) fn has_one_camera<'a>(channels: impl IntoIterator<Item = &'a ImageScene>) -> bool {
    let camera = |image: &ImageScene| (image.wavelength_nm, image.samples_per_lambda_over_d);
    let mut cameras = channels.into_iter().map(camera);
    let first = cameras.next();
    cameras.all(|other| Some(other) == first)
}

/// Change of the logarithm of the amplitude by an error `tolerance` of each term of
/// `pupil.illumination_x`, `illumination_y` and `illumination_edge`, of which it is half, at some
/// points, m: `[term, point]`.
fn illuminations(pupil: &Pupil, points: &[(f64, f64)], tolerance: f64) -> Array2<f64> {
    let half_m = 0.5 * pupil.grid.width_m();
    Array2::from_shape_fn((ILLUMINATIONS.len(), points.len()), |(term, point)| {
        let (x, y) = (points[point].0 / half_m, points[point].1 / half_m);
        0.5 * tolerance * [x, y, 2.0 * (x * x + y * y) - 1.0][term]
    })
}

/// Focus and two astigmatisms of every segment, of unit RMS in the mean over all: the same shapes
/// on each, m², so that those of all segments are a smooth shape of the pupil less pistons, tips
/// and tilts.
///
/// They are shapes of the segments, and not maps: of a sample that belongs to several segments each
/// part has its own. As maps, of the brightest segment at each sample, 5 nm of a common figure of
/// JWST were seen to differ from their staircase of 98 nm, by seven standard deviations.
///
/// Behind them the RMS of those smooth shapes, of each kind.
fn segment_figures(
    parts: &OpticsParts,
    points: &[(f64, f64)],
    model: &Model,
) -> Result<(Vec<[SegmentFigure; 3]>, [f64; 3])> {
    let frames = tilt_frames_of_lit(&model.telescope.pupil)?;
    let terms = |frame: &TiltFrame| {
        let [x2, y2] = frame.rms_m().map(|m| m * m);
        [[x2, y2, 0.0, -x2 - y2], [x2, -y2, 0.0, y2 - x2], [0.0, 0.0, 2.0 * (x2 * y2).sqrt(), 0.0]]
    };
    let (mut light, mut squares) = (0.0, [0.0; 3]);
    let mut of_pupil = [[0.0; 2]; 3];
    for ((_, segments, weights), &(x_m, y_m)) in parts.weights.rows().zip(points) {
        let own: f64 = weights.iter().map(|weight| weight * weight).sum();
        let smooth_m2 = [x_m * x_m + y_m * y_m, x_m * x_m - y_m * y_m, 2.0 * x_m * y_m];
        for ([sum, square], m2) in of_pupil.iter_mut().zip(smooth_m2) {
            (*sum, *square) = (*sum + own * m2, *square + own * m2 * m2);
        }
        for (&segment, weight) in segments.iter().zip(weights) {
            let frame = &frames[segment as usize];
            let [x, y] = frame.tilts([x_m, y_m]);
            light += weight * weight;
            for (square, [a, b, c, d]) in squares.iter_mut().zip(terms(frame)) {
                *square += (weight * (a * x * x + b * y * y + c * x * y + d)).powi(2);
            }
        }
    }
    let rms_m2 = squares.map(|square| (square / light).sqrt());
    let of_segment = |(segment, frame): (usize, &TiltFrame)| {
        let terms = terms(frame);
        [0, 1, 2].map(|kind| SegmentFigure { segment, terms: terms[kind].map(|m2| m2 / rms_m2[kind]) })
    };
    let surface = |kind: usize| {
        let [mean, square] = of_pupil[kind].map(|sum| sum / light);
        (square - mean * mean).sqrt() / rms_m2[kind]
    };
    Ok((frames.iter().enumerate().map(of_segment).collect(), [0, 1, 2].map(surface)))
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
