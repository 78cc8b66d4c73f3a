//! Geometry of the telescope's mirror: hexagonal or round segments, central obscuration, spiders.

use super::parts::PupilParts;
use super::polygon::{Point, Polygon};
use super::sampled::Segment;
use crate::hexagons::{DISC_SIDES, HexagonLayout, disc_vertices_m};
use crate::{Error, Result};

/// Largest number of rings: more than any planned telescope has (ELT: 21), and small enough that a
/// typing error is reported rather than computed.
const MAX_RINGS: usize = 64;

/// Geometry of a mirror of segments in the places of hexagons.
#[derive(Debug, Clone, PartialEq)]
pub struct HexagonalParameters {
    /// Rings of segments around the centre.
    pub rings: usize,
    /// Whether the segments are discs.
    pub is_round: bool,
    /// Side of a segment, or the radius of a disc, m.
    pub segment_side_m: f64,
    /// Gap between the facing edges of neighbours, m.
    pub gap_m: f64,
    /// Rings next to the centre that have no segments.
    pub removed_rings: usize,
    /// Largest distance of a segment's centre from the axis, m; `None` for complete rings.
    pub outer_radius_m: Option<f64>,
    /// Whether there is a segment in the centre.
    pub central_segment: bool,
    /// Diameter of the disc that shadows the centre, m; 0 for none.
    pub obscuration_diameter_m: f64,
    /// Width of the spiders' arms, m; 0 for none.
    pub spider_width_m: f64,
    /// Directions of the arms, degrees counter-clockwise from +x: each is a line across the pupil
    /// through its centre.
    pub spider_angles_deg: Vec<f64>,
    /// Directions of arms that end at the centre, degrees counter-clockwise from +x.
    pub spider_vanes_deg: Vec<f64>,
    /// Rotation of segments and spiders about the axis, degrees counter-clockwise.
    pub rotation_deg: f64,
    /// Numbers of the segments that give no light.
    pub dark_segments: Vec<usize>,
    /// Diameter of a stop of the camera, m, which limits the pupil; 0 for none.
    pub stop_diameter_m: f64,
    /// Its centre, m; `rotation_deg` does not move it.
    pub stop_centre_m: [f64; 2],
}

impl HexagonalParameters {
    /// Keck: 36 segments of 0.9 m in three rings, 3 mm apart, without a central segment; no
    /// obscuration and no spiders.
    pub fn keck() -> Self {
        Self {
            rings: 3,
            is_round: false,
            segment_side_m: 0.9,
            gap_m: 0.003,
            removed_rings: 0,
            outer_radius_m: None,
            central_segment: false,
            obscuration_diameter_m: 0.0,
            spider_width_m: 0.0,
            spider_angles_deg: Vec::new(),
            spider_vanes_deg: Vec::new(),
            rotation_deg: 0.0,
            dark_segments: Vec::new(),
            stop_diameter_m: 0.0,
            stop_centre_m: [0.0; 2],
        }
    }

    /// The layout of the hexagons.
    fn layout(&self) -> HexagonLayout {
        HexagonLayout {
            rings: self.rings,
            removed_rings: self.removed_rings,
            has_centre: self.central_segment,
            pitch_m: if self.is_round { 2.0 } else { 3f64.sqrt() } * self.segment_side_m + self.gap_m,
            outer_radius_m: self.outer_radius_m,
            rotation_deg: self.rotation_deg,
        }
    }

    fn check(&self) -> Result<()> {
        let value = |text: String| Err(Error::Value(text));
        if self.rings > MAX_RINGS {
            return value(format!("{} rings of segments are too many: at most {MAX_RINGS} are accepted", self.rings));
        }
        if self.removed_rings >= self.rings && !self.central_segment {
            let Self { rings, removed_rings, .. } = self;
            return value(format!(
                "a mirror of {rings} rings without a central segment and without the first {removed_rings} is empty: more rings are needed"
            ));
        }
        if self.removed_rings > 0 && self.central_segment {
            let removed = self.removed_rings;
            return value(format!(
                "a central segment with {removed} rings removed around it is not a mirror: leave one of them out"
            ));
        }
        if !(self.segment_side_m.is_finite() && self.segment_side_m > 0.0) {
            let side = self.segment_side_m;
            return value(format!("a segment side of {side} m is impossible: a positive length is needed"));
        }
        if let Some(radius_m) = self.outer_radius_m.filter(|radius_m| !(radius_m.is_finite() && *radius_m > 0.0)) {
            return value(format!("an outer radius of {radius_m} m is impossible: a positive length is needed"));
        }
        let lengths = [
            ("gap between segments", self.gap_m),
            ("central obscuration", self.obscuration_diameter_m),
            ("spider width", self.spider_width_m),
            ("stop", self.stop_diameter_m),
        ];
        for (name, length) in lengths {
            if !(length.is_finite() && length >= 0.0) {
                return value(format!("a {name} of {length} m is impossible: 0 or a positive length is needed"));
            }
        }
        if let Some(m) = self.stop_centre_m.iter().find(|m| !m.is_finite()) {
            return value(format!("a stop centred at {m} m is impossible: a finite length is needed"));
        }
        match self.spider_angles_deg.iter().chain(&self.spider_vanes_deg).find(|angle| !angle.is_finite()) {
            Some(angle) => value(format!("a spider at {angle} degrees is impossible: a finite angle is needed")),
            None if !self.rotation_deg.is_finite() => {
                value(format!("a rotation by {} degrees is impossible: a finite angle is needed", self.rotation_deg))
            }
            None => Ok(()),
        }
    }
}

