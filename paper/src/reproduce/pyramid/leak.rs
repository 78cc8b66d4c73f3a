//! Leak of the segments into the mirror behind a pyramid, at rest and behind turbulence.
//!
//! Behind turbulence the optical gains reduce the slopes of the segments' steps and those of the
//! mirror by different factors, so that the mirror rests elsewhere. Twin loops, with the segments
//! and with even ones, have the same turbulence: the difference of their mean commands is what the
//! segments do, and the turbulence cancels in it.

use crate::reproduce::figures::{settled_commands_nm, wavefront_maps};
use crate::reproduce::statistics::{mean, rms, standard_deviation};
use crate::reproduce::{Cell, Conditions, Progress, Table};
use cophase::Result;
use cophase::ao::{Simulator, undisturb};
use cophase::scene::Scene;
use cophase_view::plot::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
use rayon::prelude::*;

/// Radii of the modulation, λ/D.
const MODULATIONS: [f64; 3] = [3.0, 5.0, 10.0];
/// Fried parameters at 500 nm, m.
const R0_M: [f64; 2] = [0.16, 0.10];
const BASES: [&str; 2] = ["kl", "zonal"];
/// Frames until the loop has closed and the first optical gains are measured: a window of the
/// dither.
const SETTLING: u64 = 1000;
/// Frames of the mean: another window, so that the sines of the dither have none.
const AVERAGED: u64 = 1000;
/// Steps of progress of a draw: one for each loop that runs.
pub(super) const STEPS: usize = 1 + 2 * R0_M.len();

/// A loop whose leak is measured.
pub(super) struct LeakCase {
    basis: &'static str,
    modulation: f64,
    scene: Scene,
}

/// Leak of one loop at one Fried parameter. RMS over the pupil, piston, tip and tilt removed.
#[derive(Debug, Clone)]
pub struct PyramidLeakRow {
    /// `control.basis`.
    pub basis: &'static str,
    /// Radius of the modulation, λ/D.
    pub modulation: f64,
    /// Fried parameter at 500 nm, m; infinite without turbulence.
    pub r0_m: f64,
    /// The segments' errors, nm, draw by draw.
    pub input_nm: Vec<f64>,
    /// What the segments put on the mirror, nm.
    pub mirror_nm: Vec<f64>,
    /// Difference to what they put on it without turbulence, nm.
    pub change_nm: Vec<f64>,
}

/// Leaks of all loops.
#[derive(Debug, Clone)]
pub struct PyramidLeak {
    /// Loop by loop, from no turbulence to strong turbulence.
    pub rows: Vec<PyramidLeakRow>,
}

/// The loops; of a quick look one.
pub(super) fn cases(conditions: &Conditions, is_quick: bool) -> Result<Vec<LeakCase>> {
    let noiseless = [("wavefront_sensor.photon_noise", "false"), ("wavefront_sensor.read_noise_e", "0.0")];
    let star = conditions.star()?.with(&noiseless)?;
    let case = |basis: &'static str, modulation: f64| {
        let radius = modulation.to_string();
        let settings = [("control.basis", basis), ("wavefront_sensor.modulation_lambda_over_d", &*radius)];
        Ok(LeakCase { basis, modulation, scene: star.with(&settings)? })
    };
    if is_quick {
        return Ok(vec![case(BASES[0], MODULATIONS[1])?]);
    }
    BASES.into_iter().flat_map(|basis| MODULATIONS.map(|modulation| case(basis, modulation))).collect()
}

/// Closes the loops of `cases` on the pistons of draws 1 to `seeds`. Loops of other processes'
/// parts have no draws.
///
/// # Errors
/// Those of the simulator; [`cophase::Error::Interrupted`].
pub(super) fn leak(cases: &[LeakCase], seeds: usize, progress: &Progress) -> Result<PyramidLeak> {
    let mut rows = Vec::new();
    for (number, case) in cases.iter().enumerate() {
        let name = format!("leak, {}, {} lambda/D", case.basis, case.modulation);
        let draw = |seed: usize| {
            let place = number * seeds + seed - 1;
            progress.draw((&name, seed, place), STEPS, || case.draw(seed, progress)).transpose()
        };
        let draws: Vec<Vec<f64>> = (1..=seeds).into_par_iter().filter_map(draw).collect::<Result<_>>()?;
        let of = |which: usize| draws.iter().map(|draw| draw[which]).collect::<Vec<f64>>();
        rows.extend([f64::INFINITY].into_iter().chain(R0_M).enumerate().map(|(place, r0_m)| PyramidLeakRow {
            basis: case.basis,
            modulation: case.modulation,
            r0_m,
            input_nm: of(0),
            mirror_nm: of(1 + 2 * place),
            change_nm: of(2 + 2 * place),
        }));
    }
    Ok(PyramidLeak { rows })
}

