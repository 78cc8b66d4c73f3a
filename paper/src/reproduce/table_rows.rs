//! The rows of the paper's table, and those that only its text has: a telescope under a sky, and
//! what is different.

use cophase::Result;
use cophase::scene::Scene;

/// What the paper prints for a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Published {
    /// Residuals of phasing and NCPA, nm.
    Residuals([f64; 2]),
    /// That the loop diverges.
    Divergence,
    /// Nothing: it only suggests to do so.
    Nothing,
}

impl Published {
    /// The residuals, or NaN.
    pub fn residuals_nm(self) -> [f64; 2] {
        match self {
            Published::Residuals(residuals_nm) => residuals_nm,
            Published::Divergence | Published::Nothing => [f64::NAN; 2],
        }
    }
}

/// Where the light of a row comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Light {
    /// A source inside, imaged once.
    Inside,
    /// A star behind the loop.
    Star,
}

/// One row.
#[derive(Debug, PartialEq)]
pub struct Row {
    /// Its name in files.
    pub name: &'static str,
    /// What the paper calls it.
    pub method: &'static str,
    /// What the paper found.
    pub published: Published,
    light: Light,
    /// What is different from a plain zonal loop.
    settings: &'static [(&'static str, &'static str)],
}

const MASK: (&str, &str) = ("wavefront_sensor.mask", "segments");
const UNSEEN: (&str, &str) = ("control.fill", "mask-interaction-matrix");
const FILLED: (&str, &str) = ("control.fill", "inpaint");
const KL: (&str, &str) = ("control.basis", "kl");
const LARGER: (&str, &str) = ("mirror.coupling", "0.35");
const POL: (&str, &str) = ("control.loop", "pseudo-open-loop");
const FULL: (&str, &str) = ("control.loop", "full-turbulence-slopes");

const fn filtered(modes: &'static str) -> (&'static str, &'static str) {
    ("control.filtered_modes", modes)
}

/// A row whose loop has these settings beside those of the preset.
pub(super) const fn behind_the_loop(
    name: &'static str,
    method: &'static str,
    published: Published,
    settings: &'static [(&'static str, &'static str)],
) -> Row {
    Row { name, method, published, light: Light::Star, settings }
}

/// The paper's Table 2, in its order.
pub static ROWS: [Row; 8] = [
    Row {
        name: "artificial-source",
        method: "Artificial source, one image",
        published: Published::Residuals([4.4, 7.2]),
        light: Light::Inside,
        settings: &[],
    },
    behind_the_loop("zonal", "AO correction only (zonal)", Published::Residuals([32.1, 25.7]), &[]),
    behind_the_loop("kl", "AO correction only (modal)", Published::Residuals([28.7, 26.9]), &[KL, filtered("30")]),
    behind_the_loop(
        "mask-zonal",
        "AO + WFS mask (zonal)",
        Published::Residuals([56.9, 87.0]),
        &[MASK, UNSEEN, filtered("14")],
    ),
    behind_the_loop(
        "mask-kl",
        "AO + WFS mask (modal)",
        Published::Residuals([37.7, 33.4]),
        &[MASK, UNSEEN, KL, filtered("100")],
    ),
    behind_the_loop(
        "mask-coupling",
        "AO + mask (larger IF)",
        Published::Residuals([21.4, 31.9]),
        // As many as its zonal row drops: that row with another mirror.
        &[MASK, UNSEEN, LARGER, filtered("14")],
    ),
    behind_the_loop("mask-inpaint", "AO + mask + interpolation", Published::Divergence, &[MASK, FILLED]),
    behind_the_loop(
        "pol-mask-inpaint",
        "POL AO + mask + interp.",
        Published::Residuals([21.3, 31.6]),
        &[MASK, FILLED, POL],
    ),
];

/// What the paper's text adds to its last row; and its larger influence functions with as few modes
/// dropped as without a mask, for it does not say how many it dropped.
pub static VARIANTS: [Row; 4] = [
    behind_the_loop(
        "pol-mask-inpaint-kl-2",
        "POL AO + mask + interp. (2 KL)",
        Published::Residuals([21.8, 32.6]),
        &[MASK, FILLED, POL, KL, filtered("2")],
    ),
    behind_the_loop(
        "pol-mask-inpaint-kl-30",
        "POL AO + mask + interp. (30 KL)",
        Published::Residuals([21.1, 30.7]),
        &[MASK, FILLED, POL, KL, filtered("30")],
    ),
    behind_the_loop("full-turbulence-slopes", "full-turbulence slopes", Published::Nothing, &[MASK, FILLED, FULL]),
    behind_the_loop(
        "mask-coupling-2",
        "AO + mask (larger IF), 2 dropped",
        Published::Residuals([21.4, 31.9]),
        &[MASK, UNSEEN, LARGER],
    ),
];

/// Which of the paper's two telescopes: its pupil of 10.49 m does not fit the 0.5625 m of its
/// lenslets.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Segments {
    /// Segments of 0.862 m, a pupil of 10.49 m on the lenslets of one of 11.25 m: reproduces its
    /// rows best.
    #[default]
    Published,
    /// Those of the telescope, 0.9 m.
    Real,
}

impl Segments {
    /// Length of a side, m, as a scene says it.
    pub(super) fn side_m(self) -> &'static str {
        match self {
            Segments::Published => "0.862",
            Segments::Real => "0.9",
        }
    }
}

/// Wavefront sensor of the loop, with the preset that has it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LoopSensor {
    /// The lenslets of the paper: `keck-onsky`.
    #[default]
    Lenslets,
    /// A pyramid on the same telescope under the same turbulence: `keck-pyramid`.
    Pyramid,
}

