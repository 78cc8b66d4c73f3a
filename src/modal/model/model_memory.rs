//! Memory of an estimate with a model.

use crate::Result;
use crate::fourier::PixelResponse;
use crate::machine;
use crate::modal::model::Model;
use crate::modal::model::memory::{
    BASE_BYTES, KEPT_MATRICES, MATRICES_AT_ONCE, Memory, NUMBER, Tiles, WORKING_MATRICES,
};
use crate::modal::solve::gauss_newton::bytes_of_row;

/// What lowers the memory of a fit.
const ADVICE: &str = "take fewer pupil.samples, modes.ncpa_count, image.crop_pixels or images, or fewer threads \
                      (RAYON_NUM_THREADS)";

impl Model {
    /// Memory of an estimate with this model on `threads` threads.
    pub fn memory(&self, threads: usize) -> Memory {
        let (parts, sampling) = (self.optics.parts(), self.optics.sampling());
        let (n, m, modes) = (sampling.samples, sampling.pixels, self.optics.modes());
        let (illuminated, entries, smooth) =
            (parts.weights.illuminated.len(), parts.weights.weight.len(), parts.basis.nrows());
        let maps = self.telescope.pupil.grid.samples().pow(2);
        let frame = self.preparation.frame[0] * self.preparation.frame[1];
        let k = n.max(m + 2);
        // The maps; the optics and two chains, which have their values at the illuminated samples;
        // pupil, weights and tables.
        let colours = parts.colours.len();
        let each = 3 * smooth * illuminated + 9 * maps.max(n * n) + 12 * entries + 24 * illuminated + 2 * n * m;
        let model = smooth * maps + colours * each;
        // Two chains' scratch, one's for the flat wavefront, and that of the derivatives; a frame's
        // preparation. Pixels with an area: two images of each chain, and the rows of a derivative.
        let area = if parts.pixel.iter().all(PixelResponse::is_point) { 0 } else { 7 * m * m };
        let thread = colours * (21 * n * n + 17 * m * m + 10 * k * k + 4 * n * m + 40 * illuminated) + 8 * frame + area;
        let square = modes * modes * NUMBER;
        Memory {
            model: NUMBER * model + BASE_BYTES,
            threads: threads.saturating_mul(NUMBER * thread),
            matrices: square.saturating_mul(KEPT_MATRICES + WORKING_MATRICES * threads.min(MATRICES_AT_ONCE)),
            kept_image: NUMBER * (3 * m * m + 3 * modes),
            derivative_row: bytes_of_row(modes, m),
            rows: m,
            fitted_image: NUMBER * (7 * m * m + 70 * modes),
        }
    }

    /// Tiles of the work within the scene's `estimate.memory_gb`.
    pub fn tiles(&self) -> Tiles {
        self.memory(rayon::current_num_threads()).tiles(self.limit_bytes)
    }

    /// This model, with tiles that stay within the scene's `estimate.memory_gb` and within the
    /// memory that the machine has left.
    ///
    /// # Errors
    /// [`Error::Scene`] where not even the smallest tiles stay within the scene's limit,
    /// [`Error::Value`] where they do not within the machine's.
    pub(in crate::modal) fn within_memory(mut self) -> Result<Self> {
        let memory = self.memory(rayon::current_num_threads());
        memory.check(self.limit_bytes)?;
        // The model itself is there already.
        let needed = memory.least_bytes().saturating_sub(memory.model);
        machine::check_memory("a fit of this scene", needed as u64, ADVICE)?;
        if let Some(available) = machine::available() {
            self.limit_bytes = self.limit_bytes.min(memory.model.saturating_add(available.bytes as usize));
        }
        Ok(self)
    }

    /// Refuses more images than the machine's memory can keep.
    ///
    /// # Errors
    /// [`Error::Value`].
    pub(crate) fn check_images(&self, images: usize) -> Result<()> {
        let kept = self.memory(1).kept_image.saturating_mul(images);
        machine::check_memory(format_args!("a fit of {images} images of this scene"), kept as u64, ADVICE)
    }
}
