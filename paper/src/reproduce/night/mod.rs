//! A night of images, each of which is estimated, and the tracker that follows them.
//!
//! ```text
//! Scenario ─ images (a camera on a finer grid) ─ session, one fit an image ─ Tracker ─ errors, alarms
//!                                                      └ their covariance ─ nights without images: false alarms
//! ```

mod images;
mod quiet;
mod report;
mod scenario;
mod track;

pub use quiet::QuietNights;
pub use scenario::{BadFrame, Jump, Scenario};
pub use track::{Followed, TrackedFrame};

use super::{Case, Progress};
use cophase::scene::Scene;
use cophase::{Error, Result};
use images::Cameraman;

/// The telescope: Keck, an artificial source, half of the preset's sampling and two thirds of its
/// pupil grid, so that a night takes minutes. A peak S/N of 25 gives errors of some nm from one
/// image; brighter, tracking would have nothing to gain. All NCPA modes that are estimated drift
/// alike.
const SETTINGS: [(&str, &str); 11] = [
    ("pupil.samples", "80"),
    ("image.samples_per_lambda_over_d", "2"),
    ("image.pixels", "96"),
    ("image.read_noise_e", "20"),
    ("image.peak_snr", "25"),
    ("image.count", "1"),
    ("modes.ncpa", "none"),
    ("modes.exact_zernikes", "[4, 18]"),
    ("aberrations.segment_piston_rms_nm", "30"),
    ("aberrations.ncpa_rms_nm", "40"),
    ("aberrations.truth_samples", "240"),
];
/// False alarms a night that are asked for, and, to see enough of them in one night with images, of
/// a second tracker.
const ASKED: f64 = 1.0;
const ASKED_LOUD: f64 = 40.0;

/// What a night shows.
pub struct Night {
    /// What happened.
    pub scenario: Scenario,
    /// The tracker on it.
    pub followed: Followed,
    /// False alarms of a tracker that was asked for [`Night::loud_asked`], on the same estimates.
    pub loud_false_alarms: usize,
    /// What it was asked for, in the length of this night.
    pub loud_asked: f64,
    /// Root of the mean square of (estimate − truth)/σ of the single images along the principal
    /// directions.
    pub single_pull: f64,
    /// Mean time of an image's fit with its error bars, s.
    pub fit_s: f64,
    /// Nights without images.
    pub quiet: QuietNights,
}

/// A night of 8 hours with an image every 10 s, an eighth of one if `quick`, and `nights` without
/// images.
///
/// # Errors
/// Those of simulation and estimator; [`Error::Interrupted`].
pub fn night(nights: usize, quick: bool, progress: &Progress) -> Result<Night> {
    let scenario = Scenario::new(if quick { 360 } else { 2880 });
    progress.expect(scenario.frames + nights);
    let scene = Scene::preset("keck-artificial")?.with(&SETTINGS)?;
    let case = Case::new(&scene)?;
    let cameraman = Cameraman::new(&scene, &case, &scenario)?;
    let started = std::time::Instant::now();
    let estimates = cameraman.estimates(&case, progress)?;
    let fit_s = started.elapsed().as_secs_f64() / scenario.frames as f64;
    let followed = Followed::new(&case, &scenario, &estimates, cameraman.truth_nm(), ASKED)?;
    let loud = Followed::new(&case, &scenario, &estimates, cameraman.truth_nm(), ASKED_LOUD)?;
    let single_pull = track::pull(&case, &estimates, cameraman.truth_nm(), &followed)?;
    let reference = followed
        .median_frame()
        .and_then(|frame| estimates[frame].as_ref())
        .ok_or_else(|| Error::Image("no image of the night could be used".into()))?;
    let quiet = QuietNights::new(&reference.covariance_nm2, scenario.segments, nights, ASKED, progress)?;
    Ok(Night {
        followed,
        loud_false_alarms: loud.false_alarms(),
        loud_asked: ASKED_LOUD * scenario.hours() / 8.0,
        single_pull,
        fit_s,
        quiet,
        scenario,
    })
}
