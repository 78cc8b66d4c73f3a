//! What a sequence is estimated from: the images of its channels.

use super::consistency::Electrons;
use super::policy::Policy;
use crate::Result;
use crate::control::Control;
use crate::modal::{CleanedImages, Cube, reject_outliers};
use crate::scene::Scene;
use ndarray::{Array1, Array2};

/// Images of one channel behind adaptive optics.
pub(super) struct SequenceChannel<'a> {
    /// By which they are read.
    pub(super) scene: &'a Scene,
    pub(super) images: &'a Electrons<'a>,
}

impl SequenceChannel<'_> {
    /// The images without outlier pixels, where they have some.
    pub(super) fn cleaned(&self) -> Result<Option<CleanedImages>> {
        let images = self.images;
        reject_outliers(self.scene, &images.images_e, &images.bad, images.read_noise_e)
    }

    pub(super) fn cube<'b>(&'b self, cleaned: &'b Option<CleanedImages>) -> Cube<'b> {
        let images = self.images;
        let (images_e, bad) = match cleaned {
            Some(cleaned) => (&cleaned.images_e, &cleaned.bad),
            None => (images.images_e.as_ref(), images.bad.as_ref()),
        };
        Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: images.read_noise_e }
    }
}

/// A sequence: images of one channel, or of several.
pub(super) struct Sequence<'a> {
    pub(super) channels: &'a [SequenceChannel<'a>],
    /// Whether image i of every channel is of exposure i.
    pub(super) is_simultaneous: bool,
    /// Slopes of each exposure, where they are used.
    pub(super) slopes_mas: Option<&'a Array2<f64>>,
    /// By how much corrections have moved the reference slopes, where that is known.
    pub(super) moved_reference_mas: Option<&'a Array1<f64>>,
    pub(super) policy: &'a Policy,
    pub(super) control: &'a Control,
}

impl Sequence<'_> {
    /// Number of images of all channels.
    pub(super) fn images(&self) -> usize {
        self.channels.iter().map(|channel| channel.images.len()).sum()
    }

    /// Number of exposures: of images, or of sets of simultaneous ones.
    pub(super) fn exposures(&self) -> usize {
        if self.is_simultaneous { self.channels[0].images.len() } else { self.images() }
    }
}
