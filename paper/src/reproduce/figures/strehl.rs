//! Section 4.5: the Strehl ratio in H before and after the segments are corrected, three ways, and
//! the PSFs.

use super::corrected::{Bench, STATES, State, watch};
use super::setup;
use crate::experiment::metrics::{Marechal, centre, strehl_by_energy, strehl_by_otf};
use crate::reproduce::statistics::{mean, standard_deviation};
use crate::reproduce::{Cell, Conditions, Progress, Report, Table};
use cophase::ao::{ScienceCamera, Simulator, View};
use cophase::pupil::Pupil;
use cophase::{Error, Result};
use cophase_view::plot::{CaptionedMap, MapScale, MapsPicture};
use ndarray::{Array2, s};
use rayon::prelude::*;
use std::path::Path;

/// The paper's filter in H, nm.
const WAVELENGTH_NM: f64 = 1640.0;
/// Pixels per λ/11.25 m: 4 per FWHM of either pupil, whose core is 1.2 λ/11.25 m wide, and 780
/// samples to transform.
const SAMPLES_PER_LAMBDA_OVER_D: f64 = 3.25;
/// Pixels a side: 37 λ/11.25 m to each side of the star, nearly four times as far as the mirror
/// reaches.
const PIXELS: usize = 240;
/// An image is made of every fourth frame: 4 ms apart, where the residual needs 50 ms to cross an
/// actuator's pitch.
const IMAGE_EVERY: u64 = 4;
/// PSFs that are summed by one worker: a fixed number, so that sums do not depend on how many there
/// are.
const BATCH: usize = 16;
/// Pixels a side that are drawn, and the darkest that differs from black, in powers of ten of the
/// perfect peak.
const DRAWN: usize = 160;
const DARKEST: f64 = -4.5;

/// What the paper prints: amplitude and state, phasing residual (nm), Strehl ratio in H.
const PUBLISHED: [(&str, f64, f64); 6] = [
    ("conventional, before", 64.15, 0.61),
    ("conventional, pass 1", 22.0, 0.62),
    ("substantial, before", 128.3, f64::NAN),
    ("substantial, pass 1", 39.0, f64::NAN),
    ("substantial, pass 2", 23.0, f64::NAN),
    ("phased", 0.0, 0.62),
];

/// One state of one draw.
#[derive(Debug, Clone)]
pub struct StrehlDraw {
    /// The draw.
    pub seed: usize,
    /// The telescope.
    pub state: State,
    /// By energy normalisation.
    pub energy: f64,
    /// By the OTF.
    pub otf: f64,
    /// Peak over perfect peak, both of PSFs that sum to 1 over an unbounded detector: what is meant
    /// by a Strehl ratio. That by energy is larger by the light that turbulence scatters out of the
    /// box.
    pub peak: f64,
    /// By Maréchal's approximation over all frames, NCPA included: the lowest, for it takes the
    /// variance of the phase to be the same all over the pupil, and turbulence that gathers at its
    /// edge costs less than that.
    pub marechal: f64,
}

/// All of them.
#[derive(Debug, Clone)]
pub struct Strehls {
    /// State by state, draw by draw.
    pub draws: Vec<StrehlDraw>,
    picture: MapsPicture,
}

/// Measures, corrects and images draws 1 to `seeds`.
///
/// # Errors
/// Those of the simulator, the estimator and the camera; [`Error::Interrupted`].
pub fn strehl(conditions: &Conditions, seeds: usize, progress: &Progress) -> Result<Strehls> {
    progress.check()?;
    let bench = Bench::new(conditions)?;
    // An image that is fitted takes about as long as one of these loops.
    progress.expect(seeds * (bench.images() + STATES));
    let (mut draws, mut maps) = (Vec::new(), Vec::new());
    for seed in 1..=seeds {
        for state in bench.states(seed, progress)? {
            let mut simulator = bench.delivering(seed, &state.piston_nm)?;
            let seen = Seen::of(&mut simulator, progress)?;
            let energy = strehl_by_energy(seen.image.view(), 0.0, seen.perfect.view())?;
            let per_lambda_over_d =
                SAMPLES_PER_LAMBDA_OVER_D * simulator.pupil().grid.width_m() / diameter_m(simulator.pupil());
            let otf = strehl_by_otf(seen.image.view(), 0.0, seen.perfect.view(), per_lambda_over_d)?;
            let peak = highest(&centre(seen.image.view())?.image) / highest(&seen.perfect);
            if seed == 1 {
                let caption = format!("{}: {:.1} %", state.short(), 100.0 * energy);
                maps.push(drawn(caption, &seen.image, &seen.perfect)?);
                if state.amplitude.is_none() {
                    maps.push(drawn("perfect".into(), &seen.perfect, &seen.perfect)?);
                }
            }
            draws.push(StrehlDraw { seed, state, energy, otf, peak, marechal: seen.marechal });
            progress.add(1);
        }
    }
    draws.sort_by_key(|draw| place(&draw.state));
    // A row for each amplitude: before and after its passes; what that compares with at the end of
    // the first.
    let order = [0, 1, 5, 6, 2, 3, 4];
    let picture = MapsPicture {
        title: format!("PSFs at {WAVELENGTH_NM} nm over the perfect peak, one second, and their Strehl ratios"),
        columns: 4,
        maps: order.iter().filter_map(|&map| maps.get(map).cloned()).collect(),
    };
    Ok(Strehls { draws, picture })
}

