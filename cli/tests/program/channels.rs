//! Scenes with channels: images with several HDUs, a file for each channel, what is refused.

use crate::Desk;
use cophase::io::{ELECTRON, FitsReader, FitsWriter, Pixel, read_channels};

/// A pair of defocuses, before the section of the aberrations.
pub const PAIR: &str = "
[[image.channel]]
name = \"plus\"
diversity_focus_waves_rms = 1.0

[[image.channel]]
name = \"minus\"
diversity_focus_waves_rms = -1.0

[aberrations]";

/// A desk with the scene `scene.toml` of a pair, and its images `pair.fits`.
fn desk() -> Desk {
    let desk = Desk::with_scene();
    let text = std::fs::read_to_string(desk.path("scene.toml")).unwrap().replacen("[aberrations]", PAIR, 1);
    std::fs::write(desk.path("scene.toml"), text).unwrap();
    let made = desk.json(&["image", "scene.toml", "-o", "pair.fits", "--json"]);
    assert_eq!((made["images"].as_u64(), made["channels"][1].as_str()), (Some(2), Some("minus")));
    desk
}

#[test]
fn one_file_and_a_file_for_each_channel_give_one_answer() {
    let desk = desk();
    let of_one = desk.json(&["estimate", "pair.fits", "-o", "est.fits", "--json"]);
    assert_eq!((of_one["images"].as_u64(), of_one["status"].as_str()), (Some(2), Some("ok")), "{of_one}");
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    assert_eq!(file.text_column("IMAGES", "CHANNEL").unwrap(), ["plus", "minus"]);
    for (images, name) in read_channels(desk.path("pair.fits"), None).unwrap().into_iter().zip(["a.fits", "b.fits"]) {
        let mut file = FitsWriter::create(desk.path(name)).unwrap();
        file.image("IMAGES", &images.data, Pixel::F32, ELECTRON).unwrap();
        file.finish().unwrap();
    }
    // The truth is in the file with both, and so are its residuals.
    let keys = ["phasing_rms_nm", "ncpa_rms_nm", "phasing_sigma_nm", "ncpa_sigma_nm", "reduced_chi2"];
    for channels in [["plus=a.fits", "minus=b.fits"], ["minus=b.fits", "plus=a.fits"]] {
        let each = channels.iter().flat_map(|channel| ["--channel", channel]);
        let arguments: Vec<&str> = ["estimate"].into_iter().chain(each).collect();
        let found = desk.json(&[&arguments[..], &["--scene", "scene.toml", "-o", "both.fits", "--json"]].concat());
        assert!(keys.iter().all(|key| found[key] == of_one[key]), "{found} {of_one}");
    }
}

#[test]
fn a_file_of_several_channels_is_named_where_one_is_taken() {
    let desk = desk();
    let facts = ["pair.fits", "2 channels", "FILE[HDU]"];
    desk.refuses(&["check", "pair.fits", "--scene", "keck-artificial"], &facts);
    let channels = ["--channel", "plus=pair.fits", "--channel", "minus=pair.fits"];
    desk.refuses(&[&["estimate", "--scene", "scene.toml", "-o", "e.fits"][..], &channels].concat(), &facts);
}

#[test]
fn the_picture_shows_the_image_of_each_channel() {
    let desk = desk();
    desk.succeeds(&["estimate", "pair.fits", "-o", "est.fits", "--plot", "est.svg"]);
    let text = std::fs::read_to_string(desk.path("est.svg")).unwrap();
    for panel in ["Image", "Model", "Image − model"] {
        for channel in ["plus", "minus"] {
            assert!(text.lines().any(|line| line == format!("{panel}, {channel}")), "{panel} of {channel}");
        }
    }
}

#[test]
fn channels_that_do_not_belong_to_the_scene_are_refused() {
    let desk = desk();
    let estimate = |more: &[&'static str]| [&["estimate", "-o", "est.fits", "--scene", "scene.toml"], more].concat();
    desk.refuses(&estimate(&["pair.fits[IMAGES]"]), &["images of 1 channel,", "plus, minus"]);
    let both = ["--channel", "plus=pair.fits[1]", "--channel", "blue=pair.fits[2]"];
    desk.refuses(&estimate(&both), &["no images", "'minus'", "those of plus, blue"]);
    let usage = desk.run(&["estimate", "--channel", "plus", "-o", "est.fits"]);
    assert_eq!(usage.status, 2, "{}", usage.err);
    assert!(usage.err.contains("such as plus=a.fits"), "{}", usage.err);
}

#[test]
#[ignore = "merge: 15 s"]
fn channels_behind_adaptive_optics_are_simulated_and_estimated() {
    let desk = desk();
    let text = include_str!("../../../tests/c_api/small.toml").replacen("[aberrations]", PAIR, 1);
    std::fs::write(desk.path("loop.toml"), text).unwrap();
    let run = ["simulate", "loop.toml", "-o", "sky.fits"];
    let set = [
        "minus.count=2",
        "minus.rows=44",
        "plus.diversity_focus_waves_rms=0.7",
        "minus.diversity_focus_waves_rms=-0.7",
    ];
    let set = set.map(|setting| format!("image.channel.{setting}"));
    let more: Vec<&str> = set.iter().flat_map(|setting| ["--set", setting]).collect();
    let made = desk.json(&[&run[..], &more, &["--json"]].concat());
    assert_eq!((&made["channels"], &made["channel_images"]), (&["plus", "minus"].into(), &[1, 2].into()));
    // 0.02 s settling, two intervals of 0.01 s, one frame at 1054 Hz.
    assert_eq!((&made["images"], &made["frames"]), (&3.into(), &43.into()));
    let shown = desk.succeeds(&[&run[..], &more].concat()).out;
    let facts = ["3 images in 2 channels", "plus: 1 of 48x40", "minus: 2 of 48x44"];
    assert!(facts.iter().all(|fact| shown.contains(fact)), "{shown}");
    let found = desk.json(&["estimate", "sky.fits", "-o", "est.fits", "--plot", "est.svg", "--json"]);
    assert_eq!(found["images"], 3);
    let both = [&run[..], &more, &["--set", "image.simultaneous=true"]].concat();
    desk.refuses(&both, &["'minus' has image.count = 2", "'plus' 1"]);
}
