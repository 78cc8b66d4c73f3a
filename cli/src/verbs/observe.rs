//! `cophase plan --observe`: which defocuses, wavelengths and exposures reach an error.

use cophase::Result;
use cophase::pipeline::{Observation, ObservationPlan, plan_observation};
use cophase::scene::Scene;
use cophase_view::interrupt::Interrupt;
use cophase_view::terminal::{Terminal, counted};
use serde::Serialize;
use std::path::Path;

/// Plans the observation of `scene` with a progress line.
pub fn planned(
    scene: &Scene,
    wavelengths_nm: &[f64],
    budget_nm: f64,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<ObservationPlan> {
    let wait = terminal.follow();
    plan_observation(scene, wavelengths_nm, budget_nm, &interrupt.control(&wait))
}

/// Prints the plan for people, or as JSON.
pub fn show(name: &Path, plan: &ObservationPlan, as_json: bool, terminal: &Terminal) -> Result<()> {
    if as_json { terminal.json(&Printed::of(plan)) } else { terminal.show(&table(name, plan)) }
}

/// Wavelengths and defocuses of an observation, such as "2168.6 nm ±1.5 waves".
fn name(channels: &[(f64, f64)]) -> String {
    let (nm, waves) = channels[0];
    match channels {
        [_] => format!("{nm} nm, {waves:+} waves"),
        [_, (other, opposite)] if *other == nm && *opposite == -waves => format!("{nm} nm, ±{waves} waves"),
        _ => {
            let all: Vec<String> = channels.iter().map(|(nm, _)| nm.to_string()).collect();
            format!("{} nm, {waves:+} waves", all.join(" and "))
        }
    }
}

fn table(name_of_scene: &Path, plan: &ObservationPlan) -> String {
    let mut text = format!(
        "{}: a budget of {} nm for the phasing and for the NCPA\n\n{:<32}{:>11}{:>11}{:>11}{:>9}{:>8}{:>14}\n",
        name_of_scene.display(),
        plan.budget_nm,
        "channels",
        "exposures",
        "electrons",
        "peak [e]",
        "phasing",
        "NCPA",
        "pistons [nm]"
    );
    for (index, observation) in plan.observations.iter().enumerate() {
        let Observation { channels, electrons, peak_e, expected_nm: [phasing, ncpa], piston_range_nm, .. } =
            observation;
        let mark = if index == 0 && plan.recommended().is_some() { "* " } else { "  " };
        let exposures = match observation.exposures {
            Some(each) if channels.len() > 1 => format!("{} x {each}", channels.len()),
            Some(each) => each.to_string(),
            None => "–".into(),
        };
        text += &format!(
            "{mark}{:<30}{exposures:>11}{electrons:>11.2e}{peak_e:>11.2e}{phasing:>9.3}{ncpa:>8.3}{:>14}{}\n",
            name(channels),
            format!("±{piston_range_nm:.0}"),
            if observation.flaw.is_some() { "  flagged" } else { "" }
        );
    }
    let flagged = plan.observations.iter().filter(|observation| observation.flaw.is_some()).count();
    text += "\n* is recommended: the fewest exposures. Errors are those expected of these exposures, nm RMS; pistons: the range about their \
             mean within which whole wavelengths are determined.\n";
    if let Some(flaw) = plan.observations.iter().find_map(|observation| observation.flaw.as_ref()) {
        text += &format!("{} flagged, the first because: {flaw}\n", counted(flagged, "observation"));
    }
    text
}

#[derive(Serialize)]
struct Printed {
    budget_nm: f64,
    met: bool,
    observations: Vec<PrintedObservation>,
}

#[derive(Serialize)]
struct PrintedObservation {
    channels: Vec<PrintedChannel>,
    exposures: Option<usize>,
    electrons: f64,
    peak_e: f64,
    phasing_nm: f64,
    ncpa_nm: f64,
    piston_range_nm: f64,
    flaw: Option<String>,
}

#[derive(Serialize)]
struct PrintedChannel {
    wavelength_nm: f64,
    diversity_focus_waves_rms: f64,
}

impl Printed {
    fn of(plan: &ObservationPlan) -> Self {
        let observation = |one: &Observation| PrintedObservation {
            channels: one
                .channels
                .iter()
                .map(|&(wavelength_nm, diversity_focus_waves_rms)| PrintedChannel {
                    wavelength_nm,
                    diversity_focus_waves_rms,
                })
                .collect(),
            exposures: one.exposures,
            electrons: one.electrons,
            peak_e: one.peak_e,
            phasing_nm: one.expected_nm[0],
            ncpa_nm: one.expected_nm[1],
            piston_range_nm: one.piston_range_nm,
            flaw: one.flaw.clone(),
        };
        Self {
            budget_nm: plan.budget_nm,
            met: plan.recommended().is_some(),
            observations: plan.observations.iter().map(observation).collect(),
        }
    }
}
