//! The phases that a simulated run really had: what a perfect retrieval would find, to tell its errors from the rest's.

use crate::ao::{Frame, Recorder, Schedule, Shot, Simulator};
use crate::retrieval::LitSamples;
use crate::{Error, Result};
use ndarray::{Array1, Array2};

/// Gathers the dynamic wavefront of each exposure, averaged over its frames, on the scene's grid. Hand it to
/// [`Simulator::run`].
pub struct TruePhases {
    schedule: Schedule,
    lit: LitSamples,
    segments_nm: Vec<f32>,
    /// For each sample of the simulator's map with glass: its place, the lit sample that holds it, its share.
    cells: Vec<(u32, u32, f64)>,
    /// What does not change, nm.
    static_nm: Array1<f64>,
    image: usize,
    dynamic_nm: Vec<f64>,
    images: usize,
    exposed: Vec<f64>,
    /// The images with the telemetry of each.
    pub shots: Vec<Shot>,
}

impl TruePhases {
    /// For a run of `simulator`, from its start.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene without a loop; those of the telescope.
    pub fn of(simulator: &Simulator) -> Result<Self> {
        let scene = simulator.scene();
        let Some(control) = &scene.control else {
            return Err(Error::Scene(format!("{}: the section [control] is missing: a run needs it", scene.name())));
        };
        let (telescope, truth) = (simulator.telescope(), simulator.truth());
        let grid = telescope.pupil.grid;
        let lit = LitSamples::of(grid.samples(), grid.pitch_m(), &telescope.area_weights(grid)?)?;
        let mut static_nm = Array1::from(truth.ncpa_at(&lit.xs_m, &lit.ys_m)?);
        static_nm += &Array1::from(truth.piston_nm.clone()).dot(&lit.pistons);
        Ok(Self {
            schedule: Schedule::of(scene, control.settle_s, control.frame_rate_hz),
            segments_nm: simulator.segments_nm().to_vec(),
            cells: cells(simulator, &lit),
            static_nm,
            image: 0,
            dynamic_nm: vec![0.0; lit.len()],
            images: 0,
            exposed: Vec::new(),
            shots: Vec::new(),
            lit,
        })
    }

    /// The samples.
    pub fn lit(&self) -> &LitSamples {
        &self.lit
    }

    /// The phases of all exposures so far, static and dynamic, nm, `[image, sample]`.
    ///
    /// # Errors
    /// [`Error::Internal`] never.
    pub fn phases_nm(&self) -> Result<Array2<f64>> {
        let dynamic_nm = Array2::from_shape_vec((self.images, self.lit.len()), self.exposed.clone())
            .map_err(|error| Error::Internal(format!("exposures of uneven length: {error}")))?;
        Ok(dynamic_nm + &self.static_nm)
    }
}

/// Which sample of `lit` holds each sample of the simulator's finer grid.
fn cells(simulator: &Simulator, lit: &LitSamples) -> Vec<(u32, u32, f64)> {
    let (pupil, stride, n) = (simulator.pupil(), simulator.footprint().stride(), lit.samples);
    let mut sample_at = vec![None; n * n];
    lit.places.iter().enumerate().for_each(|(sample, &place)| sample_at[place] = Some(sample));
    let cell = |i: usize| ((pupil.grid.coordinate_m(i) / lit.pitch_m + n as f64 / 2.0) as usize).min(n - 1);
    let glass = pupil.amplitude.indexed_iter().filter(|(_, amplitude)| **amplitude > 0.0);
    let mut cells: Vec<(u32, u32, f64)> = glass
        .filter_map(|((y, x), &amplitude)| {
            let sample = sample_at[cell(y) * n + cell(x)]?;
            Some(((y * stride + x) as u32, sample as u32, amplitude))
        })
        .collect();
    let mut whole = vec![0.0; lit.len()];
    cells.iter().for_each(|&(_, sample, amplitude)| whole[sample as usize] += amplitude);
    cells.iter_mut().for_each(|(_, sample, amplitude)| *amplitude /= whole[*sample as usize]);
    cells
}

