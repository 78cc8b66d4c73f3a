//! Sections `[modes]` and `[estimate]`: modes and settings of an estimate.

use super::lists::NollRange;
use super::parameter::Optic;
use super::purpose::Purpose;
use super::table::{Check, Reader, default, section, unset};
use super::value::{ANY, above, between, even};
use super::words::{
    AoKnowledge, Combine, DeviceChoice, Grouping, Method, ModelChoice, NcpaBasis, Optimizer, Precision, Sampling,
    SegmentModes, Telemetry, Weighting,
};
use crate::Result;
use std::path::PathBuf;

section! {
    /// Modes that are estimated. Estimate only.
    ModesScene = "modes" {
        /// Segment modes; the default is "none" if modes come from a file.
        segment: SegmentModes, ANY, default(SegmentModes::Piston);
        /// Basis of the non-common path aberrations.
        ncpa: NcpaBasis, ANY, default(NcpaBasis::Kl);
        /// Number of modes of that basis; "zernike" starts at Noll index 2.
        ncpa_count: usize, between(1.0, 10_000.0), default(66usize);
        /// Motions of each part of the pupil that the spider separates (petals), among the
        /// non-common path aberrations.
        petals: SegmentModes, ANY, default(SegmentModes::None);
        /// FITS modes in place of a basis: image BASIS [mode, y, x] and table MODES (name, group).
        file: Option<PathBuf>, ANY, unset("the basis given by ncpa");
        /// Largest piston of a segment, about their mean, for which channels of several wavelengths
        /// find the whole wavelengths. Estimate only.
        piston_range_nm: f64, above(0.0, 1e6), default(40_000.0);
        /// First and last Noll index of Zernike polynomials that are estimated in addition to any
        /// basis; none by default for ncpa = "none".
        exact_zernikes: Option<NollRange>, between(2.0, 1000.0), unset("[2, 21], and 22 to 45 with a prior");
    }
}

impl Check for ModesScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        if let Some(file) = &self.file {
            reader.not_both("ncpa", "file")?;
            reader.refuse(&["ncpa_count", "petals"], "where modes come from a file")?;
            self.ncpa = NcpaBasis::File(file.clone());
            if !reader.named("segment") {
                self.segment = SegmentModes::None;
            }
        }
        if self.ncpa == NcpaBasis::None {
            let exact = self.exact_zernikes.get_or_insert(NollRange::None);
            let is_without_parts = [self.segment, self.petals] == [SegmentModes::None; 2];
            let nothing_left = is_without_parts && *exact == NollRange::None;
            if nothing_left && reader.source.purpose != Purpose::Arrays {
                let sentence = "modes.segment, modes.ncpa and modes.petals are all \"none\": no mode is left to estimate; name a basis for one of them";
                return Err(reader.error("ncpa", sentence));
            }
        }
        Ok(())
    }
}

