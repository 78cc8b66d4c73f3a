//! `cophase manual`: the command line as manual pages, as JSON for the documentation, and as a
//! parser of other command lines.

use clap::{Arg, ArgGroup, Command};
use cophase::io::write_atomically;
use cophase::{Error, Result};
use cophase_view::outputs;
use cophase_view::terminal::Terminal;
use serde_json::{Value, json};
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

const EXAMPLES: &str = "Examples:
  cophase manual /usr/local/share/man/man1            pages for 'man cophase', 'man cophase-estimate', ...
  cophase manual --json                               every verb and option, for programs
  cophase manual --accepts -- scene --reference       exit status 0 if this command line is accepted, else 2";

/// Exit status of a command line that is not accepted; clap's own.
const BAD_USAGE: u8 = 2;

/// Write the manual pages, or describe the command line as JSON
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES, group = ArgGroup::new("task").args(["folder", "json", "accepts"]).required(true))]
pub struct Arguments {
    /// Folder for the manual pages, made if it is not there; pages that are there are replaced
    folder: Option<PathBuf>,
    /// Print all verbs and options as JSON
    #[arg(long)]
    json: bool,
    /// Parse the command line after -- without running it
    #[arg(long, requires = "words")]
    accepts: bool,
    /// Words of a command line, without the name of the program
    #[arg(last = true, value_name = "WORD", requires = "accepts")]
    words: Vec<OsString>,
}

/// Runs the verb for `program`, the command line.
pub fn run(arguments: &Arguments, mut program: Command, terminal: &Terminal) -> Result<ExitCode> {
    if arguments.accepts {
        return Ok(accepts(program, &arguments.words));
    }
    program.build();
    if let Some(folder) = &arguments.folder {
        write_pages(&program, folder)?;
    } else {
        terminal.json(&description(&program))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Parses a command line; where it is not accepted the reason goes to stderr.
fn accepts(program: Command, words: &[OsString]) -> ExitCode {
    let line = [OsString::from("cophase")].into_iter().chain(words.iter().cloned());
    match program.try_get_matches_from(line) {
        // Help and version are errors to clap.
        Err(refusal) if refusal.use_stderr() => {
            eprint!("{refusal}");
            ExitCode::from(BAD_USAGE)
        }
        _ => ExitCode::SUCCESS,
    }
}

/// Writes the page of the program and one for each verb.
fn write_pages(program: &Command, folder: &Path) -> Result<()> {
    outputs::refuse_dash(("the folder", folder))?;
    let cannot = |error: std::io::Error| Error::file(folder, format_args!("the manual cannot be written: {error}"));
    std::fs::create_dir_all(folder).map_err(cannot)?;
    for command in std::iter::once(program).chain(shown(program)) {
        let page = clap_mangen::Man::new(command.clone());
        let mut text = Vec::new();
        page.render(&mut text).map_err(cannot)?;
        write_atomically(&folder.join(page.get_filename()), &text)?;
    }
    Ok(())
}

/// Verbs that have a page.
fn shown(program: &Command) -> impl Iterator<Item = &Command> {
    program.get_subcommands().filter(|verb| !verb.is_hide_set() && verb.get_name() != "help")
}

/// Program and verbs with their options.
fn description(program: &Command) -> Value {
    let verbs: Vec<Value> = shown(program).map(described).collect();
    let mut description = described(program);
    description["verbs"] = verbs.into();
    description
}

fn described(command: &Command) -> Value {
    let arguments = command.get_arguments().filter(|argument| !argument.is_hide_set()).map(argument);
    json!({
        "name": command.get_name(),
        "about": text(command.get_long_about().or(command.get_about())),
        "notes": text(command.get_after_long_help().or(command.get_after_help())),
        "usage": command.clone().render_usage().to_string().trim_start_matches("Usage: "),
        "arguments": arguments.collect::<Vec<Value>>(),
    })
}

fn argument(argument: &Arg) -> Value {
    let takes_value = argument.get_num_args().is_some_and(|count| count.takes_values());
    let values: Vec<&str> = match argument.get_value_names() {
        Some(names) if takes_value => names.iter().map(|name| name.as_str()).collect(),
        _ => Vec::new(),
    };
    let texts = |values: &[clap::builder::OsStr]| -> Vec<String> {
        values.iter().map(|value| value.to_string_lossy().into_owned()).collect()
    };
    let accepted = argument.get_possible_values();
    let accepted = accepted.iter().filter(|value| takes_value && !value.is_hide_set());
    json!({
        "id": argument.get_id().as_str(),
        "short": argument.get_short().map(|letter| format!("-{letter}")),
        "long": argument.get_long().map(|word| format!("--{word}")),
        "values": values,
        "help": text(argument.get_long_help().or(argument.get_help())),
        "default": if takes_value { texts(argument.get_default_values()) } else { Vec::new() },
        "accepted": accepted.map(|value| value.get_name()).collect::<Vec<&str>>(),
        "required": argument.is_required_set(),
        "global": argument.is_global_set(),
    })
}

fn text(styled: Option<&clap::builder::StyledStr>) -> String {
    styled.map(ToString::to_string).unwrap_or_default()
}
