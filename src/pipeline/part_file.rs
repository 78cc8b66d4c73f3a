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
    /// `COMMAND`, and of each fit the coefficients (`COEFFICIENTS`, nm) and the weights of its pixels (`WEIGHTS`).
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written; [`Error::Value`] where the fits are of models of different sizes.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "PART", self.part.number() as i64, "number of this part, from 1")?;
        file.card("PRIMARY", "PARTS", self.part.of() as i64, "number of all parts")?;
        file.card("PRIMARY", "NIMAGES", self.images as i64, "images of the whole estimate")?;
        file.card("PRIMARY", "IDENTITY", hex(self.identity).as_str(), "hash of images, scene and policy")?;
        let fits = || self.fits.iter().map(|(_, fit)| &**fit);
        let reals = |at: usize| fits().map(|fit| fit.numbers[at]).collect();
        let mut columns = vec![
            Column::text("KEY", self.fits.iter().map(|(key, _)| hex(*key))),
            Column::i64("EVALUATIONS", fits().map(|fit| fit.evaluations as i64).collect()),
            Column::text("REASON", fits().map(|fit| fit.reason.to_string())),
        ];
        columns.extend(NUMBERS.iter().enumerate().map(|(at, name)| Column::f64(name, "", reals(at))));
        // Channels may have models of different sizes.
        columns.push(Column::lists("COEFFICIENTS_NM", "nm", fits().map(|fit| fit.coefficients_nm.clone()).collect()));
        file.table("FITS", &columns)?;
        file.table("COMMAND", &[Column::text("WORD", &self.command)])?;
        let sizes: Vec<i64> = fits().map(|fit| fit.weights.len() as i64).collect();
        let weights: Vec<f64> = fits().flat_map(|fit| fit.weights.iter().copied()).collect();
        file.table("WEIGHTS_SIZES", &[Column::i64("PIXELS", sizes)])?;
        if !weights.is_empty() {
            let row = Array2::from_shape_vec((1, weights.len()), weights);
            file.image("WEIGHTS", &row.map_err(|error| Error::Internal(error.to_string()))?, Pixel::F64, "")?;
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
        let keys = file.text_column("FITS", "KEY")?;
        let evaluations = file.i64_column("FITS", "EVALUATIONS")?;
        let reasons = file.text_column("FITS", "REASON")?;
        let numbers = NUMBERS.map(|name| file.f64_column("FITS", name));
        let numbers = numbers.into_iter().collect::<Result<Vec<_>>>()?;
        let coefficients = file.list_column("FITS", "COEFFICIENTS_NM")?;
        let sizes = file.i64_column("WEIGHTS_SIZES", "PIXELS")?;
        let weights = if file.has("WEIGHTS") { file.row(Some("WEIGHTS"))? } else { Vec::new() };
        if sizes.len() != keys.len() || sizes.iter().map(|size| *size as usize).sum::<usize>() != weights.len() {
            return Err(damaged("WEIGHTS"));
        }
        let (mut fits, mut rest) = (Vec::with_capacity(keys.len()), weights.as_slice());
        for (row, coefficients_nm) in coefficients.into_iter().enumerate() {
            let (own, others) = rest.split_at(sizes[row] as usize);
            rest = others;
            let reason = StopReason::ALL.into_iter().find(|reason| reason.to_string() == reasons[row]);
            let fit = KeptFit {
                coefficients_nm,
                weights: own.to_vec(),
                evaluations: evaluations[row] as usize,
                reason: reason.ok_or_else(|| damaged("REASON"))?,
                numbers: std::array::from_fn(|at| numbers[at][row]),
            };
            fits.push((unhex(&keys[row]).ok_or_else(|| damaged("KEY"))?, Arc::new(fit)));
        }
        let command = file.text_column("COMMAND", "WORD")?;
        Ok(Self { part, images, command, identity, fits })
    }
}

fn hex(number: u128) -> String {
    format!("{number:032x}")
}

fn unhex(text: &str) -> Option<u128> {
    u128::from_str_radix(text, 16).ok()
}
