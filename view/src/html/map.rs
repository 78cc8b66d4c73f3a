//! Maps as pictures within a page.

use super::escape::escape;
use crate::plot;
use cophase::Result;
use ndarray::ArrayView2;

pub use crate::plot::MapColours as Colours;

/// A figure with a map, its title, and the range of its colours in `unit`.
///
/// # Errors
/// Those of encoding the picture.
pub fn map(title: &str, values: ArrayView2<f64>, colours: Colours, unit: &str) -> Result<String> {
    let plot::MapImage { png_base64, low, high } = plot::map_image(values, colours)?;
    let number = |value: f64| if value.abs() < 1e4 { format!("{value:.1}") } else { format!("{value:.2e}") };
    let title = escape(title);
    Ok(format!(
        "<figure><img alt=\"{title}\" src=\"data:image/png;base64,{png_base64}\"><figcaption>{title}: {} to {} {}</figcaption></figure>",
        number(low),
        number(high),
        escape(unit)
    ))
}
