//! Groups: images of one wavefront that are fitted together, each with a tip, a tilt, a flux and a
//! background of its own.
//!
//! An image in focus does not determine the signs of even aberrations, and its objective has many
//! minima. Several with known differences (focus, shapes of a mirror) together determine all:
//!
//! ```text
//! J(c, α, t) = Σ_i J_i(c + T t_i; (1 + α) d_i) + cᵀ P c
//! T: tip and tilt; d_i: the diversity of image i; P: the inverse covariance of the prior
//! ```
//!
//! α, the relative error of the amplitude of all diversities, is unknown where
//! `estimate.fit_optics` says so; its sign is then unknown, too, and both are tried.
//!
//! | File | What is in it |
//! |---|---|
//! | `unknowns` | the unknowns of a group, and those of each of its images |
//! | `prior` | prior of the modes, whose levels follow from the images |
//! | `member` | an image of a group with its model |
//! | `fit` | the fit from one start |
//! | `starts` | fits from several starts, and which minima there are |
//! | `consistency` | whether the images are of one wavefront |
//! | `posterior` | what the modes leave out, marginalised |
//! | `sequence`, `mean` | groups that have a wavefront each, and the mean of these |
//! | `stored` | fits of groups that were made before |

mod consistency;
mod fit;
mod mean;
mod member;
mod posterior;
pub(in crate::modal) mod prior;
pub(in crate::modal) mod sequence;
mod starts;
pub(in crate::modal) mod stored;
pub(in crate::modal) mod unknowns;

use crate::Result;
use crate::control::{Control, Stage};
use crate::modal::assess::fisher::{null_floor, pseudo_inverse};
use crate::modal::assess::status::Status;
use crate::modal::combine::agreement::Agreement;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::joint::{JointEstimate, LEAST_SHARE, amplitude_of, check_same_modes, fitted_amplitude};
use crate::modal::combine::static_maps::StaticMaps;
use crate::modal::combine::{ModalEstimate, combine};
use crate::modal::estimate::image_fits::FittedCube;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::consistency::{Consistency, consistency};
use crate::modal::group::fit::{Freedom, Group, Trial};
use crate::modal::group::posterior::{GroupPosterior, LeftOutOfChannels};
use crate::modal::group::starts::{fit_from_all, is_right};
use crate::modal::prepare::cube::Cube;
use crate::modal::solve::engine::{FitState, ImageFit, prepare_frames, reason_of_none};
use crate::scene::{Optic, OpticalParameter, System};
use ndarray::{Array2, Axis, s};
use std::time::Instant;

pub(crate) use starts::{Minima, Search};

/// The images of one channel in a group, and the fitter of its scene.
pub(crate) struct GroupChannel<'a> {
    /// Its name, empty where it is the only one.
    pub(crate) name: String,
    pub(crate) fitter: ModalFitter,
    pub(crate) cube: Cube<'a>,
    /// Which images are fitted; the others are compared with the wavefront of these.
    pub(crate) fitted: Vec<bool>,
}

/// Estimate from the images of a group.
pub(crate) struct GroupEstimate {
    /// The modes that all images share.
    pub(crate) joint: JointEstimate,
    /// The images of each channel at the minimum of all, with the fitter that has the fitted
    /// amplitude of its diversity; or why none of them can be used.
    pub(crate) channels: Vec<std::result::Result<(ModalFitter, ModalEstimate), String>>,
    /// The minima that were found.
    pub(crate) minima: Minima,
    /// Whether every image that is fitted can be used, and one wavefront explains all.
    pub(crate) is_explained: bool,
    /// Channel and number of each image that was fitted, and the reduced χ² of its difference from
    /// the wavefront of all: the largest first; none for fewer than three images.
    pub(crate) differences: Vec<([usize; 2], f64)>,
    /// Where it is the mean of several groups.
    pub(crate) sequence: Option<GroupSequence>,
}

/// The groups of a sequence, by their numbers.
pub(crate) struct GroupSequence {
    /// Whether the groups are of one wavefront.
    pub(crate) agreement: Agreement,
    /// Those that were fitted: all of whose images can be used.
    pub(crate) fitted: Vec<usize>,
    /// Whether the error bars are from their scatter.
    pub(crate) has_scatter: bool,
    /// Those of these whose mean the estimate is.
    pub(crate) used: Vec<usize>,
}

