//! Scenes as the command line names them, and files that will be written.

use cophase::io::FitsWriter;
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
    /// `scene` with these settings, and after them those of other options.
    pub fn apply(&self, scene: &Scene, options: &[(&str, &str)]) -> Result<Scene> {
        let named = self.settings.iter().map(|(key, value)| (key.as_str(), value.as_str()));
        anchored(scene.with(&named.chain(options.iter().copied()).collect::<Vec<_>>())?)
    }

    /// The keys that are set.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.settings.iter().map(|(key, _)| key.as_str())
    }
}

/// The scene in the file `name`, or the preset of that name where there is no such file.
pub fn scene(name: &Path) -> Result<Scene> {
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

/// `scene` with the full names of its files, so that its text means the same wherever it is kept.
fn anchored(scene: Scene) -> Result<Scene> {
    let pupil = match &scene.pupil.aperture {
        Aperture::File(file) => Some(file),
        _ => None,
    };
    let files = [
        ("pupil.file", pupil),
        ("modes.file", scene.modes.file.as_ref()),
        ("image.diversity_file", scene.image.diversity_file.as_ref()),
        ("aberrations.ncpa_file", scene.aberrations.as_ref().and_then(|aberrations| aberrations.ncpa_file.as_ref())),
    ];
    let mut full = Vec::new();
    for (key, file) in files {
        if let Some(file) = file {
            let path = std::path::absolute(scene.resolve(file)).map_err(|error| Error::file(file, error))?;
            full.push((key, toml_edit::Value::from(path.display().to_string()).to_string()));
        }
    }
    if full.is_empty() {
        return Ok(scene);
    }
    scene.with(&full.iter().map(|(key, path)| (*key, path.as_str())).collect::<Vec<_>>())
}

/// Says now, before the work, what would stop `output` from being written after it; `inputs` must survive.
pub fn check_output(output: &Path, inputs: &[&Path]) -> Result<()> {
    let same = |input: &&Path| matches!((input.canonicalize(), output.canonicalize()), (Ok(a), Ok(b)) if a == b);
    if inputs.iter().any(same) {
        return Err(Error::file(output, "is read by this command and cannot be its output: give another name"));
    }
    // Whatever it will hold, it appears as a FITS file does: by a rename within its directory.
    FitsWriter::create(output).map(drop)
}

/// [`check_output`] for a picture.
pub fn check_picture(output: &Path, inputs: &[&Path]) -> Result<()> {
    let extension = output.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    if !["png", "svg"].contains(&extension.to_ascii_lowercase().as_str()) {
        return Err(Error::file(output, "a picture is named .png or .svg"));
    }
    check_output(output, inputs)
}

/// An error about the contents of `path`, with its name before it.
pub fn about(path: &Path) -> impl Fn(Error) -> Error {
    let path: PathBuf = path.to_path_buf();
    move |error| match error {
        Error::Shape(reason) | Error::Image(reason) => Error::file(&path, reason),
        other => other,
    }
}
