//! An estimate as a picture.

use super::figures::{Residual, Row};
use crate::files::Truth;
use cophase::Result;
use cophase::estimate::{Estimate, Model};
use cophase::modes::Group;
use cophase::scene::Scene;
use cophase_cli::plot::{EstimatePicture, ImageTriple, MapTriple, ModalBars, ModeGroup};
use ndarray::Array2;

/// Where the truth is known, it comes with the residual.
pub type Known<'a> = Option<(&'a Truth, &'a Residual)>;

/// The picture of `estimate`, made from the file `name`.
pub fn picture(
    name: &str,
    scene: &Scene,
    model: &Model,
    estimate: &Estimate,
    rows: &[Row; 3],
    known: Known,
) -> Result<EstimatePicture> {
    let pupil = &model.telescope.pupil;
    let triple = |estimate: &Array2<f64>, sigma: &Array2<f64>, truth: Option<(&Array2<f64>, &Array2<f64>)>| MapTriple {
        estimate: estimate.clone(),
        truth: truth.map(|(truth, _)| truth.clone()),
        residual: truth.map(|(_, residual)| residual.clone()),
        // Beside a residual only a figure would be left of it: the subtitle has the one that the table has.
        sigma: truth.is_none().then(|| sigma.clone()),
        width_m: pupil.grid.width_m(),
    };
    let phasing = known.map(|(truth, residual)| (&truth.phasing_nm, &residual.phasing_nm));
    let ncpa = known.map(|(truth, residual)| (&truth.ncpa_nm, &residual.ncpa_nm));
    let compared = &estimate.compared;
    Ok(EstimatePicture {
        title: format!("Phasing and NCPA from {name}"),
        subtitle: subtitle(scene, estimate, rows),
        phasing: triple(&estimate.phasing_nm, &estimate.phasing_sigma_nm, phasing),
        ncpa: triple(&estimate.ncpa_nm, &estimate.ncpa_sigma_nm, ncpa),
        bars: bars(model, estimate, known.map(|(truth, _)| truth))?,
        image: Some(ImageTriple {
            data: compared.data_e.clone(),
            model: compared.model_e.clone(),
            residual_in_sigma: compared.residual_sigma.clone(),
        }),
    })
}

fn subtitle(scene: &Scene, estimate: &Estimate, [phasing, ncpa, _]: &[Row; 3]) -> Vec<String> {
    let part = |row: &Row| {
        let residual = row.residual_nm.map(|nm| format!(", residual {nm:.2}")).unwrap_or_default();
        format!("{} {:.2} nm RMS (1σ {:.2}{residual})", row.name, row.rms_nm, row.sigma_nm)
    };
    let how = format!(
        "{} of {} used, {} nm, reduced χ² {:.2}, {:.2} s on {} in {}",
        estimate.used(),
        super::report::counted(estimate.images.len(), "image"),
        scene.image.wavelength_nm,
        estimate.reduced_chi2(),
        estimate.seconds,
        estimate.device,
        estimate.precision
    );
    vec![format!("{}, {}, tip and tilt removed", part(phasing), part(ncpa)), how]
}

fn bars(model: &Model, estimate: &Estimate, truth: Option<&Truth>) -> Result<ModalBars> {
    let group = |group: &Group| match group {
        Group::Segment => ModeGroup::Segment,
        Group::Ncpa => ModeGroup::Ncpa,
    };
    Ok(ModalBars {
        names: model.basis.names().iter().map(|name| short(name)).collect(),
        groups: model.basis.groups().iter().map(group).collect(),
        estimate_nm: estimate.combined.coefficients_nm.clone(),
        sigma_nm: estimate.combined.sigma_nm(),
        truth_nm: truth.map(|truth| true_coefficients(model, truth)).transpose()?,
    })
}

/// `segment-07-piston` as `piston 7`: the picture makes the words before the numbers the label of the axis.
fn short(name: &str) -> String {
    let parts = name.strip_prefix("segment-").and_then(|rest| rest.split_once('-'));
    let numbered = parts.and_then(|(number, motion)| Some((number.parse::<usize>().ok()?, motion)));
    numbered.map_or_else(|| name.to_string(), |(number, motion)| format!("{motion} {number}"))
}

/// Each mode's part in the truth, nm: its product with the true map over the pupil, over that with itself. That is the
/// coefficient where the modes of a group are orthogonal, as segments, exact Zernikes and Karhunen-Loève modes are;
/// elsewhere the picture has no truth for them (NaN).
fn true_coefficients(model: &Model, truth: &Truth) -> Result<Vec<f64>> {
    let amplitude = &model.telescope.pupil.amplitude;
    let weighted = |truth_nm: &Array2<f64>| {
        let part = |at: (usize, usize)| if amplitude[at] > 0.0 { truth_nm[at] * amplitude[at] } else { 0.0 };
        Array2::from_shape_fn(amplitude.dim(), part)
    };
    let basis = &model.basis;
    let gram = basis.gram(amplitude)?;
    let orthogonal = |group: Group| {
        // Next to each other is where a basis that is not orthogonal shows: as good as all pairs, at their root's cost.
        let modes = model.modes_of(group);
        modes.clone().zip(modes.skip(1)).all(|(a, b)| gram[[a, b]].abs() < 1e-3 * (gram[[a, a]] * gram[[b, b]]).sqrt())
    };
    let coefficients = |(group, truth_nm): (Group, &Array2<f64>)| -> Result<Vec<f64>> {
        let (along, clean) = (basis.along(&weighted(truth_nm))?, orthogonal(group));
        let coefficient = |mode: usize| if clean { along[mode] / gram[[mode, mode]] } else { f64::NAN };
        Ok(model.modes_of(group).map(coefficient).collect())
    };
    let mut all = coefficients((Group::Segment, &truth.phasing_nm))?;
    all.extend(coefficients((Group::Ncpa, &truth.ncpa_nm))?);
    Ok(all)
}
