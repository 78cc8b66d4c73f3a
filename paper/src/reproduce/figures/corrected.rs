//! Section 4.5: segments moved by what a sequence of images said, and the loop that an astronomer
//! then gets.
//!
//! Images come from the masked, inpainted, pseudo-open loop, 75 a pass. What is delivered comes
//! from the plain zonal loop: the paper does not say which, but its figures do. Pistons of 64 nm
//! cost it 1 % of Strehl ratio in H, as a loop does that takes three quarters of their variance
//! away (see `leak`); one that lets them pass would lose 6 %.

use super::setup;
use crate::reproduce::on_sky::{Reader, Sequence};
use crate::reproduce::{Conditions, Progress, Way};
use cophase::ao::Simulator;
use cophase::modal::ModalEstimate;
use cophase::scene::Scene;
use cophase::source::{Truth, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};

/// The loop behind which images are taken, and the one that is used afterwards.
const MEASURING: &str = "pol-mask-inpaint";
const DELIVERING: &str = "zonal";
/// Images of a pass.
const IMAGES: &str = "75";
/// From one pass to the next the sky is another one: its seed is this much further.
const NEXT_SKY: usize = 1_000_000;
/// How long the delivered loop is watched, s.
const WATCHED_S: f64 = 1.0;
/// Frames between two looks at whether anybody still waits.
const LOOK_EVERY: u64 = 128;

/// How badly the telescope is phased.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Amplitude {
    /// 64 nm RMS: one pass.
    Conventional,
    /// The same pistons doubled, 128 nm RMS: two passes.
    Substantial,
}

impl Amplitude {
    /// Both.
    pub const ALL: [Amplitude; 2] = [Amplitude::Conventional, Amplitude::Substantial];

    /// The paper's word for it.
    pub fn name(self) -> &'static str {
        match self {
            Amplitude::Conventional => "conventional",
            Amplitude::Substantial => "substantial",
        }
    }

    /// RMS of the pistons, nm, as a scene says it.
    fn rms_nm(self) -> &'static str {
        match self {
            Amplitude::Conventional => "64.15",
            Amplitude::Substantial => "128.3",
        }
    }

    /// How often images are taken and segments moved.
    pub fn passes(self) -> usize {
        match self {
            Amplitude::Conventional => 1,
            Amplitude::Substantial => 2,
        }
    }
}

/// A telescope before or after some passes.
#[derive(Debug, Clone, PartialEq)]
pub struct State {
    /// How badly it was phased; `None` for a telescope that is perfectly phased.
    pub amplitude: Option<Amplitude>,
    /// Passes so far.
    pub pass: usize,
    /// True pistons, nm.
    pub piston_nm: Vec<f64>,
    /// Their RMS over the pupil, piston, tip and tilt removed, nm.
    pub phasing_nm: f64,
}

impl State {
    /// `before`, `pass 1`, `pass 2`; `phased`.
    pub fn name(&self) -> &'static str {
        match (self.amplitude, self.pass) {
            (None, _) => "phased",
            (_, 0) => "before",
            (_, 1) => "pass 1",
            _ => "pass 2",
        }
    }

    /// `64 nm, pass 1`: as [`State::label`], in fewer letters.
    pub(super) fn short(&self) -> String {
        let rms = self.amplitude.map(|amplitude| if amplitude == Amplitude::Conventional { "64" } else { "128" });
        rms.map_or_else(|| self.name().into(), |rms| format!("{rms} nm, {}", self.name()))
    }

    /// Amplitude and name.
    pub fn label(&self) -> String {
        self.amplitude.map_or_else(|| self.name().into(), |amplitude| format!("{}, {}", amplitude.name(), self.name()))
    }
}

/// States of one draw, in the order of [`Bench::states`]; so many.
pub(super) const STATES: usize = 6;

/// Where segments are measured and corrected.
pub(super) struct Bench {
    conditions: Conditions,
    reader: Reader,
    images: usize,
}

impl Bench {
    pub(super) fn new(conditions: &Conditions) -> Result<Self> {
        let mut conditions = conditions.clone();
        if conditions.settings.iter().all(|(key, _)| *key != "image.count") {
            conditions.settings.push(("image.count", IMAGES));
        }
        let scene = conditions.star()?;
        let reader = Reader::new(Way::Paper, &scene)?;
        Ok(Self { conditions, reader, images: scene.image.count })
    }

    /// Images that one draw takes.
    pub(super) fn images(&self) -> usize {
        Amplitude::ALL.map(Amplitude::passes).iter().sum::<usize>() * self.images
    }

