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

/// One wavelength of the model.
#[derive(Debug, Clone, PartialEq)]
pub struct GpuColour {
    /// Pixels per λ/(width of the pupil grid), q.
    pub samples_per_lambda_over_d: f64,
    /// Wavelength λ, nm.
    pub wavelength_nm: f64,
    /// PSF per squared modulus of the focal field: with several wavelengths, times this one's share
    /// of the light.
    pub intensity_scale: f64,
    /// Diversity at each illuminated sample, turns.
    pub diversity_turns: Vec<f64>,
}

/// The forward model as plain arrays: illuminated pupil samples, their weights and modes, and the
/// sampling of the image. `n` is [`samples`](Self::samples), `m` is [`pixels`](Self::pixels).
///
/// The field at illuminated sample p is
/// `E_p = exp(2πi ψ_p) Σ_s w_ps exp(2πi (c_s + t_s x_ps + u_s y_ps)/λ)` with
/// `ψ_p = diversity_p + Σ_j B_jp y_j/λ`; the focal field is
/// `U[v][u] = Σ E[y][x] exp(−2πi step ((x−(n−1)/2)(u−m/2) + (y−(n−1)/2)(v−m/2)))`,
/// `step = 1/(n q)`, and the image is `intensity_scale |U|²`, summed over the wavelengths, and
/// where pixels have an area convolved with their response.
#[derive(Debug, Clone, PartialEq)]
pub struct GpuLayout {
    /// Pupil samples along a side, n; even.
    pub samples: usize,
    /// Image pixels along a side, m; even.
    pub pixels: usize,
    /// The wavelengths; at least one.
    pub colours: Vec<GpuColour>,
    /// Response of a pixel along x and along y, as terms of a symmetric convolution: of the pixel
    /// itself, and of those at a distance of 1, 2, … on both sides. Beyond the border the image is
    /// continued by its mirror image. `None` for pixels that are points.
    pub pixel_terms: Option<[Vec<f64>; 2]>,
    /// Flat indices `y*n + x` of the illuminated samples, each once.
    pub illuminated: Vec<usize>,
    /// Smooth modes `[mode][illuminated sample]`, nm of wavefront per nm of coefficient.
    pub smooth: Vec<Vec<f64>>,
    /// Number of segments: at least 1 (a monolithic mirror is one segment).
    pub segments: usize,
    /// Illuminated sample p has the entries `segment_start[p]..segment_start[p + 1]` of the lists
    /// below.
    pub segment_start: Vec<usize>,
    /// Segment of each entry.
    pub segment_index: Vec<usize>,
    /// Weight of each entry: amplitude, of either sign.
    pub segment_weight: Vec<f64>,
    /// Coordinates of each entry on its segment along x and y, nm of wavefront per nm of tip and of
    /// tilt; required where a mode is a tip or a tilt.
    pub segment_slopes: Option<(Vec<f64>, Vec<f64>)>,
    /// Effect of each coefficient.
    pub modes: Vec<GpuMode>,
    /// Whether there is a free phase, one number per illuminated sample, which adds to ψ_p: turns
    /// at the wavelength [`free_wavelength_nm`](Self::free_wavelength_nm).
    pub free_phase: bool,
    /// Wavelength of the free phase, nm.
    pub free_wavelength_nm: f64,
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
        if self.colours.is_empty() {
            return Err(Error::Shape("a model of 0 wavelengths has no image: at least one is needed".into()));
        }
        for colour in &self.colours {
            for (what, value) in [
                ("samples_per_lambda_over_d", colour.samples_per_lambda_over_d),
                ("wavelength_nm", colour.wavelength_nm),
                ("intensity_scale", colour.intensity_scale),
                ("free_wavelength_nm", self.free_wavelength_nm),
            ] {
                if !(value.is_finite() && value > 0.0) {
                    return Err(Error::Value(format!("{what} is {value}: a positive number is needed")));
                }
            }
        }
        self.check_pixel_terms()?;
        let illuminated = self.illuminated.len();
        let expect = |what: &str, found: usize, wanted: usize| {
            if found == wanted {
                return Ok(());
            }
            Err(Error::Shape(format!(
                "{what} has {found} entries for {illuminated} illuminated samples: {wanted} are needed"
            )))
        };
        for colour in &self.colours {
            expect("diversity_turns", colour.diversity_turns.len(), illuminated)?;
        }
        expect("segment_start", self.segment_start.len(), illuminated + 1)?;
        for (j, mode) in self.smooth.iter().enumerate() {
            expect(&format!("smooth mode {j}"), mode.len(), illuminated)?;
        }
        self.check_samples()?;
        self.check_segments()?;
        self.check_modes()
    }

    fn check_pixel_terms(&self) -> Result<()> {
        let Some([x, y]) = &self.pixel_terms else { return Ok(()) };
        if x.is_empty() || x.len() != y.len() {
            let (x, y) = (x.len(), y.len());
            return Err(Error::Shape(format!(
                "pixel_terms has {x} terms along x and {y} along y: as many are needed, and at least one"
            )));
        }
        match x.iter().chain(y).find(|term| !term.is_finite()) {
            Some(term) => Err(Error::Value(format!("a term of pixel_terms is {term}: finite numbers are needed"))),
            None => Ok(()),
        }
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
        let diversities = self.colours.iter().flat_map(|colour| &colour.diversity_turns);
        match diversities.chain(self.smooth.iter().flatten()).find(|v| !v.is_finite()) {
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

    /// Whether the image is the squared modulus of one field: the kernels then need not store it.
    #[cfg(feature = "opencl")]
    pub(super) fn is_one_field(&self) -> bool {
        self.colours.len() == 1 && self.pixel_terms.is_none()
    }

    /// The first wavelength over wavelength `colour`.
    #[cfg(feature = "opencl")]
    pub(super) fn phase_scale(&self, colour: usize) -> f64 {
        self.colours[0].wavelength_nm / self.colours[colour].wavelength_nm
    }

    /// Numbers that result from an evaluation: objective, flux, background, and a derivative for
    /// each pose of each segment and each smooth mode.
    #[cfg(feature = "opencl")]
    pub(super) fn outputs(&self) -> usize {
        3 + self.segments * self.poses() + self.smooth.len()
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
