//! Hexagons in rings: the layout of a segmented mirror.

use std::f64::consts::TAU;

/// Layout of hexagons in rings about an axis, vertices on ±x before the rotation.
#[derive(Debug, Clone, PartialEq)]
pub struct HexagonLayout {
    /// Rings around the centre.
    pub rings: usize,
    /// Rings next to the centre that are left out.
    pub removed_rings: usize,
    /// Whether there is a hexagon in the centre.
    pub has_centre: bool,
    /// Distance between the centres of neighbours, m.
    pub pitch_m: f64,
    /// Largest distance of a centre from the axis, m; `None` for complete rings.
    pub outer_radius_m: Option<f64>,
    /// Rotation about the axis, degrees counter-clockwise.
    pub rotation_deg: f64,
}

/// One hexagon of a layout.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hexagon {
    /// Its ring, 0 for the centre.
    pub ring: usize,
    /// Centre along columns, m.
    pub x_m: f64,
    /// Centre along rows, m.
    pub y_m: f64,
}

impl HexagonLayout {
    /// The hexagons, ring by ring from the innermost, within a ring by the polar angle of the
    /// centre before the rotation, in [0, 2π), counter-clockwise from +x.
    pub fn hexagons(&self) -> Vec<Hexagon> {
        let centre = self.has_centre.then_some(0);
        let rings = centre.into_iter().chain(self.removed_rings + 1..=self.rings);
        rings
            .flat_map(|radius| ring(radius).into_iter().map(move |cell| (radius, cell)))
            .filter_map(|(ring, cell)| self.hexagon(ring, cell))
            .collect()
    }

