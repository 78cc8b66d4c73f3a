//! Faults that no scene has: is an estimate within its error bars, and where it is not, does it say
//! so?

mod kinds;

use super::hard_cases::{BASE, Verdict};
use super::statistics::median;
use super::{Cell, Progress, Report, Table};
use cophase::modal::StaticMaps;
use cophase::scene::Scene;
use cophase::source::{Camera, Truth, expose, flux_e, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Estimator, Images, Result};
pub(super) use kinds::halo;
use kinds::{Change, FAULTS, Fault};
use ndarray::Array3;
use rayon::prelude::*;
use std::path::Path;

/// Numbers of images of one wavefront, with the peak S/N of each.
const CONDITIONS: [[usize; 2]; 5] = [[1, 150], [1, 500], [10, 100], [40, 60], [200, 30]];

/// A fault of one size in one kind of images.
#[derive(Clone, Copy)]
pub struct FaultRow {
    fault: &'static Fault,
    size: f64,
    /// Images of one wavefront, and the peak S/N of each.
    condition: [usize; 2],
}

impl FaultRow {
    /// Its name.
    pub fn name(&self) -> String {
        let [images, snr] = self.condition;
        format!("{} {}, {images} x S/N {snr}", self.fault.name, self.shown_size())
    }

    fn shown_size(&self) -> String {
        format!("{} {}", self.size, self.fault.unit).trim().to_owned()
    }

    /// The rows whose names contain one of these texts; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        let of_fault = |fault: &'static Fault| {
            let sizes = if fault.sizes[0] == fault.sizes[2] { &fault.sizes[..1] } else { &fault.sizes[..] };
            sizes.iter().flat_map(move |&size| CONDITIONS.map(|condition| Self { fault, size, condition }))
        };
        let all: Vec<Self> = FAULTS.iter().flat_map(of_fault).collect();
        if let Some(odd) = texts.iter().find(|text| !all.iter().any(|row| row.name().contains(*text))) {
            let names: Vec<&str> = FAULTS.iter().map(|fault| fault.name).collect();
            return Err(Error::Value(format!(
                "no row of faults contains '{odd:.60}': parts of {} are accepted",
                names.join("; ")
            )));
        }
        Ok(all
            .into_iter()
            .filter(|row| texts.is_empty() || texts.iter().any(|text| row.name().contains(text)))
            .collect())
    }

    /// What makes the images, without the fault, and reads them.
    fn scene(&self) -> Result<Scene> {
        let [images, snr] = self.condition.map(|number| number.to_string());
        let own = [("image.count", images.as_str()), ("image.peak_snr", &snr), ("estimate.model", "scene")];
        Scene::preset("keck-artificial")?.with(BASE)?.with(&own)
    }

    /// Images of draw `seed`, with their truth.
    fn images(&self, seed: usize) -> Result<Images> {
        let (size, change) = (self.size, self.fault.change);
        let read = self.scene()?.with_override("aberrations.seed", &seed.to_string())?;
        let mut scene = read.clone();
        if let Change::Scene(keys) = change {
            let keys = keys(size);
            scene = scene.with(&keys.iter().map(|(key, value)| (*key, value.as_str())).collect::<Vec<_>>())?;
        }
        let telescope = Telescope::new(&scene)?;
        let mut truth = Truth::draw(&scene, &telescope, &mut stream(seed as u64, 0))?;
        if let Change::Truth(change) = change {
            truth = change(truth, &telescope, size, seed as u64)?;
        }
        let mut psf = Camera::new(&scene, &telescope)?.psf(&truth)?;
        if let Change::Psf(change) = change {
            psf = change(&psf, size);
        }
        let flux_e = flux_e(&scene.image, psf.iter().copied().fold(0.0, f64::max));
        let (rows, columns) = psf.dim();
        let mut images_e = Array3::zeros((scene.image.count, rows, columns));
        for (number, mut image_e) in images_e.outer_iter_mut().enumerate() {
            let mut rng = stream(seed as u64, 1 + number as u64);
            // Filters leave rounding below 0.
            let mut frame = psf.mapv(|h| expose(&scene.image, h.max(0.0), flux_e, &mut rng));
            if let Change::Detector(change) = change {
                change(&mut frame, size, seed as u64);
            }
            image_e.assign(&frame);
        }
        // A pupil that the scene does not have may have another outline.
        let [phasing_nm, ncpa_nm] = truth.maps_on(&Telescope::new(&read)?.pupil)?;
        let truth = StaticMaps { phasing_nm, ncpa_nm };
        Ok(Images { truth: Some(truth), ..Images::new(images_e).in_electrons() })
    }
}

