//! The frames of one channel of a session, and their fits, with all memory allocated beforehand.

use super::super::combine::{FittedImage, fitted_image};
use super::super::fitter::ModalFitter;
use super::super::prepare::{Frame, Preparation, PreparedFrame, Preparer, Refusal, Ringing};
use super::options::{ImageResult, SessionOptions, write_start};
use crate::control::Control;
use crate::imaging::{Chain, Precision};
use crate::modal::assess::image_covariances::ImageCovariances;
use crate::modal::assess::residual::variance;
use crate::modal::assess::status::{ImageReport, Status, assess};
use crate::modal::assess::tilts::Tilts;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::combine::pistons;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::rejection::weigh_dead;
use crate::modal::solve::engine::{CpuEngine, DeviceEngine, Engine, FitState, FitTask, ImageFit, check_usable};
use crate::optimize::StopReason;
use crate::scene::Optimizer;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewMut2};
use std::ops::Range;
use std::slice::from_ref;
use std::sync::Arc;
use std::time::Instant;

/// A channel of a [`Session`](super::Session): its frames, and the fits of the last call.
pub struct SessionChannel {
    name: String,
    pub(super) shared: Shared,
    frames: Vec<FrameBuffer>,
    pub(super) fits: Vec<ImageFit>,
    /// Images as they were prepared for a fit with those of other channels; none where there are
    /// none.
    originals: Vec<PreparedFrame>,
    results: Vec<ImageResult>,
    pub(super) engine: Box<dyn Engine>,
    pub(super) precision: Precision,
    device: String,
    /// Number of images of the last fit, and of those loaded for an evaluation.
    fitted: usize,
    loaded: usize,
    /// Numbers of all images.
    numbers: Vec<usize>,
}

/// Data that all images of a channel share.
pub(super) struct Shared {
    pub(super) fitter: Arc<ModalFitter>,
    /// Recipe of the fitter, with the session's own limits.
    recipe: Recipe,
    tilts: Tilts,
    motions: GlobalMotions,
    control: Control,
}

/// Memory of a frame.
struct FrameBuffer {
    data_e: Array2<f64>,
    bad: Array2<bool>,
}

impl SessionChannel {
    /// Allocates all memory, and computes the metrics of `fitter` where it has none yet (about a
    /// second for a large model). `control` is that of the session, which has other channels or
    /// not.
    ///
    /// # Errors
    /// As [`Session::new`](super::Session::new).
    pub(super) fn new(
        (name, fitter): (&str, Arc<ModalFitter>),
        options: &SessionOptions,
        control: Control,
        has_others: bool,
    ) -> Result<Self> {
        FrameBuffer::check_capacity(&fitter, options.capacity)?;
        let mut recipe = fitter.recipe.clone();
        if recipe.optimizer == Optimizer::Bfgs {
            return Err(Error::Value(
                "a session cannot use estimate.optimizer = \"bfgs\", which allocates as it goes: \"gauss-newton\" and \
                 \"paper\" are accepted"
                    .into(),
            ));
        }
        recipe.max_evaluations = options.max_evaluations.unwrap_or(recipe.max_evaluations);
        recipe.step_tolerance_nm = options.step_tolerance_nm.unwrap_or(recipe.step_tolerance_nm);
        fitter.metrics.make_all(&fitter.reference)?;
        let (tilts, motions) = (Tilts::new(&fitter.model)?, GlobalMotions::new(&fitter.model)?);
        let shared = Shared { fitter, recipe, tilts, motions, control };
        let optics = shared.fitter.model.optics.clone();
        let scene = &shared.fitter.scene.estimate;
        let precision = options.precision.unwrap_or(scene.precision().into());
        let device = options.device.unwrap_or(scene.device.into());
        let chain = Chain::open(optics, device, precision, options.capacity)?;
        let precision = chain.precision();
        let device = chain.device_name();
        let engine = shared.engine(chain, options)?;
        let (preparation, modes) = (shared.fitter.model.preparation, shared.modes());
        let frames = (0..options.capacity).map(|_| FrameBuffer::new(&preparation)).collect();
        let fits = vec![ImageFit::new(&preparation, modes); options.capacity];
        let result = ImageResult {
            coefficients_nm: vec![f64::NAN; modes],
            report: ImageReport::unfitted(Status::NotConverged(StopReason::Unfinished)),
            seconds: 0.0,
        };
        Ok(Self {
            name: name.into(),
            frames,
            originals: if has_others { vec![preparation.empty(); options.capacity] } else { Vec::new() },
            fits,
            results: vec![result; options.capacity],
            engine,
            precision,
            device,
            fitted: 0,
            loaded: 0,
            numbers: (0..options.capacity).collect(),
            shared,
        })
    }

