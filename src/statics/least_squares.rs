//! Generalised least squares: segment modes and NCPA from a mean wavefront, under the covariance of
//! the mean's turbulence, with hyperparameters by empirical Bayes.

use super::common_figure::COMMON_FIGURE_RMS_NM;
use super::mean_covariance::{MeanCovariance, Weighted};
use super::static_errors::StaticErrors;
use crate::empirical_bayes::{CoefficientGroup, NEGLIGIBLE_NM2, Posterior, VarianceRule, maximise_marginal_likelihood};
use crate::linear_algebra::{combination, row_products};
use crate::loop_response::SlopeInformation;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, concatenate, s};

/// Prior RMS of unidentifiable coefficients (the mean wavefront, tip and tilt), nm: more than a
/// model's whole range.
const FLAT_PRIOR_NM: f64 = 1e4;

/// Prior RMS of pistons before any correction, nm, for the error of nearly degenerate directions
/// (their mean and the plane through them) after an estimate like this one was corrected.
const UNCORRECTED_NM: f64 = 30.0;

/// Initial prior RMS of a group, nm.
const INITIAL_RMS_NM: f64 = 30.0;

/// Largest difference of two mean wavefronts, nm RMS, for which one correction of their scalar
/// products serves: it changes them by as much times the tolerance of the solutions.
const SAME_MEAN_NM: f64 = 0.3;

/// Linear model of the mean wavefront: response to segment modes, NCPA and an offset, weighted by
/// the inverse covariance.
pub struct StaticModel {
    covariance: MeanCovariance,
    /// Number of segments, which is that of the pistons, and of segment modes: pistons, and where
    /// they are estimated tilts.
    segments: usize,
    segment_modes: usize,
    ncpa: usize,
    /// Responses to segment modes, NCPA, common figures of the segments and the offset,
    /// `[column, sample]`.
    columns: Array2<f64>,
    /// The columns weighted by C⁻¹.
    weighted: Weighted,
    /// The last mean wavefront, and what the residual of `weighted` adds to its scalar products.
    corrected: Option<(Array1<f64>, Array1<f64>)>,
    information: Array2<f64>,
    /// Column of each unknown: the common-path part has the columns of the NCPA again.
    column_of: Vec<usize>,
    groups: Vec<CoefficientGroup>,
}

impl StaticModel {
    /// The model of responses to the modes of `segments` segments (pistons, and where they are
    /// estimated tips and tilts), to `ncpa` and to `figures`
    /// ([`common_figures`](super::common_figure::common_figures)), each `[mode, sample]`, on
    /// samples whose mean wavefront has `covariance`; `groups` as in
    /// [`NcpaBasis`](super::NcpaBasis), and whether telemetry separates NCPA from the common path.
    ///
    /// # Errors
    /// [`Error::Shape`] for responses or groups of different sizes; those of
    /// [`MeanCovariance::solve`].
    pub fn new(
        (segment_columns, segments): (ArrayView2<f64>, usize),
        (ncpa, figures): (ArrayView2<f64>, ArrayView2<f64>),
        (groups, has_telemetry): (&[usize], bool),
        covariance: &MeanCovariance,
    ) -> Result<Self> {
        let (segment_modes, samples) = segment_columns.dim();
        let modes = ncpa.nrows();
        if ncpa.ncols() != samples || groups.iter().sum::<usize>() != modes {
            let (columns, grouped) = (ncpa.ncols(), groups.iter().sum::<usize>());
            return Err(Error::Shape(format!(
                "{modes} modes of {columns} samples in groups of {grouped} were given with segment modes of {samples} samples: as \
                 many samples, and each mode in a group, are needed"
            )));
        }
        // The offset absorbs the mean wavefront, to which images are blind.
        let offset = Array2::ones((1, samples));
        let columns = concatenate(Axis(0), &[segment_columns, ncpa, figures, offset.view()])
            .map_err(|error| Error::Internal(format!("columns of uneven length: {error}")))?;
        let weighted = covariance.solve(columns.view())?;
        let half = weighted.products(columns.view(), &weighted);
        let information = (&half + &half.t()) / 2.0;
        let nuisances = segment_modes + modes..columns.nrows();
        let common_path = if has_telemetry { segment_modes..segment_modes + modes } else { 0..0 };
        let column_of: Vec<usize> = (0..segment_modes + modes).chain(common_path).chain(nuisances).collect();
        let information = information.select(Axis(0), &column_of).select(Axis(1), &column_of);
        let groups = coefficient_groups([segments, segment_modes], groups, has_telemetry, figures.nrows());
        Ok(Self {
            covariance: covariance.clone(),
            segments,
            segment_modes,
            ncpa: modes,
            columns,
            weighted,
            corrected: None,
            information,
            column_of,
            groups,
        })
    }

