//! What is true of every input, whatever its bytes: a value or one sentence, and no panic. A fuzzer
//! brings the input, or a seeded generator.

use cophase::device::{Choice, Precision};
use cophase::io::{FitsReader, read_images};
use cophase::scene::{Scene, split_setting};
use std::path::{Path, PathBuf};

/// Longest sentence: the longest of a scene lists its keys. Beyond, input is being repeated without
/// bound.
const LONGEST_SENTENCE: usize = 4000;

/// That a refusal is one sentence.
pub fn one_sentence(error: &cophase::Error) {
    let sentence = error.to_string();
    assert!(!sentence.is_empty() && sentence.lines().count() == 1, "not one line: {sentence:?}");
    assert!(sentence.len() < LONGEST_SENTENCE, "{} bytes: {sentence:?}", sentence.len());
    assert!(!sentence.contains("internal error"), "{sentence:?}");
}

/// Looks into what was read; gives whether it was.
fn read<T>(outcome: cophase::Result<T>) -> bool {
    outcome.inspect_err(one_sentence).is_ok()
}

/// A file that is written again for every input, in memory where the machine has a folder for that.
pub struct File(PathBuf);

impl File {
    /// A file of this process and of `name`, which tests side by side need.
    pub fn new(name: &str) -> Self {
        let memory = Path::new("/dev/shm");
        let folder = if memory.is_dir() { memory.to_path_buf() } else { std::env::temp_dir() };
        Self(folder.join(format!("cophase-fuzz-{}-{name}.fits", std::process::id())))
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Reads all that `bytes` hold as a FITS file; gives whether they hold images.
pub fn fits(file: &File, bytes: &[u8]) -> bool {
    std::fs::write(&file.0, bytes).expect("the folder for temporary files is writable");
    let images = read_images(&file.0, None);
    // Its own mask, too: what is no image, or has another shape, is none.
    read(read_images(&file.0, Some(&file.0)));
    if let Ok(images) = &images {
        assert_eq!(images.data.dim(), images.bad.dim());
        // What is read is what is there, but for compression: no header makes more of a file.
        let packed = bytes.starts_with(&[0x1f, 0x8b]) || bytes.windows(6).any(|key| key == b"ZIMAGE");
        assert!(packed || images.data.len() <= bytes.len(), "{} pixels of {} bytes", images.data.len(), bytes.len());
    }
    if let Ok(mut reader) = FitsReader::open(&file.0) {
        read(reader.map(None));
        for name in reader.names() {
            read(reader.map(Some(&name)));
            read(reader.cube(&name));
            read(reader.vector(&name));
            for key in ["EXTNAME", "RON_E", "BZERO", "LONGTEXT", "TFORM1"] {
                read(reader.card(Some(&name), key));
            }
            for column in ["A", "B", "C", "D", ""] {
                read(reader.f64_column(&name, column));
                read(reader.i64_column(&name, column));
                read(reader.text_column(&name, column));
            }
        }
    }
    read(images)
}

/// Why `bytes` are refused as images.
#[allow(dead_code)] // no target asks
pub fn refusal(file: &File, bytes: &[u8]) -> String {
    std::fs::write(&file.0, bytes).expect("the folder for temporary files is writable");
    read_images(&file.0, None).expect_err("these images are refused").to_string()
}

/// Reads `text` as a scene, of a whole telescope and for arrays; gives whether it is one.
pub fn scene(text: &str) -> bool {
    let here = Path::new("");
    read(Scene::for_arrays(text, here));
    let scene = Scene::from_text(text, here);
    if let Ok(scene) = &scene {
        // What is accepted says what it is, and can be varied.
        let again = Scene::from_text(scene.text(), here).expect("a scene's own text is a scene");
        assert_eq!(**scene, *again);
        read(scene.with(&[("image.read_noise_e", "7")]));
        read(scene.without("image.read_noise_e"));
    }
    read(scene)
}

/// Takes each line of `text` for what a command line may give; gives whether any setting was
/// accepted.
pub fn settings(text: &str) -> bool {
    let keck = Scene::preset("keck-artificial").expect("a preset");
    let mut accepted = false;
    for line in text.lines() {
        read(line.parse::<Choice>());
        read(line.parse::<Precision>());
        read(Scene::preset(line));
        match split_setting(line) {
            Ok((key, value)) => {
                accepted |= read(keck.with(&[(key, value)]));
                read(keck.without(key));
            }
            Err(error) => one_sentence(&error),
        }
    }
    accepted
}
