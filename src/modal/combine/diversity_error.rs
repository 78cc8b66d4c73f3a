//! Error of the diversity's amplitude, which an image cannot distinguish from the wavefront.
//!
//! With d the diversity and m the modes, the image of m·c behind (1 + δ)·d is that of m·c + δ·d
//! behind d. Where the modes span d, δ·d is estimated as part of the wavefront and does not change
//! χ²: an error of 5 % of 1.5 waves is 163 nm of focus. Where the scene says how well the diversity
//! is known (`tolerance.defocus_fraction`), the error bars include it. A fit of δ with a normal
//! prior of that width would give the same error bars.

use crate::modal::model::Model;

use crate::modes::Basis;
use crate::optimize::Metric;
use crate::pupil::Pupil;
use crate::scene::{ImageScene, System};
use crate::telescope::{Diversity, Telescope};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis, s};

/// Largest share of the diversity (RMS) outside the modes for which they count as spanning it.
const MAX_RESIDUAL_SHARE: f64 = 0.1;
/// Diversity below which signs are not known, waves RMS: 0.05 is enough to determine them at a peak
/// S/N of 500.
const MIN_WAVES: f64 = 0.02;

/// Whether an image determines the signs of even aberrations: it is defocused, or its diversity is
/// a map.
pub(crate) fn has_diversity(image: &ImageScene) -> bool {
    image.diversity_file.is_some() || image.diversity_focus_waves_rms.abs() >= MIN_WAVES
}

/// Defocus below which images are fitted together, waves RMS: one by one they may end in wrong
/// minima.
const WEAK_WAVES: f64 = 0.5;

/// Whether the diversity of `scene` is too small to fit its images alone.
///
/// # Errors
/// Those of building the telescope; [`Error::File`] for a map that cannot be read.
pub(crate) fn is_weak(scene: &System) -> Result<bool> {
    if scene.image.diversity_file.is_none() {
        return Ok(scene.image.diversity_focus_waves_rms.abs() < WEAK_WAVES);
    }
    let telescope = Telescope::new(scene)?;
    let (pupil, diversity) = (&telescope.pupil, Diversity::new(scene, &telescope)?);
    let at = |(y, x): (usize, usize)| diversity.at(pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
    let map = Array2::from_shape_fn(pupil.amplitude.dim(), at);
    Ok(pupil.rms(map.view())? < WEAK_WAVES * scene.image.wavelength_nm)
}

/// Eigenvalues of the modes' Gram matrix below this fraction of the largest are rounding.
const NULL_FLOOR: f64 = 1e-10;

/// Name of the error of the diversity among the [`SharedError`]s.
pub(in crate::modal) const NAME: &str = "diversity";

/// An error that all images share.
#[derive(Debug, Clone)]
pub struct SharedError {
    /// Its cause, in a word or two.
    pub name: &'static str,
    /// Its covariance, `[mode, mode]`, nm².
    pub covariance_nm2: Array2<f64>,
}

/// Projection of the diversity on the modes of the NCPA.
#[derive(Debug, Clone)]
pub struct DiversityProjection {
    /// Its coefficients, nm, one for each mode of the basis; 0 for segments.
    pub coefficients_nm: Array1<f64>,
    /// RMS over the pupil of the part outside the modes, over the RMS of the diversity.
    pub residual_share: f64,
    /// RMS of the diversity over the pupil, nm.
    pub rms_nm: f64,
}

/// Projector of maps on modes: least squares over a pupil, weight A (the amplitude), piston
/// removed.
pub struct ModeProjector {
    weight: Array2<f64>,
    metric: Metric,
    segment_modes: usize,
}

/// Projection of a map on modes.
pub struct Projection {
    /// Coefficients, nm, one for each mode of the basis; 0 for segments.
    pub coefficients_nm: Array1<f64>,
    /// Mean square of the projected map over the pupil, nm².
    pub mean_square_nm2: f64,
}

impl ModeProjector {
    /// A projector on the modes of `basis` behind the first `segment_modes`, at least one.
    ///
    /// # Errors
    /// [`Error::Shape`] for a basis of another pupil.
    pub fn new(pupil: &Pupil, basis: &Basis, segment_modes: usize) -> Result<Self> {
        Self::of_gram(pupil, &basis.visible_gram(&pupil.amplitude)?, segment_modes)
    }

    /// As [`ModeProjector::new`], from the products `gram` of the modes of a basis over `pupil`,
    /// piston removed.
    ///
    /// # Errors
    /// [`Error::Value`] where no mode is left.
    pub(in crate::modal) fn of_gram(pupil: &Pupil, gram: &Array2<f64>, segment_modes: usize) -> Result<Self> {
        let own = gram.slice(s![segment_modes.., segment_modes..]).to_owned();
        let metric = Metric::from_gauss_newton(&own, NULL_FLOOR)?;
        Ok(Self { weight: &pupil.amplitude / pupil.weight_sum(), metric, segment_modes })
    }

    /// Projects `map_nm` on the modes of `basis`, for which this projector was made. Values outside
    /// the pupil are ignored, but may not be NaN.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another size.
    pub fn project(&self, basis: &Basis, map_nm: &Array2<f64>) -> Result<Projection> {
        let map_nm = map_nm - (map_nm * &self.weight).sum();
        let along = Array1::from(basis.along(&(&map_nm * &self.weight))?);
        let (mut unit, mut coefficients_nm) = (vec![0.0; self.metric.rank()], Array1::zeros(basis.len()));
        self.metric.gradient_to_z(along.slice(s![self.segment_modes..]).as_slice().unwrap_or_default(), &mut unit);
        let mut smooth = coefficients_nm.slice_mut(s![self.segment_modes..]);
        self.metric.to_x(&unit, smooth.as_slice_mut().unwrap_or_default());
        Ok(Projection { coefficients_nm, mean_square_nm2: unit.iter().map(|z| z * z).sum() })
    }
}

impl DiversityProjection {
    /// Projects the diversity of `scene` by least squares over the pupil of `telescope` (weight A,
    /// piston removed) on the modes of `basis` behind the first `segment_modes`.
    ///
    /// # Errors
    /// [`Error::File`] for a map of the diversity that cannot be read.
    pub fn new(scene: &System, telescope: &Telescope, basis: &Basis, segment_modes: usize) -> Result<Self> {
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
            return Ok(Self { coefficients_nm, residual_share: 1.0, rms_nm: square.sqrt() });
        }
        let Projection { coefficients_nm, mean_square_nm2 } =
            ModeProjector::new(pupil, basis, segment_modes)?.project(basis, &map)?;
        let residual_share = (1.0 - mean_square_nm2 / square).max(0.0).sqrt();
        Ok(Self { coefficients_nm, residual_share, rms_nm: square.sqrt() })
    }

    /// Covariance of the modes, nm², for an amplitude of the diversity that is known to `fraction`
    /// of itself.
    ///
    /// # Errors
    /// [`Error::Scene`], with `remedy`, where the modes do not span the diversity: its error is
    /// then not an error of the modes alone.
    pub fn covariance_nm2(&self, fraction: f64, remedy: &str) -> Result<Array2<f64>> {
        if !self.is_spanned() {
            return Err(Error::Scene(format!(
                "tolerance.defocus_fraction = {fraction} needs modes that span the diversity, so that its error is an error of the modes; \
                 {remedy}"
            )));
        }
        let column = (&self.coefficients_nm * fraction).insert_axis(Axis(1));
        Ok(column.dot(&column.t()))
    }

    /// Whether it is too small to determine the signs of even aberrations: an image in focus is
    /// also that of the wavefront rotated by half a turn and negated.
    pub fn is_too_small(&self, wavelength_nm: f64) -> bool {
        self.rms_nm < MIN_WAVES * wavelength_nm
    }

    /// Warning that it is too small, where it is.
    pub fn warning(&self, wavelength_nm: f64) -> Option<String> {
        self.is_too_small(wavelength_nm).then(|| {
            format!(
                "the scene's diversity is {:.1} nm RMS: an image in focus does not distinguish an even aberration from its \
                 negative, and the signs of these maps are not known",
                self.rms_nm
            )
        })
    }

    /// Whether the modes span the diversity: an error of it is then estimated as NCPA, and does not
    /// change χ².
    pub fn is_spanned(&self) -> bool {
        self.residual_share < MAX_RESIDUAL_SHARE
    }
}

