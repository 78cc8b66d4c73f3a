//! Parameters that the search for the optics varies, and the search along one of them.

use crate::Result;
use crate::modal::has_diversity;
use crate::scene::{Changes, Optic, Parameter, ParameterKind, SearchRange, System};

/// Ratio to the least objective at which a search in one direction ends.
const END_RATIO: f64 = 4.0;

/// Gain of a search in half and quarter steps below which it ends. About a minimum as wide as the
/// first step those steps come within an eighth of it, where the objective is 2 % above the least:
/// after less than this no finer step gains the tenth at which another value is adopted.
const LEAST_GAIN: f64 = 0.05;

/// A parameter that is searched for.
#[derive(Debug, Clone)]
pub(super) struct SearchedParameter {
    pub(super) optic: Optic,
    pub(super) parameter: &'static Parameter,
    /// Value in the scene.
    pub(super) own: f64,
    pub(super) search: SearchRange,
}

impl SearchedParameter {
    /// Parameters that can be searched for in `scene`: none of the camera in focus, where a
    /// retrieval ends in one of many minima and objectives do not compare.
    pub(super) fn all(scene: &System) -> Vec<Self> {
        let each = Optic::all().flat_map(|optic| optic.parameters().iter().map(move |parameter| (optic, parameter)));
        let each = each.filter_map(|(optic, parameter)| {
            // The filter of a scene that names its number of wavelengths is known.
            let is_known = parameter.changes == Changes::Wavelengths && scene.estimate.wavelengths.is_some();
            let search = parameter.search(&scene.pupil, &scene.image).filter(|_| !is_known)?;
            Some(Self { optic, parameter, own: parameter.get(scene), search })
        });
        each.filter(|one| one.search.kind == ParameterKind::Telescope || has_diversity(&scene.image)).collect()
    }

    /// Finds the value within the range at which `merit` is least, and that merit, from a value
    /// with `known` merit.
    pub(super) fn find_minimum(
        &self,
        known: (f64, f64),
        mut merit: impl FnMut(f64) -> Result<f64>,
    ) -> Result<(f64, f64)> {
        let SearchRange { kind, range, first_step, last_step } = &self.search;
        let mut best = known;
        for side in [-1.0, 1.0] {
            for step in 1.. {
                let value = known.0 + side * f64::from(step) * first_step;
                if !range.contains(&value) {
                    break;
                }
                let found = merit(value)?;
                let has_risen = found > best.1;
                if !has_risen {
                    best = (value, found);
                }
                if has_risen && (found > END_RATIO * best.1 || *kind == ParameterKind::Camera) {
                    break;
                }
            }
        }
        let mut step = first_step / 2.0;
        // Half and quarter steps that lower little rule out an error that χ² would show.
        let is_lower = |best: f64| best < (1.0 - LEAST_GAIN) * known.1;
        while step > *last_step && (is_lower(best.1) || step > first_step / 5.0) {
            for value in [best.0 - step, best.0 + step] {
                if !range.contains(&value) {
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
        let search = SearchRange { kind: ParameterKind::Telescope, range: 0.0..=9.0, first_step: 1.0, last_step: 0.01 };
        let optic = Optic::PLATE_SCALE;
        let parameter =
            SearchedParameter { optic, parameter: &optic.parameters()[0], own: 0.0, search: search.clone() };
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
        let search = SearchRange { kind: ParameterKind::Camera, ..search };
        let camera = SearchedParameter { search, ..parameter };
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
