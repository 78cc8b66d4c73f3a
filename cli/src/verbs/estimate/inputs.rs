//! What an estimate reads: images of one file or of several, slopes, the scene.

use super::arguments::{Arguments, GAIN};
use crate::verbs::one_channel::of_one_channel;
use cophase::pipeline::{Images, Trust};
use cophase::scene::Scene;
use cophase::{Error, Result};
use cophase_view::outputs::Flagged;

impl Arguments {
    /// The scene, and the images of each channel with their slopes.
    pub(super) fn inputs(&self) -> Result<(Scene, Vec<Images>)> {
        let images = self.images()?;
        let scene = self.scene()?;
        let images = self.with_slopes(images, scene.image.simultaneous)?;
        Ok((scene, images))
    }

    /// The files that it reads.
    pub(super) fn read_files(&self) -> Vec<Flagged<'_>> {
        let sources = self.sources().into_iter().map(|(_, file)| ("the images", file));
        let also = [("--scene", &self.scene), ("--mask", &self.mask)];
        let also = also.into_iter().filter_map(|(flag, path)| Some((flag, path.as_deref()?)));
        sources.chain(also).chain(self.slopes.iter().map(|(_, file)| ("--slopes", file.as_path()))).collect()
    }

    /// The images of each channel.
    fn images(&self) -> Result<Vec<Images>> {
        let mut channels = Vec::new();
        for (name, file) in self.sources() {
            match name {
                None => channels.extend(Images::read(file, self.mask.as_deref())?),
                Some(name) => {
                    let images = of_one_channel(file, self.mask.as_deref())?;
                    channels.push(Images { channel: Some(name.into()), ..images });
                }
            }
        }
        let trust = match self.trust.as_deref() {
            Some("scene") => Trust::Scene,
            Some("file") => Trust::File,
            _ => Trust::Neither,
        };
        // What the command line says goes before what the file says.
        let keys = self.settings.keys().chain(self.gain.map(|_| GAIN));
        let overrides: Vec<String> = keys.map(str::to_owned).collect();
        for images in &mut channels {
            (images.trust, images.overrides) = (trust, overrides.clone());
        }
        Ok(channels)
    }

    /// The images of each channel with the slopes of `--slopes`; of one exposure that all channels
    /// share, they are those of each.
    fn with_slopes(&self, mut channels: Vec<Images>, is_simultaneous: bool) -> Result<Vec<Images>> {
        for (name, file) in &self.slopes {
            let is_meant = |images: &Images| name.is_none() || images.channel == *name;
            let meant = channels.iter().filter(|images| is_meant(images)).count();
            if meant == 0 || (meant > 1 && !is_simultaneous) {
                let names: Vec<&str> = channels.iter().filter_map(|images| images.channel.as_deref()).collect();
                let accepted = match &names[..] {
                    [] => "a file without a channel's name is accepted".to_string(),
                    _ => format!("NAME={} with one of {} is accepted", file.display(), names.join(", ")),
                };
                let reason = match name {
                    Some(name) => format!("--slopes names the channel {name}, which has no images: {accepted}"),
                    None => format!("--slopes does not say whose slopes it holds: {accepted}"),
                };
                return Err(Error::file(file, reason));
            }
            let with = |images: Images| if is_meant(&images) { images.with_slopes(file) } else { Ok(images) };
            channels = channels.into_iter().map(with).collect::<Result<_>>()?;
        }
        Ok(channels)
    }
}
