//! Layout of the tables of AOT 2.0.0: their columns in the standard's order, each with its kind and
//! unit. Transcribed from aotpy 3.2.1.
//!
//! The tables of laser guide stars, pyramids and offload loops, which a file needs only where it
//! has these, are not written.

use Kind::{Integer, List, Real, Text};

/// Kind of the cells of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    /// Text, or a reference to an image or a row.
    Text,
    Real,
    Integer,
    /// Reals, any number of them.
    List,
}

/// A table.
pub(super) struct AotTable {
    pub(super) name: &'static str,
    /// Name, kind and unit of each column.
    pub(super) columns: &'static [(&'static str, Kind, &'static str)],
}

/// The tables that are written.
pub(super) const TABLES: &[AotTable] = &[
    AotTable {
        name: "AOT_TIME",
        columns: &[("UID", Text, ""), ("TIMESTAMPS", List, "s"), ("FRAME_NUMBERS", List, "count")],
    },
    AotTable {
        name: "AOT_ATMOSPHERIC_PARAMETERS",
        columns: &[
            ("UID", Text, ""),
            ("WAVELENGTH", Real, "m"),
            ("TIME_UID", Text, ""),
            ("R0", List, "m"),
            ("SEEING", List, "arcsec"),
            ("TAU0", List, "s"),
            ("THETA0", List, "rad"),
            ("LAYERS_REL_WEIGHT", Text, ""),
            ("LAYERS_HEIGHT", Text, ""),
            ("LAYERS_LO", Text, ""),
            ("LAYERS_WIND_SPEED", Text, ""),
            ("LAYERS_WIND_DIRECTION", Text, ""),
            ("TRANSFORMATION_MATRIX", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_ABERRATIONS",
        columns: &[
            ("UID", Text, ""),
            ("MODES", Text, ""),
            ("COEFFICIENTS", Text, ""),
            ("X_OFFSETS", List, "rad"),
            ("Y_OFFSETS", List, "rad"),
        ],
    },
    AotTable {
        name: "AOT_TELESCOPES",
        columns: &[
            ("UID", Text, ""),
            ("TYPE", Text, ""),
            ("LATITUDE", Real, "deg"),
            ("LONGITUDE", Real, "deg"),
            ("ELEVATION", Real, "deg"),
            ("AZIMUTH", Real, "deg"),
            ("PARALLACTIC", Real, "deg"),
            ("PUPIL_MASK", Text, ""),
            ("PUPIL_ANGLE", Real, "rad"),
            ("ENCLOSING_D", Real, "m"),
            ("INSCRIBED_D", Real, "m"),
            ("OBSTRUCTION_D", Real, "m"),
            ("SEGMENT_TYPE", Text, ""),
            ("SEGMENT_SIZE", Real, "m"),
            ("SEGMENTS_X", List, "m"),
            ("SEGMENTS_Y", List, "m"),
            ("TRANSFORMATION_MATRIX", Text, ""),
            ("ABERRATION_UID", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_SOURCES",
        columns: &[
            ("UID", Text, ""),
            ("TYPE", Text, ""),
            ("RIGHT_ASCENSION", Real, "deg"),
            ("DECLINATION", Real, "deg"),
            ("ELEVATION_OFFSET", Real, "deg"),
            ("AZIMUTH_OFFSET", Real, "deg"),
            ("FWHM", Real, "rad"),
        ],
    },
    AotTable {
        name: "AOT_DETECTORS",
        columns: &[
            ("UID", Text, ""),
            ("TYPE", Text, ""),
            ("SAMPLING_TECHNIQUE", Text, ""),
            ("SHUTTER_TYPE", Text, ""),
            ("FLAT_FIELD", Text, ""),
            ("READOUT_NOISE", Real, "electron*s^-1*pix^-1"),
            ("PIXEL_INTENSITIES", Text, ""),
            ("FIELD_CENTRE_X", Real, "pix"),
            ("FIELD_CENTRE_Y", Real, "pix"),
            ("INTEGRATION_TIME", Real, "s"),
            ("COADDS", Integer, "count"),
            ("DARK", Text, ""),
            ("WEIGHT_MAP", Text, ""),
            ("QUANTUM_EFFICIENCY", Real, ""),
            ("PIXEL_SCALE", Real, "rad*pix^-1"),
            ("BINNING", Integer, "count"),
            ("BANDWIDTH", Real, "m"),
            ("TRANSMISSION_WAVELENGTH", List, "m"),
            ("TRANSMISSION", List, ""),
            ("SKY_BACKGROUND", Text, ""),
            ("GAIN", Real, "electron"),
            ("EXCESS_NOISE", Real, "electron"),
            ("FILTER", Text, ""),
            ("BAD_PIXEL_MAP", Text, ""),
            ("DYNAMIC_RANGE", Real, "dB"),
            ("READOUT_RATE", Real, "pix*s^-1"),
            ("FRAME_RATE", Real, "frame*s^-1"),
            ("TRANSFORMATION_MATRIX", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_SCORING_CAMERAS",
        columns: &[
            ("UID", Text, ""),
            ("PUPIL_MASK", Text, ""),
            ("WAVELENGTH", Real, "m"),
            ("TRANSFORMATION_MATRIX", Text, ""),
            ("DETECTOR_UID", Text, ""),
            ("ABERRATION_UID", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_WAVEFRONT_SENSORS",
        columns: &[
            ("UID", Text, ""),
            ("TYPE", Text, ""),
            ("SOURCE_UID", Text, ""),
            ("DIMENSIONS", Integer, "count"),
            ("N_VALID_SUBAPERTURES", Integer, "count"),
            ("MEASUREMENTS", Text, ""),
            ("REF_MEASUREMENTS", Text, ""),
            ("SUBAPERTURE_MASK", Text, ""),
            ("MASK_X_OFFSETS", List, "pix"),
            ("MASK_Y_OFFSETS", List, "pix"),
            ("SUBAPERTURE_SIZE", Real, "pix"),
            ("SUBAPERTURE_INTENSITIES", Text, ""),
            ("WAVELENGTH", Real, "m"),
            ("OPTICAL_GAIN", Text, ""),
            ("TRANSFORMATION_MATRIX", Text, ""),
            ("DETECTOR_UID", Text, ""),
            ("ABERRATION_UID", Text, ""),
            ("NCPA_UID", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_WAVEFRONT_SENSORS_SHACK_HARTMANN",
        columns: &[
            ("UID", Text, ""),
            ("CENTROIDING_ALGORITHM", Text, ""),
            ("CENTROID_GAINS", Text, ""),
            ("SPOT_FWHM", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_WAVEFRONT_CORRECTORS",
        columns: &[
            ("UID", Text, ""),
            ("TYPE", Text, ""),
            ("TELESCOPE_UID", Text, ""),
            ("N_VALID_ACTUATORS", Integer, "count"),
            ("PUPIL_MASK", Text, ""),
            ("TFZ_NUM", List, ""),
            ("TFZ_DEN", List, ""),
            ("TRANSFORMATION_MATRIX", Text, ""),
            ("ABERRATION_UID", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_WAVEFRONT_CORRECTORS_DM",
        columns: &[
            ("UID", Text, ""),
            ("ACTUATORS_X", List, "m"),
            ("ACTUATORS_Y", List, "m"),
            ("INFLUENCE_FUNCTION", Text, ""),
            ("STROKE", Real, "m"),
        ],
    },
    AotTable {
        name: "AOT_LOOPS",
        columns: &[
            ("UID", Text, ""),
            ("TYPE", Text, ""),
            ("COMMANDED_UID", Text, ""),
            ("TIME_UID", Text, ""),
            ("STATUS", Text, ""),
            ("COMMANDS", Text, ""),
            ("REF_COMMANDS", Text, ""),
            ("FRAMERATE", Real, "Hz"),
            ("DELAY", Real, "frame"),
            ("TIME_FILTER_NUM", Text, ""),
            ("TIME_FILTER_DEN", Text, ""),
        ],
    },
    AotTable {
        name: "AOT_LOOPS_CONTROL",
        columns: &[
            ("UID", Text, ""),
            ("INPUT_SENSOR_UID", Text, ""),
            ("MODES", Text, ""),
            ("MODAL_COEFFICIENTS", Text, ""),
            ("CONTROL_MATRIX", Text, ""),
            ("MEASUREMENTS_TO_MODES", Text, ""),
            ("MODES_TO_COMMANDS", Text, ""),
            ("INTERACTION_MATRIX", Text, ""),
            ("COMMANDS_TO_MODES", Text, ""),
            ("MODES_TO_MEASUREMENTS", Text, ""),
            ("RESIDUAL_COMMANDS", Text, ""),
        ],
    },
];
