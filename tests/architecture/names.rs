//! Length of test names: at most 60 characters, so that a line of the test report names the failure and fits.

use super::texts;

const LIMIT: usize = 60;
const FOLDERS: [&str; 7] = ["src", "tests", "numerics", "cli", "view", "watch", "paper"];

/// Names of the `#[test]` functions in `text` that are longer than `LIMIT`.
fn long_names(text: &str) -> Vec<&str> {
    let mut long = Vec::new();
    let mut lines = text.lines().map(str::trim);
    while lines.any(|line| line == "#[test]") {
        // Other attributes may stand between `#[test]` and its function.
        let name = lines.find_map(|line| line.strip_prefix("fn ")?.split('(').next());
        long.extend(name.filter(|name| name.len() > LIMIT));
    }
    long
}

#[test]
fn test_names_are_short() {
    let mut long = Vec::new();
    for folder in FOLDERS {
        for (file, text) in texts(folder) {
            long.extend(long_names(&text).into_iter().map(|name| format!("{folder}/{file}.rs: {name}")));
        }
    }
    assert!(long.is_empty(), "test names of more than {LIMIT} characters:\n{}\n", long.join("\n"));
}

#[test]
fn planted_long_test_name_is_found() {
    let (short, long) = ("a".repeat(LIMIT), "a".repeat(LIMIT + 1));
    let text =
        format!("fn {long}() {{}}\n#[test]\nfn {short}() {{}}\n    #[test]\n    #[ignore]\n    fn {long}() {{}}\n");
    assert_eq!(long_names(&text), [long.as_str()]);
}
