//! From values to fractions of an axis, its ticks, and numbers as text.

/// How values spread along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Scale {
    Linear,
    /// Linear, for values that are integers: ticks at integers only.
    Integer,
    Log,
    /// asinh((v − low)/knee): linear below `knee`, logarithmic above.
    Asinh {
        knee: f64,
    },
}

/// A tick and its label; minor ticks have none.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub value: f64,
    pub label: String,
}

/// An axis from `low` to `high`, both finite, `low < high`; positive on a log scale.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Axis {
    low: f64,
    high: f64,
    scale: Scale,
}

/// `v`, if it can be drawn: finite, and small enough that the difference of two does not overflow.
pub(super) fn usable(v: f64) -> Option<f64> {
    (v.abs() <= 1e300).then_some(v)
}

impl Axis {
    /// From `low` to `high` as they are, widened only where they coincide.
    pub fn exact(low: f64, high: f64, scale: Scale) -> Self {
        let (low, high) = (usable(low).unwrap_or(0.0), usable(high).unwrap_or(1.0));
        if scale == Scale::Log {
            let (low, high) = if low > 0.0 && high >= low { (low, high) } else { (0.1, 10.0) };
            return if high > low * 1.001 {
                Self { low, high, scale }
            } else {
                Self { low: low / 2.0, high: high * 2.0, scale }
            };
        }
        // Below a billionth of the values the labels would need more digits than they have.
        let least = 1e-9 * low.abs().max(high.abs());
        if high - low > least {
            Self { low, high, scale }
        } else {
            let half = if low == 0.0 { 1.0 } else { low.abs() / 2.0 };
            Self { low: low - half, high: low + half, scale }
        }
    }

    /// Round `values` with a margin of 4 % (of the decades, on a log scale).
    pub fn around(values: impl Iterator<Item = f64>, log: bool) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for v in values.filter_map(usable).filter(|&v| !log || v > 0.0) {
            low = low.min(v);
            high = high.max(v);
        }
        if low > high {
            return Self::exact(
                if log { 0.1 } else { 0.0 },
                if log { 10.0 } else { 1.0 },
                if log { Scale::Log } else { Scale::Linear },
            );
        }
        if log {
            let Self { low, high, scale } = Self::exact(low, high, Scale::Log);
            let margin = (high.ln() - low.ln()) * 0.04;
            return Self { low: low * (-margin).exp(), high: high * margin.exp(), scale };
        }
        let Self { low, high, scale } = Self::exact(low, high, Scale::Linear);
        let margin = (high - low) * 0.04;
        Self { low: low - margin, high: high + margin, scale }
    }

    /// This linear axis for values that are integers.
    pub fn of_integers(self) -> Self {
        let holds_two = self.high.floor() - self.low.ceil() >= 1.0;
        let scale = if self.scale == Scale::Linear && holds_two { Scale::Integer } else { self.scale };
        Self { scale, ..self }
    }

    pub fn low(&self) -> f64 {
        self.low
    }

    pub fn high(&self) -> f64 {
        self.high
    }

    /// Where `v` lies: 0 at `low`, 1 at `high`, held between.
    pub fn fraction(&self, v: f64) -> f64 {
        let part = match self.scale {
            Scale::Linear | Scale::Integer => (v - self.low) / (self.high - self.low),
            Scale::Log if v <= 0.0 => 0.0,
            Scale::Log => (v / self.low).ln() / (self.high / self.low).ln(),
            Scale::Asinh { knee } => ((v - self.low) / knee).max(0.0).asinh() / ((self.high - self.low) / knee).asinh(),
        };
        if part.is_nan() { 0.0 } else { part.clamp(0.0, 1.0) }
    }

    /// About `count` labelled ticks, within the axis, in rising order.
    pub fn ticks(&self, count: usize) -> Vec<Tick> {
        let count = count.max(2);
        match self.scale {
            // A coarse step may leave one tick, which does not show the scale: then a finer step.
            Scale::Linear => [count, 2 * count, 4 * count]
                .map(|count| linear_ticks(self.low, self.high, count))
                .into_iter()
                .find(|ticks| ticks.len() > 1)
                .unwrap_or_default(),
            // A step of at least 1 from the list of `stepped_ticks` is an integer.
            Scale::Integer => stepped_ticks(self.low, self.high, ((self.high - self.low) / count as f64).max(1.0)),
            Scale::Log => log_ticks(self.low, self.high, count),
            Scale::Asinh { .. } => self.asinh_ticks(count),
        }
    }

    /// Unlabelled ticks of a log axis: 2 to 9 in each decade.
    pub fn minor_ticks(&self) -> Vec<f64> {
        let decades = self.low.log10().floor() as i32..=self.high.log10().floor() as i32;
        if self.scale != Scale::Log || decades.clone().count() > 12 {
            return Vec::new();
        }
        decades
            .flat_map(|decade| (2..10).map(move |digit| f64::from(digit) * 10f64.powi(decade)))
            .filter(|v| (self.low..=self.high).contains(v))
            .collect()
    }

    /// 0 and the 1, 2, 5 of each decade, from the top down, as far apart as `count` evenly spaced
    /// ones.
    fn asinh_ticks(&self, count: usize) -> Vec<Tick> {
        let largest = self.low.abs().max(self.high.abs());
        let top = largest.log10().floor() as i32;
        let candidates = (0..6).flat_map(|n| [5.0, 2.0, 1.0].map(|digit| digit * 10f64.powi(top - n)));
        let mut kept: Vec<f64> = Vec::new();
        for v in candidates.chain([0.0]).filter(|v| (self.low..=self.high).contains(v)) {
            let gap = 0.8 / count as f64;
            if kept.iter().all(|&k| (self.fraction(k) - self.fraction(v)).abs() >= gap) {
                kept.push(v);
            }
        }
        if kept.len() < 2 {
            return linear_ticks(self.low, self.high, count);
        }
        kept.sort_by(f64::total_cmp);
        kept.into_iter().map(|value| Tick { value, label: short(value) }).collect()
    }
}

