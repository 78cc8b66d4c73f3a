//! Camera calibration: raw values to electrons.

use crate::{Error, Result};
use ndarray::Array2;

/// Calibration maps of a camera, `[y, x]`; a map that is absent is perfect.
#[derive(Debug, Clone, Default)]
pub struct CameraMaps {
    /// Signal without light, raw units.
    pub dark: Option<Array2<f64>>,
    /// Relative response, about 1.
    pub flat: Option<Array2<f64>>,
    /// Bad pixels, which take no part.
    pub bad: Option<Array2<bool>>,
}

/// Turns raw values into electrons: (raw − dark)·gain/flat. Pixels whose dark is not finite or
/// whose flat is not positive are bad; so is a value at or above the saturation.
#[derive(Debug, Clone)]
pub struct Calibration {
    dark: Array2<f64>,
    /// gain/flat.
    scale: Array2<f64>,
    bad: Array2<bool>,
    saturation: f64,
}

impl Calibration {
    /// A calibration for frames of `shape` (rows, columns). `gain_e` are electrons per raw unit;
    /// `saturation` is in raw units, and infinite where nothing saturates.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another shape, [`Error::Value`] for an impossible gain or
    /// saturation, or where no pixel is left.
    pub fn new(shape: (usize, usize), maps: CameraMaps, gain_e: f64, saturation: f64) -> Result<Self> {
        if !(gain_e.is_finite() && gain_e > 0.0) {
            return Err(Error::Value(format!("gain_e is {gain_e}: a positive number of electrons is accepted")));
        }
        if saturation.is_nan() {
            return Err(Error::Value("saturation is NaN: a raw value, or infinity, is accepted".into()));
        }
        let check = |name: &str, given: Option<(usize, usize)>| match given {
            Some((rows, columns)) if (rows, columns) != shape => Err(Error::Shape(format!(
                "the {name} has {columns}x{rows} pixels: {}x{} is accepted, the shape of a frame",
                shape.1, shape.0
            ))),
            _ => Ok(()),
        };
        check("dark", maps.dark.as_ref().map(Array2::dim))?;
        check("flat", maps.flat.as_ref().map(Array2::dim))?;
        check("bad-pixel map", maps.bad.as_ref().map(Array2::dim))?;
        let mut dark = maps.dark.unwrap_or_else(|| Array2::zeros(shape));
        let mut scale = maps.flat.map_or_else(|| Array2::from_elem(shape, gain_e), |flat| flat.mapv(|f| gain_e / f));
        let mut bad = maps.bad.unwrap_or_else(|| Array2::from_elem(shape, false));
        ndarray::Zip::from(&mut bad).and(&mut dark).and(&mut scale).for_each(|bad, dark, scale| {
            *bad |= !(dark.is_finite() && scale.is_finite() && *scale > 0.0);
            if *bad {
                (*dark, *scale) = (0.0, 0.0);
            }
        });
        if bad.iter().all(|bad| *bad) {
            return Err(Error::Value(
                "dark, flat and bad-pixel map leave no good pixel: finite darks and positive flats are accepted".into(),
            ));
        }
        Ok(Self { dark, scale, bad, saturation })
    }

    /// Rows and columns.
    pub fn shape(&self) -> (usize, usize) {
        self.bad.dim()
    }

    /// Number of pixels that are bad in every frame.
    pub fn bad_pixels(&self) -> usize {
        self.bad.iter().filter(|bad| **bad).count()
    }

    /// Whether the pixel in row `y` and column `x` is bad in every frame.
    pub fn is_bad(&self, y: usize, x: usize) -> bool {
        self.bad[[y, x]]
    }

    /// Electrons of the pixel in row `y` and column `x` that reads `raw`; `None` where it is bad.
    #[inline]
    pub fn electrons(&self, y: usize, x: usize, raw: f64) -> Option<f64> {
        let at = [y, x];
        let good = !self.bad[at] && raw.is_finite() && raw < self.saturation;
        good.then(|| (raw - self.dark[at]) * self.scale[at])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn maps(dark: f64, flat: f64) -> CameraMaps {
        let map = |value| Some(Array2::from_elem((2, 3), value));
        CameraMaps { dark: map(dark), flat: map(flat), bad: None }
    }

    #[test]
    fn raw_values_become_electrons() {
        let mut given = maps(100.0, 1.0);
        given.flat.as_mut().unwrap()[[1, 2]] = 0.5;
        given.flat.as_mut().unwrap()[[0, 1]] = 0.0;
        given.dark.as_mut().unwrap()[[0, 2]] = f64::NAN;
        given.bad = Some(Array2::from_shape_fn((2, 3), |at| at == (1, 0)));
        let calibration = Calibration::new((2, 3), given, 2.0, 4000.0).unwrap();
        assert_eq!(calibration.electrons(0, 0, 600.0), Some(1000.0));
        assert_eq!(calibration.electrons(1, 2, 600.0), Some(2000.0));
        assert_eq!(calibration.electrons(0, 0, 3999.0), Some(7798.0));
        // Saturated, not a number, no response, no dark, marked.
        for (y, x, raw) in [(0, 0, 4000.0), (0, 0, f64::NAN), (0, 1, 600.0), (0, 2, 600.0), (1, 0, 600.0)] {
            assert_eq!(calibration.electrons(y, x, raw), None, "{y} {x} {raw}");
        }
        assert_eq!(calibration.bad_pixels(), 3);
    }

    #[test]
    fn impossible_maps_are_refused() {
        let refused = |maps, gain_e, saturation| {
            Calibration::new((2, 3), maps, gain_e, saturation).map(|_| ()).unwrap_err().to_string()
        };
        assert!(refused(maps(0.0, 1.0), 0.0, 1.0).starts_with("gain_e is 0:"));
        assert!(refused(maps(0.0, 1.0), 1.0, f64::NAN).starts_with("saturation is NaN:"));
        assert!(refused(maps(0.0, -1.0), 1.0, 1.0).contains("no good pixel"));
        let turned = CameraMaps { flat: Some(Array2::ones((3, 2))), ..CameraMaps::default() };
        let turned = refused(turned, 1.0, 1.0);
        assert!(["flat", "has 2x3 pixels", "3x2"].iter().all(|fact| turned.contains(fact)), "{turned}");
    }
}
