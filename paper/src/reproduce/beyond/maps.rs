//! NCPA that were measured on a telescope, and their projection on the influence functions of its
//! mirror.
//!
//! A measured map ends at the pupil of its day, and has detail that the mirror does not reproduce.
//! Its projection is smooth and continues where the map has no light. Images are made with the map
//! and, where it has no value, with the projection; estimates are compared with the projection, and
//! the RMS of the rest is reported.

use cophase::io::{FitsWriter, Pixel, read_map};
use cophase::pupil::Grid;
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use cophase_numerics::cholesky::Cholesky;
use ndarray::{Array1, Array2, ArrayView1, Axis};
use std::path::{Path, PathBuf};

/// How the files are called.
const PREFIX: &str = "NCPA";

/// Samples of the held map: 24 to a pitch of the mirror, so that what lies between them is a
/// straight line to 1e-3.
const HELD_SAMPLES: usize = 480;

/// Weight that keeps actuators that the map determines poorly from large commands, of the strongest
/// one's. A tenth of it holds 0.5 to 2 nm more of Keck's maps, and goes on half as far again where
/// they show nothing.
const RIDGE: f64 = 1e-2;

/// Least glass of a sample of a map that counts.
const LEAST_GLASS: f64 = 0.5;

/// A measured map, and what a mirror holds of it.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldMap {
    /// Name of its file without the ending.
    pub name: String,
    /// The file of what the mirror makes of it, nm.
    pub held: PathBuf,
    /// The file of the map, which goes on as the mirror does where it shows nothing, nm.
    pub whole: PathBuf,
    /// RMS of the map over the glass that it shows; piston, tip and tilt removed, nm.
    pub rms_nm: f64,
    /// RMS of what the mirror cannot hold of it, nm.
    pub left_nm: f64,
    /// Whether it stood across, its rows along x.
    pub turned: bool,
}

/// The maps in `folder` (FITS files whose name starts with `NCPA`, nm, over the scene's grid, 0
/// where they show nothing), fitted by the mirror of `scene` and written to `directory`.
///
/// # Errors
/// [`Error::File`] for a folder or a file that cannot be read, or written; [`Error::Value`] for a
/// folder without maps.
pub fn held_maps(folder: &Path, scene: &Scene, directory: &Path) -> Result<Vec<HeldMap>> {
    let entries = std::fs::read_dir(folder).map_err(|error| Error::file(folder, error))?;
    let named = |path: &PathBuf| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        name.starts_with(PREFIX) && (name.ends_with(".fits") || name.ends_with(".fits.gz"))
    };
    let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).filter(named).collect();
    paths.sort();
    if paths.is_empty() {
        let folder = folder.display();
        return Err(Error::Value(format!("{folder} holds no maps of NCPA: files {PREFIX}*.fits are needed")));
    }
    let telescope = Telescope::new(scene)?;
    paths.iter().map(|path| held(path, scene, &telescope, directory)).collect()
}

