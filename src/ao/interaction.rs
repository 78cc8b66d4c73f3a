//! Interaction matrix of the modelled sensor and mirror, by pushing and pulling actuators.
//!
//! An influence function is exactly 0 beyond some distance (`surface`), and a lenslet measures its
//! own samples only. Actuators that share no lenslet are therefore pushed together: for Gaussian
//! functions some fifty pairs of measurements take the place of one pair for each actuator, and
//! give the same bits. The slopes of a pyramid depend on the whole wavefront: its actuators are
//! pushed one after the other.

use super::footprint::Footprint;
use super::sensor::Sensor;
use super::surface::Surface;
use crate::scene::ReconstructorKind;
use crate::{Result, machine};
use ndarray::Array2;
use std::ops::Range;

/// Stroke with which the interaction matrix is measured, nm: a thirtieth of the sensor's
/// wavelength, so that the response is linear to 1 %. Its second order cancels between push and
/// pull.
const POKE_NM: f32 = 20.0;

/// Arrays of slopes × actuators while the interaction matrix is inverted: the matrix, its copies
/// for the mask and for the decomposition, the singular vectors twice, and the work of the
/// decomposition. Measured with 50 lenslets across: 0.3 GB of 0.46.
const DENSE_COPIES: u64 = 6;
/// The same for a sparse reconstructor: the matrix alone.
const SPARSE_COPIES: u64 = 1;

/// Measures the interaction matrix, `[slopes, actuators]`, mas per nm: pushes and pulls actuators
/// in front of a flat wavefront, without noise.
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
    let moved: Vec<[Range<usize>; 2]> = (0..actuators)
        .map(|actuator| {
            // A pyramid sees an actuator in all pixels.
            let moved = if sensor.is_local() {
                surface.moved(actuator)
            } else {
                [0..footprint.samples(), 0..footprint.samples()]
            };
            moved.map(|samples| samples.start / lenslets.samples..samples.end.div_ceil(lenslets.samples))
        })
        .collect();
    let mut matrix = Array2::zeros((slopes, actuators));
    let mut command = vec![0.0; actuators];
    let mut measured = [vec![0.0; slopes], vec![0.0; slopes]];
    let mut map = footprint.zeros();
    for group in groups(&moved, lenslets.across) {
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
            for cell in cells(&moved[actuator], lenslets.across) {
                mover[cell] = Some(actuator);
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

/// Groups of actuators of which no two move a lenslet in common; `moved` are the rows and columns
/// of lenslets of each, of `across` a side. Each actuator joins the first group that it can join:
/// for functions of one size row by row, that is the fewest groups.
fn groups(moved: &[[Range<usize>; 2]], across: usize) -> Vec<Vec<usize>> {
    let mut groups: Vec<(Vec<usize>, Vec<bool>)> = Vec::new();
    for (actuator, own) in moved.iter().enumerate() {
        let is_free = |(_, taken): &(Vec<usize>, Vec<bool>)| cells(own, across).all(|cell| !taken[cell]);
        let at = groups.iter().position(is_free).unwrap_or_else(|| {
            groups.push((Vec::new(), vec![false; across * across]));
            groups.len() - 1
        });
        let (members, taken) = &mut groups[at];
        members.push(actuator);
        cells(own, across).for_each(|cell| taken[cell] = true);
    }
    groups.into_iter().map(|(members, _)| members).collect()
}

/// Lenslets in these rows and columns, of `across` a side.
fn cells([rows, columns]: &[Range<usize>; 2], across: usize) -> impl Iterator<Item = usize> {
    rows.clone().flat_map(move |row| columns.clone().map(move |column| row * across + column))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::parts::{actuators, sensor_pupil};
    use crate::ao::sensor::Lenslets;
    use crate::ao::testing::small;
    use crate::modes::MeasuredInfluence;
    use crate::telescope::Telescope;

    #[test]
    fn groups_of_actuators_have_the_bits_of_one_after_the_other() {
        for (detector, coupling, is_measured) in [
            ("quad-cell", "0.1458", false),
            ("pixels", "0.3", false),
            ("geometric", "0.05", false),
            ("quad-cell", "0.1458", true),
        ] {
            let settings = [("wavefront_sensor.detector", detector), ("mirror.coupling", coupling)];
            let scene = small("", &settings);
            let sensing = scene.wavefront_sensor.as_ref().unwrap();
            let telescope = Telescope::new(&scene).unwrap();
            let pupil = sensor_pupil(&scene, sensing, &telescope, 0).unwrap();
            let footprint = Footprint::new(&pupil);
            let lenslets = Lenslets::new(sensing, &pupil, scene.directory()).unwrap();
            let mut influence = actuators(&scene, &lenslets, &telescope).unwrap();
            if is_measured {
                let cone = Array2::from_shape_fn((23, 17), |(y, x)| 9.0 - (x as f64 - 8.0).hypot(y as f64 - 11.0));
                let cone = MeasuredInfluence::common(cone.view(), 0.21).unwrap();
                influence = influence.measured(std::sync::Arc::new(cone)).unwrap();
            }
            let mut surface = Surface::new(&influence, &pupil.grid, &footprint);
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
    fn actuators_of_a_group_move_no_lenslet_in_common() {
        // Functions of three lenslets, a lenslet apart, on nine: three groups along each axis.
        let moved: Vec<[Range<usize>; 2]> =
            (0..49).map(|actuator| [actuator / 7, actuator % 7].map(|line| line..line + 3)).collect();
        let found = groups(&moved, 9);
        assert_eq!(found.len(), 9);
        assert_eq!(found.iter().map(Vec::len).sum::<usize>(), 49);
        for group in &found {
            let mut taken: Vec<usize> = group.iter().flat_map(|&actuator| cells(&moved[actuator], 9)).collect();
            let all = taken.len();
            taken.sort_unstable();
            taken.dedup();
            assert_eq!(taken.len(), all);
        }
        // Functions over the whole pupil are measured one after the other.
        assert_eq!(groups(&vec![[0..9, 0..9]; 5], 9), (0..5).map(|actuator| vec![actuator]).collect::<Vec<_>>());
    }
}
