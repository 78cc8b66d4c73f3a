//! Task: the images to retrieve, and what is known of each.

use super::static_wavefront::StaticWavefront;
use crate::Result;
use crate::control::Control;
use crate::modal::{PreparedFrame, Refusal};

/// A prepared image, or the reason why it is unusable.
pub(super) type PreparedImage = std::result::Result<PreparedFrame, Refusal>;

/// The images to retrieve, and the static wavefront about which they are retrieved.
pub(super) struct RetrievalTask<'a> {
    /// Number of images.
    pub(super) images: usize,
    /// Prepares one of them.
    pub(super) prepare: &'a (dyn Fn(usize) -> Result<PreparedImage> + Sync),
    pub(super) about: Option<&'a StaticWavefront>,
    /// What the blur of the exposures changes in each image, electrons; empty where it is not
    /// known.
    pub(super) blur_e: &'a [Vec<f32>],
    /// Coordinates at which the optimisation of each image begins, 0 where they are of another
    /// model; where they are given, those at its end are kept.
    pub(super) starts: Option<&'a [Vec<f32>]>,
    pub(super) control: &'a Control,
}

/// What is known of an image before its retrieval: see [`RetrievalTask`].
#[derive(Clone, Copy)]
pub(super) struct KnownOfImage<'a> {
    pub(super) about: Option<&'a StaticWavefront>,
    pub(super) blur_e: &'a [f32],
    pub(super) start: Option<&'a [f32]>,
}

impl RetrievalTask<'_> {
    /// What is known of `image`.
    pub(super) fn known(&self, image: usize) -> KnownOfImage<'_> {
        fn of(each: &[Vec<f32>], image: usize) -> &[f32] {
            each.get(image).map_or(&[], Vec::as_slice)
        }
        let start = self.starts.map(|starts| of(starts, image));
        KnownOfImage { about: self.about, blur_e: of(self.blur_e, image), start }
    }

    /// # Errors
    /// [`Error::Interrupted`] where the task is cancelled, with the number of images that are done.
    pub(super) fn check_cancel(&self, done: impl FnOnce() -> usize) -> Result<()> {
        self.control.check_with(|| format!("{} of {} wavefronts were retrieved", done(), self.images))
    }
}
