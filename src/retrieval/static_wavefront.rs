//! Static wavefront about which the dynamic one of each image is sought.

/// Static wavefront: segment modes, and the rest at each illuminated sample.
#[derive(Debug, Clone, PartialEq)]
pub struct StaticWavefront {
    /// Pistons (and tips and tilts) of the segments, nm: the first coefficients of the retrieval's
    /// model.
    pub segments_nm: Vec<f64>,
    /// NCPA and the loop's response to the segments, nm at each illuminated sample.
    pub smooth_nm: Vec<f64>,
}
