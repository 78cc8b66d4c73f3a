//! Mirror as a picture in SVG: a hexagon for each segment with its number and value.

use super::escape::escape;

/// A segment of the picture.
#[derive(Debug, Clone)]
pub struct SegmentValue {
    /// Number or word that a reader knows it by.
    pub label: String,
    /// Centre, m; y is up.
    pub centre_m: [f64; 2],
    /// Value and its error bar, nm; `None` where nothing is known.
    pub value_nm: Option<[f64; 2]>,
}

/// Segments beyond which their text would be too small to read.
const MOST_LABELS: usize = 150;
/// Segment radius, in units of the picture, from which on its text grows no more.
const LARGEST_TEXT: f64 = 34.0;
/// Half of the side of the picture, in its units.
const REACH: f64 = 200.0;

/// The mirror, blue for negative and red for positive values; empty without segments.
pub fn mirror(segments: &[SegmentValue]) -> String {
    let centres: Vec<[f64; 2]> = segments.iter().map(|segment| segment.centre_m).collect();
    let Some(first) = centres.first() else { return String::new() };
    // The nearest neighbour of a hexagon is across an edge.
    let distance = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let nearest = centres[1..].iter().min_by(|a, b| distance(a, first).total_cmp(&distance(b, first)));
    let (inner_m, direction) = nearest
        .map_or((1.0, 0.0), |near| (distance(near, first) / 2.0, (near[1] - first[1]).atan2(near[0] - first[0])));
    let outer_m = 2.0 * inner_m / 3.0_f64.sqrt();
    let reach_m = centres.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max) + 1.02 * outer_m;
    let unit = REACH / reach_m;
    let values = segments.iter().filter_map(|segment| segment.value_nm);
    let scale_nm = values.map(|[nm, _]| nm.abs()).filter(|nm| nm.is_finite()).fold(1e-3, f64::max);
    let turn = direction + std::f64::consts::FRAC_PI_6;
    let mut svg = String::from(
        "<svg class=\"mirror\" viewBox=\"-202 -202 404 404\" role=\"img\" aria-label=\"Mirror, pistons of its segments\">",
    );
    for segment in segments {
        let [x, y] = segment.centre_m.map(|m| m * unit);
        let corner = |k: u8| {
            let angle = turn + f64::from(k) * std::f64::consts::FRAC_PI_3;
            let (sine, cosine) = angle.sin_cos();
            format!("{:.1},{:.1}", x + 0.98 * outer_m * unit * cosine, -y - 0.98 * outer_m * unit * sine)
        };
        let corners: Vec<String> = (0..6).map(corner).collect();
        let (colour, is_dark) = segment.value_nm.map_or(("#a0a0a0".into(), false), |[nm, _]| diverging(nm / scale_nm));
        let text = segment.value_nm.map_or("no value".into(), |[nm, sigma_nm]| format!("{nm:.2} ± {sigma_nm:.2} nm"));
        svg += &format!(
            "<polygon points=\"{}\" fill=\"{colour}\"><title>{}</title></polygon>",
            corners.join(" "),
            escape(&format!("segment {}: {text}", segment.label))
        );
        if segments.len() <= MOST_LABELS {
            let (ink, size) = (if is_dark { "#fff" } else { "#222" }, (inner_m * unit).min(LARGEST_TEXT));
            let value = segment.value_nm.map_or(String::new(), |[nm, _]| format!("{nm:.1}"));
            svg += &format!(
                "<text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"{:.1}\" font-weight=\"600\" fill=\"{ink}\">{}</text>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" font-size=\"{:.1}\" fill=\"{ink}\">{value}</text>",
                -y - 0.06 * size,
                0.55 * size,
                escape(&segment.label),
                -y + 0.5 * size,
                0.5 * size
            );
        }
    }
    format!(
        "{svg}</svg><p class=\"none\">Number and piston of each segment, nm of wavefront; blue to red: −{scale_nm:.1} to +{scale_nm:.1} nm.</p>"
    )
}

/// Colour of a value from −1 to 1, and whether text on it is white.
fn diverging(value: f64) -> (String, bool) {
    let part = value.clamp(-1.0, 1.0);
    let end = if part < 0.0 { [33.0, 102.0, 172.0] } else { [178.0, 24.0, 43.0] };
    let [r, g, b] = end.map(|end| (247.0 + (end - 247.0) * part.abs().powf(0.8)).round() as u16);
    (format!("rgb({r},{g},{b})"), r + g + b < 400)
}
