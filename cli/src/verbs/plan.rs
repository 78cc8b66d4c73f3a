//! `cophase plan`: which model a scene needs for a budget, or which observation.

use super::observe;
use cophase::planner::{self, Omission, Plan, Price, TriedValue};
use cophase::scene::Scene;
use cophase::{Error, Result};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::Terminal;
use serde::Serialize;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  cophase plan keck-artificial --budget-nm 1                    what 1 nm needs, and what it costs
  cophase plan scene.toml --budget-nm 1 -o planned.toml         the scene with the choices written in
  cophase estimate images.fits -o est.fits --budget-nm 1        plan and estimate at once
  cophase plan keck-artificial --observe --budget-nm 0.2 -o observe.toml

Wavefronts are drawn from the scene's [aberrations] (where it has none: 60 nm of pistons and 70 nm of low Zernikes, as far as its modes hold them), imaged \
without noise on the fine pupil and read by each candidate: its model error is the worst that is left. The noise is the \
Cramér-Rao bound of the candidate's pixels for the scene's star, over the root of image.count. The misfit is the reduced \
χ² of the model's error alone over what noise explains in one image: a candidate above 0.5 is rejected, because an \
estimate would restart its fits and might report a misfit. A choice never changes which modes are estimated: what fewer \
of them would cost is a row of the table.

Of a scene with channels each but those in focus is planned by itself, with the noise of all together; the first row and the last are of the joint estimate. \
Keys of [estimate] are those of all channels, and a key of [image] is the channel's own. Where channels have several wavelengths the \
pistons that are drawn are at most a twentieth of the shortest (RMS).

With --observe: one defocused image, a pair on both sides of the focus, or one image of each wavelength is simulated and estimated for each of five defocuses, with the electrons an exposure of the scene's star. The exposures are those for which the error bars reach the budget; a candidate that does not find the scene's wavefront is marked. -o writes the scene of the one with the fewest exposures; --json prints budget_nm, met, observations (channels, exposures of each, electrons, peak_e, phasing_nm, ncpa_nm, piston_range_nm, flaw).

--json prints: budget_nm, met, shortfall, reference, chosen, choices (key, value, kept, price, with channels channel), omissions; a price is \
phasing_nm and ncpa_nm (the model's error), phasing_noise_nm, ncpa_noise_nm, error_nm (the larger, with noise), misfit, \
evaluations, megaflops and estimate_us for one image.";

/// Find the cheapest model, or the shortest observation, that keeps the error within a budget
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Scene: a TOML file, or the name of a preset
    scene: PathBuf,
    /// RMS error that is allowed to the phasing, and to the NCPA, noise included [default: the
    /// scene's estimate.budget_nm]
    #[arg(long, value_name = "NM")]
    budget_nm: Option<f64>,
    /// Write the scene with the choices as keys; a file that is there is replaced
    #[arg(short, long, value_name = "FILE.toml")]
    output: Option<PathBuf>,
    /// Plan the observation: defocuses, wavelengths and exposures of an artificial source
    #[arg(long)]
    observe: bool,
    /// Wavelengths of the filters that may be used, nm [default: those of the scene]
    #[arg(long, value_name = "NM,NM", value_delimiter = ',', requires = "observe")]
    wavelengths_nm: Vec<f64>,
    #[command(flatten)]
    settings: Settings,
    /// Print the plan as JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let name = arguments.scene.as_path();
    let output = arguments.output.as_deref().map(|output| ("-o", output));
    outputs::check(output.as_slice(), &[("the scene", name)])?;
    let scene = arguments.settings.apply(&files::scene(name)?, &[])?;
    files::spare_files_of(&scene, output.as_slice())?;
    let Some(budget_nm) = arguments.budget_nm.or(scene.estimate.budget_nm) else {
        return Err(Error::Value(
            "no budget was given: --budget-nm or estimate.budget_nm of the scene is needed".into(),
        ));
    };
    if arguments.observe {
        let plan = observe::planned(&scene, &arguments.wavelengths_nm, budget_nm, terminal, &interrupt)?;
        match (&arguments.output, plan.recommended()) {
            (None, Some(_)) => {}
            (None, None) => {
                terminal.warn(&format!("{}: no observation that was tried reaches {budget_nm} nm", scene.name()));
            }
            (Some(output), Some(observation)) => observation.write(output)?,
            (Some(output), None) => {
                return Err(Error::Value(format!(
                    "no observation reaches {budget_nm} nm, and {} was not written: a larger --budget-nm, or more light, is needed",
                    output.display()
                )));
            }
        }
        return observe::show(name, &plan, arguments.json, terminal);
    }
    let plan = planned(&scene, budget_nm, terminal, &interrupt)?;
    if let Some(output) = &arguments.output {
        plan.write(output)?;
    }
    if arguments.json {
        return terminal.json(&Printed::of(&plan));
    }
    terminal.show(&table(name, &plan))
}

/// Plans with a progress line, and warns where the budget cannot be met.
pub fn planned(scene: &Scene, budget_nm: f64, terminal: &Terminal, interrupt: &Interrupt) -> Result<Plan> {
    let wait = terminal.follow();
    let plan = planner::plan(scene, budget_nm, &interrupt.control(&wait));
    drop(wait);
    let plan = plan?;
    if let Some(sentence) = plan.shortfall() {
        terminal.warn(&format!("{}: {sentence}", scene.name()));
    }
    Ok(plan)
}