section! {
    /// Settings of the estimate. Estimate only. Unset keys have the values of the optimizer's
    /// recipe.
    EstimateScene = "estimate" {
        /// Optimiser and recipe: "gauss-newton" is noise-weighted maximum likelihood; "bfgs" is the
        /// method of Lamb et al. (2021) (hard-edged pupil, no exact_zernikes, no weights); "paper"
        /// is its objective with the optimiser of "gauss-newton".
        optimizer: Optimizer, ANY, default(Optimizer::GaussNewton);
        /// Weight of each pixel in the fit.
        weighting: Option<Weighting>, ANY, unset("given by optimizer");
        /// Whether a constant background is fitted.
        fit_background: Option<bool>, ANY, unset("given by optimizer");
        /// Whether the star's flux is fitted; otherwise it is the sum of the image.
        fit_flux: Option<bool>, ANY, unset("given by optimizer");
        /// Whether the image is first centred on the optical axis.
        recentre: Option<bool>, ANY, unset("given by optimizer");
        /// Pixels on which image and model are compared.
        sampling: Sampling, ANY, default(Sampling::Auto);
        /// Number of samples along a side of the grid on which a band-limited model is fitted; maps
        /// have the pupil's grid.
        samples: Option<usize>, even(16.0, 2048.0), unset("pupil.samples, or as many as a larger defocus needs");
        /// Number of wavelengths of the model; the time of an evaluation is proportional to it.
        wavelengths: Option<usize>, between(1.0, 99.0), unset("as the width of the filter requires; 1 with the recipes of Lamb et al.");
        /// Largest number of evaluations of the objective for one image.
        max_evaluations: Option<usize>, between(1.0, 1e6), unset("given by optimizer");
        /// The fit stops if neither a coefficient nor the RMS of the wavefront would change by more
        /// than this.
        step_tolerance_nm: Option<f64>, above(0.0, 1000.0), unset("given by optimizer");
        /// Largest number of restarts, from a perturbed start, of a fit that ended in a wrong
        /// minimum; sessions do not restart.
        restarts: Option<usize>, between(0.0, 1000.0), unset("6; 0 with the recipes of Lamb et al.");
        /// Whether what the modes leave out (tips, tilts, figures and amplitudes of the segments,
        /// Zernikes to Noll 91, plate scale, gains, response) is marginalised after the fit, so
        /// that maps and error bars hold it. Sessions and the watch do not.
        posterior: Option<bool>, ANY, unset("true where the weights are the noise's and method = \"modal\"");
        /// RMS error, noise included, that is allowed for the phasing and for the NCPA each: the
        /// cheapest model within it is selected.
        budget_nm: Option<f64>, above(0.0, 1e6), unset("the model that the other keys describe");
        /// Memory that an estimate may use in addition to its images, 1e9 bytes; larger problems
        /// are divided into tiles.
        memory_gb: f64, above(0.0, 1e6), default(8.0);
        /// Optical parameters that are fitted in addition to the modes, to up to six images
        /// together.
        fit_optics: Vec<Optic>, ANY, default([]);
        /// Model: "auto" adds tip and tilt of each segment, Zernikes to Noll 91 or 210,
        /// reflectivities, a spider, a central obscuration, segments without light or a stop where
        /// the scene does not explain the images and one of these does, and with "full-phase" tip
        /// and tilt of each segment where the mean wavefront shows them; "scene" adds nothing, nor
        /// do sessions.
        model: ModelChoice, ANY, default(ModelChoice::Auto);
        /// Combination of the images of a sequence; outliers are rejected from 8 images on.
        combine: Option<Combine>, ANY, unset("clipped-mean; mean with the recipes of Lamb et al.");
        /// Images that are of one wavefront and are fitted together; "auto" takes one image of each
        /// of several channels, and all images where one of these is in focus or has less than half
        /// a wave RMS of diversity. "channels" makes a sequence of groups of one image of each
        /// channel, a number one of groups of so many successive images of each: the estimate is
        /// that of their mean wavefront.
        group: Grouping, ANY, default(Grouping::Auto);
        /// Images that are fitted together, counted from 0 over the images of all channels. The
        /// others are compared with the wavefront of these: tip, tilt, flux and background of each
        /// are fitted, and its χ² says whether it was predicted.
        fitted_images: Option<Vec<i64>>, between(0.0, 1e6), unset("all");
        /// Estimator: "modal" fits static modes to each image, "full-phase" retrieves the wavefront
        /// of each image and then the static errors, "auto" chooses: "full-phase" where the scene
        /// has an AO loop or turbulence and two images or more differ by more than noise, flux and
        /// shifts explain.
        method: Method, ANY, default(Method::Modal);
        /// Knowledge of the AO system that is used, for method = "full-phase"; each level includes
        /// those before it.
        ao_knowledge: Option<AoKnowledge>, ANY, unset("\"telemetry\" if the images have it, else \"loop\" if the scene has a loop, else \"spectrum\"");
        /// Slopes that come with the images, for method = "full-phase": "check" compares them with
        /// the slopes of the retrieved wavefronts and refuses slopes of another sign, order, unit
        /// or time, "use" divides them by the gain that was found, "ignore" leaves them out.
        telemetry: Telemetry, ANY, default(Telemetry::Check);
        /// Device that computes the estimate; "all" shares the images of a modal estimate among all
        /// GPUs, or among all OpenCL devices where there is no GPU.
        device: DeviceChoice, ANY, default(DeviceChoice::Auto);
        /// Precision of the imaging chain.
        precision: Option<Precision>, ANY, unset("\"f64\"; \"f32\" for method = \"full-phase\"");
    }
}