/// An arm of the spider.
#[derive(Debug, Clone, Copy)]
struct Arm {
    /// Unit vector along it, away from the centre.
    direction: Point,
    half_width_m: f64,
    /// Whether it goes on beyond the centre.
    is_line: bool,
}

impl Arm {
    /// Where it goes from the centre, rad.
    fn directions_rad(&self) -> impl Iterator<Item = f64> + use<> {
        let [cos, sin] = self.direction;
        let ends = [Some([cos, sin]), self.is_line.then_some([-cos, -sin])];
        ends.into_iter().flatten().map(|[x, y]| y.atan2(x))
    }

    /// The convex pieces of `polygon` beside the arm and, where it ends at the centre, behind it;
    /// empty ones among them.
    fn removed_from(&self, polygon: &Polygon) -> Vec<Polygon> {
        let Self { direction: [cos, sin], half_width_m, is_line } = *self;
        let (left, right) = ([-sin, cos], [sin, -cos]);
        let mut pieces = vec![polygon.clip(left, half_width_m), polygon.clip(right, half_width_m)];
        if !is_line {
            pieces.push(polygon.clip(left, -half_width_m).clip(right, -half_width_m).clip([-cos, -sin], 0.0));
        }
        pieces
    }
}

/// Shape of one segment without its shadowed parts: convex pieces, each added (+1) or subtracted
/// (−1).
#[derive(Debug, Clone)]
pub(crate) struct SegmentShape {
    /// Outline of the whole segment, including shadowed parts.
    pub(crate) outline: Polygon,
    pub(crate) pieces: Vec<(f64, Polygon)>,
}

impl SegmentShape {
    /// Removes what is beyond the stop, and the shadows: the spiders split the outline into convex
    /// pieces, and the part of each under the disc is subtracted.
    fn new(outline: Polygon, stop: Option<&Polygon>, disc: Option<&Polygon>, spiders: &[Arm]) -> Self {
        let mut pieces = vec![stop.map_or_else(|| outline.clone(), |stop| outline.intersection(stop))];
        pieces.retain(|piece| piece.area() > 0.0);
        for arm in spiders {
            pieces = pieces.iter().flat_map(|p| arm.removed_from(p)).filter(|p| p.area() > 0.0).collect();
        }
        let shadowed = |p: &Polygon| disc.map(|disc| p.intersection(disc)).filter(|p| p.area() > 0.0);
        let subtracted: Vec<_> = pieces.iter().filter_map(shadowed).map(|p| (-1.0, p)).collect();
        let pieces = pieces.into_iter().map(|p| (1.0, p)).chain(subtracted).collect();
        Self { outline, pieces }
    }

    /// A segment without light.
    fn dark(outline: Polygon) -> Self {
        Self { outline, pieces: Vec::new() }
    }

    pub(crate) fn area(&self) -> f64 {
        self.pieces.iter().map(|(sign, p)| sign * p.area()).sum()
    }

    /// Smallest and largest coordinate along `axis`.
    pub(crate) fn range(&self, axis: usize) -> (f64, f64) {
        let ranges = self.pieces.iter().map(|(_, p)| p.range(axis));
        ranges.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), r| (low.min(r.0), high.max(r.1)))
    }
}

/// Exact geometry of a segmented mirror, independent of a grid.
#[derive(Debug, Clone)]
pub struct Aperture {
    segments: Vec<Segment>,
    shapes: Vec<SegmentShape>,
    parts: PupilParts,
}

