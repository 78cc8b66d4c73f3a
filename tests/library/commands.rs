//! Corrections in the terms of controllers: what moves when the commands are sent to hardware that
//! numbers, signs and scales its channels in its own way.

use crate::common::assert_facts;
use crate::consistency::scene;
use cophase::Status;
use cophase::ao::actuators_in_use;
use cophase::io::{FitsWriter, Pixel};
use cophase::pipeline::{Commands, Estimate, Estimator, Images};
use cophase::pupil::Grid;
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::{Array1, Array2};
use std::path::Path;

/// Samples of the truth.
const FINE: usize = 384;
/// The observatory's number of each of our segments, and its volts per nm of wavefront: two
/// segments are wired the other way.
const OBSERVATORY: [(&str, f64); 7] =
    [("S4", 0.002), ("S7", -0.002), ("S1", 0.002), ("S6", 0.0025), ("S2", -0.0015), ("S3", 0.002), ("S5", 0.002)];
/// True pistons, nm.
const PISTONS_NM: [f64; 7] = [35.0, -60.0, 20.0, 80.0, -45.0, 5.0, -35.0];

/// Scene with a mirror and these lines of `[commands]`, in `folder`.
fn with_commands(folder: &Path, commands: &str) -> Scene {
    let plain = scene(&[
        ("aberrations.segment_piston_rms_nm", "0"),
        ("aberrations.ncpa_zernikes", ""),
        ("aberrations.ncpa_rms_nm", ""),
        ("aberrations.ncpa_power_law", ""),
        ("aberrations.truth_samples", &FINE.to_string()),
        ("aberrations.ncpa_file", "truth.fits"),
        ("image.peak_snr", "300"),
        ("mirror.actuators_across", "9"),
        ("mirror.pitch_m", "0.6"),
    ]);
    Scene::from_text(&format!("{}\n[commands]\n{commands}\n", plain.text()), folder).unwrap()
}

