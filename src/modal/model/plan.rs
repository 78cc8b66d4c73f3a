//! Pixel plan: the pixels that are fitted, and the sampling of the pupil for them.

use crate::Result;
use crate::grid::Grid;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::Preparation;
use crate::pupil::{BandLimit, Pupil, SegmentWeights};
use crate::scene::{Crop, PupilModel, Sampling, System};
use crate::telescope::{Diversity, Telescope};

/// Spare samples on each side of the pupil in a band-limited model, fewest and most: the weights
/// ring beyond the pupil, and the part beyond the grid is lost. Every spare sample is one less
/// across the pupil: at 120 samples 4 leave 0.026 nm of NCPA where 1 leaves 0.037 (the noise 0.1),
/// at 96 samples 0.7 where 1 leaves 0.12.
const SPARE_SAMPLES: (f64, f64) = (1.0, 4.0);
/// Half of the low pass's transition, cycles, on either side of the Nyquist frequency: it keeps the
/// ringing short. 8 keeps 3.8 weights a sample where 4 keeps 5.6, and the error is no larger.
const HALF_TRANSITION: f64 = 8.0;
/// What the aberrations add to the frequencies of the defocus, cycles.
pub(crate) const ABERRATION_CYCLES: f64 = 4.0;
/// λ/D around the geometric spot that still carry signal worth fitting.
pub(crate) const SPOT_MARGIN: f64 = 3.0;
/// λ/D around the geometric spot that a frame must hold to be reduced: a reduction takes it for
/// periodic, and light that is cut off at an edge rings. `keck-artificial` at a peak S/N of 500, 4
/// pixels per λ/D: with 4 λ/D a reduced χ² of 1.18, with 6 of 1.09, with 12 and more of 1.05, and
/// 1.01 where it is not reduced.
const PERIODIC_MARGIN: f64 = 6.0;
/// Least half-width of the fitted image, λ/D: without defocus the light of single segments still
/// spreads this far.
pub(crate) const LEAST_HALF_WIDTH: f64 = 16.0;

/// Samples relative to the fewest that carry the light of a large defocus. Keck, peak S/N of 500, 2
/// and 2.9 waves RMS: 1.22 times leave a reduced χ² of 1.06 and 1.09, 1.35 times 1.05 and 1.04, but
/// just the fewest 1.5 and 1.4. The 120 of its presets are 1.22 times those of 1.5 waves.
const MORE_SAMPLES: f64 = 1.22;

/// Most samples that a scene may ask for, too.
const MOST_SAMPLES: usize = 2048;

/// Pixels that are fitted, and their sampling.
pub(in crate::modal) struct PixelPlan {
    pub(in crate::modal) preparation: Preparation,
    /// Model pixels per λ/grid_m.
    pub(in crate::modal) per_lambda_over_d: f64,
    /// Half-width of the geometric spot, λ/grid_m.
    spot: f64,
    /// Samples along a side of the grid on which a band-limited model is fitted.
    samples: usize,
    /// Of these, left free on each side of the pupil.
    spare_samples: usize,
    /// [`Recipe::least_pass_cycles`].
    least_pass_cycles: f64,
}

