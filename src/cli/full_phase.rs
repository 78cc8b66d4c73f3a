//! `cophase estimate --method full-phase`: a sequence behind adaptive optics.

use super::figures::Residual;
use super::files::Truth;
use super::interrupt::Interrupt;
use super::report;
use super::terminal::Terminal;
use cophase::io::{FitsReader, Images};
use cophase::plot::{EstimatePicture, MapTriple, ModalBars, ModeGroup};
use cophase::scene::{Knows, Scene};
use cophase::sequence_estimate::{self, FullPhase, SkyImages};
use cophase::{Error, Result};
use ndarray::Array2;
use serde::Serialize;
use std::path::Path;

/// What is asked of an estimate beside its images.
pub struct Wanted<'a> {
    pub output: &'a Path,
    pub plot: Option<&'a Path>,
    pub commands: Option<&'a Path>,
    pub json: bool,
}

/// What `estimate --json` prints; the keys of the modal estimate, and what this one has beside.
#[derive(Serialize)]
struct Summary<'a> {
    images: usize,
    used: usize,
    seconds: f64,
    phasing_rms_nm: f64,
    ncpa_rms_nm: f64,
    phasing_sigma_nm: f64,
    ncpa_sigma_nm: f64,
    reduced_chi2: f64,
    evaluations: usize,
    device: &'a str,
    precision: &'static str,
    status: &'static str,
    method: &'static str,
    knows: &'static str,
    passes: usize,
}

/// The slopes of a file, mean over each exposure, if it holds them for every image.
fn slopes(path: &Path, count: usize) -> Result<Option<Array2<f64>>> {
    let mut file = FitsReader::open(path)?;
    let names = file.names();
    let Some(name) = ["SLOPES_MEAN", "SLOPES"].into_iter().find(|name| names.iter().any(|known| known == name)) else {
        return Ok(None);
    };
    let slopes_mas = file.map(Some(name))?;
    if slopes_mas.nrows() != count {
        let reason =
            format!("{name} holds {} sets of slopes for {count} images: one each is needed", slopes_mas.nrows());
        return Err(Error::file(path, reason));
    }
    Ok(Some(slopes_mas))
}

/// What there is to read.
pub struct Given<'a> {
    /// File of the images.
    pub name: &'a Path,
    pub scene: &'a Scene,
    pub images: Images,
    /// Read noise that goes before the scene's.
    pub read_noise_e: Option<f64>,
    pub truth: Option<Truth>,
}

pub fn run(given: Given, wanted: &Wanted, terminal: &Terminal, interrupt: &Interrupt) -> Result<()> {
    let Given { name, scene, images, read_noise_e, truth } = given;
    for sentence in report::file_warnings(&name.display().to_string(), &images) {
        terminal.warn(&sentence);
    }
    let count = images.data.dim().0;
    // A level below telemetry asks for none, and a file's slopes may then be whatever they are.
    let heard = scene.estimate.knows.is_none_or(|knows| knows >= Knows::Telemetry);
    let slopes_mas = if heard { slopes(name, count)? } else { None };
    let images = SkyImages { images_e: images.data, bad: images.bad, read_noise_e, slopes_mas };
    let found = {
        let wait = terminal.wait(&format!("Wavefronts of {}", report::counted(count, "image")), count);
        sequence_estimate::read(scene, &images, Some(interrupt.flag()), &|done| wait.done(done))
            .map_err(super::files::about(name))?
    };
    interrupt.check("the images were read, nothing was written")?;
    let known = known(name, &found, truth, terminal)?;
    let maps = known.as_ref().map(|(truth, _)| [&truth.phasing_nm, &truth.ncpa_nm]);
    sequence_estimate::write(wanted.output, scene, &found, maps)?;
    if let Some(commands) = wanted.commands {
        found.result()?.corrections(&found.scene, None)?.write(commands)?;
    }
    if let Some(plot) = wanted.plot {
        let name = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy();
        picture(&name, &found, known.as_ref())?.draw(plot)?;
    }
    for sentence in found.warnings()? {
        terminal.warn(&format!("{}: {sentence}", name.display()));
    }
    if wanted.json {
        return terminal.json(&summary(&found)?);
    }
    terminal.show(&table(&name.display().to_string(), &found, known.as_ref().map(|(_, residual)| residual))?)
}

fn known(
    name: &Path,
    found: &FullPhase,
    truth: Option<Truth>,
    terminal: &Terminal,
) -> Result<Option<(Truth, Residual)>> {
    let pass = found.result()?;
    let Some(truth) = truth else { return Ok(None) };
    // A truth on another grid says nothing of these maps, and is no reason to withhold them.
    match Residual::of(&found.pupil, &pass.phasing_nm, &pass.ncpa_nm, &truth) {
        Ok(residual) => Ok(Some((truth, residual))),
        Err(error) => {
            terminal.warn(&format!("{}: its truth is not shown: {error}", name.display()));
            Ok(None)
        }
    }
}