/// The plan for people.
fn table(name: &Path, plan: &Plan) -> String {
    let mut text = format!(
        "{}: a budget of {} nm for the phasing and for the NCPA, {} wavefronts drawn\n\n",
        name.display(),
        plan.budget_nm,
        plan.draws
    );
    text += &format!(
        "{:<36}{:>17}{:>17}{:>8}{:>8}{:>13}{:>8}{:>8}\n",
        "", "model [nm]", "noise [nm]", "error", "misfit", "evaluations", "Mflop", "µs"
    );
    text += &format!("{:<36}{:>9}{:>8}{:>9}{:>8}{:>8}\n", "", "phasing", "NCPA", "phasing", "NCPA", "[nm]");
    text += &line("the scene's own model in f64", &plan.reference);
    for choice in &plan.choices {
        let mark = if choice.kept { "* " } else { "  " };
        text += &line(&format!("{mark}{}{} = {}", of(&choice.channel), choice.key, choice.value), &choice.price);
    }
    text += &line("the plan", &plan.chosen);
    for omission in &plan.omissions {
        let Omission { channel, what, modelled, with_nm, without_nm, because } = omission;
        let kept = if *modelled { "modelled" } else { "left out" };
        text +=
            &format!("\n{}{what}: {kept}; {without_nm:.3} nm without, {with_nm:.3} with it; {because}.", of(channel));
    }
    let work = relation(plan.reference.megaflops, plan.chosen.megaflops, "as many operations");
    let time = relation(plan.reference.estimate_us, plan.chosen.estimate_us, "as much time here");
    text + &format!("\n\n* is in the plan. It takes {work} as the scene's own model in f64, and {time}.\n")
}

/// The name of a channel before what is its own.
fn of(channel: &Option<String>) -> String {
    channel.as_ref().map(|name| format!("{name}: ")).unwrap_or_default()
}

/// How much of something the plan takes, as a multiple of what the reference takes: a plan may take
/// more of it.
fn relation(reference: f64, plan: f64, what: &str) -> String {
    format!("{:.2} times {what}", plan / reference)
}

fn line(name: &str, price: &Price) -> String {
    let Price { model_nm: [p, n], noise_nm: [pn, nn], misfit, evaluations, megaflops, estimate_us } = price;
    let error = price.error_nm();
    format!(
        "{name:<36}{p:>9.3}{n:>8.3}{pn:>9.3}{nn:>8.3}{error:>8.3}{misfit:>8.2}{evaluations:>13.1}{megaflops:>8.0}{estimate_us:>8.0}\n"
    )
}

#[derive(Serialize)]
struct Printed {
    budget_nm: f64,
    met: bool,
    shortfall: Option<String>,
    reference: PrintedPrice,
    chosen: PrintedPrice,
    choices: Vec<PrintedChoice>,
    omissions: Vec<PrintedOmission>,
}

#[derive(Serialize)]
struct PrintedPrice {
    phasing_nm: f64,
    ncpa_nm: f64,
    phasing_noise_nm: f64,
    ncpa_noise_nm: f64,
    error_nm: f64,
    misfit: f64,
    evaluations: f64,
    megaflops: f64,
    estimate_us: f64,
}

#[derive(Serialize)]
struct PrintedChoice {
    #[serde(skip_serializing_if = "Option::is_none")]
    channel: Option<String>,
    key: &'static str,
    value: String,
    kept: bool,
    price: PrintedPrice,
}

#[derive(Serialize)]
struct PrintedOmission {
    #[serde(skip_serializing_if = "Option::is_none")]
    channel: Option<String>,
    what: &'static str,
    modelled: bool,
    with_nm: f64,
    without_nm: f64,
    because: String,
}

impl Printed {
    fn of(plan: &Plan) -> Self {
        let choice = |TriedValue { channel, key, value, kept, price }: &TriedValue| PrintedChoice {
            channel: channel.clone(),
            key,
            value: value.clone(),
            kept: *kept,
            price: PrintedPrice::of(price),
        };
        let omission = |omission: &Omission| PrintedOmission {
            channel: omission.channel.clone(),
            what: omission.what,
            modelled: omission.modelled,
            with_nm: omission.with_nm,
            without_nm: omission.without_nm,
            because: omission.because.clone(),
        };
        Self {
            budget_nm: plan.budget_nm,
            met: plan.is_met(),
            shortfall: plan.shortfall(),
            reference: PrintedPrice::of(&plan.reference),
            chosen: PrintedPrice::of(&plan.chosen),
            choices: plan.choices.iter().map(choice).collect(),
            omissions: plan.omissions.iter().map(omission).collect(),
        }
    }
}

impl PrintedPrice {
    fn of(price: &Price) -> Self {
        let Price { model_nm, noise_nm, misfit, evaluations, megaflops, estimate_us } = *price;
        Self {
            phasing_nm: model_nm[0],
            ncpa_nm: model_nm[1],
            phasing_noise_nm: noise_nm[0],
            ncpa_noise_nm: noise_nm[1],
            error_nm: price.error_nm(),
            misfit,
            evaluations,
            megaflops,
            estimate_us,
        }
    }
}