impl Aperture {
    /// Hexagonal segments in rings, vertices on ±x, centres √3·side + gap apart; numbered ring by
    /// ring from the innermost, within a ring by the polar angle of the centre in [0, 2π),
    /// counter-clockwise from +x. All is then rotated by `rotation_deg`. Round segments have
    /// centres 2·side + gap apart, in the same order.
    ///
    /// # Errors
    /// [`Error::Value`] for lengths that are negative or not finite, a mirror without segments,
    /// more than 64 rings, labels that do not fit, or a segment completely in shadow.
    pub fn hexagonal(parameters: &HexagonalParameters) -> Result<Self> {
        parameters.check()?;
        let hexagons = parameters.layout().hexagons();
        let segments: Vec<Segment> =
            hexagons.iter().zip(0..).map(|(h, label)| Segment { x_m: h.x_m, y_m: h.y_m, label }).collect();
        if let Some(number) = parameters.dark_segments.iter().find(|number| **number >= segments.len()) {
            return Err(Error::Value(format!(
                "there is no segment {number} to be dark: numbers from 0 to {} are accepted",
                segments.len().saturating_sub(1)
            )));
        }
        let obscuration = disc(parameters.obscuration_diameter_m, [0.0; 2]);
        let stop = disc(parameters.stop_diameter_m, parameters.stop_centre_m);
        let spiders = spiders(parameters);
        let mut shapes = Vec::with_capacity(segments.len());
        for (index, segment) in segments.iter().enumerate() {
            let centre = [segment.x_m, segment.y_m];
            let outline = match parameters.is_round {
                true => Polygon::regular(DISC_SIDES, centre, disc_vertices_m(parameters.segment_side_m), 0.0),
                false => Polygon::regular(6, centre, parameters.segment_side_m, parameters.rotation_deg.to_radians()),
            };
            let whole = outline.area();
            if parameters.dark_segments.contains(&index) {
                shapes.push(SegmentShape::dark(outline));
                continue;
            }
            let shape = SegmentShape::new(outline, stop.as_ref(), obscuration.as_ref(), &spiders);
            // Smaller areas are rounding errors of the clipping.
            if shape.area() < 1e-9 * whole {
                return Err(Error::Value(format!(
                    "segment {index} is completely in shadow: leave it out, name it dark, or make the obscuration ({} m) or the \
                     spiders ({} m) smaller, or the stop larger",
                    parameters.obscuration_diameter_m, parameters.spider_width_m
                )));
            }
            shapes.push(shape);
        }
        let directions_rad = spiders.iter().flat_map(Arm::directions_rad);
        Ok(Self { segments, shapes, parts: PupilParts::between_arms(directions_rad) })
    }

    /// Keck's primary mirror: see [`HexagonalParameters::keck`].
    pub fn keck() -> Self {
        Self::hexagonal(&HexagonalParameters::keck()).expect("the parameters of Keck are valid")
    }

    /// The segments, in order.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// The parts that the spider separates.
    pub fn parts(&self) -> &PupilParts {
        &self.parts
    }

    /// Illuminated area of each segment, m².
    pub fn segment_areas_m2(&self) -> Vec<f64> {
        self.shapes.iter().map(SegmentShape::area).collect()
    }

    /// Radius of the circle around the origin that encloses the mirror, m.
    pub fn extent_m(&self) -> f64 {
        self.vertices().map(|[x, y]| x.hypot(y)).fold(0.0, f64::max)
    }

    /// Side of the smallest centred square that encloses the mirror, m: the smallest width of a
    /// grid.
    pub fn width_m(&self) -> f64 {
        2.0 * self.vertices().map(|[x, y]| x.abs().max(y.abs())).fold(0.0, f64::max)
    }

    /// ∬ exp(−2πi(f_x x + f_y y)) dA over segment `segment`, m², by the closed form for polygons;
    /// frequencies in cycles per metre. The reference for every sampled pupil.
    ///
    /// # Errors
    /// [`Error::Value`] for a segment that the mirror does not have.
    pub fn spectrum_m2(&self, segment: usize, fx: f64, fy: f64) -> Result<num_complex::Complex64> {
        let Some(shape) = self.shapes.get(segment) else {
            let last = self.shapes.len() - 1;
            return Err(Error::Value(format!("segment {segment} does not exist: 0 to {last} are accepted")));
        };
        let mut value = [num_complex::Complex64::default()];
        for (sign, piece) in &shape.pieces {
            piece.add_spectrum(*sign, [0.0; 2], &[fy], &[fx], &mut value);
        }
        Ok(value[0])
    }

    pub(crate) fn shapes(&self) -> &[SegmentShape] {
        &self.shapes
    }

    fn vertices(&self) -> impl Iterator<Item = Point> + '_ {
        self.shapes.iter().flat_map(|shape| shape.outline.0.iter().copied())
    }
}

/// The polygon with the area of a disc, of the obscuration or the stop.
fn disc(diameter: f64, centre: Point) -> Option<Polygon> {
    (diameter > 0.0).then(|| Polygon::regular(DISC_SIDES, centre, disc_vertices_m(diameter / 2.0), 0.0))
}

fn spiders(parameters: &HexagonalParameters) -> Vec<Arm> {
    if parameters.spider_width_m == 0.0 {
        return Vec::new();
    }
    let arm = |angle: &f64, is_line| {
        let (sin, cos) = (angle + parameters.rotation_deg).to_radians().sin_cos();
        Arm { direction: [cos, sin], half_width_m: parameters.spider_width_m / 2.0, is_line }
    };
    let lines = parameters.spider_angles_deg.iter().map(|angle| arm(angle, true));
    lines.chain(parameters.spider_vanes_deg.iter().map(|angle| arm(angle, false))).collect()
}
