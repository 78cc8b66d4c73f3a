//! Mode set: the modes of the scene, and the Zernikes that a recipe adds to them exactly.

use crate::grid::Grid;
use crate::imaging::Mode;
use crate::io;
use crate::modal::model::prior::Prior;
use crate::modal::model::recipe::Recipe;
use crate::modes::{self, Basis, Group, SeparableBasis, SmoothBasis};
use crate::pupil::{Pupil, SegmentWeights};
use crate::scene::{NcpaBasis, NollRange, SegmentModes, System};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, Array3, Axis};
use std::sync::OnceLock;

/// A mode is dropped where those before it span all but this fraction of it.
const SMALLEST_REMAINDER: f64 = 1e-3;
/// The same for a Zernike with a prior: what is dropped is an error of the coefficients of those
/// that span it, of 1 % of its own at most.
const SMALLEST_PRIOR_REMAINDER: f64 = 0.01;

/// The smooth modes: functions, or maps on the scene's grid.
#[derive(Clone)]
pub(in crate::modal) enum Smooth {
    Functions(Option<SmoothBasis>),
    Maps(Array3<f64>),
}

impl Smooth {
    /// The modes as products of functions of x and y on `grid`, where they are such functions.
    pub(in crate::modal) fn products(&self, grid: Grid) -> Result<Option<SeparableBasis>> {
        match self {
            Self::Functions(Some(basis)) if basis.is_separable() => SeparableBasis::new(basis, grid).map(Some),
            Self::Functions(_) | Self::Maps(_) => Ok(None),
        }
    }

    /// Values at the illuminated samples, `[mode, sample]`.
    pub(in crate::modal) fn at(&self, points: &[(f64, f64)], weights: &SegmentWeights) -> Result<Array2<f64>> {
        match self {
            Self::Functions(None) => Ok(Array2::zeros((0, points.len()))),
            Self::Functions(Some(basis)) => {
                let (xs, ys): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
                basis.evaluate(&xs, &ys)
            }
            Self::Maps(maps) => {
                let illuminated: Vec<usize> = weights.illuminated.iter().map(|&p| p as usize).collect();
                let flat = maps.to_shape((maps.len_of(Axis(0)), maps.len() / maps.len_of(Axis(0)).max(1)));
                Ok(flat.map_err(|error| Error::Internal(error.to_string()))?.select(Axis(1), &illuminated))
            }
        }
    }
}

/// The modes of a scene.
#[derive(Clone)]
pub(in crate::modal) struct ModeSet {
    /// Names, groups and maps on the scene's grid.
    pub(in crate::modal) basis: Basis,
    /// What each coefficient changes in the model.
    pub(in crate::modal) kinds: Vec<Mode>,
    pub(in crate::modal) smooth: Smooth,
    /// Names of modes that were dropped because the others span them.
    pub(in crate::modal) dropped: Vec<String>,
    /// Prior of the last modes.
    pub(in crate::modal) prior: Option<Prior>,
}

/// NCPA modes, their maps on the scene's grid, and the names of those that were dropped.
struct NcpaModes {
    smooth: Smooth,
    sampled: Option<Basis>,
    dropped: Vec<String>,
    /// Zernikes with a prior on the circle around the pupil: their maps, and how many of the modes,
    /// the last, are what they add to the others.
    with_prior: Option<(Basis, usize)>,
}

impl NcpaModes {
    fn from_scene(scene: &System, recipe: &Recipe, telescope: &Telescope, own: &SceneBasis) -> Result<Self> {
        if let NcpaBasis::File(file) = &scene.modes.ncpa {
            return Self::from_maps(from_file(&scene.resolve(file), &telescope.pupil)?, recipe, &telescope.pupil);
        }
        let pupil = &telescope.pupil;
        let (smooth, dropped) = functions(scene, recipe, telescope, own)?;
        let mut smooth = with_petals(smooth, scene, telescope)?;
        let mut with_prior = None;
        if let (NollRange::Span { first, last }, Some(before)) = (recipe.prior_zernikes, &smooth) {
            let zernikes = modes::circle_zernikes(first, last, pupil)?;
            let joined = modes::join_exact(before, &zernikes, pupil, SMALLEST_PRIOR_REMAINDER)?.basis;
            with_prior = Some((zernikes.sampled(pupil)?, joined.len().saturating_sub(before.len())));
            smooth = Some(joined);
        }
        let sampled = smooth.as_ref().map(|basis| basis.sampled(pupil)).transpose()?;
        Ok(Self { smooth: Smooth::Functions(smooth), sampled, dropped, with_prior })
    }

