//! Pulls of one row on a few draws; docs/error-bars.md has the table of `cophase-paper pulls`.

use cophase::Control;
use cophase::Error;
use cophase_paper::reproduce::{Progress, PullRow, pulls};

/// Draws of the row: a third of those of the table.
const DRAWS: usize = 8;

#[test]
fn the_error_bars_of_single_images_are_right() {
    let rows = PullRow::named(&["NCPA to Noll 18, 1 images, S/N 100".into()]).unwrap();
    assert!(rows.iter().any(|row| row.name().ends_with("S/N 100")) && rows.len() == 1, "{rows:?}");
    let table = pulls(&rows, DRAWS, &Progress::new(&|_, _| {}, &Control::default())).unwrap();
    let [(_, draws)] = &table.0[..] else { panic!("one row was asked for") };
    assert_eq!(draws.len(), DRAWS);
    for part in [0, 1] {
        let square = |draw: &cophase_paper::reproduce::PullDraw| (draw.residual_nm[part] / draw.sigma_nm[part]).powi(2);
        let pull = (draws.iter().map(square).sum::<f64>() / DRAWS as f64).sqrt();
        // The RMS over n draws of a residual of k independent modes is known to 1/√(2nk): of 36
        // pistons to 4 %. Where a few weak directions dominate, these count: of five to 11 %, and
        // 0.7 to 1.35 is three times as much.
        println!("{}: {pull:.3}", ["phasing", "NCPA"][part]);
        assert!((0.7..1.35).contains(&pull), "part {part}: {pull}");
    }
    assert!(draws.iter().all(|draw| !draw.is_flagged), "{draws:?}");
    assert!(table.table().csv().lines().count() == 2, "{}", table.table().csv());
    assert!(matches!(PullRow::named(&["no such row".into()]), Err(Error::Value(_))));
}
