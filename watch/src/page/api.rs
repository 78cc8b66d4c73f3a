//! The JSON behind the page; `docs/watch.md` describes it.

use crate::clock;
use crate::live::Live;
use crate::pointing;
use crate::store::{About, Columns, Reader, StoredFrame};
use cophase::modal::ModalFitter;
use cophase::modes::Group;
use cophase::{Error, Result};
use ndarray::{Array2, ArrayView2};
use serde_json::{Value, json};
use std::sync::Arc;

/// Largest number of rows of an answer.
pub const MOST_ROWS: usize = 2000;
/// Frames of the trend unless asked otherwise.
pub const TREND: i64 = 500;
/// Largest side of a map: what a phone shows.
const MAP_SIDE: usize = 96;

/// What the answers are made from.
pub struct Api {
    pub reader: Reader,
    pub about: About,
    pub live: Live,
    pub fitter: Arc<ModalFitter>,
    pub started_s: f64,
}

impl Api {
    /// Source, counts, rate and latency, and what hinders the watch.
    pub fn status(&self) -> Result<Value> {
        let last = self.reader.last_frames(None, 100, Columns::Figures)?;
        let now_s = clock::now_s();
        let minute = last.iter().filter(|frame| now_s - frame.taken_s < 60.0).count();
        let mut latencies: Vec<f64> = last.iter().filter_map(|frame| frame.latency_s).collect();
        latencies.sort_by(f64::total_cmp);
        let pointing_rms = pointing::rms_pixels(&last);
        let span_s = last.first().zip(last.last()).map(|(first, last)| last.taken_s - first.taken_s);
        Ok(json!({
            "now_s": now_s,
            "started_s": self.started_s,
            "source": self.about.source,
            "policy": self.about.policy,
            "modes": self.about.modes.len(),
            "counts": self.reader.counts()?,
            "problem": self.live.problem(),
            "frames_last_minute": minute,
            "frames_per_s": span_s.filter(|span_s| *span_s > 0.0).map(|span_s| (last.len() - 1) as f64 / span_s),
            "latency_s": latencies.get(latencies.len() / 2),
            "pointing_rms_pixels": pointing_rms,
            "last_frame": last.last(),
        }))
    }

    /// Segments with their newest values.
    pub fn mirror(&self) -> Result<Value> {
        let frame = self.newest()?;
        let geometry: Value = serde_json::from_str(&self.about.segments).unwrap_or_default();
        let count = geometry["centres_m"].as_array().map_or(0, Vec::len);
        let segments: Vec<Value> = (0..count)
            .map(|segment| {
                let mode = self.piston(segment);
                let of = |vector: fn(&StoredFrame) -> &[f64]| {
                    frame.as_ref().zip(mode).and_then(|(frame, mode)| vector(frame).get(mode).copied())
                };
                json!({
                    "segment": segment,
                    "label": geometry["labels"][segment],
                    "centre_m": geometry["centres_m"][segment],
                    "piston_nm": of(|frame| &frame.coefficients_nm),
                    "sigma_nm": of(|frame| &frame.sigma_nm),
                    "tracked_nm": of(|frame| &frame.tracked_nm),
                    "tracked_sigma_nm": of(|frame| &frame.tracked_sigma_nm),
                })
            })
            .collect();
        let frame = frame.map(|frame| frame.id);
        Ok(json!({ "frame": frame, "inner_radius_m": geometry["inner_radius_m"], "segments": segments }))
    }

    /// History of the piston of a segment.
    pub fn segment(&self, segment: usize, limit: usize) -> Result<Value> {
        let Some(mode) = self.piston(segment) else {
            return Err(Error::Value(format!("segment {segment} has no piston mode")));
        };
        Ok(json!({ "segment": segment, "mode": self.about.modes[mode], "history": self.reader.history(mode, limit)? }))
    }

    /// RMS, χ² and flux of the last frames.
    pub fn trend(&self, limit: usize) -> Result<Value> {
        let frames = self.reader.last_frames(Some("done"), limit, Columns::Figures)?;
        let column = |value: fn(&StoredFrame) -> Option<f64>| frames.iter().map(value).collect::<Vec<_>>();
        Ok(json!({
            "frame": frames.iter().map(|frame| frame.id).collect::<Vec<_>>(),
            "time_s": column(|frame| Some(frame.observed_s)),
            "phasing_rms_nm": column(|frame| frame.phasing_rms_nm),
            "ncpa_rms_nm": column(|frame| frame.ncpa_rms_nm),
            "reduced_chi2": column(|frame| frame.chi2),
            "flux_e": column(|frame| frame.flux_e),
            "pointing_x_pixels": column(|frame| frame.pointing_x_pixels),
            "pointing_y_pixels": column(|frame| frame.pointing_y_pixels),
            "latency_s": column(|frame| frame.latency_s),
        }))
    }

