//! The mean wavefront of several groups.
//!
//! With x_g the modes at the minimum of group g, s_g and I_g −½ of the gradient of its χ² and the
//! Gauss-Newton matrix by the modes and by what they leave out, tips and tilts of its images
//! eliminated, the normal equations of all are
//!
//! ```text
//! Σ_g I_g/a_g  z = Σ_g (s_g + I_g x_g)/a_g        a_g: by how much its variances exceed those of the noise
//! ```
//!
//! and where they are of several wavefronts Σ I_g z = Σ (s_g + I_g x̄), x̄ the mean of all x_g.
//! The prior of the modes is learnt from them once more, and what the modes leave out is common to
//! all groups. Whether the groups are of one wavefront is tested by the modes of each with that
//! prior about the mean of all. Where they are, the reduced χ² of their differences multiplies the
//! variances if it is above 1; where they are not, their scatter is added to these.

use crate::Result;
use crate::modal::assess::fisher::{null_floor, pseudo_inverse, score_without, without};
use crate::modal::combine::agreement::{Agreement, TestedImages, Verdict, Whitening};
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::joint::JointEstimate;
use crate::modal::combine::pistons;
use crate::modal::combine::sequence::{SEQUENCE, scatter};
use crate::modal::combine::single_image::centre;
use crate::modal::combine::static_maps::StaticMaps;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::Minima;
use crate::modal::group::fit::{Group, Trial};
use crate::modal::group::posterior::{GroupEquations, LeftOutOfChannels};
use crate::modal::group::prior::Prior;
use crate::modal::group::stored::StoredGroup;
use crate::modal::left_out::{Equations, Step, WithLeftOut, priors};
use crate::scene::Combine;
use ndarray::{Array1, Array2, Axis, s};

/// What one group of a sequence says.
pub(super) struct FittedGroup {
    /// x.
    pub(super) coefficients_nm: Array1<f64>,
    /// I, by the modes and what they leave out.
    information: Array2<f64>,
    /// s.
    score: Array1<f64>,
    /// The same for a relative error 1 of the amplitude of all diversities, where nothing is left
    /// out.
    effect: Array1<f64>,
    /// a.
    inflation: f64,
    prior: Prior,
    pixels: usize,
}

impl FittedGroup {
    /// The group at `best`, whose images have the Gauss-Newton matrices `each`; with what the modes
    /// leave out where `equations` have it.
    ///
    /// # Errors
    /// Those of the inverse of a matrix that is not finite.
    pub(super) fn new(
        (group, best): (&Group, &Trial),
        each: &[Array2<f64>],
        equations: Option<&GroupEquations>,
        inflation: f64,
        fitter: &ModalFitter,
    ) -> Result<Self> {
        let (modes, fitted) = (group.unknowns.shared(), group.unknowns.count());
        let (information, score) = match equations {
            Some(equations) => (equations.information.clone(), equations.score.clone()),
            None => (group.sum_of(each), group.score()),
        };
        let mut effect = Array1::zeros(score.len());
        effect.slice_mut(s![..fitted]).assign(&group.effect_of_diversities(each)?);
        let kept: Vec<usize> = (0..modes).chain(fitted..score.len()).collect();
        let own: Vec<usize> = (modes..fitted).collect();
        let block = |rows: &[usize], columns: &[usize]| information.select(Axis(0), rows).select(Axis(1), columns);
        // Tip and tilt of each image but the first, which are well known.
        let along = match own.is_empty() {
            true => Array2::zeros((kept.len(), 0)),
            false => {
                let floor = null_floor(own.len(), group.pixels());
                block(&kept, &own).dot(&pseudo_inverse(&block(&own, &own), floor)?)
            }
        };
        let left = block(&kept, &kept) - along.dot(&block(&own, &kept));
        // Those of the first are among the modes.
        let mut tilts = Array2::zeros((group.unknowns.tilts().nrows(), kept.len()));
        tilts.slice_mut(s![.., ..modes]).assign(&group.unknowns.tilts());
        let [score, effect] = [score, effect].map(|slope| {
            let left_slope = slope.select(Axis(0), &kept) - along.dot(&slope.select(Axis(0), &own));
            score_without(&left, left_slope, &tilts)
        });
        let mut coefficients_nm = best.point[..modes].to_vec();
        fitter.motions.remove(&mut coefficients_nm);
        Ok(Self {
            coefficients_nm: coefficients_nm.into(),
            // In the layout of one that is read from a file, so that sums have the same rounding.
            information: without(left, &tilts).as_standard_layout().into_owned(),
            score,
            effect: effect.slice(s![..modes]).to_owned(),
            inflation,
            prior: best.prior.clone(),
            pixels: group.pixels(),
        })
    }

