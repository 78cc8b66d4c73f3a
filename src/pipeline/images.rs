//! Images of an estimate, with bad pixels, read noise, telemetry and truth.

use super::scene_files::refuse_foreign_files;
use crate::ao::{AOT_SCENE, MOVED_REFERENCE};
use crate::io::aot::MatchedSlopes;
use crate::io::{self, FitsReader, HeaderFact, PixelUnit};
use crate::modal::StaticMaps;
use crate::scene::Scene;
use crate::source::{self, SourceImages};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Array3, Axis, s};
use std::borrow::Cow;
use std::path::Path;

/// Images to estimate from.
#[derive(Debug, Clone)]
pub struct Images {
    /// Electrons, `[image, y, x]`; an estimate converts images in another [`Images::unit`] to
    /// electrons.
    pub images_e: Array3<f64>,
    /// Bad pixels, `[image, y, x]`: they are ignored. Pixels that are not finite are bad, too.
    pub bad: Array3<bool>,
    /// Read noise of a pixel, RMS electrons; `None` for the scene's, else the file's, else the
    /// scatter of each image's border.
    pub read_noise_e: Option<f64>,
    /// Slopes of the wavefront sensor, mean over each exposure, `[image, slope]`, mas: along x for
    /// every subaperture, then along y. A MAP estimate uses them; `None` without telemetry.
    pub slopes_mas: Option<Array2<f64>>,
    /// By how much corrections have moved the reference slopes, to which [`Images::slopes_mas`] are
    /// relative, in their order and unit; `None` for what the scene's
    /// `wavefront_sensor.moved_reference_file` says.
    pub moved_reference_mas: Option<Array1<f64>>,
    /// Aberrations that simulated images were made with.
    pub truth: Option<StaticMaps>,
    /// Unit of the pixels: those of an array without a unit are electrons, unless the scene has
    /// `image.gain_e_per_adu`.
    pub unit: PixelUnit,
    /// What the cards of the file state of the instrument. An estimate compares it with the scene.
    pub facts: Vec<HeaderFact>,
    /// Scene in the file, as cophase writes it. An estimate compares what it says of the instrument
    /// with its own scene.
    pub scene: Option<Scene>,
    /// Which of the two holds where the file contradicts the scene.
    pub trust: Trust,
    /// Keys whose value in the scene takes precedence over the file, such as `image.wavelength_nm`.
    pub overrides: Vec<String>,
    /// Name of the channel that they are of, where the file says it.
    pub channel: Option<String>,
    /// Sentences on what was repaired or masked when the images were read; they join the warnings
    /// of an estimate.
    pub notes: Vec<String>,
    /// Sentences on what the file has that was not read; they join the remarks of an estimate.
    pub remarks: Vec<String>,
}

/// Which of two values holds where an image file contradicts the scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Trust {
    /// Neither: a contradiction is an error.
    #[default]
    Neither,
    /// The scene's.
    Scene,
    /// The file's: it replaces the value of the key.
    File,
}

/// Note on pixels that are not finite and were not marked as bad.
fn note_of_masked(count: usize) -> Option<String> {
    let (are, were) = if count == 1 { ("is", "was") } else { ("are", "were") };
    (count > 0).then(|| format!("{} {are} not finite and {were} masked", counted(count, "pixel")))
}

impl Images {
    /// Images `[image, y, x]` whose finite pixels are all good: electrons, or counts where the
    /// scene of the estimate has `image.gain_e_per_adu`.
    pub fn new(images_e: Array3<f64>) -> Self {
        let bad = Array3::from_elem(images_e.dim(), false);
        Self::with_bad(images_e, bad)
    }

    /// [`Images::new`] with a mask of bad pixels, both `[image, y, x]`. Pixels that are not finite
    /// are bad, too, and the notes have the number of those that the mask does not have.
    pub fn with_bad(images_e: Array3<f64>, mut bad: Array3<bool>) -> Self {
        let mut non_finite = 0;
        // A mask of another shape is refused with the images.
        if bad.dim() == images_e.dim() {
            bad.zip_mut_with(&images_e, |bad, electrons| {
                let is_new = !electrons.is_finite() & !*bad;
                non_finite += usize::from(is_new);
                *bad |= is_new;
            });
        }
        Self { notes: note_of_masked(non_finite).into_iter().collect(), ..Self::marked(images_e, bad) }
    }

    /// Images whose pixels that are not finite are among the `bad` ones.
    fn marked(images_e: Array3<f64>, bad: Array3<bool>) -> Self {
        Self {
            images_e,
            bad,
            read_noise_e: None,
            slopes_mas: None,
            moved_reference_mas: None,
            truth: None,
            unit: PixelUnit::Unstated,
            facts: Vec::new(),
            scene: None,
            trust: Trust::Neither,
            overrides: Vec::new(),
            channel: None,
            notes: Vec::new(),
            remarks: Vec::new(),
        }
    }

