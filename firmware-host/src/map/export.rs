//! Writes a map in the forms that other programs read.

use std::path::Path;

use anyhow::{Result, bail};
use runtime::robot::SavedMap;

use super::{ros, walls};
use crate::report::another_run::refuse_run;
use crate::report::atomic::{prepare_dir, write_atomically};
use crate::report::known_cells::KnownCells;
use crate::report::map_image::MapPlot;

/// The description that `map_server` is given.
const YAML_FILE: &str = "map.yaml";
const WALLS_FILE: &str = "walls.geojson";

/// Writes `map.pgm`, `map.yaml`, `map.png` and `walls.geojson` into a folder. `figures` is the image's second line.
pub(super) fn write(map: &SavedMap, figures: &str, dir: &Path) -> Result<()> {
    let Some(cells) = KnownCells::of(&map.grid) else {
        bail!("the map has no known cell: there is nothing to export");
    };
    refuse_run(dir)?;
    prepare_dir(dir)?;
    write_atomically(&dir.join(ros::PGM_FILE), &ros::pgm(&cells))?;
    write_atomically(&dir.join(YAML_FILE), ros::yaml(&cells).as_bytes())?;
    let outlines = serde_json::to_vec(&walls::geojson(&cells))?;
    write_atomically(&dir.join(WALLS_FILE), &outlines)?;
    let plot = MapPlot {
        title: "map",
        figures,
        map: cells.as_cells(),
        trajectory: &[map.t_map_base],
        goals: &[],
        trips: &[],
        truth: None,
    };
    plot.write(dir)?;
    println!(
        "{0}/map.yaml and map.pgm (ROS map_server), {0}/walls.geojson, {0}/map.png: {figures}",
        dir.display()
    );
    Ok(())
}
