//! Orders, axes, signs and unit in which slopes are measured: the discrete alternatives to
//! `[all x, all y]` over the subapertures in use, row by row.

use super::lenslets::Lenslets;
use crate::scene::{SensorScene, SlopeOrder};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2};
use std::collections::HashMap;

/// All orders but the expected one.
pub(crate) const OTHER_SLOPE_ORDERS: [SlopeOrder; 12] = [
    SlopeOrder::YBeforeX,
    SlopeOrder::Interleaved,
    SlopeOrder::ColumnMajor,
    SlopeOrder::OppositeX,
    SlopeOrder::OppositeY,
    SlopeOrder::FlippedX,
    SlopeOrder::FlippedY,
    SlopeOrder::Rotated180,
    SlopeOrder::Transposed,
    SlopeOrder::Rotated90,
    SlopeOrder::Rotated270,
    SlopeOrder::TransposedBack,
];

/// Form in which slopes were measured: order, axes, signs and unit, as the scene says.
#[derive(Debug, Clone)]
pub struct SlopeFormat {
    /// Where each expected slope is among the measured ones, and its sign there.
    sources: Vec<(usize, f64)>,
    unit_mas: f64,
}

impl SlopeFormat {
    /// The form of `scene` for these subapertures in use.
    ///
    /// # Errors
    /// [`Error::Value`] for an order that subapertures without that symmetry cannot have.
    pub fn new(scene: &SensorScene, lenslets: &Lenslets) -> Result<Self> {
        let mut sources: Vec<(usize, f64)> = (0..2 * lenslets.subapertures.len()).map(|slope| (slope, 1.0)).collect();
        // The order that is undone first is the one that the measured slopes have: the later ones
        // are sources within its result.
        for &order in &scene.slope_order {
            let next = slope_sources(order, lenslets.across, &lenslets.subapertures).ok_or_else(|| {
                Error::Value(format!(
                    "wavefront_sensor.slope_order = \"{}\" is not accepted: the subapertures in use do not have that symmetry",
                    order.word()
                ))
            })?;
            sources = next.iter().map(|&(at, sign)| (sources[at].0, sources[at].1 * sign)).collect();
        }
        Ok(Self { sources, unit_mas: scene.slope_unit_mas })
    }

    /// The expected slopes `[image, slope]`, mas, of measured ones.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes.
    pub fn expected_mas(&self, measured: ArrayView2<f64>) -> Result<Array2<f64>> {
        self.check(measured.ncols())?;
        Ok(Array2::from_shape_fn(measured.dim(), |(image, slope)| {
            let (source, sign) = self.sources[slope];
            sign * self.unit_mas * measured[[image, source]]
        }))
    }

    /// The slopes `[image, slope]` as they would be measured, of expected ones, mas.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes.
    pub fn measured(&self, expected_mas: ArrayView2<f64>) -> Result<Array2<f64>> {
        self.check(expected_mas.ncols())?;
        let mut measured = Array2::zeros(expected_mas.dim());
        for (slope, &(source, sign)) in self.sources.iter().enumerate() {
            measured.column_mut(source).assign(&(&expected_mas.column(slope) * (sign / self.unit_mas)));
        }
        Ok(measured)
    }

    /// Unit of measured slopes for a card `BUNIT`: `mas`, or none where a slope of 1 is another
    /// angle.
    pub(in crate::ao) fn unit(&self) -> &'static str {
        if self.unit_mas == 1.0 { "mas" } else { "" }
    }

    /// Number of slopes.
    pub(super) fn slopes(&self) -> usize {
        self.sources.len()
    }

    fn check(&self, slopes: usize) -> Result<()> {
        let needed = self.sources.len();
        if slopes == needed {
            return Ok(());
        }
        Err(Error::Shape(format!(
            "{slopes} slopes were given: {needed} are needed, two for each of the scene's {} subapertures",
            needed / 2
        )))
    }
}

