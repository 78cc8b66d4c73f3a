//! Files of AOT without Python: what is written is read, bit by bit, and what is missing is named.

use crate::common::images_of;
use cophase::Control;
use cophase::ao::{self, Shot, Simulator};
use cophase::io::aot::{AotTables, Cell, commands_nm, image_reference, row_reference};
use cophase::io::{FitsReader, FitsWriter, Pixel, PixelUnit, Quantity, read_images};
use cophase::pipeline::{Images, embedded_scene};
use cophase::scene::Scene;
use ndarray::{Array2, Array3};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// Writes a run of the small loop with `settings` as our own file and as one of AOT.
fn run(folder: &TempDir, text: &str) -> [PathBuf; 2] {
    let scene = Scene::from_text(text, Path::new("")).unwrap();
    let mut simulator = Simulator::new(&scene).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    let summary = simulator.run(&mut shots, &Control::default()).unwrap();
    let paths = ["own.fits", "aot.fits"].map(|name| folder.path().join(name));
    ao::write(&paths[0], scene.text(), &simulator, &shots, &summary).unwrap();
    ao::write_aot(&paths[1], scene.text(), &simulator, &shots, &summary).unwrap();
    paths
}

fn sky(settings: &str) -> String {
    include_str!("../c_api/sky.toml").replace("count = 4", &format!("count = 2\n{settings}"))
}

fn bits<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> Vec<u64> {
    numbers.into_iter().map(|number| number.to_bits()).collect()
}

/// That the images of both files are the same: pixels, slopes, truth, facts, scene.
fn assert_same(own: &Images, aot: &Images) {
    assert_eq!(bits(&own.images_e), bits(&aot.images_e));
    assert_eq!(own.bad, aot.bad);
    assert_eq!((&own.unit, &own.channel), (&aot.unit, &aot.channel));
    // The tables have no fact that the cards do not have, and no other.
    let stated = |images: &Images| -> Vec<_> { images.facts.iter().map(|f| (f.keyword, f.written.clone())).collect() };
    assert_eq!(stated(own), stated(aot));
    assert_eq!(own.slopes_mas.as_ref().map(bits), aot.slopes_mas.as_ref().map(bits));
    assert!(aot.slopes_mas.as_ref().is_some_and(|slopes| slopes.iter().any(|mas| mas.abs() > 0.1)));
    let maps = |images: &Images| images.truth.as_ref().map(|truth| [bits(&truth.phasing_nm), bits(&truth.ncpa_nm)]);
    assert!(maps(own).is_some() && maps(own) == maps(aot));
    assert_eq!(own.notes, aot.notes);
}

#[test]
fn a_run_has_the_same_bits_in_both_files() {
    let folder = tempfile::tempdir().unwrap();
    let [own, aot] = run(&folder, &sky(""));
    assert_same(&images_of(&own, None), &images_of(&aot, None));
    let texts = [&own, &aot].map(|path| embedded_scene(path, |_| false).unwrap().unwrap().text().to_owned());
    assert_eq!(texts[0], texts[1]);
    // Commands are in m; rounded to the 32 bits of ours they are the same.
    let commands = FitsReader::open(&own).unwrap().map(Some("COMMANDS")).unwrap();
    let through_aot = commands_nm(&mut FitsReader::open(&aot).unwrap()).unwrap().unwrap();
    assert_eq!(commands.mapv(|nm| (nm as f32).to_bits()), through_aot.mapv(|nm| (nm as f32).to_bits()));
    // An HDU in brackets is read as that of any file.
    let selected = read_images(format!("{}[IMAGES]", aot.display()), None).unwrap();
    assert_eq!(selected.data.dim(), (2, 72, 80));
}

