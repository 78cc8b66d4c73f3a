//! Ranks: the processes that a launcher of parallel programs (mpirun, srun) starts, and signs of
//! life between them.
//!
//! The processes exchange files in a folder that all of them see, and need no MPI library: the
//! number of a process is in the environment that every launcher sets.

use cophase::pipeline::Part;
use cophase::{Error, Result};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Variables with the number of a process and the number of all: Open MPI; MPICH and Intel MPI;
/// Slurm, whose second variable is set in steps of srun only.
const VARIABLES: [[&str; 2]; 3] = [
    ["OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"],
    ["PMI_RANK", "PMI_SIZE"],
    ["SLURM_PROCID", "SLURM_STEP_NUM_TASKS"],
];

/// Variables that name the job, the same for all its processes and another for every job.
const JOBS: [&str; 4] = ["PMIX_NAMESPACE", "OMPI_MCA_ess_base_jobid", "SLURM_JOB_ID", "PMI_JOBID"];

/// Time between two looks for what others have done.
pub const LOOK: Duration = Duration::from_millis(50);
/// Time between two signs of life.
const BEAT: Duration = Duration::from_secs(1);
/// Silence after which a rank is given up, unless `COPHASE_RANK_TIMEOUT_S` says otherwise:
/// directories of network file systems are up to a minute old.
const SILENCE_S: f64 = 120.0;

/// The share of one process in a command.
#[derive(Debug, Clone, Copy)]
pub enum Share {
    Part(Part),
    /// The part that the launcher gives it.
    Rank,
}

impl FromStr for Share {
    type Err = Error;

    fn from_str(word: &str) -> Result<Self> {
        if word == "rank" { Ok(Self::Rank) } else { word.parse().map(Self::Part) }
    }
}

/// One process of several.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rank {
    /// From 0.
    pub number: usize,
    pub of: usize,
}

impl Rank {
    /// The rank of this process.
    ///
    /// # Errors
    /// [`Error::Value`] where no launcher has set one.
    pub fn of_this_process() -> Result<Self> {
        let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse().ok());
        let found = VARIABLES.iter().find_map(|[rank, size]| Some(Self { number: number(rank)?, of: number(size)? }));
        found.filter(|rank: &Self| rank.number < rank.of).ok_or_else(|| {
            let names = VARIABLES.map(|[rank, size]| format!("{rank} and {size}")).join(", ");
            Error::Value(format!(
                "--part rank takes the part from the launcher, which has set none of {names}: start it with mpirun or srun, or name \
                 the part as I/N"
            ))
        })
    }

    /// Its part.
    ///
    /// # Errors
    /// None for a rank of [`Rank::of_this_process`].
    pub fn part(self) -> Result<Part> {
        Part::new(self.number + 1, self.of)
    }

    /// `error`, with the rank before its sentence.
    pub fn name(self, error: Error) -> Error {
        match error {
            interrupted @ Error::Interrupted(_) => interrupted,
            other => Error::Value(format!("rank {} of {}: {other}", self.number, self.of)),
        }
    }
}

/// Name of the job; empty where the launcher gives none.
fn job() -> String {
    let names: Vec<String> =
        JOBS.iter().chain(&["SLURM_STEP_ID"]).filter_map(|name| std::env::var(name).ok()).collect();
    names.join("-").split_whitespace().collect()
}

/// Leaves a sign, whole or not at all: the job, and `text`.
fn leave(file: &Path, text: &str) -> std::io::Result<()> {
    let temporary = file.with_extension("tmp");
    std::fs::write(&temporary, format!("{} {text}\n", job()))?;
    std::fs::rename(temporary, file)
}

/// File of the signs of life of a rank in `folder`.
fn sign_of(folder: &Path, rank: usize) -> PathBuf {
    folder.join(format!("rank-{rank}.alive"))
}

