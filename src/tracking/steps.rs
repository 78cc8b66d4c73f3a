//! Attribution of a difference to steps of single modes.

use super::filter::Innovation;
use ndarray::Array2;

/// Most modes that one difference is attributed to: with more, the mirror moved as a whole.
const MOST_STEPS: usize = 6;

/// Step of one mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ModeStep {
    /// Which of the segment modes.
    pub(super) mode: usize,
    pub(super) size_nm: f64,
    pub(super) error_nm: f64,
    /// Twice the log-likelihood ratio.
    pub(super) statistic: f64,
}

/// What a difference is made of.
pub(super) struct Attribution {
    pub(super) steps: Vec<ModeStep>,
    /// χ² of what the steps leave.
    pub(super) rest_chi2: f64,
}

/// The most likely step of one mode in a difference that is as likely as `innovation`;
/// `white_steps`: the steps of 1 nm, white.
pub(super) fn most_likely_step(innovation: &Innovation, white_steps: &Array2<f64>) -> Option<ModeStep> {
    steps_in(&innovation.white.to_vec(), white_steps).max_by(|a, b| a.statistic.total_cmp(&b.statistic))
}

/// Steps of at least `threshold` that explain the difference `innovation`, one after the other, the
/// most likely one first (orthogonal matching pursuit would fit them together; single segments of a
/// mirror are near enough to orthogonal).
pub(super) fn attribute(innovation: &Innovation, white_steps: &Array2<f64>, threshold: f64) -> Attribution {
    let mut rest = innovation.white.to_vec();
    let mut steps: Vec<ModeStep> = Vec::new();
    while steps.len() < MOST_STEPS {
        let new = steps_in(&rest, white_steps).filter(|step| steps.iter().all(|known| known.mode != step.mode));
        let Some(step) = new.max_by(|a, b| a.statistic.total_cmp(&b.statistic)) else { break };
        if step.statistic < threshold {
            break;
        }
        rest.iter_mut().zip(white_steps.column(step.mode)).for_each(|(rest, part)| *rest -= step.size_nm * part);
        steps.push(step);
    }
    Attribution { steps, rest_chi2: rest.iter().map(|part| part * part).sum() }
}

fn steps_in<'a>(white: &'a [f64], white_steps: &'a Array2<f64>) -> impl Iterator<Item = ModeStep> + 'a {
    white_steps.columns().into_iter().enumerate().filter_map(move |(mode, step)| {
        let information: f64 = step.iter().map(|part| part * part).sum();
        let score: f64 = step.iter().zip(white).map(|(step, white)| step * white).sum();
        // A mode that is not observed has no step.
        (information > 0.0).then(|| ModeStep {
            mode,
            size_nm: score / information,
            error_nm: 1.0 / information.sqrt(),
            statistic: score * score / information,
        })
    })
}
