//! FITS reader: opens a file once, then reads its images, maps, tables and cards.

use std::ffi::CString;
use std::io::{Cursor, Read, Seek};
use std::path::{Path, PathBuf};

use ndarray::{Array2, Array3, ArrayD};

use super::card;
use super::cfitsio::{CfitsioResult, FitsHandle};
use super::extension;
use super::layout::{self, Hdu, HduKind, Layout};
use super::standard;
use super::value::{Card, checked_keyword_to_read};
use super::{packed, regular};
use crate::machine;
use crate::{Error, Result};

/// Longest file name that cfitsio opens (FLEN_FILENAME of fitsio.h, less a margin); files with
/// longer names are read into memory.
const MAX_NAME: usize = 1000;

/// A FITS file open for reading. The file is never changed.
///
/// An HDU is named by its `EXTNAME`, which is the first of that name, or with its `EXTVER` as in
/// `IMAGES,2`.
///
/// Files in standard form are read from disk; packed files, files that need repair and files with a
/// tile-compressed image (`.fz`), which is read as the plain one, are read from a copy in memory,
/// see [`FitsReader::repaired`].
pub struct FitsReader {
    path: PathBuf,
    pub(super) handle: FitsHandle,
    pub(super) layout: Layout,
    /// Index of the HDU that the path names in brackets.
    pub(super) selected: Option<usize>,
}

impl FitsReader {
    /// Opens `path`: a file name, or where there is no such file a name with an HDU in brackets,
    /// `night.fits[SCI]` or `night.fits[2]` (0 for the primary HDU), which takes the place of the
    /// first image. Other syntax has no meaning.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is missing, empty, truncated, or not FITS, with the byte and
    /// the reason; for an HDU that it does not have.
    pub fn open(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let (file, hdu) = extension::split(path);
        let mut reader = Self::open_file(&file)?;
        if let Some(hdu) = hdu {
            let found = extension::find(&reader.layout, &hdu);
            let count = reader.layout.hdus.len();
            reader.selected = Some(found.ok_or_else(|| {
                reader.refuse(format!("has no HDU `{hdu}`: {}, numbers 0 to {}", reader.listed(), count - 1))
            })?);
            reader.path = path.to_path_buf();
        }
        Ok(reader)
    }

    fn open_file(path: &Path) -> Result<Self> {
        let refused = |reason: String| Error::file(path, reason);
        let mut file = regular::open(path, "a FITS file")?;
        let mut magic = [0; 2];
        let packed = file.read(&mut magic).is_ok_and(|got| got == 2 && magic == [0x1f, 0x8b]);
        file.rewind().map_err(|error| refused(format!("cannot be read: {error}")))?;
        if packed {
            let mut source = Cursor::new(packed::unpack(file).map_err(refused)?);
            return Self::from_source(path, &mut source, None).map_err(refused);
        }
        let direct = (path.as_os_str().len() <= MAX_NAME).then_some(path);
        Self::from_source(path, &mut file, direct).map_err(refused)
    }

    /// Reads `source`; where `direct` is given and the file is in standard form, cfitsio opens it
    /// from disk.
    fn from_source(path: &Path, source: &mut (impl Read + Seek), direct: Option<&Path>) -> CfitsioResult<Self> {
        let length = source.seek(std::io::SeekFrom::End(0)).map_err(|error| format!("cannot be read: {error}"))?;
        let mut layout = layout::scan(source, length)?;
        let handle = match direct.filter(|_| layout.repairs.sentence().is_none() && !layout.holds_compressed()) {
            Some(plain) => FitsHandle::open(plain)?,
            None => FitsHandle::from_bytes(&standard::standard_file(&mut layout, source)?)?,
        };
        Ok(Self { path: path.to_path_buf(), handle, layout, selected: None })
    }

    /// Path of the file, as given.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Repairs of a file that is not standard FITS, as one sentence.
    pub fn repaired(&self) -> Option<String> {
        self.layout.repairs.sentence()
    }

    /// Names of all HDUs, upper case; without a name, `PRIMARY` for the first and empty for others.
    pub fn names(&self) -> Vec<String> {
        self.layout.hdus.iter().map(|hdu| hdu.name.clone()).collect()
    }

