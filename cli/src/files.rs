//! Scenes as the command line names them.

use crate::outputs::{self, Flagged};
use cophase::io::file_of;
use cophase::scene::{Aperture, Scene, split_setting};
use cophase::{Error, Result};
use std::path::{Path, PathBuf};

/// `--set`, for every verb that reads a scene.
#[derive(clap::Args)]
pub struct Settings {
    /// Another value for a key of the scene, such as image.peak_snr=50; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE", value_parser = setting)]
    pub settings: Vec<(String, String)>,
}

fn setting(text: &str) -> Result<(String, String)> {
    split_setting(text).map(|(key, value)| (key.to_string(), value.to_string()))
}

/// What `--seed` takes: what an integer of a scene can hold.
pub fn seed() -> impl clap::builder::TypedValueParser<Value = u64> {
    clap::value_parser!(u64).range(..=i64::MAX as u64)
}

impl Settings {
    /// `scene` with these settings, and after them those of other options. The files that it names must be there.
    pub fn apply(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let scene = self.changed(scene, options)?;
        check_files_of(&scene, |_| true)?;
        anchored(scene)
    }

    /// As [`Settings::apply`], for the scene of a FITS file. Its files may be left on another machine: those that are not
    /// needed are not missed, unless these settings name them.
    pub fn apply_to_embedded(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let scene = self.changed(scene, options)?;
        check_files_of(&scene, |key| self.keys().any(|named| named == key))?;
        anchored(scene)
    }

    fn changed(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let named = self.settings.iter().map(|(key, value)| (key.as_str(), value.as_str()));
        scene.with(&named.chain(options.iter().copied()).collect::<Vec<_>>())
    }

    /// The keys that are set.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.settings.iter().map(|(key, _)| key.as_str())
    }
}

/// The scene in the file `name` (`-` for standard input), or the preset of that name where there is no such file.
pub fn scene(name: &Path) -> Result<Scene> {
    if name == Path::new("-") {
        return Scene::from_file("/dev/stdin");
    }
    let presets = Scene::preset_names();
    match name.to_str().filter(|name| presets.contains(name) && !Path::new(name).exists()) {
        Some(preset) => Scene::preset(preset),
        None if !name.exists() => {
            let presets = presets.join(" and ");
            Err(Error::file(name, format_args!("there is no such scene: a file, or one of {presets} is needed")))
        }
        None => Scene::from_file(name),
    }
}

/// The file that each channel may have of its own.
const DIVERSITY_FILE: &str = "image.diversity_file";

/// The files that `scene` names: key and path.
fn files_of(scene: &Scene) -> Vec<(&'static str, PathBuf)> {
    let channels = scene.channels().iter().flat_map(|channel| files_of(&channel.scene));
    let channels: Vec<_> = channels.filter(|(key, _)| *key == DIVERSITY_FILE).collect();
    let pupil = match &scene.pupil.aperture {
        Aperture::File(file) => Some(file),
        _ => None,
    };
    let files = [
        ("pupil.file", pupil),
        ("modes.file", scene.modes.file.as_ref()),
        (DIVERSITY_FILE, scene.image.diversity_file.as_ref()),
        ("aberrations.ncpa_file", scene.aberrations.as_ref().and_then(|aberrations| aberrations.ncpa_file.as_ref())),
        ("mirror.actuator_file", scene.mirror.actuator_file.as_ref()),
        (
            "wavefront_sensor.subaperture_file",
            scene.wavefront_sensor.as_ref().and_then(|sensor| sensor.subaperture_file.as_ref()),
        ),
    ];
    files.into_iter().filter_map(|(key, file)| Some((key, scene.resolve(file?)))).chain(channels).collect()
}

/// Refuses a scene that names a file which does not exist, whether or not the verb reads it: a misspelt name would have
/// no effect. A map of NCPA is missed by the simulators, which read it, and not by an estimate.
fn check_files_of(scene: &Scene, is_checked: impl Fn(&str) -> bool) -> Result<()> {
    // A FITS file may have an HDU in brackets behind its name.
    let is_there = |path: &Path| file_of(path).exists();
    let missing = |(key, path): &(&str, PathBuf)| *key != "aberrations.ncpa_file" && is_checked(key) && !is_there(path);
    match files_of(scene).into_iter().find(missing) {
        Some((key, path)) => Err(Error::file(path, format_args!("there is no such file; {key} of the scene names it"))),
        None => Ok(()),
    }
}

/// Refuses an output that is a file of the scene.
pub fn spare_files_of(scene: &Scene, outputs: &[Flagged]) -> Result<()> {
    let files = files_of(scene);
    let inputs: Vec<Flagged> = files.iter().map(|(key, path)| (*key, path.as_path())).collect();
    outputs.iter().try_for_each(|&output| outputs::spare(output, &inputs))
}

/// `scene` with the full names of its files, so that its text means the same wherever it is kept.
fn anchored(scene: Scene) -> Result<Scene> {
    let mut full = Vec::new();
    for (key, file) in files_of(&scene) {
        let path = std::path::absolute(&file).map_err(|error| Error::file(&file, error))?;
        full.push((key, toml_edit::Value::from(path.display().to_string()).to_string()));
    }
    if full.is_empty() {
        return Ok(scene);
    }
    scene.with(&full.iter().map(|(key, path)| (*key, path.as_str())).collect::<Vec<_>>())
}

/// An error about the contents of `path`, with its name before it.
pub fn about(path: &Path) -> impl Fn(Error) -> Error {
    let path: PathBuf = path.to_path_buf();
    move |error| match error {
        Error::Shape(reason) | Error::Image(reason) => Error::file(&path, reason),
        other => other,
    }
}
