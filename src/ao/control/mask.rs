//! Which subapertures see the steps between segments.

use crate::pupil::Pupil;
use crate::{Error, Result};

/// Two shares closer than this are the same: subapertures that mirror each other differ by rounding, and a threshold
/// that happens to fall on their share must treat them alike.
const SAME_SHARE: f64 = 1e-9;

/// The subapertures that the reconstructor should not trust, one flag for each of `subapertures` (flat indices
/// `row·lenslets_across + column`), `true` = masked.
///
/// The criterion of the paper (its section 4.3): a subaperture in which segments meet is masked; if no more than two
/// meet, it stays where one of them holds at least `dominant_fraction` of the subaperture's light. Three that meet are
/// masked however small the third: its corner brings two steps. A segment is there if it owns a lit sample, so slivers
/// that own none are missed; for Keck the count is the same from 12 to 48 samples across a lenslet.
///
/// # Errors
/// [`Error::Shape`] where the pupil's samples do not divide evenly among the lenslets, [`Error::Value`] for a fraction
/// outside [0, 1] or subapertures that are not among the lenslets in ascending order.
pub fn segment_mask(
    pupil: &Pupil,
    lenslets_across: usize,
    subapertures: &[usize],
    dominant_fraction: f64,
) -> Result<Vec<bool>> {
    let samples = pupil.grid.samples();
    if lenslets_across == 0 || !samples.is_multiple_of(lenslets_across) {
        return Err(Error::Shape(format!(
            "{samples} pupil samples do not divide among {lenslets_across} lenslets across: a multiple is needed"
        )));
    }
    if !(0.0..=1.0).contains(&dominant_fraction) {
        let text = format!("a dominant fraction of {dominant_fraction} is impossible: it lies between 0 and 1");
        return Err(Error::Value(text));
    }
    super::check_subapertures(lenslets_across, subapertures)?;
    let side = samples / lenslets_across;
    // Each segment's light in the subaperture at hand.
    let mut light = vec![0.0; pupil.segments.len()];
    let masked = subapertures.iter().map(|index| {
        light.fill(0.0);
        let (top, left) = (index / lenslets_across * side, index % lenslets_across * side);
        for at in (0..side * side).map(|i| [top + i / side, left + i % side]) {
            // −1, no owner, is no index.
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
            // 68 as in an independent simulation. The pupil has mirror symmetry in x and in y, and no such subaperture
            // straddles an axis: counts are multiples of 4.
            assert_eq!((count(0.75), count(0.8)), (68, 80));
        }
    }

    /// One lenslet of 4×4 samples with the given owners.
    fn one_lenslet(owners: [i32; 16]) -> Pupil {
        let owner = Array2::from_shape_vec((4, 4), owners.to_vec()).unwrap();
        let amplitude = owner.mapv(|owner| if owner < 0 { 0.0 } else { 1.0 });
        let segments = vec![Segment { x_m: 0.0, y_m: 0.0 }; 3];
        Pupil { grid: Grid::new(4, 1.0).unwrap(), amplitude, owner, segments }
    }

    #[test]
    fn the_rule_at_its_edges() {
        let masked = |owners, fraction| segment_mask(&one_lenslet(owners), 1, &[0], fraction).unwrap()[0];
        let quarter = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1];
        assert!(!masked(quarter, 0.75) && masked(quarter, 0.76));
        // Half of it dark: the share is of the light.
        let dark = [-1, -1, -1, -1, -1, -1, -1, -1, 0, 0, 0, 0, 0, 0, 1, 1];
        assert!(!masked(dark, 0.75) && masked(dark, 0.76));
        let third = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2];
        assert!(masked(third, 0.0));
        assert!(!masked([0; 16], 1.0) && !masked([-1; 16], 1.0));
    }

    #[test]
    fn impossible_requests_are_refused() {
        let pupil = one_lenslet([0; 16]);
        for (across, subapertures, fraction) in
            [(3, vec![0], 0.75), (0, vec![], 0.75), (1, vec![1], 0.75), (1, vec![0], 1.5), (1, vec![0], f64::NAN)]
        {
            assert!(segment_mask(&pupil, across, &subapertures, fraction).is_err(), "{across} {fraction}");
        }
    }
}
