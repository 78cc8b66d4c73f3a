//! What the modes of a group leave out, marginalised by the step that single images have
//! ([`crate::modal::left_out`]): modes and illumination are of all images, and so are the errors of
//! the camera where all channels have one scale and wavelength; otherwise each channel has its own.

use crate::Result;
use crate::modal::assess::fisher::{null_floor, pseudo_inverse};
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::joint::JointEstimate;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::consistency::{Consistency, consistency};
use crate::modal::group::fit::{Group, Trial};
use crate::modal::group::unknowns::Unknowns;
use crate::modal::left_out::{
    Equations, Group as LeftOutGroup, LeftOut, SAME, Step, WithLeftOut, has_one_camera, last_zernike, priors,
};
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::scene::System;
use ndarray::{Array1, Array2, ArrayView1, s};

/// What the modes of all channels leave out.
pub(super) struct LeftOutOfChannels {
    /// Of each channel.
    pub(super) each: Vec<LeftOut>,
    /// Of all images, those of the cameras last.
    pub(super) groups: Vec<LeftOutGroup>,
    has_one_camera: bool,
}

impl LeftOutOfChannels {
    /// That of channels with `fitters` and names, the last of whose unknowns is the amplitude of
    /// the diversities in nm of `unit_nm`, where it is given.
    ///
    /// # Errors
    /// Those of [`LeftOut::new`].
    pub(super) fn new(scene: &System, fitters: &[ModalFitter], names: &[String], unit_nm: Option<f64>) -> Result<Self> {
        let last = last_zernike([fitters[0].recipe.exact_zernikes, fitters[0].recipe.prior_zernikes]);
        let each = fitters.iter().map(|fitter| LeftOut::new(&fitter.model, last, &scene.tolerance, unit_nm));
        let each = each.collect::<Result<Vec<LeftOut>>>()?;
        let has_one_camera = has_one_camera(fitters.iter().map(|fitter| &fitter.scene.image));
        let groups = each[0].groups_of(if has_one_camera { &[] } else { names });
        Ok(Self { each, groups, has_one_camera })
    }

    /// Places among all unknowns of those that an image of `channel` shares with others, where
    /// `unknowns` are those of the fit.
    fn places(&self, unknowns: &Unknowns, channel: usize) -> Vec<usize> {
        let (fitted, shared, own) = (unknowns.count(), unknowns.shared(), self.each[0].of_camera());
        let camera = if self.has_one_camera { 0 } else { channel };
        let behind = |unknown: usize| {
            let of_camera = if unknown < own.start { 0 } else { camera * own.len() };
            if unknown < shared { unknown } else { fitted + unknown - shared + of_camera }
        };
        (0..own.end).map(behind).collect()
    }

    /// Number of all unknowns.
    fn count(&self, unknowns: &Unknowns) -> usize {
        let own = self.each[0].of_camera();
        let cameras = if self.has_one_camera { 1 } else { self.each.len() };
        unknowns.count() + own.start - unknowns.shared() + own.len() * cameras
    }
}

/// The modes of a group with what they leave out.
pub(super) struct GroupPosterior {
    pub(super) left_out: WithLeftOut,
    pub(super) consistency: Consistency,
    pub(super) equations: GroupEquations,
    /// By how much the variances of the images are larger than those of their noise.
    pub(super) inflation: f64,
    /// Change of the unknowns of the fit, and of those that it left out.
    change: [Array1<f64>; 2],
    /// Change of the amplitude of the diversities and its error bar, relative; `None` where it is
    /// known.
    amplitude: Option<[f64; 2]>,
}

/// Where the unknowns of one image are among those of all.
struct Place {
    /// Of each that it shares with others.
    shared: Vec<usize>,
    /// The first of its own tip and tilt; `None` for the first image.
    tilts: Option<usize>,
}

/// Normal equations of a group, by the unknowns of its fit and by what that left out.
pub(super) struct GroupEquations {
    pub(super) information: Array2<f64>,
    pub(super) score: Array1<f64>,
    /// In the order of the group.
    images: Vec<ImageEquations>,
}

/// Normal equations of an image by its own unknowns: the modes of all images first.
struct ImageEquations {
    image: usize,
    place: Place,
    score: Array1<f64>,
    information: Array2<f64>,
}

