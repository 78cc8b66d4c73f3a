//! Section 4: the loop closed on the segments' steps alone. All that the mirror then shows has
//! leaked into it, and stands in the way of every estimate.

use super::setup;
use crate::reproduce::statistics::{mean, standard_deviation};
use crate::reproduce::{Cell, Conditions, Progress, Report, Segments, Table};
use cophase::Result;
use cophase::ao::{Simulator, undisturb};
use cophase::scene::{Scene, System};
use cophase_view::plot::{CaptionedMap, MapScale, MapsPicture};
use ndarray::Array2;
use rayon::prelude::*;
use std::path::Path;

/// The mirror is at rest when no actuator moves by more than this in a frame, nm: with a gain of
/// 0.3 it is then within 0.003 nm of where it goes, and rounding (1e-7 of strokes of some 500 nm)
/// moves it less.
const STILL_NM: f32 = 1e-3;
/// Frames after which a mirror that still moves is taken as it is. A stable loop of gain g needs
/// ln(500 nm/1e-3 nm)/g = 45 of them at 0.3.
const MOST_FRAMES: u64 = 3000;
/// One loop on one pupil.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeakCase {
    /// The loop, by its row in the table.
    pub row: &'static str,
    /// The telescope.
    pub segments: Segments,
    /// `wavefront_sensor.mask_dominant_fraction`.
    pub mask_dominant_fraction: f64,
    /// What an independent prototype (a loop in C, 12 draws) left on the mirror, nm, where it was
    /// tried.
    pub prototype_nm: Option<f64>,
}

impl LeakCase {
    /// The loops of the paper on the real segments and on its own, with either reading of its
    /// criterion for the mask: one segment holds 75 % of the light, or the other one at most a
    /// quarter as much as the first.
    pub const ALL: [LeakCase; 7] = [
        LeakCase::new("zonal", Segments::Real, 0.75, Some(49.0)),
        LeakCase::new("zonal", Segments::Published, 0.75, None),
        LeakCase::new("mask-zonal", Segments::Real, 0.75, None),
        LeakCase::new("mask-zonal", Segments::Published, 0.75, None),
        LeakCase::new("pol-mask-inpaint", Segments::Real, 0.75, Some(25.0)),
        LeakCase::new("pol-mask-inpaint", Segments::Published, 0.75, Some(15.0)),
        LeakCase::new("pol-mask-inpaint", Segments::Published, 0.8, Some(11.0)),
    ];

    const fn new(
        row: &'static str,
        segments: Segments,
        mask_dominant_fraction: f64,
        prototype_nm: Option<f64>,
    ) -> Self {
        Self { row, segments, mask_dominant_fraction, prototype_nm }
    }

    /// Whether the picture shows it: the three loops on the paper's pupil.
    fn is_drawn(&self) -> bool {
        self.segments == Segments::Published && self.mask_dominant_fraction == 0.75
    }

    fn scene(&self) -> Result<Scene> {
        let conditions = Conditions { segments: self.segments, ..Default::default() };
        let fraction = self.mask_dominant_fraction.to_string();
        setup::row(self.row)?.scene(&conditions)?.with_override("wavefront_sensor.mask_dominant_fraction", &fraction)
    }
}

/// What one draw of pistons does. RMS over the pupil, piston, tip and tilt removed.
#[derive(Debug, Clone)]
pub struct LeakDraw {
    /// `aberrations.seed`.
    pub seed: usize,
    /// The segments' errors, nm.
    pub input_nm: f64,
    /// The mirror's surface, nm.
    pub mirror_nm: f64,
    /// Residual behind the mirror, nm.
    pub residual_nm: f64,
    /// Frames until the mirror was at rest; `None` where it never was.
    pub frames: Option<u64>,
    /// Subapertures that are masked.
    pub masked: usize,
}

/// All draws of one case.
#[derive(Debug, Clone)]
pub struct LeakRow {
    /// Which.
    pub case: LeakCase,
    /// Side of a segment, m.
    pub segment_side_m: f64,
    /// In the order of their seeds.
    pub draws: Vec<LeakDraw>,
    /// Input, mirror and residual of the first draw.
    maps: Vec<CaptionedMap>,
}

