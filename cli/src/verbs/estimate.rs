//! `cophase estimate`: the main job.

use super::figures::{self, Residual, Row};
use super::{devices, full_phase, picture, report};
use crate::files::{self, Settings, Truth};
use crate::interrupt::Interrupt;
use crate::terminal::Terminal;
use cophase::estimate::{self, Cube, Estimate, Estimator};
use cophase::io::{self, Images};
use cophase::scene::{DeviceChoice, Method, Scene};
use cophase::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::Instant;

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

--json prints: images, used, clipped, combine, seconds, phasing_rms_nm, ncpa_rms_nm, phasing_sigma_nm, ncpa_sigma_nm, reduced_chi2, \
evaluations (of the objective, all images together), device, precision, status (the worst of the images': ok, misfit, \
wrong-minimum, not-converged, unusable).";

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
    /// behind adaptive optics (full-phase)
    #[arg(long, value_parser = ["modal", "full-phase"])]
    method: Option<String>,
    /// What full-phase assumes of the adaptive optics: nothing, its spectrum, the loop, its telemetry [default: the most there is]
    #[arg(long, value_parser = ["nothing", "spectrum", "loop", "telemetry"])]
    knows: Option<String>,
    /// Also write corrections, with full-phase: what to add to segments, mirror and reference slopes
    #[arg(long, value_name = "FILE")]
    commands: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
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
            ("estimate.knows", &self.knows),
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

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    arguments.check_outputs()?;
    let images = io::read_images(&arguments.images, arguments.mask.as_deref())?;
    let truth = files::truth(&arguments.images)?;
    let mut scene = arguments.scene()?;
    if let Some(budget_nm) = scene.estimate.budget_nm {
        scene = super::plan::planned(&scene, budget_nm, terminal, &interrupt)?.scene;
    }
    // What the command line says goes before what the file says.
    let read_noise_e = images.read_noise_e.filter(|_| !arguments.settings.names("image.read_noise_e"));
    let (name, output, plot) = (arguments.images.as_path(), arguments.output.as_path(), arguments.plot.as_deref());
    if scene.estimate.method == Method::FullPhase {
        let wanted = full_phase::Wanted { output, plot, commands: arguments.commands.as_deref(), json: arguments.json };
        let given = full_phase::Given { name, scene: &scene, images, read_noise_e, truth };
        return full_phase::run(given, &wanted, terminal, &interrupt);
    }
    if let Some(commands) = &arguments.commands {
        let reason = "corrections come from the full-phase estimate: --method full-phase is needed";
        return Err(Error::file(commands, reason));
    }
    let job = Job { name, scene, read_noise_e, images, truth };
    let found = job.run(terminal, &interrupt)?;
    found.write(output, plot)?;
    found.tell(arguments.json, arguments.verbose, terminal)
}

/// One estimate, ready to run.
pub struct Job<'a> {
    /// File of the images.
    pub name: &'a Path,
    pub scene: Scene,
    pub images: Images,
    /// Read noise that goes before the scene's.
    pub read_noise_e: Option<f64>,
    pub truth: Option<Truth>,
}

impl<'a> Job<'a> {
    /// Builds the model and fits the images.
    pub fn run(self, terminal: &Terminal, interrupt: &Interrupt) -> Result<Found<'a>> {
        let Self { name, scene, images, read_noise_e, truth } = self;
        for sentence in report::file_warnings(&name.display().to_string(), &images) {
            terminal.warn(&sentence);
        }
        let started = Instant::now();
        let count = images.data.dim().0;
        let found = {
            let images_in_words = report::counted(count, "image");
            let wait = terminal.wait(&format!("Fitting {images_in_words}"), count);
            let mut watch = |done: usize, all: usize| {
                wait.done(done);
                if done == all {
                    wait.then(&format!("Error bars of {images_in_words}"));
                }
            };
            let mut open = |estimator: &Estimator| {
                interrupt.check("the model was built, no image was fitted")?;
                let optics = estimator.model().optics.clone();
                // No more are fitted at once.
                let count = count.min(estimator.model().tiles().images);
                devices::open_chain(scene.estimate.device, scene.estimate.precision, optics, count)
            };
            let cube = Cube { images_e: images.data.view(), bad: images.bad.view(), read_noise_e };
            estimate::read(&scene, cube, &mut open, Some(interrupt.flag()), &mut watch)
        };
        let (estimator, estimate) = found.map_err(files::about(name))?;
        let model_s = started.elapsed().as_secs_f64() - estimate.seconds;
        interrupt.check("the images were fitted, nothing was written")?;
        Found::new(name, estimator, estimate, truth, model_s, terminal)
    }
}

/// One estimate, done.
pub struct Found<'a> {
    name: &'a Path,
    estimator: Estimator,
    estimate: Estimate,
    known: Option<(Truth, Residual)>,
    rows: [Row; 3],
    model_s: f64,
}

impl<'a> Found<'a> {
    fn new(
        name: &'a Path,
        estimator: Estimator,
        estimate: Estimate,
        truth: Option<Truth>,
        model_s: f64,
        terminal: &Terminal,
    ) -> Result<Self> {
        let pupil = &estimator.model().telescope.pupil;
        let known = truth.and_then(|truth| {
            // A truth on another grid says nothing of these maps, and is no reason to withhold them.
            match Residual::of(pupil, &estimate.phasing_nm, &estimate.ncpa_nm, &truth) {
                Ok(residual) => Some((truth, residual)),
                Err(error) => {
                    terminal.warn(&format!("{}: its truth is not shown: {error}", name.display()));
                    None
                }
            }
        });
        let rows = figures::rows(estimator.model(), &estimate, known.as_ref().map(|(_, residual)| residual))?;
        Ok(Self { name, estimator, estimate, known, rows, model_s })
    }

    /// Writes the estimate, and its picture where one is asked for.
    pub fn write(&self, output: &Path, plot: Option<&Path>) -> Result<()> {
        let maps = self.known.as_ref().map(|(truth, _)| [&truth.phasing_nm, &truth.ncpa_nm]);
        estimate::write(output, &self.estimator, &self.estimate, maps)?;
        let Some(plot) = plot else { return Ok(()) };
        let name = self.name.file_name().unwrap_or(self.name.as_os_str()).to_string_lossy();
        let (scene, model) = (self.estimator.scene(), self.estimator.model());
        let known = self.known.as_ref().map(|(truth, residual)| (truth, residual));
        picture::picture(&name, scene, model, &self.estimate, &self.rows, known)?.draw(plot)
    }

    /// Prints the result, and what is odd about it.
    pub fn tell(&self, json: bool, verbose: bool, terminal: &Terminal) -> Result<()> {
        let (name, model, estimate) = (self.name.display().to_string(), self.estimator.model(), &self.estimate);
        let held = self.estimator.held_diversity()?;
        for sentence in report::warnings(&name, &self.estimator, &held, estimate) {
            terminal.warn(&sentence);
        }
        if json {
            return terminal.json(&report::Summary::of(estimate, &self.rows));
        }
        terminal.show(&report::table(&name, model, estimate, &self.rows, self.model_s))?;
        terminal.show(&report::of_optics(self.estimator.fitted_optics()))?;
        if let Some(sentence) = report::of_diversity(&held, self.estimator.scene()) {
            terminal.show(&sentence)?;
        }
        if verbose {
            terminal.show(&format!("\n{}\n", estimate.degeneracy))?;
        }
        Ok(())
    }
}
