//! Spectrum of the photons that a camera detects: transmission of its filter times the star's
//! photons, and Gauss quadrature of it.

use super::band::gauss_legendre;
use crate::Result;
use crate::modes::symmetric_eigen;
use ndarray::Array2;

/// Second radiation constant hc/k, nm·K (CODATA 2018).
const RADIATION_CONSTANT_NM_K: f64 = 1.438_776_877e7;

/// Faint ends of a spectrum are left out as far as each is below this part of the largest value,
const FAINT: f64 = 1e-3;
/// and holds no more than this part of the photons. Together both ends then change no mean over the
/// spectrum of a quantity of modulus 1 by more than twice their sum, 1e-3: what
/// [`super::band::wavelengths_to`] allows. Without the limit on the photons a leak of 5e-4 over 20
/// times the width of the filter, 1 % of the light, would be lost; without that on the transmission
/// sharp ends would be.
const FAINT_SHARE: f64 = 2.5e-4;

/// Nodes in addition to those which make the integral of a polynomial over a linear piece exact,
/// for Planck's law: n nodes integrate e^(ct), t from −1 to 1, with a relative error of about 2²ⁿ⁺¹
/// n!⁴ c²ⁿ / ((2n + 1) (2n)!³), 1e-13 for n = 8 and c = 2,
const MORE_NODES: usize = 8;
/// which is this change of the logarithm of the star's photons; pieces over which it changes by
/// more are divided.
const LARGEST_CHANGE: f64 = 4.0;

/// Least share of a wavelength: rounding of the eigenvectors' squares.
const LEAST_SHARE: f64 = f64::EPSILON;

/// Photons for each wavelength: linear between rows of wavelength and transmission, 0 outside,
/// times those of a black body.
#[derive(Debug, Clone)]
pub(super) struct Spectrum {
    /// Wavelength, nm, ascending, and transmission.
    rows: Vec<(f64, f64)>,
    star_temperature_k: Option<f64>,
}

impl Spectrum {
    /// The spectrum behind a filter of these rows (wavelength in nm, ascending, and relative
    /// transmission of a photon), of a star of this temperature or with the same number of photons
    /// for each wavelength. Its faint ends are left out.
    pub(super) fn new(rows: Vec<(f64, f64)>, star_temperature_k: Option<f64>) -> Self {
        let whole = Self { rows, star_temperature_k };
        let legendre = gauss_legendre(MORE_NODES);
        let photons: Vec<f64> = (1..whole.rows.len())
            .map(|piece| whole.points_of(piece, &legendre).iter().map(|(_, photons)| photons).sum())
            .collect();
        let most: f64 = photons.iter().sum::<f64>() * FAINT_SHARE;
        let reference_nm = whole.reference_nm();
        let values: Vec<f64> =
            whole.rows.iter().map(|&(nm, transmission)| transmission * whole.star(nm, reference_nm)).collect();
        let faint = FAINT * values.iter().copied().fold(0.0, f64::max);
        // Number of pieces at an end that are left out.
        let left_out = |pieces: &mut dyn Iterator<Item = (f64, [f64; 2])>| {
            let mut sum = 0.0;
            pieces
                .take_while(|(photons, values)| {
                    sum += photons;
                    sum <= most && values.iter().all(|value| *value < faint)
                })
                .count()
        };
        let piece = |piece: usize| (photons[piece], [values[piece], values[piece + 1]]);
        let first = left_out(&mut (0..photons.len()).map(piece));
        let last = values.len() - left_out(&mut (0..photons.len()).rev().map(piece));
        Self { rows: whole.rows[first..last].to_vec(), star_temperature_k }
    }

    /// First and last wavelength with light, nm.
    pub(super) fn range_nm(&self) -> [f64; 2] {
        [self.rows[0].0, self.rows[self.rows.len() - 1].0]
    }

