//! Fits for a caller who comes back with images again and again: all memory is taken once, when the session is made.

mod batch;
mod options;
mod single;
#[cfg(all(test, feature = "opencl", debug_assertions))]
mod tests;

pub use options::{FitOptions, ImageResult, SessionOptions};

use super::minimum::Minimum;
use super::pistons::Pistons;
use super::prepare::{Frame, Prepared, Refusal};
use super::residual::variance;
use super::spread::Spread;
use super::status::{Status, Tilts, unfitted};
use super::{Estimator, Recipe};
use crate::imaging::Chain;
use crate::optimize::{CancelFlag, StopReason};
use crate::scene::Optimizer;
use crate::{Error, Result};
use batch::Batch;
use ndarray::{Array2, ArrayView1, ArrayView2, ArrayViewMut2};
use options::write_start;
use single::Single;
use std::slice::from_ref;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Instant;

/// A workspace for fits with one model: frames are written into it ([`Session::frame_mut`]), fitted, and their results
/// read. It is one thread's at a time.
///
/// It follows [`Policy::realtime`](crate::pipeline::Policy::realtime): one fit with the largest basis, no model selection,
/// no outlier rejection, no restarts. Device and precision are the scene's (`estimate.device`, `estimate.precision`) where
/// [`SessionOptions`] leave them open.
///
/// On the CPU with one thread, [`Session::fit`], [`Session::load`] and [`Session::evaluate`] neither allocate nor free
/// memory, take no lock and format no text, but to say why they fail. A fit depends on its own image alone: bit by bit
/// it is [`Estimator::estimate`]'s, whatever the number of images and threads.
pub struct Session {
    shared: Shared,
    images: Vec<Image>,
    results: Vec<ImageResult>,
    engine: Engine,
    /// How many images the last fit was of, and how many are loaded for [`Session::evaluate`].
    fitted: usize,
    loaded: usize,
}

/// What all images of a session share.
struct Shared {
    estimator: Arc<Estimator>,
    /// The estimator's, with the session's own limits.
    recipe: Recipe,
    tilts: Tilts,
    pistons: Pistons,
    cancel: CancelFlag,
}

/// One image's memory.
struct Image {
    data_e: Array2<f64>,
    bad: Array2<bool>,
    prepared: Prepared,
    minimum: Minimum,
    /// Whether there is a fit behind `minimum`.
    fitted: bool,
}

/// Where the fits run.
enum Engine {
    Cpu64(Box<Single<f64>>),
    Cpu32(Box<Single<f32>>),
    Device(Box<Batch>),
}

/// One call of [`Session::fit`], checked.
struct Call<'a> {
    shared: &'a Shared,
    read_noise_e: f64,
    start_nm: Option<ArrayView2<'a, f64>>,
    deadline: Option<Instant>,
}

impl Session {
    /// Takes all memory, and makes the metrics of `estimator` where it has none yet (a second or so for a large model).
    ///
    /// # Errors
    /// [`Error::Value`] for options out of range and for an estimator whose recipe is the paper's BFGS, which cannot be
    /// stopped and resumed; [`Error::Device`] where the device cannot run the model.
    pub fn new(estimator: Arc<Estimator>, options: &SessionOptions) -> Result<Self> {
        if options.capacity == 0 {
            return Err(Error::Value("a session for 0 images was asked for, where 1 or more are needed".into()));
        }
        Image::check_room(&estimator, options.capacity)?;
        let mut recipe = estimator.recipe.clone();
        if recipe.optimizer == Optimizer::Bfgs {
            return Err(Error::Value(
                "a session cannot use estimate.optimizer = \"bfgs\", which allocates as it goes: \"gauss-newton\" and \
                 \"paper\" are accepted"
                    .into(),
            ));
        }
        recipe.max_evaluations = options.max_evaluations.unwrap_or(recipe.max_evaluations);
        recipe.step_tolerance_nm = options.step_tolerance_nm.unwrap_or(recipe.step_tolerance_nm);
        estimator.metrics.make_all(&estimator.judge)?;
        let (tilts, pistons) = (Tilts::new(&estimator.model)?, Pistons::of(&estimator.model)?);
        let shared = Shared { estimator, recipe, tilts, pistons, cancel: CancelFlag::default() };
        let optics = shared.estimator.model.optics.clone();
        let scene = &shared.estimator.scene.estimate;
        let precision = options.precision.unwrap_or(scene.precision.into());
        let device = options.device.unwrap_or(scene.device.into());
        let engine = match Chain::open(optics, device, precision, options.capacity)? {
            Chain::Cpu64(chain) => Engine::Cpu64(Box::new(Single::new(chain, &shared, options, precision)?)),
            Chain::Cpu32(chain) => Engine::Cpu32(Box::new(Single::new(chain, &shared, options, precision)?)),
            chain => Engine::Device(Box::new(Batch::new(chain, &shared)?)),
        };
        let images = (0..options.capacity).map(|_| Image::room(&shared.estimator)).collect();
        let result = ImageResult {
            coefficients_nm: vec![f64::NAN; shared.modes()],
            report: unfitted(Status::NotConverged(StopReason::Unfinished)),
            seconds: 0.0,
        };
        let results = vec![result; options.capacity];
        Ok(Self { shared, images, results, engine, fitted: 0, loaded: 0 })
    }

