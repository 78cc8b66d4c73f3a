//! `cophase reduce`: raw frames made from simulated images, with all that a detector and a sky add,
//! become the images again.

use crate::channels::PAIR;
use crate::raw_frames::{
    COADDS, DITHERS, GAIN, NOISE_E, Noise, RAW, SIDE, SKY_E, dark, desk, desk_with, response, sky, star, write,
    write_cube,
};
use crate::{Desk, number};
use cophase::io::{Card, FitsReader, FitsWriter, Pixel, read_channels};
use cophase::pipeline::embedded_scene;
use ndarray::{Array2, Array3, Axis, s, stack};

/// The row of a file in the log.
fn reason(json: &serde_json::Value, file: &str) -> (bool, String) {
    let rows = json["frames"].as_array().unwrap();
    let row = rows.iter().find(|row| row["file"] == file).unwrap_or_else(|| panic!("{file} is not in {json}"));
    (row["used"].as_bool().unwrap(), row["reason"].as_str().unwrap().to_owned())
}

#[test]
fn raw_frames_become_the_images_again() {
    let desk = desk();
    let (perfect, _) = desk.estimates_well("images.fits", &[]);
    let residuals = desk.residuals("est.fits", "images.fits");
    let reduce = [&["reduce", "raw", "--scene", "scene.toml", "-o", "reduced.fits", "--json"], &RAW[..]].concat();
    let made = desk.json(&reduce);
    assert_eq!(made["images"], 5, "{made}");
    assert_eq!(made["warnings"].as_array().unwrap().len(), 0, "{made}");
    // The dead and the five hot pixels; of 40,000 normal ones none is bad by chance.
    assert_eq!(made["bad_pixels"], 6, "{made}");
    for (place, (y, x)) in DITHERS.into_iter().enumerate() {
        let row = &made["frames"]
            .as_array()
            .unwrap()
            .iter()
            .find(|row| row["file"] == format!("n{place:04}.fits"))
            .unwrap()
            .clone();
        // The centroid of a spot that aberrations deform is a few pixels from the axis.
        assert!((number(row, "x") - x as f64).hypot(number(row, "y") - y as f64) < 4.0, "{row}");
        // Background: the sky's, as far as a median of 36,000 pixels of 20 e each knows it, and the
        // star's halo.
        assert!((number(row, "background_e") - SKY_E).abs() < 3.0, "{row}");
    }
    // Reads of the frame and of four others (v(4) = 0.298, at corners v(3)), with the photons of
    // their sky.
    let noise_e = number(&made["channels"][0], "noise_e");
    let expected = ((NOISE_E * NOISE_E + SKY_E) * (1.0 + 0.298)).sqrt();
    assert!((noise_e / expected - 1.0).abs() < 0.03, "{noise_e} e where {expected} e is expected");

    // The scene in the file, and that of the raw frames, whose read noise of a coadd is no
    // contradiction to the noise of the images.
    let text = crate::SMALL.replace("read_noise_e = 20", "read_noise_e = 14.142");
    std::fs::write(desk.path("raw.toml"), text).unwrap();
    for options in [&[][..], &["--scene", "raw.toml"]] {
        let arguments =
            [&["estimate", "reduced.fits", "-o", "reduced-est.fits", "--json", "--strict"], options].concat();
        let done = desk.run(&arguments);
        println!("{}", done.out);
        assert_eq!(done.status, 0, "{options:?}: {}", done.err);
        let estimate: serde_json::Value = serde_json::from_str(&done.out).unwrap();
        for (at, part) in ["phasing", "ncpa"].into_iter().enumerate() {
            let key = format!("{part}_sigma_nm");
            let (sigma, bound) = (number(&estimate, &key), number(&perfect, &key));
            let residual = desk.residuals("reduced-est.fits", "images.fits")[at];
            println!("{part}: residual {residual} ({}), sigma {sigma} ({bound}), noise {noise_e}", residuals[at]);
            // The noise bound of perfect images, and 20 % for the noise of the sky.
            assert!(sigma < 1.2 * bound, "{part}: {sigma} nm, {bound} nm of perfect images");
            assert!(
                residual < 1.2 * residuals[at].max(bound),
                "{part}: {residual} nm, {} nm of perfect images",
                residuals[at]
            );
        }
    }
}

