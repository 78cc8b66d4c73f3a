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

use crate::empirical_bayes::{CoefficientGroup, Posterior, VarianceRule, maximise_marginal_likelihood};
use crate::grid::Grid;
use crate::imaging::{CpuChain, LinearModel, Mode, Optics, OpticsParts};
use crate::modal::assess::fisher::{Sensitivity, null_floor, pseudo_inverse};
use crate::modal::assess::residual::photometry;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::model::{Model, slopes};
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::modes::{circle_zernikes, tilt_frames};
use crate::pupil::Pupil;
use crate::scene::{NollRange, ToleranceScene};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, concatenate, s};
use std::ops::Range;
use std::sync::Arc;

/// Last Zernike, in Noll's order, that is marginalised where the fit ends before it.
const LAST_ZERNIKE: usize = 91;
/// Most figures of segments, three for each: their maps are on all samples.
const MOST_FIGURES: usize = 400;
/// Smallest prior standard deviation, in the unit of a group: far below what an image at a peak S/N
/// of 1,000 shows of a mode, so that it adds nothing to an error bar.
const LEAST: f64 = 1e-3;
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
/// Standard deviations from which an error is named: of twelve, one is beyond by chance in one
/// estimate of 1,000.
const SIGNIFICANT: f64 = 4.0;
/// Share of the tolerance from which it is: at a peak S/N of 500 the approximations of the model
/// are a tenth of that of the response.
const REMARKABLE: f64 = 0.25;

/// Modes that a fit leaves out.
pub(in crate::modal) struct LeftOut {
    /// The model with these modes behind the fitted ones.
    chain: CpuChain<f64>,
    /// Number of the fitted modes.
    fitted: usize,
    /// Tips and tilts of the segments among the fitted modes.
    tilts: Range<usize>,
    /// Number of all modes.
    modes: usize,
    groups: Vec<Group>,
    /// Patterns of the illumination over the segments, `[pattern, segment]`, where the amplitudes
    /// of these are among the unknowns.
    illumination: Option<Array2<f64>>,
    tolerance: ToleranceScene,
}

/// Unknowns with one prior variance.
struct Group {
    name: String,
    columns: Range<usize>,
    /// Standard deviation of one, where the search begins: nm for modes.
    rms: f64,
    /// Largest one.
    largest: f64,
    rule: VarianceRule,
    of: Of,
}

/// What the modes of a group are of, in order.
#[derive(Debug, Clone, Copy)]
enum Of {
    /// Each segment, along x, and then each along y.
    Tilts,
    /// The same, which are among the fitted modes.
    FittedTilts,
    /// Three of each segment, one segment after the other.
    Figures,
    /// All segments.
    AllSegments,
    Ncpa,
    /// Amplitudes of the segments.
    Amplitudes,
    /// An error of the optics or the camera, in units of this tolerance.
    Tolerance(f64),
}

/// Modes that are marginalised, before they are modes of a chain.
#[derive(Default)]
struct Columns {
    modes: Vec<Mode>,
    groups: Vec<Group>,
    /// Smooth modes at the illuminated samples, `[mode, sample]`.
    rows: Vec<Array2<f64>>,
    /// Number of smooth modes.
    smooth: usize,
    /// Number of modes with a prior that are fitted.
    fitted: usize,
    /// Number of unknowns that are no modes, which come last.
    further: usize,
}

impl Columns {
    fn push(
        &mut self,
        name: impl Into<String>,
        modes: Vec<Mode>,
        [rms, largest]: [f64; 2],
        (rule, of): (VarianceRule, Of),
    ) {
        // Fitted ones come first, and are modes of the chain already.
        let first = if self.groups.is_empty() { 0 } else { self.fitted + self.modes.len() };
        self.modes.extend(modes);
        self.groups.push(Group {
            name: name.into(),
            columns: first..self.fitted + self.modes.len(),
            rms,
            largest,
            rule,
            of,
        });
    }

    /// Adds an error with this tolerance, where it has one.
    fn push_error(&mut self, name: &str, tolerance: f64) {
        if tolerance > 0.0 {
            self.push_further(name, 1, [1.0, 1.0], (VarianceRule::Fixed, Of::Tolerance(tolerance)));
        }
    }

    /// Adds unknowns that are no modes, behind all of these.
    fn push_further(&mut self, name: &str, count: usize, [rms, largest]: [f64; 2], (rule, of): (VarianceRule, Of)) {
        let first = self.fitted + self.modes.len() + self.further;
        self.further += count;
        self.groups.push(Group { name: name.into(), columns: first..first + count, rms, largest, rule, of });
    }

