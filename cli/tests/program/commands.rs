//! Corrections in the terms of controllers: `estimate --commands` and `--commands-plot`.

use crate::Desk;

const ESTIMATE: [&str; 8] = [
    "estimate",
    "images.fits",
    "-o",
    "est.fits",
    "--set",
    "commands.segment_file=wires.txt",
    "--set",
    "commands.segment_unit=V",
];

#[test]
fn commands_are_written_as_text_and_drawn() {
    let desk = Desk::with_images(&[]);
    let table = |limit: &str| (0..7).map(|k| format!("{k} W{} -0.01 {limit}\n", 7 - k)).collect::<String>();
    std::fs::write(desk.path("wires.txt"), table("")).unwrap();
    let outputs = ["--commands", "c.txt", "--commands-plot", "c.svg"];
    let done = desk.succeeds(&[&ESTIMATE[..], &outputs].concat());
    assert!(!done.err.contains("limit"), "{}", done.err);
    let text = std::fs::read_to_string(desk.path("c.txt")).unwrap();
    // Before the channels stand the warnings and remarks of the estimate.
    let lines: Vec<&str> = text.lines().skip_while(|line| !line.starts_with("# segments")).collect();
    assert_eq!(lines[0], "# segments: channel, V");
    let volts = |line: &str| line.split_once(' ').unwrap().1.parse::<f64>().unwrap();
    assert!(lines[1].starts_with("W7 ") && lines[7].starts_with("W1 ") && volts(lines[2]).abs() > 1e-3, "{text}");
    let picture = std::fs::read_to_string(desk.path("c.svg")).unwrap();
    assert!(["images.fits", "W6", "of 7 channels"].iter().all(|words| picture.contains(words)));

    // Cut at a limit: said, and marked.
    std::fs::write(desk.path("wires.txt"), table("0.05")).unwrap();
    let done = desk.succeeds(&[&ESTIMATE[..], &outputs].concat());
    assert!(done.err.contains("cut at a limit: "), "{}", done.err);
    assert!(std::fs::read_to_string(desk.path("c.txt")).unwrap().contains("# at its limit"));

    // The table is not overwritten, and a mistake in it is named before anything is written.
    desk.refuses(&[&ESTIMATE[..], &["--commands", "wires.txt"]].concat(), &["wires.txt"]);
    ["c.txt", "est.fits"].iter().for_each(|name| std::fs::remove_file(desk.path(name)).unwrap());
    std::fs::write(desk.path("wires.txt"), "0 W1 1\n").unwrap();
    desk.refuses(&[&ESTIMATE[..], &outputs].concat(), &["wires.txt", "no channel", "segment 1"]);
    assert!(!desk.path("c.txt").exists() && !desk.path("est.fits").exists());
}

#[test]
fn a_step_beyond_the_largest_is_refused() {
    let desk = Desk::with_images(&[]);
    let estimate =
        ["estimate", "images.fits", "-o", "est.fits", "--commands", "c.txt", "--set", "commands.max_step_nm=20"];
    desk.refuses(&estimate, &["segment ", "20 is the largest step", "commands.max_step_nm"]);
}
