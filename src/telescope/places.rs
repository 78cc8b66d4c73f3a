//! Place of each segment in the mirror.

use crate::io::Column;
use crate::pupil::Segment;
use crate::scene::Scene;

/// Place of a segment: what identifies it on another numbering than ours.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentPlace {
    /// Number, from 0: ring by ring from the innermost, within a ring counter-clockwise from +x; by ascending label for a pupil from a
    /// file.
    pub number: usize,
    /// Ring, 0 for a central segment; `None` for a pupil from a file.
    pub ring: Option<usize>,
    /// Label in the map of a pupil from a file, or of `pupil.segment_labels`; else the number.
    pub label: i32,
    /// Centre along columns, m.
    pub x_m: f64,
    /// Centre along rows, m.
    pub y_m: f64,
}

impl SegmentPlace {
    /// Places of `segments`, which are those of `scene`.
    pub fn all(scene: &Scene, segments: &[Segment]) -> Vec<Self> {
        let hexagons = scene.pupil.layout().map(|layout| layout.hexagons());
        let place = |(number, segment): (usize, &Segment)| {
            let ring = hexagons.as_ref().and_then(|hexagons| hexagons.get(number)).map(|hexagon| hexagon.ring);
            let Segment { x_m, y_m, label } = *segment;
            Self { number, ring, label, x_m, y_m }
        };
        segments.iter().enumerate().map(place).collect()
    }

    /// Columns `SEGMENT`, `RING` (−1 where it has none), `LABEL`, `X_M` and `Y_M` of a table.
    pub fn columns(places: &[Self]) -> Vec<Column> {
        vec![
            Column::i64("SEGMENT", places.iter().map(|place| place.number as i64).collect()),
            Column::i64("RING", places.iter().map(|place| place.ring.map_or(-1, |ring| ring as i64)).collect()),
            Column::i64("LABEL", places.iter().map(|place| place.label.into()).collect()),
            Column::f64("X_M", "m", places.iter().map(|place| place.x_m).collect()),
            Column::f64("Y_M", "m", places.iter().map(|place| place.y_m).collect()),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
