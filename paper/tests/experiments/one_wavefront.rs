//! Images of one wavefront, and some of another.

use cophase::Control;
use cophase_paper::reproduce::{Progress, WavefrontRow, one_wavefront};

#[test]
fn images_of_other_wavefronts_are_said_and_clean_ones_are_not() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["clean: 3 images, S/N 100", "clean: 4 in focus, S/N 20", "1 of 2, 5 nm", "1 of 4 in focus, 20 nm"];
    let rows = WavefrontRow::named(&names.map(String::from)).unwrap();
    let progress = Progress::new(&|_, _| {}, &Control::default());
    let found = one_wavefront(&rows, 2, folder.path(), &progress).unwrap();
    assert_eq!(found.rows.len(), 4);
    for row in &found.rows {
        let expected = if row.row.name.starts_with("clean") { 0 } else { 2 };
        assert_eq!((row.draws.len(), row.said, row.flagged.len(), row.silent), (2, expected, expected, 0), "{row:?}");
    }
    let error = WavefrontRow::named(&["twelve".into()]).unwrap_err().to_string();
    assert!(error.contains("'twelve'") && error.contains("clean: 2 images, S/N 20"), "{error}");
}
