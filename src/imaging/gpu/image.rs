//! An image in the layout of the device.

use super::evaluation::GpuPhotometry;
use super::fold::FoldedShape;

/// One image in the layout of the device.
pub(super) struct FoldedImage {
    pub data: Vec<f64>,
    pub weights: Vec<f64>,
    /// 0 known, 1 flux fitted, 2 flux and background fitted.
    pub kind: i32,
    /// Known flux and background (less the offset), sum of w, sum of w (d - offset).
    pub known: [f64; 4],
    /// Offset subtracted from the data, electrons: the known background, or the weighted mean where
    /// the background is fitted. Without it the sums of a faint star on a bright background would
    /// cancel in f32.
    pub offset: f64,
}

impl FoldedImage {
    pub(super) fn new<D, W>(
        shape: &FoldedShape,
        m: usize,
        data: &[D],
        weights: &[W],
        photometry: &GpuPhotometry,
    ) -> std::result::Result<Self, String>
    where
        D: Copy + Into<f64>,
        W: Copy + Into<f64>,
    {
        let (kind, flux, background) = match *photometry {
            GpuPhotometry::Known { flux_e, background_e } => (0, flux_e, background_e),
            GpuPhotometry::FitFlux { background_e } => (1, 0.0, background_e),
            GpuPhotometry::FitBoth => (2, 0.0, 0.0),
        };
        if !(flux.is_finite() && background.is_finite()) {
            return Err(format!(
                "has a known flux of {flux} and background of {background}: finite electrons are needed"
            ));
        }
        let mut folded = FoldedImage {
            data: vec![0.0; shape.pixels()],
            weights: vec![0.0; shape.pixels()],
            kind,
            known: [flux, 0.0, 0.0, 0.0],
            offset: background,
        };
        if kind == 2 {
            let (mut sum_w, mut sum_wd) = (0.0, 0.0);
            for (&d, &w) in data.iter().zip(weights) {
                let (d, w): (f64, f64) = (d.into(), w.into());
                if w > 0.0 {
                    sum_w += w;
                    sum_wd += w * d;
                }
            }
            folded.offset = if sum_w > 0.0 { sum_wd / sum_w } else { 0.0 };
        }
        for (i, (&d, &w)) in data.iter().zip(weights).enumerate() {
            let (d, w): (f64, f64) = (d.into(), w.into());
            if w == 0.0 {
                continue;
            }
            let (row, column) = (i / m, i % m);
            if !(w.is_finite() && w > 0.0) {
                return Err(format!("has weight {w} at row {row}, column {column}: 0 or a positive number is needed"));
            }
            if !d.is_finite() {
                return Err(format!("holds {d} at row {row}, column {column}, where its weight is not 0"));
            }
            let pixel = shape.pixel(m, row, column);
            folded.data[pixel] = d - folded.offset;
            folded.weights[pixel] = w;
            folded.known[2] += w;
            folded.known[3] += w * folded.data[pixel];
        }
        Ok(folded)
    }
}