    /// What a group `stored` says, of the prior `prior` before its images said more; `None` for one
    /// of another size.
    pub(super) fn of_stored(stored: &StoredGroup, prior: Prior) -> Option<Self> {
        let StoredGroup { coefficients_nm, effect, score, information, levels_nm, inflation, pixels, .. } = stored;
        let (count, modes) = (score.len(), coefficients_nm.len());
        let is_whole = effect.len() == modes && levels_nm.len() == prior.levels_nm().len();
        Some(Self {
            coefficients_nm: coefficients_nm.clone().into(),
            information: Array2::from_shape_vec((count, count), information.clone()).ok().filter(|_| is_whole)?,
            score: score.clone().into(),
            effect: effect.clone().into(),
            inflation: *inflation,
            prior: prior.with_levels(levels_nm),
            pixels: *pixels,
        })
    }

    /// What it says, as it is stored.
    pub(super) fn stored(&self, minima: Minima) -> StoredGroup {
        StoredGroup {
            coefficients_nm: self.coefficients_nm.to_vec(),
            effect: self.effect.to_vec(),
            score: self.score.to_vec(),
            information: self.information.iter().copied().collect(),
            levels_nm: self.prior.levels_nm(),
            inflation: self.inflation,
            pixels: self.pixels,
            minima,
        }
    }

    /// Its modes with `prior` about `mean_nm`, and their covariance from the noise of its images,
    /// nm².
    fn about(&self, mean_nm: &Array1<f64>, prior: &Prior, fitter: &ModalFitter) -> Result<(Array1<f64>, Array2<f64>)> {
        let (modes, at) = (self.coefficients_nm.len(), &self.coefficients_nm);
        let own = &self.information.slice(s![..modes, ..modes]) / self.inflation;
        let precision = prior.precision(modes);
        let inverse = pseudo_inverse(&(&own + &precision), null_floor(modes, self.pixels))?;
        let slope = &self.score.slice(s![..modes]) / self.inflation - precision.dot(&(at - mean_nm));
        let mut coefficients_nm = (at + &inverse.dot(&slope)).to_vec();
        fitter.motions.remove(&mut coefficients_nm);
        Ok((coefficients_nm.into(), fitter.motions.removed_from(&inverse.dot(&own).dot(&inverse))))
    }
}

/// The groups of a sequence and their mean.
pub(super) struct Mean {
    pub(super) joint: JointEstimate,
    /// Whether the groups are of one wavefront.
    pub(super) agreement: Agreement,
    /// Those whose mean it is.
    pub(super) used: Vec<usize>,
    /// Whether its error bars are from their scatter.
    pub(super) has_scatter: bool,
}

/// Normal equations of several groups about a point.
struct Sum {
    at: Array1<f64>,
    information: Array2<f64>,
    score: Array1<f64>,
    effect: Array1<f64>,
    /// Prior of the modes with the levels that these say.
    prior: Prior,
    floor: f64,
}

impl Sum {
    /// Those of the groups `used`, which are at `rows_nm`, about the mean of these; each with its
    /// weight where `has_weights`.
    ///
    /// # Errors
    /// Those of [`Prior::learn`].
    fn new(
        groups: &[FittedGroup],
        (used, rows_nm): (&[usize], &Array2<f64>),
        has_weights: bool,
        fitter: &ModalFitter,
    ) -> Result<Self> {
        let (count, modes) = (groups[0].score.len(), rows_nm.ncols());
        let used_nm = rows_nm.select(Axis(0), used);
        let at = Array1::from(centre(&fitter.motions, &used_nm, Combine::Mean));
        let mean_inflation = used.iter().map(|&place| groups[place].inflation).sum::<f64>() / used.len() as f64;
        let (mut information, mut score) = (Array2::zeros((count, count)), Array1::zeros(count));
        let mut effect = Array1::zeros(modes);
        for (&place, row_nm) in used.iter().zip(used_nm.outer_iter()) {
            let group = &groups[place];
            let weight = if has_weights { group.inflation } else { mean_inflation }.recip();
            information.scaled_add(weight, &group.information);
            score.scaled_add(weight, &group.score);
            if has_weights {
                score.scaled_add(weight, &group.information.slice(s![.., ..modes]).dot(&(&row_nm - &at)));
            }
            effect.scaled_add(weight, &group.effect);
        }
        let own = information.slice(s![..modes, ..modes]).to_owned();
        let mut prior = groups[used[0]].prior.clone();
        prior.learn(&own, &(own.dot(&at) + score.slice(s![..modes])))?;
        let floor = null_floor(count, groups.iter().map(|group| group.pixels).sum());
        Ok(Self { at, information, score, effect, prior, floor })
    }

