//! `--map FILE`: the map that a run begins with and leaves behind.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result, bail};
use hal::ScanGeometry;
use runtime::recording::lost_reason;
use runtime::robot::Robot;
use runtime::task::AreaChange;

use super::drawn_areas::DrawnAreas;
use super::file::{About, MapFile};
use crate::config::Config;

/// The map file of a run.
#[derive(Debug)]
pub struct KeptMap {
    path: PathBuf,
    scanner_height_m: f64,
    /// BLAKE3 digest of the state that the run began with; `None` for a new map.
    loaded: Option<String>,
    /// Number of submaps in the file. The robot may begin further maps.
    loaded_submaps: usize,
    /// The scanner that the loaded map was made with.
    scanner: Option<ScanGeometry>,
    areas: DrawnAreas,
    /// Where maps that have not met the loaded one are written in this run.
    separate: Option<PathBuf>,
    /// Where the loaded map stays when this run replaces it; `None` for a new map.
    previous: Option<PathBuf>,
    /// Whether it is there.
    is_kept: Arc<AtomicBool>,
    /// Writes the map during the run.
    writing: Option<JoinHandle<()>>,
}

impl KeptMap {
    /// Loads the map into a robot that has not driven yet, if the file exists.
    ///
    /// # Errors
    /// A file that is damaged, of another version or of another robot, and a folder that is missing. The file stays as it is.
    pub fn open(path: &Path, robot: &mut Robot, config: &Config) -> Result<Self> {
        let scanner_height_m = config.lidar.height_m;
        let kept = Self {
            path: path.to_owned(),
            scanner_height_m,
            loaded: None,
            loaded_submaps: 0,
            scanner: None,
            areas: DrawnAreas::beside(path)?,
            separate: None,
            previous: None,
            is_kept: Arc::default(),
            writing: None,
        };
        if !path.exists() {
            // Found out now and not at the end of the run.
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
                bail!("{} is not a folder, so the map cannot be saved there", folder.display());
            }
            return Ok(kept);
        }
        let file = MapFile::read(path)?;
        if file.about.scanner_height_m.to_bits() != scanner_height_m.to_bits() {
            bail!(
                "the map {} was made with lidar.height_m = {}, and this robot has {scanner_height_m}: use another file",
                path.display(),
                file.about.scanner_height_m,
            );
        }
        robot
            .load_map_state(&file.state)
            .with_context(|| format!("cannot use the map {}", path.display()))?;
        let loaded = Some(blake3::hash(&file.state).to_hex().to_string());
        let has_areas = kept.areas.changes().next().is_some();
        if robot.maps() > 1 && (has_areas || !robot.explorer().keep_out().is_empty()) {
            bail!(
                "the map {} holds {} maps whose places in each other are not known, and it is not known to which of them the closed areas \
                 belong; drive without areas until both are one",
                path.display(),
                robot.maps(),
            );
        }
        // A map without localization is one section.
        let loaded_submaps = robot.submaps().max(1);
        let previous = Some(beside(path, ".previous"));
        Ok(Self { loaded, loaded_submaps, scanner: robot.scanner(), previous, ..kept })
    }

    /// BLAKE3 digest of the map state that the run began with, in hex; `None` for a new map.
    #[must_use]
    pub fn loaded(&self) -> Option<&str> {
        self.loaded.as_deref()
    }

    /// The changes that close the areas which were drawn on this map in earlier runs.
    pub fn area_changes(&self) -> impl Iterator<Item = AreaChange> {
        self.areas.changes()
    }

    /// Keeps a change of the areas for the next runs.
    ///
    /// # Errors
    /// When it cannot be written, and when the robot has several maps: which of them the next run begins in is not known.
    pub fn change_areas(&mut self, change: AreaChange, robot: &Robot) -> Result<()> {
        if robot.maps() > 1 {
            bail!("the robot has begun another map; draw the area again when both are one");
        }
        self.areas.change(change)
    }

    /// Whether the robot was given a map and is in another one, which it has begun and which has not met it.
    fn is_apart(&self, robot: &Robot) -> bool {
        self.loaded.is_some() && !robot.is_in_map_of_first(self.loaded_submaps)
    }

    /// Where the robot's maps are written, or why they are not written. A robot that is lost leaves the file as it was, and so does one in
    /// another map: a person decides whether the maps belong together.
    fn target(&mut self, robot: &Robot) -> Result<Target> {
        if let Some(why) = robot.whereabouts().lost() {
            bail!("{} stays as it was: {}", self.path.display(), lost_reason(why));
        }
        if !self.is_apart(robot) {
            let previous = self.previous.clone();
            return Ok(Target { path: self.path.clone(), previous, is_kept: self.is_kept.clone() });
        }
        let separate = self.separate.get_or_insert_with(|| free_name_beside(&self.path)).clone();
        tracing::warn!(
            "{} stays as it was: the robot has begun another map and did not come to a place that this one shows. Both are in {}, which a \
             later run can go on with",
            self.path.display(),
            separate.display()
        );
        Ok(Target { path: separate, previous: None, is_kept: Arc::default() })
    }

    /// Compares the scanner with that of the loaded map, before the robot gets the scan.
    ///
    /// # Errors
    /// Another scanner: localization would take none of its scans.
    pub fn check(&self, scanner: &ScanGeometry) -> Result<()> {
        match &self.scanner {
            Some(known) if known != scanner => bail!(
                "the map {} was made with another scanner ({} beams of {:.3} degrees; this one has {} of {:.3}): use another \
                 file",
                self.path.display(),
                known.beams,
                known.angle_increment_rad.to_degrees(),
                scanner.beams,
                scanner.angle_increment_rad.to_degrees(),
            ),
            _ => Ok(()),
        }
    }

    /// Replaces the file with the robot's map, and keeps the one that the run began with as `home.previous.map`: maps that were joined
    /// wrongly could not be separated again. A robot that never found itself in the loaded map, or that is lost at the end, leaves
    /// the file as it is; if it is in a map that it has begun meanwhile, both are written beside the file.
    ///
    /// # Errors
    /// When it cannot be written. The old file then stays.
    pub fn save(&mut self, robot: &Robot) -> Result<()> {
        // Otherwise an earlier map might replace this one.
        self.finish_writing();
        let about = About::now(self.scanner_height_m);
        match self.target(robot) {
            Ok(target) => target.write(&MapFile { about, state: robot.map_state() })?,
            Err(why) => tracing::warn!("{why}"),
        }
        Ok(())
    }

    /// As [`save`](Self::save), in the middle of a run: another thread compresses and writes the map, so that the loop need not wait
    /// for the disk. It logs what it cannot write.
    ///
    /// # Errors
    /// When the system cannot create a thread.
    pub fn save_aside(&mut self, robot: &Robot) -> Result<()> {
        if self.writing.as_ref().is_some_and(|writing| !writing.is_finished()) {
            bail!("the map is being written already");
        }
        let target = self.target(robot)?;
        let about = About::now(self.scanner_height_m);
        let file = MapFile { about, state: robot.map_state() };
        self.finish_writing();
        self.writing =
            Some(std::thread::Builder::new().name("map".to_owned()).spawn(move || {
                if let Err(error) = target.write(&file) {
                    tracing::error!("the map is not saved: {error:#}");
                }
            })?);
        Ok(())
    }

    fn finish_writing(&mut self) {
        if let Some(writing) = self.writing.take() {
            let _ = writing.join();
        }
    }
}

