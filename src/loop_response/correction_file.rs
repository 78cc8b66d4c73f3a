//! Corrections from a file, applied to simulated aberrations: what is left when segments and mirror
//! have moved.

use super::corrections::Corrections;
use crate::ao::{Simulator, actuators_in_use};
use crate::io::FitsReader;
use crate::modes::SmoothBasis;
use crate::scene::System;
use crate::source::{Truth, stream};
use crate::telescope::Telescope;
use crate::{Error, Result};
use std::path::Path;

/// Corrections as they are sent: increments of segments and actuators, nm of wavefront.
#[derive(Debug, Clone, PartialEq)]
pub struct SentCorrections {
    /// Of each segment's piston; none where the estimate had none.
    pistons_nm: Vec<f64>,
    /// Of each segment's tip, then of each tilt, nm RMS over the segment; empty where they stay.
    tilts_nm: Vec<f64>,
    /// Of each actuator; empty where the mirror stays.
    actuators_nm: Vec<f64>,
    /// Of the reference slopes, `[all x, all y]`, mas; empty without any.
    reference_mas: Vec<f64>,
}

impl SentCorrections {
    /// Reads the FITS file that [`Corrections::write`] wrote.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read, has neither segments nor actuators, or a
    /// number that is not finite.
    pub fn read(path: &Path) -> Result<Self> {
        let mut file = FitsReader::open(path)?;
        let mut column = |table: &str, name: &str| {
            if file.has_column(table, name) { file.f64_column(table, name) } else { Ok(Vec::new()) }
        };
        let pistons_nm = column("SEGMENTS", "ADD_NM")?;
        let tilts_nm = [column("SEGMENTS", "ADD_TIP_NM")?, column("SEGMENTS", "ADD_TILT_NM")?].concat();
        let actuators_nm = column("ACTUATORS", "ADD_NM")?;
        let reference_mas = [column("REFERENCE", "X_MAS")?, column("REFERENCE", "Y_MAS")?].concat();
        let sent = Self { pistons_nm, tilts_nm, actuators_nm, reference_mas };
        if sent.pistons_nm.is_empty() && sent.actuators_nm.is_empty() {
            let reason = "has no corrections: the tables SEGMENTS or ACTUATORS with the column ADD_NM are needed, as 'cophase estimate \
                          --commands FILE.fits' writes them";
            return Err(Error::file(path, reason));
        }
        let all = [&*sent.pistons_nm, &sent.tilts_nm, &sent.actuators_nm, &sent.reference_mas];
        match all.concat().into_iter().find(|value| !value.is_finite()) {
            Some(value) => Err(Error::file(path, format!("has a correction of {value}: finite numbers are needed"))),
            None => Ok(sent),
        }
    }

    /// The aberrations that remain of `truth`: increments are added to the segments, and the
    /// surface of the mirror is taken off the NCPA.
    ///
    /// # Errors
    /// [`Error::Shape`] for corrections of another number of segments or actuators than `scene`
    /// has; those of building the mirror.
    pub fn apply(&self, truth: Truth, scene: &System, telescope: &Telescope) -> Result<Truth> {
        let truth = self.move_segments(truth, telescope)?;
        if self.actuators_nm.iter().all(|nm| *nm == 0.0) {
            return Ok(truth);
        }
        let influence = actuators_in_use(scene, telescope)?;
        check("actuators", self.actuators_nm.len(), influence.len())?;
        let opposite_nm = self.actuators_nm.iter().map(|nm| -nm).collect();
        truth.with_added_ncpa(telescope, SmoothBasis::influence(influence), opposite_nm)
    }

    /// The AO system of `scene` after the corrections `sent`: segments have moved, and the loop is
    /// closed about reference slopes that have; the mirror is where the loop puts it. Corrections
    /// without reference slopes are taken off the NCPA as [`SentCorrections::apply`] does.
    ///
    /// # Errors
    /// As [`SentCorrections::apply`] and [`Simulator::with_moved_reference`].
    pub fn system(sent: &[Self], scene: &System) -> Result<Simulator> {
        let telescope = Telescope::new(scene)?;
        let seed = scene.seed();
        let mut truth = Truth::draw(scene, &telescope, &mut stream(seed, 0))?;
        let mut moved_mas: Vec<f64> = Vec::new();
        for one in sent {
            if one.reference_mas.is_empty() {
                truth = one.apply(truth, scene, &telescope)?;
                continue;
            }
            truth = one.move_segments(truth, &telescope)?;
            moved_mas.resize(moved_mas.len().max(one.reference_mas.len()), 0.0);
            moved_mas.iter_mut().zip(&one.reference_mas).for_each(|(sum, mas)| *sum += mas);
        }
        if moved_mas.iter().all(|mas| *mas == 0.0) {
            return Simulator::with_truth(scene, telescope, truth);
        }
        Simulator::with_moved_reference(scene, telescope, truth, &moved_mas)
    }

    fn move_segments(&self, truth: Truth, telescope: &Telescope) -> Result<Truth> {
        let mut truth = truth;
        let segments = truth.piston_nm.len();
        if !self.pistons_nm.is_empty() {
            check("segments", self.pistons_nm.len(), segments)?;
            let moved = truth.piston_nm.iter().zip(&self.pistons_nm).map(|(nm, add_nm)| nm + add_nm).collect();
            truth = truth.with_pistons(telescope, moved)?;
        }
        if !self.tilts_nm.is_empty() {
            check("segments' tips and tilts", self.tilts_nm.len(), 2 * segments)?;
            let (tips_nm, tilts_nm) = self.tilts_nm.split_at(segments);
            let added = tips_nm.iter().zip(tilts_nm).zip(&truth.tip_tilt_nm);
            let moved = added.map(|((tip, tilt), before)| [before[0] + tip, before[1] + tilt]).collect();
            truth = truth.with_tilts(telescope, moved)?;
        }
        Ok(truth)
    }
}

impl From<&Corrections> for SentCorrections {
    fn from(corrections: &Corrections) -> Self {
        Self {
            pistons_nm: corrections.pistons_nm.clone(),
            tilts_nm: corrections.tilts_nm.clone(),
            actuators_nm: corrections.actuators_nm.iter().map(|(_, nm)| *nm).collect(),
            reference_mas: corrections.slopes_mas.clone(),
        }
    }
}

fn check(what: &str, given: usize, needed: usize) -> Result<()> {
    if given == needed {
        return Ok(());
    }
    Err(Error::Shape(format!(
        "corrections of {given} {what} were given for a scene with {needed}: the same number is needed"
    )))
}
