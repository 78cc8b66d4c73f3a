//! The paper's section 4.4: how many images it takes, and whether their mean or their median.

use super::on_sky::{Reader, sequence_draws};
use super::statistics::{mean, standard_deviation};
use super::table_rows::{Conditions, Row};
use super::{Cell, Progress, Report, Table, Way};
use cophase::scene::Combine;
use cophase::{Error, Result};
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// Numbers of images that are looked at.
const COUNTS: [usize; 9] = [1, 2, 5, 10, 20, 40, 75, 120, 200];
/// The loops: the paper's best, and none of its measures.
const LOOPS: [&str; 2] = ["pol-mask-inpaint", "zonal"];
/// Most sets of a number of images that are taken from one sequence.
const MOST_SETS: usize = 10;
/// How images are combined.
const COMBINES: [Combine; 3] = [Combine::Mean, Combine::Median, Combine::ClippedMean];

/// What the paper says in numbers: row, images, phasing and NCPA of the mean, nm (Table 2, and
/// section 4.5 for 75).
const PUBLISHED_NM: [(&str, usize, [f64; 2]); 3] =
    [("pol-mask-inpaint", 75, [22.0, f64::NAN]), ("pol-mask-inpaint", 200, [21.3, 31.6]), ("zonal", 200, [32.1, 25.7])];

/// Residual against the number of images.
#[derive(Debug, Clone)]
pub struct ImageNumbers {
    /// One for each loop, way, combination and number.
    pub points: Vec<ImageNumber>,
}

/// One number of images, combined one way.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageNumber {
    /// The loop.
    pub row: &'static str,
    /// Who fitted.
    pub way: Way,
    /// How they were combined.
    pub combine: Combine,
    /// How many.
    pub images: usize,
    /// Residual of each set of so many images of each seed, phasing and NCPA, nm.
    pub residuals_nm: Vec<[f64; 2]>,
}

impl ImageNumber {
    fn of(&self, quantity: usize) -> Vec<f64> {
        self.residuals_nm.iter().map(|residuals_nm| residuals_nm[quantity]).collect()
    }
}

/// The images of one set among `sets` of `count` images each, spread evenly over `all`; sets have
/// no image in common.
fn spread(all: usize, count: usize, set: usize, sets: usize) -> Vec<usize> {
    (0..count).map(|i| (2 * (i * sets + set) + 1) * all / (2 * count * sets)).collect()
}

/// Sets of `count` out of `all` images.
fn sets(all: usize, count: usize) -> usize {
    (all / count).min(MOST_SETS)
}

/// Residual against the number of images behind two loops, with draws 1 to `seeds`, both ways.
///
/// # Errors
/// Those of the simulator and of the estimator; [`Error::Interrupted`].
pub fn image_numbers(conditions: &Conditions, seeds: usize, progress: &Progress) -> Result<ImageNumbers> {
    progress.check()?;
    let missing = |name| Error::Internal(format!("there is no row {name}"));
    let rows = LOOPS.map(|name| Row::named(name).ok_or_else(|| missing(name)));
    let rows = rows.into_iter().collect::<Result<Vec<_>>>()?;
    let scene = conditions.star()?;
    let all = scene.image.count;
    progress.expect(Way::BOTH.len() * rows.len() * seeds * all);
    let readers = Way::BOTH.map(|way| Reader::new(way, &scene)).into_iter().collect::<Result<Vec<_>>>()?;
    let mut counts: Vec<usize> = COUNTS.into_iter().filter(|&count| count < all).collect();
    counts.push(all);
    let point = |row: &'static Row, way, combine, images| {
        let residuals_nm = Vec::with_capacity(seeds * sets(all, images));
        ImageNumber { row: row.name, way, combine, images, residuals_nm }
    };
    let mut points = Vec::new();
    for row in &rows {
        for (way, combine) in Way::BOTH.into_iter().flat_map(|way| COMBINES.map(|combine| (way, combine))) {
            points.extend(counts.iter().map(|&images| point(row, way, combine, images)));
        }
    }
    let steps = readers.len() * all;
    // Of each sequence, the place of a point and the residuals of its sets.
    let draws = sequence_draws((&rows, seeds), conditions, (progress, steps), |row, _, sequence| {
        let mut residuals_nm: Vec<f64> = Vec::new();
        for reader in &readers {
            let Some(found) = reader.fit(&sequence, progress)? else { continue };
            let mine = points.iter().enumerate().filter(|(_, one)| one.row == row.name && one.way == reader.way);
            // A loop that was lost has fewer.
            for (place, point) in mine.filter(|(_, point)| point.images <= sequence.images()) {
                let sets = sets(sequence.images(), point.images);
                for set in 0..sets {
                    let chosen = spread(sequence.images(), point.images, set, sets);
                    match reader.estimator.combine_subset(&found, &chosen, point.combine) {
                        Ok(found) => {
                            let (phasing_nm, ncpa_nm) = (found.maps.phasing_nm.view(), found.maps.ncpa_nm.view());
                            let [phasing_nm, ncpa_nm] = reader.residuals_nm(&sequence, phasing_nm, ncpa_nm)?;
                            residuals_nm.extend([place as f64, phasing_nm, ncpa_nm]);
                        }
                        // None of the set could be fitted.
                        Err(Error::Image(_)) => {}
                        Err(error) => return Err(error),
                    }
                }
            }
        }
        Ok(residuals_nm)
    })?;
    for &[place, phasing_nm, ncpa_nm] in draws.iter().flat_map(|(_, draw)| draw.as_chunks().0) {
        points[place as usize].residuals_nm.push([phasing_nm, ncpa_nm]);
    }
    Ok(ImageNumbers { points })
}

