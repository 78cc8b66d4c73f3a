//! Frame estimator: an estimate of each frame as it comes, with everything that does not depend on
//! the frame made once.
//!
//! By [`Policy::realtime`] a frame is fitted by a [`Session`]; by any other policy an [`Estimator`]
//! makes the estimate of a file. Both report the same modes, those of the scene, so that estimates
//! of one night can be compared and tracked.

use super::channels::named;
use super::consistency::{Electrons, reconcile};
use super::estimate::Estimate;
use super::estimator::{Estimator, check_size, in_order_of};
use super::images::{Images, counted};
use super::misfit::saturation;
use super::modal_errors::{ModalErrors, change_by};
use super::policy::Policy;
use super::scene_files::check_for_estimate;
use super::warnings::contradiction_warning;
use crate::control::Control;
use crate::loop_response::{Corrections, SegmentLimits};
use crate::modal::{
    ChannelFitters, CombinedModes, FitOptions, FittedImage, ImageReport, ModalFitter, Session, SessionOptions, Status,
    check_frame_shape,
};
use crate::planner;
use crate::scene::{Grouping, Scene};
use crate::statistics::median;
use crate::tracking::Correction;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView2, Axis};
use std::sync::Arc;

/// Estimates frames of one scene, one after the other; with several channels groups, which are one
/// frame of each.
pub struct FrameEstimator {
    /// The scene, with the choices of its plan where it named a budget.
    scene: Scene,
    fitter: Arc<ModalFitter>,
    method: Method,
}

enum Method {
    /// Sessions for frames without and with bad pixels, which are fitted at their native sampling.
    Sessions([Option<Box<Session>>; 2]),
    Pipeline(Box<Estimator>),
}

/// Estimate of one frame, of the modes of [`FrameEstimator::fitter`].
#[derive(Debug, Clone)]
pub struct FrameEstimate {
    /// The modes, with their covariance; NaN where there is no fit.
    pub modes: CombinedModes,
    /// Report on the fit. Of an estimate from several images it is that of the first that is used,
    /// with the status and the χ² of the estimate, and where they are fitted each by itself the
    /// mean tip and tilt.
    pub report: ImageReport,
    /// Why the numbers must not be used: a sentence; `None` where they may.
    pub refusal: Option<String>,
    /// Sentences that a user should read before using the numbers.
    pub warnings: Vec<String>,
    /// The frame, or that of the first channel, beside its model, at the model's sampling.
    pub compared: Option<FittedImage>,
}

impl FrameEstimator {
    /// Builds the model of `scene`, and by [`Policy::realtime`] a session of it: a second at the
    /// size of Keck.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene with `estimate.method = "full-phase"` or `"auto"`, or with a
    /// key that the policy does not honour, as `estimate.group = "all"` in real time; those of
    /// [`ChannelFitters::new`], [`Session::new`] and [`Estimator::with_policy`].
    pub fn new(scene: &Scene, policy: Policy, control: Control) -> Result<Self> {
        policy.check(scene)?;
        check_for_estimate(scene)?;
        let scene = planner::resolve(scene, &control)?;
        if policy == Policy::realtime() {
            let session = Session::new(ChannelFitters::new(&scene, false)?, &SessionOptions::default())?;
            let fitter = session.fitters().first().clone();
            return Ok(Self { scene, fitter, method: Method::Sessions([Some(Box::new(session)), None]) });
        }
        // The fitter gives the modes alone, where a pipeline fits optical parameters and has images
        // with diversities of their own as well.
        let (_, first) = scene.each_channel()[0];
        let modes_of = first.system().with(|sections| {
            sections.estimate.fit_optics.clear();
            sections.estimate.group = Grouping::Auto;
            sections.image.diversity_planes.iter_mut().for_each(|planes| planes.truncate(1));
            sections.image.pupil_turns_deg.iter_mut().for_each(|turns_deg| turns_deg.truncate(1));
        })?;
        let fitter = Arc::new(ModalFitter::new(&modes_of, false)?);
        // What the modes leave out all frames share: it is no noise that a state averages.
        let alone = scene.changed(|sections| sections.leave_out_posterior())?;
        let method = Method::Pipeline(Box::new(Estimator::with_policy(&alone, policy, control)?));
        Ok(Self { scene, fitter, method })
    }

