//! Static modes, of the segments and NCPA, at the samples of the wavefronts and as maps with their
//! error bars.

use super::error_budget::ErrorBudget;
use super::image_selection::SelectedImages;
use super::iteration::Iteration;
use super::ncpa_basis::{NcpaBasis, NcpaFamily};
use super::static_errors::StaticErrors;
use crate::Result;
use crate::linear_algebra::{SpdInverse, combination, row_products};
use crate::metrics::MapGram;
use crate::modal::{DiversityProjection, GlobalMotions, ModeProjector, StaticMaps};
use crate::modes::{Basis, SegmentModes, SmoothBasis};
use crate::pupil::Pupil;
use crate::retrieval::IlluminatedSamples;
use crate::scene::System;
use crate::telescope::Telescope;
use ndarray::{Array1, Array2, ArrayView1, Axis, s};
use std::ops::Range;

/// Static modes, of the segments and NCPA of one basis, on the samples and as maps.
pub(super) struct StaticModes {
    pub(super) family: NcpaFamily,
    pub(super) basis: SmoothBasis,
    pub(super) groups: Vec<usize>,
    /// Number of groups without that of the petals.
    pub(super) orders: usize,
    pub(super) at_all: Array2<f64>,
    pub(super) at_kept: Array2<f64>,
    /// All static modes on the scene's grid, those of the segments first.
    maps: Basis,
    /// Number of modes of the segments.
    segments: usize,
    /// Motions of the whole mirror, 0 by convention, where segments have tilts. Without tilts a
    /// plane through the pistons is a staircase, which has edges.
    motions: Option<GlobalMotions>,
    gram: MapGram,
    diversity: DiversityProjection,
    /// Covariance of the NCPA's modes from an error of the diversity common to all images, nm²;
    /// `None` where it is known.
    diversity_nm2: Option<Array2<f64>>,
    /// The NCPA's modes on the scene's grid with the projection of maps onto them, where the loop
    /// response is unknown.
    projection: Option<(Basis, ModeProjector)>,
}

/// RMS response of an unknown loop to the segments, over their projection onto the NCPA's modes:
/// 1/√3, of a response uniform from 0 to 1. Keck's zonal loop responds with two thirds, and its
/// response has a correlation of 0.93 with the projection.
const UNKNOWN_RESPONSE: f64 = 0.577;

impl StaticModes {
    /// The modes of the segments and of `family` on the pupil of `scene`, at all illuminated
    /// samples and at those kept.
    ///
    /// # Errors
    /// Those of making the bases.
    pub(super) fn new(
        (segment_modes, family): (SegmentModes, NcpaFamily),
        scene: &System,
        telescope: &Telescope,
        (samples, kept): (&IlluminatedSamples, &[usize]),
        is_loop_known: bool,
    ) -> Result<Self> {
        let NcpaBasis { modes: basis, groups, orders } = NcpaBasis::new(family, scene, telescope)?;
        let at_all = basis.evaluate(&samples.xs_m, &samples.ys_m)?;
        let pupil = &telescope.pupil;
        let sampled = basis.sampled(pupil)?;
        let diversity = DiversityProjection::new(scene, telescope, &sampled, 0)?;
        let diversity_nm2 = diversity_covariance_nm2(&diversity, scene)?;
        let segment_basis = segment_modes.maps(pupil)?;
        let segments = segment_basis.len();
        let motions = match segment_modes {
            SegmentModes::Piston => None,
            SegmentModes::PistonTipTilt => {
                Some(GlobalMotions::of_segments(&segment_basis, pupil, segments + sampled.len())?)
            }
        };
        let maps = segment_basis.followed_by(sampled.clone())?;
        let gram = MapGram::of_basis(pupil, &maps)?;
        let projection = match is_loop_known {
            true => None,
            false => Some(ModeProjector::new(pupil, &sampled, 0)?).map(|projector| (sampled, projector)),
        };
        Ok(Self {
            basis,
            family,
            groups,
            orders,
            at_kept: at_all.select(Axis(1), kept),
            at_all,
            maps,
            segments,
            motions,
            gram,
            diversity,
            diversity_nm2,
            projection,
        })
    }

