//! Test models for the device, their images, and the reference results as explicit sums in f64.

use num_complex::Complex64;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

use super::super::{GpuColour, GpuLayout, GpuMode, GpuPhotometry};

/// A small asymmetric model that covers the special cases of the packing: extents that are not
/// whole vectors, dark rows and blocks, overlapping segments with weights of either sign, an unused
/// mode.
pub(super) fn scene() -> GpuLayout {
    let (n, segments, smooth): (usize, _, _) = (18, 5, 7);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let illuminated: Vec<usize> = (0..n * n)
        .filter(|i| {
            let (y, x) = (i / n, i % n);
            // Dark: an edge, two corners, and on the axis a whole row and a hole, whose blocks must
            // be zeroed.
            let hole = y.abs_diff(8).min(y.abs_diff(9)) < 3 && x.abs_diff(8).min(x.abs_diff(9)) < 4;
            !matches!(y, 8 | 9)
                && !hole
                && y > 1
                && x < 17
                && (y + x) < 29
                && !(x < 5 && y > 9)
                && random.random::<f64>() < 0.9
        })
        .collect();
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let (mut segment_start, mut segment_index, mut segment_weight) = (vec![0], Vec::new(), Vec::new());
    for (p, index) in illuminated.iter().enumerate() {
        for s in 0..1 + p % 3 {
            segment_index.push((index / 70 + s) % segments);
            segment_weight.push(if s == 0 { uniform(0.5, 1.0) } else { uniform(-0.2, 0.2) });
        }
        segment_start.push(segment_index.len());
    }
    let diversity_turns = illuminated.iter().map(|_| uniform(-3.0, 3.0)).collect();
    let smooth: Vec<Vec<f64>> = (0..smooth).map(|_| illuminated.iter().map(|_| uniform(-1.5, 1.5)).collect()).collect();
    let mut modes: Vec<GpuMode> = (0..segments).map(GpuMode::Segment).collect();
    modes.splice(2..2, (0..smooth.len() - 1).rev().map(GpuMode::Smooth));
    GpuLayout {
        samples: n,
        pixels: 22,
        colours: vec![GpuColour {
            samples_per_lambda_over_d: 1.3,
            wavelength_nm: 1650.0,
            intensity_scale: 2.5e-5,
            diversity_turns,
        }],
        pixel_terms: None,
        illuminated,
        smooth,
        segments,
        segment_start,
        segment_index,
        segment_weight,
        segment_slopes: None,
        modes,
        free_phase: false,
        free_wavelength_nm: 1650.0,
    }
}

/// The same with some segments that tilt, one of them along one axis only.
pub(super) fn tilted_scene() -> GpuLayout {
    let mut layout = scene();
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut slopes = || layout.segment_index.iter().map(|_| 4.0 * random.random::<f64>() - 2.0).collect();
    layout.segment_slopes = Some((slopes(), slopes()));
    layout.modes.splice(4..4, [GpuMode::Tilt(2), GpuMode::Tip(0), GpuMode::Tip(2), GpuMode::Tilt(4), GpuMode::Tip(4)]);
    layout
}

/// The same with a free phase.
pub(super) fn free_scene() -> GpuLayout {
    GpuLayout { free_phase: true, ..scene() }
}

/// The same with three wavelengths and pixels with an area.
pub(super) fn camera_scene() -> GpuLayout {
    let mut layout = free_scene();
    let first = layout.colours[0].clone();
    layout.colours = [0.9, 1.0, 1.2]
        .map(|ratio| GpuColour {
            samples_per_lambda_over_d: ratio * first.samples_per_lambda_over_d,
            wavelength_nm: ratio * first.wavelength_nm,
            intensity_scale: first.intensity_scale / 3.0,
            diversity_turns: first.diversity_turns.iter().map(|turns| turns / ratio).collect(),
        })
        .to_vec();
    layout.pixel_terms = Some([vec![0.8, 0.13, -0.03], vec![0.9, 0.05, 0.0]]);
    layout
}

/// A free phase of up to ±0.5 turns for each of `images`; empty where the layout has none.
pub(super) fn free_phases(layout: &GpuLayout, images: usize, random: &mut impl Rng) -> Vec<f64> {
    let count = if layout.free_phase { images * layout.illuminated.len() } else { 0 };
    (0..count).map(|_| random.random::<f64>() - 0.5).collect()
}

/// The layout with the free phase of one image added to its diversity.
pub(super) fn with_free(layout: &GpuLayout, free: &[f64]) -> GpuLayout {
    let mut with = layout.clone();
    for colour in &mut with.colours {
        let scale = layout.free_wavelength_nm / colour.wavelength_nm;
        colour.diversity_turns.iter_mut().zip(free).for_each(|(turns, free)| *turns += scale * free);
    }
    with
}

