//! Section `[pupil]`: the telescope.

use super::lists::SegmentLabels;
use super::purpose::Purpose;
use super::table::{Check, Reader, default, section, unset};
use super::value::{ANY, above, between, even};
use super::words::{Aperture, PupilModel};
use crate::Result;
use crate::hexagons::HexagonLayout;
use std::collections::HashSet;
use std::path::PathBuf;

section! {
    /// Pupil of the telescope.
    PupilScene = "pupil" {
        /// Hexagonal segments in rings ("keck" and "hexagonal" differ in the default of
        /// central_segment only), or round ones in their places.
        aperture: Aperture, ANY, default(Aperture::Keck);
        /// FITS pupil in place of hexagons: HDU PUPIL (amplitude) and optionally SEGMENT (labels:
        /// whole numbers; outside of the segments −1, 0 where they begin at 1, or 255 or 65535 of
        /// unsigned integers). Needs grid_m.
        file: Option<PathBuf>, ANY, unset("hexagons, given by aperture");
        /// Number of rings of hexagons around the centre.
        rings: usize, between(0.0, 30.0), default(3usize);
        /// Side of a segment; the radius of a round one.
        segment_side_m: f64, above(0.0, 100.0), default(0.9);
        /// Gap between the edges of neighbouring segments. The distance between centres is
        /// √3·side + gap, or 2·side + gap of round segments.
        segment_gap_m: f64, between(0.0, 10.0), default(0.003);
        /// Number of rings next to the centre that have no segments.
        removed_rings: usize, between(0.0, 29.0), default(0usize);
        /// Largest distance of a segment's centre from the axis: hexagons farther out are left out.
        outer_radius_m: Option<f64>, above(0.0, 100.0), unset("complete rings");
        /// The observatory's numbers or names of the segments, in the order of ours, which
        /// rotation_deg does not change: column LABEL of tables, the picture of the pupil, and
        /// --segment.
        segment_labels: Option<SegmentLabels>, ANY, unset("our numbers, from 0");
        /// Whether there is a central segment; the default is true for aperture = "hexagonal" and
        /// "round".
        central_segment: bool, ANY, default(false);
        /// Diameter of the circular central obscuration; 0 for none.
        central_obscuration_m: f64, between(0.0, 1000.0), default(0.0);
        /// Width of the spider's vanes; 0 for no spider.
        spider_width_m: f64, between(0.0, 10.0), default(0.0);
        /// Directions of the spider's lines through the centre, counter-clockwise from +x before
        /// rotation_deg; each line is two vanes.
        spider_angles_deg: Vec<f64>, between(-360.0, 360.0), default([0.0, 60.0, 120.0]);
        /// Directions of vanes that end at the centre, counter-clockwise from +x before
        /// rotation_deg; in place of spider_angles_deg.
        spider_vanes_deg: Option<Vec<f64>>, between(-360.0, 360.0), unset("the lines of spider_angles_deg");
        /// Numbers of segments that give no light, from 0: out of the telescope, or hidden. Their
        /// modes stay 0.
        dark_segments: Vec<i64>, between(0.0, 1e5), default([]);
        /// Diameter of a circular stop of the camera that limits the pupil; 0 for none.
        stop_diameter_m: f64, between(0.0, 1000.0), default(0.0);
        /// Centre of the stop along x, from the axis; it does not turn with the pupil.
        stop_x_m: f64, between(-100.0, 100.0), default(0.0);
        /// Centre of the stop along y.
        stop_y_m: f64, between(-100.0, 100.0), default(0.0);
        /// Rotation of segments, their numbers and the spider about the axis, counter-clockwise;
        /// modes, diversity and mirror are not rotated. 'cophase scene --plot' shows it.
        rotation_deg: f64, between(-360.0, 360.0), default(0.0);
        /// Illumination of the pupil, relative to its mean, with X = 2x/grid_m and Y = 2y/grid_m:
        /// 1 + illumination_x·X + illumination_y·Y + illumination_edge·(2X² + 2Y² − 1). This is its
        /// slope along x.
        illumination_x: f64, between(-0.9, 0.9), default(0.0);
        /// Slope of the illumination along y.
        illumination_y: f64, between(-0.9, 0.9), default(0.0);
        /// Rise of the illumination from the centre to the edge, halved.
        illumination_edge: f64, between(-0.9, 0.9), default(0.0);
        /// Side of the square pupil grid. λ/D in other keys means λ/grid_m.
        grid_m: Option<f64>, above(0.0, 1000.0), unset("the smallest grid that contains the pupil");
        /// Number of samples along a side of the estimator's pupil grid. A file with at least twice
        /// as many is a fine map.
        samples: usize, even(16.0, 2048.0), default(120usize);
        /// Sampling of the pupil in the model.
        model: Option<PupilModel>, ANY, unset("\"band-limited\"; for a file that is not a fine map \"hard\"");
        /// Frequency up to which the low pass of the band-limited model is 1. Estimate only.
        band_pass_cycles: Option<f64>, above(0.0, 1024.0), unset("as the image requires");
        /// Frequency from which the low pass of the band-limited model is 0. Estimate only.
        band_stop_cycles: Option<f64>, above(0.0, 2048.0), unset("samples - band_pass_cycles");
    }
}