/// Exchange of x and y, and then flips of x and y, from the expected coordinates to those of
/// `order`.
fn symmetry(order: SlopeOrder) -> Option<(bool, [bool; 2])> {
    match order {
        SlopeOrder::FlippedX => Some((false, [true, false])),
        SlopeOrder::FlippedY => Some((false, [false, true])),
        SlopeOrder::Rotated180 => Some((false, [true, true])),
        SlopeOrder::Transposed => Some((true, [false, false])),
        SlopeOrder::Rotated90 => Some((true, [true, false])),
        SlopeOrder::Rotated270 => Some((true, [false, true])),
        SlopeOrder::TransposedBack => Some((true, [true, true])),
        _ => None,
    }
}

/// Where each expected slope is in `order`, and its sign there; `None` where the subapertures
/// (`row·across + column`, ascending) do not have the symmetry.
pub(crate) fn slope_sources(order: SlopeOrder, across: usize, subapertures: &[usize]) -> Option<Vec<(usize, f64)>> {
    let count = subapertures.len();
    let plain = |source: &dyn Fn(usize) -> (usize, f64)| Some((0..2 * count).map(source).collect());
    if let Some((exchange, flip)) = symmetry(order) {
        return mirrored(exchange, flip, across, subapertures);
    }
    match order {
        SlopeOrder::YBeforeX => plain(&|slope| ((slope + count) % (2 * count), 1.0)),
        SlopeOrder::Interleaved => plain(&|slope| (2 * (slope % count) + slope / count, 1.0)),
        SlopeOrder::ColumnMajor => {
            let mut by_column: Vec<usize> = (0..count).collect();
            by_column.sort_by_key(|&i| (subapertures[i] % across, subapertures[i] / across));
            let mut rank = vec![0; count];
            by_column.iter().enumerate().for_each(|(place, &i)| rank[i] = place);
            plain(&|slope| (rank[slope % count] + slope / count * count, 1.0))
        }
        SlopeOrder::OppositeX => plain(&|slope| (slope, if slope < count { -1.0 } else { 1.0 })),
        SlopeOrder::OppositeY => plain(&|slope| (slope, if slope < count { 1.0 } else { -1.0 })),
        _ => plain(&|slope| (slope, 1.0)),
    }
}

