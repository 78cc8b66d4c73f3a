//! What makes an image hard: the case list.

use super::spoil::{Mismatch, Spoil};
use cophase::{Error, Result};
use ndarray::Axis;

/// Keys of a scene, or cards of a file, with their values.
pub(super) type Settings = &'static [(&'static str, &'static str)];

/// How often a case is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Draws {
    /// As often as was asked for.
    AsAsked,
    /// Five times as often: its share of right answers is wanted to a few per cent.
    FiveTimes,
    /// A quarter as often, and at least once: a sequence takes long.
    Quarter,
    /// Once.
    Once,
}

impl Draws {
    /// Their number where `seeds` were asked for.
    pub fn number(self, seeds: usize) -> usize {
        match self {
            Draws::AsAsked => seeds,
            Draws::FiveTimes => 5 * seeds,
            Draws::Quarter => (seeds / 4).max(1),
            Draws::Once => 1,
        }
    }
}

/// One hard case: what makes the images, what then goes wrong with them, and who reads them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HardCase {
    /// Of what kind it is.
    pub group: &'static str,
    /// Its name.
    pub name: &'static str,
    /// What is different in the scene that makes the images from `keck-artificial` at two pixels
    /// per λ/D.
    pub made: Settings,
    /// What goes wrong between the telescope and the file.
    pub spoil: Spoil,
    /// Cards of the FITS file from which the images are read; without any they are an array.
    pub cards: Settings,
    /// Beside `made`, what is different in the scene that reads them.
    pub read: Settings,
    /// How often it is drawn.
    pub draws: Draws,
}

/// The scene of all cases, beside the preset `keck-artificial`: two pixels per λ/D, which is all
/// that an image holds.
pub(in crate::reproduce) const BASE: Settings = &[("image.samples_per_lambda_over_d", "2"), ("image.pixels", "240")];

const fn case(group: &'static str, name: &'static str, made: Settings, spoil: Spoil, read: Settings) -> HardCase {
    HardCase { group, name, made, spoil, cards: &[], read, draws: Draws::AsAsked }
}

/// A strong aberration, or a star that is hard to see, read by a scene that knows all but the
/// truth.
const fn strong(name: &'static str, made: Settings) -> HardCase {
    case("strong", name, made, Spoil::None, &[])
}

const fn star(name: &'static str, made: Settings) -> HardCase {
    case("star", name, made, Spoil::None, &[])
}

const fn diversity(name: &'static str, made: Settings) -> HardCase {
    case("diversity", name, made, Spoil::None, &[])
}

const fn model(name: &'static str, made: Settings, read: Settings) -> HardCase {
    case("model wrong", name, made, Spoil::None, read)
}

const fn data(name: &'static str, spoil: Spoil) -> HardCase {
    case("data wrong", name, &[], spoil, &[])
}

const fn degenerate(name: &'static str, made: Settings, read: Settings) -> HardCase {
    case("degenerate", name, made, Spoil::None, read)
}

const fn often(case: HardCase) -> HardCase {
    HardCase { draws: Draws::FiveTimes, ..case }
}

/// Many images of one wavefront.
const fn sequence(name: &'static str, made: Settings) -> HardCase {
    HardCase { draws: Draws::Quarter, ..case("sequence", name, made, Spoil::None, &[]) }
}

const fn file(name: &'static str, spoil: Spoil, cards: Settings) -> HardCase {
    HardCase { cards, ..case("file", name, &[], spoil, &[]) }
}

/// A companion of `share` of the star's flux, `pixels` away along x and y.
const fn companion(name: &'static str, share: f64, pixels: [f64; 2]) -> HardCase {
    data(name, Spoil::Companion { share, pixels })
}

const fn telemetry(name: &'static str, mismatch: Mismatch) -> HardCase {
    HardCase { draws: Draws::Once, ..case("telemetry", name, &[], Spoil::Telemetry(mismatch), &[]) }
}

