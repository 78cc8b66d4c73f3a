//! What is made from the description of the command line: manual pages, JSON, completions.

use crate::Desk;
use serde_json::Value;

/// Names of the verbs in the JSON.
fn verbs(json: &Value) -> Vec<&str> {
    json["verbs"].as_array().unwrap().iter().map(|verb| verb["name"].as_str().unwrap()).collect()
}

#[test]
fn every_verb_has_a_page() {
    let desk = Desk::with_scene();
    desk.succeeds(&["manual", "man"]);
    let json = desk.json(&["manual", "--json"]);
    let help = desk.succeeds(&["--help"]).out;
    let mut expected = vec!["cophase.1".to_string()];
    for verb in verbs(&json) {
        assert!(help.contains(&format!("\n  {verb} ")), "{verb} is not in: {help}");
        expected.push(format!("cophase-{verb}.1"));
    }
    expected.sort();
    let pages = std::fs::read_dir(desk.path("man")).unwrap();
    let mut pages: Vec<String> = pages.map(|page| page.unwrap().file_name().into_string().unwrap()).collect();
    pages.sort();
    assert_eq!(pages, expected);
    let page = std::fs::read_to_string(desk.path("man/cophase-estimate.1")).unwrap();
    assert!(page.contains(".TH cophase-estimate 1") && page.contains("budget\\-nm"), "{page}");
}

#[test]
fn every_option_is_described() {
    let desk = Desk::with_scene();
    let json = desk.json(&["manual", "--json"]);
    for verb in json["verbs"].as_array().unwrap() {
        let name = verb["name"].as_str().unwrap();
        let help = desk.succeeds(&[name, "--help"]).out;
        for argument in verb["arguments"].as_array().unwrap() {
            assert!(!argument["help"].as_str().unwrap().is_empty(), "{name}: {argument}");
            if let Some(long) = argument["long"].as_str() {
                assert!(help.contains(long), "{name}: {long} is not in: {help}");
            }
        }
    }
}

#[test]
fn command_lines_are_tried_without_running_them() {
    let desk = Desk::with_scene();
    let accepts = |words: &[&str]| desk.run(&[&["manual", "--accepts", "--"], words].concat());
    let before = desk.files();
    for words in [&["image", "scene.toml", "-o", "images.fits"][..], &["estimate", "--help"], &["--version"]] {
        let done = accepts(words);
        assert_eq!((done.status, done.out.as_str(), done.err.as_str()), (0, "", ""), "{words:?}");
    }
    for (words, reason) in [(&["image", "scene.toml"][..], "--output"), (&["imagine"], "imagine")] {
        let done = accepts(words);
        assert!(done.status == 2 && done.err.contains(reason), "{words:?}: {}", done.err);
    }
    assert_eq!(desk.files(), before);
    assert_eq!(desk.run(&["manual"]).status, 2);
}

#[test]
fn completions_name_verbs_and_options() {
    let desk = Desk::with_scene();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = desk.succeeds(&["completions", shell]).out;
        assert!(script.contains("poke-nm") && script.contains("budget-nm"), "{shell}: {script}");
    }
}
