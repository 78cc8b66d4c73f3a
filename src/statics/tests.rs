//! Static errors from the known wavefronts of an AO simulation, as of a perfect retrieval, against
//! the truth.

use super::error_budget::ErrorSource;
use super::wavefront_source::{RetrievedSequence, WavefrontSource};
use super::{Iteration, StaticsSettings, estimate_static_errors};
use crate::Result;
use crate::ao::{LoopFrame, Recorder, Schedule, Shot, Simulator};
use crate::control::Control;
use crate::loop_response::SegmentLimits;
use crate::metrics::residual_nm;
use crate::retrieval::{IlluminatedSamples, StaticWavefront};
use crate::scene::{AoKnowledge, Scene, System};
use ndarray::{Array1, Array2};

mod segment_tilts;

/// Recorder of the wavefront of each exposure, averaged over its frames, on the scene's grid, for
/// [`Simulator::run`].
struct SimulatedWavefronts {
    schedule: Schedule,
    samples: IlluminatedSamples,
    segments_nm: Vec<f32>,
    /// For each illuminated sample of the simulator's map: its index, the coarser sample that holds
    /// it, its share.
    cells: Vec<(u32, u32, f64)>,
    /// Static wavefront, nm.
    static_nm: Array1<f64>,
    image: usize,
    dynamic_nm: Vec<f64>,
    images: usize,
    exposed: Vec<f64>,
    /// Telemetry of each image.
    shots: Vec<Shot>,
}

impl SimulatedWavefronts {
    /// For a run of `simulator`, whose scene has a loop, from its start.
    fn new(simulator: &Simulator) -> Result<Self> {
        let scene = simulator.scene();
        let control = scene.control.as_ref().unwrap();
        let (telescope, truth) = (simulator.telescope(), simulator.truth());
        let grid = telescope.pupil.grid;
        let samples = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &telescope.area_weights(grid)?)?;
        let mut static_nm = Array1::from(truth.ncpa_at(&samples.xs_m, &samples.ys_m)?);
        for ((segment, sample), share) in samples.pistons.indexed_iter().filter(|(_, share)| **share != 0.0) {
            let (x_m, y_m) = (samples.xs_m[sample], samples.ys_m[sample]);
            static_nm[sample] += share * truth.segment_nm(&telescope.pupil, segment, x_m, y_m);
        }
        Ok(Self {
            schedule: Schedule::new(scene, control.settle_s, control.frame_rate_hz)?,
            segments_nm: simulator.segments_nm().to_vec(),
            cells: cells(simulator, &samples),
            static_nm,
            image: 0,
            dynamic_nm: vec![0.0; samples.len()],
            images: 0,
            exposed: Vec::new(),
            shots: Vec::new(),
            samples,
        })
    }

    /// Wavefronts of all exposures so far, static and dynamic, nm, `[image, sample]`.
    fn wavefronts_nm(&self) -> Array2<f64> {
        Array2::from_shape_vec((self.images, self.samples.len()), self.exposed.clone()).unwrap() + &self.static_nm
    }
}

/// The sample of `samples` that holds each sample of the simulator's finer grid.
fn cells(simulator: &Simulator, samples: &IlluminatedSamples) -> Vec<(u32, u32, f64)> {
    let (pupil, stride, n) = (simulator.pupil(), simulator.footprint().stride(), samples.samples);
    let mut sample_at = vec![None; n * n];
    samples.indices.iter().enumerate().for_each(|(sample, &index)| sample_at[index] = Some(sample));
    let cell = |i: usize| ((pupil.grid.coordinate_m(i) / samples.pitch_m + n as f64 / 2.0) as usize).min(n - 1);
    let illuminated = pupil.amplitude.indexed_iter().filter(|(_, amplitude)| **amplitude > 0.0);
    let mut cells: Vec<(u32, u32, f64)> = illuminated
        .filter_map(|((y, x), &amplitude)| {
            let sample = sample_at[cell(y) * n + cell(x)]?;
            Some(((y * stride + x) as u32, sample as u32, amplitude))
        })
        .collect();
    let mut whole = vec![0.0; samples.len()];
    cells.iter().for_each(|&(_, sample, amplitude)| whole[sample as usize] += amplitude);
    cells.iter_mut().for_each(|(_, sample, amplitude)| *amplitude /= whole[*sample as usize]);
    cells
}

