//! The table of hard cases, and its picture.

use super::{HardCase, HardCases, Verdict};
use crate::reproduce::statistics::median;
use crate::reproduce::{Cell, Report, Table};
use cophase::Result;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// Error bars beyond this, nm, are no news and not in the picture: they say that nothing is known.
const MOST_NM: f64 = 1e4;

/// Whether a verdict is of some kind.
type Test = fn(&Verdict) -> bool;

impl HardCases {
    /// Draws that are wrong and do not say so.
    pub fn wrong_and_unflagged(&self) -> usize {
        self.count(Verdict::is_wrong_and_unflagged)
    }

    /// Draws of some kind, of all cases.
    fn count(&self, test: Test) -> usize {
        self.cases.iter().flat_map(|(_, verdicts)| verdicts).filter(|verdict| test(verdict)).count()
    }

    /// One line a case: how many draws are right and how many flagged, medians of the residuals,
    /// their error bars, χ² and evaluations, and the largest differences in single precision and on
    /// a device among the draws that are right.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "group",
            "case",
            "tried",
            "right",
            "given_defocus",
            "given_orientation",
            "flagged",
            "wrong_unflagged",
            "status",
            "phasing_nm",
            "sigma",
            "ncpa_nm",
            "sigma_ncpa",
            "chi2",
            "evaluations",
            "f32_nm",
            "opencl_nm",
        ]);
        for (case, verdicts) in &self.cases {
            table.push(line(case, verdicts));
        }
        table
    }

    /// Residual of each draw against its error bar, by what was said of it.
    pub fn picture(&self) -> CurvePicture {
        let all: Vec<&Verdict> = self.cases.iter().flat_map(|(_, verdicts)| verdicts).collect();
        // Kinds of few draws over those of many; each has its colour, and those set apart are
        // diamonds.
        let kinds: [(&str, Test, usize, Marker); 6] = [
            ("right, and said to be", |v| v.is_right() && !v.is_flagged(), 0, Marker::Disc),
            ("right, but flagged", |v| v.is_right() && v.is_flagged(), 1, Marker::Disc),
            ("wrong, and flagged", |v| !v.is_right() && v.is_flagged(), 3, Marker::Disc),
            (
                "right for the defocus of the scene",
                |v| v.is_right_given_diversity() && !v.is_flagged(),
                2,
                Marker::Diamond,
            ),
            (
                "right for the orientation of the scene",
                |v| v.is_right_given_orientation() && !v.is_flagged(),
                5,
                Marker::Diamond,
            ),
            ("wrong and unflagged", |v| v.is_wrong_and_unflagged(), 4, Marker::Disc),
        ];
        let mut series = Vec::new();
        for (label, of_kind, colour, marker) in kinds {
            let parts = all.iter().filter(|v| of_kind(v)).flat_map(|v| v.sigma_nm.into_iter().zip(v.error_nm));
            let (x, y) = parts.filter(|(x, y)| *x > 0.0 && *x < MOST_NM && *y > 0.0 && y.is_finite()).unzip();
            let style = SeriesStyle { stroke: Stroke::None, marker, colour: Some(colour) };
            series.push(Series { label: label.into(), x, y, y_err: None, style });
        }
        let (low, high) = (1e-3, 1e3);
        for factor in [1.0, 3.0] {
            let style = SeriesStyle { stroke: Stroke::Dashed, marker: Marker::None, colour: Some(7) };
            let (label, x, y) = (format!("{factor:.0} σ"), vec![low, high], vec![factor * low, factor * high]);
            series.push(Series { label, x, y, y_err: None, style });
        }
        CurvePicture {
            title: "Hard cases: residual of phasing and NCPA against the error bar".into(),
            x_label: "error bar (nm RMS)".into(),
            y_label: "residual (nm RMS)".into(),
            x_log: true,
            y_log: true,
            series,
            ..Default::default()
        }
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["hard-cases.csv", "hard-cases.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let tried = self.count(|_| true);
        let mut text = "Hard cases: images of a star; right: residuals within 3 error bars or 1 nm\n".to_string();
        text += &self.table().text();
        text += &format!(
            "{} of {tried} draws are wrong and unflagged; {} more are wrong by an error of the defocus alone, and {} by a flip of \
             the images alone, which the estimate says it cannot know\n",
            self.wrong_and_unflagged(),
            self.count(|verdict| verdict.is_right_given_diversity() && !verdict.is_flagged()),
            self.count(|verdict| verdict.is_right_given_orientation() && !verdict.is_flagged())
        );
        for (case, verdicts) in &self.cases {
            if let Some(sentence) = verdicts.iter().find_map(|verdict| verdict.sentence.as_ref()) {
                text += &format!("{}: {sentence}\n", case.name);
            }
        }
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}

fn line(case: &HardCase, verdicts: &[Verdict]) -> Vec<Cell> {
    let count = |test: Test| Cell::Count(verdicts.iter().filter(|verdict| test(verdict)).count());
    let middle = |of: fn(&Verdict) -> f64| median(&verdicts.iter().map(of).filter(|v| !v.is_nan()).collect::<Vec<_>>());
    let right = || verdicts.iter().filter(|verdict| verdict.is_right());
    let most = |of: fn(&Verdict) -> f64| right().map(of).fold(f64::NAN, f64::max);
    let shown = |value: f64| Cell::Number(if value.is_finite() { value } else { f64::NAN }, 2);
    vec![
        case.group.into(),
        case.name.into(),
        verdicts.len().into(),
        count(Verdict::is_right),
        count(Verdict::is_right_given_diversity),
        count(Verdict::is_right_given_orientation),
        count(Verdict::is_flagged),
        count(Verdict::is_wrong_and_unflagged),
        Cell::Text(words(verdicts)),
        shown(middle(|v| v.error_nm[0])),
        shown(middle(|v| v.sigma_nm[0])),
        shown(middle(|v| v.error_nm[1])),
        shown(middle(|v| v.sigma_nm[1])),
        shown(middle(|v| v.reduced_chi2)),
        Cell::Number(middle(|v| v.evaluations as f64), 0),
        Cell::Number(most(|v| v.f32_nm), 4),
        Cell::Number(most(|v| v.opencl_nm), 6),
    ]
}

/// The statuses that there are, the commonest first.
fn words(verdicts: &[Verdict]) -> String {
    let mut counts: Vec<(usize, &str)> = Vec::new();
    for verdict in verdicts {
        match counts.iter_mut().find(|(_, word)| **word == verdict.word) {
            Some((count, _)) => *count += 1,
            None => counts.push((1, &verdict.word)),
        }
    }
    counts.sort_by_key(|(count, _)| std::cmp::Reverse(*count));
    match counts.as_slice() {
        [(_, word)] => (*word).into(),
        several => several.iter().map(|(count, word)| format!("{count} {word}")).collect::<Vec<_>>().join(", "),
    }
}