fn highest(image: &Array2<f64>) -> f64 {
    image.iter().copied().fold(f64::MIN_POSITIVE, f64::max)
}

/// Place of a state in the table.
fn place(state: &State) -> usize {
    PUBLISHED.iter().position(|(label, _, _)| *label == state.label()).unwrap_or(PUBLISHED.len())
}

/// What a second of the loop shows.
struct Seen {
    image: Array2<f64>,
    perfect: Array2<f64>,
    marechal: f64,
}

impl Seen {
    fn of(simulator: &mut Simulator, progress: &Progress) -> Result<Self> {
        let view = View {
            segments: true,
            ncpa: true,
            diversity: false,
            wavelength_nm: WAVELENGTH_NM,
            rows: PIXELS,
            columns: PIXELS,
            samples_per_lambda_over_d: SAMPLES_PER_LAMBDA_OVER_D,
            bandwidth_fraction: 0.0,
            spectrum: false,
        };
        let flat = simulator.footprint().zeros();
        let perfect = simulator.camera(View { segments: false, ncpa: false, ..view })?.psf(&flat).mapv(f64::from);
        let camera = simulator.camera(view)?;
        let ncpa_nm = setup::ncpa_nm(simulator)?;
        let (pupil, stride) = (simulator.pupil().clone(), simulator.footprint().stride());
        let mut marechal = Marechal::new(WAVELENGTH_NM)?;
        let mut wavefronts = Vec::new();
        watch(simulator, progress, |number, residual_nm| {
            marechal.add(rms_nm(&pupil, &ncpa_nm, residual_nm, stride))?;
            if number.is_multiple_of(IMAGE_EVERY) {
                wavefronts.push(residual_nm.to_vec());
            }
            Ok(())
        })?;
        progress.check()?;
        let image = exposure(&camera, &wavefronts);
        let marechal =
            marechal.strehl().ok_or_else(|| Error::Value("a second without a frame was asked for".into()))?;
        Ok(Self { image, perfect, marechal })
    }
}

/// The mean of the PSFs of `wavefronts`, `[y, x]`.
fn exposure(camera: &ScienceCamera, wavefronts: &[Vec<f32>]) -> Array2<f64> {
    let sum = |batch: &[Vec<f32>]| {
        let (mut camera, mut sum) = (camera.clone(), vec![0.0; camera.pixels()]);
        batch.iter().for_each(|residual_nm| camera.add(residual_nm, &mut sum));
        camera.to_image(&sum)
    };
    let batches: Vec<Array2<f32>> = wavefronts.par_chunks(BATCH).map(sum).collect();
    let mut image = Array2::zeros((PIXELS, PIXELS));
    for batch in batches {
        image.zip_mut_with(&batch, |out, &value| *out += f64::from(value));
    }
    image / wavefronts.len() as f64
}

/// RMS over the pupil of residual and NCPA together, piston removed, nm.
fn rms_nm(pupil: &Pupil, ncpa_nm: &Array2<f64>, residual_nm: &[f32], stride: usize) -> f64 {
    let (mut weight, mut first, mut second) = (0.0, 0.0, 0.0);
    for (((y, x), &a), ncpa_nm) in pupil.amplitude.indexed_iter().zip(ncpa_nm).filter(|((_, a), _)| **a > 0.0) {
        let opd_nm = ncpa_nm + f64::from(residual_nm[y * stride + x]);
        (weight, first, second) = (weight + a, first + a * opd_nm, second + a * opd_nm * opd_nm);
    }
    (second / weight - (first / weight).powi(2)).max(0.0).sqrt()
}