/// Simulated images of the model, with bad pixels (NaN) and uneven weights.
pub(super) struct Images {
    pub(super) data: Vec<f64>,
    pub(super) weights: Vec<f64>,
    pub(super) photometry: Vec<GpuPhotometry>,
}

pub(super) fn images(layout: &GpuLayout, count: usize, random: &mut impl Rng) -> Images {
    let size = layout.pixels * layout.pixels;
    let (mut data, mut weights, mut photometry) = (Vec::new(), Vec::new(), Vec::new());
    for image in 0..count {
        let truth = coefficients(layout, 1, random);
        for (i, h) in psf(layout, &truth).iter().enumerate() {
            let bad = (i + image) % 53 == 0;
            data.push(if bad { f64::NAN } else { 4e4 * h + 12.0 + random.random::<f64>() * 20.0 });
            weights.push(if bad { 0.0 } else { 0.2 + random.random::<f64>() });
        }
        photometry.push(match image % 3 {
            0 => GpuPhotometry::FitBoth,
            1 => GpuPhotometry::FitFlux { background_e: 15.0 },
            _ => GpuPhotometry::Known { flux_e: 3.7e4, background_e: 20.0 },
        });
    }
    assert_eq!(data.len(), count * size);
    Images { data, weights, photometry }
}

pub(super) fn coefficients(layout: &GpuLayout, images: usize, random: &mut impl Rng) -> Vec<f64> {
    (0..images * layout.modes.len()).map(|_| 150.0 * (random.random::<f64>() - 0.5)).collect()
}

/// The PSF by the definition.
pub(super) fn psf(layout: &GpuLayout, coefficients: &[f64]) -> Vec<f64> {
    respond(layout, &intensity(layout, &fields(layout, coefficients)), false)
}

/// At one wavelength: P, a and E = a P at each illuminated sample, and the focal field at each
/// pixel.
struct Field {
    pupil: Vec<[Complex64; 3]>,
    focal: Vec<Complex64>,
}

fn fields(layout: &GpuLayout, coefficients: &[f64]) -> Vec<Field> {
    let field = |colour: &GpuColour| {
        let pupil = pupil(layout, colour, coefficients);
        Field { focal: focal(layout, colour, &pupil), pupil }
    };
    layout.colours.iter().map(field).collect()
}

/// Sum over the wavelengths, before the response of the pixels.
fn intensity(layout: &GpuLayout, fields: &[Field]) -> Vec<f64> {
    let at = |i: usize| {
        let parts = layout.colours.iter().zip(fields);
        parts.map(|(colour, field)| colour.intensity_scale * field.focal[i].norm_sqr()).sum()
    };
    (0..layout.pixels * layout.pixels).map(at).collect()
}

/// The image with the response of the pixels, or its transpose, applied along both axes, each as a
/// matrix.
fn respond(layout: &GpuLayout, image: &[f64], transposed: bool) -> Vec<f64> {
    let Some([along_x, along_y]) = &layout.pixel_terms else { return image.to_vec() };
    let m = layout.pixels;
    let matrix = |terms: &[f64]| {
        let mut matrix = vec![0.0; m * m];
        for (i, offset) in (0..m).flat_map(|i| (1 - terms.len() as isize..terms.len() as isize).map(move |k| (i, k))) {
            let at = i as isize + offset;
            let inside = if at < 0 {
                -1 - at
            } else if at < m as isize {
                at
            } else {
                2 * m as isize - 1 - at
            } as usize;
            let entry = if transposed { inside * m + i } else { i * m + inside };
            matrix[entry] += terms[offset.unsigned_abs()];
        }
        matrix
    };
    let (x, y) = (matrix(along_x), matrix(along_y));
    let rows: Vec<f64> = (0..m * m).map(|i| (0..m).map(|k| x[i % m * m + k] * image[i / m * m + k]).sum()).collect();
    (0..m * m).map(|i| (0..m).map(|k| y[i / m * m + k] * rows[k * m + i % m]).sum()).collect()
}

pub(super) fn turn(t: f64) -> Complex64 {
    Complex64::from_polar(1.0, TAU * t)
}

/// Amount of `mode`, turns.
fn amount(layout: &GpuLayout, colour: &GpuColour, coefficients: &[f64], mode: GpuMode) -> f64 {
    let parts = layout.modes.iter().zip(coefficients).filter(|(m, _)| **m == mode);
    parts.map(|(_, c)| c / colour.wavelength_nm).sum()
}