    /// Draw `seed` of a telescope: conventional before and after, substantial before and after each
    /// pass, perfect.
    pub(super) fn states(&self, seed: usize, progress: &Progress) -> Result<Vec<State>> {
        let mut states = Vec::with_capacity(STATES);
        for amplitude in Amplitude::ALL {
            let scene = setup::with_seed(&setup::row(MEASURING)?.scene(&self.conditions)?, seed)?;
            let scene = scene.with_override("aberrations.segment_piston_rms_nm", amplitude.rms_nm())?;
            let (telescope, truth) = drawn(&scene)?;
            states.push(state(&telescope, truth, Some(amplitude), 0)?);
            for pass in 1..=amplitude.passes() {
                let before = states.last().map_or(&[][..], |state| &state.piston_nm);
                let sky = (seed + (pass - 1) * NEXT_SKY).to_string();
                let simulator = system(&scene.with_override("turbulence.seed", &sky)?, before)?;
                let estimate = self.estimate(simulator, progress)?;
                let moved = corrected(before, &estimate);
                let (telescope, truth) = drawn(&scene)?;
                let truth = truth.with_pistons(&telescope, moved)?;
                states.push(state(&telescope, truth, Some(amplitude), pass)?);
            }
        }
        let segments = states.first().map_or(0, |state| state.piston_nm.len());
        states.push(State { amplitude: None, pass: 0, piston_nm: vec![0.0; segments], phasing_nm: 0.0 });
        Ok(states)
    }

    fn estimate(&self, simulator: Simulator, progress: &Progress) -> Result<ModalEstimate> {
        let sequence = Sequence::behind(simulator, progress)?;
        let found = self.reader.fit(&sequence, progress)?;
        found.ok_or_else(|| Error::Image(format!("none of {} images could be fitted", sequence.images())))
    }

    /// The loop that is used afterwards on a telescope with these pistons; the sky of draw `seed`,
    /// for all of its states.
    pub(super) fn delivering(&self, seed: usize, piston_nm: &[f64]) -> Result<Simulator> {
        system(&setup::with_seed(&setup::row(DELIVERING)?.scene(&self.conditions)?, seed)?, piston_nm)
    }
}

/// True pistons after the segments were moved by the opposite of their estimates, which come first
/// among the modes.
fn corrected(piston_nm: &[f64], estimate: &ModalEstimate) -> Vec<f64> {
    piston_nm.iter().zip(&estimate.combined.modes.coefficients_nm).map(|(truth, estimate)| truth - estimate).collect()
}

/// The aberrations of `scene`.
fn drawn(scene: &Scene) -> Result<(Telescope, Truth)> {
    let telescope = Telescope::new(scene)?;
    let seed = scene.seed();
    let truth = Truth::draw(scene, &telescope, &mut stream(seed, 0))?;
    Ok((telescope, truth))
}

/// The AO system of `scene` on a telescope with these pistons.
fn system(scene: &Scene, piston_nm: &[f64]) -> Result<Simulator> {
    let (telescope, truth) = drawn(scene)?;
    let truth = truth.with_pistons(&telescope, piston_nm.to_vec())?;
    Simulator::with_truth(scene, telescope, truth)
}

fn state(telescope: &Telescope, truth: Truth, amplitude: Option<Amplitude>, pass: usize) -> Result<State> {
    let pupil = &telescope.pupil;
    let phasing_nm = pupil.rms(pupil.remove_piston_tip_tilt(truth.phasing_nm.view())?.view())?;
    Ok(State { amplitude, pass, piston_nm: truth.piston_nm, phasing_nm })
}

/// Lets the loop of `simulator` settle, and shows the residual wavefront of every frame of the
/// second that follows.
pub(super) fn watch(
    simulator: &mut Simulator,
    progress: &Progress,
    mut each: impl FnMut(u64, &[f32]) -> Result<()>,
) -> Result<()> {
    let settle_s = simulator.scene().control.as_ref().map_or(0.0, |control| control.settle_s);
    let frames = |seconds: f64| (seconds / simulator.frame_s()).round() as u64;
    let (settled, watched) = (frames(settle_s), frames(WATCHED_S));
    for number in 0..settled + watched {
        if number.is_multiple_of(LOOK_EVERY) {
            progress.check()?;
        }
        let frame = simulator.step()?;
        if number >= settled {
            each(number - settled, frame.residual_nm)?;
        }
    }
    Ok(())
}
