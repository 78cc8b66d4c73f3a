//! Wavelengths that sample a filter of finite width: Gauss-Legendre quadrature.
//!
//! The image in a band is the mean over its wavelengths. K Gauss-Legendre nodes integrate
//! polynomials of degree 2K − 1 exactly. At r λ/D from the axis the phase of the field changes by
//! r·Δ turns over a band of width Δ; the mean of cos(2π·t·r·Δ) over t from −½ to ½ has an error of
//! 1e-3 with K = 2 + 2·r·Δ nodes.

/// Number of wavelengths for a filter of `width` (relative to its mean wavelength) and light up to
/// `reach_lambda_over_d` from the axis.
pub fn wavelengths_to(reach_lambda_over_d: f64, width: f64) -> usize {
    if width > 0.0 { (2.0 + 2.0 * reach_lambda_over_d * width).ceil() as usize } else { 1 }
}

/// Wavelengths of a flat filter of `width` (relative to its mean wavelength), `count` of them: each
/// relative to the mean, with its weight; the weights sum to 1.
pub fn band(width: f64, count: usize) -> Vec<(f64, f64)> {
    gauss_legendre(count).into_iter().map(|(place, share)| (1.0 + 0.5 * width * place, share)).collect()
}

/// Nodes on (−1, 1) and weights of sum 1: zeros of Legendre's polynomial of degree `count` by
/// Newton's method from Tricomi's starting points (Press et al., Numerical Recipes, section 4.6).
pub(super) fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    let n = count as f64;
    (0..count)
        .map(|i| {
            let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n + 0.5)).cos();
            let mut slope = 0.0;
            // The correct digits double with each step, from three.
            for _ in 0..8 {
                let (value, before) = (1..=count).fold((1.0, 0.0), |(p, q), k| {
                    let k = k as f64;
                    (((2.0 * k - 1.0) * x * p - (k - 1.0) * q) / k, p)
                });
                slope = n * (x * value - before) / (x * x - 1.0);
                x -= value / slope;
            }
            (-x, 1.0 / ((1.0 - x * x) * slope * slope))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_integrate_polynomials_of_twice_their_number() {
        for count in 1..=30 {
            let nodes = gauss_legendre(count);
            for degree in 0..2 * count as i32 {
                let sum: f64 = nodes.iter().map(|(x, share)| share * x.powi(degree)).sum();
                let exact = if degree % 2 == 0 { 1.0 / f64::from(degree + 1) } else { 0.0 };
                // Newton's method ends at the rounding of a zero, which enters the weights squared.
                assert!((sum - exact).abs() < 1e-13, "{count} {degree}: {sum} {exact}");
            }
        }
    }

    #[test]
    fn wavelengths_to_gives_enough_nodes_at_the_rim_of_the_spot() {
        for (spot, width) in [(20.0, 0.015), (20.0, 0.05), (20.0, 0.2), (60.0, 0.1)] {
            let count = wavelengths_to(spot, width);
            let turns = |ratio: f64| std::f64::consts::TAU * spot * (ratio - 1.0);
            let mean: f64 = band(width, count).iter().map(|(ratio, share)| share * turns(*ratio).cos()).sum();
            let whole = std::f64::consts::PI * spot * width;
            assert!((mean - whole.sin() / whole).abs() < 2e-3, "{spot} {width}: {mean} {}", whole.sin() / whole);
        }
    }
}
