//! Images of a file where a verb takes those of one channel.

use cophase::pipeline::Images;
use cophase::{Error, Result};
use std::path::Path;

/// The images of a file of one channel; the error of another names the file.
pub fn of_one_channel(path: &Path, mask: Option<&Path>) -> Result<Images> {
    Images::only(Images::read(path, mask)?).map_err(|error| Error::file(path, error))
}