    /// Gauss quadrature of the spectrum with `count` nodes: wavelengths, nm, ascending, with their
    /// shares of the photons. The shares are positive and sum to 1. With all nodes, the mean of a
    /// polynomial of degree 2·`count` − 1 over the spectrum is exact; nodes whose share is rounding
    /// are left out.
    ///
    /// The polynomials that are orthonormal with respect to the spectrum, ⟨pᵢ pⱼ⟩ = δᵢⱼ with ⟨·⟩
    /// the mean over its photons, have a recurrence with three terms,
    ///
    /// ```text
    /// bₖ₊₁ pₖ₊₁ = (x − aₖ) pₖ − bₖ pₖ₋₁      aₖ = ⟨x pₖ²⟩      bₖ₊₁ = the norm of the right side
    /// ```
    ///
    /// and the nodes are the eigenvalues of the symmetric tridiagonal matrix of diagonal a and
    /// off-diagonal b, the shares the squares of the first components of its eigenvectors (Golub &
    /// Welsch, Math. Comp. 23, 1969). The means are sums over Gauss-Legendre nodes of each piece,
    /// which are exact for the products of a linear piece and a polynomial (the discretised
    /// Stieltjes procedure: Gautschi, Orthogonal Polynomials, 2004, section 2.2). x is from −1 to 1
    /// over the spectrum, where the recurrence is stable.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] where the eigenvalues do not converge.
    pub(super) fn quadrature(&self, count: usize) -> Result<Vec<(f64, f64)>> {
        let [shortest_nm, longest_nm] = self.range_nm();
        let (middle_nm, half_nm) = ((shortest_nm + longest_nm) / 2.0, (longest_nm - shortest_nm) / 2.0);
        // pₖ² times a linear function is of degree 2·count: count + 1 nodes. Twice as many, because
        // the recurrence over a discrete set loses its orthogonality where there are not many more
        // points than nodes.
        let legendre = gauss_legendre(2 * count + MORE_NODES);
        let pieces = (1..self.rows.len()).flat_map(|piece| self.points_of(piece, &legendre));
        let (x, photons): (Vec<f64>, Vec<f64>) =
            pieces.map(|(nm, photons)| ((nm - middle_nm) / half_nm, photons)).unzip();
        let total: f64 = photons.iter().sum();
        let mean = |value: &dyn Fn(usize) -> f64| -> f64 {
            photons.iter().enumerate().map(|(i, photons)| photons * value(i)).sum::<f64>() / total
        };
        let mut jacobi = Array2::zeros((count, count));
        let (mut previous, mut current) = (vec![0.0; x.len()], vec![1.0; x.len()]);
        let mut below = 0.0;
        for k in 0..count {
            let centre = mean(&|i| x[i] * current[i] * current[i]);
            jacobi[[k, k]] = centre;
            if k > 0 {
                jacobi[[k, k - 1]] = below;
                jacobi[[k - 1, k]] = below;
            }
            let next: Vec<f64> = (0..x.len()).map(|i| (x[i] - centre) * current[i] - below * previous[i]).collect();
            below = mean(&|i| next[i] * next[i]).sqrt();
            previous = std::mem::replace(&mut current, next.into_iter().map(|value| value / below).collect());
        }
        let (places, vectors) = symmetric_eigen(&jacobi)?;
        let first = vectors.row(0);
        let kept: Vec<(f64, f64)> = places
            .iter()
            .zip(first)
            .map(|(x, first)| (*x, first * first))
            .filter(|node| node.1 > LEAST_SHARE)
            .collect();
        let sum: f64 = kept.iter().map(|(_, share)| share).sum();
        Ok(kept.into_iter().map(|(x, share)| (middle_nm + half_nm * x, share / sum)).collect())
    }