    /// Whether telemetry separates NCPA from the common path.
    pub fn has_telemetry(&self) -> bool {
        self.column_of.len() > self.columns.nrows()
    }

    /// Covariance of the mean wavefront.
    pub fn covariance(&self) -> &MeanCovariance {
        &self.covariance
    }

    /// Estimates the static errors of a mean wavefront, nm at each sample.
    ///
    /// `slopes` is the information of telemetry on the NCPA. The hyperparameters start at those of
    /// `initial`.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of samples or of NCPA modes; those of
    /// [`MeanCovariance::solve`].
    pub fn estimate(
        &mut self,
        mean_nm: ArrayView1<f64>,
        slopes: Option<&SlopeInformation>,
        initial: Option<&StaticErrors>,
    ) -> Result<StaticErrors> {
        if mean_nm.len() != self.columns.ncols() {
            let (given, needed) = (mean_nm.len(), self.columns.ncols());
            return Err(Error::Shape(format!("a mean wavefront of {given} samples was given: {needed} are needed")));
        }
        let (information, right_side) = self.normal_equations(mean_nm, slopes)?;
        let mut groups = self.groups.clone();
        for (group, nm) in groups.iter_mut().zip(initial.iter().flat_map(|errors| &errors.prior_rms_nm)) {
            group.variance_nm2 = nm * nm;
        }
        let posterior = maximise_marginal_likelihood(&information, &right_side, &groups)?;
        // Tilts keep the prior that the data give them, which alone bounds shapes of many segments
        // that the loop compensates: widened by the errors of a previous estimate too, they leave
        // 19 nm of phasing in place of 17 (75 images, tilts of 20 nm, one draw).
        let pistons_nm = posterior.prior_rms_nm[0];
        let Posterior { coefficients_nm, covariance_nm2, log_marginal_likelihood, prior_rms_nm, .. } =
            posterior.with_previous_correction(self.segments, pistons_nm, UNCORRECTED_NM)?;
        let ncpa = self.segment_modes + self.ncpa;
        let common_path = if self.has_telemetry() { ncpa..ncpa + self.ncpa } else { ncpa..ncpa };
        let mut common_path_nm = coefficients_nm.slice(s![common_path]).to_vec();
        common_path_nm.resize(self.ncpa, 0.0);
        let mut of_columns_nm = Array1::zeros(self.columns.nrows());
        self.column_of.iter().zip(&coefficients_nm).for_each(|(&column, &nm)| of_columns_nm[column] += nm);
        let residual_nm = &mean_nm - &combination(of_columns_nm.view(), self.columns.view());
        Ok(StaticErrors {
            residual_nm,
            pistons_nm: coefficients_nm.slice(s![..self.segments]).to_vec(),
            tilts_nm: coefficients_nm.slice(s![self.segments..self.segment_modes]).to_vec(),
            ncpa_nm: coefficients_nm.slice(s![self.segment_modes..ncpa]).to_vec(),
            common_path_nm,
            covariance_nm2: covariance_nm2.slice(s![..ncpa, ..ncpa]).to_owned(),
            log_marginal_likelihood,
            prior_rms_nm,
        })
    }