    /// RMS, nm, of what the NCPA's modes leave of a wavefront at the kept samples, nm, beside its
    /// mean.
    ///
    /// # Errors
    /// Where the modes' normal equations cannot be solved.
    pub(super) fn remainder_nm(&self, wavefront_nm: ArrayView1<f64>) -> Result<f64> {
        let samples = wavefront_nm.len() as f64;
        let modes = &self.at_kept - &(self.at_kept.sum_axis(Axis(1)) / samples).insert_axis(Axis(1));
        let wavefront_nm = &wavefront_nm - wavefront_nm.sum() / samples;
        let normal = SpdInverse::of_normal_equations(modes.dot(&modes.t()))?;
        let coefficients_nm = normal.inverse.dot(&row_products(modes.view(), wavefront_nm.view()));
        let left_nm = wavefront_nm - combination(coefficients_nm.view(), modes.view());
        Ok((left_nm.dot(&left_nm) / samples).sqrt())
    }

    /// Wavefronts `columns` of the segment modes, `[mode, sample]`, without the motions of the
    /// whole mirror that are 0 by convention. The loop leaves some percent of a plane in the
    /// wavefront, so that one that stays in the columns can take up what the model of the loop has
    /// wrong, many times as large.
    pub(super) fn columns_without_motions(&self, columns: Array2<f64>) -> Array2<f64> {
        match &self.motions {
            Some(motions) => motions.removed_from_columns(&columns),
            None => columns,
        }
    }

    /// `errors` without the motions of the whole mirror that are 0 by convention.
    pub(super) fn without_motions(&self, errors: StaticErrors) -> StaticErrors {
        match &self.motions {
            Some(motions) => errors.without_motions(motions),
            None => errors,
        }
    }

    /// The iteration with these static errors: maps, error bars and error budget.
    /// `uncompensated_nm` is the expected error of the segments that the loop leaves in the
    /// wavefront, where that is less than all; `input` are the coefficients about which the
    /// wavefronts were retrieved.
    pub(super) fn iteration(
        &self,
        (mut errors, uncompensated_nm): (StaticErrors, Option<f64>),
        pupil: &Pupil,
        input: Option<Array1<f64>>,
        images: &SelectedImages,
        residual_rms_nm: f64,
    ) -> Result<Iteration> {
        let coefficients = errors.coefficients_nm();
        let ranges = [0..self.segments, self.segments..coefficients.len()];
        let map_nm = |i: usize| self.map(&coefficients, ranges[i].clone(), pupil);
        let maps = StaticMaps { phasing_nm: map_nm(0), ncpa_nm: map_nm(1) };
        let error_budget = self.add_common_errors(&mut errors, &coefficients, uncompensated_nm)?;
        let sigma_nm = |i: usize| {
            let variance_nm2 = self.maps.variance(&errors.covariance_nm2, ranges[i].clone());
            outside_to_nan(variance_nm2.mapv(|nm2| nm2.max(0.0).sqrt()), pupil)
        };
        let change_nm = match input.filter(|input| input.len() == coefficients.len()) {
            None => [f64::NAN; 2],
            Some(input) => {
                let change = |i: usize| {
                    let before_nm = self.map(&input, ranges[i].clone(), pupil);
                    crate::metrics::residual_nm(pupil, [&maps.phasing_nm, &maps.ncpa_nm][i].view(), before_nm.view())
                };
                [change(0)?, change(1)?]
            }
        };
        Ok(Iteration {
            family: self.family,
            ncpa_names: self.basis.names().to_vec(),
            sigma_maps: StaticMaps { phasing_nm: sigma_nm(0), ncpa_nm: sigma_nm(1) },
            maps,
            error_budget,
            change_nm,
            diversity: self.diversity.clone(),
            used_images: images.used.clone(),
            reduced_chi2: images.reduced_chi2,
            residual_rms_nm,
            segment_tilts: None,
            reference_mas_per_nm: None,
            errors,
        })
    }

