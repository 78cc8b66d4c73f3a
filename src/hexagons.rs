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
    /// The hexagons, ring by ring from the innermost, within a ring by the polar angle of the centre before the rotation, in
    /// [0, 2π), counter-clockwise from +x.
    pub fn hexagons(&self) -> Vec<Hexagon> {
        let centre = self.has_centre.then_some(0);
        let rings = centre.into_iter().chain(self.removed_rings + 1..=self.rings);
        rings
            .flat_map(|radius| ring(radius).into_iter().map(move |cell| (radius, cell)))
            .filter_map(|(ring, cell)| self.hexagon(ring, cell))
            .collect()
    }

    /// The hexagon at axial coordinates (q, r): its centre is `pitch·(√3/2·q, q/2 + r)`. `None` outside the outer radius.
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

    /// Side of the smallest square, centred on the axis, that contains hexagons of side `side_m`, m; 0 without a hexagon.
    pub fn width_m(&self, side_m: f64) -> f64 {
        // Vertices are at `side_m` from a centre, at the rotation + k·60°: the largest cosine of their angles to an axis.
        let reach = |axis_deg: f64| {
            let off_deg = (axis_deg - self.rotation_deg).rem_euclid(60.0);
            off_deg.min(60.0 - off_deg).to_radians().cos()
        };
        let (along_x, along_y) = (side_m * reach(0.0), side_m * reach(90.0));
        let halves =
            self.hexagons().into_iter().map(|hexagon| (hexagon.x_m.abs() + along_x).max(hexagon.y_m.abs() + along_y));
        2.0 * halves.fold(0.0, f64::max)
    }

    /// Side of the smallest square, centred on the axis, that contains discs of radius `radius_m` in place of the hexagons, m; 0 without
    /// one.
    pub fn width_of_discs_m(&self, radius_m: f64) -> f64 {
        let halves = self.hexagons().into_iter().map(|h| h.x_m.abs().max(h.y_m.abs()) + disc_vertices_m(radius_m));
        2.0 * halves.fold(0.0, f64::max)
    }
}

/// Sides of the polygon of equal area that stands for a disc. Its edge deviates from the circle by 2.5e-5 of the radius: less than 0.2 mm
/// for any existing telescope.
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
    // Twice the height is an integer, so that a centre on +x has the angle 0 exactly, and not 2π by rounding.
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
        // Keck and GTC, JWST, TMT, ELT; the radii, in pitches, lie between the last ring that is complete and the first corner that is not.
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
