//! What the images cannot tell from the wavefront: an error of the diversity's amplitude.
//!
//! With d the diversity and m the modes, the image of `m·c` behind `(1 + δ)·d` is that of `m·c + δ·d` behind d. Where the
//! modes hold d, δ goes into them to the last bit and leaves no trace in χ²: an error of 5 % of 1.5 waves is 163 nm of
//! focus. A scene that says how well the diversity is known gets error bars that hold it; to fit δ with a normal prior
//! would give the same.

use super::Estimator;
use super::model::Model;
use crate::modes::Basis;
use crate::optimize::Metric;
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

impl HeldDiversity {
    /// By least squares over the pupil of `telescope` (weight A, piston removed), on the modes of `basis` behind the first
    /// `segment_modes`.
    ///
    /// # Errors
    /// [`Error::File`] for a map of the diversity that cannot be read.
    pub fn of(scene: &Scene, telescope: &Telescope, basis: &Basis, segment_modes: usize) -> Result<Self> {
        let (pupil, n) = (&telescope.pupil, segment_modes);
        let diversity = Diversity::of(scene, telescope)?;
        let coordinate = |at: usize| pupil.grid.coordinate_m(at);
        let weight = &pupil.amplitude / pupil.weight_sum();
        let map = Array2::from_shape_fn(weight.dim(), |(y, x)| diversity.at(coordinate(x), coordinate(y)));
        let map = &map - (&map * &weight).sum();
        let square = (&map * &map * &weight).sum();
        let nothing = Self { coefficients_nm: Array1::zeros(basis.len()), outside: 1.0, rms_nm: square.sqrt() };
        if n == basis.len() || square == 0.0 {
            return Ok(nothing);
        }
        let along = Array1::from(basis.along(&(&map * &weight))?);
        let gram = basis.visible_gram(&pupil.amplitude)?;
        let metric = Metric::from_gauss_newton(&gram.slice_move(s![n.., n..]), NULL_FLOOR)?;
        let (mut unit, mut coefficients_nm) = (vec![0.0; metric.rank()], nothing.coefficients_nm);
        metric.gradient_to_z(along.slice(s![n..]).as_slice().unwrap_or_default(), &mut unit);
        metric.to_x(&unit, coefficients_nm.slice_mut(s![n..]).as_slice_mut().unwrap_or_default());
        let held: f64 = unit.iter().map(|z| z * z).sum();
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

impl Estimator {
    /// The diversity as this estimator's modes see it.
    ///
    /// # Errors
    /// [`Error::File`] for a map of it that cannot be read.
    pub fn held_diversity(&self) -> Result<HeldDiversity> {
        held(&self.model, &self.scene)
    }
}

fn held(model: &Model, scene: &Scene) -> Result<HeldDiversity> {
    HeldDiversity::of(scene, &model.telescope, &model.basis, model.segment_modes)
}

/// The covariance that all images share, nm²: of a diversity that is known to a fraction of its amplitude; none where it is
/// known.
///
/// # Errors
/// [`Error::Scene`] where the modes do not hold the diversity.
pub(super) fn common(model: &Model, scene: &Scene) -> Result<Option<Array2<f64>>> {
    let fraction = scene.estimate.diversity_error;
    let of_held = || held(model, scene)?.covariance_nm2(fraction, "modes.exact_zernikes = [2, 4] holds a focus");
    (fraction > 0.0).then(of_held).transpose()
}
