//! Maps of the whole wavefront: of the fitted modes, and of what was left out of it.

use crate::Result;
use crate::imaging::SegmentFigure;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::combine::static_maps::StaticMaps;
use crate::modal::left_out::groups::{Group, Of};
use crate::modal::left_out::step::Step;
use crate::modal::model::Model;
use crate::modes::{Basis, Group as Part, SegmentModes, circle_zernikes, tilt_frames_of_lit};
use crate::pupil::Pupil;
use ndarray::{Array2, Array3, s};
use std::sync::Arc;

/// The fitted modes and those that were left out, as maps: of the segments, then of the NCPA.
#[derive(Debug)]
pub(in crate::modal) struct WholeBasis {
    basis: Basis,
    segment_modes: usize,
    /// Place of each fitted mode, and of each that was left out.
    places: [Vec<usize>; 2],
    /// Those that were left out, among the unknowns with a prior.
    left_out: Vec<usize>,
    /// Mean products over the pupil.
    products: Array2<f64>,
}

impl WholeBasis {
    /// The modes of `model`, and the shapes of `groups`, among them `figures` of the segments and
    /// Zernikes from `first_zernike` to `last_zernike`.
    ///
    /// # Errors
    /// Those of the modes.
    pub(super) fn new(
        model: &Model,
        groups: &[Group],
        figures: &[Vec<SegmentFigure>],
        [first_zernike, last_zernike]: [usize; 2],
    ) -> Result<Self> {
        let (pupil, own, count) = (&model.telescope.pupil, &model.basis, model.segment_modes);
        let (mut of_segments, mut of_ncpa) = (own.part(0..count), own.part(count..own.len()));
        let (mut segments, mut ncpa) = (Vec::new(), Vec::new());
        if let Some(tilts) = groups.iter().find(|group| matches!(group.of, Of::Tilts)) {
            let modes = SegmentModes::PistonTipTilt.maps_in(pupil, tilt_frames_of_lit)?;
            of_segments = of_segments.followed_by(modes.part(pupil.segments.len()..modes.len()))?;
            segments.extend(tilts.columns.clone());
        }
        if !figures.is_empty() {
            of_segments = of_segments.followed_by(figure_maps(pupil, figures)?)?;
            let is_figure = |group: &&Group| matches!(group.of, Of::Figures | Of::AllSegments);
            segments.extend(groups.iter().filter(is_figure).flat_map(|group| group.columns.clone()));
        }
        if let Some(zernikes) = groups.iter().find(|group| matches!(group.of, Of::Ncpa)) {
            of_ncpa = of_ncpa.followed_by(zernike_maps(pupil, first_zernike, last_zernike)?)?;
            ncpa.extend(zernikes.columns.clone());
        }
        let segment_modes = of_segments.len();
        let basis = of_segments.followed_by(of_ncpa)?;
        let fitted = (0..count).chain(segment_modes..segment_modes + own.len() - count).collect();
        let left_out = (count..segment_modes).chain(basis.len() - ncpa.len()..basis.len()).collect();
        let products = basis.gram(&(&pupil.amplitude / pupil.weight_sum()))?;
        Ok(Self { basis, segment_modes, places: [fitted, left_out], left_out: [segments, ncpa].concat(), products })
    }
}

/// The modes of an estimate with what was left out of the wavefront.
#[derive(Debug, Clone)]
pub(crate) struct WholeWavefront {
    basis: Arc<WholeBasis>,
    /// All of its modes.
    pub(crate) modes: CombinedModes,
    /// The part of their covariance that what was left out adds.
    pub(crate) added_nm2: Array2<f64>,
}

