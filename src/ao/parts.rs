//! Actuators and segment map that a simulator is built from.

use super::aligned::AlignedBuffer;
use super::footprint::Footprint;
use super::sensor::Lenslets;
use crate::Result;
use crate::machine;
use crate::modes::InfluenceFunctions;
use crate::pupil::{Grid, Pupil};
use crate::scene::{SensorScene, System};
use crate::source::Truth;
use crate::telescope::Telescope;

/// Memory of a simulation for each sample of its grid, bytes, without the layers of turbulence: the
/// pupil and its copy (24), the maps of loop and camera, and the weights of the segments (the
/// field's share in the peak). Measured with Keck's loop at 1,280 samples a side: 150 with one
/// layer, 180 with seven.
const BYTES_PER_SAMPLE: u64 = 150;
/// Memory of a layer for each sample: its ring is stored twice where the wind blows along x, and
/// twice as wide across a wind of 45 degrees.
const BYTES_PER_LAYER_SAMPLE: u64 = 16;

/// Pupil of `scene` on the grid of its sensor, `wavefront_sensor.samples_per_lenslet` samples
/// across each lenslet, for a simulation of `layers` layers of turbulence.
///
/// # Errors
/// [`crate::Error::Value`] for a grid that is larger than the machine's memory; those of
/// [`Telescope::pupil_on`].
pub fn sensor_pupil(scene: &System, sensing: &SensorScene, telescope: &Telescope, layers: usize) -> Result<Pupil> {
    let samples = sensing.lenslets_across * sensing.samples_per_lenslet;
    machine::check_memory(
        format_args!(
            "{}: an AO system of {samples}x{samples} samples with {layers} layers of turbulence",
            scene.name()
        ),
        (BYTES_PER_SAMPLE + BYTES_PER_LAYER_SAMPLE * layers as u64) * (samples as u64).pow(2),
        "set fewer wavefront_sensor.samples_per_lenslet or lenslets_across",
    )?;
    telescope.pupil_on(Grid::new(samples, telescope.pupil.grid.width_m())?)
}

/// Actuators of the scene's mirror that are in use, in the order of the tables ACTUATORS: those of
/// its map, or those at a corner of a subaperture in use; without a wavefront sensor those near the
/// pupil.
///
/// # Errors
/// [`crate::Error::File`] for a map of actuators or influence functions that cannot be read; those
/// of building the pupil and the lenslets.
pub fn actuators_in_use(scene: &System, telescope: &Telescope) -> Result<InfluenceFunctions> {
    if let Some(mapped) = Telescope::mapped_actuators(scene)? {
        return telescope.measured_influence(scene, mapped);
    }
    let Some(sensing) = &scene.wavefront_sensor else { return telescope.influence(scene) };
    actuators(
        scene,
        &Lenslets::new(sensing, &sensor_pupil(scene, sensing, telescope, 0)?, scene.directory())?,
        telescope,
    )
}

/// Actuators of the scene's mirror that are in use: those of its map, or those at a corner of a
/// subaperture in use. The sensor measures an actuator farther out only at the edge of a
/// subaperture, and the noise of its command would be a hundred times that of the others.
pub(crate) fn actuators(scene: &System, lenslets: &Lenslets, telescope: &Telescope) -> Result<InfluenceFunctions> {
    let chosen = match Telescope::mapped_actuators(scene)? {
        Some(mapped) => mapped,
        None => at_subapertures(scene, lenslets)?,
    };
    telescope.measured_influence(scene, chosen)
}

/// Actuators at a corner of a subaperture in use.
fn at_subapertures(scene: &System, lenslets: &Lenslets) -> Result<InfluenceFunctions> {
    let mirror = Telescope::mirror(scene)?;
    let middle = (lenslets.across as f64 - 1.0) / 2.0;
    let centre = |i: usize| (i as f64 - middle) * lenslets.pitch_m;
    // An actuator is at a corner of the subapertures within half a lenslet, and where lenslets are
    // finer than the actuators, of all within a pitch: without them the rim of the pupil would be
    // out of control. Rounding must not decide.
    let reach_m = (0.501 * lenslets.pitch_m).max(mirror.pitch_m() - 0.499 * lenslets.pitch_m);
    mirror.select(|x_m, y_m| {
        let is_near = |&place: &usize| {
            (centre(place % lenslets.across) - x_m).abs() <= reach_m
                && (centre(place / lenslets.across) - y_m).abs() <= reach_m
        };
        lenslets.subapertures.iter().any(is_near)
    })
}

/// Multiplies the pupil amplitude by the amplitude that each segment reflects.
pub(super) fn apply_reflectivity(pupil: &Pupil, truth: &Truth) -> Pupil {
    let mut reflecting = pupil.clone();
    ndarray::Zip::from(&mut reflecting.amplitude).and(&pupil.owner).for_each(|amplitude, &owner| {
        if owner >= 0 {
            *amplitude *= truth.amplitude[owner as usize];
        }
    });
    reflecting
}

/// Map of the segment errors, nm: each sample takes the error of the segment that owns it.
pub(super) fn segments_nm(truth: &Truth, telescope: &Telescope, pupil: &Pupil, footprint: &Footprint) -> AlignedBuffer {
    let mut map = footprint.zeros();
    for ((y, x), owner) in pupil.owned_samples() {
        let (x_m, y_m) = (pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
        map[y * footprint.stride() + x] = truth.segment_nm(&telescope.pupil, owner, x_m, y_m) as f32;
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    fn finer_subapertures_leave_the_actuators_at_the_rim_in_use() {
        let count = |keys: &[(&str, &str)]| {
            let scene = Scene::preset("keck-onsky").unwrap().with(keys).unwrap();
            actuators_in_use(&scene, &Telescope::new(&scene).unwrap()).unwrap().len()
        };
        let (usual, fine) = (
            count(&[]),
            count(&[("wavefront_sensor.lenslets_across", "40"), ("wavefront_sensor.samples_per_lenslet", "6")]),
        );
        // The same mirror; a lenslet in use has half of its light, which along the rim of the pupil
        // selects some differently.
        assert_eq!(usual, 296);
        assert!(fine.abs_diff(usual) < 20, "{fine} {usual}");
    }
}
