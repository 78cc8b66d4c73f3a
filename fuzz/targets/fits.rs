//! A FITS file of any bytes: images, mask, tables, cards.
#![no_main]

use cophase_fuzz::probes;
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static FILE: LazyLock<probes::File> = LazyLock::new(|| probes::File::new("target"));

fuzz_target!(|bytes: &[u8]| {
    probes::fits(&FILE, bytes);
});