pub(super) fn slope(layout: &GpuLayout, entry: usize) -> (f64, f64) {
    layout.segment_slopes.as_ref().map_or((0.0, 0.0), |(x, y)| (x[entry], y[entry]))
}

/// The phasor of the segment of each entry, at the sample of the entry.
fn entry_phasors(layout: &GpuLayout, colour: &GpuColour, coefficients: &[f64]) -> Vec<Complex64> {
    let poses: Vec<[f64; 3]> = (0..layout.segments)
        .map(|s| {
            [GpuMode::Segment(s), GpuMode::Tip(s), GpuMode::Tilt(s)].map(|m| amount(layout, colour, coefficients, m))
        })
        .collect();
    let phasor = |(e, &s): (usize, &usize)| {
        let ([c, t, u], (x, y)) = (poses[s], slope(layout, e));
        turn(c + t * x + u * y)
    };
    layout.segment_index.iter().enumerate().map(phasor).collect()
}

fn pupil(layout: &GpuLayout, colour: &GpuColour, coefficients: &[f64]) -> Vec<[Complex64; 3]> {
    let amount = |mode: GpuMode| amount(layout, colour, coefficients, mode);
    let phasors = entry_phasors(layout, colour, coefficients);
    let smooth: Vec<f64> = (0..layout.smooth.len()).map(|j| amount(GpuMode::Smooth(j))).collect();
    (0..layout.illuminated.len())
        .map(|p| {
            let psi = colour.diversity_turns[p] + layout.smooth.iter().zip(&smooth).map(|(b, y)| b[p] * y).sum::<f64>();
            let a: Complex64 = (layout.segment_start[p]..layout.segment_start[p + 1])
                .map(|e| phasors[e] * layout.segment_weight[e])
                .sum();
            [turn(psi), a, a * turn(psi)]
        })
        .collect()
}

/// exp(-2 pi i step (x u + y v)) of an illuminated sample and a pixel.
fn kernel(layout: &GpuLayout, colour: &GpuColour, sample: usize, pixel: usize) -> Complex64 {
    let (n, m) = (layout.samples, layout.pixels);
    let centre = |i: usize| i as f64 - (n as f64 - 1.0) / 2.0;
    let axis = |i: usize| i as f64 - m as f64 / 2.0;
    let turns = centre(sample % n) * axis(pixel % m) + centre(sample / n) * axis(pixel / m);
    Complex64::from_polar(1.0, -TAU * turns / (n as f64 * colour.samples_per_lambda_over_d))
}

fn focal(layout: &GpuLayout, colour: &GpuColour, pupil: &[[Complex64; 3]]) -> Vec<Complex64> {
    (0..layout.pixels * layout.pixels)
        .map(|pixel| {
            layout.illuminated.iter().zip(pupil).map(|(&sample, p)| p[2] * kernel(layout, colour, sample, pixel)).sum()
        })
        .collect()
}

pub(super) struct ReferenceResult {
    pub(super) objective: f64,
    pub(super) flux: f64,
    pub(super) background: f64,
    pub(super) gradient: Vec<f64>,
    /// Derivative by the phase of each illuminated sample, per turn of the free phase.
    pub(super) slopes: Vec<f64>,
}

pub(super) fn reference(
    layout: &GpuLayout,
    coefficients: &[f64],
    d: &[f64],
    w: &[f64],
    photometry: GpuPhotometry,
) -> ReferenceResult {
    let fields = fields(layout, coefficients);
    let h = respond(layout, &intensity(layout, &fields), false);
    let good = || (0..h.len()).filter(|&i| w[i] > 0.0);
    let (flux, background) = match photometry {
        GpuPhotometry::Known { flux_e, background_e } => (flux_e, background_e),
        GpuPhotometry::FitFlux { background_e } => {
            let top: f64 = good().map(|i| w[i] * h[i] * (d[i] - background_e)).sum();
            (top / good().map(|i| w[i] * h[i] * h[i]).sum::<f64>(), background_e)
        }
        GpuPhotometry::FitBoth => {
            // Relative to the weighted means: the well-conditioned form of the normal equations.
            let weight: f64 = good().map(|i| w[i]).sum();
            let mean = |f: &[f64]| good().map(|i| w[i] * f[i]).sum::<f64>() / weight;
            let (mh, md) = (mean(&h), mean(d));
            let top: f64 = good().map(|i| w[i] * (h[i] - mh) * (d[i] - md)).sum();
            let flux = top / good().map(|i| w[i] * (h[i] - mh).powi(2)).sum::<f64>();
            (flux, md - flux * mh)
        }
    };
    let r: Vec<f64> = (0..h.len()).map(|i| if w[i] > 0.0 { flux * h[i] + background - d[i] } else { 0.0 }).collect();
    let source: Vec<f64> = (0..h.len()).map(|i| 2.0 * flux * w[i] * r[i]).collect();
    let source = respond(layout, &source, true);
    let mut result = ReferenceResult {
        objective: (0..h.len()).map(|i| w[i] * r[i] * r[i]).sum(),
        flux,
        background,
        gradient: vec![0.0; layout.modes.len()],
        slopes: vec![0.0; layout.illuminated.len()],
    };
    for (colour, field) in layout.colours.iter().zip(&fields) {
        add_gradient(layout, colour, coefficients, field, &source, &mut result);
    }
    result
}

