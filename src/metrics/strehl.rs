//! Strehl ratio, in three ways: from an image by its energy, from an image by its OTF, from telemetry by Maréchal.
//!
//! The two ways from an image hold it against the *perfect* PSF: of the same telescope, at the same wavelength and
//! sampling, in a box of the same size, without aberration. Both images are read between their pixels at their peak
//! (see [`centre`](super::centre)), so neither need be centred to better than a pixel or so. The energy is that within
//! the box: light that an aberration throws out of it is not missed, and makes the ratio too high by its share.

use super::centre::Interpolant;
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::f64::consts::PI;

/// Strehl ratio by energy normalisation: the peak of `image` over that of `perfect`, each divided by its sum over the
/// box.
///
/// Both are `[y, x]`, in any unit, of the same shape. `background` is taken off every pixel of `image`; an error of `b`
/// in it, over an image of `P` pixels and a sum of `F`, changes the ratio by the part `b·P/F`. `perfect` has no
/// background. White noise of `s` per pixel raises or lowers the ratio by the part `s/peak`, and in a large box of a
/// faint star by `s·√P/F`.
///
/// # Errors
/// [`Error::Shape`] for images of two shapes, [`Error::Value`] for a background that is not finite, [`Error::Image`] for
/// an image without light, or that [`centre`](super::centre) refuses.
pub fn strehl_by_energy(image: ArrayView2<f64>, background: f64, perfect: ArrayView2<f64>) -> Result<f64> {
    let [seen, ideal] = interpolants(image, background, perfect)?;
    Ok(concentration("image", &seen)? / concentration("perfect image", &ideal)?)
}

/// Strehl ratio by the OTF: Σ OTF of `image` over Σ OTF of `perfect`, over the frequencies that the telescope passes,
/// each OTF being 1 at frequency 0 and centred so that its sum is real and largest.
///
/// The sum of an OTF *is* the peak of its PSF: this is [`strehl_by_energy`] of images without what no telescope lets
/// through. Without noise the two agree to what the edges of the box cut off; of white noise only π/s² of the variance
/// reaches the peak, s being `samples_per_lambda_over_d`.
///
/// `samples_per_lambda_over_d` counts pixels per λ/D, D being the diameter of a circle that holds the pupil; the OTF ends
/// at D/λ. Arguments and noise are otherwise those of [`strehl_by_energy`].
///
/// # Errors
/// Those of [`strehl_by_energy`]; [`Error::Value`] for fewer than 2 pixels per λ/D: below that the OTF folds over.
pub fn strehl_by_otf(
    image: ArrayView2<f64>,
    background: f64,
    perfect: ArrayView2<f64>,
    samples_per_lambda_over_d: f64,
) -> Result<f64> {
    // λ/D and the pixel come from measured lengths: 2 may arrive as 1.999999999.
    if !(samples_per_lambda_over_d.is_finite() && samples_per_lambda_over_d >= 2.0 * (1.0 - 1e-9)) {
        return Err(Error::Value(format!(
            "an OTF at {samples_per_lambda_over_d} pixels per lambda/D folds over: at least 2 are needed"
        )));
    }
    let [seen, ideal] =
        interpolants(image, background, perfect)?.map(|image| image.low_passed(1.0 / samples_per_lambda_over_d));
    Ok(concentration("image", &seen)? / concentration("perfect image", &ideal)?)
}

/// Strehl ratio exp(−(2πσ/λ)²) of a wavefront of `rms_nm` (Maréchal as extended by Mahajan 1983, J. Opt. Soc. Am. 73,
/// 860). To the next order its logarithm lacks the fourth cumulant of the phase over 12: less than σ⁴/4 (σ in rad) for a
/// phase with no heavier tails than a two-sided exponential distribution.
pub fn strehl_by_marechal(rms_nm: f64, wavelength_nm: f64) -> f64 {
    (-(2.0 * PI * rms_nm / wavelength_nm).powi(2)).exp()
}

/// Maréchal's Strehl ratio over telemetry: the average, over frames, of [`strehl_by_marechal`].
///
/// That is the Strehl ratio of the long exposure: intensities add up, and so do their peaks. The RMS of a frame is then
/// that without piston but *with* tip and tilt, unless they are taken out of the images too.
#[derive(Debug, Clone)]
pub struct Marechal {
    wavelength_nm: f64,
    sum: f64,
    frames: u64,
}

