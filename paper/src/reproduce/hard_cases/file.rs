//! Images that go through a FITS file.

use super::cases::Settings;
use cophase::io::{Card, FitsWriter, Pixel};
use cophase::{Error, Images, Result};
use ndarray::Array3;

/// `images_e` as `cophase estimate` reads them from a file with these cards.
pub(super) fn read_back(images_e: &Array3<f64>, cards: Settings) -> Result<Images> {
    let folder = tempfile::tempdir().map_err(|error| Error::file(std::env::temp_dir(), error))?;
    let path = folder.path().join("images.fits");
    let mut file = FitsWriter::create(&path)?;
    file.image("IMAGES", images_e, Pixel::F64, "")?;
    for (keyword, value) in cards {
        let card = value.parse::<f64>().map_or_else(|_| Card::from(*value), Card::from);
        file.card("IMAGES", keyword, card, "")?;
    }
    file.finish()?;
    Images::only(Images::read(&path, None)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use cophase::io::{PixelUnit, Quantity};

    #[test]
    fn pixels_and_cards_come_back() {
        let images_e = Array3::from_shape_fn((2, 3, 4), |(i, y, x)| (i + 2 * y + 6 * x) as f64 / 7.0);
        let read = read_back(&images_e, &[("BUNIT", "adu"), ("EGAIN", "20")]).unwrap();
        assert_eq!((&read.images_e, &read.unit, read.facts.len()), (&images_e, &PixelUnit::Counts, 1));
        assert_eq!((read.facts[0].quantity, &read.facts[0].values[..]), (Quantity::GainEPerAdu, &[20.0][..]));
    }
}
