//! What may be wrong with a scene, with a telescope or with a camera, without a word of it in the
//! scene.

use cophase::modes::circle_zernikes;
use cophase::source::{Truth, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use cophase_numerics::fft::plan_both;
use ndarray::{Array2, Axis, Zip};
use num_complex::Complex64;
use rand::RngExt;
use std::f64::consts::TAU;

/// What a fault changes; its size is the argument.
#[derive(Clone, Copy)]
pub(super) enum Change {
    /// The scene that makes the images: (key, value).
    Scene(fn(f64) -> Vec<(&'static str, String)>),
    /// The aberrations, with a random part by the seed of the draw.
    Truth(fn(Truth, &Telescope, f64, u64) -> Result<Truth>),
    /// The PSF on the detector's pixels, `[y, x]`.
    Psf(fn(&Array2<f64>, f64) -> Array2<f64>),
    /// Each frame, electrons; the seed is that of the draw, so that all frames have one detector.
    Detector(fn(&mut Array2<f64>, f64, u64)),
}

/// A fault at three sizes.
pub(super) struct Fault {
    pub(super) name: &'static str,
    /// Around the size at which estimates begin to say so.
    pub(super) sizes: [f64; 3],
    pub(super) unit: &'static str,
    pub(super) change: Change,
}

const fn fault(name: &'static str, sizes: [f64; 3], unit: &'static str, change: Change) -> Fault {
    Fault { name, sizes, unit, change }
}

/// One key in place of the scene's.
fn key(key: &'static str, value: impl ToString) -> Vec<(&'static str, String)> {
    vec![(key, value.to_string())]
}

/// Pixels per λ/D of the scenes.
const SAMPLING: f64 = 2.0;

/// All of them; sizes in per cent are of the light, of a gain or of a scale.
pub(super) const FAULTS: [Fault; 45] = [
    fault("nothing", [0.0; 3], "", Change::Scene(|_| Vec::new())),
    fault(
        "plate scale",
        [0.05, 0.15, 0.5],
        "%",
        Change::Scene(|size| key("image.samples_per_lambda_over_d", SAMPLING * (1.0 + 0.01 * size))),
    ),
    fault(
        "plate scale along x",
        [0.05, 0.15, 0.5],
        "%",
        Change::Psf(|psf, size| moved(psf, |x, _| [-0.01 * size * x, 0.0])),
    ),
    fault(
        "shear of the image",
        [0.05, 0.15, 0.5],
        "%",
        Change::Psf(|psf, size| moved(psf, |x, y| [0.01 * size * y, 0.01 * size * x])),
    ),
    fault("rotation of the pupil", [0.05, 0.1, 0.3], "deg", Change::Scene(|size| key("pupil.rotation_deg", size))),
    fault(
        "distortion, at the edge of the frame",
        [0.05, 0.15, 0.5],
        "%",
        Change::Psf(|psf, size| {
            let half = 0.5 * psf.nrows() as f64;
            moved(psf, move |x, y| [x, y].map(|along| -0.01 * size * along * (x * x + y * y) / (half * half)))
        }),
    ),
    fault(
        "gain of one half",
        [0.3, 1.0, 3.0],
        "%",
        Change::Detector(|frame, size, _| scale(frame, |x, _| if x >= 0.0 { 0.01 * size } else { 0.0 })),
    ),
    fault(
        "gain of a quadrant",
        [0.5, 1.5, 4.0],
        "%",
        Change::Detector(|frame, size, _| scale(frame, |x, y| if x >= 0.0 && y < 0.0 { 0.01 * size } else { 0.0 })),
    ),
    fault(
        "gain of every other column",
        [0.5, 1.5, 4.0],
        "%",
        Change::Detector(|frame, size, _| scale(frame, |x, _| if x as i64 % 2 == 0 { 0.01 * size } else { 0.0 })),
    ),
    fault(
        "gain of four of eight amplifiers",
        [0.5, 1.5, 4.0],
        "%",
        Change::Detector(|frame, size, _| {
            scale(frame, |x, _| if ((x + 120.0) / 30.0) as i64 % 2 == 0 { 0.01 * size } else { 0.0 })
        }),
    ),
    fault(
        "offset of one half, of the peak",
        [0.03, 0.1, 0.3],
        "%",
        Change::Detector(|frame, size, _| add(frame, 0.01 * size, |x, _| if x >= 0.0 { 1.0 } else { 0.0 })),
    ),
    fault(
        "slope of the background, of the peak at the edge",
        [0.03, 0.1, 0.3],
        "%",
        Change::Detector(|frame, size, _| add(frame, 0.01 * size, |x, _| x / 120.0)),
    ),
    fault(
        "bump of the background of 30 pixels, of the peak",
        [0.03, 0.1, 0.3],
        "%",
        Change::Detector(|frame, size, _| add(frame, 0.01 * size, |x, y| (-(x * x + y * y) / 1800.0).exp())),
    ),
    fault(
        "responses of the pixels",
        [0.3, 1.0, 3.0],
        "%",
        Change::Detector(|frame, size, seed| structured(frame, 0.01 * size, 0.0, seed)),
    ),
    fault(
        "flat of structures of 5 pixels",
        [0.3, 1.0, 3.0],
        "%",
        Change::Detector(|frame, size, seed| structured(frame, 0.01 * size, 2.5, seed)),
    ),
    fault(
        "flat of structures of 30 pixels",
        [0.3, 1.0, 3.0],
        "%",
        Change::Detector(|frame, size, seed| structured(frame, 0.01 * size, 15.0, seed)),
    ),
    fault(
        "vignetting, at 100 pixels",
        [1.0, 2.0, 5.0],
        "%",
        Change::Detector(|frame, size, _| scale(frame, |x, y| -0.01 * size * (x * x + y * y) / 1e4)),
    ),
    fault(
        "response at the peak",
        [1.0, 2.0, 4.0],
        "% low",
        Change::Detector(|frame, size, _| {
            let peak = peak(frame);
            frame.mapv_inplace(|e| e * (1.0 - 0.01 * size * e / peak));
        }),
    ),
    fault(
        "crosstalk to the next pixel",
        [0.1, 0.3, 1.0],
        "%",
        Change::Detector(|frame, size, _| {
            let before = frame.clone();
            Zip::indexed(frame).for_each(|(y, x), e| {
                *e += 0.01 * size * (if x > 0 { before[[y, x - 1]] } else { 0.0 } - before[[y, x]])
            });
        }),
    ),
    fault(
        "light to the neighbours, at the peak",
        [0.3, 1.0, 3.0],
        "%",
        Change::Detector(|frame, size, _| {
            let (before, peak) = (frame.clone(), peak(frame));
            let moves = before.mapv(|e| 0.01 * size * e * e / peak);
            Zip::indexed(frame).for_each(|(y, x), e| {
                let of = |y: usize, x: usize| moves.get([y, x]).copied().unwrap_or_default();
                *e += 0.25 * (of(y + 1, x) + of(y.wrapping_sub(1), x) + of(y, x + 1) + of(y, x.wrapping_sub(1)))
                    - of(y, x);
            });
        }),
    ),
    fault("halo of 10 pixels", [0.2, 0.5, 2.0], "%", Change::Psf(|psf, size| halo(psf, 0.01 * size, 10.0))),
    fault("halo of 3 pixels", [0.2, 0.5, 2.0], "%", Change::Psf(|psf, size| halo(psf, 0.01 * size, 3.0))),
    fault("halo of 30 pixels", [0.2, 0.5, 2.0], "%", Change::Psf(|psf, size| halo(psf, 0.01 * size, 30.0))),
    fault(
        "blur",
        [0.1, 0.2, 0.4],
        "pixels",
        Change::Psf(|psf, size| filtered(psf, |x, y| (-0.5 * (TAU * size).powi(2) * (x * x + y * y)).exp().into())),
    ),
    fault(
        "blur along x",
        [0.1, 0.2, 0.4],
        "pixels",
        Change::Psf(|psf, size| filtered(psf, |x, _| (-0.5 * (TAU * size * x).powi(2)).exp().into())),
    ),
    fault(
        "companion 3 λ/D away",
        [0.1, 0.3, 1.0],
        "%",
        Change::Psf(|psf, size| companion(psf, 0.01 * size, [4.8, 3.6])),
    ),
    fault(
        "companion 10 λ/D away",
        [0.1, 0.3, 1.0],
        "%",
        Change::Psf(|psf, size| companion(psf, 0.01 * size, [16.0, 12.0])),
    ),
    fault(
        "companion 30 λ/D away",
        [0.1, 0.3, 1.0],
        "%",
        Change::Psf(|psf, size| companion(psf, 0.01 * size, [-48.0, 36.0])),
    ),
    fault(
        "ghost of 20 pixels, 15 pixels away",
        [0.1, 0.3, 1.0],
        "%",
        Change::Psf(|psf, size| {
            let (inside, total) = (|x: f64, y: f64| (x - 15.0).powi(2) + y * y < 400.0, psf.sum());
            let area = 400.0 * std::f64::consts::PI;
            let mut spoilt = psf.clone();
            Zip::indexed(&mut spoilt).for_each(|at, h| {
                *h += if inside(place(psf, at)[0], place(psf, at)[1]) { 0.01 * size * total / area } else { 0.0 }
            });
            spoilt
        }),
    ),
    fault(
        "wavelength",
        [0.05, 0.15, 0.5],
        "%",
        Change::Scene(|size| key("image.wavelength_nm", 2168.6 * (1.0 + 0.01 * size))),
    ),
    fault("bandwidth", [0.5, 1.0, 2.0], "%", Change::Scene(|size| key("image.bandwidth_fraction", 0.01 * size))),
    fault(
        "pixels that collect light, of their side",
        [0.2, 0.4, 0.8],
        "",
        Change::Scene(|size| key("image.pixel_fill", size)),
    ),
    fault("obscuration", [1.6, 2.4, 3.0], "m", Change::Scene(|size| key("pupil.central_obscuration_m", size))),
    fault("spider", [0.0127, 0.0254, 0.1], "m", Change::Scene(|size| key("pupil.spider_width_m", size))),
    fault("gaps of the segments", [0.0, 0.001, 0.006], "m", Change::Scene(|size| key("pupil.segment_gap_m", size))),
    fault(
        "reflectivities of the segments",
        [1.0, 3.0, 10.0],
        "%",
        Change::Scene(|size| key("faults.segment_reflectivity_rms", 0.01 * size)),
    ),
    fault(
        "tilts of the segments",
        [1.0, 3.0, 10.0],
        "nm",
        Change::Scene(|size| key("aberrations.segment_tip_tilt_rms_nm", size)),
    ),
    fault(
        "tilt of one segment",
        [5.0, 10.0, 20.0],
        "nm",
        Change::Truth(|truth, telescope, size, _| {
            let mut tilts_nm = vec![[0.0; 2]; truth.piston_nm.len()];
            tilts_nm[7] = [size, 0.0];
            truth.with_tilts(telescope, tilts_nm)
        }),
    ),
    fault("pistons and tilts along one smooth surface", [10.0, 30.0, 60.0], "nm", Change::Truth(smooth_surface)),
    fault(
        "figure that all segments share",
        [1.0, 5.0, 15.0],
        "nm",
        Change::Scene(|size| key("aberrations.common_figure_rms_nm", size)),
    ),
    fault(
        "figures of the segments",
        [1.0, 3.0, 10.0],
        "nm",
        Change::Scene(|size| key("aberrations.segment_figure_rms_nm", size)),
    ),
    fault(
        "NCPA from Noll 67 to 91",
        [1.0, 3.0, 10.0],
        "nm",
        Change::Truth(|truth, telescope, size, seed| further_ncpa(truth, telescope, [67, 91], (size, seed))),
    ),
    fault(
        "NCPA from Noll 92 to 200",
        [1.0, 3.0, 10.0],
        "nm",
        Change::Truth(|truth, telescope, size, seed| further_ncpa(truth, telescope, [92, 200], (size, seed))),
    ),
    fault(
        "NCPA from Noll 201 to 400",
        [1.0, 3.0, 10.0],
        "nm",
        Change::Truth(|truth, telescope, size, seed| further_ncpa(truth, telescope, [201, 400], (size, seed))),
    ),
    fault(
        "read noise",
        [10.0, 30.0, 100.0],
        "% more",
        Change::Detector(|frame, size, seed| {
            let mut rng = stream(seed ^ (frame[[0, 0]].to_bits()), 901);
            // Variances add.
            let more_e = 60.0 * ((1.0 + 0.01 * size).powi(2) - 1.0).sqrt();
            frame.mapv_inplace(|e| e + more_e * normal(&mut rng));
        }),
    ),
];

/// More NCPA, of an RMS in nm over the Zernikes from `first` to `last`, by Noll.
fn further_ncpa(
    truth: Truth,
    telescope: &Telescope,
    [first, last]: [usize; 2],
    (rms_nm, seed): (f64, u64),
) -> Result<Truth> {
    let basis = circle_zernikes(first, last, &telescope.pupil)?;
    let mut rng = stream(seed, 902);
    let drawn: Vec<f64> = (first..=last).map(|_| normal(&mut rng)).collect();
    let own = drawn.iter().map(|value| value * value).sum::<f64>().sqrt();
    truth.with_added_ncpa(telescope, basis, drawn.iter().map(|value| value * rms_nm / own).collect())
}

/// The segments follow a focus of `size` nm RMS over the pupil with their pistons and tilts.
fn smooth_surface(truth: Truth, telescope: &Telescope, size: f64, _: u64) -> Result<Truth> {
    let segments = &telescope.pupil.segments;
    let squares: Vec<f64> = segments.iter().map(|own| own.x_m.powi(2) + own.y_m.powi(2)).collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    let rms = (squares.iter().map(|own| (own - mean).powi(2)).sum::<f64>() / squares.len() as f64).sqrt();
    if rms == 0.0 {
        return Err(Error::Internal("all segments are at one distance from the axis".into()));
    }
    let amount_nm = size / rms;
    let pistons_nm =
        truth.piston_nm.iter().zip(&squares).map(|(own, square)| own + amount_nm * (square - mean)).collect();
    // RMS of x over a hexagon of side 0.9 m: √(5/24) of it.
    let unit_m = 0.9 * (5.0f64 / 24.0).sqrt();
    let tilts_nm =
        segments.iter().map(|own| [own.x_m, own.y_m].map(|along| 2.0 * amount_nm * along * unit_m)).collect();
    truth.with_pistons(telescope, pistons_nm)?.with_tilts(telescope, tilts_nm)
}

/// Pixel `at` of `frame`, from its middle, along x and y.
fn place(frame: &Array2<f64>, (y, x): (usize, usize)) -> [f64; 2] {
    [(x, frame.ncols()), (y, frame.nrows())].map(|(at, size)| at as f64 - (size / 2) as f64)
}

fn peak(frame: &Array2<f64>) -> f64 {
    frame.iter().copied().fold(0.0, f64::max)
}

/// Multiplies each pixel by 1 plus what `more` says of its place.
fn scale(frame: &mut Array2<f64>, more: impl Fn(f64, f64) -> f64) {
    let [middle_x, middle_y] = [frame.ncols(), frame.nrows()].map(|size| (size / 2) as f64);
    Zip::indexed(frame).for_each(|(y, x), e| *e *= 1.0 + more(x as f64 - middle_x, y as f64 - middle_y));
}

/// Adds a share of the peak times what `form` says of a pixel's place.
fn add(frame: &mut Array2<f64>, share: f64, form: impl Fn(f64, f64) -> f64) {
    let [middle_x, middle_y] = [frame.ncols(), frame.nrows()].map(|size| (size / 2) as f64);
    let amount = share * peak(frame);
    Zip::indexed(frame).for_each(|(y, x), e| *e += amount * form(x as f64 - middle_x, y as f64 - middle_y));
}

/// A normal deviate (Box and Muller 1958).
fn normal(rng: &mut impl RngExt) -> f64 {
    let [radius, angle] = [rng.random::<f64>(), rng.random::<f64>()];
    (-2.0 * (1.0 - radius).ln()).sqrt() * (TAU * angle).cos()
}

/// Multiplies by a random pattern of an RMS of `rms` about 1, smoothed over `width` pixels.
fn structured(frame: &mut Array2<f64>, rms: f64, width: f64, seed: u64) {
    let mut rng = stream(seed, 900);
    let white = Array2::from_shape_simple_fn(frame.dim(), || normal(&mut rng));
    let mut pattern = filtered(&white, |x, y| (-0.5 * (TAU * width).powi(2) * (x * x + y * y)).exp().into());
    pattern -= pattern.mean().unwrap_or_default();
    let own = (pattern.mapv(|value| value * value).mean().unwrap_or_default()).sqrt();
    Zip::from(frame).and(&pattern).for_each(|e, value| *e *= 1.0 + rms * value / own);
}

/// `share` of the light spread by exp(−r/length).
pub(in crate::reproduce) fn halo(psf: &Array2<f64>, share: f64, length: f64) -> Array2<f64> {
    filtered(psf, |x, y| (1.0 - share + share * (1.0 + (TAU * length).powi(2) * (x * x + y * y)).powf(-1.5)).into())
}

/// A second star, `share` of both.
fn companion(psf: &Array2<f64>, share: f64, [x, y]: [f64; 2]) -> Array2<f64> {
    filtered(psf, |u, v| (1.0 - share) + share * Complex64::cis(-TAU * (u * x + v * y)))
}

/// `map` at places moved by what `by` says, pixels, of a place from the middle: the Taylor series
/// to second order, with a next term of 10⁻⁴ of the light for a third of a pixel.
fn moved(map: &Array2<f64>, by: impl Fn(f64, f64) -> [f64; 2]) -> Array2<f64> {
    let along = |frequency: f64| Complex64::new(0.0, if frequency <= -0.5 { 0.0 } else { TAU * frequency });
    let [h_x, h_y] = [filtered(map, |x, _| along(x)), filtered(map, |_, y| along(y))];
    let [h_xx, h_yy] = [filtered(map, |x, _| along(x).powi(2)), filtered(map, |_, y| along(y).powi(2))];
    let h_xy = filtered(map, |x, y| along(x) * along(y));
    Array2::from_shape_fn(map.dim(), |at| {
        let [x, y] = place(map, at);
        let [dx, dy] = by(x, y);
        let second = 0.5 * dx * dx * h_xx[at] + dx * dy * h_xy[at] + 0.5 * dy * dy * h_yy[at];
        map[at] + dx * h_x[at] + dy * h_y[at] + second
    })
}

/// `map` whose transform is multiplied by `factor` of the frequencies along x and y, cycles per
/// pixel.
fn filtered(map: &Array2<f64>, factor: impl Fn(f64, f64) -> Complex64) -> Array2<f64> {
    let mut values = map.mapv(Complex64::from);
    let plans = [0, 1].map(|axis| plan_both::<f64>(map.len_of(Axis(axis))));
    let transform = |values: &mut Array2<Complex64>, is_forward: bool| {
        for (axis, (forward, inverse)) in plans.iter().enumerate() {
            let plan = if is_forward { forward } else { inverse };
            for mut lane in values.lanes_mut(Axis(axis)) {
                let mut line = lane.to_vec();
                plan.process(&mut line);
                lane.iter_mut().zip(line).for_each(|(out, value)| *out = value);
            }
        }
    };
    transform(&mut values, true);
    let (rows, columns) = map.dim();
    let frequency =
        |at: usize, size: usize| (if 2 * at < size { at as f64 } else { at as f64 - size as f64 }) / size as f64;
    Zip::indexed(&mut values).for_each(|(y, x), value| *value *= factor(frequency(x, columns), frequency(y, rows)));
    transform(&mut values, false);
    values.mapv(|value| value.re / (rows * columns) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spot() -> Array2<f64> {
        Array2::from_shape_fn((48, 48), |(y, x)| {
            (-((x as f64 - 26.0).powi(2) + (y as f64 - 21.0).powi(2)) / 18.0).exp()
        })
    }

    #[test]
    fn images_move_by_what_they_should() {
        let far =
            |a: &Array2<f64>, b: &Array2<f64>| Zip::from(a).and(b).fold(0.0, |most: f64, a, b| most.max((a - b).abs()));
        let wanted = Array2::from_shape_fn((48, 48), |(y, x)| {
            (-((x as f64 - 26.1).powi(2) + (y as f64 - 21.0).powi(2)) / 18.0).exp()
        });
        // The third term of the series is 0.1³/6 of a third derivative of 0.05.
        assert!(far(&moved(&spot(), |_, _| [-0.1, 0.0]), &wanted) < 1e-5);
        let both = companion(&spot(), 0.25, [4.0, -2.0]);
        assert!((both[[19, 30]] - (0.25 + 0.75 * spot()[[19, 30]])).abs() < 1e-6, "{}", both[[19, 30]]);
    }

    #[test]
    fn every_fault_changes_what_it_should() {
        for fault in &FAULTS {
            let size = fault.sizes[2];
            let is_changed = match fault.change {
                Change::Scene(keys) => keys(size).is_empty() == (size == 0.0),
                Change::Truth(_) => size > 0.0,
                Change::Psf(change) => change(&spot(), size) != spot(),
                Change::Detector(change) => {
                    let mut frame = spot() * 1e5;
                    change(&mut frame, size, 3);
                    frame != spot() * 1e5
                }
            };
            assert!(is_changed, "{}", fault.name);
        }
    }
}
