//! What the modes of channels leave out, marginalised after the combination of the channels.
//!
//! The images of channel i have their minimum at ĉ_i − M_i l if what was left out is l, with
//! M = H_ff⁺ H_fl of their Gauss-Newton matrix, and a χ² that is lower by 2 s·l − lᵀ S l. With the
//! unknowns z of the combination,
//!
//! ```text
//! Σ (ĉ_i − M_i l − D_iᵀ z)ᵀ Λ_i (ĉ_i − M_i l − D_iᵀ z) + lᵀ S_i l − 2 s_i·l        D = [1 p]ᵀ
//! ```
//!
//! is a quadratic form of z and l, with s_i = g_l − Mᵀ g_f, −½ of the gradient of its χ² by l where
//! the modes follow; and the step that marginalises l is that of the images of one channel.

use super::normal::{Likelihood, Normal, design};
use crate::Result;
use crate::modal::assess::fisher::{null_floor, pseudo_inverse};
use crate::modal::combine::ModalEstimate;
use crate::modal::fitter::ModalFitter;
use crate::modal::left_out::{Equations, Group, LeftOut, OwnEquations, Step, has_one_camera, priors};
use ndarray::{Array1, Array2, s};

/// The combination of channels, with what their modes leave out.
pub(super) struct WithStep<'a> {
    /// What the first channel leaves out.
    pub(super) modes: &'a LeftOut,
    pub(super) step: Step,
    pub(super) groups: Vec<Group>,
    /// The combination, with the covariance of noise and of what was left out.
    pub(super) combined: Normal,
    /// Scatter of the channels about it, over its expectation, and its degrees of freedom.
    pub(super) disagreement: (f64, f64),
}

/// What a channel says of what was left out.
struct Reduced {
    /// M, of all that was left out of the channels.
    moves: Array2<f64>,
    /// S.
    information: Array2<f64>,
    /// s.
    score: Array1<f64>,
}

impl Reduced {
    /// From the equations of a channel, the unknowns of which are at `places` among all `count`.
    fn new(equations: &OwnEquations, fitted: usize, places: &[usize], count: usize) -> Result<Self> {
        let OwnEquations { information, score, scale, pixels } = equations;
        let floor = null_floor(information.nrows(), *pixels);
        let cross = information.slice(s![..fitted, fitted..]);
        let own = pseudo_inverse(&information.slice(s![..fitted, ..fitted]).to_owned(), floor)?.dot(&cross);
        let left = (&information.slice(s![fitted.., fitted..]) - &cross.t().dot(&own)) / *scale;
        let score = &score.slice(s![fitted..]) - &own.t().dot(&score.slice(s![..fitted]));
        let mut all = Self {
            moves: Array2::zeros((fitted, count)),
            information: Array2::zeros((count, count)),
            score: Array1::zeros(count),
        };
        for (&to, ((column, row), score)) in
            places.iter().zip(own.columns().into_iter().zip(left.outer_iter()).zip(&score))
        {
            all.moves.column_mut(to).assign(&column);
            all.score[to] = score / scale;
            places.iter().zip(row).for_each(|(&other, value)| all.information[[to, other]] = *value);
        }
        Ok(all)
    }
}

impl<'a> WithStep<'a> {
    /// Marginalises what is left out of the combination `found` of `likelihoods`; `None` where a
    /// channel does not know it.
    ///
    /// # Errors
    /// Those of [`Step::new`].
    pub(super) fn of(
        channels: &[(&'a ModalFitter, &'a ModalEstimate)],
        names: &[String],
        likelihoods: &[Likelihood],
        found: &Normal,
    ) -> Result<Option<Self>> {
        let each = channels.iter().map(|(fitter, own)| Ok(fitter.left_out()?.zip(own.left_out_equations())));
        let each: Option<Vec<(&LeftOut, &OwnEquations)>> = each.collect::<Result<Option<_>>>()?;
        let Some(each) = each else { return Ok(None) };
        let [(first, _), ..] = each[..] else { return Ok(None) };
        let (fitted, own) = (channels[0].0.model.optics.modes(), first.of_camera());
        let is_one = has_one_camera(channels.iter().map(|(fitter, _)| &fitter.scene.image));
        let groups = first.groups_of(if is_one { &[] } else { names });
        let before = found.solution.len();
        let count = own.start - fitted + own.len() * if is_one { 1 } else { each.len() };
        let mut information = Array2::zeros((before + count, before + count));
        let mut score = Array1::zeros(before + count);
        information.slice_mut(s![..before, ..before]).assign(&found.matrix);
        let mut reduced = Vec::new();
        for (channel, ((_, equations), likelihood)) in each.iter().zip(likelihoods).enumerate() {
            let camera = if is_one { 0 } else { channel * own.len() };
            let place = |unknown: usize| unknown - fitted + if unknown < own.start { 0 } else { camera };
            let places: Vec<usize> = (fitted..own.end).map(place).collect();
            let known = Reduced::new(equations, fitted, &places, count)?;
            let design = design(likelihood, found.has_amplitude)?;
            let off = &likelihood.coefficients_nm - &design.t().dot(&found.solution);
            let weighed = likelihood.information.dot(&known.moves);
            let cross = design.dot(&weighed);
            let mut part = information.slice_mut(s![..before, before..]);
            part += &cross;
            let mut part = information.slice_mut(s![before.., ..before]);
            part += &cross.t();
            let mut part = information.slice_mut(s![before.., before..]);
            part += &known.moves.t().dot(&weighed);
            part += &known.information;
            let mut part = score.slice_mut(s![before..]);
            part += &weighed.t().dot(&off);
            part += &known.score;
            reduced.push(known.moves);
        }
        let equations = Equations {
            information: &information,
            score: &score,
            fitted: &found.solution,
            tilts: first.tilts(),
            precision: None,
            floor: null_floor(before + count, before + count),
            inverse: None,
        };
        let step = Step::new(&equations, &priors(&groups))?;
        let left_out = step.with_prior_change.slice(s![first.tilts().len()..]);
        let moved = likelihoods.iter().zip(&reduced).map(|(likelihood, moves)| Likelihood {
            coefficients_nm: &likelihood.coefficients_nm - &moves.dot(&left_out),
            ..likelihood.clone()
        });
        let combined = Normal {
            solution: &found.solution + &step.change,
            covariance: &step.noise + &step.added,
            matrix: found.matrix.clone(),
            ..*found
        };
        let disagreement = combined.disagreement(&moved.collect::<Vec<_>>());
        Ok(Some(Self { modes: first, step, groups, combined, disagreement }))
    }
}
