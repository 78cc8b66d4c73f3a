//! FITS writer: a file is composed in memory and appears at its path complete, or not at all.

use std::ffi::{CString, c_char, c_int, c_void};
use std::io::Write;
use std::path::{Path, PathBuf};

use fitsio::sys;
use flate2::Compression;
use flate2::write::GzEncoder;
use ndarray::{Array2, ArrayRef, Dimension};

use super::cfitsio::FitsHandle;
use super::column::{Column, Values, ascii};
use super::layout::name_and_version;
use super::value::{Card, checked_keyword};
use crate::atomic::Target;
use crate::{Error, Result};

/// Unit of electrons in the cards `BUNIT` and `TUNITn` of a file. FITS (4.0, section 4.3) has no
/// unit `electron`, which strict readers refuse; an electron is a detected photon.
pub const ELECTRON: &str = "photon";

/// Comment of the cards with that unit.
const ELECTRON_COMMENT: &str = "detected photons, which are electrons";

/// Storage type of the pixels of an image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pixel {
    /// 32-bit real (BITPIX −32).
    F32,
    /// 64-bit real (BITPIX −64).
    F64,
    /// 32-bit integer (BITPIX 32): the values must be integers in its range.
    I32,
}

/// A FITS file being composed in memory. [`FitsWriter::finish`] writes a temporary file and renames
/// it to the path; if the writer is dropped before, no file is written.
///
/// The primary HDU has no data, only the header cards of the file, among them ORIGIN and DATE;
/// images and tables are named extensions. Each HDU has its DATASUM and CHECKSUM.
pub struct FitsWriter {
    path: PathBuf,
    handle: FitsHandle,
    /// Names of the HDUs, starting with the primary HDU.
    names: Vec<String>,
}

impl FitsWriter {
    /// Starts a file that will be written to `path`, as a gzip stream where its extension is `gz`.
    /// An existing file will be replaced, unless it is read-only.
    ///
    /// # Errors
    /// [`Error::File`] where the directory is missing or cannot be written, or `path` is not a
    /// plain file: checked here, before hours of computation.
    pub fn create(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref().to_path_buf();
        if has_extension(&path, "fz") {
            let reason = "tile compression (.fz) is not written: .fits, or .fits.gz for a compressed file, is accepted";
            return Err(Error::file(&path, reason));
        }
        let target = Target::new(&path)?;
        // Created and removed immediately: only `finish` leaves a file.
        target.temporary()?.discard();
        let mut handle = FitsHandle::create().map_err(|reason| Error::file(&path, reason))?;
        // SAFETY: no axes, so none are read.
        let made = handle.call(|file, status| unsafe { sys::ffcrimll(file, 8, 0, std::ptr::null_mut(), status) });
        made.map_err(|reason| Error::file(&path, reason))?;
        let mut file = Self { path, handle, names: vec!["PRIMARY".into()] };
        file.card("PRIMARY", "ORIGIN", concat!("cophase ", env!("CARGO_PKG_VERSION")), "program and version")?;
        // SAFETY: the call writes a card into the current HDU.
        file.call(|file, status| unsafe { sys::ffpdat(file, status) })?;
        Ok(file)
    }

    /// Adds a map `[y, x]` over a square grid of side `grid_m`, the optical axis at its centre: the
    /// card `GRID_M`, and the coordinates of its samples in m as cards of the world coordinate
    /// system.
    ///
    /// # Errors
    /// As [`FitsWriter::image`].
    pub fn map(&mut self, name: &str, map: &Array2<f64>, unit: &str, grid_m: f64) -> Result<()> {
        self.image(name, map, Pixel::F64, unit)?;
        self.card(name, "GRID_M", grid_m, "side of the map, m")?;
        for (axis, samples, letter) in [(1, map.ncols(), "X"), (2, map.nrows(), "Y")] {
            // The axis lies between the two central samples, which FITS counts from 1.
            let centre = (samples as f64 + 1.0) / 2.0;
            self.card(name, &format!("CTYPE{axis}"), letter, "position in the pupil")?;
            self.card(name, &format!("CUNIT{axis}"), "m", "")?;
            self.card(name, &format!("CRPIX{axis}"), centre, "sample of the optical axis")?;
            self.card(name, &format!("CRVAL{axis}"), 0.0, "")?;
            self.card(name, &format!("CDELT{axis}"), grid_m / samples as f64, "distance of samples, m")?;
        }
        Ok(())
    }