/// Diameter of the circle around the axis that holds the pupil, m.
fn diameter_m(pupil: &Pupil) -> f64 {
    let reach = |((y, x), _): ((usize, usize), &f64)| pupil.grid.coordinate_m(x).hypot(pupil.grid.coordinate_m(y));
    2.0 * pupil.amplitude.indexed_iter().filter(|(_, a)| **a > 0.0).map(reach).fold(0.0, f64::max)
}

/// The middle of a PSF, powers of ten of the perfect peak.
fn drawn(caption: String, image: &Array2<f64>, perfect: &Array2<f64>) -> Result<CaptionedMap> {
    let peak = highest(perfect);
    let centred = centre(image.view())?.image;
    let middle = PIXELS / 2 - DRAWN / 2..PIXELS / 2 + DRAWN / 2;
    let values = centred.slice(s![middle.clone(), middle]).mapv(|value| (value / peak).log10().max(DARKEST));
    Ok(CaptionedMap {
        caption,
        values,
        unit: "log₁₀".into(),
        width_m: None,
        scale: MapScale::Sequential,
        labels: Vec::new(),
    })
}

impl Strehls {
    /// One line for each state.
    pub fn summary(&self) -> Table {
        let mut table = Table::new(&[
            "state",
            "seeds",
            "phasing_nm",
            "phasing_sd_nm",
            "published_phasing_nm",
            "strehl_energy",
            "strehl_sd",
            "strehl_otf",
            "strehl_peak",
            "strehl_marechal",
            "published_strehl",
        ]);
        for (label, published_nm, published) in PUBLISHED {
            let draws = || self.draws.iter().filter(|draw| draw.state.label() == label);
            let of = |value: fn(&StrehlDraw) -> f64| draws().map(value).collect::<Vec<f64>>();
            let (phasing, energy) = (of(|draw| draw.state.phasing_nm), of(|draw| draw.energy));
            table.push(vec![
                label.into(),
                energy.len().into(),
                Cell::Number(mean(&phasing), 1),
                Cell::Number(standard_deviation(&phasing), 1),
                Cell::Number(published_nm, 1),
                Cell::Number(mean(&energy), 4),
                Cell::Number(standard_deviation(&energy), 4),
                Cell::Number(mean(&of(|draw| draw.otf)), 4),
                Cell::Number(mean(&of(|draw| draw.peak)), 4),
                Cell::Number(mean(&of(|draw| draw.marechal)), 4),
                Cell::Number(published, 2),
            ]);
        }
        table
    }

    /// One line for each state and draw.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "state",
            "seed",
            "phasing_nm",
            "strehl_energy",
            "strehl_otf",
            "strehl_peak",
            "strehl_marechal",
        ]);
        for draw in &self.draws {
            table.push(vec![
                Cell::Text(draw.state.label()),
                draw.seed.into(),
                Cell::Number(draw.state.phasing_nm, 2),
                Cell::Number(draw.energy, 4),
                Cell::Number(draw.otf, 4),
                Cell::Number(draw.peak, 4),
                Cell::Number(draw.marechal, 4),
            ]);
        }
        table
    }

    /// PSFs of the first draw.
    pub fn picture(&self) -> &MapsPicture {
        &self.picture
    }

    /// Strehl ratio (by energy) after all passes over that before, mean over draws: conventional,
    /// substantial.
    pub fn gain(&self) -> [f64; 2] {
        let of = |label: &str| {
            let draws = self.draws.iter().filter(|draw| draw.state.label() == label);
            mean(&draws.map(|draw| draw.energy).collect::<Vec<f64>>())
        };
        [of("conventional, pass 1") / of("conventional, before"), of("substantial, pass 2") / of("substantial, before")]
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["strehl.csv", "strehl-draws.csv", "strehl.png"].map(|name| directory.join(name));
        self.summary().write_csv(&files[0])?;
        self.table().write_csv(&files[1])?;
        self.picture.draw(&files[2])?;
        let gain = self.gain().map(|gain| 100.0 * (gain - 1.0));
        let text = format!(
            "Strehl ratio at {WAVELENGTH_NM} nm behind the plain zonal loop, NCPA in place, before and after the segments \
             are moved by what 75 images a pass said\n{}Gain: {:.1} % conventional, {:.1} % substantial (the paper: 61 to 62 \
             points, and about 10 %)\n\n",
            self.summary().text(),
            gain[0],
            gain[1]
        );
        Ok(Report { text, files: files.to_vec() })
    }
}
