//! Place of each segment in the mirror.

use crate::io::Column;
use crate::pupil::Segment;
use crate::scene::System;
use crate::{Error, Result};

/// Place of a segment: what identifies it on another numbering than ours.
#[derive(Debug, Clone, PartialEq)]
pub struct SegmentPlace {
    /// Number, from 0: ring by ring from the innermost, within a ring counter-clockwise from +x; by
    /// ascending label for a pupil from a file.
    pub number: usize,
    /// Ring, 0 for a central segment; `None` for a pupil from a file.
    pub ring: Option<usize>,
    /// Label of `pupil.segment_labels`, or in the map of a pupil from a file; else the number.
    pub label: String,
    /// Centre along columns, m.
    pub x_m: f64,
    /// Centre along rows, m.
    pub y_m: f64,
}

impl SegmentPlace {
    /// Places of `segments`, which are those of `scene`.
    pub fn all(scene: &System, segments: &[Segment]) -> Vec<Self> {
        let hexagons = scene.pupil.layout().map(|layout| layout.hexagons());
        let place = |(number, segment): (usize, &Segment)| {
            let ring = hexagons.as_ref().and_then(|hexagons| hexagons.get(number)).map(|hexagon| hexagon.ring);
            let own = scene.pupil.segment_labels.as_ref().and_then(|labels| labels.get(number));
            let label = own.map_or_else(|| segment.label.to_string(), str::to_owned);
            Self { number, ring, label, x_m: segment.x_m, y_m: segment.y_m }
        };
        segments.iter().enumerate().map(place).collect()
    }

    /// The label where it is a number.
    pub fn label_number(&self) -> Option<i64> {
        self.label.parse().ok()
    }

    /// The segment of `places` whose label is `text`.
    ///
    /// # Errors
    /// [`Error::Value`] with the label and those that are accepted.
    pub fn labelled<'a>(places: &'a [Self], text: &str) -> Result<&'a Self> {
        let text = text.trim();
        let number = text.parse::<i64>().ok();
        let is_it = |place: &&Self| place.label == text || number.is_some() && place.label_number() == number;
        places.iter().find(is_it).ok_or_else(|| {
            Error::Value(format!("there is no segment {text}: {} is accepted", Self::listed_labels(places)))
        })
    }

    /// The labels in words: the first and the last of numbers that follow each other, else all.
    pub fn listed_labels(places: &[Self]) -> String {
        let numbers: Option<Vec<i64>> = places.iter().map(Self::label_number).collect();
        match numbers.as_deref() {
            Some([first, .., last]) if last - first + 1 == places.len() as i64 => format!("{first} to {last}"),
            _ => places.iter().map(|place| place.label.as_str()).collect::<Vec<_>>().join(", "),
        }
    }

    /// Columns `SEGMENT`, `RING` (−1 where it has none), `LABEL` (numbers, or text where one is a
    /// word), `X_M` and `Y_M` of a table.
    pub fn columns(places: &[Self]) -> Vec<Column> {
        vec![
            Column::i64("SEGMENT", places.iter().map(|place| place.number as i64).collect()),
            Column::i64("RING", places.iter().map(|place| place.ring.map_or(-1, |ring| ring as i64)).collect()),
            match places.iter().map(Self::label_number).collect::<Option<Vec<i64>>>() {
                Some(numbers) => Column::i64("LABEL", numbers),
                None => Column::text("LABEL", places.iter().map(|place| &place.label)),
            },
            Column::f64("X_M", "m", places.iter().map(|place| place.x_m).collect()),
            Column::f64("Y_M", "m", places.iter().map(|place| place.y_m).collect()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::telescope::Telescope;

    #[test]
    fn rings_are_those_of_the_geometry() {
        for (preset, central) in [("keck", "false"), ("hexagonal", "true")] {
            let scene = Scene::preset("keck-artificial").unwrap();
            let scene = scene
                .with(&[
                    ("pupil.aperture", preset),
                    ("pupil.central_segment", central),
                    ("pupil.rotation_deg", "7"),
                    ("pupil.central_obscuration_m", "0"),
                    ("pupil.grid_m", ""),
                ])
                .unwrap();
            let segments = Telescope::new(&scene).unwrap().pupil.segments;
            let places = SegmentPlace::all(&scene, &segments);
            let pitch = 3f64.sqrt() * scene.pupil.segment_side_m + scene.pupil.segment_gap_m;
            for place in &places {
                // The centres of ring k lie between √3/2·k and k pitches from the axis.
                let (ring, radius) = (place.ring.unwrap() as f64, place.x_m.hypot(place.y_m) / pitch);
                assert!(radius <= ring + 1e-9 && radius >= 0.75f64.sqrt() * ring - 1e-9, "{place:?}");
            }
            assert_eq!(places.last().unwrap().ring, Some(scene.pupil.rings));
        }
    }
}
