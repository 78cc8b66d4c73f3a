//! Models of a telescope that the caller gives as arrays: pupil amplitude, segment labels, modes,
//! diversity.

use crate::modal::fitter::{ModalFitter, refuse_budget, refuse_fit_optics, refuse_full_phase, refuse_group};
use crate::modal::model::Model;
use crate::modal::model::memory;
use crate::modal::model::mode_set::{ModeSet, SceneBasis, on_grid};
use crate::modal::model::recipe::Recipe;
use crate::modes::{Basis, Group};
use crate::pupil::Pupil;
use crate::scene::{NcpaBasis, NollRange, SegmentModes, System};
use crate::telescope::{Diversity, MapOnGrid, Telescope, continued};
use crate::{Error, Result};
use ndarray::{Array2, Array3, ArrayViewMut2};

/// Width of the grid where the scene states none. No result depends on it unless the scene has
/// other lengths in metres.
const UNSTATED_WIDTH_M: f64 = 1.0;

/// A telescope, its modes and its diversity as maps of the caller's, in place of the scene's. All
/// are `[y, x]` on one grid of n × n samples, n even, with the axis between the two central ones;
/// the grid is `pupil.grid_m` wide.
#[derive(Debug, Clone)]
pub struct Arrays {
    /// Share of the light that each sample passes, 0 to 1, `[y, x]`.
    pub amplitude: Array2<f64>,
    /// Label of the segment of each sample, `[y, x]`, as
    /// [`Pupil::from_maps`](crate::pupil::Pupil::from_maps) takes them: negative where there is
    /// none; `None` for a telescope of one piece.
    pub segments: Option<Array2<i32>>,
    /// NCPA modes, `[mode, y, x]`, nm for each nm of their coefficients, which keep this order and
    /// this scale; named `mode-1`, `mode-2`, … Values where the amplitude is 0 are ignored, NaN
    /// included.
    pub modes: Option<Array3<f64>>,
    /// Diversity, `[y, x]`, nm. Values where the amplitude is 0 are ignored, NaN included.
    pub diversity_nm: Option<Array2<f64>>,
}

impl ModalFitter {
    /// A fitter for the pupil in `arrays` and the other arrays that it holds; the rest is the
    /// scene's. The scene's own pupil, and its files for which there is an array, are ignored:
    /// [`Scene::for_arrays`](crate::Scene::for_arrays) reads a scene without checking them.
    ///
    /// The arrays have the effect of the same maps in the files `pupil.file`, `modes.file` and
    /// `image.diversity_file`:
    ///
    /// * **Pupil**: one of at least twice `pupil.samples` is averaged onto that grid and
    ///   band-limited ([`Telescope::of_maps`]). `pupil.grid_m` is needed only where lengths matter,
    ///   as for `modes.ncpa = "kl"`, the default.
    /// * **Segment modes** are those of `modes.segment` for the labelled segments, pistons by
    ///   default also with NCPA modes of `arrays`, which hold no segment modes. Without labels
    ///   there are none, because the piston of a single piece does not change the image.
    /// * **NCPA modes** are those of `arrays`, on the grid of `pupil.samples`, else the scene's.
    /// * **Exact Zernikes** join both, unless `modes.exact_zernikes` says otherwise.
    /// * **Diversity** is that of `arrays`, else the scene's.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that are not square, of an even side and of one size;
    /// [`Error::Value`] for an amplitude outside \[0, 1\], a pupil without illuminated samples,
    /// labels that leave out an illuminated sample, modes or a diversity that are not finite at an
    /// illuminated sample, and where no mode is left; [`Error::Scene`] where the scene's basis
    /// cannot be built on this pupil; those of [`Model::new`].
    pub fn from_arrays(scene: &System, arrays: &Arrays) -> Result<Self> {
        refuse_budget(scene)?;
        refuse_fit_optics(scene)?;
        refuse_full_phase(scene)?;
        refuse_group(scene)?;
        let width_m = scene.pupil.grid_m.unwrap_or(UNSTATED_WIDTH_M);
        let telescope = Telescope::of_maps(scene, width_m, arrays.amplitude.clone(), arrays.segments.clone())?;
        let diversity = match &arrays.diversity_nm {
            Some(map) => diversity_from_map(map, arrays, &telescope.pupil)?,
            None => Diversity::new(scene, &telescope)?,
        };
        let recipe = Recipe::from_scene(scene);
        let set = build_modes(scene, arrays, &recipe, &telescope)?;
        let model = Model::assemble(scene, &recipe, false, telescope, &diversity, set)?;
        Self::from_model(scene, recipe, model)
    }
}

