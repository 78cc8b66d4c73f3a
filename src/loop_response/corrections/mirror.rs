//! What the mirror and the sensor's reference slopes have to take up of the NCPA.

use super::errors::NcpaModes;
use crate::Result;
use crate::ao::actuators_in_use;
use crate::loop_response::mirror_fit::MirrorFit;
use crate::modes::Samples;
use crate::pupil::Pupil;
use crate::scene::System;
use crate::telescope::Telescope;
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Position of each actuator, m, and the command, nm, with which the mirror takes the shape of the
/// NCPA `ncpa_nm`: least squares over the pupil. The mirror is subtracted from the wavefront.
pub(super) fn mirror_commands(
    scene: &System,
    telescope: &Telescope,
    modes: &NcpaModes,
    ncpa_nm: &[f64],
) -> Result<Vec<([f64; 2], f64)>> {
    let samples = Samples::from_pupil(&telescope.pupil)?;
    let influence = actuators_in_use(scene, telescope)?;
    let wanted_nm = match modes {
        NcpaModes::Smooth(basis) => ArrayView1::from(ncpa_nm).dot(&basis.evaluate(&samples.xs_m, &samples.ys_m)?),
        NcpaModes::Maps(map_nm) => without_pointing(&telescope.pupil, &samples, &map_nm(ncpa_nm))?,
    };
    let commands_nm =
        MirrorFit::new(&influence, &samples, telescope.pupil.grid)?.commands_nm(wanted_nm.view().insert_axis(Axis(0)));
    let positions_m = influence.positions_m().into_iter().map(|(x_m, y_m)| [x_m, y_m]);
    Ok(positions_m.zip(commands_nm).collect())
}

/// The map at the samples, without piston, tip and tilt.
fn without_pointing(pupil: &Pupil, samples: &Samples, map_nm: &Array2<f64>) -> Result<Array1<f64>> {
    let columns = map_nm.ncols();
    let flat_nm = pupil.remove_piston_tip_tilt(map_nm.view())?;
    Ok(samples.indices.iter().map(|&at| flat_nm[[at / columns, at % columns]]).collect())
}

/// Increments of the sensor's reference slopes with which the loop puts the opposite of the NCPA
/// `ncpa_nm` on the mirror, mas, by the response of the slopes for 1 nm of each mode,
/// `[mode, slope]`.
pub(super) fn reference_slopes(response_mas: &Array2<f64>, ncpa_nm: &[f64]) -> Vec<f64> {
    // A zero of either sign is written as 0.
    (0.0 - ArrayView1::from(ncpa_nm).dot(response_mas)).to_vec()
}