/// What a detector reads beside the star, electrons a pixel: 0.1 and 1 % of a peak of 250,000
/// electrons.
const BACKGROUNDS: [Settings; 2] = [&[("image.background_e", "250")], &[("image.background_e", "2500")]];
/// Strong pistons behind a defocus too small to spread their light: where fits end in wrong minima.
const WEAK_DEFOCUS: [Settings; 2] = [
    &[("aberrations.segment_piston_rms_nm", "500"), ("image.diversity_focus_waves_rms", "0.5")],
    &[("aberrations.segment_piston_rms_nm", "500"), ("image.diversity_focus_waves_rms", "0.25")],
];
/// Optics that are fitted beside the modes, and how far off the scene is.
const FITTED: [Settings; 5] = [
    &[("image.samples_per_lambda_over_d", "1.98"), ("estimate.fit_optics", "[\"plate-scale\"]")],
    &[("image.samples_per_lambda_over_d", "2.02"), ("estimate.fit_optics", "[\"plate-scale\"]")],
    &[("image.diversity_focus_waves_rms", "1.575"), ("estimate.fit_optics", "[\"defocus\"]")],
    &[("image.bandwidth_fraction", "0.04"), ("estimate.fit_optics", "[\"bandwidth\"]")],
    &[("image.pixel_fill", "0.8"), ("estimate.fit_optics", "[\"pixel-fill\"]")],
];
const SQUARES: Settings = &[("image.pixel_fill", "1")];
const TURNED: [Settings; 3] = [
    &[("pupil.rotation_deg", "1")],
    &[("pupil.rotation_deg", "0")],
    &[("pupil.rotation_deg", "0"), ("estimate.fit_optics", "[\"rotation\"]")],
];
/// A fit that ends in a wrong minimum stays there.
const ONE_TRY: Settings = &[("estimate.restarts", "0")];
/// Each of twenty Zernikes twice.
const DOUBLED: Settings = &[("modes.ncpa", "zernike"), ("modes.ncpa_count", "20"), ("modes.exact_zernikes", "[2, 21]")];

