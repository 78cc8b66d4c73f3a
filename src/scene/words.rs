//! The words that a scene may use, as enums, and the few values with a grammar of their own.

use super::value::{FromToml, Range};
use std::path::PathBuf;
use toml_edit::Value;

/// Defines an enum whose variants are words in a scene; variants after the semicolon are set by other keys.
macro_rules! words {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident = $word:literal,)+ $(; $(#[$other_doc:meta])* $other:ident($of:ty))? }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub enum $name { $($(#[$doc])* $variant,)+ $($(#[$other_doc])* $other($of),)? }

        impl $name {
            /// The word for it in a scene.
            pub fn word(&self) -> &'static str {
                match self { $(Self::$variant => $word,)+ $(Self::$other(_) => "file",)? }
            }
        }

        impl FromToml for $name {
            fn accepted(_: &Range) -> String {
                one_of(&[$($word),+])
            }
            fn from_toml(value: &Value, _: &Range) -> Option<Self> {
                match value.as_str()? { $($word => Some(Self::$variant),)+ _ => None }
            }
            fn to_toml(&self) -> String {
                format!("{:?}", self.word())
            }
        }
    };
}

/// `"a", "b" or "c"`.
fn one_of(words: &[&str]) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("{word:?}")).collect();
    match quoted.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => quoted.join(""),
    }
}

words! {
    /// The telescope's aperture.
    Aperture {
        /// Hexagons in rings, the central one absent unless the scene says otherwise.
        Keck = "keck",
        /// Hexagons in rings, the central one present unless the scene says otherwise.
        Hexagonal = "hexagonal",
        ;
        /// A FITS file: amplitude in HDU `PUPIL`, segment labels in HDU `SEGMENT` (optional). Set by `pupil.file`.
        File(PathBuf)
    }
}

words! {
    /// A number of the scene that can be fitted beside the modes.
    #[derive(Copy)]
    Optic {
        /// Pixels per λ/D.
        PlateScale = "plate-scale",
        /// Rotation of the pupil.
        Rotation = "rotation",
        /// Amplitude of the defocus.
        Defocus = "defocus",
        /// Width of the filter.
        Bandwidth = "bandwidth",
    }
}

words! {
    /// How the model samples the pupil.
    #[derive(Copy)]
    PupilModel {
        /// Each segment's fine indicator, low-passed and decimated: reaches the noise bound with few samples.
        BandLimited = "band-limited",
        /// Each segment's share of each sample's area; a sample at a border belongs to both.
        Area = "area",
        /// The amplitude of each sample as it is; each sample belongs to one segment.
        Hard = "hard",
    }
}

words! {
    /// Which motions of the segments are estimated.
    #[derive(Copy)]
    SegmentModes {
        /// None, beyond those in `modes.file`.
        None = "none",
        /// One piston for each segment.
        Piston = "piston",
        /// Piston, tip and tilt of each segment.
        PistonTipTilt = "piston-tip-tilt",
    }
}

words! {
    /// The basis of the non-common path aberrations.
    NcpaBasis {
        /// Karhunen-Loève modes of the mirror's influence functions under the turbulence's statistics.
        Kl = "kl",
        /// Zernike polynomials in Noll's order, from tip on.
        Zernike = "zernike",
        /// No basis (exact Zernikes may still be asked for).
        None = "none",
        ;
        /// Modes from a FITS file, used as they are. Set by `modes.file`.
        File(PathBuf)
    }
}

words! {
    /// The shape of an actuator's influence on the mirror.
    #[derive(Copy)]
    Influence {
        /// `coupling^(r²/pitch²)`: 1 at the actuator, `coupling` at its neighbour.
        Gaussian = "gaussian",
    }
}

words! {
    /// Kind of wavefront sensor.
    #[derive(Copy)]
    SensorKind {
        /// An array of lenslets.
        ShackHartmann = "shack-hartmann",
    }
}

words! {
    /// How a lenslet's spot becomes slopes.
    #[derive(Copy)]
    SensorDetector {
        /// Diffracted light on four pixels: the difference of the two halves over their sum.
        QuadCell = "quad-cell",
        /// Diffracted light on `pixels_per_lenslet` pixels a side: the centre of gravity.
        Pixels = "pixels",
        /// No light: the mean slope of the wavefront over the lenslet, without noise.
        Geometric = "geometric",
    }
}

words! {
    /// Which subapertures the reconstructor leaves out.
    #[derive(Copy)]
    SensorMask {
        /// None.
        None = "none",
        /// Those that straddle segments: no segment holds `mask_dominant_fraction` of the light.
        Segments = "segments",
    }
}

words! {
    /// The space in which the slopes are inverted.
    #[derive(Copy)]
    ControlBasis {
        /// The actuators.
        Zonal = "zonal",
        /// The mirror's Karhunen-Loève modes.
        Kl = "kl",
    }
}

