//! The model of a night watch: its estimator, and what the store and the page keep of it.

use crate::store::About;
use cophase::Result;
use cophase::modal;
use cophase::modes::Group;
use cophase::pipeline::{FrameEstimator, Policy};
use cophase::scene::Scene;
use cophase::telescope::SegmentPlace;
use cophase_view::interrupt::Interrupt;
use serde_json::json;

/// The estimator of the frames.
pub struct Model {
    scene: Scene,
    policy: Policy,
    pub estimator: FrameEstimator,
}

impl Model {
    /// Builds the model of `scene`.
    ///
    /// # Errors
    /// Those of [`FrameEstimator::new`].
    pub fn new(scene: Scene, policy: Policy, interrupt: &Interrupt) -> Result<Self> {
        let estimator = estimator(&scene, policy, interrupt)?;
        Ok(Self { scene, policy, estimator })
    }

    /// Builds it anew.
    pub fn renew(&mut self, interrupt: &Interrupt) -> Result<()> {
        self.estimator = estimator(&self.scene, self.policy, interrupt)?;
        Ok(())
    }

    /// Labels of the segments.
    pub fn labels(&self) -> Vec<String> {
        self.places().into_iter().map(|place| place.label).collect()
    }

    fn places(&self) -> Vec<SegmentPlace> {
        SegmentPlace::all(&self.scene, &self.estimator.fitter().model().telescope.pupil.segments)
    }

    /// What the store keeps of it.
    pub fn about(&self, source: String) -> About {
        let model = self.estimator.fitter().model();
        let segments = &model.telescope.pupil.segments;
        // Half of the least distance between two centres is the inner radius of a hexagon.
        let distances = segments.iter().enumerate().flat_map(|(i, one)| {
            segments[..i].iter().map(move |other| (one.x_m - other.x_m).hypot(one.y_m - other.y_m))
        });
        let nearest = distances.fold(f64::INFINITY, f64::min);
        let centres: Vec<_> = segments.iter().map(|segment| json!([segment.x_m, segment.y_m])).collect();
        let label =
            |place: SegmentPlace| place.label_number().map_or_else(|| json!(place.label), |number| json!(number));
        let labels: Vec<_> = self.places().into_iter().map(label).collect();
        let radius_m = if nearest.is_finite() { nearest / 2.0 } else { model.telescope.pupil.grid.width_m() / 2.0 };
        About {
            scene: self.scene.text().to_owned(),
            policy: self.policy.name().to_owned(),
            source,
            modes: model.basis.names().to_vec(),
            segment_modes: model.segment_modes,
            segments: json!({ "centres_m": centres, "labels": labels, "inner_radius_m": radius_m }).to_string(),
        }
    }
}

fn estimator(scene: &Scene, policy: Policy, interrupt: &Interrupt) -> Result<FrameEstimator> {
    FrameEstimator::new(scene, policy, interrupt.silent_control())
}

/// RMS over the pupil of the modes of a group, piston, tip and tilt removed.
pub fn rms_nm(model: &modal::Model, coefficients_nm: &[f64], group: Group) -> Result<f64> {
    let pupil = &model.telescope.pupil;
    let map_nm = model.map_nm(coefficients_nm, group);
    pupil.rms(pupil.remove_piston_tip_tilt(map_nm.view())?.view())
}
