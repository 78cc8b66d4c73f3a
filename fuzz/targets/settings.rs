//! What follows `--set`, `--device` and `--precision` on the command line, a line each.
#![no_main]

use cophase_fuzz::probes;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    probes::settings(text);
});
