//! Turns of the pupil on the detector, from the cards of raw frames.

use super::frame::RawFrame;
use crate::scene::Scene;

/// Range of a known angle over the frames from which the pupil may have turned: its edge by 1 % of
/// a segment.
const TURNING_DEG: f64 = 0.1;

/// The keyword in a value of `image.pupil_turn_card`, and 1 for an angle that runs
/// counter-clockwise, −1 for the opposite.
pub(super) fn card_and_sense(card: &str) -> (&str, f64) {
    card.strip_prefix('-').map_or((card, 1.0), |card| (card, -1.0))
}

/// Refuses a frame without the angle that `scene` reads.
pub(super) fn check(frame: &RawFrame, scene: &Scene) -> std::result::Result<(), String> {
    match &scene.image.pupil_turn_card {
        Some(card) if frame.header.pupil_angle_deg.is_none() => {
            let (card, _) = card_and_sense(card);
            Err(format!("its header has no number {card}, which image.pupil_turn_card names"))
        }
        _ => Ok(()),
    }
}

/// Turn of the pupil in each of these frames, degrees, within half a turn of 0; `None` where
/// `scene` names no card.
pub(super) fn turns_deg<'a>(scene: &Scene, frames: impl Iterator<Item = &'a RawFrame>) -> Option<Vec<f64>> {
    let (_, sense) = card_and_sense(scene.image.pupil_turn_card.as_deref()?);
    let zero_deg = scene.image.pupil_turn_zero_deg;
    let of = |frame: &RawFrame| {
        let turn_deg = sense * (frame.header.pupil_angle_deg? - zero_deg);
        // Without the noise of the subtraction.
        Some(1e-9 * (1e9 * ((turn_deg + 180.0).rem_euclid(360.0) - 180.0)).round())
    };
    frames.map(of).collect()
}

/// A sentence on a card of the frames by which the pupil may have turned, where the scene says
/// nothing of it.
pub(super) fn unnamed_turn<'a>(scene: &Scene, frames: impl Iterator<Item = &'a RawFrame> + Clone) -> Option<String> {
    if scene.image.pupil_turn_card.is_some() || scene.image.pupil_turns_deg.is_some() {
        return None;
    }
    let cards: Vec<&str> = frames.clone().next()?.header.angles_deg.iter().map(|(card, _)| *card).collect();
    cards.into_iter().find_map(|card| {
        let of = |frame: &RawFrame| frame.header.angles_deg.iter().find(|(own, _)| *own == card).map(|(_, angle_deg)| *angle_deg);
        let angles_deg = frames.clone().map(of).collect::<Option<Vec<f64>>>()?;
        let [least_deg, most_deg] = [f64::min, f64::max].map(|fold| angles_deg.iter().copied().reduce(fold).unwrap_or(0.0));
        (most_deg - least_deg > TURNING_DEG).then(|| {
            format!(
                "the card {card} goes from {least_deg:.2} to {most_deg:.2} degrees over the frames: where the pupil turns on the detector with it, \
                 image.pupil_turn_card = \"{card}\", or \"-{card}\" for the opposite sense, gives each image its own turn"
            )
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sign_is_the_sense_of_the_angle() {
        assert_eq!(card_and_sense("PARANG"), ("PARANG", 1.0));
        assert_eq!(card_and_sense("-ESO TEL PARANG START"), ("ESO TEL PARANG START", -1.0));
    }
}