    /// A 1-D image by the name of its HDU.
    ///
    /// # Errors
    /// As [`map`](Self::map), for an image that is not 1-D.
    pub fn vector(&mut self, hdu: &str) -> Result<Vec<f64>> {
        let index = self.find(hdu, HduKind::Image)?;
        Ok(self.planes(index, &[1])?.into_raw_vec_and_offset().0)
    }

    /// The values of a 1-D image, or of a 2-D one of a single row: HDU `hdu`, or the first image
    /// with data.
    ///
    /// # Errors
    /// As [`map`](Self::map), for an image of several rows.
    pub fn row(&mut self, hdu: Option<&str>) -> Result<Vec<f64>> {
        let index = hdu.map_or_else(|| self.first_image(&[]), |name| self.find(name, HduKind::Image))?;
        let data = self.planes(index, &[1, 2])?;
        match data.shape() {
            [_] | [1, _] => Ok(data.into_raw_vec_and_offset().0),
            shape => Err(Error::file(&self.path, format_args!("its image has {} rows: one is needed", shape[0]))),
        }
    }

    /// A map `[y, x]`: HDU `hdu`, or the first image with data. BLANK pixels are NaN.
    ///
    /// # Errors
    /// [`Error::File`] where that HDU is missing, not an image, or not 2-D.
    pub fn map(&mut self, hdu: Option<&str>) -> Result<Array2<f64>> {
        let index = hdu.map_or_else(|| self.first_image(&[]), |name| self.find(name, HduKind::Image))?;
        self.planes(index, &[2])?.into_dimensionality().map_err(|error| Error::Internal(error.to_string()))
    }

    /// The first image with data, a map `[y, x]` or a cube `[image, y, x]`. BLANK pixels are NaN.
    ///
    /// # Errors
    /// [`Error::File`] where there is none, or it is neither 2-D nor 3-D.
    pub fn map_or_cube(&mut self) -> Result<ArrayD<f64>> {
        let index = self.first_image(&[])?;
        self.planes(index, &[2, 3])
    }

    /// A cube `[image, y, x]`: image HDU `hdu`; a 2-D image is a cube of one image. BLANK pixels
    /// are NaN.
    ///
    /// # Errors
    /// [`Error::File`] where that HDU is missing, not an image, or neither 2-D nor 3-D.
    pub fn cube(&mut self, hdu: &str) -> Result<Array3<f64>> {
        let index = self.find(hdu, HduKind::Image)?;
        self.cube_at(index)
    }

    pub(super) fn cube_at(&mut self, index: usize) -> Result<Array3<f64>> {
        let data = self.planes(index, &[2, 3])?;
        let data = if data.ndim() == 2 { data.insert_axis(ndarray::Axis(0)) } else { data };
        data.into_dimensionality().map_err(|error| Error::Internal(error.to_string()))
    }

    /// The card `key` of HDU `hdu` (`None`: the primary HDU); `None` where it is absent or has no
    /// value.
    ///
    /// # Errors
    /// [`Error::File`] where the HDU is missing; [`Error::Value`] for a keyword that FITS does not
    /// allow.
    pub fn card(&mut self, hdu: Option<&str>, key: &str) -> Result<Option<Card>> {
        let index = hdu.map_or(Ok(0), |name| self.find_any(name))?;
        self.card_at(index, key)
    }

    /// The comment of the card `key` of the HDU `hdu` (any extension), or of the primary HDU; empty
    /// where there is none.
    pub(crate) fn comment(&mut self, hdu: Option<&str>, key: &str) -> Result<String> {
        let index = hdu.map_or(Ok(0), |name| self.find_any(name))?;
        Ok(self.written_at(index, key).1)
    }

    /// The card `key` of the image that [`map`](Self::map) reads without a name, else of the
    /// primary HDU.
    ///
    /// # Errors
    /// As [`FitsReader::card`], and where there is no image.
    pub fn image_card(&mut self, key: &str) -> Result<Option<Card>> {
        let index = self.first_image(&[])?;
        match self.card_at(index, key)? {
            None => self.card_at(0, key),
            found => Ok(found),
        }
    }

