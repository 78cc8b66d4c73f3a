//! Arrays across the C boundary: their description, their memory, and how they are fitted.
#![no_main]

use cophase_fuzz::frames::Session;
use libfuzzer_sys::fuzz_target;

thread_local! {
    static SESSION: Session = Session::new();
}

fuzz_target!(|bytes: &[u8]| {
    SESSION.with(|session| session.probe(bytes));
});
