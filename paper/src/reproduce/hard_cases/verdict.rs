//! Is an estimate right, and does it say so where it is not?

use super::spoil::Made;
use crate::reproduce::{KeptDraw, to_cells, to_numbers};
use cophase::metrics::residual_nm;
use cophase::modal::ModalFitter;
use cophase::modes::Group;
use cophase::pupil::Pupil;
use cophase::source::Truth;
use cophase::{Error, Estimate, Result};
use ndarray::{Array1, Array2, Axis};
use std::borrow::Cow;

/// Residuals up to so many times what the error bars make one expect are right: of a hundred modes
/// their RMS scatters by 7 %, of a few (a focus that dominates) it stays within this in all but one
/// of three hundred.
const SIGMAS: f64 = 3.0;
/// Residuals up to this are right with any error bars, nm: λ/2000, where the sampling of the model
/// shows.
const ALWAYS_RIGHT_NM: f64 = 1.0;

/// Word of an estimate without a warning.
const OK: &str = "ok";
/// Part of the remark of an estimate whose images may be flipped.
const MAY_BE_FLIPPED: &str = "orientation cannot be verified";

/// What became of one image, or of one sequence.
#[derive(Debug, Clone)]
pub struct Verdict {
    /// One word: the status of the estimate, `warned` where it is ok and the estimate has a
    /// warning, or `refused`.
    pub word: Cow<'static, str>,
    /// The sentence of a refusal.
    pub sentence: Option<String>,
    /// Residuals of phasing (modulo a wavelength) and NCPA, nm; NaN without an estimate.
    pub error_nm: [f64; 2],
    /// Residual of the NCPA without what an error of the diversity's amplitude would make of it,
    /// nm, where the estimator says that its modes take that for their own; NaN where they do not.
    pub ncpa_but_diversity_nm: f64,
    /// Residuals against the truth flipped as the images are, where they are and the estimator says
    /// that it cannot verify the orientation; NaN elsewhere.
    pub flipped_nm: [f64; 2],
    /// What the error bars make one expect of them, nm.
    pub sigma_nm: [f64; 2],
    /// Reduced χ²; the median of a sequence.
    pub reduced_chi2: f64,
    /// Evaluations of objective and gradient, all images together.
    pub evaluations: usize,
    /// Largest difference of a coefficient in single precision, nm; NaN where it was not tried, or
    /// where the status differs.
    pub f32_nm: f64,
    /// The same on an OpenCL device, in double precision.
    pub opencl_nm: f64,
}

impl Verdict {
    /// Of images that the estimator refuses.
    const REFUSED: Self = Self {
        word: Cow::Borrowed("refused"),
        sentence: None,
        error_nm: [f64::NAN; 2],
        ncpa_but_diversity_nm: f64::NAN,
        flipped_nm: [f64::NAN; 2],
        sigma_nm: [f64::NAN; 2],
        reduced_chi2: f64::NAN,
        evaluations: 0,
        f32_nm: f64::NAN,
        opencl_nm: f64::NAN,
    };

    /// Whether the answer is right within its error bars.
    pub fn is_right(&self) -> bool {
        self.within(0, self.error_nm[0]) && self.within(1, self.error_nm[1])
    }

    /// Whether it is right but for what the estimator says it cannot know: the diversity's
    /// amplitude, which it takes from the scene.
    pub fn is_right_given_diversity(&self) -> bool {
        !self.is_right() && self.within(0, self.error_nm[0]) && self.within(1, self.ncpa_but_diversity_nm)
    }

    /// Whether the maps are right but for the flip of the images, which the estimator says it
    /// cannot know.
    pub fn is_right_given_orientation(&self) -> bool {
        !self.is_right() && self.within(0, self.flipped_nm[0]) && self.within(1, self.flipped_nm[1])
    }

    fn within(&self, part: usize, error_nm: f64) -> bool {
        error_nm <= ALWAYS_RIGHT_NM.max(SIGMAS * self.sigma_nm[part])
    }

    /// Whether something says that it may not be.
    pub fn is_flagged(&self) -> bool {
        self.word != OK
    }

    /// What must not be: wrong, said to be right, and by more than what the estimate says beside it
    /// that it cannot know.
    pub fn is_wrong_and_unflagged(&self) -> bool {
        !self.is_right() && !self.is_flagged() && !self.is_right_given_diversity() && !self.is_right_given_orientation()
    }

    /// The verdict on an estimator's result: that of `assess` on an estimate, or a refusal.
    pub(in crate::reproduce) fn of(
        answer: Result<Estimate>,
        assess: impl FnOnce(&Estimate) -> Result<Self>,
    ) -> Result<Self> {
        match answer {
            Ok(found) => assess(&found),
            Err(error @ Error::Interrupted(_)) => Err(error),
            Err(error) => Ok(Self { sentence: Some(error.to_string()), ..Self::REFUSED }),
        }
    }

