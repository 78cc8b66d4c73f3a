//! `cophase estimate`: the main job.

use super::picture;
use crate::files::{self, Settings};
use crate::interrupt::Interrupt;
use crate::terminal::Terminal;
use cophase::pipeline::{Control, Estimate, Estimator, Images, Policy};
use cophase::scene::{DeviceChoice, Method, Scene};
use cophase::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const EXAMPLES: &str = "Examples:
  cophase estimate images.fits -o est.fits      from what 'cophase image' made
  cophase estimate nirc2.fits --scene scene.toml -o est.fits --plot est.png
  cophase estimate images.fits -o paper.fits --optimizer bfgs
  cophase estimate onsky.fits -o est.fits --method full-phase --commands c.fits

Images: FITS, in electrons, 2-D or a cube, in the HDU IMAGES, the primary one or the first image extension. Pixels \
that are not finite are masked, and those that an image HDU BADPIX (not zero = bad) or --mask names. The card RON_E is \
the read noise, unless --set image.read_noise_e says otherwise.

Eight images or more are judged by one another: their error bars are from the scatter between them, and the clipped \
mean (the default; --set estimate.combine=mean or median) leaves outliers out.

--json prints: images, used, clipped, combine, seconds, phasing_rms_nm, ncpa_rms_nm, phasing_sigma_nm, ncpa_sigma_nm, \
phasing_residual_nm and ncpa_residual_nm (where the truth is known), reduced_chi2, evaluations (of the objective, all \
images together), device, precision, status (the worst of the images': ok, misfit, wrong-minimum, not-converged, \
unusable), warnings (sentences), policy, model (the basis that was selected), method, and with full-phase knows, \
iterations, telemetry_gain and telemetry_correlation (of the measured slopes with those of the retrieved wavefronts); null where a key does not apply.";

/// Estimate segment phasing and NCPA from defocused images of a star
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// FITS file with one image or a cube of them
    images: PathBuf,
    /// FITS file to write: maps, modes, error bars; one that is there is replaced
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Scene: a TOML file, or the name of a preset [default: the scene in the image file]
    #[arg(long)]
    scene: Option<PathBuf>,
    /// FITS file that marks bad pixels: not zero = bad
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Also draw the result
    #[arg(long, value_name = "FILE.png|svg")]
    plot: Option<PathBuf>,
    /// Where to run: auto, cpu, opencl or opencl:P:D, as 'cophase devices' lists them
    #[arg(long, value_parser = device)]
    device: Option<String>,
    /// Precision of the imaging model [default: f64, or f32 with full-phase]
    #[arg(long, value_parser = ["f64", "f32"])]
    precision: Option<String>,
    /// Ours (gauss-newton), the paper's method as a whole (bfgs), or its objective with our optimiser (paper)
    #[arg(long, value_parser = ["gauss-newton", "bfgs", "paper"])]
    optimizer: Option<String>,
    /// RMS error that is allowed, nm, noise included: plans the cheapest model that keeps it (see cophase plan)
    #[arg(long, value_name = "NM")]
    budget_nm: Option<f64>,
    /// The estimator: static modes, fitted image by image (modal), or the whole wavefront behind each image of a sequence
    /// behind adaptive optics (full-phase); auto: full-phase where the scene has turbulence or a loop and the images change
    #[arg(long, value_parser = ["modal", "full-phase", "auto"])]
    method: Option<String>,
    /// What full-phase assumes of the adaptive optics: nothing, its spectrum, the loop, its telemetry [default: the most there is]
    #[arg(long, value_parser = ["nothing", "spectrum", "loop", "telemetry"])]
    knows: Option<String>,
    /// Slopes that come with the images, with full-phase: refused where they do not belong to the images (check), divided by
    /// the gain that is found and used (use), or left out (ignore) [default: check]
    #[arg(long, value_parser = ["check", "use", "ignore"])]
    telemetry: Option<String>,
    /// Also write corrections, with full-phase: what to add to segments, mirror and reference slopes
    #[arg(long, value_name = "FILE")]
    commands: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Exit with status 3 where the estimate carries a warning, or a status other than ok; the output is written all the same
    #[arg(long)]
    strict: bool,
    /// Also say which combinations of modes the images hardly see
    #[arg(short, long)]
    verbose: bool,
}

fn device(word: &str) -> Result<String> {
    word.parse::<DeviceChoice>().map(|_| word.to_string())
}

impl Arguments {
    /// The options that are keys of the scene.
    fn options(&self) -> Vec<(&str, &str)> {
        let options = [
            ("estimate.device", &self.device),
            ("estimate.precision", &self.precision),
            ("estimate.optimizer", &self.optimizer),
            ("estimate.method", &self.method),
            ("estimate.ao_knowledge", &self.knows),
            ("estimate.telemetry", &self.telemetry),
        ];
        options.into_iter().filter_map(|(key, value)| Some((key, value.as_deref()?))).collect()
    }

    fn check_outputs(&self) -> Result<()> {
        let mut inputs: Vec<&Path> = vec![&self.images];
        inputs.extend([&self.scene, &self.mask].into_iter().flatten().map(PathBuf::as_path));
        files::check_output(&self.output, &inputs)?;
        if let Some(commands) = &self.commands {
            files::check_output(commands, &inputs)?;
        }
        if let Some(plot) = &self.plot {
            files::check_picture(plot, &inputs)?;
        }
        Ok(())
    }