impl LeakCase {
    /// RMS of the segments' errors; then, without turbulence and for each of [`R0_M`], of the leak
    /// and of its change, nm.
    fn draw(&self, seed: usize, progress: &Progress) -> Result<Vec<f64>> {
        let seed = seed.to_string();
        let scene = self.scene.with(&[("aberrations.seed", &seed), ("turbulence.seed", &seed)])?;
        let mut simulator = Simulator::new(&scene.system().with(undisturb)?)?;
        let (still_nm, _) = settled_commands_nm(&mut simulator)?;
        progress.add(1);
        let [input_nm, mirror_nm, _] = rms_of_maps(&mut simulator, &still_nm)?;
        let mut numbers = vec![input_nm, mirror_nm, 0.0];
        for r0_m in R0_M {
            let turbulent = scene.with_override("turbulence.r0_m", &r0_m.to_string())?;
            let with_segments = mean_commands_nm(&turbulent, progress)?;
            let even = turbulent.with_override("aberrations.segment_piston_rms_nm", "0.0")?;
            let without = mean_commands_nm(&even, progress)?;
            let leak_nm: Vec<f32> =
                with_segments.iter().zip(&without).map(|(one, other)| (one - other) as f32).collect();
            let change_nm: Vec<f32> = leak_nm.iter().zip(&still_nm).map(|(one, other)| one - other).collect();
            for commands_nm in [leak_nm, change_nm] {
                numbers.push(rms_of_maps(&mut simulator, &commands_nm)?[1]);
            }
        }
        Ok(numbers)
    }
}

/// Mean commands of the loop of `scene` once it has settled, nm.
fn mean_commands_nm(scene: &Scene, progress: &Progress) -> Result<Vec<f64>> {
    let mut simulator = Simulator::new(scene)?;
    let mut sums_nm = vec![0.0; simulator.influence().indices().len()];
    for frame in 0..SETTLING + AVERAGED {
        let commands_nm = simulator.step()?.commands_nm;
        if frame >= SETTLING {
            sums_nm.iter_mut().zip(commands_nm).for_each(|(sum, &nm)| *sum += f64::from(nm) / AVERAGED as f64);
        }
        if frame % 100 == 0 {
            progress.check()?;
        }
    }
    progress.add(1);
    Ok(sums_nm)
}

/// RMS of the segments' errors, of the mirror's surface for these commands, and of what is between
/// them, nm.
fn rms_of_maps(simulator: &mut Simulator, commands_nm: &[f32]) -> Result<[f64; 3]> {
    let maps_nm = wavefront_maps(simulator, commands_nm)?;
    let pupil = simulator.pupil();
    let mut rms_nm = [0.0; 3];
    for (rms_nm, map_nm) in rms_nm.iter_mut().zip(&maps_nm) {
        *rms_nm = pupil.rms(map_nm.view())?;
    }
    Ok(rms_nm)
}

impl PyramidLeak {
    /// One line for each loop and Fried parameter: means over the draws, and the change's RMS over
    /// them.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "basis",
            "modulation_lambda_over_d",
            "r0_m",
            "seeds",
            "input_nm",
            "mirror_nm",
            "mirror_sd_nm",
            "change_nm",
        ]);
        for row in &self.rows {
            // Without turbulence there is no number.
            let r0 = Cell::Number(if row.r0_m.is_finite() { row.r0_m } else { f64::NAN }, 2);
            table.push(vec![
                row.basis.into(),
                Cell::Number(row.modulation, 0),
                r0,
                row.mirror_nm.len().into(),
                Cell::Number(mean(&row.input_nm), 1),
                Cell::Number(mean(&row.mirror_nm), 1),
                Cell::Number(standard_deviation(&row.mirror_nm), 1),
                Cell::Number(rms(&row.change_nm), 2),
            ]);
        }
        table
    }

    /// Leak against the radius of the modulation, a line for each basis and Fried parameter.
    pub fn picture(&self) -> CurvePicture {
        let mut series: Vec<Series> = Vec::new();
        for row in &self.rows {
            let r0 =
                if row.r0_m.is_finite() { format!("r0 {:.0} cm", 100.0 * row.r0_m) } else { "no turbulence".into() };
            let label = format!("{}, {r0}", row.basis);
            let place = match series.iter().position(|series| series.label == label) {
                Some(place) => place,
                None => {
                    let stroke = if row.basis == BASES[0] { Stroke::Solid } else { Stroke::Dashed };
                    let colour = R0_M.iter().position(|r0_m| *r0_m == row.r0_m).map_or(0, |place| place + 1);
                    let style = SeriesStyle { stroke, marker: Marker::Disc, colour: Some(colour) };
                    series.push(Series { label, style, y_err: Some(Vec::new()), ..Default::default() });
                    series.len() - 1
                }
            };
            let one = &mut series[place];
            one.x.push(row.modulation);
            one.y.push(mean(&row.mirror_nm));
            one.y_err.iter_mut().for_each(|errors| errors.push(standard_deviation(&row.mirror_nm)));
        }
        CurvePicture {
            title: "Segment pistons that leak into the mirror behind a pyramid".into(),
            x_label: "modulation (lambda/D)".into(),
            y_label: "mirror (nm RMS)".into(),
            series,
            ..Default::default()
        }
    }
}
