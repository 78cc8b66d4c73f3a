//! Gradient against central differences, and Jacobian against the adjoint, on a small case without
//! symmetry: overlapping segment weights, an off-centre pupil, bad pixels, images wider and
//! narrower than the pupil.

#[cfg(all(feature = "opencl", debug_assertions))]
mod fallback;
mod free_phase;
#[cfg(target_arch = "x86_64")]
mod subnormal;

use super::*;
use crate::fourier::{PixelResponse, Sampling, Transform};
use crate::grid::Grid;
use crate::modes::{Mirror, SeparableBasis, SmoothBasis, Zernikes};
use crate::pupil::SegmentWeights;
use approx::assert_relative_eq;
use ndarray::{Array1, Array2};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

fn random(count: usize, scale: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    (0..count).map(|_| scale * (2.0 * rng.random::<f64>() - 1.0)).collect()
}

/// Three overlapping segments on an asymmetric pupil, two smooth modes, every kind of mode.
fn optics(samples: usize, pixels: usize, per_lambda_over_d: f64) -> Arc<Optics> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let illuminated: Vec<u32> = (0..(samples * samples) as u32).filter(|p| p % 7 != 0 && p % 5 != 1).collect();
    let (mut offsets, mut segment, mut weight) = (vec![0], Vec::new(), Vec::new());
    for &p in &illuminated {
        for s in 0..3 {
            if (p + s) % 3 != 0 {
                segment.push(s);
                weight.push(rng.random::<f64>() - 0.2);
            }
        }
        offsets.push(weight.len() as u32);
    }
    let (count, entries) = (illuminated.len(), weight.len());
    let energy = weight.iter().map(|w| w * w).sum();
    let slopes = Some((random(entries, 1.7, &mut rng), random(entries, 1.7, &mut rng)));
    let mut modes: Vec<Mode> = (0..3).flat_map(|s| [Mode::Piston(s), Mode::Tip(s), Mode::Tilt(s)]).collect();
    modes.extend([Mode::Smooth(1), Mode::Smooth(0)]);
    Arc::new(
        Optics::new(OpticsParts {
            sampling: Sampling::new(samples, pixels, per_lambda_over_d).unwrap(),
            wavelength_nm: 2168.6,
            colours: vec![Colour::MONOCHROMATIC],
            pixel: [PixelResponse::POINT; 2],
            weights: SegmentWeights { segments: 3, illuminated, offsets, segment, weight, energy },
            slopes,
            diversity_nm: random(count, 4000.0, &mut rng),
            basis: Array2::from_shape_vec((2, count), random(2 * count, 2.0, &mut rng)).unwrap(),
            products: None,
            modes,
        })
        .unwrap(),
    )
}

/// The same model with three wavelengths.
fn in_colours(optics: &Optics) -> Arc<Optics> {
    let colours = [(0.9, 0.3), (1.0, 0.45), (1.12, 0.25)].map(|(ratio, share)| Colour { ratio, share }).to_vec();
    Arc::new(Optics::new(OpticsParts { colours, ..optics.parts().clone() }).unwrap())
}

/// The same model with pixels that have an area.
fn with_area(optics: &Optics) -> Arc<Optics> {
    let pixel = [(1.0, 0.0), (0.7, 0.3)]
        .map(|(width_pixels, diffusion_pixels)| PixelResponse { width_pixels, diffusion_pixels });
    Arc::new(Optics::new(OpticsParts { pixel, ..optics.parts().clone() }).unwrap())
}

fn exposures(pixels: usize) -> Vec<Exposure> {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let photometries = [
        Photometry::Fixed { flux_e: 3e4, background_e: 2.0 },
        Photometry::FitFlux { background_e: 1.0 },
        Photometry::FitBoth,
    ];
    photometries
        .map(|photometry| Exposure {
            data_e: (0..pixels * pixels).map(|i| 100.0 * rng.random::<f64>() + (i % 11) as f64).collect(),
            // One pixel in nine is bad.
            weight: (0..pixels * pixels).map(|i| if i % 9 == 4 { 0.0 } else { 0.01 + rng.random::<f64>() }).collect(),
            photometry,
        })
        .to_vec()
}

