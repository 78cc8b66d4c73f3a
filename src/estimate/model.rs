//! The estimator's model of a scene: which modes, on which samples, compared with which pixels.

use super::prepare::Preparation;
use super::recipe::Recipe;
use crate::fourier::Sampling;
use crate::grid::Grid;
use crate::imaging::{Mode, Optics, OpticsParts};
use crate::io;
use crate::modes::{self, Basis, Group, SmoothBasis};
use crate::pupil::{BandLimit, Pupil, SegmentWeights};
use crate::scene::{Crop, NcpaBasis, PupilModel, Sampling as Pixels, Scene, SegmentModes, Zernikes};
use crate::telescope::{Diversity, Telescope};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Array3, Axis};
use std::cell::OnceCell;
use std::sync::Arc;

/// Spare samples on each side of the pupil in a band-limited model, fewest and most: the weights ring beyond the glass,
/// and what rings beyond the grid is lost. Every spare sample is one less across the pupil: at 120 samples 4 leave
/// 0.026 nm of NCPA where 1 leaves 0.037 (the noise 0.1), at 96 samples 0.7 where 1 leaves 0.12.
const SPARE_SAMPLES: (f64, f64) = (1.0, 4.0);
/// Half of the low pass's transition, cycles, on either side of the Nyquist frequency: it keeps the ringing short. 8
/// keeps 3.8 weights a sample where 4 keeps 5.6, and the error is no larger.
const HALF_TRANSITION: f64 = 8.0;
/// What the aberrations add to the frequencies of the defocus, cycles.
const ABERRATION_CYCLES: f64 = 4.0;
/// λ/D around the geometric spot that still carry signal worth fitting.
const SPOT_MARGIN: f64 = 3.0;
/// Least half-width of the fitted image, λ/D: without defocus the light of single segments still spreads this far.
const LEAST_HALF_WIDTH: f64 = 16.0;
/// A mode is dropped where those before it already span all but this fraction of it.
const SMALLEST_REMAINDER: f64 = 1e-3;

/// Everything that is fixed before an image is looked at.
pub struct Model {
    /// The telescope, on the scene's grid.
    pub telescope: Telescope,
    /// The model that the chains run.
    pub optics: Arc<Optics>,
    /// How frames become exposures.
    pub preparation: Preparation,
    /// Names, groups and maps (on the scene's grid, `[mode, y, x]`, nm per nm) of the modes.
    pub basis: Basis,
    /// Number of segment modes; they come first.
    pub segment_modes: usize,
    /// Modes that were asked for but that the others already span.
    pub dropped: Vec<String>,
    /// Side of the grid on which the model runs, m.
    grid_width_m: f64,
}

impl Model {
    /// Builds the model of `scene`. `native` forbids the reduction to Nyquist sampling (bad pixels would ring).
    ///
    /// # Errors
    /// Those of the rooms below, for files that cannot be read and bases that cannot be built.
    pub fn of(scene: &Scene, recipe: &Recipe, native: bool) -> Result<Self> {
        Self::with_own_basis(scene, recipe, native, &OwnBasis::default())
    }

    /// As [`Model::of`], with the scene's own basis kept for other recipes of the same scene.
    pub(super) fn with_own_basis(scene: &Scene, recipe: &Recipe, native: bool, own: &OwnBasis) -> Result<Self> {
        let telescope = Telescope::of(scene)?;
        let diversity = Diversity::of(scene, &telescope.pupil)?;
        let pixels = PixelPlan::of(scene, recipe, native, &diversity, &telescope.pupil);
        let set = ModeSet::of(scene, recipe, &telescope, own)?;
        let band_limited = recipe.pupil_model == PupilModel::BandLimited && telescope.is_fine() && !set.is_from_file();
        let (grid, weights) = if band_limited {
            band_limited_weights(scene, &telescope, &pixels)?
        } else if recipe.pupil_model == PupilModel::Area {
            (telescope.pupil.grid, telescope.area_weights(telescope.pupil.grid)?)
        } else {
            (telescope.pupil.grid, SegmentWeights::hard(&telescope.pupil))
        };
        let per_lambda_over_d = pixels.per_lambda_over_d * telescope.pupil.grid.width_m() / grid.width_m();
        let sampling = Sampling::new(grid.samples(), pixels.preparation.pixels, per_lambda_over_d)?;
        let points: Vec<(f64, f64)> = weights
            .lit
            .iter()
            .map(|&p| (p as usize % grid.samples(), p as usize / grid.samples()))
            .map(|(x, y)| (grid.coordinate_m(x), grid.coordinate_m(y)))
            .collect();
        let slopes = (set.kinds.iter().any(|mode| matches!(mode, Mode::Tip(_))))
            .then(|| slopes(&weights, &points, &telescope.pupil));
        let optics = Optics::new(OpticsParts {
            sampling,
            wavelength_nm: scene.image.wavelength_nm,
            slopes,
            diversity_nm: diversity_at(&diversity, &points, &weights, grid)?,
            basis: set.smooth.at(&points, &weights)?,
            modes: set.kinds,
            weights,
        })?;
        Ok(Self {
            telescope,
            optics: Arc::new(optics),
            preparation: pixels.preparation,
            segment_modes: set.basis.groups().iter().filter(|group| **group == Group::Segment).count(),
            basis: set.basis,
            dropped: set.dropped,
            grid_width_m: grid.width_m(),
        })
    }