    /// Adds to the covariance of the NCPA the errors that all images have in common, of the
    /// diversity and of an unknown loop response; returns the error budget.
    fn add_common_errors(
        &self,
        errors: &mut StaticErrors,
        coefficients: &Array1<f64>,
        uncompensated_nm: Option<f64>,
    ) -> Result<ErrorBudget> {
        let [phasing_nm, ncpa_nm] = self.expected_rms_nm(&errors.covariance_nm2)?;
        let averaged_nm = [uncompensated_nm.map_or(phasing_nm, |nm| nm.min(phasing_nm)), ncpa_nm];
        let response_nm = self.unknown_response_nm(coefficients)?;
        let column = response_nm.view().insert_axis(Axis(1));
        let response_nm2 = column.dot(&column.t());
        for common_nm2 in self.diversity_nm2.iter().chain([&response_nm2]) {
            let mut ncpa_nm2 = errors.covariance_nm2.slice_mut(s![self.segments.., self.segments..]);
            ncpa_nm2 += common_nm2;
        }
        let ncpa = self.segments..self.maps.len();
        let ncpa_rms_nm =
            |covariance_nm2: &Array2<f64>| self.gram.expected_rms_of_nm(ncpa.clone(), covariance_nm2.view());
        let diversity_nm = self.diversity_nm2.as_ref().map_or(Ok(0.0), ncpa_rms_nm)?;
        let total_nm = self.expected_rms_nm(&errors.covariance_nm2)?;
        Ok(ErrorBudget::new(total_nm, averaged_nm, diversity_nm, ncpa_rms_nm(&response_nm2)?))
    }

    /// Expected RMS over the pupil of phasing and NCPA with a covariance, piston, tip and tilt
    /// removed, nm.
    fn expected_rms_nm(&self, covariance_nm2: &Array2<f64>) -> Result<[f64; 2]> {
        let expected = |range: Range<usize>| {
            self.gram.expected_rms_of_nm(range.clone(), covariance_nm2.slice(s![range.clone(), range]))
        };
        Ok([expected(0..self.segments)?, expected(self.segments..covariance_nm2.nrows())?])
    }

    /// Standard deviation of an unknown loop's response to the segments, in the NCPA's modes, nm; 0
    /// where the loop is known.
    fn unknown_response_nm(&self, coefficients: &Array1<f64>) -> Result<Array1<f64>> {
        let Some((basis, projector)) = &self.projection else { return Ok(Array1::zeros(self.at_all.nrows())) };
        let segments_nm = self.sum(coefficients, 0..self.segments);
        Ok(projector.project(basis, &segments_nm)?.coefficients_nm * UNKNOWN_RESPONSE)
    }

    /// Map of the modes in `range`, NaN outside the pupil.
    fn map(&self, coefficients: &Array1<f64>, range: Range<usize>, pupil: &Pupil) -> Array2<f64> {
        outside_to_nan(self.sum(coefficients, range), pupil)
    }

    /// Sum of the modes in `range`, 0 outside their support.
    fn sum(&self, coefficients: &Array1<f64>, range: Range<usize>) -> Array2<f64> {
        self.maps.combined(&coefficients.to_vec(), range)
    }
}

/// Covariance of the NCPA's modes from an error of the diversity, nm².
fn diversity_covariance_nm2(diversity: &DiversityProjection, scene: &System) -> Result<Option<Array2<f64>>> {
    let fraction = scene.tolerance.defocus_fraction;
    let left = 100.0 * diversity.residual_share;
    let remedy = format!("the full-phase estimate's modes leave {left:.0} % of this one, and hold a focus");
    (fraction > 0.0).then(|| diversity.covariance_nm2(fraction, &remedy)).transpose()
}

/// Refuses a scene with an error of the diversity that the modes of `family` cannot represent,
/// before any image is read.
///
/// # Errors
/// [`Error::Scene`]; those of making the modes.
pub(crate) fn check_diversity(family: NcpaFamily, scene: &System, telescope: &Telescope) -> Result<()> {
    if scene.tolerance.defocus_fraction > 0.0 {
        let sampled = NcpaBasis::new(family, scene, telescope)?.modes.sampled(&telescope.pupil)?;
        diversity_covariance_nm2(&DiversityProjection::new(scene, telescope, &sampled, 0)?, scene)?;
    }
    Ok(())
}

fn outside_to_nan(mut map: Array2<f64>, pupil: &Pupil) -> Array2<f64> {
    ndarray::Zip::from(&mut map).and(&pupil.owner).for_each(|value, &owner| {
        if owner < 0 {
            *value = f64::NAN;
        }
    });
    map
}