    /// Its name; empty for the only channel of a scene that lists none.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The fitter whose model is fitted.
    pub fn fitter(&self) -> &Arc<ModalFitter> {
        &self.shared.fitter
    }

    /// Warning that the device that `auto` selected was lost and the CPU replaces it.
    pub fn device_failure(&self) -> Option<&str> {
        self.engine.failure()
    }

    /// Where it runs: `cpu`, or the address and the name of a device.
    pub(super) fn device_name(&self) -> &str {
        &self.device
    }

    /// Buffers of frame `image`, `[y, x]`: electrons and bad pixels; `None` beyond the capacity.
    pub(super) fn frame_mut(&mut self, image: usize) -> Option<(ArrayViewMut2<'_, f64>, ArrayViewMut2<'_, bool>)> {
        let frame = self.frames.get_mut(image)?;
        Some((frame.data_e.view_mut(), frame.bad.view_mut()))
    }

    /// The recipe of the fits.
    pub(super) fn recipe(&self) -> &Recipe {
        &self.shared.recipe
    }

    /// Discards the results of the last fit.
    pub(super) fn discard_results(&mut self) {
        self.fitted = 0;
    }

    /// Fits frames 0 to `count` − 1 from the rows of `start_nm`. An image that cannot be fitted has
    /// its status in its result.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the control was cancelled; [`Error::Device`] where a device
    /// fails. Neither leaves results.
    pub(super) fn fit(
        &mut self,
        count: usize,
        start_nm: Option<ArrayView2<f64>>,
        read_noise_e: Option<f64>,
        deadline: Option<Instant>,
    ) -> Result<()> {
        (self.fitted, self.loaded) = (0, 0);
        for (image, fit) in self.fits[..count].iter_mut().enumerate() {
            write_start(&mut fit.start_nm, start_nm.as_ref().map(|start_nm| start_nm.row(image)));
        }
        let control = self.shared.control.silent().until(deadline);
        let prepare = prepare(&self.frames, &self.shared.recipe, self.shared.read_noise_e(read_noise_e));
        self.engine.fit(&self.shared.task(&control), &prepare, &mut self.fits[..count]).map_err(
            |error| match error {
                Error::Interrupted(_) => interrupted(),
                other => other,
            },
        )?;
        self.fitted = count;
        for (fit, result) in self.fits[..count].iter_mut().zip(&mut self.results) {
            self.shared.report(fit, result);
        }
        Ok(())
    }

    /// Begins a fit of frames 0 to `count` − 1 with those of other channels, from the rows of
    /// `start_nm`.
    pub(super) fn begin(&mut self, count: usize, start_nm: Option<ArrayView2<f64>>) {
        (self.fitted, self.loaded) = (count, 0);
        for (image, fit) in self.fits[..count].iter_mut().enumerate() {
            write_start(&mut fit.start_nm, start_nm.as_ref().map(|start_nm| start_nm.row(image)));
            (fit.seconds, fit.state) = (0.0, FitState::NotBegun);
        }
    }

    /// Prepares some `images` for it, which the engine numbers from 0.
    ///
    /// # Errors
    /// [`Error::Device`] where a device fails.
    pub(super) fn prepare(&mut self, images: Range<usize>, read_noise_e: Option<f64>) -> Result<()> {
        let recipe = &self.shared.recipe;
        let prepare = prepare(&self.frames[images.clone()], recipe, self.shared.read_noise_e(read_noise_e));
        self.engine.load(&self.shared.task(&self.shared.control), &prepare, &mut self.fits[images.clone()])?;
        let fits = self.fits[images.clone()].iter_mut().zip(&mut self.originals[images]);
        for (number, (fit, original)) in fits.enumerate().filter(|(_, (fit, _))| fit.state == FitState::NotBegun) {
            original.clone_from(&fit.prepared);
            if recipe.reject_outliers && weigh_dead(&mut fit.prepared) {
                self.engine.replace(number, &fit.prepared.exposure)?;
            }
        }
        Ok(())
    }