/// Fits the images of all `channels` of `scene` together, and marginalises what the modes leave
/// out, or does not; `near_nm` are the modes that some of them show alone.
///
/// # Errors
/// [`crate::Error::Image`] where no image can be used, [`crate::Error::Shape`] for images of
/// another size than their scene's, [`crate::Error::Scene`] for channels with other modes,
/// [`crate::Error::Interrupted`].
pub(crate) fn estimate_group(
    scene: &System,
    channels: Vec<GroupChannel>,
    (near_nm, search): (Option<&[f64]>, Search),
    marginalise: bool,
    control: &Control,
) -> Result<GroupEstimate> {
    let started = Instant::now();
    check_same_modes(channels.iter().map(|channel| &channel.fitter))?;
    let mut fits = channels.iter().map(|channel| channel.fitter.prepared(&channel.cube)).collect::<Result<Vec<_>>>()?;
    control.enter(Stage::Fitting, 0);
    let own: Vec<&ModalFitter> = channels.iter().map(|channel| &channel.fitter).collect();
    let is_fitted = |[channel, image]: [usize; 2]| channels[channel].fitted[image];
    let mut found = Solution::new(scene, &own, &fits, is_fitted, (near_nm, search), control)?;
    control.enter(Stage::Combining, 0);
    let fitters = own.iter().map(|fitter| found.fitter(fitter)).collect::<Result<Vec<_>>>()?;
    let names: Vec<String> = channels.iter().map(|channel| channel.name.clone()).collect();
    let left_out = marginalise.then(|| {
        // In nm of the diversity before it had the amplitude that was found.
        let amplitude = found.group.unknowns.amplitude();
        let unit_nm = amplitude.map(|place| found.group.amplitude_unit_nm() + found.best.point[place]);
        LeftOutOfChannels::new(scene, &fitters, &names, unit_nm)
    });
    let left_out = left_out.transpose()?;
    let of_group = (&found.group, &found.best, &found.normal.each[..]);
    let posterior = left_out.as_ref().map(|of| GroupPosterior::new(of_group, &fitters, of)).transpose()?;
    if let Some(posterior) = &posterior {
        found.explain(&posterior.left_out.explained_chi2);
    }
    found.group.write(&found.best, &mut fits);
    let places = fits.iter().enumerate().flat_map(|(channel, fits)| (0..fits.len()).map(move |image| [channel, image]));
    for place in places.filter(|place| !is_fitted(*place)).collect::<Vec<_>>() {
        let unknowns = &found.group.unknowns;
        let sigma = unknowns.amplitude().map(|_| f64::INFINITY);
        let mut alone = Group::new(&own, &fits, |other| other == place, sigma);
        // An image that cannot be used has its reason already.
        let Ok(alone) = &mut alone else { continue };
        let mut compared = alone.fit(&found.best.point[..unknowns.shared()], Freedom::Tilts, &control.silent())?;
        if let (Some(posterior), Some(left_out)) = (&posterior, &left_out) {
            let (fitter, image) = ((place[0], &fitters[place[0]]), (&alone.members[0].image, &compared.minima[0]));
            let explained = posterior.explained(&found.group, fitter, image, left_out)?;
            let chi2 = &mut compared.minima[0].chi2;
            chi2.value -= explained / chi2.freedom;
        }
        alone.write(&compared, &mut fits);
    }
    let mut joint = found.joint(&fitters)?;
    let mut differences = &found.normal.consistency.of_each;
    if let Some(posterior) = &posterior {
        posterior.apply(&mut joint, &fitters[0]);
        differences = &posterior.consistency.of_each;
    }
    let fitted = channels.iter().flat_map(|channel| &channel.fitted).filter(|is_fitted| **is_fitted).count();
    let is_whole = found.group.members.len() == fitted;
    let is_explained = is_whole && found.is_explained() && !joint.is_contradictory();
    let mut differences: Vec<_> =
        found.group.members.iter().map(|member| member.place).zip(differences.iter().copied()).collect();
    differences.sort_by(|a, b| b.1.total_cmp(&a.1));
    if differences.len() < 3 {
        differences.clear();
    }
    let (minima, channels) = (found.minima, of_channels(fitters, fits, started)?);
    Ok(GroupEstimate { joint, channels, minima, is_explained, differences, sequence: None })
}

/// The images of each channel at their minima, by `fitters`; or why none of them can be used. Their
/// fits began at `started`.
fn of_channels(
    fitters: Vec<ModalFitter>,
    fits: Vec<Vec<ImageFit>>,
    started: Instant,
) -> Result<Vec<std::result::Result<(ModalFitter, ModalEstimate), String>>> {
    let mut estimates = Vec::new();
    for (mut fitter, fits) in fitters.into_iter().zip(fits) {
        if let Some(reason) = fits.iter().all(|fit| !fit.is_fitted()).then(|| reason_of_none(&fits)) {
            estimates.push(Err(reason));
            continue;
        }
        // What is left out is common to the group.
        fitter.recipe.marginalise = false;
        let mut own = combine(&fitter, FittedCube::from_fits(fits), false)?;
        (own.is_of_group, own.device) = (true, "cpu".into());
        own.seconds =
            if estimates.iter().any(std::result::Result::is_ok) { 0.0 } else { started.elapsed().as_secs_f64() };
        estimates.push(Ok((fitter, own)));
    }
    Ok(estimates)
}

