//! Models of a telescope that the caller gives as arrays: pupil amplitude, segment labels, modes, diversity.

use super::fitter::{ModalFitter, refuse_budget, refuse_fit_optics, refuse_full_phase};
use super::mode_set::{ModeSet, SceneBasis, on_grid};
use super::model::Model;
use super::recipe::Recipe;
use crate::modes::Group;
use crate::pupil::Pupil;
use crate::scene::{NcpaBasis, NollRange, PupilModel, Scene, SegmentModes};
use crate::telescope::{Diversity, MapOnGrid, Telescope};
use crate::{Error, Result};
use ndarray::{Array2, Array3, ArrayViewMut2};

/// Width of the grid where the scene states none. No result depends on it unless the scene has other lengths in metres.
const UNSTATED_WIDTH_M: f64 = 1.0;

/// A telescope, its modes and its diversity as maps of the caller's, in place of the scene's. All are `[y, x]` on one
/// grid of n × n samples, n even, with the axis between the two central ones; the grid is `pupil.grid_m` wide.
#[derive(Debug, Clone)]
pub struct Arrays {
    /// Share of the light that each sample passes, 0 to 1, `[y, x]`.
    pub amplitude: Array2<f64>,
    /// Label of the segment of each sample, `[y, x]`, as [`Pupil::from_maps`] takes them: negative where there is none; `None` for a telescope of one piece.
    pub segments: Option<Array2<i32>>,
    /// NCPA modes, `[mode, y, x]`, nm for each nm of their coefficients, which keep this order and this scale; named
    /// `mode-1`, `mode-2`, … Values where the amplitude is 0 are ignored, NaN included.
    pub modes: Option<Array3<f64>>,
    /// Diversity, `[y, x]`, nm. Values where the amplitude is 0 are ignored, NaN included.
    pub diversity_nm: Option<Array2<f64>>,
}

impl ModalFitter {
    /// A fitter for the pupil in `arrays` and the other arrays that it holds; the rest is the scene's. The scene's own pupil,
    /// and its files for which there is an array, are ignored: [`Scene::for_arrays`] reads a scene without checking
    /// them.
    ///
    /// The pupil is used on its own samples, not by `pupil.samples` and `pupil.model`, and `pupil.grid_m` is needed
    /// only where lengths matter (`modes.ncpa = "kl"`).
    ///
    /// * **Segment modes** are those of `modes.segment` for the labelled segments. Without labels there are none, because
    ///   the piston of a single piece does not change the image.
    /// * **NCPA modes** are those of `arrays`; without any, those of `modes.ncpa` or `modes.file` where the scene names
    ///   one of them, else none.
    /// * **Exact Zernikes** join the modes of a caller only where the scene names `modes.exact_zernikes`.
    /// * **Diversity** is that of `arrays`, else the scene's.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that are not square, of an even side and of one size; [`Error::Value`] for an amplitude
    /// outside \[0, 1\], a pupil without illuminated samples, labels that leave out an illuminated sample, modes
    /// or a diversity that are not finite at an illuminated sample, and where no mode is left; [`Error::Scene`] where the scene's basis cannot be built on this
    /// pupil; those of [`Model::new`].
    pub fn from_arrays(scene: &Scene, arrays: &Arrays) -> Result<Self> {
        refuse_budget(scene)?;
        refuse_fit_optics(scene)?;
        refuse_full_phase(scene)?;
        let width_m = scene.pupil.grid_m.unwrap_or(UNSTATED_WIDTH_M);
        let telescope = Telescope::from_maps(width_m, arrays.amplitude.clone(), arrays.segments.clone())?;
        let diversity = match &arrays.diversity_nm {
            Some(map) => diversity_from_map(map.clone(), &telescope.pupil)?,
            None => Diversity::new(scene, &telescope)?,
        };
        let (recipe, set) = build_modes(scene, arrays, &telescope)?;
        let model = Model::assemble(scene, &recipe, false, telescope, &diversity, set)?;
        Self::from_model(scene, recipe, model)
    }
}