impl LoopSensor {
    fn preset(self) -> &'static str {
        match self {
            LoopSensor::Lenslets => "keck-onsky",
            LoopSensor::Pyramid => "keck-pyramid",
        }
    }
}

/// What all rows have in common.
#[derive(Debug, Clone, Default)]
pub struct Conditions {
    /// The telescope behind the loop.
    pub segments: Segments,
    /// The sensor of the loop.
    pub sensor: LoopSensor,
    /// Other settings of the scene behind the loop: (key, value).
    pub settings: Vec<(&'static str, &'static str)>,
}

impl Conditions {
    /// The scene behind the loop, as far as the estimator knows it: nothing here hangs on how the
    /// loop is controlled.
    ///
    /// # Errors
    /// [`cophase::Error::Scene`] for settings that the scene does not accept.
    pub fn star(&self) -> Result<Scene> {
        // The paper's images are instantaneous.
        let common = [("image.exposure_s", "0"), ("pupil.segment_side_m", self.segments.side_m())];
        Scene::preset(self.sensor.preset())?.with(&common)?.with(&self.settings)
    }
}

impl Row {
    /// The row of that name, of the table or of the variants.
    pub fn named(name: &str) -> Option<&'static Row> {
        ROWS.iter().chain(&VARIANTS).find(|row| row.name == name)
    }

    /// Whether there is a loop at all.
    pub fn has_loop(&self) -> bool {
        self.light == Light::Star
    }

    /// What makes the images, but for the seed.
    ///
    /// # Errors
    /// As [`Conditions::star`].
    pub fn scene(&self, conditions: &Conditions) -> Result<Scene> {
        match self.light {
            Light::Inside => Scene::preset("keck-artificial"),
            Light::Star => conditions.star()?.with(self.settings),
        }
    }

    /// The estimator's scene. Its modes are those of the real mirror for every mirror of a row, as
    /// in the paper.
    ///
    /// # Errors
    /// As [`Conditions::star`].
    pub fn reading_scene(&self, conditions: &Conditions) -> Result<Scene> {
        match self.light {
            Light::Inside => Scene::preset("keck-artificial"),
            Light::Star => conditions.star(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cophase::scene::{ControlBasis, Fill, Loop, SensorMask};

    #[test]
    fn every_row_is_a_scene_and_no_two_are_the_same() {
        let conditions = Conditions::default();
        let rows: Vec<&Row> = ROWS.iter().chain(&VARIANTS).collect();
        let scenes: Vec<Scene> = rows.iter().map(|row| row.scene(&conditions).unwrap()).collect();
        for (i, (row, scene)) in rows.iter().zip(&scenes).enumerate() {
            assert_eq!(Row::named(row.name), Some(*row));
            assert_eq!(row.has_loop(), scene.control.is_some(), "{}", row.name);
            assert!(scenes[..i].iter().all(|other| **other != **scene), "{}", row.name);
            assert!(rows[..i].iter().all(|other| other.name != row.name));
        }
    }

    #[test]
    fn rows_differ_as_the_paper_says() {
        let conditions = Conditions::default();
        let control = |name: &str| {
            let scene = Row::named(name).unwrap().scene(&conditions).unwrap();
            let (control, sensor) = (scene.control.clone().unwrap(), scene.wavefront_sensor.clone().unwrap());
            (control.basis, control.filtered_modes, control.r#loop, control.fill, sensor.mask, scene.mirror.coupling)
        };
        let (none, mask) = (SensorMask::None, SensorMask::Segments);
        let (zonal, kl) = (ControlBasis::Zonal, ControlBasis::Kl);
        let (closed, unseen) = (Loop::Closed, Fill::MaskInteractionMatrix);
        assert_eq!(control("zonal"), (zonal, Some(2), closed, Fill::None, none, 0.1458));
        assert_eq!(control("kl"), (kl, Some(30), closed, Fill::None, none, 0.1458));
        assert_eq!(control("mask-zonal"), (zonal, Some(14), closed, unseen, mask, 0.1458));
        assert_eq!(control("mask-kl"), (kl, Some(100), closed, unseen, mask, 0.1458));
        assert_eq!(control("mask-coupling"), (zonal, Some(14), closed, unseen, mask, 0.35));
        assert_eq!(control("mask-inpaint"), (zonal, Some(2), closed, Fill::Inpaint, mask, 0.1458));
        assert_eq!(control("pol-mask-inpaint"), (zonal, Some(2), Loop::PseudoOpenLoop, Fill::Inpaint, mask, 0.1458));
        assert_eq!(
            control("full-turbulence-slopes"),
            (zonal, Some(2), Loop::FullTurbulenceSlopes, Fill::Inpaint, mask, 0.1458)
        );
    }

    #[test]
    fn conditions_reach_the_scene_and_the_reader_has_no_loop() {
        let conditions =
            Conditions { segments: Segments::Real, settings: vec![("image.count", "7")], ..Default::default() };
        let row = Row::named("mask-coupling").unwrap();
        let scene = row.scene(&conditions).unwrap();
        assert_eq!((scene.pupil.segment_side_m, scene.image.count, scene.image.exposure_s), (0.9, 7, 0.0));
        assert_eq!(Row::named("kl").unwrap().scene(&Conditions::default()).unwrap().pupil.segment_side_m, 0.862);
        assert_eq!(row.reading_scene(&conditions).unwrap().mirror.coupling, 0.1458);
    }
}