    /// The fitter whose modes are estimated, that of the first channel.
    pub fn fitter(&self) -> &Arc<ModalFitter> {
        &self.fitter
    }

    /// The scene, with the choices of its plan where it named a budget.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Number of estimates from `images`, those of each channel: one for each image, or each group,
    /// in real time, else one from all.
    pub fn estimates_of(&self, images: &(impl AsRef<[Images]> + ?Sized)) -> usize {
        match &self.method {
            Method::Sessions(_) => images.as_ref().iter().map(Images::len).max().unwrap_or(0),
            Method::Pipeline(_) => 1,
        }
    }

    /// Estimate `number` of [`FrameEstimator::estimates_of`] from `images`, those of each channel
    /// as in [`Estimator::estimate`], which are checked and converted as there.
    ///
    /// # Errors
    /// [`Error::Image`] and [`Error::Shape`] for images that contradict the scene or have another
    /// size or another number than those of the other channels; those of the fit. A frame that
    /// cannot be fitted is no error: see [`FrameEstimate::refusal`].
    pub fn estimate(&mut self, images: &(impl AsRef<[Images]> + ?Sized), number: usize) -> Result<FrameEstimate> {
        match &mut self.method {
            Method::Sessions(sessions) => {
                let images = in_order_of(&self.scene, images.as_ref())?;
                fit(&self.scene, sessions, &group_of(&self.scene, &images, number)?)
            }
            Method::Pipeline(estimator) => FrameEstimate::of_estimate(&estimator.estimate(images)?, &self.fitter),
        }
    }
}

impl FrameEstimator {
    /// Which of these modes the scene's policy corrects, and by how much: the decision alone, in
    /// microseconds. NCPA stay where the scene names no mirror.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of modes; [`Error::Value`] for segment modes that are
    /// not pistons.
    pub fn correction(&self, coefficients_nm: ArrayView1<f64>, covariance_nm2: ArrayView2<f64>) -> Result<Correction> {
        let coefficients_nm = coefficients_nm.to_vec();
        self.errors(&coefficients_nm, covariance_nm2)?.correction()
    }

    /// Corrections of these modes, such as those of a tracked state, as [`Estimate::corrections`]
    /// makes them of an estimate.
    ///
    /// # Errors
    /// As [`FrameEstimator::correction`], and those of [`Estimate::corrections`].
    pub fn corrections(
        &self,
        coefficients_nm: ArrayView1<f64>,
        covariance_nm2: ArrayView2<f64>,
    ) -> Result<Corrections> {
        let coefficients_nm = coefficients_nm.to_vec();
        self.errors(&coefficients_nm, covariance_nm2)?.corrections(None)
    }

    /// What `corrections` change of the coefficients, nm, when they are applied.
    ///
    /// # Errors
    /// Those of building the mirror.
    pub fn change_by(&self, corrections: &Corrections) -> Result<Vec<f64>> {
        change_by(&self.scene, self.fitter.model(), corrections)
    }

    fn errors<'a>(
        &'a self,
        coefficients_nm: &'a [f64],
        covariance_nm2: ArrayView2<'a, f64>,
    ) -> Result<ModalErrors<'a>> {
        let model = self.fitter.model();
        let modes = model.basis.len();
        let (given, (rows, columns)) = (coefficients_nm.len(), covariance_nm2.dim());
        if [given, rows, columns] != [modes; 3] {
            return Err(Error::Shape(format!(
                "{given} modes with a covariance of {rows}x{columns} were given, where {modes} modes are needed"
            )));
        }
        Ok(ModalErrors {
            scene: &self.scene,
            model,
            coefficients_nm,
            covariance_nm2,
            limits: SegmentLimits::of_scene(&self.scene, false),
        })
    }
}

