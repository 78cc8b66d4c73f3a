//! File of the optical path difference (OPD) of an estimate, as POPPY and STPSF read it.

use super::estimate::Estimate;
use crate::Result;
use crate::io::{FitsWriter, Pixel};
use std::path::Path;

impl Estimate {
    /// Writes phasing and NCPA together as an OPD map, m, 0 outside the pupil, in the first image
    /// `OPD` with the cards `BUNIT` and `PUPLSCAL`, and the pupil as `AMPLITUDE`:
    /// `poppy.FITSOpticalElement(opd=path)` reads the map. Axes and sign are those of the estimate;
    /// POPPY's image of it is turned by 180 degrees, because its Fourier transform has the other
    /// sign.
    ///
    /// The pistons of the segments are in the map: cards `S01PISTN`, ... would add them a second
    /// time and are not written.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) where the file cannot be written.
    pub fn write_opd(&self, path: impl AsRef<Path>) -> Result<()> {
        let grid = &self.pupil.grid;
        let opd_m = self.maps.wavefront_nm().mapv(|nm| if nm.is_finite() { nm * 1e-9 } else { 0.0 });
        let mut file = FitsWriter::create(path)?;
        file.map("OPD", &opd_m, "m", grid.width_m())?;
        file.image("AMPLITUDE", &self.pupil.amplitude, Pixel::F64, "")?;
        for name in ["OPD", "AMPLITUDE"] {
            file.card(name, "PUPLSCAL", grid.pitch_m(), "distance of samples, m")?;
        }
        file.finish()
    }
}
