//! The chain on a device: checks and folds the input, runs the stages, and unfolds the results.

use std::f64::consts::TAU;

use rayon::prelude::*;

use super::budget::usable_memory_bytes;
use super::evaluation::{GpuEvaluation, GpuPhotometry};
use super::fold::FoldedShape;
use super::image::FoldedImage;
use super::layout::{GpuColour, GpuLayout, GpuMode};
use super::stages::{Focal, Inputs, Stages};
use crate::device::{Build, Device, Precision};
use crate::{Error, Result};

/// Images folded on the host at a time: enough for every core, and little memory compared with the
/// device's.
const FOLDED_AT_ONCE: usize = 32;

/// Least images of which a core computes the inputs, 1 µs for each: waking another core takes some
/// 0.1 ms.
const INPUTS_AT_ONCE: usize = 256;

/// The chain on a device, with memory for a number of images. It cannot be shared between threads,
/// because the arguments of its kernels stay bound between launches.
pub struct GpuChain {
    device: Device,
    build: Build,
    layout: GpuLayout,
    shape: FoldedShape,
    stages: Stages,
    /// The same chain with matrix products in place of the FFT, for focal fields, which the FFT
    /// kernel does not store. Made at its first use.
    matrix: Option<Box<GpuChain>>,
    photometry: Vec<GpuPhotometry>,
    /// Offset subtracted from the data of each image: see [`FoldedImage::offset`].
    offsets: Vec<f64>,
}

impl GpuChain {
    /// Compiles the chain for `layout` on `device`, with memory for `capacity` images.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] for a layout whose arrays do not fit each other,
    /// [`Error::Device`] where the device lacks the precision or the memory.
    pub fn new(device: &Device, precision: Precision, layout: &GpuLayout, capacity: usize) -> Result<Self> {
        layout.check()?;
        let build = Build::for_device(device.info(), precision);
        let fft = FoldedShape::fft(layout, build.vector);
        Self::with_build(device, Build { fft, ..build }, layout, capacity)
    }

    /// [`GpuChain::new`] with a given build.
    ///
    /// # Errors
    /// As for [`GpuChain::new`].
    pub(crate) fn with_build(device: &Device, build: Build, layout: &GpuLayout, capacity: usize) -> Result<Self> {
        Self::with_memory(device, build, layout, capacity, usable_memory_bytes(device.info()))
    }

    /// [`GpuChain::with_build`] in at most `memory_bytes` of device memory: less memory means
    /// smaller tiles.
    ///
    /// # Errors
    /// As for [`GpuChain::new`]; [`Error::Device`], with the bytes needed and available, where the
    /// memory does not suffice.
    pub(crate) fn with_memory(
        device: &Device,
        build: Build,
        layout: &GpuLayout,
        capacity: usize,
        memory_bytes: u64,
    ) -> Result<Self> {
        layout.check()?;
        if capacity == 0 {
            return Err(Error::Value("a chain for 0 images is impossible: 1 or more is needed".into()));
        }
        let shape = FoldedShape::new(layout, &layout.colours[0], build);
        let stages = Stages::new(device, build, layout, capacity, memory_bytes)?;
        Ok(Self {
            device: device.clone(),
            build,
            layout: layout.clone(),
            shape,
            stages,
            matrix: None,
            photometry: Vec::new(),
            offsets: Vec::new(),
        })
    }

    /// The device.
    #[cfg(all(test, debug_assertions))]
    pub(crate) fn device(&self) -> &Device {
        &self.device
    }

    /// Number of coefficients of the model.
    pub fn modes(&self) -> usize {
        self.layout.modes.len()
    }

    /// Number of samples with a free phase.
    fn free_samples(&self) -> usize {
        if self.layout.free_phase { self.layout.illuminated.len() } else { 0 }
    }

    /// Points of the FFT; `None` with matrix products. Beside the model, the work of an evaluation
    /// depends on it.
    pub fn fft_points(&self) -> Option<usize> {
        self.build.fft.map(|fft| fft.points())
    }

    /// Device memory that the chain takes, bytes: see the memory budget in `budget.rs`.
    pub fn bytes(&self) -> u64 {
        self.stages.bytes()
    }

    /// Largest number of images.
    pub fn capacity(&self) -> usize {
        self.stages.capacity()
    }

