//! The chain on the CPU: one image per thread at a time, in f64 (the reference) or f32. For a model
//! of several wavelengths, field and transform are computed for each, and pixels and detector once.

mod free;

pub use free::FreeWavefront;

use super::detector::{Evaluation, Exposure, LoadedImage};
use super::field::{Change, Field, FieldState};
use super::optics::Optics;
use super::phasor::Polynomial;
use super::pixels::Pixels;
use crate::fourier::{Sampling, Transform, Workspace};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2};
use pulp::NullaryFnOnce;
use rayon::prelude::*;
use std::borrow::Borrow;
use std::sync::{Arc, Mutex};

/// Forward model and adjoint on the CPU, for a batch of images.
pub struct CpuChain<T: Polynomial> {
    optics: Arc<Optics>,
    colours: Vec<Stages<T>>,
    /// The area of the pixels, where they are not points.
    pixels: Option<Pixels<T>>,
    images: Vec<LoadedImage<T>>,
    /// Scratch memory not in use by a thread.
    idle: Mutex<Vec<Scratch<T>>>,
}

/// The stages of one wavelength.
struct Stages<T: Polynomial> {
    field: Field<T>,
    transform: Transform<T>,
}

/// Scratch memory of one thread, for one evaluation at a time: see [`CpuChain::scratch`].
pub struct Scratch<T: Polynomial> {
    colours: Vec<ColourScratch<T>>,
    pupil_bar: Vec<T>,
    psf: Vec<T>,
    /// Two images, for pixels that are not points.
    images: [Vec<T>; 2],
}

/// Scratch memory of one wavelength.
struct ColourScratch<T: Polynomial> {
    field: FieldState<T>,
    pupil: Vec<T>,
    focus: Vec<T>,
    workspace: Workspace<T>,
}

/// Field and PSF of the flat wavefront, which are the same for every image: see
/// [`CpuChain::flat_wavefront`]. For one thread.
pub struct FlatWavefront<T: Polynomial> {
    scratch: Scratch<T>,
    /// The focal field of each wavelength; an evaluation overwrites the one in `scratch`.
    focus: Vec<Vec<T>>,
}

impl<T: Polynomial> CpuChain<T> {
    /// A chain for `optics` with the cheapest transforms for its sampling.
    pub fn new(optics: Arc<Optics>) -> Self {
        Self::with_transforms(optics, Transform::choose)
    }

    /// A chain with the transforms that `transform` constructs for the sampling of each wavelength.
    pub fn with_transforms(optics: Arc<Optics>, transform: impl Fn(Sampling) -> Transform<T>) -> Self {
        let stages = |optics: &Optics| Stages { field: Field::new(optics), transform: transform(optics.sampling()) };
        let colours = optics.colours().iter().map(|colour| stages(colour)).collect();
        let pixels = Pixels::of(&optics);
        Self { optics, colours, pixels, images: Vec::new(), idle: Mutex::new(Vec::new()) }
    }

    /// The model.
    pub fn optics(&self) -> &Arc<Optics> {
        &self.optics
    }

    /// Points of the FFT of the first wavelength; `None` with matrix products.
    pub fn fft_points(&self) -> Option<usize> {
        match self.colours[0].transform {
            Transform::Matrix(_) => None,
            Transform::Fft(_) => self.optics.colours()[0].sampling().padded(),
        }
    }

    /// The field stage of each wavelength.
    pub(super) fn fields(&self) -> impl Iterator<Item = &Field<T>> {
        self.colours.iter().map(|colour| &colour.field)
    }

    /// Replaces the batch of images.
    ///
    /// # Errors
    /// As [`Exposure::check`].
    pub fn load<E: Borrow<Exposure>>(&mut self, exposures: &[E]) -> Result<()> {
        exposures.iter().try_for_each(|exposure| exposure.borrow().check(self.optics.sampling().pixels))?;
        self.images.resize_with(exposures.len(), || LoadedImage::empty(self.optics.sampling().pixels));
        self.images.iter_mut().zip(exposures).for_each(|(image, exposure)| image.set(exposure.borrow()));
        Ok(())
    }