impl LeakRow {
    /// What leaked into the mirror, nm, draw by draw.
    pub fn mirror_nm(&self) -> Vec<f64> {
        self.draws.iter().map(|draw| draw.mirror_nm).collect()
    }
}

/// All cases.
#[derive(Debug, Clone)]
pub struct Leak {
    /// In the order that was asked for.
    pub rows: Vec<LeakRow>,
}

/// Closes the loops of `cases` on the pistons of draws 1 to `seeds`, without turbulence and noise.
///
/// # Errors
/// Those of the simulator, and [`cophase::Error::Interrupted`].
pub fn leak(cases: &[LeakCase], seeds: usize, progress: &Progress) -> Result<Leak> {
    progress.expect(cases.len() * seeds);
    let row = |case: &LeakCase| -> Result<LeakRow> {
        let scene = case.scene()?;
        let draws = (1..=seeds).into_par_iter().map(|seed| {
            progress.check()?;
            let draw = case.settle(&setup::with_seed(&scene, seed)?.system().with(undisturb)?, seed)?;
            progress.add(1);
            Ok(draw)
        });
        let (draws, maps): (_, Vec<_>) = draws.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        Ok(LeakRow {
            case: *case,
            segment_side_m: scene.pupil.segment_side_m,
            draws,
            maps: maps.into_iter().next().unwrap_or_default(),
        })
    };
    Ok(Leak { rows: cases.iter().map(row).collect::<Result<_>>()? })
}

impl LeakCase {
    /// Closes the loop of `scene` until the mirror is at rest; maps of the first draw only.
    fn settle(&self, scene: &System, seed: usize) -> Result<(LeakDraw, Vec<CaptionedMap>)> {
        let mut simulator = Simulator::new(scene)?;
        let (commands_nm, frames) = settled_commands_nm(&mut simulator)?;
        let maps_nm = wavefront_maps(&mut simulator, &commands_nm)?;
        let pupil = simulator.pupil().clone();
        let rms = |map: usize| pupil.rms(maps_nm[map].view());
        let draw = LeakDraw {
            seed,
            input_nm: rms(0)?,
            mirror_nm: rms(1)?,
            residual_nm: rms(2)?,
            frames,
            masked: simulator.mask().iter().filter(|&&masked| masked).count(),
        };
        let drawn = seed == 1 && self.is_drawn();
        let captions = ["input", "mirror", "residual"].into_iter().filter(|_| drawn).zip(&maps_nm);
        let maps = captions.map(|(what, map_nm)| {
            let caption = format!("{}, {what}: {:.1} nm RMS", self.row, pupil.rms(map_nm.view())?);
            Ok(setup::wavefront(&pupil, caption, map_nm, MapScale::SharedDiverging))
        });
        Ok((draw, maps.collect::<Result<_>>()?))
    }
}

/// Commands of the mirror once it is at rest, nm, and the frames until then; of a mirror that still
/// moves at the end no number of frames.
///
/// # Errors
/// Those of [`Simulator::step`].
pub(in crate::reproduce) fn settled_commands_nm(simulator: &mut Simulator) -> Result<(Vec<f32>, Option<u64>)> {
    let mut commands_nm = vec![0.0; simulator.influence().indices().len()];
    let mut frames = None;
    while frames.is_none() && simulator.frames() < MOST_FRAMES {
        let frame = simulator.step()?;
        let moved = frame.commands_nm.iter().zip(&commands_nm).map(|(now, then)| (now - then).abs());
        // The first frame sees the flat mirror that the loop starts with.
        if moved.fold(0.0, f32::max) < STILL_NM && frame.number > 0 {
            frames = Some(frame.number);
        }
        commands_nm.copy_from_slice(frame.commands_nm);
    }
    Ok((commands_nm, frames))
}

