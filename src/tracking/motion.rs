//! Motion of all coordinates between images: rates of the blocks, and of NCPA modes of their own.

use super::bytes::{ByteReader, Writer};
use super::drift_rate::DriftRate;
use super::mode_motion::{Believed, ModeMotion};
use super::settings::TrackerSettings;
use crate::Result;
use ndarray::{Array1, s};

/// How the coordinates move.
#[derive(Debug, Clone)]
pub(super) struct Motion {
    segments: DriftRate,
    ncpa: DriftRate,
    /// Of the NCPA coordinates; `None` where their rate is given.
    own: Option<ModeMotion>,
    /// What follows from it.
    believed: Believed,
    /// Number of coordinates of segments, and of NCPA.
    sizes: [usize; 2],
}

impl Motion {
    /// Before there are estimates.
    pub(super) fn new(settings: &TrackerSettings, sizes: [usize; 2]) -> Self {
        Self {
            segments: DriftRate::new(settings.drift_segments_nm_per_sqrt_hour),
            ncpa: DriftRate::new(settings.drift_ncpa_nm_per_sqrt_hour),
            own: None,
            believed: Believed::default(),
            sizes,
        }
    }

    /// Rates of the blocks, nm/√h.
    pub(super) fn nm_per_sqrt_hour(&self) -> (f64, f64) {
        (self.segments.nm_per_sqrt_hour(), self.ncpa.nm_per_sqrt_hour())
    }

    /// Variance that each coordinate gains in `hours`, nm².
    pub(super) fn added_nm2(&self, hours: f64) -> Array1<f64> {
        let [of_segments, of_ncpa] = self.sizes;
        let own = |at: usize| self.believed.rate2_nm2_per_hour.get(at).map(|rate2| rate2 * hours);
        let ncpa = (0..of_ncpa).map(|at| own(at).unwrap_or(self.ncpa.added_nm2(hours)));
        std::iter::repeat_n(self.segments.added_nm2(hours), of_segments).chain(ncpa).collect()
    }

    /// Variance of what each coordinate has in one image alone, nm².
    pub(super) fn white_nm2(&self) -> Array1<f64> {
        let [of_segments, of_ncpa] = self.sizes;
        let own = |at: usize| self.believed.white_nm2.get(at).copied().unwrap_or(0.0);
        std::iter::repeat_n(0.0, of_segments).chain((0..of_ncpa).map(own)).collect()
    }

    /// Coordinates that move by themselves more than the others, in which no step is looked for.
    pub(super) fn unsteady(&self) -> Vec<usize> {
        let unsteady = self.believed.is_unsteady.iter().enumerate().filter(|(_, is_unsteady)| **is_unsteady);
        unsteady.map(|(place, _)| self.sizes[0] + place).collect()
    }

    /// An accepted observation, `hours` after the one before.
    pub(super) fn learn(&mut self, z_nm: &Array1<f64>, variances_nm2: &Array1<f64>, hours: f64) {
        let at = self.sizes[0];
        self.segments.learn(z_nm.slice(s![..at]), variances_nm2.slice(s![..at]), hours, &[]);
        let left_out = &self.believed.is_unsteady;
        self.ncpa.learn(z_nm.slice(s![at..]), variances_nm2.slice(s![at..]), hours, left_out);
        if self.ncpa.is_given() || self.sizes[1] == 0 {
            return;
        }
        let (z_nm, variances_nm2) = (z_nm.slice(s![at..]).to_owned(), variances_nm2.slice(s![at..]).to_owned());
        let alike = self.ncpa.nm_per_sqrt_hour();
        match &mut self.own {
            None => self.own = Some(ModeMotion::new(&z_nm, &variances_nm2)),
            Some(own) => own.learn(&z_nm, &variances_nm2, hours, alike),
        }
        self.believe();
    }

    fn believe(&mut self) {
        if let Some(own) = &self.own {
            self.believed = own.believed(self.ncpa.nm_per_sqrt_hour());
        }
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        self.segments.write(writer);
        self.ncpa.write(writer);
        writer.number(usize::from(self.own.is_some()));
        if let Some(own) = &self.own {
            own.write(writer);
        }
    }

    pub(super) fn read(settings: &TrackerSettings, sizes: [usize; 2], reader: &mut ByteReader) -> Result<Self> {
        let segments = DriftRate::read(settings.drift_segments_nm_per_sqrt_hour, sizes[0], reader)?;
        let ncpa = DriftRate::read(settings.drift_ncpa_nm_per_sqrt_hour, sizes[1], reader)?;
        let own = if reader.number()? == 1 { Some(ModeMotion::read(sizes[1], reader)?) } else { None };
        let own = own.filter(|_| !ncpa.is_given());
        let mut motion = Self { segments, ncpa, own, believed: Believed::default(), sizes };
        motion.believe();
        Ok(motion)
    }
}
