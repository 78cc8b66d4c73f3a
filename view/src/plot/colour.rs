//! Colours: the palette of the lines, the colour maps, and the scales from a value to a colour.

use super::axis::{Axis, Scale, usable};
use ndarray::ArrayView2;

/// 8-bit sRGB.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rgb(pub u8, pub u8, pub u8);

pub(super) const INK: Rgb = Rgb(0x1f, 0x23, 0x28);
pub(super) const MUTED: Rgb = Rgb(0x5c, 0x63, 0x6b);
pub(super) const AXIS: Rgb = Rgb(0x4a, 0x50, 0x57);
pub(super) const GRID: Rgb = Rgb(0xe6, 0xe8, 0xeb);
pub(super) const WHITE: Rgb = Rgb(255, 255, 255);
/// Where there is no value: outside the pupil, a masked pixel.
pub(super) const NOTHING: Rgb = Rgb(0xd9, 0xdb, 0xde);

/// Colours of the series, in order: Okabe and Ito's set, which colour-blind readers distinguish
/// (Nature Methods 8, 441).
pub(super) const SERIES: [Rgb; 7] = [
    Rgb(0x00, 0x72, 0xb2),
    Rgb(0xd5, 0x5e, 0x00),
    Rgb(0x00, 0x9e, 0x73),
    Rgb(0xcc, 0x79, 0xa7),
    Rgb(0xe6, 0x9f, 0x00),
    Rgb(0x56, 0xb4, 0xe9),
    Rgb(0x55, 0x55, 0x55),
];

/// ColorBrewer's RdBu in 11 classes, reversed: blue is negative, red positive, zero nearly white.
const DIVERGING: [Rgb; 11] = [
    Rgb(0x05, 0x30, 0x61),
    Rgb(0x21, 0x66, 0xac),
    Rgb(0x43, 0x93, 0xc3),
    Rgb(0x92, 0xc5, 0xde),
    Rgb(0xd1, 0xe5, 0xf0),
    Rgb(0xf7, 0xf7, 0xf7),
    Rgb(0xfd, 0xdb, 0xc7),
    Rgb(0xf4, 0xa5, 0x82),
    Rgb(0xd6, 0x60, 0x4d),
    Rgb(0xb2, 0x18, 0x2b),
    Rgb(0x67, 0x00, 0x1f),
];

/// matplotlib's viridis at tenths.
const SEQUENTIAL: [Rgb; 10] = [
    Rgb(0x44, 0x01, 0x54),
    Rgb(0x48, 0x28, 0x78),
    Rgb(0x3e, 0x4a, 0x89),
    Rgb(0x31, 0x68, 0x8e),
    Rgb(0x26, 0x82, 0x8e),
    Rgb(0x1f, 0x9e, 0x89),
    Rgb(0x35, 0xb7, 0x79),
    Rgb(0x6e, 0xce, 0x58),
    Rgb(0xb5, 0xde, 0x2b),
    Rgb(0xfd, 0xe7, 0x25),
];

/// matplotlib's inferno at tenths: black sky, bright star.
const LIGHT: [Rgb; 10] = [
    Rgb(0x00, 0x00, 0x04),
    Rgb(0x1b, 0x0c, 0x41),
    Rgb(0x4a, 0x0c, 0x6b),
    Rgb(0x78, 0x1c, 0x6d),
    Rgb(0xa5, 0x2c, 0x60),
    Rgb(0xcf, 0x44, 0x46),
    Rgb(0xed, 0x69, 0x25),
    Rgb(0xfb, 0x9b, 0x06),
    Rgb(0xf7, 0xd1, 0x3d),
    Rgb(0xfc, 0xff, 0xa4),
];

/// Beyond this part of the values a colour scale ends: one wild pixel must not grey out the rest.
const KEPT: f64 = 0.998;

/// An asinh stretch is linear below this part of the range and logarithmic above: a defocused
/// star's rings span about two decades.
const KNEE: f64 = 0.02;

/// A scale from a value to a colour.
#[derive(Debug, Clone)]
pub(super) struct Shade {
    stops: &'static [Rgb],
    axis: Axis,
    /// Values lie below, above the scale.
    clipped: (bool, bool),
}

impl Shade {
    /// Symmetric about zero, common to `maps`, reaching at least `least`.
    pub fn diverging(maps: &[ArrayView2<f64>], least: f64) -> Self {
        let mut sizes: Vec<f64> = values(maps).map(f64::abs).collect();
        let limit = positive_or_one(quantile(&mut sizes, KEPT).max(least));
        let axis = Axis::exact(-limit, limit, Scale::Linear);
        Self { stops: &DIVERGING, clipped: beyond(maps, &axis), axis }
    }

    /// From zero (or the lowest value, if negative) to the highest.
    pub fn sequential(maps: &[ArrayView2<f64>]) -> Self {
        let (low, high) = bounds(maps);
        let low = low.min(0.0);
        let axis = Axis::exact(low, low + positive_or_one(high - low), Scale::Linear);
        Self { stops: &SEQUENTIAL, clipped: beyond(maps, &axis), axis }
    }

