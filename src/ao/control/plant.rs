//! Plant: interaction matrix, subapertures and actuators that a control law is built for.

use crate::{Error, Result};
use ndarray::Array2;

/// Model of sensor and mirror for the control.
///
/// Slopes are `[x of every subaperture, then y of every subaperture]`. Commands are nm of
/// wavefront, one for each actuator. The mirror's surface is **subtracted** from the wavefront: the
/// sensor measures the slopes of (turbulence − mirror).
#[derive(Debug, Clone, Copy)]
pub struct Plant<'a> {
    /// Interaction matrix D, `[2·subapertures, actuators]`: slopes of a wavefront with the shape of
    /// each actuator's influence function, per nm.
    pub interaction: &'a Array2<f64>,
    /// Lenslets along a side of the map of lenslets.
    pub lenslets_across: usize,
    /// Flat index `row·lenslets_across + column` of each subaperture in use, ascending.
    pub subapertures: &'a [usize],
    /// Masked subapertures, `true` = masked; `control.fill` of the scene determines how they are
    /// treated.
    pub mask: &'a [bool],
    /// Commands of the mirror's Karhunen-Loève modes, `[actuators, modes]`, strongest first; for
    /// `basis = "kl"`.
    pub kl: Option<&'a Array2<f64>>,
    /// Command matrix, `[actuators, 2·subapertures]`, nm per slope, in place of an inverse of D.
    pub command_matrix: Option<&'a Array2<f64>>,
    /// Actuators along a side of the mirror's square, and the flat index `row·across + column` of
    /// each actuator in use, ascending; for `reconstructor = "sparse"`.
    pub actuator_grid: Option<(usize, &'a [usize])>,
    /// Largest absolute command of an actuator, nm.
    pub stroke_limit_nm: Option<f64>,
}

impl Plant<'_> {
    /// Number of actuators.
    pub(super) fn actuators(&self) -> usize {
        self.interaction.ncols()
    }

    pub(super) fn check(&self) -> Result<()> {
        let shape = |text: String| Err(Error::Shape(text));
        check_subapertures(self.lenslets_across, self.subapertures)?;
        check_mask(self.subapertures, self.mask)?;
        let (slopes, actuators) = self.interaction.dim();
        let subapertures = self.subapertures.len();
        if slopes != 2 * subapertures || slopes == 0 || actuators == 0 {
            return shape(format!(
                "an interaction matrix of {slopes} × {actuators} was given for {subapertures} subapertures; two rows \
                 for each subaperture and a column for each actuator are needed, at least one of each"
            ));
        }
        if let Some(((row, column), value)) = self.interaction.indexed_iter().find(|(_, value)| !value.is_finite()) {
            let text =
                format!("the interaction matrix is {value} at row {row}, column {column}; finite values are needed");
            return Err(Error::Value(text));
        }
        if let Some(kl) = self.kl {
            if kl.nrows() != actuators {
                let rows = kl.nrows();
                return shape(format!("the Karhunen-Loève modes have {rows} commands; the mirror needs {actuators}"));
            }
            if let Some(value) = kl.iter().find(|value| !value.is_finite()) {
                return Err(Error::Value(format!(
                    "the Karhunen-Loève modes contain {value}; finite values are needed"
                )));
            }
        }
        self.check_actuator_grid()?;
        match self.stroke_limit_nm {
            Some(limit) if limit.is_nan() || limit <= 0.0 => {
                Err(Error::Value(format!("a stroke limit of {limit} nm is impossible; a positive number is needed")))
            }
            _ => Ok(()),
        }
    }

    fn check_actuator_grid(&self) -> Result<()> {
        let Some((across, places)) = self.actuator_grid else { return Ok(()) };
        let is_ascending = places.is_sorted_by(|a, b| a < b);
        if places.len() == self.actuators() && is_ascending && places.last().is_some_and(|&last| last < across * across)
        {
            return Ok(());
        }
        let (given, needed) = (places.len(), self.actuators());
        Err(Error::Shape(format!(
            "{given} places of actuators on a square of {across} a side were given; one for each of {needed}, ascending, is needed"
        )))
    }
}

/// Checks that the indices are cells of the map of lenslets, ascending.
pub(super) fn check_subapertures(lenslets_across: usize, subapertures: &[usize]) -> Result<()> {
    let lenslets = lenslets_across.saturating_mul(lenslets_across);
    if let Some(index) = subapertures.iter().find(|&&index| index >= lenslets) {
        let text = format!(
            "subaperture {index} is not one of the {lenslets} lenslets; 0 to that number less one are accepted"
        );
        return Err(Error::Value(text));
    }
    match subapertures.windows(2).find(|pair| pair[0] >= pair[1]) {
        Some(pair) => Err(Error::Value(format!(
            "subaperture {} follows {}; ascending indices without repetition are needed",
            pair[1], pair[0]
        ))),
        None => Ok(()),
    }
}

/// Checks that there is a flag for each subaperture.
pub(super) fn check_mask(subapertures: &[usize], mask: &[bool]) -> Result<()> {
    if mask.len() == subapertures.len() {
        return Ok(());
    }
    let (flags, count) = (mask.len(), subapertures.len());
    Err(Error::Shape(format!("a mask of {flags} flags was given for {count} subapertures; one for each is needed")))
}
