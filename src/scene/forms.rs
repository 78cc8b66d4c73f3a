//! Keys that are forms of one quantity, of which a scene names one.

/// The sampling, as everything reads it, and its other forms.
pub(super) const SAMPLING: [&str; 4] = ["samples_per_lambda_over_d", "pixel_mas", "pixel_arcsec", "pixel_pitch_um"];
/// The defocus, likewise.
pub(super) const FOCUS: [&str; 4] =
    ["diversity_focus_waves_rms", "diversity_focus_waves_pv", "diversity_focus_nm_rms", "diversity_stage_mm"];

/// The other forms of `key` of the section `[image]`.
pub(super) fn other_forms(key: &str) -> impl Iterator<Item = &'static str> + use<'_> {
    let groups = [SAMPLING, FOCUS].into_iter().filter(move |group| group.contains(&key));
    groups.flatten().filter(move |other| *other != key)
}
