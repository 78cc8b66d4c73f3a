//! Scenes of the channels of a scene.

use super::channel::{self, ChannelText};
use super::table::Source;
use super::{Channel, Scene};
use crate::{Error, Result};
use std::path::Path;
use toml_edit::{Document, DocumentMut};

impl Scene {
    /// The channels, in order; none for a scene with one way of imaging.
    pub fn channels(&self) -> &[Channel] {
        &self.content.channels
    }

    /// Refuses a scene with several channels, for `who` (a noun in the plural), who images the wavefront in one way.
    ///
    /// # Errors
    /// [`Error::Scene`].
    pub(crate) fn refuse_channels(&self, who: &str) -> Result<()> {
        match self.channels() {
            [] => Ok(()),
            channels => Err(Error::Scene(format!(
                "{}: {who} have one channel, and the scene has {} ([[image.channel]]): give a scene of one channel, or give this one \
                 to 'cophase estimate', 'cophase simulate', pipeline::Estimator::estimate_channels or, in real time, modal::JointSession \
                 (cophase_joint_session_create), which take several",
                self.name(),
                channels.len()
            ))),
        }
    }

    /// Most channels of a scene.
    pub(crate) const MAX_CHANNELS: usize = channel::MAX_CHANNELS;

    /// This scene with a channel for each turn of the pupil, by name and degrees, in place of each of its channels, or of its only way of
    /// imaging.
    ///
    /// # Errors
    /// [`Error::Scene`] for names and turns that channels cannot have.
    pub(crate) fn with_turns(&self, turns: &[Vec<(String, f64)>]) -> Result<Self> {
        let mut document: DocumentMut = self
            .text()
            .parse()
            .map_err(|error| Error::Internal(format!("the text of a valid scene is not TOML: {error}")))?;
        channel::set_turns(&mut document, turns)?;
        Self::parse(self.name(), &document.to_string(), self.directory(), self.purpose(), &[])
    }

    /// The scenes of the channels in the text of a scene; none where it lists no channels.
    pub(super) fn parse_channels(source: Source, document: &Document<&str>, directory: &Path) -> Result<Vec<Channel>> {
        let parsed = channel::texts(source, document)?.into_iter().map(|ChannelText { name, text, settings }| {
            let own = settings.iter().map(|(key, value)| (key.as_str(), value.as_str()));
            let settings: Vec<(&str, &str)> = source.settings.iter().copied().chain(own).collect();
            let title = format!("{}, channel {name}", source.name);
            let scene = Self::parse(&title, &text, directory, source.purpose, &settings)?;
            Ok(Channel { name, scene })
        });
        parsed.collect()
    }
}
