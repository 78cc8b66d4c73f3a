//! Table of the disturbed nights.

use super::{MovingNights, MovingStar};
use crate::experiment::{Cell, Table};
use crate::reproduce::Report;
use cophase::Result;
use std::path::Path;

impl MovingStar {
    /// One line for each kind of night.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "what_moves",
            "nights",
            "asked",
            "false_segments",
            "false_wavefronts",
            "ratio",
            "named_20",
            "named_40",
            "named_80",
            "latest_20",
            "latest_40",
            "latest_80",
            "pointing_alarms",
            "refused_fits",
            "outliers",
        ]);
        for MovingNights { row, nights } in &self.rows {
            let sum = |value: &dyn Fn(&super::MovingNight) -> usize| nights.iter().map(value).sum::<usize>();
            let false_alarms = [0, 1].map(|which| sum(&|night| night.false_alarms[which]));
            let asked = self.asked * nights.len() as f64;
            let named = |step: usize| sum(&|night| usize::from(night.named_after[step].is_some()));
            let latest = |step: usize| nights.iter().filter_map(|night| night.named_after[step]).max();
            let mut cells = vec![
                Cell::Text(row.name()),
                nights.len().into(),
                Cell::Number(asked, 1),
                false_alarms[0].into(),
                false_alarms[1].into(),
                Cell::Number((false_alarms[0] + false_alarms[1]) as f64 / asked, 2),
            ];
            cells.extend((0..3).map(|step| named(step).into()));
            cells.extend((0..3).map(|step| Cell::Number(latest(step).map_or(f64::NAN, |images| images as f64), 0)));
            cells.extend([
                sum(&|night| night.moves).into(),
                sum(&|night| night.refused[0]).into(),
                sum(&|night| night.refused[1]).into(),
            ]);
            table.push(cells);
        }
        table
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let file = directory.join("moving-star.csv");
        self.table().write_csv(&file)?;
        let text = format!(
            "Nights of an image every 80 s in which star, focus and flux move: false alarms of the wavefront, and images until steps of 20, -40 and \
             80 nm were named (how many nights, and after how many images at most)\n{}",
            self.table().text()
        );
        Ok(Report { text, files: vec![file] })
    }
}
