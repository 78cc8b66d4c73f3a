//! Degeneracy report: the combinations of modes that the data do not determine, or determine
//! weakly.

use super::linalg::symmetric_eigen;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, s};
use std::fmt;

/// Singular values below this count as null. Eigenvalues of a matrix of unit diagonal carry an
/// error of about (modes)·ε ≈ 1e-13 at 1,000 modes, whose root is 3e-7.
pub const NULL_BELOW: f64 = 1e-6;

/// Default limit of weak directions: with a singular value below this, the error of a direction is
/// more than five times that of a single mode.
pub const WEAK_BELOW: f64 = 0.2;

/// Components of each direction in its description.
const SHOWN: usize = 4;

/// Null and weakly determined directions of a Gram or Fisher matrix. The modes are first scaled to
/// a unit diagonal, so that the result does not depend on units and areas.
#[derive(Debug, Clone)]
pub struct Degeneracy {
    /// Singular values, in decreasing order: √2 for two identical modes, 1 for a mode orthogonal to
    /// all others, 0 for a null direction.
    pub singular_values: Vec<f64>,
    /// Directions that the data do not determine.
    pub null: Vec<Direction>,
    /// Weakly determined directions, smallest singular value first.
    pub weak: Vec<Direction>,
    /// The limit below which a direction counts as weak.
    pub weak_below: f64,
}

/// A combination of modes.
#[derive(Debug, Clone)]
pub struct Direction {
    /// RMS of the signal of the direction, relative to that of its modes.
    pub singular_value: f64,
    /// Coefficients of the modes, of unit norm, in the order of the modes and in their units.
    pub coefficients: Vec<f64>,
    /// Description: the largest components, or the name if it has one.
    pub description: String,
}

impl Degeneracy {
    /// Analyses a symmetric positive semi-definite `[modes, modes]` matrix: products of modes over
    /// the pupil, or a Fisher matrix. Directions with singular values below `weak_below` are listed
    /// as weak.
    ///
    /// Modes whose names end in `-piston` are taken as segment pistons.
    ///
    /// # Errors
    /// [`Error::Shape`] where the matrix is not square or does not have one row per name;
    /// [`Error::Value`] where an entry is not finite, a diagonal entry is negative, or `weak_below`
    /// is not a number.
    pub fn from_matrix(matrix: &Array2<f64>, names: &[String], weak_below: f64) -> Result<Self> {
        let modes = names.len();
        if matrix.dim() != (modes, modes) {
            let text = format!(
                "a matrix of shape {:?} was given for {modes} modes: it needs a row and a column for each",
                matrix.dim()
            );
            return Err(Error::Shape(text));
        }
        if weak_below.is_nan() {
            return Err(Error::Value("the limit of weak directions is not a number: 0.2 is a good choice".into()));
        }
        let diagonal = matrix.diag();
        if let Some(mode) = (0..modes).find(|&mode| diagonal[mode] < 0.0) {
            let text = format!("the diagonal entry of mode {} is {}: 0 or more is needed", names[mode], diagonal[mode]);
            return Err(Error::Value(text));
        }
        // A mode without signal (a rounding error relative to the others) becomes a null direction.
        let faint = diagonal.iter().copied().fold(0.0, f64::max) * 1e-14;
        let scale = diagonal.mapv(|own| if own > faint { 1.0 / own.sqrt() } else { 0.0 });
        let scaled = Array2::from_shape_fn((modes, modes), |(i, j)| matrix[[i, j]] * scale[i] * scale[j]);
        let (eigenvalues, vectors) = symmetric_eigen(&scaled)?;

        // Coefficients of the modes themselves.
        let to_coefficients = scale.mapv(|scale| if scale > 0.0 { scale } else { 1.0 });
        let singular = eigenvalues.mapv(|value| value.max(0.0).sqrt());
        let nulls = singular.iter().take_while(|&&value| value < NULL_BELOW).count();
        let weak_end = singular.iter().take_while(|&&value| value < weak_below.max(NULL_BELOW)).count();
        let space = vectors.slice(s![.., ..nulls]).to_owned();
        let direction = |vector: ArrayView1<f64>, singular_value: f64| {
            let coefficients = &vector * &to_coefficients;
            let norm = coefficients.dot(&coefficients).sqrt();
            let description = describe(vector, &to_coefficients, names);
            Direction { singular_value, coefficients: (coefficients / norm).to_vec(), description }
        };
        Ok(Self {
            null: null_directions(&space, &to_coefficients, names)
                .iter()
                .map(|vector| direction(vector.view(), 0.0))
                .collect(),
            weak: (nulls..weak_end).map(|i| direction(vectors.column(i), singular[i])).collect(),
            singular_values: singular.iter().rev().copied().collect(),
            weak_below,
        })
    }
}

