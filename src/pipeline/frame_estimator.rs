//! Frame estimator: an estimate of each frame as it comes, with everything that does not depend on
//! the frame made once.
//!
//! By [`Policy::realtime`] a frame is fitted by a [`Session`]; by any other policy an [`Estimator`]
//! makes the estimate of a file. Both report the same modes, those of the scene, so that estimates
//! of one night can be compared and tracked.

use super::consistency::reconcile;
use super::estimate::Estimate;
use super::estimator::{Estimator, check_size};
use super::images::Images;
use super::misfit::saturation;
use super::modal_errors::{ModalErrors, change_by};
use super::policy::Policy;
use super::scene_files::check_for_estimate;
use crate::control::Control;
use crate::loop_response::{Corrections, SegmentLimits};
use crate::modal::{
    CombinedModes, FittedImage, ImageReport, ModalFitter, Session, SessionOptions, Status, check_frame_shape,
};
use crate::planner;
use crate::scene::Scene;
use crate::tracking::Correction;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView2, Axis};
use std::sync::Arc;

/// Estimates frames of one scene, one after the other.
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
    /// with the status and the χ² of the estimate, and the mean tip and tilt.
    pub report: ImageReport,
    /// Why the numbers must not be used: a sentence; `None` where they may.
    pub refusal: Option<String>,
    /// Sentences that a user should read before using the numbers.
    pub warnings: Vec<String>,
    /// The frame beside its model, at the model's sampling.
    pub compared: Option<FittedImage>,
}

impl FrameEstimator {
    /// Builds the model of `scene`, and by [`Policy::realtime`] a session of it: a second at the
    /// size of Keck.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene with channels, with `estimate.method = "full-phase"` or
    /// `"auto"`, or with a key that the policy does not honour; those of [`ModalFitter::new`],
    /// [`Session::new`] and [`Estimator::with_policy`].
    pub fn new(scene: &Scene, policy: Policy, control: Control) -> Result<Self> {
        policy.check(scene)?;
        check_for_estimate(scene)?;
        let scene = planner::resolve(scene, &control)?;
        // The fitter gives the modes alone where a pipeline fits optical parameters as well.
        let modes_of = scene.system().with(|sections| sections.estimate.fit_optics.clear())?;
        let fitter = Arc::new(ModalFitter::new(&modes_of, false)?);
        let method = if policy == Policy::realtime() {
            let session = Session::new(fitter.clone(), &SessionOptions::default())?;
            Method::Sessions([Some(Box::new(session)), None])
        } else {
            // What the modes leave out all frames share: it is no noise that a state averages.
            let alone = scene.changed(|sections| sections.leave_out_posterior())?;
            Method::Pipeline(Box::new(Estimator::with_policy(&alone, policy, control)?))
        };
        Ok(Self { scene, fitter, method })
    }

    /// The fitter whose modes are estimated.
    pub fn fitter(&self) -> &Arc<ModalFitter> {
        &self.fitter
    }

    /// The scene, with the choices of its plan where it named a budget.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Number of estimates from `images`: one for each in real time, else one from all.
    pub fn estimates_of(&self, images: &Images) -> usize {
        match &self.method {
            Method::Sessions(_) => images.len(),
            Method::Pipeline(_) => 1,
        }
    }

    /// Estimate `number` of [`FrameEstimator::estimates_of`] from `images`, which are checked and
    /// converted as [`Estimator::estimate`] does.
    ///
    /// # Errors
    /// [`Error::Image`] and [`Error::Shape`] for images that contradict the scene or have another
    /// size; those of the fit. A frame that cannot be fitted is no error: see
    /// [`FrameEstimate::refusal`].
    pub fn estimate(&mut self, images: &Images, number: usize) -> Result<FrameEstimate> {
        match &mut self.method {
            Method::Sessions(sessions) => {
                if number >= images.len() {
                    let count = images.len();
                    return Err(Error::Shape(format!(
                        "image {number} does not exist: there are {count} images, from 0"
                    )));
                }
                images.check()?;
                let frame = images.selected(&[number]);
                let (frame, _) = frame.without_odd_edge(self.scene.image.fitted_shape());
                fit(&self.scene, &self.fitter, sessions, &frame)
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

/// The fit of `images`, which is one frame.
fn fit(
    scene: &Scene,
    fitter: &Arc<ModalFitter>,
    sessions: &mut [Option<Box<Session>>; 2],
    images: &Images,
) -> Result<FrameEstimate> {
    check_size(images, scene)?;
    let consistent = reconcile(images, scene)?;
    if consistent.is_changed {
        return Err(Error::Image(
            "the file's values were to replace those of the scene, which a session cannot do: correct the scene".into(),
        ));
    }
    let electrons = &consistent.images;
    let (data_e, bad) = (electrons.images_e.index_axis(Axis(0), 0), electrons.bad.index_axis(Axis(0), 0));
    let [width, height] = fitter.model().preparation.frame;
    check_frame_shape(data_e.dim(), (height, width))?;
    let is_reduced = fitter.model().preparation.reduced != fitter.model().preparation.frame;
    let native = usize::from(is_reduced && bad.iter().any(|bad| *bad));
    let session = match &mut sessions[native] {
        Some(session) => session,
        none => {
            let native = Arc::new(ModalFitter::new(scene, true)?);
            none.insert(Box::new(Session::new(native, &SessionOptions::default())?))
        }
    };
    let (mut to_e, mut to_bad) = session.frame_mut(0, 0)?;
    to_e.assign(&data_e);
    to_bad.assign(&bad);
    let options = crate::modal::FitOptions { read_noise_e: electrons.read_noise_e, ..Default::default() };
    session.fit(1, &options)?;
    let channel = &session.channels()[0];
    let result = channel.results()[0].clone();
    let report = result.report;
    let covariance_nm2 = Array2::from_elem([result.coefficients_nm.len(); 2], f64::NAN);
    let mut estimate = FrameEstimate {
        modes: CombinedModes { coefficients_nm: result.coefficients_nm, covariance_nm2 },
        report,
        refusal: None,
        warnings: images.notes.clone(),
        compared: channel.fitted_image(0),
    };
    let saturated = estimate.compared.as_ref().and_then(|compared| saturation(compared, data_e, bad));
    match report.status {
        Status::Ok | Status::Misfit => estimate.modes.covariance_nm2 = session.refine(0)?.modes.covariance_nm2,
        Status::WrongMinimum | Status::Contradictory | Status::NotConverged(_) | Status::Unusable(_) => {
            // A cause says more than its effect on χ².
            estimate.refusal = saturated.clone().or_else(|| Some(report.sentence()));
        }
    }
    if report.status == Status::Misfit {
        match saturated {
            Some(sentence) => estimate.refusal = Some(sentence),
            None => estimate.warnings.push(report.sentence()),
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
        // NaN for none.
        let mean = |axis: usize| used.iter().map(|report| report.tip_tilt_nm[axis]).sum::<f64>() / used.len() as f64;
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