    /// The estimator whose model is fitted.
    pub fn estimator(&self) -> &Arc<Estimator> {
        &self.shared.estimator
    }

    /// That the device which `auto` took was lost, and the CPU has taken its place, as a sentence.
    pub fn device_failure(&self) -> Option<&str> {
        match &self.engine {
            Engine::Cpu64(_) | Engine::Cpu32(_) => None,
            Engine::Device(batch) => batch.failure(),
        }
    }

    /// Where it runs: `cpu`, or the address and the name of a device.
    pub fn device_name(&self) -> String {
        match &self.engine {
            Engine::Cpu64(_) | Engine::Cpu32(_) => "cpu".into(),
            Engine::Device(batch) => batch.device_name(),
        }
    }

    /// Most images of a call.
    pub fn capacity(&self) -> usize {
        self.images.len()
    }

    /// The buffers of frame `image`, `[y, x]`: electrons, and bad pixels, which the caller fills before a fit. They
    /// keep what was written.
    ///
    /// # Errors
    /// [`Error::Shape`] beyond the capacity.
    pub fn frame_mut(&mut self, image: usize) -> Result<(ArrayViewMut2<'_, f64>, ArrayViewMut2<'_, bool>)> {
        let capacity = self.images.len();
        let image = self.images.get_mut(image).ok_or_else(|| {
            Error::Shape(format!("frame {image} was asked for, where the session has room for {capacity}"))
        })?;
        Ok((image.data_e.view_mut(), image.bad.view_mut()))
    }

    /// Fits frames 0 to `count` − 1. What troubles one image is in its result.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the cancel flag went up, which leaves no results; [`Error::Shape`] for more frames
    /// than the capacity or a start of another shape, [`Error::Value`] for an option out of range, [`Error::Device`]
    /// where a device fails.
    pub fn fit(&mut self, count: usize, options: &FitOptions) -> Result<()> {
        let began = Instant::now();
        (self.fitted, self.loaded) = (0, 0);
        self.checked_count(count)?;
        self.checked_start(count, options.start_nm)?;
        let call = Call {
            shared: &self.shared,
            read_noise_e: self.read_noise_e(options.read_noise_e)?,
            start_nm: options.start_nm,
            // A deadline beyond the end of the clock is none.
            deadline: options.deadline.and_then(|time| began.checked_add(time)),
        };
        let (images, results) = (&mut self.images[..count], &mut self.results[..count]);
        let outcome = match &mut self.engine {
            Engine::Cpu64(single) => single.fit(&call, images, results),
            Engine::Cpu32(single) => single.fit(&call, images, results),
            Engine::Device(batch) => batch.fit(&call, images, results),
        };
        if let Err(Error::Interrupted(_)) = outcome {
            self.shared.cancel.store(false, Ordering::Relaxed);
        }
        outcome?;
        self.fitted = count;
        Ok(())
    }

    /// The results of the last fit, one per image; none after a fit that failed.
    pub fn results(&self) -> &[ImageResult] {
        &self.results[..self.fitted]
    }

    /// Covariance of the coefficients of an image of the last fit, nm², `[mode, mode]`, pistons about their mean; scaled
    /// by χ² where the model misfits.
    ///
    /// # Errors
    /// [`Error::Value`] for an image that was not fitted, or that sees no mode at all.
    pub fn covariance_nm2(&self, image: usize) -> Result<Array2<f64>> {
        let fitted = self.results().get(image).zip(self.images.get(image)).filter(|(_, image)| image.fitted);
        let Some((result, Image { prepared, minimum, .. })) = fitted else {
            return Err(Error::Value(format!(
                "image {image} has no covariance: the last fit was of {} images, and did not fit this one",
                self.fitted
            )));
        };
        let estimator = &self.shared.estimator;
        let psf = estimator.judge.psf(ArrayView1::from(&minimum.coefficients_nm));
        let variance_e2 = variance(&psf, minimum, &prepared.floor_variance_e2);
        let spread = Spread::of(estimator, &[0], from_ref(prepared), from_ref(minimum), from_ref(&variance_e2))?;
        Ok(estimator.with_shared(spread.covariance(0) * result.report.reduced_chi2.max(1.0)))
    }

    /// The flag that stops the fit that is running, or else the next: another thread raises it, and the fit that
    /// returns [`Error::Interrupted`] lowers it.
    pub fn cancel_flag(&self) -> CancelFlag {
        self.shared.cancel.clone()
    }