fn linear_ticks(low: f64, high: f64, count: usize) -> Vec<Tick> {
    stepped_ticks(low, high, (high - low) / count as f64)
}

/// Ticks at multiples of 1, 2, 5 or 10 times a power of ten, at least `raw` apart.
fn stepped_ticks(low: f64, high: f64, raw: f64) -> Vec<Tick> {
    let decade = 10f64.powf(raw.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|digit| digit * decade).into_iter().find(|&s| s >= raw * 0.999);
    let Some(step) = step.filter(|s| s.is_normal()) else { return Vec::new() };
    // The slack keeps a bound that is itself a multiple of the step.
    let (first, last) = ((low / step - 1e-6).ceil(), (high / step + 1e-6).floor());
    let values: Vec<f64> = (0..50).map(|i| first + f64::from(i)).take_while(|&i| i <= last).map(|i| i * step).collect();
    let largest = low.abs().max(high.abs());
    // Plain digits where they are few, a common power of ten elsewhere.
    let power = if (1e-3..1e5).contains(&largest) { 0 } else { largest.log10().floor() as i32 };
    let decimals = (f64::from(power) - (step.log10() + 1e-9).floor()).clamp(0.0, 12.0) as usize;
    let label = |v: f64| match power {
        _ if v == 0.0 => "0".to_string(),
        0 => signed(v, decimals),
        _ => format!("{}×{}", signed(v / 10f64.powi(power), decimals), power_of_ten(power)),
    };
    values.into_iter().map(|value| Tick { value, label: label(value) }).collect()
}

fn log_ticks(low: f64, high: f64, count: usize) -> Vec<Tick> {
    let (first, last) = ((low.log10() - 1e-9).ceil() as i32, (high.log10() + 1e-9).floor() as i32);
    let decades = (last - first + 1).max(0) as usize;
    let digits: &[f64] = match decades {
        0 | 1 if (high / low) < 4.0 => return linear_ticks(low, high, count),
        0..=2 if count >= 3 => &[1.0, 2.0, 5.0],
        _ => &[1.0],
    };
    let every = decades.div_ceil(count).max(1);
    (first - 1..=last)
        .filter(|decade| (decade - first).rem_euclid(every as i32) == 0)
        .flat_map(|decade| digits.iter().map(move |digit| (digit * 10f64.powi(decade), *digit, decade)))
        .filter(|(value, ..)| (low * (1.0 - 1e-9)..=high * (1.0 + 1e-9)).contains(value))
        .map(|(value, digit, decade)| {
            let label = match (decade, digit as i32) {
                (-3..=4, _) => short(value),
                (_, 1) => power_of_ten(decade),
                (_, digit) => format!("{digit}×{}", power_of_ten(decade)),
            };
            Tick { value, label }
        })
        .collect()
}

/// `v` with `decimals` places and a true minus sign.
fn signed(v: f64, decimals: usize) -> String {
    let text = format!("{v:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().any(|c| c.is_ascii_digit() && c != '0') => format!("−{digits}"),
        Some(digits) => digits.to_string(),
        None => text,
    }
}

