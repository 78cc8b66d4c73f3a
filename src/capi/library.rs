//! What comes with the library: presets of scenes, and the devices of this machine.

use super::handle::fence;
use super::pointer::{put, put_text, text};
use super::status::cophase_status;
use crate::device::{DeviceInfo, devices};
use crate::scene::Scene;
use crate::{Error, Result};
use std::ffi::{CString, c_char};
use std::path::Path;
use std::sync::OnceLock;

/// The presets as C strings, made once.
static PRESETS: OnceLock<Result<Vec<CString>>> = OnceLock::new();

/// Text of a scene that comes with the library, such as "keck-artificial", "keck-onsky" or
/// "jwst-pair", in `*scene_text`: a static string.
///
/// COPHASE_BAD_SCENE for another name; the message lists all names.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_scene_preset(name: *const c_char, scene_text: *mut *const c_char) -> cophase_status {
    fence(|| {
        let name = unsafe { text(name, "name") }?;
        // The sentence for a name that does not exist is the scene's own.
        Scene::preset_text(name)?;
        let place = Scene::preset_names().iter().position(|known| *known == name);
        let texts = PRESETS.get_or_init(texts).as_ref().map_err(Clone::clone)?;
        let found = place.and_then(|place| texts.get(place));
        let found = found.ok_or_else(|| Error::Internal(format!("the scene '{name}' has a text and no place")))?;
        unsafe { put(scene_text, "scene_text", found.as_ptr()) }
    })
}

/// A scene with another value for one key; its comments stay.
///
/// scene_text: scene as TOML, UTF-8, as cophase_scene_preset gives one.
/// key: section and name, such as "image.peak_snr".
/// value: value in TOML, such as "50" or "[4, 18]"; words and file names may do without quotes. An
///   empty value removes the key, which then has its default.
/// text: receives at most `capacity` bytes of the new scene, the terminating zero included, as with
///   snprintf; may be NULL if capacity is 0. It must not overlap scene_text.
/// length: receives the length of the whole text in bytes, without the zero: a text is whole if it
///   is less than capacity.
///
/// COPHASE_BAD_SCENE for a key that does not exist or a value that it does not accept, with what is
/// accepted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_scene_set(
    scene_text: *const c_char,
    key: *const c_char,
    value: *const c_char,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    fence(|| {
        let (scene_text, key, value) =
            unsafe { (self::text(scene_text, "scene_text")?, self::text(key, "key")?, self::text(value, "value")?) };
        // A scene for a caller's arrays is not complete without them.
        let scene = Scene::from_text(scene_text, Path::new(""))
            .or_else(|error| Scene::for_arrays(scene_text, Path::new("")).map_err(|_| error))?;
        unsafe { put_text(text, capacity, length, scene.with_override(key, value)?.text()) }
    })
}

fn texts() -> Result<Vec<CString>> {
    let text = |name: &&str| {
        CString::new(Scene::preset_text(name)?)
            .map_err(|error| Error::Internal(format!("the scene '{name}' holds a zero byte: {error}")))
    };
    Scene::preset_names().iter().map(text).collect()
}

/// The line of an OpenCL device: its address, which begins its description too, once.
fn line(info: &DeviceInfo) -> String {
    let (address, description) = (info.address(), info.to_string());
    format!("{address}\t{}", description.trim_start_matches(&address).trim_start())
}

/// Devices of this machine, one a line: the text for `device` in cophase_session_options or
/// estimate.device in a scene, a tab, and a description. The first line is always the CPU.
///
/// text: receives at most `capacity` bytes, the terminating zero included, as with snprintf; may be
///   NULL if capacity is 0.
/// length: receives the length of the whole text in bytes, without the zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_device_list(text: *mut c_char, capacity: usize, length: *mut usize) -> cophase_status {
    fence(|| {
        // A machine whose OpenCL is broken still has its CPU.
        let present = devices().unwrap_or_default();
        let lines: Vec<String> = std::iter::once("cpu\tCPU chain".into()).chain(present.iter().map(line)).collect();
        unsafe { put_text(text, capacity, length, &lines.join("\n")) }
    })
}
