//! Section 3.5 of the paper: which amplitude of the defocus is best, at two wavelengths.
//!
//! All models have the paper's 120 samples. Without aberrations the light of 2 waves RMS reaches 32
//! λ/D from the axis, that of 3 waves 48: what 120 samples cannot carry shows in χ² and, from 2
//! waves on, in the error.

use super::statistics::{mean, median, rms, standard_deviation};
use super::{Bound, Case, Cell, Draw, Progress, Report, Table, Trial, Way, draws};
use cophase::Result;
use cophase::scene::Scene;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use std::path::Path;

/// The paper's two filters: narrowband Fe and Brackett gamma.
const WAVELENGTHS_NM: [(f64, &str); 2] = [(1640.0, "1640"), (2168.6, "2168.6")];
/// Amplitudes, waves RMS over the pupil.
const WAVES_RMS: [&str; 10] = ["0.25", "0.5", "0.75", "1", "1.25", "1.5", "1.75", "2", "2.5", "3"];
/// The same, for a look at the shape.
const FEW_WAVES_RMS: [&str; 3] = ["0.5", "1.5", "3"];
/// The paper's choice.
const CHOSEN_WAVES_RMS: f64 = 1.5;

/// Residuals of both ways at each wavelength and amplitude.
#[derive(Debug, Clone)]
pub struct Diversity {
    /// By way, then wavelength, then amplitude.
    pub points: Vec<DiversityPoint>,
}

/// One amplitude.
#[derive(Debug, Clone)]
pub struct DiversityPoint {
    /// Whose choices.
    pub way: Way,
    /// Wavelength, nm; the image has 4 pixels per λ/D at either.
    pub wavelength_nm: f64,
    /// Amplitude of the defocus, waves RMS.
    pub waves_rms: f64,
    /// Draws that were not lost.
    pub seeds: usize,
    /// Draws whose segment errors were no better known after the fit than before: a wrong minimum,
    /// or none.
    pub lost: usize,
    /// Mean residual of the segment errors over the draws that were not lost, nm.
    pub phasing_nm: f64,
    /// Its scatter from draw to draw.
    pub phasing_sd_nm: f64,
    /// Mean residual of the NCPA, nm.
    pub ncpa_nm: f64,
    /// Its scatter.
    pub ncpa_sd_nm: f64,
    /// Root of the mean square of their Cramér-Rao bounds, phasing, nm; NaN for the paper's way,
    /// which stays far from it.
    pub phasing_bound_nm: f64,
    /// The same of the NCPA.
    pub ncpa_bound_nm: f64,
    /// Median χ² per degree of freedom.
    pub reduced_chi2: f64,
    /// Median evaluations.
    pub evaluations: f64,
}

/// The scene of section 3 with draws 1 to `seeds` at each wavelength and amplitude, both ways.
///
/// # Errors
/// Those of the estimator, and [`cophase::Error::Interrupted`].
pub fn diversity(seeds: usize, quick: bool, progress: &Progress) -> Result<Diversity> {
    let amplitudes: &[&str] = if quick { &FEW_WAVES_RMS } else { &WAVES_RMS };
    progress.expect(Way::BOTH.len() * WAVELENGTHS_NM.len() * amplitudes.len() * seeds);
    let preset = Scene::preset("keck-artificial")?;
    let put_in_nm = preset.aberrations.as_ref().map_or(0.0, |truth| truth.segment_piston_rms_nm);
    let mut points = Vec::new();
    for (wavelength_nm, wavelength) in WAVELENGTHS_NM {
        for waves in amplitudes {
            let scene =
                preset.with(&[("image.wavelength_nm", wavelength), ("image.diversity_focus_waves_rms", waves)])?;
            let draws = draws(&scene, seeds, progress)?;
            for way in Way::BOTH {
                let case = Case::new(&way.of(&scene)?)?;
                let trials = case.fit(&draws, progress)?;
                let waves_rms = scene.image.diversity_focus_waves_rms;
                let mut point = DiversityPoint::of(way, wavelength_nm, waves_rms, &trials, put_in_nm);
                if way == Way::Ours {
                    point.bound(&case, &trials, &draws, put_in_nm)?;
                }
                points.push(point);
            }
        }
    }
    // A stable sort: within a way and a wavelength, amplitudes stay in order.
    points.sort_by_key(|point| point.way == Way::Ours);
    Ok(Diversity { points })
}

/// Whether a fit found anything: its residual is smaller than what was put in.
fn found(trial: &Trial, put_in_nm: f64) -> bool {
    trial.phasing_nm < put_in_nm
}

impl DiversityPoint {
    fn of(way: Way, wavelength_nm: f64, waves_rms: f64, trials: &[Trial], put_in_nm: f64) -> Self {
        let kept: Vec<&Trial> = trials.iter().filter(|trial| found(trial, put_in_nm)).collect();
        let of = |f: fn(&Trial) -> f64| kept.iter().map(|trial| f(trial)).collect::<Vec<f64>>();
        let (phasing, ncpa) = (of(|trial| trial.phasing_nm), of(|trial| trial.ncpa_nm));
        Self {
            way,
            wavelength_nm,
            waves_rms,
            seeds: kept.len(),
            lost: trials.len() - kept.len(),
            phasing_nm: mean(&phasing),
            phasing_sd_nm: standard_deviation(&phasing),
            ncpa_nm: mean(&ncpa),
            ncpa_sd_nm: standard_deviation(&ncpa),
            phasing_bound_nm: f64::NAN,
            ncpa_bound_nm: f64::NAN,
            reduced_chi2: median(&of(|trial| trial.reduced_chi2)),
            evaluations: median(&of(|trial| trial.evaluations as f64)),
        }
    }

