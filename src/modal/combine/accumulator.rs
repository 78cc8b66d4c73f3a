//! Accumulator: running static estimate of images that are fitted one after the other.

use crate::modal::assess::status::{ImageReport, Selection, assess_together};
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::diversity_error::check_reachable;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::combine::is_sequence;
use crate::modal::combine::sequence::{scatter, shrinkage_of_variance};
use crate::modal::combine::single_image::{centre, covariance_with_scatter};
use crate::modal::fitter::ModalFitter;
use crate::modal::session::Session;
use crate::modes::Group;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, Axis};
use std::sync::Arc;

/// Keeps the coefficients of the last images, and combines them by the rules of
/// [`ModalFitter::estimate`]: up to seven images are assessed one by one, eight and more as a
/// sequence. Outliers are left out as the scene says. Whether they are of one wavefront is not
/// tested.
pub struct Accumulator {
    fitter: Arc<ModalFitter>,
    motions: GlobalMotions,
    /// Inner products of the modes over the pupil, piston removed: the mean square of a map is
    /// cᵀ·G·c.
    gram: Array2<f64>,
    /// Ring buffer, `[place, mode]`, nm.
    coefficients_nm: Array2<f64>,
    reports: Vec<ImageReport>,
    /// Number of images pushed since the last [`Accumulator::clear`].
    pushed: u64,
}

/// Combined estimate of the images that are kept.
#[derive(Debug, Clone)]
pub struct RunningEstimate {
    /// Mean or median of the images used, and its covariance.
    pub modes: CombinedModes,
    /// Number of images that are kept.
    pub images: usize,
    /// Number of images that were combined.
    pub used: usize,
    /// Number of images that converged and that the clipped mean left out.
    pub clipped: usize,
    /// RMS over the pupil of the segments' part of the wavefront, nm.
    pub phasing_rms_nm: f64,
    /// RMS over the pupil of the error bar of the phasing, nm.
    pub phasing_sigma_nm: f64,
    /// RMS over the pupil of the non-common path aberrations, nm.
    pub ncpa_rms_nm: f64,
    /// RMS over the pupil of the error bar of the NCPA, nm.
    pub ncpa_sigma_nm: f64,
    /// Median reduced χ² of the images used.
    pub reduced_chi2: f64,
}

impl Accumulator {
    /// An accumulator of the last `capacity` images of the fitter's model.
    ///
    /// # Errors
    /// [`Error::Value`] for a capacity of 0, or one that memory cannot hold.
    pub fn new(fitter: Arc<ModalFitter>, capacity: usize) -> Result<Self> {
        let model = fitter.model();
        let modes = model.optics.modes();
        let size = capacity.checked_mul(modes).filter(|&size| size > 0);
        let (mut memory, mut reports) = (Vec::<f64>::new(), Vec::new());
        let is_too_large =
            |size| memory.try_reserve_exact(size).is_err() || reports.try_reserve_exact(capacity).is_err();
        if size.is_none_or(is_too_large) {
            return Err(Error::Value(format!(
                "capacity is {capacity}: 1 to as many images of {modes} coefficients as memory holds are accepted"
            )));
        }
        memory.resize(capacity * modes, 0.0);
        let coefficients_nm = Array2::from_shape_vec((capacity, modes), memory)
            .map_err(|error| Error::Internal(format!("the ring of images: {error}")))?;
        let (motions, gram) = (GlobalMotions::new(model)?, model.basis.visible_gram(&model.telescope.pupil.amplitude)?);
        Ok(Self { motions, gram, coefficients_nm, reports, pushed: 0, fitter })
    }

    /// Adds all images of the session's last fit; they replace the oldest ones. Allocates nothing.
    ///
    /// # Errors
    /// [`Error::Value`] for a session of another model, and of several channels.
    pub fn push(&mut self, session: &Session) -> Result<()> {
        let [channel] = session.channels() else {
            return Err(Error::Value(format!(
                "the session has {} channels: one of one channel is accepted, whose images a sequence combines",
                session.channels().len()
            )));
        };
        if !Arc::ptr_eq(&self.fitter, channel.fitter()) {
            return Err(Error::Value(
                "the session is of another model: one of the sequence's model is accepted".into(),
            ));
        }
        let capacity = self.coefficients_nm.nrows();
        for result in channel.results() {
            let place = (self.pushed % capacity as u64) as usize;
            self.coefficients_nm.row_mut(place).assign(&ArrayView1::from(&result.coefficients_nm));
            match self.reports.get_mut(place) {
                Some(report) => *report = result.report,
                None => self.reports.push(result.report),
            }
            self.pushed += 1;
        }
        Ok(())
    }

    /// Removes all images.
    pub fn clear(&mut self) {
        self.reports.clear();
        self.pushed = 0;
    }

    /// The fitter whose images it takes.
    pub fn fitter(&self) -> &Arc<ModalFitter> {
        &self.fitter
    }

