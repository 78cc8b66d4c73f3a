//! Joint estimate of the channels of one wavefront, from an estimate of each.
//!
//! Near their minima the objectives of the channels are quadratic in the modes, so that the minimum
//! of their sum follows from the minimum ĉ_i of each and its covariance C_i by generalised least
//! squares:
//!
//! ```text
//! ĉ_i = c + δ p_i + T t_i + noise       c: the modes, common to all channels
//! Λ_i = C_i⁺ − C_i⁺ T (Tᵀ C_i⁺ T)⁻¹ Tᵀ C_i⁺    T: tip and tilt of all channels but the first, which are each channel's own
//! N = Σ [1 p_i]ᵀ Λ_i [1 p_i] + diag(0, 1/σ²)    [c δ] = N⁺ Σ [1 p_i]ᵀ Λ_i ĉ_i      covariance N⁺
//! ```
//!
//! δ is the relative error of the amplitude of the diversities d_i, whose coefficients are p_i: an
//! image of c behind (1+δ) d_i is that of c + δ d_i behind d_i. One mechanism is assumed to make
//! them all. It is known to σ (`tolerance.defocus_fraction`), not at all where
//! `estimate.fit_optics` names "defocus", and exactly otherwise. Two images with diversities d and
//! −d determine it, one does not.
//!
//! The scatter of the ĉ_i about the result, in units of its expectation, is small only where the
//! channels are of one wavefront by one model: an image that is flipped, or of another wavelength
//! than the scene says, disagrees with the others.

mod left_out;
mod normal;

use crate::modal::assess::fisher::{null_floor, pseudo_inverse, without};
use crate::modal::assess::tilts::spanned_tip_and_tilt;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::integers::{self, ColourChannel, PistonInteger};
use crate::modal::combine::pistons;
use crate::modal::combine::static_maps::StaticMaps;
use crate::modal::combine::{ModalEstimate, with_prior};
use crate::modal::fitter::ModalFitter;
use crate::modal::left_out::WithLeftOut;
use crate::scene::{Optic, OpticalParameter, System};
use crate::{Error, Result};
use left_out::WithStep;
use ndarray::{Array1, Array2, s};
use normal::{Likelihood, Normal};

/// Fitter of a channel, and what it found.
type ChannelFit<'a> = (&'a ModalFitter, &'a ModalEstimate);

/// Channels agree where the reduced χ² of their differences is above 1 by no more than this many of
/// its standard deviations, √(2/n) of n degrees of freedom,
const DEVIATIONS: f64 = 5.0;
/// and by what the sampling of the model adds to it: 0.1 to 0.3 of the χ² of an image at a peak S/N
/// of 500 to 1,000. A flipped image gives 1,000 and more at S/N 500.
const ALLOWANCE: f64 = 0.3;

/// Least share of the information on the amplitude of the diversities that the modes must leave:
/// below, an error of 1 % of the projections would be taken for it.
pub(in crate::modal) const LEAST_SHARE: f64 = 1e-4;

/// Estimate from several channels.
pub(crate) struct JointEstimate {
    /// The modes, with the prior and the errors that all images share.
    pub(crate) modes: CombinedModes,
    /// Segment errors and NCPA.
    pub(crate) maps: StaticMaps,
    /// Their error bars.
    pub(crate) sigma_maps: StaticMaps,
    /// Amplitude of the diversity of the first channel that has one, where it was fitted.
    pub(crate) defocus: Option<OpticalParameter>,
    /// What the modes leave out, where it is marginalised.
    pub(crate) left_out: Option<WithLeftOut>,
    /// Whole wavelengths of each segment's piston; none where the channels have one wavelength.
    pub(crate) integers: Vec<PistonInteger>,
    /// Change of the modes for a relative error 1 of the amplitude of all diversities, nm; none
    /// where that is unknown or fitted.
    pub(crate) diversity_effect_nm: Option<Array1<f64>>,
    /// Scatter of the channels about the estimate over its expectation, and its degrees of freedom.
    pub(crate) disagreement: (f64, f64),
    /// The same by the modes alone, before what these leave out explains a part of it.
    pub(crate) disagreement_by_modes: (f64, f64),
    /// Modes by each channel, with the whole wavelengths of its pistons, nm.
    pub(crate) channels_nm: Vec<Vec<f64>>,
}

