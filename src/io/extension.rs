//! Names of files with an HDU in brackets, as cfitsio and ds9 take them: `night.fits[2]`,
//! `night.fits[SCI]`, `night.fits[SCI,2]`.

use super::layout::Layout;
use super::regular;
use std::io::Read;
use std::path::{Path, PathBuf};

/// File and HDU of a name. A file whose own name ends so has priority.
pub(super) fn split(path: &Path) -> (PathBuf, Option<String>) {
    let whole = || (path.to_path_buf(), None);
    if path.exists() {
        return whole();
    }
    let inside = |text: &str| {
        let (file, rest) = text.rsplit_once('[')?;
        let hdu = rest.strip_suffix(']').filter(|hdu| !hdu.trim().is_empty() && !file.is_empty())?;
        Some((PathBuf::from(file), Some(hdu.trim().to_string())))
    };
    path.to_str().and_then(inside).unwrap_or_else(whole)
}

/// The file of a name, without an HDU in brackets.
pub fn file_of(path: impl AsRef<Path>) -> PathBuf {
    split(path.as_ref()).0
}

/// Whether the file of a name begins as FITS does, or is compressed by gzip.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for a file that cannot be read.
pub fn is_fits(path: impl AsRef<Path>) -> crate::Result<bool> {
    let path = file_of(path);
    let mut start = Vec::new();
    let read = regular::open(&path, "a FITS file or a text")?.take(6).read_to_end(&mut start);
    read.map_err(|error| crate::Error::file(&path, error))?;
    Ok(start == b"SIMPLE" || start.starts_with(&[0x1f, 0x8b]))
}

/// Index of the HDU that the text in brackets names: its name, with its EXTVER or without, else its
/// number, 0 for the primary one.
pub(super) fn find(layout: &Layout, hdu: &str) -> Option<usize> {
    let named = layout.hdus.iter().position(|known| known.is_named(hdu));
    named.or_else(|| hdu.parse().ok().filter(|&number: &usize| number < layout.hdus.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_split_where_no_file_has_it() {
        let split = |name: &str| split(Path::new(name));
        assert_eq!(split("no-such/a.fits[SCI]"), ("no-such/a.fits".into(), Some("SCI".into())));
        assert_eq!(split("no-such/a[1].fits[ 2 ]"), ("no-such/a[1].fits".into(), Some("2".into())));
        for whole in ["no-such/a.fits", "no-such/a.fits[]", "[2]", "no-such/a[1].fits"] {
            assert_eq!(split(whole), (whole.into(), None));
        }
        let folder = tempfile::tempdir().unwrap();
        let odd = folder.path().join("a.fits[1]");
        std::fs::write(&odd, "").unwrap();
        assert_eq!(super::split(&odd), (odd.clone(), None));
    }
}
