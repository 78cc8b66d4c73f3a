//! FITS input and output, text tables.
//!
//! * [`read_images`] reads the file of a camera: images, bad pixels, read noise. [`FitsReader`]
//!   reads other content by name: maps, cubes, columns, cards. Reading never changes the file.
//! * Files of AOT, the telemetry standard of adaptive optics, are read by the same functions:
//!   [`aot`].
//! * [`FitsWriter`] composes a file in memory, which appears at its path complete or not at all.
//!
//! Arrays are `[.., y, x]` in C order; in the file x is NAXIS1. Names of HDUs and columns are
//! compared without case.
//!
//! # Files that are not standard FITS
//!
//! Tile-compressed images (`.fz`) are read as the plain ones: `tiles`.
//!
//! `layout` reads the headers before cfitsio does and compares every size with the length of the
//! file; `repair` converts cards to the standard's form in a copy in memory, and one sentence
//! reports the repairs. A file that cannot be repaired is rejected with the byte and the reason.

pub mod aot;
mod band;
mod card;
mod card_unit;
mod cfitsio;
mod characters;
mod column;
mod columns;
mod extension;
mod header;
mod image_hdu;
mod images;
mod layout;
mod mask;
mod mosaic;
mod packed;
mod read;
mod regular;
mod repair;
mod standard;
mod text_table;
mod tiles;
mod value;
mod write;

pub use crate::atomic::{abandon as abandon_files, abandon_with, write as write_atomically};
pub use column::Column;
pub use extension::{file_of, is_fits};
pub use header::{AVERAGED_COADDS, COADD_TIMES, HeaderFact, PixelUnit, Quantity, READ_NOISE_OF_A_COADD};
pub use image_hdu::{CHANNEL, HduImages};
pub use images::{read_channels, read_images};
pub use mask::{MOST_MARKED, read_mask};
pub use read::{FitsReader, read_cube, read_map};
pub use text_table::{TextRow, TextTable, read_text};
pub use value::Card;
pub use write::{ELECTRON, FitsWriter, Pixel};