impl WholeWavefront {
    /// Fitted modes `modes` of an estimate that has taken `step`, whose covariances are to be
    /// multiplied by `scale`. Where the fitted modes follow what has a prior, of the covariance C,
    /// by F, that adds F C Fᵀ to these, C of what was left out, and F C between them.
    pub(super) fn new(
        (basis, motions): (&Arc<WholeBasis>, &GlobalMotions),
        step: &Step,
        modes: &CombinedModes,
        scale: f64,
    ) -> Self {
        let [fitted, left_out] = &basis.places;
        let count = basis.basis.len();
        let (mut coefficients_nm, mut added_nm2) = (vec![0.0; count], Array2::zeros((count, count)));
        let own_nm2 = motions.removed_from(&step.added.slice(s![..fitted.len(), ..fitted.len()]).to_owned());
        for (&place, row) in fitted.iter().zip(own_nm2.outer_iter()) {
            fitted.iter().zip(row).for_each(|(&other, nm2)| added_nm2[[place, other]] = nm2 * scale);
        }
        let cross_nm2 = motions.removed_from_rows(&step.with_left_out.slice(s![..fitted.len(), ..]));
        for (&place, &column) in left_out.iter().zip(&basis.left_out) {
            coefficients_nm[place] = step.found.coefficients_nm[column];
            for (&other, nm2) in fitted.iter().zip(cross_nm2.column(column)) {
                added_nm2[[place, other]] = nm2 * scale;
                added_nm2[[other, place]] = nm2 * scale;
            }
            let row = step.found.covariance_nm2.row(column);
            let others = left_out.iter().zip(&basis.left_out);
            others.for_each(|(&other, &column)| added_nm2[[place, other]] = row[column] * scale);
        }
        let whole = CombinedModes { coefficients_nm, covariance_nm2: added_nm2.clone() };
        let mut own = Self { basis: basis.clone(), modes: whole, added_nm2 };
        own.take_fitted(modes);
        own
    }

    /// Takes these fitted modes in place of those it has, to whose errors others were added.
    pub(in crate::modal) fn take_fitted(&mut self, modes: &CombinedModes) {
        let fitted = &self.basis.places[0];
        for ((&place, nm), row) in fitted.iter().zip(&modes.coefficients_nm).zip(modes.covariance_nm2.outer_iter()) {
            self.modes.coefficients_nm[place] = *nm;
            fitted.iter().zip(row).for_each(|(&other, nm2)| self.modes.covariance_nm2[[place, other]] = *nm2);
        }
    }

    /// Gives the prior of `model` to its modes, which what was left out follows.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a covariance that is not finite.
    pub(in crate::modal) fn take_prior(&mut self, model: &Model) -> Result<()> {
        let behind = self.basis.segment_modes - model.segment_modes;
        if let Some(prior) = &model.prior {
            self.modes = prior.behind(behind).posterior(&self.modes)?;
        }
        Ok(())
    }

    /// The maps, and their error bars.
    pub(crate) fn maps(&self, model: &Model) -> [StaticMaps; 2] {
        self.maps_of(model, &self.modes)
    }

    /// The same of other coefficients of its modes, of another covariance.
    pub(crate) fn maps_of(&self, model: &Model, modes: &CombinedModes) -> [StaticMaps; 2] {
        let of = (&self.basis.basis, self.basis.segment_modes);
        [StaticMaps::of(model, of, modes), StaticMaps::error_bars_of(model, of, modes)]
    }

    /// Place of each fitted mode among all.
    pub(crate) fn fitted(&self) -> &[usize] {
        &self.basis.places[0]
    }

    /// All modes as maps.
    pub(crate) fn basis(&self) -> &Basis {
        &self.basis.basis
    }

    /// Mean products of all over the pupil.
    pub(crate) fn products(&self) -> &Array2<f64> {
        &self.basis.products
    }

    /// Number of those of the segments, which are the first.
    pub(crate) fn segment_modes(&self) -> usize {
        self.basis.segment_modes
    }
}

