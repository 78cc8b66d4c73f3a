//! The rows: sequences, what is known of the loop, and what may be wrong.

use super::HeldMap;
use crate::reproduce::{Conditions, Row};
use cophase::scene::Scene;
use cophase::source::{Truth, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::Array2;
use std::borrow::Cow;
use std::path::Path;

type Settings = &'static [(&'static str, &'static str)];

/// A row of the table.
#[derive(Debug, Clone, PartialEq)]
pub struct BeyondRow {
    /// Its name.
    pub name: Cow<'static, str>,
    /// The row of the paper's table whose loop it has.
    pub row: &'static str,
    /// The row whose loop the pistons are estimated behind, and corrected, before anything else:
    /// the paper's two steps.
    pub first: Option<&'static str>,
    /// What is different in what makes the images, and in what reads them.
    pub made: Settings,
    /// Beside `made`, what is different in what reads them.
    pub read: Settings,
    /// Measured NCPA in place of drawn ones.
    pub map: Option<HeldMap>,
}

const fn row(name: &'static str, loop_row: &'static str, made: Settings, read: Settings) -> BeyondRow {
    BeyondRow { name: Cow::Borrowed(name), row: loop_row, first: None, made, read, map: None }
}

/// Images that are read by a scene like the one that made them.
const fn same(name: &'static str, loop_row: &'static str, made: Settings) -> BeyondRow {
    row(name, loop_row, made, &[])
}

/// The zonal loop with `made` in the images and `read` in the reader.
const fn zonal(name: &'static str, made: Settings, read: Settings) -> BeyondRow {
    row(name, "zonal", made, read)
}

const LOOP: Settings = &[("estimate.ao_knowledge", "loop")];

/// The row against whose χ² the others' is held.
pub(super) const NOMINAL: &str = "75 images";

/// All rows but those of measured maps.
pub static BEYOND_ROWS: [BeyondRow; 39] = [
    same(NOMINAL, "zonal", &[]),
    same("25 images", "zonal", &[("image.count", "25")]),
    same("10 images", "zonal", &[("image.count", "10")]),
    same("pol + mask", "pol-mask-inpaint", &[]),
    same("kl, 30 dropped", "kl", &[]),
    same("128 nm", "zonal", &[("aberrations.segment_piston_rms_nm", "128.3")]),
    same("star 100 times fainter", "zonal", &[("image.peak_snr", "40")]),
    zonal("known loop", &[], LOOP),
    zonal("known spectrum", &[], &[("estimate.ao_knowledge", "spectrum")]),
    zonal("no AO knowledge", &[], &[("estimate.ao_knowledge", "nothing")]),
    row("pol + mask, known loop", "pol-mask-inpaint", &[], LOOP),
    zonal("10 images, known loop", &[("image.count", "10")], LOOP),
    BeyondRow {
        name: Cow::Borrowed("NCPA in two steps"),
        row: "zonal",
        first: Some("pol-mask-inpaint"),
        made: &[],
        read: &[],
        map: None,
    },
    zonal("r0 30 % too large", &[], &[("turbulence.r0_m", "0.208")]),
    zonal("wind 50 % too fast", &[], &[("turbulence.wind_m_s", "[10.2, 10.35, 10.65, 11.25, 15.0, 40.35, 27.75]")]),
    zonal("wind from one side", &[], &[("turbulence.wind_dir_rad", "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]")]),
    zonal(
        "slopes 10 % too small",
        &[("wavefront_sensor.slope_gain", "0.9")],
        &[("wavefront_sensor.slope_gain", "1.0")],
    ),
    zonal(
        "lenslets shifted by a tenth",
        &[("wavefront_sensor.shift_subapertures", "[0.1, 0.0]")],
        &[("wavefront_sensor.shift_subapertures", "[0.0, 0.0]")],
    ),
    same("lenslets shifted, known", "zonal", &[("wavefront_sensor.shift_subapertures", "[0.1, 0.0]")]),
    zonal("mirror's pitch 1 % too large", &[], &[("mirror.pitch_m", "0.568")]),
    same("10 ms exposures", "zonal", &[("image.exposure_s", "0.010")]),
    zonal("1.5 % bandwidth", &[("image.bandwidth_fraction", "0.015")], &[("image.bandwidth_fraction", "0")]),
    same("1.5 % bandwidth, known", "zonal", &[("image.bandwidth_fraction", "0.015")]),
    // What a scene says of a simulated detector, of reflectivities and of a drift, no reader asks.
    same("pixel responses of 2 %", "zonal", &[("faults.pixel_response_rms", "0.02")]),
    zonal("pixels that are squares", &[("image.pixel_fill", "1.0")], &[("image.pixel_fill", "0")]),
    same("pixels that are squares, known", "zonal", &[("image.pixel_fill", "1.0")]),
    zonal("2 % defocus error", &[], &[("image.diversity_focus_waves_rms", "1.53")]),
    zonal(
        "2 % defocus error, known to 2 %",
        &[],
        &[("image.diversity_focus_waves_rms", "1.53"), ("tolerance.defocus_fraction", "0.02")],
    ),
    same("segment tilts of 20 nm", "zonal", &[("aberrations.segment_tip_tilt_rms_nm", "20")]),
    // 75 images take 22.5 s.
    same("drift of 20 nm", "zonal", &[("faults.drift_nm_per_min", "53.3")]),
    zonal("plate scale off 0.5 %", &[], &[("image.samples_per_lambda_over_d", "2.01")]),
    zonal("plate scale off 1 %", &[], &[("image.samples_per_lambda_over_d", "2.02")]),
    same("reflectivities of 5 %", "zonal", &[("faults.segment_reflectivity_rms", "0.05")]),
    // 5 % of amplitude.
    same("reflectivities of 10 %", "zonal", &[("faults.segment_reflectivity_rms", "0.10")]),
    zonal("spiders not in the model", &[("pupil.spider_width_m", "0.0254")], &[("pupil.spider_width_m", "0")]),
    zonal(
        "obscuration not in the model",
        &[("pupil.central_obscuration_m", "2.48")],
        &[("pupil.central_obscuration_m", "0")],
    ),
    same("spiders in both", "zonal", &[("pupil.spider_width_m", "0.0254")]),
    same("obscuration in both", "zonal", &[("pupil.central_obscuration_m", "2.48")]),
    same("200 images", "zonal", &[("image.count", "200")]),
];

/// Images of a sequence unless the row says otherwise.
const IMAGES: &str = "75";

impl BeyondRow {
    /// The row of this name.
    ///
    /// # Errors
    /// [`Error::Value`] for a name that no row has.
    pub fn named(name: &str) -> Result<&'static BeyondRow> {
        BEYOND_ROWS.iter().find(|row| row.name == name).ok_or_else(|| {
            let names: Vec<&str> = BEYOND_ROWS.iter().map(|row| &*row.name).collect();
            Error::Value(format!("no row is called '{name:.60}': {} are accepted", names.join("; ")))
        })
    }

    /// What makes the images of draw `seed`, behind the loop of `loop_row`.
    ///
    /// # Errors
    /// [`Error::Scene`] for settings that the scene does not accept.
    pub(super) fn made(&self, loop_row: &str, conditions: &Conditions, seed: usize) -> Result<Scene> {
        let row = Row::named(loop_row).ok_or_else(|| Error::Internal(format!("there is no row {loop_row}")))?;
        let seed = seed.to_string();
        let seeds = [("image.count", IMAGES), ("aberrations.seed", &*seed), ("turbulence.seed", &*seed)];
        let scene = row.scene(conditions)?.with(&seeds)?.with(&conditions.settings)?.with(self.made)?;
        self.map.as_ref().map_or(Ok(scene.clone()), |map| with_map(&scene, &map.whole))
    }

    /// The NCPA that an estimate is held against, where those of `made` have more than any mode of
    /// the mirror.
    pub(super) fn held_nm(&self, made: &Scene) -> Result<Option<Array2<f64>>> {
        let Some(map) = &self.map else { return Ok(None) };
        let (held, telescope) = (with_map(made, &map.held)?, Telescope::new(made)?);
        Ok(Some(Truth::draw(&held, &telescope, &mut stream(0, 0))?.ncpa_nm))
    }

    /// What reads images that `made` has made.
    ///
    /// # Errors
    /// As [`BeyondRow::made`].
    pub(super) fn reader(&self, made: &Scene) -> Result<Scene> {
        made.with(&[("estimate.method", "full-phase")])?.with(self.read)
    }
}

/// `scene` with the NCPA of a map.
fn with_map(scene: &Scene, map: &Path) -> Result<Scene> {
    scene.with(&[
        ("aberrations.ncpa_rms_nm", ""),
        ("aberrations.ncpa_zernikes", ""),
        ("aberrations.ncpa_power_law", ""),
        ("aberrations.ncpa_file", &map.display().to_string()),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_a_scene_that_can_be_read() {
        for row in &BEYOND_ROWS {
            for loop_row in [Some(row.row), row.first].into_iter().flatten() {
                let made = row.made(loop_row, &Conditions::default(), 3).unwrap();
                assert_eq!(made.turbulence.seed, 3);
                let read = row.reader(&made).unwrap();
                // A row that reads otherwise reads something else, and one name is one row.
                assert_eq!(row.read.is_empty(), row.read.iter().all(|_| *read == *made), "{}", row.name);
            }
            assert_eq!(BeyondRow::named(&row.name).unwrap(), row);
        }
        assert!(BeyondRow::named("75").is_err());
    }
}
