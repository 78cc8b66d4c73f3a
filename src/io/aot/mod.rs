//! AOT, the telemetry standard of adaptive optics (Gomes et al. 2024, A&A 686, A7), as FITS.
//!
//! A file has the card `AOT-VERS`, a binary table for each kind of component (telescopes,
//! detectors, wavefront sensors, loops, …), and images in extensions of their own. A cell of a
//! table refers to an image by `INTREF<EXTNAME>` and to a row of another table by `ROWREF<UID>`; an
//! empty cell, and NaN in a column of numbers, is a value that is not known. The layout is that of
//! the standard's reference implementation, the Python package aotpy 3.2.1
//! (`aotpy/io/fits/_file.py`), version 2.0.0 of the format; version 1.0.0 differs in columns that
//! are not read here.
//!
//! * [`AotTables`] composes the tables of a file.
//! * [`read_images`](super::read_images) and [`read_channels`](super::read_channels) read the
//!   images of the scoring cameras, [`slopes()`] the slopes that belong to them, [`commands_nm`]
//!   the commands, [`system()`] telescope, turbulence and loop, [`configuration()`] the free text
//!   of the header.
//!
//! Units. The standard fixes that of most quantities: m, s, rad, Hz. It leaves slopes to the author
//! ("user defined units") with the card `BUNIT` of their image. Slopes in `mas`, or without a unit,
//! are read as they are, so that their bits stay; `rad`, `arcsec` and `pix` (with the pixel scale
//! of the sensor's detector) are converted to mas.

mod cameras;
mod configuration;
mod layout;
mod read;
mod slopes;
mod system;
mod version;
mod write;

pub(crate) use cameras::cameras;
pub use configuration::{configuration, configuration_card};
pub use slopes::{MatchedSlopes, commands_nm, slopes};
pub use system::{AotControl, AotImage, AotMirror, AotSensor, AotSystem, AotTelescope, AotTurbulence, system};
pub use version::{TIME_REFERENCE, is_aot};
pub use write::{AotTables, Cell, image_reference, row_reference};