/// Adds the derivatives through one wavelength; `source` is the derivative by the intensity.
fn add_gradient(
    layout: &GpuLayout,
    colour: &GpuColour,
    coefficients: &[f64],
    Field { pupil, focal }: &Field,
    source: &[f64],
    result: &mut ReferenceResult,
) {
    let k = TAU / colour.wavelength_nm;
    // dJ/dE* at each illuminated sample, by the adjoint sum.
    let bar: Vec<Complex64> = layout
        .illuminated
        .iter()
        .map(|&sample| {
            let pixel = |i: usize| focal[i] * kernel(layout, colour, sample, i).conj() * source[i];
            colour.intensity_scale * (0..focal.len()).map(pixel).sum::<Complex64>()
        })
        .collect();
    let phasors = entry_phasors(layout, colour, coefficients);
    let segment = |s: usize, along: &dyn Fn(usize) -> f64| {
        let each = |p: usize| {
            (layout.segment_start[p]..layout.segment_start[p + 1])
                .filter(|&e| layout.segment_index[e] == s)
                .map(|e| along(e) * layout.segment_weight[e] * (phasors[e].conj() * pupil[p][0].conj() * bar[p]).im)
                .sum::<f64>()
        };
        2.0 * k * (0..bar.len()).map(each).sum::<f64>()
    };
    // Per turn of this wavelength.
    let slopes: Vec<f64> = pupil.iter().zip(&bar).map(|(p, bar)| 2.0 * TAU * (p[2].conj() * bar).im).collect();
    for (gradient, mode) in result.gradient.iter_mut().zip(&layout.modes) {
        *gradient += match *mode {
            GpuMode::Smooth(j) => layout.smooth[j].iter().zip(&slopes).map(|(b, d)| b * d / colour.wavelength_nm).sum(),
            GpuMode::Segment(s) => segment(s, &|_| 1.0),
            GpuMode::Tip(s) => segment(s, &|e| slope(layout, e).0),
            GpuMode::Tilt(s) => segment(s, &|e| slope(layout, e).1),
        };
    }
    let scale = layout.free_wavelength_nm / colour.wavelength_nm;
    result.slopes.iter_mut().zip(slopes).for_each(|(sum, slope)| *sum += scale * slope);
}

/// A whole image of the smallest size with an FFT plan.
pub(super) fn whole_scene() -> GpuLayout {
    let mut whole = GpuLayout { pixels: 64, free_phase: true, ..scene() };
    whole.colours[0].samples_per_lambda_over_d = 64.0 / 18.0;
    whole
}

#[test]
fn the_reference_agrees_with_its_own_finite_differences() {
    [scene(), tilted_scene(), camera_scene()].iter().for_each(differences_in);
}

fn differences_in(layout: &GpuLayout) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let images = images(layout, 3, &mut random);
    let size = layout.pixels * layout.pixels;
    let c = coefficients(layout, 1, &mut random);
    for image in 0..3 {
        let range = image * size..(image + 1) * size;
        let at = |c: &[f64]| {
            reference(layout, c, &images.data[range.clone()], &images.weights[range.clone()], images.photometry[image])
        };
        let result = at(&c);
        let scale = result.gradient.iter().fold(0.0f64, |a, g| a.max(g.abs()));
        for k in 0..c.len() {
            // A step of 1e-5 wave: the cubic term of the difference is (2 pi 1e-5)^2 ~ 4e-9 of the
            // gradient, the rounding 1e-16 J/(step g) ~ 1e-10.
            let step = 0.0165;
            let shifted =
                |by: f64| at(&c.iter().enumerate().map(|(i, v)| v + if i == k { by } else { 0.0 }).collect::<Vec<_>>());
            let difference = (shifted(step).objective - shifted(-step).objective) / (2.0 * step);
            assert!((difference - result.gradient[k]).abs() < 1e-6 * scale, "{k}: {difference} {}", result.gradient[k]);
        }
    }
}