impl GroupEquations {
    /// Those at `best`, where the channels have what they leave out.
    ///
    /// # Errors
    /// Those of [`LeftOut::normal_equations`].
    fn new((group, best): (&Group, &Trial), fitters: &[ModalFitter], of_channels: &LeftOutOfChannels) -> Result<Self> {
        let all = of_channels.count(&group.unknowns);
        let place = |image: usize, channel: usize| {
            let shared = of_channels.places(&group.unknowns, channel);
            Place { shared, tilts: group.unknowns.first_tilt(image) }
        };
        let tilts = group.unknowns.tilts();
        let (mut information, mut score) = (Array2::zeros((all, all)), Array1::zeros(all));
        let mut images = Vec::new();
        for (channel, (fitter, left_out)) in fitters.iter().zip(&of_channels.each).enumerate() {
            let members = group.members.iter().enumerate().zip(&best.minima);
            let own: Vec<_> = members.filter(|((_, member), _)| member.place[0] == channel).collect();
            if own.is_empty() {
                continue;
            }
            let frames: Vec<_> = own.iter().map(|((_, member), minimum)| (&member.image, *minimum)).collect();
            let found = left_out.normal_equations(&fitter.model, &frames)?;
            for (number, ((image, _), _)) in own.into_iter().enumerate() {
                let own = ImageEquations {
                    image,
                    place: place(image, channel),
                    score: found.images[number].clone(),
                    information: found.information_of(number),
                };
                own.place.add(&own.information, &own.score, &tilts, (&mut information, &mut score));
                images.push(own);
            }
        }
        images.sort_by_key(|own| own.image);
        Ok(Self { information, score, images })
    }

    /// What of the score of each image, by the modes of `group`, what was left out does not
    /// explain, and the χ² of each that `step` explains.
    fn explained(&self, group: &Group, step: &Step, tilts_with_prior: usize) -> (Vec<Array1<f64>>, Vec<f64>) {
        let (fitted, shared) = (group.unknowns.count(), group.unknowns.shared());
        let tilts = group.unknowns.tilts();
        let left_out = step.with_prior_change.slice(s![tilts_with_prior..]);
        let change = |place: &Place| -> Array1<f64> {
            let of = |&unknown: &usize| match unknown.checked_sub(fitted) {
                None => step.change[unknown],
                Some(behind) => left_out[behind],
            };
            let mut own: Array1<f64> = place.shared.iter().map(of).collect();
            for (axis, tilt) in tilts.outer_iter().enumerate() {
                let own_nm = place.tilts.map_or(0.0, |first| step.change[first + axis]);
                own.slice_mut(s![..shared]).scaled_add(own_nm, &tilt);
            }
            own
        };
        let of_image = |own: &ImageEquations| {
            let (change, left) = (change(&own.place), s![..shared, shared..]);
            let score = &own.score.slice(s![..shared]) - &own.information.slice(left).dot(&change.slice(s![shared..]));
            (score, change.dot(&(&own.score * 2.0 - own.information.dot(&change))))
        };
        self.images.iter().map(of_image).unzip()
    }
}

impl GroupPosterior {
    /// Marginalises what the modes leave out of the fit `best` of `group`, whose images have the
    /// Gauss-Newton matrices `information_of_each` by their modes, and whose channels have
    /// `fitters` with the diversities that were found.
    ///
    /// # Errors
    /// Those of [`Step::new`].
    pub(super) fn new(
        (group, best, information_of_each): (&Group, &Trial, &[Array2<f64>]),
        fitters: &[ModalFitter],
        of_channels: &LeftOutOfChannels,
    ) -> Result<Self> {
        let fitter = &fitters[0];
        let modes = fitter.model.optics.modes();
        let all = GroupEquations::new((group, best), fitters, of_channels)?;
        let (left_out, groups) = (&of_channels.each[0], &of_channels.groups);
        let (mut at, mut at_modes) = (Array1::from(best.point.clone()), best.point[..modes].to_vec());
        fitter.motions.remove(&mut at_modes);
        at.slice_mut(s![..modes]).assign(&ArrayView1::from(&at_modes));
        let (mut inflation, chi2) = (1.0, best.chi2());
        let freedom = chi2 / best.reduced_chi2();
        for pass in 0.. {
            let equations = Equations {
                information: &(&all.information / inflation),
                score: &(&all.score / inflation),
                fitted: &at,
                tilts: left_out.tilts(),
                precision: Some(group.precision(&best.prior, left_out.tilts())),
                floor: null_floor(all.score.len(), group.pixels()),
                inverse: None,
            };
            let step = Step::new(&equations, &priors(groups))?;
            let (scores, explained_chi2) = all.explained(group, &step, left_out.tilts().len());
            let scale = ((chi2 - explained_chi2.iter().sum::<f64>()) / freedom).max(1.0);
            let consistency = consistency(group, information_of_each, scores, scale)?;
            let before = inflation;
            inflation = scale * consistency.of_all.0.max(1.0);
            if pass == 0 && inflation > before * (1.0 + SAME) {
                continue;
            }
            let own = |all: &Array2<f64>| fitter.motions.removed_from(&all.slice(s![..modes, ..modes]).to_owned());
            let amplitude = group.unknowns.amplitude().map(|place| {
                let variance = step.noise[[place, place]] + step.added[[place, place]];
                [step.change[place], variance.sqrt()].map(|nm| nm / group.amplitude_unit_nm())
            });
            let mut coefficients_nm = (&at + &step.change).slice(s![..modes]).to_vec();
            fitter.motions.remove(&mut coefficients_nm);
            let combined = CombinedModes { coefficients_nm, covariance_nm2: own(&step.noise) + own(&step.added) };
            let left_out = WithLeftOut::new((left_out, &fitter.motions), groups, &step, combined, 1.0);
            let left_out = WithLeftOut { explained_chi2, ..left_out };
            let behind = step.with_prior_change.slice(s![of_channels.each[0].tilts().len()..]).to_owned();
            let change = [step.change, behind];
            return Ok(Self { left_out, consistency, equations: all, inflation, change, amplitude });
        }
        unreachable!("the second step is the last")
    }

