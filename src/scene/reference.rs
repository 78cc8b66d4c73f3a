//! The reference of all keys, printed from the table that the parser uses.

use super::directory_of_keys;
use std::fmt::Write;

/// Suffixes of keys and the units they stand for, longer ones first.
const UNITS: [(&str, &str); 11] = [
    ("_over_d", "pixels per λ/grid_m"),
    ("_waves_rms", "waves RMS"),
    ("_cycles", "cycles per grid_m"),
    ("_m_s", "m/s"),
    ("_deg", "degrees"),
    ("_rad", "radians"),
    ("_nm", "nm"),
    ("_hz", "Hz"),
    ("_m", "m"),
    ("_s", "s"),
    ("_e", "electrons"),
];

/// Every section and key of a scene: what it is, its unit, what is accepted and the default, as text.
pub fn reference() -> String {
    let mut text = String::from("A scene names what is there; nothing that it does not name is modelled.\n");
    for section in directory_of_keys() {
        // Writing to a String cannot fail.
        let _ = write!(text, "\n[{}]{}\n", section.name, section.about);
        for key in section.keys {
            let unit = unit_of(key.name).map(|unit| format!(" ({unit})")).unwrap_or_default();
            let _ = writeln!(text, "  {}{unit}:{}", key.name, key.about);
            let _ = writeln!(text, "      accepted: {}; default: {}", key.accepted, key.default);
        }
    }
    text
}

/// The unit that stands in a key's name.
fn unit_of(key: &str) -> Option<&'static str> {
    UNITS.iter().find(|(suffix, _)| key.ends_with(suffix)).map(|(_, unit)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_follow_from_the_names() {
        assert_eq!(unit_of("wind_m_s"), Some("m/s"));
        assert_eq!(unit_of("segment_side_m"), Some("m"));
        assert_eq!(unit_of("diversity_focus_waves_rms"), Some("waves RMS"));
        assert_eq!(unit_of("filtered_modes"), None);
        assert_eq!(unit_of("pixels"), None);
    }
}
