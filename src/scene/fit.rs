//! `[modes]` and `[estimate]`: what is estimated, and how.

use super::lists::Zernikes;
use super::purpose::Purpose;
use super::table::{Check, Reader, default, section, unset};
use super::value::{ANY, above, between, even};
use super::words::{
    Combine, DeviceChoice, Knows, Method, NcpaBasis, Optic, Optimizer, Precision, Sampling, SegmentModes, Weighting,
};
use crate::Result;
use std::path::PathBuf;

section! {
    /// The modes that are estimated.
    ModesScene = "modes" {
        /// Motions of the segments; "none" unless named where modes come from a file.
        segment: SegmentModes, ANY, default(SegmentModes::Piston);
        /// Basis of the non-common path aberrations.
        ncpa: NcpaBasis, ANY, default(NcpaBasis::Kl);
        /// Modes of that basis; "zernike" counts from Noll 2.
        ncpa_count: usize, between(1.0, 10_000.0), default(66usize);
        /// FITS modes in place of a basis: image BASIS [mode, y, x] and table MODES (name, group).
        file: Option<PathBuf>, ANY, unset("the basis, as ncpa says");
        /// First and last Noll index of Zernikes estimated exactly, whatever the basis; unset and with ncpa = "none": none.
        exact_zernikes: Option<Zernikes>, between(2.0, 1000.0), unset("tip, tilt and focus; to Noll 21 where the images ask for it");
    }
}

impl Check for ModesScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        if let Some(file) = &self.file {
            reader.not_both("ncpa", "file")?;
            reader.refuse(&["ncpa_count"], "where modes come from a file")?;
            self.ncpa = NcpaBasis::File(file.clone());
            if !reader.named("segment") {
                self.segment = SegmentModes::None;
            }
        }
        if self.ncpa == NcpaBasis::None {
            let exact = self.exact_zernikes.get_or_insert(Zernikes::None);
            let nothing_left = self.segment == SegmentModes::None && *exact == Zernikes::None;
            if nothing_left && reader.source.purpose == Purpose::Whole {
                let sentence = "modes.segment and modes.ncpa are both \"none\": nothing is left to estimate; name a basis for one of them";
                return Err(reader.error("ncpa", sentence));
            }
        }
        Ok(())
    }
}

section! {
    /// How the modes are estimated. What is unset follows from the optimizer's recipe.
    EstimateScene = "estimate" {
        /// The recipe: "bfgs" is the paper's method as a whole (hard-edged pupil, no exact_zernikes, no weights), "paper" its objective with our optimiser.
        optimizer: Optimizer, ANY, default(Optimizer::GaussNewton);
        /// Weight of each pixel.
        weighting: Option<Weighting>, ANY, unset("as the recipe does");
        /// Whether a constant background is fitted.
        fit_background: Option<bool>, ANY, unset("as the recipe does");
        /// Whether the star's flux is fitted; otherwise it is the sum of the image.
        fit_flux: Option<bool>, ANY, unset("as the recipe does");
        /// Whether the image is first moved to the optical axis.
        recentre: Option<bool>, ANY, unset("as the recipe does");
        /// The pixels that the fit compares.
        sampling: Sampling, ANY, default(Sampling::Auto);
        /// Samples along a side of the grid on which a band-limited model is fitted; maps stay on the pupil's.
        samples: Option<usize>, even(16.0, 2048.0), unset("pupil.samples");
        /// Wavelengths of the model, whose images add; an evaluation takes as many times as long.
        wavelengths: Option<usize>, between(1.0, 99.0), unset("as many as image.bandwidth_fraction needs; 1 with the paper's recipes");
        /// Most evaluations of the objective for one image.
        max_evaluations: Option<usize>, between(1.0, 1e6), unset("as the recipe does");
        /// The fit stops where neither a coefficient nor the RMS of the wavefront would move by more than this.
        step_tolerance_nm: Option<f64>, above(0.0, 1000.0), unset("as the recipe does");
        /// How often a fit that ended in a wrong minimum is tried again from elsewhere; a session, which has no time, never does.
        restarts: Option<usize>, between(0.0, 1000.0), unset("3; 0 with the paper's recipes");
        /// RMS error that is allowed to the phasing and to the NCPA each, noise included: the model is then planned, the cheapest that keeps it.
        budget_nm: Option<f64>, above(0.0, 1e6), unset("the model that the other keys describe");
        /// Memory that an estimate may take beside its images, 1e9 bytes; larger work is cut into tiles.
        memory_gb: f64, above(0.0, 1e6), default(8.0);
        /// Standard deviation of the diversity's amplitude over itself, for the error bars: the NCPA's modes take an error of it for their own.
        diversity_error: f64, between(0.0, 1.0), default(0.0);
        /// Numbers of the scene that are fitted beside the modes, of up to six of the images together: image.samples_per_lambda_over_d, pupil.rotation_deg, image.diversity_focus_waves_rms, image.bandwidth_fraction.
        fit_optics: Vec<Optic>, ANY, default([]);
        /// How the images of a sequence become one estimate; outliers are told among 8 images or more.
        combine: Option<Combine>, ANY, unset("clipped-mean; mean with the paper's recipes");
        /// The estimator.
        method: Method, ANY, default(Method::Modal);
        /// method = "full-phase": what is assumed of the adaptive optics.
        knows: Option<Knows>, ANY, unset("telemetry where the images bring it, else the loop where the scene has one, else the spectrum");
        /// Where it runs.
        device: DeviceChoice, ANY, default(DeviceChoice::Auto);
        /// Precision of the imaging chain; "f32" unless named where method = "full-phase".
        precision: Precision, ANY, default(Precision::F64);
    }
}

impl Check for EstimateScene {
    fn check(&mut self, reader: &Reader) -> Result<()> {
        match self.method {
            Method::Modal => self.check_modal(reader),
            Method::FullPhase => self.check_full_phase(reader),
        }
    }
}

impl EstimateScene {
    fn check_modal(&self, reader: &Reader) -> Result<()> {
        reader.refuse(&["knows"], "where estimate.method is \"modal\"")?;
        if self.fit_optics.is_empty() {
            return Ok(());
        }
        // The paper's recipes have no weights by which to tell optics from modes; a plan is made before there are images.
        if self.optimizer != Optimizer::GaussNewton || self.weighting == Some(Weighting::None) {
            let sentence =
                "estimate.fit_optics needs weights by the noise: optimizer = \"gauss-newton\", and weighting left out";
            return Err(reader.error("fit_optics", sentence));
        }
        reader.not_both("budget_nm", "fit_optics")
    }

    /// What an estimator of whole wavefronts has no use for is refused rather than ignored.
    fn check_full_phase(&mut self, reader: &Reader) -> Result<()> {
        let modal =
            ["weighting", "max_evaluations", "step_tolerance_nm", "restarts", "budget_nm", "fit_optics", "combine"];
        reader.refuse(&modal, "where estimate.method is \"full-phase\"")?;
        if self.optimizer != Optimizer::GaussNewton {
            let sentence = format_args!(
                "estimate.optimizer = \"{}\" is a recipe for static modes, which estimate.method = \"full-phase\" does \
                 not follow; leave it out",
                self.optimizer.word()
            );
            return Err(reader.error("optimizer", sentence));
        }
        if !reader.named("precision") {
            self.precision = Precision::F32;
        }
        Ok(())
    }
}