/// Frame `number` of each channel.
///
/// # Errors
/// [`Error::Shape`] where a channel has none; those of [`Images::check`].
fn group_of(scene: &Scene, images: &[&Images], number: usize) -> Result<Vec<Images>> {
    let channels = scene.each_channel();
    let each = images.iter().zip(&channels).map(|(images, (name, own))| {
        if number >= images.len() {
            let of = name.map(|name| format!(" of the channel '{name}'")).unwrap_or_default();
            let there = counted(images.len(), "image");
            return Err(Error::Shape(format!("image {number}{of} does not exist: there are {there}, from 0")));
        }
        named(*name, images.check())?;
        let frame = images.selected(&[number]);
        let (cut, _) = frame.without_odd_edge(own.image.fitted_shape());
        Ok(cut.into_owned())
    });
    each.collect()
}

/// The electrons of a frame of the channel `own`.
fn electrons_of<'a>(frame: &'a Images, own: &Scene) -> Result<Electrons<'a>> {
    check_size(frame, own)?;
    let consistent = reconcile(frame, own)?;
    if consistent.is_changed {
        return Err(Error::Image(
            "the file's values were to replace those of the scene, which a session cannot do: correct the scene".into(),
        ));
    }
    Ok(consistent.images)
}

/// The fit of a group, whose `frames` are one of each channel.
fn fit(scene: &Scene, sessions: &mut [Option<Box<Session>>; 2], frames: &[Images]) -> Result<FrameEstimate> {
    let channels = scene.each_channel();
    let each = frames.iter().zip(&channels).map(|(frame, (name, own))| named(*name, electrons_of(frame, own)));
    let electrons = each.collect::<Result<Vec<_>>>()?;
    let pixels = |channel: usize| {
        let electrons: &Electrons = &electrons[channel];
        (electrons.images_e.index_axis(Axis(0), 0), electrons.bad.index_axis(Axis(0), 0))
    };
    let Some(first) = &sessions[0] else {
        return Err(Error::Internal("there is no session of frames without bad pixels".into()));
    };
    let mut is_native = false;
    for (number, (name, fitter)) in first.fitters().iter().enumerate() {
        let (preparation, (data_e, bad)) = (fitter.model().preparation, pixels(number));
        let [width, height] = preparation.frame;
        named(Some(name).filter(|name| !name.is_empty()), check_frame_shape(data_e.dim(), (height, width)))?;
        is_native |= preparation.reduced != preparation.frame && bad.iter().any(|bad| *bad);
    }
    let session = match &mut sessions[usize::from(is_native)] {
        Some(session) => session,
        none => {
            let native = ChannelFitters::new(scene, true)?;
            none.insert(Box::new(Session::new(native, &SessionOptions::default())?))
        }
    };
    for number in 0..electrons.len() {
        let (data_e, bad) = pixels(number);
        let (mut to_e, mut to_bad) = session.frame_mut(0, number)?;
        to_e.assign(&data_e);
        to_bad.assign(&bad);
    }
    // A call has one for all channels; where they differ each has its scene's.
    let read_noise_e = electrons[0].read_noise_e;
    let is_common = electrons.iter().all(|electrons| electrons.read_noise_e == read_noise_e);
    session.fit(1, &FitOptions { read_noise_e: read_noise_e.filter(|_| is_common), ..Default::default() })?;
    let (result, of_channels) = (session.results()[0].clone(), session.channels());
    let reports: Vec<ImageReport> = of_channels.iter().map(|channel| channel.results()[0].report).collect();
    // The sentence of a channel, with its name where there are several.
    let said = |number: usize, sentence: &str| match of_channels[number].name() {
        "" => sentence.to_owned(),
        name => format!("channel {name}: {sentence}"),
    };
    let at = reports.iter().position(|report| report.status == result.status).unwrap_or(0);
    let reduced_chi2 = median(&reports.iter().map(|report| report.reduced_chi2).collect::<Vec<_>>());
    let covariance_nm2 = Array2::from_elem([result.coefficients_nm.len(); 2], f64::NAN);
    let notes =
        frames.iter().enumerate().flat_map(|(number, frame)| frame.notes.iter().map(move |note| (number, note)));
    let mut estimate = FrameEstimate {
        modes: CombinedModes { coefficients_nm: result.coefficients_nm, covariance_nm2 },
        report: ImageReport { status: result.status, reduced_chi2, ..reports[0] },
        refusal: None,
        warnings: notes.map(|(number, note)| said(number, note)).collect(),
        compared: of_channels[0].fitted_image(0),
    };
    let saturated = of_channels.iter().enumerate().find_map(|(number, channel)| {
        let (data_e, bad) = pixels(number);
        let sentence = saturation(&channel.fitted_image(0)?, data_e, bad)?;
        Some(said(number, &sentence))
    });
    match result.status {
        Status::Ok | Status::Misfit => {
            let refined = session.refine(0)?;
            estimate.modes = refined.modes;
            if refined.is_contradictory {
                estimate.report.status = Status::Contradictory;
                estimate.refusal = Some(contradiction_warning(refined.disagreement));
            }
        }
        Status::WrongMinimum | Status::Contradictory | Status::NotConverged(_) | Status::Unusable(_) => {
            // A cause says more than its effect on χ².
            estimate.refusal = saturated.clone().or_else(|| Some(said(at, &reports[at].sentence())));
        }
    }
    if result.status == Status::Misfit {
        match saturated {
            Some(sentence) => estimate.refusal = Some(sentence),
            None => estimate.warnings.push(said(at, &reports[at].sentence())),
        }
    }
    Ok(estimate)
}

