//! Draws that processes share: each makes those of its part and keeps them in a file; the process
//! without a part takes all that are kept, makes those that are not, and has the numbers of one
//! process.
//!
//! ```text
//! head:  version, target, options
//! line:  row <tab> seed <tab> cells of the draw     numbers in the digits that give the same bits again
//! ```

use cophase::pipeline::Part;
use cophase::{Error, Result};
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// A draw as cells of a line, without tabs and line ends.
pub trait KeptDraw: Sized {
    /// Its numbers and words.
    fn cells(&self) -> Vec<String>;

    /// The draw of these cells; none where they are not those of a draw.
    fn from_cells(cells: &[&str]) -> Option<Self>;
}

/// The shortest digits that are read as the same bits, of each number.
pub fn to_cells(numbers: &[f64]) -> Vec<String> {
    numbers.iter().map(|number| format!("{number:e}")).collect()
}

/// The numbers of cells; none where one is no number.
pub fn to_numbers(cells: &[&str]) -> Option<Vec<f64>> {
    cells.iter().map(|cell| cell.parse().ok()).collect()
}

impl KeptDraw for Vec<f64> {
    fn cells(&self) -> Vec<String> {
        to_cells(self)
    }

    fn from_cells(cells: &[&str]) -> Option<Self> {
        to_numbers(cells)
    }
}

/// The draws of one experiment that are kept in a folder, and the part of one process.
pub struct Shares {
    part: Option<Part>,
    /// Of this process; none without a part.
    path: Option<PathBuf>,
    known: BTreeMap<(String, usize), Vec<String>>,
    /// The file of this part, from its first draw on.
    own: Mutex<Option<std::fs::File>>,
    head: String,
}

impl Shares {
    /// The draws of the experiment `name` that `folder` keeps. `options` are all choices on which a
    /// draw of a given row and seed depends.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read, or that is of another version or other
    /// options.
    pub fn open(folder: &Path, name: &str, options: &str, part: Option<Part>) -> Result<Self> {
        let head = format!("cophase {}, {name}, {options}", env!("CARGO_PKG_VERSION"));
        let entries = std::fs::read_dir(folder).map_err(|error| Error::file(folder, error))?;
        let is_of_part = |path: &PathBuf| {
            let file = path.file_name().map(|file| file.to_string_lossy().into_owned()).unwrap_or_default();
            file.starts_with(&format!("{name}.part-")) && file.ends_with(".draws")
        };
        let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(is_of_part).collect();
        files.sort();
        let mut known = BTreeMap::new();
        for file in &files {
            let text = std::fs::read_to_string(file).map_err(|error| Error::file(file, error))?;
            // The last line of a process that was killed may have no end.
            let mut lines = text.split_inclusive('\n').filter_map(|line| line.strip_suffix('\n'));
            if let Some(other) = lines.next().filter(|line| *line != head) {
                return Err(Error::file(
                    file,
                    format!("its draws are of '{other:.100}', and '{head}' is wanted: remove it"),
                ));
            }
            for line in lines {
                let mut cells = line.split('\t').map(str::to_owned);
                let (Some(row), Some(Ok(seed))) = (cells.next(), cells.next().map(|seed| seed.parse())) else {
                    continue;
                };
                known.entry((row, seed)).or_insert_with(|| cells.collect());
            }
        }
        let path = |part: Part| folder.join(format!("{name}.part-{}-of-{}.draws", part.number(), part.of()));
        Ok(Self { part, path: part.map(path), known, own: Mutex::default(), head })
    }