    /// Status, error bars and χ² of an estimate, without its residuals.
    fn own_figures(found: &Estimate) -> Self {
        let status = found.status.word();
        Self {
            word: Cow::Borrowed(if status == OK && !found.warnings.is_empty() { "warned" } else { status }),
            sigma_nm: [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm],
            reduced_chi2: found.reduced_chi2,
            evaluations: found.evaluations(),
            ..Self::REFUSED
        }
    }

    /// Of a modal estimate, against what is behind the images.
    pub(super) fn new(found: &Estimate, made: &Made) -> Result<Self> {
        let fitter = fitter(found)?;
        // What cannot be compared, because it is of another telescope, is not right.
        let against = |flip: Option<Axis>| {
            let behind = Behind::new(&made.truth, &fitter.model().telescope.pupil, flip);
            behind
                .and_then(|behind| errors_nm(fitter, &found.modes.coefficients_nm, &behind))
                .unwrap_or([f64::INFINITY; 3])
        };
        let [phasing_nm, ncpa_nm, ncpa_but_diversity_nm] = against(None);
        let mut verdict = Self { error_nm: [phasing_nm, ncpa_nm], ncpa_but_diversity_nm, ..Self::own_figures(found) };
        if made.flip.is_some() && found.remarks.iter().any(|remark| remark.contains(MAY_BE_FLIPPED)) {
            let [phasing_nm, ncpa_nm, _] = against(made.flip);
            verdict.flipped_nm = [phasing_nm, ncpa_nm];
        }
        Ok(verdict)
    }

    /// Of an estimate whose images came with their truth, by its maps: a MAP estimate has no
    /// fitter.
    pub(in crate::reproduce) fn by_maps(found: &Estimate) -> Self {
        let error_nm = found.truth.as_ref().map_or([f64::INFINITY; 2], |(_, apart)| [apart.rms_nm[0], apart.rms_nm[1]]);
        Self { error_nm, ..Self::own_figures(found) }
    }
}

impl KeptDraw for Verdict {
    fn cells(&self) -> Vec<String> {
        let [[p, n], [fp, f_n], [sp, sn]] = [self.error_nm, self.flipped_nm, self.sigma_nm];
        let figures = [self.reduced_chi2, self.evaluations as f64, self.f32_nm, self.opencl_nm];
        let numbers = [&[p, n, self.ncpa_but_diversity_nm, fp, f_n, sp, sn], &figures[..]].concat();
        let sentence = self.sentence.as_ref().map(|text| text.split_whitespace().collect::<Vec<_>>().join(" "));
        std::iter::once(self.word.to_string()).chain(to_cells(&numbers)).chain(sentence).collect()
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        let (word, cells) = cells.split_first()?;
        let (numbers, sentence) = cells.split_at_checked(11)?;
        let [p, n, ncpa_but_diversity_nm, fp, f_n, sp, sn, reduced_chi2, evaluations, f32_nm, opencl_nm] =
            to_numbers(numbers)?[..]
        else {
            return None;
        };
        Some(Self {
            word: Cow::Owned((*word).to_owned()),
            sentence: sentence.first().map(|text| (*text).to_owned()),
            error_nm: [p, n],
            ncpa_but_diversity_nm,
            flipped_nm: [fp, f_n],
            sigma_nm: [sp, sn],
            reduced_chi2,
            evaluations: evaluations as usize,
            f32_nm,
            opencl_nm,
        })
    }
}

/// What is behind images, on the grid of an estimate.
struct Behind {
    piston_nm: Vec<f64>,
    /// `[y, x]`, NaN outside the pupil.
    phasing_nm: Array2<f64>,
    /// The same.
    ncpa_nm: Array2<f64>,
}

impl Behind {
    /// `truth`, flipped along an axis. A pupil that looks the same when flipped has a grid that is
    /// symmetric about its middle.
    ///
    /// # Errors
    /// [`Error::Shape`] for a truth of another telescope.
    fn new(truth: &Truth, pupil: &Pupil, flip: Option<Axis>) -> Result<Self> {
        let (mut piston_nm, [mut phasing_nm, mut ncpa_nm]) = (truth.piston_nm.clone(), truth.maps_on(pupil)?);
        if let Some(axis) = flip {
            phasing_nm.invert_axis(axis);
            ncpa_nm.invert_axis(axis);
            for (&owner, &nm) in pupil.owner.iter().zip(&phasing_nm).filter(|(owner, _)| **owner >= 0) {
                piston_nm[owner as usize] = nm;
            }
        }
        Ok(Self { piston_nm, phasing_nm, ncpa_nm })
    }
}

