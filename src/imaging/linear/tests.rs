//! Tests of the linear model.

use super::*;
use crate::fourier::PixelResponse;
use crate::imaging::{Colour, Mode, OpticsParts};
use crate::pupil::SegmentWeights;
use ndarray::Array1;
use std::sync::Arc;

/// Nine segments in a square of 27×27 samples of 30, each of which overlaps its neighbours by
/// one sample, and a smooth mode over all of them.
fn optics(tilts: bool, colours: &[Colour], pixel: [PixelResponse; 2]) -> Arc<Optics> {
    let (n, m, side) = (30, 14, 9);
    let (mut illuminated, mut offsets, mut segment, mut weight) = (Vec::new(), vec![0], Vec::new(), Vec::new());
    for (y, x) in (0..27).flat_map(|y| (0..27).map(move |x| (y, x))) {
        illuminated.push((n * (y + 1) + x + 2) as u32);
        for s in 0..9 {
            let (top, left) = ((s / 3 * side) as i32, (s % 3 * side) as i32);
            let inside = |at: i32, first: i32| (first - 1..first + 10).contains(&at);
            if inside(y as i32, top) && inside(x as i32, left) {
                segment.push(s as u32);
                weight.push(0.4 + 0.3 * ((x * 7 + y * 3 + s) as f64).sin());
            }
        }
        offsets.push(weight.len() as u32);
    }
    let slope = |seed: f64| (0..weight.len()).map(|i| (seed * i as f64).cos()).collect::<Vec<f64>>();
    let modes_of = |s| if tilts { vec![Mode::Piston(s), Mode::Tip(s), Mode::Tilt(s)] } else { vec![Mode::Piston(s)] };
    let parts = OpticsParts {
        products: None,
        sampling: Sampling::new(n, m, 1.9).unwrap(),
        wavelength_nm: 2000.0,
        colours: colours.to_vec(),
        pixel,
        diversity_nm: (0..illuminated.len()).map(|p| 900.0 * (0.02 * p as f64).sin()).collect(),
        basis: Array2::from_shape_fn((1, illuminated.len()), |(_, p)| (0.05 * p as f64).cos()),
        modes: (0..9).flat_map(modes_of).chain([Mode::Smooth(0)]).collect(),
        slopes: Some((slope(0.3), slope(0.7))),
        weights: SegmentWeights {
            segments: 9,
            energy: weight.iter().map(|w| w * w).sum(),
            illuminated,
            offsets,
            segment,
            weight,
        },
    };
    Arc::new(Optics::new(parts).unwrap())
}

/// Derivatives from boxes and from the whole pupil agree, all rows at once and in tiles.
#[test]
fn derivatives_in_tiles_agree_with_those_of_the_whole_image() {
    let three = [(0.95, 0.3), (1.0, 0.4), (1.04, 0.3)].map(|(ratio, share)| Colour { ratio, share });
    let alone = [Colour::MONOCHROMATIC];
    let points = [PixelResponse::POINT; 2];
    let squares = [1.0, 0.6].map(|width_pixels| PixelResponse { width_pixels, diffusion_pixels: 0.1 });
    for (tilts, colours, pixel) in [
        (false, &alone[..], points),
        (true, &alone, points),
        (false, &three, points),
        (true, &three, points),
        (true, &three, squares),
    ] {
        let chain = CpuChain::<f64>::new(optics(tilts, colours, pixel));
        let modes = chain.optics().modes();
        let at = ndarray::Array1::from_shape_fn(modes, |i| 60.0 * (i as f64 * 1.7).sin());
        let mut linear = chain.linearise(at.view());
        assert!((0..9).all(|segment| linear.is_small(segment)), "the test needs segments with small boxes");
        let (psf, wanted) = chain.jacobian(at.view());
        let (m, peak) = (linear.pixels(), wanted.iter().fold(0.0f64, |m, v| m.max(v.abs())));
        // Sums of some thousand products, in another order: 1e-13 of the largest leaves an
        // order of magnitude.
        let same = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-13 * scale;
        let brightest = psf.iter().copied().fold(0.0, f64::max);
        assert!(linear.psf().iter().zip(&psf).all(|(a, b)| same(*a, *b, brightest)));
        // The PSF is of second degree in the amplitudes, so that the difference between one and
        // a half and a half of one is its derivative.
        for (changed, found) in linear.by_amplitudes().outer_iter().enumerate() {
            let with_factor = |factor: f64| {
                let mut parts = chain.optics().parts().clone();
                let entries = parts.weights.segment.iter().zip(&mut parts.weights.weight);
                entries.filter(|(own, _)| **own == changed as u32).for_each(|(_, weight)| *weight *= factor);
                CpuChain::<f64>::new(Arc::new(Optics::new(parts).unwrap())).psf(at.view())
            };
            let pairs = with_factor(1.5).into_iter().zip(with_factor(0.5));
            assert!(pairs.zip(found).all(|((more, less), found)| same(*found, more - less, brightest)), "{tilts}");
        }
        let image: Vec<f64> = (0..m * m).map(|pixel| (0.7 * pixel as f64).cos()).collect();
        let dotted = |columns: &Array2<f64>| columns.dot(&ArrayView1::from(&image)).to_vec();
        let by_amplitudes = dotted(&linear.by_amplitudes());
        // Sums over m² pixels of derivatives up to the largest.
        for ((wanted, scale), found) in
            [(dotted(&wanted), peak), (by_amplitudes, brightest)].iter().zip(linear.products(&image))
        {
            let pairs = found.iter().zip(wanted);
            assert!(pairs.clone().all(|(a, b)| same(*a, *b, scale * (m * m) as f64)), "{tilts} {found:?} {wanted:?}");
            assert_eq!(pairs.len(), found.len());
        }
        for tile in [m, 5, 1] {
            for first in (0..m).step_by(tile) {
                let rows = first..m.min(first + tile);
                let mut found = Array2::from_elem((modes, rows.len() * m), f64::NAN);
                linear.derivatives(rows.clone(), found.view_mut());
                let wanted = wanted.slice(ndarray::s![.., rows.start * m..rows.end * m]);
                assert!(found.iter().zip(wanted).all(|(a, b)| same(*a, *b, peak)), "{tilts} {rows:?}");
            }
        }
    }
}

