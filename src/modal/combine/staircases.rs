//! Phasing and NCPA without the shapes of the whole mirror that images do not divide between the
//! two.
//!
//! A focus or an astigmatism that all segments share is the same wavefront as one of the whole
//! pupil less a staircase of pistons, tips and tilts of the segments. So where segments have tips
//! and tilts, how much of these three shapes is a staircase and how much is NCPA rests on how well
//! the figure is known; their sum, and all other shapes, do not.

use crate::Result;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::diversity_error::ModeProjector;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::left_out::WholeWavefront;
use crate::modal::model::Model;
use ndarray::{Array1, Array2};

impl WholeWavefront {
    /// Its modes without focus and astigmatisms of the whole pupil: without staircases in the
    /// segments, and without the smooth ones in the NCPA; `None` where the segments of `model` have
    /// no tips and tilts, fitted or left out, or there are no NCPA.
    ///
    /// # Errors
    /// Those of [`ModeProjector::of_gram`].
    pub(crate) fn without_staircases(&self, model: &Model) -> Result<Option<CombinedModes>> {
        let (basis, pupil, segments) = (self.basis(), &model.telescope.pupil, self.segment_modes());
        // Pistons, tips and tilts are the first modes of the segments.
        let motions = 3 * model.pistons();
        if motions == 0 || segments < motions || segments == basis.len() {
            return Ok(None);
        }
        let weight = &pupil.amplitude / pupil.weight_sum();
        let (squares, gram) = (self.products().diag(), basis.without_means(self.products().clone(), &weight)?);
        let projector = ModeProjector::of_gram(pupil, &gram, segments)?;
        let (mut staircases, mut smooth) = (Vec::new(), Vec::new());
        for kind in 0..3 {
            let map = Array2::from_shape_fn(weight.dim(), |(y, x)| {
                let [x, y] = [x, y].map(|at| pupil.grid.coordinate_m(at));
                [x * x + y * y, x * x - y * y, 2.0 * x * y][kind]
            });
            // Piston, tip and tilt of a segment are orthogonal.
            let along = basis.along(&(&map * &weight))?;
            let share = |mode: usize| if squares[mode] > 0.0 { along[mode] / squares[mode] } else { 0.0 };
            let is_its = |mode: usize| if mode < motions { share(mode) } else { 0.0 };
            staircases.push(Array1::from_shape_fn(basis.len(), is_its));
            smooth.push(projector.project(basis, &map)?.coefficients_nm);
        }
        let staircases = GlobalMotions::of_shapes(staircases, &gram, 0..segments)?;
        let smooth = GlobalMotions::of_shapes(smooth, &gram, segments..basis.len())?;
        let mut coefficients_nm = self.modes.coefficients_nm.clone();
        let both = staircases.and(&smooth)?;
        both.remove(&mut coefficients_nm);
        let covariance_nm2 = both.removed_from(&self.modes.covariance_nm2);
        Ok(Some(CombinedModes { coefficients_nm, covariance_nm2 }))
    }
}