fn fitter(found: &Estimate) -> Result<&ModalFitter> {
    let modal = found.modal().ok_or_else(|| Error::Internal("the estimate is not modal".into()))?;
    Ok(&modal.fitter)
}

/// Residuals of phasing, of NCPA, and of NCPA less the best multiple of the diversity, nm; the last
/// is NaN where the modes do not span the diversity.
fn errors_nm(fitter: &ModalFitter, coefficients_nm: &[f64], behind: &Behind) -> Result<[f64; 3]> {
    let model = fitter.model();
    let pupil = &model.telescope.pupil;
    let Behind { piston_nm, phasing_nm, ncpa_nm } = behind;
    let near_nm = nearest(fitter, coefficients_nm, piston_nm);
    let phasing = residual_nm(pupil, model.map_nm(&near_nm, Group::Segment).view(), phasing_nm.view())?;
    let found_nm = model.map_nm(&near_nm, Group::Ncpa);
    let ncpa = residual_nm(pupil, found_nm.view(), ncpa_nm.view())?;
    let diversity = fitter.diversity_projection()?;
    if !diversity.is_spanned() {
        return Ok([phasing, ncpa, f64::NAN]);
    }
    let diversity_nm = model.map_nm(&diversity.coefficients_nm.to_vec(), Group::Ncpa);
    let flat = |map: Array2<f64>| -> Result<Array2<f64>> {
        Ok(pupil.remove_piston_tip_tilt(map.view())?.mapv(|v| if v.is_nan() { 0.0 } else { v }))
    };
    let (error, along) = (flat(&found_nm - ncpa_nm)?, flat(diversity_nm.clone())?);
    let weighted = &along * &pupil.amplitude;
    let share = (&error * &weighted).sum() / (&along * &weighted).sum();
    let rest = residual_nm(pupil, (found_nm - diversity_nm * share).view(), ncpa_nm.view())?;
    Ok([phasing, ncpa, rest])
}

/// Largest difference of two estimates of an image, nm; NaN where their modes differ.
pub(super) fn apart_nm(one: &Estimate, other: &Estimate) -> f64 {
    let Ok(fitter) = fitter(one) else { return f64::NAN };
    if one.modes.coefficients_nm.len() != other.modes.coefficients_nm.len() {
        return f64::NAN;
    }
    let near_nm =
        nearest(fitter, &one.modes.coefficients_nm, &other.modes.coefficients_nm[..fitter.model().segment_modes]);
    near_nm.iter().zip(&other.modes.coefficients_nm).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// The coefficients with each piston moved by the whole wavelengths that no monochromatic image can
/// tell.
fn nearest(fitter: &ModalFitter, coefficients_nm: &[f64], piston_nm: &[f64]) -> Vec<f64> {
    let model = fitter.model();
    let wavelength_nm = model.optics.parts().wavelength_nm;
    let off: Array1<f64> = coefficients_nm.iter().zip(piston_nm).map(|(found, truth)| found - truth).collect();
    // The mean over segments goes round with them: about the direction in which most of them point.
    let (sine, cosine) = off.iter().fold((0.0, 0.0), |(sine, cosine), nm| {
        let (s, c) = (std::f64::consts::TAU * nm / wavelength_nm).sin_cos();
        (sine + s, cosine + c)
    });
    let mean_nm = sine.atan2(cosine) * wavelength_nm / std::f64::consts::TAU;
    let mut near_nm = coefficients_nm.to_vec();
    // Tips and tilts of segments, which follow their pistons, stay.
    let pistons = model.segment_modes.min(model.telescope.pupil.segments.len());
    for (near, off) in near_nm[..pistons].iter_mut().zip(&off) {
        *near -= wavelength_nm * ((off - mean_nm) / wavelength_nm).round();
    }
    // Each of them has moved the mean, which no image determines.
    let off_nm: f64 = near_nm.iter().zip(piston_nm).map(|(near, truth)| near - truth).sum();
    near_nm[..pistons].iter_mut().for_each(|near| *near -= off_nm / pistons.max(1) as f64);
    near_nm
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_verdict_is_kept_to_the_bit() {
        let refused = Verdict { sentence: Some("the image is dark: no star".into()), ..Verdict::REFUSED };
        let found = Verdict { word: "warned".into(), error_nm: [1.0 / 3.0, 0.1], evaluations: 7, ..Verdict::REFUSED };
        [refused, found].iter().for_each(crate::experiment::assert_survives);
    }
}
