//! Scenes as the command line names them.

use crate::outputs::{self, Flagged};
use cophase::pipeline::embedded_scene;
use cophase::scene::{Scene, split_setting};
use cophase::{Error, Result};
use std::path::{Path, PathBuf};

/// `--set`, for every verb that reads a scene.
#[derive(clap::Args)]
pub struct Settings {
    /// Another value for a key of the scene, such as image.peak_snr=50; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = setting)]
    pub settings: Vec<(String, String)>,
    /// Let the scene in a FITS file name files outside of that file's folder
    #[arg(long)]
    pub foreign_files: bool,
}

fn setting(text: &str) -> Result<(String, String)> {
    split_setting(text).map(|(key, value)| (key.to_string(), value.to_string()))
}

/// What `--seed` takes: what an integer of a scene can hold.
pub fn seed() -> impl clap::builder::TypedValueParser<Value = u64> {
    clap::value_parser!(u64).range(..=i64::MAX as u64)
}

impl Settings {
    /// `scene` with these settings, and after them those of other options. The files that it names
    /// must be there.
    pub fn apply(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let scene = self.changed(scene, options)?;
        scene.check_files(|_| true)?;
        anchored(scene)
    }

    /// The scene `name` with these settings and options, or the one in the file `images`.
    pub fn scene_of(&self, name: Option<&Path>, images: &Path, options: &[(&str, &str)]) -> Result<Scene> {
        if let Some(name) = name {
            return self.apply(&scene(name)?, options);
        }
        let scene = embedded_scene(images, |key| self.foreign_files || self.replaces(key))?.ok_or_else(|| {
            let reason =
                "holds no scene (table SCENE): name one with --scene, a file or a preset such as keck-artificial";
            Error::file(images, reason)
        })?;
        self.apply_to_embedded(&scene, options)
    }

    /// As [`Settings::apply`], for the scene of a FITS file. Its files may be left on another
    /// machine: those that are not needed are not missed, unless these settings name them.
    fn apply_to_embedded(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let scene = self.changed(scene, options)?;
        scene.check_files(|key| self.keys().any(|named| named == key))?;
        anchored(scene)
    }

    fn changed(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let named = self.settings.iter().map(|(key, value)| (key.as_str(), value.as_str()));
        scene.with(&named.chain(options.iter().copied()).collect::<Vec<_>>())
    }

    /// Whether these settings replace the file `key`, that of a channel, too.
    fn replaces(&self, key: &str) -> bool {
        self.keys().any(|set| {
            let of_channel = set.strip_prefix("image.channel.").and_then(|rest| rest.rsplit_once('.'));
            set == key || of_channel.is_some_and(|(_, name)| key.strip_prefix("image.") == Some(name))
        })
    }

    /// The keys that are set.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.settings.iter().map(|(key, _)| key.as_str())
    }
}

/// The scene in the file `name` (`-` for standard input), or the preset of that name where there is
/// no such file.
pub fn scene(name: &Path) -> Result<Scene> {
    if name == Path::new("-") {
        return Scene::from_file("/dev/stdin");
    }
    let presets = Scene::preset_names();
    match name.to_str().filter(|name| presets.contains(name) && !Path::new(name).exists()) {
        Some(preset) => Scene::preset(preset),
        None if !name.exists() => {
            let presets = presets.join(", ");
            Err(Error::file(name, format_args!("there is no such scene: a file or one of {presets} is needed")))
        }
        None => Scene::from_file(name),
    }
}

/// Refuses an output that is a file of the scene.
pub fn spare_files_of(scene: &Scene, outputs: &[Flagged]) -> Result<()> {
    let files = scene.files();
    let inputs: Vec<Flagged> = files.iter().map(|(key, path)| (*key, path.as_path())).collect();
    outputs.iter().try_for_each(|&output| outputs::spare(output, &inputs))
}

/// `scene` with the full names of its files, so that its text means the same wherever it is kept.
fn anchored(scene: Scene) -> Result<Scene> {
    let mut full = Vec::new();
    let mut add = |key: String, file: PathBuf| -> Result<()> {
        let path = std::path::absolute(&file).map_err(|error| Error::file(&file, error))?;
        full.push((key, toml_edit::Value::from(path.display().to_string()).to_string()));
        Ok(())
    };
    // A file of one channel is not that of the others.
    for (number, (name, own)) in scene.each_channel().into_iter().enumerate() {
        for (key, file) in own.files() {
            match (name, key.strip_prefix("image.")) {
                (Some(name), Some(key)) => add(format!("image.channel.{name}.{key}"), file)?,
                _ if number == 0 => add(key.to_owned(), file)?,
                _ => {}
            }
        }
    }
    if full.is_empty() {
        return Ok(scene);
    }
    scene.with(&full.iter().map(|(key, path)| (key.as_str(), path.as_str())).collect::<Vec<_>>())
}

/// An error about the contents of `path`, with its name before it.
pub fn about(path: &Path) -> impl Fn(Error) -> Error {
    let path: PathBuf = path.to_path_buf();
    move |error| match error {
        Error::Shape(reason) | Error::Image(reason) => Error::file(&path, reason),
        other => other,
    }
}