/// Writes the wavefront: pistons and smooth NCPA of 60 nm, less the surface of the mirror.
fn write_truth(scene: &Scene, pistons_nm: &[f64], commands_nm: &Array1<f64>) {
    let telescope = Telescope::new(scene).unwrap();
    let pupil = telescope.pupil_on(Grid::new(FINE, telescope.pupil.grid.width_m()).unwrap()).unwrap();
    let places = || (0..FINE * FINE).map(|at| (pupil.grid.coordinate_m(at % FINE), pupil.grid.coordinate_m(at / FINE)));
    let (xs_m, ys_m): (Vec<f64>, Vec<f64>) = places().unzip();
    let surface_nm = commands_nm.dot(&actuators_in_use(scene, &telescope).unwrap().evaluate(&xs_m, &ys_m).unwrap());
    let map = Array2::from_shape_fn((FINE, FINE), |(y, x)| {
        let (x_m, y_m) = (pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
        // Astigmatism and coma, which differ in every direction, in metres.
        let smooth_nm = 25.0 * (x_m * x_m - y_m * y_m) / 2.0 + 12.0 * x_m * (3.0 * (x_m * x_m + y_m * y_m) - 6.0) / 4.0;
        let piston_nm = usize::try_from(pupil.owner[[y, x]]).map_or(0.0, |segment| pistons_nm[segment]);
        piston_nm + smooth_nm - surface_nm[y * FINE + x]
    });
    let mut file = FitsWriter::create(scene.resolve("truth.fits")).unwrap();
    file.image("TRUTH", &map, Pixel::F64, "nm").unwrap();
    file.finish().unwrap();
}

fn estimate(scene: &Scene) -> Result<Estimate> {
    let images = Images { truth: None, ..Images::only(Images::simulated(scene)?)? };
    Estimator::new(scene)?.estimate(&images)
}

/// The volts that `commands` send to the channel `name`.
fn volts(commands: &Option<Commands>, name: &str) -> f64 {
    let commands = commands.as_ref().unwrap();
    assert_eq!(commands.unit, "V");
    commands.channels.iter().find(|channel| channel.name == name).unwrap().value
}

#[test]
fn commands_in_volts_correct_a_permuted_mirror() {
    let folder = tempfile::tempdir().unwrap();
    let scene = with_commands(
        folder.path(),
        "segment_file = \"segments.txt\"\nsegment_unit = \"V\"\nactuator_matrix_file = \"volts.fits\"\nactuator_unit = \"V\"",
    );
    // The order of the rows is the observatory's.
    let mut rows: Vec<(usize, &str, f64)> =
        OBSERVATORY.iter().enumerate().map(|(number, (name, scale))| (number, *name, *scale)).collect();
    rows.sort_by_key(|(_, name, _)| *name);
    let line = |(number, name, scale): &(usize, &str, f64)| format!("{number} {name} {scale}\n");
    std::fs::write(folder.path().join("segments.txt"), rows.iter().map(line).collect::<String>()).unwrap();
    // The electronics of the mirror: channel k drives actuator n − 1 − k, and its neighbour by a
    // tenth; negative volts push.
    let telescope = Telescope::new(&scene).unwrap();
    let actuators = actuators_in_use(&scene, &telescope).unwrap().len();
    let nm_per_volt = Array2::from_shape_fn((actuators, actuators), |(actuator, channel)| {
        match (actuators - 1 - channel).abs_diff(actuator) {
            0 => -400.0,
            1 => -40.0,
            _ => 0.0,
        }
    });
    // Channels per nm: the inverse, by its series in the tenth, whose 12th power is below rounding.
    let flip = Array2::from_shape_fn((actuators, actuators), |(i, j)| if i + j + 1 == actuators { 1.0 } else { 0.0 });
    let off = nm_per_volt.dot(&flip) / -400.0 - Array2::<f64>::eye(actuators);
    let series = (0..40).fold(
        (Array2::eye(actuators), Array2::eye(actuators)),
        |(sum, power): (Array2<f64>, Array2<f64>), _| {
            let power = -power.dot(&off);
            (sum + &power, power)
        },
    );
    let volts_per_nm = flip.dot(&series.0) / -400.0;
    let mut file = FitsWriter::create(folder.path().join("volts.fits")).unwrap();
    file.image("VOLTS", &volts_per_nm, Pixel::F64, "").unwrap();
    file.finish().unwrap();

    write_truth(&scene, &PISTONS_NM, &Array1::zeros(actuators));
    let before = estimate(&scene).unwrap();
    let corrections = before.corrections(None).unwrap();
    assert_eq!(corrections.limited, 0);
    // The hardware, which knows the observatory's names and volts alone.
    let moved = OBSERVATORY.iter().map(|(name, scale)| volts(&corrections.segment_commands, name) / scale);
    let after_nm: Vec<f64> = PISTONS_NM.iter().zip(moved).map(|(nm, add)| nm + add).collect();
    let sent: Array1<f64> =
        (0..actuators).map(|channel| volts(&corrections.actuator_commands, &channel.to_string())).collect();
    write_truth(&scene, &after_nm, &nm_per_volt.dot(&sent));
    let after = estimate(&scene).unwrap();
    println!(
        "phasing {:.2} to {:.2} nm (1σ {:.2}), NCPA {:.2} to {:.2} nm (1σ {:.2}), pistons {after_nm:.1?}",
        before.figures.phasing.rms_nm,
        after.figures.phasing.rms_nm,
        after.figures.phasing.sigma_nm,
        before.figures.ncpa.rms_nm,
        after.figures.ncpa.rms_nm,
        after.figures.ncpa.sigma_nm
    );
    assert_eq!([before.status, after.status], [Status::Ok; 2]);
    // What is left of the pistons is the noise of two estimates and those below their error bars;
    // of the NCPA also what the mirror does not make: a wrong sign, order or scale of any channel
    // leaves tens of nm.
    assert!(after.figures.phasing.rms_nm < 5.0 * after.figures.phasing.sigma_nm, "{}", after.figures.phasing.rms_nm);
    assert!(after.figures.ncpa.rms_nm < 0.1 * before.figures.ncpa.rms_nm, "{}", after.figures.ncpa.rms_nm);
}

#[test]
fn limits_hold_and_tables_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    let scene = with_commands(folder.path(), "segment_file = \"segments.txt\"\nsegment_unit = \"um\"");
    let actuators = actuators_in_use(&scene, &Telescope::new(&scene).unwrap()).unwrap().len();
    let table =
        |limit: &str| (0..7).map(|number| format!("{number} {} -0.001 {limit}\n", 100 + number)).collect::<String>();
    write("segments.txt", &table("0.03"));
    write_truth(&scene, &PISTONS_NM, &Array1::zeros(actuators));
    let found = estimate(&scene).unwrap();
    let corrections = found.corrections(None).unwrap();
    let commands = corrections.segment_commands.clone().unwrap();
    assert!(corrections.actuator_commands.is_none() && corrections.actuators_nm.len() == actuators);
    let over = corrections.pistons_nm.iter().filter(|nm| nm.abs() > 30.0).count();
    assert!(over >= 3 && corrections.limited == over, "{} of {over}", corrections.limited);
    for (number, (channel, nm)) in commands.channels.iter().zip(&corrections.pistons_nm).enumerate() {
        assert_eq!((channel.name.as_str(), channel.number), (&*(100 + number).to_string(), number));
        assert_eq!((channel.value, channel.is_limited), ((-0.001 * nm).clamp(-0.03, 0.03), nm.abs() > 30.0));
    }
    // Text and FITS say the same.
    let [text, fits] = ["c.txt", "c.fits"].map(|name| folder.path().join(name));
    corrections.write(&text).unwrap();
    corrections.write(&fits).unwrap();
    let text = std::fs::read_to_string(text).unwrap();
    assert!(text.contains("# segments: channel, um\n100 ") && text.contains("# actuators: channel, nm\n0 "), "{text}");
    assert_eq!(text.matches("# at its limit").count(), over);
    assert!(text.contains("# The orientation cannot be verified"), "{text}");
    let mut file = cophase::io::FitsReader::open(&fits).unwrap();
    let values: Vec<f64> = commands.channels.iter().map(|channel| channel.value).collect();
    assert_eq!(file.f64_column("SEGMENT_COMMANDS", "ADD").unwrap(), values);
    assert_eq!(file.text_column("SEGMENT_COMMANDS", "NAME").unwrap()[6], "106");
    // Both say by which policy, which modes are held and why, and what is expected.
    assert_eq!(file.card(None, "CONVENT").unwrap(), Some("least-squares".into()));
    let [segments_nm2, ncpa_nm2] = corrections.expected_drop_nm2;
    for (key, wanted) in [("GAIN", 1.0), ("DEADBAND", 1.0), ("DROPSEG", segments_nm2), ("DROPNCPA", ncpa_nm2)] {
        let Some(cophase::io::Card::Real(value)) = file.card(None, key).unwrap() else { panic!("{key}") };
        // Cards have 15 digits.
        assert!((value - wanted).abs() <= 1e-14 * wanted && wanted > 0.0, "{key}: {value} {wanted}");
    }
    for (table, moved) in [("SEGMENTS", "ADD_NM"), ("NCPA", "CORRECTED_NM")] {
        let moved = file.f64_column(table, moved).unwrap();
        let held = file.text_column(table, "HELD").unwrap();
        assert!(moved.iter().zip(&held).all(|(nm, held)| (*nm == 0.0) == (held == "deadband")), "{moved:?} {held:?}");
    }
    let held = corrections.ncpa.iter().filter(|mode| mode.held.is_some()).count();
    assert!(
        held > 0 && text.contains("# Held (deadband): ") && text.contains("# Corrected: 7 of 7 segment modes"),
        "{text}"
    );
    assert!(corrections.summary().contains(&format!("({held} within the deadband)")), "{}", corrections.summary());
    // Segments alone where the limit is in nm.
    assert!(found.corrections(Some(1.0)).unwrap().pistons_nm.iter().all(|nm| nm.abs() <= 1.0));
    // Where nothing but noise is left, all is held: an estimate of a thousandth of these errors.
    let mut calm = found.clone();
    calm.modes.coefficients_nm.iter_mut().for_each(|nm| *nm *= 0.001);
    let calm = calm.corrections(None).unwrap();
    assert!(calm.pistons_nm.iter().all(|nm| *nm == 0.0) && calm.segments_held.iter().all(Option::is_some));
    // By a policy of the scene: a half of each mode above its error bar.
    let half = Estimate { scene: found.scene.with(&[("commands.gain", "0.5")]).unwrap(), ..found.clone() };
    let half = half.corrections(None).unwrap();
    assert_eq!((half.policy.gain, corrections.policy.gain), (0.5, 1.0));
    for (half, all) in half.pistons_nm.iter().zip(&corrections.pistons_nm) {
        // A product with 1/2 is exact.
        assert_eq!(2.0 * half, *all);
    }

    for (name, contents, expected) in [
        ("segments.txt", table("0"), "line 1: a limit of 0"),
        ("segments.txt", table("").replace("6 106", "7 106"), "line 7 | no segment 7"),
        ("segments.txt", table("").replace("101", "100"), "line 2 | channel 100 | twice"),
        ("segments.txt", table("").lines().take(6).collect::<Vec<_>>().join("\n"), "no channel | segment 6"),
    ] {
        write(name, &contents);
        match found.corrections(None).map(|_| ()) {
            Err(Error::File { path, reason }) => {
                assert_facts(&reason, expected);
                assert!(path.ends_with(name), "{path:?}");
            }
            other => panic!("{expected}: {other:?}"),
        }
    }
    std::fs::remove_file(folder.path().join("segments.txt")).unwrap();
    let sentence = found.corrections(None).unwrap_err().to_string();
    assert_facts(&sentence, "commands.segment_file");
    // An estimate misses the file before the work.
    let sentence = Estimator::new(&scene).err().unwrap().to_string();
    assert!(sentence.contains("commands.segment_file"), "{sentence}");
}