impl Recorder for SimulatedWavefronts {
    fn frame(&mut self, frame: &LoopFrame) -> Result<()> {
        let Some(exposure) = self.schedule.exposure(self.image) else { return Ok(()) };
        let Some(since) = exposure.place(frame.number) else { return Ok(()) };
        let share = 1.0 / exposure.frames as f64;
        for &(place, sample, weight) in &self.cells {
            let moving = f64::from(frame.residual_nm[place as usize] - self.segments_nm[place as usize]);
            self.dynamic_nm[sample as usize] += share * weight * moving;
        }
        if since + 1 == exposure.frames {
            self.exposed.append(&mut self.dynamic_nm);
            self.dynamic_nm.resize(self.samples.len(), 0.0);
            self.images += 1;
            self.image += 1;
        }
        Ok(())
    }

    fn shot(&mut self, shot: Shot) -> Result<()> {
        self.shots.push(shot);
        Ok(())
    }
}

/// The squares of the error budget's terms add up to the total's, to rounding.
fn assert_terms_add_up(iteration: &Iteration) {
    let budget = &iteration.error_budget;
    for (i, total_nm) in budget.total_nm.into_iter().enumerate() {
        let square_nm2: f64 = budget.terms.iter().map(|term| [term.phasing_nm, term.ncpa_nm][i].powi(2)).sum();
        assert!((square_nm2.sqrt() / total_nm - 1.0).abs() < 1e-9, "{budget:?}");
    }
}

/// Known wavefronts, given once.
struct KnownWavefronts(IlluminatedSamples, Option<RetrievedSequence>);

impl WavefrontSource for KnownWavefronts {
    fn samples(&self) -> &IlluminatedSamples {
        &self.0
    }
    fn retrieve(&mut self, _: Option<&StaticWavefront>) -> Result<Option<RetrievedSequence>> {
        Ok(self.1.take())
    }
}

/// A small Keck, seven segments behind ten lenslets, 40 images in two seconds.
fn run() -> (Simulator, SimulatedWavefronts) {
    run_with(&[])
}

/// The same with further settings.
fn run_with(more: &[(&str, &str)]) -> (Simulator, SimulatedWavefronts) {
    let settings = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "5.625"),
        ("pupil.samples", "60"),
        ("image.pixels", "64"),
        ("image.count", "40"),
        ("image.interval_s", "0.05"),
        ("image.exposure_s", "0.0"),
        ("wavefront_sensor.lenslets_across", "10"),
        ("mirror.actuators_across", "11"),
        ("control.settle_s", "0.2"),
    ];
    let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap().with(more).unwrap();
    let mut simulator = Simulator::new(&scene).unwrap();
    let mut wavefronts = SimulatedWavefronts::new(&simulator).unwrap();
    simulator.run(&mut wavefronts, &Control::default()).unwrap();
    (simulator, wavefronts)
}