/// The joint estimate of images that were fitted alone by `fitters` of the channels of `scene`,
/// from `near_nm`; `None` where one wavefront does not explain them.
///
/// # Errors
/// As [`estimate_group`].
pub(in crate::modal) fn refined(
    scene: &System,
    fitters: &[&ModalFitter],
    mut fits: Vec<Vec<ImageFit>>,
    near_nm: &[f64],
) -> Result<Option<JointEstimate>> {
    fits.iter_mut().flatten().filter(|fit| fit.is_fitted()).for_each(|fit| fit.state = FitState::NotBegun);
    let control = Control::default();
    let found = Solution::new(scene, fitters, &fits, |_| true, (Some(near_nm), Search::First), &control)?;
    let own = fitters.iter().map(|fitter| found.fitter(fitter)).collect::<Result<Vec<_>>>()?;
    let joint = found.joint(&own)?;
    Ok((found.is_explained() && !joint.is_contradictory()).then_some(joint))
}

/// The best minimum of a group, with its normal equations.
struct Solution<'a> {
    group: Group<'a>,
    best: Trial,
    minima: Minima,
    normal: Normal,
    /// The word of `estimate.fit_optics` that fits the amplitude of the diversities.
    amplitude: Option<Optic>,
    /// See [`Normal::share_of_amplitude`].
    share: f64,
}

impl<'a> Solution<'a> {
    /// Fits the images `is_fitted` of `fits` from the starts of `search`.
    ///
    /// # Errors
    /// As [`estimate_group`].
    fn new(
        scene: &System,
        fitters: &[&'a ModalFitter],
        fits: &[Vec<ImageFit>],
        is_fitted: impl Fn([usize; 2]) -> bool,
        search: (Option<&[f64]>, Search),
        control: &Control,
    ) -> Result<Self> {
        let amplitude = fitted_amplitude(scene);
        let known_to = Some(scene.tolerance.defocus_fraction).filter(|sigma| *sigma > 0.0);
        let mut group = Group::new(fitters, fits, &is_fitted, amplitude.map(|_| f64::INFINITY).or(known_to))?;
        let (mut best, mut minima) = fit_from_all(&mut group, search, control)?;
        let mut normal = Normal::new(&mut group, &mut best)?;
        let share = normal.share_of_amplitude();
        if amplitude.is_some() && share <= LEAST_SHARE {
            // The images do not show the amplitude: it stays as the scene says.
            group = Group::new(fitters, fits, &is_fitted, None)?;
            (best, minima) = fit_from_all(&mut group, search, control)?;
            normal = Normal::new(&mut group, &mut best)?;
        }
        group.gather_pistons(&mut best);
        Ok(Self { group, best, minima, normal, amplitude, share })
    }

    /// Takes what the modes leave out from the χ² of each image.
    fn explain(&mut self, chi2: &[f64]) {
        for (minimum, explained) in self.best.minima.iter_mut().zip(chi2) {
            minimum.chi2.value -= explained / minimum.chi2.freedom;
        }
        self.minima.is_suspicious &= !is_right(&self.best);
    }

    /// Whether the wavefront explains every image.
    fn is_explained(&self) -> bool {
        let each = self.group.members.iter().zip(&self.best.minima);
        each.map(|(member, minimum)| member.status(minimum)).all(|status| status == Status::Ok)
    }

    /// Factor of the diversities that was found.
    fn factor(&self) -> f64 {
        1.0 + self.best.amplitude(&self.group)
    }

    /// `fitter` with the diversity that was found.
    fn fitter(&self, fitter: &ModalFitter) -> Result<ModalFitter> {
        match self.group.unknowns.amplitude() {
            Some(_) => fitter.with_diversity_times(self.factor()),
            None => Ok(fitter.clone()),
        }
    }

    /// The joint estimate, where `fitters` have the diversities that were found.
    fn joint(&self, fitters: &[ModalFitter]) -> Result<JointEstimate> {
        let mut joint = self.normal.estimate(&self.group, &self.best, &fitters[0])?;
        joint.defocus = self.amplitude.and_then(|optic| {
            let value = amplitude_of(optic, fitters.iter())?;
            let scene = value / self.factor();
            let relative = self.normal.sigma_of_amplitude().map(|nm| nm / self.group.amplitude_unit_nm());
            let sigma = relative.map_or(f64::INFINITY, |sigma| scene.abs() * sigma);
            Some(OpticalParameter::of_key(optic, optic.key()?, [scene, value]).with_error(sigma, self.share))
        });
        Ok(joint)
    }
}

impl ModalFitter {
    /// This fitter with `factor` times the diversity.
    fn with_diversity_times(&self, factor: f64) -> Result<Self> {
        let scene = self.scene.with(|sections| {
            sections.image.diversity_focus_waves_rms *= factor;
            sections.image.diversity_scale *= factor;
        })?;
        let model = self.model.with_diversity_times(factor)?;
        Ok(Self { scene_basis: self.scene_basis.clone(), ..Self::from_model(&scene, self.recipe.clone(), model)? })
    }