    /// Whether an image is prepared and not yet fitted.
    pub(super) fn is_member(&self, image: usize) -> bool {
        self.fits[image].state == FitState::NotBegun
    }

    /// Writes the result of an image from its fit.
    pub(super) fn report(&mut self, image: usize) {
        self.shared.report(&mut self.fits[image], &mut self.results[image]);
    }

    /// An image of the last fit as it was prepared, not fitted.
    pub(super) fn unfitted(&self, image: usize) -> ImageFit {
        let (fit, prepared) = (self.fits[image].clone(), self.originals[image].clone());
        ImageFit { prepared, state: FitState::NotBegun, ..fit }
    }

    /// Fits an image of the last fit without those of other channels, from its start.
    ///
    /// # Errors
    /// Those of the chain.
    pub(super) fn fitted_alone(&self, image: usize) -> Result<ImageFit> {
        let mut fit = self.unfitted(image);
        let prepared = fit.prepared.clone();
        let control = Control::default();
        CpuEngine::new(&*self.shared.fitter.reference, Some(1)).fit(
            &self.shared.task(&control),
            &|_, _, out| {
                out.clone_from(&prepared);
                Ok(())
            },
            std::slice::from_mut(&mut fit),
        )?;
        Ok(fit)
    }

    /// The result of each image of the last fit; none after a fit that failed.
    pub fn results(&self) -> &[ImageResult] {
        &self.results[..self.fitted]
    }

    /// Covariance of the coefficients of an image of the last fit, nm², `[mode, mode]`, pistons
    /// about their mean; scaled by χ² where the model misfits.
    ///
    /// # Errors
    /// [`Error::Value`] for an image that was not fitted, or that no mode changes.
    pub(super) fn covariance_nm2(&self, image: usize) -> Result<Array2<f64>> {
        let fitted = self.results().get(image).zip(self.fits.get(image)).filter(|(_, fit)| fit.is_fitted());
        let Some((result, ImageFit { prepared, minimum, .. })) = fitted else {
            return Err(Error::Value(format!(
                "image {image} has no covariance: the last fit was of {} images, and did not fit this one",
                self.fitted
            )));
        };
        let fitter = &self.shared.fitter;
        let psf = fitter.reference.psf(ArrayView1::from(&minimum.coefficients_nm));
        let variance_e2 = variance(&psf, minimum, &prepared.floor_variance_e2);
        let covariances =
            ImageCovariances::new(fitter, &[0], from_ref(prepared), from_ref(minimum), from_ref(&variance_e2))?;
        Ok(fitter.with_shared(covariances.covariance(0) * result.report.reduced_chi2.max(1.0)))
    }

    /// Image `image` of the last fit beside its model; `None` for one that was not fitted. It
    /// evaluates the model once more.
    pub fn fitted_image(&self, image: usize) -> Option<FittedImage> {
        let fit = self.fits[..self.fitted].get(image).filter(|fit| fit.is_fitted())?;
        Some(fitted_image(&self.shared.fitter, &fit.minimum, &fit.prepared))
    }

    /// Prepares frames 0 to `count` − 1 for [`SessionChannel::evaluate`], weighted by the noise of
    /// their own pixels.
    ///
    /// # Errors
    /// As [`Session::load`](super::Session::load).
    pub(super) fn load(&mut self, count: usize, read_noise_e: Option<f64>) -> Result<()> {
        (self.fitted, self.loaded) = (0, 0);
        let task = self.shared.task(&self.shared.control);
        let prepare = prepare(&self.frames, &self.shared.recipe, self.shared.read_noise_e(read_noise_e));
        self.engine.load(&task, &prepare, &mut self.fits[..count])?;
        check_usable(&self.fits[..count])?;
        self.loaded = count;
        Ok(())
    }

    /// Objectives and gradients of the first of the loaded images.
    ///
    /// # Errors
    /// As [`Session::evaluate`](super::Session::evaluate).
    pub(super) fn evaluate(
        &mut self,
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()> {
        let (count, modes) = (coefficients_nm.nrows(), self.shared.modes());
        if coefficients_nm.ncols() != modes || objectives.len() != count || gradients.len() != count * modes {
            let (columns, objectives, gradients) = (coefficients_nm.ncols(), objectives.len(), gradients.len());
            return Err(Error::Shape(format!(
                "{count}x{columns} coefficients, {objectives} objectives and {gradients} gradients were given, where \
                 {count}x{modes}, {count} and {} are needed",
                count * modes
            )));
        }
        if self.loaded == 0 {
            return Err(Error::Value("no image is loaded: load what is to be evaluated first".into()));
        }
        if count > self.loaded {
            let loaded = self.loaded;
            return Err(Error::Shape(format!("{count} images were to be evaluated, where {loaded} are loaded")));
        }
        self.engine.evaluate(&self.numbers[..count], coefficients_nm, objectives, gradients)
    }
}

impl Shared {
    fn modes(&self) -> usize {
        self.fitter.model.optics.modes()
    }