    /// Uploads images: `data` (electrons) and `weights` (1/electrons²; 0 masks a pixel, whose data
    /// are ignored) are `[image][row][column]`, with one photometry per image. They replace the
    /// images of an earlier call; after an error none is loaded.
    ///
    /// # Errors
    /// [`Error::Shape`] where the lists do not fit or exceed the capacity; [`Error::Value`] for a
    /// weight that is negative or not finite, data that are not finite where the weight is
    /// positive, or known photometry that is not finite; [`Error::Device`] where the device failed.
    pub fn load<D, W>(&mut self, data: &[D], weights: &[W], photometry: &[GpuPhotometry]) -> Result<()>
    where
        D: Copy + Into<f64> + Sync,
        W: Copy + Into<f64> + Sync,
    {
        let m = self.layout.pixels;
        let (images, size) = (photometry.len(), m * m);
        for (what, found) in [("data", data.len()), ("weights", weights.len())] {
            if found != images * size {
                return Err(Error::Shape(format!("{found} {what} are not {images} images of {m} x {m} pixels")));
            }
        }
        let parts = data.chunks_exact(size).zip(weights.chunks_exact(size)).zip(photometry);
        self.load_images(&parts.map(|((data, weights), photometry)| (data, weights, *photometry)).collect::<Vec<_>>())
    }

    /// As [`GpuChain::load`], from the data, weights and photometry of each image.
    ///
    /// # Errors
    /// As for [`GpuChain::load`].
    pub fn load_images<D, W>(&mut self, images: &[(&[D], &[W], GpuPhotometry)]) -> Result<()>
    where
        D: Copy + Into<f64> + Sync,
        W: Copy + Into<f64> + Sync,
    {
        if images.len() > self.capacity() {
            return Err(Error::Shape(format!(
                "{} images exceed the capacity of the chain, {} images",
                images.len(),
                self.capacity()
            )));
        }
        self.photometry.clear();
        self.offsets.clear();
        self.offsets.resize(images.len(), 0.0);
        let slots: Vec<_> =
            images.iter().enumerate().map(|(i, &(data, weights, one))| (i, data, weights, one)).collect();
        self.upload(&slots)?;
        self.photometry.extend(images.iter().map(|(.., photometry)| *photometry));
        Ok(())
    }

    /// Folds images and writes them into their slots.
    fn upload<D, W>(&mut self, images: &[(usize, &[D], &[W], GpuPhotometry)]) -> Result<()>
    where
        D: Copy + Into<f64> + Sync,
        W: Copy + Into<f64> + Sync,
    {
        let m = self.layout.pixels;
        let fold = |&(image, data, weights, ref photometry): &(usize, &[D], &[W], GpuPhotometry)| {
            if data.len() != m * m || weights.len() != m * m {
                let (data, weights) = (data.len(), weights.len());
                return Err(Error::Shape(format!(
                    "{data} data and {weights} weights are not an image of {m} x {m} pixels"
                )));
            }
            let folded = FoldedImage::new(&self.shape, m, data, weights, photometry)
                .map_err(|what| Error::Value(format!("image {image} {what}")))?;
            Ok((image, folded))
        };
        for images in images.chunks(FOLDED_AT_ONCE) {
            let folded = images.par_iter().map(fold).collect::<Result<Vec<_>>>()?;
            self.stages.load(&folded)?;
            for ((image, .., photometry), (_, folded)) in images.iter().zip(&folded) {
                self.offsets[*image] = folded.offset;
                // None is known before all images are loaded.
                if let Some(known) = self.photometry.get_mut(*image) {
                    *known = *photometry;
                }
            }
        }
        Ok(())
    }

    /// Replaces one loaded image.
    ///
    /// # Errors
    /// As for [`GpuChain::load`], and [`Error::Shape`] where there is no such image.
    pub fn replace(&mut self, image: usize, data: &[f64], weights: &[f64], photometry: GpuPhotometry) -> Result<()> {
        self.replace_all(&[(image, data, weights, photometry)])
    }

    /// Replaces loaded images: index, data, weights and photometry of each.
    ///
    /// # Errors
    /// As for [`GpuChain::replace`].
    pub fn replace_all(&mut self, images: &[(usize, &[f64], &[f64], GpuPhotometry)]) -> Result<()> {
        let loaded = self.photometry.len();
        if let Some((image, ..)) = images.iter().find(|(image, ..)| *image >= loaded) {
            return Err(Error::Shape(format!("image {image} is not among the {loaded} loaded")));
        }
        self.upload(images)
    }

