//! The decompositions, products and transforms against numbers that are known.

use cophase_numerics::cholesky::Cholesky;
use cophase_numerics::decompositions::{eigenvalues, roots, svd, symmetric_eigen, unit_scale};
use cophase_numerics::fft::{FftDirection, FftReal, plan_both};
use cophase_numerics::product::{Matrix, MatrixMut};
use cophase_numerics::systems::{least_squares, solve};
use ndarray::{Array1, Array2, array};
use num_complex::Complex64;

#[test]
fn the_factor_whitens_its_own_covariance() {
    let matrix = array![[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
    let factor = Cholesky::new(matrix.view()).unwrap();
    let white = factor.solve_lower(factor.solve_lower(matrix.view()).t());
    // A dozen operations on numbers of order 1: some 1e-15.
    assert!((&white - &Array2::<f64>::eye(3)).iter().all(|off| off.abs() < 1e-14), "{white}");
    let right = array![[1.0, 0.0], [2.0, -1.0], [3.0, 0.5]];
    assert!((matrix.dot(&factor.solve(right.view())) - &right).iter().all(|off| off.abs() < 1e-14));
    assert!((matrix.dot(&factor.inverse()) - Array2::<f64>::eye(3)).iter().all(|off| off.abs() < 1e-14));
    // 4·(3·2 − 0.04) − (2 + 0.1) + 0.5·(−0.2 − 1.5), along the first row.
    assert!((factor.log_determinant() - 20.89_f64.ln()).abs() < 1e-14);
    let failure = Cholesky::new(array![[1.0, 2.0], [2.0, 1.0]].view()).err().unwrap();
    assert!(failure.to_string().contains("NonPositivePivot"), "{failure}");
}

#[test]
fn roots_of_known_polynomials() {
    // (λ − 2)(λ² + 1) = λ³ − 2λ² + λ − 2; simple, well separated roots: a few ε.
    let mut found = roots(&[-2.0, 1.0, -2.0].map(Complex64::from)).unwrap();
    found.sort_by(|a, b| a.im.total_cmp(&b.im));
    for (found, known) in found.iter().zip([-Complex64::i(), Complex64::from(2.0), Complex64::i()]) {
        assert!((found - known).norm() < 1e-14, "{found} against {known}");
    }
    assert_eq!(roots(&[Complex64::new(0.5, 1.0)]).unwrap(), [Complex64::new(-0.5, -1.0)]);
}

#[test]
fn decompositions_give_their_matrix_back() {
    let matrix = array![[3.0, 1.0, 0.0], [1.0, 2.0, -0.5], [0.0, -0.5, 1.0]];
    // A dozen operations on numbers of order 1: some 1e-15.
    let is_matrix = |found: Array2<f64>| (found - &matrix).iter().all(|off| off.abs() < 1e-14);
    let svd = svd(matrix.view()).unwrap();
    assert!(is_matrix((&svd.left * &Array1::from(svd.values)).dot(&svd.right.t())));
    let scale = unit_scale(matrix.view());
    assert_eq!(scale, 0.5);
    let eigen = symmetric_eigen(matrix.view(), scale).unwrap();
    let mut general: Vec<f64> = eigenvalues(matrix.view()).unwrap().iter().map(|value| value.re).collect();
    general.sort_by(f64::total_cmp);
    assert!(eigen.values.iter().zip(general).all(|(a, b)| (a - b).abs() < 1e-14));
    assert!(is_matrix((&eigen.vectors * &Array1::from(eigen.values)).dot(&eigen.vectors.t())));
}

#[test]
fn least_squares_fits_a_line_and_refuses_rank_deficiency() {
    let line = array![[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]];
    // Through (0, 0), (1, 1), (2, 1): intercept 1/6, slope 1/2, from the normal equations by hand.
    let fit = least_squares(line.view(), array![[0.0], [1.0], [1.0]].view()).unwrap();
    assert!((fit[[0, 0]] - 1.0 / 6.0).abs() < 1e-15 && (fit[[1, 0]] - 0.5).abs() < 1e-15, "{fit}");
    let zeros = Array2::zeros((3, 1));
    assert!(least_squares(array![[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]].view(), zeros.view()).is_none());
    assert!(least_squares(array![[1.0, 2.0]].view(), Array2::zeros((1, 1)).view()).is_none());
}

#[test]
fn a_square_system_is_solved() {
    let matrix = array![[0.0, 2.0, 1.0], [1.0, 1.0, 0.0], [2.0, 0.0, -3.0]];
    let wanted = array![[1.0], [-2.0], [0.5]];
    // A dozen operations on numbers of order 1: some 1e-15.
    let found = solve(matrix.view(), matrix.dot(&wanted).view());
    assert!((found - wanted).iter().all(|off| off.abs() < 1e-14));
}

#[test]
fn products_of_parts_are_those_by_hand() {
    let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
    let matrix = Matrix::from_rows(&values, 2, 3);
    let part = matrix.part(0..2, 1..3);
    let mut out = [0.0; 6];
    let (mut left, mut right) = MatrixMut::from_rows(&mut out, 2, 3).split_at_column(2);
    // [2 3; 5 6]·[2 5; 3 6] = [13 28; 28 61], [2 3; 5 6]·[1 4]ᵀ = [14 29]ᵀ.
    left.assign_product(1.0, part, part.transpose());
    left.add_product(-2.0, part, part.transpose());
    let column = [1.0, 4.0];
    right.add_product(1.0, part, Matrix::from_rows(&column, 2, 1));
    assert_eq!(out, [-13.0, -28.0, 14.0, -28.0, -61.0, 29.0]);
}

#[test]
fn the_inverse_transform_restores_the_numbers() {
    let (forward, inverse) = plan_both::<f64>(12);
    let numbers: Vec<Complex64> = (0..12).map(|i| Complex64::cis(f64::from(i * i))).collect();
    let mut line = numbers.clone();
    forward.process(&mut line);
    // Frequency 0 is the sum: rounding of a dozen numbers of order 1.
    assert!((line[0] - numbers.iter().sum::<Complex64>()).norm() < 1e-14);
    inverse.process(&mut line);
    assert!(line.iter().zip(&numbers).all(|(found, number)| (found / 12.0 - number).norm() < 1e-14));
}

#[test]
fn a_pair_has_its_lengths_in_order() {
    let plans = f32::plan_pair([24, 16], FftDirection::Inverse);
    assert_eq!(plans.map(|plan| (plan.len(), plan.fft_direction())), [24, 16].map(|n| (n, FftDirection::Inverse)));
}
