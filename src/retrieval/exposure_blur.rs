//! Blur of an exposure: the wavefront changes while the shutter is open.
//!
//! An exposure is the mean of many images. Its transfer function is that of the mean wavefront
//! times exp(−D(r)/2) at the baseline r, with D the structure function of the changes about the
//! mean, in rad², where these are normal and independent of it (Roddier 1981, Progress in Optics
//! 19, 281, of long exposures). D follows from the power spectral density of the changes, which the
//! scene's winds and exposure determine.
//!
//! 10 ms behind Keck's loop take 0.6 % of the light out of the core. A model without it finds a
//! wider image, and in it a focus, a spherical aberration and, along the wind, an astigmatism of
//! some nm that do not average over images.
//!
//! The blur is small and smooth, so that the image of an earlier estimate is precise enough for it:
//! it is what a retrieval subtracts from its data, and costs two Fourier transforms an image
//! instead of two in each evaluation.

use super::ao_residual::AoResidual;
use crate::Result;
use crate::fourier::{fast_side, transform_square};
use crate::scene::System;
use cophase_numerics::fft::{Fft, plan_both};
use num_complex::Complex64;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Blur of the images of a model.
pub(super) struct ExposureBlur {
    /// Pixels along a side of an image, and of the grid on which it is convolved, without wrapping.
    pixels: usize,
    padded: usize,
    /// Transfer function less 1, over the number of points of the grid, `[fy, fx]` in the order of
    /// the Fourier transform.
    change: Vec<f64>,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl ExposureBlur {
    /// For images of `pixels` pixels a side, of which a whole turn of the frequency is a baseline
    /// of `reach_m`; `None` where the scene does not say how its turbulence moves.
    ///
    /// # Errors
    /// Those of [`AoResidual::from_scene`].
    pub(super) fn new(scene: &System, pixels: usize, reach_m: f64) -> Result<Option<Self>> {
        let residual = AoResidual::from_scene(scene)?;
        if !residual.has_layers() {
            return Ok(None);
        }
        let padded = fast_side(2 * pixels);
        let (forward, inverse) = plan_both(padded);
        // Baselines are reach_m/padded apart, so that frequencies of the wavefront are 1/reach_m
        // apart.
        let signed = |k: usize| if k <= padded / 2 { k as f64 } else { k as f64 - padded as f64 };
        let rad_per_nm = TAU / scene.image.wavelength_nm;
        let scale = (rad_per_nm / reach_m).powi(2);
        let mut covariance: Vec<Complex64> = (0..padded * padded)
            .map(|at| (signed(at % padded) / reach_m, signed(at / padded) / reach_m))
            .map(|(fx, fy)| Complex64::from(scale * residual.change_density(fx, fy)))
            .collect();
        // Piston: images are blind to it.
        covariance[0] = Complex64::ZERO;
        transform_square(&mut covariance, padded, &*inverse);
        let variance = covariance[0].re;
        let points = (padded * padded) as f64;
        let change = covariance.iter().map(|value| ((value.re - variance).exp() - 1.0) / points).collect();
        Ok(Some(Self { pixels, padded, change, forward, inverse }))
    }

    /// What the blur changes in the image `psf`, `[y, x]`.
    pub(super) fn change(&self, psf: &[f64]) -> Vec<f64> {
        let (m, padded) = (self.pixels, self.padded);
        let mut grid = vec![Complex64::ZERO; padded * padded];
        for (row, line) in grid.chunks_exact_mut(padded).zip(psf.chunks_exact(m)) {
            row.iter_mut().zip(line).for_each(|(out, &value)| *out = value.into());
        }
        transform_square(&mut grid, padded, &*self.forward);
        grid.iter_mut().zip(&self.change).for_each(|(value, change)| *value *= change);
        transform_square(&mut grid, padded, &*self.inverse);
        grid.chunks_exact(padded).take(m).flat_map(|row| row[..m].iter().map(|value| value.re)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    fn scene(exposure_s: &str) -> Scene {
        Scene::preset("keck-onsky").unwrap().with(&[("image.exposure_s", exposure_s)]).unwrap()
    }

    #[test]
    fn blur_moves_light_from_the_core_to_a_symmetric_halo() {
        let m = 96;
        let blur = ExposureBlur::new(&scene("0.010"), m, 22.5).unwrap().unwrap();
        let mut point = vec![0.0; m * m];
        point[m / 2 * m + m / 2] = 1.0;
        let change = blur.change(&point);
        let core = -change[m / 2 * m + m / 2];
        // 0.6 %, that is changes of 26 nm RMS at 2.17 µm: the layers move by 7 to 27 cm, a fraction
        // of the 56 cm between actuators, beyond which the loop leaves some 60 nm. A factor of two
        // in the variance would be seen in the NCPA.
        assert!((0.004..0.009).contains(&core), "{core}");
        let others: f64 = change.iter().sum::<f64>() + core;
        // The halo is as wide as λ over the size of what moves, 27 mm in 10 ms for the fastest
        // layer: some of it falls beyond 48 pixels of 20 mas.
        assert!(others > 0.5 * core && others < core, "{others} {core}");
        // A symmetric kernel: the image on the other side of the point is the same, to rounding of
        // 1e-16 of the core.
        let at = |x: usize, y: usize| change[y * m + x];
        assert!((at(m / 2 + 5, m / 2 + 3) - at(m / 2 - 5, m / 2 - 3)).abs() < 1e-12);
        // Longer exposures blur more, and the shortest not at all.
        let long = ExposureBlur::new(&scene("0.030"), m, 22.5).unwrap().unwrap().change(&point);
        assert!(-long[m / 2 * m + m / 2] > 1.5 * core);
        let short = ExposureBlur::new(&scene("1e-9"), m, 22.5).unwrap().unwrap().change(&point);
        assert!(short.iter().all(|value| value.abs() < 1e-9));
    }

    #[test]
    fn a_scene_without_winds_has_no_blur() {
        let still = [
            ("turbulence.fractions", "[]"),
            ("turbulence.heights_m", "[]"),
            ("turbulence.wind_m_s", "[]"),
            ("turbulence.wind_dir_rad", "[]"),
        ];
        let scene = scene("0.010").with(&still).unwrap();
        assert!(ExposureBlur::new(&scene, 32, 22.5).unwrap().is_none());
    }
}
