//! Maps of the static wavefront: segment errors and NCPA apart.

use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::model::Model;
use crate::modes::Basis;
use ndarray::Array2;

/// Segment errors and non-common path aberrations, or the error bars of both (1σ): maps `[y, x]`,
/// nm, NaN outside the pupil.
#[derive(Debug, Clone, PartialEq)]
pub struct StaticMaps {
    /// Of the segment errors.
    pub phasing_nm: Array2<f64>,
    /// Of the non-common path aberrations.
    pub ncpa_nm: Array2<f64>,
}

impl StaticMaps {
    /// The maps of `modes`.
    pub(in crate::modal) fn of_modes(model: &Model, modes: &CombinedModes) -> Self {
        Self::of(model, (&model.basis, model.segment_modes), modes)
    }

    /// The error bars of [`StaticMaps::of_modes`].
    pub(in crate::modal) fn of_error_bars(model: &Model, modes: &CombinedModes) -> Self {
        Self::error_bars_of(model, (&model.basis, model.segment_modes), modes)
    }

    /// The maps of `modes` of `basis`, the first `segments` of which are those of segments.
    pub(in crate::modal) fn of(model: &Model, (basis, segments): (&Basis, usize), modes: &CombinedModes) -> Self {
        let map_nm = |part| model.outside_to_nan(basis.combined(&modes.coefficients_nm, part));
        Self { phasing_nm: map_nm(0..segments), ncpa_nm: map_nm(segments..basis.len()) }
    }

    /// The error bars of [`StaticMaps::of`]: √ of the diagonal of M C Mᵀ over the pupil, for the
    /// modes of each group.
    pub(in crate::modal) fn error_bars_of(
        model: &Model,
        (basis, segments): (&Basis, usize),
        modes: &CombinedModes,
    ) -> Self {
        let sigma_nm = |part| {
            let variance_nm2 = basis.variance(&modes.covariance_nm2, part);
            model.outside_to_nan(variance_nm2.mapv(|v| v.max(0.0).sqrt()))
        };
        Self { phasing_nm: sigma_nm(0..segments), ncpa_nm: sigma_nm(segments..basis.len()) }
    }

    /// Phasing and NCPA together, `[y, x]`, nm.
    pub fn wavefront_nm(&self) -> Array2<f64> {
        &self.phasing_nm + &self.ncpa_nm
    }
}