    /// Modes given by their maps, unchanged, followed by what the exact Zernikes add to the NCPA
    /// among them.
    fn from_maps(given: Basis, recipe: &Recipe, pupil: &Pupil) -> Result<Self> {
        let (mut basis, mut dropped) = (given, Vec::new());
        if let NollRange::Span { first, last } = recipe.exact_zernikes {
            let zernikes = modes::zernike_basis(first, last, pupil)?.sampled(pupil)?;
            (basis, dropped) = with_remainders(basis, &zernikes, SMALLEST_REMAINDER, pupil)?;
        }
        let mut with_prior = None;
        if let NollRange::Span { first, last } = recipe.prior_zernikes {
            let (zernikes, before) = (modes::circle_zernikes(first, last, pupil)?.sampled(pupil)?, basis.len());
            (basis, _) = with_remainders(basis, &zernikes, SMALLEST_PRIOR_REMAINDER, pupil)?;
            with_prior = Some((zernikes, basis.len() - before));
        }
        Ok(Self { smooth: Smooth::Maps(basis.maps()), sampled: Some(basis), dropped, with_prior })
    }
}

impl ModeSet {
    /// The NCPA modes of `scene`, behind those of the segments.
    pub(in crate::modal) fn from_scene(
        scene: &System,
        segment: SegmentModes,
        recipe: &Recipe,
        telescope: &Telescope,
        own: &SceneBasis,
    ) -> Result<Self> {
        Self::assemble(segment, NcpaModes::from_scene(scene, recipe, telescope, own)?, recipe, &telescope.pupil)
    }

    /// NCPA modes that the caller gives on the grid of `pupil`, behind those of the segments.
    pub(in crate::modal) fn from_maps(
        segment: SegmentModes,
        ncpa: Basis,
        recipe: &Recipe,
        pupil: &Pupil,
    ) -> Result<Self> {
        Self::assemble(segment, NcpaModes::from_maps(ncpa, recipe, pupil)?, recipe, pupil)
    }

    fn assemble(segment: SegmentModes, ncpa: NcpaModes, recipe: &Recipe, pupil: &Pupil) -> Result<Self> {
        let segment = match segment {
            SegmentModes::None => None,
            // The piston of a mirror of one piece does not change the image.
            SegmentModes::Piston if pupil.segments.len() == 1 => None,
            SegmentModes::Piston => Some(modes::SegmentModes::Piston),
            SegmentModes::PistonTipTilt => Some(modes::SegmentModes::PistonTipTilt),
        };
        let segments = pupil.segments.len();
        let segment_basis = segment.map(|modes| modes.maps(pupil)).transpose()?;
        let mut kinds: Vec<Mode> = Vec::new();
        for motion in 0..segment.map_or(0, modes::SegmentModes::per_segment) {
            kinds.extend((0..segments).map(|s| [Mode::Piston(s), Mode::Tip(s), Mode::Tilt(s)][motion]));
        }
        let NcpaModes { smooth, sampled, dropped, with_prior } = ncpa;
        kinds.extend((0..sampled.as_ref().map_or(0, Basis::len)).map(Mode::Smooth));
        let basis = match (segment_basis, sampled) {
            (Some(segments), Some(ncpa)) => segments.followed_by(ncpa)?,
            (Some(only), None) | (None, Some(only)) => only,
            (None, None) => return Err(Error::Scene("the scene leaves no mode to estimate".into())),
        };
        let prior = match (with_prior, recipe.prior_zernikes) {
            (Some((zernikes, count)), NollRange::Span { first, .. }) => {
                Prior::new(&basis, count, (&zernikes, first), pupil)?
            }
            _ => None,
        };
        Ok(Self { basis, kinds, smooth, dropped, prior })
    }

    /// Whether the smooth modes are given on the scene's grid only.
    pub(in crate::modal) fn is_from_file(&self) -> bool {
        matches!(self.smooth, Smooth::Maps(_))
    }
}

/// The scene's own basis, which takes a second to build: built once for all recipes of a scene.
#[derive(Default)]
pub(in crate::modal) struct SceneBasis(OnceLock<Option<SmoothBasis>>);

