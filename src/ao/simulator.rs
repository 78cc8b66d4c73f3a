//! Closed-loop simulator: one telescope, one guide star, frame after frame.
//!
//! ```text
//! atmosphere ─(+ segments)─(− mirror)─ residual ─ sensor ─ slopes ─ controller ─ commands ┐
//!                              └────────────────── the next frame ────────────────────────┘
//! ```

use super::aligned::AlignedBuffer;
use super::atmosphere::Atmosphere;
use super::camera::{self, CameraOptics, ScienceCamera, View};
use super::channel::ChannelOptics;
use super::control::{self, ControlLaw, OpticalGains, Stability, segment_mask};
use super::correction::{CorrectionLoop, LoopFrame};
use super::drift::Drift;
use super::footprint::Footprint;
use super::interaction::interaction;
use super::measured_matrices;
use super::parts::{actuators, apply_reflectivity, segments_nm, sensor_pupil};
use super::profile::{LoopStage, Profile};
use super::schedule::Schedule;
use super::sensor::{GuideStar, Lenslets, Sensor, SlopeFormat, reference_mas};
use super::surface::Surface;
use crate::modes::{InfluenceFunctions, karhunen_loeve_complete};
use crate::pupil::Pupil;
use crate::scene::{ControlBasis, ControlScene, OpticalGainMethod, SensorMask, SensorScene, System};
use crate::source::{Truth, stream};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::Array2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;
use std::time::Instant;

/// Random number stream of the sensor's noise under the seed of the turbulence; the streams below
/// are the layers'.
const SENSOR_STREAM: u64 = 1 << 32;

/// Share of an image's light that the simulator's grid filters away above which it warns. 0.28 %
/// cost 1 nm of NCPA (80 samples across ten lenslets, 40 λ/D of image); at 0.08 %, those of
/// `keck-pyramid`, the mean error of three draws was 0.5 nm, as their scatter lets expect.
const LARGEST_LIGHT_FILTERED: f64 = 0.0015;

/// AO simulation: telescope, turbulence, loop and science camera of a scene.
pub struct Simulator {
    pub(super) scene: System,
    telescope: Telescope,
    /// Pupil on the simulator's grid.
    pupil: Pupil,
    pub(super) influence: InfluenceFunctions,
    /// At least one.
    pub(super) channels: Vec<ChannelOptics>,
    truth: Truth,
    /// What a static shape of the mirror leaves of `truth` on the camera's path; `None` without
    /// one.
    pub(super) seen_truth: Option<Truth>,
    /// By how much corrections have moved the reference slopes, mas; empty where they have not.
    pub(super) moved_reference_mas: Vec<f64>,
    mask: Vec<bool>,
    interaction: Array2<f64>,
    law: ControlLaw,
    pub(super) atmosphere: Atmosphere,
    pub(super) correction: CorrectionLoop,
    pub(super) residual_nm: AlignedBuffer,
}

/// Sections of a scene that the loop requires: sensor and control.
pub(super) fn sections(scene: &System) -> Result<(&SensorScene, &ControlScene)> {
    let missing = |section: &str| {
        Error::Scene(format!("{}: the section [{section}] is missing; an AO loop needs it", scene.name()))
    };
    Ok((
        scene.wavefront_sensor.as_ref().ok_or_else(|| missing("wavefront_sensor"))?,
        scene.control.as_ref().ok_or_else(|| missing("control"))?,
    ))
}

impl Simulator {
    /// Builds the system of `scene`, with aberrations drawn from `aberrations.seed`.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene without a sensor or control, and for simultaneous channels with
    /// other numbers or times of exposures; the errors of building each part.
    pub fn new(scene: &System) -> Result<Self> {
        let telescope = Telescope::new(scene)?;
        let seed = scene.seed();
        let truth = Truth::draw(scene, &telescope, &mut stream(seed, 0))?;
        Self::with_truth(scene, telescope, truth)
    }

