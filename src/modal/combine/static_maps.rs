//! Maps of the static wavefront: segment errors and NCPA apart.

use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::model::Model;
use crate::modes::Group;
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
        let map_nm = |group| model.map_nm(&modes.coefficients_nm, group);
        Self { phasing_nm: map_nm(Group::Segment), ncpa_nm: map_nm(Group::Ncpa) }
    }

    /// The error bars of [`StaticMaps::of_modes`]: √ of the diagonal of M C Mᵀ over the pupil, for
    /// the modes of each group.
    pub(in crate::modal) fn of_error_bars(model: &Model, modes: &CombinedModes) -> Self {
        let sigma_nm = |group| {
            let variance_nm2 = model.basis.variance(&modes.covariance_nm2, model.modes_of(group));
            model.outside_to_nan(variance_nm2.mapv(|v| v.max(0.0).sqrt()))
        };
        Self { phasing_nm: sigma_nm(Group::Segment), ncpa_nm: sigma_nm(Group::Ncpa) }
    }

    /// Phasing and NCPA together, `[y, x]`, nm.
    pub fn wavefront_nm(&self) -> Array2<f64> {
        &self.phasing_nm + &self.ncpa_nm
    }
}
