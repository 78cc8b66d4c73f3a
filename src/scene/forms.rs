//! Keys that are forms of one quantity, of which a scene names one.

/// The sampling, as everything reads it, and its other forms.
pub(super) const SAMPLING: [&str; 4] = ["samples_per_lambda_over_d", "pixel_mas", "pixel_arcsec", "pixel_pitch_um"];
/// The defocus, as everything reads it, and its other forms.
pub(super) const FOCUS: [&str; 4] =
    ["diversity_focus_waves_rms", "diversity_focus_waves_pv", "diversity_focus_nm_rms", "diversity_stage_mm"];
/// The focal length over the pupil's grid, and the focal length.
pub(super) const FOCAL: [&str; 2] = ["focal_ratio", "focal_length_m"];
/// The star's brightness.
pub(super) const BRIGHTNESS: [&str; 2] = ["peak_snr", "flux_e"];

/// What a file of the NCPA stands for.
pub(super) const ZERNIKES: [&str; 3] = ["ncpa_rms_nm", "ncpa_zernikes", "ncpa_power_law"];

/// What coefficients of the petals stand for.
pub(super) const PETALS: [&str; 2] = ["petal_piston_rms_nm", "petal_tip_tilt_rms_nm"];

/// The other forms of `key` of a section, which give way where it is set.
pub(super) fn other_forms(section: &str, key: &str) -> Vec<&'static str> {
    match (section, key) {
        ("aberrations", "ncpa_file") => ZERNIKES.to_vec(),
        ("aberrations", "petal_coefficients_nm") => PETALS.to_vec(),
        ("aberrations", key) if PETALS.contains(&key) => vec!["petal_coefficients_nm"],
        ("image", key) => {
            let groups: [&[&str]; 4] = [&SAMPLING, &FOCUS, &FOCAL, &BRIGHTNESS];
            let own = groups.into_iter().filter(|group| group.contains(&key));
            own.flatten().copied().filter(|other| *other != key).collect()
        }
        _ => Vec::new(),
    }
}