/// The draws of some rows.
pub struct Faults(pub Vec<(FaultRow, Vec<Verdict>)>);

/// Estimates draws 1 to `seeds` of each row.
///
/// # Errors
/// Those of making images, and [`Error::Interrupted`]. An estimator that refuses is no error but a
/// verdict.
pub fn faults(rows: &[FaultRow], seeds: usize, progress: &Progress) -> Result<Faults> {
    progress.expect(rows.len() * seeds);
    let estimators = CONDITIONS.map(|condition| {
        let row = rows.iter().find(|row| row.condition == condition)?;
        Some((condition, row.scene().and_then(|scene| Estimator::new(&scene))))
    });
    let estimators = estimators.into_iter().flatten().map(|(condition, made)| Ok((condition, made?)));
    let estimators = estimators.collect::<Result<Vec<_>>>()?;
    let of_row = |(place, row): (usize, &FaultRow)| {
        let Some((_, estimator)) = estimators.iter().find(|(condition, _)| *condition == row.condition) else {
            return Err(Error::Internal("a row has no estimator".into()));
        };
        let make = |seed: usize| {
            let verdict = Verdict::of(estimator.estimate(&row.images(seed)?), |found| Ok(Verdict::by_maps(found)))?;
            progress.add(1);
            Ok(verdict)
        };
        let number = |seed: usize| place * seeds + seed;
        let draw = |seed: usize| progress.draw((&row.name(), seed, number(seed)), 1, || make(seed)).transpose();
        Ok((*row, (1..=seeds).into_par_iter().filter_map(draw).collect::<Result<Vec<_>>>()?))
    };
    Ok(Faults(rows.par_iter().enumerate().map(of_row).collect::<Result<Vec<_>>>()?))
}

impl Faults {
    /// One line a row.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "fault",
            "size",
            "images",
            "peak_snr",
            "draws",
            "right",
            "flagged",
            "wrong_unflagged",
            "phasing_nm",
            "phasing_over_sigma",
            "ncpa_nm",
            "ncpa_over_sigma",
            "chi2",
            "verdicts",
        ]);
        for (row, draws) in &self.0 {
            let count = |is: &dyn Fn(&Verdict) -> bool| Cell::from(draws.iter().filter(|own| is(own)).count());
            let of = |value: &dyn Fn(&Verdict) -> f64| median(&draws.iter().map(value).collect::<Vec<_>>());
            let mut words: Vec<&str> = draws.iter().map(|own| own.word.as_ref()).collect();
            words.dedup();
            let ratio = |part: usize| Cell::Number(of(&|own| own.error_nm[part] / own.sigma_nm[part]), 2);
            table.push(vec![
                row.fault.name.into(),
                row.shown_size().as_str().into(),
                row.condition[0].into(),
                row.condition[1].into(),
                draws.len().into(),
                count(&Verdict::is_right),
                count(&Verdict::is_flagged),
                count(&Verdict::is_wrong_and_unflagged),
                Cell::Number(of(&|own| own.error_nm[0]), 3),
                ratio(0),
                Cell::Number(of(&|own| own.error_nm[1]), 3),
                ratio(1),
                Cell::Number(of(&|own| own.reduced_chi2), 3),
                words.join(" ").as_str().into(),
            ]);
        }
        table
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let file = directory.join("faults.csv");
        self.table().write_csv(&file)?;
        let all = || self.0.iter().flat_map(|(_, draws)| draws);
        let wrong = all().filter(|verdict| verdict.is_wrong_and_unflagged()).count();
        let text = format!(
            "Faults that the scene does not have: {wrong} of {} draws are wrong and unflagged (medians over draws)\n{}",
            all().count(),
            self.table().text()
        );
        Ok(Report { text, files: vec![file] })
    }
}
