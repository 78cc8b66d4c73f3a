//! What the images cannot tell from the wavefront: an error of the diversity's amplitude.
//!
//! With d the diversity and m the modes, the image of `m·c` behind `(1 + δ)·d` is that of `m·c + δ·d` behind d. Where the
//! modes hold d, δ goes into them to the last bit and leaves no trace in χ²: an error of 5 % of 1.5 waves is 163 nm of
//! focus. A scene that says how well the diversity is known gets error bars that hold it; to fit δ with a normal prior
//! would give the same.

use super::model::Model;

use crate::modes::Basis;
use crate::optimize::Metric;
use crate::pupil::Pupil;
use crate::scene::Scene;
use crate::telescope::{Diversity, Telescope};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis, s};

/// Share of the diversity outside the modes up to which they are said to hold it.
const HELD: f64 = 0.1;
/// Diversity below which signs are not known, waves RMS: 0.05 tells them at a peak S/N of 500.
const LEAST_WAVES: f64 = 0.02;
/// Directions of the modes over the pupil below this fraction of the strongest are rounding.
const NULL_FLOOR: f64 = 1e-10;

/// An error that all images share.
#[derive(Debug, Clone)]
pub struct SharedError {
    /// Its cause, in a word or two.
    pub name: &'static str,
    /// Its covariance, `[mode, mode]`, nm².
    pub covariance_nm2: Array2<f64>,
}

/// The diversity as the modes of the NCPA see it.
#[derive(Debug, Clone)]
pub struct HeldDiversity {
    /// Its coefficients, nm, one for each mode of the basis; 0 for segments.
    pub coefficients_nm: Array1<f64>,
    /// RMS over the pupil of what the modes do not hold of it, over its own.
    pub outside: f64,
    /// RMS over the pupil, nm.
    pub rms_nm: f64,
}

/// What modes hold of a map: least squares over a pupil, weight A, piston removed.
pub struct Holder {
    weight: Array2<f64>,
    metric: Metric,
    segment_modes: usize,
}

/// What modes hold of a map.
pub struct Held {
    /// Their coefficients, one for each mode of the basis; 0 for segments.
    pub coefficients_nm: Array1<f64>,
    /// Mean square over the pupil, nm².
    pub square: f64,
}

impl Holder {
    /// For the modes of `basis` behind the first `segment_modes`, at least one.
    ///
    /// # Errors
    /// [`Error::Shape`] for a basis of another pupil.
    pub fn of(pupil: &Pupil, basis: &Basis, segment_modes: usize) -> Result<Self> {
        let gram = basis.visible_gram(&pupil.amplitude)?;
        let metric = Metric::from_gauss_newton(&gram.slice_move(s![segment_modes.., segment_modes..]), NULL_FLOOR)?;
        Ok(Self { weight: &pupil.amplitude / pupil.weight_sum(), metric, segment_modes })
    }

    /// What the modes of `basis`, for which this was made, hold of `map_nm`; where there is no glass it may be anything but
    /// NaN.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another size.
    pub fn held(&self, basis: &Basis, map_nm: &Array2<f64>) -> Result<Held> {
        let map_nm = map_nm - (map_nm * &self.weight).sum();
        let along = Array1::from(basis.along(&(&map_nm * &self.weight))?);
        let (mut unit, mut coefficients_nm) = (vec![0.0; self.metric.rank()], Array1::zeros(basis.len()));
        self.metric.gradient_to_z(along.slice(s![self.segment_modes..]).as_slice().unwrap_or_default(), &mut unit);
        let mut smooth = coefficients_nm.slice_mut(s![self.segment_modes..]);
        self.metric.to_x(&unit, smooth.as_slice_mut().unwrap_or_default());
        Ok(Held { coefficients_nm, square: unit.iter().map(|z| z * z).sum() })
    }
}

