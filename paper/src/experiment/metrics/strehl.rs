//! Strehl ratio by three methods: from an image by its energy, from an image by its OTF, from
//! telemetry by Maréchal.
//!
//! The two methods for images compare an image with the *perfect* PSF: of the same telescope, at
//! the same wavelength and sampling, in a box of the same size, without aberration. Both peaks are
//! interpolated between the pixels (see [`centre`](super::centre)), so neither image needs centring
//! to better than a pixel. The energy is that within the box: light scattered out of it is not
//! counted, and makes the ratio too high by its fraction.

use super::centre::Interpolant;
use cophase::{Error, Result};
use ndarray::ArrayView2;
use std::f64::consts::PI;

/// Strehl ratio by energy normalisation: the peak of `image` over that of `perfect`, each divided
/// by its sum over the box.
///
/// Both are `[y, x]`, in any unit, of the same shape. `background` is subtracted from every pixel
/// of `image`. An error `b` of it, in an image of `P` pixels and sum `F`, causes a relative error
/// `b·P/F` of the ratio. `perfect` has no background. White noise of `s` per pixel causes a
/// relative error `s/peak`, and for a faint star in a large box `s·√P/F`.
///
/// # Errors
/// [`Error::Shape`] for images of different shapes, [`Error::Value`] for a background that is not
/// finite, [`Error::Image`] for an image without light, or one that [`centre`](super::centre)
/// refuses.
pub fn strehl_by_energy(image: ArrayView2<f64>, background: f64, perfect: ArrayView2<f64>) -> Result<f64> {
    let [measured, ideal] = interpolants(image, background, perfect)?;
    Ok(peak_over_sum("image", &measured)? / peak_over_sum("perfect image", &ideal)?)
}

/// Strehl ratio by the OTF: Σ OTF of `image` over Σ OTF of `perfect`, over the frequencies that the
/// telescope passes. Each OTF is 1 at frequency 0, and centred so that its sum is real and largest.
///
/// The sum of an OTF is the peak of its PSF, so this is [`strehl_by_energy`] of images low-passed
/// at the telescope's cut-off. Without noise the two methods differ only by the effect of the box's
/// edges. Only π/s² of the variance of white noise contributes to the peak, with s =
/// `samples_per_lambda_over_d`.
///
/// `samples_per_lambda_over_d` counts pixels per λ/D, where D is the diameter of a circle that
/// contains the pupil; the OTF ends at D/λ. The other arguments are those of [`strehl_by_energy`].
///
/// # Errors
/// Those of [`strehl_by_energy`]; [`Error::Value`] for fewer than 2 pixels per λ/D, which alias the
/// OTF.
pub fn strehl_by_otf(
    image: ArrayView2<f64>,
    background: f64,
    perfect: ArrayView2<f64>,
    samples_per_lambda_over_d: f64,
) -> Result<f64> {
    // The sampling is computed from measured lengths: 2 may be given as 1.999999999.
    if !(samples_per_lambda_over_d.is_finite() && samples_per_lambda_over_d >= 2.0 * (1.0 - 1e-9)) {
        return Err(Error::Value(format!(
            "an OTF at {samples_per_lambda_over_d} pixels per lambda/D is aliased; at least 2 are needed"
        )));
    }
    let [measured, ideal] =
        interpolants(image, background, perfect)?.map(|image| image.low_passed(1.0 / samples_per_lambda_over_d));
    Ok(peak_over_sum("image", &measured)? / peak_over_sum("perfect image", &ideal)?)
}

/// Strehl ratio exp(−(2πσ/λ)²) of a wavefront of `rms_nm` (Maréchal as extended by Mahajan 1983, J.
/// Opt. Soc. Am. 73, 860). The next term of its logarithm is the fourth cumulant of the phase over
/// 12: less than σ⁴/4 (σ in rad) for a phase whose tails are not heavier than those of a two-sided
/// exponential distribution.
pub fn strehl_by_marechal(rms_nm: f64, wavelength_nm: f64) -> f64 {
    (-(2.0 * PI * rms_nm / wavelength_nm).powi(2)).exp()
}

/// Maréchal's Strehl ratio over telemetry: the average over frames of [`strehl_by_marechal`].
///
/// This is the Strehl ratio of the long exposure, because intensities add. The RMS of a frame must
/// exclude piston and include tip and tilt, unless these are also removed from the images.
#[derive(Debug, Clone)]
pub struct Marechal {
    wavelength_nm: f64,
    sum: f64,
    frames: u64,
}

impl Marechal {
    /// Average at `wavelength_nm`, without frames.
    ///
    /// # Errors
    /// [`Error::Value`] for a wavelength that is not positive and finite.
    pub fn new(wavelength_nm: f64) -> Result<Self> {
        if !(wavelength_nm.is_finite() && wavelength_nm > 0.0) {
            return Err(Error::Value(format!(
                "a wavelength of {wavelength_nm} nm is impossible; a positive number is needed"
            )));
        }
        Ok(Self { wavelength_nm, sum: 0.0, frames: 0 })
    }

    /// Adds a frame whose residual wavefront has the RMS `rms_nm` over the pupil.
    ///
    /// # Errors
    /// [`Error::Value`] for an RMS that is negative or not finite; the average is then unchanged.
    pub fn add(&mut self, rms_nm: f64) -> Result<()> {
        if !(rms_nm.is_finite() && rms_nm >= 0.0) {
            return Err(Error::Value(format!(
                "a residual of {rms_nm} nm RMS is impossible; a finite number that is not negative is needed"
            )));
        }
        self.sum += strehl_by_marechal(rms_nm, self.wavelength_nm);
        self.frames += 1;
        Ok(())
    }

    /// Number of frames added.
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Average Strehl ratio; `None` before the first frame.
    pub fn strehl(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.sum / self.frames as f64)
    }
}

/// Peak of an image over its sum.
fn peak_over_sum(name: &str, image: &Interpolant) -> Result<f64> {
    let sum = image.sum();
    if !(sum.is_finite() && sum > 0.0) {
        return Err(Error::Image(format!(
            "the {name} sums to {sum} after subtraction of its background; a positive sum is needed"
        )));
    }
    Ok(image.peak()?.height / sum)
}

fn interpolants(image: ArrayView2<f64>, background: f64, perfect: ArrayView2<f64>) -> Result<[Interpolant; 2]> {
    if image.dim() != perfect.dim() {
        let ((rows, columns), (wanted_rows, wanted_columns)) = (image.dim(), perfect.dim());
        return Err(Error::Shape(format!(
            "an image of {rows}x{columns} pixels cannot be compared with a perfect one of {wanted_rows}x\
             {wanted_columns}; equal shapes are needed"
        )));
    }
    if !background.is_finite() {
        return Err(Error::Value(format!("a background of {background} is impossible; a finite number is needed")));
    }
    Ok([Interpolant::new("image", (&image - background).view())?, Interpolant::new("perfect image", perfect)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn marechal_averages_strehl_ratios_and_not_variances() {
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
    fn images_without_a_strehl_ratio_are_refused_with_the_reason() {
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
