//! Images of a camera or of the simulator, with their bad pixels and read noise.

use std::path::Path;

use super::aot;
use super::image_hdu::{HduImages, of_data, read_hdu};
use super::layout::HduKind;
use super::mask::BADPIX;
use super::mosaic::{self, Mosaic};
use super::read::FitsReader;
use crate::Result;

/// Reads the images of `path`: the HDU in brackets behind its name if there is one, else HDU
/// `IMAGES` if it exists, else the amplifiers of a detector, an image HDU each with a card
/// `DETSEC`, put together, else the primary HDU, else the first image extension. Image HDUs that
/// are not read are named in the notes or remarks.
///
/// A file of AOT has those of its scoring camera: [`aot`].
///
/// 2-D or a cube (image index slowest), any BITPIX, scaled or not. An image HDU `BADPIX`, 2-D for
/// all images or a cube, marks pixels as bad where it is not zero; so does the file `mask` (the HDU
/// in brackets, else its HDU `BADPIX`, else its first image).
///
/// # Errors
/// [`Error::File`](crate::Error::File), with the file and the reason: missing, truncated (with the
/// bytes present and needed), not FITS, no image, neither 2-D nor 3-D, a mask of another shape, a
/// read noise that is not a number.
pub fn read_images(path: impl AsRef<Path>, mask: Option<&Path>) -> Result<HduImages> {
    read_only(&mut FitsReader::open(path)?, mask)
}

/// As [`read_images`], of an open file.
fn read_only(file: &mut FitsReader, mask: Option<&Path>) -> Result<HduImages> {
    if aot::is_aot(file) {
        let mut cameras = aot::cameras(file, mask)?;
        return match (cameras.pop(), cameras.len()) {
            (Some(images), 0) => Ok(images),
            (_, others) => {
                Err(file.refuse(format!("holds images of {} scoring cameras, where one is read", others + 1)))
            }
        };
    }
    let marks = if file.has(BADPIX) { Some(file.find(BADPIX, HduKind::Image)?) } else { None };
    let is_named = file.selected_image()?.is_some() || file.has("IMAGES");
    let mosaic = if is_named { None } else { mosaic::assembled(file)? };
    if let Some(Mosaic { index, data, remark }) = mosaic {
        let mut images = of_data(file, (0, index), data, marks, mask)?;
        images.remarks.push(remark);
        return Ok(images);
    }
    let index = image_hdu(file)?;
    let mut images = read_hdu(file, (0, index), marks, mask)?;
    if !is_named {
        let (note, remark) = mosaic::unread(file, index);
        images.notes.extend(note);
        images.remarks.extend(remark);
    }
    Ok(images)
}

/// Reads the images of all channels in `path`: the HDUs `IMAGES` in the order of their `EXTVER`,
/// each with the HDU `BADPIX` of the same place, or all with the only one; of a file with one HDU
/// `IMAGES` or none, as [`read_images`]. Those of a file of AOT are of its scoring cameras, in
/// their order.
///
/// # Errors
/// As [`read_images`].
pub fn read_channels(path: impl AsRef<Path>, mask: Option<&Path>) -> Result<Vec<HduImages>> {
    let mut file = FitsReader::open(path)?;
    if aot::is_aot(&file) {
        return aot::cameras(&mut file, mask);
    }
    let found = if file.selected_image()?.is_some() { Vec::new() } else { file.all_images("IMAGES") };
    if found.len() < 2 {
        return read_only(&mut file, mask).map(|images| vec![images]);
    }
    let marks = file.all_images(BADPIX);
    if ![0, 1, found.len()].contains(&marks.len()) {
        let (marks, images) = (marks.len(), found.len());
        return Err(
            file.refuse(format!("has {marks} HDUs {BADPIX} and {images} HDUs IMAGES: as many, 1 or 0 are accepted"))
        );
    }
    let marks_of = |place: usize| marks.get(if marks.len() == 1 { 0 } else { place }).copied();
    found.into_iter().enumerate().map(|at| read_hdu(&mut file, at, marks_of(at.0), mask)).collect()
}

/// The HDU that holds the images.
fn image_hdu(file: &FitsReader) -> Result<usize> {
    if let Some(index) = file.selected_image()? {
        return Ok(index);
    }
    if file.has("IMAGES") {
        // An estimate file has a table of this name: its maps are not images.
        if file.find("IMAGES", HduKind::Table).is_ok() && file.has("MODES") {
            let reason = "is the result of an estimate and holds no images: the file of the images that it was made from is needed";
            return Err(file.refuse(reason));
        }
        return file.find("IMAGES", HduKind::Image);
    }
    file.first_image(&[BADPIX])
}
