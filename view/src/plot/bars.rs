//! Mode coefficients with their error bars, and their residuals where the truth is known.

use super::axis::{Axis, usable};
use super::canvas::{Canvas, Pen, Rect};
use super::colour::{AXIS, INK, MUTED, Rgb};
use super::font::{self, Ink};
use super::frame::{ABOVE, BELOW, Frame, LABEL_EM, LEFT, PANEL_EM, TICK_EM, panel_title, x_number, x_tick};
use super::panel::{rms_text, root_mean_square};

/// To which part of the wavefront a mode belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ModeGroup {
    /// A segment's piston (or tip, or tilt).
    Segment,
    /// A mode of the non-common path aberrations.
    Ncpa,
}

/// Mode coefficients, all lists of one length.
#[derive(Debug, Clone, Default)]
pub struct ModalBars {
    /// Names; a common stem before their numbers ("piston 1", "piston 2") becomes the label of the
    /// axis.
    pub names: Vec<String>,
    /// The panel of each mode.
    pub groups: Vec<ModeGroup>,
    /// Estimates, nm.
    pub estimate_nm: Vec<f64>,
    /// 1σ, nm.
    pub sigma_nm: Vec<f64>,
    /// True coefficients, nm, where they are known.
    pub truth_nm: Option<Vec<f64>>,
}

const BAR: Rgb = Rgb(0x9d, 0xc3, 0xe0);
const TRUTH: Rgb = Rgb(0xd5, 0x5e, 0x00);
const ERROR: Rgb = Rgb(0x1f, 0x3f, 0x5f);

/// Height of a row of bars; `strip` adds the residuals.
pub(super) fn row_height(strip: bool) -> f64 {
    ABOVE + 250.0 + if strip { 126.0 } else { 0.0 } + BELOW
}

/// Draws the groups of `bars` side by side in `cell`, each as wide as its number of modes asks.
pub(super) fn draw(canvas: &mut Canvas, bars: &ModalBars, cell: Rect) {
    let groups: Vec<Group> = [(ModeGroup::Segment, "Segment modes"), (ModeGroup::Ncpa, "NCPA modes")]
        .into_iter()
        .map(|(group, name)| Group::of(bars, group, name))
        .filter(|group| !group.modes.is_empty())
        .collect();
    let total: usize = groups.iter().map(|g| g.modes.len()).sum();
    let shares: Vec<f64> = groups.iter().map(|g| (g.modes.len() as f64 / total as f64).max(0.3)).collect();
    let sum: f64 = shares.iter().sum();
    let mut x = cell.x;
    for (group, share) in groups.iter().zip(shares) {
        let w = cell.w * share / sum;
        group.draw(canvas, Rect { x, w, ..cell });
        x += w;
    }
}

/// One mode: estimate, 1σ and truth in nm, where they are finite.
struct Mode {
    estimate: Option<f64>,
    sigma: Option<f64>,
    truth: Option<f64>,
}

impl Mode {
    fn residual(&self) -> Option<f64> {
        Some(self.estimate? - self.truth?)
    }
}

struct Group<'a> {
    name: &'a str,
    names: Vec<&'a str>,
    modes: Vec<Mode>,
    with_truth: bool,
}

impl<'a> Group<'a> {
    fn of(bars: &'a ModalBars, group: ModeGroup, name: &'a str) -> Self {
        let members: Vec<usize> = (0..bars.groups.len()).filter(|&i| bars.groups[i] == group).collect();
        let mode = |&i: &usize| Mode {
            estimate: usable(bars.estimate_nm[i]),
            sigma: usable(bars.sigma_nm[i]).map(f64::abs),
            truth: bars.truth_nm.as_ref().and_then(|truth| usable(truth[i])),
        };
        Self {
            name,
            names: members.iter().map(|&i| bars.names[i].as_str()).collect(),
            modes: members.iter().map(mode).collect(),
            with_truth: bars.truth_nm.is_some(),
        }
    }

