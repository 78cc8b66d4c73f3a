//! From a mean phase to pistons and NCPA: generalised least squares under the covariance of the turbulence's mean.

use super::covariance::MeanCovariance;
use super::empirical_bayes::{Evidence, Family, Group, strongest};
use crate::loop_response::Sensed;
use crate::modes::{self, SmoothBasis};
use crate::scene::Scene;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, concatenate, s};

/// Slopes of the lenslets' disc for each mode that they are to tell from the others: the pupil leaves two thirds of them.
const SLOPES_A_MODE: f64 = 2.7;
/// Likewise of a mirror's modes, all of which the loop must tell apart: a quarter more slopes than modes are in the pupil.
const SLOPES_A_MIRROR_MODE: f64 = 1.9;

/// Most modes of a mirror: what they cost goes as their number, and images have few pixels for more.
const MOST_MIRROR_MODES: usize = 400;

/// How many modes the sensor of `scene` tells apart, of which each takes so many slopes of the lenslets' disc.
fn told_apart(scene: &Scene, slopes_a_mode: f64) -> f64 {
    scene.wavefront_sensor.as_ref().map_or(f64::INFINITY, |sensor| {
        // Two slopes for each lenslet of a disc.
        std::f64::consts::FRAC_PI_2 * (sensor.lenslets_across as f64).powi(2) / slopes_a_mode
    })
}

/// The highest order whose modes the sensor of `scene` tells apart, at most `wanted`.
fn highest_order(scene: &Scene, wanted: usize) -> usize {
    let modes = told_apart(scene, SLOPES_A_MODE);
    (2..=wanted).rev().find(|&order| ((order + 1) * (order + 2) / 2 - 1) as f64 <= modes).unwrap_or(1)
}

/// Least power of the order as which the variance of a mode falls: polished glass and turbulence have 3.7 and more.
const LEAST_STEEPNESS: f64 = 3.0;

/// What nobody knows anything about (the mean phase, tip and tilt), nm: more than a model's whole range.
const UNKNOWN_NM: f64 = 1e4;

/// Pistons as nobody has corrected them, nm: what is left of those that images do not tell, their mean and the plane through
/// them, by an estimate that corrected the others.
const UNTOUCHED_NM: f64 = 30.0;

/// Where the search for the strength of a group begins, nm.
const START_NM: f64 = 30.0;

/// Static errors of a telescope.
#[derive(Debug, Clone)]
pub struct StaticErrors {
    /// Piston of each segment, nm.
    pub pistons_nm: Vec<f64>,
    /// Coefficients of the NCPA's modes, nm.
    pub ncpa_nm: Vec<f64>,
    /// What the mean phase has of the same modes though the sensor saw it, nm: turbulence that did not average out, and
    /// actuators that the loop hardly feels and lets wander. 0 without telemetry, which alone tells it from NCPA.
    pub followed_nm: Vec<f64>,
    /// Posterior covariance of both in turn, nm²: how far they may be off.
    pub covariance_nm2: Array2<f64>,
    /// Logarithm of the evidence, to compare families of modes on the same phases.
    pub log_evidence: f64,
    /// What none of these explains of the mean phase, nm at each sample.
    pub unexplained_nm: Array1<f64>,
    /// The strength of each group of modes that the phases support, nm RMS of a mode: pistons, tip and tilt, then the
    /// others in turn.
    pub strengths_nm: Vec<f64>,
}

impl StaticErrors {
    /// The strength of the higher one of the last two of `groups` groups of NCPA modes, nm RMS of a mode.
    pub(super) fn highest_nm(&self, groups: usize) -> f64 {
        // The pistons come first.
        self.strengths_nm[groups.max(3) - 1..=groups].iter().copied().fold(0.0, f64::max)
    }

