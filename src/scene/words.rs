//! Words that a scene may use, as enums, and values with a syntax of their own.

use super::value::{FromToml, Range};
use std::path::PathBuf;
use toml_edit::Value;

/// Defines an enum whose variants are words in a scene; variants after the semicolon are set by other keys.
macro_rules! words {
    ($(#[$meta:meta])* $name:ident { $($(#[$doc:meta])* $variant:ident = $word:literal,)+ $(; $(#[$other_doc:meta])* $other:ident($content:ty))? }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub enum $name { $($(#[$doc])* $variant,)+ $($(#[$other_doc])* $other($content),)? }

        impl $name {
            /// Word of the variant in a scene.
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

/// Lists words: `"a", "b" or "c"`.
fn one_of(words: &[&str]) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("{word:?}")).collect();
    match quoted.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => quoted.join(""),
    }
}

words! {
    /// Aperture of the telescope.
    Aperture {
        /// Hexagons in rings, by default without the central one.
        Keck = "keck",
        /// Hexagons in rings, by default with the central one.
        Hexagonal = "hexagonal",
        ;
        /// A FITS file: amplitude in HDU `PUPIL`, segment labels in HDU `SEGMENT` (optional). Set by `pupil.file`.
        File(PathBuf)
    }
}

words! {
    /// Optical parameter of a scene that can be fitted in addition to the modes.
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
        /// Side of a pixel's sensitive square.
        PixelFill = "pixel-fill",
        /// Diameter of the central obscuration.
        Obscuration = "obscuration",
        /// Width of the spider's vanes.
        Spiders = "spiders",
        /// Light that each segment reflects.
        Reflectivities = "reflectivities",
        /// Slopes of the light over the pupil, and its rise from the centre to the edge.
        Illumination = "illumination",
    }
}

impl Optic {
    /// Key of the scene that gives its value; `None` for the reflectivities, which are 1 in every scene, and for the
    /// illumination, which has several keys.
    pub fn key(&self) -> Option<&'static str> {
        match self {
            Self::PlateScale => Some("image.samples_per_lambda_over_d"),
            Self::Rotation => Some("pupil.rotation_deg"),
            Self::Defocus => Some("image.diversity_focus_waves_rms"),
            Self::Bandwidth => Some("image.bandwidth_fraction"),
            Self::PixelFill => Some("image.pixel_fill"),
            Self::Obscuration => Some("pupil.central_obscuration_m"),
            Self::Spiders => Some("pupil.spider_width_m"),
            Self::Reflectivities | Self::Illumination => None,
        }
    }
}

words! {
    /// Sampling of the pupil in the model.
    #[derive(Copy)]
    PupilModel {
        /// Indicator function of each segment on a fine grid, low-passed and decimated: reaches the noise bound with
        /// few samples.
        BandLimited = "band-limited",
        /// Fraction of each sample's area in each segment; a sample at a border belongs to both segments.
        Area = "area",
        /// Amplitude of each sample without a low pass; each sample belongs to one segment.
        Hard = "hard",
    }
}

words! {
    /// Segment modes that are estimated.
    #[derive(Copy)]
    SegmentModes {
        /// None, except those in `modes.file`.
        None = "none",
        /// One piston for each segment.
        Piston = "piston",
        /// Piston, tip and tilt of each segment.
        PistonTipTilt = "piston-tip-tilt",
    }
}

words! {
    /// Basis of the non-common path aberrations.
    NcpaBasis {
        /// Karhunen-Loève modes of the mirror's influence functions under the turbulence's statistics.
        Kl = "kl",
        /// Zernike polynomials in Noll's order, from tip on.
        Zernike = "zernike",
        /// No basis (`modes.exact_zernikes` can still be estimated).
        None = "none",
        ;
        /// Modes from a FITS file, used without changes. Set by `modes.file`.
        File(PathBuf)
    }
}

words! {
    /// Order, axes or signs of measured slopes, relative to all x and then all y over the subapertures in use, row by row.
    #[derive(Copy)]
    SlopeOrder {
        /// All x, then all y, subapertures row by row.
        Expected = "x-then-y",
        /// Along y first, then along x.
        YBeforeX = "y-then-x",
        /// x and y of each subaperture in turn.
        Interleaved = "interleaved",
        /// Subapertures column by column.
        ColumnMajor = "column-major",
        /// The slopes along x have the opposite sign.
        OppositeX = "opposite-x",
        /// The slopes along y have the opposite sign.
        OppositeY = "opposite-y",
        /// Positions and signs mirrored, left to right.
        FlippedX = "flipped-x",
        /// Positions and signs mirrored, up to down.
        FlippedY = "flipped-y",
        /// Both: rotated by 180°.
        Rotated180 = "rotated-180",
        /// x and y exchanged, positions too.
        Transposed = "transposed",
        /// Rotated by 90°, one way or the other.
        Rotated90 = "rotated-90",
        /// As [`SlopeOrder::Rotated90`], the other way.
        Rotated270 = "rotated-270",
        /// x and y exchanged about the other diagonal.
        TransposedBack = "transposed-back",
    }
}