    /// Prepares frames 0 to `count` − 1 for [`Session::evaluate`], weighed by the noise of their own pixels.
    ///
    /// # Errors
    /// [`Error::Image`] for the first that cannot be used, [`Error::Shape`] for more than the capacity,
    /// [`Error::Value`] for a read noise out of range, [`Error::Device`] where a device fails.
    pub fn load(&mut self, count: usize, read_noise_e: Option<f64>) -> Result<()> {
        (self.fitted, self.loaded) = (0, 0);
        self.checked_count(count)?;
        let read_noise_e = self.read_noise_e(read_noise_e)?;
        let call = Call { shared: &self.shared, read_noise_e, start_nm: None, deadline: None };
        let images = &mut self.images[..count];
        match &mut self.engine {
            Engine::Cpu64(single) => single.load(&call, images),
            Engine::Cpu32(single) => single.load(&call, images),
            Engine::Device(batch) => batch.load(&call, images),
        }?;
        self.loaded = count;
        Ok(())
    }

    /// Objectives of the loaded images at `coefficients_nm` (`[image, mode]`, nm; fewer images than are loaded are the
    /// first ones), and their gradients per nm, image by image.
    ///
    /// # Errors
    /// [`Error::Shape`] where the arrays do not fit each other, the model or what is loaded; [`Error::Value`] where
    /// nothing is; [`Error::Device`] where a device fails.
    pub fn evaluate(
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
        match &mut self.engine {
            Engine::Cpu64(single) => single.evaluate(coefficients_nm, objectives, gradients),
            Engine::Cpu32(single) => single.evaluate(coefficients_nm, objectives, gradients),
            Engine::Device(batch) => return batch.evaluate(coefficients_nm, objectives, gradients),
        }
        Ok(())
    }

    fn checked_count(&self, count: usize) -> Result<()> {
        let capacity = self.images.len();
        if count > capacity {
            return Err(Error::Shape(format!("{count} images were given, where the session has room for {capacity}")));
        }
        Ok(())
    }

    fn checked_start(&self, count: usize, start_nm: Option<ArrayView2<f64>>) -> Result<()> {
        let Some(start_nm) = start_nm else { return Ok(()) };
        let (wanted, (rows, columns)) = (self.shared.modes(), start_nm.dim());
        if (rows, columns) != (count, wanted) {
            return Err(Error::Shape(format!(
                "a start of {rows}x{columns} was given, where {count}x{wanted} is needed"
            )));
        }
        match start_nm.indexed_iter().find(|(_, nm)| !nm.is_finite()) {
            Some(((image, mode), nm)) => Err(Error::Value(format!(
                "coefficient {mode} of the start of image {image} is {nm}, where a finite number is needed"
            ))),
            None => Ok(()),
        }
    }

    fn read_noise_e(&self, given: Option<f64>) -> Result<f64> {
        let read_noise_e = given.unwrap_or(self.shared.estimator.scene.image.read_noise_e);
        if !(read_noise_e >= 0.0 && read_noise_e.is_finite()) {
            return Err(Error::Value(format!(
                "a read noise of {read_noise_e} electrons was given, where a finite number of 0 or more is needed"
            )));
        }
        Ok(read_noise_e)
    }
}

impl Shared {
    fn modes(&self) -> usize {
        self.estimator.model.optics.modes()
    }
}

impl Image {
    /// Refuses a capacity that memory cannot hold, rather than find out while taking it.
    fn check_room(estimator: &Estimator, capacity: usize) -> Result<()> {
        let preparation = &estimator.model.preparation;
        let [x, y] = preparation.frame;
        // A frame with its mask, and at the model's sampling data, weights and floor.
        let bytes = x * y * (size_of::<f64>() + size_of::<bool>()) + 3 * size_of::<f64>() * preparation.pixels.pow(2);
        let all = capacity.checked_mul(bytes);
        if all.is_none_or(|all| Vec::<u8>::new().try_reserve_exact(all).is_err()) {
            return Err(Error::Value(format!(
                "a session for {capacity} images was asked for, which memory cannot hold: each takes {bytes} bytes"
            )));
        }
        Ok(())
    }

    fn room(estimator: &Estimator) -> Self {
        let preparation = &estimator.model.preparation;
        let shape = (preparation.frame[1], preparation.frame[0]);
        Self {
            data_e: Array2::zeros(shape),
            bad: Array2::from_elem(shape, false),
            prepared: preparation.room(),
            minimum: Minimum::room(estimator.model.optics.modes()),
            fitted: false,
        }
    }
}

impl<'a> Call<'a> {
    fn start_of(&self, image: usize) -> Option<ArrayView1<'_, f64>> {
        self.start_nm.as_ref().map(|start_nm| start_nm.row(image))
    }

    fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// # Errors
    /// [`Error::Interrupted`] where the flag is up.
    fn go_on(&self) -> Result<()> {
        if self.shared.cancel.load(Ordering::Relaxed) { Err(interrupted()) } else { Ok(()) }
    }
}

fn interrupted() -> Error {
    Error::Interrupted("the fit was cancelled".into())
}

fn unusable(image: usize, refusal: Refusal) -> Error {
    Error::Image(format!("frame {image} cannot be used: {refusal}"))
}
