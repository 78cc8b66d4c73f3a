//! What the figures share: the paper's loops, its pupil, a calm sky, maps.

use crate::Result;
use crate::ao::Simulator;
use crate::plot::{CaptionedMap, MapScale};
use crate::pupil::Pupil;
use crate::scene::Scene;
use ndarray::Array2;

/// Segments whose pupil is 10.49 m across, as the paper's is, on the lenslets that it names, m.
pub(super) const PAPER_SIDE_M: f64 = 0.862;

/// The zonal loops of section 4.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoopKind {
    /// All subapertures, an integrator.
    Plain,
    /// Subapertures that straddle segments are left out of the interaction matrix.
    Masked,
    /// Pseudo-open-loop, the slopes of those subapertures inpainted.
    Inpainted,
}

impl LoopKind {
    /// In the order of the paper.
    pub const ALL: [LoopKind; 3] = [LoopKind::Plain, LoopKind::Masked, LoopKind::Inpainted];

    /// A word for tables.
    pub fn name(self) -> &'static str {
        match self {
            LoopKind::Plain => "zonal",
            LoopKind::Masked => "mask-zonal",
            LoopKind::Inpainted => "pol-mask-inpaint",
        }
    }

    /// `scene` with this loop; the modes that are dropped are the paper's.
    ///
    /// # Errors
    /// Those of [`Scene::with`].
    pub fn of(self, scene: &Scene) -> Result<Scene> {
        let (mask, r#loop, fill, filtered) = match self {
            LoopKind::Plain => ("none", "closed", "none", "2"),
            LoopKind::Masked => ("segments", "closed", "mask-interaction-matrix", "14"),
            LoopKind::Inpainted => ("segments", "pseudo-open-loop", "inpaint", "2"),
        };
        scene.with(&[
            ("wavefront_sensor.mask", mask),
            ("control.basis", "zonal"),
            ("control.loop", r#loop),
            ("control.fill", fill),
            ("control.condition_number", ""),
            ("control.filtered_modes", filtered),
        ])
    }
}

/// The scene of section 4.
pub(super) fn on_sky() -> Result<Scene> {
    Scene::preset("keck-onsky")
}

/// `scene` with the draw `seed` of aberrations and of everything else that chance decides.
pub(super) fn with_seed(scene: &Scene, seed: usize) -> Result<Scene> {
    let seed = seed.to_string();
    scene.with(&[("aberrations.seed", &seed), ("turbulence.seed", &seed)])
}

/// `scene` without turbulence and without the sensor's noise.
pub(super) fn calm(scene: &Scene) -> Result<Scene> {
    scene.with(&[
        ("turbulence.fractions", "[]"),
        ("turbulence.heights_m", "[]"),
        ("turbulence.wind_m_s", "[]"),
        ("turbulence.wind_dir_rad", "[]"),
        ("wavefront_sensor.photon_noise", "false"),
        ("wavefront_sensor.read_noise_e", "0.0"),
    ])
}

/// A map over the footprint of `simulator` as `[y, x]` on its pupil's grid; NaN where there is no glass.
pub(super) fn on_pupil(simulator: &Simulator, map: &[f32]) -> Array2<f64> {
    let stride = simulator.footprint().stride();
    let amplitude = &simulator.pupil().amplitude;
    Array2::from_shape_fn(amplitude.dim(), |(y, x)| {
        if amplitude[[y, x]] > 0.0 { f64::from(map[y * stride + x]) } else { f64::NAN }
    })
}

/// A wavefront to be drawn, its RMS (as it is given) behind the caption.
pub(super) fn wavefront(pupil: &Pupil, caption: &str, map_nm: &Array2<f64>, scale: MapScale) -> Result<CaptionedMap> {
    let rms = pupil.rms(map_nm.view())?;
    Ok(CaptionedMap {
        caption: format!("{caption}: {rms:.1} nm RMS"),
        values: map_nm.clone(),
        unit: "nm".into(),
        width_m: Some(pupil.grid.width_m()),
        scale,
    })
}
