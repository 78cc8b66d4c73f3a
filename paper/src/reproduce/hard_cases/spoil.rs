//! What goes wrong between the telescope and the file.

use cophase::Result;
use cophase::scene::Scene;
use cophase::source::{Camera, Truth, expose, flux_e, stream};
use cophase::telescope::Telescope;
use cophase_numerics::fft::plan_both;
use ndarray::{Array, Array2, Array3, ArrayViewMut2, Axis, RemoveAxis, Zip, s};
use num_complex::Complex64;
use rand::RngExt;

/// How the slopes that come with a sequence differ from those that were measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mismatch {
    /// Not at all.
    None,
    /// All have the opposite sign.
    OppositeSign,
    /// Those along y come before those along x.
    YBeforeX,
    /// All are 0.
    Zero,
    /// They are in arcseconds in place of mas.
    OtherUnit,
    /// The first image has the slopes of the last one.
    ReversedTime,
    /// Each image has the slopes of the one before it.
    ShiftedTime,
    /// The slopes are right, and the images are flipped left to right.
    FlippedImages,
}

/// What goes wrong with an image, or with the truth behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Spoil {
    /// Nothing.
    None,
    /// A segment stands off by so many wavelengths.
    Segment(f64),
    /// The image, and with it pupil and aberrations, is turned by so many degrees.
    Rotated(f64),
    /// The image is moved along x and y, pixels.
    Moved(f64, f64),
    /// A pixel reads ten times the peak.
    Hot,
    /// Three pixels near the peak read nothing.
    Dead,
    /// Three pixels near the peak read NaN.
    NotANumber,
    /// No pixel reads more than half the peak.
    Saturated,
    /// Twenty pixels are hit by something up to the peak.
    Cosmic,
    /// The rows from the middle on read nothing.
    Truncated,
    /// A companion has this share of the star's flux, so many pixels away along x and y.
    Companion {
        /// Its flux over the star's.
        share: f64,
        /// Where it is, along x and y.
        pixels: [f64; 2],
    },
    /// The image is flipped along this axis.
    Flipped(Axis),
    /// No star: its light is spread evenly.
    Flat,
    /// Counts beyond 65,535 begin again at 0; the peak stands at 1.5 times as much.
    Wrapped,
    /// The detector responds less the more light there is: by this share at the peak.
    NonLinear(f64),
    /// The pixels are counts of so many electrons each.
    Counts(f64),
    /// The pixels are divided by their sum.
    Normalised,
    /// A short sequence behind adaptive optics, with a scene of its own, comes with these slopes.
    Telemetry(Mismatch),
}

/// Images with what is behind them.
pub(in crate::reproduce) struct Made {
    /// Electrons, `[image, y, x]`.
    pub(in crate::reproduce) images_e: Array3<f64>,
    pub(in crate::reproduce) truth: Truth,
    /// Axis along which the images are flipped.
    pub(in crate::reproduce) flip: Option<Axis>,
}

/// Makes the images of `scene` and spoils them. One seed is one image, or one sequence.
pub(in crate::reproduce) fn made(scene: &Scene, spoil: Spoil) -> Result<Made> {
    let telescope = Telescope::new(scene)?;
    let seed = scene.seed();
    let mut truth = Truth::draw(scene, &telescope, &mut stream(seed, 0))?;
    if let Spoil::Segment(waves) = spoil {
        let mut piston_nm = truth.piston_nm.clone();
        let which = seed as usize % piston_nm.len();
        piston_nm[which] = waves * scene.image.wavelength_nm;
        truth = truth.with_pistons(&telescope, piston_nm)?;
    }
    let mut psf = Camera::new(scene, &telescope)?.psf(&truth)?;
    match spoil {
        Spoil::Rotated(degrees) => psf = rotated(psf, degrees.to_radians()),
        Spoil::Moved(x, y) => psf = sheared(sheared(psf, Axis(1), |_| x), Axis(0), |_| y),
        Spoil::Companion { share, pixels: [x, y] } => {
            let companion = sheared(sheared(psf.clone(), Axis(1), |_| x), Axis(0), |_| y);
            psf = (psf + companion * share) / (1.0 + share);
        }
        Spoil::Flipped(axis) => psf = flipped(&psf, axis),
        Spoil::Flat => {
            let mean = psf.mean().unwrap_or_default();
            psf.fill(mean);
        }
        _ => {}
    }
    let peak = psf.iter().copied().fold(0.0, f64::max);
    let flux_e = flux_e(&scene.image, peak);
    let (rows, columns) = psf.dim();
    let mut images_e = Array3::zeros((scene.image.count, rows, columns));
    for (number, mut image_e) in images_e.outer_iter_mut().enumerate() {
        let mut rng = stream(seed, 1 + number as u64);
        // Interpolation leaves rounding, and of a sharp edge a trace, below 0.
        image_e.zip_mut_with(&psf, |e, h| *e = expose(&scene.image, h.max(0.0), flux_e, &mut rng));
        detector(image_e, spoil, &mut rng);
    }
    let flip = if let Spoil::Flipped(axis) = spoil { Some(axis) } else { None };
    Ok(Made { images_e, truth, flip })
}

/// The frames flipped along `axis` about the optical axis, which is on pixel N/2: the first line
/// has no counterpart.
pub(in crate::reproduce) fn flipped<D: RemoveAxis>(frames: &Array<f64, D>, axis: Axis) -> Array<f64, D> {
    let n = frames.len_of(axis);
    let sources: Vec<usize> = (0..n).map(|at| (n - at) % n).collect();
    frames.select(axis, &sources)
}

