//! True aberrations of simulated images, drawn at random.

use crate::modes::{SmoothBasis, Zernikes, noll_orders};
use crate::pupil::Pupil;
use crate::scene::{AberrationScene, NollRange as Span, SegmentModes, System};
use crate::telescope::{MapOnGrid, OpdMap, Telescope};
use crate::{Error, Result};
use ndarray::Array2;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Aberrations of a simulated image.
#[derive(Clone)]
pub struct Truth {
    /// Piston of each segment, nm, with zero mean over the pupil.
    pub piston_nm: Vec<f64>,
    /// Tilt of each segment along x and y, nm RMS over the segment.
    pub tip_tilt_nm: Vec<[f64; 2]>,
    /// Focus and two astigmatisms of each segment, nm RMS over the segment.
    pub figure_nm: Vec<[f64; 3]>,
    /// Segment errors on the scene's grid, nm, `[y, x]`, NaN outside the pupil.
    pub phasing_nm: Array2<f64>,
    /// Non-common path aberrations on the same grid, nm.
    pub ncpa_nm: Array2<f64>,
    /// Amplitude that each segment reflects, about 1.
    pub amplitude: Vec<f64>,
    ncpa: Ncpa,
    /// Drift of pistons and NCPA, nm per minute; `None` for static ones.
    drift: Option<(Vec<f64>, Ncpa)>,
    /// Length over which a segment's tilt of 1 nm RMS rises by 1 nm, m.
    tilt_unit_m: f64,
    /// Mean and RMS about it of each figure over the segments, m².
    figure_units_m2: [[f64; 2]; 3],
}

#[derive(Clone)]
enum Ncpa {
    None,
    Modes { basis: SmoothBasis, coefficients_nm: Vec<f64>, offset_nm: f64 },
    Map(MapOnGrid),
    Sum(Box<Ncpa>, Box<Ncpa>),
}

impl Truth {
    /// Draws the aberrations of `scene`.
    ///
    /// Pistons are normal, then shifted to zero mean and scaled to exactly the stated RMS over the
    /// segments. The NCPA are Zernike polynomials on the circle around the pupil. Their variances
    /// are proportional to the radial order to the stated power; their sum is scaled to exactly the
    /// stated RMS over the pupil (weight A, piston removed). Petals are added to them. A map of
    /// NCPA whose cards have the pistons and tilts of the segments gives those too.
    ///
    /// # Errors
    /// [`Error::File`] for an NCPA map that cannot be read, and one with cards of the segments
    /// where the scene draws these.
    pub fn draw(scene: &System, telescope: &Telescope, rng: &mut impl Rng) -> Result<Self> {
        let segments = telescope.pupil.segments.len();
        let Some(aberrations) = &scene.aberrations else {
            let poses = (vec![0.0; segments], vec![[0.0; 2]; segments], vec![[0.0; 3]; segments]);
            return Self::assemble(telescope, poses, Ncpa::None);
        };
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let areas = telescope.pupil.segment_areas();
        let mean = |values: &[f64]| weighted_mean(values, &areas);
        let piston_nm = draw_pistons(&areas, aberrations.segment_piston_rms_nm, &mut normal);
        let tilts = draw_tilts(&areas, aberrations.segment_tip_tilt_rms_nm, &mut normal);
        let tip_tilt_nm = tilts.chunks(2).map(|t| [t[0], t[1]]).collect();
        let mut planes = None;
        let (span, power) = (aberrations.ncpa_zernikes, aberrations.ncpa_power_law);
        let ncpa = if let Some(file) = &aberrations.ncpa_file {
            let path = scene.resolve(file);
            let map = OpdMap::read(&path)?;
            planes = map.segment_planes(&telescope.pupil).map_err(|error| Error::file(&path, error))?;
            if planes.is_some()
                && (aberrations.segment_piston_rms_nm > 0.0 || aberrations.segment_tip_tilt_rms_nm > 0.0)
            {
                let reason = "has the pistons and tilts of the segments (cards S01PISTN, ...), and the scene aberrations.segment_piston_rms_nm \
                              or segment_tip_tilt_rms_nm: one of both is accepted";
                return Err(Error::file(&path, reason));
            }
            Ncpa::Map(map.over(&telescope.pupil).map_err(|error| Error::file(&path, error))?)
        } else {
            draw_zernikes(span, power, aberrations.ncpa_rms_nm, telescope, &mut normal)?
        };
        // Drawn last, so that the other draws of a seed do not depend on them.
        let reflectivity = draw_pistons(&areas, scene.faults.segment_reflectivity_rms, &mut normal);
        let drift_nm = scene.faults.drift_nm_per_min;
        let drift = if drift_nm > 0.0 {
            let pistons_nm = draw_pistons(&areas, drift_nm, &mut normal);
            Some((pistons_nm, draw_zernikes(span, power, drift_nm, telescope, &mut normal)?))
        } else {
            None
        };
        let ncpa = ncpa.plus(draw_petals(aberrations, telescope, &mut normal)?);
        let figure_nm = draw_figures(&areas, aberrations, &mut normal);
        let (piston_nm, tip_tilt_nm) = match planes {
            Some(planes) => {
                let mut piston_nm: Vec<f64> = planes.iter().map(|plane| plane[0]).collect();
                let centre = mean(&piston_nm);
                piston_nm.iter_mut().for_each(|piston| *piston -= centre);
                let unit_m = segment_radius_rms(telescope);
                (piston_nm, planes.iter().map(|[_, along_x, along_y]| [along_x * unit_m, along_y * unit_m]).collect())
            }
            None => (piston_nm, tip_tilt_nm),
        };
        let mut truth = Self::assemble(telescope, (piston_nm, tip_tilt_nm, figure_nm), ncpa)?;
        truth.amplitude = reflectivity.into_iter().map(|more| (1.0 + more).max(0.0).sqrt()).collect();
        truth.drift = drift;
        Ok(truth)
    }

