//! Simulated camera: field on a fine grid, image at the detector's sampling, photon and read noise.

use super::pixels::DetectorPixels;
use super::truth::Truth;
use crate::Result;
use crate::fourier::{Sampling, Transform};
use crate::grid::Grid;
use crate::machine;
use crate::pupil::SegmentWeights;
use crate::scene::{ImageScene, System};
use crate::telescope::{Diversity, Filter, Telescope};
use ndarray::{Array2, s};
use rand::Rng;
use rand_distr::{Distribution, Poisson, StandardNormal};

/// Least number of wavelengths of a filter of finite width. The simulation uses twice as many as a
/// model needs, so that the discretisation error of a model is visible in its residuals.
const LEAST_WAVELENGTHS: usize = 7;

/// Memory of the camera of an artificial source for each sample of its grid, bytes: the field (16),
/// its transform, the weights of the segments with their indices, coordinates and wavefronts at the
/// illuminated samples. Measured on the Keck pupil: 112 to 120 from 1024 to 4096 samples a side,
/// for the whole process.
const BYTES_PER_SAMPLE: u64 = 120;

/// Pixels along a side of the square that holds the frame: even, as transforms are.
fn square(image: &ImageScene) -> usize {
    image.pixels.next_multiple_of(2)
}

/// Camera of a scene behind its telescope.
pub struct Camera<'a> {
    scene: &'a System,
    telescope: &'a Telescope,
    grid: Grid,
    weights: SegmentWeights,
    diversity: Diversity,
    filter: Filter,
}

impl<'a> Camera<'a> {
    /// Camera of `scene`, with the pupil on `aberrations.truth_samples` samples (default:
    /// [`Telescope::truth_samples`]).
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a coarse pupil map and a finer grid; those of reading the
    /// diversity and the filter.
    pub fn new(scene: &'a System, telescope: &'a Telescope) -> Result<Self> {
        let own = telescope.pupil.grid;
        let stated = scene.aberrations.as_ref().and_then(|aberrations| aberrations.truth_samples);
        let samples = stated.unwrap_or(telescope.truth_samples());
        let grid = Grid::new(samples, own.width_m())?;
        machine::check_memory(
            format_args!("{}: a simulated image with aberrations.truth_samples = {samples}", scene.name()),
            BYTES_PER_SAMPLE * (samples as u64).pow(2),
            "set fewer, at least pupil.samples",
        )?;
        let weights = telescope.area_weights(grid)?;
        let diversity = Diversity::new(scene, telescope)?;
        Ok(Self { scene, telescope, grid, weights, diversity, filter: Filter::new(scene)? })
    }

    /// Computes the noise-free PSF on the detector's frame, `[y, x]`; it sums to 1 over an
    /// unbounded detector.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] for an impossible sampling.
    pub fn psf(&self, truth: &Truth) -> Result<Array2<f64>> {
        let (image, psf) = (&self.scene.image, self.square_psf(truth)?);
        let (rows, columns) = image.frame_shape();
        // The axis is on pixel M/2 of the square and of the frame.
        let [y, x] = [rows, columns].map(|size| square(image) / 2 - size / 2);
        Ok(DetectorPixels::new(self.scene).apply(psf.slice_move(s![y..y + rows, x..x + columns])))
    }

    /// Computes the PSF on a square that holds the frame.
    fn square_psf(&self, truth: &Truth) -> Result<Array2<f64>> {
        let image = &self.scene.image;
        let opd_nm = self.smooth_opd_nm(truth)?;
        if self.filter.is_monochromatic() {
            return self.monochromatic(truth, &opd_nm, image.wavelength_nm);
        }
        let count =
            LEAST_WAVELENGTHS.max(2 * self.filter.wavelengths_needed(self.scene, self.telescope, &self.diversity));
        let mut sum = Array2::zeros((square(image), square(image)));
        for (ratio, share) in self.filter.wavelengths(count)? {
            sum.scaled_add(share, &self.monochromatic(truth, &opd_nm, image.wavelength_nm * ratio)?);
        }
        Ok(sum)
    }

