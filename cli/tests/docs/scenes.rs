//! TOML blocks: scenes, or keys that are laid over a preset.

use crate::blocks::{self, Block};
use cophase::scene::Scene;
use std::path::Path;
use toml_edit::{DocumentMut, Item};

/// The scene of the block alone, else the first preset that accepts its keys.
fn accepted(block: &Block) -> Result<(), String> {
    let mut refusals = match Scene::from_text(&block.text, Path::new("")) {
        Ok(_) => return Ok(()),
        Err(error) => vec![format!("alone: {error}")],
    };
    for preset in Scene::preset_names() {
        match Scene::from_text(&over(preset, &block.text)?, Path::new("")) {
            Ok(_) => return Ok(()),
            Err(error) => refusals.push(format!("over {preset}: {error}")),
        }
    }
    Err(refusals.join("\n  "))
}

/// The preset with the keys of `text` in place of its own.
fn over(preset: &str, text: &str) -> Result<String, String> {
    let parsed = |text: &str| text.parse::<DocumentMut>().map_err(|error| error.to_string());
    let mut scene = parsed(Scene::preset_text(preset).map_err(|error| error.to_string())?)?;
    for (section, item) in parsed(text)?.iter() {
        match (item, scene.get_mut(section)) {
            (Item::Table(keys), Some(Item::Table(there))) => {
                for (key, value) in keys.iter() {
                    there.insert(key, value.clone());
                }
            }
            _ => {
                scene.insert(section, item.clone());
            }
        }
    }
    Ok(scene.to_string())
}

#[test]
fn toml_blocks_are_scenes() {
    let pages = blocks::run_in("toml");
    let blocks = pages.iter().flat_map(|(_, blocks)| blocks);
    let refused: Vec<String> = blocks
        .filter_map(|block| accepted(block).err().map(|refusals| format!("{block}: no scene:\n  {refusals}")))
        .collect();
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}