    /// Replaces one image of the batch.
    ///
    /// # Errors
    /// As [`Exposure::check`], and [`Error::Shape`] where there is no such image.
    pub fn replace(&mut self, image: usize, exposure: &Exposure) -> Result<()> {
        exposure.check(self.optics.sampling().pixels)?;
        let count = self.images.len();
        let slot = self.images.get_mut(image).ok_or_else(|| no_image(image, count))?;
        slot.set(exposure);
        Ok(())
    }

    /// Objectives and gradients of `images` at `coefficients_nm` (`[image, mode]`, nm), in that
    /// order.
    ///
    /// # Errors
    /// [`Error::Shape`] where the arrays do not fit the batch and the model.
    pub fn evaluate(&self, images: &[usize], coefficients_nm: ArrayView2<f64>) -> Result<Vec<Evaluation>> {
        check_batch(images, coefficients_nm, self.images.len(), self.optics.modes())?;
        Ok((0..images.len())
            .into_par_iter()
            .map(|i| {
                let mut memory = self.take_scratch();
                let mut evaluation = self.evaluation();
                self.evaluate_one(&self.images[images[i]], coefficients_nm.row(i), &mut memory, &mut evaluation);
                self.return_scratch(memory);
                evaluation
            })
            .collect())
    }

    /// Objective and gradient of one image at `coefficients_nm`, into `evaluation`
    /// ([`CpuChain::evaluation`]): on this thread, without allocation. Bitwise the result of
    /// [`CpuChain::evaluate`].
    ///
    /// # Panics
    /// If an argument was made by a chain of another model.
    pub fn evaluate_one(
        &self,
        image: &LoadedImage<T>,
        coefficients_nm: ArrayView1<f64>,
        scratch: &mut Scratch<T>,
        evaluation: &mut Evaluation,
    ) {
        vectorised(Forward { chain: self, coefficients_nm, memory: scratch });
        self.evaluate_at_last_psf(image, scratch, evaluation);
    }

    /// As [`CpuChain::evaluate_one`] at the coefficients of the last [`CpuChain::psf_in`] with
    /// `scratch`, whose PSF is used again: bitwise the same.
    ///
    /// # Panics
    /// As [`CpuChain::evaluate_one`].
    pub fn evaluate_at_last_psf(&self, image: &LoadedImage<T>, scratch: &mut Scratch<T>, evaluation: &mut Evaluation) {
        crate::fault::panic_in_worker();
        vectorised(Backward { chain: self, image, memory: scratch, evaluation });
    }

    /// Field and PSF of the flat wavefront, computed once for many images.
    pub fn flat_wavefront(&self) -> FlatWavefront<T> {
        let mut scratch = self.scratch();
        self.psf_in(Array1::zeros(self.optics.modes()).view(), &mut scratch);
        FlatWavefront { focus: scratch.colours.iter().map(|colour| colour.focus.clone()).collect(), scratch }
    }

    /// As [`CpuChain::evaluate_one`] at the flat wavefront, in slightly more than half of the time:
    /// bitwise the same.
    ///
    /// # Panics
    /// As [`CpuChain::evaluate_one`].
    pub fn evaluate_flat(&self, image: &LoadedImage<T>, flat: &mut FlatWavefront<T>, evaluation: &mut Evaluation) {
        flat.scratch
            .colours
            .iter_mut()
            .zip(&flat.focus)
            .for_each(|(colour, focus)| colour.focus.copy_from_slice(focus));
        self.evaluate_at_last_psf(image, &mut flat.scratch, evaluation);
    }