    /// RMS over the pupil of NCPA finer than the last of `groups` orders, nm, if the strength of a mode goes on falling as a
    /// power of the order, as it does over the finer half of those that were found: with the variance s² of a mode of the
    /// last order N, and s² ∝ n^−q, Σ (n + 1)·s²·(n/N)^−q over n > N is about s²·N²/(q − 2).
    pub(super) fn beyond_nm(&self, groups: usize) -> f64 {
        // The first is tip and tilt, which nobody knows.
        let finer = (groups / 2).max(2)..=groups;
        let points: Vec<(f64, f64)> =
            finer.map(|order| ((order as f64).ln(), 2.0 * self.strengths_nm[order].ln())).collect();
        let count = points.len() as f64;
        let (x, y) = points.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x / count, sy + y / count));
        let (across, along) =
            points.iter().fold((0.0, 0.0), |(c, a), (u, v)| (c + (u - x) * (v - y), a + (u - x).powi(2)));
        let steepness = if along > 0.0 { (-across / along).max(LEAST_STEEPNESS) } else { LEAST_STEEPNESS };
        let last = groups as f64;
        let variance_nm2 = (y - steepness * (last.ln() - x)).exp();
        (variance_nm2 * last * last / (steepness - 2.0)).sqrt()
    }

    /// These, where phases show only these shares of an error of the pistons and of the NCPA.
    pub(super) fn widened(mut self, [pistons, ncpa]: [f64; 2]) -> Self {
        let segments = self.pistons_nm.len();
        let share = |mode: usize| if mode < segments { pistons } else { ncpa };
        self.covariance_nm2.indexed_iter_mut().for_each(|((i, j), nm2)| *nm2 /= share(i) * share(j));
        self
    }
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
            Family::Zernike { highest_order: wanted } => {
                let order = highest_order(scene, wanted);
                Ok(Self { basis: zernikes(order)?, groups: orders(order) })
            }
            Family::Mirror => {
                let (influence, turbulence) = (telescope.influence(scene)?, Telescope::turbulence(scene)?);
                let most = (told_apart(scene, SLOPES_A_MIRROR_MODE) as usize).clamp(1, MOST_MIRROR_MODES);
                let basis = modes::karhunen_loeve_at_most(&influence, &telescope.pupil, &turbulence, most)?.basis;
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
    ncpa: usize,
    /// Pistons, NCPA and the mean phase, `[column, sample]`.
    columns: Array2<f64>,
    /// C⁻¹ of the columns.
    solved: Array2<f64>,
    information: Array2<f64>,
    /// The column that each unknown shows as: what the sensor saw has those of the NCPA again.
    shows_as: Vec<usize>,
    groups: Vec<Group>,
}

impl StaticModel {
    /// The model of pistons that show as `pistons` and NCPA that show as `ncpa`, both `[mode, sample]`, on samples whose
    /// mean phase has `covariance`; `groups` as in `NcpaModes`, and whether slopes will tell NCPA from what the sensor saw.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps or groups that do not fit each other; those of [`MeanCovariance::solve`].
    pub fn new(
        pistons: ArrayView2<f64>,
        ncpa: ArrayView2<f64>,
        (groups, telemetry): (&[usize], bool),
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
        let modes = ncpa.nrows();
        let (all, offset) = (0..segments + modes, segments + modes);
        let again = if telemetry { segments..segments + modes } else { 0..0 };
        let shows_as: Vec<usize> = all.chain(again).chain([offset]).collect();
        let information = information.select(Axis(0), &shows_as).select(Axis(1), &shows_as);
        let searched = |columns, start_nm: f64| Group { columns, variance_nm2: start_nm * start_nm, fixed: false };
        let known = |columns| Group { columns, variance_nm2: UNKNOWN_NM * UNKNOWN_NM, fixed: true };
        let mut all = vec![searched(0..segments, START_NM)];
        let mut first = segments;
        for start_nm in [START_NM, START_NM / 3.0].into_iter().take(if telemetry { 2 } else { 1 }) {
            for (place, &size) in groups.iter().enumerate() {
                let columns = first..first + size;
                all.push(if place == 0 { known(columns) } else { searched(columns, start_nm) });
                first += size;
            }
        }
        all.push(known(first..first + 1));
        Ok(Self { segments, ncpa: modes, columns, solved, information, shows_as, groups: all })
    }