fn coefficients(images: usize, modes: usize) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    Array2::from_shape_vec((images, modes), random(images * modes, 150.0, &mut rng)).unwrap()
}

#[test]
fn the_gradient_is_the_central_difference() {
    for (samples, pixels, q) in [(10, 14, 1.9), (12, 8, 2.0), (8, 16, 2.0)] {
        let one = optics(samples, pixels, q);
        let fft = |sampling| Transform::fft(sampling).unwrap_or_else(|| Transform::matrix(sampling));
        let three = in_colours(&one);
        let ways: [(_, &dyn Fn(Sampling) -> Transform<f64>); 4] =
            [(&one, &Transform::matrix), (&one, &fft), (&three, &fft), (&with_area(&three), &Transform::matrix)];
        for (optics, transform) in ways {
            let mut chain = CpuChain::<f64>::with_transforms(optics.clone(), transform);
            chain.load(&exposures(pixels)).unwrap();
            let c = coefficients(3, optics.modes());
            let at = chain.evaluate(&[0, 1, 2], c.view()).unwrap();
            // Truncation of the central difference is (2πh/λ·mode)²/6 ≈ 1e-9 of the gradient's size
            // at h = 0.01 nm (modes reach 2); rounding is 2e-16·J/h, about 1e-9 of the gradient
            // too. 1e-6 of its norm bounds both.
            let h = 0.01;
            for (image, at) in at.iter().enumerate() {
                let norm = Array1::from(at.gradient.clone()).mapv(|g| g * g).sum().sqrt();
                for mode in 0..optics.modes() {
                    let shifted = |by: f64| {
                        let mut c = c.slice(ndarray::s![image..=image, ..]).to_owned();
                        c[[0, mode]] += by;
                        chain.evaluate(&[image], c.view()).unwrap()[0].objective
                    };
                    let difference = (shifted(h) - shifted(-h)) / (2.0 * h);
                    let error = (difference - at.gradient[mode]).abs();
                    assert!(error < 1e-6 * norm, "image {image} mode {mode}: {error:e} of {norm:e}");
                }
            }
        }
    }
}

#[test]
fn the_jacobian_and_the_gradient_are_adjoint() {
    let points = optics(10, 14, 1.9);
    jacobian_and_gradient_are_adjoint(with_area(&points));
    jacobian_and_gradient_are_adjoint(points);
}

fn jacobian_and_gradient_are_adjoint(optics: Arc<Optics>) {
    let mut chain = CpuChain::<f64>::new(optics.clone());
    let exposures = exposures(14);
    chain.load(&exposures).unwrap();
    let c = coefficients(3, optics.modes());
    let evaluations = chain.evaluate(&[0, 1, 2], c.view()).unwrap();
    for (image, evaluation) in evaluations.iter().enumerate() {
        let (psf, jacobian) = chain.jacobian(c.row(image));
        let residual: Array1<f64> = (0..psf.len())
            .map(|i| {
                let model = evaluation.flux_e * psf[i] + evaluation.background_e;
                2.0 * evaluation.flux_e * exposures[image].weight[i] * (model - exposures[image].data_e[i])
            })
            .collect();
        let gradient = jacobian.dot(&residual);
        // Sums of 196 products with both signs: 1e-16 times the sum of sizes; 1e-12 of the norm
        // leaves a wide margin.
        let norm = gradient.mapv(|g| g * g).sum().sqrt();
        for (a, b) in gradient.iter().zip(&evaluation.gradient) {
            assert!((a - b).abs() < 1e-12 * norm, "{a} {b}");
        }
    }
}

