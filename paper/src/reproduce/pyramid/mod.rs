//! The paper's table behind a pyramid sensor: residuals of modal fits and of full-phase estimates,
//! and the leak of the segments into the mirror.
//!
//! ```text
//! rows ─ on_sky ─┬─ draws (modal fits, as in the paper's table; full-phase estimate) ─┬─ table
//!                └─ leak (mean mirror with segments less that without them) ──────────┘
//! ```

mod draws;
mod leak;
mod table;

pub use draws::{FullPhaseReading, PyramidDraw};
pub use leak::{PyramidLeak, PyramidLeakRow};
pub use table::PyramidTable;

use super::on_sky::{Reader, sequence_draws};
use super::table_rows::{Conditions, LoopSensor, Published, Row, behind_the_loop};
use super::{Progress, RowResult};
use cophase::{Error, Result};

/// Images of a sequence, as of the rows of `beyond`, and their distance. Between images the
/// wavefront behind the loop decorrelates: a lenslet's width passes in 0.1 s at the slowest wind.
/// The paper's 0.3 s would take half as many frames again.
const SETTINGS: [(&str, &str); 2] = [("image.count", "75"), ("image.interval_s", "0.2")];

/// The rows of images.
pub static PYRAMID_ROWS: [Row; 5] = [
    behind_the_loop("kl", "Karhunen-Loève control", Published::Nothing, &[]),
    behind_the_loop("zonal", "zonal control", Published::Nothing, &[("control.basis", "zonal")]),
    behind_the_loop("exposures", "exposures of 10 ms", Published::Nothing, &[("image.exposure_s", "0.010")]),
    behind_the_loop(
        "modulation-3",
        "modulation of 3 lambda/D",
        Published::Nothing,
        &[("wavefront_sensor.modulation_lambda_over_d", "3.0")],
    ),
    behind_the_loop("r0-10-cm", "r0 of 10 cm", Published::Nothing, &[("turbulence.r0_m", "0.10")]),
];

/// Name of the part without images.
const LEAK: &str = "leak";
/// Rows of images of a quick look.
const QUICK_ROWS: usize = 2;

/// What is made: rows of images, and whether the leak is.
#[derive(Debug, Clone, PartialEq)]
pub struct PyramidParts {
    rows: Vec<&'static Row>,
    has_leak: bool,
}

impl PyramidParts {
    /// The parts of these names: those of [`PYRAMID_ROWS`] and `leak`; none are all, of a quick
    /// look the first two rows and the leak.
    ///
    /// # Errors
    /// [`Error::Value`] for another name.
    pub fn named(names: &[String], is_quick: bool) -> Result<Self> {
        if names.is_empty() {
            let count = if is_quick { QUICK_ROWS } else { PYRAMID_ROWS.len() };
            return Ok(Self { rows: PYRAMID_ROWS.iter().take(count).collect(), has_leak: true });
        }
        let row = |name: &&String| {
            PYRAMID_ROWS.iter().find(|row| row.name == **name).ok_or_else(|| {
                let known = PYRAMID_ROWS.iter().map(|row| row.name).chain([LEAK]).collect::<Vec<_>>().join(", ");
                Error::Value(format!("no row of pyramid is called '{name:.60}': {known} are accepted"))
            })
        };
        let rows = names.iter().filter(|name| *name != LEAK).map(|name| row(&name)).collect::<Result<_>>()?;
        Ok(Self { rows, has_leak: names.iter().any(|name| name == LEAK) })
    }
}

/// Draws 1 to `seeds` of the rows and of the leak behind the pyramid of `keck-pyramid`.
///
/// # Errors
/// Those of the simulator and of the estimators; [`Error::Interrupted`].
pub fn pyramid(
    parts: &PyramidParts,
    conditions: &Conditions,
    seeds: usize,
    is_quick: bool,
    progress: &Progress,
) -> Result<PyramidTable> {
    progress.check()?;
    // Settings of the caller, such as those of a quick look, come last.
    let settings = SETTINGS.into_iter().chain(conditions.settings.iter().copied()).collect();
    let conditions = &Conditions { sensor: LoopSensor::Pyramid, settings, ..conditions.clone() };
    let leaks = if parts.has_leak { leak::cases(conditions, is_quick)? } else { Vec::new() };
    let scene = conditions.star()?;
    let steps = draws::PASSES * scene.image.count;
    progress.expect(seeds * (parts.rows.len() * steps + leaks.len() * leak::STEPS));
    let readers = if parts.rows.is_empty() { Vec::new() } else { Reader::both(&scene)? };
    let found = sequence_draws((&parts.rows, seeds), conditions, (progress, steps), |row, seed, sequence| {
        PyramidDraw::read(&row.scene(conditions)?, seed, &sequence, &readers, progress)
    })?;
    let of_row = |row: &&'static Row| {
        let of_row = found.iter().filter(|(of, _)| of == row).map(|(_, draw)| draw.clone());
        let (modal, full_phase) = of_row.map(|draw| (draw.modal, draw.full_phase)).unzip();
        (RowResult::new(row, &scene, modal), full_phase)
    };
    let (modal, full_phase) = parts.rows.iter().map(of_row).unzip();
    Ok(PyramidTable { modal: super::OnSky { rows: modal }, full_phase, leak: leak::leak(&leaks, seeds, progress)? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_different_scenes_of_a_pyramid_and_are_found_by_name() {
        let conditions = Conditions { sensor: LoopSensor::Pyramid, ..Conditions::default() };
        let scenes: Vec<_> = PYRAMID_ROWS.iter().map(|row| row.scene(&conditions).unwrap()).collect();
        for (i, (row, scene)) in PYRAMID_ROWS.iter().zip(&scenes).enumerate() {
            assert!(scene.wavefront_sensor.as_ref().unwrap().is_pyramid(), "{}", row.name);
            assert!(scenes[..i].iter().all(|other| **other != **scene), "{}", row.name);
            let named = PyramidParts::named(&[row.name.into()], false).unwrap();
            assert_eq!(named, PyramidParts { rows: vec![row], has_leak: false });
        }
        let all = PyramidParts::named(&[], false).unwrap();
        assert_eq!((all.rows.len(), all.has_leak), (PYRAMID_ROWS.len(), true));
        let error = PyramidParts::named(&["k".into()], false).unwrap_err().to_string();
        assert!(error.contains("'k'") && error.contains("kl, zonal") && error.contains(LEAK), "{error}");
    }
}
