//! Model of a scene for modal fits: modes, pupil samples, pixels.

pub(in crate::modal) mod arrays;
pub(in crate::modal) mod band;
pub(in crate::modal) mod device;
pub(in crate::modal) mod memory;
pub(in crate::modal) mod mode_set;
pub(in crate::modal) mod model_cache;
pub(in crate::modal) mod model_memory;
pub(in crate::modal) mod plan;
pub(in crate::modal) mod prior;
pub(in crate::modal) mod recipe;

use super::prepare::Preparation;
use crate::fourier::Sampling;
use crate::imaging::{Mode, Optics, OpticsParts};
use crate::modal::model::mode_set::{ModeSet, SceneBasis};
use crate::modal::model::plan::{PixelPlan, band_limited_weights};
use crate::modal::model::prior::Prior;
use crate::modal::model::recipe::Recipe;
use crate::modes::{self, Basis, Group};
use crate::pupil::{Pupil, SegmentWeights};
use crate::scene::{PupilModel, System};
use crate::telescope::{Diversity, Telescope, pixel_response};
use crate::{Error, Result};
use ndarray::Array2;
use std::sync::Arc;

/// Model of the images of one scene: everything that does not depend on the images.
#[derive(Clone)]
pub struct Model {
    /// The telescope, on the scene's grid.
    pub telescope: Telescope,
    /// The model that the chains run.
    pub optics: Arc<Optics>,
    /// Preparation of frames.
    pub preparation: Preparation,
    /// Names, groups and maps (on the scene's grid, `[mode, y, x]`, nm per nm) of the modes.
    pub basis: Basis,
    /// Mean square of each mode over the pupil, nm² for a coefficient of 1 nm.
    pub(super) mean_squares: Arc<[f64]>,
    /// Number of segment modes; they come first.
    pub segment_modes: usize,
    /// Names of modes that were left out because the others span them.
    pub dropped: Vec<String>,
    /// Prior of the last modes.
    pub(super) prior: Option<Prior>,
    /// Limit of an estimate's memory, bytes.
    pub(super) limit_bytes: usize,
    /// Side of the grid on which the model runs, m.
    grid_width_m: f64,
}

impl Model {
    /// Builds the model of `scene`. `native` forbids the reduction to Nyquist sampling (it would
    /// ring around bad pixels).
    ///
    /// # Errors
    /// Those of the modules below, for files that cannot be read and bases that cannot be built.
    pub fn new(scene: &System, recipe: &Recipe, native: bool) -> Result<Self> {
        Self::with_scene_basis(scene, recipe, native, &SceneBasis::default())
    }

    /// As [`Model::new`], reduced to Nyquist sampling, for a telescope that differs from the
    /// scene's in the amplitudes of its segments only.
    ///
    /// # Errors
    /// As [`Model::new`].
    pub fn with_telescope(scene: &System, recipe: &Recipe, telescope: Telescope) -> Result<Self> {
        memory::check_maps(scene, recipe)?;
        let diversity = Diversity::new(scene, &telescope)?;
        let set = ModeSet::from_scene(scene, scene.modes.segment, recipe, &telescope, &SceneBasis::default())?;
        Self::assemble(scene, recipe, false, telescope, &diversity, set)
    }

    /// As [`Model::new`], with the scene's own basis, which other recipes of the same scene share.
    pub(super) fn with_scene_basis(scene: &System, recipe: &Recipe, native: bool, own: &SceneBasis) -> Result<Self> {
        memory::check_maps(scene, recipe)?;
        let telescope = Telescope::new(scene)?;
        let set = ModeSet::from_scene(scene, scene.modes.segment, recipe, &telescope, own)?;
        Self::with_modes(scene, recipe, native, telescope, set)
    }

    /// As [`Model::new`], for the modes of this scene or of one that differs slightly in its
    /// optical parameters.
    pub(super) fn with_modes(
        scene: &System,
        recipe: &Recipe,
        native: bool,
        telescope: Telescope,
        set: ModeSet,
    ) -> Result<Self> {
        let diversity = Diversity::new(scene, &telescope)?;
        Self::assemble(scene, recipe, native, telescope, &diversity, set)
    }

