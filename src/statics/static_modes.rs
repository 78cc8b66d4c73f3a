//! A family of NCPA modes beside the pistons: on the samples of phases, and as maps with their error bars.

use super::empirical_bayes::Family;
use super::image_selection::Sequence;
use super::iterations::{Pass, coefficients};
use super::least_squares::{NcpaModes, StaticErrors};
use crate::estimate::{HeldDiversity, Holder};
use crate::metrics::MapGram;
use crate::modes::{Basis, SmoothBasis};
use crate::pupil::Pupil;
use crate::retrieval::LitSamples;
use crate::scene::Scene;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, Array3, ArrayView2, Axis, s};

/// A family of NCPA modes, on the samples and on the scene's grid.
pub(super) struct Ncpa {
    family: Family,
    pub(super) basis: SmoothBasis,
    pub(super) groups: Vec<usize>,
    pub(super) at_all: Array2<f64>,
    pub(super) at_kept: Array2<f64>,
    /// All static modes on the scene's grid, pistons first, `[mode, y, x]`.
    maps: Array3<f64>,
    segments: usize,
    gram: [MapGram; 2],
    diversity: HeldDiversity,
    /// Covariance of the modes, nm², that an error of the diversity makes in all images alike; none where it is known.
    shared_nm2: Option<Array2<f64>>,
    /// The modes on the scene's grid and what they hold of a map, where the loop's answer to the pistons is not known.
    smoothing: Option<(Basis, Holder)>,
}

/// What a loop that nobody knows answers to the pistons, as a share of what the NCPA's modes hold of them: anything between
/// nothing and all, of which this is the RMS. Keck's zonal loop answers with two thirds, and what it answers looks like that
/// (a correlation of 0.93).
const ANSWERED: f64 = 0.577;

impl Ncpa {
    pub(super) fn of(
        family: Family,
        scene: &Scene,
        telescope: &Telescope,
        (lit, kept): (&LitSamples, &[usize]),
        loop_is_known: bool,
    ) -> Result<Self> {
        let modes = NcpaModes::of(family, scene, telescope)?;
        let at_all = modes.basis.evaluate(&lit.xs_m, &lit.ys_m)?;
        let pupil = &telescope.pupil;
        let sampled = modes.basis.sampled(pupil)?;
        let diversity = HeldDiversity::of(scene, telescope, &sampled, 0)?;
        let shared_nm2 = shared_nm2(&diversity, scene)?;
        let smooth = sampled.maps();
        let smoothing = match loop_is_known {
            true => None,
            false => Some(Holder::of(pupil, &sampled, 0)?).map(|holder| (sampled, holder)),
        };
        let pistons = crate::modes::SegmentModes::Piston.maps(pupil)?.maps();
        let gram = [MapGram::new(pupil, pistons.view())?, MapGram::new(pupil, smooth.view())?];
        let segments = pistons.len_of(Axis(0));
        let maps = ndarray::concatenate(Axis(0), &[pistons.view(), smooth.view()])
            .map_err(|error| Error::Internal(format!("maps of two sizes: {error}")))?;
        Ok(Self {
            basis: modes.basis,
            family,
            groups: modes.groups,
            at_kept: at_all.select(Axis(1), kept),
            at_all,
            maps,
            segments,
            gram,
            diversity,
            shared_nm2,
            smoothing,
        })
    }

    /// What a pass found, as maps with their error bars; `about` is the static wavefront about which its phases were sought.
    pub(super) fn pass(
        &self,
        mut errors: StaticErrors,
        pupil: &Pupil,
        about: Option<Array1<f64>>,
        sequence: &Sequence,
        residual_rms_nm: f64,
    ) -> Result<Pass> {
        let coefficients = coefficients(&errors);
        let ranges = [0..self.segments, self.segments..coefficients.len()];
        let map = |range: &std::ops::Range<usize>| self.map(&coefficients, range.clone(), pupil);
        let [phasing_nm, ncpa_nm] = [map(&ranges[0]), map(&ranges[1])];
        let expected = |covariance_nm2: &Array2<f64>| -> Result<[f64; 2]> {
            let of =
                |i: usize| self.gram[i].expected_rms_nm(covariance_nm2.slice(s![ranges[i].clone(), ranges[i].clone()]));
            Ok([of(0)?, of(1)?])
        };
        let averaged_nm = expected(&errors.covariance_nm2)?;
        let answer_nm = self.unknown_answer_nm(&coefficients)?;
        let column = answer_nm.view().insert_axis(Axis(1));
        let answer_nm2 = column.dot(&column.t());
        let answer_nm = self.gram[1].expected_rms_nm(answer_nm2.view())?;
        for shared_nm2 in self.shared_nm2.iter().chain([&answer_nm2]) {
            let mut ncpa_nm2 = errors.covariance_nm2.slice_mut(s![self.segments.., self.segments..]);
            ncpa_nm2 += shared_nm2;
        }
        let expected_nm = expected(&errors.covariance_nm2)?;
        let part = |range: &std::ops::Range<usize>| errors.covariance_nm2.slice(s![range.clone(), range.clone()]);
        let sigma = |range: &std::ops::Range<usize>| self.sigma(part(range), range.clone(), pupil);
        let changed_nm = match about.filter(|about| about.len() == coefficients.len()) {
            None => [f64::NAN; 2],
            Some(about) => {
                let change = |i: usize| {
                    let before_nm = self.map(&about, ranges[i].clone(), pupil);
                    crate::metrics::residual_nm(pupil, [&phasing_nm, &ncpa_nm][i].view(), before_nm.view())
                };
                [change(0)?, change(1)?]
            }
        };
        Ok(Pass {
            family: self.family,
            ncpa_names: self.basis.names().to_vec(),
            phasing_sigma_nm: sigma(&ranges[0]),
            ncpa_sigma_nm: sigma(&ranges[1]),
            expected_nm,
            averaged_nm,
            beyond_nm: 0.0,
            answer_nm,
            changed_nm,
            diversity: self.diversity.clone(),
            used_images: sequence.used.clone(),
            reduced_chi2: sequence.reduced_chi2,
            residual_rms_nm,
            segment_tilts: None,
            phasing_nm,
            ncpa_nm,
            errors,
        })
    }

