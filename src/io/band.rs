//! Photometric bands that the name of a filter states: the broad bands of the optical and near
//! infrared.
//!
//! Only a name that is unambiguously a broad band counts: `H2`, `Hcont`, `Br_gamma` and `PK50_1.5`
//! are none, and neither are names that mean different bands in different systems, such as `y`
//! (Strömgren's at 547 nm) or `L` (luminance).

/// Band of a filter: all wavelengths within `tolerance`, relative to the larger of the two, of its
/// centre.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Band {
    names: &'static [&'static str],
    /// Centre, nm.
    pub centre_nm: f64,
    /// Largest relative distance from the centre. The half-power points are at 5 to 10 %; more is
    /// allowed, because spellings and systems differ, and so is a narrow filter near the edge.
    pub tolerance: f64,
}

const fn infrared(names: &'static [&'static str], centre_nm: f64) -> Band {
    Band { names, centre_nm, tolerance: 0.15 }
}

/// The optical bands of one letter differ between the systems of Johnson, Cousins and SDSS.
const fn optical(names: &'static [&'static str], centre_nm: f64) -> Band {
    Band { names, centre_nm, tolerance: 0.2 }
}

/// Names in lower case, without the separators and the words of [`SYSTEMS`]. Centres: Tokunaga &
/// Vacca 2005 (PASP 117, 421) for the Mauna Kea filters, with which 2MASS and NIRC2 agree within 2
/// %; Bessell 2005 (ARA&A 43, 293) for the optical.
const BANDS: [Band; 15] = [
    optical(&["u", "u'"], 360.0),
    optical(&["b"], 440.0),
    optical(&["g", "g'"], 480.0),
    optical(&["v"], 550.0),
    optical(&["r", "r'"], 640.0),
    optical(&["i", "i'"], 790.0),
    optical(&["z", "z'"], 950.0),
    infrared(&["y"], 1020.0),
    infrared(&["j"], 1250.0),
    infrared(&["h"], 1635.0),
    infrared(&["k"], 2200.0),
    infrared(&["ks", "kshort"], 2150.0),
    infrared(&["k'", "kp", "kprime"], 2120.0),
    infrared(&["l'", "lp", "lprime"], 3780.0),
    infrared(&["m'", "mp", "mprime", "ms"], 4680.0),
];

/// Letters that are bands in the other case only: Strömgren's b, v and y; Gaia's G.
const OTHER_SYSTEMS: [&str; 4] = ["b", "v", "y", "G"];

/// Words beside the name of a band.
const SYSTEMS: [&str; 13] = [
    "band", "filter", "mko", "2mass", "nirc2", "ukidss", "wfcam", "vista", "johnson", "cousins", "bessell", "bessel",
    "sdss",
];

impl Band {
    /// The band that `filter` names, such as `K'`, `H (MKO)` or `Kp + clear`; `None` where it names
    /// none, or two.
    pub(super) fn named(filter: &str) -> Option<Self> {
        let mut bands = filter.split(['+', ',', ';', '/', '&', '|']).filter_map(Self::of_one);
        let band = bands.next()?;
        bands.all(|other| other == band).then_some(band)
    }

    /// The band of one of the filters that the light passes.
    fn of_one(filter: &str) -> Option<Self> {
        let words = filter.split(|c: char| !(c.is_alphanumeric() || c == '\''));
        let name: String = words.filter(|word| !SYSTEMS.contains(&word.to_lowercase().as_str())).collect();
        let lower = name.to_lowercase();
        let is_other = OTHER_SYSTEMS.contains(&name.as_str());
        BANDS.into_iter().find(|band| !is_other && band.names.contains(&lower.as_str()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_broad_bands_are_recognised_and_others_are_not() {
        for (centre_nm, names) in [
            (1250.0, &["J", "j", "J band", "MKO J"][..]),
            (1635.0, &["H", " H ", "H-band", "H (2MASS)", "clear + H", "PK50_1.5 + H", "H + H"]),
            (2200.0, &["K", "K_MKO"]),
            (2150.0, &["Ks", "KS", "K_s", "K_short", "2MASS Ks", "Ks,OPEN"]),
            (2120.0, &["K'", "Kp", "Kp + clear", "Kp+clear", "K-prime"]),
            (3780.0, &["L'", "Lp"]),
            (4680.0, &["M'", "Ms", "Mp"]),
            (1020.0, &["Y"]),
            (640.0, &["R", "r", "r'", "SDSS r", "sdss_r", "Cousins R"]),
            (480.0, &["g", "g'"]),
        ] {
            for name in names {
                assert_eq!(Band::named(name).map(|band| band.centre_nm), Some(centre_nm), "{name}");
            }
        }
        for name in [
            "",
            " ",
            "clear",
            "open",
            "PK50_1.5",
            "PK50_1.5 + FEII",
            "FeII",
            "Br-gamma",
            "Br_gamma",
            "BrG",
            "H2",
            "H2_1-0",
            "H2O_ice",
            "Hcont",
            "H-alpha",
            "Kcont",
            "NB2.108",
            "CH4_short",
            "CO",
            "HeI",
            "F160W",
            "J + H",
            "H/K",
            "JH",
            "L",
            "M",
            "y",
            "v",
            "G",
            "1",
            "K 2.2",
            "I+z",
        ] {
            assert_eq!(Band::named(name), None, "{name}");
        }
    }
}