fn is_piston(name: &str) -> bool {
    name.ends_with("-piston")
}

/// A readable basis of the null space with the orthonormal columns `space`: global piston first if
/// it is in the space, then directions of few modes each, by elimination. The eigenvectors
/// themselves would mix all of them.
fn null_directions(space: &Array2<f64>, to_coefficients: &Array1<f64>, names: &[String]) -> Vec<Array1<f64>> {
    let mut rows: Vec<Array1<f64>> = space.columns().into_iter().map(|column| column.to_owned()).collect();
    let mut named = Vec::new();
    if let Some(global) = global_piston(to_coefficients, names) {
        let inside: f64 = rows.iter().map(|row| row.dot(&global).powi(2)).sum();
        // Null vectors are known to about NULL_BELOW² over the gap to the next eigenvalue: far
        // better than 1e-6.
        if inside > 1.0 - 1e-6 {
            for row in &mut rows {
                let share = row.dot(&global);
                row.scaled_add(-share, &global);
            }
            named.push(global);
        }
    }
    let mut sparse: Vec<Array1<f64>> = Vec::new();
    while named.len() + sparse.len() < space.ncols() {
        // The pivot is the largest entry of all: afterwards its mode occurs in this direction only.
        let size = |&(row, mode): &(usize, usize)| rows[row][mode].abs();
        let entries = (0..rows.len()).flat_map(|row| (0..names.len()).map(move |mode| (row, mode)));
        let Some((row, mode)) = entries.max_by(|a, b| size(a).total_cmp(&size(b))) else { break };
        let pivot = rows.swap_remove(row);
        let pivot = &pivot / pivot[mode];
        for other in rows.iter_mut().chain(&mut sparse) {
            let share = other[mode];
            other.scaled_add(-share, &pivot);
        }
        sparse.push(pivot);
    }
    let unit = |vector: Array1<f64>| &vector / vector.dot(&vector).sqrt();
    named.into_iter().chain(sparse).map(unit).collect()
}

/// All segment pistons with the same coefficient, as a unit vector of the scaled modes; none with
/// fewer than two.
fn global_piston(to_coefficients: &Array1<f64>, names: &[String]) -> Option<Array1<f64>> {
    let pistons = names.iter().filter(|name| is_piston(name)).count();
    let entry = |(mode, name): (usize, &String)| if is_piston(name) { 1.0 / to_coefficients[mode] } else { 0.0 };
    let global: Array1<f64> = names.iter().enumerate().map(entry).collect();
    let norm = global.dot(&global).sqrt();
    (pistons > 1 && norm > 0.0).then(|| global / norm)
}

/// Description of a direction: `vector` over the scaled modes.
fn describe(vector: ArrayView1<f64>, to_coefficients: &Array1<f64>, names: &[String]) -> String {
    if let Some(global) = global_piston(to_coefficients, names) {
        // Global piston within one percent.
        if vector.dot(&global).powi(2) > 0.9999 * vector.dot(&vector) {
            let pistons = names.iter().filter(|name| is_piston(name)).count();
            return format!("all {pistons} segment pistons together (global piston)");
        }
    }
    let mut order: Vec<usize> = (0..names.len()).collect();
    order.sort_by(|&a, &b| vector[b].abs().total_cmp(&vector[a].abs()));
    let largest = order.first().map_or(0.0, |&mode| vector[mode]);
    // Components below a thousandth of the largest are omitted.
    let counted = order.iter().filter(|&&mode| vector[mode].abs() > 1e-3 * largest.abs()).count();
    let mut text = String::new();
    for (place, &mode) in order.iter().take(counted.min(SHOWN)).enumerate() {
        // The sign of a direction is arbitrary: the first component is positive.
        let value = vector[mode] * largest.signum();
        let sign = match (place, value < 0.0) {
            (0, _) => "",
            (_, false) => " + ",
            (_, true) => " − ",
        };
        text += &format!("{sign}{:.2} {}", value.abs(), names[mode]);
    }
    if counted > SHOWN {
        text += &format!(" and {} smaller", counted - SHOWN);
    }
    text
}