    /// The layout of hexagons whose centres (x, y), m, are given in any order, and the place among
    /// them of each of its hexagons; `None` for places that are not those of complete rings, or of
    /// all within a radius, to a fiftieth of the distance of neighbours. The rotation is between
    /// −30° and 30°.
    pub fn of_centres(centres_m: &[(f64, f64)]) -> Option<(Self, Vec<usize>)> {
        let pairs = || {
            let of = |i: usize| (0..i).map(move |j| (centres_m[i].0 - centres_m[j].0, centres_m[i].1 - centres_m[j].1));
            (1..centres_m.len()).flat_map(of)
        };
        let least_m = pairs().map(|(x, y)| x.hypot(y)).fold(f64::INFINITY, f64::min);
        // Neighbours, of which the next ones are √3 times as far.
        let near: Vec<(f64, f64)> = pairs().filter(|(x, y)| x.hypot(*y) < 1.2 * least_m).collect();
        let &(x, y) = near.first().filter(|_| least_m > 0.0)?;
        let pitch_m = near.iter().map(|(x, y)| x.hypot(*y)).sum::<f64>() / near.len() as f64;
        // Neighbours are at 30° + k·60° where vertices are on ±x.
        let off_deg = (y.atan2(x).to_degrees() - 30.0).rem_euclid(60.0);
        let turned_deg = if off_deg > 30.0 { off_deg - 60.0 } else { off_deg };
        let rotation_deg = if turned_deg.abs() < LEAST_ROTATION_DEG { 0.0 } else { turned_deg };
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        let ring_of = |&(x, y): &(f64, f64)| {
            let (q, up) = ((cos * x + sin * y) / (pitch_m * 3f64.sqrt() / 2.0), (cos * y - sin * x) / pitch_m);
            let (q, r) = (q.round(), (up - q / 2.0).round());
            q.abs().max(r.abs()).max((q + r).abs()) as usize
        };
        let rings: Vec<usize> = centres_m.iter().map(ring_of).collect();
        let removed_rings = rings.iter().filter(|ring| **ring > 0).min()? - 1;
        let complete = Self {
            rings: *rings.iter().max()?,
            removed_rings,
            has_centre: rings.contains(&0),
            pitch_m,
            outer_radius_m: None,
            rotation_deg,
        };
        let farthest_m = centres_m.iter().map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max);
        let within = Self { outer_radius_m: Some(farthest_m + 0.02 * pitch_m), ..complete.clone() };
        [complete, within].into_iter().find_map(|layout| {
            let hexagons = layout.hexagons();
            let place = |hexagon: &Hexagon| {
                let is_near = |(x, y): &(f64, f64)| (hexagon.x_m - x).hypot(hexagon.y_m - y) < 0.02 * pitch_m;
                centres_m.iter().position(is_near)
            };
            let places: Vec<usize> = hexagons.iter().map_while(place).collect();
            (hexagons.len() == centres_m.len() && places.len() == hexagons.len()).then_some((layout, places))
        })
    }

    /// The hexagon at axial coordinates (q, r): its centre is `pitch·(√3/2·q, q/2 + r)`. `None`
    /// outside the outer radius.
    fn hexagon(&self, ring: usize, (q, r): (i32, i32)) -> Option<Hexagon> {
        let (q, r) = (f64::from(q), f64::from(r));
        let [x, y] = [self.pitch_m * 3f64.sqrt() / 2.0 * q, self.pitch_m * (q / 2.0 + r)];
        // Allows for a radius that was rounded to fewer digits.
        if self.outer_radius_m.is_some_and(|radius_m| x.hypot(y) > radius_m * (1.0 + 1e-9)) {
            return None;
        }
        // A rotation by 0 is exact.
        let (sin, cos) = self.rotation_deg.to_radians().sin_cos();
        Some(Hexagon { ring, x_m: cos * x - sin * y, y_m: sin * x + cos * y })
    }

    /// Side of the smallest square, centred on the axis, that contains hexagons of side `side_m`,
    /// m; 0 without a hexagon.
    pub fn width_m(&self, side_m: f64) -> f64 {
        // Vertices are at `side_m` from a centre, at the rotation + k·60°: the largest cosine of
        // their angles to an axis.
        let reach = |axis_deg: f64| {
            let off_deg = (axis_deg - self.rotation_deg).rem_euclid(60.0);
            off_deg.min(60.0 - off_deg).to_radians().cos()
        };
        let (along_x, along_y) = (side_m * reach(0.0), side_m * reach(90.0));
        let halves =
            self.hexagons().into_iter().map(|hexagon| (hexagon.x_m.abs() + along_x).max(hexagon.y_m.abs() + along_y));
        2.0 * halves.fold(0.0, f64::max)
    }

    /// Side of the smallest square, centred on the axis, that contains discs of radius `radius_m`
    /// in place of the hexagons, m; 0 without one.
    pub fn width_of_discs_m(&self, radius_m: f64) -> f64 {
        let halves = self.hexagons().into_iter().map(|h| h.x_m.abs().max(h.y_m.abs()) + disc_vertices_m(radius_m));
        2.0 * halves.fold(0.0, f64::max)
    }
}

/// Rotations below this are those of rounded places.
const LEAST_ROTATION_DEG: f64 = 0.01;

/// Sides of the polygon of equal area that stands for a disc. Its edge deviates from the circle by
/// 2.5e-5 of the radius: less than 0.2 mm for any existing telescope.
pub const DISC_SIDES: usize = 256;

/// Distance of that polygon's vertices from the centre of a disc of radius `radius_m`, m.
pub fn disc_vertices_m(radius_m: f64) -> f64 {
    let step = TAU / DISC_SIDES as f64;
    radius_m * (step / step.sin()).sqrt()
}

