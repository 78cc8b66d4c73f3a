//! Interaction matrix of the modelled sensor and mirror, by pushing and pulling actuators.
//!
//! An influence function is exactly 0 beyond a few pitches (`surface`), and a lenslet measures its own samples only. Actuators that share
//! no lenslet are therefore pushed together: with a `period` of lines between them along each axis, period² pairs of measurements take the
//! place of one pair for each actuator, and give the same bits.

use super::footprint::Footprint;
use super::sensor::Sensor;
use super::surface::Surface;
use crate::scene::ReconstructorKind;
use crate::{Result, machine};
use ndarray::Array2;
use std::ops::Range;

/// Stroke with which the interaction matrix is measured, nm: a thirtieth of the sensor's wavelength, so that the
/// response is linear to 1 %. Its second order cancels between push and pull.
const POKE_NM: f32 = 20.0;

/// Arrays of slopes × actuators while the interaction matrix is inverted: the matrix, its copies for the mask and for the
/// decomposition, the singular vectors twice, and the work of the decomposition. Measured with 50 lenslets across: 0.3 GB of 0.46.
const DENSE_COPIES: u64 = 6;
/// The same for a sparse reconstructor: the matrix alone.
const SPARSE_COPIES: u64 = 1;

/// Measures the interaction matrix, `[slopes, actuators]`, mas per nm: pushes and pulls actuators in front of a flat wavefront, without
/// noise.
///
/// # Errors
/// [`crate::Error::Value`] for a matrix whose inversion is larger than the machine's memory.
pub(super) fn interaction(
    sensor: &mut Sensor,
    surface: &mut Surface,
    footprint: &Footprint,
    reconstructor: ReconstructorKind,
) -> Result<Array2<f64>> {
    let (slopes, actuators) = (sensor.slopes(), surface.actuators());
    let copies = match reconstructor {
        ReconstructorKind::Dense => DENSE_COPIES,
        ReconstructorKind::Sparse => SPARSE_COPIES,
    };
    machine::check_memory(
        format_args!("the control of {actuators} actuators by {slopes} slopes"),
        8 * copies * actuators as u64 * (slopes + actuators) as u64,
        "set fewer mirror.actuators_across or wavefront_sensor.lenslets_across",
    )?;
    let lenslets = sensor.lenslets().clone();
    let moved: Vec<Range<usize>> = (0..surface.across())
        .map(|line| {
            let samples = surface.moved_samples(line);
            samples.start / lenslets.samples..samples.end.div_ceil(lenslets.samples)
        })
        .collect();
    let period = period(&moved);
    let mut matrix = Array2::zeros((slopes, actuators));
    let mut command = vec![0.0; actuators];
    let mut measured = [vec![0.0; slopes], vec![0.0; slopes]];
    let mut map = footprint.zeros();
    for group in groups(surface, period) {
        for (sign, measured) in [1.0, -1.0].into_iter().zip(&mut measured) {
            map.fill(0.0);
            command.fill(0.0);
            group.iter().for_each(|&actuator| command[actuator] = sign * POKE_NM);
            surface.add(&command, 1.0, &mut map)?;
            sensor.measure(&map, None, measured)?;
        }
        // The actuator of the group that moves each lenslet.
        let mut mover = vec![None; lenslets.across * lenslets.across];
        for &actuator in &group {
            let place = surface.indices()[actuator];
            for row in moved[place / surface.across()].clone() {
                for column in moved[place % surface.across()].clone() {
                    mover[row * lenslets.across + column] = Some(actuator);
                }
            }
        }
        let count = lenslets.subapertures.len();
        for (slope, (push, pull)) in measured[0].iter().zip(&measured[1]).enumerate() {
            if let Some(actuator) = mover[lenslets.subapertures[slope % count]] {
                matrix[[slope, actuator]] = f64::from(push - pull) / f64::from(2.0 * POKE_NM);
            }
        }
    }
    Ok(matrix)
}

/// Least distance between lines of actuators that move no lenslet in common, whichever the lines; `moved` are the lenslets of each.
fn period(moved: &[Range<usize>]) -> usize {
    let is_apart = |distance: &usize| {
        moved.iter().zip(&moved[*distance..]).all(|(one, other)| one.end <= other.start || other.is_empty())
    };
    (1..moved.len()).find(is_apart).unwrap_or(moved.len()).max(1)
}

/// Actuators of which any two are at least `period` lines apart along one axis.
fn groups(surface: &Surface, period: usize) -> Vec<Vec<usize>> {
    let mut groups = vec![Vec::new(); period * period];
    for (actuator, place) in surface.indices().iter().enumerate() {
        let (row, column) = (place / surface.across(), place % surface.across());
        groups[row % period * period + column % period].push(actuator);
    }
    groups.retain(|group| !group.is_empty());
    groups
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::parts::{actuators, sensor_pupil};
    use crate::ao::sensor::Lenslets;
    use crate::ao::testing::small;
    use crate::telescope::Telescope;

    #[test]
    fn groups_of_actuators_have_the_bits_of_one_after_the_other() {
        for (detector, coupling) in [("quad-cell", "0.1458"), ("pixels", "0.3"), ("geometric", "0.05")] {
            let settings = [("wavefront_sensor.detector", detector), ("mirror.coupling", coupling)];
            let scene = small("", &settings);
            let sensing = scene.wavefront_sensor.as_ref().unwrap();
            let telescope = Telescope::new(&scene).unwrap();
            let pupil = sensor_pupil(&scene, sensing, &telescope, 0).unwrap();
            let footprint = Footprint::new(&pupil);
            let lenslets = Lenslets::new(sensing, &pupil, scene.directory()).unwrap();
            let mut surface = Surface::new(&actuators(&scene, &lenslets).unwrap(), &pupil.grid, &footprint);
            let mut sensor = Sensor::new(sensing, lenslets, &pupil, &footprint).unwrap();
            let matrix = interaction(&mut sensor, &mut surface, &footprint, ReconstructorKind::Dense).unwrap();
            for (actuator, column) in matrix.columns().into_iter().enumerate() {
                let [push, pull] = [POKE_NM, -POKE_NM].map(|stroke_nm| {
                    let mut command = vec![0.0; surface.actuators()];
                    command[actuator] = stroke_nm;
                    let (mut map, mut slopes) = (footprint.zeros(), vec![0.0; sensor.slopes()]);
                    surface.add(&command, 1.0, &mut map).unwrap();
                    sensor.measure(&map, None, &mut slopes).unwrap();
                    slopes
                });
                for ((push, pull), value) in push.iter().zip(&pull).zip(column) {
                    let alone = f64::from(push - pull) / f64::from(2.0 * POKE_NM);
                    assert_eq!(value.to_bits(), alone.to_bits(), "{detector}, actuator {actuator}");
                }
            }
        }
    }

    #[test]
    fn lines_a_period_apart_move_no_lenslet_in_common() {
        let moved = [0..2, 0..3, 1..4, 3..6, 5..6, 7..7];
        let period = period(&moved);
        // 0..2 and 1..4, two lines apart, have lenslet 1 in common.
        assert_eq!(period, 3);
        assert_eq!(super::period(&[0..9, 0..9, 0..9]), 3);
    }
}