#[test]
fn darks_give_the_noise_where_the_stated_one_is_another() {
    let desk = desk();
    // A tenth of the true read noise: what is missing could be that of a dark current.
    let options = ["--set", "image.read_noise_e=1.4", "--set", "image.saturation_adu=9000"];
    let made = desk
        .json(&[&["reduce", "raw", "--scene", "scene.toml", "-o", "reduced.fits", "--json"], &options[..]].concat());
    let noise_e = number(&made["channels"][0], "noise_e");
    let expected = ((NOISE_E * NOISE_E + SKY_E) * (1.0 + 0.298)).sqrt();
    assert!((noise_e / expected - 1.0).abs() < 0.03, "{noise_e} e where {expected} e is expected");
    let warnings = made["warnings"].to_string();
    assert!(warnings.contains("14.") && warnings.contains("stated as 1.4"), "{warnings}");
}

#[test]
fn frames_of_another_exposure_are_rejected_as_an_estimate_does() {
    let desk = desk();
    let reduce =
        ["reduce", "raw", "--scene", "scene.toml", "-o", "reduced.fits", "--set", "estimate.method=full-phase"];
    let other = ["--set", "image.exposure_s=3"];
    // A key on the command line holds against a card.
    desk.succeeds(&[&reduce[..], &RAW, &other].concat());
    let text = crate::SMALL.replace("[image]", "[image]\nexposure_s = 3");
    std::fs::write(desk.path("scene.toml"), text).unwrap();
    desk.refuses(&[&reduce[..], &RAW].concat(), &["n0000.fits", "card ITIME = 0.5", "image.exposure_s = 3"]);
    // A modal estimate does not read it.
    desk.succeeds(&[&reduce[..6], &RAW].concat());
    desk.succeeds(&["estimate", "reduced.fits", "-o", "reduced-est.fits"]);
}

#[test]
fn a_cut_out_of_another_size_is_fitted() {
    let desk = desk();
    std::fs::write(desk.path("raw.toml"), crate::SMALL.replace("read_noise_e = 20", "read_noise_e = 14.142")).unwrap();
    desk.succeeds(&["reduce", "raw", "--scene", "raw.toml", "-o", "reduced.fits", "--pixels", "48"]);
    let estimate = ["estimate", "reduced.fits", "-o", "est.fits", "--json"];
    let by_file = desk.json(&estimate);
    let by_frames = desk.json(&[&estimate[..], &["--scene", "raw.toml"]].concat());
    assert_eq!(by_file["phasing_rms_nm"], by_frames["phasing_rms_nm"]);
    let said = desk.succeeds(&["estimate", "reduced.fits", "-o", "est.fits", "--scene", "raw.toml"]).out;
    assert!(said.contains("48x48 pixels") && said.contains("64x64"), "{said}");
    desk.succeeds(&["check", "reduced.fits", "--scene", "raw.toml"]);
    let set = ["--scene", "raw.toml", "--set", "image.pixels=64"];
    let refused = desk.run(&[&estimate[..], &set].concat());
    assert!(refused.status == 1 && refused.err.contains("48x48 pixels where the scene says 64x64"), "{}", refused.err);
}

