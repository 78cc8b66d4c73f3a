//! `make install` into a folder of one test's own.

use super::libraries::libraries;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;

/// An installed tree and the files that a test makes beside it, gone when it is dropped.
pub struct Tree {
    folder: tempfile::TempDir,
    prefix: PathBuf,
    destdir: Option<PathBuf>,
}

/// The libraries that are linked from cargo's archive are made once, and are the same for all
/// tests.
static MAKE: Mutex<()> = Mutex::new(());

impl Tree {
    /// Installs where the files are to stay.
    pub fn install() -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { prefix: folder.path().join("usr"), destdir: None, folder }.installed()
    }

    /// Installs for `prefix` below a DESTDIR: a tree whose files are elsewhere than they say, as
    /// after a move.
    pub fn stage(prefix: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        Self { prefix: prefix.into(), destdir: Some(folder.path().join("stage")), folder }.installed()
    }

    fn installed(self) -> Self {
        self.make("install");
        self
    }

    pub fn make(&self, goal: &str) {
        let _one = MAKE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let assign = |variable: &str, path: &Path| format!("{variable}={}", path.display());
        let profile = libraries().parent().unwrap().file_name().unwrap().to_owned();
        let build = Path::new(env!("CARGO_TARGET_TMPDIR")).join("c-library").join(profile);
        let mut make = Command::new("make");
        // A make above this one has no say.
        make.current_dir(env!("CARGO_MANIFEST_DIR")).env_remove("MAKEFLAGS").env_remove("MAKELEVEL").arg(goal);
        make.arg(assign("ARCHIVE", &libraries().join("libcophase.a"))).arg(assign("BUILD", &build));
        make.arg(assign("PREFIX", &self.prefix)).args(self.destdir.iter().map(|path| assign("DESTDIR", path)));
        run(&mut make);
    }

    /// Where the files are.
    pub fn path(&self) -> PathBuf {
        self.destdir.as_ref().map_or(self.prefix.clone(), |stage| stage.join(self.prefix.strip_prefix("/").unwrap()))
    }

    /// A path for a file of the test's, outside what is installed.
    pub fn scratch(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Every file and link below the prefix, from there, sorted.
    pub fn files(&self) -> Vec<String> {
        let mut folders = vec![self.path()];
        let mut files = Vec::new();
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap().map(Result::unwrap) {
                if entry.file_type().unwrap().is_dir() {
                    folders.push(entry.path());
                } else {
                    files.push(entry.path().strip_prefix(self.path()).unwrap().display().to_string());
                }
            }
        }
        files.sort();
        files
    }
}

/// What a command that must succeed prints.
pub fn run(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{said}{complained}", output.status);
    said
}

/// Whether `program` runs here; where it does not, the test is skipped, or fails in CI.
pub fn is_here(program: &str) -> bool {
    let output = Command::new(program).arg("--version").output();
    let here = output.as_ref().is_ok_and(|output| output.status.success());
    if !here {
        assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "{program}: {output:?}");
        println!("skipped: {program} does not run here");
    }
    here
}