    /// Builds the system of `scene` with the aberrations of `truth`.
    ///
    /// # Errors
    /// As [`Simulator::new`].
    pub fn with_truth(scene: &System, telescope: Telescope, truth: Truth) -> Result<Self> {
        let (sensing, control_scene) = sections(scene)?;
        let schedule = Schedule::new(scene, control_scene.settle_s, control_scene.frame_rate_hz)?;
        let pupil = sensor_pupil(scene, sensing, &telescope, scene.turbulence.fractions.len())?;
        // The subapertures in use are selected with perfectly reflecting segments.
        let illuminated = apply_reflectivity(&pupil, &truth);
        let footprint = Footprint::with_margin(&illuminated, camera::MARGIN_SAMPLES);
        let lenslets = Lenslets::new(sensing, &pupil, scene.directory())?.with_light_of(&illuminated);
        let influence = actuators(scene, &lenslets, &telescope)?;
        let mut surface = Surface::new(&influence, &pupil.grid, &footprint);
        let mut sensor = Sensor::new(sensing, lenslets, &illuminated, &footprint)?;
        let modelled = interaction(&mut sensor, &mut surface, &footprint, control_scene.reconstructor)?;
        let sensor = sensor.with_changes(sensing, &illuminated, &footprint)?;
        let lenslets = sensor.lenslets();
        let measured = measured_matrices::interaction(scene, lenslets, &modelled)?;
        let interaction = measured.unwrap_or(modelled);
        let command_matrix = measured_matrices::command_matrix(scene, control_scene, lenslets, surface.actuators())?;
        let mask = match sensing.mask {
            SensorMask::None => vec![false; lenslets.subapertures.len()],
            SensorMask::Segments => {
                segment_mask(&pupil, lenslets.across, &lenslets.subapertures, sensing.mask_dominant_fraction)?
            }
        };
        let modes = match control_scene.basis {
            _ if command_matrix.is_some() => None,
            ControlBasis::Zonal => None,
            ControlBasis::Kl => {
                let modes = karhunen_loeve_complete(&influence, &pupil, &Telescope::turbulence(scene)?)?;
                Some(modes.basis.matrix().t().to_owned())
            }
        };
        let plant = control::Plant {
            interaction: &interaction,
            lenslets_across: lenslets.across,
            subapertures: &lenslets.subapertures,
            mask: &mask,
            kl: modes.as_ref(),
            command_matrix: command_matrix.as_ref(),
            actuator_grid: Some((scene.mirror.actuators_across, influence.indices())),
            stroke_limit_nm: scene.mirror.stroke_limit_nm,
        };
        let law = ControlLaw::new(control_scene, &plant)?;
        let has_dither = control_scene.optical_gains == OpticalGainMethod::Dither;
        let gains = law
            .reconstructor()
            .filter(|_| has_dither)
            .map(|reconstructor| OpticalGains::new(reconstructor, &interaction, control_scene.dither_nm));
        let frame_s = 1.0 / control_scene.frame_rate_hz;
        let atmosphere = Atmosphere::new(&scene.turbulence, &pupil.grid, &footprint, frame_s, scene.turbulence.seed)?;
        let mut noise = ChaCha8Rng::seed_from_u64(scene.turbulence.seed);
        noise.set_stream(SENSOR_STREAM);
        let noisy = sensing.photon_noise || sensing.read_noise_e > 0.0;
        let light = noisy.then(|| GuideStar::new(sensing, lenslets.pitch_m, frame_s, noise));
        let segments_nm = segments_nm(&truth, &telescope, &pupil, &footprint);
        let drift = Drift::new(&truth, &pupil, &footprint, &segments_nm, &schedule, frame_s)?;
        let correction = CorrectionLoop {
            segments_nm,
            drift: drift.map(Arc::new),
            slopes_mas: vec![0.0; sensor.slopes()],
            reference_mas: reference_mas(scene, sensing, &SlopeFormat::new(sensing, sensor.lenslets())?)?,
            commands_nm: vec![0.0; surface.actuators()],
            controller: law.start(),
            gains,
            residual_rms_nm: 0.0,
            number: 0,
            frame_s,
            profile: Profile::default(),
            footprint,
            surface,
            sensor,
            light,
        };
        let channels = ChannelOptics::all(scene, &telescope)?;
        let residual_nm = correction.footprint.zeros();
        let scene = scene.clone();
        Ok(Self {
            scene,
            telescope,
            pupil,
            influence,
            channels,
            truth,
            seen_truth: None,
            moved_reference_mas: Vec::new(),
            mask,
            interaction,
            law,
            atmosphere,
            correction,
            residual_nm,
        })
    }

