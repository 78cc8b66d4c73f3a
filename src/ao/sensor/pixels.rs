//! Diffractive detector with pixels: spots on n×n pixels, centres of gravity.
//!
//! A lenslet of n samples, padded to 2n, forms a spot on 2n×2n points λ/2d apart. Its axis lies
//! between the points, like the quad cell's; the points are binned into pixels. The transform is a
//! matrix product, `F = W·E·Wᵀ` with `W_kx = exp(−2πi·(k + ½ − n)·x/2n)`, for [`LANES`] lenslets at
//! once, one in each lane of a vector.

use super::lenslets::Lenslets;
use super::light::GuideStar;
use crate::ao::footprint::{Footprint, LANES};
use crate::ao::phase::unit_phasor;
use crate::scene::SensorScene;
use pulp::{Arch, NullaryFnOnce};

/// Default number of pixels across a lenslet.
const USUAL_PIXELS: usize = 8;

type Lane = [f32; LANES];

/// Spots and pixels of all subapertures.
#[derive(Clone)]
pub(super) struct SensorPixels {
    lenslets: Lenslets,
    turns_per_nm: f32,
    footprint: Footprint,
    stride: usize,
    pixels: usize,
    /// The central ones, which are read.
    field_pixels: usize,
    threshold_e: f64,
    /// `W`, `[k][x]`.
    cos: Vec<f32>,
    sin: Vec<f32>,
    /// Work arrays of one group of lenslets: field `[y][x]`, half transform `[y][k]`, pixels
    /// `[v][u]`.
    field: [Vec<Lane>; 2],
    half: [Vec<Lane>; 2],
    spot: Vec<Lane>,
    arch: Arch,
}

impl SensorPixels {
    pub(super) fn new(scene: &SensorScene, lenslets: &Lenslets, footprint: &Footprint) -> Self {
        let n = lenslets.samples;
        let divides = |&pixels: &usize| (2 * n).is_multiple_of(pixels) && pixels.is_multiple_of(2);
        let pixels = scene.pixels_per_lenslet.or((2..=USUAL_PIXELS).rev().find(divides)).unwrap_or(2);
        let angle = |i: usize| {
            let (k, x) = ((i / n) as f64 + 0.5 - n as f64, (i % n) as f64);
            -std::f64::consts::PI * k * x / n as f64
        };
        let zero = [0.0; LANES];
        Self {
            lenslets: lenslets.clone(),
            turns_per_nm: (1.0 / scene.wavelength_nm) as f32,
            footprint: footprint.clone(),
            stride: footprint.stride(),
            pixels,
            field_pixels: scene.field_pixels.unwrap_or(pixels),
            threshold_e: scene.threshold_e,
            cos: (0..2 * n * n).map(|i| angle(i).cos() as f32).collect(),
            sin: (0..2 * n * n).map(|i| angle(i).sin() as f32).collect(),
            field: [vec![zero; n * n], vec![zero; n * n]],
            half: [vec![zero; 2 * n * n], vec![zero; 2 * n * n]],
            spot: vec![zero; pixels * pixels],
            arch: Arch::new(),
        }
    }

    /// Measures centres of gravity, in pixels from the centre: x, then y.
    pub(super) fn raw_slopes(&mut self, opd_nm: &[f32], mut light: Option<&mut GuideStar>, slopes: &mut [f32]) {
        let count = self.lenslets.subapertures.len();
        let (along_x, along_y) = slopes.split_at_mut(count);
        for first in (0..count).step_by(LANES) {
            let group = first..(first + LANES).min(count);
            self.arch.dispatch(FormSpots { camera: self, opd_nm, first, count: group.len() });
            for (lane, i) in group.enumerate() {
                [along_x[i], along_y[i]] = self.centre_of_gravity(lane, self.lenslets.light[i], light.as_deref_mut());
            }
        }
    }

