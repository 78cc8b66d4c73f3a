//! Full-phase estimate from the exposures of several channels.

use super::channels::{ChannelImages, by_diversity};
use super::control::Control;
use super::estimate::Estimate;
use super::map;
use super::policy::Policy;
use super::sequence_channel::{Sequence, SequenceChannel};
use super::warnings::integers_warning;
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::{Array2, Axis, concatenate};

/// Estimates the static errors behind the exposures of all channels of `scene`.
///
/// # Errors
/// Those of [`map::estimate`].
pub(super) fn estimate(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    channels: &[ChannelImages],
) -> Result<Estimate> {
    let [with, in_focus] = by_diversity(channels);
    let sequences: Vec<_> =
        with.iter().map(|channel| SequenceChannel { scene: &channel.scene, images: &channel.images }).collect();
    let is_simultaneous = scene.image.simultaneous;
    let (slopes_mas, ignored) = telemetry(&with, is_simultaneous)?;
    let slopes_mas = slopes_mas.as_ref();
    let channels = &sequences;
    // One sensor measures the slopes of all channels.
    let moved_reference_mas = with.iter().find_map(|channel| channel.images.moved_reference_mas);
    let found =
        map::estimate(scene, Sequence { channels, is_simultaneous, slopes_mas, moved_reference_mas, policy, control })?;
    let left_out = in_focus.iter().map(|channel| {
        format!(
            "channel {}: it is in focus, where an image does not determine the signs of even aberrations, and was left out: a \
             full-phase estimate reads defocused images",
            channel.name
        )
    });
    let doubtful = integers_warning(&found.integers);
    let warnings = left_out.chain(ignored).chain(found.warnings).chain(doubtful).collect();
    let names = with.iter().map(|channel| channel.name.to_owned()).collect();
    Ok(Estimate { scene: scene.clone(), channels: names, warnings, ..found })
}

/// Slopes of the exposures, where each channel has its own, and a warning where only some have any.
fn telemetry(channels: &[&ChannelImages], is_simultaneous: bool) -> Result<(Option<Array2<f64>>, Option<String>)> {
    let slopes: Vec<_> = channels.iter().filter_map(|channel| channel.images.slopes_mas).collect();
    match slopes[..] {
        [] => Ok((None, None)),
        _ if slopes.len() < channels.len() => {
            Ok((None, Some("only some channels have slopes of the wavefront sensor, and these are ignored".into())))
        }
        // One exposure, one set of slopes.
        [first, ..] if is_simultaneous => Ok((Some(first.clone()), None)),
        _ => {
            let views: Vec<_> = slopes.iter().map(|slopes| slopes.view()).collect();
            let all = concatenate(Axis(0), &views).map_err(|_| {
                Error::Shape("the slopes of the channels differ in number: each needs all of the sensor's".into())
            })?;
            Ok((Some(all), None))
        }
    }
}