    /// These aberrations with other pistons, nm, one for each segment of `telescope` (after a
    /// correction of the segments).
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong number of pistons, [`Error::Value`] for one that is not finite.
    pub fn with_pistons(self, telescope: &Telescope, piston_nm: Vec<f64>) -> Result<Self> {
        let (given, needed) = (piston_nm.len(), telescope.pupil.segments.len());
        if given != needed {
            return Err(Error::Shape(format!("{given} pistons were given for {needed} segments; one each is needed")));
        }
        if let Some(piston) = piston_nm.iter().find(|piston| !piston.is_finite()) {
            return Err(Error::Value(format!("a piston of {piston} nm is impossible; a finite number is needed")));
        }
        let corrected = Self::assemble(telescope, (piston_nm, self.tip_tilt_nm, self.figure_nm), self.ncpa)?;
        Ok(Self { amplitude: self.amplitude, drift: self.drift, ..corrected })
    }

    /// These aberrations with other tilts of the segments along x and y, nm RMS over the segment,
    /// one pair for each segment of `telescope`.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong number of tilts, [`Error::Value`] for one that is not finite.
    pub fn with_tilts(self, telescope: &Telescope, tip_tilt_nm: Vec<[f64; 2]>) -> Result<Self> {
        let (given, needed) = (tip_tilt_nm.len(), self.piston_nm.len());
        if given != needed {
            return Err(Error::Shape(format!(
                "tilts of {given} segments were given for {needed}; a pair each is needed"
            )));
        }
        if let Some(nm) = tip_tilt_nm.iter().flatten().find(|nm| !nm.is_finite()) {
            return Err(Error::Value(format!("a tilt of {nm} nm is impossible; a finite number is needed")));
        }
        let tilted = Self::assemble(telescope, (self.piston_nm, tip_tilt_nm, self.figure_nm), self.ncpa)?;
        Ok(Self { amplitude: self.amplitude, drift: self.drift, ..tilted })
    }

