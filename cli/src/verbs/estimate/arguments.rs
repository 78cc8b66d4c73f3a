//! The command line of an estimate.

use cophase::Result;
use cophase::scene::{DeviceChoice, Scene};
use cophase_view::files::Settings;
use cophase_view::outputs::{self, Flagged};
use cophase_view::ranks::Share;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  cophase estimate images.fits -o est.fits      from what 'cophase image' made
  cophase estimate nirc2.fits --scene scene.toml -o est.fits --plot est.png
  cophase estimate images.fits -o paper.fits --optimizer bfgs
  cophase estimate onsky.fits -o est.fits --method full-phase --commands c.fits
  cophase estimate images.fits -o est.fits --commands-plot what-would-move.png
  cophase estimate images.fits -o est.fits --opd opd.fits
  cophase estimate images.fits -o est.fits --report est.html
  cophase estimate night.fits --slopes wfs.fits --scene s.toml -o est.fits
  cophase estimate --channel K=k.fit --channel H=h.fit --scene s.toml -o e.fits
  cophase estimate night.fits -o part3.fits --part 3/8     see 'cophase merge'
  mpirun -n 8 cophase estimate night.fits -o est.fits --part rank

Images: FITS, 2-D or a cube, in the HDU IMAGES, the primary one or the first image extension, or in the HDU whose name or \
number follows the file's in brackets: 'night.fits[SCI]'. Those of several channels are HDUs IMAGES with EXTVER 1, 2, ... and \
their names in the card CHANNEL, or a file each (--channel). Pixels that are not finite are masked, and those that an image HDU \
BADPIX (not zero = bad) or --mask names.

Slopes of the wavefront sensor: in the HDU SLOPES_MEAN or SLOPES of the images' file, or in a file of their own (--slopes): a row for each \
image, in the order and unit of [wavefront_sensor]; NaN for images without.

Units: electrons, or counts (card BUNIT 'adu', 'DN', 'count'), which are converted with the electrons per count of \
--gain, image.gain_e_per_adu of the scene, or the card EGAIN or GAIN. Counts without a gain are refused.

Cards: the file must not contradict the scene. Wavelength (WAVELEN, WAVELENG, CENWAVE, EFFWAVE, ...), broad band (FILTER = 'J', \
'H', 'Kp + clear', ...), pixel scale (PIXSCALE, PIXELSCL, SECPIX, CDELT1 or CD1_1 of the sky), read noise (RON_E, RON, RDNOISE, \
READNOIS), gain, exposure (EXPTIME, ITIME, ...; where the scene names it) and the scene in a file of cophase are compared \
with the keys; --trust scene or --trust file decides, and a key of --set or --gain takes precedence over the file. Where the \
scene has no read noise, the card's is used, else the scatter of the image's border.

The error bars of eight images or more are from the scatter between them, and the clipped \
mean (the default; --set estimate.combine=mean or median) leaves outliers out. Images that differ by more than their noise, and \
which no AO loop or turbulence of the scene lets differ, are left out where they are less than a third, with a warning; else the \
status is contradictory.