/// A file to write.
#[derive(Debug)]
struct Target {
    path: PathBuf,
    /// Where what is in the file now stays, if it is not there yet.
    previous: Option<PathBuf>,
    is_kept: Arc<AtomicBool>,
}

impl Target {
    /// Writes the file. What cannot be kept is logged, because the new map would be lost otherwise.
    fn write(&self, file: &MapFile) -> Result<()> {
        let is_kept = self.is_kept.load(Ordering::Relaxed) || !self.path.exists();
        if let Some(previous) = self.previous.as_ref().filter(|_| !is_kept) {
            match keep(&self.path, previous) {
                Ok(()) => self.is_kept.store(true, Ordering::Relaxed),
                Err(error) => tracing::warn!(
                    "the map that the run began with cannot be kept as {}: {error}",
                    previous.display()
                ),
            }
        }
        Ok(file.write(&self.path)?)
    }
}

/// Gives a file a second name. The file is replaced and not changed afterwards, so the second name keeps what is in it now.
fn keep(path: &Path, previous: &Path) -> std::io::Result<()> {
    // A link itself would lead to the new file.
    let file = path.canonicalize()?;
    let partial = beside(previous, ".partial");
    let _ = std::fs::remove_file(&partial);
    // Not every file system has hard links.
    std::fs::hard_link(&file, &partial)
        .or_else(|_| std::fs::copy(&file, &partial).map(|_bytes| ()))?;
    std::fs::rename(&partial, previous)?;
    // Nothing is renamed if both were the same file.
    let _ = std::fs::remove_file(&partial);
    Ok(())
}

