//! Errors that are to be corrected, and which of their modes are: the scene's policy.

use crate::loop_response::segment_layout::{common_directions, edges, projection_without};
use crate::modes::SmoothBasis;
use crate::pupil::Segment;
use crate::scene::System;
use crate::tracking::{Correctable, Correction, CorrectionPolicy, correction};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, s};

/// Estimated static errors, as far as corrections need them.
pub struct CorrectableErrors<'a> {
    /// Piston of each segment, nm; none where the estimate has none.
    pub pistons_nm: &'a [f64],
    /// Tip of each segment, then tilt of each, nm RMS over the segment; empty where they are not
    /// corrected. With them the segments have no common tip and tilt.
    pub tilts_nm: &'a [f64],
    /// Covariance of pistons and tilts in turn, nm².
    pub segment_covariance_nm2: ArrayView2<'a, f64>,
    /// Whether images hold little information on the plane through all pistons, as behind adaptive
    /// optics: it is then a block of its own, which is left where its correction is not expected to
    /// lower the error.
    pub has_uncertain_plane: bool,
    /// Limits of the corrections of segments.
    pub limits: SegmentLimits,
    /// Coefficients of the NCPA, nm.
    pub ncpa_nm: &'a [f64],
    /// Their error bars, nm.
    pub ncpa_sigma_nm: &'a [f64],
    /// What they are coefficients of.
    pub ncpa: NcpaModes<'a>,
    /// Whether a mirror takes NCPA. Without, they are left.
    pub has_ncpa_corrector: bool,
    /// Reference slopes about which the loop moves its mirror by 1 nm of each NCPA mode,
    /// `[mode, slope]`, mas: turbulence blurs the spots of lenslets, whose slopes then change less.
    /// `None` where no slopes were measured.
    pub reference_mas_per_nm: Option<&'a Array2<f64>>,
}

/// Limits of the corrections of segments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentLimits {
    /// Largest correction of a piston, or of a tilt, to which larger ones are cut unless a caller
    /// names another, nm.
    pub cut_nm: f64,
    /// Largest correction of a piston; a larger one is refused, nm.
    pub refused_nm: f64,
}

impl SegmentLimits {
    /// No limits.
    pub const NONE: Self = Self { cut_nm: f64::INFINITY, refused_nm: f64::INFINITY };

    /// The limits of `scene`: by `commands.max_step_nm`, and where that is unset and the whole
    /// wavelengths of the pistons are not known by the wavelength. A quarter of it is half of the
    /// distance to the next fringe.
    pub fn of_scene(scene: &System, are_integers_known: bool) -> Self {
        let wavelength_nm = scene.image.wavelength_nm;
        match scene.commands.max_step_nm {
            Some(step_nm) => Self { cut_nm: step_nm, refused_nm: step_nm },
            None if are_integers_known => Self::NONE,
            None => Self { cut_nm: wavelength_nm / 4.0, refused_nm: wavelength_nm / 2.0 },
        }
    }

    /// Refuses a piston that moves by more than `refused_nm`. `pistons_nm` are the estimates, of
    /// which the part `gain` is corrected where `is_moved`.
    ///
    /// # Errors
    /// [`Error::Value`].
    pub(super) fn check(&self, pistons_nm: &[[f64; 2]], is_moved: impl Fn(usize) -> bool, gain: f64) -> Result<()> {
        let largest = (0..pistons_nm.len()).filter(|&segment| is_moved(segment)).map(|k| (k, gain * pistons_nm[k][0]));
        match largest.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())) {
            Some((segment, nm)) if nm.abs() > self.refused_nm => Err(Error::Value(format!(
                "segment {segment} would be moved by {:.0} nm of wavefront, where {:.0} is the largest step that is sent \
                 (commands.max_step_nm; by default half of the wavelength where there is one, which does not show whole ones): take images in \
                 a second wavelength, or allow the step by commands.max_step_nm",
                -nm, self.refused_nm
            ))),
            _ => Ok(()),
        }
    }
}

