//! Orientation of the images and sign of the defocus: what the pupil's shape shows, and what a poke
//! does.

use super::finding::{CheckedQuantity, FOCUS, Finding, Verdict};
use super::turns::{self, Turn};
use super::{Work, chi2_of, first_used, is_raised, pixels_of, raised};
use crate::Result;
use crate::modal::ModelCache;
use crate::pipeline::images::Images;
use crate::pipeline::modal_task::Fitted;
use crate::pipeline::orientation::Poke;
use crate::scene::{Method, Scene};

/// Largest part of χ² beyond 1 that the right orientation leaves.
const LEFT_BY_TURN: f64 = 0.1;
/// Rise of χ² above which images contradict an orientation whose pupil differs by less than
/// `turns::DIFFERENT`: ten times Schwarz's ln N of 10⁴ pixels, for the model's own error.
const CONTRADICTED: f64 = 100.0;

impl Work<'_> {
    /// The findings, and `given` in the orientation with which the rest is checked; `fitted`
    /// becomes the fit of it. A poke comes with the images before it and behind it, and is
    /// estimated by the method of the scene `own`.
    pub(super) fn orientation(
        &self,
        (own, given): (&Scene, &Scene),
        cache: &ModelCache,
        fitted: &mut Fitted,
        poke: Option<(Option<&Images>, &Images, Poke)>,
    ) -> Result<(Scene, Vec<Finding>)> {
        let (shown, mut findings) = self.turned(given, fitted)?;
        let mut scene = match &shown {
            Some(turn) => given.with_settings(&turn.settings)?,
            None => given.clone(),
        };
        let Some((before, after, poke)) = poke else { return Ok((scene, findings)) };
        let is_ambiguous = shown.is_some_and(|turn| turn.is_also_sign);
        // A modal estimate behind adaptive optics shows no poke.
        let estimated = match own.estimate.method {
            Method::FullPhase => own.with_settings(&turns::differences(given, &scene))?,
            _ => scene.clone(),
        };
        let found = turns::of_poke(&estimated, (before, after), poke, is_ambiguous, self.control)?;
        let Some(settings) = &found.settings else {
            // The shape of the pupil does not decide either: the finding says why the poke does
            // not.
            findings.retain(|known| known.verdict == Verdict::Fault);
            if found.is_other_part {
                let fault = Finding::new(CheckedQuantity::Poke, Verdict::Fault, found.explanation.as_str());
                // Before all others: what was stated of the poke is no property of scene or images.
                findings.push(Finding { gain: f64::MAX, ..fault });
                return Ok((scene, findings));
            }
            for quantity in [CheckedQuantity::Orientation, CheckedQuantity::DefocusSign] {
                if findings.iter().all(|known| known.quantity != quantity) {
                    findings.push(Finding::open(quantity, found.explanation.as_str()));
                }
            }
            return Ok((scene, findings));
        };
        if !settings.is_empty() {
            let other = scene.with_settings(settings)?;
            let again = self.fit(&other, &cache.for_scene(given, &other))?;
            let [before, after] = [&*fitted, &again].map(chi2_of);
            if is_raised(after, before) {
                let sentence = format!("{}; {}", found.explanation, raised(settings, after, before));
                findings.retain(|known| known.verdict == Verdict::Fault);
                findings.push(Finding::open(CheckedQuantity::Orientation, sentence));
                return Ok((scene, findings));
            }
            (scene, *fitted) = (other, again);
        }
        let gain = findings.iter().map(|known| known.gain).fold(found.gain, f64::max);
        let settings = turns::differences(given, &scene);
        let is_sign = settings.iter().any(|setting| setting.key() == FOCUS);
        let one = |quantity: CheckedQuantity, is_this: bool| {
            let of_fault = Finding { gain, settings: settings.clone(), ..Finding::new(quantity, Verdict::Fault, "") };
            let base =
                if is_this && !settings.is_empty() { of_fault } else { Finding::new(quantity, Verdict::Agrees, "") };
            Finding { explanation: found.explanation.clone(), ..base }
        };
        Ok((scene, vec![one(CheckedQuantity::Orientation, !is_sign), one(CheckedQuantity::DefocusSign, is_sign)]))
    }

    /// The turn of the images that the pupil's shape shows, with which they are explained, and the
    /// findings; `fitted` becomes its fit.
    fn turned(&self, scene: &Scene, fitted: &mut Fitted) -> Result<(Option<Turn>, Vec<Finding>)> {
        let turns::Shape { mut turns, mut hidden, shows_sign } = turns::turns(scene)?;
        let (own_chi2, is_explained, pixels) = (chi2_of(fitted), fitted.is_explained(), pixels_of(fitted));
        // Turns that only bright images distinguish are also tried where the scene explains the
        // images.
        let is_tried = |turn: &Turn| if is_explained { !turn.is_plain } else { own_chi2 > 1.0 };
        let mut best: Option<(usize, Scene, f64)> = None;
        let mut is_shown: Vec<bool> = turns.iter().map(|turn| turn.is_plain).collect();
        for (number, turn) in turns.iter().enumerate().filter(|(_, turn)| is_tried(turn)) {
            // The turned pupil may be larger than its grid.
            let Ok(other) = scene.with_settings(&turn.settings) else { continue };
            let chi2 = self.trial_chi2(&other, first_used(fitted))?.unwrap_or(f64::INFINITY);
            is_shown[number] |= is_explained && (chi2 - own_chi2) * pixels > CONTRADICTED;
            if best.as_ref().is_none_or(|(.., least)| chi2 < *least) {
                best = Some((number, other, chi2));
            }
        }
        let is_right = |chi2: f64| (chi2 - 1.0).max(0.0) < LEFT_BY_TURN * (own_chi2 - 1.0);
        if let Some((number, other, _)) = best.filter(|(.., chi2)| !is_explained && is_right(*chi2))
            // A new basis: that of the cache belongs to the scene's rotation.
            && let Ok(again) = self.fit(&other, &ModelCache::default())
            && is_right(chi2_of(&again))
        {
            let turn = turns.swap_remove(number);
            let (chi2, pixels) = (chi2_of(&again), pixels_of(&again));
            let gain = (own_chi2 - chi2) * pixels / chi2.max(1.0);
            let chi2s = format!("reduced χ² {chi2:.2} in place of {own_chi2:.1}");
            let findings = turn.findings(scene, gain, &chi2s, shows_sign.unwrap_or(true));
            *fitted = again;
            return Ok((Some(turn), findings));
        }
        let is_sign_shown = turns.iter().zip(&is_shown).any(|(turn, is_shown)| turn.is_also_sign && *is_shown);
        // The images of the opposite sign are those of the pupil turned by 180°.
        let shows_sign = shows_sign.unwrap_or(is_sign_shown);
        hidden
            .extend(turns.iter().zip(&is_shown).filter(|(_, is_shown)| !**is_shown).map(|(turn, _)| turn.name.clone()));
        let orientation = if hidden.is_empty() {
            let shown = "the pupil's shape shows every orientation, but not a turn by 180° together with the opposite sign of the defocus: \
                         the maps then have the opposite sign, which a known poke shows";
            Finding::new(CheckedQuantity::Orientation, Verdict::Agrees, shown)
        } else {
            let hidden = hidden.join(", ");
            Finding::open(
                CheckedQuantity::Orientation,
                format!("the pupil does not distinguish {hidden}: a known poke of a segment or actuator does"),
            )
        };
        Ok((None, vec![orientation, turns::sign(shows_sign)]))
    }
}
