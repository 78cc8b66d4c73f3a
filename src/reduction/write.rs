//! The file of a reduction.

use super::log;
use super::reduced::{ReducedChannel, Reduction};
use crate::Result;
use crate::io::{CHANNEL, ELECTRON, FitsWriter, Pixel, READ_NOISE_OF_A_COADD};
use crate::scene::Scene;
use std::path::Path;

impl Reduction {
    /// Writes the images of each channel (`IMAGES`, electrons, with `EXTVER` 1, 2, ... and the card
    /// `CHANNEL`) and their bad pixels (`BADPIX`), the log (table `REDUCTION`) and the scene (table
    /// `SCENE`), with the turns of the pupil. The write is atomic.
    ///
    /// # Errors
    /// [`crate::Error::File`] if the file cannot be written; [`crate::Error::Scene`] for a scene
    /// whose pupil cannot turn.
    pub fn write(&self, path: &Path, scene: &Scene) -> Result<()> {
        let scene = &self.with_turns(scene)?;
        let mut file = FitsWriter::create(path)?;
        for (number, channel) in self.channels.iter().enumerate() {
            write_channel(&mut file, number, channel)?;
        }
        log::write(&mut file, &self.log)?;
        file.text("SCENE", scene.text())?;
        file.finish()
    }

    /// `scene` with the turns of the pupil in the images of each channel.
    fn with_turns(&self, scene: &Scene) -> Result<Scene> {
        let names: Vec<_> = scene.each_channel().into_iter().map(|(name, _)| name).collect();
        scene.with_each_channel(|channel, sections| {
            let reduced = self.channels.iter().find(|reduced| reduced.name.as_deref() == names[channel]);
            if let Some(turns_deg) = reduced.and_then(|reduced| reduced.pupil_turns_deg.as_ref()) {
                sections.image.pupil_turns_deg = Some(turns_deg.clone());
            }
        })
    }
}

fn write_channel(file: &mut FitsWriter, number: usize, channel: &ReducedChannel) -> Result<()> {
    let hdu = |name: &str| if number == 0 { name.to_owned() } else { format!("{name},{}", number + 1) };
    let (images, bad) = (hdu("IMAGES"), hdu("BADPIX"));
    file.image(&images, &channel.images_e, Pixel::F32, ELECTRON)?;
    if let Some(name) = &channel.name {
        file.card(&images, CHANNEL, name.as_str(), "name of the channel")?;
    }
    file.card(&images, "RON_E", channel.noise_e, "noise of a pixel without star, electrons RMS")?;
    if let Some(read_noise_e) = channel.stated_read_noise_e {
        file.card(&images, READ_NOISE_OF_A_COADD, read_noise_e, "read noise of one coadd, electrons RMS")?;
    }
    if let Some((itime_s, coadds)) = channel.exposure {
        file.card(&images, "ITIME", itime_s, "exposure of one coadd, s")?;
        file.card(&images, "COADDS", i64::from(coadds), "coadds of an image")?;
        file.card(&images, "EXPTIME", itime_s * f64::from(coadds), "exposure of an image, s")?;
    }
    for (keyword, wavelength_nm) in &channel.wavelengths_nm {
        file.card(&images, keyword, *wavelength_nm, "wavelength of the raw frames, nm")?;
    }
    file.image(&bad, &channel.bad.mapv(|bad| f64::from(u8::from(bad))), Pixel::I32, "")
}
