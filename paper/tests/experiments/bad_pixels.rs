//! Bad pixels that are not marked: one draw of the extremes.

use cophase::Control;
use cophase_paper::reproduce::{Progress, bad_pixels};

#[test]
fn bad_pixels_cost_little_more_than_their_light() {
    let found = bad_pixels(1, true, &Progress::new(&|_, _| {}, &Control::default())).unwrap();
    assert_eq!(found.rows.len(), 16);
    for row in &found.rows {
        assert!(row.seeds == [1, 1], "{row:?}");
        // A residual of some 30 directions scatters by 13 %, three of these; half a noise as much
        // is no bound.
        assert!(row.over_bound().iter().all(|ratio| (0.5..1.6).contains(ratio)), "{row:?}");
    }
}