    fn draw(&self, canvas: &mut Canvas, cell: Rect) {
        let room = Rect { x: cell.x + LEFT, y: cell.y + ABOVE, w: cell.w - LEFT - 16.0, h: cell.h - ABOVE - BELOW };
        let main_h = if self.with_truth { room.h - 126.0 } else { room.h };
        let main = self.bars(canvas, Rect { h: main_h, ..room });
        panel_title(canvas, main.plot, self.name, "");
        self.legend(canvas, main.plot);
        let lowest = if self.with_truth {
            self.strip(canvas, Rect { y: room.y + main_h + 16.0, h: 110.0, ..room })
        } else {
            main
        };
        let prefix = common_prefix(&self.names);
        let labels: Vec<&str> = self.names.iter().map(|name| &name[prefix.len()..]).collect();
        self.mode_axis(canvas, &lowest, &labels);
        let label = prefix.trim_end_matches([' ', '_', '-', '.', '#']);
        lowest.x_label(canvas, if label.is_empty() { "mode" } else { label });
    }

    fn frame(&self, plot: Rect, values: impl Iterator<Item = f64>) -> Frame {
        let modes = self.modes.len() as f64;
        let y = Axis::around(values.chain([0.0]), false);
        Frame { plot, x: Axis::exact(-0.5 - 0.01 * modes, modes * 1.01 - 0.5, super::axis::Scale::Linear), y }
    }

    /// Width of one mode on the page.
    fn pitch(&self, frame: &Frame) -> f64 {
        frame.x_at(1.0) - frame.x_at(0.0)
    }

    fn bars(&self, canvas: &mut Canvas, plot: Rect) -> Frame {
        let reach = |m: &Mode| {
            let (e, s) = (m.estimate, m.sigma.unwrap_or(0.0));
            [e.map(|e| e - s), e.map(|e| e + s), m.truth].into_iter().flatten()
        };
        let frame = self.frame(plot, self.modes.iter().flat_map(reach));
        frame.y_grid(canvas);
        let pitch = plot.w / self.modes.len() as f64 / 1.02;
        let zero = frame.y_at(0.0);
        for (i, mode) in self.modes.iter().enumerate() {
            let x = frame.x_at(i as f64);
            let Some(estimate) = mode.estimate else { continue };
            let y = frame.y_at(estimate);
            let w = (pitch * if pitch > 4.0 { 0.74 } else { 1.0 }).min(90.0);
            canvas.fill(Rect { x: x - w / 2.0, y: y.min(zero), w, h: (y - zero).abs() }, BAR, 1.0);
            self.error_bar(canvas, &frame, (i, estimate), mode.sigma);
        }
        canvas.line((plot.x, zero), (plot.right(), zero), Pen::solid(AXIS, 1.5));
        for (i, truth) in self.modes.iter().enumerate().filter_map(|(i, m)| Some((i, m.truth?))) {
            diamond(canvas, frame.at(i as f64, truth), (pitch * 0.3).clamp(2.0, 6.0));
        }
        frame.outline(canvas);
        frame.y_axis(canvas, "coefficient (nm)");
        frame
    }

    fn error_bar(&self, canvas: &mut Canvas, frame: &Frame, (i, centre): (usize, f64), sigma: Option<f64>) {
        let Some(sigma) = sigma.filter(|&s| s > 0.0) else { return };
        let pitch = self.pitch(frame);
        let pen = Pen::solid(ERROR, if pitch > 8.0 { 2.0 } else { 1.0 });
        let (x, top) = frame.at(i as f64, centre + sigma);
        let bottom = frame.y_at(centre - sigma);
        canvas.line((x, top), (x, bottom), pen);
        if pitch > 8.0 {
            let cap = (pitch * 0.2).min(7.0);
            for y in [top, bottom] {
                canvas.line((x - cap, y), (x + cap, y), pen);
            }
        }
    }

    /// Estimate minus truth, on its own scale.
    fn strip(&self, canvas: &mut Canvas, plot: Rect) -> Frame {
        let reach = |m: &Mode| {
            let (r, s) = (m.residual(), m.sigma.unwrap_or(0.0));
            [r.map(|r| r - s), r.map(|r| r + s)].into_iter().flatten()
        };
        let frame = self.frame(plot, self.modes.iter().flat_map(reach));
        frame.y_grid(canvas);
        let zero = frame.y_at(0.0);
        canvas.line((plot.x, zero), (plot.right(), zero), Pen::solid(AXIS, 1.5));
        let radius = (self.pitch(&frame) * 0.25).clamp(1.5, 4.5);
        for (i, mode) in self.modes.iter().enumerate() {
            let Some(residual) = mode.residual() else { continue };
            self.error_bar(canvas, &frame, (i, residual), mode.sigma);
            canvas.disc(frame.at(i as f64, residual), radius, ERROR);
        }
        frame.outline(canvas);
        frame.y_axis(canvas, "residual");
        frame
    }

