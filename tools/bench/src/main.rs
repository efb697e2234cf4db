//! Prints the benchmark table.
#![forbid(unsafe_code)]

use bench::{ROOMS, report};
use clap::Parser;

/// Measures what the project promises to be fast at.
#[derive(Parser)]
struct Options {
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// A room's name, or a part of the name of a row.
    filter: Option<String>,
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    let filter = options.filter.as_deref().unwrap_or("");
    let one_room = ROOMS.iter().any(|(room, _)| *room == filter);
    let mut rows = Vec::new();
    for (_, measure) in ROOMS.iter().filter(|(room, _)| !one_room || *room == filter) {
        rows.extend(measure()?.into_iter().filter(|row| one_room || row.name.contains(filter)));
    }
    anyhow::ensure!(
        !rows.is_empty(),
        "nothing to measure is called `{filter}`; without a filter, everything is measured"
    );
    if options.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
    } else {
        println!("{}", report::table(&rows));
    }
    Ok(())
}
