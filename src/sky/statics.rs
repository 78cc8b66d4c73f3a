//! From a mean phase to pistons and NCPA: generalised least squares under the covariance of the turbulence's mean.

use super::evidence::{Evidence, Family, Group, strongest};
use super::{MeanCovariance, Sensed};
use crate::modes::{self, SmoothBasis};
use crate::scene::Scene;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, concatenate, s};

/// Radial orders of the Zernike family: to 13, 104 polynomials of up to 26 zeros around the pupil, finer than segments. What
/// Keck's mirror holds of three measured maps has more (16, 37 and 32 nm are left); but with 16 orders ten images of one draw leave
/// 18 nm of NCPA where they leave 6 with 13.
const HIGHEST_ORDER: usize = 13;

/// Slopes for each mode that they are to tell from the others: a few, for the pupil does not fill the lenslets' square.
const SLOPES_A_MODE: f64 = 4.0;

/// The highest order whose modes the sensor of `scene` tells apart, at most [`HIGHEST_ORDER`].
fn highest_order(scene: &Scene) -> usize {
    let modes = scene.wavefront_sensor.as_ref().map_or(f64::INFINITY, |sensor| {
        // Two slopes for each lenslet of a disc.
        std::f64::consts::FRAC_PI_2 * (sensor.lenslets_across as f64).powi(2) / SLOPES_A_MODE
    });
    (2..=HIGHEST_ORDER).rev().find(|&order| ((order + 1) * (order + 2) / 2 - 1) as f64 <= modes).unwrap_or(1)
}

/// What nobody knows anything about (the mean phase, tip and tilt), nm: more than a model's whole range.
const UNKNOWN_NM: f64 = 1e4;

/// Where the search for the strength of a group begins, nm.
const START_NM: f64 = 30.0;

/// Static errors of a telescope.
#[derive(Debug, Clone)]
pub struct StaticErrors {
    /// Piston of each segment, nm.
    pub pistons_nm: Vec<f64>,
    /// Coefficients of the NCPA's modes, nm.
    pub ncpa_nm: Vec<f64>,
    /// Posterior covariance of both in turn, nm²: how far they may be off.
    pub covariance_nm2: Array2<f64>,
    /// Logarithm of the evidence, to compare families of modes on the same phases.
    pub log_evidence: f64,
    /// The strength of each group of modes that the phases support, nm RMS of a mode: pistons, tip and tilt, then the
    /// others in turn.
    pub strengths_nm: Vec<f64>,
}

/// NCPA modes and the groups that share a variance.
pub struct NcpaModes {
    /// The modes.
    pub basis: SmoothBasis,
    /// How many modes there are in each group, in turn; the first are tip and tilt.
    pub groups: Vec<usize>,
}

impl NcpaModes {
    /// Those of `family` on the pupil of `scene`.
    ///
    /// # Errors
    /// Those of making the bases.
    pub fn of(family: Family, scene: &Scene, telescope: &Telescope) -> Result<Self> {
        let orders = |last: usize| (1..=last).map(|order| order + 1).collect::<Vec<_>>();
        // Orders 1 to n hold Noll's 2 to (n + 1)(n + 2)/2.
        let zernikes = |last: usize| modes::zernike_basis(2, (last + 1) * (last + 2) / 2, &telescope.pupil);
        match family {
            Family::Zernike => {
                let order = highest_order(scene);
                Ok(Self { basis: zernikes(order)?, groups: orders(order) })
            }
            Family::KarhunenLoeve => {
                let (turbulence, count) = (Telescope::turbulence(scene)?, scene.modes.ncpa_count.max(1));
                let basis =
                    modes::karhunen_loeve(&telescope.influence(scene)?, &telescope.pupil, &turbulence, count)?.basis;
                // As many to a group as orders of a Zernike basis have.
                let mut groups: Vec<usize> = Vec::new();
                let mut left = basis.len();
                for size in 2.. {
                    if left == 0 {
                        break;
                    }
                    groups.push(left.min(size));
                    left -= left.min(size);
                }
                Ok(Self { basis, groups })
            }
        }
    }
}

/// What static errors do to a mean phase, held against the covariance of the turbulence in it.
pub struct StaticModel {
    segments: usize,
    columns: Array2<f64>,
    /// C⁻¹ of the columns.
    solved: Array2<f64>,
    information: Array2<f64>,
    groups: Vec<Group>,
}

