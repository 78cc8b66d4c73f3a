//! Maps of the optical path difference (OPD) from FITS files, in the convention of POPPY and STPSF
//! (WebbPSF).
//!
//! | Card | What it says |
//! |---|---|
//! | `BUNIT` | unit: nm, um, m, mm, Angstrom and their names; nm without it, where the map is plausible so |
//! | `GRID_M`, else `PUPLSCAL`, else `PIXELSCL` | width of the map; distance of its samples, m |
//! | `S01PISTN`, `S01XTILT`, `S01YTILT`, … | piston and tilts of each segment, m, that the map does **not** hold |
//!
//! STPSF writes the cards of the segments where it has taken their pistons and tilts out of the map
//! (`remove_piston_tip_tilt` of `stpsf.opds.OTE_Linear_Model_WSS`). With r half of a segment's
//! extent along x, about its centre, they are the coefficients of 1, y/r (a tilt about x) and x/r
//! (a tilt about y), those of `poppy.zernike.hexike_basis_wss`.

use super::continuation::continued;
use super::map_on_grid::MapOnGrid;
use crate::io::{Card, FitsReader};
use crate::pupil::Pupil;
use crate::scene::System;
use crate::{Error, Result};
use ndarray::{Array2, Axis};
use std::f64::consts::TAU;
use std::path::Path;

/// A map of the optical path difference on a grid of its own.
#[derive(Debug, Clone)]
pub struct OpdMap {
    /// The map, `[y, x]`, nm; may be NaN outside the pupil.
    pub values_nm: Array2<f64>,
    /// Width of the map, m; `None` where its file does not say it.
    pub width_m: Option<f64>,
    /// Piston, XTILT and YTILT of each segment that are not in the map, nm; empty without such
    /// cards.
    pub segments_nm: Vec<[f64; 3]>,
}

/// Piston of a segment, nm, and its slopes along x and y, nm/m, about its centre.
pub type SegmentPlane = [f64; 3];

impl OpdMap {
    /// Reads the first map of the FITS file `path`, or that of the HDU in brackets behind its name.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read, a map that is not square, a unit that is no
    /// length, a width that is not positive, and cards of segments with a gap between them.
    pub fn read(path: &Path) -> Result<Self> {
        let mut file = FitsReader::open(path)?;
        let (nm, values) = (unit_nm(&mut file, None)?, file.map(None)?);
        Self::from_values(path, &mut file, values, nm)
    }

    /// As [`OpdMap::read`], map `plane` of a cube; also of a phase (rad, or waves) of light of
    /// `wavelength_nm`.
    ///
    /// # Errors
    /// As [`OpdMap::read`]; [`Error::File`] for a map that the cube does not have.
    pub fn read_plane(path: &Path, plane: usize, wavelength_nm: f64) -> Result<Self> {
        let mut file = FitsReader::open(path)?;
        let nm = unit_nm(&mut file, Some(wavelength_nm))?;
        let values = file.map_or_cube()?;
        let count = if values.ndim() == 3 { values.len_of(Axis(0)) } else { 1 };
        if plane >= count {
            return Err(Error::file(
                path,
                format_args!("image.diversity_planes has {plane}, and the file has {count} maps, counted from 0"),
            ));
        }
        let map = if values.ndim() == 3 { values.index_axis_move(Axis(0), plane) } else { values };
        let map = map.into_dimensionality().map_err(|error| Error::Internal(error.to_string()))?;
        Self::from_values(path, &mut file, map, nm)
    }

    /// The map `values` of the first image of `file`, in units of `nm`, or without a unit.
    fn from_values(path: &Path, file: &mut FitsReader, values: Array2<f64>, nm: Option<f64>) -> Result<Self> {
        let values_nm = values * nm.unwrap_or(1.0);
        if let Some(likely) = likely_unit(values_nm.iter().copied()).filter(|_| nm.is_none()) {
            return Err(Error::file(
                path,
                format_args!("no card BUNIT has the unit of the map, and {likely}: BUNIT is needed"),
            ));
        }
        let (rows, columns) = values_nm.dim();
        if rows != columns {
            return Err(Error::file(
                path,
                format_args!("the map has {columns}x{rows} samples: a square map is accepted"),
            ));
        }
        let width_m = width_m(file, columns)?;
        Ok(Self { values_nm, width_m, segments_nm: segment_cards(file)? })
    }

