//! Tests of the library through its public API, in one program: linking is most of what a test
//! program costs.

#[path = "../common/mod.rs"]
mod common;

mod aot;
mod channels;
mod checksums;
mod commands;
mod consistency;
mod detectors;
mod diversity_map;
mod filter;
mod fits;
mod full_phase;
mod fuzz;
mod golden;
mod group_sequences;
mod groups;
mod left_out;
mod measured_loop;
mod measured_mirror;
mod modal;
mod model_selection;
mod modes;
mod moved_reference;
mod night;
mod night_channels;
mod observation;
mod one_wavefront;
mod optical_gains;
mod orientation;
mod petals;
mod planner;
mod progress;
mod pupil;
mod pupil_maps;
mod pupil_turns;
mod scene;
mod scene_files;
mod session_channels;
mod telemetry;
mod tracking;