#[test]
#[ignore = "merge: 8 s"]
fn turns_of_the_pupil_come_from_a_card() {
    let turns_deg = [-3.0, -1.5, 0.0, 1.5, 3.0];
    // A parallactic angle, which runs the other way.
    let card = |number: usize| vec![("PARANG", Card::Real(40.0 - turns_deg[number]))];
    let grid = ["--set", "pupil.grid_m=4.8"];
    let desk = desk_with(&[&format!("image.pupil_turns_deg={turns_deg:?}"), "pupil.grid_m=4.8"], &card);
    let reduce =
        [&["reduce", "raw", "--scene", "scene.toml", "-o", "reduced.fits", "--json"], &RAW[..], &grid].concat();
    let made = desk.json(&reduce);
    let [warning] = made["warnings"].as_array().unwrap().as_slice() else { panic!("{made}") };
    let facts = ["PARANG", "37.00 to 43.00 degrees", "image.pupil_turn_card = \"PARANG\""];
    assert!(facts.iter().all(|fact| warning.as_str().unwrap().contains(fact)), "{warning}");
    let ruled = ["--set", "image.pupil_turn_card=-PARANG", "--set", "image.pupil_turn_zero_deg=40"];
    let made = desk.json(&[&reduce[..], &ruled].concat());
    assert_eq!(made["warnings"].as_array().unwrap().len(), 0, "{made}");
    let scene = embedded_scene(&desk.path("reduced.fits"), |_| true).unwrap().unwrap();
    assert_eq!(scene.image.pupil_turns_deg, Some(turns_deg.to_vec()));
    // With the scene of the file, and with that of the raw frames, which names the card.
    let rule = "read_noise_e = 14.142\npupil_turn_card = \"-PARANG\"\npupil_turn_zero_deg = 40";
    std::fs::write(desk.path("raw.toml"), crate::SMALL.replace("read_noise_e = 20", rule)).unwrap();
    let own = [&["--scene", "raw.toml"], &grid[..]].concat();
    for options in [&[][..], &own] {
        let estimate = [&["estimate", "reduced.fits", "-o", "est.fits", "--json", "--strict"], options].concat();
        let found = desk.json(&estimate);
        let residuals = desk.residuals("est.fits", "images.fits");
        for (part, residual) in ["phasing", "ncpa"].into_iter().zip(residuals) {
            let sigma_nm = number(&found, &format!("{part}_sigma_nm"));
            assert!(residual < 3.0 * sigma_nm, "{part}: {residual} nm at {sigma_nm} nm");
        }
    }
    let other = ["--set", "image.pupil_turn_card=ROTPOSN"];
    let refused = desk.run(&[&reduce[..], &other].concat());
    assert!(refused.status == 1 && refused.err.contains("no number ROTPOSN"), "{}", refused.err);
}

#[test]
fn coadds_that_a_camera_averages_are_summed() {
    let desk = desk();
    let reduce = ["reduce", "raw", "--scene", "scene.toml", "-o", "reduced.fits", "--json"];
    let summed = number(&desk.json(&[&reduce[..], &RAW].concat())["channels"][0], "noise_e");
    let files: Vec<_> = std::fs::read_dir(desk.path("raw")).unwrap().map(|entry| entry.unwrap().path()).collect();
    let rewrite = |path: &std::path::Path, edit: &dyn Fn(f64) -> f64| {
        let mut file = FitsReader::open(path).unwrap();
        let counts = file.map(Some("RAW")).unwrap().mapv(edit);
        let keys = ["ITIME", "COADDS", "GAIN", "OBJECT", "SHRNAME", "KOAIMTYP"];
        let cards: Vec<(&str, Card)> =
            keys.into_iter().filter_map(|key| Some((key, file.card(Some("RAW"), key).unwrap()?))).collect();
        drop(file);
        let mut copy = FitsWriter::create(path).unwrap();
        copy.image("RAW", &counts, Pixel::F64, "").unwrap();
        cards.into_iter().for_each(|(key, card)| copy.card("RAW", key, card, "").unwrap());
        copy.finish().unwrap();
    };
    files.iter().for_each(|path| rewrite(path, &|counts| counts / COADDS));
    let averaged = [&reduce[..], &RAW, &["--set", "image.coadds_are_averaged=true"]].concat();
    let found = number(&desk.json(&averaged)["channels"][0], "noise_e");
    assert!((found / summed - 1.0).abs() < 1e-9, "{found} {summed}");
    // The star of one frame saturates in every coadd, at a level that counts over the coadds do not
    // reach.
    let saturated = desk.path("raw/n0000.fits");
    rewrite(&saturated, &|counts| counts.min(1000.0));
    let level = ["--set", "image.read_noise_e=14.142", "--set", "image.saturation_adu=1000"];
    let (used, why) = reason(&desk.json(&[&reduce[..], &level].concat()), "n0000.fits");
    assert!(!used && why.contains("saturated") && why.contains("image.coadds_are_averaged"), "{why}");
}