    /// The map over its own width, or over `width_m` where its file does not say it.
    ///
    /// # Errors
    /// Those of [`MapOnGrid::new`].
    pub fn on_width(&self, width_m: f64) -> Result<MapOnGrid> {
        MapOnGrid::new(self.values_nm.clone(), self.width_m.unwrap_or(width_m))
    }

    /// As [`OpdMap::on_width`] of the grid of `pupil`, with what the map does not have beyond the
    /// edge continued from inside.
    ///
    /// # Errors
    /// [`Error::Value`] for a map that is narrower than the pupil: its cards have another unit, or
    /// it is one of another telescope.
    pub fn over(&self, pupil: &Pupil) -> Result<MapOnGrid> {
        let width_m = self.width_m.unwrap_or(pupil.grid.width_m());
        check_width(width_m, pupil)?;
        MapOnGrid::new(continued(&self.values_nm, width_m, pupil), width_m)
    }

    /// Pistons and slopes of the segments of `pupil` that are not in the map; `None` without cards
    /// of segments.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of segments.
    pub fn segment_planes(&self, pupil: &Pupil) -> Result<Option<Vec<SegmentPlane>>> {
        let (cards, segments) = (self.segments_nm.len(), pupil.segments.len());
        if cards == 0 {
            return Ok(None);
        }
        if cards != segments {
            return Err(Error::Value(format!(
                "the map has cards of {cards} segments (S01PISTN, ...) where the pupil has {segments}: one of each is needed"
            )));
        }
        let planes = self.segments_nm.iter().zip(half_extents_m(pupil));
        Ok(Some(planes.map(|([piston, about_x, about_y], r)| [*piston, about_y / r, about_x / r]).collect()))
    }
}

/// Least RMS of a wavefront in nm that is believed where nothing names its unit: no telescope is as
/// flat.
const LEAST_RMS_NM: f64 = 0.5;

/// The unit that wavefronts without one are likely in, as part of a sentence, where their RMS is
/// too small for nm; `None` for a plausible one and for 0.
pub fn likely_unit(values_nm: impl Iterator<Item = f64>) -> Option<String> {
    let known = values_nm.filter(|value| value.is_finite() && *value != 0.0);
    let (sum, count) = known.fold((0.0, 0usize), |(sum, count), value| (sum + value * value, count + 1));
    let rms_nm = (sum / count.max(1) as f64).sqrt();
    if rms_nm == 0.0 || rms_nm >= LEAST_RMS_NM {
        return None;
    }
    let of_lengths = [("um", 1e3), ("m", 1e9)].into_iter().find(|(_, nm)| (1.0..1e5).contains(&(rms_nm * nm)));
    let waves = rms_nm / TAU;
    let in_radians =
        if waves > 1e-3 { format!(", and {waves:.3} waves if they are in radians") } else { String::new() };
    let likely = of_lengths.map(|(unit, nm)| format!(", but {:.3} nm if they are in {unit}{in_radians}", rms_nm * nm));
    Some(format!("the RMS of the values as nm is {rms_nm:.2e}{}", likely.unwrap_or_default()))
}

/// Remark on a map of the scene's diversity whose file does not say its unit; `None` for other
/// scenes.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, or whose unit is no length.
pub fn unit_remark(scene: &System) -> Result<Option<String>> {
    let Some(file) = &scene.image.diversity_file else { return Ok(None) };
    let path = scene.resolve(file);
    let is_stated = unit_nm(&mut FitsReader::open(&path)?, Some(scene.image.wavelength_nm))?.is_some();
    let shown = path.display();
    Ok((!is_stated).then(|| format!("The diversity was read in nm, because {shown} has no card BUNIT.")))
}

