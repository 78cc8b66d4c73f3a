//! A noise-free, turbulence-free loop.

use crate::scene::{OpticalGainMethod, Sections};

/// Takes away the turbulence, the reference slopes and the noise of the wavefront sensor.
pub fn undisturb(sections: &mut Sections) {
    let turbulence = &mut sections.turbulence;
    for list in
        [&mut turbulence.fractions, &mut turbulence.heights_m, &mut turbulence.wind_m_s, &mut turbulence.wind_dir_rad]
    {
        list.clear();
    }
    if let Some(control) = &mut sections.control {
        control.optical_gains = OpticalGainMethod::None;
    }
    if let Some(sensor) = &mut sections.wavefront_sensor {
        sensor.reference_file = None;
    }
    take_noise(sections);
}

/// Takes away the noise of the wavefront sensor.
pub fn take_noise(sections: &mut Sections) {
    if let Some(sensor) = &mut sections.wavefront_sensor {
        (sensor.photon_noise, sensor.read_noise_e) = (false, 0.0);
    }
}
