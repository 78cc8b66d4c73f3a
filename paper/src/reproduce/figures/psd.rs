//! Section 4.5: power spectra of the residual wavefront before and after the segments are
//! corrected.

use super::corrected::{Amplitude, Bench, STATES, State, watch};
use crate::experiment::metrics::{Psd, PsdAverage, control_half_width_per_m};
use crate::reproduce::statistics::mean;
use crate::reproduce::{Cell, Conditions, Progress, Report, Table};
use cophase::{Error, Result};
use cophase_view::plot::{CaptionedMap, CurvePicture, MapScale, MapsPicture, Marker, Series, SeriesStyle, Stroke};
use ndarray::{Array2, ArrayView2, s};
use std::path::Path;

/// Frequencies of the map of ratios reach this many times as far as the mirror does.
const REACH: f64 = 4.0;
/// Pixels of the picture for each frequency: the border of the box is one of them wide.
const FINE: usize = 5;

/// The average spectrum of one state over the frames of all draws.
#[derive(Debug, Clone)]
pub struct StatePsd {
    /// The telescope, as in the first draw.
    pub state: State,
    /// Residual phasing error of each draw, nm.
    pub phasing_nm: Vec<f64>,
    /// Frames.
    pub frames: usize,
    /// The spectrum.
    pub psd: Psd,
    /// Residual wavefront within the mirror's control box, and outside of it, nm RMS.
    pub inside_outside_nm: [f64; 2],
}

/// All states.
#[derive(Debug, Clone)]
pub struct Psds {
    /// Conventional before and after, substantial before and after each pass, perfectly phased.
    pub states: Vec<StatePsd>,
    /// Half the side of the mirror's control box, cycles/m.
    pub half_width_per_m: f64,
}

/// Measures and corrects draws 1 to `seeds`, and averages the spectra of about 1000 frames of each.
///
/// # Errors
/// Those of the simulator, the estimator and [`PsdAverage`]; [`Error::Interrupted`].
pub fn psd(conditions: &Conditions, seeds: usize, progress: &Progress) -> Result<Psds> {
    progress.check()?;
    let bench = Bench::new(conditions)?;
    progress.expect(seeds * (bench.images() + STATES));
    let mut averages: Vec<(State, Vec<f64>, PsdAverage)> = Vec::new();
    let mut pitch_m = f64::NAN;
    for seed in 1..=seeds {
        for (place, state) in bench.states(seed, progress)?.into_iter().enumerate() {
            let mut simulator = bench.delivering(seed, &state.piston_nm)?;
            pitch_m = simulator.scene().mirror.pitch_m;
            if averages.len() == place {
                averages.push((state.clone(), Vec::new(), PsdAverage::new(simulator.pupil(), 1)?));
            }
            let (samples, stride) = (simulator.footprint().samples(), simulator.footprint().stride());
            let (_, phasing_nm, average) = &mut averages[place];
            phasing_nm.push(state.phasing_nm);
            watch(&mut simulator, progress, |_, residual_nm| {
                let rows = ArrayView2::from_shape((samples, stride), residual_nm);
                let rows =
                    rows.map_err(|error| Error::Internal(format!("a residual wavefront of odd shape: {error}")))?;
                average.add(rows.slice(s![.., ..samples]))
            })?;
            progress.add(1);
        }
    }
    let half_width_per_m = control_half_width_per_m(pitch_m)?;
    let states = averages.into_iter().map(|(state, phasing_nm, average)| {
        let psd = average.mean()?;
        let inside = psd.variance_within_nm2(half_width_per_m)?;
        let outside = (psd.variance_nm2() - inside).max(0.0);
        let inside_outside_nm = [inside.sqrt(), outside.sqrt()];
        Ok(StatePsd { state, phasing_nm, frames: average.maps(), psd, inside_outside_nm })
    });
    Ok(Psds { states: states.collect::<Result<_>>()?, half_width_per_m })
}

impl Psds {
    /// First and last state of `amplitude`.
    fn ends(&self, amplitude: Amplitude) -> Option<[&StatePsd; 2]> {
        let of = |pass| self.states.iter().find(|s| s.state.amplitude == Some(amplitude) && s.state.pass == pass);
        Some([of(0)?, of(amplitude.passes())?])
    }