    /// The static errors behind a mean phase, nm at each sample.
    ///
    /// `sensed` is what slopes say of the NCPA beside the phases. The search for strengths begins at those of `before`.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of samples or of NCPA modes.
    pub fn estimate(
        &self,
        mean_nm: ArrayView1<f64>,
        sensed: Option<&Sensed>,
        before: Option<&StaticErrors>,
    ) -> Result<StaticErrors> {
        if mean_nm.len() != self.columns.ncols() {
            let (given, needed) = (mean_nm.len(), self.columns.ncols());
            return Err(Error::Shape(format!("a mean phase of {given} samples was given: {needed} are needed")));
        }
        let mut information = self.information.clone();
        let mut b = self.solved.dot(&mean_nm).select(Axis(0), &self.shows_as);
        if let Some(Sensed { information: more, b: more_b, .. }) = sensed {
            let ncpa = self.segments..self.segments + self.ncpa;
            if more_b.len() != ncpa.len() {
                let (given, needed) = (more_b.len(), ncpa.len());
                return Err(Error::Shape(format!("slopes of {given} NCPA modes were given: {needed} are needed")));
            }
            let mut part = information.slice_mut(s![ncpa.clone(), ncpa.clone()]);
            part += more;
            let mut part = b.slice_mut(s![ncpa]);
            part += more_b;
        }
        let mut groups = self.groups.clone();
        for (group, nm) in groups.iter_mut().zip(before.iter().flat_map(|errors| &errors.strengths_nm)) {
            group.variance_nm2 = nm * nm;
        }
        let strongest = strongest(&information, &b, &groups)?;
        let pistons_nm = strongest.strengths_nm[0];
        let Evidence { coefficients_nm, covariance_nm2, log_evidence, strengths_nm } =
            strongest.corrected_before(self.segments, pistons_nm, UNTOUCHED_NM)?;
        let (ncpa, last) = (self.segments + self.ncpa, coefficients_nm.len() - 1);
        let mut followed_nm = coefficients_nm.slice(s![ncpa..last]).to_vec();
        followed_nm.resize(self.ncpa, 0.0);
        let mut unexplained_nm = mean_nm.to_owned();
        for (&column, &nm) in self.shows_as.iter().zip(&coefficients_nm) {
            unexplained_nm.scaled_add(-nm, &self.columns.row(column));
        }
        Ok(StaticErrors {
            unexplained_nm,
            pistons_nm: coefficients_nm.slice(s![..self.segments]).to_vec(),
            ncpa_nm: coefficients_nm.slice(s![self.segments..ncpa]).to_vec(),
            followed_nm,
            covariance_nm2: covariance_nm2.slice(s![..ncpa, ..ncpa]).to_owned(),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beyond_the_last_order_is_the_sum_of_a_power_law() {
        let orders = 20;
        let strength_nm = |order: f64, steepness: f64| 100.0 * order.powf(-steepness / 2.0);
        let errors = |steepness: f64| StaticErrors {
            pistons_nm: Vec::new(),
            ncpa_nm: Vec::new(),
            followed_nm: Vec::new(),
            covariance_nm2: Array2::zeros((0, 0)),
            log_evidence: 0.0,
            unexplained_nm: Array1::zeros(0),
            strengths_nm: std::iter::once(60.0)
                .chain((1..=orders).map(|order| strength_nm(order as f64, steepness)))
                .collect(),
        };
        for steepness in [3.5, 4.0, 6.0] {
            // Mode by mode, to where the rest is a thousandth.
            let variance = |order: u32| f64::from(order + 1) * strength_nm(f64::from(order), steepness).powi(2);
            let sum: f64 = (orders as u32 + 1..20_000).map(variance).sum();
            // The sum that begins at 20.5, and the one mode that an order has more, against an integral from 20: 10 % at the
            // steepest.
            let beyond_nm = errors(steepness).beyond_nm(orders);
            assert!((beyond_nm / sum.sqrt() - 1.0).abs() < 0.1, "{steepness}: {beyond_nm} {}", sum.sqrt());
        }
        // Two orders, of which the first is tip and tilt: the one that is left, and the least steepness.
        assert!((errors(4.0).beyond_nm(2) / (strength_nm(2.0, 4.0) * 2.0) - 1.0).abs() < 1e-12);
        // Strengths that do not fall, which noise may make, leave no infinity.
        let level_nm = errors(0.0).beyond_nm(orders);
        assert!((level_nm / (100.0 * 20.0) - 1.0).abs() < 0.5, "{level_nm}");
    }

    #[test]
    fn modes_are_as_many_as_the_sensor_tells_apart() {
        let with = |lenslets: &str| {
            Scene::preset("keck-onsky").unwrap().with(&[("wavefront_sensor.lenslets_across", lenslets)]).unwrap()
        };
        let keck = with("20");
        // 628 slopes in the lenslets' disc, of which 2.7 a mode are 233 modes: 230 to order 20.
        assert_eq!([13, 20, 24].map(|order| highest_order(&keck, order)), [13, 20, 20]);
        let mirror = |scene: &Scene| NcpaModes::of(Family::Mirror, scene, &Telescope::of(scene).unwrap()).unwrap();
        // All that Keck's mirror makes on the pupil's samples, which is fewer than 628/1.9; of ten lenslets 157/1.9.
        let modes = mirror(&keck);
        let telescope = Telescope::of(&keck).unwrap();
        let (influence, turbulence) = (telescope.influence(&keck).unwrap(), Telescope::turbulence(&keck).unwrap());
        let all = modes::karhunen_loeve_at_most(&influence, &telescope.pupil, &turbulence, usize::MAX).unwrap().basis;
        assert!(all.len() < 330, "{}", all.len());
        assert_eq!((modes.basis.len(), &modes.groups[..3]), (all.len(), &[2, 3, 4][..]));
        assert_eq!(modes.groups.iter().sum::<usize>(), modes.basis.len());
        assert_eq!(mirror(&with("10")).basis.len(), 82);
    }
}
