//! Sensor and mirror for the tests: slopes are differences between the corners of lenslets.

use super::{Plant, segment_mask};
use crate::grid::Grid;
use crate::modes::{InfluenceFunctions, karhunen_loeve};
use crate::pupil::Pupil;
use crate::scene::{ControlScene, Scene};
use crate::telescope::Telescope;
use ndarray::{Array2, s};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::OnceLock;

fn preset() -> Scene {
    Scene::preset("keck-onsky").unwrap()
}

/// Lenslets across the preset's grid.
const ACROSS: usize = 20;

/// `[control]` with the given keys.
pub fn scene(keys: &str) -> ControlScene {
    let text = Scene::preset_text("keck-onsky").unwrap();
    let (before, _) = text.split_once("[control]").unwrap();
    let text = format!("{before}[control]\n{keys}\n");
    Scene::from_text(&text, Path::new(".")).unwrap().control.clone().unwrap()
}

/// Pupil of the preset, and the subapertures that are at least half illuminated.
pub fn keck(samples: usize) -> (Pupil, Vec<usize>) {
    sampled(&Telescope::new(&preset()).unwrap(), samples)
}

fn sampled(telescope: &Telescope, samples: usize) -> (Pupil, Vec<usize>) {
    let pupil = telescope.pupil_on(Grid::new(samples, 11.25).unwrap()).unwrap();
    let side = samples / ACROSS;
    let is_half_illuminated = |index: &usize| {
        let (y, x) = (index / ACROSS * side, index % ACROSS * side);
        pupil.amplitude.slice(s![y..y + side, x..x + side]).sum() >= 0.5 * (side * side) as f64
    };
    let subapertures = (0..ACROSS * ACROSS).filter(is_half_illuminated).collect();
    (pupil, subapertures)
}

/// Mask of the preset.
pub fn keck_mask() -> Vec<bool> {
    let (pupil, subapertures) = keck(240);
    segment_mask(&pupil, ACROSS, &subapertures, 0.75).unwrap()
}

/// Owner of the arrays that a plant borrows.
pub struct Bench {
    pub across: usize,
    pub subapertures: Vec<usize>,
    pub mask: Vec<bool>,
    pub interaction: Array2<f64>,
    pub kl: Array2<f64>,
    /// Actuators along a side of the mirror, and the places of those in use.
    pub mirror: (usize, Vec<usize>),
}

impl Bench {
    /// Sensor, mirror and mask of the preset; built once.
    pub fn keck() -> &'static Self {
        static BENCH: OnceLock<Bench> = OnceLock::new();
        BENCH.get_or_init(|| {
            let mut bench = Self::with_segment_side(0.9);
            let scene = preset();
            let telescope = Telescope::new(&scene).unwrap();
            let influence = on_corners(&telescope.influence(&scene).unwrap(), &bench.subapertures);
            let turbulence = Telescope::turbulence(&scene).unwrap();
            let kl = karhunen_loeve(&influence, &telescope.pupil, &turbulence, 250).unwrap();
            bench.kl = kl.basis.matrix().t().to_owned();
            bench
        })
    }

    /// The preset with segments of side `segment_side_m`, without Karhunen-Loève modes.
    pub fn with_segment_side(segment_side_m: f64) -> Self {
        let preset = Scene::preset_text("keck-onsky").unwrap();
        let text = preset.replace("segment_side_m = 0.9", &format!("segment_side_m = {segment_side_m}"));
        let scene = Scene::from_text(&text, Path::new(".")).unwrap();
        let telescope = Telescope::new(&scene).unwrap();
        let (pupil, subapertures) = sampled(&telescope, 240);
        let mask = segment_mask(&pupil, ACROSS, &subapertures, 0.75).unwrap();
        let influence = on_corners(&telescope.influence(&scene).unwrap(), &subapertures);
        let interaction = corner_differences(&influence, ACROSS, &subapertures);
        let kl = Array2::zeros((influence.len(), 0));
        let mirror = (ACROSS + 1, influence.indices().to_vec());
        Self { across: ACROSS, subapertures, mask, interaction, kl, mirror }
    }

    /// A square of 4×4 lenslets and 5×5 actuators, the middle masked.
    pub fn small() -> Self {
        let influence = crate::modes::Mirror::new(5, 0.5625, 0.15).unwrap().all();
        let subapertures: Vec<usize> = (0..16).collect();
        let mask = subapertures.iter().map(|i| [5, 6].contains(i)).collect();
        let interaction = corner_differences(&influence, 4, &subapertures);
        let mirror = (5, influence.indices().to_vec());
        Self { across: 4, subapertures, mask, interaction, kl: Array2::eye(25), mirror }
    }

    pub fn plant(&self) -> Plant<'_> {
        Plant {
            interaction: &self.interaction,
            lenslets_across: self.across,
            subapertures: &self.subapertures,
            mask: &self.mask,
            kl: Some(&self.kl),
            command_matrix: None,
            actuator_grid: Some((self.mirror.0, &self.mirror.1)),
            stroke_limit_nm: None,
        }
    }
}

/// Actuators of the mirror on a corner of a subaperture: the others change no slope.
fn on_corners(influence: &InfluenceFunctions, subapertures: &[usize]) -> InfluenceFunctions {
    let first = subapertures.iter().map(|index| index / ACROSS * (ACROSS + 1) + index % ACROSS);
    let cells: BTreeSet<usize> =
        first.flat_map(|cell| [0, 1, ACROSS + 1, ACROSS + 2].map(|step| cell + step)).collect();
    influence.mirror().at(cells.into_iter().collect()).unwrap()
}

/// Interaction matrix of the mean slopes between the four corners of each lenslet, nm per m.
fn corner_differences(influence: &InfluenceFunctions, across: usize, subapertures: &[usize]) -> Array2<f64> {
    let mirror = influence.mirror();
    let corners = (across + 1) * (across + 1);
    let xs: Vec<f64> = (0..corners).map(|i| mirror.coordinate_m(i % (across + 1))).collect();
    let ys: Vec<f64> = (0..corners).map(|i| mirror.coordinate_m(i / (across + 1))).collect();
    let values = influence.evaluate(&xs, &ys).unwrap();
    let count = subapertures.len();
    Array2::from_shape_fn((2 * count, influence.len()), |(slope, actuator)| {
        let index = subapertures[slope % count];
        let corner = index / across * (across + 1) + index % across;
        let at = |dy: usize, dx: usize| values[[actuator, corner + dy * (across + 1) + dx]];
        let (rise, run) = if slope < count {
            (at(0, 1) + at(1, 1), at(0, 0) + at(1, 0))
        } else {
            (at(1, 0) + at(1, 1), at(0, 0) + at(0, 1))
        };
        (rise - run) / (2.0 * mirror.pitch_m())
    })
}
