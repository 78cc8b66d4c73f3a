//! Section 4: what goes into the simulation. The layers of turbulence with the segments as a static
//! one, the NCPA, and the subapertures that are masked.

use super::setup::{self, on_pupil, wavefront};
use crate::reproduce::statistics::{mean, standard_deviation};
use crate::reproduce::{Cell, Conditions, Progress, Report, Table};
use cophase::ao::{Atmosphere, Simulator};
use cophase::{Error, Result};
use cophase_view::plot::{CaptionedMap, MapScale, MapsPicture};
use ndarray::Array2;
use std::path::Path;

/// Shades that distinguish neighbouring segments under the mask, of 1; blue, because the mask is
/// red.
const SHADES: [f64; 3] = [-0.15, -0.3, -0.45];
/// Shade of a masked subaperture.
const MASKED: f64 = 0.8;

/// One layer, or one static aberration.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerRow {
    /// `turbulence`, `segments` or `ncpa`.
    pub kind: &'static str,
    /// Height, m.
    pub height_m: f64,
    /// Share of the turbulence.
    pub fraction: f64,
    /// Fried's parameter of this layer alone, at 500 nm, m.
    pub r0_m: f64,
    /// Wind speed, m/s.
    pub wind_m_s: f64,
    /// Wind direction, degrees from +x.
    pub wind_dir_deg: f64,
    /// RMS over the pupil of each draw, piston removed, nm.
    pub rms_nm: Vec<f64>,
    /// The same without tip and tilt.
    pub level_nm: Vec<f64>,
}

/// What goes in.
#[derive(Debug, Clone)]
pub struct Layers {
    /// The layers in the scene's order, then the segments and the NCPA.
    pub rows: Vec<LayerRow>,
    /// Subapertures in use, and those of them that are masked.
    pub subapertures: [usize; 2],
    layers: MapsPicture,
    inputs: MapsPicture,
}

/// Draws 1 to `seeds` of the aberrations and of the turbulence at the moment when the loop is
/// closed.
///
/// # Errors
/// Those of the simulator; [`Error::Interrupted`].
pub fn layers(conditions: &Conditions, seeds: usize, progress: &Progress) -> Result<Layers> {
    progress.expect(seeds);
    let scene = setup::row("pol-mask-inpaint")?.scene(conditions)?;
    let sky = &scene.turbulence;
    let still = |kind| LayerRow {
        kind,
        height_m: 0.0,
        fraction: f64::NAN,
        r0_m: f64::NAN,
        wind_m_s: 0.0,
        wind_dir_deg: f64::NAN,
        rms_nm: Vec::new(),
        level_nm: Vec::new(),
    };
    let moving = |layer: usize| LayerRow {
        height_m: sky.heights_m[layer],
        fraction: sky.fractions[layer],
        r0_m: sky.r0_m * sky.fractions[layer].powf(-0.6),
        wind_m_s: sky.wind_m_s[layer],
        wind_dir_deg: sky.wind_dir_rad[layer].to_degrees().rem_euclid(360.0),
        ..still("turbulence")
    };
    let mut rows: Vec<LayerRow> = (0..sky.fractions.len()).map(moving).collect();
    rows.extend([still("segments"), still("ncpa")]);
    let mut first = None;
    for seed in 1..=seeds {
        progress.check()?;
        let drawn = setup::with_seed(&scene, seed)?;
        let simulator = Simulator::new(&drawn)?;
        let maps_nm = maps(&simulator)?;
        let pupil = simulator.pupil();
        for (row, map_nm) in rows.iter_mut().zip(&maps_nm) {
            row.rms_nm.push(pupil.rms(pupil.remove_piston(map_nm.view())?.view())?);
            row.level_nm.push(pupil.rms(pupil.remove_piston_tip_tilt(map_nm.view())?.view())?);
        }
        if first.is_none() {
            first = Some(pictures(&simulator, &rows, maps_nm)?);
        }
        progress.add(1);
    }
    let (layers, inputs, subapertures) = first.ok_or_else(|| Error::Value("0 seeds leave nothing to draw".into()))?;
    Ok(Layers { rows, subapertures, layers, inputs })
}

/// The layers, the segments, the NCPA, `[y, x]`, nm.
fn maps(simulator: &Simulator) -> Result<Vec<Array2<f64>>> {
    let (scene, pupil) = (simulator.scene(), simulator.pupil());
    let sky = &scene.turbulence;
    let atmosphere = Atmosphere::new(sky, &pupil.grid, simulator.footprint(), simulator.frame_s(), sky.seed)?;
    let mut maps: Vec<_> = atmosphere.layers_nm().iter().map(|map| on_pupil(simulator, map)).collect();
    maps.push(on_pupil(simulator, simulator.segments_nm()));
    maps.push(setup::ncpa_nm(simulator)?);
    Ok(maps)
}

