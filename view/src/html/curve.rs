//! Curves over time as SVG.

use super::escape::escape;

/// A curve: a line through its values, or dots where it is `dotted`.
pub struct Curve<'a> {
    pub values: &'a [Option<f64>],
    pub dotted: bool,
}

const SIZE: [f64; 2] = [360.0, 160.0];
/// Space for the axes: left, right, top, bottom.
const SPACE: [f64; 4] = [46.0, 8.0, 8.0, 20.0];

/// Curves over the same times, s since 1970; `clock` writes a time.
pub fn curve(title: &str, times_s: &[f64], curves: &[Curve], clock: &dyn Fn(f64) -> String) -> String {
    let [width, height] = SIZE;
    let [left, right, top, bottom] = SPACE;
    let known = || curves.iter().flat_map(|curve| curve.values).flatten().copied().filter(|value| value.is_finite());
    let (mut least, mut most) = known().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    let caption = format!("<figcaption>{}</figcaption>", escape(title));
    if least > most {
        return format!("<figure><p class=\"none\">no values</p>{caption}</figure>");
    }
    if most - least < 1e-9 * most.abs().max(1.0) {
        (least, most) = (least - 0.5, most + 0.5);
    }
    let (begin, end) = times_s.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(*t), b.max(*t)));
    let part = |t: f64| if end > begin { (t - begin) / (end - begin) } else { 0.5 };
    let x = |t: f64| left + part(t) * (width - left - right);
    let y = |value: f64| top + (most - value) / (most - least) * (height - top - bottom);
    let mut svg = format!("<svg viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\">", escape(title));
    for value in ticks(least, most) {
        svg += &format!(
            "<line class=\"axis\" x1=\"{left}\" x2=\"{}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/><text class=\"tick\" x=\"{}\" y=\"{:.1}\" \
             text-anchor=\"end\">{}</text>",
            width - right,
            left - 6.0,
            y(value) + 4.0,
            short(value),
            at = y(value)
        );
    }
    svg += &format!("<text class=\"tick\" x=\"{left}\" y=\"{}\">{}</text>", height - 4.0, escape(&clock(begin)));
    svg += &format!(
        "<text class=\"tick\" x=\"{}\" y=\"{}\" text-anchor=\"end\">{}</text>",
        width - right,
        height - 4.0,
        escape(&clock(end))
    );
    for curve in curves {
        let mut points: Vec<(f64, f64)> = times_s
            .iter()
            .zip(curve.values)
            .filter_map(|(t, value)| Some((*t, (*value).filter(|v| v.is_finite())?)))
            .collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        if curve.dotted {
            points.iter().for_each(|(t, value)| {
                svg += &format!("<circle class=\"dot\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"1.5\"/>", x(*t), y(*value));
            });
        } else {
            let points: Vec<String> =
                points.iter().map(|(t, value)| format!("{:.1},{:.1}", x(*t), y(*value))).collect();
            svg += &format!("<polyline class=\"line\" points=\"{}\"/>", points.join(" "));
        }
    }
    format!("<figure>{svg}</svg>{caption}</figure>")
}

/// Round numbers between two values, some four.
fn ticks(least: f64, most: f64) -> Vec<f64> {
    let raw = (most - least) / 4.0;
    let power = 10.0_f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|step| *step >= raw).unwrap_or(raw);
    let first = (least / step).ceil();
    (0..8).map(|k| (first + f64::from(k)) * step).take_while(|value| *value <= most + 1e-6 * step).collect()
}

/// A number as short as it can be read.
fn short(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.1e}");
    }
    let text = format!("{value:.4}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
