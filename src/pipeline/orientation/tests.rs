//! Every orientation of a segment's and of an actuator's poke is found, also where the pupil is
//! rotated.

use super::*;
use ndarray::Array2;

fn scene(rotation_deg: &str) -> Scene {
    let settings = [("pupil.grid_m", "11.5"), ("pupil.samples", "96"), ("pupil.rotation_deg", rotation_deg)];
    Scene::preset("keck-artificial").unwrap().with(&settings).unwrap()
}

/// The pokes: off every symmetry axis of the pupil, so that no two orientations give the same map.
fn pokes(telescope: &Telescope, scene: &Scene) -> [Poke; 2] {
    let off_axis = |x_m: f64, y_m: f64| {
        let angle = y_m.atan2(x_m).to_degrees() - scene.pupil.rotation_deg;
        // The axes are 30 degrees apart, and an actuator or a segment is a tenth of the pupil.
        (angle.rem_euclid(30.0) - 15.0).abs() < 6.0 && x_m.hypot(y_m) > 2.5 && x_m.hypot(y_m) < 4.3
    };
    let segment = telescope.pupil.segments.iter().position(|segment| off_axis(segment.x_m, segment.y_m)).unwrap();
    let influence = crate::ao::actuators_in_use(scene, telescope).unwrap();
    let actuator = influence.positions_m().iter().position(|&(x_m, y_m)| off_axis(x_m, y_m)).unwrap();
    [Poke::Segment(segment, 120.0), Poke::Actuator(actuator, -120.0)]
}

#[test]
#[ignore = "merge: 6 s"]
fn every_orientation_of_a_poke_is_found() {
    for rotation_deg in ["0", "7"] {
        let scene = scene(rotation_deg);
        let telescope = Telescope::new(&scene).unwrap();
        let pupil = &telescope.pupil;
        for poke in pokes(&telescope, &scene) {
            let expected = ExpectedMap::new(&scene, &telescope, poke).unwrap();
            let (mut tried, modes) = (0, 60);
            // Something else that changes between the images: a tenth of the poke.
            let other =
                Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| 5.0 * ((x * x + 3 * y) as f64 / 90.0).sin());
            for rotation_deg in [0.0, 60.0, -60.0] {
                for flip in [[false, false], [true, false], [false, true], [true, true]] {
                    for sign in [1.0, -1.0] {
                        let map_nm = expected.map_nm(pupil, flip, rotation_deg).unwrap();
                        let difference_nm = pupil.remove_piston_tip_tilt((&map_nm * sign + &other).view()).unwrap();
                        let candidates = expected.candidates(pupil, &scene, &difference_nm, modes).unwrap();
                        let moved = expected.moved(pupil, &difference_nm, modes).unwrap();
                        let found = selected(candidates, moved, &expected, pupil, &scene, false).unwrap();
                        let PokeResult::Orientation(found) = found else { panic!("{found:?}") };
                        let best = found.best;
                        assert_eq!((best.flip, best.rotation_deg, best.sign), (flip, rotation_deg, sign), "{poke:?}");
                        assert!(best.correlation > 0.8 && found.equivalent.is_empty(), "{found:?}");
                        tried += 1;
                    }
                }
            }
            assert_eq!(tried, 24);
        }
    }
}

/// 9 was stated, which no symmetry of the pupil turns into the segment that moved, its neighbour 8.
#[test]
fn wrong_segment_number_is_named() {
    let scene = scene("-17.1");
    let telescope = Telescope::new(&scene).unwrap();
    let pupil = &telescope.pupil;
    let [stated, moved] = [9, 8].map(|index| ExpectedMap::new(&scene, &telescope, Poke::Segment(index, 90.0)).unwrap());
    let difference_nm = moved.map_nm(pupil, [false; 2], 0.0).unwrap();
    let answer = |expected: &ExpectedMap| {
        let candidates = expected.candidates(pupil, &scene, &difference_nm, 60).unwrap();
        let moved = expected.moved(pupil, &difference_nm, 60).unwrap();
        selected(candidates, moved, expected, pupil, &scene, false).unwrap()
    };
    let found = answer(&stated);
    let PokeResult::OtherPart(sentence) = &found else { panic!("{found:?}") };
    assert!(sentence.starts_with("segment 8 moved") && sentence.contains("the poke of segment 9"), "{sentence}");
    let found = answer(&moved);
    let PokeResult::Orientation(found) = &found else { panic!("{found:?}") };
    assert!(found.settings.is_empty() && found.moved.as_ref().is_some_and(|moved| moved.is_stated), "{found:?}");
}

#[test]
fn a_quarter_turn_is_undone() {
    let image = Array3::from_shape_fn((1, 6, 6), |(_, y, x)| (10 * y + x) as f64);
    let images = Images::new(image.clone());
    let four = (0..4).fold(images, |images, _| turned(&images));
    // Row and column 0 have no partner behind the axis at pixel 3.
    for ((_, y, x), bad) in four.bad.indexed_iter() {
        assert_eq!(*bad, y == 0 || x == 0, "{y} {x}");
        assert!(*bad || four.images_e[[0, y, x]] == image[[0, y, x]]);
    }
}