impl PixelPlan {
    /// The plan of a model; `may_be_finer` where it is band-limited and the geometry of its pupil
    /// is known.
    pub(in crate::modal) fn new(
        scene: &System,
        recipe: &Recipe,
        native: bool,
        (diversity, pupil): (&Diversity, &Pupil),
        may_be_finer: bool,
    ) -> Self {
        let image = &scene.image;
        let ((rows, columns), frame_sampling) = (image.fitted_shape(), image.samples_per_lambda_over_d);
        let frame = [columns, rows];
        let nyquist = frame.map(|pixels| pixels as f64 * 2.0 / frame_sampling);
        let whole = |pixels: f64| (pixels - pixels.round()).abs() < 1e-9 && (pixels.round() as usize).is_multiple_of(2);
        let spot = diversity.spot(pupil, image.wavelength_nm);
        let mut half_width = (spot + SPOT_MARGIN).max(LEAST_HALF_WIDTH);
        let periodic = (spot + PERIODIC_MARGIN).max(LEAST_HALF_WIDTH);
        let is_cut = periodic > rows.min(columns) as f64 / (2.0 * frame_sampling);
        let may_reduce = match recipe.sampling {
            Sampling::Auto => !is_cut,
            Sampling::Native => false,
            Sampling::Nyquist => true,
        };
        // One sampling serves both axes: both must come out whole.
        let wanted = !native && may_reduce && frame_sampling > 2.0 && nyquist.into_iter().all(whole);
        let (reduced, per_lambda_over_d) =
            if wanted { (nyquist.map(|pixels| pixels.round() as usize), 2.0) } else { (frame, frame_sampling) };
        let in_frame = reduced[0].max(reduced[1]) as f64 / (2.0 * per_lambda_over_d);
        let fewest = 2.0 * (half_width.min(in_frame) + spot + ABERRATION_CYCLES + SPARE_SAMPLES.0);
        let count = samples(scene, if may_be_finer { fewest } else { 0.0 });
        // Frequencies that the samples carry beyond those that the image needs.
        let samples = count as f64;
        let beyond = samples / 2.0 - (half_width + spot + ABERRATION_CYCLES);
        let spare_samples = beyond.clamp(SPARE_SAMPLES.0, SPARE_SAMPLES.1) as usize;
        if recipe.pupil_model == PupilModel::BandLimited {
            // Not wider than the samples can carry: aliasing beyond that costs more than the light
            // that is left out, down to two thirds of the spot.
            let carried = samples / 2.0 - spare_samples as f64 - spot - ABERRATION_CYCLES;
            half_width = half_width.min(carried.max(spot * 2.0 / 3.0).max(LEAST_HALF_WIDTH));
        }
        let signal = 2.0 * per_lambda_over_d * half_width;
        // The part that is fitted is square: up to the frame's longer side, lest light along it be
        // lost.
        let longest = reduced[0].max(reduced[1]);
        let pixels = match image.crop_pixels {
            Crop::Pixels(native) => 2 * (native * longest / rows.max(columns) / 2).max(4),
            Crop::Auto if recipe.crop => 8 * (signal / 8.0).ceil() as usize,
            Crop::Auto => longest,
        };
        let preparation =
            Preparation { frame, reduced, pixels: pixels.min(longest), flip: [image.flip_x, image.flip_y] };
        Self {
            preparation,
            per_lambda_over_d,
            spot,
            samples: count,
            spare_samples,
            least_pass_cycles: recipe.least_pass_cycles,
        }
    }

    /// Half-width of the fitted image, λ/grid_m.
    fn half_width(&self) -> f64 {
        self.preparation.pixels as f64 / (2.0 * self.per_lambda_over_d)
    }
}

/// Samples along a side of the grid on which a band-limited model of `scene` is fitted, whose light
/// `fewest` carry: those of the pupil, and more where these are fewer.
fn samples(scene: &System, fewest: f64) -> usize {
    let own = scene.pupil.samples;
    scene.estimate.samples.unwrap_or_else(|| {
        let wanted = 2 * (0.5 * MORE_SAMPLES * fewest).ceil() as usize;
        if fewest > own as f64 { wanted.clamp(own, MOST_SAMPLES) } else { own }
    })
}

/// Grid of the model, with spare samples around the pupil, and the weights on it.
///
/// The pass band holds every frequency of the pupil that light of the spot can bring into the
/// image: half the image and the spot, and a little for the aberrations.
pub(in crate::modal) fn band_limited_weights(
    scene: &System,
    telescope: &Telescope,
    pixels: &PixelPlan,
) -> Result<(Grid, SegmentWeights)> {
    let (own, samples) = (telescope.pupil.grid, pixels.samples);
    let stretch = samples as f64 / (samples - 2 * pixels.spare_samples) as f64;
    let grid = Grid::new(samples, own.width_m() * stretch)?;
    let needed = pixels.half_width() + pixels.spot + ABERRATION_CYCLES;
    let wanted = needed.max(pixels.least_pass_cycles) * stretch;
    // The smallest grid that a scene accepts has 16 samples.
    let most = (samples as f64 / 2.0 - HALF_TRANSITION).max(samples as f64 / 4.0);
    let pass = scene.pupil.band_pass_cycles.map_or(wanted.min(most), |pass| pass * stretch);
    let mut limit = BandLimit::new(pass, samples)?;
    if let Some(stop) = scene.pupil.band_stop_cycles {
        limit.stop = (stop * stretch).min(samples as f64);
    }
    Ok((grid, telescope.band_limited_weights(grid, &limit)?))
}
