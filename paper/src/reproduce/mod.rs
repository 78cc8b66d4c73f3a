//! The paper's results beside ours: experiments that return plain data, print a table, and write it
//! as CSV with a picture.
//!
//! An experiment is a function of this room ([`artificial_source()`], [`samples()`],
//! [`diversity()`], [`on_sky()`], [`image_numbers()`], those of [`figures`]); [`Target`] runs one
//! by name and writes its files. Residuals are RMS over the pupil (weight A) in nm, piston, tip and
//! tilt removed.

mod artificial_source;
mod bad_pixels;
mod beyond;
mod channels;
mod checks;
mod closed_loop;
mod diversity;
mod faults;
pub mod figures;
mod groups;
mod hard_cases;
mod left_out;
mod moving_star;
mod night;
mod observations;
mod on_sky;
mod on_sky_images;
mod on_sky_table;
mod one_wavefront;
mod options;
mod petals;
mod pulls;
mod pyramid;
mod report;
mod row_draw;
mod samples;
mod table_rows;
mod target;

pub use artificial_source::{ArtificialSource, WayResult, artificial_source};
pub use bad_pixels::{BadPixelRow, BadPixels, bad_pixels};
pub use beyond::{BEYOND_ROWS, Beyond, BeyondDraw, BeyondRow, HeldMap, beyond, beyond_rows, held_maps};
pub use channels::{CHANNEL_ROWS, ChannelDraw, ChannelRow, ChannelTable, channels};
pub use checks::{CHECK_ROWS, CheckDraw, CheckRow, Checks, checks};
pub use closed_loop::{ClosedLoop, Round, closed_loop};
pub use diversity::{Diversity, DiversityPoint, diversity};
pub use faults::{FaultRow, Faults, faults};
pub use groups::{GROUP_ROWS, GroupDraws, GroupRow, Groups, groups};
pub use hard_cases::{Draws, HARD_CASES, HardCase, HardCases, Mismatch, Spoil, Verdict, hard_cases};
pub use left_out::{LeftOutDraw, LeftOutRow, LeftOutTable, left_out};
pub use moving_star::{Disturbance, MovingNight, MovingNights, MovingRow, MovingStar, Step, moving_star};
pub use night::{BadFrame, Followed, Jump, Night, QuietNights, Scenario, TrackedFrame, night};
pub use observations::{Observations, PlannedScene, observations};
pub use on_sky::{LoopRun, Reader, Reading, Sequence};
pub use on_sky_images::{ImageNumber, ImageNumbers, image_numbers};
pub use on_sky_table::{OnSky, RowResult, on_sky, reduction_percent};
pub use one_wavefront::{OneWavefront, WavefrontDraws, WavefrontRow, one_wavefront};
pub use options::Options;
pub use petals::{PetalDraw, PetalPoint, PetalTable, petals};
pub use pulls::{PullDraw, PullRow, PullTable, pulls};
pub use pyramid::{
    FullPhaseReading, PYRAMID_ROWS, PyramidDraw, PyramidLeak, PyramidLeakRow, PyramidParts, PyramidTable, pyramid,
};
pub use report::Report;
pub use row_draw::RowDraw;
pub use samples::{Samples, SamplesPoint, samples};
pub use table_rows::{Conditions, LoopSensor, Published, ROWS, Row, Segments, VARIANTS};
pub use target::Target;

pub use crate::experiment::{Bound, Case, Cell, Draw, Progress, Pulls, Shares, Table, Trial, Way, draws, statistics};
use crate::experiment::{KeptDraw, to_cells, to_numbers};