    fn task<'a>(&'a self, control: &'a Control) -> FitTask<'a> {
        let ModalFitter { model, reference, metrics, .. } = &*self.fitter;
        FitTask { model, reference, metrics, recipe: &self.recipe, control }
    }

    /// Read noise of a pixel: the one given, or the scene's.
    fn read_noise_e(&self, given: Option<f64>) -> Option<f64> {
        given.or(self.fitter.scene.image.read_noise_e)
    }

    /// The engine for `chain`, with its memory.
    fn engine(&self, chain: Chain, options: &SessionOptions) -> Result<Box<dyn Engine>> {
        crate::machine::check_threads("threads", options.threads)?;
        let threads = (options.threads > 0).then_some(options.threads);
        Ok(match chain {
            Chain::Cpu64(chain) => {
                let mut engine = CpuEngine::new(chain, threads);
                engine.allocate(&self.task(&self.control), options.capacity)?;
                Box::new(engine)
            }
            Chain::Cpu32(chain) => {
                let mut engine = CpuEngine::new(chain, threads);
                engine.allocate(&self.task(&self.control), options.capacity)?;
                Box::new(engine)
            }
            chain => Box::new(DeviceEngine::new(chain)),
        })
    }

    /// Writes the outcome of a fit.
    fn report(&self, fit: &mut ImageFit, result: &mut ImageResult) {
        match fit.state {
            FitState::Fitted => {
                pistons::wrap_if_monochromatic(&mut fit.minimum.coefficients_nm, &fit.start_nm, &self.fitter.model);
                self.motions.remove(&mut fit.minimum.coefficients_nm);
                result.report = assess(&self.fitter.model, &self.tilts, &fit.prepared, &fit.minimum);
                result.coefficients_nm.copy_from_slice(&fit.minimum.coefficients_nm);
            }
            FitState::Refused(refusal) => result.refuse(refusal),
            FitState::NotBegun => result.not_begun(&fit.start_nm),
        }
        result.seconds = fit.seconds;
    }
}

/// Prepares the frames in the buffers; frames with bad pixels that a reduction would smear are
/// refused.
fn prepare<'a>(
    frames: &'a [FrameBuffer],
    recipe: &'a Recipe,
    read_noise_e: Option<f64>,
) -> impl Fn(usize, &mut Preparer, &mut PreparedFrame) -> std::result::Result<(), Refusal> + Sync + 'a {
    move |index, preparer, prepared| {
        let FrameBuffer { data_e, bad } = &frames[index];
        let frame = Frame { data_e: data_e.view(), bad: bad.view(), read_noise_e };
        preparer.prepare(frame, recipe, Ringing::Refused, prepared)
    }
}

impl FrameBuffer {
    /// Refuses a capacity that memory cannot hold, before any is allocated.
    fn check_capacity(fitter: &ModalFitter, capacity: usize) -> Result<()> {
        let preparation = &fitter.model.preparation;
        let [x, y] = preparation.frame;
        // A frame with its mask, and at the model's sampling data, weights and floor.
        let bytes = x * y * (size_of::<f64>() + size_of::<bool>()) + 3 * size_of::<f64>() * preparation.pixels.pow(2);
        let all = capacity.checked_mul(bytes);
        if all.is_none_or(|all| Vec::<u8>::new().try_reserve_exact(all).is_err()) {
            return Err(Error::Value(format!(
                "capacity is {capacity}, more than memory can hold: each image takes {bytes} bytes"
            )));
        }
        Ok(())
    }

    fn new(preparation: &Preparation) -> Self {
        let shape = (preparation.frame[1], preparation.frame[0]);
        Self { data_e: Array2::zeros(shape), bad: Array2::from_elem(shape, false) }
    }
}

pub(super) fn interrupted() -> Error {
    Error::Interrupted("the fit was cancelled".into())
}
