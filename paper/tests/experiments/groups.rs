//! Groups of images that are fitted together: one draw of two kinds.

use cophase::Control;
use cophase_paper::reproduce::{GroupRow, Progress, groups};

#[test]
fn groups_end_in_the_right_minimum() {
    let folder = tempfile::tempdir().unwrap();
    let rows = GroupRow::named(&["5 in focus, shapes 150 nm, scale".into(), "pair of 0.2".into()]).unwrap();
    let found = groups(&rows, 1, folder.path(), &Progress::new(&|_, _| {}, &Control::default())).unwrap();
    assert_eq!(found.rows.len(), 2);
    for row in &found.rows {
        // A residual of some 30 directions scatters by 13 %, three of these.
        assert!(row.silent() == 0 && row.pulls().iter().all(|pull| (0.5..1.6).contains(pull)), "{row:?}");
    }
}