    fn bound(&mut self, case: &Case, trials: &[Trial], draws: &[Draw], put_in_nm: f64) -> Result<()> {
        let kept = trials.iter().zip(draws).filter(|(trial, _)| found(trial, put_in_nm));
        let bounds = kept.map(|(trial, draw)| case.bound(trial, draw)).collect::<Result<Vec<_>>>()?;
        let of = |f: fn(&Bound) -> f64| rms(&bounds.iter().map(f).collect::<Vec<f64>>());
        (self.phasing_bound_nm, self.ncpa_bound_nm) = (of(|bound| bound.phasing_nm), of(|bound| bound.ncpa_nm));
        Ok(())
    }
}

impl Diversity {
    /// The points of one curve.
    fn curve(&self, way: Way, wavelength_nm: f64) -> Vec<&DiversityPoint> {
        self.points.iter().filter(|point| point.way == way && point.wavelength_nm == wavelength_nm).collect()
    }

    /// The amplitude with the smallest phasing residual, waves RMS; NaN where there is none.
    pub fn optimum_waves_rms(&self, way: Way, wavelength_nm: f64) -> f64 {
        let curve = self.curve(way, wavelength_nm);
        let finite = curve.iter().filter(|point| point.phasing_nm.is_finite());
        finite.min_by(|a, b| a.phasing_nm.total_cmp(&b.phasing_nm)).map_or(f64::NAN, |point| point.waves_rms)
    }

    /// One line a point.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "way",
            "wavelength_nm",
            "waves_rms",
            "seeds",
            "lost",
            "phasing_nm",
            "phasing_sd_nm",
            "ncpa_nm",
            "ncpa_sd_nm",
            "phasing_bound_nm",
            "ncpa_bound_nm",
            "chi2",
            "evaluations",
        ]);
        for point in &self.points {
            table.push(vec![
                point.way.name().into(),
                Cell::Number(point.wavelength_nm, 1),
                Cell::Number(point.waves_rms, 2),
                point.seeds.into(),
                point.lost.into(),
                Cell::Number(point.phasing_nm, 3),
                Cell::Number(point.phasing_sd_nm, 3),
                Cell::Number(point.ncpa_nm, 3),
                Cell::Number(point.ncpa_sd_nm, 3),
                Cell::Number(point.phasing_bound_nm, 3),
                Cell::Number(point.ncpa_bound_nm, 3),
                Cell::Number(point.reduced_chi2, 2),
                Cell::Number(point.evaluations, 0),
            ]);
        }
        table
    }

    /// Phasing residual against amplitude, as the paper's figure, with ours and the bound below it.
    pub fn picture(&self) -> CurvePicture {
        let mut series = Vec::new();
        for (colour, (wavelength_nm, name)) in WAVELENGTHS_NM.into_iter().enumerate() {
            for way in Way::BOTH {
                let curve = self.curve(way, wavelength_nm);
                let (label, marker) = match way {
                    Way::Paper => (format!("the paper's way, {name} nm"), Marker::Ring),
                    Way::Ours => (format!("ours, {name} nm"), Marker::Disc),
                };
                let list = |of: fn(&DiversityPoint) -> f64| curve.iter().map(|point| of(point)).collect::<Vec<f64>>();
                let style = SeriesStyle { stroke: Stroke::Solid, marker, colour: Some(colour) };
                let (x, y) = (list(|point| point.waves_rms), list(|point| point.phasing_nm));
                series.push(Series { label, x: x.clone(), y, y_err: Some(list(|point| point.phasing_sd_nm)), style });
                if way == Way::Ours {
                    let style = SeriesStyle { stroke: Stroke::Dashed, marker: Marker::None, colour: Some(colour) };
                    let (label, y) = (format!("bound, {name} nm"), list(|point| point.phasing_bound_nm));
                    series.push(Series { label, x, y, y_err: None, style });
                }
            }
        }
        // Unseen: room for the legend above the points.
        let highest = self.points.iter().map(|point| point.phasing_nm).fold(f64::MIN_POSITIVE, f64::max);
        let style = SeriesStyle { stroke: Stroke::None, marker: Marker::None, colour: None };
        series.push(Series { x: vec![CHOSEN_WAVES_RMS], y: vec![30.0 * highest], style, ..Default::default() });
        CurvePicture {
            title: "Phasing residual against the amplitude of the defocus".into(),
            x_label: "defocus (waves RMS)".into(),
            y_label: "residual (nm RMS)".into(),
            y_log: true,
            series,
            vertical_lines: vec![(CHOSEN_WAVES_RMS, "3/2 waves, the paper's choice".into())],
            ..Default::default()
        }
    }

    pub(super) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["diversity.csv", "diversity.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.picture().draw(&files[1])?;
        let mut text =
            "Residual against the amplitude of the defocus, nm RMS (mean and scatter over draws that were not lost)\n"
                .to_string()
                + &self.table().text();
        for way in Way::BOTH {
            for (wavelength_nm, name) in WAVELENGTHS_NM {
                let best = self.optimum_waves_rms(way, wavelength_nm);
                text += &format!("smallest phasing residual, {}, {name} nm: at {best} waves RMS\n", way.name());
            }
        }
        Ok(Report { text: text + "\n", files: files.to_vec() })
    }
}