/// Cubes of two channels, which a card distinguishes, with frames of the sky and darks: from raw
/// frames to the estimate of the pair.
#[test]
fn cubes_of_two_channels_with_a_sky_give_a_pair_estimate() {
    let desk = Desk::with_scene();
    let text = std::fs::read_to_string(desk.path("scene.toml")).unwrap().replacen("[aberrations]", PAIR, 1);
    std::fs::write(desk.path("pair.toml"), text).unwrap();
    let counts = ["--set", "image.channel.plus.count=3", "--set", "image.channel.minus.count=3"];
    desk.succeeds(&[&["image", "pair.toml", "-o", "pair.fits"], &counts[..]].concat());
    std::fs::create_dir(desk.path("raw")).unwrap();
    let mut noise = Noise(3);
    for (images, (name, stage_mm)) in
        read_channels(desk.path("pair.fits"), None).unwrap().into_iter().zip([("p.fits", -4.0), ("m.fits", 4.0)])
    {
        // The telescope did not move: the star is at one place in all planes, and only frames of
        // the sky have no star there.
        let planes: Vec<_> =
            images.data.outer_iter().map(|image| star(&image.to_owned(), (100, 90), &mut noise)).collect();
        let planes: Vec<_> = planes.iter().map(|plane| plane.view()).collect();
        let cube = stack(Axis(0), &planes).unwrap();
        let cards = [("OBJECT", "HD 1".into()), ("STAGE", Card::Real(stage_mm))];
        write_cube(&desk, &format!("raw/{name}"), &cube, &cards);
    }
    for (name, count, is_sky) in [("sky.fits", 5, true), ("dark.fits", 9, false)] {
        let mut cube = Array3::zeros((count, SIDE, SIDE));
        for mut plane in cube.outer_iter_mut() {
            let read = |noise: &mut Noise| Array2::from_shape_fn((SIDE, SIDE), |_| NOISE_E * noise.normal());
            plane.assign(&if is_sky { sky(&mut noise) } else { read(&mut noise) });
        }
        write_cube(&desk, &format!("raw/{name}"), &cube, &[("OBJECT", if is_sky { "sky" } else { "dark" }.into())]);
    }
    let response = response();
    let mut flat = Array3::zeros((8, SIDE, SIDE));
    for mut plane in flat.outer_iter_mut() {
        plane.assign(&response.mapv(|r| 80_000.0 * r + (80_000.0f64 * r).sqrt() * noise.normal()));
    }
    write_cube(&desk, "raw/flat.fits", &flat, &[("OBJECT", "flat".into())]);

    let channels = ["--channel", "plus=STAGE=-4", "--channel", "minus=STAGE=4"];
    let reduce = ["reduce", "raw", "--scene", "pair.toml", "-o", "reduced.fits", "--json"];
    let made = desk.json(&[&reduce[..], &RAW, &channels].concat());
    assert_eq!((&made["images"], made["channels"].as_array().unwrap().len()), (&6.into(), 2), "{made}");
    assert_eq!(made["warnings"].as_array().unwrap().len(), 0, "{made}");
    for name in ["p.fits", "m.fits"] {
        let rows = made["frames"].as_array().unwrap();
        let of_file = rows.iter().filter(|row| row["file"].as_str().unwrap().starts_with(name));
        assert_eq!(of_file.filter(|row| row["used"] == true).count(), 3, "{made}");
    }
    let perfect = desk.json(&["estimate", "pair.fits", "-o", "est.fits", "--json"]);
    let found = desk.json(&["estimate", "reduced.fits", "-o", "reduced-est.fits", "--json", "--strict"]);
    let residuals = desk.residuals("reduced-est.fits", "pair.fits");
    for (at, part) in ["phasing", "ncpa"].into_iter().enumerate() {
        let key = format!("{part}_sigma_nm");
        let (sigma, bound) = (number(&found, &key), number(&perfect, &key));
        // Beside the noise of perfect images that of the sky (60 photons beside 400 e² of the
        // reads), of its master of five frames, and of the flat: a fifth. A residual of 7 or 12
        // unknowns is within twice its expectation in 999 of 1,000 draws.
        assert!(sigma < 1.3 * bound && residuals[at] < 2.0 * sigma, "{part}: {residuals:?} {sigma} {bound}");
    }
}

