//! What the programs of this workspace share: pictures and HTML pages from results, the terminal,
//! signals, and the files, scenes and shares that a command line names.

pub mod allocator;
pub mod files;
pub mod html;
pub mod interrupt;
pub mod outputs;
pub mod panics;
pub mod plot;
pub mod program;
pub mod ranks;
pub mod terminal;
