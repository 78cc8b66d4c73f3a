//! The C libraries that cargo builds along with the tests.

use std::path::PathBuf;

/// Their folder: cargo puts them where the test programs are, among their dependencies.
pub fn libraries() -> PathBuf {
    let test = std::env::current_exe().expect("the path of this test program");
    test.parent().expect("a program lies in a folder").into()
}