/// Unit of the first image of `file`, nm; `None` without the card `BUNIT`. A phase is one of light
/// of `wavelength_nm`, where that is known.
///
/// # Errors
/// [`Error::File`] for a unit that is no length.
pub(super) fn unit_nm(file: &mut FitsReader, wavelength_nm: Option<f64>) -> Result<Option<f64>> {
    let unit = match file.image_card("BUNIT")? {
        Some(Card::Text(text)) => text.trim().to_lowercase(),
        _ => String::new(),
    };
    match unit.trim_end_matches('s') {
        "" => Ok(None),
        "nm" | "nanometer" | "nanometre" => Ok(Some(1.0)),
        "um" | "micron" | "micrometer" | "micrometre" => Ok(Some(1e3)),
        "m" | "meter" | "metre" => Ok(Some(1e9)),
        "mm" | "millimeter" | "millimetre" => Ok(Some(1e6)),
        "angstrom" => Ok(Some(0.1)),
        "rad" | "radian" | "wave" => {
            if let Some(wavelength_nm) = wavelength_nm {
                return Ok(Some(if unit.starts_with('w') { wavelength_nm } else { wavelength_nm / TAU }));
            }
            let sentence = format_args!(
                "BUNIT = '{unit}': a length (nm, um, m, mm, Angstrom) is accepted for a wavefront, λ for a wave and λ/2π for a radian"
            );
            Err(Error::file(file.path(), sentence))
        }
        _ => {
            let sentence = format_args!("BUNIT = '{unit}': nm, um, m, mm and Angstrom are accepted for a wavefront");
            Err(Error::file(file.path(), sentence))
        }
    }
}

/// Width of the first image of `file`, of `columns` samples, by its cards, m; `None` without them.
///
/// # Errors
/// [`Error::File`] for a width that is not positive.
pub(super) fn width_m(file: &mut FitsReader, columns: usize) -> Result<Option<f64>> {
    for (key, samples) in [("GRID_M", 1), ("PUPLSCAL", columns), ("PIXELSCL", columns)] {
        if let Some(card) = file.image_card(key)? {
            let number = card.number().filter(|number| number.is_finite() && *number > 0.0);
            let number = number
                .ok_or_else(|| Error::file(file.path(), format_args!("{key} = {card}: a length in m is accepted")))?;
            return Ok(Some(number * samples as f64));
        }
    }
    Ok(None)
}

/// Refuses a map of `width_m` that is narrower than the pupil.
///
/// # Errors
/// [`Error::Value`] with both widths.
pub(super) fn check_width(width_m: f64, pupil: &Pupil) -> Result<()> {
    let grid = &pupil.grid;
    let reach_m = |(y, x): (usize, usize)| grid.coordinate_m(x).abs().max(grid.coordinate_m(y).abs());
    let needed_m = 2.0 * pupil.owned_samples().map(|(at, _)| reach_m(at)).fold(0.0, f64::max);
    if width_m < needed_m - grid.pitch_m() {
        return Err(Error::Value(format!(
            "the map is {width_m} m wide (GRID_M, or PUPLSCAL or PIXELSCL times its samples) where the pupil is {needed_m:.4} m: a map \
             of the whole pupil is accepted"
        )));
    }
    Ok(())
}

/// The cards of the segments, nm.
fn segment_cards(file: &mut FitsReader) -> Result<Vec<[f64; 3]>> {
    let mut found: Vec<[f64; 3]> = Vec::new();
    for segment in 1..100 {
        let mut terms_nm = [None; 3];
        for (term_nm, name) in terms_nm.iter_mut().zip(["PISTN", "XTILT", "YTILT"]) {
            *term_nm =
                file.image_card(&format!("S{segment:02}{name}"))?.and_then(|card| card.number()).map(|m| m * 1e9);
        }
        if terms_nm.iter().all(Option::is_none) {
            continue;
        }
        if found.len() + 1 != segment {
            let (path, missing) = (file.path(), found.len() + 1);
            return Err(Error::file(
                path,
                format_args!("has cards S{segment:02}PISTN, ... and none of segment {missing:02}"),
            ));
        }
        found.push(terms_nm.map(|nm| nm.unwrap_or(0.0)));
    }
    Ok(found)
}

/// Half of the extent along x of each segment, m.
fn half_extents_m(pupil: &Pupil) -> Vec<f64> {
    let mut ends = vec![[f64::INFINITY, f64::NEG_INFINITY]; pupil.segments.len()];
    for ((_, x), segment) in pupil.owned_samples() {
        let (x_m, [low, high]) = (pupil.grid.coordinate_m(x), &mut ends[segment]);
        (*low, *high) = (low.min(x_m), high.max(x_m));
    }
    // A segment of one column of samples is as wide as a sample.
    ends.into_iter().map(|[low, high]| ((high - low) / 2.0).max(pupil.grid.pitch_m() / 2.0)).collect()
}
