//! Faults that the scene does not have: one draw of some.

use cophase::Control;
use cophase_paper::reproduce::{FaultRow, Progress, faults};

#[test]
fn faults_are_within_the_error_bars_or_said() {
    // With whether the estimate says so.
    let cases = [
        ("nothing 0, 1 x S/N 150", false),
        ("plate scale along x 0.15 %, 1 x S/N 150", true),
        ("gain of every other column 4 %, 1 x S/N 150", true),
        ("companion 10 λ/D away 1 %, 1 x S/N 150", true),
        ("pistons and tilts along one smooth surface 30 nm, 1 x S/N 150", true),
        ("NCPA from Noll 67 to 91 3 nm, 1 x S/N 150", false),
    ];
    let names = cases.map(|(name, _)| name.to_owned());
    let rows = FaultRow::named(&names).unwrap();
    let found = faults(&rows, 1, &Progress::new(&|_, _| {}, &Control::default())).unwrap();
    assert_eq!(found.0.len(), cases.len());
    for (row, draws) in &found.0 {
        let (_, is_said) = cases.iter().find(|(name, _)| *name == row.name()).unwrap();
        let [verdict] = &draws[..] else { panic!("{}: {} draws", row.name(), draws.len()) };
        assert!(!verdict.is_wrong_and_unflagged(), "{}: {verdict:?}", row.name());
        assert_eq!(verdict.is_flagged(), *is_said, "{}: {verdict:?}", row.name());
    }
}