    /// The images of `cube`, prepared for a fit.
    fn prepared(&self, cube: &Cube) -> Result<Vec<ImageFit>> {
        let frames = self.frames(cube)?;
        let control = Control::default();
        let mut fits = vec![ImageFit::new(&self.model.preparation, self.model.optics.modes()); frames.len()];
        prepare_frames(&self.task(&control), &frames, &mut fits);
        Ok(fits)
    }
}

/// Normal equations of a group at its minimum.
struct Normal {
    /// Gauss-Newton matrix of each image.
    each: Vec<Array2<f64>>,
    /// Gauss-Newton matrix of the unknowns with the inverse covariance of the prior.
    information: Array2<f64>,
    /// See [`null_floor`].
    floor: f64,
    /// Covariance of the unknowns.
    covariance: Array2<f64>,
    /// Place of the amplitude of the diversities.
    amplitude: Option<usize>,
    consistency: Consistency,
    /// By how much the variances of the images are larger than those of their noise.
    inflation: f64,
}

impl Normal {
    fn new(group: &mut Group, best: &mut Trial) -> Result<Self> {
        let scale = best.reduced_chi2().max(1.0);
        let each = best.each.take().unwrap_or_else(|| group.information_of_each(&best.point));
        group.evaluate(&best.point);
        let consistency = consistency(group, &each, group.scores(), scale)?;
        let inflation = scale * consistency.of_all.0.max(1.0);
        let information = group.sum_of(&each) / inflation + &best.prior.precision(group.unknowns.count());
        let floor = null_floor(information.nrows(), group.pixels());
        let covariance = pseudo_inverse(&information, floor)?;
        let amplitude = group.unknowns.amplitude();
        Ok(Self { each, information, floor, covariance, amplitude, consistency, inflation })
    }

    /// Share of the information on the amplitude of the diversities that the other unknowns leave;
    /// 0 where it is known.
    fn share_of_amplitude(&self) -> f64 {
        let Some(place) = self.amplitude else { return 0.0 };
        let others: Vec<usize> = (0..self.information.nrows()).filter(|&unknown| unknown != place).collect();
        let left = self.information.select(Axis(0), &others).select(Axis(1), &others);
        let cross = self.information.column(place).select(Axis(0), &others);
        let own = self.information[[place, place]];
        let reproduced = pseudo_inverse(&left, self.floor).map_or(own, |inverse| cross.dot(&inverse.dot(&cross)));
        if own > 0.0 { ((own - reproduced) / own).max(0.0) } else { 0.0 }
    }

    /// Error bar of the amplitude, nm of the largest diversity; `None` where it is known.
    fn sigma_of_amplitude(&self) -> Option<f64> {
        self.amplitude.map(|place| self.covariance[[place, place]].sqrt())
    }

    /// The estimate of the modes, without the amplitude of the diversities.
    fn estimate(&self, group: &Group, best: &Trial, first: &ModalFitter) -> Result<JointEstimate> {
        let modes = first.model.optics.modes();
        let mut coefficients_nm = best.point[..modes].to_vec();
        first.motions.remove(&mut coefficients_nm);
        let own = self.covariance.slice(s![..modes, ..modes]).to_owned();
        let covariance_nm2 = first.motions.removed_from(&own);
        let diversity_effect_nm = match self.amplitude {
            Some(_) => None,
            None => {
                let right = group.effect_of_diversities(&self.each)?;
                Some(self.covariance.dot(&(right / self.inflation)).slice(s![..modes]).to_owned())
            }
        };
        let combined = CombinedModes { coefficients_nm, covariance_nm2 };
        Ok(JointEstimate {
            maps: StaticMaps::of_modes(&first.model, &combined),
            sigma_maps: StaticMaps::of_error_bars(&first.model, &combined),
            modes: combined,
            defocus: None,
            left_out: None,
            integers: Vec::new(),
            diversity_effect_nm,
            disagreement: self.consistency.of_all,
            disagreement_by_modes: self.consistency.of_all,
            channels_nm: Vec::new(),
        })
    }
}
