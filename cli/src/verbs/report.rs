//! An estimate in words and numbers: the table, the warnings, the JSON.

use super::figures::Row;
use cophase::estimate::{Estimate, Estimator, FittedOptic, HeldDiversity, ImageReport, Model, Status};
use cophase::io::Images;
use cophase::scene::{Combine, Scene};
use serde::Serialize;

/// Images named one by one in a warning; the others are counted.
const NAMED_IMAGES: usize = 3;
/// Modes named likewise.
const NAMED_MODES: usize = 6;

/// `1 image`, `2 images`.
pub fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// What `estimate --json` prints; scripts rely on these keys.
#[derive(Serialize)]
pub struct Summary {
    images: usize,
    used: usize,
    clipped: usize,
    combine: &'static str,
    seconds: f64,
    phasing_rms_nm: f64,
    ncpa_rms_nm: f64,
    phasing_sigma_nm: f64,
    ncpa_sigma_nm: f64,
    reduced_chi2: f64,
    evaluations: usize,
    device: String,
    precision: &'static str,
    status: &'static str,
}

impl Summary {
    pub fn of(estimate: &Estimate, [phasing, ncpa, _]: &[Row; 3]) -> Self {
        Self {
            images: estimate.images.len(),
            used: estimate.used(),
            clipped: estimate.clipped_images.len(),
            combine: estimate.combine.word(),
            seconds: estimate.seconds,
            phasing_rms_nm: phasing.rms_nm,
            ncpa_rms_nm: ncpa.rms_nm,
            phasing_sigma_nm: phasing.sigma_nm,
            ncpa_sigma_nm: ncpa.sigma_nm,
            reduced_chi2: estimate.reduced_chi2(),
            evaluations: evaluations(estimate),
            device: estimate.device.clone(),
            precision: estimate.precision,
            status: estimate.status().word(),
        }
    }
}

fn evaluations(estimate: &Estimate) -> usize {
    estimate.images.iter().map(|image| image.evaluations).sum()
}

/// The table for people.
pub fn table(name: &str, model: &Model, estimate: &Estimate, rows: &[Row; 3], model_s: f64) -> String {
    let modes = model.basis.len();
    let mut text = format!(
        "{name}: {}, {modes} modes ({} of the segments, {} of the NCPA)\n\n",
        combination(estimate),
        model.segment_modes,
        modes - model.segment_modes
    );
    let known = rows[0].residual_nm.is_some();
    let residual = if known { "   residual [nm]" } else { "" };
    text += &format!("{:<12}{:>10}{:>12}{residual}\n", "", "RMS [nm]", "1σ [nm]");
    for Row { name, rms_nm, sigma_nm, residual_nm } in rows {
        let residual = residual_nm.map(|nm| format!("{nm:>16.3}")).unwrap_or_default();
        text += &format!("{name:<12}{rms_nm:>10.3}{sigma_nm:>12.3}{residual}\n");
    }
    let masked: usize = estimate.images.iter().map(|image| image.bad_pixels).sum();
    let masked = if masked > 0 { format!(", {} masked", counted(masked, "pixel")) } else { String::new() };
    let cut: usize = estimate.images.iter().map(|image| image.cut_pixels).sum();
    let masked = if cut > 0 { format!("{masked}, {} that stood out cut", counted(cut, "pixel")) } else { masked };
    let error_bars = if estimate.is_sequence() { " Error bars from the scatter between images." } else { "" };
    text + &format!(
        "\nRMS over the pupil, tip and tilt removed. Reduced χ² {:.3}{masked}.{error_bars}\n{} in {:.2} s on {} in {}; the model took {model_s:.2} s.\n",
        estimate.reduced_chi2(),
        counted(evaluations(estimate), "evaluation"),
        estimate.seconds,
        estimate.device,
        estimate.precision,
    )
}

/// How many images became the estimate, and how.
fn combination(estimate: &Estimate) -> String {
    let all = counted(estimate.images.len(), "image");
    let used = estimate.used();
    if estimate.images.len() == 1 {
        return format!("{used} of {all} used");
    }
    let how = match estimate.combine {
        Combine::Median => "median",
        Combine::ClippedMean if estimate.is_sequence() => "clipped mean",
        Combine::Mean | Combine::ClippedMean => "mean",
    };
    match estimate.clipped_images.len() {
        0 => format!("{how} of {used} of {all}"),
        clipped => format!("{how} of {used} of {all} ({clipped} clipped)"),
    }
}

/// What a person should know of the file that was read.
pub fn file_warnings(name: &str, images: &Images) -> Vec<String> {
    let repaired = images.repaired.as_ref().map(|sentence| format!("{name}: {sentence}"));
    let non_finite = (images.non_finite > 0).then(|| {
        let (are, were) = if images.non_finite == 1 { ("is", "was") } else { ("are", "were") };
        format!("{name}: {} {are} not finite and {were} masked", counted(images.non_finite, "pixel"))
    });
    repaired.into_iter().chain(non_finite).collect()
}