    /// These aberrations with more NCPA: `coefficients_nm` of `basis`, nm. A mirror that is moved
    /// adds the opposite of its surface.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong number of coefficients, [`Error::Value`] for one that is not
    /// finite.
    pub fn with_added_ncpa(self, telescope: &Telescope, basis: SmoothBasis, coefficients_nm: Vec<f64>) -> Result<Self> {
        let (given, needed) = (coefficients_nm.len(), basis.len());
        if given != needed {
            return Err(Error::Shape(format!(
                "{given} coefficients were given for {needed} modes; one each is needed"
            )));
        }
        if let Some(nm) = coefficients_nm.iter().find(|nm| !nm.is_finite()) {
            return Err(Error::Value(format!("a coefficient of {nm} nm is impossible; a finite number is needed")));
        }
        let added = Ncpa::Modes { basis, coefficients_nm, offset_nm: 0.0 };
        let poses = (self.piston_nm, self.tip_tilt_nm, self.figure_nm);
        let more = Self::assemble(telescope, poses, self.ncpa.plus(added))?;
        Ok(Self { amplitude: self.amplitude, drift: self.drift, ..more })
    }

    fn assemble(
        telescope: &Telescope,
        (piston_nm, tip_tilt_nm, figure_nm): (Vec<f64>, Vec<[f64; 2]>, Vec<[f64; 3]>),
        ncpa: Ncpa,
    ) -> Result<Self> {
        let pupil = &telescope.pupil;
        let outside = Array2::from_elem(pupil.amplitude.dim(), f64::NAN);
        let (tilt_unit_m, figure_units_m2) = (segment_radius_rms(telescope), figure_units_m2(telescope));
        let amplitude = vec![1.0; piston_nm.len()];
        let (phasing_nm, ncpa_nm, drift) = (outside.clone(), outside, None);
        let mut truth = Self {
            piston_nm,
            tip_tilt_nm,
            figure_nm,
            phasing_nm,
            ncpa_nm,
            amplitude,
            ncpa,
            drift,
            tilt_unit_m,
            figure_units_m2,
        };
        [truth.phasing_nm, truth.ncpa_nm] = truth.maps_on(pupil)?;
        Ok(truth)
    }

    /// NCPA at points of the pupil plane, nm.
    ///
    /// # Errors
    /// [`Error::Shape`] for lists of unequal length.
    pub fn ncpa_at(&self, xs_m: &[f64], ys_m: &[f64]) -> Result<Vec<f64>> {
        self.ncpa.at(xs_m, ys_m)
    }

    /// Light that the segments of `telescope` reflect, relative to perfect reflectivity.
    pub(crate) fn throughput(&self, telescope: &Telescope) -> f64 {
        let areas = telescope.pupil.segment_areas();
        let light = |(area, amplitude): (&f64, &f64)| area * amplitude * amplitude;
        areas.iter().zip(&self.amplitude).map(light).sum::<f64>() / areas.iter().sum::<f64>()
    }

    /// Drift of each segment's piston, nm per minute; `None` for static ones.
    pub(crate) fn piston_drift_nm(&self) -> Option<&[f64]> {
        self.drift.as_ref().map(|(pistons_nm, _)| &pistons_nm[..])
    }

    /// Drift of the NCPA at points of the pupil plane, nm per minute.
    pub(crate) fn ncpa_drift_at(&self, xs_m: &[f64], ys_m: &[f64]) -> Result<Vec<f64>> {
        self.drift.as_ref().map_or_else(|| Ok(vec![0.0; xs_m.len()]), |(_, ncpa)| ncpa.at(xs_m, ys_m))
    }