    /// Wavelengths, nm, within the piece that ends at this row, at these Gauss-Legendre nodes, and
    /// the photons that each stands for; none of a dark piece.
    fn points_of(&self, piece: usize, legendre: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let ((from_nm, from), (to_nm, to)) = (self.rows[piece - 1], self.rows[piece]);
        if from == 0.0 && to == 0.0 {
            return Vec::new();
        }
        let reference_nm = self.reference_nm();
        // Of both factors of Planck's law, λ⁻⁴ and the exponent.
        let change = self.star_temperature_k.map_or(0.0, |temperature_k| {
            4.0 * (to_nm / from_nm).ln() + RADIATION_CONSTANT_NM_K / temperature_k * (1.0 / from_nm - 1.0 / to_nm)
        });
        let parts = (change / LARGEST_CHANGE).ceil().max(1.0);
        let point = |(part, (place, share)): (usize, (f64, f64))| {
            let way = (part as f64 + 0.5 * (1.0 + place)) / parts;
            let (nm, transmission) = (from_nm + way * (to_nm - from_nm), from + way * (to - from));
            (nm, share / parts * (to_nm - from_nm) * transmission * self.star(nm, reference_nm))
        };
        let each = |part| legendre.iter().map(move |node| (part, *node));
        (0..parts as usize).flat_map(each).map(point).collect()
    }

    /// Wavelength at which the photons of the star are 1, nm: the longest with transmission, where
    /// exponents are smallest.
    fn reference_nm(&self) -> f64 {
        self.rows.iter().rev().find(|(_, transmission)| *transmission > 0.0).map_or(1.0, |(nm, _)| *nm)
    }