    fn scene(&self) -> Result<Scene> {
        let scene = match &self.scene {
            Some(name) => files::scene(name)?,
            None => files::embedded_scene(&self.images)?.ok_or_else(|| {
                let reason =
                    "holds no scene (table SCENE): name one with --scene, a file or a preset such as keck-artificial";
                Error::file(&self.images, reason)
            })?,
        };
        let budget = self.budget_nm.map(|nm| nm.to_string());
        let mut options = self.options();
        options.extend(budget.as_deref().map(|nm| ("estimate.budget_nm", nm)));
        self.settings.apply(&scene, &options)
    }
}

/// Exit status under --strict of an estimate with a warning.
const DOUBTFUL_STATUS: u8 = 3;

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<ExitCode> {
    let interrupt = Interrupt::catch()?;
    arguments.check_outputs()?;
    let mut images = Images::read(&arguments.images, arguments.mask.as_deref())?;
    if arguments.settings.names("image.read_noise_e") {
        // What the command line says goes before what the file says.
        images.read_noise_e = None;
    }
    let scene = arguments.scene()?;
    if arguments.commands.is_some() && scene.estimate.method == Method::Modal {
        let reason = "corrections come from the full-phase estimate: --method full-phase is needed";
        return Err(Error::file(arguments.commands.as_deref().unwrap_or(&arguments.output), reason));
    }
    let estimate = estimated(&arguments.images, &scene, &images, terminal, &interrupt)?;
    write(&arguments.images, &estimate, &arguments.output, arguments.plot.as_deref())?;
    if let Some(commands) = &arguments.commands {
        estimate.corrections(None)?.write(commands)?;
    }
    print(&arguments.images, &estimate, arguments.json, terminal)?;
    if let Some(degeneracy) = estimate.degeneracy.as_ref().filter(|_| arguments.verbose && !arguments.json) {
        terminal.show(&format!("\n{degeneracy}\n"))?;
    }
    let is_doubtful = arguments.strict && !estimate.is_sound();
    Ok(if is_doubtful { ExitCode::from(DOUBTFUL_STATUS) } else { ExitCode::SUCCESS })
}

/// The estimate of `images`, which are of the file `name`, with a progress bar.
pub fn estimated(
    name: &Path,
    scene: &Scene,
    images: &Images,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<Estimate> {
    let bar = terminal.follow();
    let observer = bar.observer();
    let control = Control::with_flag(interrupt.flag().clone(), observer);
    let estimator = Estimator::with_policy(scene, Policy::default(), control)?;
    estimator.estimate(images).map_err(files::about(name))
}

/// Writes the estimate, and its picture where one is asked for.
pub fn write(name: &Path, estimate: &Estimate, output: &Path, plot: Option<&Path>) -> Result<()> {
    estimate.write(output)?;
    let Some(plot) = plot else { return Ok(()) };
    let name = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy();
    picture::picture(&name, estimate)?.draw(plot)
}

/// Prints the result on stdout, and the warnings on stderr.
pub fn print(name: &Path, estimate: &Estimate, json: bool, terminal: &Terminal) -> Result<()> {
    let name = name.display();
    for sentence in &estimate.warnings {
        terminal.warn(&format!("{name}: {sentence}"));
    }
    if json {
        return terminal.json(&Summary::new(estimate));
    }
    terminal.show(&format!("{name}: {}", estimate.summary()))
}

/// What `estimate --json` prints; scripts rely on these keys.
#[derive(Serialize)]
struct Summary<'a> {
    images: usize,
    used: usize,
    clipped: usize,
    combine: Option<&'static str>,
    seconds: f64,
    phasing_rms_nm: f64,
    ncpa_rms_nm: f64,
    phasing_sigma_nm: f64,
    ncpa_sigma_nm: f64,
    phasing_residual_nm: Option<f64>,
    ncpa_residual_nm: Option<f64>,
    reduced_chi2: f64,
    evaluations: usize,
    device: &'a str,
    precision: &'static str,
    status: &'static str,
    warnings: &'a [String],
    policy: &'static str,
    model: &'a str,
    method: &'static str,
    knows: Option<&'static str>,
    iterations: Option<usize>,
    telemetry_gain: Option<f64>,
    telemetry_correlation: Option<f64>,
}

impl<'a> Summary<'a> {
    fn new(estimate: &'a Estimate) -> Self {
        let residual_nm = estimate.truth.as_ref().map(|(_, residual)| residual.rms_nm);
        let map = estimate.map.as_ref();
        let telemetry = map.and_then(|map| map.telemetry.as_ref());
        Self {
            images: estimate.images.len(),
            used: estimate.used(),
            clipped: estimate.clipped(),
            combine: estimate.combine.map(|combine| combine.word()),
            seconds: estimate.seconds,
            phasing_rms_nm: estimate.phasing.rms_nm,
            ncpa_rms_nm: estimate.ncpa.rms_nm,
            phasing_sigma_nm: estimate.phasing.sigma_nm,
            ncpa_sigma_nm: estimate.ncpa.sigma_nm,
            phasing_residual_nm: residual_nm.map(|nm| nm[0]),
            ncpa_residual_nm: residual_nm.map(|nm| nm[1]),
            reduced_chi2: estimate.reduced_chi2,
            evaluations: estimate.evaluations(),
            device: &estimate.device,
            precision: estimate.precision.word(),
            status: estimate.status.word(),
            warnings: &estimate.warnings,
            policy: estimate.policy.name(),
            model: &estimate.model,
            method: estimate.method().word(),
            knows: map.map(|map| map.knows.word()),
            iterations: map.map(|map| map.iterations.len()),
            telemetry_gain: telemetry.map(|check| check.gain),
            telemetry_correlation: telemetry.map(|check| check.correlation),
        }
    }
}
