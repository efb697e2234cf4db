//! A map that stays: `firmware-host map save|show|export`, and `--map` of `explore` and `run`.

mod drawn_areas;
mod export;
mod file;
mod kept;
mod ros;
mod walls;

use std::fs::File;
use std::io::Read;
use std::path::Path;

use anyhow::{Context, Result, bail};
use jiff::Timestamp;
use runtime::mapping::CellState;
use runtime::robot::SavedMap;

use crate::cli::{MapArgs, MapTask, RunModels};
use crate::replay_run::robot_at_end;

pub use file::{About, MAGIC, MAP_FILE_VERSION, MapFile, MapFileError};
pub use kept::KeptMap;

/// Runs one of the subcommands.
///
/// # Errors
/// A map or a run that cannot be read, and output that cannot be written.
pub fn run(args: &MapArgs) -> Result<()> {
    match &args.task {
        MapTask::Save { run, out, models } => save(run, out, models),
        MapTask::Export { from, out, models } => {
            let file = open(from, models)?;
            let map = SavedMap::read(&file.state)?;
            export::write(&map, &caption(&file, &map), out)
        }
        MapTask::Show { file } => show(file),
    }
}

fn save(run: &Path, out: &Path, models: &RunModels) -> Result<()> {
    // A run of another robot must not replace this one's map.
    if out.exists() {
        bail!("{} exists already; choose another file, or remove it", out.display());
    }
    let file = of_run(run, models)?;
    let map = SavedMap::read(&file.state)?;
    file.write(out)?;
    println!("{}: {}", out.display(), caption(&file, &map));
    Ok(())
}

/// The map at the end of a recorded run.
fn of_run(run: &Path, models: &RunModels) -> Result<MapFile> {
    let (robot, header) = robot_at_end(run, models)?;
    let about = About::now(header.t_base_laser.translation.z);
    Ok(MapFile { about, state: robot.map_state() })
}

/// A map file, or the map of a recorded run.
fn open(path: &Path, models: &RunModels) -> Result<MapFile> {
    if is_map_file(path)? { Ok(MapFile::read(path)?) } else { of_run(path, models) }
}

/// Whether this is a file that begins as map files do. A directory is a run.
fn is_map_file(path: &Path) -> Result<bool> {
    let cannot_read =
        || format!("cannot read {}; give a map file, or the --out folder of a run", path.display());
    if path.metadata().with_context(cannot_read)?.is_dir() {
        return Ok(false);
    }
    let mut begin = [0; MAGIC.len()];
    let mut source = File::open(path).with_context(cannot_read)?;
    // A file that is shorter than the magic is no map.
    Ok(source.read_exact(&mut begin).is_ok() && begin == MAGIC)
}

fn show(path: &Path) -> Result<()> {
    let file = MapFile::read(path)?;
    let map = SavedMap::read(&file.state)?;
    let bytes = path.metadata()?.len();
    let at = map.t_map_base;
    println!(
        "file        {} (format {MAP_FILE_VERSION}, {:.1} KiB)",
        path.display(),
        bytes as f64 / 1024.0
    );
    println!("saved       {} ago by {}", age(&file.about), file.about.written_by);
    println!("free floor  {:.1} m2", square_metres(&map, CellState::Free));
    println!("occupied    {:.1} m2", square_metres(&map, CellState::Occupied));
    println!("cells       {} m", map.grid.cell_m());
    println!("submaps     {}", map.submaps);
    if map.maps > 1 {
        println!(
            "maps        {}, whose places in each other are not known; the floor is that in which the robot was",
            map.maps
        );
    }
    match map.scanner {
        Some(scanner) => println!(
            "scanner     {} beams, {:.1} degrees, {} m above the floor",
            scanner.beams,
            (scanner.angle_increment_rad * (scanner.beams - 1) as f64).to_degrees(),
            file.about.scanner_height_m
        ),
        None => println!("scanner     none"),
    }
    println!(
        "robot       at ({:.2}, {:.2}) m, {:.0} degrees, when the map was saved",
        at.x_m,
        at.y_m,
        // Adding 0 makes -0 to 0.
        at.yaw_rad.to_degrees().round() + 0.0
    );
    Ok(())
}

fn caption(file: &MapFile, map: &SavedMap) -> String {
    let free_m2 = square_metres(map, CellState::Free);
    let saved = Timestamp::from_second(file.about.saved_unix_s).unwrap_or_default();
    let saved = saved.strftime("%Y-%m-%d %H:%M UTC");
    let others = match map.maps {
        1 => String::new(),
        maps => format!(", one of {maps} maps whose places in each other are not known"),
    };
    format!("{free_m2:.1} m2 of free floor, {} submaps, saved {saved}{others}", map.submaps)
}

fn square_metres(map: &SavedMap, state: CellState) -> f64 {
    let cells = map.grid.known_cells().filter(|(cell, _)| map.grid.state(*cell) == state);
    cells.count() as f64 * map.grid.cell_m() * map.grid.cell_m()
}

/// Time since a map was saved, in its two largest units.
fn age(about: &About) -> String {
    let saved = Timestamp::from_second(about.saved_unix_s).unwrap_or_default();
    let seconds = Timestamp::now().as_second().saturating_sub(saved.as_second()).max(0);
    let minutes = seconds / 60;
    let hours = minutes / 60;
    match (hours / 24, hours % 24, minutes % 60) {
        (0, 0, 0) => format!("{seconds} s"),
        (0, 0, minutes) => format!("{minutes} min"),
        (0, hours, minutes) => format!("{hours} h {minutes} min"),
        (days, hours, _) => format!("{days} d {hours} h"),
    }
}