    /// Photons of the star for each wavelength at `nm`, relative to those at `reference_nm`:
    /// Planck's law of the radiance, λ⁻⁵/(e^(hc/λkT) − 1), over the energy of a photon, hc/λ. With
    /// exponents of −x so that none overflows.
    fn star(&self, nm: f64, reference_nm: f64) -> f64 {
        let Some(temperature_k) = self.star_temperature_k else { return 1.0 };
        let exponent = |nm: f64| RADIATION_CONSTANT_NM_K / (nm * temperature_k);
        let (own, reference) = (exponent(nm), exponent(reference_nm));
        (reference_nm / nm).powi(4) * (reference - own).exp() * (-reference).exp_m1() / (-own).exp_m1()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telescope::band;

    /// Mean of a power of (λ − 2000 nm)/200 nm.
    fn moment(nodes: &[(f64, f64)], degree: i32) -> f64 {
        nodes.iter().map(|(nm, share)| share * ((nm - 2000.0) / 200.0).powi(degree)).sum()
    }

    /// Asymmetric, with a kink, a gap and ends that are not faint.
    fn curve() -> Vec<(f64, f64)> {
        vec![(1850.0, 0.1), (1900.0, 0.9), (2010.0, 0.6), (2020.0, 0.0), (2030.0, 0.0), (2150.0, 0.7), (2180.0, 0.05)]
    }

    /// Mean of the same over the curve, piece by piece, in closed form: with x along the piece,
    /// transmission c + s·x.
    fn exact(rows: &[(f64, f64)], degree: i32) -> f64 {
        let sum = |degree: i32| -> f64 {
            let piece = |pair: &[(f64, f64)]| {
                let [x, y] = [0, 1].map(|i| (pair[i].0 - 2000.0) / 200.0);
                let slope = (pair[1].1 - pair[0].1) / (y - x);
                let power = |n: i32| (y.powi(n) - x.powi(n)) / f64::from(n);
                (pair[0].1 - slope * x) * power(degree + 1) + slope * power(degree + 2)
            };
            rows.windows(2).map(piece).sum()
        };
        sum(degree) / sum(0)
    }

    #[test]
    fn nodes_integrate_polynomials_of_twice_their_number() {
        let spectrum = Spectrum::new(curve(), None);
        assert_eq!(spectrum.range_nm(), [1850.0, 2180.0]);
        for count in 1..=30 {
            let nodes = spectrum.quadrature(count).unwrap();
            assert_eq!(nodes.len(), count);
            assert!(nodes.iter().all(|(nm, share)| *share > 0.0 && (1850.0..2180.0).contains(nm)));
            for degree in 0..2 * count as i32 {
                let (found, exact) = (moment(&nodes, degree), exact(&curve(), degree));
                // Rounding of a symmetric eigenvalue problem and of sums of some hundred terms; |x|
                // ≤ 1.
                assert!((found - exact).abs() < 1e-13, "{count} {degree}: {found} {exact}");
            }
        }
    }

    #[test]
    fn a_curve_with_sharp_ends_has_the_nodes_of_a_top_hat() {
        for rows in [vec![(1800.0, 0.5), (2200.0, 0.5)], vec![(1800.0, 70.0), (1811.0, 70.0), (2200.0, 70.0)]] {
            let spectrum = Spectrum::new(rows, None);
            for count in [1, 2, 3, 7, 20, 60, 120] {
                let (found, known) = (spectrum.quadrature(count).unwrap(), band(0.2, count));
                for ((nm, share), (ratio, known)) in found.into_iter().zip(known) {
                    // As above; the share of an eigenvector grows in its error with the number of
                    // nodes.
                    assert!(
                        (nm / 2000.0 - ratio).abs() < 1e-13 && (share - known).abs() < 1e-13,
                        "{count} {nm} {share} {known}"
                    );
                }
            }
        }
    }

    #[test]
    fn the_star_shifts_the_mean_as_a_fine_sum_says() {
        let planck = |nm: f64, kelvin: f64| nm.powi(-4) / (RADIATION_CONSTANT_NM_K / (nm * kelvin)).exp_m1();
        for kelvin in [3000.0, 10_000.0, 300.0] {
            let spectrum = Spectrum::new(vec![(1800.0, 1.0), (2200.0, 1.0)], Some(kelvin));
            let (mut sum, mut square, mut total) = (0.0, 0.0, 0.0);
            const STEPS: usize = 100_000;
            for step in 0..STEPS {
                let nm = 1800.0 + 400.0 * (step as f64 + 0.5) / STEPS as f64;
                let photons = planck(nm, kelvin);
                (sum, square, total) = (sum + photons * nm, square + photons * nm * nm, total + photons);
            }
            let nodes = spectrum.quadrature(4).unwrap();
            let mean_nm: f64 = nodes.iter().map(|(nm, share)| nm * share).sum();
            let second: f64 = nodes.iter().map(|(nm, share)| nm * nm * share).sum();
            println!("{kelvin} K: the mean is {:.4} nm from the middle", mean_nm - 2000.0);
            // The sum of 1e5 steps is exact to 1e-10 of the range's square.
            assert!((mean_nm - sum / total).abs() < 1e-5, "{kelvin} {mean_nm} {}", sum / total);
            assert!((second / (square / total) - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn faint_ends_are_left_out_and_leaks_are_not() {
        let filter = [(1900.0, 0.0), (1910.0, 1.0), (2090.0, 1.0), (2100.0, 0.0)];
        let with = |wing: f64, from_nm: f64| {
            let mut rows = vec![(from_nm, wing), (1899.0, wing)];
            rows.extend(filter);
            Spectrum::new(rows, None).range_nm()
        };
        // 2.5e-5 of the photons; none; 5e-4; 2.5e-5 that pass more than a thousandth.
        assert_eq!(with(5e-5, 1800.0), [1900.0, 2100.0]);
        assert_eq!(with(0.0, 300.0), [1900.0, 2100.0]);
        assert_eq!(with(5e-4, 1700.0), [1700.0, 2100.0]);
        assert_eq!(with(5e-3, 1898.0), [1898.0, 2100.0]);
        // Cold stars have no light at short wavelengths, and no number overflows.
        let [shortest, _] =
            Spectrum::new((1..300).map(|i| (10.0 * f64::from(i), 1.0)).collect(), Some(100.0)).range_nm();
        assert!(shortest > 2000.0, "{shortest}");
    }
}