fn build_modes(scene: &System, arrays: &Arrays, recipe: &Recipe, telescope: &Telescope) -> Result<ModeSet> {
    let segment = segment_modes(scene, arrays)?;
    if let Some(maps) = &arrays.modes {
        if scene.modes.petals != SegmentModes::None {
            let word = scene.modes.petals.word();
            return Err(Error::Value(format!(
                "modes.petals = \"{word}\" has no meaning with modes as an array; leave one of them out"
            )));
        }
        return ModeSet::from_maps(segment, ncpa_from_maps(maps.clone(), arrays, telescope)?, recipe, &telescope.pupil);
    }
    if scene.modes.ncpa == NcpaBasis::Kl && scene.pupil.grid_m.is_none() {
        let sentence = "'pupil.grid_m' is missing; the width of the pupil's array, in m, is needed by modes.ncpa = \"kl\", the \
                        default; \"zernike\" and \"none\" need none";
        return Err(Error::Scene(sentence.into()));
    }
    let is_without_ncpa = scene.modes.ncpa == NcpaBasis::None
        && recipe.exact_zernikes == NollRange::None
        && scene.modes.petals == SegmentModes::None;
    if segment == SegmentModes::None && is_without_ncpa {
        return Err(Error::Value(
            "there is no mode to estimate: give modes, a modes.ncpa other than \"none\", or the labels of segments with a \
             modes.segment other than \"none\""
                .into(),
        ));
    }
    memory::check_maps(scene, recipe)?;
    ModeSet::from_scene(scene, segment, recipe, telescope, &SceneBasis::default())
}

/// Motions of the labelled segments. Pistons are the scene's default, so that pistons without
/// labels are no error; tips and tilts without labels are one.
fn segment_modes(scene: &System, arrays: &Arrays) -> Result<SegmentModes> {
    match (scene.modes.segment, &arrays.segments) {
        (modes, Some(_)) => Ok(modes),
        (SegmentModes::PistonTipTilt, None) => Err(Error::Value(
            "modes.segment = \"piston-tip-tilt\" needs the labels of the segments, and none are given; give them, or \
             write modes.segment = \"none\""
                .into(),
        )),
        (SegmentModes::None | SegmentModes::Piston, None) => Ok(SegmentModes::None),
    }
}

fn ncpa_from_maps(mut maps: Array3<f64>, arrays: &Arrays, telescope: &Telescope) -> Result<Basis> {
    let count = maps.dim().0;
    if count == 0 {
        return Err(Error::Shape("an array of 0 modes is given; at least one is needed, or no array at all".into()));
    }
    let names: Vec<String> = (1..=count).map(|mode| format!("mode-{mode}")).collect();
    // Another shape is refused by `on_grid`.
    if (maps.dim().1, maps.dim().2) == arrays.amplitude.dim() {
        for (map, name) in maps.outer_iter_mut().zip(&names) {
            check_finite_in_pupil(map, name, &arrays.amplitude)?;
        }
    }
    on_grid(names, vec![Group::Ncpa; count], maps, &telescope.pupil)
}

fn diversity_from_map(map: &Array2<f64>, arrays: &Arrays, pupil: &Pupil) -> Result<Diversity> {
    let ((rows, columns), (samples, _)) = (map.dim(), arrays.amplitude.dim());
    if (rows, columns) != (samples, samples) {
        return Err(Error::Shape(format!(
            "the diversity has {columns}x{rows} samples where the pupil has {samples}x{samples}"
        )));
    }
    check_finite_in_pupil(map.clone().view_mut(), "the diversity", &arrays.amplitude)?;
    let width_m = pupil.grid.width_m();
    Ok(Diversity::Map(MapOnGrid::new(continued(map, width_m, pupil), width_m)?))
}

/// Refuses values that are not finite at illuminated samples, and replaces them by 0 elsewhere:
/// maps are commonly NaN outside the pupil.
fn check_finite_in_pupil(mut map: ArrayViewMut2<f64>, name: &str, amplitude: &Array2<f64>) -> Result<()> {
    for ((y, x), value) in map.indexed_iter_mut().filter(|(_, value)| !value.is_finite()) {
        if amplitude[[y, x]] > 0.0 {
            return Err(Error::Value(format!(
                "{name} is {value} at row {y}, column {x}, where the pupil is illuminated; finite values are needed"
            )));
        }
        *value = 0.0;
    }
    Ok(())
}
