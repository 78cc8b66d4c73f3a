//! The desk on which tests of a program run it, in a folder of its own. A test crate names the
//! program in `crate::PROGRAM`.

#![allow(dead_code, reason = "not every program needs everything on the desk")]

use cophase::io::{FitsReader, FitsWriter, Pixel};
use ndarray::Array3;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// Seven hexagons, 21 modes: an estimate in a tenth of a second. At 64 samples and a peak SNR of
/// 100 the model's own error is below the noise (reduced χ² 1.08).
pub const SMALL: &str = "
[pupil]
aperture = \"hexagonal\"
rings = 1
samples = 64

[image]
wavelength_nm = 2000
samples_per_lambda_over_d = 2
pixels = 64
diversity_focus_waves_rms = 1.0
peak_snr = 100
read_noise_e = 20

[aberrations]
segment_piston_rms_nm = 60
ncpa_rms_nm = 50
ncpa_zernikes = [4, 10]
seed = 1

[modes]
ncpa = \"zernike\"
ncpa_count = 14
exact_zernikes = []
";

/// A folder with the scene `scene.toml` in it; the program runs there.
pub struct Desk {
    folder: TempDir,
}

/// What the program did.
pub struct Done {
    pub status: i32,
    pub out: String,
    pub err: String,
}

