//! Scene that the tests of the simulator share.

use crate::scene::Scene;

/// The small AO system with a list of channels, or none where the text is empty, and settings.
pub(super) fn small(channels: &str, settings: &[(&str, &str)]) -> Scene {
    let small = include_str!("../../tests/c_api/small.toml");
    let list = if channels.is_empty() { String::new() } else { format!("[[image.channel]]\n{channels}\n") };
    let text = small.replacen("[aberrations]", &format!("{list}[aberrations]"), 1);
    Scene::from_text(&text, "".as_ref()).unwrap().with(settings).unwrap()
}