    /// Objective, gradient and photometry of the images `active` (indices into what was loaded) at
    /// `coefficients`, nm, `[active image][mode]`.
    ///
    /// # Errors
    /// [`Error::Shape`] for an image that is not loaded or a list of another length;
    /// [`Error::Value`] for a coefficient that is not finite; [`Error::Device`] where the device
    /// failed.
    pub fn evaluate(&mut self, active: &[usize], coefficients: &[f64]) -> Result<GpuEvaluation> {
        let free = vec![0.0; active.len() * self.free_samples()];
        self.evaluate_free(active, coefficients, &free, &mut free.clone())
    }

    /// As [`GpuChain::evaluate`] with a free phase `free`, turns,
    /// `[active image][illuminated sample]`, for a model that has one. The gradient of the
    /// objective by it, per turn, is written into `slopes`.
    ///
    /// # Errors
    /// As for [`GpuChain::evaluate`].
    pub fn evaluate_free(
        &mut self,
        active: &[usize],
        coefficients: &[f64],
        free: &[f64],
        slopes: &mut [f64],
    ) -> Result<GpuEvaluation> {
        let wanted = active.len() * self.free_samples();
        if free.len() != wanted || slopes.len() != wanted {
            return Err(Error::Shape(format!(
                "{} free phases and space for {} derivatives were given for {} images of {} free samples",
                free.len(),
                slopes.len(),
                active.len(),
                self.free_samples()
            )));
        }
        if let Some(image) = active.iter().find(|i| **i >= self.photometry.len()) {
            return Err(Error::Shape(format!("image {image} is not among the {} loaded", self.photometry.len())));
        }
        let inputs = self.inputs(active.len(), coefficients)?;
        let fitted = active.iter().any(|&i| !matches!(self.photometry[i], GpuPhotometry::Known { .. }));
        let results = self.stages.evaluate(active, &inputs, (free, slopes), fitted)?;

        let (poses, outputs) = (self.layout.poses(), self.layout.outputs());
        let mut evaluation = GpuEvaluation {
            objective: Vec::with_capacity(active.len()),
            gradient: Vec::with_capacity(active.len() * self.modes()),
            flux_e: Vec::with_capacity(active.len()),
            background_e: Vec::with_capacity(active.len()),
        };
        for (result, &image) in results.chunks_exact(outputs).zip(active) {
            evaluation.objective.push(result[0]);
            evaluation.flux_e.push(result[1]);
            evaluation.background_e.push(result[2] + self.offsets[image]);
            let (segments, smooth) = result[3..].split_at(self.layout.segments * poses);
            evaluation.gradient.extend(self.layout.modes.iter().map(|mode| match *mode {
                GpuMode::Segment(s) => segments[s * poses],
                GpuMode::Tip(s) => segments[s * poses + 1],
                GpuMode::Tilt(s) => segments[s * poses + 2],
                GpuMode::Smooth(j) => smooth[j],
            }));
        }
        Ok(evaluation)
    }

    /// The PSFs at `coefficients`, nm, `[image][mode]`: `[image][row][column]`, for any number of
    /// images (no image need be loaded).
    ///
    /// # Errors
    /// As for [`GpuChain::evaluate`].
    pub fn psf(&mut self, coefficients: &[f64]) -> Result<Vec<f64>> {
        if self.build.fft.is_some() {
            let matrix = match self.matrix.take() {
                Some(matrix) => matrix,
                None => Box::new(Self::with_build(&self.device, Build { fft: None, ..self.build }, &self.layout, 1)?),
            };
            return self.matrix.insert(matrix).psf(coefficients);
        }
        let (m, modes) = (self.layout.pixels, self.modes());
        let images = coefficients.len().checked_div(modes).unwrap_or(1);
        let mut psfs = Vec::with_capacity(images * m * m);
        for first in (0..images).step_by(self.stages.focal_tile()) {
            let count = (images - first).min(self.stages.focal_tile());
            let inputs = self.inputs(count, &coefficients[first * modes..(first + count) * modes])?;
            let (pixels, shape) = (self.shape.pixels(), self.shape);
            let mut unfolded = vec![0.0; count * m * m];
            let images = unfolded.par_chunks_exact_mut(m * m);
            match self.stages.focal(count, &inputs)? {
                Focal::Field(fields) => {
                    let fields = fields.par_chunks_exact(2 * pixels);
                    images.zip(fields).for_each(|(image, field)| unfold_intensity(&shape, field, m, image));
                }
                Focal::Intensity(folded) => {
                    let unfold = |(image, folded): (&mut [f64], &[f64])| {
                        image.iter_mut().enumerate().for_each(|(i, h)| *h = folded[shape.pixel(m, i / m, i % m)]);
                    };
                    images.zip(folded.par_chunks_exact(pixels)).for_each(unfold);
                }
            }
            psfs.append(&mut unfolded);
        }
        Ok(psfs)
    }