impl SceneBasis {
    /// The basis, built at the first call.
    fn get_or_build(&self, scene: &System, telescope: &Telescope) -> Result<Option<SmoothBasis>> {
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

/// Exact Zernikes first, then what the scene's basis adds to them, and the names of its modes that
/// were dropped.
fn functions(
    scene: &System,
    recipe: &Recipe,
    telescope: &Telescope,
    own: &SceneBasis,
) -> Result<(Option<SmoothBasis>, Vec<String>)> {
    let (pupil, count) = (&telescope.pupil, scene.modes.ncpa_count);
    let own = own.get_or_build(scene, telescope)?;
    let exact = match recipe.exact_zernikes {
        NollRange::Span { first, last } => match &scene.modes.ncpa {
            // Together they are a longer basis of the same kind.
            NcpaBasis::Zernike if first <= count + 2 => {
                return Ok((Some(modes::zernike_basis(2, last.max(count + 1), pupil)?), Vec::new()));
            }
            _ => Some(modes::zernike_basis(first, last, pupil)?),
        },
        NollRange::None => None,
    };
    Ok(match (exact, own) {
        (Some(exact), Some(own)) => {
            let joined = modes::join_exact(&exact, &own, pupil, SMALLEST_REMAINDER)?;
            (Some(joined.basis), joined.dropped.into_iter().map(|dropped| dropped.name).collect())
        }
        (exact, own) => (exact.or(own), Vec::new()),
    })
}

/// `before`, then what the petals of `scene` add to them: the last piston, for instance, is in the
/// span of the others and a piston of the pupil.
fn with_petals(before: Option<SmoothBasis>, scene: &System, telescope: &Telescope) -> Result<Option<SmoothBasis>> {
    match (before, telescope.petals(scene.modes.petals)?) {
        (before, None) => Ok(before),
        (before, Some(petals)) => {
            let petals = SmoothBasis::petals(petals);
            let raw = before.map_or_else(|| petals.clone(), |before| before.followed_by(&petals));
            Ok(Some(modes::orthonormalise(&raw, &telescope.pupil, SMALLEST_REMAINDER)?.basis))
        }
    }
}

/// Modes from a FITS file.
fn from_file(path: &std::path::Path, pupil: &Pupil) -> Result<Basis> {
    let mut file = io::FitsReader::open(path)?;
    let maps = file.cube("BASIS")?;
    let names = file.text_column("MODES", "NAME")?;
    let groups = file.text_column("MODES", "GROUP")?;
    let groups = groups.iter().map(|group| Group::parse(group)).collect::<Result<Vec<_>>>();
    let given = groups.and_then(|groups| on_grid(names, groups, maps, pupil)).map_err(|e| Error::file(path, e))?;
    if given.groups().windows(2).any(|pair| pair[0] == Group::Ncpa && pair[1] == Group::Segment) {
        return Err(Error::file(path, "segment modes must come before NCPA modes"));
    }
    Ok(given)
}

/// Modes from a cube `[mode, y, x]` on the grid of `pupil`.
pub(in crate::modal) fn on_grid(
    names: Vec<String>,
    groups: Vec<Group>,
    maps: Array3<f64>,
    pupil: &Pupil,
) -> Result<Basis> {
    let (samples, (_, rows, columns)) = (pupil.grid.samples(), maps.dim());
    if rows != samples || columns != samples {
        return Err(Error::Shape(format!(
            "the modes have {columns}x{rows} samples where the pupil has {samples}x{samples}{}",
            if rows == columns && rows > samples {
                format!("; with pupil.samples = {rows} the model has their grid")
            } else {
                String::new()
            }
        )));
    }
    Basis::from_cube(names, groups, maps)
}

/// `given`, followed by what `zernikes` add to its NCPA modes; and the names of those of which less
/// than `smallest` is left.
fn with_remainders(given: Basis, zernikes: &Basis, smallest: f64, pupil: &Pupil) -> Result<(Basis, Vec<String>)> {
    let (added, dropped) = remainders(&given, zernikes, smallest, pupil);
    if added.is_empty() {
        return Ok((given, dropped));
    }
    let views: Vec<_> = added.iter().map(|(_, map)| map.view()).collect();
    let maps = ndarray::stack(Axis(0), &views).map_err(|error| Error::Internal(error.to_string()))?;
    let names = added.iter().map(|(name, _)| name.clone()).collect();
    Ok((given.followed_by(Basis::from_cube(names, vec![Group::Ncpa; added.len()], maps)?)?, dropped))
}

/// What each extra mode adds to the NCPA modes of `given` (and to the extras before it), at unit
/// RMS over the pupil; and the names of those that add nothing.
fn remainders(given: &Basis, extra: &Basis, smallest: f64, pupil: &Pupil) -> (Vec<(String, Array2<f64>)>, Vec<String>) {
    let root: Array1<f64> = pupil.amplitude.iter().map(|a| (a / pupil.weight_sum()).sqrt()).collect();
    let flat = |basis: &Basis, keep: &dyn Fn(usize) -> bool| -> Vec<Array1<f64>> {
        let maps = basis.maps();
        let kept = maps.outer_iter().enumerate().filter(|(i, _)| keep(*i));
        kept.map(|(_, map)| map.iter().zip(&root).map(|(v, r)| v * r).collect()).collect()
    };
    let mut directions: Vec<Array1<f64>> = Vec::new();
    // Gram-Schmidt with one re-orthogonalisation is accurate to rounding ("twice is enough").
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
        if norm <= smallest * length {
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