    /// Normal equations of the mean wavefront and of the slopes: information F, nm⁻², and right
    /// side b, nm⁻¹.
    fn normal_equations(
        &mut self,
        mean_nm: ArrayView1<f64>,
        slopes: Option<&SlopeInformation>,
    ) -> Result<(Array2<f64>, Array1<f64>)> {
        let mut information = self.information.clone();
        let products = row_products(self.weighted.solution.view(), mean_nm) + self.correction(mean_nm)?;
        let mut right_side = products.select(Axis(0), &self.column_of);
        if let Some(slopes) = slopes {
            let ncpa = self.segment_modes..self.segment_modes + self.ncpa;
            if slopes.right_side.len() != ncpa.len() {
                let (given, needed) = (slopes.right_side.len(), ncpa.len());
                return Err(Error::Shape(format!("slopes of {given} NCPA modes were given: {needed} are needed")));
            }
            // Slopes measure NCPA + share · common path.
            let common_path = ncpa.end..ncpa.end + if self.has_telemetry() { self.ncpa } else { 0 };
            let parts = [(ncpa, 1.0), (common_path, slopes.common_path_share)];
            for (rows, row_share) in parts.iter().filter(|(rows, _)| !rows.is_empty()) {
                for (columns, share) in parts.iter().filter(|(columns, _)| !columns.is_empty()) {
                    let mut part = information.slice_mut(s![rows.clone(), columns.clone()]);
                    part.scaled_add(row_share * share, &slopes.information);
                }
                right_side.slice_mut(s![rows.clone()]).scaled_add(*row_share, &slopes.right_side);
            }
        }
        Ok((information, right_side))
    }

    /// What the residual of the weighted columns adds to their scalar products with `mean_nm`.
    fn correction(&mut self, mean_nm: ArrayView1<f64>) -> Result<&Array1<f64>> {
        let is_same = |other: &Array1<f64>| {
            let difference = other - &mean_nm;
            difference.dot(&difference) <= SAME_MEAN_NM * SAME_MEAN_NM * mean_nm.len() as f64
        };
        let (_, correction) = match self.corrected.take().filter(|(other, _)| is_same(other)) {
            Some(corrected) => self.corrected.insert(corrected),
            None => {
                let solved = self.covariance.solve(mean_nm.insert_axis(Axis(0)))?;
                let correction = self.weighted.correction(solved.solution.row(0));
                self.corrected.insert((mean_nm.to_owned(), correction))
            }
        };
        Ok(correction)
    }
}

/// Groups of the coefficients: pistons; tilts, where there are more segment modes than segments;
/// the groups of the NCPA, and with telemetry those of the common path; the common figures; the
/// offset.
fn coefficient_groups(
    [segments, segment_modes]: [usize; 2],
    ncpa: &[usize],
    has_telemetry: bool,
    figures: usize,
) -> Vec<CoefficientGroup> {
    let free = |columns, rms_nm: f64| CoefficientGroup {
        columns,
        variance_nm2: rms_nm * rms_nm,
        range_nm2: [NEGLIGIBLE_NM2, f64::INFINITY],
        rule: VarianceRule::MostLikely,
    };
    let fixed = |columns, rms_nm: f64| CoefficientGroup {
        columns,
        variance_nm2: rms_nm * rms_nm,
        range_nm2: [NEGLIGIBLE_NM2, f64::INFINITY],
        rule: VarianceRule::Fixed,
    };
    let flat = |columns| fixed(columns, FLAT_PRIOR_NM);
    let mut groups = vec![free(0..segments, INITIAL_RMS_NM)];
    if segment_modes > segments {
        groups.push(free(segments..segment_modes, INITIAL_RMS_NM));
    }
    let mut first = segment_modes;
    for rms_nm in [INITIAL_RMS_NM, INITIAL_RMS_NM / 3.0].into_iter().take(if has_telemetry { 2 } else { 1 }) {
        for (place, &size) in ncpa.iter().enumerate() {
            let columns = first..first + size;
            groups.push(if place == 0 { flat(columns) } else { free(columns, rms_nm) });
            first += size;
        }
    }
    if figures > 0 {
        groups.push(fixed(first..first + figures, COMMON_FIGURE_RMS_NM));
    }
    groups.push(flat(first + figures..first + figures + 1));
    groups
}
