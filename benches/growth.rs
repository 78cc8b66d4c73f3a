//! How do time and memory grow with modes, pupil samples and batch? `cargo bench --bench growth`
//! (`-- --quick` for a minute's worth)
//!
//! Each point runs in a process of its own, so that its peak of resident memory is its own. The
//! exponent between the last two points of a table stands below each column, beside the one that
//! its operations have:
//!
//! - an **evaluation** is two transforms, 4mn(n + m) multiply-adds each, and products with the
//!   smooth modes. Segment modes cost what the illuminated samples cost, however many they are.
//! - **error bars** are Jᵀ W J, M²·m² multiply-adds, after derivatives (of a segment box·m·(m +
//!   box), of a smooth mode a transform), and before an inverse and an eigen-decomposition, M³.
//! - a **fit** is some 15 evaluations, each with two products with an M×M matrix, and one metric,
//!   which costs what error bars cost.

use cophase::Control;
use cophase::imaging::{Chain, Precision};
use cophase::modal::{Cube, Frame, ModalFitter};
use cophase::scene::Scene;
use cophase::source;
use ndarray::{Array1, Array2, Axis};
use serde::{Deserialize, Serialize};
use std::process::{Command, exit};
use std::time::Instant;

/// What a point of a table is made of.
struct Point {
    rings: usize,
    samples: usize,
    pixels: usize,
    images: usize,
}

#[derive(Serialize, Deserialize)]
struct Found {
    modes: usize,
    model_s: f64,
    evaluation_s: f64,
    bars_s: f64,
    fit_s: f64,
    evaluations: usize,
    peak: usize,
    formula: usize,
}

