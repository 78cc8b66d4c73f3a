//! Nights in which star, focus and flux move: one draw.

use cophase::Control;
use cophase_paper::reproduce::{Disturbance, MovingRow, Progress, moving_star};

#[test]
fn steps_are_named_while_star_and_focus_move() {
    let rows = MovingRow::named(&["focus slowly, S/N 25".into()]).unwrap();
    assert!(rows.len() == 1 && rows[0].disturbance == Disturbance::SlowFocus, "{rows:?}");
    let found = moving_star(&rows, 1, true, &Progress::new(&|_, _| {}, &Control::default())).unwrap();
    let night = &found.rows[0].nights[0];
    // 20, -40 and 80 nm, of which an image knows 4.
    for (named, most) in night.named_after.iter().zip([10, 2, 2]) {
        assert!(named.is_some_and(|images| images <= most), "{night:?}");
    }
    assert_eq!((night.false_alarms, night.refused[0]), ([0, 0], 0), "{night:?}");
}

#[test]
fn unknown_row_of_nights_is_refused() {
    let error = MovingRow::named(&["moon".into()]).unwrap_err().to_string();
    assert!(error.contains("moon") && error.contains("star"), "{error}");
}