impl ImageNumbers {
    /// One line a point; the paper's figures where it prints them, which are those of the mean.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "row",
            "way",
            "combine",
            "images",
            "sets",
            "phasing_nm",
            "phasing_sd_nm",
            "ncpa_nm",
            "ncpa_sd_nm",
            "published_phasing_nm",
            "published_ncpa_nm",
        ]);
        for point in &self.points {
            let [phasing, ncpa] = [0, 1].map(|quantity| point.of(quantity));
            let published = if (point.way, point.combine) == (Way::Paper, Combine::Mean) {
                published(point.row, point.images)
            } else {
                [f64::NAN; 2]
            };
            table.push(vec![
                point.row.into(),
                point.way.name().into(),
                point.combine.word().into(),
                point.images.into(),
                point.residuals_nm.len().into(),
                Cell::Number(mean(&phasing), 1),
                Cell::Number(standard_deviation(&phasing), 1),
                Cell::Number(mean(&ncpa), 1),
                Cell::Number(standard_deviation(&ncpa), 1),
                Cell::Number(published[0], 1),
                Cell::Number(published[1], 1),
            ]);
        }
        table
    }

    /// One line a loop and a number, phasing / NCPA, for a reader.
    pub fn side_by_side(&self) -> Table {
        let mut table =
            Table::new(&["row", "images", "paper", "its way: mean", "median", "clipped mean", "ours: clipped mean"]);
        let columns = [
            (Way::Paper, Combine::Mean),
            (Way::Paper, Combine::Median),
            (Way::Paper, Combine::ClippedMean),
            (Way::Ours, Combine::ClippedMean),
        ];
        for point in self.points.iter().filter(|point| (point.way, point.combine) == columns[0]) {
            let here = columns.map(|(way, combine)| {
                let found = self.points.iter().find(|other| {
                    (other.row, other.images, other.way, other.combine) == (point.row, point.images, way, combine)
                });
                shown(found.map_or([f64::NAN; 2], |found| [0, 1].map(|quantity| mean(&found.of(quantity)))))
            });
            let paper = shown(published(point.row, point.images));
            let texts = [paper].into_iter().chain(here).map(Cell::Text);
            table.push([point.row.into(), point.images.into()].into_iter().chain(texts).collect());
        }
        table
    }

    /// Both quantities behind one loop: mean, median and clipped mean the paper's way, clipped mean
    /// ours.
    pub fn picture(&self, row: &str) -> CurvePicture {
        let mut series = Vec::new();
        for (quantity, (what, marker)) in [("phasing", Marker::Disc), ("NCPA", Marker::Diamond)].into_iter().enumerate()
        {
            let lines = [
                (Way::Paper, Combine::Mean, Stroke::Solid, "mean"),
                (Way::Paper, Combine::Median, Stroke::Dashed, "median"),
                (Way::Paper, Combine::ClippedMean, Stroke::Dotted, "clipped mean"),
                (Way::Ours, Combine::ClippedMean, Stroke::Solid, "ours, clipped mean"),
            ];
            for (way, combine, stroke, label) in lines {
                let points = || self.points.iter().filter(|p| (p.row, p.way, p.combine) == (row, way, combine));
                let statistic = |of: fn(&[f64]) -> f64| points().map(|point| of(&point.of(quantity))).collect();
                // One set of error bars a quantity: they are much the same, and would hide one
                // another.
                let bars = combine == Combine::Mean;
                series.push(Series {
                    label: format!("{what}, {label}"),
                    x: points().map(|point| point.images as f64).collect(),
                    y: statistic(mean),
                    y_err: bars.then(|| statistic(standard_deviation)),
                    style: SeriesStyle {
                        stroke,
                        marker,
                        colour: Some(quantity + if way == Way::Ours { 2 } else { 0 }),
                    },
                });
            }
            let printed = PUBLISHED_NM.iter().filter(|(name, ..)| *name == row);
            let (x, y) = printed.map(|(_, images, nm)| (*images as f64, nm[quantity])).unzip();
            let style = SeriesStyle { stroke: Stroke::None, marker: Marker::Square, colour: Some(quantity) };
            series.push(Series { label: format!("{what}, the paper"), x, y, y_err: None, style });
        }
        CurvePicture {
            title: format!("Residual against the number of images: {row}"),
            x_label: "images, spread over the minute".into(),
            y_label: "residual (nm RMS)".into(),
            x_log: true,
            y_log: true,
            series,
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["images.csv", "images.png", "images-zonal.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        for (path, row) in files[1..].iter().zip(LOOPS) {
            self.picture(row).draw(path)?;
        }
        let text = "Residual against the number of images: phasing / NCPA, nm RMS, mean over sets of images and seeds\n"
            .to_string() + &self.side_by_side().text();
        Ok(Report { text, files: files.to_vec() })
    }
}