    /// Error of `segment` at a point, nm; `pupil` has the centres of the segments.
    pub(crate) fn segment_nm(&self, pupil: &Pupil, segment: usize, x_m: f64, y_m: f64) -> f64 {
        let (centre, [tip, tilt]) = (pupil.segments[segment], self.tip_tilt_nm[segment]);
        let (x_m, y_m) = (x_m - centre.x_m, y_m - centre.y_m);
        let plane_nm = self.piston_nm[segment] + (tip * x_m + tilt * y_m) / self.tilt_unit_m;
        let figures = figures_m2(x_m, y_m).into_iter().zip(self.figure_units_m2).zip(self.figure_nm[segment]);
        plane_nm
            + figures.map(|((m2, [mean, rms]), nm)| if nm == 0.0 { 0.0 } else { nm * (m2 - mean) / rms }).sum::<f64>()
    }

    /// Whether any segment has more than a piston.
    pub(super) fn varies_over_segments(&self) -> bool {
        self.tip_tilt_nm.iter().flatten().chain(self.figure_nm.iter().flatten()).any(|&nm| nm != 0.0)
    }

    /// Maps of the segment errors and of the NCPA on the grid of `pupil`, `[y, x]`, nm, NaN outside
    /// the pupil.
    ///
    /// # Errors
    /// [`Error::Shape`] for a pupil with other segments than the scene's.
    pub fn maps_on(&self, pupil: &Pupil) -> Result<[Array2<f64>; 2]> {
        if pupil.segments.len() != self.piston_nm.len() {
            let (given, wanted) = (pupil.segments.len(), self.piston_nm.len());
            return Err(Error::Shape(format!(
                "a pupil of {given} segments was given for a truth of {wanted}; the same number is needed"
            )));
        }
        let illuminated: Vec<((usize, usize), usize)> = pupil.owned_samples().collect();
        let at = |((y, x), _): &((usize, usize), usize)| (pupil.grid.coordinate_m(*x), pupil.grid.coordinate_m(*y));
        let (xs, ys): (Vec<f64>, Vec<f64>) = illuminated.iter().map(at).unzip();
        let outside = Array2::from_elem(pupil.owner.dim(), f64::NAN);
        let (mut phasing_nm, mut ncpa_nm) = (outside.clone(), outside);
        for ((at, owner), ncpa) in illuminated.into_iter().zip(self.ncpa_at(&xs, &ys)?) {
            let (y, x) = at;
            phasing_nm[at] = self.segment_nm(pupil, owner, pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
            ncpa_nm[at] = ncpa;
        }
        Ok([phasing_nm, ncpa_nm])
    }
}

impl Ncpa {
    /// The sum of both.
    fn plus(self, other: Self) -> Self {
        match (self, other) {
            (Ncpa::None, only) | (only, Ncpa::None) => only,
            (one, other) => Ncpa::Sum(Box::new(one), Box::new(other)),
        }
    }

