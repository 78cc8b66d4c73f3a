//! Light behind a modulated four-sided pyramid, in the four images of the pupil.
//!
//! The images are far from each other: the light of one face that is diffracted into the image of
//! another, which falls with their distance, is left out. Everything else is exact, up to the
//! rounding of single precision: the focal field is sampled infinitely finely, the edges cross it
//! at the points of the modulation wherever they lie, and a frame needs no transform for each
//! point. See `half_planes` for the edges, `modulation` for the circle and `kernel` for the sums.

use super::half_planes::HalfPlanes;
use super::kernel::{Components, Lane, StepTerms, SumIntensities, Tile, Vector};
use super::modulation::Modulation;
use super::plane::Plane;
use crate::ao::footprint::{Footprint, LANES};
use crate::ao::phase::unit_phasor;
use num_complex::Complex32;
use pulp::Arch;
use std::f64::consts::TAU;

/// Pyramid over a grid of samples, with the memory of a frame.
#[derive(Clone)]
pub(super) struct PyramidOptics {
    footprint: Footprint,
    turns_per_nm: f32,
    modulation: Modulation,
    planes: HalfPlanes,
    arch: Arch,
    tiles: Vec<Tile>,
    steps: Vec<StepTerms>,
    /// Waves of the nodes, as scalars `[sample][node]` and in vectors `[vector][node]`.
    waves: Vec<[f32; 2]>,
    wave_vectors: Vec<Vector>,
    /// Waves along y times the weights of the steps, `[row][term of v]`.
    phasors: Vec<[f32; 2]>,
    /// Field and its transpose.
    field: Plane,
    transposed: Plane,
    /// A, B and C at the first point.
    differences: [Plane; 3],
    /// Components of the field along x, over y, and along y, over x: `[node]`; and their
    /// transforms.
    components: [Plane; 2],
    spectra: [Vec<Complex32>; 2],
    line: Vec<Complex32>,
    u_terms: Vec<[[f32; 2]; 2]>,
    v_terms: Vec<[Vector; 2]>,
    sums: Vec<[Lane; 4]>,
}

impl PyramidOptics {
    /// Pyramid at `wavelength_nm` behind the pupil of `footprint`; light is computed in `tiles`.
    pub(super) fn new(footprint: &Footprint, wavelength_nm: f64, modulation: Modulation, tiles: Vec<Tile>) -> Self {
        let n = footprint.samples();
        let planes = HalfPlanes::new(n, &modulation.offsets);
        let nodes = modulation.nodes.len();
        let wave = |s: usize, node: usize| {
            let angle = TAU * modulation.nodes[node] * (s as f64 - (n as f64 - 1.0) / 2.0) / n as f64;
            [angle.cos(), angle.sin()]
        };
        let vectors = n.div_ceil(LANES);
        let mut wave_vectors = vec![Vector::ZERO; vectors * nodes];
        for (s, node) in (0..n).flat_map(|s| (0..nodes).map(move |node| (s, node))) {
            let vector = &mut wave_vectors[s / LANES * nodes + node];
            [vector.re[s % LANES], vector.im[s % LANES]] = wave(s, node).map(|part| part as f32);
        }
        let steps = terms(&modulation);
        let [u_count, v_count] = steps.last().map_or([0; 2], |last| [last.u.end, last.v.end]);
        let mut phasors = vec![[0.0; 2]; n * v_count];
        for (step, terms) in modulation.steps.iter().zip(&steps) {
            let Some(strip) = &step.strips[1] else { continue };
            for (term, node) in terms.v.clone().zip(strip.nodes.clone()) {
                let scale = 2.0 * strip.sign * modulation.weights[node] / n as f64;
                (0..n).for_each(|y| phasors[y * v_count + term] = wave(y, node).map(|part| (scale * part) as f32));
            }
        }
        let length = planes.length();
        Self {
            footprint: footprint.clone(),
            turns_per_nm: (1.0 / wavelength_nm) as f32,
            arch: Arch::new(),
            tiles,
            waves: (0..n)
                .flat_map(|s| (0..nodes).map(move |node| (s, node)))
                .map(|(s, node)| wave(s, node).map(|part| part as f32))
                .collect(),
            wave_vectors,
            phasors,
            field: Plane::zeros(n, n),
            transposed: Plane::zeros(n, n),
            differences: [(); 3].map(|()| Plane::zeros(n, n)),
            components: [(); 2].map(|()| Plane::zeros(nodes, n)),
            spectra: [(); 2].map(|()| vec![Complex32::ZERO; nodes * length]),
            line: vec![Complex32::ZERO; length],
            u_terms: vec![[[0.0; 2]; 2]; n * u_count],
            v_terms: vec![[Vector::ZERO; 2]; vectors * v_count],
            sums: vec![[[0.0; LANES]; 4]; n * vectors],
            modulation,
            planes,
            steps,
        }
    }

