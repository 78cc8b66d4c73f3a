//! Numbers of a scene that the search for the optics varies, and the search along one of them.

use crate::Result;
use crate::modal::has_diversity;
use crate::scene::Scene;
use std::ops::RangeInclusive;

/// Ratio to the least objective at which a search in one direction ends.
const END_RATIO: f64 = 4.0;

/// Gain of a search in half and quarter steps below which it ends. About a minimum as wide as the first step those steps come within an
/// eighth of it, where the objective is 2 % above the least: after less than this no finer step gains the tenth at which another value is
/// adopted.
const LEAST_GAIN: f64 = 0.05;

/// What a number of the scene describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OpticsKind {
    /// Scale or shadow: the objective can have several minima along it.
    Telescope,
    /// Filter or pixel, which blur the image: the objective has one minimum along it.
    Camera,
}

/// A number of the scene that is searched for.
#[derive(Debug, Clone)]
pub(super) struct OpticsParameter {
    pub(super) key: &'static str,
    pub(super) kind: OpticsKind,
    /// Value in the scene.
    pub(super) own: f64,
    pub(super) range: RangeInclusive<f64>,
    /// About the half-width of the minimum.
    pub(super) first_step: f64,
    /// Step at which the search ends: the remaining error raises χ² by some hundredths.
    pub(super) last_step: f64,
}

impl OpticsParameter {
    /// Parameters that can be searched for in `scene`.
    pub(super) fn all(scene: &Scene) -> Vec<Self> {
        let sampling = scene.image.samples_per_lambda_over_d;
        let mut all = vec![Self {
            key: "image.samples_per_lambda_over_d",
            kind: OpticsKind::Telescope,
            own: sampling,
            range: 0.97 * sampling..=1.03 * sampling,
            first_step: 0.01 * sampling,
            last_step: 0.0003 * sampling,
        }];
        all.extend(Self::camera(scene));
        all.extend(Self::shadows(scene));
        all
    }

    /// Shadows of the pupil; none in one from a file, which includes them.
    fn shadows(scene: &Scene) -> Vec<Self> {
        let Some(width_m) = scene.pupil.extent_m() else { return Vec::new() };
        let shadow = |key, own: f64, farthest: f64, first_step, last_step| Self {
            key,
            kind: OpticsKind::Telescope,
            own,
            range: 0.0..=(farthest * width_m).max(1.5 * own),
            first_step: first_step * width_m,
            last_step: last_step * width_m,
        };
        // As fractions of the pupil's width, for half a percent of its area and less: on Keck 10 cm of an obscuration's
        // diameter and 1 cm of the spider's width.
        vec![
            shadow("pupil.central_obscuration_m", scene.pupil.central_obscuration_m, 0.5, 1e-2, 2.5e-4),
            shadow("pupil.spider_width_m", scene.pupil.spider_width_m, 0.01, 1e-3, 5e-5),
        ]
    }

    /// The width of the filter and the area of the pixels, where the scene's model can have them; none in focus, where a retrieval ends in
    /// one of many minima and objectives do not compare.
    fn camera(scene: &Scene) -> Vec<Self> {
        let image = &scene.image;
        let mut all = Vec::new();
        if !has_diversity(image) {
            return all;
        }
        // The width of a filter from a file is known.
        if scene.estimate.wavelengths.is_none() && image.filter_file.is_none() {
            all.push(Self {
                key: "image.bandwidth_fraction",
                kind: OpticsKind::Camera,
                own: image.bandwidth_fraction,
                // From narrow-band filters, 1 to 2 %, to those of the atmosphere's windows, 15 to 20 %.
                range: 0.0..=0.25,
                first_step: 0.01,
                last_step: 0.001,
            });
        }
        if image.has_samples_of_pixels() {
            all.push(Self {
                key: "image.pixel_fill",
                kind: OpticsKind::Camera,
                own: image.pixel_fill,
                range: 0.0..=1.2,
                first_step: 0.5,
                last_step: 0.05,
            });
        }
        all
    }

    /// Finds the value within the range at which `merit` is least, and that merit, from a value with `known` merit.
    pub(super) fn find_minimum(
        &self,
        known: (f64, f64),
        mut merit: impl FnMut(f64) -> Result<f64>,
    ) -> Result<(f64, f64)> {
        let mut best = known;
        for side in [-1.0, 1.0] {
            for step in 1.. {
                let value = known.0 + side * f64::from(step) * self.first_step;
                if !self.range.contains(&value) {
                    break;
                }
                let found = merit(value)?;
                let has_risen = found > best.1;
                if !has_risen {
                    best = (value, found);
                }
                if has_risen && (found > END_RATIO * best.1 || self.kind == OpticsKind::Camera) {
                    break;
                }
            }
        }
        let mut step = self.first_step / 2.0;
        // Half and quarter steps that lower little rule out an error that χ² would show.
        let is_lower = |best: f64| best < (1.0 - LEAST_GAIN) * known.1;
        while step > self.last_step && (is_lower(best.1) || step > self.first_step / 5.0) {
            for value in [best.0 - step, best.0 + step] {
                if !self.range.contains(&value) {
                    continue;
                }
                let found = merit(value)?;
                if found < best.1 {
                    best = (value, found);
                    break;
                }
            }
            step /= 2.0;
        }
        Ok(best)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    #[test]
    fn the_search_ends_at_the_minimum_or_at_a_steep_rise() {
        let parameter = OpticsParameter {
            key: "",
            kind: OpticsKind::Telescope,
            own: 0.0,
            range: 0.0..=9.0,
            first_step: 1.0,
            last_step: 0.01,
        };
        let tries = Cell::new(0);
        let bowl = |at: f64| move |value: f64| Ok(1.0 + (value - at).powi(2));
        // Within the last step.
        let near = parameter.find_minimum((0.0, 17.0), bowl(4.0 / 1.3)).unwrap();
        assert!((near.0 - 4.0 / 1.3).abs() < 0.01, "{near:?}");
        let steep = |value: f64| {
            tries.set(tries.get() + 1);
            bowl(0.0)(value)
        };
        assert_eq!(parameter.find_minimum((0.0, 1.0), steep).unwrap(), (0.0, 1.0));
        // Steps of 1 and 2 up the wall, then a half and a quarter.
        assert_eq!(tries.get(), 4);
        // With one minimum the first rise ends a side.
        tries.set(0);
        let camera = OpticsParameter { kind: OpticsKind::Camera, ..parameter };
        assert_eq!(camera.find_minimum((0.0, 1.0), steep).unwrap(), (0.0, 1.0));
        assert_eq!(tries.get(), 3);
        // A gain of 2 % is followed in half and quarter steps: 1, 0.5, 0.25 and 0.75.
        tries.set(0);
        let slight = |value: f64| {
            tries.set(tries.get() + 1);
            Ok(0.98 + (value - 0.5).powi(2))
        };
        assert_eq!(camera.find_minimum((0.0, 1.0), slight).unwrap(), (0.5, 0.98));
        assert_eq!(tries.get(), 4);
    }
}