    pub(super) fn card_at(&mut self, index: usize, key: &str) -> Result<Option<Card>> {
        let key = checked_keyword_to_read(key)?;
        let Some(value) = self.layout.hdus[index].value(&key).map(str::to_owned) else { return Ok(None) };
        // No text of several cards has a keyword of several words.
        if value.starts_with('\'') && key.contains(' ') {
            return Ok(Some(Card::Text(card::text(&value))));
        }
        if value.starts_with('\'') {
            let name = CString::new(key).map_err(|error| Error::Internal(error.to_string()))?;
            self.move_to(index)?;
            return self
                .handle
                .long_text(&name)
                .map(|text| Some(Card::Text(text)))
                .map_err(|reason| self.refuse(reason));
        }
        Ok(Card::parse(&value))
    }

    /// Index of the image that the path names in brackets; `None` where it names none.
    ///
    /// # Errors
    /// [`Error::File`] for an HDU that is no image with data.
    pub(super) fn selected_image(&self) -> Result<Option<usize>> {
        let Some(index) = self.selected else { return Ok(None) };
        let hdu = &self.layout.hdus[index];
        if hdu.kind == HduKind::Compressed {
            return Err(self.refuse(&hdu.refusal));
        }
        if hdu.kind != HduKind::Image || hdu.axes.is_empty() {
            return Err(self.refuse(format!("{} is no image with data: {}", hdu.described(), self.listed())));
        }
        Ok(Some(index))
    }

    /// The value of a card as written, and its comment; empty where it is absent.
    pub(super) fn written_at(&self, index: usize, key: &str) -> (String, String) {
        let found = self.layout.hdus[index].value_and_comment(key);
        found.map(|(value, comment)| (value.to_string(), comment.to_string())).unwrap_or_default()
    }

    /// Index of the image that the path names, else of the first image with data whose name is not
    /// in `besides`.
    pub(super) fn first_image(&self, besides: &[&str]) -> Result<usize> {
        if let Some(index) = self.selected_image()? {
            return Ok(index);
        }
        let holds =
            |hdu: &Hdu| hdu.kind == HduKind::Image && !hdu.axes.is_empty() && !besides.contains(&hdu.name.as_str());
        let hdus = &self.layout.hdus;
        hdus.iter().position(holds).ok_or_else(|| {
            let compressed = hdus.iter().find(|hdu| hdu.kind == HduKind::Compressed);
            compressed.map_or_else(
                || self.refuse(format!("holds no image: {}", self.listed())),
                |hdu| self.refuse(&hdu.refusal),
            )
        })
    }

    /// Indices of all HDUs `name` that are images with data, in the order of their EXTVER (1 where
    /// there is none).
    pub(super) fn all_images(&self, name: &str) -> Vec<usize> {
        let hdus = &self.layout.hdus;
        let is_one = |hdu: &Hdu| hdu.name == name && hdu.kind == HduKind::Image && !hdu.axes.is_empty();
        let mut found: Vec<usize> = (0..hdus.len()).filter(|&index| is_one(&hdus[index])).collect();
        found.sort_by_key(|&index| hdus[index].version().unwrap_or(1));
        found
    }

    /// Index of HDU `name` of kind `kind`.
    pub(super) fn find(&self, name: &str, kind: HduKind) -> Result<usize> {
        if let Some(index) = self.layout.hdus.iter().position(|hdu| hdu.is_named(name) && hdu.kind == kind) {
            return Ok(index);
        }
        let index = self.find_any(name)?;
        let hdu = &self.layout.hdus[index];
        let (wanted, content) = match (kind, hdu.kind) {
            (_, HduKind::Compressed) => return Err(self.refuse(&hdu.refusal)),
            (HduKind::Image, _) => ("an image", "a table"),
            _ => ("a table", "something else"),
        };
        Err(self.refuse(format!("HDU `{name}` contains {content}, where {wanted} is needed")))
    }

    /// Whether several HDUs `name` are images with data.
    pub fn has_several(&self, name: &str) -> bool {
        self.all_images(name).len() > 1
    }

    /// Whether the file is read as a whole, and not by the HDU in brackets behind its name.
    pub fn is_whole(&self) -> bool {
        self.selected.is_none()
    }

    /// Whether the file has the HDU `name`.
    pub fn has(&self, name: &str) -> bool {
        self.find_any(name).is_ok()
    }