    /// One line for each state; the ratios are of variance, before over this state.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "state",
            "seeds",
            "frames",
            "phasing_nm",
            "inside_nm",
            "outside_nm",
            "ratio_inside",
            "ratio_outside",
        ]);
        for state in &self.states {
            let before = state.state.amplitude.and_then(|amplitude| self.ends(amplitude)).map(|[before, _]| before);
            let ratio = |part: usize| {
                let of = |before: &StatePsd| (before.inside_outside_nm[part] / state.inside_outside_nm[part]).powi(2);
                Cell::Number(before.map_or(f64::NAN, of), 3)
            };
            table.push(vec![
                Cell::Text(state.state.label()),
                state.phasing_nm.len().into(),
                state.frames.into(),
                Cell::Number(mean(&state.phasing_nm), 1),
                Cell::Number(state.inside_outside_nm[0], 1),
                Cell::Number(state.inside_outside_nm[1], 1),
                ratio(0),
                ratio(1),
            ]);
        }
        table
    }

    /// Spectra before over after, in powers of ten; the control box is drawn in the darkest blue.
    ///
    /// # Errors
    /// As [`Psd::ratio`].
    pub fn ratios(&self) -> Result<MapsPicture> {
        let mut maps = Vec::new();
        for [before, after] in Amplitude::ALL.into_iter().filter_map(|amplitude| self.ends(amplitude)) {
            let (step_per_m, nm) = (before.psd.step_per_m(), [before, after].map(|state| mean(&state.phasing_nm)));
            let middle = self.middle(&before.psd.ratio(&after.psd)?, step_per_m);
            maps.push((before.state.amplitude.map_or("", Amplitude::name), nm, step_per_m, middle));
        }
        // What nearly all values lie within: the line is as dark as the scale goes, and does not
        // stretch it.
        let mut sizes: Vec<f64> = maps.iter().flat_map(|(.., map)| map.iter().map(|v| v.abs())).collect();
        sizes.retain(|size| size.is_finite());
        sizes.sort_by(f64::total_cmp);
        let line = -sizes.get(sizes.len() * 199 / 200).copied().unwrap_or(1.0);
        let captioned = |(name, nm, step_per_m, map): (&str, [f64; 2], f64, Array2<f64>)| CaptionedMap {
            caption: format!(
                "{name}: {:.0} to {:.0} nm; {:.3} cycles/m a pixel",
                nm[0],
                nm[1],
                step_per_m / FINE as f64
            ),
            values: self.boxed(&map, step_per_m, line),
            unit: "log₁₀".into(),
            width_m: None,
            scale: MapScale::SharedDiverging,
            labels: Vec::new(),
        };
        let maps = maps.into_iter().map(captioned).collect();
        let title = "Power of the residual, before over after; box: what the mirror controls".into();
        Ok(MapsPicture { title, columns: 2, maps })
    }

    /// Powers of ten of the middle of a map of ratios.
    fn middle(&self, ratio: &Array2<f64>, step_per_m: f64) -> Array2<f64> {
        let middle = ratio.nrows() / 2;
        let reach = ((REACH * self.half_width_per_m / step_per_m).round() as usize).min(middle.saturating_sub(1));
        ratio.slice(s![middle - reach..=middle + reach, middle - reach..=middle + reach]).mapv(f64::log10)
    }

    /// The map enlarged, with the border of the control box at `line`.
    fn boxed(&self, map: &Array2<f64>, step_per_m: f64, line: f64) -> Array2<f64> {
        let reach = (map.nrows() / 2) as f64;
        let frequency = |j: usize| ((j as f64 + 0.5) / FINE as f64 - 0.5 - reach) * step_per_m;
        let thick = step_per_m / FINE as f64;
        Array2::from_shape_fn((map.nrows() * FINE, map.ncols() * FINE), |(y, x)| {
            let farthest = frequency(y).abs().max(frequency(x).abs());
            let border = (farthest - self.half_width_per_m).abs() < thick / 2.0 * (1.0 + 1e-9);
            if border { line } else { map[[y / FINE, x / FINE]] }
        })
    }

    /// Spectra averaged around frequency 0.
    pub fn curves(&self) -> CurvePicture {
        let series = |state: &StatePsd| {
            let rings = state.psd.rings();
            let stroke = if state.state.pass == 0 { Stroke::Solid } else { Stroke::Dashed };
            let colour = match state.state.amplitude {
                None => 2,
                Some(Amplitude::Conventional) => 0,
                Some(Amplitude::Substantial) if state.state.pass == 1 => 4,
                Some(Amplitude::Substantial) => 1,
            };
            // The ring at frequency 0 is what piston left.
            let rings = rings.frequency_per_m.into_iter().zip(rings.density_nm2_m2).skip(1);
            let (x, y) = rings.unzip();
            let style = SeriesStyle { stroke, marker: Marker::None, colour: Some(colour) };
            Series { label: state.state.label(), x, y, y_err: None, style }
        };
        CurvePicture {
            title: "Power spectrum of the residual wavefront behind the plain loop".into(),
            x_label: "spatial frequency (cycles/m)".into(),
            y_label: "power (nm² m²)".into(),
            x_log: true,
            y_log: true,
            series: self.states.iter().map(series).collect(),
            vertical_lines: vec![(self.half_width_per_m, "mirror".into())],
            ..Default::default()
        }
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["psd.csv", "psd-ratio.png", "psd.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.ratios()?.draw(&files[1])?;
        self.curves().draw(&files[2])?;
        let text = format!(
            "Residual wavefront behind the plain loop within the mirror's control box (|fx| and |fy| up to {:.3} cycles/m) \
             and outside, nm RMS; ratios of variance, before over after\n",
            self.half_width_per_m
        ) + &self.table().text();
        Ok(Report { text, files: files.to_vec() })
    }
}