    fn push_rows(&mut self, name: impl Into<String>, rows: Array2<f64>, sizes_nm: [f64; 2], rule: (VarianceRule, Of)) {
        let modes = (self.smooth..self.smooth + rows.nrows()).map(Mode::Smooth).collect();
        self.smooth += rows.nrows();
        self.rows.push(rows);
        self.push(name, modes, sizes_nm, rule);
    }
}

impl LeftOut {
    /// What `model` leaves out.
    ///
    /// # Errors
    /// Those of [`Optics::new`].
    pub(in crate::modal) fn new(model: &Model, last_zernike: usize, tolerance: &ToleranceScene) -> Result<Self> {
        let (parts, pupil) = (model.optics.parts().clone(), &model.telescope.pupil);
        let grid = Grid::new(parts.sampling.samples, pupil.grid.width_m() * model.width_ratio())?;
        let samples = grid.samples();
        let point =
            |&cell: &u32| (grid.coordinate_m(cell as usize % samples), grid.coordinate_m(cell as usize / samples));
        let points: Vec<(f64, f64)> = parts.weights.illuminated.iter().map(point).collect();
        let mut columns = Columns { smooth: parts.basis.nrows(), ..Columns::default() };
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
        let fitted = parts.modes.len();
        let modes: Vec<Mode> = parts.modes.iter().copied().chain(columns.modes).collect();
        let count = modes.len();
        let rows: Vec<_> =
            std::iter::once(parts.basis.view()).chain(columns.rows.iter().map(|rows| rows.view())).collect();
        let basis = concatenate(Axis(0), &rows).map_err(|error| Error::Internal(error.to_string()))?;
        let optics = Optics::new(OpticsParts { basis, modes, products: None, slopes: own_slopes, ..parts })?;
        let (chain, groups) = (CpuChain::new(Arc::new(optics)), columns.groups);
        Ok(Self { chain, fitted, tilts, modes: count, groups, illumination, tolerance: tolerance.clone() })
    }

    /// The modes of images of one wavefront, whose fits ended in `minima`, with what was left out:
    /// `likelihood` is their combination, and `noise_nm2` the part of its covariance that follows
    /// from the images' noise.
    ///
    /// # Errors
    /// [`Error::Internal`] for values that are not finite.
    pub(in crate::modal) fn marginalised(
        &self,
        (model, motions): (&Model, &GlobalMotions),
        images: &[(&PreparedFrame, &Minimum)],
        likelihood: &CombinedModes,
        noise_nm2: &Array2<f64>,
    ) -> Result<WithLeftOut> {
        let Self { fitted, tilts, .. } = self;
        let Summed { information, score, chi2, freedom } = self.summed(model, images)?;
        let free: Vec<usize> = (0..*fitted).filter(|mode| !tilts.contains(mode)).collect();
        let with_prior: Vec<usize> = tilts.clone().chain(*fitted..score.len()).collect();
        let block = |rows: &[usize], columns: &[usize]| information.select(Axis(0), rows).select(Axis(1), columns);
        let floor = null_floor(score.len(), images.first().map_or(1, |(first, _)| first.exposure.weight.len()));
        let inverse = pseudo_inverse(&block(&free, &free), floor)?;
        let cross = block(&free, &with_prior);
        let moves = inverse.dot(&cross);
        let left = block(&with_prior, &with_prior) - cross.t().dot(&moves);
        let value = |&mode: &usize| if mode < *fitted { likelihood.coefficients_nm[mode] } else { 0.0 };
        let fitted_nm: Array1<f64> = with_prior.iter().map(value).collect();
        let score = score.select(Axis(0), &with_prior);
        let groups: Vec<CoefficientGroup> = self.groups.iter().map(Group::prior).collect();
        let found = maximise_marginal_likelihood(&left, &(&score + &left.dot(&fitted_nm)), &groups)?;
        let change_nm = &found.coefficients_nm - &fitted_nm;
        // χ² that the change explains; the rest scales the error bars.
        let explained = change_nm.dot(&(&score * 2.0 - left.dot(&change_nm)));
        let scale = ((chi2 - explained) / freedom).max(1.0);
        // Rows of the fitted modes by those with a prior: free ones follow these, others are among
        // them.
        let mut follow = Array2::zeros((*fitted, with_prior.len()));
        for (row, &mode) in moves.outer_iter().zip(&free) {
            follow.row_mut(mode).assign(&(-&row));
        }
        for (place, mode) in tilts.clone().enumerate() {
            follow[[mode, place]] = 1.0;
        }
        let mut noise_alone_nm2 = Array2::zeros((*fitted, *fitted));
        for (row, &mode) in inverse.outer_iter().zip(&free) {
            row.iter().zip(&free).for_each(|(nm2, &other)| noise_alone_nm2[[mode, other]] = *nm2);
        }
        let changed_nm = &ArrayView1::from(&likelihood.coefficients_nm) + &follow.dot(&change_nm);
        let mut coefficients_nm = changed_nm.to_vec();
        motions.remove(&mut coefficients_nm);
        let added_nm2 = motions.removed_from(&follow.dot(&found.covariance_nm2).dot(&follow.t())) * scale;
        let noise_alone_nm2 = motions.removed_from(&noise_alone_nm2) * scale;
        let covariance_nm2 = &likelihood.covariance_nm2 - noise_nm2 + noise_alone_nm2 + &added_nm2;
        let (mut terms, mut errors) = (Vec::new(), Vec::new());
        for (group, &rms) in self.groups.iter().zip(&found.prior_rms_nm) {
            match group.of {
                Of::Tolerance(tolerance) => errors.push(group.error(tolerance, &found, scale)),
                Of::Amplitudes => {
                    terms.push(LeftOutTerm { name: group.name.clone(), size: 100.0 * AMPLITUDE_UNIT * rms, unit: "%" })
                }
                _ => terms.push(LeftOutTerm { name: group.name.clone(), size: rms, unit: "nm" }),
            }
        }
        let phasing_nm = self.phasing_nm(model, &found);
        let modes = CombinedModes { coefficients_nm, covariance_nm2 };
        Ok(WithLeftOut { modes, added_nm2, phasing_nm, terms, errors })
    }