    /// The PSF, as [`CpuChain::psf`], without allocation.
    pub fn psf_in<'s>(&self, coefficients_nm: ArrayView1<f64>, scratch: &'s mut Scratch<T>) -> &'s [T] {
        vectorised(Forward { chain: self, coefficients_nm, memory: scratch });
        &scratch.psf
    }

    /// Memory for one image of this model, without data.
    pub fn empty_image(&self) -> LoadedImage<T> {
        LoadedImage::empty(self.optics.sampling().pixels)
    }

    /// Writes `exposure` into `image`.
    ///
    /// # Errors
    /// As [`Exposure::check`].
    pub fn set(&self, image: &mut LoadedImage<T>, exposure: &Exposure) -> Result<()> {
        exposure.check(self.optics.sampling().pixels)?;
        image.set(exposure);
        Ok(())
    }

    /// Memory for the results of an evaluation.
    pub fn evaluation(&self) -> Evaluation {
        Evaluation { gradient: vec![0.0; self.optics.modes()], ..Evaluation::default() }
    }

    /// The PSF (m×m, `[y][x]`, sum 1 over an unbounded detector) at `coefficients_nm`.
    pub fn psf(&self, coefficients_nm: ArrayView1<f64>) -> Vec<T> {
        let mut memory = self.take_scratch();
        vectorised(Forward { chain: self, coefficients_nm, memory: &mut memory });
        let psf = memory.psf.clone();
        self.return_scratch(memory);
        psf
    }

    /// The PSF and its derivative with respect to every coefficient, `[mode, pixel]`, per nm.
    pub fn jacobian(&self, coefficients_nm: ArrayView1<f64>) -> (Vec<T>, Array2<T>) {
        let pixels = self.optics.sampling().pixels;
        let mut here = self.take_scratch();
        vectorised(Forward { chain: self, coefficients_nm, memory: &mut here });
        let mut jacobian = Array2::from_elem((self.optics.modes(), here.psf.len()), T::zero());
        let modes = &self.optics.parts().modes;
        let rows: Vec<_> = jacobian.outer_iter_mut().zip(modes).collect();
        let at = &here.colours;
        rows.into_par_iter().for_each(|(mut row, &mode)| {
            let mut memory = self.take_scratch();
            for ((stages, at), memory) in self.colours.iter().zip(at).zip(&mut memory.colours) {
                memory.pupil.fill(T::zero());
                stages.field.derivative(Change::Mode(mode), &at.field, &mut memory.pupil);
                stages.transform.forward(&memory.pupil, &mut memory.focus, &mut memory.workspace);
                // The grid must be zero outside the illuminated samples.
                memory.pupil.fill(T::zero());
                let lines = at.focus.chunks_exact(2 * pixels).zip(memory.focus.chunks_exact(2 * pixels));
                for (v, (at, along)) in lines.enumerate() {
                    for u in 0..pixels {
                        let real = at[u] * along[u] + at[pixels + u] * along[pixels + u];
                        row[v * pixels + u] += real + real;
                    }
                }
            }
            if let (Some(pixels), Some(row)) = (&self.pixels, row.as_slice_mut()) {
                pixels.apply(row, &mut memory.images[0]);
            }
            self.return_scratch(memory);
        });
        let psf = here.psf.clone();
        self.return_scratch(here);
        (psf, jacobian)
    }

    /// Scratch memory for one thread.
    pub fn scratch(&self) -> Scratch<T> {
        let (n, m) = (self.optics.sampling().samples, self.optics.sampling().pixels);
        let colour = |stages: &Stages<T>| ColourScratch {
            field: stages.field.state(),
            pupil: vec![T::zero(); 2 * n * n],
            focus: vec![T::zero(); 2 * m * m],
            workspace: stages.transform.workspace(),
        };
        Scratch {
            colours: self.colours.iter().map(colour).collect(),
            pupil_bar: vec![T::zero(); 2 * n * n],
            psf: vec![T::zero(); m * m],
            images: [0, 1].map(|_| vec![T::zero(); if self.pixels.is_some() { m * m } else { 0 }]),
        }
    }

    /// Computes the PSF from the pupil fields in `memory`.
    #[inline(always)]
    fn to_psf(&self, memory: &mut Scratch<T>) {
        let pixels = self.optics.sampling().pixels;
        for (i, (stages, colour)) in self.colours.iter().zip(&mut memory.colours).enumerate() {
            stages.transform.forward(&colour.pupil, &mut colour.focus, &mut colour.workspace);
            match i {
                0 => LoadedImage::intensity(&colour.focus, &mut memory.psf, pixels),
                _ => LoadedImage::add_intensity(&colour.focus, &mut memory.psf, pixels),
            }
        }
        if let Some(pixels) = &self.pixels {
            pixels.apply(&mut memory.psf, &mut memory.images[0]);
        }
    }

    fn take_scratch(&self) -> Scratch<T> {
        let idle = self.idle.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).pop();
        idle.unwrap_or_else(|| self.scratch())
    }

    fn return_scratch(&self, memory: Scratch<T>) {
        self.idle.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(memory);
    }
}

