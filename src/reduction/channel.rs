//! Channel that a frame of the star belongs to.

use super::frame::RawFrame;
use crate::agreement::Compared;
use crate::io::{HeaderFact, Quantity};
use crate::scene::Scene;

/// Channel that a frame belongs to, by its place; the reason where it belongs to none.
pub(super) fn channel_of(frame: &RawFrame, scene: &Scene, overrides: &[String]) -> std::result::Result<usize, String> {
    let channels = scene.channels();
    let scene_of = |channel: usize| channels.get(channel).map_or(scene, |channel| &channel.scene);
    let disagrees = |channel: usize| contradiction(frame, scene_of(channel), overrides);
    if channels.is_empty() {
        return disagrees(0).map_or(Ok(0), Err);
    }
    let names = || channels.iter().map(|channel| channel.name.as_str()).collect::<Vec<_>>().join(", ");
    if let Some(name) = &frame.channel {
        let found = channels.iter().position(|channel| channel.name == *name);
        let channel = found.ok_or_else(|| format!("the scene has no channel {name}: there are {}", names()))?;
        return disagrees(channel).map_or(Ok(channel), Err);
    }
    let agreeing: Vec<usize> = (0..channels.len()).filter(|&channel| disagrees(channel).is_none()).collect();
    let has_wavelength = frame.header.facts.iter().any(is_wavelength);
    match agreeing.as_slice() {
        [only] if has_wavelength => Ok(*only),
        [] => {
            let first = disagrees(0).unwrap_or_default();
            Err(format!("its header is that of none of the channels {}: {first}", names()))
        }
        _ => {
            Err(format!("its header does not say which of the channels {} it is of (--channel NAME=PATTERN)", names()))
        }
    }
}

/// How the cards of a frame contradict a scene, in what an estimate compares with the images that
/// are made of it: noise and gain are the reduction's own.
fn contradiction(frame: &RawFrame, scene: &Scene, overrides: &[String]) -> Option<String> {
    let quantities = [Quantity::WavelengthNm, Quantity::BandNm, Quantity::PixelMas, Quantity::ExposureS];
    quantities.into_iter().find_map(|quantity| {
        let compared = Compared::new(scene, quantity)?;
        let is_open = !overrides.iter().any(|known| known == compared.key);
        let found = compared.disagreement(&frame.header.facts).filter(|_| is_open)?;
        let (key, value) = (compared.key, compared.of_key(compared.value));
        Some(format!("{} where the scene has {key} = {value} (--set {key}={value} keeps the scene's)", found.card))
    })
}

fn is_wavelength(fact: &HeaderFact) -> bool {
    matches!(fact.quantity, Quantity::WavelengthNm | Quantity::BandNm)
}