    fn at(&self, xs_m: &[f64], ys_m: &[f64]) -> Result<Vec<f64>> {
        Ok(match self {
            Ncpa::None => vec![0.0; xs_m.len()],
            Ncpa::Sum(one, other) => {
                one.at(xs_m, ys_m)?.into_iter().zip(other.at(xs_m, ys_m)?).map(|(one, other)| one + other).collect()
            }
            Ncpa::Map(map) => xs_m.iter().zip(ys_m).map(|(&x, &y)| map.at(x, y)).collect(),
            Ncpa::Modes { basis, coefficients_nm, offset_nm } => {
                let coefficients = ndarray::ArrayView1::from(coefficients_nm);
                (coefficients.dot(&basis.evaluate(xs_m, ys_m)?) + *offset_nm).to_vec()
            }
        })
    }
}

/// RMS of x over a segment, m: √(5/24) of the side for a hexagon. It is measured on the pupil, so
/// that it holds for any shape.
fn segment_radius_rms(telescope: &Telescope) -> f64 {
    let pupil = &telescope.pupil;
    let (mut weight, mut square) = (0.0, 0.0);
    for ((y, x), owner) in pupil.owned_samples() {
        let (a, centre) = (pupil.amplitude[[y, x]], pupil.segments[owner]);
        let (x, y) = (pupil.grid.coordinate_m(x) - centre.x_m, pupil.grid.coordinate_m(y) - centre.y_m);
        (weight, square) = (weight + a, square + a * (x * x + y * y) / 2.0);
    }
    (square / weight).sqrt()
}

/// Focus and two astigmatisms at a point from the centre of a segment, m².
fn figures_m2(x_m: f64, y_m: f64) -> [f64; 3] {
    [x_m * x_m + y_m * y_m, x_m * x_m - y_m * y_m, 2.0 * x_m * y_m]
}

/// Mean and RMS about it of each figure over the segments, m², measured on the pupil.
fn figure_units_m2(telescope: &Telescope) -> [[f64; 2]; 3] {
    let pupil = &telescope.pupil;
    let (mut weight, mut sums) = (0.0, [[0.0; 2]; 3]);
    for ((y, x), owner) in pupil.owned_samples() {
        let (a, centre) = (pupil.amplitude[[y, x]], pupil.segments[owner]);
        let (x, y) = (pupil.grid.coordinate_m(x) - centre.x_m, pupil.grid.coordinate_m(y) - centre.y_m);
        weight += a;
        for ([sum, square], m2) in sums.iter_mut().zip(figures_m2(x, y)) {
            (*sum, *square) = (*sum + a * m2, *square + a * m2 * m2);
        }
    }
    sums.map(|[sum, square]| [sum / weight, (square / weight - (sum / weight).powi(2)).max(0.0).sqrt()])
}

fn weighted_mean(values: &[f64], areas: &[f64]) -> f64 {
    let whole: f64 = areas.iter().sum();
    values.iter().zip(areas).map(|(v, a)| v * a).sum::<f64>() / whole
}

/// A normal number for each of the parts of a pupil with these areas, with zero mean and the given
/// RMS over the pupil.
fn draw_pistons(areas: &[f64], rms: f64, normal: &mut dyn FnMut() -> f64) -> Vec<f64> {
    let mut values: Vec<f64> = areas.iter().map(|_| normal()).collect();
    let centre = weighted_mean(&values, areas);
    values.iter_mut().for_each(|p| *p -= centre);
    let square: Vec<f64> = values.iter().map(|p| p * p).collect();
    scale_to(&mut values, weighted_mean(&square, areas).sqrt(), rms);
    values
}

/// A tip and a tilt for each of these parts in turn, with the given RMS over the pupil.
fn draw_tilts(areas: &[f64], rms: f64, normal: &mut dyn FnMut() -> f64) -> Vec<f64> {
    let mut tilts: Vec<f64> = (0..2 * areas.len()).map(|_| normal()).collect();
    let square: Vec<f64> = tilts.chunks(2).map(|t| t[0] * t[0] + t[1] * t[1]).collect();
    scale_to(&mut tilts, weighted_mean(&square, areas).sqrt(), rms);
    tilts
}

/// Figures of segments with these areas: those that all share, and each its own.
fn draw_figures(areas: &[f64], aberrations: &AberrationScene, normal: &mut dyn FnMut() -> f64) -> Vec<[f64; 3]> {
    // Without figures no number is drawn, so that the noise of a seed stays.
    if aberrations.common_figure_rms_nm == 0.0 && aberrations.segment_figure_rms_nm == 0.0 {
        return vec![[0.0; 3]; areas.len()];
    }
    let square = |figure: &[f64; 3]| figure.iter().map(|nm| nm * nm).sum::<f64>();
    let mut common = [0; 3].map(|_| normal());
    let rms = square(&common).sqrt();
    scale_to(&mut common, rms, aberrations.common_figure_rms_nm);
    let mut own: Vec<[f64; 3]> = areas.iter().map(|_| [0; 3].map(|_| normal())).collect();
    let rms = weighted_mean(&own.iter().map(square).collect::<Vec<_>>(), areas).sqrt();
    scale_to(own.as_flattened_mut(), rms, aberrations.segment_figure_rms_nm);
    own.into_iter().map(|own| [0, 1, 2].map(|kind| own[kind] + common[kind])).collect()
}

/// Petals of `aberrations`, given or drawn.
fn draw_petals(aberrations: &AberrationScene, telescope: &Telescope, normal: &mut dyn FnMut() -> f64) -> Result<Ncpa> {
    let [piston_nm, tilt_nm] = [aberrations.petal_piston_rms_nm, aberrations.petal_tip_tilt_rms_nm];
    let given = aberrations.petal_coefficients_nm.as_ref();
    if given.is_none() && piston_nm == 0.0 && tilt_nm == 0.0 {
        return Ok(Ncpa::None);
    }
    let Some(petals) = telescope.petals(SegmentModes::PistonTipTilt)? else { return Ok(Ncpa::None) };
    let count = petals.shares().len();
    let coefficients_nm = match given {
        Some(given) if given.len() == count => given.iter().copied().chain(vec![0.0; 2 * count]).collect(),
        Some(given) if given.len() == 3 * count => given.clone(),
        Some(given) => {
            return Err(Error::Scene(format!(
                "aberrations.petal_coefficients_nm has {} numbers; {count}, a piston for each part of the pupil, or {}, with tips and \
                 tilts, are needed",
                given.len(),
                3 * count
            )));
        }
        None => {
            let pistons = draw_pistons(petals.shares(), piston_nm, normal);
            let tilts = draw_tilts(petals.shares(), tilt_nm, normal);
            let tips = tilts.iter().step_by(2).chain(tilts.iter().skip(1).step_by(2));
            pistons.iter().chain(tips).copied().collect::<Vec<f64>>()
        }
    };
    let offset_nm = -weighted_mean(&coefficients_nm[..count], petals.shares());
    Ok(Ncpa::Modes { basis: SmoothBasis::petals(petals), coefficients_nm, offset_nm })
}

fn scale_to(values: &mut [f64], rms: f64, wanted: f64) {
    let factor = if rms > 0.0 { wanted / rms } else { 0.0 };
    values.iter_mut().for_each(|value| *value *= factor);
}

fn draw_zernikes(
    span: Span,
    power: f64,
    rms_nm: f64,
    telescope: &Telescope,
    normal: &mut dyn FnMut() -> f64,
) -> Result<Ncpa> {
    // Piston (Noll 1) has no effect on an image.
    let nolls: Vec<usize> = span.indices().filter(|&noll| noll > 1).collect();
    if nolls.is_empty() || rms_nm == 0.0 {
        return Ok(Ncpa::None);
    }
    let mut coefficients_nm = Vec::with_capacity(nolls.len());
    for &noll in &nolls {
        let (order, _) = noll_orders(noll)?;
        coefficients_nm.push(normal() * (order as f64).powf(power / 2.0));
    }
    let pupil = &telescope.pupil;
    let radius_m = pupil
        .amplitude
        .indexed_iter()
        .filter(|(_, a)| **a > 0.0)
        .map(|((y, x), _)| pupil.grid.coordinate_m(x).hypot(pupil.grid.coordinate_m(y)))
        .fold(0.0, f64::max);
    let basis = SmoothBasis::zernike(Zernikes::new(nolls, radius_m)?);
    let samples = crate::modes::Samples::from_pupil(pupil)?;
    let map = ndarray::ArrayView1::from(&coefficients_nm).dot(&basis.evaluate(&samples.xs_m, &samples.ys_m)?);
    let mean: f64 = map.iter().zip(&samples.weights).map(|(m, w)| m * w).sum();
    let rms = map.iter().zip(&samples.weights).map(|(m, w)| w * (m - mean).powi(2)).sum::<f64>().sqrt();
    scale_to(&mut coefficients_nm, rms, rms_nm);
    Ok(Ncpa::Modes { basis, coefficients_nm, offset_nm: -mean * rms_nm / rms })
}