/// Refuses a wanted error that no number of images reaches, because all images share an error of
/// variance `shared_nm2`.
///
/// # Errors
/// [`Error::Value`].
pub fn check_reachable(wanted_nm: f64, shared_nm2: f64) -> Result<()> {
    if shared_nm2 > 0.0 && wanted_nm.powi(2) <= shared_nm2 {
        return Err(Error::Value(format!(
            "an error of {wanted_nm} nm is out of reach of any number of images: the errors that all images share, such as an \
             error of the diversity, make {:.3} nm alone",
            shared_nm2.sqrt()
        )));
    }
    Ok(())
}

/// Projects the diversity of `scene` on the modes of `model`.
///
/// # Errors
/// [`Error::File`] for a map of it that cannot be read.
pub(in crate::modal) fn project_diversity(model: &Model, scene: &System) -> Result<DiversityProjection> {
    DiversityProjection::new(scene, &model.telescope, &model.basis, model.segment_modes)
}

/// The error that all images share where the diversity is known to a fraction of its amplitude
/// (`tolerance.defocus_fraction`).
///
/// # Errors
/// [`Error::Scene`] where the modes do not span the diversity.
pub(in crate::modal) fn shared_error(model: &Model, scene: &System) -> Result<Option<SharedError>> {
    let fraction = scene.tolerance.defocus_fraction;
    if fraction == 0.0 {
        return Ok(None);
    }
    let remedy = "modes.exact_zernikes = [2, 4] spans a focus";
    let covariance_nm2 = project_diversity(model, scene)?.covariance_nm2(fraction, remedy)?;
    Ok(Some(SharedError { name: NAME, covariance_nm2 }))
}