    /// Width of the model's grid over that of the scene's.
    pub fn width_ratio(&self) -> f64 {
        self.grid_width_m / self.telescope.pupil.grid.width_m()
    }

    /// The map of some of the modes, `[y, x]`, nm, NaN outside the pupil.
    pub fn map_nm(&self, coefficients_nm: &[f64], group: Group) -> Array2<f64> {
        let mut map = Array2::zeros(self.telescope.pupil.amplitude.dim());
        for ((mode, &nm), &of) in self.basis.maps().outer_iter().zip(coefficients_nm).zip(self.basis.groups()) {
            if of == group {
                map.scaled_add(nm, &mode);
            }
        }
        self.outside_to_nan(map)
    }

    /// `map` with NaN where there is no glass.
    pub fn outside_to_nan(&self, mut map: Array2<f64>) -> Array2<f64> {
        ndarray::Zip::from(&mut map).and(&self.telescope.pupil.owner).for_each(|value, &owner| {
            if owner < 0 {
                *value = f64::NAN;
            }
        });
        map
    }
}

/// Which pixels are compared.
struct PixelPlan {
    preparation: Preparation,
    /// Model pixels per λ/grid_m.
    per_lambda_over_d: f64,
    /// Half-width of the geometric spot, λ/grid_m.
    spot: f64,
    /// Samples left free on each side of a band-limited pupil.
    spare_samples: usize,
}

impl PixelPlan {
    fn of(scene: &Scene, recipe: &Recipe, native: bool, diversity: &Diversity, pupil: &Pupil) -> Self {
        let image = &scene.image;
        let (frame_pixels, frame_sampling) = (image.pixels, image.samples_per_lambda_over_d);
        let nyquist = frame_pixels as f64 * 2.0 / frame_sampling;
        let whole = (nyquist - nyquist.round()).abs() < 1e-9 && (nyquist.round() as usize).is_multiple_of(2);
        let wanted = !native && recipe.sampling != Pixels::Native && frame_sampling > 2.0 && whole;
        let (reduced_pixels, per_lambda_over_d) =
            if wanted { (nyquist.round() as usize, 2.0) } else { (frame_pixels, frame_sampling) };
        let spot = diversity.steepest_nm_m(pupil) * pupil.grid.width_m() / image.wavelength_nm;
        let mut half_width = (spot + SPOT_MARGIN).max(LEAST_HALF_WIDTH);
        // What the samples could pass beyond what the image needs.
        let beyond = scene.pupil.samples as f64 / 2.0 - (half_width + spot + ABERRATION_CYCLES);
        let spare_samples = beyond.clamp(SPARE_SAMPLES.0, SPARE_SAMPLES.1) as usize;
        if recipe.pupil_model == PupilModel::BandLimited {
            // Not wider than what the samples can carry: what aliases beyond that costs more than the light that is
            // left out, down to two thirds of the spot.
            let carried = scene.pupil.samples as f64 / 2.0 - spare_samples as f64 - spot - ABERRATION_CYCLES;
            half_width = half_width.min(carried.max(spot * 2.0 / 3.0).max(LEAST_HALF_WIDTH));
        }
        let signal = 2.0 * per_lambda_over_d * half_width;
        let pixels = match image.crop_pixels {
            Crop::Pixels(native) => 2 * (native * reduced_pixels / frame_pixels / 2).max(4),
            Crop::Auto if recipe.crop => 8 * (signal / 8.0).ceil() as usize,
            Crop::Auto => reduced_pixels,
        };
        let preparation = Preparation {
            frame_pixels,
            reduced_pixels,
            pixels: pixels.min(reduced_pixels),
            flip: [image.flip_x, image.flip_y],
        };
        Self { preparation, per_lambda_over_d, spot, spare_samples }
    }

