//! Sections and keys that no scene has, with what was probably meant.

use super::channel;
use super::section_keys::SectionKeys;
use super::table::{Reader, Source, nearest, shown, suggestion};
use crate::{Error, Result};

/// Refuses sections and keys that are not among `sections`, with a suggestion.
pub(super) fn refuse(source: Source, document: &toml_edit::Table, sections: &[SectionKeys]) -> Result<()> {
    for (name, item) in document.iter() {
        let reader = |section| Reader { source, section, item: Some(item) };
        let Some(section) = sections.iter().find(|section| section.name == name) else {
            return Err(Error::Scene(format!(
                "{}: {}",
                place(source, document, name),
                unknown_section(sections, name)
            )));
        };
        let Some(table) = item.as_table_like() else {
            let at = place(source, document, name);
            return Err(Error::Scene(format!("{at}: '{name}' is not a section; write [{name}] with its keys below")));
        };
        let is_list = |key: &str| name == "image" && key == channel::LIST;
        let is_known = |key: &str| is_list(key) || section.keys.iter().any(|known| known.name == key);
        if let Some((key, _)) = table.iter().find(|(key, _)| !is_known(key)) {
            return Err(reader(section.name).error(key, unknown_key(sections, section, key)));
        }
    }
    Ok(())
}

/// Position of an entry of the document, for messages.
fn place(source: Source, document: &toml_edit::Table, name: &str) -> String {
    source.at(document.get_key_value(name).and_then(|(key, item)| key.span().or_else(|| item.span())))
}

/// Message for an unknown section.
pub(super) fn unknown_section(sections: &[SectionKeys], name: &str) -> String {
    // A key above the first header is a more common mistake than an unknown section.
    if let Some(home) = sections.iter().find(|section| section.keys.iter().any(|key| key.name == name)) {
        return format!("'{}' is outside its section; it belongs in [{}]", shown(name), home.name);
    }
    let names = || sections.iter().map(|section| section.name);
    match nearest(name, names()) {
        Some(_) => format!("unknown section '{}'{}", shown(name), suggestion(name, names())),
        None => format!("unknown section '{}'; there are {}", shown(name), names().collect::<Vec<_>>().join(", ")),
    }
}

/// Message for an unknown key.
pub(super) fn unknown_key(sections: &[SectionKeys], section: &SectionKeys, key: &str) -> String {
    let names = || section.keys.iter().map(|key| key.name);
    let unknown = format!("unknown key '{}.{}'", section.name, shown(key));
    if let Some(home) = sections.iter().find(|other| other.keys.iter().any(|known| known.name == key)) {
        return format!("{unknown}; it belongs in [{}]", home.name);
    }
    match nearest(key, names()) {
        Some(_) => unknown + &suggestion(key, names()),
        None => format!("{unknown}; [{}] has {}", section.name, names().collect::<Vec<_>>().join(", ")),
    }
}
