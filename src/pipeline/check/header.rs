//! Values of the file, cards and its own scene, that differ from the scene's: which of the two the
//! images agree with.

use super::finding::{CheckedQuantity, Finding, Verdict};
use super::{Work, chi2_of, pixels_of};
use crate::modal::ModelCache;
use crate::pipeline::consistency::Contradiction;
use crate::pipeline::modal_task::Fitted;
use crate::scene::Scene;

impl Work<'_> {
    /// A finding for each contradiction that is left; `fitted` is the fit with `scene`.
    pub(super) fn header(&self, scene: &Scene, cache: &ModelCache, fitted: &Fitted) -> Vec<Finding> {
        self.contradictions.iter().map(|one| self.of_contradiction(one, scene, cache, fitted)).collect()
    }

    /// A value of the file is a fault where the images agree with it, and where they do not decide:
    /// an estimate refuses it then. Of a scene that was corrected since the file was written the
    /// images know better.
    fn of_contradiction(&self, one: &Contradiction, scene: &Scene, cache: &ModelCache, fitted: &Fitted) -> Finding {
        let settings = vec![one.of_file.clone()];
        let fault = |gain: f64, explanation: String| Finding {
            gain,
            settings: settings.clone(),
            ..Finding::new(CheckedQuantity::Header, Verdict::Fault, explanation)
        };
        let own_chi2 = chi2_of(fitted);
        let undecided = || fault(0.0, format!("{}; the images do not decide between them", one.sentence));
        let other = match scene.with_settings(&settings) {
            Ok(other) => other,
            // A value that fits only together with others of the file.
            Err(error) => return Finding::open(CheckedQuantity::Header, format!("{}; {error}", one.sentence)),
        };
        let agrees = |how: String| {
            let sentence = format!(
                "{}; the images agree with the scene: {how} ('cophase estimate' then needs --trust scene)",
                one.sentence
            );
            Finding::new(CheckedQuantity::Header, Verdict::Agrees, sentence)
        };
        let file_chi2 = match self.fit(&other, &cache.for_scene(scene, &other)) {
            Ok(again) => chi2_of(&again),
            Err(_) if fitted.is_explained() => return agrees("with the file's value they cannot be fitted".into()),
            Err(_) => return undecided(),
        };
        let pixels = pixels_of(fitted);
        let gain = (own_chi2 - file_chi2) * pixels / own_chi2.min(file_chi2).max(1.0);
        let log_pixels = pixels.max(2.0).ln();
        let chi2s = format!("reduced χ² {own_chi2:.2}, and {file_chi2:.2} with the file's value");
        if gain > log_pixels {
            fault(gain - log_pixels, format!("{}; the images agree with the file: {chi2s}", one.sentence))
        } else if gain < -log_pixels {
            agrees(chi2s)
        } else {
            undecided()
        }
    }
}