    /// Change of the PSF by one unit of each unknown that is no mode.
    fn further(&self, model: &Model, linear: &LinearModel) -> Vec<Array1<f64>> {
        let mut columns = Vec::new();
        if let Some(patterns) = &self.illumination {
            let amplitudes = linear.by_amplitudes();
            columns.extend(amplitudes.outer_iter().map(|column| column.to_owned() * AMPLITUDE_UNIT));
            let illumination = patterns.dot(&amplitudes);
            let slopes = illumination.outer_iter().map(|column| column.to_owned());
            columns.extend(in_tolerances(slopes.zip([self.tolerance.illumination_fraction; ILLUMINATIONS.len()])));
        }
        let native = model.preparation.native_pixels().sqrt();
        let camera = camera::columns(linear.psf(), linear.pixels(), native).into_iter();
        columns.extend(in_tolerances(camera.zip(camera::errors(&self.tolerance).map(|(_, tolerance)| tolerance))));
        columns
    }

    /// Gauss-Newton matrix and score of all images.
    fn summed(&self, model: &Model, images: &[(&PreparedFrame, &Minimum)]) -> Result<Summed> {
        let chain = &self.chain;
        let (mut loaded, mut scratch, mut evaluation) = (chain.empty_image(), chain.scratch(), chain.evaluation());
        let mut at = Array1::<f64>::zeros(self.modes);
        let (mut score, mut first_information) = (Array1::<f64>::zeros(0), None);
        let (mut square_snr, mut chi2, mut freedom) = (0.0, 0.0, 0.0);
        for (prepared, minimum) in images {
            let exposure = &prepared.exposure;
            at.slice_mut(s![..self.fitted]).assign(&ArrayView1::from(&minimum.coefficients_nm));
            chain.set(&mut loaded, exposure)?;
            chain.evaluate_one(&loaded, at.view(), &mut scratch, &mut evaluation);
            let linear = chain.linearise(at.view());
            let further = self.further(model, &linear);
            let (flux_e, background_e) = photometry(exposure, linear.psf());
            let weighted: Array1<f64> = (linear.psf().iter().zip(&exposure.data_e).zip(&exposure.weight))
                .map(|((psf, data), weight)| weight * (data - flux_e * psf - background_e))
                .collect();
            let of_modes = evaluation.gradient.iter().map(|slope| -0.5 * slope);
            let own: Array1<f64> =
                of_modes.chain(further.iter().map(|column| flux_e * column.dot(&weighted))).collect();
            score = if score.is_empty() { own } else { score + own };
            // That of the first image, as much as all images say.
            if first_information.is_none() {
                let weights = (exposure.weight.as_slice(), None);
                let bytes = model.tiles().derivative_bytes;
                let own = Sensitivity::of(&linear, &further, flux_e, weights, exposure.photometry, bytes).fisher;
                first_information = Some((&own + &own.t()) * (0.5 / minimum.chi2.square_snr));
            }
            square_snr += minimum.chi2.square_snr;
            chi2 += minimum.chi2.value * minimum.chi2.freedom;
            freedom += minimum.chi2.freedom;
        }
        let Some(information) = first_information else {
            return Err(Error::Internal("there is no image whose left-out modes could be marginalised".into()));
        };
        Ok(Summed { information: information * square_snr, score, chi2, freedom })
    }