/// Sources under a symmetry of the square. With W(u, v) = W'(u', v'), where u' is ±u or, exchanged,
/// ±v, a slope along u is ± the one along the file's axis that u became.
fn mirrored(
    exchange: bool,
    [flip_x, flip_y]: [bool; 2],
    across: usize,
    subapertures: &[usize],
) -> Option<Vec<(usize, f64)>> {
    let count = subapertures.len();
    let index: HashMap<usize, usize> = subapertures.iter().enumerate().map(|(i, &place)| (place, i)).collect();
    let reflect = |at: usize, flip: bool| if flip { across - 1 - at } else { at };
    let sign = |flip: bool| if flip { -1.0 } else { 1.0 };
    let mut sources = vec![(0, 0.0); 2 * count];
    for (i, &place) in subapertures.iter().enumerate() {
        let (row, column) = (place / across, place % across);
        let (u, v) = if exchange { (row, column) } else { (column, row) };
        let there = *index.get(&(reflect(v, flip_y) * across + reflect(u, flip_x)))?;
        let (along_x, along_y) = ((there, sign(flip_x)), (count + there, sign(flip_y)));
        (sources[i], sources[count + i]) = if exchange { (along_y, along_x) } else { (along_x, along_y) };
    }
    Some(sources)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Slopes of W = x²·(2y + 1) + y³/3 about the centre of a 3 × 3 array without one corner pair,
    /// in another frame.
    #[test]
    fn sources_undo_each_order() {
        let across = 4;
        // A symmetric set: all but the corners.
        let subapertures: Vec<usize> = (0..16).filter(|i| ![0, 3, 12, 15].contains(i)).collect();
        let count = subapertures.len();
        let at = |i: usize| (i as f64) - 1.5;
        let wavefront = |u: f64, v: f64| u * u * (2.0 * v + 1.0) + v * v * v / 3.0 + 0.3 * u;
        let slopes = |w: &dyn Fn(f64, f64) -> f64| {
            let h = 1e-4;
            let places = || subapertures.iter().map(|p| (at(p % across), at(p / across)));
            let x = places().map(|(u, v)| (w(u + h, v) - w(u - h, v)) / (2.0 * h));
            let y = places().map(|(u, v)| (w(u, v + h) - w(u, v - h)) / (2.0 * h));
            x.chain(y).collect::<Vec<f64>>()
        };
        let expected = slopes(&wavefront);
        // The file's wavefront W'(g(x)) = W(x), so W' = W∘g⁻¹.
        type Field<'a> = &'a dyn Fn(f64, f64) -> f64;
        let orientations: [(SlopeOrder, Field); 4] = [
            (SlopeOrder::FlippedX, &|u, v| wavefront(-u, v)),
            (SlopeOrder::Rotated180, &|u, v| wavefront(-u, -v)),
            (SlopeOrder::Transposed, &|u, v| wavefront(v, u)),
            // g(u, v) = (−v, u): g⁻¹(u', v') = (v', −u').
            (SlopeOrder::Rotated90, &|u, v| wavefront(v, -u)),
        ];
        let restored = |order: SlopeOrder, given: &[f64]| -> Vec<f64> {
            let sources = slope_sources(order, across, &subapertures).unwrap();
            sources.iter().map(|&(source, sign)| sign * given[source]).collect()
        };
        for (order, other) in orientations {
            let found = restored(order, &slopes(other));
            assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{order:?}");
        }
        let interleaved: Vec<f64> = (0..2 * count).map(|i| expected[i / 2 + i % 2 * count]).collect();
        assert_eq!(restored(SlopeOrder::Interleaved, &interleaved), expected);
        let swapped = [&expected[count..], &expected[..count]].concat();
        assert_eq!(restored(SlopeOrder::YBeforeX, &swapped), expected);
        let mut by_column: Vec<usize> = (0..count).collect();
        by_column.sort_by_key(|&i| (subapertures[i] % across, subapertures[i] / across));
        let columns: Vec<f64> =
            by_column.iter().map(|&i| expected[i]).chain(by_column.iter().map(|&i| expected[count + i])).collect();
        assert_eq!(restored(SlopeOrder::ColumnMajor, &columns), expected);
        assert!(slope_sources(SlopeOrder::FlippedX, across, &subapertures[1..]).is_none());

        // Two orders, one after the other, and a unit: there and back.
        let text = "[image]\nwavelength_nm = 2000\npixels = 64\n[wavefront_sensor]\nslope_unit_mas = -250\n\
                    slope_order = [\"interleaved\", \"rotated-90\"]\n";
        let scene = crate::scene::Scene::from_text(text, std::path::Path::new("")).unwrap();
        let light = vec![1.0; count];
        let lenslets = Lenslets { across, samples: 2, pitch_m: 1.0, subapertures: subapertures.clone(), light };
        let format = SlopeFormat::new(scene.wavefront_sensor.as_ref().unwrap(), &lenslets).unwrap();
        let turned = slopes(&|u, v| wavefront(v, -u));
        let measured = Array2::from_shape_fn((1, 2 * count), |(_, i)| -turned[i / 2 + i % 2 * count] / 250.0);
        let found = format.expected_mas(measured.view()).unwrap();
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6));
        // Rounding of a product and a quotient.
        assert!((format.measured(found.view()).unwrap() - &measured).iter().all(|off| off.abs() < 1e-12));
        assert!(format.measured(Array2::zeros((1, 3)).view()).is_err());
    }
}
