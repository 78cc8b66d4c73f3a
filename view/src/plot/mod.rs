//! Pictures from results, as PNG or SVG (the file's extension says which), from plain data only.
//!
//! * [`EstimatePicture`]: the maps, coefficients and image of an estimate, beside the truth where
//!   that is known.
//! * [`CurvePicture`]: series with error bars on linear or logarithmic axes.
//! * [`MapsPicture`]: a grid of captioned maps.
//! * [`NumberingPicture`]: a pupil with the numbers of its segments.
//!
//! Maps are `[row = y, col = x]` with row 0 at the bottom, so that the telescope's y axis points
//! up. Values that are not finite are drawn as nothing, and never stop a picture. A file appears
//! whole or not at all.

mod axis;
mod bars;
mod canvas;
mod colour;
mod curve;
mod encode;
mod estimate;
mod font;
mod frame;
mod map_image;
mod maps;
mod numbering;
mod page;
mod panel;

pub use bars::{ModalBars, ModeGroup};
pub use curve::{CurvePicture, Marker, Series, SeriesStyle, Stroke};
pub use estimate::{EstimatePicture, ImageTriple, MapRms, MapTriple};
pub use map_image::{MapColours, MapImage, map_image};
pub use maps::{CaptionedMap, MapScale, MapsPicture};
pub use numbering::{Lattice, NumberingPicture};

/// Refuses a map that is not a positive number of metres wide.
fn check_width(width_m: f64, name: &str) -> cophase::Result<()> {
    if width_m > 0.0 && width_m.is_finite() {
        return Ok(());
    }
    Err(cophase::Error::Value(format!("the {name} map is {width_m} m wide: a positive width is needed")))
}