--json prints: channels (their names), images, used, clipped, combine, seconds, phasing_rms_nm, ncpa_rms_nm, phasing_sigma_nm, ncpa_sigma_nm, \
phasing_residual_nm and ncpa_residual_nm (where the truth is known), reduced_chi2, evaluations (of the objective, all \
images together), device, precision, status (the worst of the images': ok, misfit, wrong-minimum, not-converged, \
unusable; contradictory where the images are of several wavefronts), warnings (sentences), policy, model (the modes that were added), method, and with full-phase ao_knowledge, \
iterations, telemetry_gain and telemetry_correlation (of the measured slopes with those of the retrieved wavefronts), \
error_budget (name, phasing_nm and ncpa_nm of each term), model_errors (modal, unless estimate.posterior = false: name, value, sigma, tolerance and \
significance of each error of the optics and the camera), without_staircases (phasing_rms_nm, ncpa_rms_nm, phasing_sigma_nm and \
ncpa_sigma_nm without the focus and astigmatisms of the whole pupil, where only a tolerance divides them between the two); null where a key does not apply.";

/// Estimate segment phasing and NCPA from defocused images of a star
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// FITS file with one image or a cube of them, FILE or FILE[HDU], or with those of several
    /// channels; - for standard input
    #[arg(required_unless_present = "channel", conflicts_with = "channel")]
    pub(super) images: Option<PathBuf>,
    /// FITS file with the images of one channel of the scene ([[image.channel]]); once for each
    /// channel
    #[arg(long, value_name = "NAME=FILE", value_parser = channel, hide_short_help = true)]
    pub(super) channel: Vec<(String, PathBuf)>,
    /// FITS file to write: maps, modes, error bars; one that is there is replaced; .fits.gz is
    /// compressed
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: PathBuf,
    /// Scene: a TOML file, or the name of a preset [default: the scene in the image file]
    #[arg(long)]
    pub(super) scene: Option<PathBuf>,
    /// FITS file that marks bad pixels: not zero = bad
    #[arg(long, value_name = "FILE")]
    pub(super) mask: Option<PathBuf>,
    /// Electrons per count of images in counts (image.gain_e_per_adu) [default: the scene's, else
    /// the card EGAIN or GAIN]
    #[arg(long, value_name = "E_PER_ADU")]
    pub(super) gain: Option<f64>,
    /// What holds where the file contradicts the scene [default: neither, it is an error]
    #[arg(long, value_parser = ["scene", "file"])]
    pub(super) trust: Option<String>,
    /// Also draw the result
    #[arg(long, value_name = "FILE.png|svg")]
    pub(super) plot: Option<PathBuf>,
    /// Where to run: auto, cpu, opencl or opencl:P:D, as 'cophase devices' lists them; all: modal
    /// fits shared among all GPUs, or among all OpenCL devices where there is no GPU
    #[arg(long, value_parser = device)]
    pub(super) device: Option<String>,
    /// Precision of the imaging model [default: f64, or f32 with full-phase]
    #[arg(long, value_parser = ["f64", "f32"], hide_short_help = true)]
    pub(super) precision: Option<String>,
    /// Ours (gauss-newton), the method of Lamb et al. (2021) as a whole (bfgs), or its objective
    /// with our optimiser (paper)
    #[arg(long, value_parser = ["gauss-newton", "bfgs", "paper"], hide_short_help = true)]
    pub(super) optimizer: Option<String>,
    /// RMS error that is allowed, nm, noise included: plans the cheapest model that keeps it (see
    /// cophase plan)
    #[arg(long, value_name = "NM", hide_short_help = true)]
    pub(super) budget_nm: Option<f64>,
    /// The estimator: static modes, fitted image by image (modal), or the whole wavefront behind
    /// each image of a sequence behind adaptive optics (full-phase); auto: full-phase where the
    /// scene has turbulence or a loop and the images change
    #[arg(long, value_parser = ["modal", "full-phase", "auto"])]
    pub(super) method: Option<String>,
    /// What full-phase assumes of the adaptive optics: nothing, its spectrum, the loop, its
    /// telemetry [default: the most there is]
    #[arg(long, value_parser = ["nothing", "spectrum", "loop", "telemetry"], hide_short_help = true)]
    pub(super) ao_knowledge: Option<String>,
    /// Slopes that come with the images, with full-phase: refused where they do not belong to the
    /// images (check), divided by the gain that is found and used (use), or left out (ignore)
    /// [default: check]
    #[arg(long, value_parser = ["check", "use", "ignore"], hide_short_help = true)]
    pub(super) telemetry: Option<String>,
    /// FITS file with the slopes of the wavefront sensor, [image, slope], in place of those in the
    /// file of the images: FILE or FILE[HDU], of one channel NAME=FILE
    #[arg(long, value_name = "FILE", value_parser = file_of_channel, hide_short_help = true)]
    pub(super) slopes: Vec<(Option<String>, PathBuf)>,
    /// Also write corrections: what to add to segments, mirror and (full-phase) reference slopes;
    /// FITS, or text for FILE.txt
    #[arg(long, value_name = "FILE")]
    pub(super) commands: Option<PathBuf>,
    /// Also draw the corrections: what would move, in the terms of the controllers ([commands] of
    /// the scene)
    #[arg(long, value_name = "FILE.png|svg", hide_short_help = true)]
    pub(super) commands_plot: Option<PathBuf>,
    /// Also write phasing and NCPA together as an OPD map, m, as POPPY and STPSF read it (BUNIT,
    /// PUPLSCAL)
    #[arg(long, value_name = "FILE", hide_short_help = true)]
    pub(super) opd: Option<PathBuf>,
    /// Also write a report for people: one HTML file with maps, images, segments, modes, warnings
    /// and settings
    #[arg(long, value_name = "FILE.html")]
    pub(super) report: Option<PathBuf>,
    #[command(flatten)]
    pub(super) settings: Settings,
    /// Fit the images of part I of N only, and write the part to -o: 'cophase merge' makes the
    /// estimate of all parts, with the other outputs of this command. rank: the part of this
    /// process under mpirun or srun, whose first process merges
    #[arg(long, value_name = "I/N|rank", hide_short_help = true)]
    pub(super) part: Option<Share>,
    /// Print the result as JSON
    #[arg(long)]
    pub(super) json: bool,
    /// Exit with status 3 where the estimate carries a warning, or a status other than ok; the
    /// output is written all the same
    #[arg(long)]
    pub(super) strict: bool,
    /// Also say which combinations of modes the images determine poorly
    #[arg(short, long)]
    pub(super) verbose: bool,
}