    /// Names below the axis, thinned until they fit.
    fn mode_axis(&self, canvas: &mut Canvas, frame: &Frame, labels: &[&str]) {
        let bottom = frame.plot.bottom();
        let longest = frame.plot.w / 4.0;
        let labels: Vec<String> = labels.iter().map(|label| font::fitted(label, TICK_EM, longest)).collect();
        let widest = labels.iter().map(|label| font::width(label, TICK_EM)).fold(0.0, f64::max);
        let pitch = frame.plot.w / labels.len() as f64 / 1.02;
        let every = [1, 2, 5, 10, 20, 50, 100, 200, 500]
            .into_iter()
            .find(|&n| n as f64 * pitch >= widest + 8.0)
            .unwrap_or(labels.len().max(1));
        for (i, label) in labels.iter().enumerate().step_by(every) {
            let x = frame.x_at(i as f64);
            x_tick(canvas, x, bottom, 6.0);
            x_number(canvas, x, bottom, label);
        }
    }

    /// At the right of the panel's name, from the right and as far as there is room: the RMS of the
    /// residuals, then what diamonds, bars and error bars are. (A panel too narrow for all has a
    /// wider neighbour that says it.)
    fn legend(&self, canvas: &mut Canvas, plot: Rect) {
        let y = plot.y - 13.0;
        let leftmost = plot.x + font::width(self.name, PANEL_EM) + 24.0;
        let mut end = plot.right();
        // Where the entry starts, if it fits with its symbol.
        let mut place = |text: &str, symbol: f64| {
            let start = end - font::width(text, LABEL_EM);
            let fits = start - symbol >= leftmost;
            end = if fits { start - symbol - 22.0 } else { f64::NEG_INFINITY };
            fits.then_some(start)
        };
        if self.with_truth {
            let rms = root_mean_square(self.modes.iter().filter_map(Mode::residual));
            let text = format!("residual {}", rms_text(rms, "nm"));
            if place(&text, 0.0).is_some() {
                canvas.text((plot.right(), y), &text, Ink::new(LABEL_EM, MUTED).end());
            }
            if let Some(x) = place("truth", 22.0) {
                canvas.text((x, y), "truth", Ink::new(LABEL_EM, INK));
                diamond(canvas, (x - 15.0, y - 6.5), 6.0);
            }
        }
        let text = "estimate ± 1σ";
        if let Some(x) = place(text, 26.0) {
            canvas.text((x, y), text, Ink::new(LABEL_EM, INK));
            canvas.fill(Rect { x: x - 25.0, y: y - 15.0, w: 14.0, h: 16.0 }, BAR, 1.0);
            canvas.line((x - 18.0, y - 19.0), (x - 18.0, y - 10.0), Pen::solid(ERROR, 2.0));
        }
    }
}

fn diamond(canvas: &mut Canvas, (x, y): (f64, f64), r: f64) {
    canvas.polygon(&[(x, y - r), (x + r, y), (x, y + r), (x - r, y)], TRUTH);
}

/// What all names share before their numbers: "piston 1", "piston 12" give "piston "; nothing,
/// where a name does not end in a number.
fn common_prefix<'a>(names: &[&'a str]) -> &'a str {
    let stem = |name: &'a str| name.trim_end_matches(|c: char| c.is_ascii_digit());
    let Some(&first) = names.first() else { return "" };
    let prefix = stem(first);
    if names.iter().all(|&name| stem(name) == prefix && name.len() > prefix.len()) { prefix } else { "" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbered_names_share_their_stem() {
        assert_eq!(common_prefix(&["piston 1", "piston 12"]), "piston ");
        assert_eq!(common_prefix(&["Z4", "Z5", "KL1"]), "");
        assert_eq!(common_prefix(&["focus"]), "");
        assert_eq!(common_prefix(&[]), "");
    }
}
