//! `cophase compare`: an estimate against the truth.

use cophase::io::FitsReader;
use cophase::pipeline::{Comparison, ForeignComparison, ForeignTruth, StaticMaps, read_pistons};
use cophase::scene::Scene;
use cophase::telescope::{OpdMap, SegmentPlace, Telescope};
use cophase::{Error, Result};
use cophase_view::terminal::Terminal;
use serde::Serialize;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  cophase compare est.fits --truth images.fits
  cophase compare est.fits --truth images.fits --json
  cophase compare est.fits --truth-pistons pistons.txt --truth-ncpa ncpa.fits
  cophase compare est.fits --truth-phasing 'other.fits[SEGMENTS]'
  cophase compare est.fits --truth-opd opd.fits

Maps: FITS, the first image or that of the HDU in brackets, on any grid: of the unit of the card BUNIT (nm, um, m; nm without it) and \
of the width of the card GRID_M, or of samples PUPLSCAL apart, m; else as wide as the estimate's. Rows are y and columns x, as \
in the estimate. A map on another grid is interpolated, and samples at an edge, for which it may have the value of another \
segment, are left out. --truth-opd is the whole wavefront; where it has cards S01PISTN, S01XTILT, S01YTILT, ..., as STPSF \
writes them, these are the segment errors and the map is the NCPA.

Pistons: text (.txt, .csv, .dat) with rows of segment and piston in nm, or the columns LABEL (or SEGMENT) and PISTON_NM of a FITS \
table SEGMENTS. A segment has its number or label in the table SEGMENTS of the estimate.

--json prints: phasing_residual_nm, ncpa_residual_nm, wavefront_residual_nm, null where the truth is not known; samples (of the \
pupil), samples_left_out.";

/// Compare an estimate with the truth: RMS over the pupil, tip and tilt removed
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// FITS file that 'cophase estimate' wrote
    estimate: PathBuf,
    /// FITS file with TRUTH_PHASING and TRUTH_NCPA, as 'cophase image' writes them [default: the
    /// estimate's own]
    #[arg(long, value_name = "FILE", conflicts_with_all = ["truth_pistons", "truth_phasing", "truth_ncpa", "truth_opd"])]
    truth: Option<PathBuf>,
    /// True piston of each segment, nm
    #[arg(long, value_name = "FILE", conflicts_with_all = ["truth_phasing", "truth_opd"])]
    truth_pistons: Option<PathBuf>,
    /// FITS map of the true segment errors
    #[arg(long, value_name = "MAP", conflicts_with = "truth_opd")]
    truth_phasing: Option<PathBuf>,
    /// FITS map of the true NCPA
    #[arg(long, value_name = "MAP", conflicts_with = "truth_opd")]
    truth_ncpa: Option<PathBuf>,
    /// FITS map of the whole true wavefront (OPD), in the convention of POPPY and STPSF
    #[arg(long, value_name = "MAP")]
    truth_opd: Option<PathBuf>,
    /// Let the scene in the estimate name files outside of its folder
    #[arg(long)]
    foreign_files: bool,
    /// Print the residuals as JSON
    #[arg(long)]
    json: bool,
}