    /// These images, which are in electrons also where the scene has a gain.
    pub fn in_electrons(self) -> Self {
        Self { unit: PixelUnit::Electrons, ..self }
    }

    /// Reads a FITS file, which may be one of AOT ([`io::aot`]): the images of each channel, in the
    /// order of `EXTVER`, at least one. Of each: images with their unit, `BADPIX` or the file
    /// `mask`, what the cards state of the instrument, the scene (`SCENE`; where it has channels,
    /// that of the one of this name), the telemetry (`SLOPES_MEAN`, else `SLOPES`, of its `EXTVER`,
    /// which is 1 where there is none, and `MOVED_REFERENCE`) and the truth (`TRUTH_PHASING`,
    /// `TRUTH_NCPA`), each where the file has it.
    ///
    /// # Errors
    /// Those of [`io::read_channels`].
    pub fn read(path: impl AsRef<Path>, mask: Option<&Path>) -> Result<Vec<Self>> {
        let path = path.as_ref();
        // A scene of another version, with other keys, cannot be compared.
        let scene = embedded_scene(path, |_| true).ok().flatten();
        let truth = StaticMaps::read_truth(path)?;
        let mut file = FitsReader::open(path)?;
        let moved = moved_reference(&mut file)?;
        let each = io::read_channels(path, mask)?.into_iter().map(|read| {
            let found = slopes(&mut file, &read)?;
            let mut images = Self::marked(read.data, read.bad);
            let masked = note_of_masked(read.non_finite);
            images.notes = read.repaired.into_iter().chain(read.notes).chain(found.left_out).chain(masked).collect();
            (images.unit, images.facts, images.channel) = (read.unit, read.facts, read.channel);
            images.remarks = read.remarks;
            if images.unit == PixelUnit::Unstated {
                let sentence =
                    "The file has no card BUNIT: its pixels are electrons, unless the scene has image.gain_e_per_adu.";
                images.remarks.push(sentence.into());
            }
            images.scene = scene.as_ref().and_then(|scene| own_scene(scene, images.channel.as_deref()));
            (images.slopes_mas, images.truth) = (found.slopes, truth.clone());
            images.moved_reference_mas.clone_from(&moved);
            Ok(images)
        });
        each.collect()
    }

    /// These images with the slopes of the wavefront sensor in the FITS file `path` in place of
    /// their own: a row for each image, in the order and unit of the scene's `[wavefront_sensor]`;
    /// NaN for images without telemetry. They are in the HDU that `FILE[HDU]` names, else in
    /// `SLOPES_MEAN`, else in `SLOPES`, else in the first image, with `MOVED_REFERENCE` where the
    /// file is read as a whole; of a file of AOT ([`io::aot`]) those of its exposures are taken.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read, or whose number of rows is another than that
    /// of the images.
    pub fn with_slopes(self, path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut file = FitsReader::open(path)?;
        let found = if io::aot::is_aot(&file) {
            io::aot::slopes(&mut file, 0, self.len())?
        } else {
            let named = ["SLOPES_MEAN", "SLOPES"].into_iter().find(|hdu| file.is_whole() && file.has(hdu));
            MatchedSlopes { slopes: Some(file.map(named)?), left_out: None }
        };
        let Some(slopes) = found.slopes else {
            let reason = found.left_out.unwrap_or_else(|| "has no slopes of a wavefront sensor".into());
            return Err(Error::file(path, reason));
        };
        if slopes.nrows() != self.len() {
            let (rows, images) = (slopes.nrows(), self.len());
            return Err(Error::file(
                path,
                format_args!("has slopes of {rows} exposures: a row for each of {images} images is accepted"),
            ));
        }
        let notes = self.notes.into_iter().chain(found.left_out).collect();
        Ok(Self { slopes_mas: Some(slopes), moved_reference_mas: moved_reference(&mut file)?, notes, ..self })
    }

    /// Simulated images of an artificial source with their truth, of each channel of the scene: see
    /// [`source::simulate`].
    ///
    /// # Errors
    /// Those of [`source::simulate`].
    pub fn simulated(scene: &Scene) -> Result<Vec<Self>> {
        let named = source::simulate(scene)?.into_iter().zip(scene.each_channel());
        Ok(named.map(|(made, (name, _))| Self { channel: name.map(str::to_owned), ..Self::from(made) }).collect())
    }