#[test]
fn fitted_photometry_minimises_the_objective() {
    let optics = optics(10, 14, 1.9);
    let mut chain = CpuChain::<f64>::new(optics.clone());
    let c = coefficients(1, optics.modes());
    let mut exposure = exposures(14).remove(2);
    chain.load(&[exposure.clone()]).unwrap();
    let best = chain.evaluate(&[0], c.view()).unwrap().remove(0);
    for (flux, background) in [(1.001, 1.0), (0.999, 1.0), (1.0, 1.001), (1.0, 0.999)] {
        let (flux_e, background_e) = (best.flux_e * flux, best.background_e * background);
        exposure.photometry = Photometry::Fixed { flux_e, background_e };
        chain.replace(0, &exposure).unwrap();
        assert!(chain.evaluate(&[0], c.view()).unwrap()[0].objective > best.objective);
    }
}

#[test]
fn single_precision_agrees_and_batches_have_equal_bits() {
    let optics = optics(12, 16, 2.0);
    let (mut wide, mut narrow) = (CpuChain::<f64>::new(optics.clone()), CpuChain::<f32>::new(optics.clone()));
    wide.load(&exposures(16)).unwrap();
    narrow.load(&exposures(16)).unwrap();
    let c = coefficients(3, optics.modes());
    let (a, b) = (wide.evaluate(&[0, 1, 2], c.view()).unwrap(), narrow.evaluate(&[0, 1, 2], c.view()).unwrap());
    for (a, b) in a.iter().zip(&b) {
        // The required accuracy in f32: 1e-5 for objective and gradient.
        assert!((a.objective - b.objective).abs() < 1e-5 * a.objective);
        let (mut error, mut norm) = (0.0, 0.0);
        for (a, b) in a.gradient.iter().zip(&b.gradient) {
            (error, norm) = (error + (a - b).powi(2), norm + a * a);
        }
        assert!(error.sqrt() < 1e-5 * norm.sqrt(), "{:e}", (error / norm).sqrt());
    }
    for (image, batch) in a.iter().enumerate() {
        let alone = wide.evaluate(&[image], c.slice(ndarray::s![image..=image, ..])).unwrap();
        assert_eq!(alone[0].objective.to_bits(), batch.objective.to_bits());
        assert_eq!(alone[0].gradient, batch.gradient);
    }
}

#[test]
fn evaluations_with_a_reused_psf_are_bitwise_the_same() {
    fn compare<T: Polynomial>() {
        let chain = CpuChain::<T>::new(optics(12, 10, 2.2));
        let (mut scratch, mut flat) = (chain.scratch(), chain.flat_wavefront());
        let bits = |found: &Evaluation| {
            let gradient: Vec<u64> = found.gradient.iter().map(|g| g.to_bits()).collect();
            (found.objective.to_bits(), found.flux_e.to_bits(), found.background_e.to_bits(), gradient)
        };
        let places = [coefficients(1, 11).row(0).to_owned(), Array1::zeros(11)];
        // The second image uses the scratch memory of the first.
        for exposure in &exposures(10) {
            let mut image = chain.empty_image();
            chain.set(&mut image, exposure).unwrap();
            let mut found = chain.evaluation();
            let [_, expected] = places.each_ref().map(|place| {
                let mut expected = chain.evaluation();
                chain.evaluate_one(&image, place.view(), &mut scratch, &mut expected);
                chain.psf_in(place.view(), &mut scratch);
                chain.evaluate_at_last_psf(&image, &mut scratch, &mut found);
                assert_eq!(bits(&found), bits(&expected));
                expected
            });
            chain.evaluate_flat(&image, &mut flat, &mut found);
            assert_eq!(bits(&found), bits(&expected));
        }
    }
    compare::<f32>();
    compare::<f64>();
}

