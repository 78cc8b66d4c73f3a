//! One version, wherever it is written.

/// Where `changelog` or `header` name another version than `version`, that of `Cargo.toml`; one
/// sentence each.
fn disagreements(version: &str, changelog: &str, header: &str) -> Vec<String> {
    let mut found = Vec::new();
    let headings: Vec<&str> = changelog
        .lines()
        .filter_map(|line| line.strip_prefix("## [")?.split(']').next())
        .filter(|heading| *heading != "Unreleased")
        .collect();
    match headings.first() {
        Some(newest) if *newest != version => found.push(format!("CHANGELOG.md's newest release is {newest}")),
        None if !changelog.contains("## [Unreleased]") => found.push("CHANGELOG.md has no heading".into()),
        _ => {}
    }
    let numbers: Vec<&str> = version.split('.').collect();
    for line in header.lines() {
        let mut words = line.split_whitespace();
        let (Some("#define"), Some(name), Some(value)) = (words.next(), words.next(), words.next()) else { continue };
        let expected = match name {
            "COPHASE_VERSION_MAJOR" => numbers[0],
            "COPHASE_VERSION_MINOR" => numbers[1],
            "COPHASE_VERSION_PATCH" => numbers[2],
            "COPHASE_VERSION" | "COPHASE_VERSION_STRING" => version,
            _ => continue,
        };
        if value.trim_matches('"') != expected {
            found.push(format!("include/cophase.h says {name} {value}"));
        }
    }
    found
}

#[test]
fn the_version_is_the_same_everywhere() {
    let version = env!("CARGO_PKG_VERSION");
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let changelog = std::fs::read_to_string(root.join("CHANGELOG.md")).expect("CHANGELOG.md");
    let header = std::fs::read_to_string(root.join("include/cophase.h")).unwrap_or_default();
    assert_eq!(disagreements(version, &changelog, &header), [""; 0], "Cargo.toml says {version}");
}

#[test]
fn a_planted_disagreement_is_found() {
    let released = "## [Unreleased]\n## [1.2.3] - 2030-01-01\n## [1.2.2] - 2029-01-01\n";
    let header = "#define COPHASE_VERSION_MAJOR 1\n#define COPHASE_VERSION \"1.2.3\"\n";
    assert!(disagreements("1.2.3", released, header).is_empty());
    assert!(disagreements("0.1.0", "## [Unreleased]\n", "").is_empty());
    assert_eq!(disagreements("1.2.4", released, "").len(), 1);
    assert_eq!(disagreements("1.2.3", "# Changelog\n", "").len(), 1);
    assert_eq!(disagreements("2.2.3", "## [2.2.3]\n", header).len(), 2);
}
