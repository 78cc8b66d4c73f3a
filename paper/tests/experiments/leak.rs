//! How much of the segments' pistons leaks into the mirror (section 4 of the paper), against an
//! independent prototype.

use cophase::Control;
use cophase::Error;
use cophase::ao::Simulator;
use cophase::scene::Scene;
use cophase::source::Truth;
use cophase::telescope::Telescope;
use cophase_paper::reproduce::figures::{Leak, LeakCase, leak};
use cophase_paper::reproduce::{Progress, statistics};
use rand::SeedableRng;

const SEEDS: usize = 6;

/// The cases that the prototype tried.
fn tried() -> Vec<LeakCase> {
    LeakCase::ALL.into_iter().filter(|case| case.prototype_nm.is_some()).collect()
}

fn run(cases: &[LeakCase], seeds: usize) -> Leak {
    leak(cases, seeds, &Progress::new(&|_, _| {}, &Control::default())).unwrap()
}

#[test]
fn pistons_leak_as_in_an_independent_prototype() {
    let found = run(&tried(), SEEDS);
    assert_eq!(found.rows.len(), 4);
    for row in &found.rows {
        let mirror_nm = statistics::mean(&row.mirror_nm());
        let prototype_nm = row.case.prototype_nm.unwrap();
        // Draws scatter by 6 % (zonal) to 16 % (10.49 m, 0.75), the mean of six by 2 to 6 %, and
        // that of the prototype's twelve by 2 to 5 %: 25 % is three times both together, and the
        // most that two simulators may differ by.
        assert!((mirror_nm / prototype_nm - 1.0).abs() < 0.25, "{:?}: {mirror_nm}", row.case);
        for draw in &row.draws {
            // 0.7^k of what actuators go (10 nm where nearly nothing leaks, 300 nm where all does)
            // is below 1e-3 nm from k = 26 to 35 on. The sensor is not linear for steps between
            // segments, so that the slowest mode takes longer, but not three times as long.
            assert!(draw.frames.is_some_and(|frames| (20..110).contains(&frames)), "{draw:?}");
            // Nothing is made of nothing: the three are sides of a triangle.
            assert!((draw.input_nm - draw.residual_nm).abs() <= draw.mirror_nm * (1.0 + 1e-9), "{draw:?}");
        }
    }
    // Plain, then the mask on the real segments, on the paper's pupil, and with its wider reading:
    // each leaks less, the same pistons in all (where they differ least, 13.9 and 9.6 nm over
    // twelve draws, it is in eleven of the twelve).
    let leaked: Vec<f64> = found.rows.iter().map(|row| statistics::mean(&row.mirror_nm())).collect();
    assert!(leaked.is_sorted_by(|more, less| more > less), "{leaked:?}");
    // 36 pistons of 64.15 nm without their mean have 35 degrees of freedom, of which tip and tilt
    // take nearly 2: √(33/35) is left, with a scatter of 3 % a draw.
    let input = statistics::mean(&found.rows[0].draws.iter().map(|draw| draw.input_nm).collect::<Vec<_>>());
    assert!((input / (64.15 * (33f64 / 35.0).sqrt()) - 1.0).abs() < 0.05, "{input}");
}

#[test]
fn the_same_draws_give_the_same_bits_and_a_mask_that_grows() {
    let cases = &LeakCase::ALL[5..];
    assert!(cases.iter().all(|case| case.row == "pol-mask-inpaint"));
    let (first, second) = (run(cases, 1), run(cases, 1));
    assert_eq!(first.draws().csv(), second.draws().csv());
    let bits = |leak: &Leak| leak.rows.iter().map(|row| row.draws[0].mirror_nm.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&first), bits(&second));
    // Shares from 0.75 to 0.80 are masked by the second only.
    assert!(first.rows[0].draws[0].masked < first.rows[1].draws[0].masked);
}

#[test]
fn cancelled_run_stops() {
    let cancelled = Control::default();
    cancelled.cancel();
    let error = leak(&LeakCase::ALL, 1, &Progress::new(&|_, _| {}, &cancelled)).unwrap_err();
    assert!(matches!(error, Error::Interrupted(_)), "{error}");
}

#[test]
fn corrected_segments_have_no_leakage() {
    let calm = ["fractions", "heights_m", "wind_m_s", "wind_dir_rad"].map(|key| format!("turbulence.{key}"));
    let mut settings: Vec<(&str, &str)> = calm.iter().map(|key| (key.as_str(), "[]")).collect();
    settings.extend([("wavefront_sensor.photon_noise", "false"), ("wavefront_sensor.read_noise_e", "0")]);
    let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
    let telescope = Telescope::new(&scene).unwrap();
    let draw = || Truth::draw(&scene, &telescope, &mut rand_chacha::ChaCha12Rng::seed_from_u64(7)).unwrap();
    let ncpa_nm = draw().ncpa_nm;
    let truth = draw().with_pistons(&telescope, vec![0.0; 36]).unwrap();
    // The NCPA lie behind the loop, and stay.
    assert!(truth.ncpa_nm.iter().zip(&ncpa_nm).all(|(now, then)| now.to_bits() == then.to_bits()));
    let mut simulator = Simulator::with_truth(&scene, Telescope::new(&scene).unwrap(), truth).unwrap();
    for _ in 0..20 {
        let frame = simulator.step().unwrap();
        // A flat wavefront: the sensor's rounding, 1e-7 of a spot's width of some 230 mas, and the
        // gain of a few hundred nm per 100 mas on the weakest of its modes.
        assert!(frame.residual_rms_nm < 0.01, "{}", frame.residual_rms_nm);
    }
    assert!(matches!(draw().with_pistons(&telescope, vec![0.0; 35]), Err(Error::Shape(_))));
    let mut wild = vec![0.0; 36];
    wild[3] = f64::NAN;
    assert!(matches!(draw().with_pistons(&telescope, wild), Err(Error::Value(_))));
}
