//! Size of a cut-out: images of a file that cophase wrote may be smaller or larger than the scene
//! says, for they have their star where a scene of their size has it. The size is no property of
//! the instrument.

use super::images::Images;
use crate::Result;
use crate::scene::Scene;

const KEYS: [&str; 3] = ["image.pixels", "image.columns", "image.rows"];

/// `scene` for images of another size, by the scenes of their files, with a sentence on it; `None`
/// where the size is the scene's, where a file does not say it, or where the caller has set it.
///
/// # Errors
/// [`crate::Error::Scene`] for a size that the scene does not accept.
pub(super) fn scene_of_cut_out(scene: &Scene, images: &[&Images]) -> Result<Option<(Scene, String)>> {
    let size_of = |images: &&Images| {
        let (_, rows, columns) = images.images_e.dim();
        let of_file = images.scene.as_ref()?.image.frame_shape();
        let is_set = images.overrides.iter().any(|key| KEYS.contains(&key.as_str()));
        (of_file == (rows, columns) && !is_set).then_some(of_file)
    };
    let own = scene.image.frame_shape();
    let Some((rows, columns)) = images.first().and_then(size_of).filter(|size| *size != own) else { return Ok(None) };
    let is_common = images.iter().all(|images| size_of(images) == Some((rows, columns)));
    if !is_common || scene.each_channel().iter().any(|(_, scene)| scene.image.frame_shape() != own) {
        return Ok(None);
    }
    let pixels = rows.max(columns);
    let side = |size: usize| (size != pixels).then_some(size);
    let cut_out = scene.changed(|sections| {
        let image = &mut sections.image;
        (image.pixels, image.columns, image.rows) = (pixels, side(columns), side(rows));
    });
    let sentence = format!(
        "The images have {columns}x{rows} pixels, as the scene of their file says, in place of the scene's {}x{}.",
        own.1, own.0
    );
    Ok(Some((cut_out?, sentence)))
}
