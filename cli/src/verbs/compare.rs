//! `cophase compare`: an estimate against the truth.

use crate::terminal::Terminal;
use cophase::io::FitsReader;
use cophase::pipeline::{Comparison, TruthMaps};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use serde::Serialize;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  cophase compare est.fits --truth images.fits
  cophase compare est.fits --truth images.fits --json

--json prints: phasing_residual_nm, ncpa_residual_nm, wavefront_residual_nm.";

/// Compare an estimate with the truth: RMS over the pupil, tip and tilt removed
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// FITS file that 'cophase estimate' wrote
    estimate: PathBuf,
    /// FITS file with TRUTH_PHASING and TRUTH_NCPA, as 'cophase image' writes them [default: the estimate's own]
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Print the residuals as JSON
    #[arg(long)]
    json: bool,
}

/// What `compare --json` prints; scripts rely on these keys.
#[derive(Serialize)]
struct Summary {
    phasing_residual_nm: f64,
    ncpa_residual_nm: f64,
    wavefront_residual_nm: f64,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let path = &arguments.estimate;
    let mut file = FitsReader::open(path)?;
    let (phasing_nm, ncpa_nm) = (file.map(Some("PHASING"))?, file.map(Some("NCPA"))?);
    let scene = cophase::pipeline::embedded_scene(path)?
        .ok_or_else(|| Error::file(path, "holds no scene (table SCENE), which says how the pupil is weighted"))?;
    let truth_path: &Path = arguments.truth.as_deref().unwrap_or(path);
    let truth = TruthMaps::read(truth_path)?.ok_or_else(|| {
        let other = if arguments.truth.is_none() { ": name a file that does with --truth" } else { "" };
        Error::file(truth_path, format_args!("holds no truth (images TRUTH_PHASING and TRUTH_NCPA){other}"))
    })?;
    check_widths((path, "PHASING"), (truth_path, "TRUTH_PHASING"))?;
    let pupil = Telescope::new(&scene)?.pupil;
    let residual = Comparison::new(&pupil, &phasing_nm, &ncpa_nm, &truth)
        .map_err(|error| Error::file(path, format_args!("compared with {}: {error}", truth_path.display())))?;
    let [phasing, ncpa, wavefront] = residual.rms_nm;
    if arguments.json {
        let summary =
            Summary { phasing_residual_nm: phasing, ncpa_residual_nm: ncpa, wavefront_residual_nm: wavefront };
        return terminal.json(&summary);
    }
    let row = |name: &str, nm: f64| format!("{name:<12}{nm:>16.3}\n");
    let head = format!("{:<12}{:>16}\n", "", "residual [nm]");
    let rows = row("phasing", phasing) + &row("NCPA", ncpa) + &row("wavefront", wavefront);
    terminal.show(&(head + &rows + "\nRMS over the pupil, tip and tilt removed.\n"))
}

/// Refuses maps whose cards GRID_M differ: with the same number of samples they would be compared at other places of the
/// mirror.
fn check_widths(estimate: (&Path, &str), truth: (&Path, &str)) -> Result<()> {
    let width_m = |(path, hdu): (&Path, &str)| -> Result<Option<f64>> {
        Ok(FitsReader::open(path)?.card(Some(hdu), "GRID_M")?.and_then(|card| card.number()))
    };
    match (width_m(estimate)?, width_m(truth)?) {
        (Some(own), Some(other)) if (own - other).abs() > 1e-6 * own => Err(Error::file(
            truth.0,
            format_args!(
                "its maps are {other} m wide (GRID_M), and those of {} are {own} m: maps of one grid can be compared",
                estimate.0.display()
            ),
        )),
        _ => Ok(()),
    }
}