    /// Half-width of the fitted image, λ/grid_m.
    fn half_width(&self) -> f64 {
        self.preparation.pixels as f64 / (2.0 * self.per_lambda_over_d)
    }
}

/// The scene's number of samples, spread over the pupil and some room around it, and the weights on them.
///
/// The pass band holds every frequency of the pupil that light of the spot can bring into the image: half the image and
/// the spot, and a little for the aberrations.
fn band_limited_weights(scene: &Scene, telescope: &Telescope, pixels: &PixelPlan) -> Result<(Grid, SegmentWeights)> {
    let own = telescope.pupil.grid;
    let samples = scene.pupil.samples;
    let stretch = samples as f64 / (samples - 2 * pixels.spare_samples) as f64;
    let grid = Grid::new(samples, own.width_m() * stretch)?;
    let wanted = (pixels.half_width() + pixels.spot + ABERRATION_CYCLES) * stretch;
    // The smallest grid that a scene accepts has 16 samples.
    let most = (samples as f64 / 2.0 - HALF_TRANSITION).max(samples as f64 / 4.0);
    let pass = scene.pupil.band_pass_cycles.map_or(wanted.min(most), |pass| pass * stretch);
    let mut limit = BandLimit::new(pass, samples)?;
    if let Some(stop) = scene.pupil.band_stop_cycles {
        limit.stop = (stop * stretch).min(samples as f64);
    }
    Ok((grid, telescope.band_limited_weights(grid, &limit)?))
}

/// Coordinates of each entry on its segment, in units of the segment's RMS.
fn slopes(weights: &SegmentWeights, points: &[(f64, f64)], pupil: &Pupil) -> (Vec<f64>, Vec<f64>) {
    let mut moments = vec![[0.0; 3]; pupil.segments.len()];
    for (((y, x), &owner), &a) in
        pupil.owner.indexed_iter().zip(&pupil.amplitude).filter(|((_, owner), _)| **owner >= 0)
    {
        let centre = pupil.segments[owner as usize];
        let (x, y) = (pupil.grid.coordinate_m(x) - centre.x_m, pupil.grid.coordinate_m(y) - centre.y_m);
        let [weight, xx, yy] = &mut moments[owner as usize];
        (*weight, *xx, *yy) = (*weight + a, *xx + a * x * x, *yy + a * y * y);
    }
    let mut slopes = (Vec::new(), Vec::new());
    for ((_, segments, _), &(x, y)) in weights.rows().zip(points) {
        for &segment in segments {
            let ([weight, xx, yy], centre) = (moments[segment as usize], pupil.segments[segment as usize]);
            slopes.0.push((x - centre.x_m) / (xx / weight).sqrt());
            slopes.1.push((y - centre.y_m) / (yy / weight).sqrt());
        }
    }
    slopes
}

/// The diversity at the lit samples: a map on this very grid sample by sample, anything else by coordinates.
fn diversity_at(
    diversity: &Diversity,
    points: &[(f64, f64)],
    weights: &SegmentWeights,
    grid: Grid,
) -> Result<Vec<f64>> {
    if points.len() != weights.lit.len() {
        return Err(Error::Internal(format!(
            "{} points for {} lit samples of {grid:?}",
            points.len(),
            weights.lit.len()
        )));
    }
    Ok(points.iter().map(|&(x, y)| diversity.at(x, y)).collect())
}

/// The smooth modes: functions, or maps on the scene's grid.
enum Smooth {
    Functions(Option<SmoothBasis>),
    Maps(Array3<f64>),
}

impl Smooth {
    /// Values at the lit samples, `[mode, lit]`.
    fn at(&self, points: &[(f64, f64)], weights: &SegmentWeights) -> Result<Array2<f64>> {
        match self {
            Self::Functions(None) => Ok(Array2::zeros((0, points.len()))),
            Self::Functions(Some(basis)) => {
                let (xs, ys): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
                basis.evaluate(&xs, &ys)
            }
            Self::Maps(maps) => {
                let lit: Vec<usize> = weights.lit.iter().map(|&p| p as usize).collect();
                let flat = maps.to_shape((maps.len_of(Axis(0)), maps.len() / maps.len_of(Axis(0)).max(1)));
                Ok(flat.map_err(|error| Error::Internal(error.to_string()))?.select(Axis(1), &lit))
            }
        }
    }
}

