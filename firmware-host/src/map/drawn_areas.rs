//! Areas that a person has drawn in the live view, in a file beside the map in whose frame they lie.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use runtime::task::AreaChange;
use serde_json::json;

use crate::areas;
use crate::report::atomic::write_atomically;

/// The corners of an area, metres in `map`.
type Corners = [[f64; 2]; 4];

/// The areas with their file, `MAP.keep-out.geojson`.
#[derive(Debug)]
pub struct DrawnAreas {
    file: PathBuf,
    areas: Vec<Corners>,
}

impl DrawnAreas {
    /// The areas that were drawn on this map in earlier runs.
    ///
    /// # Errors
    /// A file that cannot be read, or holds other shapes than areas with at most four corners.
    pub fn beside(map: &Path) -> Result<Self> {
        let mut name = map.file_name().unwrap_or_default().to_os_string();
        name.push(".keep-out.geojson");
        let file = map.with_file_name(name);
        let areas = match fs::read_to_string(&file) {
            Ok(text) => read(&text).with_context(|| {
                format!("{}: mend or remove this file of drawn areas", file.display())
            })?,
            Err(error) if error.kind() == ErrorKind::NotFound => Vec::new(),
            Err(error) => {
                return Err(error).with_context(|| format!("cannot read {}", file.display()));
            }
        };
        Ok(Self { file, areas })
    }

    /// The changes that close all of them.
    pub fn changes(&self) -> impl Iterator<Item = AreaChange> {
        self.areas.iter().map(|corners_m| AreaChange::Close { corners_m: *corners_m })
    }

    /// Takes a change, and writes the file again.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn change(&mut self, change: AreaChange) -> Result<()> {
        match change {
            AreaChange::Close { corners_m } => self.areas.push(corners_m),
            AreaChange::OpenAll => self.areas.clear(),
        }
        let features: Vec<_> = self.areas.iter().map(feature).collect();
        let all = json!({"type": "FeatureCollection", "features": features});
        Ok(write_atomically(&self.file, &serde_json::to_vec_pretty(&all)?)?)
    }
}

/// An area as GeoJSON, whose rings end where they began.
fn feature(corners_m: &Corners) -> serde_json::Value {
    let ring: Vec<_> = corners_m.iter().chain(corners_m.first()).collect();
    let geometry = json!({"type": "Polygon", "coordinates": [ring]});
    json!({"type": "Feature", "properties": {}, "geometry": geometry})
}

fn read(text: &str) -> Result<Vec<Corners>> {
    areas::polygons(text)?.iter().map(|polygon| corners(polygon)).collect()
}

/// A triangle has its last corner twice.
fn corners(polygon: &[[f64; 2]]) -> Result<Corners> {
    let corners_m = match polygon {
        [a, b, c, d] => [*a, *b, *c, *d],
        [a, b, c] => [*a, *b, *c, *c],
        more => bail!("an area has {} corners; more than four need --keep-out FILE", more.len()),
    };
    AreaChange::Close { corners_m }.check()?;
    Ok(corners_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: Corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    const LINE: Corners = [[0.1 + 0.2, -1.0], [2.0, 1e-17], [2.0, 1e-17], [0.1 + 0.2, -1.0]];

    #[test]
    fn areas_come_back_in_the_next_run_bit_for_bit_until_they_are_opened() {
        let dir = tempfile::tempdir().unwrap();
        let map = dir.path().join("home.map");
        let mut areas = DrawnAreas::beside(&map).unwrap();
        assert_eq!(areas.changes().count(), 0);
        areas.change(close(SQUARE)).unwrap();
        areas.change(close(LINE)).unwrap();
        let mut again = DrawnAreas::beside(&map).unwrap();
        assert_eq!(again.changes().collect::<Vec<_>>(), [close(SQUARE), close(LINE)]);
        again.change(AreaChange::OpenAll).unwrap();
        assert_eq!(DrawnAreas::beside(&map).unwrap().changes().count(), 0);
    }

    fn close(corners_m: Corners) -> AreaChange {
        AreaChange::Close { corners_m }
    }

    #[test]
    fn a_file_that_is_damaged_or_has_too_many_corners_is_named_and_not_ignored() {
        let dir = tempfile::tempdir().unwrap();
        let map = dir.path().join("home.map");
        let file = dir.path().join("home.map.keep-out.geojson");
        let five = r#"{"type":"Polygon","coordinates":[[[0,0],[1,0],[2,1],[1,2],[0,1]]]}"#;
        let far = r#"{"type":"Polygon","coordinates":[[[0,0],[1,0],[5e6,1]]]}"#;
        for (text, words) in [("{", "not JSON"), (five, "5 corners"), (far, "1,000 m")] {
            fs::write(&file, text).unwrap();
            let error = format!("{:#}", DrawnAreas::beside(&map).unwrap_err());
            assert!(
                error.contains("home.map.keep-out.geojson") && error.contains(words),
                "{error}"
            );
        }
    }
}
