//! `holescout config`, and the merging of defaults, file and flags.

use std::path::Path;

use holescout::config::Config;
use holescout::error::FileError;

use crate::cli::{Command, Common};
use crate::console::Report;
use crate::failure::Failure;

/// Defaults, overridden by the file, overridden by the flags; validated once.
pub(crate) fn merged(common: &Common, command: &Command) -> Result<Config, Failure> {
    let mut config = common.config.as_deref().map_or_else(|| Ok(Config::default()), read)?;
    // The file by itself first, so that its mistakes are told from those of the flags.
    if let (Some(path), Err(error)) = (&common.config, config.validate()) {
        return Err(Failure::input(format!("{}: {error}", path.display())));
    }
    command.apply(&mut config);
    config.validate()?;
    Ok(config)
}

fn read(path: &Path) -> Result<Config, Failure> {
    let text = std::fs::read_to_string(path).map_err(FileError::new("read", path))?;
    Config::parse(&text).map_err(|error| Failure::input(format!("{}: {error}", path.display())))
}

pub(crate) fn run(config: &Config) -> Result<Report, Failure> {
    let text = toml::to_string_pretty(config).map_err(Failure::running)?;
    Report::new(text, config)
}
