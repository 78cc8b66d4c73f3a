//! The forward model as plain arrays for the device, and their check.

use crate::{Error, Result};

/// The effect of one coefficient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GpuMode {
    /// The piston of this segment.
    Segment(usize),
    /// The slope of this segment along x.
    Tip(usize),
    /// The slope of this segment along y.
    Tilt(usize),
    /// The amount of this smooth mode.
    Smooth(usize),
}

/// The forward model as plain arrays: illuminated pupil samples, their weights and modes, and the sampling of the image. `n` is [`samples`](Self::samples), `m` is [`pixels`](Self::pixels).
///
/// The field at illuminated sample p is `E_p = exp(2πi ψ_p) Σ_s w_ps exp(2πi (c_s + t_s x_ps + u_s y_ps)/λ)` with
/// `ψ_p = diversity_p + Σ_j B_jp y_j/λ`; the
/// focal field is `U[v][u] = Σ E[y][x] exp(−2πi step ((x−(n−1)/2)(u−m/2) + (y−(n−1)/2)(v−m/2)))`, `step = 1/(n q)`, and
/// the image is `intensity_scale |U|²`.
#[derive(Debug, Clone, PartialEq)]
pub struct GpuLayout {
    /// Pupil samples along a side, n; even.
    pub samples: usize,
    /// Image pixels along a side, m; even.
    pub pixels: usize,
    /// Pixels per λ/(width of the pupil grid), q.
    pub samples_per_lambda_over_d: f64,
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// PSF per squared modulus of the focal field.
    pub intensity_scale: f64,
    /// Flat indices `y*n + x` of the illuminated samples, each once.
    pub illuminated: Vec<usize>,
    /// Diversity at each illuminated sample, turns.
    pub diversity_turns: Vec<f64>,
    /// Smooth modes `[mode][illuminated sample]`, nm of wavefront per nm of coefficient.
    pub smooth: Vec<Vec<f64>>,
    /// Number of segments: at least 1 (a monolithic mirror is one segment).
    pub segments: usize,
    /// Illuminated sample p has the entries `segment_start[p]..segment_start[p + 1]` of the lists below.
    pub segment_start: Vec<usize>,
    /// Segment of each entry.
    pub segment_index: Vec<usize>,
    /// Weight of each entry: amplitude, of either sign.
    pub segment_weight: Vec<f64>,
    /// Coordinates of each entry on its segment along x and y, nm of wavefront per nm of tip and of tilt; required where a
    /// mode is a tip or a tilt.
    pub segment_slopes: Option<(Vec<f64>, Vec<f64>)>,
    /// Effect of each coefficient.
    pub modes: Vec<GpuMode>,
    /// Whether there is a free phase, one number per illuminated sample, which adds to ψ_p.
    pub free_phase: bool,
}