    /// A deviation of what a loop that is not known answers to pistons, in the NCPA's modes, nm; 0 where it is known.
    fn unknown_answer_nm(&self, coefficients: &Array1<f64>) -> Result<Array1<f64>> {
        let Some((basis, holder)) = &self.smoothing else { return Ok(Array1::zeros(self.at_all.nrows())) };
        let pistons_nm = self.shown(coefficients, 0..self.segments);
        Ok(holder.held(basis, &pistons_nm)?.coefficients_nm * ANSWERED)
    }

    /// Modes that do not show at a sample are NaN nowhere: the pupil's owner says where the map ends.
    fn map(&self, coefficients: &Array1<f64>, range: std::ops::Range<usize>, pupil: &Pupil) -> Array2<f64> {
        outside_to_nan(self.shown(coefficients, range), pupil)
    }

    /// 0 where no mode shows.
    fn shown(&self, coefficients: &Array1<f64>, range: std::ops::Range<usize>) -> Array2<f64> {
        let (_, rows, columns) = self.maps.dim();
        let mut map = Array2::zeros((rows, columns));
        for mode in range {
            map.scaled_add(coefficients[mode], &self.maps.index_axis(Axis(0), mode));
        }
        map
    }

    fn sigma(&self, covariance_nm2: ArrayView2<f64>, range: std::ops::Range<usize>, pupil: &Pupil) -> Array2<f64> {
        let maps = self.maps.slice(s![range, .., ..]);
        let flat: Array2<f64> = Array2::from_shape_fn((maps.dim().0, pupil.amplitude.len()), |(mode, at)| {
            maps[[mode, at / maps.dim().2, at % maps.dim().2]]
        });
        let half = covariance_nm2.dot(&flat);
        let variance = (&half * &flat).sum_axis(Axis(0));
        let n = pupil.amplitude.ncols();
        outside_to_nan(
            Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| variance[y * n + x].max(0.0).sqrt()),
            pupil,
        )
    }
}

/// What an error of the diversity makes of the modes that hold it.
fn shared_nm2(diversity: &HeldDiversity, scene: &Scene) -> Result<Option<Array2<f64>>> {
    let fraction = scene.estimate.diversity_error;
    let left = 100.0 * diversity.outside;
    let remedy = format!("the full-phase estimate's modes leave {left:.0} % of this one, and hold a focus");
    (fraction > 0.0).then(|| diversity.covariance_nm2(fraction, &remedy)).transpose()
}

/// Refuses a scene whose diversity is known to a fraction and is nothing that modes of `family` hold, before any image is
/// read.
///
/// # Errors
/// [`Error::Scene`]; those of making the modes.
pub(crate) fn check_diversity(family: Family, scene: &Scene, telescope: &Telescope) -> Result<()> {
    if scene.estimate.diversity_error > 0.0 {
        let sampled = NcpaModes::of(family, scene, telescope)?.basis.sampled(&telescope.pupil)?;
        shared_nm2(&HeldDiversity::of(scene, telescope, &sampled, 0)?, scene)?;
    }
    Ok(())
}

fn outside_to_nan(mut map: Array2<f64>, pupil: &Pupil) -> Array2<f64> {
    ndarray::Zip::from(&mut map).and(&pupil.owner).for_each(|value, &owner| {
        if owner < 0 {
            *value = f64::NAN;
        }
    });
    map
}