struct Table {
    title: &'static str,
    varied: fn(&Point, &Found) -> f64,
    points: Vec<Point>,
    /// Exponents of the operations: model, evaluation, error bars, fit.
    expected: [&'static str; 4],
}

fn main() {
    let arguments: Vec<String> = std::env::args().collect();
    if let Some(at) = arguments.iter().position(|argument| argument == "--point") {
        let numbers: Vec<usize> = arguments[at + 1..].iter().filter_map(|number| number.parse().ok()).collect();
        let [rings, samples, pixels, images] = numbers[..] else { exit(2) };
        let found = measure(&Point { rings, samples, pixels, images });
        println!("{}", serde_json::to_string(&found).expect("plain numbers"));
        return;
    }
    let quick = arguments.iter().any(|argument| argument == "--quick");
    for table in tables(quick) {
        table.print();
    }
}

fn tables(quick: bool) -> [Table; 3] {
    let pick = |list: &[usize], most: usize| -> Vec<usize> {
        list.iter().copied().filter(|&value| !quick || value <= most).collect()
    };
    let point = |rings, samples, pixels, images| Point { rings, samples, pixels, images };
    [
        Table {
            title: "modes (256 samples, 192 pixels, one image)",
            varied: |_, found| found.modes as f64,
            points: pick(&[1, 2, 4, 8, 12, 16], 4).into_iter().map(|rings| point(rings, 256, 192, 1)).collect(),
            expected: ["0 to 1", "0", "2 to 3", "2 to 3"],
        },
        Table {
            title: "pupil samples (37 segments, 96 pixels, one image)",
            varied: |point, _| point.samples as f64,
            points: pick(&[64, 128, 256, 512, 1024], 256).into_iter().map(|n| point(3, n, 96, 1)).collect(),
            expected: ["2", "1 to 2", "1 to 2", "1 to 2"],
        },
        Table {
            title: "images (7 segments, 64 samples, 64 pixels)",
            varied: |point, _| point.images as f64,
            points: pick(&[1, 8, 64, 512, 4096], 64).into_iter().map(|images| point(1, 64, 64, images)).collect(),
            expected: ["0", "0", "0", "1"],
        },
    ]
}

impl Table {
    fn print(&self) {
        println!("\nGrowth with {}\n", self.title);
        println!(
            "| modes | samples | images | model s | evaluation µs | error bars s | fit s | evaluations | peak MB | formula MB |"
        );
        println!("|---|---|---|---|---|---|---|---|---|---|");
        let mut found: Vec<(f64, Found)> = Vec::new();
        for point in &self.points {
            let Some(one) = run(point) else { continue };
            println!(
                "| {} | {} | {} | {:.3} | {:.0} | {:.3} | {:.3} | {} | {:.0} | {:.0} |",
                one.modes,
                point.samples,
                point.images,
                one.model_s,
                one.evaluation_s * 1e6,
                one.bars_s,
                one.fit_s,
                one.evaluations,
                one.peak as f64 / 1e6,
                one.formula as f64 / 1e6
            );
            found.push(((self.varied)(point, &one), one));
        }
        let columns: [fn(&Found) -> f64; 5] =
            [|f| f.model_s, |f| f.evaluation_s, |f| f.bars_s, |f| f.fit_s, |f| f.peak as f64];
        let line = |from: usize| -> Vec<String> {
            columns.iter().map(|of| exponent(&found[from..], of).map_or("–".into(), |e| format!("{e:.1}"))).collect()
        };
        let [all, last] = [line(0), line(found.len().saturating_sub(2))];
        let [model, evaluation, bars, fit] = self.expected;
        println!(
            "\nexponents of model, evaluation, error bars, fit and peak: {} over all, {} over the last step",
            all.join(", "),
            last.join(", ")
        );
        println!("expected of the first four where they rule: {model}; {evaluation}; {bars}; {fit}");
    }
}

/// Slope of log y over log x by least squares.
fn exponent(found: &[(f64, Found)], of: &fn(&Found) -> f64) -> Option<f64> {
    let points: Vec<(f64, f64)> = found.iter().map(|(x, found)| (x.ln(), of(found).ln())).collect();
    let mean = |pick: fn(&(f64, f64)) -> f64| points.iter().map(pick).sum::<f64>() / points.len() as f64;
    let (x, y) = (mean(|p| p.0), mean(|p| p.1));
    let along: f64 = points.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let square: f64 = points.iter().map(|p| (p.0 - x).powi(2)).sum();
    (points.len() > 1 && square > 0.0).then(|| along / square)
}

/// A point in a process of its own.
fn run(point: &Point) -> Option<Found> {
    let numbers = [point.rings, point.samples, point.pixels, point.images].map(|number| number.to_string());
    let program = std::env::current_exe().expect("the path of this program");
    let output = Command::new(program).arg("--point").args(&numbers).output().expect("this program starts");
    let text = String::from_utf8_lossy(&output.stdout);
    let found = serde_json::from_str(text.trim()).ok();
    if found.is_none() {
        println!("| {}: {} |", numbers.join(" "), String::from_utf8_lossy(&output.stderr).trim());
    }
    found
}

fn scene(point: &Point) -> Scene {
    let text = format!(
        "[pupil]\naperture = \"hexagonal\"\nrings = {}\nsegment_side_m = 0.72\nsegment_gap_m = 0.004\nsamples = {}\n\
         [image]\nwavelength_nm = 2168.6\npixels = {2}\ncrop_pixels = {2}\ncount = {3}\npeak_snr = 300\nread_noise_e = 5\n\
         [aberrations]\nsegment_piston_rms_nm = 30\nsegment_tip_tilt_rms_nm = 10\nncpa_rms_nm = 20\ntruth_samples = {4}\n\
         [modes]\nsegment = \"piston-tip-tilt\"\nncpa = \"zernike\"\nncpa_count = 10\nexact_zernikes = \"none\"\n",
        point.rings,
        point.samples,
        point.pixels,
        point.images,
        (2 * point.samples).max(512)
    );
    Scene::from_text(&text, std::path::Path::new("")).expect("the scene is valid")
}

fn measure(point: &Point) -> Found {
    let scene = scene(point);
    let started = Instant::now();
    let estimator = ModalFitter::new(&scene, false).expect("the scene has a model");
    let model_s = started.elapsed().as_secs_f64();
    let modes = estimator.model().optics.modes();
    let images_e = source::simulate(&scene).expect("the scene can be imaged").remove(0).images_e;
    let bad = images_e.mapv(|_| false);
    let before = resident("VmRSS:");
    let mut chain = Chain::cpu(estimator.model().optics.clone(), Precision::F64);

    let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
    let estimate = estimator
        .estimate(&mut chain, Cube { images_e: cube.images_e, bad: cube.bad, read_noise_e: None }, &Control::default())
        .expect("the images can be fitted");
    let evaluations = estimate.images.iter().map(|report| report.evaluations).sum();
    // What the images of this process take is not the estimator's.
    let images_bytes = images_e.len() * (size_of::<f64>() + size_of::<bool>());
    let peak = resident("VmHWM:").saturating_sub(images_bytes).max(before.saturating_sub(images_bytes));
    let limit = (scene.estimate.memory_gb * 1e9) as usize;
    let formula = estimator.model().memory(rayon::current_num_threads()).most_bytes(point.images, limit);

    let at = Array1::zeros(modes);
    let bars_s = timed(|| drop(estimator.bound(at.view(), 1e6, 1.0).expect("modes are seen")));
    let coefficients = Array2::from_shape_fn((1, modes), |(image, mode)| 20.0 * ((7 * image + 3 * mode) as f64).sin());
    // The fits leave no image loaded.
    let frame = Frame { data_e: images_e.index_axis(Axis(0), 0), bad: bad.index_axis(Axis(0), 0), read_noise_e: None };
    let prepared = estimator.model().preparation.prepare(frame, estimator.recipe()).expect("the image holds a star");
    chain.load(&[prepared.exposure]).expect("the image fits");
    let evaluation_s = timed(|| drop(chain.evaluate(&[0], coefficients.view()).expect("the evaluation runs")));
    assert_eq!(estimate.images.len(), images_e.len_of(Axis(0)));
    Found { modes, model_s, evaluation_s, bars_s, fit_s: estimate.seconds, evaluations, peak, formula }
}

/// The shortest of up to nine runs, within three seconds or so.
fn timed(mut work: impl FnMut()) -> f64 {
    let started = Instant::now();
    let mut shortest = f64::INFINITY;
    for _ in 0..9 {
        let begun = Instant::now();
        work();
        shortest = shortest.min(begun.elapsed().as_secs_f64());
        if started.elapsed().as_secs_f64() > 3.0 {
            break;
        }
    }
    shortest
}

/// A line of what Linux says of this process, bytes; 0 elsewhere.
fn resident(key: &str) -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(key)).unwrap_or_default();
    line.split_whitespace().next().and_then(|kib| kib.parse::<usize>().ok()).unwrap_or(0) * 1024
}