fn held(path: &Path, scene: &Scene, telescope: &Telescope, directory: &Path) -> Result<HeldMap> {
    let in_file = |error: Error| Error::file(path, error);
    let map_nm = read_map(path, None)?;
    let (rows, columns) = map_nm.dim();
    if rows != columns || rows % 2 != 0 {
        let text = format!("a map of {columns}x{rows} samples: a square with an even side is needed");
        return Err(Error::file(path, text));
    }
    let width_m = telescope.pupil.grid.width_m();
    let grid = Grid::new(rows, width_m).map_err(in_file)?;
    let glass = telescope.pupil_on(grid)?.amplitude;
    // Some were stored with the pupil rotated by 90 degrees, as the illuminated part of the map
    // shows.
    let shown = |map: &Array2<f64>| map.iter().zip(&glass).filter(|(nm, glass)| shows(**nm, **glass)).count();
    let across = map_nm.t().to_owned();
    let turned = shown(&across) > shown(&map_nm);
    let map_nm = if turned { across } else { map_nm };
    let places: Vec<(usize, usize)> =
        map_nm.indexed_iter().filter(|(at, nm)| shows(**nm, glass[*at])).map(|(at, _)| at).collect();
    let xs_m: Vec<f64> = places.iter().map(|&(_, x)| grid.coordinate_m(x)).collect();
    let ys_m: Vec<f64> = places.iter().map(|&(y, _)| grid.coordinate_m(y)).collect();
    let influence = telescope.influence(scene)?;
    if places.len() < 2 * influence.len() {
        let (few, needed) = (places.len(), 2 * influence.len());
        return Err(Error::file(path, format!("only {few} samples show the pupil: at least {needed} are needed")));
    }
    let planes =
        ndarray::stack![Axis(0), Array1::ones(xs_m.len()), Array1::from(xs_m.clone()), Array1::from(ys_m.clone())];
    let wanted_nm: Array1<f64> = places.iter().map(|&at| map_nm[at]).collect();
    let wanted_nm = &wanted_nm - &fitted(&planes, wanted_nm.view(), 0.0)?.dot(&planes);
    let shapes = influence.evaluate(&xs_m, &ys_m)?;
    let commands_nm = fitted(&shapes, wanted_nm.view(), RIDGE)?;
    let left_nm = &wanted_nm - &commands_nm.dot(&shapes);
    let left_nm = &left_nm - &fitted(&planes, left_nm.view(), 0.0)?.dot(&planes);
    let rms = |values: &Array1<f64>| (values.dot(values) / values.len() as f64).sqrt();
    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let held_nm = surface(&influence, &commands_nm, width_m)?;
    let whole_nm = &held_nm + &spread(&places, &left_nm, rows);
    let written = |what: &str, map_nm: &Array2<f64>| -> Result<PathBuf> {
        let path = directory.join(format!("{what}-{name}.fits"));
        let path = std::path::absolute(&path).map_err(|error| Error::file(&path, error))?;
        let mut file = FitsWriter::create(&path)?;
        file.image("NCPA", map_nm, Pixel::F64, "nm")?;
        file.finish()?;
        Ok(path)
    };
    let (held, whole) = (written("held", &held_nm)?, written("whole", &whole_nm)?);
    Ok(HeldMap { name, held, whole, rms_nm: rms(&wanted_nm), left_nm: rms(&left_nm), turned })
}

/// Values at `places` of a map of `side` samples, and 0 elsewhere, on the samples of the surface:
/// each takes the value of the map's sample that it lies in, as the map says no more.
fn spread(places: &[(usize, usize)], values: &Array1<f64>, side: usize) -> Array2<f64> {
    let mut map = Array2::zeros((side, side));
    places.iter().zip(values).for_each(|(&at, &value)| map[at] = value);
    Array2::from_shape_fn((HELD_SAMPLES, HELD_SAMPLES), |(y, x)| {
        map[[y * side / HELD_SAMPLES, x * side / HELD_SAMPLES]]
    })
}

/// Whether a sample of a map says something of the glass behind it.
fn shows(nm: f64, glass: f64) -> bool {
    nm.is_finite() && nm != 0.0 && glass >= LEAST_GLASS
}

/// Least squares of `values` by the rows of `shapes`, held by `ridge` of the strongest.
fn fitted(shapes: &Array2<f64>, values: ArrayView1<f64>, ridge: f64) -> Result<Array1<f64>> {
    let (mut gram, right) = (shapes.dot(&shapes.t()), shapes.dot(&values));
    let held = ridge * gram.diag().fold(0.0, |a: f64, &b| a.max(b));
    let size = gram.nrows();
    gram.diag_mut().iter_mut().for_each(|value| *value += held);
    let factor = Cholesky::new(gram.view())
        .map_err(|failure| Error::Internal(format!("{size} shapes are not independent: {failure}")))?;
    Ok(factor.solve(right.insert_axis(Axis(1)).view()).remove_axis(Axis(1)))
}