    /// Advances the loop by one frame.
    ///
    /// # Errors
    /// Internal errors of the stages only.
    pub fn step(&mut self) -> Result<LoopFrame<'_>> {
        let started = Instant::now();
        self.atmosphere.next_frame(&mut self.residual_nm)?;
        self.correction.profile.lap(LoopStage::Atmosphere, started);
        self.correction.step(&mut self.residual_nm)?;
        Ok(self.correction.last(&self.residual_nm))
    }

    /// Advances the loop by one frame in which `extra_nm`, a map over the footprint, is added to
    /// the turbulence: a vibration, a test signal, or a layer of the caller's.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another size.
    pub fn step_with_opd(&mut self, extra_nm: &[f32]) -> Result<LoopFrame<'_>> {
        if extra_nm.len() != self.residual_nm.len() {
            let (given, needed) = (extra_nm.len(), self.residual_nm.len());
            return Err(Error::Shape(format!("a map of {given} samples was given; {needed} are needed")));
        }
        self.atmosphere.next_frame(&mut self.residual_nm)?;
        for (out, extra) in self.residual_nm.iter_mut().zip(extra_nm) {
            *out += extra;
        }
        self.correction.step(&mut self.residual_nm)?;
        Ok(self.correction.last(&self.residual_nm))
    }

    /// A sentence for each channel whose images have errors because the simulator's grid is too
    /// coarse for them.
    pub fn warnings(&self) -> Vec<String> {
        let (samples, pupil) = (self.pupil.grid.samples(), &self.telescope.pupil);
        let sentence = |channel: &ChannelOptics| {
            let (view, diversity) = (View::from_scene(&channel.scene.image), &channel.diversity);
            let filtered = view.light_filtered(samples, pupil, diversity);
            let images = channel.name.as_ref().map_or(String::new(), |name| format!(" of channel {name}"));
            let key = self.scene.wavefront_sensor.as_ref()?.samples_key();
            (filtered > LARGEST_LIGHT_FILTERED).then(|| {
                format!(
                    "{samples} samples across the pupil filter away {:.2} % of the light of the images{images}: estimates from them have \
                     errors of a nm that are not in the error bars; {} are enough: set more wavefront_sensor.{key}",
                    filtered * 100.0,
                    view.samples_needed(pupil, diversity)
                )
            })
        };
        self.channels.iter().filter_map(sentence).collect()
    }

    /// Builds a camera of this system's images, with the diversity and the filter of the first
    /// channel.
    ///
    /// # Errors
    /// As [`ScienceCamera::new`].
    pub fn camera(&self, view: View) -> Result<ScienceCamera> {
        self.camera_of(&self.channels[0], view)
    }

    /// Builds a camera with the diversity and the filter of `channel`.
    pub(super) fn camera_of(&self, channel: &ChannelOptics, view: View) -> Result<ScienceCamera> {
        let optics = CameraOptics {
            telescope: &self.telescope,
            pupil: &self.pupil,
            footprint: &self.correction.footprint,
            truth: &self.truth,
            diversity: &channel.diversity,
            filter: &channel.filter,
            segments_nm: &self.correction.segments_nm,
        };
        ScienceCamera::new(view, &optics)
    }

    /// The scene.
    pub fn scene(&self) -> &System {
        &self.scene
    }

    /// The telescope.
    pub fn telescope(&self) -> &Telescope {
        &self.telescope
    }

    /// The pupil on the simulator's grid.
    pub fn pupil(&self) -> &Pupil {
        &self.pupil
    }

    /// The illuminated part of that grid.
    pub fn footprint(&self) -> &Footprint {
        &self.correction.footprint
    }

    /// The static aberrations on the camera's path, a static shape that moved reference slopes put
    /// on the mirror included.
    pub fn truth(&self) -> &Truth {
        self.seen_truth.as_ref().unwrap_or(&self.truth)
    }

    /// The segment errors, nm, a map over the footprint.
    pub fn segments_nm(&self) -> &[f32] {
        &self.correction.segments_nm
    }

    /// The actuators in use.
    pub fn influence(&self) -> &InfluenceFunctions {
        &self.influence
    }

    /// The lenslets and which of them are used.
    pub fn lenslets(&self) -> &Lenslets {
        self.correction.sensor.lenslets()
    }

    /// Which subapertures are masked.
    pub fn mask(&self) -> &[bool] {
        &self.mask
    }

    /// Interaction matrix, `[slopes, actuators]`, mas per nm.
    pub fn interaction(&self) -> &Array2<f64> {
        &self.interaction
    }

    /// Control law of the loop.
    pub fn law(&self) -> &ControlLaw {
        &self.law
    }

    /// Stability of the loop, from its poles.
    pub fn stability(&self) -> &Stability {
        self.law.stability()
    }

    /// Duration of a frame, s.
    pub fn frame_s(&self) -> f64 {
        self.correction.frame_s
    }

    /// Frames since the loop was closed.
    pub fn frames(&self) -> u64 {
        self.correction.number
    }

    /// Time spent in each stage so far.
    pub fn profile(&self) -> &Profile {
        &self.correction.profile
    }

    pub(super) fn surface_taps(&self) -> (f64, f64) {
        self.correction.surface.taps()
    }

    pub(super) fn surface_bytes(&self) -> f64 {
        self.correction.surface.bytes()
    }

    /// Surface of the mirror for `commands_nm`, nm of wavefront, a map over the footprint.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong number of commands.
    pub fn surface_nm(&mut self, commands_nm: &[f32]) -> Result<AlignedBuffer> {
        let mut map = self.correction.footprint.zeros();
        self.correction.surface.add(commands_nm, 1.0, &mut map)?;
        Ok(map)
    }
}