impl PupilScene {
    /// Layout of the hexagons; `None` for a pupil from a file.
    pub fn layout(&self) -> Option<HexagonLayout> {
        if matches!(self.aperture, Aperture::File(_)) {
            return None;
        }
        Some(HexagonLayout {
            rings: self.rings,
            removed_rings: self.removed_rings,
            has_centre: self.central_segment,
            pitch_m: if self.is_round() { 2.0 } else { 3f64.sqrt() } * self.segment_side_m + self.segment_gap_m,
            outer_radius_m: self.outer_radius_m,
            rotation_deg: self.rotation_deg,
        })
    }

    /// This pupil turned by an angle, counter-clockwise.
    pub(super) fn turned_by(&self, turn_deg: f64) -> Self {
        Self { rotation_deg: self.rotation_deg + turn_deg, ..self.clone() }
    }

    /// Whether the segments are discs.
    pub fn is_round(&self) -> bool {
        self.aperture == Aperture::Round
    }

    /// Side of the smallest square, centred on the axis, that contains the segments, m; `None` for
    /// a pupil from a file.
    pub fn extent_m(&self) -> Option<f64> {
        let width_m = if self.is_round() { HexagonLayout::width_of_discs_m } else { HexagonLayout::width_m };
        self.layout().map(|layout| width_m(&layout, self.segment_side_m))
    }

    fn check_file(&self, file: &std::path::Path, reader: &Reader) -> Result<()> {
        reader.not_both("aperture", "file")?;
        let rings = ["rings", "removed_rings", "outer_radius_m", "segment_labels"];
        let geometry = ["segment_side_m", "segment_gap_m", "central_segment", "rotation_deg"];
        let blocked = ["central_obscuration_m", "spider_width_m", "spider_angles_deg", "spider_vanes_deg"];
        let lost = ["dark_segments", "stop_diameter_m", "stop_x_m", "stop_y_m"];
        reader.refuse(&[rings.as_slice(), &geometry, &blocked, &lost].concat(), "where the pupil comes from a file")?;
        if self.grid_m.is_none() && reader.source.purpose != Purpose::Arrays {
            let file = file.display();
            return Err(reader.error(
                "file",
                format_args!("'pupil.grid_m' is missing; the width of the grid of {file}, in m, is needed"),
            ));
        }
        Ok(())
    }

    fn check_geometry(&self, extent_m: f64, reader: &Reader) -> Result<()> {
        let Self { segment_side_m: side, segment_gap_m: gap, central_obscuration_m: obscuration, rings, .. } = *self;
        if gap >= side {
            let sentence = format_args!(
                "pupil.segment_gap_m = {gap} is not accepted; less than segment_side_m = {side} is needed"
            );
            return Err(reader.error("segment_gap_m", sentence));
        }
        self.check_layout(reader)?;
        if obscuration >= extent_m {
            let sentence = format!(
                "pupil.central_obscuration_m = {obscuration} hides the whole pupil; a diameter below the pupil's {extent_m:.4} m is needed"
            );
            return Err(reader.error("central_obscuration_m", sentence));
        }
        // Allows for an extent that was rounded to fewer digits: a part in 10⁹ is far below a
        // sample.
        match self.grid_m {
            Some(grid_m) if grid_m * (1.0 + 1e-9) < extent_m => {
                let segments = if self.is_round() { "discs of radius" } else { "hexagons of side" };
                let sentence = format!(
                    "pupil.grid_m = {grid_m} is not accepted; {rings} rings of {segments} {side} m are {extent_m:.4} m across and need a grid at least as wide"
                );
                Err(reader.error("grid_m", sentence))
            }
            _ => Ok(()),
        }
    }

