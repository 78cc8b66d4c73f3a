//! Records of the store.

use serde::Serialize;
use std::ffi::OsString;
use std::io::Read;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use twox_hash::XxHash3_128;

/// Hash of what a frame was made of: two files with the same bytes are one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Content(pub [u8; 16]);

impl Content {
    /// That of some bytes (XXH3, 128 bits).
    pub fn of(bytes: &[u8]) -> Self {
        Self(XxHash3_128::oneshot(bytes).to_be_bytes())
    }

    /// That of all that `source` has, which need not fit into the memory.
    pub fn read(source: &mut impl Read) -> std::io::Result<Self> {
        let (mut hash, mut buffer) = (XxHash3_128::new(), vec![0; 1 << 20]);
        loop {
            match source.read(&mut buffer) {
                Ok(0) => return Ok(Self(hash.finish_128().to_be_bytes())),
                Ok(count) => hash.write(&buffer[..count]),
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        }
    }
}

/// The model that a store was made for.
#[derive(Debug, Clone, PartialEq)]
pub struct About {
    /// The scene as TOML.
    pub scene: String,
    /// `realtime` or `full`.
    pub policy: String,
    /// Source of the frames: a folder or a stream.
    pub source: String,
    /// Names of the modes, in order.
    pub modes: Vec<String>,
    /// Number of segment modes; they come first.
    pub segment_modes: usize,
    /// Segments, as JSON for the page: centre and radius, m, label.
    pub segments: String,
}

impl About {
    /// As rows of the table `about`.
    pub(super) fn pairs(&self) -> [(&'static str, String); 6] {
        [
            ("scene", self.scene.clone()),
            ("policy", self.policy.clone()),
            ("source", self.source.clone()),
            ("modes", self.modes.join("\n")),
            ("segment_modes", self.segment_modes.to_string()),
            ("segments", self.segments.clone()),
        ]
    }

    pub(super) fn from_pairs(value: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let modes = value("modes")?;
        Some(Self {
            scene: value("scene")?,
            policy: value("policy")?,
            source: value("source")?,
            modes: modes.lines().map(str::to_owned).collect(),
            segment_modes: value("segment_modes")?.parse().ok()?,
            segments: value("segments")?,
        })
    }

    /// The first difference of the model; the same frames may come from another folder.
    pub(super) fn difference(&self, other: &Self) -> Option<String> {
        if self.policy != other.policy {
            return Some(format!("--policy {}, not {}", other.policy, self.policy));
        }
        let lines = |text: &str| text.lines().map(str::trim).map(str::to_owned).collect::<Vec<_>>();
        let (own, others) = (lines(&self.scene), lines(&other.scene));
        if let Some(line) = others.iter().find(|line| !own.contains(line)) {
            return Some(format!("its scene has `{line}`"));
        }
        (own != others || self.modes != other.modes).then(|| "its scene differs".into())
    }
}

/// A frame with its result.
#[derive(Debug, Clone)]
pub struct Frame {
    /// What it was made of.
    pub content: Content,
    /// Number of the image in the file, from 0.
    pub image: usize,
    /// File, or stream and counter.
    pub name: String,
    /// When it was observed, s since 1970.
    pub observed_s: f64,
    /// When its estimate was made, s since 1970.
    pub taken_s: f64,
    /// From the complete frame to its estimate, s.
    pub latency_s: f64,
    /// Why it was refused; `None` where it was not.
    pub reason: Option<String>,
    /// Status of its fit.
    pub fit: Option<String>,
    /// Reduced χ².
    pub chi2: f64,
    /// Electrons of the star.
    pub flux_e: f64,
    /// Electrons per pixel.
    pub background_e: f64,
    /// RMS over the pupil of the segment errors.
    pub phasing_rms_nm: f64,
    /// RMS over the pupil of the NCPA.
    pub ncpa_rms_nm: f64,
    /// The star, pixels of the frame from its axis, along x and y.
    pub pointing_pixels: [f64; 2],
    /// Of each mode without the pointing, nm; empty where there is no fit.
    pub coefficients_nm: Vec<f64>,
    /// Error bar of each mode, nm.
    pub sigma_nm: Vec<f64>,
    /// Tracked coefficients after this frame, nm.
    pub tracked_nm: Vec<f64>,
    /// Their error bars, nm.
    pub tracked_sigma_nm: Vec<f64>,
    /// Sentences.
    pub warnings: Vec<String>,
}

impl Frame {
    /// A frame without a fit that was refused for `reason`; the name, with which sentences on files
    /// begin, is not repeated.
    pub fn refused(content: Content, image: usize, name: String, observed_s: f64, reason: String) -> Self {
        let without_name = reason.strip_prefix(&name).and_then(|rest| rest.strip_prefix(": "));
        let reason = without_name.map_or(reason.clone(), str::to_owned);
        Self {
            content,
            image,
            name,
            observed_s,
            taken_s: observed_s,
            latency_s: f64::NAN,
            reason: Some(reason),
            fit: None,
            chi2: f64::NAN,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            phasing_rms_nm: f64::NAN,
            ncpa_rms_nm: f64::NAN,
            pointing_pixels: [f64::NAN; 2],
            coefficients_nm: Vec::new(),
            sigma_nm: Vec::new(),
            tracked_nm: Vec::new(),
            tracked_sigma_nm: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

/// Something that happened.
#[derive(Debug, Clone, Serialize)]
pub struct Event {
    /// s since 1970: when the frame that showed it was observed; of an event of no frame, when it
    /// was noticed.
    pub time_s: f64,
    /// `segment`, `wavefront`, `pointing`, `correction`, `source` or `disk`.
    pub kind: &'static str,
    /// What a person reads.
    pub sentence: String,
    /// The segment that moved.
    pub segment: Option<usize>,
    /// By how much.
    pub size_nm: Option<f64>,
    /// Error bar of that.
    pub size_error_nm: Option<f64>,
    /// Since when, s since 1970.
    pub since_s: Option<f64>,
}

impl Event {
    /// An event of no segment, now.
    pub fn now(kind: &'static str, sentence: impl Into<String>) -> Self {
        let (segment, size_nm, size_error_nm, since_s) = (None, None, None, None);
        let time_s = crate::clock::now_s();
        Self { time_s, kind, sentence: sentence.into(), segment, size_nm, size_error_nm, since_s }
    }
}

/// A file that was taken, as it was then.
#[derive(Debug, Clone, PartialEq)]
pub struct FileRecord {
    /// Its name.
    pub path: PathBuf,
    /// Bytes.
    pub size: u64,
    /// Time of the last change, ns since 1970.
    pub mtime_ns: i64,
    /// Inode.
    pub inode: u64,
    /// Hash of its bytes.
    pub content: Content,
}

/// A frame as the page and the export read it; vectors where they are there.
#[derive(Debug, Clone, Serialize)]
pub struct StoredFrame {
    pub id: i64,
    pub name: String,
    pub image: i64,
    pub observed_s: f64,
    pub taken_s: f64,
    pub latency_s: Option<f64>,
    pub status: String,
    pub reason: Option<String>,
    pub fit: Option<String>,
    pub chi2: Option<f64>,
    pub flux_e: Option<f64>,
    pub background_e: Option<f64>,
    pub phasing_rms_nm: Option<f64>,
    pub ncpa_rms_nm: Option<f64>,
    pub pointing_x_pixels: Option<f64>,
    pub pointing_y_pixels: Option<f64>,
    pub warnings: Vec<String>,
    #[serde(skip)]
    pub coefficients_nm: Vec<f64>,
    #[serde(skip)]
    pub sigma_nm: Vec<f64>,
    #[serde(skip)]
    pub tracked_nm: Vec<f64>,
    #[serde(skip)]
    pub tracked_sigma_nm: Vec<f64>,
}

/// An event as the page and the export read it.
#[derive(Debug, Clone, Serialize)]
pub struct StoredEvent {
    pub id: i64,
    pub time_s: f64,
    pub kind: String,
    pub sentence: String,
    pub frame: Option<i64>,
    pub segment: Option<i64>,
    pub size_nm: Option<f64>,
    pub size_error_nm: Option<f64>,
    pub since_s: Option<f64>,
}

/// Doubles in little-endian order; nothing for none.
pub(super) fn blob(numbers: &[f64]) -> Option<Vec<u8>> {
    (!numbers.is_empty()).then(|| numbers.iter().flat_map(|number| number.to_le_bytes()).collect())
}

/// The doubles of [`blob`].
pub(super) fn numbers(blob: Option<&[u8]>) -> Vec<f64> {
    let number = |bytes: &[u8]| bytes.try_into().map_or(f64::NAN, f64::from_le_bytes);
    blob.unwrap_or_default().chunks_exact(8).map(number).collect()
}

/// A path as it is stored: names of files need not be UTF-8.
pub(super) fn path_bytes(path: &Path) -> &[u8] {
    path.as_os_str().as_bytes()
}

pub(super) fn path_of(bytes: Vec<u8>) -> PathBuf {
    OsString::from_vec(bytes).into()
}