    /// Multiplies the variances of all groups by `scale`.
    fn inflate(&mut self, scale: f64) {
        self.information /= scale;
        self.score /= scale;
        self.effect /= scale;
    }

    /// Change of the modes from the point, and their covariance, if nothing is left out.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes the images.
    fn modes_alone(&self) -> Result<(Array1<f64>, Array2<f64>)> {
        let (modes, precision) = (self.at.len(), self.prior.precision(self.at.len()));
        let own = &self.information.slice(s![..modes, ..modes]) + &precision;
        let covariance_nm2 = pseudo_inverse(&own, self.floor)?;
        let slope = &self.score.slice(s![..modes]) - &precision.dot(&self.at);
        Ok((covariance_nm2.dot(&slope), covariance_nm2))
    }

    /// The estimate, whose covariance has `scatter_nm2` beyond the noise.
    ///
    /// # Errors
    /// Those of [`Step::new`]; [`crate::Error::Value`] where no mode changes the images.
    fn estimate(
        &self,
        scatter_nm2: &Array2<f64>,
        fitter: &ModalFitter,
        left_out: Option<&LeftOutOfChannels>,
    ) -> Result<JointEstimate> {
        let (change, noise_nm2) = self.modes_alone()?;
        let with = |change: &Array1<f64>, covariance_nm2: &Array2<f64>| {
            let mut coefficients_nm = (&self.at + change).to_vec();
            fitter.motions.remove(&mut coefficients_nm);
            let covariance_nm2 = fitter.motions.removed_from(covariance_nm2) + scatter_nm2;
            CombinedModes { coefficients_nm, covariance_nm2 }
        };
        let (modes, left_out) = match left_out {
            Some(of_channels) => {
                let (step, first) = (self.step(of_channels)?, &of_channels.each[0]);
                let modes = with(&step.change, &(&step.noise + &step.added));
                let found = WithLeftOut::new((first, &fitter.motions), &of_channels.groups, &step, modes.clone(), 1.0);
                (modes, Some(found))
            }
            None => (with(&change, &noise_nm2), None),
        };
        let own_maps =
            || [StaticMaps::of_modes(&fitter.model, &modes), StaticMaps::of_error_bars(&fitter.model, &modes)];
        let [maps, sigma_maps] = left_out.as_ref().map_or_else(own_maps, |left_out| left_out.whole.maps(&fitter.model));
        Ok(JointEstimate {
            maps,
            sigma_maps,
            modes,
            defocus: None,
            left_out,
            integers: Vec::new(),
            diversity_effect_nm: Some(noise_nm2.dot(&self.effect)),
            disagreement: (1.0, 0.0),
            disagreement_by_modes: (1.0, 0.0),
            channels_nm: Vec::new(),
        })
    }

    /// The step that marginalises what is left out.
    ///
    /// # Errors
    /// Those of [`Step::new`].
    fn step(&self, left_out: &LeftOutOfChannels) -> Result<Step> {
        let tilts = left_out.each[0].tilts();
        let equations = Equations {
            information: &self.information,
            score: &self.score,
            fitted: &self.at,
            tilts: tilts.clone(),
            precision: Some(self.prior.precision_but(self.at.len(), tilts)),
            floor: self.floor,
            inverse: None,
        };
        Step::new(&equations, &priors(&left_out.groups))
    }
}

