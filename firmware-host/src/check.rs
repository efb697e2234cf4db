//! `firmware-host check`: is this configuration sound, and what is in effect?

use anyhow::Result;

use crate::cli::CheckArgs;
use crate::config::{Config, DEFAULT_FILE};

/// Prints the effective configuration, or the documented defaults when there is no file.
///
/// # Errors
/// Everything that is wrong with the file.
pub fn run(args: &CheckArgs) -> Result<()> {
    match &args.config {
        None => print!("{DEFAULT_FILE}"),
        Some(path) => {
            let config = Config::load(path)?;
            print!("# {} is sound. In effect:\n\n{}", path.display(), config.to_toml()?);
        }
    }
    Ok(())
}