/// All of them.
pub static HARD_CASES: [HardCase; 108] = [
    case("nominal", "64 nm pistons, 73 nm NCPA", &[], Spoil::None, &[]),
    strong("pistons 128 nm", &[("aberrations.segment_piston_rms_nm", "128")]),
    strong("pistons 250 nm", &[("aberrations.segment_piston_rms_nm", "250")]),
    often(strong("pistons 400 nm", &[("aberrations.segment_piston_rms_nm", "400")])),
    often(strong("pistons 500 nm", &[("aberrations.segment_piston_rms_nm", "500")])),
    strong("pistons 800 nm", &[("aberrations.segment_piston_rms_nm", "800")]),
    case("strong", "a segment at λ/2", &[], Spoil::Segment(0.5), &[]),
    case("strong", "a segment at -λ/2", &[], Spoil::Segment(-0.5), &[]),
    case("strong", "a segment at λ/4", &[], Spoil::Segment(0.25), &[]),
    strong("NCPA 150 nm", &[("aberrations.ncpa_rms_nm", "150")]),
    strong("NCPA 250 nm", &[("aberrations.ncpa_rms_nm", "250")]),
    strong("NCPA 400 nm", &[("aberrations.ncpa_rms_nm", "400")]),
    strong(
        "pistons 500 nm, NCPA 250 nm",
        &[("aberrations.segment_piston_rms_nm", "500"), ("aberrations.ncpa_rms_nm", "250")],
    ),
    strong(
        "pistons 500 nm, NCPA 400 nm",
        &[("aberrations.segment_piston_rms_nm", "500"), ("aberrations.ncpa_rms_nm", "400")],
    ),
    strong("NCPA 700 nm", &[("aberrations.ncpa_rms_nm", "700")]),
    strong("pistons 500 nm, peak S/N 30", &[("aberrations.segment_piston_rms_nm", "500"), ("image.peak_snr", "30")]),
    strong("pistons 500 nm, defocus 0.5 waves", WEAK_DEFOCUS[0]),
    strong("pistons 500 nm, defocus 0.25 waves", WEAK_DEFOCUS[1]),
    case("strong", "the same, 0.5 waves, one try", WEAK_DEFOCUS[0], Spoil::None, ONE_TRY),
    case("strong", "the same, 0.25 waves, one try", WEAK_DEFOCUS[1], Spoil::None, ONE_TRY),
    strong(
        "pistons and NCPA 1e6 nm",
        &[("aberrations.segment_piston_rms_nm", "1e6"), ("aberrations.ncpa_rms_nm", "1e6")],
    ),
    star("peak S/N 5", &[("image.peak_snr", "5")]),
    star("peak S/N 10", &[("image.peak_snr", "10")]),
    star("peak S/N 20", &[("image.peak_snr", "20")]),
    star("peak S/N 40", &[("image.peak_snr", "40")]),
    star("peak S/N 60", &[("image.peak_snr", "60")]),
    star("peak S/N 100", &[("image.peak_snr", "100")]),
    star("peak S/N 5000", &[("image.peak_snr", "5000")]),
    star("1 electron", &[("image.peak_snr", ""), ("image.flux_e", "1")]),
    star(
        "1e9 electrons, no read noise",
        &[("image.peak_snr", ""), ("image.flux_e", "1e9"), ("image.read_noise_e", "0")],
    ),
    star("1e13 electrons", &[("image.peak_snr", ""), ("image.flux_e", "1e13")]),
    sequence("40 images, peak S/N 5", &[("image.count", "40"), ("image.peak_snr", "5")]),
    sequence("40 images, peak S/N 20", &[("image.count", "40"), ("image.peak_snr", "20")]),
    sequence("40 images, peak S/N 60", &[("image.count", "40"), ("image.peak_snr", "60")]),
    sequence("200 images, peak S/N 5", &[("image.count", "200"), ("image.peak_snr", "5")]),
    sequence("200 images, peak S/N 20", &[("image.count", "200"), ("image.peak_snr", "20")]),
    sequence("200 images, peak S/N 60", &[("image.count", "200"), ("image.peak_snr", "60")]),
    sequence(
        "40 images, peak S/N 20, NCPA to Noll 45",
        &[("image.count", "40"), ("image.peak_snr", "20"), ("aberrations.ncpa_zernikes", "[4, 45]")],
    ),
    diversity("no defocus", &[("image.diversity_focus_waves_rms", "0")]),
    diversity("defocus 0.05 waves", &[("image.diversity_focus_waves_rms", "0.05")]),
    diversity("defocus 0.25 waves", &[("image.diversity_focus_waves_rms", "0.25")]),
    diversity("defocus 0.5 waves", &[("image.diversity_focus_waves_rms", "0.5")]),
    diversity("defocus 1 wave", &[("image.diversity_focus_waves_rms", "1")]),
    diversity("defocus 3 waves", &[("image.diversity_focus_waves_rms", "3")]),
    diversity("defocus -1.5 waves", &[("image.diversity_focus_waves_rms", "-1.5")]),
    model("defocus 5 % small", &[], &[("image.diversity_focus_waves_rms", "1.425")]),
    model("defocus 5 % large", &[], &[("image.diversity_focus_waves_rms", "1.575")]),
    model(
        "defocus 5 % large, known to 5 %",
        &[],
        &[("image.diversity_focus_waves_rms", "1.575"), ("tolerance.defocus_fraction", "0.05")],
    ),
    model("plate scale 1 % small", &[], &[("image.samples_per_lambda_over_d", "1.98")]),
    model("plate scale 1 % large", &[], &[("image.samples_per_lambda_over_d", "2.02")]),
    model("plate scale 1 % small, fitted", &[], FITTED[0]),
    model("plate scale 1 % large, fitted", &[], FITTED[1]),
    model("defocus 5 % large, asked for", &[], FITTED[2]),
    model("background 0.1 %", BACKGROUNDS[0], &[]),
    model("background 1 %", BACKGROUNDS[1], &[]),
    model("pixel responses 2 %", &[("faults.pixel_response_rms", "0.02")], &[]),
    model("pixels that are squares", SQUARES, &[("image.pixel_fill", "0")]),
    model("pixels that are squares, known", SQUARES, &[]),
    model("pixels that are squares, taken for 0.8, fitted", SQUARES, FITTED[4]),
    model("bandwidth 1.5 %", &[("image.bandwidth_fraction", "0.015")], &[("image.bandwidth_fraction", "0")]),
    model("bandwidth 5 %", &[("image.bandwidth_fraction", "0.05")], &[("image.bandwidth_fraction", "0")]),
    model("bandwidth 5 %, known", &[("image.bandwidth_fraction", "0.05")], &[]),
    model("bandwidth 5 %, taken for 4 %, fitted", &[("image.bandwidth_fraction", "0.05")], FITTED[3]),
    model("segment tilts 30 nm", &[("aberrations.segment_tip_tilt_rms_nm", "30")], &[]),
    model("reflectivities 5 %", &[("faults.segment_reflectivity_rms", "0.05")], &[]),
    model("NCPA of high order", &[("aberrations.ncpa_zernikes", "[4, 200]"), ("aberrations.ncpa_power_law", "0")], &[]),
    model("spiders not in the model", &[("pupil.spider_width_m", "0.0254")], &[("pupil.spider_width_m", "0")]),
    model(
        "obscuration not in the model",
        &[("pupil.central_obscuration_m", "2.48")],
        &[("pupil.central_obscuration_m", "0")],
    ),
    case("model wrong", "image rotated by a degree", &[], Spoil::Rotated(1.0), &[]),
    model("pupil rotated by a degree", TURNED[0], TURNED[1]),
    model("pupil rotated by a degree, fitted", TURNED[0], TURNED[2]),
    case("orientation", "image flipped left to right", &[], Spoil::Flipped(Axis(1)), &[]),
    case("orientation", "image flipped up to down", &[], Spoil::Flipped(Axis(0)), &[]),
    data("image off by 3 pixels", Spoil::Moved(3.0, -2.0)),
    data("image off by half a pixel", Spoil::Moved(0.5, 0.5)),
    data("hot pixel", Spoil::Hot),
    data("dead pixels", Spoil::Dead),
    data("pixels that are NaN", Spoil::NotANumber),
    data("saturated at half the peak", Spoil::Saturated),
    data("cosmic rays", Spoil::Cosmic),
    data("lower half of the frame missing", Spoil::Truncated),
    companion("double star", 0.33, [4.0, 3.0]),
    companion("companion of 1 %, 3 λ/D away", 0.01, [4.8, 3.6]),
    companion("companion of 1 %, 10 λ/D away", 0.01, [16.0, 12.0]),
    companion("companion of 0.3 %, 3 λ/D away", 0.003, [4.8, 3.6]),
    companion("companion of 0.3 %, 10 λ/D away", 0.003, [16.0, 12.0]),
    data("response 2 % low at the peak", Spoil::NonLinear(0.02)),
    data("response 0.5 % low at the peak", Spoil::NonLinear(0.005)),
    data("flat frame", Spoil::Flat),
    data("counts that wrapped at 65536", Spoil::Wrapped),
    data("counts read as electrons", Spoil::Counts(20.0)),
    data("normalised to a sum of 1", Spoil::Normalised),
    case(
        "data wrong",
        "another telescope",
        &[("pupil.rings", "2"), ("pupil.segment_side_m", "1.25")],
        Spoil::None,
        &[("pupil.rings", "3"), ("pupil.segment_side_m", "0.9")],
    ),
    file("counts without a gain", Spoil::Counts(20.0), &[("BUNIT", "adu")]),
    file("counts with EGAIN = 20", Spoil::Counts(20.0), &[("BUNIT", "adu"), ("EGAIN", "20")]),
    file("WAVELEN = 1640", Spoil::None, &[("BUNIT", "electron"), ("WAVELEN", "1640")]),
    file("WAVELEN = 2168.6", Spoil::None, &[("BUNIT", "electron"), ("WAVELEN", "2168.6")]),
    telemetry("slopes as they were measured", Mismatch::None),
    telemetry("slopes of the opposite sign", Mismatch::OppositeSign),
    telemetry("slopes along y before those along x", Mismatch::YBeforeX),
    telemetry("slopes that are all 0", Mismatch::Zero),
    telemetry("slopes in another unit", Mismatch::OtherUnit),
    telemetry("slopes in the reverse order of the images", Mismatch::ReversedTime),
    telemetry("slopes of the image before", Mismatch::ShiftedTime),
    telemetry("images flipped, slopes not", Mismatch::FlippedImages),
    degenerate("Zernikes twice", &[], DOUBLED),
    degenerate("more modes than pixels", &[], &[("image.crop_pixels", "8")]),
    degenerate("pupil of 16 samples", &[], &[("estimate.samples", "16")]),
];

