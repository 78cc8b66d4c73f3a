use super::*;

/// Deterministic values in [−1, 1] without any symmetry.
fn noise(count: usize, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    (0..count)
        .map(|_| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        })
        .collect()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Images larger and smaller than the pupil, with integer and fractional sampling.
const CASES: [(usize, usize, f64); 4] = [(6, 10, 2.0), (12, 8, 1.37), (10, 20, 2.0), (8, 4, 3.25)];

#[test]
fn the_matrix_transform_is_the_definition() {
    for (n, m, q) in CASES {
        let sampling = Sampling::new(n, m, q).unwrap();
        let transform = Transform::<f64>::matrix(sampling);
        let mut workspace = transform.workspace();
        let pupil = noise(2 * n * n, 1);
        let mut focus = vec![f64::NAN; 2 * m * m];
        transform.forward(&pupil, &mut focus, &mut workspace);
        let truth = definition::forward(sampling, &pupil);
        // Sums of n² terms of size 1: rounding grows no faster than n² half-ulps; 1e-14·n² leaves a
        // margin of 100.
        let bound = 1e-14 * (n * n) as f64;
        assert!(focus.iter().zip(&truth).all(|(a, b)| (a - b).abs() < bound), "forward, n {n} m {m} q {q}");

        let focus = noise(2 * m * m, 2);
        let mut back = vec![f64::NAN; 2 * n * n];
        transform.adjoint(&focus, &mut back, &mut workspace);
        let truth = definition::adjoint(sampling, &focus);
        let bound = 1e-14 * (m * m) as f64;
        assert!(back.iter().zip(&truth).all(|(a, b)| (a - b).abs() < bound), "adjoint, n {n} m {m} q {q}");
    }
}

#[test]
fn the_fft_has_the_intensity_of_the_definition() {
    for (n, m, q) in CASES {
        let sampling = Sampling::new(n, m, q).unwrap();
        let Some(transform) = Transform::<f64>::fft(sampling) else {
            assert!(q.fract() != 0.0 || n as f64 * q < m as f64, "a whole grid must have an FFT");
            continue;
        };
        let pupil = noise(2 * n * n, 3);
        let mut focus = vec![f64::NAN; 2 * m * m];
        transform.forward(&pupil, &mut focus, &mut transform.workspace());
        let truth = definition::forward(sampling, &pupil);
        let intensity =
            |field: &[f64], v: usize, u: usize| field[2 * m * v + u].powi(2) + field[2 * m * v + m + u].powi(2);
        for v in 0..m {
            for u in 0..m {
                // Squares of sums of n² terms of size 1.
                let bound = 1e-14 * (n * n * n * n) as f64;
                assert!((intensity(&focus, v, u) - intensity(&truth, v, u)).abs() < bound);
            }
        }
    }
}

#[test]
fn adjoints_pass_the_dot_test() {
    for (n, m, q) in CASES {
        let sampling = Sampling::new(n, m, q).unwrap();
        for transform in [Some(Transform::<f64>::matrix(sampling)), Transform::fft(sampling)].into_iter().flatten() {
            let (pupil, image) = (noise(2 * n * n, 4), noise(2 * m * m, 5));
            let (mut focus, mut back) = (vec![0.0; 2 * m * m], vec![0.0; 2 * n * n]);
            // Scratch memory filled with NaN shows whether it is read before it is written.
            let mut workspace = transform.workspace();
            workspace.real.fill(f64::NAN);
            transform.forward(&pupil, &mut focus, &mut workspace);
            workspace.complex.fill(num_complex::Complex::new(f64::NAN, f64::NAN));
            transform.adjoint(&image, &mut back, &mut workspace);
            let (left, right) = (dot(&focus, &image), dot(&pupil, &back));
            // Both sides are sums of 2m² products of numbers of size n: 1e-15·(norms) with a margin
            // of 10.
            let bound = 1e-14 * dot(&focus, &focus).sqrt() * dot(&image, &image).sqrt();
            assert!((left - right).abs() < bound, "{left} against {right}, bound {bound}");
        }
    }
}

#[test]
fn single_precision_agrees_to_its_rounding() {
    let sampling = Sampling::new(12, 8, 1.37).unwrap();
    let (wide, narrow) = (Transform::<f64>::matrix(sampling), Transform::<f32>::matrix(sampling));
    let pupil = noise(2 * 144, 6);
    let narrow_pupil: Vec<f32> = pupil.iter().map(|&v| v as f32).collect();
    let (mut a, mut b) = (vec![0.0; 128], vec![0.0f32; 128]);
    wide.forward(&pupil, &mut a, &mut wide.workspace());
    narrow.forward(&narrow_pupil, &mut b, &mut narrow.workspace());
    let largest = a.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    // 144 terms in f32: a random walk of 12 half-ulps is 7e-7 of the largest value; three times
    // that.
    assert!(a.iter().zip(&b).all(|(a, b)| (a - f64::from(*b)).abs() < 2e-6 * largest));
}

#[test]
fn odd_sizes_are_refused() {
    assert!(Sampling::new(7, 8, 2.0).is_err());
    assert!(Sampling::new(8, 9, 2.0).is_err());
    assert!(Sampling::new(8, 8, 0.0).is_err());
}

#[test]
fn fast_sides_have_the_prime_factors_2_3_and_5() {
    assert_eq!([fast_side(0), fast_side(7), fast_side(121), fast_side(128)], [2, 8, 128, 128]);
    assert_eq!(fast_side(151), 160);
}
