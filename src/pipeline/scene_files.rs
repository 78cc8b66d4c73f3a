//! Files that a scene names, and a check that they exist.

use crate::io::file_of;
use crate::scene::{Aperture, Purpose, Scene};
use crate::{Error, Result};
use std::path::{Component, Path, PathBuf};
use std::time::SystemTime;

/// Most bytes of a file that a scene names: 1000 maps of 512 × 512 samples in double precision.
const LARGEST_BYTES: u64 = 2 << 30;

/// Files that each channel may have of its own.
const DIVERSITY_FILE: &str = "image.diversity_file";
const FILTER_FILE: &str = "image.filter_file";

impl Scene {
    /// Files that the scene names: key and path.
    pub fn files(&self) -> Vec<(&'static str, PathBuf)> {
        let channels = self.channels().iter().flat_map(|channel| channel.scene.files());
        let channels: Vec<_> = channels.filter(|(key, _)| [DIVERSITY_FILE, FILTER_FILE].contains(key)).collect();
        let pupil = match &self.pupil.aperture {
            Aperture::File(file) => Some(file),
            _ => None,
        };
        let files = [
            ("pupil.file", pupil),
            ("modes.file", self.modes.file.as_ref()),
            (DIVERSITY_FILE, self.image.diversity_file.as_ref()),
            (FILTER_FILE, self.image.filter_file.as_ref()),
            ("aberrations.ncpa_file", self.aberrations.as_ref().and_then(|aberrations| aberrations.ncpa_file.as_ref())),
            ("mirror.influence_file", self.mirror.influence_file.as_ref()),
            ("mirror.actuator_file", self.mirror.actuator_file.as_ref()),
            ("commands.segment_file", self.commands.segment_file.as_ref()),
            ("commands.segment_matrix_file", self.commands.segment_matrix_file.as_ref()),
            ("commands.actuator_file", self.commands.actuator_file.as_ref()),
            ("commands.actuator_matrix_file", self.commands.actuator_matrix_file.as_ref()),
            ("control.interaction_file", self.control.as_ref().and_then(|control| control.interaction_file.as_ref())),
            (
                "control.command_matrix_file",
                self.control.as_ref().and_then(|control| control.command_matrix_file.as_ref()),
            ),
            (
                "wavefront_sensor.reference_file",
                self.wavefront_sensor.as_ref().and_then(|sensor| sensor.reference_file.as_ref()),
            ),
            (
                "wavefront_sensor.moved_reference_file",
                self.wavefront_sensor.as_ref().and_then(|sensor| sensor.moved_reference_file.as_ref()),
            ),
            (
                "wavefront_sensor.subaperture_file",
                self.wavefront_sensor.as_ref().and_then(|sensor| sensor.subaperture_file.as_ref()),
            ),
        ];
        files.into_iter().filter_map(|(key, file)| Some((key, self.resolve(file?)))).chain(channels).collect()
    }

    /// Refuses a scene that names a file which does not exist under a key that `is_checked`
    /// accepts, whether or not the file is read: a misspelt name would have no effect. A missing
    /// map of NCPA is an error for simulators, which read it, and not for an estimate.
    ///
    /// # Errors
    /// [`Error::File`] with the name of the file and the key.
    pub fn check_files(&self, is_checked: impl Fn(&str) -> bool) -> Result<()> {
        // A FITS file may have an HDU in brackets behind its name.
        let is_there = |path: &Path| file_of(path).exists();
        let missing =
            |(key, path): &(&str, PathBuf)| *key != "aberrations.ncpa_file" && is_checked(key) && !is_there(path);
        let files = self.files();
        if let Some((key, path)) = files.iter().find(|file| missing(file)) {
            return Err(Error::file(path, format_args!("there is no such file; {key} of the scene names it")));
        }
        // Also those that need not be there: what is there may be read.
        for (key, path) in files.iter().filter(|(_, path)| is_there(path)) {
            check_file(&file_of(path)).map_err(|error| match error {
                Error::File { path, reason } => {
                    Error::file(path, format_args!("{reason}; {key} of the scene names it"))
                }
                other => other,
            })?;
        }
        Ok(())
    }
}

/// Time and length of a file, by which a change of it is seen; `None` where it is not there.
pub(super) type FileState = Option<(SystemTime, u64)>;

/// State of each file that `scene` names.
pub(super) fn file_states(scene: &Scene) -> Vec<FileState> {
    let state = |path: &Path| {
        let metadata = file_of(path).metadata().ok()?;
        Some((metadata.modified().ok()?, metadata.len()))
    };
    scene.files().iter().map(|(_, path)| state(path)).collect()
}

/// Refuses the scene in the file `image` where it names an existing file outside of that file's
/// folder, under a key that `is_accepted` does not accept: it would read what its maker may not
/// see. Files that are not there are missed where they are needed.
pub(super) fn refuse_foreign_files(scene: &Scene, image: &Path, is_accepted: impl Fn(&str) -> bool) -> Result<()> {
    // The parent of a plain name is empty.
    let folder = image.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = plain(folder)?;
    for (key, path) in scene.files() {
        if !is_accepted(key) && file_of(&path).exists() && !plain(&path)?.starts_with(&folder) {
            let path = path.display();
            return Err(Error::file(
                image,
                format_args!(
                    "the scene in it names {path} ({key}), which is outside of its folder: a file beside the image is accepted; give the scene \
                     itself, or accept its files (--foreign-files)"
                ),
            ));
        }
    }
    Ok(())
}

/// `path` from the root, without `.` and `..`. Links are as they are: who may put one beside the
/// image may read what it points to.
fn plain(path: &Path) -> Result<PathBuf> {
    let mut plain = PathBuf::new();
    for component in std::path::absolute(path).map_err(|error| Error::file(path, error))?.components() {
        match component {
            Component::ParentDir => drop(plain.pop()),
            other => plain.push(other),
        }
    }
    Ok(plain)
}

/// Length of a file that a scene names.
///
/// # Errors
/// [`Error::File`] for anything but a regular file of at most [`LARGEST_BYTES`].
pub(super) fn check_file(path: &Path) -> Result<u64> {
    let metadata = path.metadata().map_err(|error| Error::file(path, error))?;
    if !metadata.is_file() {
        return Err(Error::file(path, "is a directory, a device or a pipe, where a regular file is needed"));
    }
    match metadata.len() {
        length if length <= LARGEST_BYTES => Ok(length),
        length => Err(Error::file(path, format_args!("has {length} bytes: at most {LARGEST_BYTES} are accepted"))),
    }
}

/// As [`Scene::check_files`] of every key, for an estimate: the scene in an image file may name
/// files of another machine, and only those that the estimate reads are missed.
///
/// # Errors
/// As [`Scene::check_files`].
pub(super) fn check_for_estimate(scene: &Scene) -> Result<()> {
    let is_whole = scene.purpose() != Purpose::Embedded;
    scene.check_files(|_| is_whole)
}