    /// Centre of gravity of the spot in `lane`; 0 if no pixel reaches the threshold.
    fn centre_of_gravity(&self, lane: usize, share: f64, mut light: Option<&mut GuideStar>) -> [f32; 2] {
        // The noise-free calibration uses no threshold, as for a bright star.
        let threshold_e = if light.is_some() { self.threshold_e } else { 0.0 };
        let electrons = light.as_deref().map_or(1.0, |light| light.electrons * share);
        let whole: f64 = self.spot.iter().map(|pixel| f64::from(pixel[lane])).sum();
        let middle = (self.pixels - 1) as f64 / 2.0;
        let (mut sum, mut x, mut y) = (0.0, 0.0, 0.0);
        let margin = (self.pixels - self.field_pixels) / 2;
        let field = margin..self.pixels - margin;
        let is_read = |place: usize| field.contains(&(place % self.pixels)) && field.contains(&(place / self.pixels));
        for (place, pixel) in self.spot.iter().enumerate().filter(|(place, _)| is_read(*place)) {
            let mean = f64::from(pixel[lane]) / whole * electrons;
            let signal = light.as_deref_mut().map_or(mean, |light| light.pixel(mean));
            if threshold_e == 0.0 || signal >= threshold_e {
                sum += signal;
                x += signal * ((place % self.pixels) as f64 - middle);
                y += signal * ((place / self.pixels) as f64 - middle);
            }
        }
        // A sum of half an electron or less is noise about 0, and its ratio is not usable.
        if light.is_some() && sum <= 0.5 { [0.0; 2] } else { [(x / sum) as f32, (y / sum) as f32] }
    }
}

/// Kernel: the spots of [`LANES`] subapertures from `first` on.
struct FormSpots<'a> {
    camera: &'a mut SensorPixels,
    opd_nm: &'a [f32],
    first: usize,
    count: usize,
}

impl NullaryFnOnce for FormSpots<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { camera, opd_nm, first, count } = self;
        camera.gather(opd_nm, first, count);
        camera.transform();
    }
}

impl SensorPixels {
    /// Computes the field of each lenslet, one in each lane; unused lanes repeat the last lenslet.
    #[inline(always)]
    fn gather(&mut self, opd_nm: &[f32], first: usize, count: usize) {
        let (n, across, stride) = (self.lenslets.samples, self.lenslets.across, self.stride);
        let mut start = [0; LANES];
        for (lane, start) in start.iter_mut().enumerate() {
            let subaperture = self.lenslets.subapertures[first + lane.min(count - 1)];
            *start = subaperture / across * n * stride + subaperture % across * n;
        }
        let [re, im] = &mut self.field;
        for (place, (re, im)) in re.iter_mut().zip(im).enumerate() {
            let offset = place / n * stride + place % n;
            let (mut turns, mut a) = ([0.0f32; LANES], [0.0f32; LANES]);
            for l in 0..LANES {
                turns[l] = opd_nm[start[l] + offset] * self.turns_per_nm;
                a[l] = self.footprint.amplitude()[start[l] + offset];
            }
            for l in 0..LANES {
                let (cos, sin) = unit_phasor(turns[l]);
                (re[l], im[l]) = (a[l] * cos, a[l] * sin);
            }
        }
    }

    /// Transforms the fields to spots.
    #[inline(always)]
    fn transform(&mut self) {
        let n = self.lenslets.samples;
        for y in 0..n {
            for k in 0..2 * n {
                let weights = (k * n)..(k + 1) * n;
                let line = (y * n..(y + 1) * n).map(|i| (&self.field[0][i], &self.field[1][i]));
                let (re, im) = product(&self.cos[weights.clone()], &self.sin[weights], line);
                (self.half[0][y * 2 * n + k], self.half[1][y * 2 * n + k]) = (re, im);
            }
        }
        self.spot.fill([0.0; LANES]);
        let bin = 2 * n / self.pixels;
        for u in 0..2 * n {
            for v in 0..2 * n {
                let weights = (v * n)..(v + 1) * n;
                let line = (0..n).map(|y| (&self.half[0][y * 2 * n + u], &self.half[1][y * 2 * n + u]));
                let (re, im) = product(&self.cos[weights.clone()], &self.sin[weights], line);
                let pixel = &mut self.spot[v / bin * self.pixels + u / bin];
                for l in 0..LANES {
                    pixel[l] += re[l].mul_add(re[l], im[l] * im[l]);
                }
            }
        }
    }
}

/// `Σ_x W_x·E_x` in each lane.
#[inline(always)]
fn product<'a>(cos: &[f32], sin: &[f32], line: impl Iterator<Item = (&'a Lane, &'a Lane)>) -> (Lane, Lane) {
    let (mut re, mut im) = ([0.0f32; LANES], [0.0f32; LANES]);
    for ((&c, &s), (e_re, e_im)) in cos.iter().zip(sin).zip(line) {
        for l in 0..LANES {
            re[l] = c.mul_add(e_re[l], (-s).mul_add(e_im[l], re[l]));
            im[l] = c.mul_add(e_im[l], s.mul_add(e_re[l], im[l]));
        }
    }
    (re, im)
}