/// Signs of life of this rank: a file whose content changes, until it is dropped.
pub struct Heartbeat {
    file: PathBuf,
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Heartbeat {
    /// Begins to beat in `folder`.
    pub fn start(folder: &Path, rank: Rank) -> Self {
        let file = sign_of(folder, rank.number);
        let (stop, stopped) = channel();
        let thread = {
            let (file, process) = (file.clone(), std::process::id());
            std::thread::spawn(move || {
                for beat in 0_u64.. {
                    // A sign that cannot be written is missed by those who wait for it.
                    let _ = leave(&file, &format!("{process} {beat}"));
                    if stopped.recv_timeout(BEAT) != Err(RecvTimeoutError::Timeout) {
                        break;
                    }
                }
            })
        };
        Self { file, stop: Some(stop), thread: Some(thread) }
    }

    /// Leaves the sentence of an error as the last sign.
    pub fn fail(mut self, error: &Error) {
        self.stop();
        let _ = leave(&self.file, &format!("{FAILED}{error}"));
        self.file = PathBuf::new();
    }

    /// Leaves as the last sign that the rank is done.
    pub fn finish(mut self) {
        self.stop();
        // The process tells it from that of an earlier job.
        let _ = leave(&self.file, &format!("{} {DONE}", std::process::id()));
        self.file = PathBuf::new();
    }

    fn stop(&mut self) {
        self.stop.take();
        self.thread.take().map(JoinHandle::join);
    }
}

/// Last word of a rank that is done.
const DONE: &str = "done";
/// Before the sentence of a rank that failed.
const FAILED: &str = "failed: ";

impl Drop for Heartbeat {
    fn drop(&mut self) {
        self.stop();
        let _ = std::fs::remove_file(&self.file);
    }
}

/// Watch on the signs of life of another rank.
pub struct RankMonitor {
    file: PathBuf,
    rank: Rank,
    /// Content at the last change, and when that was.
    last: (Option<String>, Instant),
    /// Whether the content is of this job.
    is_known: bool,
}

impl RankMonitor {
    /// Watches rank `number` of as many as `own` is one of.
    fn watch(folder: &Path, own: Rank, number: usize) -> Self {
        let file = sign_of(folder, number);
        let content = std::fs::read_to_string(&file).ok();
        let job = job();
        let is_known =
            content.as_deref().and_then(|text| text.split(' ').next()).is_some_and(|of| !of.is_empty() && of == job);
        Self { file, rank: Rank { number, ..own }, last: (content, Instant::now()), is_known }
    }

    /// Monitors of all ranks but the first, which is `own`.
    pub fn of_others(folder: &Path, own: Rank) -> Vec<Self> {
        (1..own.of).map(|number| Self::watch(folder, own, number)).collect()
    }

    /// Whether the rank has said that it is done.
    fn is_done(&self) -> bool {
        self.is_known && self.last.0.as_deref().is_some_and(|text| text.trim_end().ends_with(DONE))
    }

    /// The rank that is watched.
    pub fn rank(&self) -> Rank {
        self.rank
    }

    /// # Errors
    /// [`Error::Value`] where the rank has failed, or has given no sign for too long. Without a
    /// name of the job a file that does not change is of an earlier one.
    pub fn check(&mut self) -> Result<()> {
        let content = std::fs::read_to_string(&self.file).ok();
        let Rank { number, of } = self.rank;
        if content != self.last.0 {
            self.last = (content, Instant::now());
            self.is_known = true;
        }
        let text = self.last.0.as_deref().filter(|_| self.is_known).and_then(|text| text.split_once(' '));
        if let Some(sentence) = text.and_then(|(_, text)| text.strip_prefix(FAILED)) {
            return Err(Error::Value(format!("rank {number} of {of} failed: {}", sentence.trim_end())));
        }
        let silence = self.last.1.elapsed();
        if silence > silence_limit() && !self.is_done() {
            let folder = self.file.parent().unwrap_or(Path::new(".")).display();
            let what = if self.is_known { "no further sign of life" } else { "no sign of life" };
            return Err(Error::Value(format!(
                "rank {number} of {of} has given {what} in {folder} for {:.0} s: it has died, or does not see this folder",
                silence.as_secs_f64()
            )));
        }
        Ok(())
    }
}

/// Waits until all other ranks are done, and removes their signs.
///
/// # Errors
/// Those of [`RankMonitor::check`], and of `check`, which is called again and again.
pub fn wait_for_all(mut monitors: Vec<RankMonitor>, check: impl Fn() -> Result<()>) -> Result<()> {
    loop {
        let mut waiting = false;
        for monitor in &mut monitors {
            monitor.check()?;
            waiting |= !monitor.is_done();
        }
        if !waiting {
            monitors.iter().for_each(|monitor| drop(std::fs::remove_file(&monitor.file)));
            return Ok(());
        }
        check()?;
        std::thread::sleep(LOOK);
    }
}

fn silence_limit() -> Duration {
    let named = std::env::var("COPHASE_RANK_TIMEOUT_S").ok().and_then(|text| text.parse().ok());
    Duration::from_secs_f64(named.filter(|s: &f64| (0.0..1e6).contains(s)).unwrap_or(SILENCE_S))
}
