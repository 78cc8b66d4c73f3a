//! Values with a syntax of their own: the device of an estimate, the crop of an image, which images
//! are fitted together.

use crate::scene::value::{ANY, FromToml, Range};
use toml_edit::Value;

/// Device that computes an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The fastest available device.
    Auto,
    /// The processor, without OpenCL.
    Cpu,
    /// The first OpenCL device.
    OpenCl,
    /// All GPUs, or all OpenCL devices where there is no GPU: the images of a modal estimate are
    /// shared among them.
    All,
    /// One OpenCL device, by the numbers that `cophase devices` prints.
    OpenClDevice {
        /// Index of the platform.
        platform: usize,
        /// Index of the device on that platform.
        device: usize,
    },
}

impl std::str::FromStr for DeviceChoice {
    type Err = crate::Error;

    /// Reads `auto`, `cpu`, `all`, `opencl` or `opencl:P:D`.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for any other word.
    fn from_str(word: &str) -> crate::Result<Self> {
        let numbered = || {
            let (platform, device) = word.strip_prefix("opencl:")?.split_once(':')?;
            Some(Self::OpenClDevice { platform: index(platform)?, device: index(device)? })
        };
        match word {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "opencl" => Ok(Self::OpenCl),
            "all" => Ok(Self::All),
            _ => numbered().ok_or_else(|| {
                crate::Error::Value(format!(
                    "device {word:?} is not accepted; {} is needed",
                    Self::accepted(&crate::scene::value::ANY)
                ))
            }),
        }
    }
}

/// Parses digits only: `usize::from_str` also accepts a sign.
fn index(digits: &str) -> Option<usize> {
    digits.bytes().all(|b| b.is_ascii_digit()).then(|| digits.parse().ok())?
}

impl FromToml for DeviceChoice {
    fn accepted(_: &Range) -> String {
        "\"auto\", \"cpu\", \"all\", \"opencl\" or \"opencl:P:D\" (platform and device numbers)".into()
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        value.as_str()?.parse().ok()
    }
    fn to_toml(&self) -> String {
        match self {
            Self::Auto => "\"auto\"".into(),
            Self::Cpu => "\"cpu\"".into(),
            Self::OpenCl => "\"opencl\"".into(),
            Self::All => "\"all\"".into(),
            Self::OpenClDevice { platform, device } => format!("\"opencl:{platform}:{device}\""),
        }
    }
}

/// Most successive images of a channel in a group.
const MOST_SUCCESSIVE: usize = 10_000;

/// Which images are fitted together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Grouping {
    /// One image of each of several channels, and all images where one of these is in focus or has
    /// less than half a wave RMS of diversity; each image alone otherwise.
    Auto,
    /// Each image alone.
    Each,
    /// All images of all channels.
    All,
    /// So many successive images of each channel, and the next ones again: a sequence of groups.
    Successive(usize),
}

impl Grouping {
    /// The value, as a scene has it.
    pub(crate) fn shown(&self) -> String {
        self.to_toml()
    }
}

impl FromToml for Grouping {
    fn accepted(_: &Range) -> String {
        format!(
            "\"auto\", \"each\", \"channels\" (the same as 1), \"all\" or a number of images from 1 to {MOST_SUCCESSIVE}"
        )
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        match value.as_str() {
            Some("auto") => Some(Self::Auto),
            Some("each") => Some(Self::Each),
            Some("channels") => Some(Self::Successive(1)),
            Some("all") => Some(Self::All),
            Some(_) => None,
            None => usize::from_toml(value, &ANY)
                .filter(|images| (1..=MOST_SUCCESSIVE).contains(images))
                .map(Self::Successive),
        }
    }
    fn to_toml(&self) -> String {
        match self {
            Self::Auto => "\"auto\"".into(),
            Self::Each => "\"each\"".into(),
            Self::All => "\"all\"".into(),
            Self::Successive(1) => "\"channels\"".into(),
            Self::Successive(images) => images.to_string(),
        }
    }
}

/// Part of an image that is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crop {
    /// The square with signal.
    Auto,
    /// A centred square of this many detector pixels a side.
    Pixels(usize),
}

impl FromToml for Crop {
    fn accepted(range: &Range) -> String {
        format!("\"auto\" or {}", usize::accepted(range))
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        match value.as_str() {
            Some(word) => (word == "auto").then_some(Self::Auto),
            None => usize::from_toml(value, range).map(Self::Pixels),
        }
    }
    fn to_toml(&self) -> String {
        match self {
            Self::Auto => "\"auto\"".into(),
            Self::Pixels(pixels) => pixels.to_string(),
        }
    }
    fn is_within(&self, range: &Range) -> bool {
        match self {
            Self::Auto => true,
            Self::Pixels(pixels) => pixels.is_within(range),
        }
    }
}
