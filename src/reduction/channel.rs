//! Channel that a frame of the star belongs to.

use super::frame::Frame;
use crate::io::{HeaderFact, Quantity};
use crate::scene::Scene;

/// Channel that a frame belongs to, by its place; the reason where it belongs to none.
pub(super) fn channel_of(frame: &Frame, scene: &Scene, overrides: &[String]) -> std::result::Result<usize, String> {
    let channels = scene.channels();
    let scene_of = |channel: usize| channels.get(channel).map_or(scene, |channel| &channel.scene);
    let disagrees = |channel: usize| wavelength_contradiction(frame, scene_of(channel), overrides);
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
        [] => Err(format!("its wavelength is that of none of the channels {}", names())),
        _ => {
            Err(format!("its header does not say which of the channels {} it is of (--channel NAME=PATTERN)", names()))
        }
    }
}

/// How the wavelength or the filter of a frame contradicts a scene.
fn wavelength_contradiction(frame: &Frame, scene: &Scene, overrides: &[String]) -> Option<String> {
    let key = "image.wavelength_nm";
    if overrides.iter().any(|known| known == key) {
        return None;
    }
    let contradiction = |quantity: Quantity| {
        let facts: Vec<&HeaderFact> = frame.header.facts.iter().filter(|fact| fact.quantity == quantity).collect();
        let first = facts.first()?;
        let agrees = facts.iter().any(|fact| fact.agrees(scene.image.wavelength_nm));
        let wavelength_nm = scene.image.wavelength_nm;
        (!agrees)
            .then(|| format!("card {} = {} where the scene has {key} = {wavelength_nm}", first.keyword, first.written))
    };
    contradiction(Quantity::WavelengthNm).or_else(|| contradiction(Quantity::BandNm))
}

fn is_wavelength(fact: &HeaderFact) -> bool {
    matches!(fact.quantity, Quantity::WavelengthNm | Quantity::BandNm)
}
