//! The phases that a simulated run really had: what a perfect retrieval would find, to tell its errors from the rest's.

use super::LitSamples;
use crate::ao::{Frame, Recorder, Schedule, Shot, Simulator};
use crate::{Error, Result};
use ndarray::{Array1, Array2};

/// Gathers the dynamic wavefront of each exposure, averaged over its frames, on the scene's grid. Hand it to
/// [`Simulator::run`].
pub struct TruePhases {
    schedule: Schedule,
    lit: LitSamples,
    segments_nm: Vec<f32>,
    /// For each sample of the simulator's map with glass: its place, the lit sample that holds it, its share.
    cells: Vec<(u32, u32, f64)>,
    /// What does not change, nm.
    static_nm: Array1<f64>,
    image: usize,
    dynamic_nm: Vec<f64>,
    images: usize,
    exposed: Vec<f64>,
    /// The images with the telemetry of each.
    pub shots: Vec<Shot>,
}

impl TruePhases {
    /// For a run of `simulator`, from its start.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene without a loop; those of the telescope.
    pub fn of(simulator: &Simulator) -> Result<Self> {
        let scene = simulator.scene();
        let Some(control) = &scene.control else {
            return Err(Error::Scene(format!("{}: the section [control] is missing: a run needs it", scene.name())));
        };
        let (telescope, truth) = (simulator.telescope(), simulator.truth());
        let grid = telescope.pupil.grid;
        let lit = LitSamples::of(grid.samples(), grid.pitch_m(), &telescope.area_weights(grid)?)?;
        let mut static_nm = Array1::from(truth.ncpa_at(&lit.xs_m, &lit.ys_m)?);
        static_nm += &Array1::from(truth.piston_nm.clone()).dot(&lit.pistons);
        Ok(Self {
            schedule: Schedule::of(scene, control.settle_s, control.frame_rate_hz),
            segments_nm: simulator.segments_nm().to_vec(),
            cells: cells(simulator, &lit),
            static_nm,
            image: 0,
            dynamic_nm: vec![0.0; lit.len()],
            images: 0,
            exposed: Vec::new(),
            shots: Vec::new(),
            lit,
        })
    }

    /// The samples.
    pub fn lit(&self) -> &LitSamples {
        &self.lit
    }

    /// The phases of all exposures so far, static and dynamic, nm, `[image, sample]`.
    ///
    /// # Errors
    /// [`Error::Internal`] never.
    pub fn phases_nm(&self) -> Result<Array2<f64>> {
        let dynamic_nm = Array2::from_shape_vec((self.images, self.lit.len()), self.exposed.clone())
            .map_err(|error| Error::Internal(format!("exposures of uneven length: {error}")))?;
        Ok(dynamic_nm + &self.static_nm)
    }
}

/// Which sample of `lit` holds each sample of the simulator's finer grid.
fn cells(simulator: &Simulator, lit: &LitSamples) -> Vec<(u32, u32, f64)> {
    let (pupil, stride, n) = (simulator.pupil(), simulator.footprint().stride(), lit.samples);
    let mut sample_at = vec![None; n * n];
    lit.places.iter().enumerate().for_each(|(sample, &place)| sample_at[place] = Some(sample));
    let cell = |i: usize| ((pupil.grid.coordinate_m(i) / lit.pitch_m + n as f64 / 2.0) as usize).min(n - 1);
    let glass = pupil.amplitude.indexed_iter().filter(|(_, amplitude)| **amplitude > 0.0);
    let mut cells: Vec<(u32, u32, f64)> = glass
        .filter_map(|((y, x), &amplitude)| {
            let sample = sample_at[cell(y) * n + cell(x)]?;
            Some(((y * stride + x) as u32, sample as u32, amplitude))
        })
        .collect();
    let mut whole = vec![0.0; lit.len()];
    cells.iter().for_each(|&(_, sample, amplitude)| whole[sample as usize] += amplitude);
    cells.iter_mut().for_each(|(_, sample, amplitude)| *amplitude /= whole[*sample as usize]);
    cells
}

impl Recorder for TruePhases {
    fn frame(&mut self, frame: &Frame) -> Result<()> {
        let Some(since) = frame.number.checked_sub(self.schedule.start(self.image)) else { return Ok(()) };
        if self.image >= self.schedule.images || since >= self.schedule.exposure {
            return Ok(());
        }
        let share = 1.0 / self.schedule.exposure as f64;
        for &(place, sample, weight) in &self.cells {
            let moving = f64::from(frame.residual_nm[place as usize] - self.segments_nm[place as usize]);
            self.dynamic_nm[sample as usize] += share * weight * moving;
        }
        if since + 1 == self.schedule.exposure {
            self.exposed.append(&mut self.dynamic_nm);
            self.dynamic_nm.resize(self.lit.len(), 0.0);
            self.images += 1;
            self.image += 1;
        }
        Ok(())
    }

    fn shot(&mut self, shot: Shot) -> Result<()> {
        self.shots.push(shot);
        Ok(())
    }
}