    /// Adds an image: `array[.., y, x]`, x fastest in the file, in `unit` (empty for none). A name
    /// `NAME,2` is the second HDU of that name: its EXTVER is 2.
    ///
    /// # Errors
    /// [`Error::Value`] where a value does not fit `pixel`, or the name is in use or not printable
    /// ASCII; [`Error::Shape`] for an array without elements.
    pub fn image<A, D>(&mut self, name: &str, array: &ArrayRef<A, D>, pixel: Pixel, unit: &str) -> Result<()>
    where
        A: Copy + Into<f64>,
        D: Dimension,
    {
        let name = self.new_name(name)?;
        if array.is_empty() || array.ndim() == 0 {
            return Err(Error::Shape(format!(
                "image `{name}` has the shape {:?}: every axis needs 1 or more",
                array.shape()
            )));
        }
        let values = array.iter().map(|&value| value.into());
        let mut axes: Vec<i64> = array.shape().iter().rev().map(|&size| size as i64).collect();
        let bitpix = match pixel {
            Pixel::F32 => -32,
            Pixel::F64 => -64,
            Pixel::I32 => 32,
        };
        let mut data = Data::new(values, pixel, &name)?;
        let (count, code, start) = data.raw();
        let mut first = vec![1_i64; axes.len()];
        self.call(|file, status| unsafe {
            // SAFETY: one size and one first pixel per axis; `start` holds `count` values of type
            // `code`.
            sys::ffcrimll(file, bitpix, axes.len() as c_int, axes.as_mut_ptr(), status);
            sys::ffppxll(file, code, first.as_mut_ptr(), count as i64, start, status)
        })?;
        self.names.push(name.clone());
        let (title, version) = name_and_version(&name);
        self.card(&name, "EXTNAME", title, "name of this extension")?;
        self.version_card(&name, version)?;
        let comment = if unit == ELECTRON { ELECTRON_COMMENT } else { "unit of the pixels" };
        if unit.is_empty() { Ok(()) } else { self.card(&name, "BUNIT", unit, comment) }
    }

    /// Adds a binary table; all columns have the same length. Names as for [`FitsWriter::image`].
    ///
    /// # Errors
    /// [`Error::Shape`] for columns of different lengths or none; [`Error::Value`] for a name that
    /// is in use or not printable ASCII.
    pub fn table(&mut self, name: &str, columns: &[Column]) -> Result<()> {
        let name = self.new_name(name)?;
        let rows =
            columns.first().map(Column::len).ok_or_else(|| Error::Shape(format!("table `{name}` has no columns")))?;
        if let Some(odd) = columns.iter().find(|column| column.len() != rows) {
            let (first, odd, length) = (&columns[0].name, &odd.name, odd.len());
            return Err(Error::Shape(format!(
                "table `{name}` has {rows} rows in `{first}` and {length} in `{odd}`: one length is needed"
            )));
        }
        let names = columns.iter().map(|column| c_text(&column.name)).collect::<Result<Vec<_>>>()?;
        let units = columns.iter().map(|column| c_text(&column.unit)).collect::<Result<Vec<_>>>()?;
        let forms = columns.iter().map(|column| c_text(&column.form())).collect::<Result<Vec<_>>>()?;
        let (short, version) = name_and_version(&name);
        let title = c_text(short)?;
        let (mut ttype, mut tform, mut tunit) = (pointers(&names), pointers(&forms), pointers(&units));
        self.call(|file, status| unsafe {
            // SAFETY: one NUL-terminated text per column in each list; cfitsio only reads them.
            let (ttype, tform, tunit) = (ttype.as_mut_ptr(), tform.as_mut_ptr(), tunit.as_mut_ptr());
            let fields = columns.len() as c_int;
            sys::ffcrtb(
                file,
                sys::BINARY_TBL as c_int,
                rows as i64,
                fields,
                ttype,
                tform,
                tunit,
                title.as_ptr(),
                status,
            )
        })?;
        for (i, column) in columns.iter().enumerate().filter(|_| rows > 0) {
            self.fill(i as c_int + 1, column)?;
        }
        self.names.push(name.clone());
        self.version_card(&name, version)?;
        for (i, _) in columns.iter().enumerate().filter(|(_, column)| column.unit == ELECTRON) {
            self.card(&name, &format!("TUNIT{}", i + 1), ELECTRON, ELECTRON_COMMENT)?;
        }
        Ok(())
    }