/// The mirror's surface over the whole grid, nm, `[y, x]`.
fn surface(
    influence: &cophase::modes::InfluenceFunctions,
    commands_nm: &Array1<f64>,
    width_m: f64,
) -> Result<Array2<f64>> {
    let grid = Grid::new(HELD_SAMPLES, width_m)?;
    let xs_m: Vec<f64> = (0..HELD_SAMPLES).map(|x| grid.coordinate_m(x)).collect();
    let mut map_nm = Array2::zeros((HELD_SAMPLES, HELD_SAMPLES));
    for (y, mut row) in map_nm.outer_iter_mut().enumerate() {
        let ys_m = vec![grid.coordinate_m(y); HELD_SAMPLES];
        row.assign(&commands_nm.dot(&influence.evaluate(&xs_m, &ys_m)?));
    }
    Ok(map_nm)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A map that the mirror can make, and checks of one sample that it cannot.
    fn map(detail_nm: f64, across: bool) -> Array2<f64> {
        let grid = Grid::new(80, 11.25).unwrap();
        let glass = Telescope::new(&Scene::preset("keck-onsky").unwrap()).unwrap().pupil_on(grid).unwrap().amplitude;
        let map = Array2::from_shape_fn((80, 80), |(y, x)| {
            let (x_m, y_m) = (grid.coordinate_m(x), grid.coordinate_m(y));
            let smooth_nm = 100.0 * (0.9 * x_m).sin() * (0.7 * y_m + 0.3).cos() + 5.0;
            let check = if (x + y) % 2 == 0 { 1.0 } else { -1.0 };
            if glass[[y, x]] > 0.0 { smooth_nm + check * detail_nm } else { 0.0 }
        });
        if across { map.t().to_owned() } else { map }
    }

    #[test]
    fn smooth_maps_fit_the_mirror_and_the_rest_is_reported() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let (folder, out) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
        for (name, map) in [("NCPA_a", map(0.0, false)), ("NCPA_b", map(20.0, true))] {
            let mut file = FitsWriter::create(folder.path().join(format!("{name}.fits"))).unwrap();
            file.image("MAP", &map, Pixel::F64, "nm").unwrap();
            file.finish().unwrap();
        }
        let held = held_maps(folder.path(), &scene, out.path()).unwrap();
        assert_eq!((held.len(), held[0].turned, held[1].turned), (2, false, true));
        // A wave of 12 pitches is held but for the ridge and the edge: a few hundredths. Checks are
        // not, but for the edge.
        assert!(held[0].left_nm < 0.05 * held[0].rms_nm, "{held:?}");
        assert!((held[1].left_nm / 20.0 - 1.0).abs() < 0.05, "{held:?}");
        let smooth = read_map(&held[1].held, None).unwrap();
        let grid = Grid::new(HELD_SAMPLES, 11.25).unwrap();
        assert_eq!(smooth.dim(), (HELD_SAMPLES, HELD_SAMPLES));
        assert!(smooth.iter().all(|nm| nm.abs() < 300.0), "it goes on where the map shows nothing, and nowhere far");
        // Where the map has values, the whole map differs from the projection by the RMS that was
        // reported.
        let rest = read_map(&held[1].whole, None).unwrap() - &smooth;
        let shown = rest.iter().filter(|nm| **nm != 0.0);
        let rms_nm = (shown.clone().map(|nm| nm * nm).sum::<f64>() / shown.count() as f64).sqrt();
        assert!((rms_nm / held[1].left_nm - 1.0).abs() < 1e-9, "{rms_nm} {held:?}");
        assert!(grid.pitch_m() < 0.03);
    }

    #[test]
    fn a_folder_without_maps_is_named() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let empty = tempfile::tempdir().unwrap();
        let error = held_maps(empty.path(), &scene, empty.path()).unwrap_err();
        assert!(error.to_string().contains("NCPA*.fits"), "{error}");
        assert!(held_maps(&empty.path().join("no"), &scene, empty.path()).is_err());
    }
}
