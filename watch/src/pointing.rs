//! The star's pointing over some frames.

use crate::store::StoredFrame;

/// Root of the mean square of its distance from its mean place, pixels, over the frames that have a
/// result; `None` for fewer than two.
pub fn rms_pixels<'a>(frames: impl IntoIterator<Item = &'a StoredFrame>) -> Option<f64> {
    let place = |frame: &StoredFrame| frame.pointing_x_pixels.zip(frame.pointing_y_pixels);
    let places: Vec<(f64, f64)> = frames.into_iter().filter_map(place).collect();
    let count = places.len() as f64;
    let mean = |axis: fn(&(f64, f64)) -> f64| places.iter().map(axis).sum::<f64>() / count;
    let (x, y) = (mean(|place| place.0), mean(|place| place.1));
    let square = places.iter().map(|place| (place.0 - x).powi(2) + (place.1 - y).powi(2)).sum::<f64>() / count;
    (places.len() > 1).then(|| square.sqrt())
}
