//! Channels of a simulation: what each images the wavefront with.

use crate::Result;
use crate::scene::System;
use crate::telescope::{Diversity, Filter, Telescope};

/// Diversity and filter of one way of imaging the wavefront.
pub(super) struct ChannelOptics {
    /// Its name; `None` for the only one of a scene without channels.
    pub(super) name: Option<String>,
    /// Its own scene.
    pub(super) scene: System,
    pub(super) diversity: Diversity,
    pub(super) filter: Filter,
}

impl ChannelOptics {
    /// Those of each channel of `scene` behind `telescope`, in order; of a scene without channels
    /// one.
    ///
    /// # Errors
    /// Those of reading the diversity and the filter.
    pub(super) fn all(scene: &System, telescope: &Telescope) -> Result<Vec<Self>> {
        match scene.channels() {
            [] => Ok(vec![Self::new(None, scene, telescope)?]),
            channels => {
                let each = channels.iter().map(|own| Self::new(Some(&own.name), &own.system, telescope));
                each.collect()
            }
        }
    }

    fn new(name: Option<&String>, scene: &System, telescope: &Telescope) -> Result<Self> {
        let (diversity, filter) = (Diversity::new(scene, telescope)?, Filter::new(scene)?);
        Ok(Self { name: name.cloned(), scene: scene.clone(), diversity, filter })
    }
}