/// The modes of a scene.
struct ModeSet {
    basis: Basis,
    kinds: Vec<Mode>,
    smooth: Smooth,
    dropped: Vec<String>,
}

impl ModeSet {
    fn of(scene: &Scene, recipe: &Recipe, telescope: &Telescope, own: &OwnBasis) -> Result<Self> {
        let pupil = &telescope.pupil;
        let segment = match scene.modes.segment {
            SegmentModes::None => None,
            SegmentModes::Piston => Some(modes::SegmentModes::Piston),
            SegmentModes::PistonTipTilt => Some(modes::SegmentModes::PistonTipTilt),
        };
        let segments = pupil.segments.len();
        let segment_basis = segment.map(|modes| modes.maps(pupil)).transpose()?;
        let mut kinds: Vec<Mode> = Vec::new();
        for motion in 0..segment.map_or(0, modes::SegmentModes::per_segment) {
            kinds.extend((0..segments).map(|s| [Mode::Piston(s), Mode::Tip(s), Mode::Tilt(s)][motion]));
        }
        let (smooth, ncpa, dropped) = if let NcpaBasis::File(file) = &scene.modes.ncpa {
            let (basis, dropped) = from_file(&scene.resolve(file), recipe.exact_zernikes, pupil)?;
            (Smooth::Maps(basis.maps().to_owned()), Some(basis), dropped)
        } else {
            let (smooth, dropped) = functions(scene, recipe, telescope, own)?;
            let sampled = smooth.as_ref().map(|basis| basis.sampled(pupil)).transpose()?;
            (Smooth::Functions(smooth), sampled, dropped)
        };
        kinds.extend((0..ncpa.as_ref().map_or(0, Basis::len)).map(Mode::Smooth));
        let basis = match (segment_basis, ncpa) {
            (Some(segments), Some(ncpa)) => segments.followed_by(&ncpa)?,
            (Some(only), None) | (None, Some(only)) => only,
            (None, None) => return Err(Error::Scene("the scene leaves no mode to estimate".into())),
        };
        Ok(Self { basis, kinds, smooth, dropped })
    }

    fn is_from_file(&self) -> bool {
        matches!(self.smooth, Smooth::Maps(_))
    }
}

/// The scene's own basis, which costs a second to build: made once for all recipes of a scene.
#[derive(Default)]
pub(super) struct OwnBasis(OnceCell<Option<SmoothBasis>>);

impl OwnBasis {
    fn of(&self, scene: &Scene, telescope: &Telescope) -> Result<Option<SmoothBasis>> {
        if let Some(made) = self.0.get() {
            return Ok(made.clone());
        }
        let (pupil, count) = (&telescope.pupil, scene.modes.ncpa_count);
        let made = match &scene.modes.ncpa {
            NcpaBasis::Kl => {
                let turbulence = Telescope::turbulence(scene)?;
                Some(modes::karhunen_loeve(&telescope.influence(scene)?, pupil, &turbulence, count)?.basis)
            }
            NcpaBasis::Zernike => Some(modes::zernike_basis(2, count + 1, pupil)?),
            NcpaBasis::None | NcpaBasis::File(_) => None,
        };
        Ok(self.0.get_or_init(|| made).clone())
    }
}

/// Exact Zernikes first, then what the scene's basis adds to them; names keep the order.
fn functions(
    scene: &Scene,
    recipe: &Recipe,
    telescope: &Telescope,
    own: &OwnBasis,
) -> Result<(Option<SmoothBasis>, Vec<String>)> {
    let (pupil, count) = (&telescope.pupil, scene.modes.ncpa_count);
    let own = own.of(scene, telescope)?;
    let exact = match recipe.exact_zernikes {
        Zernikes::Span { first, last } => match &scene.modes.ncpa {
            // A Zernike basis that already reaches as far is exact as it is.
            NcpaBasis::Zernike if last <= count + 1 => None,
            _ => Some(modes::zernike_basis(first, last, pupil)?),
        },
        Zernikes::None => None,
    };
    Ok(match (exact, own) {
        (Some(exact), Some(own)) => {
            let joined = modes::join_exact(&exact, &own, pupil, SMALLEST_REMAINDER)?;
            (Some(joined.basis), joined.dropped.into_iter().map(|dropped| dropped.name).collect())
        }
        (exact, own) => (exact.or(own), Vec::new()),
    })
}