/// A figure is a tip whose slopes are its shape, where no segment has a tip; that of two
/// segments is the sum of both.
#[test]
fn figures_of_segments_are_tips_of_their_shapes() {
    let three = [(0.95, 0.3), (1.0, 0.4), (1.04, 0.3)].map(|(ratio, share)| Colour { ratio, share });
    let chain = CpuChain::<f64>::new(optics(true, &three, [PixelResponse::POINT; 2]));
    let (parts, terms) = (chain.optics().parts(), [0.3, -0.2, 0.5, 0.1]);
    let is_tip = |mode: &Mode| matches!(mode, Mode::Tip(_) | Mode::Tilt(_));
    let at: Array1<f64> =
        (parts.modes.iter().zip(0..)).map(|(mode, i)| if is_tip(mode) { 0.0 } else { 9.0 * f64::from(i) }).collect();
    let (xs, ys) = parts.slopes.clone().unwrap();
    let [a, b, c, d] = terms;
    let shape = xs.iter().zip(&ys).map(|(x, y)| a * x * x + b * y * y + c * x * y + d).collect();
    let shaped = Optics::new(OpticsParts { slopes: Some((shape, ys)), ..parts.clone() }).unwrap();
    let (m, modes) = (parts.sampling.pixels, parts.modes.len());
    let wanted = CpuChain::<f64>::new(Arc::new(shaped)).jacobian(at.view()).1;
    let tip = |segment| {
        let place = parts.modes.iter().position(|mode| matches!(mode, Mode::Tip(own) if *own == segment)).unwrap();
        wanted.row(place).to_owned()
    };
    let figure = |segment| SegmentFigure { segment, terms };
    let mut linear = chain.linearise(at.view()).with_figures(&[vec![figure(4)], vec![figure(1), figure(7)]]);
    let mut found = Array2::zeros((linear.unknowns(), m * m));
    linear.derivatives(0..m, found.view_mut());
    let image: Vec<f64> = (0..m * m).map(|pixel| (0.7 * pixel as f64).cos()).collect();
    let products = linear.products(&image)[0].clone();
    for (row, wanted) in [(modes, tip(4)), (modes + 1, tip(1) + tip(7))] {
        let peak = wanted.iter().fold(0.0f64, |most, value| most.max(value.abs()));
        // As above.
        assert!(found.row(row).iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-13 * peak), "{row}");
        let product = wanted.dot(&Array1::from(image.clone()));
        assert!((products[row] - product).abs() < 1e-13 * peak * (m * m) as f64, "{row}");
    }
}

/// The PSF is of second degree in the amplitudes: see the test of those of the segments.
#[test]
fn patterns_of_the_light_are_changes_of_the_amplitude() {
    let three = [(0.95, 0.3), (1.0, 0.4), (1.04, 0.3)].map(|(ratio, share)| Colour { ratio, share });
    for tilts in [false, true] {
        let chain = CpuChain::<f64>::new(optics(tilts, &three, [PixelResponse::POINT; 2]));
        let (parts, modes) = (chain.optics().parts(), chain.optics().modes());
        let at = Array1::from_shape_fn(modes, |i| 60.0 * (i as f64 * 1.7).sin());
        let with_light = |amount: f64| {
            let mut parts = parts.clone();
            for (sample, ends) in parts.weights.offsets.windows(2).enumerate() {
                let factor = 1.0 + amount * parts.basis[[0, sample]];
                let own = &mut parts.weights.weight[ends[0] as usize..ends[1] as usize];
                own.iter_mut().for_each(|weight| *weight *= factor);
            }
            Array1::from(CpuChain::<f64>::new(Arc::new(Optics::new(parts).unwrap())).psf(at.view()))
        };
        let wanted = with_light(0.5) - with_light(-0.5);
        let mut linear = chain.linearise(at.view()).with_light(0..1);
        let m = parts.sampling.pixels;
        let mut found = Array2::zeros((linear.unknowns(), m * m));
        linear.derivatives(0..m, found.view_mut());
        let peak = wanted.iter().fold(0.0f64, |most, value| most.max(value.abs()));
        // As above.
        assert!(found.row(modes).iter().zip(&wanted).all(|(a, b)| (a - b).abs() < 1e-13 * peak), "{tilts}");
        let image: Vec<f64> = (0..m * m).map(|pixel| (0.7 * pixel as f64).cos()).collect();
        let product = wanted.dot(&Array1::from(image.clone()));
        assert!((linear.products(&image)[0][modes] - product).abs() < 1e-13 * peak * (m * m) as f64, "{tilts}");
    }
}