fn summary(found: &FullPhase) -> Result<Summary<'_>> {
    let pass = found.result()?;
    let [phasing_rms_nm, ncpa_rms_nm] = found.rms_nm()?;
    Ok(Summary {
        images: found.reports.len(),
        used: pass.used_images.len(),
        seconds: found.seconds,
        phasing_rms_nm,
        ncpa_rms_nm,
        phasing_sigma_nm: pass.error_budget.total_nm[0],
        ncpa_sigma_nm: pass.error_budget.total_nm[1],
        reduced_chi2: pass.reduced_chi2,
        evaluations: found.reports.iter().map(|report| report.evaluations).sum(),
        device: &found.device,
        precision: found.precision.word(),
        status: if found.misfits()? { "misfit" } else { "ok" },
        method: "full-phase",
        knows: found.knows.word(),
        passes: found.passes.len(),
    })
}

fn table(name: &str, found: &FullPhase, residual: Option<&Residual>) -> Result<String> {
    let pass = found.result()?;
    let rms_nm = found.rms_nm()?;
    let passes: String = match found.passes.len() {
        1 => "1 pass".into(),
        count => format!("{count} passes"),
    };
    let mut text = format!(
        "{name}: {} of {} used, {passes}, knows {}\n\n",
        pass.used_images.len(),
        report::counted(found.reports.len(), "image"),
        found.knows.word()
    );
    let head = if residual.is_some() { "   residual [nm]" } else { "" };
    text += &format!("{:<12}{:>10}{:>12}{head}\n", "", "RMS [nm]", "1σ [nm]");
    for (i, what) in ["phasing", "NCPA"].into_iter().enumerate() {
        let residual = residual.map(|residual| format!("{:>16.3}", residual.rms_nm[i])).unwrap_or_default();
        text += &format!("{what:<12}{:>10.3}{:>12.3}{residual}\n", rms_nm[i], pass.error_budget.total_nm[i]);
    }
    let further = match pass.further_images([pass.error_budget.total_nm[0] / 2.0, pass.error_budget.total_nm[1] / 2.0])
    {
        Ok(further) => format!("Half the error bars take {further} more images."),
        Err(_) => "No number of images halves the error bars: they hold what all images share.".into(),
    };
    let of_diversity = report::of_diversity(&pass.diversity, &found.scene).unwrap_or_default();
    Ok(text
        + &format!(
            "\nRMS over the pupil, tip and tilt removed. Reduced χ² {:.2}. {further}\n\
             {:.1} s, {:.1} of them in {} retrievals, on {} in {}.\n",
            pass.reduced_chi2,
            found.seconds,
            found.retrieval_seconds,
            found.reports.len() * found.passes.len(),
            found.device,
            found.precision.word(),
        )
        + &of_diversity)
}

fn picture(name: &str, found: &FullPhase, known: Option<&(Truth, Residual)>) -> Result<EstimatePicture> {
    let pass = found.result()?;
    let triple = |estimate: &Array2<f64>, sigma: &Array2<f64>, truth: Option<(&Array2<f64>, &Array2<f64>)>| MapTriple {
        estimate: estimate.clone(),
        truth: truth.map(|(truth, _)| truth.clone()),
        residual: truth.map(|(_, residual)| residual.clone()),
        sigma: truth.is_none().then(|| sigma.clone()),
        width_m: found.pupil.grid.width_m(),
    };
    let segments = pass.errors.pistons_nm.len();
    let short = |ncpa: &String| ncpa.replace("noll-", "noll ").replace("kl-", "kl ");
    let names = (0..segments).map(|segment| format!("piston {segment}")).chain(pass.ncpa_names.iter().map(short));
    let rms_nm = found.rms_nm()?;
    let part =
        |i: usize, what: &str| format!("{what} {:.2} nm RMS (1σ {:.2})", rms_nm[i], pass.error_budget.total_nm[i]);
    Ok(EstimatePicture {
        title: format!("Phasing and NCPA from {name}"),
        subtitle: vec![
            format!("{}, {}, tip and tilt removed", part(0, "phasing"), part(1, "NCPA")),
            format!(
                "{} of {} images, full-phase, knows {}, {} passes, {:.1} s",
                pass.used_images.len(),
                found.reports.len(),
                found.knows.word(),
                found.passes.len(),
                found.seconds
            ),
        ],
        phasing: triple(
            &pass.phasing_nm,
            &pass.phasing_sigma_nm,
            known.map(|(truth, residual)| (&truth.phasing_nm, &residual.phasing_nm)),
        ),
        ncpa: triple(
            &pass.ncpa_nm,
            &pass.ncpa_sigma_nm,
            known.map(|(truth, residual)| (&truth.ncpa_nm, &residual.ncpa_nm)),
        ),
        bars: ModalBars {
            names: names.collect(),
            groups: (0..segments + pass.ncpa_names.len())
                .map(|mode| if mode < segments { ModeGroup::Segment } else { ModeGroup::Ncpa })
                .collect(),
            estimate_nm: pass.coefficients_nm(),
            sigma_nm: pass.sigma_nm(),
            truth_nm: None,
        },
        image: None,
    })
}