/// Compared with the sum of monochromatic models.
#[test]
fn images_of_several_wavelengths_add() {
    let optics = in_colours(&optics(12, 14, 1.9));
    let c = coefficients(1, optics.modes()).row(0).to_owned();
    let mut sum = vec![0.0; 14 * 14];
    for colour in &optics.parts().colours {
        let alone = OpticsParts {
            sampling: Sampling::new(12, 14, 1.9 * colour.ratio).unwrap(),
            wavelength_nm: 2168.6 * colour.ratio,
            colours: vec![Colour::MONOCHROMATIC],
            ..optics.parts().clone()
        };
        let psf = CpuChain::<f64>::new(Arc::new(Optics::new(alone).unwrap())).psf(c.view());
        sum.iter_mut().zip(psf).for_each(|(sum, psf)| *sum += colour.share * psf);
    }
    let psf = CpuChain::<f64>::new(optics.clone()).psf(c.view());
    let peak = psf.iter().copied().fold(0.0, f64::max);
    // Rounding of sums of a hundred terms.
    assert!(psf.iter().zip(&sum).all(|(a, b)| (a - b).abs() < 1e-13 * peak));
    let parts = optics.parts();
    for colours in [vec![], vec![Colour { ratio: 1.0, share: 0.5 }], vec![Colour { ratio: -1.0, share: 1.0 }]] {
        assert!(Optics::new(OpticsParts { colours, ..parts.clone() }).is_err());
    }
}

/// Pixels with an area have the mean of a finely sampled PSF over it.
#[test]
fn pixels_gather_light_over_their_area() {
    // 31² points a pixel: their mean differs from the integral by (π/31)²/24 = 4e-4 of the highest
    // frequencies.
    let (pixels, points) = (40, 31);
    let fine = optics(24, pixels * points, 2.0 * points as f64);
    let coarse = Sampling::new(24, pixels, 2.0).unwrap();
    let square = PixelResponse { width_pixels: 1.0, diffusion_pixels: 0.0 };
    let parts = OpticsParts { sampling: coarse, ..fine.parts().clone() };
    let area = Arc::new(Optics::new(OpticsParts { pixel: [square; 2], ..parts.clone() }).unwrap());
    let at = coefficients(1, fine.modes());
    let psf = |optics| CpuChain::<f64>::with_transforms(optics, Transform::matrix).psf(at.row(0));
    let (fine, area, centres) = (psf(fine), psf(area), psf(Arc::new(Optics::new(parts).unwrap())));
    let mean = |v: usize, u: usize| {
        let first = |at: usize| points * at - points / 2;
        let rows = (0..points).map(|y| (first(v) + y) * pixels * points + first(u));
        // The flux in a sample goes with its area.
        rows.map(|row| fine[row..row + points].iter().sum::<f64>()).sum::<f64>()
    };
    // Beyond the reach of the convolution from the border, where the image is continued by its
    // mirror image.
    let inside = || (12..28).flat_map(|v| (12..28).map(move |u| (v, u)));
    let rms = |of: &dyn Fn(usize, usize) -> f64| inside().map(|(v, u)| of(v, u).powi(2)).sum::<f64>().sqrt();
    let error = rms(&|v, u| area[v * pixels + u] - mean(v, u)) / rms(&|v, u| mean(v, u));
    let blur = rms(&|v, u| centres[v * pixels + u] - mean(v, u)) / rms(&|v, u| mean(v, u));
    println!("error {error:.1e}, of pixels that are points {blur:.1e}");
    // A square pupil has more contrast at high frequencies than the circle for which the
    // convolution is computed: some 4e-4.
    assert!(error < 1e-3 && blur > 0.05, "{error:e} {blur:e}");
}