#[test]
#[ignore = "merge: 2 s"]
fn errors_decrease_with_the_knowledge_of_the_ao() {
    let (simulator, run) = run();
    let wavefront_nm = run.wavefronts_nm();
    let count = wavefront_nm.nrows();
    assert_eq!((count, run.shots.len()), (40, 40));
    let slopes = run.shots[0].mean_slopes_mas.len();
    let slopes_mas = Array2::from_shape_fn((count, slopes), |(i, k)| f64::from(run.shots[i].mean_slopes_mas[k]));
    // A frozen exposure is one frame.
    assert_eq!(run.shots[3].mean_slopes_mas, run.shots[3].slopes_mas);
    let find = |ao_knowledge: AoKnowledge| -> Iteration {
        let sequence = RetrievedSequence {
            wavefront_nm: wavefront_nm.clone(),
            reduced_chi2: vec![1.0; count],
            slopes_mas: Some(slopes_mas.clone()),
        };
        let settings = StaticsSettings { ao_knowledge, ..StaticsSettings::default() };
        let mut known = KnownWavefronts(run.samples.clone(), Some(sequence));
        estimate_static_errors(simulator.scene(), &mut known, &settings, &Control::default()).unwrap().pop().unwrap()
    };
    let pupil = &simulator.telescope().pupil;
    let truth = simulator.truth();
    let residuals_nm = |iteration: &Iteration| {
        [
            residual_nm(pupil, iteration.maps.phasing_nm.view(), truth.phasing_nm.view()).unwrap(),
            residual_nm(pupil, iteration.maps.ncpa_nm.view(), truth.ncpa_nm.view()).unwrap(),
        ]
    };
    let iterations = [AoKnowledge::Spectrum, AoKnowledge::Loop, AoKnowledge::Telemetry].map(find);
    let [spectrum, known_loop, telemetry] = [0, 1, 2].map(|i| residuals_nm(&iterations[i]));
    println!("{spectrum:.2?} {known_loop:.2?} {telemetry:.2?}");
    // Without the loop its response to the pistons counts as NCPA; without slopes the mean of the
    // turbulence does.
    assert!(known_loop[1] < 0.8 * spectrum[1] && telemetry[1] < 0.5 * known_loop[1]);
    // An error bar is the root of a mean square over some ten degrees of freedom, so one draw
    // scatters by a quarter; and a pupil of three segments, with lags tapered at its width,
    // underestimates the lowest orders of its turbulence by up to a half. Three times it is too
    // much.
    for (found_nm, iteration) in [spectrum, known_loop, telemetry].iter().zip(&iterations) {
        let expected_nm = iteration.error_budget.total_nm;
        assert!((0..2).all(|i| found_nm[i] < 3.0 * expected_nm[i]), "{expected_nm:?}");
        assert_terms_add_up(iteration);
    }
    assert!(telemetry[0] < 15.0 && telemetry[1] < 10.0, "64 and 73 nm were put in");
    // Error bars increase as the knowledge decreases; the unknown loop response does not average
    // over images.
    let [wide, narrow, narrowest] = [0, 1, 2].map(|i| iterations[i].error_budget.total_nm[1]);
    assert!(wide > narrow && narrow > narrowest, "{wide} {narrow} {narrowest}");
    let [unknown, known, _] = &iterations;
    let (known, budget) = (&known.error_budget, &unknown.error_budget);
    assert_eq!((known.term_nm(ErrorSource::UnknownLoopResponse), known.averaged_nm()), ([0.0; 2], known.total_nm));
    let response_nm = budget.term_nm(ErrorSource::UnknownLoopResponse)[1];
    // Pistons of 64 nm, of which the modes represent most and the pupil's plane absorbs some, times
    // 0.58.
    assert!((15.0..40.0).contains(&response_nm), "{response_nm}");
    assert!((budget.total_nm[1] / budget.averaged_nm()[1].hypot(response_nm) - 1.0).abs() < 1e-9);
    assert!(unknown.further_images([f64::INFINITY, 0.9 * response_nm]).is_err());
}

