//! Files of corrections: FITS, or text, and what is said of a correction.

use super::{Corrections, ModeCorrection};
use crate::Result;
use crate::io::{Column, FitsWriter, write_atomically};
use crate::loop_response::controller::Commands;
use crate::telescope::SegmentPlace;
use crate::tracking::HoldReason;
use std::path::Path;

/// Extension of a file of corrections that is text.
const TEXT: &str = "txt";

impl Corrections {
    /// Writes the corrections: as text for a path that ends in `.txt`, else as FITS with the table
    /// `SEGMENTS`, where there is a mirror `ACTUATORS`, where there is a loop `REFERENCE`, where
    /// the scene describes controllers `SEGMENT_COMMANDS` and `ACTUATOR_COMMANDS`, with NCPA modes
    /// `NCPA`, and `WARNINGS`. Columns `HELD` say why a mode stays; cards have the policy and the
    /// expected drop of the squared error.
    ///
    /// # Errors
    /// [`crate::Error::File`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(TEXT)) {
            return write_atomically(path, self.text().as_bytes());
        }
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "NCPAMODE", self.corrected_modes as i64, "NCPA modes corrected")?;
        file.card("PRIMARY", "NLIMITED", self.limited as i64, "commands cut at the limit")?;
        let convention = self.policy.convention.word();
        file.card("PRIMARY", "CONVENT", convention, "what moving segments minimises")?;
        file.card("PRIMARY", "GAIN", self.policy.gain, "part of an error that is corrected")?;
        file.card("PRIMARY", "DEADBAND", self.policy.deadband_sigma, "error bars below which a mode is held")?;
        let [segments_nm2, ncpa_nm2] = self.expected_drop_nm2;
        file.card("PRIMARY", "DROPSEG", segments_nm2, "nm2, expected drop of squares, segments")?;
        file.card("PRIMARY", "DROPNCPA", ncpa_nm2, "nm2, expected drop of squares, NCPA")?;
        let column = |of: &[[f64; 2]], i: usize| of.iter().map(|pair| pair[i]).collect::<Vec<f64>>();
        let mut segments = SegmentPlace::columns(&self.places);
        segments.push(Column::f64("ADD_NM", "nm", self.pistons_nm.clone()));
        segments.push(Column::f64("ESTIMATE_NM", "nm", column(&self.estimate_nm, 0)));
        segments.push(Column::f64("SIGMA_NM", "nm", column(&self.estimate_nm, 1)));
        let count = self.places.len();
        let held = |from: usize| self.segments_held[from..from + count].iter().map(|held| word(*held));
        segments.push(Column::text("HELD", held(0)));
        for (of, name) in [(0, "TIP"), (1, "TILT")] {
            if let Some((add_nm, estimate_nm)) = self.tilts_of_axis(of) {
                segments.push(Column::f64(&format!("ADD_{name}_NM"), "nm", add_nm.to_vec()));
                segments.push(Column::f64(&format!("{name}_NM"), "nm", column(estimate_nm, 0)));
                segments.push(Column::f64(&format!("{name}_SIGMA_NM"), "nm", column(estimate_nm, 1)));
                segments.push(Column::text(&format!("{name}_HELD"), held((1 + of) * count)));
            }
        }
        if !self.places.is_empty() {
            file.table("SEGMENTS", &segments)?;
        }
        if !self.actuators_nm.is_empty() {
            let actuators = [
                Column::f64("X_M", "m", self.actuators_nm.iter().map(|(at, _)| at[0]).collect()),
                Column::f64("Y_M", "m", self.actuators_nm.iter().map(|(at, _)| at[1]).collect()),
                Column::f64("ADD_NM", "nm", self.actuators_nm.iter().map(|(_, nm)| *nm).collect()),
            ];
            file.table("ACTUATORS", &actuators)?;
        }
        if !self.slopes_mas.is_empty() {
            let (x, y) = self.slopes_mas.split_at(self.slopes_mas.len() / 2);
            let reference = [Column::f64("X_MAS", "mas", x.to_vec()), Column::f64("Y_MAS", "mas", y.to_vec())];
            file.table("REFERENCE", &reference)?;
        }
        let controllers =
            [("SEGMENT_COMMANDS", &self.segment_commands), ("ACTUATOR_COMMANDS", &self.actuator_commands)];
        for (name, commands) in controllers {
            if let Some(commands) = commands {
                file.table(name, &commands.columns())?;
            }
        }
        if !self.ncpa.is_empty() {
            let column = |value: fn(&ModeCorrection) -> f64| self.ncpa.iter().map(value).collect();
            let modes = [
                Column::i64("MODE", (0..self.ncpa.len() as i64).collect()),
                Column::f64("CORRECTED_NM", "nm", column(|mode| mode.corrected_nm)),
                Column::f64("ESTIMATE_NM", "nm", column(|mode| mode.estimate_nm)),
                Column::f64("SIGMA_NM", "nm", column(|mode| mode.sigma_nm)),
                Column::text("HELD", self.ncpa.iter().map(|mode| word(mode.held))),
            ];
            file.table("NCPA", &modes)?;
        }
        let warnings: Vec<&String> = self.all_warnings().collect();
        if !warnings.is_empty() {
            file.table("WARNINGS", &[Column::text("SENTENCE", warnings)])?;
        }
        file.finish()
    }

    /// The warnings of the corrections, then those of the estimate.
    fn all_warnings(&self) -> impl Iterator<Item = &String> {
        self.warnings.iter().chain(&self.estimate_warnings)
    }

    /// The commands as text: the warnings as comments, and a line with the name of each channel and
    /// what to add to it.
    fn text(&self) -> String {
        let mut text = String::from("# Corrections by cophase: what to add to each channel.\n");
        self.sentences().iter().for_each(|sentence| text += &format!("# {sentence}\n"));
        self.all_warnings().for_each(|sentence| text += &format!("# {}\n", sentence.replace('\n', " ")));
        let own = |nm: &mut dyn Iterator<Item = f64>| Commands::in_nm(nm);
        let segments = own(&mut self.pistons_nm.iter().copied());
        let [tips, tilts] = [0, 1].map(|axis| {
            let is_own = self.segment_commands.is_none();
            own(&mut self
                .tilts_of_axis(axis)
                .filter(|_| is_own)
                .into_iter()
                .flat_map(|(add_nm, _)| add_nm.iter().copied()))
        });
        let actuators = own(&mut self.actuators_nm.iter().map(|(_, nm)| *nm));
        for (what, commands) in [
            ("segments", self.segment_commands.as_ref().unwrap_or(&segments)),
            ("tips of segments, RMS over each", &tips),
            ("tilts of segments, RMS over each", &tilts),
            ("actuators", self.actuator_commands.as_ref().unwrap_or(&actuators)),
        ] {
            text += &commands.text(what);
        }
        text
    }

    /// What is corrected, and what is expected of it: one line.
    pub fn summary(&self) -> String {
        let moved = |held: &mut dyn Iterator<Item = Option<HoldReason>>, what: &str| {
            let held: Vec<Option<HoldReason>> = held.collect();
            let count = |reason| held.iter().filter(|held| **held == reason).count();
            let (all, sent) = (held.len() - count(Some(HoldReason::NeverCorrected)), count(None));
            let reasons = [
                (count(Some(HoldReason::Deadband)), "within the deadband"),
                (count(Some(HoldReason::NoBenefit)), "without expected benefit"),
            ];
            let reasons: Vec<String> =
                reasons.iter().filter(|(count, _)| *count > 0).map(|(count, why)| format!("{count} {why}")).collect();
            let reasons = if reasons.is_empty() { String::new() } else { format!(" ({})", reasons.join(", ")) };
            format!("{sent} of {all} {what}{reasons}")
        };
        let segments = moved(&mut self.segments_held.iter().copied(), "segment modes");
        let ncpa = moved(&mut self.ncpa.iter().map(|mode| mode.held), "NCPA modes");
        let [segments_nm2, ncpa_nm2] = self.expected_drop_nm2;
        format!("{segments}, {ncpa}; expected drop of the sum of squares {segments_nm2:.0} and {ncpa_nm2:.0} nm²")
    }

    /// The summary, and the modes that are held.
    fn sentences(&self) -> Vec<String> {
        let count = self.places.len();
        let names = ["piston", "tip", "tilt"];
        let segments = self.segments_held.iter().enumerate();
        let segments = segments.map(|(mode, held)| (format!("{} {}", names[mode / count], mode % count), *held));
        let ncpa = self.ncpa.iter().enumerate().map(|(mode, one)| (format!("NCPA {mode}"), one.held));
        let all: Vec<(String, Option<HoldReason>)> = segments.chain(ncpa).collect();
        let mut sentences = vec![format!("Corrected: {}", self.summary())];
        for reason in [HoldReason::Deadband, HoldReason::NoBenefit] {
            let held: Vec<&str> =
                all.iter().filter(|(_, held)| *held == Some(reason)).map(|(name, _)| name.as_str()).collect();
            if !held.is_empty() {
                sentences.push(format!("Held ({}): {}", reason.word(), held.join(", ")));
            }
        }
        sentences
    }

    /// Increments of the tips (axis 0) or tilts (axis 1) of all segments, and their estimates;
    /// `None` where there are none.
    fn tilts_of_axis(&self, axis: usize) -> Option<(&[f64], &[[f64; 2]])> {
        let count = self.tilts_nm.len() / 2;
        let of_axis = axis * count..(axis + 1) * count;
        (count > 0).then(|| (&self.tilts_nm[of_axis.clone()], &self.tilt_estimate_nm[of_axis]))
    }
}

/// Why a mode stays; empty for one that moves.
fn word(held: Option<HoldReason>) -> &'static str {
    held.map_or("", HoldReason::word)
}