impl GpuLayout {
    /// Checks that the arrays fit each other.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] for the first that does not.
    pub fn check(&self) -> Result<()> {
        let even = |what: &str, size: usize| match size {
            0 => Err(Error::Shape(format!("a model of 0 {what} is empty: an even number of 2 or more is needed"))),
            s if s % 2 == 1 => {
                Err(Error::Shape(format!("{s} {what} a side cannot be folded: an even number is needed")))
            }
            _ => Ok(()),
        };
        even("pupil samples", self.samples)?;
        even("image pixels", self.pixels)?;
        for (what, value) in [
            ("samples_per_lambda_over_d", self.samples_per_lambda_over_d),
            ("wavelength_nm", self.wavelength_nm),
            ("intensity_scale", self.intensity_scale),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::Value(format!("{what} is {value}: a positive number is needed")));
            }
        }
        let illuminated = self.illuminated.len();
        let expect = |what: &str, found: usize, wanted: usize| {
            if found == wanted {
                return Ok(());
            }
            Err(Error::Shape(format!(
                "{what} has {found} entries for {illuminated} illuminated samples: {wanted} are needed"
            )))
        };
        expect("diversity_turns", self.diversity_turns.len(), illuminated)?;
        expect("segment_start", self.segment_start.len(), illuminated + 1)?;
        for (j, mode) in self.smooth.iter().enumerate() {
            expect(&format!("smooth mode {j}"), mode.len(), illuminated)?;
        }
        self.check_samples()?;
        self.check_segments()?;
        self.check_modes()
    }

    fn check_samples(&self) -> Result<()> {
        let mut seen = vec![false; self.samples * self.samples];
        for &index in &self.illuminated {
            match seen.get_mut(index) {
                Some(seen) if !*seen => *seen = true,
                Some(_) => {
                    return Err(Error::Shape(format!("illuminated sample {index} is listed twice: list it once")));
                }
                None => {
                    return Err(Error::Shape(format!(
                        "illuminated sample {index} is outside a pupil of {0} x {0} samples",
                        self.samples
                    )));
                }
            }
        }
        if seen.iter().all(|illuminated| !illuminated) {
            return Err(Error::Shape("no sample of the pupil is illuminated: at least one is needed".into()));
        }
        match self.diversity_turns.iter().chain(self.smooth.iter().flatten()).find(|v| !v.is_finite()) {
            Some(value) => {
                Err(Error::Value(format!("a mode or the diversity holds {value}: finite numbers are needed")))
            }
            None => Ok(()),
        }
    }

    fn check_segments(&self) -> Result<()> {
        if self.segments == 0 {
            return Err(Error::Shape("a pupil of 0 segments has no weights: at least one segment is needed".into()));
        }
        let entries = self.segment_index.len();
        let ordered = self.segment_start.windows(2).all(|pair| pair[0] <= pair[1]);
        if !ordered || self.segment_start.first() != Some(&0) || self.segment_start.last() != Some(&entries) {
            return Err(Error::Shape(format!(
                "segment_start must increase from 0 to the number of entries, {entries}"
            )));
        }
        if self.segment_weight.len() != entries {
            return Err(Error::Shape(format!(
                "{} segment weights were given for {entries} entries: as many are needed",
                self.segment_weight.len()
            )));
        }
        if let Some(s) = self.segment_index.iter().find(|s| **s >= self.segments) {
            return Err(Error::Shape(format!("segment {s} is outside 0..{}", self.segments)));
        }
        if let Some(weight) = self.segment_weight.iter().find(|w| !w.is_finite()) {
            return Err(Error::Value(format!("a segment weight is {weight}: finite numbers are needed")));
        }
        let Some((x, y)) = &self.segment_slopes else { return Ok(()) };
        if x.len() != entries || y.len() != entries {
            return Err(Error::Shape(format!(
                "{} and {} segment slopes were given for {entries} entries: as many are needed",
                x.len(),
                y.len()
            )));
        }
        match x.iter().chain(y).find(|v| !v.is_finite()) {
            Some(slope) => Err(Error::Value(format!("a segment slope is {slope}: finite numbers are needed"))),
            None => Ok(()),
        }
    }

    /// Degrees of freedom of a segment: 1 for piston, 3 for piston, tip and tilt.
    #[cfg(feature = "opencl")]
    pub(super) fn poses(&self) -> usize {
        let tilts = |mode: &GpuMode| matches!(mode, GpuMode::Tip(_) | GpuMode::Tilt(_));
        if self.modes.iter().any(tilts) { 3 } else { 1 }
    }

    fn check_modes(&self) -> Result<()> {
        for (k, mode) in self.modes.iter().enumerate() {
            let (what, index, size) = match *mode {
                GpuMode::Segment(s) => ("segment", s, self.segments),
                GpuMode::Tip(s) | GpuMode::Tilt(s) if self.segment_slopes.is_some() => {
                    ("segment tilt", s, self.segments)
                }
                GpuMode::Tip(_) | GpuMode::Tilt(_) => {
                    return Err(Error::Shape(format!("mode {k} tilts a segment, which needs segment_slopes")));
                }
                GpuMode::Smooth(j) => ("smooth mode", j, self.smooth.len()),
            };
            if index >= size {
                return Err(Error::Shape(format!("mode {k} is {what} {index}, outside 0..{size}")));
            }
        }
        Ok(())
    }
}