/// The optics that were fitted, one a line.
pub fn of_optics(optics: &[FittedOptic]) -> String {
    let line = |optic: &FittedOptic| {
        let FittedOptic { scene, value, sigma, .. } = optic;
        if optic.is_told() {
            format!("{} = {value:.6} ± {sigma:.1e} (the scene says {scene})\n", optic.key())
        } else {
            format!("{} = {value} (the scene says {scene}): not told, the modes do all that it does\n", optic.key())
        }
    };
    optics.iter().map(line).collect()
}

/// What holds of every image of this scene: what it can and cannot say of the diversity.
pub fn of_diversity(held: &HeldDiversity, scene: &Scene) -> Option<String> {
    (held.is_held() && scene.estimate.diversity_error == 0.0).then(|| {
        format!(
            "The NCPA count from the scene's diversity: 1 % more of it would read as {:.1} nm of them \
             (estimate.diversity_error is for the error bars).\n",
            0.01 * held.rms_nm
        )
    })
}

/// What a person should know of the estimate.
pub fn warnings(name: &str, estimator: &Estimator, held: &HeldDiversity, estimate: &Estimate) -> Vec<String> {
    let model = estimator.model();
    let mut sentences: Vec<String> = estimate.device_failure.iter().map(|reason| format!("{name}: {reason}")).collect();
    sentences.extend(held.warning(estimator.scene().image.wavelength_nm));
    for optic in estimator.fitted_optics().iter().filter(|optic| !optic.is_told()) {
        let (word, key) = (optic.optic.word(), optic.key());
        sentences.push(format!(
            "estimate.fit_optics names \"{word}\", which these images do not tell from the modes: {key} stays {}, and the error \
             bars do not hold its error",
            optic.value
        ));
    }
    let together = about_sequence(estimate);
    for word in ["unusable", "not-converged", "wrong-minimum", "misfit"] {
        if word == "misfit"
            && let Some(sentence) = &together
        {
            sentences.push(format!("{name}: {sentence}"));
            continue;
        }
        let concerned: Vec<(usize, &ImageReport)> =
            estimate.images.iter().enumerate().filter(|(_, image)| image.status.word() == word).collect();
        let several = estimate.images.len() > 1;
        for (index, image) in concerned.iter().take(NAMED_IMAGES) {
            let which =
                if several { format!(" image {} of {}", index + 1, estimate.images.len()) } else { String::new() };
            sentences.extend(
                about_image(image, estimate.used_images.contains(index))
                    .map(|sentence| format!("{name}{which}: {sentence}")),
            );
        }
        if concerned.len() > NAMED_IMAGES {
            let more = counted(concerned.len() - NAMED_IMAGES, "more image");
            sentences.push(format!("{name}: the same holds for {more} ({word}); see table IMAGES of the output"));
        }
    }
    if !model.dropped.is_empty() {
        let dropped = counted(model.dropped.len(), "mode");
        sentences.push(format!("{dropped} left out, for the others span them: {}", listed(&model.dropped)));
    }
    for direction in estimate.degeneracy.null.iter().filter(|direction| !direction.is_global_piston()) {
        let what = &direction.description;
        sentences.push(format!("the images do not see this direction at all, and 0 is reported for it: {what}"));
    }
    sentences
}

/// What holds for a sequence as a whole, said once: that its typical image misfits.
fn about_sequence(estimate: &Estimate) -> Option<String> {
    let misfits = estimate.images.iter().filter(|image| image.status == Status::Misfit).count();
    if !estimate.is_sequence() || 2 * misfits <= estimate.used() {
        return None;
    }
    let chi2 = estimate.reduced_chi2();
    Some(format!(
        "the residual is {:.1} times the noise in the typical image (median reduced χ² {chi2:.1}): a wavefront that \
         changes from image to image and that the modes do not span, as behind adaptive optics, or a scene that differs \
         from the instrument; error bars are from the scatter between images, and do not know what all images share",
        chi2.sqrt()
    ))
}

fn about_image(image: &ImageReport, used: bool) -> Option<String> {
    let chi2 = image.reduced_chi2;
    match &image.status {
        Status::Ok => None,
        Status::Misfit => Some(format!(
            "the residual is {:.1} times the noise (reduced χ² {chi2:.1}): the modes do not span what is there, or the \
             scene differs from the instrument; error bars are scaled up by as much",
            chi2.sqrt()
        )),
        Status::WrongMinimum => Some(format!(
            "reduced χ² is {chi2:.0}: the fit is probably in a wrong minimum, or wavelength, diversity or orientation \
             of the scene are not the image's"
        )),
        Status::NotConverged(reason) if used => Some(format!(
            "the fit did not converge ({reason}), and there is no better image: these maps are no estimate"
        )),
        Status::NotConverged(reason) => Some(format!("left out, the fit did not converge ({reason})")),
        Status::Unusable(reason) => Some(format!("left out, {reason}")),
    }
}

fn listed(names: &[String]) -> String {
    let first = names[..names.len().min(NAMED_MODES)].join(", ");
    if names.len() > NAMED_MODES { format!("{first} and {} more", names.len() - NAMED_MODES) } else { first }
}