    /// The newest events first.
    pub fn events(&self, limit: usize) -> Result<Value> {
        Ok(json!({ "events": self.reader.events(limit)? }))
    }

    /// The newest corrections first.
    pub fn corrections(&self, limit: usize) -> Result<Value> {
        Ok(json!({ "corrections": self.reader.corrections(limit)? }))
    }

    /// The newest frames that were refused, and why.
    pub fn refused(&self, limit: usize) -> Result<Value> {
        let mut frames = self.reader.last_frames(Some("refused"), limit, Columns::Figures)?;
        frames.reverse();
        Ok(json!({ "refused": frames }))
    }

    /// Frames after the frame `after`, the oldest first.
    pub fn frames(&self, after: i64, limit: usize) -> Result<Value> {
        Ok(json!({ "frames": self.reader.frames_after(after, limit, Columns::Figures)? }))
    }

    /// The coefficients of a frame.
    pub fn frame(&self, id: i64) -> Result<Value> {
        let frame = self.reader.frames_after(id - 1, 1, Columns::All)?.into_iter().find(|frame| frame.id == id);
        let Some(frame) = frame else { return Err(Error::Value(format!("there is no frame {id}"))) };
        let modes = &self.about.modes;
        Ok(json!({
            "modes": modes,
            "coefficients_nm": frame.coefficients_nm,
            "sigma_nm": frame.sigma_nm,
            "tracked_nm": frame.tracked_nm,
            "tracked_sigma_nm": frame.tracked_sigma_nm,
            "frame": frame,
        }))
    }

    /// Map of the NCPA of the newest frame, tracked where they are tracked, without tip and tilt,
    /// which are pointing.
    pub fn ncpa(&self) -> Result<Value> {
        let Some(frame) = self.newest()? else { return Ok(json!({ "frame": null, "nm": [] })) };
        let coefficients_nm = if frame.tracked_nm.is_empty() { &frame.coefficients_nm } else { &frame.tracked_nm };
        let model = self.fitter.model();
        // The coefficients hold no plane of the whole pupil; of modes that are not orthogonal to it
        // a slope is left.
        let map_nm = model.telescope.pupil.remove_piston_tip_tilt(model.map_nm(coefficients_nm, Group::Ncpa).view())?;
        Ok(json!({ "frame": frame.id, "nm": rows(map_nm.view(), MAP_SIDE) }))
    }

    /// The newest image that was fitted, and its residual in standard deviations.
    pub fn image(&self) -> Value {
        match self.live.image() {
            None => json!({ "frame": null, "data_e": [], "residual_sigma": [] }),
            Some((frame, image)) => json!({
                "frame": frame,
                "data_e": rows(image.data_e.view(), MAP_SIDE),
                "residual_sigma": rows(image.residual_sigma.view(), MAP_SIDE),
            }),
        }
    }

    fn newest(&self) -> Result<Option<StoredFrame>> {
        Ok(self.reader.last_frames(Some("done"), 1, Columns::All)?.pop())
    }

    /// The mode that is the piston of a segment.
    fn piston(&self, segment: usize) -> Option<usize> {
        self.about.modes.iter().position(|name| {
            let number = name.strip_prefix("segment-").and_then(|rest| rest.strip_suffix("-piston"));
            number.and_then(|number| number.parse().ok()) == Some(segment)
        })
    }
}

/// Rows of a map from below, with at most `side` samples along each axis: means of blocks, null
/// where nothing is known.
fn rows(map: ArrayView2<f64>, side: usize) -> Vec<Vec<Option<f64>>> {
    let block = map.nrows().max(map.ncols()).div_ceil(side).max(1);
    let mut sums = Array2::<(f64, u32)>::default((map.nrows().div_ceil(block), map.ncols().div_ceil(block)));
    for ((y, x), value) in map.indexed_iter().filter(|(_, value)| value.is_finite()) {
        let sum = &mut sums[[y / block, x / block]];
        *sum = (sum.0 + value, sum.1 + 1);
    }
    // Two decimals: what a colour shows, in half of the bytes.
    let mean = |&(sum, count): &(f64, u32)| (count > 0).then(|| (sum / f64::from(count) * 100.0).round() / 100.0);
    sums.rows().into_iter().map(|row| row.iter().map(mean).collect()).collect()
}