    /// NCPA plus diversity at the illuminated samples, nm.
    fn smooth_opd_nm(&self, truth: &Truth) -> Result<Vec<f64>> {
        let (xs, ys): (Vec<f64>, Vec<f64>) = self.weights.illuminated.iter().map(|&p| self.at(p)).unzip();
        let mut opd_nm = truth.ncpa_at(&xs, &ys)?;
        for (opd_nm, (&x, &y)) in opd_nm.iter_mut().zip(xs.iter().zip(&ys)) {
            *opd_nm += self.diversity.at(x, y);
        }
        Ok(opd_nm)
    }

    /// Coordinates of a flat grid index, m.
    fn at(&self, flat: u32) -> (f64, f64) {
        let (y, x) = (flat as usize / self.grid.samples(), flat as usize % self.grid.samples());
        (self.grid.coordinate_m(x), self.grid.coordinate_m(y))
    }

    fn monochromatic(&self, truth: &Truth, opd_nm: &[f64], wavelength_nm: f64) -> Result<Array2<f64>> {
        let image = &self.scene.image;
        // A pixel is a fixed angle: it spans fewer λ/D where λ is longer.
        let per_lambda_over_d = image.samples_per_lambda_over_d * wavelength_nm / image.wavelength_nm;
        let sampling = Sampling::new(self.grid.samples(), square(image), per_lambda_over_d)?;
        let (n, m) = (sampling.samples, sampling.pixels);
        let mut field = vec![0.0f64; 2 * n * n];
        let phasor = |nm: f64| (std::f64::consts::TAU * (nm / wavelength_nm)).sin_cos();
        let varies = truth.varies_over_segments();
        let pistons: Vec<(f64, f64)> = truth.piston_nm.iter().map(|&nm| phasor(nm)).collect();
        for (((p, segments, weights), &opd), &flat) in self.weights.rows().zip(opd_nm).zip(&self.weights.illuminated) {
            let (mut re, mut im) = (0.0, 0.0);
            for (&segment, weight) in segments.iter().zip(weights) {
                let (sin, cos) = if varies {
                    let (x, y) = self.telescope.on_mirror(self.at(flat));
                    phasor(truth.segment_nm(&self.telescope.pupil, segment as usize, x, y))
                } else {
                    pistons[segment as usize]
                };
                let weight = weight * truth.amplitude[segment as usize];
                (re, im) = (re + weight * cos, im + weight * sin);
            }
            let (sin, cos) = phasor(opd);
            let place = 2 * (p / n) * n + p % n;
            field[place] = re * cos - im * sin;
            field[place + n] = re * sin + im * cos;
        }
        let transform = Transform::matrix(sampling);
        let mut focus = vec![0.0f64; 2 * m * m];
        transform.forward(&field, &mut focus, &mut transform.workspace());
        let scale = sampling.step().powi(2) / (self.weights.energy * truth.throughput(self.telescope));
        Ok(Array2::from_shape_fn((m, m), |(v, u)| {
            scale * (focus[2 * m * v + u].powi(2) + focus[2 * m * v + m + u].powi(2))
        }))
    }
}

/// Electrons of the star: `image.flux_e`, or the flux for which the brightest pixel (`peak` of the
/// PSF) has the signal-to-noise ratio `image.peak_snr` = s/√(s + background + read noise²), s its
/// signal. A scene has one of the two noises where it does not have a flux.
pub fn flux_e(image: &ImageScene, peak: f64) -> f64 {
    image.flux_e.unwrap_or_else(|| {
        let snr = image.peak_snr.unwrap_or(500.0);
        let photons = if image.photon_noise { 1.0 } else { 0.0 };
        let floor = image.simulated_read_noise_e().powi(2) + photons * image.background_e;
        let peak_e = 0.5 * (snr * snr * photons + snr * (snr * snr * photons + 4.0 * floor).sqrt());
        peak_e / peak
    })
}

/// Draws one pixel of an exposure with noise, electrons; `h` is the PSF at the pixel.
pub fn expose(image: &ImageScene, h: f64, flux_e: f64, rng: &mut impl Rng) -> f64 {
    let mean = flux_e * h + image.background_e;
    // `Poisson` needs a positive mean; for a mean of 0 the signal is 0.
    let photons = if image.photon_noise { Poisson::new(mean).map_or(0.0, |poisson| poisson.sample(rng)) } else { mean };
    let noise: f64 = StandardNormal.sample(rng);
    photons + image.simulated_read_noise_e() * noise
}