fn pictures(
    simulator: &Simulator,
    rows: &[LayerRow],
    maps_nm: Vec<Array2<f64>>,
) -> Result<(MapsPicture, MapsPicture, [usize; 2])> {
    let pupil = simulator.pupil();
    let mut drawn = Vec::with_capacity(rows.len());
    for (row, map_nm) in rows.iter().zip(&maps_nm) {
        let map_nm = pupil.remove_piston(map_nm.view())?;
        let rms = pupil.rms(map_nm.view())?;
        let (caption, scale) = match row.kind {
            "turbulence" => {
                let (height_km, percent) = (row.height_m / 1000.0, 100.0 * row.fraction);
                (format!("{height_km} km, {percent:.1} %, {rms:.0} nm"), MapScale::SharedDiverging)
            }
            "segments" => (format!("0 km, static, {rms:.0} nm"), MapScale::Diverging),
            _ => (format!("NCPA: {rms:.1} nm RMS"), MapScale::Diverging),
        };
        drawn.push(wavefront(pupil, caption, &map_nm, scale));
    }
    let ncpa = drawn.pop();
    let segments = drawn.last().zip(rows.iter().find(|row| row.kind == "segments"));
    let segments = segments.map(|(map, row)| {
        let caption = format!("Segments: {:.1} nm RMS", row.rms_nm.iter().copied().fold(0.0, f64::max));
        CaptionedMap { caption, ..map.clone() }
    });
    let mask = mask(simulator);
    let subapertures = [simulator.mask().len(), simulator.mask().iter().filter(|&&masked| masked).count()];
    let layers = MapsPicture {
        title: "Layers of the simulation: height, share of the turbulence, RMS".into(),
        columns: 4,
        maps: drawn,
    };
    let inputs = MapsPicture {
        title: "Static aberrations, and the mask of the sensor".into(),
        columns: 3,
        maps: segments.into_iter().chain(ncpa).chain([mask]).collect(),
    };
    Ok((layers, inputs, subapertures))
}

/// The segments in shades, masked subapertures over them.
fn mask(simulator: &Simulator) -> CaptionedMap {
    let (pupil, lenslets) = (simulator.pupil(), simulator.lenslets());
    // Three shades such that no two neighbours share one: by the segment's place in its row and
    // column of hexagons.
    let side_m = simulator.scene().pupil.segment_side_m;
    let shade = |owner: usize| {
        let segment = pupil.segments[owner];
        let column = (segment.x_m / (1.5 * side_m)).round();
        let row = (segment.y_m / (3f64.sqrt() * side_m) - column / 2.0).round();
        SHADES[(column - row).rem_euclid(3.0) as usize % SHADES.len()]
    };
    let mut values = pupil.owner.mapv(|owner| usize::try_from(owner).map_or(f64::NAN, shade));
    let masked: Vec<usize> = lenslets
        .subapertures
        .iter()
        .zip(simulator.mask())
        .filter(|(_, masked)| **masked)
        .map(|(place, _)| *place)
        .collect();
    for place in &masked {
        let (top, left) = (place / lenslets.across * lenslets.samples, place % lenslets.across * lenslets.samples);
        for (y, x) in (0..lenslets.samples.pow(2)).map(|i| (top + i / lenslets.samples, left + i % lenslets.samples)) {
            // A line of the pupil is left around each.
            if y > top && x > left {
                values[[y, x]] = MASKED;
            }
        }
    }
    CaptionedMap {
        caption: format!("{} of {} subapertures masked (red)", masked.len(), lenslets.subapertures.len()),
        values,
        unit: String::new(),
        width_m: Some(pupil.grid.width_m()),
        scale: MapScale::Diverging,
        labels: Vec::new(),
    }
}

impl Layers {
    /// One line for each layer, and for the static aberrations.
    pub fn table(&self) -> Table {
        let mut table = Table::new(&[
            "kind",
            "height_m",
            "fraction",
            "r0_m",
            "wind_m_s",
            "wind_dir_deg",
            "seeds",
            "rms_nm",
            "rms_sd_nm",
            "level_nm",
        ]);
        for row in &self.rows {
            table.push(vec![
                row.kind.into(),
                Cell::Number(row.height_m, 0),
                Cell::Number(row.fraction, 3),
                Cell::Number(row.r0_m, 3),
                Cell::Number(row.wind_m_s, 1),
                Cell::Number(row.wind_dir_deg, 1),
                row.rms_nm.len().into(),
                Cell::Number(mean(&row.rms_nm), 1),
                Cell::Number(standard_deviation(&row.rms_nm), 1),
                Cell::Number(mean(&row.level_nm), 1),
            ]);
        }
        table
    }

    /// The layers and the segments of the first draw.
    pub fn picture(&self) -> &MapsPicture {
        &self.layers
    }

    /// Segments, NCPA and mask of the first draw.
    pub fn inputs(&self) -> &MapsPicture {
        &self.inputs
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["layers.csv", "layers.png", "layers-inputs.png"].map(|name| directory.join(name));
        self.table().write_csv(&files[0])?;
        self.layers.draw(&files[1])?;
        self.inputs.draw(&files[2])?;
        let [used, masked] = self.subapertures;
        let text = format!(
            "Inputs of the simulation, RMS over the pupil (piston removed; level_nm: tip and tilt as well), mean over draws; \
             {masked} of {used} subapertures are masked\n"
        ) + &self.table().text();
        Ok(Report { text, files: files.to_vec() })
    }
}