    fn find_any(&self, name: &str) -> Result<usize> {
        let found = self.layout.hdus.iter().position(|hdu| hdu.is_named(name));
        found.ok_or_else(|| self.refuse(format!("has no HDU `{name}`: {}", self.listed())))
    }

    fn listed(&self) -> String {
        let names: Vec<_> = self.layout.hdus.iter().map(|hdu| hdu.described()).collect();
        format!("there are {}", names.join(", "))
    }

    /// Whether the primary HDU has no image of its own, so that its cards describe that at `index`,
    /// and this HDU does not say otherwise (the card `INHERIT` of the FITS convention of this
    /// name).
    pub(super) fn is_inherited_by(&self, index: usize) -> bool {
        index > 0 && self.layout.hdus[0].axes.is_empty() && self.layout.hdus[index].value("INHERIT") != Some("F")
    }

    /// HDU `index` in words.
    pub(super) fn described(&self, index: usize) -> String {
        self.layout.hdus[index].described()
    }

    pub(super) fn name_of(&self, index: usize) -> &str {
        &self.layout.hdus[index].name
    }

    pub(super) fn version_of(&self, index: usize) -> Option<i64> {
        self.layout.hdus[index].version()
    }

    /// The image at `index`, with axes in C order; the number of axes must be one of `ranks`.
    fn planes(&mut self, index: usize, ranks: &[usize]) -> Result<ArrayD<f64>> {
        let hdu = &self.layout.hdus[index];
        let shape: Vec<usize> = hdu.axes.iter().rev().map(|&size| size as usize).collect();
        let what = hdu.described();
        if !ranks.contains(&shape.len()) {
            let accepted = if ranks.len() == 1 { "2-D (y, x) is" } else { "2-D (y, x) or 3-D (image, y, x) is" };
            return Err(self.refuse(format!("the image {what} is {}-D, where {accepted} accepted", shape.len())));
        }
        if shape.contains(&0) {
            return Err(self.refuse(format!("the image {what} has no pixels: its shape is {shape:?}")));
        }
        if let Some(reason) = hdu.scaling_fault(["BSCALE", "BZERO"]) {
            return Err(self.refuse(reason));
        }
        let integers = hdu.bitpix > 0;
        self.move_to(index)?;
        self.check_data_sum(index)?;
        let pixels: usize = shape.iter().product();
        // As f64, and once more where a part is copied or masked.
        machine::check_memory(
            format_args!("{}: the image {what} of shape {shape:?}", self.path.display()),
            9 * pixels as u64,
            "give a smaller image",
        )?;
        let data = self.handle.image(shape.len(), pixels, integers).map_err(|reason| self.refuse(reason))?;
        ndarray::ArrayD::from_shape_vec(shape, data).map_err(|error| Error::Internal(error.to_string()))
    }

    /// Refuses an HDU whose data are not those that its card `DATASUM` was computed of. A card
    /// without a number says nothing.
    pub(super) fn check_data_sum(&mut self, index: usize) -> Result<()> {
        let Some(stated) =
            self.layout.hdus[index].value("DATASUM").and_then(|sum| card::text(sum).trim().parse::<u64>().ok())
        else {
            return Ok(());
        };
        let sum = self.handle.data_sum().map_err(|reason| self.refuse(reason))?;
        if sum == stated {
            return Ok(());
        }
        let what = self.layout.hdus[index].described();
        Err(self.refuse(format!(
            "the file is damaged: the data of {what} have the sum {sum}, where its card DATASUM is {stated}; the original, or for data \
             that were changed on purpose a file without this card, is needed"
        )))
    }

    pub(super) fn move_to(&mut self, index: usize) -> Result<()> {
        self.handle.move_to(index).map_err(|reason| self.refuse(reason))
    }

    pub(super) fn refuse(&self, reason: impl std::fmt::Display) -> Error {
        Error::file(&self.path, reason)
    }
}

/// Reads a map of `path`: [`FitsReader::map`].
pub fn read_map(path: impl AsRef<Path>, hdu: Option<&str>) -> Result<Array2<f64>> {
    FitsReader::open(path)?.map(hdu)
}

/// Reads a cube of `path`: [`FitsReader::cube`].
pub fn read_cube(path: impl AsRef<Path>, hdu: &str) -> Result<Array3<f64>> {
    FitsReader::open(path)?.cube(hdu)
}
