//! Draws: images behind a loop, read in full-phase and in the paper's way.

use super::rows::BeyondRow;
use crate::reproduce::on_sky::{Reader, Sequence};
use crate::reproduce::{Conditions, Progress, Way};
use cophase::ao::Simulator;
use cophase::metrics::residual_nm;
use cophase::pipeline::Estimate;
use cophase::pupil::Pupil;
use cophase::scene::Scene;
use cophase::source::{Truth, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::{Array2, s};

/// Columns of the file of draws.
pub(super) const HEAD: &str = "row,seed,images,used,passes,phasing_nm,ncpa_nm,phasing_sigma_nm,ncpa_sigma_nm,chi2,\
                               first_phasing_nm,first_ncpa_nm,paper_phasing_nm,paper_ncpa_nm,seconds,retrieval_ms";

/// The sky of a second sequence is another.
const SECOND_SKY: usize = 1000;

/// One draw of one row.
#[derive(Debug, Clone, PartialEq)]
pub struct BeyondDraw {
    /// Name of the row.
    pub row: String,
    /// Seed of aberrations, turbulence and noise.
    pub seed: usize,
    /// The numbers of the columns after them, in order.
    pub numbers: [f64; 14],
}

impl BeyondDraw {
    pub(super) fn line(&self) -> String {
        let numbers: Vec<String> = self.numbers.iter().map(|number| format!("{number:.4}")).collect();
        // A comma in a name would be a column.
        format!("{},{},{}", self.row.replace(',', ";"), self.seed, numbers.join(","))
    }

    pub(super) fn parse(line: &str) -> Option<Self> {
        let mut cells = line.split(',');
        let (row, seed) = (cells.next()?.replace(';', ","), cells.next()?.parse().ok()?);
        let numbers: Vec<f64> = cells.map(|cell| cell.parse().ok()).collect::<Option<_>>()?;
        Some(Self { row, seed, numbers: numbers.try_into().ok()? })
    }

    pub(super) fn passes(&self) -> f64 {
        self.numbers[2]
    }

    pub(super) fn residuals_nm(&self) -> [f64; 2] {
        [self.numbers[3], self.numbers[4]]
    }

    pub(super) fn sigmas_nm(&self) -> [f64; 2] {
        [self.numbers[5], self.numbers[6]]
    }

    pub(super) fn chi2(&self) -> f64 {
        self.numbers[7]
    }

    pub(super) fn first_nm(&self) -> [f64; 2] {
        [self.numbers[8], self.numbers[9]]
    }

    pub(super) fn paper_nm(&self) -> [f64; 2] {
        [self.numbers[10], self.numbers[11]]
    }

    pub(super) fn retrieval_ms(&self) -> f64 {
        self.numbers[13]
    }
}

/// Images behind a loop, and the pupil of their truth.
pub(super) struct Behind {
    sequence: Sequence,
    /// The pupil on which the truth is.
    pupil: Pupil,
    /// Residuals of the paper's way on the first so many images, by the scene that read them: rows
    /// share them.
    paper_nm: Vec<(Scene, [f64; 2])>,
}

impl Behind {
    /// The images that `simulator` is set to take.
    pub(super) fn of(simulator: Simulator, progress: &Progress) -> Result<Self> {
        let pupil = simulator.telescope().pupil.clone();
        Ok(Self { sequence: Sequence::behind(simulator, progress)?, pupil, paper_nm: Vec::new() })
    }

    /// These, estimates of whose NCPA are held against `ncpa_nm`, if any, in place of all that they
    /// show.
    pub(super) fn held_against(mut self, ncpa_nm: Option<Array2<f64>>) -> Self {
        self.sequence.ncpa_nm = ncpa_nm.unwrap_or(self.sequence.ncpa_nm);
        self
    }

    /// Residuals of maps against the truth. Where one of the pupils has no glass there is nothing
    /// to compare.
    fn residuals_nm(&self, phasing_nm: &Array2<f64>, ncpa_nm: &Array2<f64>) -> Result<[f64; 2]> {
        let on = |map: &Array2<f64>| map.mapv(|nm| if nm.is_finite() { nm } else { 0.0 });
        let residual = |map, truth| residual_nm(&self.pupil, on(map).view(), on(truth).view());
        let truth = &self.sequence;
        Ok([residual(phasing_nm, &truth.phasing_nm)?, residual(ncpa_nm, &truth.ncpa_nm)?])
    }

    /// Phasing and NCPA in the paper's way; none where nothing can be fitted.
    fn paper_maps(&self, reader: &Scene, count: usize, progress: &Progress) -> Result<Option<[Array2<f64>; 2]>> {
        let all = &self.sequence;
        let sequence = Sequence {
            images_e: all.images_e.slice(s![..count, .., ..]).to_owned(),
            slopes_mas: all.slopes_mas.slice(s![..count, ..]).to_owned(),
            phasing_nm: all.phasing_nm.clone(),
            ncpa_nm: all.ncpa_nm.clone(),
            run: None,
        };
        let fitted = Reader::new(Way::Paper, reader)?.fit(&sequence, &Progress::new(&|_, _| {}, progress.control()))?;
        Ok(fitted.map(|estimate| [estimate.combined.maps.phasing_nm, estimate.combined.maps.ncpa_nm]))
    }

    /// Residuals of the paper's way, which no row asks twice.
    fn paper_nm(&mut self, reader: &Scene, count: usize, progress: &Progress) -> Result<[f64; 2]> {
        if let Some((_, known)) = self.paper_nm.iter().find(|(scene, _)| **scene == **reader) {
            return Ok(*known);
        }
        let maps = self.paper_maps(reader, count, progress)?;
        let found = maps.map_or(Ok([f64::NAN; 2]), |[phasing, ncpa]| self.residuals_nm(&phasing, &ncpa))?;
        self.paper_nm.push((reader.clone(), found));
        Ok(found)
    }
}

/// The scene with which the paper's way reads what `reader` does in full-phase: it knows nothing of
/// the loop.
fn modal(reader: &Scene) -> Result<Scene> {
    let settings =
        [("estimate.method", "modal"), ("estimate.ao_knowledge", ""), ("wavefront_sensor.slope_gain", "1.0")];
    let still = [("wavefront_sensor.shift_subapertures", "[0.0, 0.0]"), ("turbulence.wind_m_s", "[]")];
    let air = [("turbulence.wind_dir_rad", "[]"), ("turbulence.fractions", "[]"), ("turbulence.heights_m", "[]")];
    // Its modes need not hold the diversity, and its error bars are not asked for.
    let known = [("tolerance.defocus_fraction", "0")];
    reader.with(&settings)?.with(&[&still[..], &air, &known].concat())
}

impl BeyondRow {
    /// What this row makes of images of draw `seed`.
    pub(super) fn draw(
        &self,
        behind: &mut Behind,
        made: &Scene,
        seed: usize,
        progress: &Progress,
    ) -> Result<BeyondDraw> {
        let (reader, count) = (self.reader(made)?, made.image.count.min(behind.sequence.images()));
        let found = behind.sequence.full_phase(&reader, count, progress)?;
        let paper_nm = behind.paper_nm(&modal(&reader)?, count, progress)?;
        self.held(behind, &found, count, seed, paper_nm)
    }

    /// The paper's two steps: pistons estimated behind the loop of `first` and corrected, each way
    /// by its own estimate, then everything behind the row's own loop, under another sky.
    pub(super) fn two_steps(
        &self,
        first: &str,
        conditions: &Conditions,
        seed: usize,
        progress: &Progress,
    ) -> Result<BeyondDraw> {
        let before = self.made(first, conditions, seed)?;
        let behind = Behind::of(Simulator::new(&before)?, progress)?;
        let reader = self.reader(&before)?;
        let found = behind.sequence.full_phase(&reader, before.image.count, progress)?;
        let ours = self.corrected(&found.maps.phasing_nm, conditions, seed, progress)?;
        let Some([phasing_nm, _]) = behind.paper_maps(&modal(&reader)?, before.image.count, progress)? else {
            return Err(Error::Image(format!("the paper's way found nothing behind the loop {first}")));
        };
        let mut paper = self.corrected(&phasing_nm, conditions, seed, progress)?;
        let made = self.made(self.row, conditions, seed)?;
        let (reader, count) = (self.reader(&made)?, made.image.count);
        let paper_nm = paper.paper_nm(&modal(&reader)?, count, progress)?;
        self.held(&ours, &ours.sequence.full_phase(&reader, count, progress)?, count, seed, paper_nm)
    }

    /// Images behind the row's own loop with the pistons of draw `seed` less those of an estimate.
    fn corrected(
        &self,
        phasing_nm: &Array2<f64>,
        conditions: &Conditions,
        seed: usize,
        progress: &Progress,
    ) -> Result<Behind> {
        let made = self.made(self.row, conditions, seed)?;
        let sky = (seed + SECOND_SKY).to_string();
        let telescope = Telescope::new(&made)?;
        let truth = Truth::draw(&made, &telescope, &mut stream(seed as u64, 0))?;
        let (mut sums, mut samples) = (vec![0.0; truth.piston_nm.len()], vec![0.0; truth.piston_nm.len()]);
        for (&owner, nm) in telescope.pupil.owner.iter().zip(phasing_nm).filter(|(owner, _)| **owner >= 0) {
            (sums[owner as usize], samples[owner as usize]) =
                (sums[owner as usize] + nm, samples[owner as usize] + 1.0);
        }
        let left_nm = truth.piston_nm.iter().zip(sums.iter().zip(samples)).map(|(nm, (sum, n))| nm - sum / n).collect();
        let truth = truth.with_pistons(&telescope, left_nm)?;
        let second = made.with(&[("turbulence.seed", &*sky)])?;
        Behind::of(Simulator::with_truth(&second, telescope, truth)?, progress)
    }

    fn held(
        &self,
        behind: &Behind,
        found: &Estimate,
        count: usize,
        seed: usize,
        paper_nm: [f64; 2],
    ) -> Result<BeyondDraw> {
        let Some(map) = found.full_phase() else { return Err(Error::Internal("a sequence without iterations".into())) };
        let first = &map.iterations[0];
        let [phasing_nm, ncpa_nm] = behind.residuals_nm(&found.maps.phasing_nm, &found.maps.ncpa_nm)?;
        let [first_phasing_nm, first_ncpa_nm] = behind.residuals_nm(&first.maps.phasing_nm, &first.maps.ncpa_nm)?;
        let iterations = map.iterations.len() as f64;
        let numbers = [
            count as f64,
            found.used() as f64,
            iterations,
            phasing_nm,
            ncpa_nm,
            found.figures.phasing.sigma_nm,
            found.figures.ncpa.sigma_nm,
            found.reduced_chi2,
            first_phasing_nm,
            first_ncpa_nm,
            paper_nm[0],
            paper_nm[1],
            found.run.seconds,
            1e3 * map.retrieval_seconds / (count as f64 * iterations),
        ];
        Ok(BeyondDraw { row: self.name.to_string(), seed, numbers })
    }
}
