//! Petals of a telescope: motions of the parts of its pupil.

use super::model::Telescope;
use crate::Result;
use crate::modes::{self, Petals};
use crate::scene::SegmentModes;

impl Telescope {
    /// The motions `modes` of each part of the pupil that the spider separates; `None` for "none".
    ///
    /// # Errors
    /// Those of [`Petals::new`].
    pub fn petals(&self, modes: SegmentModes) -> Result<Option<Petals>> {
        let modes = match modes {
            SegmentModes::None => return Ok(None),
            SegmentModes::Piston => modes::SegmentModes::Piston,
            SegmentModes::PistonTipTilt => modes::SegmentModes::PistonTipTilt,
        };
        Petals::new(self.parts(), &self.pupil, modes).map(Some)
    }
}