/// Builds the modes, and the recipe that goes with them.
fn build_modes(scene: &Scene, arrays: &Arrays, telescope: &Telescope) -> Result<(Recipe, ModeSet)> {
    let pupil = &telescope.pupil;
    let segment = segment_modes(scene, arrays)?;
    let own = arrays.modes.is_none() && (scene.names("modes.ncpa") || scene.names("modes.file"));
    let mut recipe = Recipe::from_scene(scene);
    // A map on the model's own grid has no finer one from which to band-limit it.
    recipe.pupil_model = PupilModel::Hard;
    if !own && scene.modes.exact_zernikes.is_none() {
        recipe.exact_zernikes = NollRange::None;
    }
    if let Some(maps) = &arrays.modes {
        return Ok((
            recipe.clone(),
            ModeSet::from_maps(segment, ncpa_from_maps(maps.clone(), pupil)?, &recipe, pupil)?,
        ));
    }
    let basis = if own && scene.modes.ncpa != NcpaBasis::None { SceneBasis::default() } else { SceneBasis::none() };
    if own && scene.modes.ncpa == NcpaBasis::Kl && scene.pupil.grid_m.is_none() {
        let sentence =
            "'pupil.grid_m' is missing; the width of the pupil's array, in m, is needed by modes.ncpa = \"kl\"";
        return Err(Error::Scene(sentence.into()));
    }
    let nothing = !own || scene.modes.ncpa == NcpaBasis::None;
    if segment == SegmentModes::None && nothing && recipe.exact_zernikes == NollRange::None {
        return Err(Error::Value(
            "there is no mode to estimate: give modes, or the labels of segments with a modes.segment other than \
             \"none\""
                .into(),
        ));
    }
    let set = ModeSet::from_scene(scene, segment, &recipe, telescope, &basis)?;
    Ok((recipe, set))
}

/// Motions of the labelled segments. Pistons are the scene's default, so that pistons without labels are no error; tips and
/// tilts without labels are one.
fn segment_modes(scene: &Scene, arrays: &Arrays) -> Result<SegmentModes> {
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

fn ncpa_from_maps(mut maps: Array3<f64>, pupil: &Pupil) -> Result<crate::modes::Basis> {
    let count = maps.dim().0;
    if count == 0 {
        return Err(Error::Shape("an array of 0 modes is given; at least one is needed, or no array at all".into()));
    }
    let names: Vec<String> = (1..=count).map(|mode| format!("mode-{mode}")).collect();
    // Another shape is refused by `on_grid`.
    if (maps.dim().1, maps.dim().2) == pupil.amplitude.dim() {
        for (map, name) in maps.outer_iter_mut().zip(&names) {
            check_finite_in_pupil(map, name, pupil)?;
        }
    }
    on_grid(names, vec![Group::Ncpa; count], maps, pupil)
}

fn diversity_from_map(mut map: Array2<f64>, pupil: &Pupil) -> Result<Diversity> {
    let (samples, (rows, columns)) = (pupil.grid.samples(), map.dim());
    if (rows, columns) != (samples, samples) {
        return Err(Error::Shape(format!(
            "the diversity has {columns}x{rows} samples where the pupil has {samples}x{samples}"
        )));
    }
    check_finite_in_pupil(map.view_mut(), "the diversity", pupil)?;
    Ok(Diversity::Map(MapOnGrid::new(map, pupil.grid.width_m())?))
}

/// Refuses values that are not finite at illuminated samples, and replaces them by 0 elsewhere: maps are commonly NaN outside
/// the pupil.
fn check_finite_in_pupil(mut map: ArrayViewMut2<f64>, name: &str, pupil: &Pupil) -> Result<()> {
    for ((y, x), value) in map.indexed_iter_mut().filter(|(_, value)| !value.is_finite()) {
        if pupil.amplitude[[y, x]] > 0.0 {
            return Err(Error::Value(format!(
                "{name} is {value} at row {y}, column {x}, where the pupil is illuminated; finite values are needed"
            )));
        }
        *value = 0.0;
    }
    Ok(())
}