#[test]
fn segment_matrix_gives_commands_and_needs_all_columns() {
    let folder = tempfile::tempdir().unwrap();
    let scene = with_commands(
        folder.path(),
        "segment_file = \"channels.txt\"\nsegment_matrix_file = \"matrix.fits\"\nsegment_unit = \"um\"",
    );
    let put = |columns: usize| {
        // Three supports below each segment, of 1 µm of surface for 2 of wavefront, in nm.
        let matrix = Array2::from_shape_fn((21, columns), |(row, column)| if row / 3 == column { 5e-4 } else { 0.0 });
        let mut file = FitsWriter::create(folder.path().join("matrix.fits")).unwrap();
        file.image("MATRIX", &matrix, Pixel::F64, "").unwrap();
        file.finish().unwrap();
    };
    let channels: String = (0..21).rev().map(|row| format!("{row} M{}L{} 1\n", row / 3, row % 3)).collect();
    std::fs::write(folder.path().join("channels.txt"), channels).unwrap();
    put(7);
    let actuators = actuators_in_use(&scene, &Telescope::new(&scene).unwrap()).unwrap().len();
    write_truth(&scene, &PISTONS_NM, &Array1::zeros(actuators));
    let found = estimate(&scene).unwrap();
    let corrections = found.corrections(None).unwrap();
    let commands = corrections.segment_commands.unwrap();
    for (k, channel) in commands.channels.iter().enumerate() {
        let row = 20 - k;
        assert_eq!(channel.name, format!("M{}L{}", row / 3, row % 3));
        assert_eq!(channel.value, 5e-4 * corrections.pistons_nm[row / 3]);
    }
    put(8);
    let sentence = found.corrections(None).unwrap_err().to_string();
    assert_facts(&sentence, "21 rows | 8 columns | 7 segments");
}

