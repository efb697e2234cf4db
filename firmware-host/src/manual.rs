//! Completion scripts and man pages, made from the declared command line.

use std::path::Path;

use anyhow::{Context, Result};
use clap::CommandFactory;
use clap_complete::Shell;

use crate::cli::Cli;
use crate::output::Output;

/// Prints the completion script for a shell.
pub fn completions(shell: Shell) {
    clap_complete::generate(shell, &mut Cli::command(), "firmware-host", &mut Output);
}

/// Writes `firmware-host.1` and a page for each command into a folder, which is created if it is missing.
///
/// # Errors
/// The folder cannot be written.
pub fn man_pages(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder)
        .and_then(|()| clap_mangen::generate_to(Cli::command(), folder))
        .with_context(|| format!("cannot write man pages into {}", folder.display()))
}