impl Check for EstimateScene {
    fn check(&self, reader: &Reader) -> Result<()> {
        match self.method {
            Method::Modal => self.check_modal(reader),
            Method::FullPhase => self.check_full_phase(reader),
            // Keys of the other method are refused when the images have decided.
            Method::Auto => Ok(()),
        }
    }
}

impl EstimateScene {
    /// Precision of the imaging chain.
    pub fn precision(&self) -> Precision {
        let usual = if self.method == Method::FullPhase { Precision::F32 } else { Precision::F64 };
        self.precision.unwrap_or(usual)
    }

    /// Whether what the modes leave out is marginalised after the fit.
    pub fn has_posterior(&self) -> bool {
        self.method != Method::FullPhase && self.has_noise_weights() && self.posterior.unwrap_or(true)
    }

    /// Weight of each pixel where `optimizer` is in place of the one that is named.
    pub(crate) fn weighting_with(&self, optimizer: Optimizer) -> Weighting {
        let is_ours = optimizer == Optimizer::GaussNewton;
        self.weighting.unwrap_or(if is_ours { Weighting::Noise } else { Weighting::None })
    }

    fn has_noise_weights(&self) -> bool {
        self.weighting_with(self.optimizer) == Weighting::Noise
    }

    fn check_modal(&self, reader: &Reader) -> Result<()> {
        let of_full_phase =
            [("ao_knowledge", self.ao_knowledge.is_some()), ("telemetry", self.telemetry != Telemetry::Check)];
        reader.refuse_set(&of_full_phase, "where estimate.method is \"modal\"")?;
        if self.fitted_images.as_ref().is_some_and(Vec::is_empty) {
            let sentence = "estimate.fitted_images = [] is not accepted; the number of one image at least is needed";
            return Err(reader.error("fitted_images", sentence));
        }
        if self.posterior == Some(true) && !self.has_noise_weights() {
            let sentence = "estimate.posterior = true needs noise weights; optimizer = \"gauss-newton\" without weighting is needed";
            return Err(reader.error("posterior", sentence));
        }
        if self.fit_optics.is_empty() {
            return Ok(());
        }
        // Without weights (the paper's recipes) optics and modes are not identifiable together; a
        // model is planned without images, so it cannot fit optics.
        if self.optimizer != Optimizer::GaussNewton || self.weighting == Some(Weighting::None) {
            let sentence =
                "estimate.fit_optics needs noise weights; optimizer = \"gauss-newton\" without weighting is needed";
            return Err(reader.error("fit_optics", sentence));
        }
        match self.budget_nm {
            Some(_) => Err(reader.both("budget_nm", "fit_optics")),
            None => Ok(()),
        }
    }

    /// Refuses keys that a full-phase estimate does not use.
    fn check_full_phase(&self, reader: &Reader) -> Result<()> {
        let modal = [
            ("weighting", self.weighting.is_some()),
            ("max_evaluations", self.max_evaluations.is_some()),
            ("step_tolerance_nm", self.step_tolerance_nm.is_some()),
            ("restarts", self.restarts.is_some()),
            ("budget_nm", self.budget_nm.is_some()),
            ("fit_optics", !self.fit_optics.is_empty()),
            ("combine", self.combine.is_some()),
            ("group", self.group != Grouping::Auto),
            ("fitted_images", self.fitted_images.is_some()),
            ("posterior", self.posterior.is_some()),
        ];
        reader.refuse_set(&modal, "where estimate.method is \"full-phase\"")?;
        if self.optimizer != Optimizer::GaussNewton {
            let sentence = format_args!(
                "estimate.optimizer = \"{}\" has no meaning where estimate.method is \"full-phase\", which has an \
                 optimiser of its own; leave it out",
                self.optimizer.word()
            );
            return Err(reader.error("optimizer", sentence));
        }
        if self.telemetry == Telemetry::Ignore && self.ao_knowledge == Some(AoKnowledge::Telemetry) {
            let sentence = "estimate.telemetry = \"ignore\" contradicts estimate.ao_knowledge = \"telemetry\"; leave one of \
                            them out";
            return Err(reader.error("telemetry", sentence));
        }
        Ok(())
    }
}
