//! Scenes of the channels of a scene.

use super::channel::{self, ChannelText, ImageList};
use super::table::Source;
use super::{Channel, Scene};
use crate::Result;
use std::path::Path;
use toml_edit::Document;

impl Scene {
    /// The channels, in order; none for a scene with one way of imaging.
    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Name and scene of each way of imaging, in order: of each of its channels, or, for a scene
    /// that lists none, its own without a name.
    pub fn each_channel(&self) -> Vec<(Option<&str>, &Self)> {
        match self.channels() {
            [] => vec![(None, self)],
            channels => channels.iter().map(|channel| (Some(channel.name.as_str()), &channel.scene)).collect(),
        }
    }

    /// Most channels of a scene.
    pub(crate) const MAX_CHANNELS: usize = channel::MAX_CHANNELS;

    /// This scene with a channel for each number of a list that its images have, by name and
    /// number, in place of each of its channels, or of its only way of imaging.
    ///
    /// # Errors
    /// [`Error::Scene`] for names and numbers that channels cannot have.
    pub(crate) fn divided(&self, list_of: ImageList, parts: &[Vec<(String, f64)>]) -> Result<Self> {
        let mut document = self.document()?;
        channel::divide(&mut document, list_of, parts)?;
        Self::parse(self.name(), &document.to_string(), self.directory(), self.purpose(), &[])
    }

    /// This scene, which has one way of imaging, with channels of these names, each with its values
    /// of keys `image.KEY`.
    ///
    /// # Errors
    /// [`Error::Scene`] for keys and values that channels cannot have.
    pub(crate) fn with_channels(&self, channels: &[(String, Vec<(&str, f64)>)]) -> Result<Self> {
        let mut document = self.document()?;
        channel::set_list(&mut document, channels)?;
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