#[test]
fn a_piston_a_wavelength_away_is_given_near_the_others() {
    let folder = tempfile::tempdir().unwrap();
    let scene = with_commands(folder.path(), "");
    let areas_mean = |nm: &[f64]| nm.iter().sum::<f64>() / nm.len() as f64;
    let none = Array1::zeros(actuators_in_use(&scene, &Telescope::new(&scene).unwrap()).unwrap().len());
    for (segment, periods) in [(3, 1.0), (5, -2.0)] {
        let mut pistons_nm = PISTONS_NM;
        pistons_nm[segment] += periods * scene.image.wavelength_nm;
        write_truth(&scene, &pistons_nm, &none);
        let found = estimate(&scene).unwrap();
        assert!(found.is_sound(), "{:?}", found.warnings);
        for (nm, truth) in found.modes.coefficients_nm.iter().zip(PISTONS_NM) {
            assert!((nm - truth + areas_mean(&PISTONS_NM)).abs() < 5.0, "{nm} {truth}");
        }
        assert!(found.remarks.iter().all(|remark| !remark.contains("modulo")), "{:?}", found.remarks);
    }
}

#[test]
fn a_segment_is_not_sent_to_another_fringe() {
    let folder = tempfile::tempdir().unwrap();
    let scene = with_commands(folder.path(), "");
    let none = Array1::zeros(actuators_in_use(&scene, &Telescope::new(&scene).unwrap()).unwrap().len());
    // 700 nm from the mean of all: more than a quarter of the wavelength, less than half of it.
    let mut pistons_nm = [0.0; 7];
    pistons_nm[2] = 700.0 * 7.0 / 6.0;
    write_truth(&scene, &pistons_nm, &none);
    let found = estimate(&scene).unwrap();
    let remarks: Vec<&String> = found.remarks.iter().filter(|remark| remark.contains("modulo")).collect();
    assert_eq!(remarks.len(), 1);
    assert_facts(remarks[0], "wavelength of 2169 nm | Segment 2 | second wavelength");
    let from_mean_nm: f64 =
        remarks[0].split("Segment 2 is ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    // Within some error bars of a segment.
    assert!((from_mean_nm - 700.0).abs() < 3.0, "{remarks:?}");
    let moved = |estimate: &Estimate| estimate.corrections(None).map(|corrections| corrections.pistons_nm[2]);
    assert_eq!(moved(&found).unwrap(), -scene.image.wavelength_nm / 4.0);
    let by = |step_nm: &str| {
        let scene = found.scene.with(&[("commands.max_step_nm", step_nm)]).unwrap();
        moved(&Estimate { scene, ..found.clone() })
    };
    assert!((by("1000").unwrap() + 700.0).abs() < 5.0);
    let refused = by("600").unwrap_err();
    assert!(matches!(refused, Error::Value(_)));
    assert_facts(
        &refused.to_string(),
        "segment 2 would be moved by - | 600 | commands.max_step_nm | second wavelength",
    );
    // A wavelength of the wrong sign, as another program or a start may give it.
    let mut wrong = found.clone();
    wrong.modes.coefficients_nm[2] -= scene.image.wavelength_nm;
    assert_facts(&moved(&wrong).unwrap_err().to_string(), "segment 2 | 1084");
}