/// The error is common to all images and iterations, so it changes neither the estimate, nor when
/// iterations end, nor the gain of further images.
#[test]
fn an_error_of_the_diversity_is_in_the_error_bars_alone() {
    let (simulator, run) = run();
    let wavefront_nm = run.wavefronts_nm();
    let fraction = 0.1;
    let find = |scene: &System| -> Iteration {
        let reduced_chi2 = vec![1.0; wavefront_nm.nrows()];
        let sequence = RetrievedSequence { wavefront_nm: wavefront_nm.clone(), reduced_chi2, slopes_mas: None };
        let settings = StaticsSettings { ao_knowledge: AoKnowledge::Loop, ..StaticsSettings::default() };
        estimate_static_errors(
            scene,
            &mut KnownWavefronts(run.samples.clone(), Some(sequence)),
            &settings,
            &Control::default(),
        )
        .unwrap()
        .pop()
        .unwrap()
    };
    let known = simulator.scene();
    let (sure, mut unsure) =
        (find(known), find(&known.with(|sections| sections.tolerance.defocus_fraction = 0.1).unwrap()));
    assert_eq!(sure.modes().coefficients_nm, unsure.modes().coefficients_nm);
    let (known_nm, total_nm) = (sure.error_budget.total_nm, unsure.error_budget.total_nm);
    assert_eq!((sure.error_budget.averaged_nm(), unsure.error_budget.averaged_nm()), (known_nm, known_nm));
    assert_terms_add_up(&unsure);

    // A focus is Noll's 4, the third of the modes, and of 1.5 waves RMS over the finest pupil: a
    // part in a hundred.
    let segments = sure.errors.pistons_nm.len();
    let (rms_nm, along_nm) = (1.5 * known.image.wavelength_nm, &sure.diversity.coefficients_nm);
    assert!((along_nm[2].abs() / rms_nm - 1.0).abs() < 0.01 && sure.diversity.is_spanned(), "{:?}", sure.diversity);
    let more_nm2 = &unsure.errors.covariance_nm2 - &sure.errors.covariance_nm2;
    let along = |mode: usize| if mode < segments { 0.0 } else { fraction * along_nm[mode - segments] };
    // Rounding of variances of some 10⁵ nm².
    let off_nm2 = more_nm2.indexed_iter().map(|((i, j), nm2)| (nm2 - along(i) * along(j)).abs());
    assert!(off_nm2.fold(0.0, f64::max) < 1e-9);
    // 7 segments and their neighbourhood on 60 samples: the diversity of the map, but for the part
    // that modes do not represent.
    let diversity = crate::telescope::Diversity::new(known, simulator.telescope()).unwrap();
    let grid = simulator.telescope().pupil.grid;
    for ((y, x), sigma_nm) in unsure.sigma_maps.ncpa_nm.indexed_iter().filter(|(_, nm)| nm.is_finite()) {
        let more_nm = (sigma_nm.powi(2) - sure.sigma_maps.ncpa_nm[[y, x]].powi(2)).sqrt();
        let shown_nm = fraction * diversity.at(grid.coordinate_m(x), grid.coordinate_m(y)).abs();
        assert!((more_nm - shown_nm).abs() < 0.01 * fraction * rms_nm, "{more_nm} {shown_nm}");
    }
    let shared_nm = (total_nm[1].powi(2) - known_nm[1].powi(2)).sqrt();
    assert!((shared_nm / (fraction * rms_nm) - 1.0).abs() < 0.01, "{shared_nm}");
    assert_eq!(total_nm[0], known_nm[0]);

    // A change of twice the averaged part, which is a tenth of the error bar.
    unsure.change_nm = [0.0, 2.0 * known_nm[1]];
    assert!(unsure.has_changed(0.25) && unsure.change_nm[1] < total_nm[1]);
    // Four times the images halve the averaged part, and not the rest.
    let half_nm = [f64::INFINITY, shared_nm.hypot(known_nm[1] / 2.0)];
    let count = unsure.used_images.len();
    // Rounded up, from a difference of squares.
    assert!((3 * count..=3 * count + 1).contains(&unsure.further_images(half_nm).unwrap()));
    let sentence = unsure.further_images([f64::INFINITY, 0.9 * shared_nm]).unwrap_err().to_string();
    assert!(sentence.contains("out of reach"), "{sentence}");

    // NCPA beyond the modes are in the error bars of the NCPA alone, and do not average over
    // images.
    let mut beyond = sure.clone();
    beyond.add_beyond_modes(50.0);
    assert_eq!(beyond.error_budget.averaged_nm(), known_nm);
    assert_eq!(beyond.error_budget.total_nm, [known_nm[0], known_nm[1].hypot(50.0)]);
    assert_terms_add_up(&beyond);
    for (wider_nm, sigma_nm) in beyond.sigma_maps.ncpa_nm.iter().zip(&sure.sigma_maps.ncpa_nm) {
        assert!(wider_nm.is_nan() && sigma_nm.is_nan() || *wider_nm == sigma_nm.hypot(50.0));
    }
    assert!(beyond.further_images([f64::INFINITY, 49.0]).is_err());

    // The focus is below its error bar, and no other mode is.
    let corrected = |iteration: &Iteration| iteration.corrections(known, None, SegmentLimits::NONE).unwrap();
    let [all, but_focus] = [&sure, &unsure].map(corrected);
    assert_eq!(all.corrected_modes, but_focus.corrected_modes + 1);
    assert_eq!(all.pistons_nm, but_focus.pistons_nm);
}