words! {
    /// How the loop is closed.
    #[derive(Copy)]
    Loop {
        /// An integrator on the residual slopes.
        Closed = "closed",
        /// The mirror's own slopes are added back before the reconstruction.
        PseudoOpenLoop = "pseudo-open-loop",
        /// The mirror's own slopes are added back for `fill = "inpaint"` and taken away again before the integrator.
        FullTurbulenceSlopes = "full-turbulence-slopes",
    }
}

words! {
    /// What stands in for masked slopes.
    #[derive(Copy)]
    Fill {
        /// Their measured values: nothing is replaced.
        None = "none",
        /// Nothing: their rows leave the interaction matrix.
        MaskInteractionMatrix = "mask-interaction-matrix",
        /// Values inpainted from their neighbours.
        Inpaint = "inpaint",
    }
}

words! {
    /// The recipe of a fit.
    #[derive(Copy)]
    Optimizer {
        /// Noise-weighted maximum likelihood: limited-memory BFGS in the metric of the Gauss-Newton matrix.
        GaussNewton = "gauss-newton",
        /// The paper's method as a whole: hard-edged pupil, the scene's modes alone, no weights, BFGS from zero.
        Bfgs = "bfgs",
        /// The paper's objective, minimised as [`Optimizer::GaussNewton`] does: the same minimum in a tenth of the
        /// evaluations.
        Paper = "paper",
    }
}

words! {
    /// How the images of a sequence become one estimate, mode by mode.
    #[derive(Copy)]
    Combine {
        /// The mean of all images whose fit converged.
        Mean = "mean",
        /// Their median.
        Median = "median",
        /// The mean without those that scatter far more than the others do.
        ClippedMean = "clipped-mean",
    }
}

words! {
    /// The weight of each pixel in a fit.
    #[derive(Copy)]
    Weighting {
        /// One over its photon and read variance.
        Noise = "noise",
        /// The same for all.
        None = "none",
    }
}

words! {
    /// The pixels that a fit compares.
    #[derive(Copy)]
    Sampling {
        /// Whichever costs less without loss.
        Auto = "auto",
        /// The detector's own.
        Native = "native",
        /// Two per λ/D.
        Nyquist = "nyquist",
    }
}

words! {
    /// The precision of the imaging chain.
    #[derive(Copy)]
    Precision {
        /// Double.
        F64 = "f64",
        /// Single.
        F32 = "f32",
    }
}

words! {
    /// The estimator.
    #[derive(Copy)]
    Method {
        /// Static modes, fitted image by image.
        Modal = "modal",
        /// The whole wavefront behind each image of a sequence, and static errors from all of them together.
        FullPhase = "full-phase",
    }
}

words! {
    /// What a full-phase estimate assumes of the adaptive optics in front of the camera: each level with all before it.
    #[derive(Copy, PartialOrd, Ord)]
    Knows {
        /// Nothing: the mirror's pitch, and a spectrum of ordinary seeing.
        Nothing = "nothing",
        /// The spectrum of the residual wavefront, from the scene's turbulence and control.
        Spectrum = "spectrum",
        /// The loop: what it answers to the pistons is found by closing it on them alone.
        Loop = "loop",
        /// What its sensor measured during each exposure.
        Telemetry = "telemetry",
    }
}

/// Where the estimator runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The fastest that is here.
    Auto,
    /// The processor, without OpenCL.
    Cpu,
    /// The first OpenCL device.
    OpenCl,
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

    /// Reads `auto`, `cpu`, `opencl` or `opencl:P:D`.
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
            _ => numbered().ok_or_else(|| {
                crate::Error::Value(format!(
                    "device {word:?} is not accepted; {} is needed",
                    Self::accepted(&super::value::ANY)
                ))
            }),
        }
    }
}

/// Digits alone: `usize::from_str` would also take a sign.
fn index(digits: &str) -> Option<usize> {
    digits.bytes().all(|b| b.is_ascii_digit()).then(|| digits.parse().ok())?
}

impl FromToml for DeviceChoice {
    fn accepted(_: &Range) -> String {
        "\"auto\", \"cpu\", \"opencl\" or \"opencl:P:D\" (platform and device numbers)".into()
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        value.as_str()?.parse().ok()
    }
    fn to_toml(&self) -> String {
        match self {
            Self::Auto => "\"auto\"".into(),
            Self::Cpu => "\"cpu\"".into(),
            Self::OpenCl => "\"opencl\"".into(),
            Self::OpenClDevice { platform, device } => format!("\"opencl:{platform}:{device}\""),
        }
    }
}

/// How much of an image is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crop {
    /// What carries signal.
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
}
