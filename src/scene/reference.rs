//! Reference of all keys, generated from the parser's table.

use super::parameter::Optic;
use super::section_keys::SectionKeys;
use std::fmt::Write;

/// Suffixes of keys and their units, longer ones first.
const UNITS: [(&str, &str); 21] = [
    ("modulation_lambda_over_d", "wavelength_nm over grid_m"),
    ("_over_d", "pixels per λ/grid_m"),
    ("_waves_rms", "waves RMS"),
    ("_waves_pv", "waves, peak to valley"),
    ("_nm_rms", "nm RMS"),
    ("_arcsec", "arcsec"),
    ("_mas", "mas"),
    ("_mm", "mm"),
    ("_um", "µm"),
    ("_e_per_adu", "electrons per count"),
    ("_adu", "counts"),
    ("_cycles", "cycles per grid_m"),
    ("_m_s", "m/s"),
    ("_deg", "degrees"),
    ("_rad", "radians"),
    ("_nm", "nm"),
    ("_hz", "Hz"),
    ("_k", "K"),
    ("_m", "m"),
    ("_s", "s"),
    ("_e", "electrons"),
];

/// First lines of the reference.
const HEADER: &str = "\
A scene is a TOML file with the sections below. Only effects that a scene names are modelled.
Each key has its unit, its meaning, the accepted values, the default where a scene does not name it, and who reads it.
\"Simulations\" are the simulators, and the model selection of estimate.budget_nm, which simulates images; estimates ignore the
key. \"Estimates\": the simulators ignore the key.
";

/// The section with a list of channels, and the reference of that list.
const CHANNELS_BELOW: &str = "image";
const CHANNELS: &str = "
[[image.channel]] One way of imaging the wavefront; as many as there are channels.
  name: Name of the channel.
      accepted: 1 to 40 printable ASCII characters without '='; default: its number, from 1; read by: both
  Any key of [image] but simultaneous: in place of the one there. Pixels keep their angle on the sky where a channel names another
  wavelength_nm and not its samples_per_lambda_over_d.
";

/// Key whose words are optical parameters.
const FIT_OPTICS: &str = "fit_optics";

/// Reference of these sections and their keys, as text: unit, meaning, accepted values, default.
pub(super) fn reference_of(sections: Vec<SectionKeys>) -> String {
    let mut text = String::from(HEADER);
    for section in sections {
        // Writing to a String cannot fail.
        let _ = write!(text, "\n[{}]{}\n", section.name, section.about);
        for key in section.keys {
            let unit = unit_of(key.name).map(|unit| format!(" ({unit})")).unwrap_or_default();
            let more = if key.name == FIT_OPTICS { optics() } else { String::new() };
            let _ = writeln!(text, "  {}{unit}:{}{more}", key.name, key.about);
            let readers = readers(section.about, key.about);
            let _ = writeln!(text, "      accepted: {}; default: {}; read by: {readers}", key.accepted, key.default);
        }
        if section.name == CHANNELS_BELOW {
            text.push_str(CHANNELS);
        }
    }
    text
}

/// The words of [`FIT_OPTICS`] with the keys that each fits, to follow the key's text.
fn optics() -> String {
    format!(" {}.", Optic::all().map(Optic::listed).collect::<Vec<_>>().join(", "))
}

/// Who reads a key: what its text says, else what its section's says.
fn readers(section: &str, key: &str) -> &'static str {
    let said = [key, section].into_iter().find_map(|about| {
        let about = about.to_lowercase();
        let only = [
            ("read by 'cophase reduce'", "reduce"),
            ("simulation only.", "simulations"),
            ("estimate only.", "estimates"),
            ("read by ", "both"),
        ];
        only.into_iter().find(|(words, _)| about.contains(words)).map(|(_, readers)| readers)
    });
    said.unwrap_or("both")
}

/// Unit in the name of a key.
fn unit_of(key: &str) -> Option<&'static str> {
    UNITS.iter().find(|(suffix, _)| key.ends_with(suffix)).map(|(_, unit)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readers_follow_from_the_texts() {
        assert_eq!(readers(" Camera.", " Width."), "both");
        assert_eq!(readers(" Faults. Simulation only.", " RMS."), "simulations");
        assert_eq!(readers(" Camera.", " Whether it is mirrored. Estimate only."), "estimates");
        assert_eq!(readers(" Camera.", " Level. Read by 'cophase reduce'."), "reduce");
        assert_eq!(readers(" Control. Simulation only.", " Gain. Read by simulations and estimates."), "both");
    }

    #[test]
    fn units_follow_from_the_names() {
        assert_eq!(unit_of("wind_m_s"), Some("m/s"));
        assert_eq!(unit_of("segment_side_m"), Some("m"));
        assert_eq!(unit_of("diversity_focus_waves_rms"), Some("waves RMS"));
        assert_eq!(unit_of("filtered_modes"), None);
        assert_eq!(unit_of("pixels"), None);
    }
}