#[test]
fn frames_that_cannot_be_used_are_named_with_the_reason() {
    let desk = desk();
    let image =
        FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap().slice(s![0, .., ..]).to_owned();
    let mut noise = Noise(2);
    let mut bright = star(&(50.0 * &image), (100, 100), &mut noise);
    bright.mapv_inplace(|electrons| electrons.min(2.0 * 12_000.0 * GAIN));
    write(&desk, "raw/bright.fits", &bright, &[]);
    write(&desk, "raw/cloud.fits", &sky(&mut noise), &[]);
    // The star moves by 40 columns in the exposure.
    let mut trail = sky(&mut noise);
    for column in 48..88 {
        trail.slice_mut(s![68..132, column..column + 64]).scaled_add(1.0 / 40.0, &image);
    }
    write(&desk, "raw/trail.fits", &trail, &[]);
    let mut edge = sky(&mut noise);
    edge.slice_mut(s![..56, ..64]).scaled_add(1.0, &image.slice(s![8.., ..]));
    write(&desk, "raw/edge.fits", &edge, &[]);
    write(&desk, "raw/other.fits", &star(&image, (100, 100), &mut noise), &[("CENWAVE", Card::Real(1.6455))]);
    std::fs::write(desk.path("raw/cut.fits"), &std::fs::read(desk.path("raw/n0000.fits")).unwrap()[..9000]).unwrap();
    let reduce = [&["reduce", "raw", "--scene", "scene.toml", "-o", "reduced.fits", "--json"], &RAW[..]].concat();
    let made = desk.json(&reduce);
    assert_eq!(made["images"], 5, "{made}");
    for (file, word) in [
        ("bright.fits", "saturated"),
        ("cloud.fits", "no star"),
        ("trail.fits", "trailed"),
        ("edge.fits", "edge of the frame"),
        ("other.fits", "CENWAVE = 1.6455"),
        ("cut.fits", "truncated"),
    ] {
        let (used, why) = reason(&made, file);
        assert!(!used && why.contains(word), "{file}: {why}");
    }
    // The log in the file is that on the screen.
    let mut file = FitsReader::open(desk.path("reduced.fits")).unwrap();
    let used = file.i64_column("REDUCTION", "USED").unwrap();
    assert_eq!(used.len(), made["frames"].as_array().unwrap().len());
    assert_eq!(used.iter().sum::<i64>(), 5 + 9 + 8 + 8);
    let out = desk.succeeds(&[&reduce[..6], &RAW[..]].concat()).out;
    assert!(out.contains("5 images, 6 frames not used") && out.contains("trailed"), "{out}");
}

/// Darks and flats that neither a card nor a list names are no stars, and no sky of the others.
#[test]
fn calibrations_that_no_card_names_change_no_image() {
    let desk = desk();
    let frames = [&["--scene", "scene.toml", "--json"], &RAW[..]].concat();
    // The darks hold the hot pixels; without them the detector has a mask.
    let mut mask = FitsWriter::create(desk.path("mask.fits")).unwrap();
    mask.image("BADPIX", &dark().mapv(|counts| f64::from(counts > 1000.0)), Pixel::I32, "").unwrap();
    mask.finish().unwrap();
    let mask = ["--mask", "mask.fits"];
    let reduce = |raw: &[&str], output: &str| desk.json(&[&["reduce"], raw, &["-o", output], &frames, &mask].concat());
    let stars: Vec<String> = (0..DITHERS.len()).map(|number| format!("raw/n{number:04}.fits")).collect();
    let stars: Vec<&str> = stars.iter().map(String::as_str).collect();
    let alone = reduce(&stars, "alone.fits");
    std::fs::create_dir(desk.path("unnamed")).unwrap();
    let mut noise = Noise(5);
    for number in 0..4 {
        let dark = Array2::from_shape_fn((SIDE, SIDE), |_| NOISE_E * noise.normal());
        write(&desk, &format!("unnamed/a{number}.fits"), &dark, &[]);
        // A lamp with a hot spot, which is as compact as a star.
        let flat = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| {
            let radius = (y as f64 - 100.0).hypot(x as f64 - 90.0) / 12.0;
            80_000.0 * (1.0 + 0.3 * (-0.5 * radius * radius).exp())
        });
        let flat = flat * &response();
        write(&desk, &format!("unnamed/b{number}.fits"), &flat.mapv(|e| e + e.sqrt() * noise.normal()), &[]);
    }
    let mixed = reduce(&[&stars[..], &["unnamed"]].concat(), "mixed.fits");
    let cube = |name: &str| FitsReader::open(desk.path(name)).unwrap().cube("IMAGES").unwrap();
    assert_eq!((&mixed["images"], cube("mixed.fits")), (&5.into(), cube("alone.fits")), "{mixed}");
    for number in 0..4 {
        let (used, why) = reason(&mixed, &format!("a{number}.fits"));
        assert!(!used && why.contains("no star") && why.contains("--darks"), "{why}");
        let (used, why) = reason(&mixed, &format!("b{number}.fits"));
        assert!(!used && why.contains("electrons a pixel") && why.contains("--flats"), "{why}");
    }
    for row in alone["frames"].as_array().unwrap() {
        assert!(number(row, "flux_e") > 0.0, "{row}");
    }
    // A list of the user is not doubted.
    let listed = reduce(&[&stars[..], &["--stars", "unnamed/a0.fits"]].concat(), "listed.fits");
    let (_, why) = reason(&listed, "a0.fits");
    assert!(!why.contains("others of its exposure"), "{why}");
}

