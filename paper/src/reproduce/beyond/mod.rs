//! Beyond the paper: the full-phase estimate of the images behind each kind of loop, beside the
//! paper's way.
//!
//! Every draw is kept in `beyond-draws.csv` as soon as it is done, and none that is there is made
//! again: a long table can be made in parts. Draws are made seed by seed, so that a table that was
//! stopped has all its rows. Processes that share a table have each the draws of some seeds, and a
//! file for them, `beyond-draws.part-I-of-N.csv`.

mod draws;
mod maps;
mod rows;
mod table;

pub use draws::BeyondDraw;
pub use maps::{HeldMap, held_maps};
pub use rows::{BEYOND_ROWS, BeyondRow};
pub use table::Beyond;

use super::table_rows::Conditions;
use super::{Options, Progress, Report};
use cophase::ao::Simulator;
use cophase::pipeline::Part;
use cophase::scene::Scene;
use cophase::{Error, Result};
use draws::{Behind, HEAD};
use std::borrow::Cow;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The rows that `options` asks for: those it names, or all; and with a folder of maps one for each
/// of them. A quick look has the first three.
///
/// # Errors
/// [`Error::Value`] for a name that no row has; those of [`held_maps`].
pub fn beyond_rows(options: &Options) -> Result<(Vec<BeyondRow>, Vec<HeldMap>)> {
    let maps = match &options.maps {
        None => Vec::new(),
        Some(folder) => held_maps(folder, &options.conditions().star()?, &options.directory)?,
    };
    let of_map = |map: &HeldMap| BeyondRow {
        name: Cow::Owned(map.name.clone()),
        map: Some(map.clone()),
        ..BEYOND_ROWS[0].clone()
    };
    let measured: Vec<BeyondRow> = maps.iter().map(of_map).collect();
    let rows = if options.rows.is_empty() {
        let most = if options.quick { 3 } else { BEYOND_ROWS.len() };
        BEYOND_ROWS.iter().take(most).chain(&measured).cloned().collect()
    } else {
        let named = |name: &String| {
            measured
                .iter()
                .find(|row| row.name == **name)
                .map_or_else(|| BeyondRow::named(name).cloned(), |row| Ok(row.clone()))
        };
        options.rows.iter().map(named).collect::<Result<_>>()?
    };
    Ok((rows, maps))
}

/// Draws 1 to `seeds` of `rows`, or those of a part of the seeds; draws in `directory` are taken
/// from there, and new ones added to them.
///
/// # Errors
/// Those of the simulator and of the estimator; [`Error::File`]; [`Error::Interrupted`].
pub fn beyond(
    rows: &[BeyondRow],
    conditions: &Conditions,
    seeds: usize,
    (directory, part): (&Path, Option<Part>),
    progress: &Progress,
) -> Result<Beyond> {
    let path = directory.join(file_name(part));
    let mut draws = kept_draws(directory)?;
    let mut failed = Vec::new();
    let own: Vec<usize> = match part {
        None => (1..=seeds).collect(),
        Some(part) => part.items(seeds).into_iter().map(|place| place + 1).collect(),
    };
    let wanted = |draw: &BeyondDraw| own.contains(&draw.seed) && rows.iter().any(|row| row.name == draw.row);
    progress.expect(rows.len() * own.len());
    progress.add(draws.iter().filter(|draw| wanted(draw)).count());
    for &seed in &own {
        let missing: Vec<&BeyondRow> =
            rows.iter().filter(|row| !draws.iter().any(|draw| draw.row == row.name && draw.seed == seed)).collect();
        for group in groups(&missing, conditions, seed)? {
            let mut images = None;
            for (row, made) in &group.members {
                progress.check()?;
                match one(row, made, &group.longest, &mut images, (conditions, seed), progress) {
                    Ok(draw) => {
                        keep(&path, &draw)?;
                        // With the digits of the file, so that a table does not depend on which of
                        // its draws were there.
                        draws.extend(BeyondDraw::parse(&draw.line()));
                    }
                    Err(error @ (Error::Interrupted(_) | Error::File { .. })) => return Err(error),
                    // A row that cannot be made is reported, and the others go on.
                    Err(error) => failed.push(format!("{}, seed {seed}: {error}", row.name)),
                }
                progress.add(1);
            }
        }
    }
    draws.retain(wanted);
    draws.sort_by_key(|draw| draw.seed);
    Ok(Beyond { rows: rows.to_vec(), draws, failed })
}

/// One draw; `images` are those of its group, made for the first who wants them.
fn one(
    row: &BeyondRow,
    made: &Scene,
    longest: &Scene,
    images: &mut Option<Behind>,
    (conditions, seed): (&Conditions, usize),
    progress: &Progress,
) -> Result<BeyondDraw> {
    if let Some(first) = row.first {
        return row.two_steps(first, conditions, seed, progress);
    }
    let behind = match images {
        Some(behind) => behind,
        None => images.insert(Behind::of(Simulator::new(longest)?, progress)?.held_against(row.held_nm(longest)?)),
    };
    row.draw(behind, made, seed, progress)
}

impl Beyond {
    /// What a part says: its draws are kept, and those of all parts make the table.
    pub(in crate::reproduce) fn report_of_part(&self, part: Part, directory: &Path) -> Report {
        let (draws, failed) = (self.draws.len(), &self.failed);
        let mut text =
            format!("part {part} of beyond: {draws} draws are there; without --part the table is made of all\n");
        failed.iter().for_each(|sentence| text += &format!("not made: {sentence}\n"));
        Report { text, files: vec![directory.join(file_name(Some(part)))] }
    }
}

