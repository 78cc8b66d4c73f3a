//! What the controller is given.

use crate::{Error, Result};
use ndarray::Array2;

/// What is to be controlled, as the controller sees it.
///
/// Slopes are `[x of every subaperture, then y of every subaperture]`. Commands are nm of wavefront, one for each
/// actuator, and what the mirror makes of them is taken **away** from the wavefront: the sensor measures the slopes of
/// (turbulence − mirror).
#[derive(Debug, Clone, Copy)]
pub struct Plant<'a> {
    /// Interaction matrix D, `[2·subapertures, actuators]`: the slopes of a wavefront shaped like each actuator's
    /// influence, per nm.
    pub interaction: &'a Array2<f64>,
    /// Lenslets along a side of the map of lenslets.
    pub lenslets_across: usize,
    /// Flat index `row·lenslets_across + column` of each subaperture in use, ascending.
    pub subapertures: &'a [usize],
    /// Which of them the reconstructor should not trust, `true` = masked; what follows is the scene's `control.fill`.
    pub mask: &'a [bool],
    /// Commands of the mirror's Karhunen-Loève modes, `[actuators, modes]`, strongest first; for `basis = "kl"`.
    pub kl: Option<&'a Array2<f64>>,
    /// Largest command of an actuator either way, nm.
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
                "an interaction matrix of {slopes} × {actuators} was given for {subapertures} subapertures: two rows \
                 for each and a column for each actuator are needed, at least one"
            ));
        }
        if let Some(((row, column), value)) = self.interaction.indexed_iter().find(|(_, value)| !value.is_finite()) {
            let text =
                format!("the interaction matrix holds {value} at row {row}, column {column}: numbers are needed");
            return Err(Error::Value(text));
        }
        if let Some(kl) = self.kl {
            if kl.nrows() != actuators {
                let rows = kl.nrows();
                return shape(format!("the Karhunen-Loève modes have {rows} commands: the mirror needs {actuators}"));
            }
            if let Some(value) = kl.iter().find(|value| !value.is_finite()) {
                return Err(Error::Value(format!("the Karhunen-Loève modes hold {value}: numbers are needed")));
            }
        }
        match self.stroke_limit_nm {
            Some(limit) if limit.is_nan() || limit <= 0.0 => {
                Err(Error::Value(format!("a stroke limit of {limit} nm is impossible: it must be positive")))
            }
            _ => Ok(()),
        }
    }
}

/// That the indices are cells of the map of lenslets, ascending.
pub(super) fn check_subapertures(lenslets_across: usize, subapertures: &[usize]) -> Result<()> {
    let lenslets = lenslets_across.saturating_mul(lenslets_across);
    if let Some(index) = subapertures.iter().find(|&&index| index >= lenslets) {
        let text = format!("subaperture {index} is none of the {lenslets} lenslets: 0 to one below that are accepted");
        return Err(Error::Value(text));
    }
    match subapertures.windows(2).find(|pair| pair[0] >= pair[1]) {
        Some(pair) => Err(Error::Value(format!(
            "subaperture {} follows {}: ascending indices, each once, are needed",
            pair[1], pair[0]
        ))),
        None => Ok(()),
    }
}

/// That there is a flag for each subaperture.
pub(super) fn check_mask(subapertures: &[usize], mask: &[bool]) -> Result<()> {
    if mask.len() == subapertures.len() {
        return Ok(());
    }
    let (flags, count) = (mask.len(), subapertures.len());
    Err(Error::Shape(format!("a mask of {flags} flags was given for {count} subapertures: one for each is needed")))
}