/// Resolves the whole wavelengths of the pistons, where the variances of the channels are `scale`
/// times those of their noise.
fn resolve(
    scene: &System,
    likelihoods: &mut [Likelihood],
    wavelengths_nm: &[f64],
    pistons: usize,
    scale: f64,
) -> Result<Vec<PistonInteger>> {
    let covariance_nm2 = Normal::new(likelihoods, false, 0.0)?.covariance * scale;
    let information: Vec<Array2<f64>> = likelihoods.iter().map(|channel| &channel.information / scale).collect();
    let each = likelihoods.iter_mut().zip(wavelengths_nm).zip(&information);
    let mut colours: Vec<ColourChannel> = each
        .map(|((likelihood, &wavelength_nm), information)| ColourChannel {
            wavelength_nm,
            coefficients_nm: &mut likelihood.coefficients_nm,
            information,
        })
        .collect();
    Ok(integers::resolve(&mut colours, &covariance_nm2, pistons, scene.modes.piston_range_nm))
}

/// Refuses fitters that do not have the same modes.
///
/// # Errors
/// [`Error::Scene`].
pub(in crate::modal) fn check_same_modes<'a>(fitters: impl IntoIterator<Item = &'a ModalFitter>) -> Result<()> {
    let mut fitters = fitters.into_iter();
    let Some(first) = fitters.next() else { return Ok(()) };
    match fitters.find(|other| other.model.basis.names() != first.model.basis.names()) {
        None => Ok(()),
        Some(other) => Err(Error::Scene(format!(
            "{} has {} modes, and {} has {}: channels of one wavefront need one telescope and the same modes",
            other.scene.name(),
            other.model.basis.len(),
            first.scene.name(),
            first.model.basis.len()
        ))),
    }
}

/// Combines the estimates of the channels of `scene`, which have the same modes, and `names`; what
/// they leave out is marginalised where it was for each.
///
/// # Errors
/// [`Error::Scene`] for an amplitude of the diversity that is to be fitted and that the modes do
/// not span; [`Error::Value`] where no mode changes the images.
pub(crate) fn joint(scene: &System, channels: &[ChannelFit], names: &[String]) -> Result<JointEstimate> {
    let Some(&(first, _)) = channels.first() else { return Err(Error::Internal("no channel is combined".into())) };
    let (count, model) = (first.model.optics.modes(), &first.model);
    check_same_modes(channels.iter().map(|(fitter, _)| *fitter))?;
    let likelihoods = channels.iter().enumerate();
    let mut likelihoods =
        likelihoods.map(|(number, &fit)| likelihood_of(fit, number, channels[0])).collect::<Result<Vec<_>>>()?;
    let amplitude = fitted_amplitude(scene);
    let is_fitted = amplitude.is_some();
    let sigma = scene.tolerance.defocus_fraction;
    let is_unknown = is_fitted || sigma > 0.0;
    if is_unknown {
        check_spanned(channels)?;
    }
    let wavelengths_nm: Vec<f64> = channels.iter().map(|fit| fit.0.model.optics.parts().wavelength_nm).collect();
    let mut integers = Vec::new();
    if integers::are_determined(&wavelengths_nm) {
        integers = resolve(scene, &mut likelihoods, &wavelengths_nm, model.pistons(), 1.0)?;
        let (chi2, _) = Normal::new(&likelihoods, false, 0.0)?.disagreement(&likelihoods);
        if chi2 > 1.0 {
            // The channels are less precise than their noise, and integers less certain.
            let again = resolve(scene, &mut likelihoods, &wavelengths_nm, model.pistons(), chi2)?;
            integers = again.into_iter().zip(integers).map(|(new, old)| new.following(&old)).collect();
        }
    }
    let normal =
        |with_amplitude: bool| Normal::new(&likelihoods, with_amplitude, if is_fitted { 0.0 } else { sigma.powi(-2) });
    let mut found = normal(is_unknown)?;
    let share = if is_fitted { found.share_of_amplitude(&likelihoods) } else { 0.0 };
    if is_fitted && share <= LEAST_SHARE {
        found = normal(false)?;
    }
    let disagreement_by_modes = found.disagreement(&likelihoods);
    let mut disagreement = disagreement_by_modes;
    let diversity_effect_nm = (!found.has_amplitude).then(|| {
        let each = likelihoods.iter().map(|channel| channel.information.dot(&channel.diversity_nm));
        found.covariance.dot(&each.fold(Array1::zeros(count), |sum, one| sum + one))
    });
    let with_step = WithStep::of(channels, names, &likelihoods, &found)?;
    if let Some(with_step) = &with_step {
        (found, disagreement) = (with_step.combined.clone(), with_step.disagreement);
    }
    // Channels that disagree by more than their noise are wrong by at least as much.
    let of_modes = |all: &Array2<f64>| {
        first.motions.removed_from(&all.slice(s![..count, ..count]).to_owned()) * disagreement.0.max(1.0)
    };
    let mut coefficients_nm = found.solution.slice(s![..count]).to_vec();
    first.motions.remove(&mut coefficients_nm);
    let likelihood = CombinedModes { coefficients_nm, covariance_nm2: of_modes(&found.covariance) };
    let modes = with_prior(model, likelihood.clone())?;
    let mut left_out = with_step.map(|WithStep { modes: own, step, groups, .. }| {
        WithLeftOut::new((own, &first.motions), &groups, &step, likelihood, disagreement.0.max(1.0))
    });
    let [maps, sigma_maps] = match &mut left_out {
        Some(left_out) => {
            left_out.whole.take_prior(model)?;
            left_out.whole.maps(model)
        }
        None => [StaticMaps::of_modes(model, &modes), StaticMaps::of_error_bars(model, &modes)],
    };
    Ok(JointEstimate {
        maps,
        sigma_maps,
        modes,
        defocus: amplitude.and_then(|optic| fitted_defocus(optic, channels, &found, share)),
        left_out,
        integers,
        diversity_effect_nm,
        disagreement,
        disagreement_by_modes,
        channels_nm: likelihoods.iter().map(|channel| channel.coefficients_nm.to_vec()).collect(),
    })
}

