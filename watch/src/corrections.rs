//! Corrections of a watch: when one is written, and what is kept of it.
//!
//! After a frame the scene's policy weighs the tracked state. What is worth correcting is written;
//! while that may still be applied, another one is written only where the state has moved, since
//! then, by what the policy would correct.

use crate::clock;
use crate::model::{Model, rms_nm};
use crate::store::{Correction, Event, Frame, Store};
use crate::tracking::Step;
use cophase::modes::Group;
use cophase::{Error, Result};
use ndarray::{Array1, Array2};
use std::path::Path;

/// Writes a correction to `path` where the state after `step` asks for one, and makes the tracker
/// expect it.
///
/// The file is written before the frame is in the store. A watch that ends between both takes the
/// frame again, which leads to the same correction with the same number.
///
/// # Errors
/// [`Error::File`] where the file cannot be written; those of the corrections.
pub fn write(path: &Path, model: &Model, store: &Store, frame: &Frame, step: &mut Step) -> Result<Option<Correction>> {
    let Some((state_nm, covariance_nm2)) = step.tracked().filter(|_| step.outlier.is_none()) else { return Ok(None) };
    let is_worth = |state_nm: &Array1<f64>, covariance_nm2: &Array2<f64>| -> Result<bool> {
        let correction = model.estimator.correction(state_nm.view(), covariance_nm2.view())?;
        Ok(correction.coefficients_nm.iter().any(|nm| *nm != 0.0))
    };
    if !is_worth(&state_nm, &covariance_nm2)? {
        return Ok(None);
    }
    if let Some(number) = step.expected() {
        let Some([former_nm, sigma_nm]) = store.correction_state(number)? else {
            return Err(Error::Internal(format!("the store has no correction {number}, which the tracker expects")));
        };
        let moved_nm = &state_nm - &Array1::from(former_nm);
        let mut sum_nm2 = covariance_nm2.clone();
        sum_nm2.diag_mut().iter_mut().zip(&sigma_nm).for_each(|(nm2, nm)| *nm2 += nm * nm);
        if !is_worth(&moved_nm, &sum_nm2)? {
            return Ok(None);
        }
    }
    let mut corrections = model.estimator.corrections(state_nm.view(), covariance_nm2.view())?;
    let change_nm = model.estimator.change_by(&corrections)?;
    let number = store.next_correction()?;
    let image = if frame.image > 0 { format!(" image {}", frame.image) } else { String::new() };
    let source = format!(
        "correction {number} of this watch, from the tracked state after {}{image}, observed at {}",
        frame.name,
        clock::to_iso(frame.observed_s)
    );
    corrections.warnings.insert(0, source);
    corrections.write(path)?;
    step.expect(number, &change_nm)?;
    let sentence = format!("correction {number} was written to {}: {}", path.display(), corrections.summary());
    // Of the frame, as all events of a frame are.
    step.events.push(Event { time_s: frame.observed_s, ..Event::now("correction", sentence) });
    let fitted = model.estimator.fitter().model();
    Ok(Some(Correction {
        number,
        written_s: clock::now_s(),
        phasing_rms_nm: rms_nm(fitted, &change_nm, Group::Segment)?,
        ncpa_rms_nm: rms_nm(fitted, &change_nm, Group::Ncpa)?,
        change_nm,
        state_sigma_nm: covariance_nm2.diag().iter().map(|nm2| nm2.max(0.0).sqrt()).collect(),
        state_nm: state_nm.to_vec(),
        segment_modes: corrections.segments_held.iter().filter(|held| held.is_none()).count(),
        ncpa_modes: corrections.corrected_modes,
    }))
}
