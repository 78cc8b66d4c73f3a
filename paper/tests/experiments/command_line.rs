//! The command line of `cophase-paper`: parts of a table, ranks, outputs that are refused before
//! the work.

use crate::desk::{Desk, Done};
use std::path::Path;

/// Rows of a CSV table without their last column, the measured time.
fn without_times(path: &Path) -> Vec<String> {
    let text = std::fs::read_to_string(path).unwrap();
    text.lines().map(|line| line.rsplit_once(',').unwrap().0.to_owned()).collect()
}

#[test]
fn parts_of_a_table_make_that_of_one_run() {
    let desk = Desk::with_scene();
    let reproduce = |folder: &str, part: &[&str]| {
        let row = ["pulls", "--row", "Noll 18, 1 images, S/N 100", "--seeds", "3", "-o", folder];
        desk.succeeds(&[&row[..], part].concat()).out
    };
    reproduce("whole", &[]);
    for part in ["2/2", "1/2"] {
        let said = reproduce("parts", &["--part", part]);
        assert!(said.starts_with(&format!("part {part} of pulls")) && said.contains(".draws"), "{said}");
        assert!(!desk.path("parts/pulls.csv").exists());
    }
    let kept = |number: usize| desk.path(&format!("parts/pulls.part-{number}-of-2.draws"));
    let lines = |number: usize| std::fs::read_to_string(kept(number)).unwrap().lines().count();
    assert_eq!(lines(1) + lines(2), 2 + 3, "a head each, and each draw once");
    // Times that no draw takes: the table has the draws of the parts, and makes none again.
    for number in [1, 2] {
        let text = std::fs::read_to_string(kept(number)).unwrap();
        let line = |line: &str| {
            let mut cells: Vec<&str> = line.split('\t').collect();
            if cells.len() == 8 {
                cells[6] = "4e6";
            }
            cells.join("\t") + "\n"
        };
        std::fs::write(kept(number), text.lines().map(line).collect::<String>()).unwrap();
    }
    assert!(reproduce("parts", &[]).contains("4000000.00"));
    assert_eq!(without_times(&desk.path("parts/pulls.csv")), without_times(&desk.path("whole/pulls.csv")));
    // Draws of other options are refused.
    let other = ["pulls", "--quick", "-o", "parts"];
    desk.refuses(&other, &["pulls.part-1-of-2.draws", "--quick", "remove it"]);
}

/// Draws that are there are not made again, so that only the sharing is left to see.
#[test]
fn ranks_share_the_draws_of_a_table() {
    let desk = Desk::with_scene();
    std::fs::create_dir(desk.path("results")).unwrap();
    let line = |seed: usize| format!("75 images,{seed},{}\n", vec![format!("{seed}.2500"); 14].join(","));
    std::fs::write(desk.path("results/beyond-draws.csv"), format!("head\n{}", line(2))).unwrap();
    std::fs::write(desk.path("results/beyond-draws.part-2-of-9.csv"), format!("head\n{}{}", line(1), line(3))).unwrap();
    let reproduce = "beyond --row '75 images' --seeds 3 -o";
    let whole = desk.succeeds(&["beyond", "--row", "75 images", "--seeds", "3", "-o", "results"]);
    let table = std::fs::read(desk.path("results/beyond.csv")).unwrap();
    std::fs::remove_file(desk.path("results/beyond.csv")).unwrap();
    let part = desk.succeeds(&["beyond", "--row", "75 images", "--seeds", "3", "-o", "results", "--part", "1/2"]);
    assert!(part.out.starts_with("part 1/2 of beyond: 2 draws are there"), "{}", part.out);
    assert!(!desk.path("results/beyond.csv").exists());
    desk.refuses(&["leak", "-o", "other", "--part", "1/2"], &["part 1/2 of leak", "one process"]);
    let Some(mut command) = desk.mpirun(2, &format!("exec $COPHASE {reproduce} results --part rank")) else { return };
    let done = Done::from(command.output().unwrap());
    assert_eq!((done.status, &done.out), (0, &whole.out), "{}", done.err);
    assert_eq!(std::fs::read(desk.path("results/beyond.csv")).unwrap(), table);
    let left = std::fs::read_dir(desk.path("results")).unwrap();
    let signs = left.filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with("rank-"));
    assert_eq!(signs.count(), 0);
}

#[test]
fn outputs_are_refused_before_the_work() {
    let desk = Desk::with_scene();
    desk.refuses(&["table", "-o", "-"], &["standard output", "./-"]);
    desk.refuses(&["bench", "--csv", "-"], &["standard output", "./-"]);
    desk.refuses(&["bench", "--csv", "b.png", "--picture", "b.png"], &["b.png", "--csv", "--picture"]);
    desk.refuses(&["bench", "scene.toml", "--csv", "scene.toml"], &["read by this command", "--csv"]);
    let missing = ["bench", "scene.toml", "--set", "mirror.actuator_file=actuatros.txt"];
    desk.refuses(&missing, &["actuatros.txt", "no such file", "mirror.actuator_file"]);
    assert_eq!(desk.run(&[]).status, 2, "no target is named");
    assert_eq!(desk.run(&["tabel", "-o", "results"]).status, 2, "there is no such target");
}