/// File of the draws of a part, or of all.
fn file_name(part: Option<Part>) -> String {
    match part {
        None => "beyond-draws.csv".into(),
        Some(part) => format!("beyond-draws.part-{}-of-{}.csv", part.number(), part.of()),
    }
}

/// The draws in the files of `directory`, each once.
fn kept_draws(directory: &Path) -> Result<Vec<BeyondDraw>> {
    let entries = std::fs::read_dir(directory).map_err(|error| Error::file(directory, error))?;
    let is_of_draws = |path: &PathBuf| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        name == file_name(None) || (name.starts_with("beyond-draws.part-") && name.ends_with(".csv"))
    };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(is_of_draws).collect();
    paths.sort();
    let mut draws: Vec<BeyondDraw> = Vec::new();
    for path in paths {
        let text = std::fs::read_to_string(&path).map_err(|error| Error::file(&path, error))?;
        for draw in text.lines().skip(1).filter_map(BeyondDraw::parse) {
            if !draws.iter().any(|known| known.row == draw.row && known.seed == draw.seed) {
                draws.push(draw);
            }
        }
    }
    Ok(draws)
}

/// Adds a draw to the file of them.
fn keep(path: &Path, draw: &BeyondDraw) -> Result<()> {
    let in_file = |error| Error::file(path, error);
    let first = !path.exists();
    let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path).map_err(in_file)?;
    let head = if first { format!("{HEAD}\n") } else { String::new() };
    writeln!(file, "{head}{}", draw.line()).map_err(in_file)
}

/// Rows that read the same images, which differ in their number at most: an image does not hang on
/// those after it.
struct Group<'a> {
    /// The scene with the most images.
    longest: Scene,
    members: Vec<(&'a BeyondRow, Scene)>,
}

fn groups<'a>(rows: &[&'a BeyondRow], conditions: &Conditions, seed: usize) -> Result<Vec<Group<'a>>> {
    let mut groups: Vec<(Scene, Group)> = Vec::new();
    for &row in rows {
        let made = row.made(row.row, conditions, seed)?;
        let one = made.with_override("image.count", "1")?;
        let shared = groups.iter_mut().find(|(key, group)| {
            let alone = row.first.is_some() || group.members.iter().any(|(member, _)| member.first.is_some());
            !alone && **key == *one
        });
        match shared {
            None => groups.push((one, Group { longest: made.clone(), members: vec![(row, made)] })),
            Some((_, group)) => {
                if made.image.count > group.longest.image.count {
                    group.longest = made.clone();
                }
                group.members.push((row, made));
            }
        }
    }
    Ok(groups.into_iter().map(|(_, group)| group).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_draw_survives_its_line() {
        let numbers = std::array::from_fn(|i| i as f64 + 0.25);
        let draw = BeyondDraw { row: "kl, 30 dropped".into(), seed: 7, numbers };
        assert_eq!(BeyondDraw::parse(&draw.line()), Some(draw));
        assert_eq!(HEAD.split(',').count(), 16);
        assert_eq!(BeyondDraw::parse("a,1,2"), None);
    }

    #[test]
    fn draws_of_parts_are_found_each_once() {
        let folder = tempfile::tempdir().unwrap();
        let draw = |seed: usize| BeyondDraw { row: "75 images".into(), seed, numbers: [1.5; 14] };
        for (part, seeds) in [(None, &[1][..]), (Some("1/2"), &[1, 3]), (Some("2/2"), &[2])] {
            let part = part.map(|part: &str| part.parse().unwrap());
            seeds.iter().for_each(|seed| keep(&folder.path().join(file_name(part)), &draw(*seed)).unwrap());
        }
        let mut seeds: Vec<usize> = kept_draws(folder.path()).unwrap().iter().map(|draw| draw.seed).collect();
        seeds.sort_unstable();
        assert_eq!(seeds, [1, 2, 3]);
        let named = [BeyondRow::named("75 images").unwrap().clone()];
        let quiet = Progress::new(&|_, _| {}, &cophase::Control::default());
        let of = |part: &str| {
            let part = Some(part.parse().unwrap());
            // All draws are there: none is made.
            beyond(&named, &Conditions::default(), 3, (folder.path(), part), &quiet).unwrap().draws
        };
        assert_eq!((of("1/2"), of("2/2")), (vec![draw(1), draw(3)], vec![draw(2)]));
        let whole = beyond(&named, &Conditions::default(), 3, (folder.path(), None), &quiet).unwrap().draws;
        assert_eq!(whole, [draw(1), draw(2), draw(3)]);
    }

    #[test]
    fn rows_that_read_the_same_images_share_them() {
        let named = |name: &str| BeyondRow::named(name).unwrap();
        let rows = ["75 images", "128 nm", "200 images", "NCPA in two steps", "known loop", "10 images"].map(named);
        let groups = groups(&rows, &Conditions::default(), 2).unwrap();
        let names: Vec<Vec<&str>> =
            groups.iter().map(|group| group.members.iter().map(|(row, _)| &*row.name).collect()).collect();
        assert_eq!(
            names,
            [vec!["75 images", "200 images", "known loop", "10 images"], vec!["128 nm"], vec!["NCPA in two steps"]]
        );
        assert_eq!((groups[0].longest.image.count, groups[0].members[3].1.image.count), (200, 10));
    }
}