#[test]
fn channels_have_own_cameras_and_shared_telemetry() {
    let channels = "\n[[image.channel]]\nname = \"plus\"\ndiversity_focus_waves_rms = 1.0\n\n[[image.channel]]\nname = \"minus\"\n\
                    diversity_focus_waves_rms = -1.0\n";
    for simultaneous in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let text = sky(&format!("simultaneous = {simultaneous}"))
            .replace("\n[aberrations]", &format!("{channels}\n[aberrations]"));
        let [own, aot] = run(&folder, &text);
        let [own, read] = [&own, &aot].map(|path| Images::read(path, None).unwrap());
        assert_eq!((own.len(), read.len()), (2, 2));
        own.iter().zip(&read).for_each(|(own, aot)| assert_same(own, aot));
        let names = ["plus", "minus"].map(|name| Some(name.to_owned()));
        assert_eq!(read.iter().map(|images| images.channel.clone()).collect::<Vec<_>>(), names);
        let measured = FitsReader::open(&aot).unwrap().cube("SLOPES").unwrap().dim().0;
        assert_eq!(measured, if simultaneous { 2 } else { 4 });
        let several = Images::only(Images::read(&aot, None).unwrap()).unwrap_err().to_string();
        assert!(several.contains("2 channels") && several.contains("FILE[HDU]"), "{several}");
        assert!(read_images(&aot, None).unwrap_err().to_string().contains("2 scoring cameras"));
    }
}

/// A file of AOT with two images of a camera in counts, and what `edit` adds.
fn small(path: &Path, edit: impl FnOnce(&mut AotTables, &mut FitsWriter)) {
    let mut tables = AotTables::new();
    let mut file = FitsWriter::create(path).unwrap();
    let detector = vec![
        ("UID", "D".into()),
        ("PIXEL_INTENSITIES", image_reference("FRAMES").into()),
        ("BAD_PIXEL_MAP", image_reference("BAD").into()),
        ("DARK", image_reference("BAD").into()),
        ("PIXEL_SCALE", 5e-8.into()),
        ("INTEGRATION_TIME", 0.5.into()),
        ("COADDS", Cell::Integer(3)),
        ("GAIN", 4.0.into()),
    ];
    tables.row("AOT_DETECTORS", detector).unwrap();
    let camera = vec![("UID", "C".into()), ("WAVELENGTH", 2e-6.into()), ("DETECTOR_UID", row_reference("D").into())];
    tables.row("AOT_SCORING_CAMERAS", camera).unwrap();
    file.image("FRAMES", &Array3::from_elem((2, 8, 8), 7.0), Pixel::F32, "").unwrap();
    let mut bad = Array2::<f64>::zeros((8, 8));
    bad[[1, 2]] = 1.0;
    file.image("BAD", &bad, Pixel::I32, "").unwrap();
    edit(&mut tables, &mut file);
    tables.write(&mut file, "SCAO", "test", "C:\\data").unwrap();
    file.finish().unwrap();
}

fn sensor(tables: &mut AotTables, more: Vec<(&'static str, Cell)>) {
    let own =
        vec![("UID", "W".into()), ("TYPE", "Shack-Hartmann".into()), ("MEASUREMENTS", image_reference("S").into())];
    tables.row("AOT_WAVEFRONT_SENSORS", own.into_iter().chain(more).collect()).unwrap();
}

#[test]
fn tables_state_the_instrument() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.fits");
    small(&path, |_, _| ());
    let images = images_of(&path, None);
    assert_eq!(images.unit, PixelUnit::Counts);
    assert_eq!(images.bad.iter().filter(|bad| **bad).count(), 2);
    assert!(images.bad[[0, 1, 2]] && images.bad[[1, 1, 2]]);
    let values = |quantity| images.facts.iter().find(|fact| fact.quantity == quantity).unwrap().values.clone();
    // 5e-8 rad are 10.313 mas; three co-additions of 0.5 s, or an image that is already the sum.
    assert!((values(Quantity::PixelMas)[0] - 10.3132403).abs() < 1e-6);
    assert!((values(Quantity::WavelengthNm)[0] - 2000.0).abs() < 1e-9);
    assert_eq!((values(Quantity::ExposureS), values(Quantity::GainEPerAdu)), (vec![0.5, 1.5], vec![4.0]));
    assert!(!images.facts.iter().any(|fact| fact.quantity == Quantity::ReadNoiseE));
    assert!(images.notes.iter().any(|note| note.contains("DARK") && note.contains("`C`")), "{:?}", images.notes);
    assert!(images.slopes_mas.is_none() && images.scene.is_none() && images.channel.is_none());
}