/// The mean of `groups`, without outliers where the scene says so; what they leave out is
/// `left_out`.
///
/// # Errors
/// Those of [`Step::new`]; [`crate::Error::Value`] where no mode changes the images.
pub(super) fn mean_of(
    groups: &[FittedGroup],
    fitter: &ModalFitter,
    left_out: Option<&LeftOutOfChannels>,
) -> Result<Mean> {
    let modes = fitter.model.optics.modes();
    let rows = groups.iter().map(|group| {
        let mut row_nm = group.coefficients_nm.to_vec();
        pistons::wrap_if_monochromatic(&mut row_nm, &groups[0].coefficients_nm.to_vec(), &fitter.model);
        fitter.motions.remove(&mut row_nm);
        row_nm
    });
    let rows: Vec<Vec<f64>> = rows.collect();
    let mut rows_nm = Array2::from_shape_fn((groups.len(), modes), |(group, mode)| rows[group][mode]);
    let mut used: Vec<usize> = (0..groups.len()).collect();
    // By one prior, for the levels that a group finds are noise, too, and about the mean of all, so
    // that it moves faint groups no further from bright ones.
    let sum = Sum::new(groups, (&used, &rows_nm), true, fitter)?;
    let mean_nm = &sum.at + &sum.modes_alone()?.0;
    let (mut fitted_nm, mut noise_nm2) = (rows_nm.clone(), Vec::new());
    for (group, (mut fitted_nm, row_nm)) in groups.iter().zip(fitted_nm.outer_iter_mut().zip(rows_nm.outer_iter())) {
        let to_row_nm = &row_nm - &group.coefficients_nm;
        let (own_nm, own_noise_nm2) = group.about(&(&mean_nm - &to_row_nm), &sum.prior, fitter)?;
        fitted_nm.assign(&(own_nm + to_row_nm));
        noise_nm2.push(own_noise_nm2);
    }
    let mean_noise_nm2 = |used: &[usize]| {
        let sum_nm2 = used.iter().fold(Array2::zeros((modes, modes)), |sum, &place| sum + &noise_nm2[place]);
        sum_nm2 / used.len() as f64
    };
    let mut agreement = Agreement::untested();
    if groups.len() > 1 {
        let whitening = Whitening::new(fitter, &mean_noise_nm2(&used))?;
        let variances = noise_nm2.iter().map(|noise_nm2| whitening.variance(noise_nm2)).collect();
        let tested = TestedImages::new(fitter, &whitening, fitted_nm.clone(), variances);
        agreement = tested.agreement(&whitening);
        // Whole wavelengths.
        rows_nm += &(&tested.coefficients_nm - &fitted_nm);
        fitted_nm = tested.coefficients_nm;
        if let (Verdict::Outliers(outliers), Combine::ClippedMean) = (&agreement.verdict, fitter.recipe.combine) {
            used.retain(|group| !outliers.contains(group));
        }
    }
    let is_clipped = used.len() < groups.len();
    // Groups of one wavefront count by what they know. Of several, each of which knows another part
    // best, the mean is wanted.
    let has_weights = is_clipped || !agreement.is_significant();
    let mut sum = Sum::new(groups, (&used, &rows_nm), has_weights, fitter)?;
    let mut scatter_nm2 = Array2::zeros((modes, modes));
    if !has_weights {
        let used_nm = fitted_nm.select(Axis(0), &used);
        scatter_nm2 = scatter_beyond_noise(&agreement, &used_nm, &mean_noise_nm2(&used), fitter);
    } else if !is_clipped && agreement.reduced_chi2 > 1.0 {
        sum.inflate(agreement.reduced_chi2);
    }
    let has_scatter = !has_weights && used.len() >= SEQUENCE;
    Ok(Mean { joint: sum.estimate(&scatter_nm2, fitter, left_out)?, agreement, used, has_scatter })
}

/// What the covariance of the mean of groups that are not of one wavefront, with the modes
/// `used_nm`, has beyond the mean of their `noise_nm2`: from eight on by their scatter, otherwise
/// by the χ² of their differences, because the scatter of few is of low rank.
fn scatter_beyond_noise(
    agreement: &Agreement,
    used_nm: &Array2<f64>,
    noise_nm2: &Array2<f64>,
    fitter: &ModalFitter,
) -> Array2<f64> {
    let count = used_nm.nrows();
    let single_nm2 = if count >= SEQUENCE {
        fitter.motions.removed_from(&scatter(used_nm, Combine::Mean, noise_nm2))
    } else {
        noise_nm2 * agreement.reduced_chi2
    };
    // The mean of several wavefronts is as far from each of them as they are from each other.
    let shared_by = if agreement.is_contradictory() { 1 } else { count };
    (single_nm2 - noise_nm2) / shared_by as f64
}