/// Segment errors, the mirror's surface for `commands_nm`, and what is between them on the pupil,
/// nm, piston, tip and tilt removed.
///
/// # Errors
/// Those of [`Simulator::surface_nm`].
pub(in crate::reproduce) fn wavefront_maps(simulator: &mut Simulator, commands_nm: &[f32]) -> Result<[Array2<f64>; 3]> {
    let input_nm = setup::on_pupil(simulator, simulator.segments_nm());
    let surface_nm = simulator.surface_nm(commands_nm)?;
    let mirror_nm = setup::on_pupil(simulator, &surface_nm);
    let residual_nm = &input_nm - &mirror_nm;
    let level = |map_nm: Array2<f64>| simulator.pupil().remove_piston_tip_tilt(map_nm.view());
    Ok([level(input_nm)?, level(mirror_nm)?, level(residual_nm)?])
}

impl Leak {
    /// One line for each case.
    pub fn summary(&self) -> Table {
        let mut table = Table::new(&[
            "loop",
            "segment_side_m",
            "mask_fraction",
            "masked",
            "seeds",
            "input_nm",
            "mirror_nm",
            "mirror_sd_nm",
            "residual_nm",
            "prototype_nm",
        ]);
        for row in &self.rows {
            let of = |value: fn(&LeakDraw) -> f64| row.draws.iter().map(value).collect::<Vec<f64>>();
            let masked = row.draws.first().map_or(0, |draw| draw.masked);
            table.push(vec![
                row.case.row.into(),
                Cell::Number(row.segment_side_m, 3),
                Cell::Number(if masked > 0 { row.case.mask_dominant_fraction } else { f64::NAN }, 2),
                masked.into(),
                row.draws.len().into(),
                Cell::Number(mean(&of(|draw| draw.input_nm)), 1),
                Cell::Number(mean(&row.mirror_nm()), 1),
                Cell::Number(standard_deviation(&row.mirror_nm()), 1),
                Cell::Number(mean(&of(|draw| draw.residual_nm)), 1),
                Cell::Number(row.case.prototype_nm.unwrap_or(f64::NAN), 0),
            ]);
        }
        table
    }

    /// One line for each case and draw.
    pub fn draws(&self) -> Table {
        let mut table = Table::new(&[
            "loop",
            "segment_side_m",
            "mask_fraction",
            "seed",
            "input_nm",
            "mirror_nm",
            "residual_nm",
            "frames",
        ]);
        for (row, draw) in self.rows.iter().flat_map(|row| row.draws.iter().map(move |draw| (row, draw))) {
            table.push(vec![
                row.case.row.into(),
                Cell::Number(row.segment_side_m, 3),
                Cell::Number(row.case.mask_dominant_fraction, 2),
                draw.seed.into(),
                Cell::Number(draw.input_nm, 2),
                Cell::Number(draw.mirror_nm, 2),
                Cell::Number(draw.residual_nm, 2),
                Cell::Number(draw.frames.map_or(f64::NAN, |frames| frames as f64), 0),
            ]);
        }
        table
    }

    /// Input, mirror and residual of the first draw on the paper's pupil, a row for each loop.
    pub fn picture(&self) -> MapsPicture {
        MapsPicture {
            title: "The loop closed on segment pistons alone: input, mirror, residual".into(),
            columns: 3,
            maps: self.rows.iter().flat_map(|row| row.maps.iter().cloned()).collect(),
        }
    }

    pub(in crate::reproduce) fn report(&self, directory: &Path) -> Result<Report> {
        let files = ["leak.csv", "leak-draws.csv", "leak.png"].map(|name| directory.join(name));
        self.summary().write_csv(&files[0])?;
        self.draws().write_csv(&files[1])?;
        self.picture().draw(&files[2])?;
        let text =
            "Segment pistons that leak into the mirror, no turbulence, nm RMS over the pupil without piston, tip \
                    and tilt\n(mean over draws; the paper has about 9 for pol-mask-inpaint)\n"
                .to_string()
                + &self.summary().text();
        Ok(Report { text, files: files.to_vec() })
    }
}