    /// χ² of an image of `channel` that was not fitted, which what was left out of the images of
    /// `group` explains: with tip and tilt that follow.
    ///
    /// # Errors
    /// Those of [`LeftOut::normal_equations`].
    pub(super) fn explained(
        &self,
        group: &Group,
        (channel, fitter): (usize, &ModalFitter),
        (prepared, minimum): (&PreparedFrame, &Minimum),
        of_channels: &LeftOutOfChannels,
    ) -> Result<f64> {
        let (fitted, shared) = (group.unknowns.count(), group.unknowns.shared());
        let found = of_channels.each[channel].normal_equations(&fitter.model, &[(prepared, minimum)])?;
        let (information, score) = (found.information_of(0), found.images[0].clone());
        let [own, behind] = &self.change;
        let places = of_channels.places(&group.unknowns, channel);
        let of = |&place: &usize| place.checked_sub(fitted).map_or_else(|| own[place], |place| behind[place]);
        let mut change: Array1<f64> = places.iter().map(of).collect();
        let mut tilts = Array2::zeros((group.unknowns.tilts().nrows(), change.len()));
        tilts.slice_mut(s![.., ..shared]).assign(&group.unknowns.tilts());
        let along = tilts.dot(&information);
        let slope = tilts.dot(&score) - along.dot(&change);
        let inverse = pseudo_inverse(&along.dot(&tilts.t()), null_floor(tilts.nrows(), group.pixels()))?;
        change += &tilts.t().dot(&inverse.dot(&slope));
        Ok(change.dot(&(score * 2.0 - information.dot(&change))))
    }

    /// Puts what was found in place of that of the fit.
    pub(super) fn apply(&self, joint: &mut JointEstimate, fitter: &ModalFitter) {
        joint.modes = self.left_out.modes.clone();
        [joint.maps, joint.sigma_maps] = self.left_out.whole.maps(&fitter.model);
        joint.disagreement = self.consistency.of_all;
        joint.left_out = Some(self.left_out.clone());
        if let (Some(fitted), Some([change, sigma])) = (&mut joint.defocus, self.amplitude) {
            fitted.value += fitted.scene * change;
            fitted.sigma = fitted.scene.abs() * sigma;
        }
    }
}

impl Place {
    /// Adds the normal equations of this image to those of all.
    fn add(
        &self,
        information: &Array2<f64>,
        score: &Array1<f64>,
        tilts: &Array2<f64>,
        (all, all_score): (&mut Array2<f64>, &mut Array1<f64>),
    ) {
        for (&to, (row, slope)) in self.shared.iter().zip(information.outer_iter().zip(score)) {
            all_score[to] += slope;
            for (&other, value) in self.shared.iter().zip(row) {
                all[[to, other]] += value;
            }
        }
        let Some(first) = self.tilts else { return };
        let modes = tilts.ncols();
        // Rows of the own tips and tilts, by the shared unknowns.
        let along = tilts.dot(&information.slice(s![..modes, ..]));
        let own = along.slice(s![.., ..modes]).dot(&tilts.t());
        let slopes = tilts.dot(&score.slice(s![..modes]));
        for (axis, row) in along.outer_iter().enumerate() {
            all_score[first + axis] += slopes[axis];
            for (&to, value) in self.shared.iter().zip(row) {
                all[[first + axis, to]] += value;
                all[[to, first + axis]] += value;
            }
            for (other, value) in own.row(axis).iter().enumerate() {
                all[[first + axis, first + other]] += value;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    /// Two modes and one that is left out, which come first and last among six unknowns, and a tip
    /// of the image's own.
    #[test]
    fn equations_of_an_image_are_those_of_its_unknowns_among_all() {
        let tilts = array![[0.5, -2.0]];
        let place = Place { shared: vec![0, 1, 5], tilts: Some(3) };
        let known = array![[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 3.0]];
        let score = array![1.0, -0.5, 0.25];
        let (mut all, mut all_score) = (Array2::zeros((6, 6)), Array1::zeros(6));
        place.add(&known, &score, &tilts, (&mut all, &mut all_score));
        // Coefficients of the image by all unknowns.
        let design =
            array![[1.0, 0.0, 0.0, 0.5, 0.0, 0.0], [0.0, 1.0, 0.0, -2.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]];
        let expected = design.t().dot(&known.dot(&design));
        assert!((&all - &expected).iter().all(|off| off.abs() < 1e-14), "{all} {expected}");
        assert!((&all_score - &design.t().dot(&score)).iter().all(|off| off.abs() < 1e-14), "{all_score}");
    }
}