/// `v` with as few digits as name it, up to four.
fn short(v: f64) -> String {
    if v == 0.0 {
        return "0".into();
    }
    let power = (v.abs().log10() + 1e-9).floor() as i32;
    if !(-4..=4).contains(&power) {
        let mantissa = trimmed(signed(v / 10f64.powi(power), 3));
        return if mantissa == "1" { power_of_ten(power) } else { format!("{mantissa}×{}", power_of_ten(power)) };
    }
    trimmed(signed(v, (3 - power).max(0) as usize))
}

fn trimmed(text: String) -> String {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
}

fn power_of_ten(power: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    let raised = |c: char| c.to_digit(10).map_or('⁻', |d| DIGITS[d as usize]);
    format!("10{}", power.to_string().chars().map(raised).collect::<String>())
}

/// `v` with three significant digits; a dash where there is none.
pub(super) fn figure(v: f64) -> String {
    match usable(v) {
        None => "–".into(),
        Some(0.0) => "0".into(),
        Some(v) => {
            let power = v.abs().log10().floor() as i32;
            if (-3..=5).contains(&power) {
                signed(v, (2 - power).clamp(0, 5) as usize)
            } else {
                format!("{}×{}", signed(v / 10f64.powi(power), 2), power_of_ten(power))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(ticks: &[Tick]) -> Vec<&str> {
        ticks.iter().map(|t| t.label.as_str()).collect()
    }

    #[test]
    fn linear_ticks_are_round_numbers() {
        let axis = Axis::exact(-83.0, 83.0, Scale::Linear);
        assert_eq!(labels(&axis.ticks(5)), ["−50", "0", "50"]);
        assert_eq!(labels(&Axis::exact(0.0, 1.0, Scale::Linear).ticks(5)), ["0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(labels(&Axis::exact(0.0, 4e5, Scale::Linear).ticks(4)), ["0", "1×10⁵", "2×10⁵", "3×10⁵", "4×10⁵"]);
        assert_eq!(labels(&Axis::exact(0.0, 2e-4, Scale::Linear).ticks(2)), ["0", "1×10⁻⁴", "2×10⁻⁴"]);
    }

    #[test]
    fn axes_of_integers_have_integer_ticks() {
        let axis = |low, high| Axis::exact(low, high, Scale::Linear).of_integers();
        assert_eq!(labels(&axis(0.96, 2.04).ticks(6)), ["1", "2"]);
        assert_eq!(labels(&axis(-0.5, 3.5).ticks(9)), ["0", "1", "2", "3"]);
        assert_eq!(labels(&axis(0.0, 40.0).ticks(4)), ["0", "10", "20", "30", "40"]);
        // No two integers: as any other axis.
        assert!(axis(0.6, 1.4).ticks(4).len() > 1);
    }

    #[test]
    fn log_ticks_are_decades_and_thin_out() {
        assert_eq!(labels(&Axis::exact(0.5, 2000.0, Scale::Log).ticks(6)), ["1", "10", "100", "1000"]);
        assert_eq!(labels(&Axis::exact(8.0, 150.0, Scale::Log).ticks(6)), ["10", "20", "50", "100"]);
        let wide = Axis::exact(1e-30, 1e30, Scale::Log).ticks(6);
        assert!((4..=7).contains(&wide.len()), "{wide:?}");
    }

    #[test]
    fn any_range_has_a_usable_axis() {
        let odd = [f64::NAN, f64::INFINITY, 0.0, -0.0, 1e-320, 1e308, -5.0, 5.0 + 1e-15, 5.0];
        for low in odd {
            for high in odd {
                for scale in [Scale::Linear, Scale::Log, Scale::Asinh { knee: 0.1 }] {
                    let axis = Axis::exact(low, high, scale);
                    assert!(axis.low < axis.high && axis.low.is_finite() && axis.high.is_finite(), "{axis:?}");
                    assert!(axis.ticks(6).len() < 60);
                    assert!((0.0..=1.0).contains(&axis.fraction(low)));
                }
            }
        }
    }

    #[test]
    fn numbers_are_written_briefly() {
        assert_eq!([52.34, 8.096, 1234.0, 0.0, -0.0321].map(figure), ["52.3", "8.10", "1234", "0", "−0.0321"]);
        assert_eq!(figure(f64::NAN), "–");
        assert_eq!(figure(3.2e-9), "3.20×10⁻⁹");
    }
}