    /// Number of points of the modulation.
    pub(super) fn points(&self) -> usize {
        self.modulation.points
    }

    /// Computes T, X/2, Y/2 and Z/2 of the wavefront `opd_nm`, a map over the footprint, summed
    /// over the points of the modulation.
    pub(super) fn propagate(&mut self, opd_nm: &[f32]) {
        self.fill(opd_nm);
        self.first_point();
        self.field_components();
        self.step_terms();
        let [a, b, c] = &self.differences;
        let fields = [&self.field.values[..], &a.values, &b.values, &c.values];
        let [u_count, v_count] = self.steps.last().map_or([0; 2], |last| [last.u.end, last.v.end]);
        self.arch.dispatch(SumIntensities {
            tiles: &self.tiles,
            steps: &self.steps,
            vectors: self.field.vectors(),
            fields,
            waves: &self.wave_vectors,
            u_terms: &self.u_terms,
            phasors: &self.phasors,
            v_terms: &self.v_terms,
            counts: [self.modulation.nodes.len(), u_count, v_count],
            sums: &mut self.sums,
        });
    }

    /// The sums of the last frame at a sample: T, X/2, Y/2 and Z/2, where a tile is.
    pub(super) fn sums_at(&self, row: usize, column: usize) -> [f32; 4] {
        self.sums[row * self.field.vectors() + column / LANES].map(|lane| lane[column % LANES])
    }

    /// Least operations of a frame: additions and multiplications; a fused pair counts as two.
    pub(super) fn operations(&self) -> f64 {
        let vectors: usize = self.tiles.iter().map(|tile| tile.rows.len()).sum();
        let samples = (vectors * LANES) as f64;
        let terms: usize = self.steps.iter().map(|step| step.u.len() + step.v.len()).sum();
        // Two complex products for each term, ten squares and products of complex numbers at each
        // point.
        let circle = samples * (16.0 * terms as f64 + 40.0 * self.points() as f64);
        let (n, nodes) = (self.footprint.samples() as f64, self.modulation.nodes.len() as f64);
        // Both transforms of lines of A, B and C; of the nodes, forward once and back for each
        // term; the nodes' components.
        let transforms = (6.0 * n + 2.0 * nodes + terms as f64) * self.planes.transform_operations();
        circle + transforms + 16.0 * nodes * n * n
    }

    /// Field of the pupil and its transpose.
    fn fill(&mut self, opd_nm: &[f32]) {
        let (n, stride) = (self.footprint.samples(), self.footprint.stride());
        for y in 0..n {
            for x in self.footprint.span(y).start..self.footprint.span(y).end.min(n) {
                let a = self.footprint.amplitude()[y * stride + x];
                let (cos, sin) = unit_phasor(opd_nm[y * stride + x] * self.turns_per_nm);
                // Outside of the pupil the map is unspecified.
                let value = if a > 0.0 { Complex32::new(a * cos, a * sin) } else { Complex32::ZERO };
                self.field.set(y, x, value);
                self.transposed.set(x, y, value);
            }
        }
    }