impl Desk {
    /// A desk with nothing but the scene.
    pub fn with_scene() -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap() };
        std::fs::write(desk.path("scene.toml"), SMALL).unwrap();
        desk
    }

    /// A desk with `images.fits`, made from the scene with `settings`.
    pub fn with_images(settings: &[&str]) -> Self {
        let desk = Self::with_scene();
        let set = settings.iter().flat_map(|setting| ["--set", setting]);
        let arguments: Vec<&str> = ["image", "scene.toml", "-o", "images.fits"].into_iter().chain(set).collect();
        desk.succeeds(&arguments);
        desk
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(crate::PROGRAM);
        command.args(arguments).current_dir(self.folder.path());
        command
    }

    /// `mpirun -n RANKS sh -c SCRIPT` here, where `$COPHASE` is the program and `$RANK` the number
    /// of the process; `None` where there is no mpirun, which is a failure where
    /// `COPHASE_REQUIRE_MPI=1`.
    pub fn mpirun(&self, ranks: usize, script: &str) -> Option<Command> {
        let is_here = Command::new("mpirun").arg("--version").output().is_ok_and(|output| output.status.success());
        if !is_here {
            let is_required = std::env::var_os("COPHASE_REQUIRE_MPI").is_some_and(|value| value == "1");
            assert!(!is_required, "mpirun is missing: install openmpi-bin");
            eprintln!("skipped: there is no mpirun (openmpi-bin)");
            return None;
        }
        let mut command = Command::new("mpirun");
        // As root in a container; more processes than cores.
        command.args(["--allow-run-as-root", "--oversubscribe", "-n", &ranks.to_string(), "sh", "-c"]);
        command.arg(format!("RANK=$OMPI_COMM_WORLD_RANK; {script}")).current_dir(self.path(""));
        command.env("COPHASE", crate::PROGRAM).env("RAYON_NUM_THREADS", "1");
        Some(command)
    }

    pub fn run(&self, arguments: &[&str]) -> Done {
        Done::from(self.command(arguments).output().unwrap())
    }

    /// Runs what must succeed.
    pub fn succeeds(&self, arguments: &[&str]) -> Done {
        let done = self.run(arguments);
        assert_eq!(done.status, 0, "{arguments:?}: {}", done.err);
        done
    }

    /// The JSON that a successful command prints.
    pub fn json(&self, arguments: &[&str]) -> Value {
        let done = self.succeeds(arguments);
        serde_json::from_str(&done.out).unwrap_or_else(|error| panic!("{arguments:?}: {error}: {}", done.out))
    }

    /// Runs what must fail: exit status 1, one line on stderr with each of `words`, nothing on
    /// stdout, no file made.
    pub fn refuses(&self, arguments: &[&str], words: &[&str]) {
        let before = self.files();
        self.run(arguments).failed(arguments, words);
        assert_eq!(self.files(), before, "{arguments:?}");
    }

    /// Names of everything in the folder, hidden files included.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Copies the images of `from` to `to` after `edit`, with their scene, truth and read noise.
    pub fn edit_images(&self, from: &str, to: &str, edit: impl FnOnce(&mut Array3<f64>)) {
        let mut file = FitsReader::open(self.path(from)).unwrap();
        let mut images = file.cube("IMAGES").unwrap();
        edit(&mut images);
        let mut copy = FitsWriter::create(self.path(to)).unwrap();
        copy.image("IMAGES", &images, Pixel::F64, "electron").unwrap();
        copy.card("IMAGES", "RON_E", file.card(Some("IMAGES"), "RON_E").unwrap().unwrap(), "").unwrap();
        for name in ["TRUTH_PHASING", "TRUTH_NCPA"] {
            copy.image(name, &file.map(Some(name)).unwrap(), Pixel::F64, "nm").unwrap();
        }
        copy.text("SCENE", &file.text_column("SCENE", "LINE").unwrap().join("\n")).unwrap();
        copy.finish().unwrap();
    }

    /// Residuals of `estimate` against the truth of `images`: phasing, NCPA, wavefront, nm.
    pub fn residuals(&self, estimate: &str, images: &str) -> [f64; 3] {
        let json = self.json(&["compare", estimate, "--truth", images, "--json"]);
        ["phasing", "ncpa", "wavefront"].map(|part| number(&json, &format!("{part}_residual_nm")))
    }

    /// Estimates from `images`, whose residuals must agree with the error bars; gives the JSON and
    /// what stderr said.
    pub fn estimates_well(&self, images: &str, options: &[&str]) -> (Value, String) {
        let arguments: Vec<&str> =
            ["estimate", images, "-o", "est.fits", "--json"].iter().chain(options).copied().collect();
        let done = self.succeeds(&arguments);
        let json: Value = serde_json::from_str(&done.out).unwrap();
        let [phasing, ncpa, _] = self.residuals("est.fits", images);
        // The RMS of some 6 and 12 normal errors exceeds its expectation by 2 less than once in a
        // thousand draws, and the draws are fixed by the seed.
        for (residual, sigma) in [(phasing, "phasing_sigma_nm"), (ncpa, "ncpa_sigma_nm")] {
            let bound = 2.0 * number(&json, sigma);
            assert!(residual < bound, "{images} {options:?}: {residual} nm where {bound} nm is allowed: {json}");
        }
        (json, done.err)
    }
}

impl From<Output> for Done {
    fn from(output: Output) -> Self {
        Self {
            status: output.status.code().unwrap_or(-1),
            out: String::from_utf8(output.stdout).unwrap(),
            err: String::from_utf8(output.stderr).unwrap(),
        }
    }
}

impl Done {
    /// Exit status 1 and one sentence.
    pub fn failed(&self, arguments: &[&str], words: &[&str]) {
        assert_eq!(self.status, 1, "{arguments:?}: {}", self.err);
        assert_eq!(self.err.lines().count(), 1, "{arguments:?}: {}", self.err);
        assert!(self.err.starts_with("cophase: ") && !self.err.contains("panicked"), "{arguments:?}: {}", self.err);
        assert_eq!(self.out, "", "{arguments:?}");
        for word in words {
            assert!(self.err.contains(word), "{arguments:?}: '{word}' is not in: {}", self.err);
        }
    }
}

pub fn number(json: &Value, key: &str) -> f64 {
    json[key].as_f64().unwrap_or_else(|| panic!("{key} is no number in {json}"))
}

pub fn text_column(path: &Path, table: &str, column: &str) -> Vec<String> {
    FitsReader::open(path).unwrap().text_column(table, column).unwrap()
}
