//! A folder of frames when all is well, and files that are not what they should be.

use super::*;
use cophase::io::FitsReader;

#[test]
fn watch_takes_each_file_once_and_agrees_with_an_estimate() {
    let desk = desk_with_frames(3);
    (0..2).for_each(|number| put(&desk, number));
    let done = once(&desk);
    assert!(
        done.out.contains("000.fits: phasing ") && done.out.contains("2 frames with an estimate, 0 refused"),
        "{}",
        done.out
    );
    let first = rows(&desk.path("night.db"));
    assert_eq!(
        first.iter().map(|row| (row.name.as_str(), row.status.as_str())).collect::<Vec<_>>(),
        [("000.fits", "done"), ("001.fits", "done")]
    );
    // The same file, the same content under another name, and a new one.
    std::fs::copy(made(&desk, 0), desk.path("frames/copy.fits")).unwrap();
    put(&desk, 2);
    once(&desk);
    once(&desk);
    let second = rows(&desk.path("night.db"));
    assert_eq!(second.len(), 3, "{second:?}");
    assert_eq!(second[..2], first[..]);
    // A session makes the fit that the library's session makes: the modes of the scene, of the same
    // image.
    let scene = cophase::scene::Scene::from_file(desk.path("scene.toml")).unwrap();
    let fitter = std::sync::Arc::new(cophase::modal::ModalFitter::new(&scene, false).unwrap());
    let pointing = fitter.pointing().unwrap();
    let mut session = cophase::modal::Session::new(fitter, &Default::default()).unwrap();
    let image = FitsReader::open(made(&desk, 1)).unwrap().cube("IMAGES").unwrap();
    session.frame_mut(0, 0).unwrap().0.assign(&image.index_axis(ndarray::Axis(0), 0));
    session.frame_mut(0, 0).unwrap().1.fill(false);
    let options = cophase::modal::FitOptions { read_noise_e: Some(20.0), ..Default::default() };
    session.fit(1, &options).unwrap();
    // Without the pointing, which is tip and tilt alone.
    let fitted_nm = &session.results()[0].coefficients_nm;
    let wavefront_nm = pointing.removed_from(fitted_nm);
    assert_eq!(wavefront_nm.iter().zip(fitted_nm).filter(|(left, fitted)| left != fitted).count(), 2);
    let bytes: Vec<u8> = wavefront_nm.iter().flat_map(|nm| nm.to_le_bytes()).collect();
    assert_eq!(second[1].coefficients.as_ref(), Some(&bytes));
}

#[test]
fn the_images_of_a_cube_are_frames_and_a_full_estimate_is_one() {
    let desk = Desk::with_images(&["image.count=3"]);
    std::fs::create_dir(desk.path("frames")).unwrap();
    std::fs::copy(desk.path("images.fits"), desk.path("frames/cube.fits")).unwrap();
    once(&desk);
    let found = rows(&desk.path("night.db"));
    assert_eq!(found.iter().map(|row| row.image).collect::<Vec<_>>(), [0, 1, 2]);
    assert!(found.iter().all(|row| row.status == "done"));
    let full = [&WATCH[..], &["--once", "--policy", "full"]].concat();
    desk.run(&full).failed(&full, &["night.db", "--policy realtime, not full", "--state"]);
    let full = full.iter().map(|word| if *word == "night.db" { "full.db" } else { word }).collect::<Vec<_>>();
    desk.succeeds(&full);
    let found = rows(&desk.path("full.db"));
    assert_eq!((found.len(), found[0].status.as_str()), (1, "done"), "{found:?}");
    // Of the modes of the scene, without those that the pipeline adds: 6 or 7 pistons and 14
    // Zernikes.
    let modes = |row: &Row| row.coefficients.as_ref().unwrap().len() / 8;
    assert_eq!(modes(&found[0]), modes(&rows(&desk.path("night.db"))[0]));
}

/// A pair of defocuses, before the section of the aberrations.
const PAIR: &str = "
[[image.channel]]
name = \"plus\"

[[image.channel]]
name = \"minus\"
diversity_focus_waves_rms = -1.0

[aberrations]";