impl StaticModel {
    /// The model of pistons that show as `pistons` and NCPA that show as `ncpa`, both `[mode, sample]`, on samples whose
    /// mean phase has `covariance`; `groups` as in `NcpaModes`.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps or groups that do not fit each other; those of [`MeanCovariance::solve`].
    pub fn new(
        pistons: ArrayView2<f64>,
        ncpa: ArrayView2<f64>,
        groups: &[usize],
        covariance: &MeanCovariance,
    ) -> Result<Self> {
        let (segments, samples) = pistons.dim();
        if ncpa.ncols() != samples || groups.iter().sum::<usize>() != ncpa.nrows() {
            let text = format!(
                "{} modes of {} samples in groups of {} do not go with pistons of {samples} samples",
                ncpa.nrows(),
                ncpa.ncols(),
                groups.iter().sum::<usize>()
            );
            return Err(Error::Shape(text));
        }
        // The mean phase of an image is nobody's.
        let offset = Array2::ones((1, samples));
        let columns = concatenate(Axis(0), &[pistons, ncpa, offset.view()])
            .map_err(|error| Error::Internal(format!("columns of uneven length: {error}")))?;
        let solved = covariance.solve(columns.view())?;
        let half = solved.dot(&columns.t());
        let information = (&half + &half.t()) / 2.0;
        let searched = |columns, variance_nm2: f64| Group { columns, variance_nm2, fixed: false };
        let known = |columns| Group { columns, variance_nm2: UNKNOWN_NM * UNKNOWN_NM, fixed: true };
        let mut all = vec![searched(0..segments, START_NM * START_NM)];
        let mut first = segments;
        for (place, &size) in groups.iter().enumerate() {
            let columns = first..first + size;
            all.push(if place == 0 { known(columns) } else { searched(columns, START_NM * START_NM) });
            first += size;
        }
        all.push(known(first..first + 1));
        Ok(Self { segments, columns, solved, information, groups: all })
    }

    /// The static errors behind a mean phase, nm at each sample.
    ///
    /// `sensed` is what slopes say of the NCPA beside the phases.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of samples or of NCPA modes.
    pub fn estimate(&self, mean_nm: ArrayView1<f64>, sensed: Option<&Sensed>) -> Result<StaticErrors> {
        if mean_nm.len() != self.columns.ncols() {
            let (given, needed) = (mean_nm.len(), self.columns.ncols());
            return Err(Error::Shape(format!("a mean phase of {given} samples was given: {needed} are needed")));
        }
        let (mut information, mut b) = (self.information.clone(), self.solved.dot(&mean_nm));
        if let Some(Sensed { coefficients_nm, information: more, .. }) = sensed {
            let ncpa = self.segments..self.columns.nrows() - 1;
            if coefficients_nm.len() != ncpa.len() {
                let (given, needed) = (coefficients_nm.len(), ncpa.len());
                return Err(Error::Shape(format!("slopes of {given} NCPA modes were given: {needed} are needed")));
            }
            let mut part = information.slice_mut(s![ncpa.clone(), ncpa.clone()]);
            part += more;
            let mut part = b.slice_mut(s![ncpa]);
            part += &more.dot(coefficients_nm);
        }
        let Evidence { coefficients_nm, covariance_nm2, log_evidence, strengths_nm } =
            strongest(&information, &b, &self.groups)?;
        let last = coefficients_nm.len() - 1;
        Ok(StaticErrors {
            pistons_nm: coefficients_nm.slice(s![..self.segments]).to_vec(),
            ncpa_nm: coefficients_nm.slice(s![self.segments..last]).to_vec(),
            covariance_nm2: covariance_nm2.slice(s![..last, ..last]).to_owned(),
            log_evidence,
            strengths_nm,
        })
    }

    /// Number of segments.
    pub fn segments(&self) -> usize {
        self.segments
    }

    /// What coefficients of pistons and NCPA show at each sample, nm.
    pub fn shown_nm(&self, errors: &StaticErrors) -> Array1<f64> {
        let coefficients: Array1<f64> = errors.pistons_nm.iter().chain(&errors.ncpa_nm).copied().collect();
        coefficients.dot(&self.columns.slice(s![..coefficients.len(), ..]))
    }
}