/// Modes of the NCPA.
pub enum NcpaModes<'a> {
    /// Functions of the place in the pupil; tip and tilt are the first two.
    Smooth(&'a SmoothBasis),
    /// Maps on the scene's grid: the map of such coefficients, `[y, x]`, nm, NaN outside the pupil.
    Maps(&'a dyn Fn(&[f64]) -> Array2<f64>),
}

/// A decision on errors: what is corrected, and the estimates that it is made from.
pub(super) struct Decision {
    /// Correction of pistons, tips, tilts and NCPA in turn.
    pub(super) correction: Correction,
    /// Pistons, tips and tilts, each with its error bar, nm, without the mean or the plane that no
    /// correction changes.
    pub(super) segments_nm: Vec<[f64; 2]>,
}

impl CorrectableErrors<'_> {
    /// What `policy` corrects of pistons, tips, tilts and NCPA in turn, of a mirror of these
    /// segments.
    ///
    /// # Errors
    /// Those of [`correction`].
    pub fn correction(&self, policy: &CorrectionPolicy, segments: &[Segment]) -> Result<Correction> {
        Ok(self.decide(policy, segments)?.correction)
    }

    pub(super) fn decide(&self, policy: &CorrectionPolicy, segments: &[Segment]) -> Result<Decision> {
        let pistons = segments.len();
        let flat = self.projection(policy, segments);
        let pistons_nm = flat.dot(&ArrayView1::from(self.pistons_nm));
        let mut covariance_nm2 = self.segment_covariance_nm2.to_owned();
        let of_pistons = flat.dot(&self.segment_covariance_nm2.slice(s![..pistons, ..pistons])).dot(&flat);
        covariance_nm2.slice_mut(s![..pistons, ..pistons]).assign(&of_pistons);
        let (count, modes) = (pistons + self.tilts_nm.len(), pistons + self.tilts_nm.len() + self.ncpa_nm.len());
        let coefficients_nm: Array1<f64> =
            pistons_nm.iter().chain(self.tilts_nm).chain(self.ncpa_nm).copied().collect();
        let mut all_nm2 = Array2::zeros((modes, modes));
        all_nm2.slice_mut(s![..count, ..count]).assign(&covariance_nm2);
        all_nm2.diag_mut().iter_mut().skip(count).zip(self.ncpa_sigma_nm).for_each(|(nm2, nm)| *nm2 = nm * nm);
        let correction = correction(
            policy,
            &Correctable {
                coefficients_nm: coefficients_nm.view(),
                covariance_nm2: all_nm2.view(),
                segment_modes: &(0..count),
                segment_of_mode: &(0..count).map(|mode| mode % pistons.max(1)).collect::<Vec<usize>>(),
                edges: &edges(segments),
                left_modes: &(count..count + self.left_ncpa()).collect::<Vec<usize>>(),
            },
        )?;
        let sigma_nm = covariance_nm2.diag().mapv(|nm2| nm2.max(0.0).sqrt());
        let segments_nm = coefficients_nm.iter().zip(&sigma_nm).map(|(&nm, &sigma_nm)| [nm, sigma_nm]).collect();
        Ok(Decision { correction, segments_nm })
    }

    /// Number of the first NCPA modes that are not corrected: pointing, or all.
    pub(super) fn left_ncpa(&self) -> usize {
        match self.ncpa {
            _ if !self.has_ncpa_corrector => self.ncpa_nm.len(),
            NcpaModes::Smooth(_) => self.ncpa_nm.len().min(2),
            NcpaModes::Maps(_) => 0,
        }
    }

    /// Projection of the pistons on what may be corrected: without their mean, and without the
    /// plane where it is left. Segments with tilts have no common motion, and a plane through their
    /// pistons alone is a shape of the whole mirror.
    fn projection(&self, policy: &CorrectionPolicy, segments: &[Segment]) -> Array2<f64> {
        let count = segments.len();
        if !self.tilts_nm.is_empty() {
            return Array2::eye(count);
        }
        let directions = common_directions(segments);
        let (mean, plane) = directions.split_at(directions.len().min(1));
        let is_left = self.has_uncertain_plane && !self.is_worth_correcting(policy, plane);
        projection_without(count, if is_left { &directions } else { mean })
    }

    /// Whether the components of the pistons along `directions` are beyond the deadband, all
    /// together, and their correction is expected to lower the error: with gain g and error bars of
    /// the variance P in all, g·(2 − g)·|m|² > 2·g·P (Stein 1981, as in [`correction`]).
    fn is_worth_correcting(&self, policy: &CorrectionPolicy, directions: &[Array1<f64>]) -> bool {
        let pistons_nm = ArrayView1::from(self.pistons_nm);
        let count = pistons_nm.len();
        let covariance_nm2 = self.segment_covariance_nm2.slice(s![..count, ..count]);
        let squares_nm2: f64 = directions.iter().map(|direction| direction.dot(&pistons_nm).powi(2)).sum();
        let variance_nm2: f64 = directions.iter().map(|direction| direction.dot(&covariance_nm2.dot(direction))).sum();
        squares_nm2 > (2.0 / (2.0 - policy.gain)).max(policy.deadband_sigma.powi(2)) * variance_nm2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plane_through_the_segments_is_corrected_where_known() {
        let ring = (0..6).map(|k| (f64::from(k) * std::f64::consts::FRAC_PI_3).sin_cos());
        let centres = std::iter::once((0.0, 0.0)).chain(ring);
        let segments: Vec<Segment> = centres.map(|(y_m, x_m)| Segment { x_m, y_m, label: 0 }).collect();
        let directions = common_directions(&segments);
        let plane_nm = |k: usize| 40.0 * segments[k].x_m + 20.0 * segments[k].y_m;
        // Signs that alternate around the ring have no plane.
        let rest_nm = |k: usize| if k == 0 { 20.0 } else { 30.0 * (-1.0_f64).powi(k as i32) };
        let pistons_nm: Vec<f64> = (0..7).map(|k| plane_nm(k) + rest_nm(k)).collect();
        let map_nm = |_: &[f64]| Array2::zeros((1, 1));
        let along = |nm: &Array1<f64>| (directions[1].dot(nm).powi(2) + directions[2].dot(nm).powi(2)).sqrt();
        let found = |plane_sigma_nm: f64, has_uncertain_plane: bool| {
            let mut covariance_nm2 = Array2::eye(7);
            for direction in &directions[1..] {
                let (column, row) =
                    (direction.view().insert_axis(ndarray::Axis(1)), direction.view().insert_axis(ndarray::Axis(0)));
                covariance_nm2 += &(&column * &row * plane_sigma_nm.powi(2));
            }
            let errors = CorrectableErrors {
                pistons_nm: &pistons_nm,
                tilts_nm: &[],
                segment_covariance_nm2: covariance_nm2.view(),
                has_uncertain_plane,
                limits: SegmentLimits::NONE,
                ncpa_nm: &[],
                ncpa_sigma_nm: &[],
                ncpa: NcpaModes::Maps(&map_nm),
                has_ncpa_corrector: true,
                reference_mas_per_nm: None,
            };
            errors.correction(&CorrectionPolicy::default(), &segments).unwrap()
        };
        let whole = along(&Array1::from(pistons_nm.clone()));
        // 77 nm in all. Beside error bars of 5 nm along both directions it is corrected, but for
        // pistons within the deadband.
        for is_uncertain in [true, false] {
            assert!((along(&found(5.0, is_uncertain).coefficients_nm) / whole - 1.0).abs() < 0.2);
        }
        // Beside 60 nm, of which twice the variance is 120² in all, it is left as it is, and the
        // rest is corrected.
        let left = found(60.0, true);
        assert!(along(&left.coefficients_nm) < 1e-9 && left.held.is_empty(), "{left:?}");
    }
}