impl HardCase {
    /// The cases of these names; none are all.
    ///
    /// # Errors
    /// [`Error::Value`] for a name that no case has.
    pub fn named(names: &[String]) -> Result<Vec<HardCase>> {
        if names.is_empty() {
            return Ok(HARD_CASES.to_vec());
        }
        let named = |name: &String| {
            HARD_CASES.iter().find(|case| case.name == name).copied().ok_or_else(|| {
                let names: Vec<&str> = HARD_CASES.iter().map(|case| case.name).collect();
                Error::Value(format!("no hard case is called '{name:.60}': {} are accepted", names.join("; ")))
            })
        };
        names.iter().map(named).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use cophase::scene::Scene;

    #[test]
    fn names_are_used_once() {
        let mut names: Vec<_> = HARD_CASES.iter().map(|case| case.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), HARD_CASES.len());
        let found = HardCase::named(&["peak S/N 5".into(), "no defocus".into()]).unwrap();
        assert_eq!(found.iter().map(|case| case.name).collect::<Vec<_>>(), ["peak S/N 5", "no defocus"]);
        assert_eq!(HardCase::named(&[]).unwrap(), HARD_CASES);
        let error = HardCase::named(&["nothing".into()]).unwrap_err().to_string();
        assert!(error.contains("'nothing'") && error.contains("peak S/N 5"), "{error}");
    }

    #[test]
    fn a_case_is_drawn_at_least_once() {
        let numbers = |seeds| [Draws::AsAsked, Draws::FiveTimes, Draws::Quarter, Draws::Once].map(|d| d.number(seeds));
        assert_eq!((numbers(8), numbers(1)), ([8, 40, 2, 1], [1, 5, 1, 1]));
    }

    #[test]
    fn every_case_is_a_scene_that_can_be_read() {
        let base = Scene::preset("keck-artificial").unwrap().with(BASE).unwrap();
        for case in &HARD_CASES {
            let made = base.with(case.made).unwrap();
            assert_eq!(case.read.is_empty(), *made.with(case.read).unwrap() == *made, "{}", case.name);
        }
    }
}
