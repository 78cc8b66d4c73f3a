//! Fitters of the channels of a scene.

use crate::modal::fitter::ModalFitter;
use crate::modal::model::model_cache::ModelCache;
use crate::modal::model::recipe::Recipe;
use crate::scene::System;
use crate::{Error, Result};
use std::sync::Arc;

/// Fitters of the channels of a scene, in its order, whose models have the same modes: one for a
/// scene that lists no channels.
#[derive(Debug, Clone)]
pub struct ChannelFitters {
    scene: System,
    channels: Vec<(String, Arc<ModalFitter>)>,
}

impl From<Arc<ModalFitter>> for ChannelFitters {
    fn from(fitter: Arc<ModalFitter>) -> Self {
        Self { scene: fitter.scene.clone(), channels: vec![(String::new(), fitter)] }
    }
}

impl ChannelFitters {
    /// Builds the models of `scene`, with the basis of modes that channels share computed once;
    /// `native` as in [`ModalFitter::new`].
    ///
    /// # Errors
    /// Those of [`ModalFitter::new`]; [`Error::Scene`] for channels with other modes than the
    /// first.
    pub fn new(scene: &System, native: bool) -> Result<Self> {
        let Some(first) = scene.channels().first() else {
            return Ok(Arc::new(ModalFitter::new(scene, native)?).into());
        };
        let cache = ModelCache::default();
        let channels = scene.channels().iter().map(|channel| {
            let (own, basis) = (&channel.system, cache.for_scene(&first.system, &channel.system).basis);
            let fitter = ModalFitter::with_scene_basis(own, Recipe::from_scene(own), native, basis)?;
            Ok((channel.name.clone(), Arc::new(fitter)))
        });
        let made = Self { scene: scene.clone(), channels: channels.collect::<Result<_>>()? };
        let (first, modes) = (made.first(), made.first().model.basis.names());
        if let Some((_, other)) = made.iter().find(|(_, fitter)| fitter.model.basis.names() != modes) {
            return Err(Error::Scene(format!(
                "{} has {} modes, and {} has {}: channels of one wavefront need one telescope and the same modes",
                other.scene.name(),
                other.model.basis.len(),
                first.scene.name(),
                modes.len(),
            )));
        }
        Ok(made)
    }

    /// The scene.
    pub fn scene(&self) -> &System {
        &self.scene
    }

    /// Number of channels.
    #[allow(clippy::len_without_is_empty)] // there is at least one
    pub fn len(&self) -> usize {
        self.channels.len()
    }

    /// Name and fitter of each channel; the name is empty where the scene lists no channels.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = (&str, &Arc<ModalFitter>)> {
        self.channels.iter().map(|(name, fitter)| (name.as_str(), fitter))
    }

    /// The fitter of the first channel, whose modes are those of all.
    pub fn first(&self) -> &Arc<ModalFitter> {
        &self.channels[0].1
    }

    /// The fitter of the only channel.
    ///
    /// # Errors
    /// [`Error::Value`] where there are several; `what`, a noun, is named as that which needs one.
    pub fn only(&self, what: &str) -> Result<&Arc<ModalFitter>> {
        match self.len() {
            1 => Ok(self.first()),
            count => Err(Error::Value(format!(
                "the model has {count} channels: {what} is of one channel, which ChannelFitters::of_channel (cophase_model_channel) gives"
            ))),
        }
    }

    /// Name and fitter of a channel, numbered from 0.
    ///
    /// # Errors
    /// [`Error::Value`] for one that does not exist.
    pub fn get(&self, channel: usize) -> Result<(&str, &Arc<ModalFitter>)> {
        self.iter().nth(channel).ok_or_else(|| {
            let count = self.len();
            Error::Value(format!("channel {channel} does not exist: there are {count}, numbered from 0"))
        })
    }

    /// A channel by itself.
    ///
    /// # Errors
    /// [`Error::Value`] for one that does not exist.
    pub fn of_channel(&self, channel: usize) -> Result<Self> {
        let (name, fitter) = self.get(channel)?;
        Ok(Self { scene: fitter.scene.clone(), channels: vec![(name.into(), fitter.clone())] })
    }
}
