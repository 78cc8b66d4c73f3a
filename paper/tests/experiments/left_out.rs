//! What a scene leaves out, with the step that marginalises it and without.

use cophase::Control;
use cophase_paper::reproduce::{LeftOutRow, Progress, left_out};

#[test]
fn tilts_that_the_scene_leaves_out_are_in_the_error_bars() {
    let rows = LeftOutRow::named(&["Keck, 1 x S/N 150, segment tilts 4 nm".into()]).unwrap();
    let progress = Progress::new(&|_, _| {}, &Control::default());
    let found = left_out(&rows, 2, &progress).unwrap();
    let [(row, draws)] = found.0.as_slice() else { panic!("{}", found.0.len()) };
    assert_eq!((row.name().as_str(), draws.len()), ("Keck, 1 x S/N 150, segment tilts 4 nm", 2));
    for draw in draws {
        let [without, with] = [0, 1].map(|step: usize| draw.residual_nm[step][0] / draw.sigma_nm[step][0]);
        assert!(without > 4.0 && with < 2.0, "{without} {with} {draw:?}");
    }
    let error = LeftOutRow::named(&["twelve".into()]).map(|_| ()).unwrap_err().to_string();
    assert!(error.contains("'twelve'") && error.contains("Keck, 1 x S/N 50, nothing"), "{error}");
}
