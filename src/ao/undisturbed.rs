//! A noise-free, turbulence-free loop.

/// Settings of a scene that take away the turbulence, the reference slopes and the noise of the wavefront sensor.
pub const UNDISTURBED_LOOP: [(&str, &str); 8] = [
    ("turbulence.fractions", "[]"),
    ("turbulence.heights_m", "[]"),
    ("turbulence.wind_m_s", "[]"),
    ("turbulence.wind_dir_rad", "[]"),
    ("wavefront_sensor.reference_file", ""),
    ("control.optical_gains", "none"),
    ("wavefront_sensor.photon_noise", "false"),
    ("wavefront_sensor.read_noise_e", "0.0"),
];