/// Axial coordinates (q, r) of a ring's hexagons by polar angle.
fn ring(radius: usize) -> Vec<(i32, i32)> {
    let n = radius as i32;
    let on_ring = |&(q, r): &(i32, i32)| q.abs().max(r.abs()).max((q + r).abs()) == n;
    let mut cells: Vec<_> = (-n..=n).flat_map(|q| (-n..=n).map(move |r| (q, r))).filter(on_ring).collect();
    // Twice the height is an integer, so that a centre on +x has the angle 0 exactly, and not 2π by
    // rounding.
    let angle = |&(q, r): &(i32, i32)| {
        let angle = f64::from(q + 2 * r).atan2(3f64.sqrt() * f64::from(q));
        if angle < 0.0 { angle + TAU } else { angle }
    };
    cells.sort_by(|a, b| angle(a).total_cmp(&angle(b)));
    cells
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn layout(rings: usize, removed_rings: usize, outer_radius_m: Option<f64>) -> HexagonLayout {
        HexagonLayout { rings, removed_rings, has_centre: false, pitch_m: 1.0, outer_radius_m, rotation_deg: 0.0 }
    }

    #[test]
    fn telescopes_have_the_published_numbers_of_segments() {
        // Keck and GTC, JWST, TMT, ELT; the radii, in pitches, lie between the last ring that is
        // complete and the first corner that is not.
        for (layout, count) in [
            (layout(3, 0, None), 36),
            (layout(2, 0, None), 18),
            (layout(13, 1, Some(11.7)), 492),
            (layout(17, 4, Some(15.45)), 798),
        ] {
            let hexagons = layout.hexagons();
            assert_eq!(hexagons.len(), count);
            // Six-fold symmetry.
            for Hexagon { x_m: x, y_m: y, ring } in &hexagons {
                let (sin, cos) = (PI / 3.0).sin_cos();
                let turned = [cos * x - sin * y, sin * x + cos * y];
                let near = |other: &&Hexagon| (other.x_m - turned[0]).hypot(other.y_m - turned[1]) < 1e-9;
                assert_eq!(hexagons.iter().find(near).map(|other| other.ring), Some(*ring));
            }
        }
    }

    #[test]
    fn a_layout_is_found_from_its_centres() {
        let known = [
            layout(3, 0, None),
            HexagonLayout { rotation_deg: -17.0, has_centre: true, ..layout(1, 0, None) },
            layout(13, 1, Some(11.7)),
            HexagonLayout { rotation_deg: 30.0, ..layout(17, 4, Some(15.45)) },
        ];
        for layout in known {
            let mut centres_m: Vec<(f64, f64)> = layout.hexagons().iter().map(|h| (h.x_m, h.y_m)).collect();
            centres_m.reverse();
            let (found, places) = HexagonLayout::of_centres(&centres_m).unwrap();
            assert_eq!(
                (found.rings, found.removed_rings, found.has_centre),
                (layout.rings, layout.removed_rings, layout.has_centre)
            );
            // Rounding of coordinates of up to 17.
            assert!((found.pitch_m - 1.0).abs() < 1e-12 && (found.rotation_deg - layout.rotation_deg).abs() < 1e-9);
            assert!(places.into_iter().rev().eq(0..centres_m.len()));
            centres_m.remove(2);
            assert_eq!(HexagonLayout::of_centres(&centres_m), None);
        }
        for centres_m in
            [&[][..], &[(0.0, 0.0)], &[(1.0, 1.0), (1.0, 1.0)], &[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)]]
        {
            assert_eq!(HexagonLayout::of_centres(centres_m), None);
        }
    }

    #[test]
    fn width_is_that_of_the_vertices() {
        for rotation_deg in [0.0, 7.0, 30.0, -41.0] {
            let layout = HexagonLayout { rotation_deg, ..layout(2, 0, Some(1.8)) };
            let mut half_m = 0.0f64;
            for hexagon in layout.hexagons() {
                for k in 0..6 {
                    let (sin, cos) = (f64::from(k) * PI / 3.0 + rotation_deg.to_radians()).sin_cos();
                    half_m = half_m.max((hexagon.x_m + 0.6 * cos).abs()).max((hexagon.y_m + 0.6 * sin).abs());
                }
            }
            // Rounding of a few operations on numbers of about 1.
            assert!((layout.width_m(0.6) - 2.0 * half_m).abs() < 1e-12, "{rotation_deg}");
        }
    }
}
