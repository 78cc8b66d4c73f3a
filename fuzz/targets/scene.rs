//! The text of a scene.
#![no_main]

use cophase_fuzz::probes;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    probes::scene(text);
});