#[test]
fn a_wavefront_that_grows_along_x_moves_the_spot_along_columns() {
    let (samples, pixels) = (16, 16);
    let illuminated: Vec<u32> = (0..256).collect();
    let tilt: Vec<f64> = illuminated.iter().map(|p| f64::from(p % 16) - 7.5).collect();
    let optics = Optics::new(OpticsParts {
        sampling: Sampling::new(samples, pixels, 2.0).unwrap(),
        wavelength_nm: 1000.0,
        colours: vec![Colour::MONOCHROMATIC],
        pixel: [PixelResponse::POINT; 2],
        weights: SegmentWeights {
            segments: 1,
            offsets: (0..=256).collect(),
            segment: vec![0; 256],
            weight: vec![1.0; 256],
            energy: 256.0,
            illuminated,
        },
        slopes: None,
        diversity_nm: vec![0.0; 256],
        basis: Array2::from_shape_vec((1, 256), tilt).unwrap(),
        products: None,
        modes: vec![Mode::Smooth(0)],
    })
    .unwrap();
    let chain = CpuChain::<f64>::new(Arc::new(optics));
    // Three pixels: 3 turns over the 32 samples of the padded grid.
    let psf = chain.psf(Array1::from(vec![3.0 * 1000.0 / 32.0]).view());
    let brightest = (0..256).max_by(|&a, &b| psf[a].total_cmp(&psf[b])).unwrap();
    assert_eq!((brightest / 16, brightest % 16), (8, 11));
}

#[test]
fn arguments_that_do_not_fit_are_refused() {
    let optics = optics(8, 6, 2.0);
    let mut chain = CpuChain::<f64>::new(optics.clone());
    assert!(chain.load(&exposures(8)).is_err());
    chain.load(&exposures(6)).unwrap();
    assert!(chain.evaluate(&[3], coefficients(1, optics.modes()).view()).is_err());
    assert!(chain.evaluate(&[0], coefficients(1, 2).view()).is_err());
    let mut parts = optics.parts().clone();
    parts.modes.push(Mode::Smooth(2));
    assert!(Optics::new(parts).is_err());
}

#[test]
fn modes_as_products_agree_with_their_maps() {
    let n = 24;
    let optics = optics(n, 20, 2.1);
    let grid = Grid::new(n, 3.0).unwrap();
    // Enough modes that products are fewer operations than maps.
    let zernikes = SmoothBasis::zernike(Zernikes::new(2..=21, 1.6).unwrap());
    let mirror = SmoothBasis::influence(Mirror::new(5, 0.75, 0.15).unwrap().all());
    let basis = zernikes.followed_by(&mirror);
    let mut parts = optics.parts().clone();
    let at = |p: &u32| (grid.coordinate_m(*p as usize % n), grid.coordinate_m(*p as usize / n));
    let (xs, ys): (Vec<f64>, Vec<f64>) = parts.weights.illuminated.iter().map(at).unzip();
    parts.basis = basis.evaluate(&xs, &ys).unwrap();
    parts.modes = (0..basis.len()).map(Mode::Smooth).chain([Mode::Piston(1)]).collect();
    let maps = Arc::new(Optics::new(parts.clone()).unwrap());
    let products = SeparableBasis::new(&basis, grid).unwrap();
    assert!(products.operations() < basis.len() * xs.len());
    parts.products = Some(products);
    let products = Arc::new(Optics::new(parts).unwrap());
    let exposures = exposures(20);
    let at = Array2::from_shape_fn((3, basis.len() + 1), |(i, j)| 60.0 * ((5 * i + 3 * j) as f64).sin());
    fn found<T: Polynomial>(optics: &Arc<Optics>, exposures: &[Exposure], at: &Array2<f64>) -> Vec<Evaluation> {
        let mut chain = CpuChain::<T>::new(optics.clone());
        chain.load(exposures).unwrap();
        chain.evaluate(&[0, 1, 2], at.view()).unwrap()
    }
    let norm = |gradient: &[f64]| gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let expected = found::<f64>(&maps, &exposures, &at);
    // Phases of a few turns, rounded to 1e-16 and 6e-8 of themselves by either way.
    for (found, bound) in
        [(found::<f64>(&products, &exposures, &at), 1e-12), (found::<f32>(&products, &exposures, &at), 1e-4)]
    {
        for (found, expected) in found.iter().zip(&expected) {
            assert_relative_eq!(found.objective, expected.objective, max_relative = bound);
            let difference: Vec<f64> = found.gradient.iter().zip(&expected.gradient).map(|(a, b)| a - b).collect();
            assert!(norm(&difference) < bound * norm(&expected.gradient), "{bound}");
        }
    }
}
