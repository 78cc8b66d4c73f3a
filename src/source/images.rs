//! Simulation of images of an artificial source.

use super::camera::{Camera, expose, flux_e};
use super::random::stream;
use super::truth::Truth;
use crate::scene::System;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3};

/// Random number streams from one channel to the next: more than it has images. Those of the images
/// begin at 1 above a multiple of it.
const CHANNEL_STREAMS: u64 = 1 << 32;

/// Simulated images with their truth.
pub struct SourceImages {
    /// Electrons, `[image, y, x]`.
    pub images_e: Array3<f64>,
    /// Electrons of the star in each image.
    pub flux_e: f64,
    /// Aberrations in the images.
    pub truth: Truth,
}

/// Simulates the images of each channel of `scene`, in order, or of the only one: one draw of
/// aberrations, which all channels have, `image.count` draws of noise. The same scene gives
/// bit-identical images.
///
/// # Errors
/// Those of building the telescope; [`Error::File`] for a map that cannot be read; [`Error::Scene`]
/// for aberrations that drift, which needs the time axis of an AO simulation.
pub fn simulate(scene: &System) -> Result<Vec<SourceImages>> {
    simulate_with(scene, &|truth, _, _| Ok(truth))
}

/// A change of the aberrations that a scene and its telescope have.
pub type ChangeOfTruth<'a> = dyn Fn(Truth, &System, &Telescope) -> Result<Truth> + 'a;

/// As [`simulate`], with aberrations that `change` makes of those that were drawn, such as what
/// corrections leave of them.
///
/// # Errors
/// As [`simulate`], and those of `change`.
pub fn simulate_with(scene: &System, change: &ChangeOfTruth) -> Result<Vec<SourceImages>> {
    match scene.channels() {
        [] => Ok(vec![simulate_channel(scene, 0, change)?]),
        channels => {
            let each = channels.iter().enumerate();
            each.map(|(number, channel)| simulate_channel(&channel.system, number as u64, change)).collect()
        }
    }
}

/// Images of the channel `number`, whose scene this is.
fn simulate_channel(scene: &System, number: u64, change: &ChangeOfTruth) -> Result<SourceImages> {
    if scene.faults.drift_nm_per_min > 0.0 {
        return Err(Error::Scene(format!(
            "{}: faults.drift_nm_per_min = {} has no meaning for images of an artificial source; 0 is accepted",
            scene.name(),
            scene.faults.drift_nm_per_min
        )));
    }
    let telescope = Telescope::new(scene)?;
    let seed = scene.seed();
    let truth = change(Truth::draw(scene, &telescope, &mut stream(seed, 0))?, scene, &telescope)?;
    let turns_deg = of_each(scene, "pupil_turns_deg", scene.image.pupil_turns_deg.as_deref())?;
    let planes = of_each(scene, "diversity_planes", scene.image.diversity_planes.as_deref())?;
    let of_image = |image: usize| {
        scene.with(|sections| {
            if let Some(turn_deg) = turns_deg.get(image) {
                sections.image.pupil_turns_deg = Some(vec![*turn_deg]);
            }
            if let Some(plane) = planes.get(image) {
                sections.image.diversity_planes = Some(vec![*plane]);
            }
        })
    };
    let first = of_image(0)?;
    let mut psf = psf_of(&first, &Telescope::new(&first)?, &truth)?;
    let (rows, columns) = psf.dim();
    let mut images_e = Array3::zeros((scene.image.count, rows, columns));
    let flux_e = flux_e(&scene.image, psf.iter().copied().fold(0.0, f64::max));
    for (image, mut out) in images_e.outer_iter_mut().enumerate() {
        if image > 0 && (turns_deg.len() > image || planes.len() > image) {
            let own = of_image(image)?;
            psf = psf_of(&own, &Telescope::new(&own)?, &truth)?;
        }
        let mut rng = stream(seed, number * CHANNEL_STREAMS + 1 + image as u64);
        out.zip_mut_with(&psf, |out, &h| *out = expose(&scene.image, h, flux_e, &mut rng));
    }
    Ok(SourceImages { images_e, flux_e, truth })
}

/// The values of a list of `[image]`, one for each image; none where all images have one value.
fn of_each<'a, T>(scene: &System, key: &str, list: Option<&'a [T]>) -> Result<&'a [T]> {
    match list {
        Some(list) if list.len() != 1 && list.len() != scene.image.count => Err(Error::Scene(format!(
            "{}: image.{key} has {} numbers where image.count = {}; one, or one for each image, is needed",
            scene.name(),
            list.len(),
            scene.image.count
        ))),
        Some(list @ [_, _, ..]) => Ok(list),
        _ => Ok(&[]),
    }
}

/// The PSF of `scene` with these aberrations.
fn psf_of(scene: &System, telescope: &Telescope, truth: &Truth) -> Result<Array2<f64>> {
    Camera::new(scene, telescope)?.psf(truth)
}