impl fmt::Display for Degeneracy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let modes = self.singular_values.len();
        let determined: Vec<f64> = self.singular_values.iter().copied().filter(|&value| value >= NULL_BELOW).collect();
        match (determined.first(), determined.last()) {
            (Some(largest), Some(smallest)) => {
                write!(
                    f,
                    "{} of {modes} directions are determined, with singular values {largest:.2} to {smallest:.2}.",
                    determined.len()
                )?;
            }
            _ => write!(f, "None of {modes} directions is determined.")?,
        }
        for direction in &self.null {
            write!(f, "\nNot determined: {}.", direction.description)?;
        }
        for direction in &self.weak {
            write!(
                f,
                "\nWeakly determined (singular value {:.2}): {}.",
                direction.singular_value, direction.description
            )?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|&name| name.to_owned()).collect()
    }

    #[test]
    fn global_piston_is_named_next_to_other_null_directions() {
        // Three segments of unequal area, means removed: G = diag(a) − a·aᵀ. Two further modes that
        // are identical up to a factor, and one without signal.
        let areas = [0.2, 0.3, 0.5];
        let mut gram = Array2::zeros((6, 6));
        for i in 0..3 {
            for j in 0..3 {
                gram[[i, j]] = if i == j { areas[i] } else { 0.0 } - areas[i] * areas[j];
            }
        }
        gram[[3, 3]] = 1.0;
        gram[[3, 4]] = 2.0;
        gram[[4, 3]] = 2.0;
        gram[[4, 4]] = 4.0;
        let names = names(&["s-0-piston", "s-1-piston", "s-2-piston", "kl-00", "kl-01", "kl-02"]);
        let report = Degeneracy::from_matrix(&gram, &names, WEAK_BELOW).unwrap();
        let descriptions: Vec<&str> = report.null.iter().map(|direction| direction.description.as_str()).collect();
        assert_eq!(descriptions.len(), 3, "{report}");
        assert!(descriptions[0].contains("3 segment pistons") && descriptions[0].contains("global piston"), "{report}");
        assert!(descriptions.contains(&"1.00 kl-02"), "{report}");
        assert!(
            descriptions.contains(&"0.71 kl-00 − 0.71 kl-01") || descriptions.contains(&"0.71 kl-01 − 0.71 kl-00"),
            "{report}"
        );
        // The signal of each direction is zero.
        for direction in &report.null {
            let c = Array1::from(direction.coefficients.clone());
            assert!((c.dot(&c) - 1.0).abs() < 1e-12);
            assert!(gram.dot(&c).iter().all(|signal| signal.abs() < 1e-12), "{}", direction.description);
        }
        // Twice the same mode: √2, within the rounding of a 6×6 eigenproblem.
        assert!((report.singular_values[0] - 2f64.sqrt()).abs() < 1e-12);
        let text = report.to_string();
        assert!(text.starts_with("3 of 6 directions") && text.contains("singular values 1.41 to "), "{text}");
    }

    #[test]
    fn a_weak_direction_is_named_with_its_singular_value() {
        // Two modes with correlation 0.995: singular values √1.995 and √0.005 = 0.0707.
        let gram = array![[1.0, 0.995 * 3.0, 0.0], [0.995 * 3.0, 9.0, 0.0], [0.0, 0.0, 2.0]];
        let report = Degeneracy::from_matrix(&gram, &names(&["noll-2", "kl-00", "kl-01"]), WEAK_BELOW).unwrap();
        assert!(report.null.is_empty());
        assert_eq!(report.weak.len(), 1);
        assert!((report.weak[0].singular_value - 0.005f64.sqrt()).abs() < 1e-12);
        let text = report.to_string();
        assert!(["Weakly", "singular value 0.07", ": 0.71 "].iter().all(|fact| text.contains(fact)), "{text}");
        // In the modes' own units the second coefficient is a third of the first.
        let c = &report.weak[0].coefficients;
        assert!((c[1] / c[0] + 1.0 / 3.0).abs() < 1e-12, "{c:?}");
    }

    #[test]
    fn bad_matrices_are_refused() {
        let two = names(&["a", "b"]);
        assert!(Degeneracy::from_matrix(&Array2::eye(3), &two, 0.2).is_err());
        assert!(Degeneracy::from_matrix(&array![[1.0, f64::NAN], [f64::NAN, 1.0]], &two, 0.2).is_err());
        assert!(Degeneracy::from_matrix(&array![[1.0, 0.0], [0.0, -1.0]], &two, 0.2).is_err());
        assert!(Degeneracy::from_matrix(&Array2::eye(2), &two, f64::NAN).is_err());
        // A report of no modes is empty, not an error.
        assert!(Degeneracy::from_matrix(&Array2::zeros((0, 0)), &[], 0.2).unwrap().null.is_empty());
    }
}