/// Modes from a FITS file, used as they are, followed by what the exact Zernikes add to its NCPA modes.
fn from_file(path: &std::path::Path, exact: Zernikes, pupil: &Pupil) -> Result<(Basis, Vec<String>)> {
    let mut file = io::FitsReader::open(path)?;
    let maps = file.cube("BASIS")?;
    let names = file.text_column("MODES", "NAME")?;
    let groups = file.text_column("MODES", "GROUP")?;
    let samples = pupil.grid.samples();
    if maps.dim().1 != samples || maps.dim().2 != samples {
        let (_, rows, columns) = maps.dim();
        return Err(Error::file(
            path,
            format_args!("the modes have {columns}x{rows} samples where the pupil has {samples}x{samples}"),
        ));
    }
    let groups = groups.iter().map(|group| Group::parse(group)).collect::<Result<Vec<_>>>();
    let given = groups.and_then(|groups| Basis::from_cube(names, groups, maps)).map_err(|e| Error::file(path, e))?;
    if given.groups().windows(2).any(|pair| pair[0] == Group::Ncpa && pair[1] == Group::Segment) {
        return Err(Error::file(path, "segment modes must come before NCPA modes"));
    }
    let Zernikes::Span { first, last } = exact else { return Ok((given, Vec::new())) };
    let zernikes = modes::zernike_basis(first, last, pupil)?.sampled(pupil)?;
    let (added, dropped) = remainders(&given, &zernikes, pupil);
    if added.is_empty() {
        return Ok((given, dropped));
    }
    let views: Vec<_> = added.iter().map(|(_, map)| map.view()).collect();
    let maps = ndarray::stack(Axis(0), &views).map_err(|error| Error::Internal(error.to_string()))?;
    let names = added.iter().map(|(name, _)| name.clone()).collect();
    Ok((given.followed_by(&Basis::from_cube(names, vec![Group::Ncpa; added.len()], maps)?)?, dropped))
}

/// What each extra mode adds to the NCPA modes of `given` (and to the extras before it), at unit RMS over the pupil;
/// and the names of those that add nothing.
fn remainders(given: &Basis, extra: &Basis, pupil: &Pupil) -> (Vec<(String, Array2<f64>)>, Vec<String>) {
    let root: Array1<f64> = pupil.amplitude.iter().map(|a| (a / pupil.weight_sum()).sqrt()).collect();
    let flat = |basis: &Basis, keep: &dyn Fn(usize) -> bool| -> Vec<Array1<f64>> {
        let maps = basis.maps();
        let kept = maps.outer_iter().enumerate().filter(|(i, _)| keep(*i));
        kept.map(|(_, map)| map.iter().zip(&root).map(|(v, r)| v * r).collect()).collect()
    };
    let mut directions: Vec<Array1<f64>> = Vec::new();
    // Twice is enough: the classical result on Gram-Schmidt with re-orthogonalisation.
    let project = |mut v: Array1<f64>, directions: &[Array1<f64>]| {
        for direction in directions.iter().chain(directions) {
            let along = direction.dot(&v);
            v.scaled_add(-along, direction);
        }
        v
    };
    directions.push(&root / root.dot(&root).sqrt());
    for mode in flat(given, &|i| given.groups()[i] == Group::Ncpa) {
        let length = mode.dot(&mode).sqrt();
        let rest = project(mode, &directions);
        let norm = rest.dot(&rest).sqrt();
        if norm > 1e-9 * length {
            directions.push(rest / norm);
        }
    }
    let (mut added, mut dropped) = (Vec::new(), Vec::new());
    for (mode, name) in flat(extra, &|_| true).into_iter().zip(extra.names()) {
        let length = mode.dot(&mode).sqrt();
        let rest = project(mode, &directions);
        let norm = rest.dot(&rest).sqrt();
        if norm <= SMALLEST_REMAINDER * length {
            dropped.push(name.clone());
            continue;
        }
        let unit = rest / norm;
        let values = unit.iter().zip(&root).map(|(v, r)| if *r > 0.0 { v / r } else { 0.0 }).collect();
        let map = Array2::from_shape_vec(pupil.amplitude.dim(), values);
        directions.push(unit);
        if let Ok(map) = map {
            added.push((name.clone(), map));
        }
    }
    (added, dropped)
}
