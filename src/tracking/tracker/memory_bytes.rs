//! Bytes of what observations have left in a tracker.

use super::memory::{Measured, TrackerMemory};
use crate::Result;
use crate::tracking::TrackerSettings;
use crate::tracking::bytes::{ByteReader, Writer, damaged};
use crate::tracking::coordinates::Coordinates;
use crate::tracking::filter::KalmanFilter;
use crate::tracking::motion::Motion;

impl TrackerMemory {
    pub(super) fn write(&self, writer: &mut Writer) {
        self.coordinates.write(writer);
        self.filter.write(writer);
        self.motion.write(writer);
        self.pointing.write(writer);
        writer.real(self.time_s);
        writer.real(self.learnt_s);
        writer.vector(self.stepped_nm.iter());
        writer.number(self.outliers);
        writer.number(usize::from(self.suspect.is_some()));
        if let Some(suspect) = &self.suspect {
            writer.real(suspect.time_s);
            writer.vector(suspect.z_nm.iter());
            writer.matrix(&suspect.covariance_nm2);
        }
        self.detector.write(writer);
    }

    pub(super) fn read(settings: &TrackerSettings, reader: &mut ByteReader) -> Result<Self> {
        let coordinates = Coordinates::read(reader)?;
        let (modes, size) = (settings.segment_modes.len(), coordinates.len());
        let filter = KalmanFilter::read(reader)?;
        let fits = filter.state_nm.len() == size && filter.covariance_nm2.dim() == (size, size);
        if !fits || coordinates.of_segments > size || settings.segment_modes.end > coordinates.modes() {
            return Err(damaged());
        }
        let motion = Motion::read(settings, coordinates.sizes(), reader)?;
        let mut memory = Self::with(settings, coordinates, filter, motion, [0.0; 2]);
        memory.pointing.read(reader)?;
        (memory.time_s, memory.learnt_s) = (reader.real()?, reader.real()?);
        memory.stepped_nm = reader.vector()?;
        memory.outliers = reader.number()?;
        if reader.number()? == 1 {
            let (time_s, z_nm, covariance_nm2) = (reader.real()?, reader.vector()?, reader.matrix()?);
            if z_nm.len() != size || covariance_nm2.dim() != (size, size) {
                return Err(damaged());
            }
            memory.suspect = Some(Measured { time_s, z_nm, covariance_nm2 });
        }
        if memory.stepped_nm.len() != size {
            return Err(damaged());
        }
        memory.detector.read(modes, size, reader)?;
        Ok(memory)
    }
}