/// Where maps that have not met that of `path` are written: the first of `home.separate.map`, `home.separate-2.map` and so on that does not
/// exist.
fn free_name_beside(path: &Path) -> PathBuf {
    let first = beside(path, ".separate");
    let others = (2..).map(|number| beside(path, &format!(".separate-{number}")));
    let mut names = std::iter::once(first).chain(others);
    names.find(|name| !name.exists()).unwrap_or_else(|| path.to_owned())
}

fn beside(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_stem().unwrap_or_default().to_owned();
    name.push(suffix);
    if let Some(extension) = path.extension() {
        name.push(".");
        name.push(extension);
    }
    path.with_file_name(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn separate_maps_are_written_beside_the_file_under_the_first_name_that_is_free() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("home.map");
        let first = folder.path().join("home.separate.map");
        assert_eq!(free_name_beside(&path), first);
        std::fs::write(&first, "").unwrap();
        assert_eq!(free_name_beside(&path), folder.path().join("home.separate-2.map"));
        assert_eq!(beside(Path::new("home"), ".separate"), Path::new("home.separate"));
    }

    fn map(state: &str) -> MapFile {
        MapFile { about: About::now(0.18), state: state.into() }
    }

    fn state(path: &Path) -> Vec<u8> {
        MapFile::read(path).unwrap().state
    }

    /// Where a run writes that began with the map in `path`.
    fn target(path: &Path) -> Target {
        let previous = Some(beside(path, ".previous"));
        Target { path: path.to_owned(), previous, is_kept: Arc::default() }
    }

    #[test]
    fn the_map_that_a_run_began_with_stays_beside_the_new_one_until_the_next_run() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("home.map");
        let previous = folder.path().join("home.previous.map");
        target(&path).write(&map("of Monday")).unwrap();
        assert!(!previous.exists());
        let tuesday = target(&path);
        tuesday.write(&map("of Tuesday at noon")).unwrap();
        tuesday.write(&map("of Tuesday")).unwrap();
        assert_eq!(state(&path), b"of Tuesday");
        assert_eq!(state(&previous), b"of Monday");
        target(&path).write(&map("of Wednesday")).unwrap();
        assert_eq!(state(&previous), b"of Tuesday");
    }

    #[cfg(unix)]
    #[test]
    fn of_a_map_behind_a_link_the_file_is_kept_and_not_the_link() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("there.map");
        let link = folder.path().join("home.map");
        map("of Monday").write(&file).unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        target(&link).write(&map("of Tuesday")).unwrap();
        assert_eq!(state(&link), b"of Tuesday");
        assert_eq!(state(&folder.path().join("home.previous.map")), b"of Monday");
    }

    #[test]
    fn a_map_is_written_even_if_the_one_before_cannot_be_kept() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("home.map");
        map("of Monday").write(&path).unwrap();
        std::fs::create_dir_all(folder.path().join("home.previous.map/full")).unwrap();
        let tuesday = target(&path);
        tuesday.write(&map("of Tuesday")).unwrap();
        assert_eq!(state(&path), b"of Tuesday");
        assert!(!tuesday.is_kept.load(Ordering::Relaxed));
    }
}
