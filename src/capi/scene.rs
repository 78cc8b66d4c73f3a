//! Scenes.

use super::handle::fence;
use super::pointer::{put, text};
use super::status::cophase_status;
use crate::scene::Scene;
use crate::{Error, Result};
use std::ffi::{CString, c_char};
use std::sync::OnceLock;

/// The presets as C strings, made once.
static PRESETS: OnceLock<Result<Vec<CString>>> = OnceLock::new();

/// The text of a scene that comes with the library: "keck-artificial" or "keck-onsky", in `*scene_text`.
///
/// It is a static string that the caller must not free. COPHASE_BAD_SCENE for another name.
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

fn texts() -> Result<Vec<CString>> {
    let text = |name: &&str| {
        CString::new(Scene::preset_text(name)?)
            .map_err(|error| Error::Internal(format!("the scene '{name}' holds a zero byte: {error}")))
    };
    Scene::preset_names().iter().map(text).collect()
}