    /// The draw that is kept.
    pub fn kept<D: KeptDraw>(&self, row: &str, seed: usize) -> Option<D> {
        let cells = self.known.get(&(row.to_owned(), seed))?;
        D::from_cells(&cells.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// Whether the draw in this place of all of an experiment, from 0, is one of this process.
    pub fn is_own(&self, place: usize) -> bool {
        self.part.is_none_or(|part| place % part.of() == part.number() - 1)
    }

    /// Keeps a draw, where this process has a part.
    ///
    /// # Errors
    /// [`Error::File`].
    pub fn keep(&self, row: &str, seed: usize, draw: &impl KeptDraw) -> Result<()> {
        let Some(path) = self.file() else { return Ok(()) };
        let mut own = self.own.lock().unwrap_or_else(PoisonError::into_inner);
        let file = match &mut *own {
            Some(file) => file,
            none => none.insert(self.begin(path).map_err(|error| Error::file(path, error))?),
        };
        let cells = [row.to_owned(), seed.to_string()].into_iter().chain(draw.cells());
        let line = cells.collect::<Vec<_>>().join("\t") + "\n";
        file.write_all(line.as_bytes()).map_err(|error| Error::file(path, error))
    }

    /// The file of this process; none without a part.
    pub fn file(&self) -> Option<&Path> {
        self.path.as_deref()
    }

    /// Opens the file of this part behind its last whole line.
    fn begin(&self, path: &Path) -> std::io::Result<std::fs::File> {
        let text = if path.exists() { std::fs::read_to_string(path)? } else { String::new() };
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
        file.set_len(whole as u64)?;
        if whole == 0 {
            file.write_all(format!("{}\n", self.head).as_bytes())?;
        }
        Ok(file)
    }
}

/// Asserts that a draw is the same, to the bit, when it was kept: the shortest digits of a number
/// are those of its bits.
#[cfg(test)]
pub(crate) fn assert_survives<D: KeptDraw + std::fmt::Debug>(draw: &D) {
    let line = draw.cells().join("\t");
    assert!(!line.contains('\n'), "{line}");
    let again = D::from_cells(&line.split('\t').collect::<Vec<_>>()).unwrap();
    assert_eq!(format!("{again:?}"), format!("{draw:?}"));
    assert!(D::from_cells(&["no draw"]).is_none());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers whose shortest decimal digits are long, and those that are none.
    const ODD: [f64; 5] = [0.1 + 0.2, -1e-300, f64::NAN, f64::INFINITY, 5e-324];

    #[test]
    fn draws_of_parts_keep_their_bits_and_torn_lines_are_redone() {
        let folder = tempfile::tempdir().unwrap();
        let open = |part: Option<&str>| {
            Shares::open(folder.path(), "t", "all", part.map(|part| part.parse().unwrap())).unwrap()
        };
        let (one, two) = (open(Some("1/2")), open(Some("2/2")));
        for place in 0..6 {
            let owner = if one.is_own(place) { &one } else { &two };
            assert_ne!(one.is_own(place), two.is_own(place));
            owner.keep("a row", place, &ODD.map(|number| number * place as f64).to_vec()).unwrap();
        }
        let path = two.file().unwrap().to_owned();
        let bits = |draw: Vec<f64>| draw.into_iter().map(f64::to_bits).collect::<Vec<_>>();
        let all = open(None);
        assert!(all.known.len() == 6 && all.file().is_none() && all.is_own(5));
        for place in 1..6 {
            assert_eq!(bits(all.kept("a row", place).unwrap()), ODD.map(|number| (number * place as f64).to_bits()));
        }
        assert_eq!(all.kept::<Vec<f64>>("another row", 1), None);
        // Killed in its last number: 5e-324 times 5 is 2.5e-323.
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, text.trim_end().strip_suffix("3").unwrap()).unwrap();
        let again = open(Some("2/2"));
        assert!(again.known.len() == 5 && again.kept::<Vec<f64>>("a row", 5).is_none());
        again.keep("a row", 5, &ODD.map(|number| number * 5.0).to_vec()).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        let other = Shares::open(folder.path(), "t", "quick", None).err().unwrap().to_string();
        assert!(other.contains(".draws") && other.contains("quick") && other.contains("remove it"), "{other}");
    }
}