impl Recorder for TruePhases {
    fn frame(&mut self, frame: &Frame) -> Result<()> {
        let Some(since) = frame.number.checked_sub(self.schedule.start(self.image)) else { return Ok(()) };
        if self.image >= self.schedule.images || since >= self.schedule.exposure {
            return Ok(());
        }
        let share = 1.0 / self.schedule.exposure as f64;
        for &(place, sample, weight) in &self.cells {
            let moving = f64::from(frame.residual_nm[place as usize] - self.segments_nm[place as usize]);
            self.dynamic_nm[sample as usize] += share * weight * moving;
        }
        if since + 1 == self.schedule.exposure {
            self.exposed.append(&mut self.dynamic_nm);
            self.dynamic_nm.resize(self.lit.len(), 0.0);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Progress;
    use crate::loop_response::Commands;
    use crate::metrics::residual_nm;
    use crate::scene::{Knows, Scene};
    use crate::statics::{Measured, Pass, PassRecipe, PhaseSource, StaticWavefront, find_statics};

    /// Phases that are known from the start.
    struct Known(LitSamples, Option<Measured>);

    impl PhaseSource for Known {
        fn lit(&self) -> &LitSamples {
            &self.0
        }
        fn phases(&mut self, _: Option<&StaticWavefront>) -> Result<Option<Measured>> {
            Ok(self.1.take())
        }
    }

    /// A small Keck, seven segments behind ten lenslets, 40 images in two seconds.
    fn run() -> (Simulator, TruePhases) {
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
        let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
        let mut simulator = Simulator::new(&scene).unwrap();
        let mut phases = TruePhases::of(&simulator).unwrap();
        simulator.run(&mut phases, &mut Progress::default()).unwrap();
        (simulator, phases)
    }

    #[test]
    fn the_more_is_known_the_less_is_left() {
        let (simulator, run) = run();
        let phase_nm = run.phases_nm().unwrap();
        let count = phase_nm.nrows();
        assert_eq!((count, run.shots.len()), (40, 40));
        let slopes = run.shots[0].mean_slopes_mas.len();
        let slopes_mas = Array2::from_shape_fn((count, slopes), |(i, k)| f64::from(run.shots[i].mean_slopes_mas[k]));
        // A frozen exposure is one frame.
        assert_eq!(run.shots[3].mean_slopes_mas, run.shots[3].slopes_mas);
        let find = |knows: Knows| -> Pass {
            let measured = Measured {
                phase_nm: phase_nm.clone(),
                reduced_chi2: vec![1.0; count],
                slopes_mas: Some(slopes_mas.clone()),
            };
            let recipe = PassRecipe { knows, ..PassRecipe::default() };
            let mut known = Known(run.lit().clone(), Some(measured));
            find_statics(simulator.scene(), &mut known, &recipe, None).unwrap().pop().unwrap()
        };
        let pupil = &simulator.telescope().pupil;
        let truth = simulator.truth();
        let left = |pass: &Pass| {
            [
                residual_nm(pupil, pass.phasing_nm.view(), truth.phasing_nm.view()).unwrap(),
                residual_nm(pupil, pass.ncpa_nm.view(), truth.ncpa_nm.view()).unwrap(),
            ]
        };
        let passes = [Knows::Spectrum, Knows::Loop, Knows::Telemetry].map(find);
        let [spectrum, known_loop, telemetry] = [0, 1, 2].map(|i| left(&passes[i]));
        println!("{spectrum:.2?} {known_loop:.2?} {telemetry:.2?}");
        // Without the loop its answer to the pistons passes for NCPA; without slopes the mean of the turbulence does.
        assert!(known_loop[1] < 0.8 * spectrum[1] && telemetry[1] < 0.5 * known_loop[1]);
        // An error bar is the root of a mean square over some ten degrees of freedom, so one draw scatters by a quarter; and
        // a pupil of three segments, with lags tapered at its width, underestimates the lowest orders of its turbulence by
        // up to a half. Three times it is too much.
        for (left, pass) in [(spectrum, &passes[0]), (known_loop, &passes[1]), (telemetry, &passes[2])] {
            assert!(
                left[0] < 3.0 * pass.expected_nm[0] && left[1] < 3.0 * pass.expected_nm[1],
                "{:?}",
                pass.expected_nm
            );
        }
        assert!(telemetry[0] < 15.0 && telemetry[1] < 10.0, "64 and 73 nm were put in");
        // The less is known the larger the error bar; what the loop may have answered no number of images takes out.
        let [wide, narrow, narrowest] = [0, 1, 2].map(|i| passes[i].expected_nm[1]);
        assert!(wide > narrow && narrow > narrowest, "{wide} {narrow} {narrowest}");
        let [unknown, known, _] = &passes;
        assert_eq!((known.answer_nm, known.averaged_nm), (0.0, known.expected_nm));
        // Pistons of 64 nm of which the modes hold most and the pupil's plane takes some, times 0.58.
        assert!((15.0..40.0).contains(&unknown.answer_nm), "{}", unknown.answer_nm);
        assert!((unknown.expected_nm[1] / unknown.averaged_nm[1].hypot(unknown.answer_nm) - 1.0).abs() < 1e-9);
        assert!(unknown.further_images([f64::INFINITY, 0.9 * unknown.answer_nm]).is_err());
    }

    /// All images and passes share it: neither the estimate, nor when passes end, nor what further images bring hangs on it.
    #[test]
    fn an_error_of_the_diversity_is_in_the_error_bars_alone() {
        let (simulator, run) = run();
        let phase_nm = run.phases_nm().unwrap();
        let fraction = 0.1;
        let find = |scene: &Scene| -> Pass {
            let reduced_chi2 = vec![1.0; phase_nm.nrows()];
            let measured = Measured { phase_nm: phase_nm.clone(), reduced_chi2, slopes_mas: None };
            let recipe = PassRecipe { knows: Knows::Loop, ..PassRecipe::default() };
            find_statics(scene, &mut Known(run.lit().clone(), Some(measured)), &recipe, None).unwrap().pop().unwrap()
        };
        let known = simulator.scene();
        let (sure, mut unsure) = (find(known), find(&known.with_override("estimate.diversity_error", "0.1").unwrap()));
        assert_eq!(sure.coefficients_nm(), unsure.coefficients_nm());
        assert_eq!((sure.averaged_nm, sure.expected_nm), (unsure.averaged_nm, sure.averaged_nm));

        // A focus is Noll's 4, the third of the modes, and of 1.5 waves RMS over the finest pupil: a part in a hundred.
        let segments = sure.errors.pistons_nm.len();
        let (rms_nm, along_nm) = (1.5 * known.image.wavelength_nm, &sure.diversity.coefficients_nm);
        assert!((along_nm[2].abs() / rms_nm - 1.0).abs() < 0.01 && sure.diversity.is_held(), "{:?}", sure.diversity);
        let more_nm2 = &unsure.errors.covariance_nm2 - &sure.errors.covariance_nm2;
        let along = |mode: usize| if mode < segments { 0.0 } else { fraction * along_nm[mode - segments] };
        // Rounding of variances of some 10⁵ nm².
        let off_nm2 = more_nm2.indexed_iter().map(|((i, j), nm2)| (nm2 - along(i) * along(j)).abs());
        assert!(off_nm2.fold(0.0, f64::max) < 1e-9);
        // 7 segments and their neighbourhood on 60 samples: the diversity of the map, to as much of it as modes do not hold.
        let diversity = crate::telescope::Diversity::of(known, simulator.telescope()).unwrap();
        let grid = simulator.telescope().pupil.grid;
        for ((y, x), sigma_nm) in unsure.ncpa_sigma_nm.indexed_iter().filter(|(_, nm)| nm.is_finite()) {
            let more_nm = (sigma_nm.powi(2) - sure.ncpa_sigma_nm[[y, x]].powi(2)).sqrt();
            let shown_nm = fraction * diversity.at(grid.coordinate_m(x), grid.coordinate_m(y)).abs();
            assert!((more_nm - shown_nm).abs() < 0.01 * fraction * rms_nm, "{more_nm} {shown_nm}");
        }
        let shared_nm = (unsure.expected_nm[1].powi(2) - sure.expected_nm[1].powi(2)).sqrt();
        assert!((shared_nm / (fraction * rms_nm) - 1.0).abs() < 0.01, "{shared_nm}");
        assert_eq!(unsure.expected_nm[0], sure.expected_nm[0]);

        // Twice what is averaged moved, which is a tenth of the error bar.
        unsure.changed_nm = [0.0, 2.0 * unsure.averaged_nm[1]];
        assert!(unsure.moved(0.25) && unsure.changed_nm[1] < unsure.expected_nm[1]);
        // Four times the images halve what is averaged, and nothing the rest.
        let half_nm = [f64::INFINITY, shared_nm.hypot(sure.expected_nm[1] / 2.0)];
        let count = unsure.used_images.len();
        // Rounded up, from a difference of squares.
        assert!((3 * count..=3 * count + 1).contains(&unsure.further_images(half_nm).unwrap()));
        let sentence = unsure.further_images([f64::INFINITY, 0.9 * shared_nm]).unwrap_err().to_string();
        assert!(sentence.contains("out of reach"), "{sentence}");

        // NCPA that no mode describes are in the error bars of theirs alone, and no number of images takes them out.
        let mut beyond = sure.clone();
        beyond.go_beyond(50.0);
        assert_eq!((beyond.expected_nm[0], beyond.averaged_nm), (sure.expected_nm[0], sure.averaged_nm));
        assert_eq!(beyond.expected_nm[1], sure.expected_nm[1].hypot(50.0));
        for (wider_nm, sigma_nm) in beyond.ncpa_sigma_nm.iter().zip(&sure.ncpa_sigma_nm) {
            assert!(wider_nm.is_nan() && sigma_nm.is_nan() || *wider_nm == sigma_nm.hypot(50.0));
        }
        assert!(beyond.further_images([f64::INFINITY, 49.0]).is_err());

        // Do no harm: the focus is under its error bar, and nothing else is.
        let corrected = |pass: &Pass| Commands::of(known, pass, None).unwrap();
        let [all, but_focus] = [&sure, &unsure].map(corrected);
        assert_eq!(all.corrected_modes, but_focus.corrected_modes + 1);
        assert_eq!(all.pistons_nm, but_focus.pistons_nm);
    }
}
