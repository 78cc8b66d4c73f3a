//! Phasing and NCPA without the shapes of the whole mirror that only a tolerance divides between
//! the two: see `WholeWavefront::without_staircases`.

use super::estimate::{Figures, WithoutStaircases};
use super::modal::ExpectedErrors;
use crate::Result;
use crate::modal::{Model, WithLeftOut};

/// How many times the error bar of the phasing without these shapes that with them is, from which
/// both are given; also where the images show a figure that all segments share.
const REMARKABLE: f64 = 1.5;

impl WithoutStaircases {
    /// That of an estimate with these `figures`; `None` where the images divide the
    /// three shapes.
    ///
    /// # Errors
    /// Those of the maps.
    pub(super) fn of(
        (errors, model): (&ExpectedErrors, &Model),
        left_out: Option<&WithLeftOut>,
        figures: &Figures,
    ) -> Result<Option<Self>> {
        let Some(left_out) = left_out else { return Ok(None) };
        let Some(modes) = left_out.whole.without_staircases(model)? else { return Ok(None) };
        let sigma_nm = errors.of_whole_nm(&modes.covariance_nm2)?;
        if left_out.shared_figure.is_none() && figures.phasing.sigma_nm <= REMARKABLE * sigma_nm[0] {
            return Ok(None);
        }
        let [maps, sigma_maps] = left_out.whole.maps_of(model, &modes);
        Ok(Some(Self { figures: Figures::new(&model.telescope.pupil, &maps, sigma_nm)?, maps, sigma_maps }))
    }

    /// What a user should know, where the estimate with the shapes has these `figures`.
    pub(super) fn remark(&self, figures: &Figures) -> String {
        let Figures { phasing, ncpa, .. } = self.figures;
        format!(
            "How the focus and astigmatism of the whole pupil are divided between segments and NCPA depends on tolerance.common_figure_nm: a figure that \
             all segments share is the same wavefront as a staircase of their pistons, tips and tilts and a smooth shape. Without these three \
             shapes the phasing is {:.2} ± {:.2} nm and the NCPA {:.2} ± {:.2} nm; the sum with them, the wavefront, is known to {:.2} nm.",
            phasing.rms_nm, phasing.sigma_nm, ncpa.rms_nm, ncpa.sigma_nm, figures.wavefront.sigma_nm
        )
    }
}
