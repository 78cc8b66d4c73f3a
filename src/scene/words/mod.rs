//! Words that a scene may use, as enums, and values with a syntax of their own.

/// Defines an enum whose variants are words in a scene; variants after the semicolon are set by
/// other keys.
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

mod adaptive;
mod device;
mod estimate;
mod telescope;

pub use adaptive::{
    ControlBasis, Fill, Influence, Loop, OpticalGainMethod, ReconstructorKind, SensorDetector, SensorKind, SensorMask,
    SlopeNormalisation, SlopeOrder,
};
pub use device::{Crop, DeviceChoice, Grouping};
pub use estimate::{
    AoKnowledge, Combine, Method, ModelChoice, Optimizer, Precision, Sampling, SegmentConvention, Telemetry, Weighting,
};
pub use telescope::{Aperture, NcpaBasis, PupilModel, SegmentModes};

/// Lists words: `"a", "b" or "c"`.
pub(super) fn one_of(words: &[&str]) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("{word:?}")).collect();
    match quoted.split_last() {
        Some((last, rest)) if !rest.is_empty() => format!("{} or {last}", rest.join(", ")),
        _ => quoted.join(""),
    }
}