    /// The static estimate of the images that are kept.
    ///
    /// # Errors
    /// [`Error::Image`] where none was pushed or none was fitted.
    pub fn estimate(&self) -> Result<RunningEstimate> {
        let (single_nm2, selected, coefficients_nm) = self.single()?;
        let how = self.fitter.recipe().combine;
        let covariance_nm2 = self.fitter.with_shared(single_nm2 * shrinkage_of_variance(how, selected.used.len()));
        let root = |group, product: &dyn Fn(usize, usize) -> f64| self.mean_square(group, product).max(0.0).sqrt();
        let rms = |group| root(group, &|i, j| coefficients_nm[i] * coefficients_nm[j]);
        let sigma = |group| root(group, &|i, j| covariance_nm2[[i, j]]);
        let chi2: Vec<f64> = selected.used.iter().map(|&place| self.reports[place].reduced_chi2).collect();
        Ok(RunningEstimate {
            images: self.reports.len(),
            used: selected.used.len(),
            clipped: selected.clipped.len(),
            phasing_rms_nm: rms(Group::Segment),
            phasing_sigma_nm: sigma(Group::Segment),
            ncpa_rms_nm: rms(Group::Ncpa),
            ncpa_sigma_nm: sigma(Group::Ncpa),
            reduced_chi2: median(&chi2),
            modes: CombinedModes { coefficients_nm, covariance_nm2 },
        })
    }

    /// Number of further images like those so far that would bring the error bars of both maps (RMS
    /// over the pupil) down to these values; infinity sets no limit on a map. 0 where the error
    /// bars are small enough already.
    ///
    /// Images that could not be used count, too: where one in two is used, two more are needed for
    /// one.
    ///
    /// # Errors
    /// [`Error::Value`] for a wanted error that is not positive, and those of
    /// [`Accumulator::estimate`].
    pub fn images_needed(&self, phasing_nm: f64, ncpa_nm: f64) -> Result<u64> {
        for (name, wanted) in [("phasing_nm", phasing_nm), ("ncpa_nm", ncpa_nm)] {
            if wanted.is_nan() || wanted <= 0.0 {
                return Err(Error::Value(format!("{name} is {wanted}: a positive error, or infinity, is accepted")));
            }
        }
        let now = self.estimate()?;
        // Errors that all images share are not averaged out.
        let all_shared_nm2 = self.fitter.shared_covariance_nm2();
        let shared = |group| match &all_shared_nm2 {
            Some(shared_nm2) => self.mean_square(group, &|i, j| shared_nm2[[i, j]]).max(0.0),
            None => 0.0,
        };
        let mut ratio = 0.0f64;
        for (group, sigma_nm, wanted_nm) in
            [(Group::Segment, now.phasing_sigma_nm, phasing_nm), (Group::Ncpa, now.ncpa_sigma_nm, ncpa_nm)]
        {
            let shared_nm2 = shared(group);
            check_reachable(wanted_nm, shared_nm2)?;
            let averaged_nm2 = (sigma_nm.powi(2) - shared_nm2).max(0.0);
            ratio = ratio.max((averaged_nm2 / (wanted_nm.powi(2) - shared_nm2)).sqrt());
        }
        if ratio <= 1.0 {
            return Ok(0);
        }
        // Error bars fall as the root of the number of images.
        let more = now.images as f64 * (ratio * ratio - 1.0);
        Ok(more.ceil() as u64)
    }

    /// The covariance of the coefficients of one image (nm², pistons about their mean), which
    /// images are used, and their mean or median.
    fn single(&self) -> Result<(Array2<f64>, Selection, Vec<f64>)> {
        let mut reports = self.reports.clone();
        assess_together(&mut reports);
        let reports: Vec<&ImageReport> = reports.iter().collect();
        let how = self.fitter.recipe().combine;
        let rows = self.coefficients_nm.slice(ndarray::s![..reports.len(), ..]).to_owned();
        let selected = Selection::new(&reports, &rows, how);
        if selected.used.is_empty() {
            return Err(Error::Image(match reports.first() {
                None => "the sequence holds no image: push a fitted one first".into(),
                Some(_) => format!("none of the {} images of the sequence was fitted", reports.len()),
            }));
        }
        let used_nm = rows.select(Axis(0), &selected.used);
        let coefficients_nm = centre(&self.motions, &used_nm, how);
        let median_of_used = |value: fn(&ImageReport) -> f64| {
            median(&selected.used.iter().map(|&place| value(reports[place])).collect::<Vec<_>>())
        };
        let noise_nm2 = self.fitter.bound(
            ArrayView1::from(&coefficients_nm),
            median_of_used(|report| report.flux_e),
            median_of_used(|report| report.background_e).max(0.0),
        )?;
        let single_nm2 = if is_sequence(&reports) {
            self.motions.removed_from(&scatter(&used_nm, how, &noise_nm2))
        } else {
            let chi2 = selected.used.iter().map(|&place| reports[place].reduced_chi2.max(1.0)).sum::<f64>();
            covariance_with_scatter(noise_nm2 * (chi2 / selected.used.len() as f64), &used_nm)
        };
        Ok((single_nm2, selected, coefficients_nm))
    }

    /// Mean square over the pupil of the map of a group: Σ gram[i, j]·product(i, j) over the modes
    /// of the group, where `product(i, j)` is the product (or the covariance) of two coefficients.
    fn mean_square(&self, group: Group, product: &dyn Fn(usize, usize) -> f64) -> f64 {
        let model = self.fitter.model();
        let range = match group {
            Group::Segment => 0..model.segment_modes,
            Group::Ncpa => model.segment_modes..model.basis.len(),
        };
        range
            .clone()
            .flat_map(|i| range.clone().map(move |j| (i, j)))
            .map(|(i, j)| self.gram[[i, j]] * product(i, j))
            .sum()
    }
}
