//! An estimate as a picture.

use cophase::Result;
use cophase::Status;
use cophase::modal::Model;
use cophase::modes::Group;
use cophase::pipeline::{Comparison, Estimate, Figure, StaticMaps};
use cophase_view::plot::{EstimatePicture, ImageTriple, MapRms, MapTriple, ModalBars, ModeGroup};
use cophase_view::terminal::counted;
use ndarray::Array2;

/// The picture of `estimate`, made from the file `name`.
pub fn picture(name: &str, estimate: &Estimate) -> Result<EstimatePicture> {
    let truth = estimate.truth.as_ref();
    let triple =
        |map: &Array2<f64>, sigma: &Array2<f64>, part: &dyn Fn(&StaticMaps, &Comparison) -> [Array2<f64>; 2]| {
            let [truth, residual] = truth.map(|(truth, residual)| part(truth, residual).map(Some)).unwrap_or_default();
            MapTriple {
                estimate: map.clone(),
                // Beside a residual only a figure would be left of it: the subtitle has the one
                // that the table has.
                sigma: truth.is_none().then(|| sigma.clone()),
                truth,
                residual,
                width_m: estimate.pupil.grid.width_m(),
                rms: MapRms::default(),
            }
        };
    let [phasing_rms, ncpa_rms] = rms(estimate)?;
    Ok(EstimatePicture {
        title: format!("Phasing and NCPA from {name}"),
        subtitle: subtitle(estimate),
        phasing: MapTriple {
            rms: phasing_rms,
            ..triple(&estimate.maps.phasing_nm, &estimate.sigma_maps.phasing_nm, &|truth, residual| {
                [truth.phasing_nm.clone(), residual.maps.phasing_nm.clone()]
            })
        },
        ncpa: MapTriple {
            rms: ncpa_rms,
            ..triple(&estimate.maps.ncpa_nm, &estimate.sigma_maps.ncpa_nm, &|truth, residual| {
                [truth.ncpa_nm.clone(), residual.maps.ncpa_nm.clone()]
            })
        },
        bars: bars(estimate)?,
        images: images(estimate),
    })
}

/// The first image of each channel.
fn images(estimate: &Estimate) -> Vec<ImageTriple> {
    let name = |number: usize| estimate.channels.get(number).cloned().unwrap_or_default();
    let compared = estimate.modal().map_or(&[][..], |modal| &modal.compared);
    let each = compared.iter().enumerate().map(|(number, compared)| ImageTriple {
        name: name(number),
        data: compared.data_e.clone(),
        model: compared.model_e.clone(),
        residual_in_sigma: compared.residual_sigma.clone(),
    });
    each.collect()
}

/// The figures above the maps of phasing and NCPA: those of the report, over the pupil's weight,
/// tip and tilt removed.
fn rms(estimate: &Estimate) -> Result<[MapRms; 2]> {
    let truth = estimate.truth.as_ref();
    let of_truth = |map: &Array2<f64>| {
        let pupil = &estimate.pupil;
        pupil.rms(pupil.remove_piston_tip_tilt(map.view())?.view())
    };
    let figures = |part: usize, figure: Figure, truth_nm: Option<f64>| MapRms {
        estimate_nm: Some(figure.rms_nm),
        truth_nm,
        residual_nm: truth.map(|(_, residual)| residual.rms_nm[part]),
        sigma_nm: Some(figure.sigma_nm),
    };
    let phasing_nm = truth.map(|(truth, _)| of_truth(&truth.phasing_nm)).transpose()?;
    let ncpa_nm = truth.map(|(truth, _)| of_truth(&truth.ncpa_nm)).transpose()?;
    Ok([figures(0, estimate.figures.phasing, phasing_nm), figures(1, estimate.figures.ncpa, ncpa_nm)])
}