    /// For images: asinh from the darkest of `maps` to the brightest, or a little above the
    /// brightest of `model`, lest a cosmic ray dim the star.
    pub fn stretched(maps: &[ArrayView2<f64>], model: ArrayView2<f64>) -> Self {
        let (low, brightest) = bounds(maps);
        let signal = bounds(&[model]).1 - low;
        let high = if signal > 0.0 { brightest.min(low + 1.1 * signal) } else { brightest };
        let range = positive_or_one(high - low);
        let axis = Axis::exact(low, low + range, Scale::Asinh { knee: KNEE * range });
        Self { stops: &LIGHT, clipped: beyond(maps, &axis), axis }
    }

    /// The colour of `value`; [`NOTHING`] where it is not finite.
    pub fn colour(&self, value: f64) -> Rgb {
        match usable(value) {
            None => NOTHING,
            Some(value) => self.at(self.axis.fraction(value)),
        }
    }

    /// The colour at a fraction of the scale, 0 (lowest) to 1.
    pub fn at(&self, fraction: f64) -> Rgb {
        let last = self.stops.len() - 1;
        let position = fraction.clamp(0.0, 1.0) * last as f64;
        let below = (position as usize).min(last - 1);
        let part = position - below as f64;
        let (a, b) = (self.stops[below], self.stops[below + 1]);
        let mix = |a: u8, b: u8| (f64::from(a) + (f64::from(b) - f64::from(a)) * part).round() as u8;
        Rgb(mix(a.0, b.0), mix(a.1, b.1), mix(a.2, b.2))
    }

    /// The scale's axis, for the colour bar.
    pub fn axis(&self) -> &Axis {
        &self.axis
    }

    /// Whether values lie (below, above) the scale.
    pub fn clipped(&self) -> (bool, bool) {
        self.clipped
    }
}

fn values<'a>(maps: &'a [ArrayView2<'a, f64>]) -> impl Iterator<Item = f64> + 'a {
    maps.iter().flat_map(|map| map.iter().copied().filter_map(usable))
}

/// Lowest and highest value with [`KEPT`] of the values between 1 − KEPT and KEPT; (0, 0) where
/// there is none.
fn bounds(maps: &[ArrayView2<f64>]) -> (f64, f64) {
    let mut all: Vec<f64> = values(maps).collect();
    let low = quantile(&mut all, 1.0 - KEPT);
    // The brightest pixels of an image are its signal, not its outliers: keep them all.
    let high = all.iter().copied().fold(low, f64::max);
    (low, high)
}

fn positive_or_one(v: f64) -> f64 {
    // Below the smallest normal number a division by the range overflows.
    if v > f64::MIN_POSITIVE { v } else { 1.0 }
}

/// The smallest element with at least `q` of the elements at or below it; 0 of none.
fn quantile(values: &mut [f64], q: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let rank = ((values.len() as f64 * q).ceil() as usize).clamp(1, values.len()) - 1;
    *values.select_nth_unstable_by(rank, f64::total_cmp).1
}

fn beyond(maps: &[ArrayView2<f64>], axis: &Axis) -> (bool, bool) {
    values(maps).fold((false, false), |(below, above), v| (below || v < axis.low(), above || v > axis.high()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn zero_is_neutral_plus_is_red_minus_is_blue() {
        let map = array![[-2.0, 0.0, 2.0]];
        let shade = Shade::diverging(&[map.view()], 0.0);
        assert_eq!(shade.colour(0.0), Rgb(0xf7, 0xf7, 0xf7));
        assert_eq!(shade.colour(2.0), Rgb(0x67, 0x00, 0x1f));
        assert_eq!(shade.colour(-9.0), Rgb(0x05, 0x30, 0x61));
        assert_eq!(shade.colour(f64::NAN), NOTHING);
        assert_eq!(shade.colour(f64::INFINITY), NOTHING);
    }

    #[test]
    fn one_wild_pixel_does_not_set_the_scale_but_is_announced() {
        let mut map = Array2::from_shape_fn((100, 100), |(i, _)| i as f64 / 99.0);
        map[[0, 0]] = 1e6;
        let shade = Shade::diverging(&[map.view()], 0.0);
        assert_eq!(shade.axis().high(), 1.0);
        assert_eq!(shade.clipped(), (false, true));
    }

    #[test]
    fn a_faint_ring_is_seen_in_the_stretch() {
        let map = array![[0.0, 0.02, 1.0]];
        let shade = Shade::stretched(&[map.view()], map.view());
        // asinh(1)/asinh(50) = 0.19 of the way up, against 0.02 on a linear scale.
        assert!((shade.axis().fraction(0.02) - 0.191).abs() < 1e-3);
    }

    #[test]
    fn a_cosmic_ray_does_not_dim_the_star() {
        let (data, model) = (array![[0.0, 95.0, 1e6]], array![[0.0, 100.0, 5.0]]);
        let shade = Shade::stretched(&[data.view(), model.view()], model.view());
        assert!((shade.axis().high() - 110.0).abs() < 1e-9, "{:?}", shade.axis());
        assert_eq!(shade.clipped(), (false, true));
    }

    #[test]
    fn empty_constant_and_non_finite_maps_have_a_scale() {
        for map in [array![[f64::NAN]], array![[0.0]], array![[7.0]], Array2::zeros((0, 0)), array![[1e308, -1e308]]] {
            for shade in [
                Shade::diverging(&[map.view()], 0.0),
                Shade::sequential(&[map.view()]),
                Shade::stretched(&[map.view()], map.view()),
            ] {
                let axis = shade.axis();
                assert!(axis.low().is_finite() && axis.high() > axis.low(), "{map}: {axis:?}");
            }
        }
    }
}