fn device(word: &str) -> Result<String> {
    word.parse::<DeviceChoice>().map(|_| word.to_string())
}

/// The name of a channel, and the file with its images.
fn channel(argument: &str) -> std::result::Result<(String, PathBuf), String> {
    match argument.split_once('=') {
        Some((name, file)) if !name.is_empty() && !file.is_empty() => Ok((name.into(), file.into())),
        _ => Err("a channel and its file are needed, such as plus=a.fits".into()),
    }
}

/// A file, and the channel that is named before it; the name of a file that is there may have an
/// equals sign.
fn file_of_channel(argument: &str) -> std::result::Result<(Option<String>, PathBuf), String> {
    if !argument.contains('=') || Path::new(argument).exists() {
        return Ok((None, argument.into()));
    }
    channel(argument).map(|(name, file)| (Some(name), file))
}

impl Arguments {
    /// The files with images, and the channels that the command line names for them.
    pub(super) fn sources(&self) -> Vec<(Option<&str>, &Path)> {
        let named = self.channel.iter().map(|(name, file)| (Some(name.as_str()), file.as_path()));
        self.images.iter().map(|file| (None, file.as_path())).chain(named).collect()
    }

    /// The file of the first images, after which the result is named.
    pub(super) fn first(&self) -> &Path {
        self.sources().first().map_or(Path::new(""), |(_, file)| *file)
    }

    /// The options that are keys of the scene.
    pub(super) fn options(&self) -> Vec<(&str, &str)> {
        let options = [
            ("estimate.device", &self.device),
            ("estimate.precision", &self.precision),
            ("estimate.optimizer", &self.optimizer),
            ("estimate.method", &self.method),
            ("estimate.ao_knowledge", &self.ao_knowledge),
            ("estimate.telemetry", &self.telemetry),
        ];
        options.into_iter().filter_map(|(key, value)| Some((key, value.as_deref()?))).collect()
    }

    pub(super) fn outputs(&self) -> Vec<Flagged<'_>> {
        let also = [
            ("--commands", &self.commands),
            ("--plot", &self.plot),
            ("--commands-plot", &self.commands_plot),
            ("--opd", &self.opd),
            ("--report", &self.report),
        ];
        let also = also.into_iter().filter_map(|(flag, path)| Some((flag, path.as_deref()?)));
        [("-o", self.output.as_path())].into_iter().chain(also).collect()
    }

    pub(super) fn check_outputs(&self) -> Result<()> {
        for (flag, plot) in [("--plot", &self.plot), ("--commands-plot", &self.commands_plot)] {
            if let Some(plot) = plot {
                outputs::check_picture((flag, plot))?;
            }
        }
        if let Some(report) = &self.report {
            outputs::check_report(("--report", report))?;
        }
        outputs::check(&self.outputs(), &self.read_files())
    }

    pub(super) fn scene(&self) -> Result<Scene> {
        let [budget, gain] = [self.budget_nm, self.gain].map(|number| number.map(|number| number.to_string()));
        let mut options = self.options();
        options.extend(budget.as_deref().map(|nm| ("estimate.budget_nm", nm)));
        options.extend(gain.as_deref().map(|gain| (GAIN, gain)));
        self.settings.scene_of(self.scene.as_deref(), self.first(), &options)
    }
}

/// Key of --gain.
pub(super) const GAIN: &str = "image.gain_e_per_adu";