#[test]
fn slopes_follow_the_mask_the_unit_and_the_times() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.fits");
    let cube = Array3::from_shape_fn((2, 2, 3), |(frame, axis, place)| (100 * frame + 10 * axis + place) as f64);
    let mask = ndarray::array![[-1.0, 2.0], [0.0, 1.0]];
    let read = || images_of(&path, None).slopes_mas.unwrap();
    for (unit, factor) in [("mas", 1.0), ("", 1.0), ("arcsec", 1e3), ("rad", 180.0 / std::f64::consts::PI * 3.6e6)] {
        small(&path, |tables, file| {
            sensor(tables, vec![("SUBAPERTURE_MASK", image_reference("M").into())]);
            file.image("S", &cube, Pixel::F64, unit).unwrap();
            file.image("M", &mask, Pixel::I32, "").unwrap();
        });
        let expected = ndarray::array![[2.0, 0.0, 1.0, 12.0, 10.0, 11.0], [102.0, 100.0, 101.0, 112.0, 110.0, 111.0]];
        assert_eq!(read(), expected * factor, "{unit}");
    }
    // Pixels of 5e-8 rad, that of the detector of the small file.
    small(&path, |tables, file| {
        sensor(tables, vec![("DETECTOR_UID", row_reference("D").into())]);
        file.image("S", &cube, Pixel::F64, "pix").unwrap();
    });
    assert!((read()[[0, 1]] - 10.3132403).abs() < 1e-6);
    // Frames at 0, 1, 2, 3 s; images of half a second at 1.1 and 2.9 s.
    let frames = Array3::from_shape_fn((4, 2, 3), |(frame, ..)| frame as f64);
    small(&path, |tables, file| {
        sensor(tables, Vec::new());
        for (uid, times_s) in [("I", vec![1.1, 2.9]), ("F", vec![0.0, 1.0, 2.0, 3.0])] {
            tables.row("AOT_TIME", vec![("UID", uid.into()), ("TIMESTAMPS", times_s.into())]).unwrap();
        }
        file.image("S", &frames, Pixel::F64, "mas").unwrap();
        file.card("S", "TIME_UID", row_reference("F"), "").unwrap();
        file.card("FRAMES", "TIME_UID", row_reference("I"), "").unwrap();
    });
    assert_eq!(read().column(0).to_vec(), [1.0, 3.0]);
}

#[test]
fn missing_and_contradictory_tables_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.fits");
    let refused = |edit: &dyn Fn(&mut AotTables, &mut FitsWriter), words: &[&str]| {
        small(&path, edit);
        let sentence = Images::read(&path, None).unwrap_err().to_string();
        assert!(words.iter().all(|word| sentence.contains(word)), "{words:?}: {sentence}");
    };
    let slopes = |file: &mut FitsWriter, shape: (usize, usize, usize), unit: &str| {
        file.image("S", &Array3::<f64>::zeros(shape), Pixel::F64, unit).unwrap();
    };
    refused(&|tables, _| sensor(tables, Vec::new()), &["MEASUREMENTS", "`S`"]);
    let in_another_file = |tables: &mut AotTables, _: &mut FitsWriter| {
        let cells = vec![
            ("UID", "W".into()),
            ("TYPE", "Shack-Hartmann".into()),
            ("MEASUREMENTS", Cell::from("FILEREF<slopes.fits>1")),
        ];
        tables.row("AOT_WAVEFRONT_SENSORS", cells).unwrap();
    };
    refused(&in_another_file, &["FILEREF<slopes.fits>1", "INTREF<NAME>"]);
    refused(
        &|tables, file| {
            sensor(tables, Vec::new());
            slopes(file, (2, 4, 3), "mas");
        },
        &["(2, 4, 3)", "2 dimensions"],
    );
    refused(
        &|tables, file| {
            sensor(tables, Vec::new());
            slopes(file, (2, 2, 3), "pix");
        },
        &["PIXEL_SCALE"],
    );
    let two_sensors = |tables: &mut AotTables, file: &mut FitsWriter| {
        sensor(tables, Vec::new());
        sensor(tables, Vec::new());
        slopes(file, (2, 2, 3), "mas");
    };
    small(&path, two_sensors);
    let images = images_of(&path, None);
    assert!(images.slopes_mas.is_none() && images.notes.iter().any(|note| note.contains("2 wavefront sensors")));

    let mut file = FitsWriter::create(&path).unwrap();
    file.card("PRIMARY", "AOT-VERS", "3.0.0", "").unwrap();
    file.image("FRAMES", &Array3::from_elem((2, 8, 8), 7.0), Pixel::F32, "").unwrap();
    file.finish().unwrap();
    let sentence = Images::read(&path, None).unwrap_err().to_string();
    assert!(sentence.contains("3.0.0") && sentence.contains("2.0.0 and 1.0.0"), "{sentence}");
}