words! {
    /// Shape of an actuator's influence function.
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
    /// Detector behind a lenslet, and the calculation of slopes.
    #[derive(Copy)]
    SensorDetector {
        /// Diffracted spot on four pixels; slope: difference of the two halves over their sum.
        QuadCell = "quad-cell",
        /// Diffracted spot on `pixels_per_lenslet` pixels a side; slope: centre of gravity.
        Pixels = "pixels",
        /// No diffraction and no noise; slope: mean slope of the wavefront over the lenslet.
        Geometric = "geometric",
    }
}

words! {
    /// Subapertures that are masked in the reconstruction.
    #[derive(Copy)]
    SensorMask {
        /// None.
        None = "none",
        /// Those that straddle segments: no segment has `mask_dominant_fraction` of their light.
        Segments = "segments",
    }
}

words! {
    /// Basis in which the interaction matrix is inverted.
    #[derive(Copy)]
    ControlBasis {
        /// Actuators.
        Zonal = "zonal",
        /// Karhunen-Loève modes of the mirror.
        Kl = "kl",
    }
}

words! {
    /// Control law.
    #[derive(Copy)]
    Loop {
        /// Integrator on the residual slopes.
        Closed = "closed",
        /// The mirror's own slopes are added before the reconstruction.
        PseudoOpenLoop = "pseudo-open-loop",
        /// The mirror's own slopes are added for `fill = "inpaint"` and subtracted again before the integrator.
        FullTurbulenceSlopes = "full-turbulence-slopes",
    }
}

words! {
    /// Treatment of masked slopes.
    #[derive(Copy)]
    Fill {
        /// The measured values are used.
        None = "none",
        /// Their rows are removed from the interaction matrix.
        MaskInteractionMatrix = "mask-interaction-matrix",
        /// They are replaced by values inpainted from their neighbours.
        Inpaint = "inpaint",
    }
}

words! {
    /// Optimiser and recipe of a fit.
    #[derive(Copy)]
    Optimizer {
        /// Noise-weighted maximum likelihood: limited-memory BFGS in the metric of the Gauss-Newton matrix.
        GaussNewton = "gauss-newton",
        /// The paper's method: hard-edged pupil, only the scene's modes, no weights, BFGS from zero.
        Bfgs = "bfgs",
        /// The paper's objective, minimised by the optimiser of [`Optimizer::GaussNewton`]: the same minimum with a
        /// tenth of the evaluations.
        Paper = "paper",
    }
}

words! {
    /// Combination of the images of a sequence, mode by mode.
    #[derive(Copy)]
    Combine {
        /// Mean of all images whose fit converged.
        Mean = "mean",
        /// Median of these images.
        Median = "median",
        /// Mean without outliers.
        ClippedMean = "clipped-mean",
    }
}

words! {
    /// Weight of each pixel in a fit.
    #[derive(Copy)]
    Weighting {
        /// Inverse of the pixel's variance from photon and read noise.
        Noise = "noise",
        /// Equal weights.
        None = "none",
    }
}

words! {
    /// Pixels on which image and model are compared.
    #[derive(Copy)]
    Sampling {
        /// The faster one without loss of information.
        Auto = "auto",
        /// The detector's pixels.
        Native = "native",
        /// Two pixels per λ/D.
        Nyquist = "nyquist",
    }
}

words! {
    /// Precision of the imaging chain.
    #[derive(Copy)]
    Precision {
        /// Double precision.
        F64 = "f64",
        /// Single precision.
        F32 = "f32",
    }
}

words! {
    /// Model of an estimate.
    #[derive(Copy)]
    ModelChoice {
        /// That of the scene, extended where it does not explain the images.
        Auto = "auto",
        /// That of the scene.
        Scene = "scene",
    }
}

words! {
    /// Estimator.
    #[derive(Copy)]
    Method {
        /// Fit of static modes to each image.
        Modal = "modal",
        /// Maximum a posteriori retrieval of the wavefront of each image, and of the static errors from all images.
        FullPhase = "full-phase",
        /// `FullPhase` where the scene has an AO loop or turbulence and the images change from one to the next by more than
        /// their noise; else `Modal`.
        Auto = "auto",
    }
}

words! {
    /// Knowledge of the AO system that a full-phase estimate uses; each level includes those before it.
    #[derive(Copy, PartialOrd, Ord)]
    AoKnowledge {
        /// Only the mirror's pitch; the residual wavefront has a typical spectrum.
        Nothing = "nothing",
        /// Spectrum of the residual wavefront, from the scene's turbulence and control.
        Spectrum = "spectrum",
        /// Response of the closed loop to the segments, from a noise-free, turbulence-free simulation.
        Loop = "loop",
        /// Slopes that the sensor measured during each exposure.
        Telemetry = "telemetry",
    }
}

words! {
    /// Use of telemetry that comes with the images of a full-phase estimate.
    #[derive(Copy)]
    Telemetry {
        /// It is compared with the retrieved wavefronts, and refused where it does not belong to them.
        Check = "check",
        /// It is compared, and used all the same, divided by the gain that was found.
        Use = "use",
        /// It is not used.
        Ignore = "ignore",
    }
}

/// Device that computes an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The fastest available device.
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

/// Parses digits only: `usize::from_str` also accepts a sign.
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
}