impl HeldDiversity {
    /// By least squares over the pupil of `telescope` (weight A, piston removed), on the modes of `basis` behind the first
    /// `segment_modes`.
    ///
    /// # Errors
    /// [`Error::File`] for a map of the diversity that cannot be read.
    pub fn of(scene: &Scene, telescope: &Telescope, basis: &Basis, segment_modes: usize) -> Result<Self> {
        let pupil = &telescope.pupil;
        let diversity = Diversity::new(scene, telescope)?;
        let coordinate = |at: usize| pupil.grid.coordinate_m(at);
        let dim = pupil.amplitude.dim();
        let map = Array2::from_shape_fn(dim, |(y, x)| diversity.at(coordinate(x), coordinate(y)));
        let weight = &pupil.amplitude / pupil.weight_sum();
        let map = &map - (&map * &weight).sum();
        let square = (&map * &map * &weight).sum();
        if segment_modes == basis.len() || square == 0.0 {
            let coefficients_nm = Array1::zeros(basis.len());
            return Ok(Self { coefficients_nm, outside: 1.0, rms_nm: square.sqrt() });
        }
        let Held { coefficients_nm, square: held } = Holder::of(pupil, basis, segment_modes)?.held(basis, &map)?;
        Ok(Self { coefficients_nm, outside: (1.0 - held / square).max(0.0).sqrt(), rms_nm: square.sqrt() })
    }

    /// The covariance of the modes, nm², that an amplitude known to `fraction` of itself makes.
    ///
    /// # Errors
    /// [`Error::Scene`], with `remedy`, where the modes do not hold the diversity: its error is then no error of theirs
    /// alone.
    pub fn covariance_nm2(&self, fraction: f64, remedy: &str) -> Result<Array2<f64>> {
        if !self.is_held() {
            return Err(Error::Scene(format!(
                "estimate.diversity_error = {fraction} needs modes that hold the diversity, so that they can hold its error; \
                 {remedy}"
            )));
        }
        let column = (&self.coefficients_nm * fraction).insert_axis(Axis(1));
        Ok(column.dot(&column.t()))
    }

    /// Whether it is so small that the signs of even aberrations are anybody's guess: an image in focus is that of the
    /// wavefront turned by half a turn and negated.
    pub fn is_too_small(&self, wavelength_nm: f64) -> bool {
        self.rms_nm < LEAST_WAVES * wavelength_nm
    }

    /// That it is, where it is, as a sentence.
    pub fn warning(&self, wavelength_nm: f64) -> Option<String> {
        self.is_too_small(wavelength_nm).then(|| {
            format!(
                "the scene's diversity is {:.1} nm RMS: an image in focus does not tell an even aberration from its negative, \
                 and the signs of these maps are not known",
                self.rms_nm
            )
        })
    }

    /// Whether an error of the diversity would be read as NCPA, and leave no trace.
    pub fn is_held(&self) -> bool {
        self.outside < HELD
    }
}

/// Refuses a wanted error that no number of images reaches, for all of them share `shared_nm2`.
///
/// # Errors
/// [`Error::Value`].
pub fn within_reach(wanted_nm: f64, shared_nm2: f64) -> Result<()> {
    if shared_nm2 > 0.0 && wanted_nm.powi(2) <= shared_nm2 {
        return Err(Error::Value(format!(
            "an error of {wanted_nm} nm is out of reach of any number of images: what all of them share, as an error of the \
             diversity, alone makes {:.3} nm",
            shared_nm2.sqrt()
        )));
    }
    Ok(())
}

/// The diversity as the modes of `model` see it.
///
/// # Errors
/// [`Error::File`] for a map of it that cannot be read.
pub(super) fn held(model: &Model, scene: &Scene) -> Result<HeldDiversity> {
    HeldDiversity::of(scene, &model.telescope, &model.basis, model.segment_modes)
}

/// The error that all images share where the diversity is known to a fraction of its amplitude (`estimate.diversity_error`).
///
/// # Errors
/// [`Error::Scene`] where the modes do not hold the diversity.
pub(super) fn common(model: &Model, scene: &Scene) -> Result<Option<SharedError>> {
    let fraction = scene.estimate.diversity_error;
    if fraction == 0.0 {
        return Ok(None);
    }
    let remedy = "modes.exact_zernikes = [2, 4] holds a focus";
    let covariance_nm2 = held(model, scene)?.covariance_nm2(fraction, remedy)?;
    Ok(Some(SharedError { name: "diversity", covariance_nm2 }))
}
