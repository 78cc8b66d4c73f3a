//! Interpolation of wavefronts from retrieved samples to those of the sensor.

use crate::modes::Samples;
use crate::retrieval::IlluminatedSamples;
use ndarray::{Array1, ArrayView1};

/// Least weight of illuminated neighbours in a bilinear interpolation: with less the nearest sample
/// is taken.
const MIN_WEIGHT: f64 = 1e-3;

/// Interpolates a wavefront from the retrieved samples to those of the sensor.
pub(super) fn interpolated(interpolation: &[[(u32, f64); 4]], wavefront_nm: ArrayView1<f64>) -> Array1<f64> {
    let at = |corners: &[(u32, f64); 4]| corners.iter().map(|&(s, w)| w * wavefront_nm[s as usize]).sum::<f64>();
    interpolation.iter().map(at).collect()
}

/// Bilinear interpolation between illuminated samples: the weights of dark ones go to the others,
/// and where all are dark the nearest illuminated sample is taken.
pub(super) fn interpolation(samples: &IlluminatedSamples, fine: &Samples) -> Vec<[(u32, f64); 4]> {
    let n = samples.samples;
    let mut sample_at = vec![None; n * n];
    samples.indices.iter().enumerate().for_each(|(sample, &index)| sample_at[index] = Some(sample as u32));
    let index = |c_m: f64| (c_m / samples.pitch_m + (n as f64 - 1.0) / 2.0).clamp(0.0, n as f64 - 1.0);
    let between = |x_m: f64, y_m: f64| {
        let (x, y) = (index(x_m), index(y_m));
        let (u, v) = ((x as usize).min(n - 2), (y as usize).min(n - 2));
        let (fx, fy) = (x - u as f64, y - v as f64);
        let corners = [
            (v, u, (1.0 - fy) * (1.0 - fx)),
            (v, u + 1, (1.0 - fy) * fx),
            (v + 1, u, fy * (1.0 - fx)),
            (v + 1, u + 1, fy * fx),
        ];
        let mut found = corners.map(|(v, u, w)| sample_at[v * n + u].map_or((0, 0.0), |sample| (sample, w)));
        let whole: f64 = found.iter().map(|(_, w)| w).sum();
        if whole > MIN_WEIGHT {
            found.iter_mut().for_each(|(_, w)| *w /= whole);
            return found;
        }
        let away = |sample: usize| (samples.xs_m[sample] - x_m).powi(2) + (samples.ys_m[sample] - y_m).powi(2);
        let nearest = (0..samples.len()).min_by(|&a, &b| away(a).total_cmp(&away(b))).unwrap_or(0);
        [(nearest as u32, 1.0), (0, 0.0), (0, 0.0), (0, 0.0)]
    };
    fine.xs_m.iter().zip(&fine.ys_m).map(|(&x_m, &y_m)| between(x_m, y_m)).collect()
}