impl FrameEstimate {
    /// The modes of `fitter` in `estimate`.
    fn of_estimate(estimate: &Estimate, fitter: &ModalFitter) -> Result<Self> {
        let place = |name: &String| {
            estimate.basis.names.iter().position(|known| known == name).ok_or_else(|| {
                Error::Image(format!(
                    "the estimate has no mode {name}, which the scene has: its model is {}",
                    estimate.model
                ))
            })
        };
        let places = fitter.model().basis.names().iter().map(place).collect::<Result<Vec<_>>>()?;
        let refusal = match estimate.status {
            Status::Ok | Status::Misfit => None,
            status => Some(match estimate.images.first() {
                Some(image) if estimate.images.len() == 1 => image.message.clone(),
                _ => format!("the status of the estimate is {}", status.word()),
            }),
        };
        let used: Vec<ImageReport> =
            estimate.images.iter().filter(|image| image.is_used).map(|image| image.report).collect();
        // Of images that are fitted together the modes have tip and tilt of the first.
        let is_each =
            estimate.channels.is_empty() && matches!(estimate.scene.estimate.group, Grouping::Auto | Grouping::Each);
        let of_mean = &used[..if is_each { used.len() } else { used.len().min(1) }];
        // NaN for none.
        let mean =
            |axis: usize| of_mean.iter().map(|report| report.tip_tilt_nm[axis]).sum::<f64>() / of_mean.len() as f64;
        Ok(Self {
            modes: CombinedModes {
                coefficients_nm: places.iter().map(|&mode| estimate.modes.coefficients_nm[mode]).collect(),
                covariance_nm2: estimate.modes.covariance_nm2.select(Axis(0), &places).select(Axis(1), &places),
            },
            report: ImageReport {
                status: estimate.status,
                reduced_chi2: estimate.reduced_chi2,
                tip_tilt_nm: [mean(0), mean(1)],
                ..used.first().copied().unwrap_or(ImageReport::unfitted(estimate.status))
            },
            refusal,
            warnings: estimate.warnings.clone(),
            compared: estimate.modal().and_then(|modal| modal.compared.first()).cloned(),
        })
    }
}