/// What `compare --json` prints; scripts rely on these keys.
#[derive(Serialize)]
struct Summary {
    phasing_residual_nm: Option<f64>,
    ncpa_residual_nm: Option<f64>,
    wavefront_residual_nm: Option<f64>,
    samples: usize,
    samples_left_out: usize,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let path = &arguments.estimate;
    let mut file = FitsReader::open(path)?;
    let maps = StaticMaps { phasing_nm: file.map(Some("PHASING"))?, ncpa_nm: file.map(Some("NCPA"))? };
    let scene = cophase::pipeline::embedded_scene(path, |_| arguments.foreign_files)?
        .ok_or_else(|| Error::file(path, "holds no scene (table SCENE), which says how the pupil is weighted"))?;
    let telescope = Telescope::new(&scene)?;
    let compared = |truth: &ForeignTruth| truth.compare(&telescope, &maps);
    let found = match arguments.foreign(&scene, &telescope)? {
        Some(truth) => compared(&truth).map_err(|error| Error::file(path, error))?,
        None => {
            let truth_path: &Path = arguments.truth.as_deref().unwrap_or(path);
            let truth = StaticMaps::read_truth(truth_path)?.ok_or_else(|| {
                let other = if arguments.truth.is_none() { ": name a file that does with --truth" } else { "" };
                Error::file(truth_path, format_args!("holds no truth (images TRUTH_PHASING and TRUTH_NCPA){other}"))
            })?;
            let about = |error| Error::file(path, format_args!("compared with {}: {error}", truth_path.display()));
            if is_on_grid(truth_path, &truth, &telescope)? {
                let found = Comparison::new(&telescope.pupil, &maps, &truth).map_err(about)?;
                let samples = telescope.pupil.amplitude.iter().filter(|amplitude| **amplitude > 0.0).count();
                ForeignComparison { rms_nm: found.rms_nm.map(Some), samples, left_out: 0 }
            } else {
                let map = |name: &str| OpdMap::read(Path::new(&format!("{}[{name}]", truth_path.display())));
                let (phasing, ncpa) = (Some(map("TRUTH_PHASING")?), Some(map("TRUTH_NCPA")?));
                compared(&ForeignTruth { phasing, ncpa, ..ForeignTruth::default() }).map_err(about)?
            }
        }
    };
    show(&found, arguments.json, terminal)
}

impl Arguments {
    /// The truth of another program; `None` where none is named.
    fn foreign(&self, scene: &Scene, telescope: &Telescope) -> Result<Option<ForeignTruth>> {
        let map = |path: &Option<PathBuf>| path.as_ref().map(|path| OpdMap::read(path)).transpose();
        let places = SegmentPlace::all(scene, &telescope.pupil.segments);
        let pistons_nm = |path: &PathBuf| read_pistons(path, &places, scene.image.wavelength_nm);
        let truth = ForeignTruth {
            pistons_nm: self.truth_pistons.as_ref().map(pistons_nm).transpose()?,
            phasing: map(&self.truth_phasing)?,
            ncpa: map(&self.truth_ncpa)?,
            wavefront: map(&self.truth_opd)?,
        };
        let has_map = [&truth.phasing, &truth.ncpa, &truth.wavefront].iter().any(|map| map.is_some());
        Ok((has_map || truth.pistons_nm.is_some()).then_some(truth))
    }
}

/// Whether the maps of `truth`, which are in the file `path`, are on the grid of `telescope`.
fn is_on_grid(path: &Path, truth: &StaticMaps, telescope: &Telescope) -> Result<bool> {
    let grid = &telescope.pupil.grid;
    let width_m = FitsReader::open(path)?.card(Some("TRUTH_PHASING"), "GRID_M")?.and_then(|card| card.number());
    let is_as_wide = width_m.is_none_or(|width_m| (width_m - grid.width_m()).abs() <= 1e-6 * grid.width_m());
    Ok(is_as_wide
        && [&truth.phasing_nm, &truth.ncpa_nm].iter().all(|map| map.dim() == (grid.samples(), grid.samples())))
}

fn show(found: &ForeignComparison, json: bool, terminal: &Terminal) -> Result<()> {
    let [phasing, ncpa, wavefront] = found.rms_nm;
    if json {
        return terminal.json(&Summary {
            phasing_residual_nm: phasing,
            ncpa_residual_nm: ncpa,
            wavefront_residual_nm: wavefront,
            samples: found.samples,
            samples_left_out: found.left_out,
        });
    }
    let row = |name: &str, nm: Option<f64>| match nm {
        Some(nm) => format!("{name:<12}{nm:>16.3}\n"),
        None => format!("{name:<12}{:>16}\n", "unknown"),
    };
    let head = format!("{:<12}{:>16}\n", "", "residual [nm]");
    let rows = row("phasing", phasing) + &row("NCPA", ncpa) + &row("wavefront", wavefront);
    let remark = found.remark().map_or(String::new(), |remark| format!("{remark}.\n"));
    terminal.show(&(head + &rows + "\nRMS over the pupil, tip and tilt removed.\n" + &remark))
}
