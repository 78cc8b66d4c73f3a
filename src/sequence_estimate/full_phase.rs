//! What a full-phase estimate found, in the terms that programs and bindings report it in.

use crate::pupil::Pupil;
use crate::retrieval::{RetrievalReport, RetrievedOptics};
use crate::scene::{Knows, Precision, Scene};
use crate::statics::{ErrorSource, Iteration, SegmentTilts, StaticsSettings};
use crate::{Error, Result};

/// χ² per degree of freedom of images that the model explains but for what it cannot know of turbulence: behind a bright star
/// 1.4 to 1.6 where exposures are frozen, 4.2 in exposures of 10 ms; square pixels taken for points make it 8.
pub(super) const EXPLAINED: f64 = 6.0;

/// What a full-phase estimate found.
#[derive(Debug, Clone)]
pub struct FullPhase {
    /// All passes; the last one is the estimate.
    pub passes: Vec<Iteration>,
    /// How the retrieval of each image went in the last pass.
    pub reports: Vec<RetrievalReport>,
    /// Single pixels of each image that nobody had marked bad, that stood out, and that were taken off it.
    pub cut_pixels: Vec<usize>,
    /// What was assumed of the adaptive optics.
    pub knows: Knows,
    /// Optics that the images said are others than the scene's.
    pub optics: RetrievedOptics,
    /// The scene by which static errors were sought, and corrections are to be made: with the optics that were found, unless
    /// the sensor's subapertures speak against them.
    pub scene: Scene,
    /// What reports call that on which the retrievals ran; the search for optics is always the CPU's.
    pub device: String,
    /// That the device which `auto` took was lost on the way, and the CPU took its place, as a sentence.
    pub device_failure: Option<String>,
    /// Precision of the imaging chain.
    pub precision: Precision,
    /// The pupil on which maps are.
    pub pupil: Pupil,
    /// Wall-clock time, s; that in retrievals.
    pub seconds: f64,
    /// Of it, in retrievals of all passes, s.
    pub retrieval_seconds: f64,
}

impl FullPhase {
    /// The last pass.
    ///
    /// # Errors
    /// [`Error::Internal`] never: an estimate has a pass at least.
    pub fn result(&self) -> Result<&Iteration> {
        self.passes.last().ok_or_else(|| Error::Internal("an estimate without a pass".into()))
    }

    /// RMS over the pupil of phasing and NCPA, piston, tip and tilt removed, nm.
    ///
    /// # Errors
    /// As [`FullPhase::result`].
    pub fn rms_nm(&self) -> Result<[f64; 2]> {
        let pass = self.result()?;
        let rms = |map: &ndarray::Array2<f64>| self.pupil.rms(self.pupil.remove_piston_tip_tilt(map.view())?.view());
        Ok([rms(&pass.phasing_nm)?, rms(&pass.ncpa_nm)?])
    }

    /// Whether passes ended because the last one changed next to nothing, and not because there may be no more.
    ///
    /// # Errors
    /// As [`FullPhase::result`].
    pub fn settled(&self) -> Result<bool> {
        let (pass, recipe) = (self.result()?, StaticsSettings::default());
        Ok(self.passes.len() < recipe.max_iterations || !pass.has_changed(recipe.tolerance))
    }

    /// Whether the typical image's residual is more than the noise and what the model cannot know.
    ///
    /// # Errors
    /// As [`FullPhase::result`].
    pub fn misfits(&self) -> Result<bool> {
        // Where optics were looked for, what was found should have explained the images.
        let explained =
            if self.optics.warnings().is_empty() { EXPLAINED } else { crate::retrieval::OPTICS_SEARCH_CHI2 };
        Ok(self.result()?.reduced_chi2 > explained)
    }

    /// What somebody should know before using the estimate, in a sentence each.
    ///
    /// # Errors
    /// As [`FullPhase::result`].
    pub fn warnings(&self) -> Result<Vec<String>> {
        let pass = self.result()?;
        let mut sentences = Vec::new();
        let (all, left_out) = (self.reports.len(), self.reports.len() - pass.used_images.len());
        if left_out > 0 {
            let were = if left_out == 1 { "was" } else { "were" };
            sentences.push(format!("{left_out} of {all} images {were} left out"));
        }
        let spoilt = self.cut_pixels.iter().filter(|pixels| **pixels > 0).count();
        if spoilt > 0 {
            let (pixels, were) = match self.cut_pixels.iter().sum::<usize>() {
                1 => ("1 pixel".into(), "was"),
                many => (format!("{many} pixels"), "were"),
            };
            sentences.push(format!(
                "{pixels} that stood out of {spoilt} of {all} images {were} taken off (cosmic rays, hot pixels)"
            ));
        }
        sentences.extend(self.device_failure.clone());
        sentences.extend(pass.diversity.warning(self.scene.image.wavelength_nm));
        sentences.extend(self.optics.warnings());
        if self.misfits()? {
            sentences.push(format!(
                "the residual of the typical image is {:.1} times the noise (reduced χ² {:.1}): the scene differs from the \
                 instrument, and the error bars do not know by how much",
                pass.reduced_chi2.sqrt(),
                pass.reduced_chi2
            ));
        }
        if let Some(tilts) = pass.segment_tilts.filter(SegmentTilts::is_significant) {
            sentences.push(format!(
                "single segments seem to be tilted, by {:.0} nm RMS and more: pistons and NCPA have taken a share of it for \
                 theirs, and their error bars do not know",
                tilts.rms_nm
            ));
        }
        let beyond_nm = pass.error_budget.term_nm(ErrorSource::NcpaBeyondModes)[1];
        if beyond_nm > 0.0 {
            sentences.push(format!(
                "the NCPA go on beyond the {} modes that the sensor tells apart: some {:.1} nm of them are in no map, and in the \
                 error bars alone",
                pass.errors.ncpa_nm.len(),
                beyond_nm
            ));
        }
        if !self.settled()? {
            let [phasing_nm, ncpa_nm] = pass.change_nm;
            sentences.push(format!(
                "{} passes did not settle: the last one changed the phasing by {phasing_nm:.1} nm and the NCPA by \
                 {ncpa_nm:.1} nm",
                self.passes.len()
            ));
        }
        if self.knows < Knows::Loop {
            sentences.push(format!(
                "with estimate.knows = \"{}\" the loop's answer to the pistons counts as NCPA: their error bars hold {:.0} nm \
                 for it",
                self.knows.word(),
                pass.error_budget.term_nm(ErrorSource::UnknownLoopResponse)[1]
            ));
        }
        Ok(sentences)
    }

    /// What became of image `image`, in a sentence; none where there is no such image.
    pub fn about_image(&self, image: usize) -> Option<String> {
        let report = self.reports.get(image)?;
        if let Some(refusal) = &report.refusal {
            return Some(format!("left out, {refusal}"));
        }
        let used = self.passes.last().is_some_and(|pass| pass.used_images.contains(&image));
        let how = if used { "used" } else { "left out, its χ² is not like the others'" };
        Some(format!("{how}; reduced χ² {:.2}, {}", report.reduced_chi2, report.reason))
    }
}