    /// The inputs of the stages.
    fn inputs(&self, images: usize, coefficients: &[f64]) -> Result<Inputs> {
        let modes = self.modes();
        if coefficients.len() != images * modes {
            return Err(Error::Shape(format!(
                "{} coefficients are not those of {images} images of {modes} modes",
                coefficients.len()
            )));
        }
        if let Some(k) = coefficients.iter().position(|c| !c.is_finite()) {
            return Err(Error::Value(format!(
                "coefficient {} of image {} is {}: finite nanometres are needed",
                k % modes,
                k / modes,
                coefficients[k]
            )));
        }
        // The closures borrow the layout alone: the stages cannot be shared between threads.
        let layout = &self.layout;
        let turns = self.of_each_image(images, layout.smooth.len(), coefficients, |turns, coefficients| {
            for (mode, coefficient) in layout.modes.iter().zip(coefficients) {
                if let GpuMode::Smooth(j) = *mode {
                    turns[j] += coefficient / layout.colours[0].wavelength_nm;
                }
            }
        });
        let poses = self.layout.colours.iter().map(|colour| self.poses(colour, images, coefficients)).collect();
        Ok(Inputs { turns, poses })
    }

    /// The poses of the segments at a wavelength: re and im of the phasor of the piston times the
    /// root of the intensity scale (so that |U|² is the PSF), then tip and tilt, turns.
    fn poses(&self, colour: &GpuColour, images: usize, coefficients: &[f64]) -> Vec<f64> {
        let (layout, amplitude) = (&self.layout, colour.intensity_scale.sqrt());
        self.of_each_image(images, 4 * layout.segments, coefficients, |poses, coefficients| {
            for (mode, coefficient) in layout.modes.iter().zip(coefficients) {
                let amount = coefficient / colour.wavelength_nm;
                match *mode {
                    GpuMode::Segment(s) => poses[4 * s] += amount,
                    GpuMode::Tip(s) => poses[4 * s + 2] += amount,
                    GpuMode::Tilt(s) => poses[4 * s + 3] += amount,
                    GpuMode::Smooth(_) => (),
                }
            }
            for pose in poses.chunks_exact_mut(4) {
                let (sine, cosine) = (TAU * (pose[0] - pose[0].round())).sin_cos();
                (pose[0], pose[1]) = (amplitude * cosine, amplitude * sine);
            }
        })
    }

    /// `numbers` of each image, which `fill` makes of zeros from its coefficients; many images on
    /// all cores.
    fn of_each_image(
        &self,
        images: usize,
        numbers: usize,
        coefficients: &[f64],
        fill: impl Fn(&mut [f64], &[f64]) + Sync,
    ) -> Vec<f64> {
        let mut filled = vec![0.0; images * numbers];
        let to = filled.par_chunks_exact_mut(numbers.max(1));
        let from = coefficients.par_chunks_exact(self.modes().max(1));
        to.zip(from).with_min_len(INPUTS_AT_ONCE).for_each(|(to, from)| fill(to, from));
        filled
    }
}

/// Intensity |C ∓ iS|² of `[pair][+v, -v][C re, C im, S re, S im][u]`, in the order of pixels of an
/// image of `m` rows.
fn unfold_intensity(shape: &FoldedShape, field: &[f64], m: usize, image: &mut [f64]) {
    let span = shape.span;
    for (i, h) in image.iter_mut().enumerate() {
        // The index of a pixel counts 2 sides of `span` per row, that of the focal field 4 planes.
        let pixel = shape.pixel(m, i / m, i % m);
        let (row, side, u) = (pixel / (2 * span), pixel / span % 2, pixel % span);
        let [cr, ci, sr, si] = [0, 1, 2, 3].map(|plane| field[(row * 4 + plane) * span + u]);
        let sign = if side == 0 { 1.0 } else { -1.0 };
        *h = (cr + sign * si).powi(2) + (ci - sign * sr).powi(2);
    }
}

impl std::fmt::Debug for GpuChain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GpuChain")
            .field("shape", &self.shape)
            .field("capacity", &self.capacity())
            .finish_non_exhaustive()
    }
}