/// What the detector, and the program that writes its file, do to a frame.
fn detector(mut image_e: ArrayViewMut2<f64>, spoil: Spoil, rng: &mut impl RngExt) {
    let (peak, (rows, columns)) = (image_e.iter().copied().fold(0.0, f64::max), image_e.dim());
    // Near the axis there is light.
    let mut near = || [rows, columns].map(|n| (n / 2).saturating_sub(12) + rng.random_range(0..24));
    match spoil {
        Spoil::Hot => image_e[near()] = 10.0 * peak,
        Spoil::Dead => (0..3).for_each(|_| image_e[near()] = 0.0),
        Spoil::NotANumber => (0..3).for_each(|_| image_e[near()] = f64::NAN),
        Spoil::Cosmic => {
            for _ in 0..20 {
                let at = [rng.random_range(0..rows), rng.random_range(0..columns)];
                image_e[at] += peak * rng.random::<f64>();
            }
        }
        Spoil::Saturated => image_e.mapv_inplace(|e| e.min(0.5 * peak)),
        Spoil::Truncated => image_e.slice_mut(s![rows / 2.., ..]).fill(0.0),
        Spoil::Wrapped => image_e.mapv_inplace(|e| (1.5 * 65_536.0 * e / peak).rem_euclid(65_536.0)),
        Spoil::NonLinear(share) => image_e.mapv_inplace(|e| e * (1.0 - share * e / peak)),
        Spoil::Counts(electrons) => image_e.mapv_inplace(|e| e / electrons),
        Spoil::Normalised => {
            let sum = image_e.sum();
            image_e.mapv_inplace(|e| e / sum);
        }
        _ => {}
    }
}

/// `map` turned counter-clockwise about its middle, by three shears (Unser, Thévenaz and
/// Yaroslavsky 1995): exact for what the pixels hold, but for the corners.
fn rotated(map: Array2<f64>, angle_rad: f64) -> Array2<f64> {
    let (along_x, along_y) = (-(angle_rad / 2.0).tan(), angle_rad.sin());
    let middle = map.nrows() as f64 / 2.0;
    let shear = |factor: f64| move |line: usize| factor * (line as f64 - middle);
    let once = sheared(map, Axis(1), shear(along_x));
    sheared(sheared(once, Axis(0), shear(along_y)), Axis(1), shear(along_x))
}

/// `map` with each line along `axis` moved by what `shift` says of it, pixels, by Fourier
/// interpolation.
fn sheared(mut map: Array2<f64>, axis: Axis, shift: impl Fn(usize) -> f64) -> Array2<f64> {
    let n = map.len_of(axis);
    let (forward, inverse) = plan_both(n);
    for (number, mut lane) in map.lanes_mut(axis).into_iter().enumerate() {
        let shift = shift(number);
        let mut line: Vec<Complex64> = lane.iter().copied().map(Complex64::from).collect();
        forward.process(&mut line);
        for (k, value) in line.iter_mut().enumerate() {
            let cycles = if 2 * k < n { k as f64 } else { k as f64 - n as f64 };
            let angle = -std::f64::consts::TAU * cycles * shift / n as f64;
            // Of the highest frequency only the cosine is real.
            *value *= if 2 * k == n { Complex64::from(angle.cos()) } else { Complex64::cis(angle) } / n as f64;
        }
        inverse.process(&mut line);
        Zip::from(&mut lane).and(&line).for_each(|out, value| *out = value.re);
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A spot of width 4 pixels about (x, y) from the middle, which a grid of 48 holds to 1e-8.
    fn spot(x: f64, y: f64) -> Array2<f64> {
        let square = |at: usize, middle: f64| (at as f64 - 24.0 - middle).powi(2);
        Array2::from_shape_fn((48, 48), |(row, column)| (-(square(column, x) + square(row, y)) / 8.0).exp())
    }

    #[test]
    fn images_move_and_turn_by_what_they_should() {
        let far = |a: Array2<f64>, b: Array2<f64>| (a - b).iter().fold(0.0, |m: f64, d| m.max(d.abs()));
        let moved = sheared(sheared(spot(-1.0, 2.0), Axis(1), |_| 2.5), Axis(0), |_| -0.25);
        assert!(far(moved, spot(1.5, 1.75)) < 1e-6);
        assert!(far(flipped(&spot(-1.0, 2.0), Axis(1)), spot(1.0, 2.0)) < 1e-12);
        assert!(far(flipped(&spot(-1.0, 2.0), Axis(0)), spot(-1.0, -2.0)) < 1e-12);
        // A quarter of a turn takes x to y; the shears of so large an angle stay within the grid
        // for a spot near its middle.
        let turned = rotated(spot(3.0, 0.0), 0.5);
        assert!(far(turned, spot(3.0 * 0.5f64.cos(), 3.0 * 0.5f64.sin())) < 1e-5);
    }

    #[test]
    fn every_fault_of_a_detector_changes_the_frame() {
        let clean = spot(0.0, 0.0) * 1e5;
        let faults = [
            Spoil::Hot,
            Spoil::Dead,
            Spoil::NotANumber,
            Spoil::Saturated,
            Spoil::Cosmic,
            Spoil::Truncated,
            Spoil::Wrapped,
            Spoil::NonLinear(0.02),
            Spoil::Counts(20.0),
            Spoil::Normalised,
        ];
        for fault in faults {
            let mut frame = clean.clone();
            detector(frame.view_mut(), fault, &mut stream(3, 1));
            assert_ne!(frame, clean, "{fault:?}");
            assert_eq!(frame.iter().any(|e| !e.is_finite()), fault == Spoil::NotANumber, "{fault:?}");
        }
    }
}