impl Marechal {
    /// At `wavelength_nm`; no frames yet.
    ///
    /// # Errors
    /// [`Error::Value`] for a wavelength that is not positive and finite.
    pub fn new(wavelength_nm: f64) -> Result<Self> {
        if !(wavelength_nm.is_finite() && wavelength_nm > 0.0) {
            return Err(Error::Value(format!("a wavelength of {wavelength_nm} nm is impossible: it must be positive")));
        }
        Ok(Self { wavelength_nm, sum: 0.0, frames: 0 })
    }

    /// Adds a frame whose residual wavefront is `rms_nm` over the pupil.
    ///
    /// # Errors
    /// [`Error::Value`] for an RMS that is negative or not finite; the average stays as it was.
    pub fn add(&mut self, rms_nm: f64) -> Result<()> {
        if !(rms_nm.is_finite() && rms_nm >= 0.0) {
            return Err(Error::Value(format!(
                "a residual of {rms_nm} nm RMS is impossible: a finite number that is not negative is needed"
            )));
        }
        self.sum += strehl_by_marechal(rms_nm, self.wavelength_nm);
        self.frames += 1;
        Ok(())
    }

    /// Frames added so far.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// The average; `None` before the first frame.
    pub fn strehl(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.sum / self.frames as f64)
    }
}

/// Peak over sum.
fn concentration(name: &str, image: &Interpolant) -> Result<f64> {
    let sum = image.sum();
    if !(sum.is_finite() && sum > 0.0) {
        return Err(Error::Image(format!(
            "the {name} sums to {sum} without its background: a Strehl ratio needs light"
        )));
    }
    Ok(image.peak()?.height / sum)
}

fn interpolants(image: ArrayView2<f64>, background: f64, perfect: ArrayView2<f64>) -> Result<[Interpolant; 2]> {
    if image.dim() != perfect.dim() {
        let ((rows, columns), (wanted_rows, wanted_columns)) = (image.dim(), perfect.dim());
        return Err(Error::Shape(format!(
            "an image of {rows}x{columns} pixels cannot be held against a perfect one of {wanted_rows}x\
             {wanted_columns}: one box is needed"
        )));
    }
    if !background.is_finite() {
        return Err(Error::Value(format!("a background of {background} was given: a finite number is needed")));
    }
    Ok([Interpolant::of("image", (&image - background).view())?, Interpolant::of("perfect image", perfect)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn marechal_averages_the_strehl_and_not_the_variance() {
        let mut marechal = Marechal::new(1000.0).unwrap();
        assert_eq!((marechal.strehl(), marechal.frames()), (None, 0));
        // 1 rad and 0 rad.
        marechal.add(1000.0 / (2.0 * PI)).unwrap();
        marechal.add(0.0).unwrap();
        let expected = (1.0 + (-1.0f64).exp()) / 2.0;
        assert!((marechal.strehl().unwrap() - expected).abs() < 1e-15);
        for wrong in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(marechal.add(wrong).unwrap_err().to_string().contains("nm RMS"));
        }
        assert_eq!(marechal.frames(), 2);
        assert!([0.0, -1.0, f64::NAN, f64::INFINITY].into_iter().all(|wavelength| Marechal::new(wavelength).is_err()));
    }

    #[test]
    fn images_that_have_no_strehl_are_refused_in_a_sentence() {
        let star = array![[0.0, 1.0, 0.0, 0.0], [1.0, 4.0, 1.0, 0.0], [0.0, 1.0, 0.0, 0.0]];
        let mut holed = star.clone();
        holed[[1, 2]] = f64::INFINITY;
        for (image, background, named) in [
            (Array2::zeros((3, 3)), 0.0, "3x3"),
            (Array2::zeros((3, 4)), 0.0, "0 everywhere"),
            (holed, 0.0, "row 1, column 2"),
            (star.clone(), f64::NAN, "background of NaN"),
            (star.clone(), 1.0, "sums to -4"),
            (-star.clone(), 0.0, "sums to -8"),
        ] {
            for error in [
                strehl_by_energy(image.view(), background, star.view()).unwrap_err(),
                strehl_by_otf(image.view(), background, star.view(), 2.0).unwrap_err(),
            ] {
                assert!(error.to_string().contains(named), "{error}");
            }
        }
        for perfect in [-&star, &star * f64::NAN] {
            let error = strehl_by_energy(star.view(), 0.0, perfect.view()).unwrap_err();
            assert!(error.to_string().contains("the perfect image"), "{error}");
        }
        for sampling in [0.0, 1.5, -3.0, f64::NAN, f64::INFINITY] {
            assert!(strehl_by_otf(star.view(), 0.0, star.view(), sampling).is_err());
        }
    }
}
