//! `cophase scene`: the documented scenes.

use crate::terminal::Terminal;
use cophase::Result;
use cophase::scene::{self, Scene};

const EXAMPLES: &str = "Examples:
  cophase scene                                 the names of the presets
  cophase scene keck-artificial > scene.toml    one of them, to edit
  cophase scene --reference                     every key, with its default";

/// Print a documented scene, or list those that come with the program
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Preset to print; without it, the presets are listed
    name: Option<String>,
    /// Print every key that a scene may have
    #[arg(long, conflicts_with = "name")]
    reference: bool,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    if arguments.reference {
        return terminal.print(&scene::reference());
    }
    match &arguments.name {
        Some(name) => terminal.print(Scene::preset_text(name)?),
        None => terminal.print(&listing()?),
    }
}

/// Name and first sentence of each preset.
fn listing() -> Result<String> {
    let mut text = String::new();
    for name in Scene::preset_names() {
        let first = Scene::preset_text(name)?.lines().next().unwrap_or_default();
        text += &format!("{name:<16}  {}\n", first.trim_start_matches(['#', ' ']));
    }
    Ok(text)
}
