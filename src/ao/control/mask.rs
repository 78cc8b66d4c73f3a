//! Mask of the subapertures that straddle segments.

use crate::pupil::Pupil;
use crate::{Error, Result};

/// Tolerance of the comparison with the threshold. Subapertures that are mirror images of each
/// other differ by rounding, and a threshold equal to their share must treat them the same way.
const SAME_SHARE: f64 = 1e-9;

/// Computes the mask, one flag for each of `subapertures` (flat indices
/// `row·lenslets_across + column`), `true` = masked.
///
/// The criterion is the paper's (its section 4.3). A subaperture with one segment is not masked.
/// With two segments it is masked unless one of them has at least `dominant_fraction` of its light.
/// With three it is masked for any size of the third, whose corner makes two steps. A segment
/// counts if it owns an illuminated sample, so slivers that own none are missed; for Keck the
/// number of masked subapertures is the same from 12 to 48 samples across a lenslet.
///
/// # Errors
/// [`Error::Shape`] if the pupil's samples are not a multiple of the lenslets, [`Error::Value`] for
/// a fraction outside [0, 1] or subapertures that are out of range or not ascending.
pub fn segment_mask(
    pupil: &Pupil,
    lenslets_across: usize,
    subapertures: &[usize],
    dominant_fraction: f64,
) -> Result<Vec<bool>> {
    let samples = pupil.grid.samples();
    if lenslets_across == 0 || !samples.is_multiple_of(lenslets_across) {
        return Err(Error::Shape(format!(
            "{samples} pupil samples do not divide among {lenslets_across} lenslets across; a multiple is needed"
        )));
    }
    if !(0.0..=1.0).contains(&dominant_fraction) {
        let text = format!("a dominant fraction of {dominant_fraction} is impossible; 0 to 1 is accepted");
        return Err(Error::Value(text));
    }
    super::check_subapertures(lenslets_across, subapertures)?;
    let side = samples / lenslets_across;
    // Light of each segment in the present subaperture.
    let mut light = vec![0.0; pupil.segments.len()];
    let masked = subapertures.iter().map(|index| {
        light.fill(0.0);
        let (top, left) = (index / lenslets_across * side, index % lenslets_across * side);
        for at in (0..side * side).map(|i| [top + i / side, left + i % side]) {
            // The owner −1 (none) does not convert to an index.
            if let Some(light) = usize::try_from(pupil.owner[at]).ok().and_then(|owner| light.get_mut(owner)) {
                *light += pupil.amplitude[at];
            }
        }
        let meeting = light.iter().filter(|&&light| light > 0.0).count();
        let share = light.iter().copied().fold(0.0, f64::max) / light.iter().sum::<f64>();
        meeting > 2 || (meeting == 2 && share < dominant_fraction - SAME_SHARE)
    });
    Ok(masked.collect())
}

#[cfg(test)]
mod tests {
    use super::super::testing::keck;
    use super::*;
    use crate::grid::Grid;
    use crate::pupil::Segment;
    use ndarray::Array2;

    #[test]
    fn the_preset_masks_68_of_its_248_subapertures_at_any_sampling() {
        for samples in [240, 480] {
            let (pupil, subapertures) = keck(samples);
            assert_eq!(subapertures.len(), 248);
            let count = |fraction| {
                let mask = segment_mask(&pupil, 20, &subapertures, fraction).unwrap();
                mask.iter().filter(|&&masked| masked).count()
            };
            // 68 agrees with an independent simulation. The pupil has mirror symmetry in x and in
            // y, and no masked subaperture straddles an axis, so counts are multiples of 4.
            assert_eq!((count(0.75), count(0.8)), (68, 80));
        }
    }

    /// One lenslet of 4×4 samples with the given owners.
    fn one_lenslet(owners: [i32; 16]) -> Pupil {
        let owner = Array2::from_shape_vec((4, 4), owners.to_vec()).unwrap();
        let amplitude = owner.mapv(|owner| if owner < 0 { 0.0 } else { 1.0 });
        let segments = vec![Segment { x_m: 0.0, y_m: 0.0, label: 0 }; 3];
        Pupil { grid: Grid::new(4, 1.0).unwrap(), amplitude, owner, segments }
    }

    #[test]
    fn the_criterion_at_its_thresholds() {
        let masked = |owners, fraction| segment_mask(&one_lenslet(owners), 1, &[0], fraction).unwrap()[0];
        let quarter = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1];
        assert!(!masked(quarter, 0.75) && masked(quarter, 0.76));
        // Half of the subaperture is dark: the share is relative to its light.
        let dark = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 1, 1];
        assert!(!masked(dark, 0.75) && masked(dark, 0.76));
        let third = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2];
        assert!(masked(third, 0.0));
        assert!(!masked([0; 16], 1.0) && !masked([-1; 16], 1.0));
    }

    #[test]
    fn invalid_arguments_are_refused() {
        let pupil = one_lenslet([0; 16]);
        for (across, subapertures, fraction) in
            [(3, vec![0], 0.75), (0, vec![], 0.75), (1, vec![1], 0.75), (1, vec![0], 1.5), (1, vec![0], f64::NAN)]
        {
            assert!(segment_mask(&pupil, across, &subapertures, fraction).is_err(), "{across} {fraction}");
        }
    }
}
