//! Gradients by the free phase and by the amplitudes of the segments.

use super::*;

/// Logarithms of the amplitudes of the segments: central differences, one by one, with a free
/// phase.
#[test]
fn the_gradient_in_the_amplitudes_is_exact() {
    let tilting = optics(12, 14, 1.9);
    assert!(!CpuChain::<f64>::new(tilting.clone()).has_amplitudes());
    let mut parts = tilting.parts().clone();
    parts.modes = vec![Mode::Piston(0), Mode::Piston(1), Mode::Piston(2), Mode::Smooth(0)];
    parts.slopes = None;
    let one = Arc::new(Optics::new(parts).unwrap());
    amplitudes_are_exact(in_colours(&one));
    amplitudes_are_exact(one);
}

fn amplitudes_are_exact(optics: Arc<Optics>) {
    let chain = CpuChain::<f64>::new(optics.clone());
    assert!(chain.has_amplitudes());
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let illuminated = optics.parts().weights.illuminated.len();
    let (free, c) = (random(illuminated, 0.3, &mut rng), coefficients(1, optics.modes()).row(0).to_owned());
    let ln = random(3, 0.2, &mut rng);
    for exposure in &exposures(14) {
        let mut image = chain.empty_image();
        chain.set(&mut image, exposure).unwrap();
        let at = |ln: &[f64]| -> (f64, [f64; 3]) {
            let (mut evaluation, mut scratch) = (chain.evaluation(), chain.scratch());
            let (mut unused, mut gradient) = (vec![0.0; illuminated], [f64::NAN; 3]);
            scratch.set_amplitudes(ln.iter().map(|ln| ln.exp()));
            let at = FreeWavefront { coefficients_nm: c.view(), turns: &free };
            chain.evaluate_free(&image, at, &mut scratch, &mut evaluation, &mut unused);
            chain.amplitude_gradient(&scratch, &mut gradient);
            (evaluation.objective, gradient)
        };
        let gradient = at(&ln).1;
        let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        for segment in 0..3 {
            // As in the modes' test: truncation h²/6 = 2e-11 of the third derivative, rounding
            // 2e-16·J/h = 2e-11·J.
            let h = 1e-5;
            let shifted = |by: f64| {
                let mut ln = ln.clone();
                ln[segment] += by;
                at(&ln).0
            };
            let difference = (shifted(h) - shifted(-h)) / (2.0 * h);
            assert!((difference - gradient[segment]).abs() < 1e-6 * norm, "{difference} {gradient:?}");
        }
        // A common amplitude of all segments is degenerate with a fitted flux, and not with a fixed
        // one.
        let together: f64 = gradient.iter().sum();
        let fixed = matches!(exposure.photometry, Photometry::Fixed { .. });
        assert_eq!(together.abs() > 1e-9 * norm, fixed, "{together} of {norm}");
    }
}

/// Free phase: central differences along random directions, the evaluation without free phase, and
/// single precision.
#[test]
fn the_gradient_in_the_free_phase_is_exact() {
    fn at<T: Polynomial>(
        optics: &Arc<Optics>,
        exposure: &Exposure,
        c: &Array1<f64>,
        free: &[f64],
    ) -> (Evaluation, Vec<f64>) {
        let chain = CpuChain::<T>::new(optics.clone());
        let (mut image, mut evaluation, mut scratch) = (chain.empty_image(), chain.evaluation(), chain.scratch());
        chain.set(&mut image, exposure).unwrap();
        let free: Vec<T> = free.iter().map(|&v| T::narrow(v)).collect();
        let mut gradient = vec![T::nan(); free.len()];
        let at = FreeWavefront { coefficients_nm: c.view(), turns: &free };
        chain.evaluate_free(&image, at, &mut scratch, &mut evaluation, &mut gradient);
        (evaluation, gradient.iter().map(|g| g.widen()).collect())
    }
    let one = optics(12, 14, 1.9);
    let (exposures, c) = (exposures(14), coefficients(1, one.modes()).row(0).to_owned());
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let illuminated = one.parts().weights.illuminated.len();
    let three = in_colours(&one);
    for (exposure, optics) in exposures.iter().flat_map(|exposure| [(exposure, &one), (exposure, &three)]) {
        let free = random(illuminated, 0.3, &mut rng);
        let (here, gradient) = at::<f64>(optics, exposure, &c, &free);
        let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        for _ in 0..5 {
            let along = random(illuminated, 1.0, &mut rng);
            let slope: f64 = gradient.iter().zip(&along).map(|(g, v)| g * v).sum();
            // As in the modes' test: truncation (2πh)²/6 = 7e-10 at 1e-5 turns, rounding 2e-16·J/h
            // of about the same.
            let h = 1e-5;
            let shifted = |by: f64| -> f64 {
                let free: Vec<f64> = free.iter().zip(&along).map(|(f, v)| f + by * v).collect();
                at::<f64>(optics, exposure, &c, &free).0.objective
            };
            let difference = (shifted(h) - shifted(-h)) / (2.0 * h);
            assert!((difference - slope).abs() < 1e-6 * norm, "{difference} {slope} of {norm}");
        }
        // The required accuracy in f32: 1e-5 for objective and gradient.
        let (narrow, narrow_gradient) = at::<f32>(optics, exposure, &c, &free);
        assert!((narrow.objective / here.objective - 1.0).abs() < 1e-5);
        let error = gradient.iter().zip(&narrow_gradient).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        assert!(error < 1e-5 * norm, "{error:e} of {norm:e}");
        // A free phase of zero gives bitwise the evaluation without it.
        let mut chain = CpuChain::<f64>::new(optics.clone());
        chain.load(std::slice::from_ref(exposure)).unwrap();
        let alone = chain.evaluate(&[0], c.view().insert_axis(ndarray::Axis(0))).unwrap().remove(0);
        let (with, _) = at::<f64>(optics, exposure, &c, &vec![0.0; illuminated]);
        assert_eq!((alone.objective.to_bits(), alone.gradient), (with.objective.to_bits(), with.gradient));
    }
}
