//! Files that a scene names, and a check that they exist.

use crate::io::file_of;
use crate::scene::{Aperture, Purpose, Scene};
use crate::{Error, Result};
use std::path::{Path, PathBuf};
use std::time::SystemTime;

/// Files that each channel may have of its own.
const DIVERSITY_FILE: &str = "image.diversity_file";
const FILTER_FILE: &str = "image.filter_file";

/// Files that `scene` names: key and path.
pub fn scene_files(scene: &Scene) -> Vec<(&'static str, PathBuf)> {
    let channels = scene.channels().iter().flat_map(|channel| scene_files(&channel.scene));
    let channels: Vec<_> = channels.filter(|(key, _)| [DIVERSITY_FILE, FILTER_FILE].contains(key)).collect();
    let pupil = match &scene.pupil.aperture {
        Aperture::File(file) => Some(file),
        _ => None,
    };
    let files = [
        ("pupil.file", pupil),
        ("modes.file", scene.modes.file.as_ref()),
        (DIVERSITY_FILE, scene.image.diversity_file.as_ref()),
        (FILTER_FILE, scene.image.filter_file.as_ref()),
        ("aberrations.ncpa_file", scene.aberrations.as_ref().and_then(|aberrations| aberrations.ncpa_file.as_ref())),
        ("mirror.influence_file", scene.mirror.influence_file.as_ref()),
        ("mirror.actuator_file", scene.mirror.actuator_file.as_ref()),
        ("commands.segment_file", scene.commands.segment_file.as_ref()),
        ("commands.segment_matrix_file", scene.commands.segment_matrix_file.as_ref()),
        ("commands.actuator_file", scene.commands.actuator_file.as_ref()),
        ("commands.actuator_matrix_file", scene.commands.actuator_matrix_file.as_ref()),
        ("control.interaction_file", scene.control.as_ref().and_then(|control| control.interaction_file.as_ref())),
        (
            "control.command_matrix_file",
            scene.control.as_ref().and_then(|control| control.command_matrix_file.as_ref()),
        ),
        (
            "wavefront_sensor.reference_file",
            scene.wavefront_sensor.as_ref().and_then(|sensor| sensor.reference_file.as_ref()),
        ),
        (
            "wavefront_sensor.moved_reference_file",
            scene.wavefront_sensor.as_ref().and_then(|sensor| sensor.moved_reference_file.as_ref()),
        ),
        (
            "wavefront_sensor.subaperture_file",
            scene.wavefront_sensor.as_ref().and_then(|sensor| sensor.subaperture_file.as_ref()),
        ),
    ];
    files.into_iter().filter_map(|(key, file)| Some((key, scene.resolve(file?)))).chain(channels).collect()
}

/// Time and length of a file, by which a change of it is seen; `None` where it is not there.
pub(super) type FileState = Option<(SystemTime, u64)>;

/// State of each file that `scene` names.
pub(super) fn file_states(scene: &Scene) -> Vec<FileState> {
    let state = |path: &Path| {
        let metadata = file_of(path).metadata().ok()?;
        Some((metadata.modified().ok()?, metadata.len()))
    };
    scene_files(scene).iter().map(|(_, path)| state(path)).collect()
}

/// Refuses a scene that names a file which does not exist under a key that `is_checked` accepts, whether or not the file is read:
/// a misspelt name would have no effect. A map of NCPA is missed by the simulators, which read it, and not by an estimate.
///
/// # Errors
/// [`Error::File`] with the name of the file and the key.
pub fn check_scene_files(scene: &Scene, is_checked: impl Fn(&str) -> bool) -> Result<()> {
    // A FITS file may have an HDU in brackets behind its name.
    let is_there = |path: &Path| file_of(path).exists();
    let missing = |(key, path): &(&str, PathBuf)| *key != "aberrations.ncpa_file" && is_checked(key) && !is_there(path);
    match scene_files(scene).into_iter().find(missing) {
        Some((key, path)) => Err(Error::file(path, format_args!("there is no such file; {key} of the scene names it"))),
        None => Ok(()),
    }
}

/// As [`check_scene_files`] of every key, for an estimate: the scene in an image file may name files of another machine, and
/// only those that the estimate reads are missed.
///
/// # Errors
/// As [`check_scene_files`].
pub(super) fn check_for_estimate(scene: &Scene) -> Result<()> {
    if scene.purpose() == Purpose::Embedded { Ok(()) } else { check_scene_files(scene, |_| true) }
}