#[test]
fn bad_input_is_refused() {
    let desk = Desk::with_images(&[]);
    std::fs::create_dir(desk.path("raw")).unwrap();
    std::fs::create_dir(desk.path("empty")).unwrap();
    let image =
        FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap().slice(s![0, .., ..]).to_owned();
    let frame = star(&image, (100, 100), &mut Noise(4));
    write(&desk, "raw/n1.fits", &frame, &[]);
    write(&desk, "raw/d1.fits", &sky(&mut Noise(6)), &[("IMAGETYP", "dark".into())]);
    write(&desk, "d2.fits", &frame, &[("IMAGETYP", "dark".into()), ("ITIME", Card::Real(3.0))]);
    let mut mask = FitsWriter::create(desk.path("mask.fits")).unwrap();
    mask.image("BADPIX", &Array2::<f64>::zeros((64, 64)), Pixel::I32, "").unwrap();
    mask.finish().unwrap();
    let base = ["--scene", "scene.toml", "-o", "out.fits"];
    for (arguments, words) in [
        (&["empty"][..], &["empty", "no FITS file"][..]),
        (&["missing.fits"], &["missing.fits", "no such file"]),
        (&["raw/x*.fits"], &["raw/x*.fits", "names no FITS file"]),
        (&["raw/d1.fits"], &["no frame with a star"]),
        (&["scene.toml"], &["no frame can be read", "scene.toml"]),
        (&["raw", "--darks", "raw/n1.fits"], &["no frame with a star"]),
        (&["raw", "--darks", "raw/n1.fits", "--stars", "raw/n1.fits"], &["n1.fits", "as star and as dark"]),
        (&["raw", "--channel", "plus=n*"], &["--channel", "plus", "it has none"]),
        (&["raw", "--pixels", "7"], &["image.pixels = 7", "an integer from 8"]),
        (&["raw", "--pixels", "300"], &["n1.fits", "edge of the frame"]),
        (&["raw/n1.fits", "d2.fits", "--saturation", "1"], &["saturated"]),
        (&["raw/n1.fits", "d2.fits"], &["no dark of 0.5 s", "of 3 s"]),
        (&["raw", "--mask", "mask.fits"], &["mask has 64x64", "200x200"]),
    ] {
        desk.refuses(&[&["reduce"], arguments, &base].concat(), words);
    }
    // A gain in the file of the scene that is not the card's; one that is set holds.
    let text = crate::SMALL.replace("read_noise_e = 20", "read_noise_e = 20\ngain_e_per_adu = 2");
    std::fs::write(desk.path("gain.toml"), text).unwrap();
    let gain = ["reduce", "raw", "--scene", "gain.toml", "-o", "out.fits"];
    desk.refuses(&gain, &["GAIN = 4", "image.gain_e_per_adu = 2"]);
    desk.succeeds(&[&gain[..], &["--set", "image.gain_e_per_adu=2"]].concat());
    // An output that is an input; one that replaces an earlier reduction in the folder of the raw
    // frames.
    desk.refuses(&["reduce", "raw", "--scene", "scene.toml", "-o", "raw/n1.fits"], &["cannot be its output"]);
    for _ in 0..2 {
        desk.succeeds(&["reduce", "raw", "--scene", "scene.toml", "-o", "raw/out.fits"]);
    }
}

