//! `estimate --part rank`: under mpirun any number of processes makes the file of one run, and a
//! process that fails or dies ends the job with a sentence and leaves no half-written file.
//!
//! Where Open MPI is not installed the tests that start it say so and pass, unless
//! `COPHASE_REQUIRE_MPI=1`.

use crate::parts::{are_the_same, sequence};
use crate::{Desk, Done};
use std::process::Command;
use std::time::{Duration, Instant};

const ESTIMATE: &str = "$COPHASE estimate images.fits -o est.fits --part rank --json";

fn run(mut command: Command) -> Done {
    Done::from(command.output().unwrap())
}

#[test]
fn any_number_of_ranks_makes_the_file_of_one_run() {
    let desk = sequence();
    desk.succeeds(&["estimate", "images.fits", "-o", "whole.fits"]);
    for ranks in [1, 2, 4] {
        let Some(command) = desk.mpirun(ranks, &format!("exec {ESTIMATE}")) else { return };
        let done = run(command);
        assert_eq!(done.status, 0, "{}", done.err);
        // One rank prints, and one result.
        let json: serde_json::Value = serde_json::from_str(&done.out).unwrap();
        assert_eq!(json["images"].as_u64(), Some(12));
        are_the_same(&desk.path("whole.fits"), &desk.path("est.fits"));
        assert_eq!(desk.files(), ["est.fits", "images.fits", "scene.toml", "whole.fits"]);
        std::fs::remove_file(desk.path("est.fits")).unwrap();
    }
}

/// A job that ends with a nonzero status and the words, without an estimate and without temporary
/// files.
fn fails(desk: &Desk, command: Command, words: &[&str]) {
    let done = run(command);
    assert_ne!(done.status, 0);
    assert!(words.iter().all(|word| done.err.contains(word)), "{words:?}: {}", done.err);
    assert!(!done.err.contains("panicked") && !desk.path("est.fits").exists(), "{}", done.err);
    let files = desk.files();
    assert!(!files.iter().any(|name| name.starts_with(".cophase")), "{files:?}");
}

#[test]
#[ignore = "merge: 6 s"]
fn failed_rank_ends_the_job_and_the_next_job_resumes() {
    let desk = sequence();
    let first_part = desk.path("est.fits.parts/part-1-of-2.fits");
    // Killed when the other has written its part.
    let killed =
        "if [ $RANK = 1 ]; then while ! [ -e est.fits.parts/part-1-of-2.fits ]; do sleep 0.1; done; kill -9 $$; fi";
    let Some(command) = desk.mpirun(2, &format!("{killed}; exec {ESTIMATE}")) else { return };
    fails(&desk, command, &["signal 9"]);
    let written = std::fs::metadata(&first_part).unwrap().modified().unwrap();
    // The scene is not where this rank runs.
    let elsewhere = "if [ $RANK = 1 ]; then SCENE=absent.toml; else SCENE=scene.toml; fi; exec";
    let command = desk.mpirun(2, &format!("{elsewhere} {ESTIMATE} --scene $SCENE")).unwrap();
    fails(&desk, command, &["rank 1 of 2: absent.toml", "there is no such scene"]);
    // The disk of the first rank is full: no file may be larger than 16 blocks.
    let command = desk.mpirun(2, &format!("if [ $RANK = 0 ]; then ulimit -f 16; fi; exec {ESTIMATE}")).unwrap();
    fails(&desk, command, &["rank 0 of 2", "File too large", "no partial file is left"]);
    assert!(std::fs::metadata(&first_part).unwrap().modified().unwrap() >= written, "what was there stays");
    // Another number of ranks takes the fits that are there.
    desk.succeeds(&["estimate", "images.fits", "-o", "whole.fits"]);
    assert_eq!(run(desk.mpirun(4, &format!("exec {ESTIMATE}")).unwrap()).status, 0);
    are_the_same(&desk.path("whole.fits"), &desk.path("est.fits"));
    assert!(!desk.path("est.fits.parts").exists());
}

/// A launcher that does not end the job when a process dies, as srun without --kill-on-bad-exit.
#[test]
fn a_silent_rank_is_given_up() {
    let desk = Desk::with_images(&["image.count=2"]);
    let mut command = desk.command(&["estimate", "images.fits", "-o", "est.fits", "--part", "rank"]);
    command.env("SLURM_PROCID", "0").env("SLURM_STEP_NUM_TASKS", "2").env("COPHASE_RANK_TIMEOUT_S", "1");
    for name in ["OMPI_COMM_WORLD_RANK", "PMI_RANK"] {
        command.env_remove(name);
    }
    let started = Instant::now();
    Done::from(command.output().unwrap()).failed(&["--part rank"], &["rank 0 of 2", "rank 1 of 2", "no sign of life"]);
    // The limit of 1 s, and the fit of an image that takes a tenth; the rest is for a busy machine.
    assert!(started.elapsed() < Duration::from_secs(60));
    // One that failed says why.
    let alive = desk.path("est.fits.parts/rank-1.alive");
    std::fs::write(alive, "7-0 failed: the disk is on fire\n").unwrap();
    command.env("SLURM_JOB_ID", "7").env("SLURM_STEP_ID", "0").env("COPHASE_RANK_TIMEOUT_S", "600");
    Done::from(command.output().unwrap()).failed(&["--part rank"], &["rank 1 of 2", "the disk is on fire"]);
}