    /// The images of the only channel.
    ///
    /// # Errors
    /// [`Error::Image`] where there are several, or none.
    pub fn only(each: Vec<Self>) -> Result<Self> {
        let count = each.len();
        let [one] = <[Self; 1]>::try_from(each).map_err(|_| {
            Error::Image(format!(
                "there are images of {count} channels (HDUs IMAGES with EXTVER 1, 2, ..., or scoring cameras of AOT), where one is \
                 taken: name one as FILE[HDU]"
            ))
        })?;
        Ok(one)
    }

    /// Number of images.
    pub fn len(&self) -> usize {
        self.images_e.dim().0
    }

    /// Whether there is no image.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// These of the images alone, by their numbers from 0, which are there.
    pub(super) fn selected(&self, which: &[usize]) -> Self {
        let has_all = |slopes: &&Array2<f64>| which.iter().all(|number| *number < slopes.nrows());
        Self {
            images_e: self.images_e.select(Axis(0), which),
            bad: self.bad.select(Axis(0), which),
            slopes_mas: self.slopes_mas.as_ref().filter(has_all).map(|slopes| slopes.select(Axis(0), which)),
            moved_reference_mas: self.moved_reference_mas.clone(),
            read_noise_e: self.read_noise_e,
            truth: self.truth.clone(),
            unit: self.unit.clone(),
            facts: self.facts.clone(),
            scene: self.scene.clone(),
            trust: self.trust,
            overrides: self.overrides.clone(),
            channel: self.channel.clone(),
            notes: self.notes.clone(),
            remarks: self.remarks.clone(),
        }
    }

    /// These images without their last row or column where a frame of the scene, `(rows, columns)`,
    /// has one less, and a sentence on it.
    ///
    /// The frames of a scene are even. The axis is on pixel `[rows/2, columns/2]`, rounded down,
    /// which stays the same pixel.
    pub(super) fn without_odd_edge(&self, (rows, columns): (usize, usize)) -> (Cow<'_, Self>, Option<String>) {
        let (_, y, x) = self.images_e.dim();
        let edges = match (y.checked_sub(rows), x.checked_sub(columns)) {
            (Some(1), Some(0)) => "row was",
            (Some(0), Some(1)) => "column was",
            (Some(1), Some(1)) => "row and the last column were",
            _ => return (Cow::Borrowed(self), None),
        };
        let part = s![.., ..rows, ..columns];
        let (images_e, bad) = (self.images_e.slice(part).to_owned(), self.bad.slice(part).to_owned());
        let sentence =
            format!("The last {edges} left out: the images have {x}x{y} pixels, an estimate takes {columns}x{rows}.");
        (Cow::Owned(Self { images_e, bad, ..self.clone() }), Some(sentence))
    }

    /// # Errors
    /// [`Error::Shape`] where mask or telemetry do not belong to the images; [`Error::Value`] for
    /// an impossible read noise.
    pub(super) fn check(&self) -> Result<()> {
        if self.bad.dim() != self.images_e.dim() {
            let (mask, images) = (self.bad.dim(), self.images_e.dim());
            return Err(Error::Shape(format!("the mask of bad pixels has the shape {mask:?}: {images:?} is accepted")));
        }
        // Of an image that is bad altogether the result says that it cannot be used.
        let marked = self.bad.iter().zip(&self.images_e).filter(|(bad, value)| **bad && value.is_finite()).count();
        let share = marked as f64 / self.bad.len().max(1) as f64;
        if share > io::MOST_MARKED && share < 1.0 {
            return Err(Error::Image(format!(
                "the mask marks {:.1} % of the pixels as bad: at most {} % are accepted; in a map of good pixels true and false must \
                 change places",
                100.0 * share,
                100.0 * io::MOST_MARKED
            )));
        }
        if let Some(noise_e) = self.read_noise_e.filter(|noise_e| !(noise_e.is_finite() && *noise_e >= 0.0)) {
            return Err(Error::Value(format!("read_noise_e is {noise_e}: 0 electrons or more is accepted")));
        }
        Ok(())
    }
}

/// Images of one channel are a list of one.
impl AsRef<[Images]> for Images {
    fn as_ref(&self) -> &[Images] {
        std::slice::from_ref(self)
    }
}

impl From<SourceImages> for Images {
    fn from(made: SourceImages) -> Self {
        let truth = StaticMaps { phasing_nm: made.truth.phasing_nm, ncpa_nm: made.truth.ncpa_nm };
        Self { truth: Some(truth), ..Self::new(made.images_e).in_electrons() }
    }
}

/// What `scene` says of the channel `name`; `None` where it has channels and not this one.
fn own_scene(scene: &Scene, name: Option<&str>) -> Option<Scene> {
    match (scene.channels(), name) {
        ([], _) => Some(scene.clone()),
        (channels, Some(name)) => channels.iter().find(|channel| channel.name == name).map(|own| own.scene.clone()),
        (_, None) => None,
    }
}

