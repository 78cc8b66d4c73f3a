//! The pictures, drawn and read back.

mod numbering;
mod plot;
mod ticks;