/// A line for an estimate that is not sound: its status, and the first of its warnings.
fn doubt(estimate: &Estimate) -> Option<String> {
    let status = (estimate.status != Status::Ok).then(|| format!("status {}", estimate.status.word()));
    let first = estimate.warnings.first().map(|first| match estimate.warnings.len() {
        1 => first.clone(),
        count => format!("{count} warnings, the first: {first}"),
    });
    let parts: Vec<String> = status.into_iter().chain(first).collect();
    (!parts.is_empty()).then(|| format!("Warning: {}", parts.join("; ")))
}

fn subtitle(estimate: &Estimate) -> Vec<String> {
    let residuals_nm = estimate.truth.as_ref().map(|(_, residual)| residual.rms_nm);
    let part = |i: usize, name: &str, Figure { rms_nm, sigma_nm }: Figure| {
        let residual = residuals_nm.map(|nm| format!(", residual {:.2}", nm[i])).unwrap_or_default();
        format!("{name} {rms_nm:.2} nm RMS (1σ {sigma_nm:.2}{residual})")
    };
    let method = match estimate.full_phase() {
        None => String::new(),
        Some(map) => format!(
            ", {}, AO knowledge \"{}\", {}",
            estimate.method.word(),
            map.ao_knowledge.word(),
            counted(map.iterations.len(), "iteration")
        ),
    };
    let how = format!(
        "{} of {} used, {} nm{method}, reduced χ² {:.2}, {:.2} s on {} in {}",
        estimate.used(),
        counted(estimate.images.len(), "image"),
        estimate.scene.image.wavelength_nm,
        estimate.reduced_chi2,
        estimate.run.seconds,
        estimate.run.device,
        estimate.run.precision
    );
    let (phasing, ncpa) = (part(0, "phasing", estimate.figures.phasing), part(1, "NCPA", estimate.figures.ncpa));
    let figures = format!("{phasing}, {ncpa}, tip and tilt removed");
    [figures, how].into_iter().chain(doubt(estimate)).collect()
}

fn bars(estimate: &Estimate) -> Result<ModalBars> {
    let group = |group: &Group| match group {
        Group::Segment => ModeGroup::Segment,
        Group::Ncpa => ModeGroup::Ncpa,
    };
    let known = estimate.modal().zip(estimate.truth.as_ref());
    Ok(ModalBars {
        names: estimate.basis.names.iter().map(|name| short(name)).collect(),
        groups: estimate.basis.groups.iter().map(group).collect(),
        estimate_nm: estimate.modes.coefficients_nm.clone(),
        sigma_nm: estimate.modes.sigma_nm(),
        truth_nm: known.map(|(modal, (truth, _))| true_coefficients(modal.fitter.model(), truth)).transpose()?,
    })
}

/// `segment-07-piston` as `piston 7`, `noll-4` as `noll 4`: the picture makes the words before the
/// numbers the label of the axis.
fn short(name: &str) -> String {
    let parts = name.strip_prefix("segment-").and_then(|rest| rest.split_once('-'));
    let numbered = parts.and_then(|(number, motion)| Some((number.parse::<usize>().ok()?, motion)));
    let plain = || name.replace("noll-", "noll ").replace("kl-", "kl ");
    numbered.map_or_else(plain, |(number, motion)| format!("{motion} {number}"))
}

/// Each mode's part in the truth, nm: its product with the true map over the pupil, over that with
/// itself. That is the coefficient where the modes of a group are orthogonal, as segments, exact
/// Zernikes and Karhunen-Loève modes are; elsewhere the picture has no truth for them (NaN).
fn true_coefficients(model: &Model, truth: &StaticMaps) -> Result<Vec<f64>> {
    let amplitude = &model.telescope.pupil.amplitude;
    let weighted = |truth_nm: &Array2<f64>| {
        let part = |at: (usize, usize)| if amplitude[at] > 0.0 { truth_nm[at] * amplitude[at] } else { 0.0 };
        Array2::from_shape_fn(amplitude.dim(), part)
    };
    let basis = &model.basis;
    let gram = basis.gram(amplitude)?;
    let orthogonal = |group: Group| {
        // Next to each other is where a basis that is not orthogonal shows: as good as all pairs,
        // at their root's cost.
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
