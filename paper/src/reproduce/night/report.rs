//! Tables and picture of a night.

use super::Night;
use super::scenario::INTERVAL_S;
use crate::experiment::{Cell, Table};
use crate::reproduce::Report;
use cophase::Result;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// Parts of the error, with their numbers.
const PARTS: [&str; 2] = ["phasing", "NCPA"];

impl Night {
    /// Errors of single images and of the tracked state.
    pub fn errors(&self) -> Table {
        let mut table = Table::new(&["part", "single_nm", "tracked_nm", "ratio", "drift_nm_per_sqrt_hour", "learnt"]);
        let (segments, ncpa) = self.followed.drift_nm_per_sqrt_hour;
        for (part, learnt) in [segments, ncpa].into_iter().enumerate() {
            let [single_nm, tracked_nm] = self.followed.rms_nm(part);
            table.push(vec![
                PARTS[part].into(),
                Cell::Number(single_nm, 2),
                Cell::Number(tracked_nm, 2),
                Cell::Number(tracked_nm / single_nm, 3),
                Cell::Number(self.followed.true_drift_nm_per_sqrt_hour[part], 2),
                Cell::Number(learnt, 2),
            ]);
        }
        table
    }

    /// What was said of each jump.
    pub fn jumps(&self) -> Table {
        let mut table = Table::new(&["segment", "jump_nm", "images_until_named", "size_nm", "sigma_nm"]);
        for jump in &self.scenario.jumps {
            let named = self.followed.naming(jump);
            let of = |value: &dyn Fn(usize, &cophase::tracking::Change) -> f64| {
                named.map_or(f64::NAN, |(images, change)| value(images, change))
            };
            table.push(vec![
                jump.segment.into(),
                Cell::Number(jump.nm, 0),
                Cell::Number(of(&|images, _| images as f64), 0),
                Cell::Number(of(&|_, change| change.size_nm), 1),
                Cell::Number(of(&|_, change| change.size_error_nm), 1),
            ]);
        }
        table
    }

    /// What became of each bad frame.
    pub fn bad_frames(&self) -> Table {
        let mut table = Table::new(&["image", "fault", "verdict", "single_nm", "tracked_nm"]);
        for &(frame, fault) in &self.scenario.bad {
            let seen = &self.followed.frames[frame];
            table.push(vec![
                frame.into(),
                fault.word().into(),
                seen.verdict.into(),
                Cell::Number(seen.single_nm[0], 1),
                Cell::Number(seen.tracked_nm[0], 2),
            ]);
        }
        table
    }

    /// False alarms.
    pub fn alarms(&self) -> Table {
        let mut table = Table::new(&["nights", "asked", "false_alarms", "ratio"]);
        let total: usize = self.quiet.alarms.iter().sum();
        let with_images = self.scenario.hours() / 8.0;
        let rows = [
            ("drawn from the covariance", self.quiet.asked * self.quiet.alarms.len() as f64, total),
            ("with images", self.quiet.asked * with_images, self.followed.false_alarms()),
            ("with images, more asked for", self.loud_asked, self.loud_false_alarms),
        ];
        for (name, asked, alarms) in rows {
            table.push(vec![
                name.into(),
                Cell::Number(asked, 1),
                alarms.into(),
                Cell::Number(alarms as f64 / asked, 2),
            ]);
        }
        table
    }

    /// One line for each alarm.
    pub fn changes(&self) -> Table {
        let mut table = Table::new(&["image", "since_h", "segment", "size_nm", "sigma_nm", "statistic", "threshold"]);
        for (frame, change) in &self.followed.changes {
            table.push(vec![
                (*frame).into(),
                Cell::Number(change.since_s / 3600.0, 4),
                Cell::Text(change.segment.map_or_else(|| "none".into(), |segment| segment.to_string())),
                Cell::Number(change.size_nm, 1),
                Cell::Number(change.size_error_nm, 1),
                Cell::Number(change.statistic, 1),
                Cell::Number(change.threshold, 1),
            ]);
        }
        table
    }

    /// One line for each image.
    pub fn frames(&self) -> Table {
        let mut table = Table::new(&[
            "hours",
            "flux",
            "single_phasing_nm",
            "tracked_phasing_nm",
            "single_ncpa_nm",
            "tracked_ncpa_nm",
            "verdict",
        ]);
        for (number, frame) in self.followed.frames.iter().enumerate() {
            table.push(vec![
                Cell::Number(number as f64 * INTERVAL_S / 3600.0, 4),
                Cell::Number(self.scenario.flux(number), 3),
                Cell::Number(frame.single_nm[0], 3),
                Cell::Number(frame.tracked_nm[0], 3),
                Cell::Number(frame.single_nm[1], 3),
                Cell::Number(frame.tracked_nm[1], 3),
                frame.verdict.into(),
            ]);
        }
        table
    }

    /// Phasing errors through the night.
    pub fn picture(&self) -> CurvePicture {
        let frames = &self.followed.frames;
        let hours = |number: usize| number as f64 * INTERVAL_S / 3600.0;
        let curve = |label: &str, value: &dyn Fn(usize) -> f64, style| Series {
            label: label.into(),
            x: (0..frames.len()).map(hours).collect(),
            y: (0..frames.len()).map(value).collect(),
            y_err: None,
            style,
        };
        let points = SeriesStyle { stroke: Stroke::Solid, marker: Marker::None, colour: Some(0) };
        let line = SeriesStyle { stroke: Stroke::Solid, marker: Marker::None, colour: Some(1) };
        let rejected = SeriesStyle { stroke: Stroke::None, marker: Marker::Diamond, colour: Some(3) };
        let only = |is_wanted: bool, value: f64| if is_wanted { value } else { f64::NAN };
        let series = vec![
            curve("single images", &|at| only(frames[at].is_used, frames[at].single_nm[0]), points),
            curve("tracked", &|at| frames[at].tracked_nm[0], line),
            curve("images that were not used", &|at| only(!frames[at].is_used, frames[at].tracked_nm[0]), rejected),
        ];
        let jumps = self.scenario.jumps.iter();
        CurvePicture {
            title: "A night: an image every 10 s, drift, jumps, clouds".into(),
            x_label: "time (h)".into(),
            y_label: "phasing error (nm RMS)".into(),
            y_log: true,
            series,
            vertical_lines: jumps.map(|jump| (hours(jump.frame), format!("{:+.0} nm", jump.nm))).collect(),
            ..Default::default()
        }
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let tables = [
            ("night.csv", self.errors()),
            ("night-jumps.csv", self.jumps()),
            ("night-bad-frames.csv", self.bad_frames()),
            ("night-changes.csv", self.changes()),
            ("night-alarms.csv", self.alarms()),
        ];
        let mut files = Vec::new();
        let mut text = format!(
            "A night of {} images: error of single images and of the tracked state, nm RMS, over the images that were used; drift in nm RMS per \
             mode and root hour\n",
            self.scenario.frames
        );
        for (name, table) in tables {
            files.push(directory.join(name));
            table.write_csv(&directory.join(name))?;
            text += &table.text();
        }
        let unused = self.followed.frames.iter().filter(|frame| !frame.is_used).count();
        text += &format!(
            "{unused} images were not used. (estimate - truth)/sigma of single images, RMS: {:.3}. An image took {:.0} ms to make and fit.\n\n",
            self.single_pull,
            1e3 * self.fit_s
        );
        files.push(directory.join("night-frames.csv"));
        self.frames().write_csv(&directory.join("night-frames.csv"))?;
        files.push(directory.join("night.png"));
        self.picture().draw(directory.join("night.png"))?;
        Ok(Report { text, files })
    }
}
