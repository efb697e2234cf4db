//! Prints the benchmark table.
#![forbid(unsafe_code)]

use bench::{AREAS, report};
use clap::Parser;

/// Measures the speed of the workspace's components beside that of peers.
#[derive(Parser)]
struct Options {
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Name of an area, or a part of the name of a row.
    filter: Option<String>,
}

fn main() -> anyhow::Result<()> {
    let options = Options::parse();
    let filter = options.filter.as_deref().unwrap_or("");
    let one_area = AREAS.iter().any(|(area, _)| *area == filter);
    let mut rows = Vec::new();
    for (_, measure) in AREAS.iter().filter(|(area, _)| !one_area || *area == filter) {
        rows.extend(measure()?.into_iter().filter(|row| one_area || row.name.contains(filter)));
    }
    anyhow::ensure!(
        !rows.is_empty(),
        "no area or row matches `{filter}`; without a filter, everything is measured"
    );
    if options.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
    } else {
        println!("{}", report::table(&rows));
    }
    Ok(())
}