/// Whether channels whose differences have the given reduced χ² and degrees of freedom differ by
/// more than their noise.
pub(in crate::modal) fn contradict((chi2, freedom): (f64, f64)) -> bool {
    freedom > 0.0 && chi2 > 1.0 + ALLOWANCE + DEVIATIONS * (2.0 / freedom).sqrt()
}

impl JointEstimate {
    /// Whether the channels differ by more than their noise.
    pub(crate) fn is_contradictory(&self) -> bool {
        contradict(self.disagreement)
    }

    /// Whether they do so by the modes alone: what these leave out explains wrong whole wavelengths
    /// of many segments, too.
    pub(crate) fn is_contradictory_by_modes(&self) -> bool {
        contradict(self.disagreement_by_modes)
    }
}

/// The modes that several channels have in common, from estimates of each with the covariance of
/// their noise; pistons within half a wavelength of the first channel's.
///
/// # Errors
/// [`Error::Value`] where no mode changes the images.
pub(crate) fn combine_estimates(scene: &System, channels: &[(&ModalFitter, CombinedModes)]) -> Result<CombinedModes> {
    let Some((first, reference)) = channels.first() else {
        return Err(Error::Internal("no channel is combined".into()));
    };
    let each = channels.iter().enumerate().map(|(number, (fitter, own))| {
        normal_likelihood(fitter, own.clone(), number, (first, &reference.coefficients_nm))
    });
    let likelihoods = each.collect::<Result<Vec<_>>>()?;
    let sigma = scene.tolerance.defocus_fraction;
    let found = Normal::new(&likelihoods, sigma > 0.0, if sigma > 0.0 { sigma.powi(-2) } else { 0.0 })?;
    let modes = first.model.optics.modes();
    let mut coefficients_nm = found.solution.slice(s![..modes]).to_vec();
    first.motions.remove(&mut coefficients_nm);
    let covariance_nm2 = first.motions.removed_from(&found.covariance.slice(s![..modes, ..modes]).to_owned());
    Ok(CombinedModes { coefficients_nm, covariance_nm2 })
}