fn published(row: &str, images: usize) -> [f64; 2] {
    let known = PUBLISHED_NM.iter().find(|(name, count, _)| (*name, *count) == (row, images));
    known.map_or([f64::NAN; 2], |(.., nm)| *nm)
}

/// Phasing / NCPA.
fn shown([phasing_nm, ncpa_nm]: [f64; 2]) -> String {
    let one = |nm: f64| if nm.is_nan() { "-".to_string() } else { format!("{nm:.1}") };
    format!("{} / {}", one(phasing_nm), one(ncpa_nm))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_spread_evenly_and_share_no_image() {
        for count in COUNTS {
            let sets = sets(200, count);
            let mut seen: Vec<usize> = (0..sets).flat_map(|set| spread(200, count, set, sets)).collect();
            assert!(seen.iter().all(|&image| image < 200), "{count}");
            let gaps: Vec<usize> = spread(200, count, 0, sets).windows(2).map(|pair| pair[1] - pair[0]).collect();
            // Within rounding to whole images.
            assert!(gaps.iter().all(|&gap| (200 / count..=200 / count + 1).contains(&gap)), "{count}: {gaps:?}");
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), sets * count);
        }
        assert_eq!(spread(200, 1, 0, 1), [100]);
        assert_eq!(spread(4, 2, 1, 2), [1, 3]);
    }

    #[test]
    fn text_has_a_line_for_each_number() {
        let point = |combine, residuals_nm: &[[f64; 2]]| ImageNumber {
            row: "zonal",
            way: Way::Paper,
            combine,
            images: 200,
            residuals_nm: residuals_nm.to_vec(),
        };
        let points = vec![point(Combine::Mean, &[[30.0, 20.0], [34.0, 24.0]]), point(Combine::Median, &[])];
        let text = ImageNumbers { points }.side_by_side().text();
        assert!(text.contains("32.1 / 25.7  32.0 / 22.0    - / -"), "{text}");
        assert_eq!(text.trim_end().lines().count(), 2, "{text}");
    }

    #[test]
    fn figures_of_the_table_are_those_of_its_rows() {
        for (name, images, nm) in PUBLISHED_NM {
            if images == 200 {
                assert_eq!(Row::named(name).unwrap().published.residuals_nm(), nm);
            }
        }
    }
}