impl<T: Polynomial> Scratch<T> {
    /// The PSF of the last evaluation.
    pub fn psf(&self) -> &[T] {
        &self.psf
    }
}

/// Forward model: coefficients to PSF.
struct Forward<'a, T: Polynomial> {
    chain: &'a CpuChain<T>,
    coefficients_nm: ArrayView1<'a, f64>,
    memory: &'a mut Scratch<T>,
}

impl<T: Polynomial> NullaryFnOnce for Forward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { chain, coefficients_nm, memory } = self;
        for (stages, colour) in chain.colours.iter().zip(&mut memory.colours) {
            stages.field.forward(coefficients_nm, &mut colour.field, &mut colour.pupil);
        }
        chain.to_psf(memory);
    }
}

/// Objective from the PSF, and the adjoint to the gradient.
struct Backward<'a, T: Polynomial> {
    chain: &'a CpuChain<T>,
    image: &'a LoadedImage<T>,
    memory: &'a mut Scratch<T>,
    evaluation: &'a mut Evaluation,
}

impl<T: Polynomial> NullaryFnOnce for Backward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { chain, image, memory, evaluation } = self;
        let m = chain.optics.sampling().pixels;
        image.forward(&memory.psf, evaluation);
        evaluation.gradient.fill(0.0);
        let [slope, work] = &mut memory.images;
        if let Some(pixels) = &chain.pixels {
            image.slope(evaluation, &memory.psf, slope);
            // The convolution is its own adjoint.
            pixels.apply(slope, work);
        }
        for (stages, colour) in chain.colours.iter().zip(&mut memory.colours) {
            match chain.pixels {
                Some(_) => LoadedImage::times_slope(slope, &mut colour.focus, m),
                // The objective is that of all wavelengths; each call computes the same value.
                None => image.adjoint(evaluation, &memory.psf, &mut colour.focus, m),
            }
            stages.transform.adjoint(&colour.focus, &mut memory.pupil_bar, &mut colour.workspace);
            stages.field.adjoint(&memory.pupil_bar, &mut colour.field, &mut evaluation.gradient);
        }
    }
}

/// Runs `work` compiled for the widest vectors of this CPU. All of it must be inlined into the
/// call; otherwise it is compiled for the oldest CPU, where each fused multiply-add is a function
/// call. Hence named types with an `inline(always)` body instead of closures, and the same
/// attribute on the stages.
#[inline(always)]
pub(super) fn vectorised<R>(work: impl NullaryFnOnce<Output = R>) -> R {
    pulp::Arch::new().dispatch(work)
}

/// Checks that images and coefficients fit the batch and the model.
pub(super) fn check_batch(
    images: &[usize],
    coefficients_nm: ArrayView2<f64>,
    loaded: usize,
    modes: usize,
) -> Result<()> {
    if coefficients_nm.dim() != (images.len(), modes) {
        let (rows, columns) = coefficients_nm.dim();
        return Err(Error::Shape(format!(
            "coefficients of shape {rows}x{columns} were given for {} images of {modes} modes: one row per image and one column \
             per mode are needed",
            images.len()
        )));
    }
    match images.iter().find(|&&image| image >= loaded) {
        Some(&image) => Err(no_image(image, loaded)),
        None => Ok(()),
    }
}

fn no_image(image: usize, count: usize) -> Error {
    Error::Shape(format!("image {image} was requested, but only {count} are loaded"))
}