    /// A, B and C at the first point of the modulation.
    fn first_point(&mut self) {
        let n = self.footprint.samples();
        let [u, v] = self.modulation.start();
        let [a, b, c] = &mut self.differences;
        for y in 0..n {
            self.planes.transform(self.field.row(y), &mut self.line);
            a.set_row(y, self.planes.convolve(&self.line, u));
        }
        for x in 0..n {
            self.planes.transform(self.transposed.row(x), &mut self.line);
            let column = self.planes.convolve(&self.line, v);
            column.iter().enumerate().for_each(|(y, &value)| b.set(y, x, value));
        }
        for y in 0..n {
            self.planes.transform(b.row(y), &mut self.line);
            c.set_row(y, self.planes.convolve(&self.line, u));
        }
    }

    /// Fourier components of the field at the nodes, along x and along y, and their transforms
    /// along the other axis.
    fn field_components(&mut self) {
        let (nodes, length) = (self.modulation.nodes.len(), self.planes.length());
        let lines = [&self.transposed, &self.field];
        for ((lines, components), spectra) in lines.into_iter().zip(&mut self.components).zip(&mut self.spectra) {
            self.arch.dispatch(Components {
                lines: &lines.values,
                vectors: lines.vectors(),
                waves: &self.waves,
                nodes,
                out: &mut components.values,
            });
            for (node, spectrum) in spectra.chunks_exact_mut(length).enumerate() {
                self.planes.transform(components.row(node), spectrum);
            }
        }
    }

    /// Terms of all steps for this frame.
    fn step_terms(&mut self) {
        let (n, length) = (self.footprint.samples(), self.planes.length());
        let [u_count, v_count] = self.steps.last().map_or([0; 2], |last| [last.u.end, last.v.end]);
        let spectrum = |node: usize| node * length..(node + 1) * length;
        for (step, terms) in self.modulation.steps.iter().zip(&self.steps) {
            let nodes = |axis: usize| step.strips[axis].as_ref().map_or(0..0, |strip| strip.nodes.clone());
            let sign = step.strips[0].as_ref().map_or(0.0, |strip| strip.sign);
            for (term, node) in terms.u.clone().zip(nodes(0)) {
                let scale = (2.0 * sign * self.modulation.weights[node] / n as f64) as f32;
                let of_b = self.planes.convolve(&self.spectra[0][spectrum(node)], step.v_before);
                for (y, (alpha, gamma)) in self.components[0].row(node).zip(of_b).enumerate() {
                    self.u_terms[y * u_count + term] = [alpha, *gamma].map(|z| [scale * z.re, scale * z.im]);
                }
            }
            for (term, node) in terms.v.clone().zip(nodes(1)) {
                let of_a = self.planes.convolve(&self.spectra[1][spectrum(node)], step.u_after);
                for (x, (b, c)) in self.components[1].row(node).zip(of_a).enumerate() {
                    let both = &mut self.v_terms[x / LANES * v_count + term];
                    for (vector, value) in both.iter_mut().zip([b, *c]) {
                        (vector.re[x % LANES], vector.im[x % LANES]) = (value.re, value.im);
                    }
                }
            }
        }
    }
}

/// Terms of the steps, numbered in order.
fn terms(modulation: &Modulation) -> Vec<StepTerms> {
    let (mut u, mut v) = (0, 0);
    let number = |end: &mut usize, count: usize| {
        let first = *end;
        *end += count;
        first..*end
    };
    let each = modulation.steps.iter().map(|step| {
        let [along_u, along_v] = step.strips.each_ref().map(|strip| strip.as_ref().map_or(0..0, |s| s.nodes.clone()));
        StepTerms { u: number(&mut u, along_u.len()), u_node: along_u.start, v: number(&mut v, along_v.len()) }
    });
    each.collect()
}