    /// RMS over the pupil of what is left out of the segments, nm, which the maps do not have:
    /// modes of a segment have the share of its area.
    fn phasing_nm(&self, model: &Model, found: &Posterior) -> f64 {
        let areas = model.telescope.pupil.segment_areas();
        let total: f64 = areas.iter().sum();
        let mut square_nm2 = 0.0;
        for group in &self.groups {
            for (place, column) in group.columns.clone().enumerate() {
                let share = match group.of {
                    Of::Tilts => areas[place % areas.len()] / total,
                    Of::Figures => areas[place / 3] / total,
                    Of::AllSegments => 1.0,
                    Of::FittedTilts | Of::Ncpa | Of::Amplitudes | Of::Tolerance(_) => 0.0,
                };
                square_nm2 += share * (found.coefficients_nm[column].powi(2) + found.covariance_nm2[[column, column]]);
            }
        }
        square_nm2.sqrt()
    }
}

/// Columns in units of their tolerances; those that are exact are none.
fn in_tolerances(columns: impl Iterator<Item = (Array1<f64>, f64)>) -> impl Iterator<Item = Array1<f64>> {
    columns.filter(|(_, tolerance)| *tolerance > 0.0).map(|(column, tolerance)| column * tolerance)
}

/// Normal equations of images at their minima.
struct Summed {
    information: Array2<f64>,
    /// −½ of the gradient.
    score: Array1<f64>,
    chi2: f64,
    freedom: f64,
}

impl Group {
    fn prior(&self) -> CoefficientGroup {
        CoefficientGroup {
            columns: self.columns.clone(),
            variance_nm2: self.rms.powi(2),
            range_nm2: [LEAST.powi(2), self.largest.powi(2)],
            rule: self.rule,
        }
    }

    /// The error that this group is of, whose prior standard deviation is `tolerance`. Variances
    /// are `scale` times those of the noise.
    fn error(&self, tolerance: f64, found: &Posterior, scale: f64) -> LeftOutError {
        let place = self.columns.start;
        let (value, variance) = (found.coefficients_nm[place], found.covariance_nm2[[place, place]]);
        // Without the prior of variance 1: 1/variance = 1/own + 1, value/variance = seen/own.
        let own = variance / (1.0 - variance).max(f64::EPSILON);
        LeftOutError {
            name: self.name.clone(),
            value: value * tolerance,
            sigma: (variance * scale).sqrt() * tolerance,
            tolerance,
            significance: value / variance * (own / scale).sqrt(),
        }
    }
}

/// Modes with the errors of what was left out.
#[derive(Debug, Clone)]
pub(crate) struct WithLeftOut {
    /// Their mean and covariance.
    pub(crate) modes: CombinedModes,
    /// The part of the covariance that what was left out adds.
    pub(crate) added_nm2: Array2<f64>,
    /// RMS of what was left out of the phasing, which the map does not have, nm.
    pub(crate) phasing_nm: f64,
    /// How large each group is.
    pub(crate) terms: Vec<LeftOutTerm>,
    /// Errors of the optics and the camera.
    pub(crate) errors: Vec<LeftOutError>,
}

/// An error of the optics or the camera that the scene takes to have none; relative, or rad.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeftOutError {
    /// What is wrong, as the subject of a sentence.
    pub(crate) name: String,
    /// Its value, and the error bar of that.
    pub(crate) value: f64,
    pub(crate) sigma: f64,
    /// Its standard deviation before the images.
    pub(crate) tolerance: f64,
    /// Value that the images say without the tolerance, over its error bar.
    pub(crate) significance: f64,
}

impl LeftOutError {
    /// Whether the images show it, and it is not small beside its tolerance.
    pub(crate) fn is_shown(&self) -> bool {
        self.significance.abs() > SIGNIFICANT && self.value.abs() > REMARKABLE * self.tolerance
    }
}

/// Modes that were left out of the fit, and how large the images say they are.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeftOutTerm {
    /// What they are.
    pub(crate) name: String,
    /// Standard deviation of each of its modes, in this unit.
    pub(crate) size: f64,
    pub(crate) unit: &'static str,
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