#[test]
fn an_image_of_each_channel_is_one_frame() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("scene.toml"), SMALL.replacen("[aberrations]", PAIR, 1)).unwrap();
    std::fs::create_dir(desk.path("frames")).unwrap();
    desk.succeeds(&["image", "scene.toml", "-o", "frames/pairs.fits", "--set", "image.count=2"]);
    // With another defocus than the scene's, and of one channel.
    let other = ["image", "scene.toml", "-o", "frames/other.fits", "--set"];
    desk.succeeds(&[&other[..], &["image.channel.minus.diversity_focus_waves_rms=-0.9"]].concat());
    let single = SMALL.replacen("[image]", "[image]\ncount = 1", 1);
    std::fs::write(desk.path("single.toml"), single).unwrap();
    desk.succeeds(&["image", "single.toml", "-o", "frames/single.fits"]);
    desk.succeeds(&[&WATCH[..], &["--once", "--trust", "scene"]].concat());
    let found = rows(&desk.path("night.db"));
    let each: Vec<_> = found.iter().map(|row| (row.name.as_str(), row.image, row.status.as_str())).collect();
    let pairs = [("pairs.fits", 0, "done"), ("pairs.fits", 1, "done")];
    assert_eq!(each, [&[("other.fits", 0, "refused")], &pairs[..], &[("single.fits", 0, "refused")]].concat());
    assert!(found[0].reason.contains("channel"), "{}", found[0].reason);
    assert!(found[3].reason.contains("1 channel, where the scene has 2 (plus, minus)"), "{}", found[3].reason);
    // The joint fit of a session, at the wavefront that it finds, without the pointing.
    let scene = cophase::scene::Scene::from_file(desk.path("scene.toml")).unwrap();
    let fitters = cophase::modal::ChannelFitters::new(&scene, false).unwrap();
    let pointing = fitters.first().pointing().unwrap();
    let mut session = cophase::modal::Session::new(fitters, &Default::default()).unwrap();
    let images = cophase::pipeline::Images::read(desk.path("frames/pairs.fits"), None).unwrap();
    for (channel, images) in images.iter().enumerate() {
        let (mut electrons, mut bad) = session.frame_mut(0, channel).unwrap();
        electrons.assign(&images.images_e.index_axis(ndarray::Axis(0), 1));
        bad.fill(false);
    }
    session.fit(1, &Default::default()).unwrap();
    let wavefront_nm = pointing.removed_from(&session.refine(0).unwrap().modes.coefficients_nm);
    let bytes: Vec<u8> = wavefront_nm.iter().flat_map(|nm| nm.to_le_bytes()).collect();
    assert_eq!(found[2].coefficients.as_ref(), Some(&bytes));
    // What a session does not fit together, and what has one channel.
    let all = [&WATCH[..], &["--once", "--set", "estimate.group=\"all\""]].concat();
    desk.refuses(&all, &["estimate.group = \"all\"", "--policy full"]);
    desk.refuses(
        &["watch", "--stream", "cam", "--scene", "scene.toml", "--state", "stream.db"],
        &["stream 'cam'", "one channel", "2"],
    );
    // Four images, one estimate: of the contradictory ones none.
    let full = [
        "watch",
        "frames",
        "--scene",
        "scene.toml",
        "--state",
        "full.db",
        "--once",
        "--policy",
        "full",
        "--trust",
        "scene",
    ];
    desk.succeeds(&[&full[..], &["--set", "estimate.group=\"all\""]].concat());
    let full = rows(&desk.path("full.db"));
    let each: Vec<_> = full.iter().map(|row| (row.name.as_str(), row.status.as_str())).collect();
    assert_eq!(each, [("other.fits", "refused"), ("pairs.fits", "done"), ("single.fits", "refused")]);
    assert!(full[0].reason.contains("contradictory"), "{}", full[0].reason);
}

#[test]
fn frames_that_appear_are_taken_under_their_last_name() {
    let desk = desk_with_frames(3);
    let mut watch = Running::start(&desk, &["--poll-seconds", "600"]);
    let watched = desk.path("night.db");
    put(&desk, 0);
    wait_for_rows(&desk, 1);
    // The way of many cameras: a temporary name, then a rename.
    std::fs::copy(made(&desk, 1), desk.path("frames/001.fits.tmp")).unwrap();
    std::fs::rename(desk.path("frames/001.fits.tmp"), desk.path("frames/001.fits")).unwrap();
    wait_for_rows(&desk, 2);
    // A file that was taken and gets another name is no new frame, and the frame follows it.
    std::fs::rename(desk.path("frames/000.fits"), desk.path("frames/archive-000.fits")).unwrap();
    wait_until("the new name", || rows(&watched).iter().any(|row| row.name == "archive-000.fits"));
    put(&desk, 2);
    wait_for_rows(&desk, 3);
    assert_eq!(watch.stop(), Some(0));
    let names: Vec<String> = rows(&watched).into_iter().map(|row| row.name).collect();
    assert_eq!(names, ["001.fits", "002.fits", "archive-000.fits"]);
    // One file is left of the store, and its lock.
    assert!(!desk.files().iter().any(|name| name.ends_with("-wal") || name.ends_with("-shm")), "{:?}", desk.files());
}