    /// Assembles the model of these parts; `scene` gives the image and the band limit of the pupil.
    pub(super) fn assemble(
        scene: &System,
        recipe: &Recipe,
        native: bool,
        telescope: Telescope,
        diversity: &Diversity,
        set: ModeSet,
    ) -> Result<Self> {
        scene.refuse_channels("a model and its sessions")?;
        refuse_turns(scene, &telescope)?;
        let band_limited = recipe.pupil_model == PupilModel::BandLimited && telescope.is_fine() && !set.is_from_file();
        let may_be_finer = band_limited && scene.pupil.extent_m().is_some();
        let pixels = PixelPlan::new(scene, recipe, native, (diversity, &telescope.pupil), may_be_finer);
        if let Some(samples) = scene.estimate.samples.filter(|&samples| !band_limited && samples != scene.pupil.samples)
        {
            return Err(Error::Scene(format!(
                "estimate.samples = {samples} needs a band-limited model of a pupil that is known on a finer grid; leave it out, \
                 or name pupil.samples"
            )));
        }
        let (grid, weights) = if band_limited {
            band_limited_weights(scene, &telescope, &pixels)?
        } else if recipe.pupil_model == PupilModel::Area {
            (telescope.pupil.grid, telescope.area_weights(telescope.pupil.grid)?)
        } else {
            (telescope.pupil.grid, telescope.hard_weights())
        };
        let per_lambda_over_d = pixels.per_lambda_over_d * telescope.pupil.grid.width_m() / grid.width_m();
        let light = band::light(scene, &telescope, diversity)?;
        // A pixel is a fixed angle: it spans fewer λ/D where λ is longer.
        let sampling = Sampling::new(grid.samples(), pixels.preparation.pixels, per_lambda_over_d * light.mean)?;
        let points: Vec<(f64, f64)> = weights
            .illuminated
            .iter()
            .map(|&p| (p as usize % grid.samples(), p as usize / grid.samples()))
            .map(|(x, y)| (grid.coordinate_m(x), grid.coordinate_m(y)))
            .collect();
        let slopes = (set.kinds.iter().any(|mode| matches!(mode, Mode::Tip(_))))
            .then(|| slopes(&weights, &points, &telescope.pupil))
            .transpose()?;
        let optics = Optics::new(OpticsParts {
            sampling,
            wavelength_nm: scene.image.wavelength_nm * light.mean,
            colours: light.colours,
            pixel: [0, 1].map(|axis| pixel_response(scene).in_pixels_of(pixels.preparation.native_along(axis))),
            slopes,
            diversity_nm: points.iter().map(|&(x, y)| diversity.at(x, y)).collect(),
            basis: set.smooth.at(&points, &weights)?,
            products: set.smooth.products(grid)?,
            modes: set.kinds,
            weights,
        })?;
        Self {
            mean_squares: set.basis.mean_squares(&telescope.pupil.amplitude)?.into(),
            telescope,
            optics: Arc::new(optics),
            preparation: pixels.preparation,
            segment_modes: set.basis.groups().iter().filter(|group| **group == Group::Segment).count(),
            basis: set.basis,
            dropped: set.dropped,
            prior: set.prior,
            limit_bytes: memory::limit_bytes(scene),
            grid_width_m: grid.width_m(),
        }
        .within_memory()
    }

    /// This model with `factor` times the diversity.
    ///
    /// # Errors
    /// Those of [`Optics::new`].
    pub(super) fn with_diversity_times(&self, factor: f64) -> Result<Self> {
        let mut parts = self.optics.parts().clone();
        parts.diversity_nm.iter_mut().for_each(|nm| *nm *= factor);
        Ok(Self { optics: Arc::new(Optics::new(parts)?), ..self.clone() })
    }

    /// Width of the model's grid over that of the scene's.
    pub fn width_ratio(&self) -> f64 {
        self.grid_width_m / self.telescope.pupil.grid.width_m()
    }

    /// The map of some of the modes, `[y, x]`, nm, NaN outside the pupil.
    pub fn map_nm(&self, coefficients_nm: &[f64], group: Group) -> Array2<f64> {
        self.outside_to_nan(self.basis.combined(coefficients_nm, self.modes_of(group)))
    }

    /// Number of segment pistons; they are the first modes.
    pub(crate) fn pistons(&self) -> usize {
        let names = self.basis.names().iter().take(self.segment_modes);
        names.take_while(|name| name.ends_with("-piston")).count()
    }

    /// The modes of a group.
    pub fn modes_of(&self, group: Group) -> std::ops::Range<usize> {
        match group {
            Group::Segment => 0..self.segment_modes,
            Group::Ncpa => self.segment_modes..self.basis.len(),
        }
    }

    /// `map` with NaN outside the pupil.
    pub fn outside_to_nan(&self, mut map: Array2<f64>) -> Array2<f64> {
        ndarray::Zip::from(&mut map).and(&self.telescope.pupil.owner).for_each(|value, &owner| {
            if owner < 0 {
                *value = f64::NAN;
            }
        });
        map
    }
}

/// Refuses turns of the pupil that `telescope` does not have.
///
/// # Errors
/// [`Error::Scene`].
fn refuse_turns(scene: &System, telescope: &Telescope) -> Result<()> {
    let Some(turn_deg) = scene.image.pupil_turn_deg() else {
        return Err(Error::Scene(format!(
            "{}: image.pupil_turns_deg has one number for each image, and a model, its sessions and the watch have one turn of the pupil: a list of \
             one is needed there; 'cophase estimate' and pipeline::Estimator take one for each image",
            scene.name()
        )));
    };
    if turn_deg != telescope.turn_deg() {
        return Err(Error::Scene(format!(
            "{}: image.pupil_turns_deg = [{turn_deg}] is not accepted for a pupil that is given as an array: turn the array",
            scene.name()
        )));
    }
    Ok(())
}

/// Coordinates of each entry on its segment, in units of the segment's RMS.
pub(super) fn slopes(weights: &SegmentWeights, points: &[(f64, f64)], pupil: &Pupil) -> Result<(Vec<f64>, Vec<f64>)> {
    let frames = modes::tilt_frames_of_lit(pupil)?;
    let mut slopes = (Vec::new(), Vec::new());
    for ((_, segments, _), &(x, y)) in weights.rows().zip(points) {
        for &segment in segments {
            let [tip, tilt] = frames[segment as usize].tilts([x, y]);
            slopes.0.push(tip);
            slopes.1.push(tilt);
        }
    }
    Ok(slopes)
}