    fn check_layout(&self, reader: &Reader) -> Result<()> {
        let Self { rings, removed_rings, .. } = *self;
        if rings == 0 && !self.central_segment {
            let sentence = "pupil.rings = 0 without a central segment leaves no segment; rings from 1 or central_segment = true is needed";
            return Err(reader.error("rings", sentence));
        }
        if removed_rings > 0 && self.central_segment {
            let sentence = format!(
                "pupil.removed_rings = {removed_rings} is not accepted with a central segment; 0, or central_segment = false is needed"
            );
            return Err(reader.error("removed_rings", sentence));
        }
        if removed_rings > 0 && removed_rings >= rings {
            let sentence =
                format!("pupil.removed_rings = {removed_rings} is not accepted; less than rings = {rings} is needed");
            return Err(reader.error("removed_rings", sentence));
        }
        let count = self.layout().map_or(0, |layout| layout.hexagons().len());
        if let Some(radius_m) = self.outer_radius_m.filter(|_| count == 0) {
            let sentence = format!(
                "pupil.outer_radius_m = {radius_m} leaves no segment; a radius that contains the centre of at least one is needed"
            );
            return Err(reader.error("outer_radius_m", sentence));
        }
        let dark: HashSet<i64> = self.dark_segments.iter().copied().collect();
        let sentence = match dark.iter().find(|number| usize::try_from(**number).map_or(true, |number| number >= count))
        {
            Some(number) => Some(format!(
                "pupil.dark_segments has {number}; numbers from 0 to {} are needed",
                count.saturating_sub(1)
            )),
            None if dark.len() < self.dark_segments.len() => {
                Some("pupil.dark_segments has a number twice; once is needed".into())
            }
            None if dark.len() == count => {
                Some(format!("pupil.dark_segments has all {count} segments; fewer are needed"))
            }
            None => None,
        };
        if let Some(sentence) = sentence {
            return Err(reader.error("dark_segments", sentence));
        }
        let Some(labels) = &self.segment_labels else { return Ok(()) };
        let mut seen = HashSet::new();
        let sentence = match labels.iter().find(|label| !seen.insert(*label)) {
            _ if labels.len() != count => {
                format!(
                    "pupil.segment_labels has {} labels; one for each of the {count} segments is needed",
                    labels.len()
                )
            }
            Some(twice) => {
                format!("pupil.segment_labels has {twice} twice; a label of its own for each segment is needed")
            }
            None => return Ok(()),
        };
        Err(reader.error("segment_labels", sentence))
    }

    /// Slopes along x and y and the rise to the edge of the illumination; `None` for an even one.
    pub(crate) fn illumination(&self) -> Option<[f64; 3]> {
        let terms = [self.illumination_x, self.illumination_y, self.illumination_edge];
        terms.iter().any(|term| *term != 0.0).then_some(terms)
    }

    fn check_band(&self, reader: &Reader) -> Result<()> {
        let samples = self.samples;
        if let Some(pass) = self.band_pass_cycles.filter(|&pass| 2.0 * pass >= samples as f64) {
            let sentence = format!(
                "pupil.band_pass_cycles = {pass} is not accepted; less than half of samples = {samples} is needed"
            );
            return Err(reader.error("band_pass_cycles", sentence));
        }
        match (self.band_pass_cycles, self.band_stop_cycles) {
            (pass, Some(stop)) if stop > samples as f64 || pass.is_some_and(|pass| pass >= stop) => {
                let sentence = format!(
                    "pupil.band_stop_cycles = {stop} is not accepted; more than band_pass_cycles and at most samples = {samples} is needed"
                );
                Err(reader.error("band_stop_cycles", sentence))
            }
            _ => Ok(()),
        }
    }
}

impl Check for PupilScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        reader.not_both("spider_angles_deg", "spider_vanes_deg")?;
        if self.spider_vanes_deg.is_some() {
            self.spider_angles_deg.clear();
        }
        if let Some(file) = &self.file {
            self.check_file(file, reader)?;
            self.aperture = Aperture::File(file.clone());
        } else {
            self.model.get_or_insert(PupilModel::BandLimited);
            if !reader.named("central_segment") {
                self.central_segment = self.aperture != Aperture::Keck;
            }
        }
        if matches!(self.model, Some(PupilModel::Area | PupilModel::Hard)) {
            reader
                .refuse(&["band_pass_cycles", "band_stop_cycles"], "where the pupil's model is not \"band-limited\"")?;
        }
        Ok(())
    }

    fn check(&self, reader: &Reader) -> Result<()> {
        if let Some(extent_m) = self.extent_m().filter(|_| reader.source.purpose != Purpose::Arrays) {
            self.check_geometry(extent_m, reader)?;
        }
        self.check_band(reader)
    }
}