    /// Adds a table with one column `LINE`: the lines of `text`, as [`Column::text`] writes them.
    ///
    /// # Errors
    /// As [`FitsWriter::table`].
    pub fn text(&mut self, name: &str, text: &str) -> Result<()> {
        self.table(name, &[Column::text("LINE", text.lines())])
    }

    /// Sets a card of HDU `hdu` (`PRIMARY`, or the name of an added HDU). A real number that is not
    /// finite, which FITS cannot represent, is written as a card without value.
    ///
    /// # Errors
    /// [`Error::Value`] for a keyword that FITS does not allow, or an HDU that does not exist.
    pub fn card(&mut self, hdu: &str, key: &str, value: impl Into<Card>, comment: &str) -> Result<()> {
        let key = c_text(&checked_keyword(key)?)?;
        let comment = c_text(comment)?;
        let index = self.names.iter().position(|name| name.eq_ignore_ascii_case(hdu)).ok_or_else(|| {
            Error::Value(format!("there is no HDU `{hdu}` for the card: there are {}", self.names.join(", ")))
        })?;
        self.handle.move_to(index).map_err(|reason| Error::file(&self.path, reason))?;
        let value = value.into();
        let text = c_text(if let Card::Text(text) = &value { text } else { "" })?;
        let (key, comment) = (key.as_ptr(), comment.as_ptr());
        // SAFETY: all texts are NUL-terminated and outlive the call.
        self.call(|file, status| unsafe {
            match &value {
                Card::Text(_) => sys::ffukls(file, key, text.as_ptr(), comment, status),
                Card::Integer(n) => sys::ffukyj(file, key, *n, comment, status),
                Card::Real(x) if x.is_finite() => sys::ffukyd(file, key, *x, -digits(*x), comment, status),
                Card::Real(_) => sys::ffukyu(file, key, comment, status),
                Card::Logical(b) => sys::ffukyl(file, key, c_int::from(*b), comment, status),
            }
        })
    }

    /// Writes the file under a temporary name in the same directory, and renames it to its path.
    ///
    /// # Errors
    /// [`Error::File`] where that fails, for instance on a full disk: no new file is left then, and
    /// a previous file at the path is unchanged.
    pub fn finish(self) -> Result<()> {
        let Self { path, mut handle, names } = self;
        for index in 0..names.len() {
            handle.move_to(index).map_err(|reason| Error::file(&path, reason))?;
            // SAFETY: the call reads the current HDU, and writes its cards DATASUM and CHECKSUM.
            let summed = handle.call(|file, status| unsafe { sys::ffpcks(file, status) });
            summed.map_err(|reason| Error::file(&path, reason))?;
        }
        let bytes = handle.into_bytes(names.len()).map_err(|reason| Error::file(&path, reason))?;
        let bytes =
            if has_extension(&path, "gz") { packed(&bytes).map_err(|error| Error::file(&path, error))? } else { bytes };
        Target::new(&path)?.write(&bytes)
    }

    fn fill(&mut self, number: c_int, column: &Column) -> Result<()> {
        let rows = column.len() as i64;
        if let Values::Lists(lists) = &column.values {
            return lists.iter().enumerate().try_for_each(|(row, list)| self.fill_list(number, row as i64 + 1, list));
        }
        let texts = match &column.values {
            Values::Text(values) => values.iter().map(|value| c_text(value)).collect::<Result<Vec<_>>>()?,
            _ => Vec::new(),
        };
        let mut starts = pointers(&texts);
        let (code, start): (u32, *mut c_void) = match &column.values {
            Values::F64(values) => (sys::TDOUBLE, values.as_ptr().cast_mut().cast()),
            Values::I64(values) => (sys::TLONGLONG, values.as_ptr().cast_mut().cast()),
            Values::Text(_) => (sys::TSTRING, starts.as_mut_ptr().cast()),
            Values::Lists(_) => return Err(Error::Internal("lists are written row by row".into())),
        };
        // SAFETY: `start` holds `rows` values of type `code`; cfitsio only reads them.
        self.call(|file, status| unsafe { sys::ffpcl(file, code as c_int, number, 1, 1, rows, start, status) })
    }