#[test]
fn a_file_that_is_written_slowly_is_waited_for() {
    use std::io::Write;
    let desk = desk_with_frames(1);
    let mut watch = Running::start(&desk, &["--settle-seconds", "60"]);
    let bytes = std::fs::read(made(&desk, 0)).unwrap();
    let mut file = std::fs::File::create(desk.path("frames/slow.fits")).unwrap();
    let pieces: Vec<&[u8]> = bytes.chunks(bytes.len() / 5 + 1).collect();
    for piece in &pieces {
        assert_eq!(rows_or_none(&desk), 0);
        file.write_all(piece).unwrap();
        file.flush().unwrap();
        // Longer than the watch takes for a look; that it is shorter on a busy machine makes the
        // test easier, not wrong.
        std::thread::sleep(Duration::from_millis(300));
    }
    drop(file);
    wait_for_rows(&desk, 1);
    watch.stop();
    let found = rows(&desk.path("night.db"));
    assert_eq!((found.len(), found[0].status.as_str()), (1, "done"), "{found:?}");
}

fn rows_or_none(desk: &Desk) -> usize {
    let connection = rusqlite::Connection::open(desk.path("night.db")).unwrap();
    connection.query_row("SELECT count(*) FROM frames", [], |row| row.get::<_, i64>(0)).unwrap_or(0) as usize
}

#[test]
fn invalid_frames_are_refused_once_with_the_reason() {
    let desk = desk_with_frames(2);
    let whole = std::fs::read(made(&desk, 0)).unwrap();
    std::fs::write(desk.path("frames/half.fits"), &whole[..whole.len() / 2]).unwrap();
    std::fs::write(desk.path("frames/empty.fits"), "").unwrap();
    std::fs::write(desk.path("frames/text.fits"), "no FITS file\n").unwrap();
    std::fs::write(desk.path("frames/notes.txt"), "left alone").unwrap();
    write_frame(&desk.path("frames/size.fits"), 48, 100.0);
    write_frame(&desk.path("frames/constant.fits"), 64, 100.0);
    desk.edit_images("made/000.fits", "frames/saturated.fits", |images| {
        let top = images.iter().copied().fold(0.0, f64::max) / 4.0;
        images.mapv_inplace(|electrons| electrons.min(top));
    });
    put(&desk, 1);
    let done = once(&desk);
    let found = rows(&desk.path("night.db"));
    let reasons = [
        ("001.fits", ""),
        ("constant.fits", "is constant"),
        ("empty.fits", "empty"),
        ("half.fits", "byte"),
        ("saturated.fits", "saturated"),
        ("size.fits", "48x48 pixels"),
        ("text.fits", "FITS"),
    ];
    assert_eq!(found.len(), reasons.len(), "{found:?}");
    for (row, (name, reason)) in found.iter().zip(reasons) {
        assert_eq!(row.name, name);
        assert_eq!(row.status, if reason.is_empty() { "done" } else { "refused" }, "{row:?}");
        assert!(row.reason.contains(reason) && !row.reason.contains(&row.name), "{row:?}");
    }
    assert_eq!(done.err.lines().filter(|line| line.contains("refused: ")).count(), 6, "{}", done.err);
    // Not tried again, until one changes.
    assert!(!once(&desk).err.contains("refused"));
    std::fs::write(desk.path("frames/half.fits"), &whole).unwrap();
    once(&desk);
    let again = rows(&desk.path("night.db"));
    assert_eq!(again.len(), 8);
    assert_eq!(
        again.iter().filter(|row| row.name == "half.fits").map(|row| row.status.as_str()).collect::<Vec<_>>(),
        ["refused", "done"]
    );
}

#[test]
fn a_log_has_a_line_of_json_for_each_frame() {
    let desk = desk_with_frames(2);
    put(&desk, 0);
    std::fs::write(desk.path("frames/text.fits"), "no FITS file\n").unwrap();
    desk.succeeds(&[&WATCH[..], &["--once", "--log", "log.jsonl"]].concat());
    let text = std::fs::read_to_string(desk.path("log.jsonl")).unwrap();
    let lines: Vec<serde_json::Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let mut kinds: Vec<&str> = lines.iter().map(|line| line["what"].as_str().unwrap()).collect();
    kinds.sort_unstable();
    assert_eq!(kinds, ["frame", "refused", "undated", "watch"]);
    let frame = lines.iter().find(|line| line["what"] == "frame").unwrap();
    assert!(
        frame["phasing_rms_nm"].as_f64().unwrap() > 0.0 && frame["time"].as_str().unwrap().ends_with('Z'),
        "{frame}"
    );
}