impl StaticMaps {
    /// The aberrations behind simulated images, in the FITS file `path`; `None` where it holds
    /// none.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be read.
    pub fn read_truth(path: &Path) -> Result<Option<Self>> {
        let mut file = FitsReader::open(path)?;
        if !["TRUTH_PHASING", "TRUTH_NCPA"].iter().all(|name| file.has(name)) {
            return Ok(None);
        }
        // In a file of AOT a map is the only one of a cube of modes.
        let mut map = |name: &str| {
            let cube = file.cube(name)?;
            if cube.dim().0 == 1 { Ok(cube.index_axis_move(Axis(0), 0)) } else { file.map(Some(name)) }
        };
        Ok(Some(Self { phasing_nm: map("TRUTH_PHASING")?, ncpa_nm: map("TRUTH_NCPA")? }))
    }
}

/// The scene that a FITS file carries in its table `SCENE`, or a file of AOT as [`AOT_SCENE`] in
/// its card `CONFIG`, if it has one; its relative file names refer to the file's folder. A file
/// that is read may come from anybody: its scene names files in or below its own folder only,
/// except under keys that `is_accepted` accepts.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, a table that is not a valid scene, and a scene
/// that names a file which is there, but outside of the folder.
pub fn embedded_scene(path: &Path, is_accepted: impl Fn(&str) -> bool) -> Result<Option<Scene>> {
    let mut file = FitsReader::open(path)?;
    let (text, place) = if io::aot::is_aot(&file) {
        let text = io::aot::configuration(&mut file)?;
        (text.and_then(|text| text.strip_prefix(AOT_SCENE).map(str::to_owned)), "card CONFIG")
    } else if file.has("SCENE") {
        (Some(file.text_column("SCENE", "LINE")?.join("\n") + "\n"), "table SCENE")
    } else {
        (None, "")
    };
    let Some(text) = text else { return Ok(None) };
    let directory = path.parent().unwrap_or(Path::new(""));
    let scene =
        Scene::embedded(&text, directory).map_err(|error| Error::file(path, format_args!("{place}: {error}")))?;
    refuse_foreign_files(&scene, path, is_accepted)?;
    Ok(Some(scene))
}

/// By how much corrections have moved the reference slopes, where the file says it.
fn moved_reference(file: &mut FitsReader) -> Result<Option<Array1<f64>>> {
    let is_there = file.is_whole() && file.has(MOVED_REFERENCE);
    is_there.then(|| file.row(Some(MOVED_REFERENCE)).map(Array1::from)).transpose()
}

/// Telemetry of the images `read` in a file, if it has any: of a file of AOT that of their times;
/// else, where the file has the images of several channels, that with their EXTVER.
fn slopes(file: &mut FitsReader, read: &io::HduImages) -> Result<MatchedSlopes> {
    if io::aot::is_aot(file) {
        return io::aot::slopes(file, usize::try_from(read.version - 1).unwrap_or(0), read.data.dim().0);
    }
    let has_channels = file.has_several("IMAGES");
    let hdu = |name: &str| if has_channels { format!("{name},{}", read.version) } else { name.to_owned() };
    let hdu = ["SLOPES_MEAN", "SLOPES"].map(hdu).into_iter().find(|hdu| file.has(hdu));
    let slopes = hdu.map(|hdu| file.map(Some(&hdu))).transpose()?;
    Ok(MatchedSlopes { slopes, left_out: None })
}

/// `1 image`, `2 images`.
pub(super) fn counted(count: usize, noun: &str) -> String {
    format!("{count} {noun}{}", if count == 1 { "" } else { "s" })
}

/// Most ranges of numbers that a sentence has.
const MOST_RANGES: usize = 8;

/// Ascending numbers, counted from `first`, consecutive ones as a range: `1 to 4, 7`.
pub(super) fn in_ranges(numbers: &[usize], first: usize) -> String {
    let mut ranges: Vec<[usize; 2]> = Vec::new();
    for &number in numbers {
        match ranges.last_mut() {
            Some([_, last]) if *last + 1 == number => *last = number,
            _ => ranges.push([number, number]),
        }
    }
    let named = ranges.iter().take(MOST_RANGES).map(|&[from, to]| match to - from {
        0 => format!("{}", from + first),
        1 => format!("{}, {}", from + first, to + first),
        _ => format!("{} to {}", from + first, to + first),
    });
    let more = if ranges.len() > MOST_RANGES { ", ..." } else { "" };
    named.collect::<Vec<_>>().join(", ") + more
}
