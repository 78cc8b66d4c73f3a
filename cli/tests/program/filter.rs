//! A filter from a file that the scene names relative to itself.

use crate::Desk;

const KEYS: [&str; 4] = ["--set", "image.filter_file=filters/k.txt", "--set", "image.star_temperature_k=4000"];

#[test]
fn a_filter_file_beside_the_scene_is_found_from_any_folder() {
    let desk = Desk::with_scene();
    std::fs::create_dir(desk.path("filters")).unwrap();
    let table = desk.path("filters/k.txt");
    std::fs::write(&table, "# nm\n1900 0.2\n1950 0.9\n2050 1.0\n2150 0.1\n").unwrap();
    let scene = std::fs::read_to_string(desk.path("scene.toml")).unwrap();
    let keys = "[image]\nfilter_file = \"filters/k.txt\"\nstar_temperature_k = 4000";
    std::fs::write(desk.path("filtered.toml"), scene.replace("[image]", keys)).unwrap();
    std::fs::create_dir(desk.path("elsewhere")).unwrap();
    desk.succeeds(&["image", "filtered.toml", "-o", "elsewhere/images.fits"]);
    // The scene in the images has the full name of the table, which is not beside them.
    let own = ["estimate", "elsewhere/images.fits", "-o", "est.fits", "--json", "--foreign-files"];
    desk.refuses(&own[..4], &["k.txt", "image.filter_file", "--foreign-files"]);
    let found = desk.json(&own);
    assert_eq!(found["status"], "ok", "{found}");
    let again = ["estimate", "elsewhere/images.fits", "--scene", "filtered.toml", "-o", "again.fits", "--json"];
    assert_eq!(desk.json(&again)["reduced_chi2"], found["reduced_chi2"]);
    desk.succeeds(&[&["image", "scene.toml", "-o", "images.fits"], &KEYS[..]].concat());
    desk.refuses(&["image", "filtered.toml", "-o", "filters/k.txt"], &["filters/k.txt"]);
    std::fs::write(&table, "19000 1\n21500 1\n").unwrap();
    let outside = ["k.txt", "image.wavelength_nm = 2000 ", "19000 to 21500 nm", "10 Å are 1 nm"];
    desk.refuses(&["image", "filtered.toml", "-o", "other.fits"], &outside);
    desk.refuses(&again[..6], &outside);
    std::fs::remove_file(&table).unwrap();
    let missing = ["k.txt", "image.filter_file"];
    desk.refuses(&["image", "filtered.toml", "-o", "other.fits"], &missing);
    desk.refuses(&["estimate", "elsewhere/images.fits", "-o", "other.fits", "--foreign-files"], &missing);
}

#[test]
fn the_filter_file_of_one_channel_is_not_that_of_the_others() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("k.txt"), "1900 0.2\n1950 0.9\n2050 1.0\n2150 0.1\n").unwrap();
    let channels = "
[[image.channel]]
name = \"one\"

[[image.channel]]
name = \"broad\"
filter_file = \"k.txt\"
diversity_focus_waves_rms = -1.0

[aberrations]";
    let scene = std::fs::read_to_string(desk.path("scene.toml")).unwrap();
    std::fs::write(desk.path("pair.toml"), scene.replace("[aberrations]", channels)).unwrap();
    desk.succeeds(&["image", "pair.toml", "-o", "images.fits"]);
    let text = cophase::pipeline::embedded_scene(&desk.path("images.fits"), |_| false).unwrap().unwrap();
    let files: Vec<bool> = text.channels().iter().map(|channel| channel.scene.image.filter_file.is_some()).collect();
    assert_eq!(files, [false, true]);
    let found = desk.json(&["estimate", "images.fits", "-o", "est.fits", "--json"]);
    assert_eq!(found["status"], "ok", "{found}");
}