/// Likelihood of the channel `number`; its pistons within half a wavelength of the first channel's.
fn likelihood_of((fitter, found): ChannelFit, number: usize, (first, reference): ChannelFit) -> Result<Likelihood> {
    let mut likelihood = found.likelihood().clone();
    for shared in
        fitter.shared_errors().iter().filter(|shared| shared.name != crate::modal::combine::diversity_error::NAME)
    {
        likelihood.covariance_nm2 += &shared.covariance_nm2;
    }
    normal_likelihood(fitter, likelihood, number, (first, &reference.likelihood().coefficients_nm))
}

/// Likelihood from the estimate of the channel `number`; its pistons within half a wavelength of
/// `reference_nm`, the first channel's.
fn normal_likelihood(
    fitter: &ModalFitter,
    mut likelihood: CombinedModes,
    number: usize,
    (first, reference_nm): (&ModalFitter, &[f64]),
) -> Result<Likelihood> {
    let model = &fitter.model;
    let diversity_nm = fitter.diversity_projection()?.coefficients_nm;
    if number > 0 {
        pistons::wrap(&mut likelihood.coefficients_nm, reference_nm, model);
        first.motions.remove(&mut likelihood.coefficients_nm);
    }
    let modes = model.optics.modes();
    // An inverse in scaled coordinates has other null directions than the covariance, in each
    // channel others.
    let information = pseudo_inverse(&likelihood.covariance_nm2, null_floor(modes, modes))?;
    let mut information = fitter.motions.without_information_on(&information);
    if number > 0 {
        information = without(information, &spanned_tip_and_tilt(model)?);
    }
    let coefficients_nm = Array1::from(likelihood.coefficients_nm);
    Ok(Likelihood { coefficients_nm, information, diversity_nm })
}

/// Refuses an unknown amplitude of diversities that are not combinations of the modes.
///
/// # Errors
/// [`Error::Scene`] where the modes of a channel do not span its diversity.
fn check_spanned(channels: &[ChannelFit]) -> Result<()> {
    channels.iter().try_for_each(|(fitter, _)| spanned_diversity(fitter).map(|_| ()))
}

/// Coefficients of the diversity of a channel, nm, whose amplitude is unknown.
///
/// # Errors
/// [`Error::Scene`] where the modes do not span it.
pub(in crate::modal) fn spanned_diversity(fitter: &ModalFitter) -> Result<Array1<f64>> {
    let projection = fitter.diversity_projection()?;
    if projection.rms_nm > 0.0 && !projection.is_spanned() {
        return Err(Error::Scene(format!(
            "{}: the amplitude of the diversities is unknown (estimate.fit_optics with \"defocus\", or tolerance.defocus_fraction), which \
             channels determine where the modes span every diversity: raise modes.ncpa_count or leave both out",
            fitter.scene.name()
        )));
    }
    Ok(projection.coefficients_nm)
}

/// The word of `estimate.fit_optics` that fits the amplitude of the diversities of `scene`; `None`
/// where it is known.
pub(in crate::modal) fn fitted_amplitude(scene: &System) -> Option<Optic> {
    let words = &scene.estimate.fit_optics;
    [Optic::DEFOCUS, Optic::DIVERSITY].into_iter().find(|optic| words.contains(optic))
}

/// The first amplitude of a diversity of `channels` that is not 0, in the unit of `optic`; `None`
/// where there is none.
pub(in crate::modal) fn amplitude_of<'a>(
    optic: Optic,
    mut channels: impl Iterator<Item = &'a ModalFitter>,
) -> Option<f64> {
    let parameter = optic.parameters().first()?;
    channels.find_map(|fitter| Some(parameter.get(&fitter.scene)).filter(|value| *value != 0.0))
}

/// The amplitude of the first diversity, from the relative error that was found.
fn fitted_defocus(optic: Optic, channels: &[ChannelFit], found: &Normal, share: f64) -> Option<OpticalParameter> {
    let scene = amplitude_of(optic, channels.iter().map(|(fitter, _)| *fitter))?;
    let (value, sigma) = match found.amplitude() {
        Some((delta, sigma)) => (scene * (1.0 + delta), scene.abs() * sigma),
        None => (scene, f64::INFINITY),
    };
    Some(OpticalParameter::of_key(optic, optic.key()?, [scene, value]).with_error(sigma, share))
}
