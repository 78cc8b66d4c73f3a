//! File of a part of an estimate: FITS with a row for each fit.

use super::parts::{FittedPart, Part};
use crate::io::{Card, Column, FitsReader, FitsWriter, Pixel};
use crate::modal::KeptFit;
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::Array2;
use std::path::Path;
use std::sync::Arc;

/// Columns of the numbers of a fit, in the order of [`KeptFit::numbers`].
const NUMBERS: [&str; 7] = ["FLUX_E", "BACKGROUND_E", "CHI2", "CHI2_LEAST", "CHI2_SCATTER", "SQUARE_SNR", "FREEDOM"];

impl FittedPart {
    /// Writes the part, whole or not at all: the cards `PART`, `PARTS` and `NIMAGES`, the tables `FITS`, a row for each fit, and
    /// `COMMAND`; for each fit the coefficients (`COEFFICIENTS`, nm) and the weights of its pixels (`WEIGHTS`), and for each image the PSF
    /// where its fit ended (`PSFS`). Each of these is one row after the other, because channels differ in size.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "PART", self.part.number() as i64, "number of this part, from 1")?;
        file.card("PRIMARY", "PARTS", self.part.of() as i64, "number of all parts")?;
        file.card("PRIMARY", "NIMAGES", self.images as i64, "images of the whole estimate")?;
        file.card("PRIMARY", "IDENTITY", hex(self.identity).as_str(), "hash of images, scene and policy")?;
        let fits = || self.fits.iter().map(|(_, fit)| &**fit);
        let reals = |at: usize| fits().map(|fit| fit.numbers[at]).collect();
        let sizes = |rows: &[&[f64]]| Column::i64("SIZE", rows.iter().map(|row| row.len() as i64).collect());
        let coefficients: Vec<&[f64]> = fits().map(|fit| fit.coefficients_nm.as_slice()).collect();
        let weights: Vec<&[f64]> = fits().map(|fit| fit.weights.as_slice()).collect();
        let psfs: Vec<&[f64]> = self.psfs.iter().map(|(_, psf)| psf.as_slice()).collect();
        let mut columns = vec![
            Column::text("KEY", self.fits.iter().map(|(key, _)| hex(*key))),
            Column::i64("EVALUATIONS", fits().map(|fit| fit.evaluations as i64).collect()),
            Column::text("REASON", fits().map(|fit| fit.reason.to_string())),
        ];
        columns.extend(NUMBERS.iter().enumerate().map(|(at, name)| Column::f64(name, "", reals(at))));
        file.table("FITS", &columns)?;
        file.table("COMMAND", &[Column::text("WORD", &self.command)])?;
        file.table("COEFFICIENTS_SIZES", &[sizes(&coefficients)])?;
        file.table("WEIGHTS_SIZES", &[sizes(&weights)])?;
        let keys = Column::text("KEY", self.psfs.iter().map(|(key, _)| hex(*key)));
        file.table("PSFS_SIZES", &[keys, sizes(&psfs)])?;
        for (name, rows, unit) in [("COEFFICIENTS", coefficients, "nm"), ("WEIGHTS", weights, ""), ("PSFS", psfs, "")] {
            let values = rows.concat();
            if !values.is_empty() {
                let row = Array2::from_shape_vec((1, values.len()), values);
                file.image(name, &row.map_err(|error| Error::Internal(error.to_string()))?, Pixel::F64, unit)?;
            }
        }
        file.finish()
    }

    /// Reads a file of [`FittedPart::write`].
    ///
    /// # Errors
    /// [`Error::File`] for a file that is not one, or that is damaged.
    pub fn read(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let mut file = FitsReader::open(path)?;
        if !file.has("FITS") || !file.has("COMMAND") {
            let reason = "is no part of an estimate, as 'cophase estimate --part I/N' writes it";
            return Err(Error::file(path, reason));
        }
        let damaged = |what: &str| Error::file(path, format!("is a damaged part of an estimate: {what}"));
        let number = |file: &mut FitsReader, key: &str| -> Result<usize> {
            let card = file.card(Some("PRIMARY"), key)?.and_then(|card| card.number());
            card.filter(|n| *n >= 0.0 && n.fract() == 0.0).map(|n| n as usize).ok_or_else(|| damaged(key))
        };
        let (of, images) = (number(&mut file, "PARTS")?, number(&mut file, "NIMAGES")?);
        let part = Part::new(number(&mut file, "PART")?, of).map_err(|_| damaged("PART"))?;
        let identity = file.card(Some("PRIMARY"), "IDENTITY")?;
        let identity = identity.as_ref().and_then(Card::text).and_then(unhex).ok_or_else(|| damaged("IDENTITY"))?;
        let mut keys = |table: &str| -> Result<Vec<u128>> {
            let texts = file.text_column(table, "KEY")?;
            texts.iter().map(|text| unhex(text).ok_or_else(|| damaged("KEY"))).collect()
        };
        let (keys, psf_keys) = (keys("FITS")?, keys("PSFS_SIZES")?);
        let evaluations = file.i64_column("FITS", "EVALUATIONS")?;
        let reasons = file.text_column("FITS", "REASON")?;
        let numbers = NUMBERS.map(|name| file.f64_column("FITS", name));
        let numbers = numbers.into_iter().collect::<Result<Vec<_>>>()?;
        let mut rows_of = |name: &str, count: usize| rows(&mut file, name, count)?.ok_or_else(|| damaged(name));
        let coefficients = rows_of("COEFFICIENTS", keys.len())?;
        let weights = rows_of("WEIGHTS", keys.len())?;
        let psfs = rows_of("PSFS", psf_keys.len())?;
        let fit = |(row, (coefficients_nm, weights)): (usize, (Vec<f64>, Vec<f64>))| {
            let reason = StopReason::ALL.into_iter().find(|reason| reason.to_string() == reasons[row]);
            let fit = KeptFit {
                coefficients_nm,
                weights,
                evaluations: evaluations[row] as usize,
                reason: reason.ok_or_else(|| damaged("REASON"))?,
                numbers: std::array::from_fn(|at| numbers[at][row]),
            };
            Ok((keys[row], Arc::new(fit)))
        };
        let fits = coefficients.into_iter().zip(weights).enumerate().map(fit).collect::<Result<_>>()?;
        let psfs = psf_keys.into_iter().zip(psfs.into_iter().map(Arc::new)).collect();
        Ok(Self { part, images, command: file.text_column("COMMAND", "WORD")?, identity, fits, psfs })
    }
}

/// The `count` rows of the image `name`, whose sizes are in the table `NAME_SIZES`; `None` where these do not fit.
fn rows(file: &mut FitsReader, name: &str, count: usize) -> Result<Option<Vec<Vec<f64>>>> {
    let sizes = file.i64_column(&format!("{name}_SIZES"), "SIZE")?;
    let values = if file.has(name) { file.row(Some(name))? } else { Vec::new() };
    let sizes: Vec<usize> = sizes.into_iter().filter_map(|size| usize::try_from(size).ok()).collect();
    if sizes.len() != count || sizes.iter().sum::<usize>() != values.len() {
        return Ok(None);
    }
    let mut rest = values.as_slice();
    let row = |size: usize| {
        let (own, others) = rest.split_at(size);
        rest = others;
        own.to_vec()
    };
    Ok(Some(sizes.into_iter().map(row).collect()))
}

fn hex(number: u128) -> String {
    format!("{number:032x}")
}

fn unhex(text: &str) -> Option<u128> {
    u128::from_str_radix(text, 16).ok()
}
