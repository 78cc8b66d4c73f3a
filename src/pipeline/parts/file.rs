//! File of a part of an estimate: FITS with a row for each fit.

use super::{Fits, FittedPart, Part};
use crate::io::{Card, Column, FitsReader, FitsWriter, Pixel};
use crate::modal::{Minima, Minimum, StoredFit, StoredGroup};
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::Array2;
use std::collections::BTreeMap;
use std::path::Path;

/// Name of a column and the number of a fit in it.
type NumberColumn = (&'static str, fn(&mut Minimum) -> &mut f64);

/// Columns of the numbers of a fit.
const NUMBERS: [NumberColumn; 7] = [
    ("FLUX_E", |fit| &mut fit.flux_e),
    ("BACKGROUND_E", |fit| &mut fit.background_e),
    ("CHI2", |fit| &mut fit.chi2.value),
    ("CHI2_LEAST", |fit| &mut fit.chi2.least),
    ("CHI2_SCATTER", |fit| &mut fit.chi2.scatter),
    ("SQUARE_SNR", |fit| &mut fit.chi2.square_snr),
    ("FREEDOM", |fit| &mut fit.chi2.freedom),
];

impl FittedPart {
    /// Writes the part, whole or not at all: the cards `PART`, `PARTS` and `NIMAGES`, the tables
    /// `FITS`, a row for each fit, and `COMMAND`; for each fit the coefficients (`COEFFICIENTS`,
    /// nm) and the weights of its pixels (`WEIGHTS`). Each of these is one row after the other,
    /// because channels differ in size. Of a sequence of groups the table `GROUPS`, and
    /// `GROUP_VALUES`: of each group modes, effect of the diversities, levels of the prior, score
    /// and information.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "PART", self.part.number() as i64, "number of this part, from 1")?;
        file.card("PRIMARY", "PARTS", self.part.of() as i64, "number of all parts")?;
        file.card("PRIMARY", "NIMAGES", self.images as i64, "images of the whole estimate")?;
        let identity = format!("{:032x}", self.identity);
        file.card("PRIMARY", "IDENTITY", identity.as_str(), "hash of images, scene and policy")?;
        let rows = || self.fits.iter().flat_map(|(at, fits)| fits.iter().map(move |fit| (*at, fit)));
        let integers = |name, of: &dyn Fn((usize, usize), &StoredFit) -> usize| {
            Column::i64(name, rows().map(|(at, fit)| of(at, fit) as i64).collect())
        };
        let mut columns = vec![
            integers("CHANNEL", &|(channel, _), _| channel),
            integers("IMAGE", &|(_, image), _| image),
            integers("STEP", &|_, fit| fit.step),
            Column::text("CHAIN", rows().map(|(_, fit)| &fit.chain)),
            integers("MODES", &|_, fit| fit.minimum.coefficients_nm.len()),
            integers("PIXELS", &|_, fit| fit.weights.len()),
            integers("EVALUATIONS", &|_, fit| fit.minimum.evaluations),
            Column::text("REASON", rows().map(|(_, fit)| fit.minimum.reason.to_string())),
        ];
        columns.extend(NUMBERS.iter().map(|(name, number)| {
            Column::f64(name, "", rows().map(|(_, fit)| *number(&mut fit.minimum.clone())).collect())
        }));
        file.table("FITS", &columns)?;
        file.table("COMMAND", &[Column::text("WORD", &self.command)])?;
        let mut row = |name, unit, of: fn(&StoredFit) -> &[f64]| -> Result<()> {
            let values = rows().flat_map(|(_, fit)| of(fit)).copied().collect::<Vec<f64>>();
            if values.is_empty() {
                return Ok(());
            }
            let row = Array2::from_shape_vec((1, values.len()), values);
            file.image(name, &row.map_err(|error| Error::Internal(error.to_string()))?, Pixel::F64, unit)
        };
        row("COEFFICIENTS", "nm", |fit| &fit.minimum.coefficients_nm)?;
        row("WEIGHTS", "", |fit| &fit.weights)?;
        if !self.groups.is_empty() {
            write_groups(&mut file, &self.groups)?;
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
        let identity = identity.as_ref().and_then(Card::text).and_then(|text| u128::from_str_radix(text, 16).ok());
        let identity = identity.ok_or_else(|| damaged("IDENTITY"))?;
        let mut integers = |name: &str| -> Result<Vec<usize>> {
            let column = file.i64_column("FITS", name)?;
            column.into_iter().map(|value| usize::try_from(value).map_err(|_| damaged(name))).collect()
        };
        let [channels, image_numbers, steps] = [integers("CHANNEL")?, integers("IMAGE")?, integers("STEP")?];
        let [modes, pixels, evaluations] = [integers("MODES")?, integers("PIXELS")?, integers("EVALUATIONS")?];
        let [chains, reasons] = [file.text_column("FITS", "CHAIN")?, file.text_column("FITS", "REASON")?];
        let numbers = NUMBERS.map(|(name, _)| file.f64_column("FITS", name));
        let numbers = numbers.into_iter().collect::<Result<Vec<_>>>()?;
        let mut values = |name: &str, sizes: &[usize]| -> Result<Vec<Vec<f64>>> {
            let values = if file.has(name) { file.row(Some(name))? } else { Vec::new() };
            split(&values, sizes).ok_or_else(|| damaged(name))
        };
        let pairs = values("COEFFICIENTS", &modes)?.into_iter().zip(values("WEIGHTS", &pixels)?);
        let mut fits = Fits::new();
        for (row, (coefficients_nm, weights)) in pairs.enumerate() {
            let reason = StopReason::ALL.into_iter().find(|reason| reason.to_string() == reasons[row]);
            let (evaluations, reason) = (evaluations[row], reason.ok_or_else(|| damaged("REASON"))?);
            let mut minimum = Minimum { coefficients_nm, evaluations, reason, ..Minimum::empty(0) };
            NUMBERS.iter().zip(&numbers).for_each(|((_, number), column)| *number(&mut minimum) = column[row]);
            let fit = StoredFit { step: steps[row], chain: chains[row].clone(), minimum, weights };
            fits.entry((channels[row], image_numbers[row])).or_default().push(fit);
        }
        let groups = match file.has("GROUPS") {
            true => read_groups(&mut file)?.ok_or_else(|| damaged("GROUPS"))?,
            false => BTreeMap::new(),
        };
        Ok(Self { part, images, command: file.text_column("COMMAND", "WORD")?, identity, fits, groups })
    }
}

fn write_groups(file: &mut FitsWriter, groups: &BTreeMap<usize, StoredGroup>) -> Result<()> {
    let counts = |name, of: fn(&StoredGroup) -> usize| {
        Column::i64(name, groups.values().map(|group| of(group) as i64).collect())
    };
    let reals = |name, of: fn(&StoredGroup) -> f64| Column::f64(name, "", groups.values().map(of).collect());
    file.table(
        "GROUPS",
        &[
            Column::i64("GROUP", groups.keys().map(|&number| number as i64).collect()),
            counts("MODES", |group| group.coefficients_nm.len()),
            counts("LEVELS", |group| group.levels_nm.len()),
            counts("UNKNOWNS", |group| group.score.len()),
            counts("PIXELS", |group| group.pixels),
            counts("STARTS", |group| group.minima.starts),
            counts("IN_BEST", |group| group.minima.in_best),
            counts("HAS_TWIN", |group| group.minima.has_twin.into()),
            counts("SUSPICIOUS", |group| group.minima.is_suspicious.into()),
            reals("NEXT", |group| group.minima.next.unwrap_or(f64::NAN)),
            reals("INFLATION", |group| group.inflation),
        ],
    )?;
    let each = groups.values().flat_map(|group| {
        let StoredGroup { coefficients_nm, effect, levels_nm, score, information, .. } = group;
        [coefficients_nm, effect, levels_nm, score, information]
    });
    let values: Vec<f64> = each.flatten().copied().collect();
    let row = Array2::from_shape_vec((1, values.len()), values).map_err(|error| Error::Internal(error.to_string()))?;
    file.image("GROUP_VALUES", &row, Pixel::F64, "")
}

/// What [`write_groups`] has written; `None` where it is damaged.
fn read_groups(file: &mut FitsReader) -> Result<Option<BTreeMap<usize, StoredGroup>>> {
    let names = ["GROUP", "MODES", "LEVELS", "UNKNOWNS", "PIXELS", "STARTS", "IN_BEST", "HAS_TWIN", "SUSPICIOUS"];
    let columns = names.map(|name| file.i64_column("GROUPS", name));
    let columns = columns.into_iter().collect::<Result<Vec<_>>>()?;
    let [next, inflation] = [file.f64_column("GROUPS", "NEXT")?, file.f64_column("GROUPS", "INFLATION")?];
    let count = |name: usize, row: usize| usize::try_from(columns[name][row]).ok();
    let values = file.row(Some("GROUP_VALUES"))?;
    let read = || {
        let mut sizes = Vec::new();
        for row in 0..next.len() {
            let [modes, levels, unknowns] = [count(1, row)?, count(2, row)?, count(3, row)?];
            sizes.extend([modes, modes, levels, unknowns, unknowns.checked_mul(unknowns)?]);
        }
        let mut parts = split(&values, &sizes)?.into_iter();
        let mut groups = BTreeMap::new();
        for row in 0..next.len() {
            let group = StoredGroup {
                coefficients_nm: parts.next()?,
                effect: parts.next()?,
                levels_nm: parts.next()?,
                score: parts.next()?,
                information: parts.next()?,
                inflation: inflation[row],
                pixels: count(4, row)?,
                minima: Minima {
                    starts: count(5, row)?,
                    in_best: count(6, row)?,
                    next: Some(next[row]).filter(|next| !next.is_nan()),
                    has_twin: count(7, row)? > 0,
                    is_suspicious: count(8, row)? > 0,
                },
            };
            groups.insert(count(0, row)?, group);
        }
        Some(groups)
    };
    Ok(read())
}

/// `values` in pieces of these sizes; `None` where they are not as many.
fn split(mut values: &[f64], sizes: &[usize]) -> Option<Vec<Vec<f64>>> {
    let piece = |size: &usize| {
        let (own, rest) = values.split_at_checked(*size)?;
        values = rest;
        Some(own.to_vec())
    };
    let pieces = sizes.iter().map(piece).collect::<Option<Vec<_>>>()?;
    values.is_empty().then_some(pieces)
}