#[test]
fn a_first_scene_is_made_of_a_header() {
    let desk = Desk::with_images(&[]);
    let image =
        FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap().slice(s![0, .., ..]).to_owned();
    let cards = [
        ("TELESCOP", Card::from("KECK II")),
        ("CURRINST", "NIRC2".into()),
        ("CAMNAME", "NARROW".into()),
        ("CENWAVE", Card::Real(2.1686)),
        ("EFFWAVE", Card::Real(2.1686)),
        ("RDNOISE", Card::Real(38.0)),
    ];
    write(&desk, "n1.fits", &star(&image, (100, 100), &mut Noise(5)), &cards);
    let text = desk.succeeds(&["scene", "--from", "n1.fits"]).out;
    std::fs::write(desk.path("first.toml"), &text).unwrap();
    // It is a scene, and says what is missing.
    desk.succeeds(&["scene", "first.toml"]);
    for line in ["wavelength_nm = 2168.6", "exposure_s = 1.0", "read_noise_e = 38.0", "gain_e_per_adu = 4.0"] {
        assert!(text.contains(line), "{line} is not in {text}");
    }
    for key in ["diversity_focus_waves_rms", "saturation_adu", "bandwidth_fraction"] {
        let line = text.lines().find(|line| line.starts_with(key)).unwrap_or_else(|| panic!("{key} is not in {text}"));
        assert!(line.contains("TO BE FILLED IN"), "{line}");
    }
    // 2.1686 um over 10.95 m is 40.850 mas, which pixels of 9.952 mas sample 4.105 times.
    assert!(text.contains("pixel_mas = 9.952") && text.contains("4.105 pixels per lambda"), "{text}");
    // It fits the frame, whose header it agrees with.
    desk.succeeds(&[
        "reduce",
        "n1.fits",
        "--scene",
        "first.toml",
        "-o",
        "reduced.fits",
        "--pixels",
        "64",
        "--no-dither-sky",
    ]);
    // Other telescopes have presets of their own.
    for (telescope, line) in [("GTC", "segment_side_m = 0.936"), ("TMT", ""), ("ESO-ELT", ""), ("GMT", "")] {
        write(&desk, "t.fits", &star(&image, (100, 100), &mut Noise(7)), &[("TELESCOP", telescope.into())]);
        let text = desk.succeeds(&["scene", "--from", "t.fits"]).out;
        assert!(text.contains(line) && !text.contains("is not known"), "{telescope}: {text}");
    }
    // Nothing is known of a bare file, and a scene all the same.
    let bare = desk.succeeds(&["scene", "--from", "images.fits"]).out;
    assert!(bare.contains("TELESCOP = ''"), "{bare}");
    for section in bare.split("\n[").skip(1) {
        assert!(section.contains("TO BE FILLED IN"), "{section}");
    }
    let cards = [("ITIME", Card::Real(2.0)), ("COADDS", Card::Integer(1))];
    write(&desk, "n2.fits", &star(&image, (100, 100), &mut Noise(6)), &cards);
    let one = desk.succeeds(&["scene", "--from", "n2.fits"]).out;
    assert!(one.contains("# 1 coadd of 2 s\n"), "{one}");
    desk.refuses(&["scene", "--from", "scene.toml"], &["scene.toml"]);
}

/// The real frame of NIRC2, in focus, where the folder of data is beside the project.
#[test]
fn a_real_frame_is_found_and_cut_out() {
    let frame = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/20130801_n0004.fits");
    if !frame.exists() {
        return;
    }
    let desk = Desk::with_scene();
    let frame = frame.display().to_string();
    let text = desk.succeeds(&["scene", "--from", &frame]).out;
    assert!(text.contains("wavelength_nm = 1645.5") && text.contains("exposure_s = 25.0"), "{text}");
    std::fs::write(desk.path("first.toml"), text).unwrap();
    let json =
        desk.json(&["reduce", &frame, "--scene", "first.toml", "-o", "reduced.fits", "--pixels", "64", "--json"]);
    let row = &json["frames"][0];
    println!("{json}");
    assert_eq!(row["coadds"], 50, "{json}");
    // The star is the brightest pixel of the frame, up to the centroid's halo.
    let data = FitsReader::open(&frame).unwrap().map(None).unwrap();
    let ((y, x), _) = data.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    assert!((number(row, "x") - x as f64).hypot(number(row, "y") - y as f64) < 2.0, "({x}, {y}): {json}");
}