    /// Writes the list in a row of a column, both counted from 1.
    fn fill_list(&mut self, number: c_int, row: i64, list: &[f64]) -> Result<()> {
        // cfitsio writes a list over the one that the row's descriptor names: a row that was not
        // written holds any bytes. SAFETY: the call writes a descriptor of no elements into the
        // current table.
        self.call(|file, status| unsafe { sys::ffpdes(file, number, row, 0, 0, status) })?;
        if list.is_empty() {
            return Ok(());
        }
        let start = list.as_ptr().cast_mut();
        // SAFETY: `start` holds as many values as the list; cfitsio only reads them.
        self.call(|file, status| unsafe { sys::ffpcld(file, number, row, 1, list.len() as i64, start, status) })
    }

    fn call(&mut self, function: impl FnOnce(*mut sys::fitsfile, *mut c_int) -> c_int) -> Result<()> {
        self.handle.call(function).map_err(|reason| Error::file(&self.path, reason))
    }

    /// Writes the EXTVER of HDU `name`, where it has one.
    fn version_card(&mut self, name: &str, version: Option<i64>) -> Result<()> {
        version.map_or(Ok(()), |version| self.card(name, "EXTVER", version, "number among the extensions of this name"))
    }

    /// `name` in capitals.
    ///
    /// # Errors
    /// [`Error::Value`] where it is in use or not printable ASCII.
    fn new_name(&self, name: &str) -> Result<String> {
        let upper = name.trim().to_ascii_uppercase();
        // 60: EXTNAME fits its card without CONTINUE.
        if upper.is_empty() || upper.len() > 60 || upper != ascii(&upper) {
            return Err(Error::Value(format!(
                "`{name}` cannot name an HDU: 1 to 60 printable ASCII characters are accepted"
            )));
        }
        if self.names.contains(&upper) {
            return Err(Error::Value(format!("HDU `{upper}` exists already: names must differ")));
        }
        Ok(upper)
    }
}

/// Whether `path` ends with `.extension`, in capitals or not.
fn has_extension(path: &Path, extension: &str) -> bool {
    path.extension().is_some_and(|own| own.eq_ignore_ascii_case(extension))
}

/// `bytes` as a gzip stream.
fn packed(bytes: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(bytes)?;
    encoder.finish()
}

/// Pixels in their storage type.
enum Data {
    F32(Vec<f32>),
    F64(Vec<f64>),
    I32(Vec<i32>),
}

impl Data {
    fn new(values: impl Iterator<Item = f64>, pixel: Pixel, name: &str) -> Result<Self> {
        let refusal =
            |value: f64, kind: &str| Error::Value(format!("the value {value:?} of image `{name}` is not {kind}"));
        match pixel {
            Pixel::F64 => Ok(Data::F64(values.collect())),
            Pixel::F32 => {
                let narrow = |value: f64| {
                    let fits = !value.is_finite() || (value as f32).is_finite();
                    if fits { Ok(value as f32) } else { Err(refusal(value, "within the range of a 32-bit real")) }
                };
                values.map(narrow).collect::<Result<_>>().map(Data::F32)
            }
            Pixel::I32 => {
                let whole = |value: f64| {
                    let fits = value.fract() == 0.0 && (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value);
                    if fits { Ok(value as i32) } else { Err(refusal(value, "a 32-bit integer")) }
                };
                values.map(whole).collect::<Result<_>>().map(Data::I32)
            }
        }
    }

    /// Count, cfitsio type and address.
    fn raw(&mut self) -> (usize, c_int, *mut c_void) {
        match self {
            Data::F32(values) => (values.len(), sys::TFLOAT as c_int, values.as_mut_ptr().cast()),
            Data::F64(values) => (values.len(), sys::TDOUBLE as c_int, values.as_mut_ptr().cast()),
            Data::I32(values) => (values.len(), sys::TINT as c_int, values.as_mut_ptr().cast()),
        }
    }
}

/// Fewest significant digits, 15 to 17, that read back as `x`: 0.1 stays 0.1.
fn digits(x: f64) -> c_int {
    let exact = |digits: &usize| format!("{x:.*e}", digits - 1).parse() == Ok(x);
    (15..17).find(exact).unwrap_or(17) as c_int
}

fn c_text(text: &str) -> Result<CString> {
    CString::new(ascii(text)).map_err(|error| Error::Internal(error.to_string()))
}

fn pointers(texts: &[CString]) -> Vec<*mut c_char> {
    texts.iter().map(|text| text.as_ptr().cast_mut()).collect()
}