/// Sums of `figures` on the grid of the pupil, each sample of the segment that owns it.
fn figure_maps(pupil: &Pupil, figures: &[Vec<SegmentFigure>]) -> Result<Basis> {
    let (frames, samples) = (tilt_frames_of_lit(pupil)?, pupil.grid.samples());
    let mut owned = vec![Vec::new(); pupil.segments.len()];
    for ((row, column), segment) in pupil.owned_samples() {
        let tilts = frames[segment].tilts([column, row].map(|at| pupil.grid.coordinate_m(at)));
        owned[segment].push(((row * samples + column) as u32, tilts));
    }
    let of_segment = |SegmentFigure { segment, terms: [a, b, c, d] }: &SegmentFigure| {
        let value = |[x, y]: [f64; 2]| a * x * x + b * y * y + c * x * y + d;
        owned[*segment].iter().map(|&(at, tilts)| (at, value(tilts))).collect::<Vec<_>>()
    };
    let lists = figures.iter().map(|own| {
        let mut list: Vec<(u32, f64)> = own.iter().flat_map(of_segment).collect();
        list.sort_unstable_by_key(|(at, _)| *at);
        list
    });
    let names = (0..figures.len()).map(|number| format!("figure-{number}")).collect();
    Basis::from_lists(names, vec![Part::Segment; figures.len()], samples, lists.collect())
}

/// Zernikes from `first` to `last`, in Noll's order, on the grid of the pupil.
fn zernike_maps(pupil: &Pupil, first: usize, last: usize) -> Result<Basis> {
    let (samples, owned) = (pupil.grid.samples(), pupil.owned_samples().map(|(at, _)| at).collect::<Vec<_>>());
    let [xs_m, ys_m]: [Vec<f64>; 2] = [0, 1].map(|axis| {
        let coordinate = |&(row, column): &(usize, usize)| pupil.grid.coordinate_m([column, row][axis]);
        owned.iter().map(coordinate).collect()
    });
    let values = circle_zernikes(first, last, pupil)?.evaluate(&xs_m, &ys_m)?;
    let mut maps = Array3::zeros((values.nrows(), samples, samples));
    for (mut map, values) in maps.outer_iter_mut().zip(values.outer_iter()) {
        owned.iter().zip(values).for_each(|(&at, value)| map[at] = *value);
    }
    let names = (first..=last).map(|noll| format!("left-out-zernike-{noll}")).collect();
    Basis::from_cube(names, vec![Part::Ncpa; values.nrows()], maps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modal::Recipe;
    use crate::modal::left_out::LeftOut;
    use crate::scene::Scene;

    #[test]
    fn maps_have_the_units_of_what_was_left_out() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let model = Model::new(&scene, &Recipe::with_prior(&scene), false).unwrap();
        let whole = LeftOut::new(&model, 45, &scene.tolerance, None).unwrap().whole;
        let [fitted, left_out] = &whole.places;
        // 72 tips and tilts, 108 figures, 3 common ones, Zernikes 46 to 91.
        assert_eq!((fitted.len(), left_out.len(), whole.segment_modes), (model.basis.len(), 229, 36 + 72 + 111));
        let squares = whole.basis.mean_squares(&model.telescope.pupil.amplitude).unwrap();
        let sum = |modes: std::ops::Range<usize>| modes.map(|mode| squares[mode]).sum::<f64>();
        // Tips of 1 nm RMS on every segment, and figures, have 1 nm RMS over the pupil, but for its
        // samples and its obscuration.
        for (name, all) in
            [("tips", sum(36..72)), ("figures", sum(108..216) / 3.0), ("common figures", sum(216..219) / 3.0)]
        {
            assert!((all - 1.0).abs() < 0.15, "{name}: {all}");
        }
        // Zernikes are largest at the rim of their circle, of which the hexagons lack a part.
        let zernikes = sum(whole.basis.len() - 46..whole.basis.len()) / 46.0;
        assert!((0.6..1.1).contains(&zernikes), "{zernikes}");
    }
}
