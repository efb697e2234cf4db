//! `--keep-out FILE` and `--keep-in FILE`: areas that the robot must not enter, or not leave, from GeoJSON files.
//!
//! The polygons become part of the configuration, and with it of the recording, so that a replay needs no file. Their coordinates
//! are metres in `map`, as in the `walls.geojson` of `firmware-host map export`, and not the degrees of RFC 7946.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use runtime::exploration::PolicyKind;
use runtime::planning::KeepOut;
use serde_json::Value;

use crate::config::Config;

/// The corners of an area, metres.
pub type Polygon = Vec<[f64; 2]>;

/// The files with areas.
#[derive(Args, Debug, Clone, Default)]
pub struct AreaArgs {
    /// GeoJSON file with polygons that the robot must not enter, in metres of the frame `map`.
    #[arg(long, value_name = "FILE")]
    pub keep_out: Option<PathBuf>,
    /// GeoJSON file with polygons that the robot must not leave, in metres of the frame `map`. It explores only there.
    #[arg(long, value_name = "FILE")]
    pub keep_in: Option<PathBuf>,
}

impl AreaArgs {
    /// Adds the areas of the files to the configuration, and checks that the policy can respect all areas.
    ///
    /// # Errors
    /// A file that cannot be read or has other shapes than polygons without holes; a policy that drives without a path.
    pub fn add_to(&self, policy: PolicyKind, config: &mut Config) -> Result<()> {
        if let Some(path) = &self.keep_out {
            config.planning.keep_out_m.extend(read("--keep-out", path)?);
        }
        if let Some(path) = &self.keep_in {
            config.planning.keep_in_m.extend(read("--keep-in", path)?);
        }
        config.plan_config().validate()?;
        if config.planning.keep_in_m.iter().any(|area| area.len() < 3) {
            bail!(
                "planning.keep_in_m: an area has fewer than three corners, and no robot fits into it"
            );
        }
        let areas = [&config.planning.keep_out_m, &config.planning.keep_in_m];
        if areas.iter().all(|areas| areas.is_empty()) {
            return Ok(());
        }
        can_keep_out(policy, config)
    }
}

/// Whether a robot without a map of before may be where it begins: at (0, 0) of `map`. Elsewhere it would rotate on the spot and
/// plan no path.
///
/// # Errors
/// What keeps it from being there.
pub fn allow_the_start(config: &Config) -> Result<()> {
    let planning = &config.planning;
    let closed = KeepOut::new(planning.keep_out_m.clone(), Vec::new());
    let (what, key) = if closed.forbids([0.0; 2]) {
        ("inside of a closed area", "--keep-out, planning.keep_out_m")
    } else if KeepOut::new(Vec::new(), planning.keep_in_m.clone()).forbids([0.0; 2]) {
        ("outside of the areas to keep in", "--keep-in, planning.keep_in_m")
    } else {
        return Ok(());
    };
    bail!(
        "the robot begins at (0, 0) of the frame `map`, which is {what} ({key}), and could plan no path; change the areas, \
         begin at another place, or give the --map that the areas were drawn on"
    )
}

/// The polygons of the file that this option names.
fn read(option: &str, path: &Path) -> Result<Vec<Polygon>> {
    let named = || format!("{option} {}", path.display());
    let text = std::fs::read_to_string(path).with_context(|| {
        format!("cannot read {}; {option} needs a GeoJSON file with polygons", path.display())
    })?;
    let polygons = polygons(&text).with_context(named)?;
    if polygons.is_empty() {
        return Err(anyhow!("the file has no polygon")).with_context(named);
    }
    Ok(polygons)
}

/// Whether a robot with this policy can keep out of areas, or in them.
///
/// # Errors
/// Why it cannot.
pub fn can_keep_out(policy: PolicyKind, config: &Config) -> Result<()> {
    if !policy.plans_paths() {
        bail!(
            "the policy `{}` plans no paths and would enter closed areas, or leave the allowed ones; use --policy active, frontier or inconsistency",
            policy.name()
        );
    }
    if config.exploration.warm_up_frames > 0 {
        bail!(
            "the robot plans no paths in exploration.warm_up_frames and would enter closed areas, or leave the allowed ones; set it to 0"
        );
    }
    Ok(())
}

/// All polygons of a GeoJSON text, without the corner that repeats the first one.
///
/// # Errors
/// Text that is not GeoJSON, or has other shapes than polygons without holes.
pub fn polygons(text: &str) -> Result<Vec<Polygon>> {
    let value: Value = serde_json::from_str(text).context("not JSON")?;
    let mut polygons = Vec::new();
    collect(&value, &mut polygons)?;
    Ok(polygons)
}

fn collect(value: &Value, into: &mut Vec<Polygon>) -> Result<()> {
    match value["type"].as_str() {
        Some("FeatureCollection") => {
            parts(value, "features")?.iter().try_for_each(|feature| collect(feature, into))
        }
        Some("Feature") => collect(&value["geometry"], into),
        Some("GeometryCollection") => {
            parts(value, "geometries")?.iter().try_for_each(|geometry| collect(geometry, into))
        }
        Some("Polygon") => {
            into.push(polygon(&value["coordinates"])?);
            Ok(())
        }
        Some("MultiPolygon") => {
            for rings in parts(value, "coordinates")? {
                into.push(polygon(rings)?);
            }
            Ok(())
        }
        Some(other) => bail!("a {other} is not an area; only Polygon and MultiPolygon are"),
        None => bail!("a part without `type` is not GeoJSON"),
    }
}

fn parts<'a>(value: &'a Value, key: &str) -> Result<&'a Vec<Value>> {
    value[key].as_array().with_context(|| format!("`{key}` is not a list"))
}

fn polygon(rings: &Value) -> Result<Polygon> {
    // Positions may have a height, which does not matter.
    let rings: Vec<Vec<Vec<f64>>> = serde_json::from_value(rings.clone())
        .context("the coordinates of a polygon are not lists of numbers")?;
    let [ring] = rings.as_slice() else {
        bail!("a polygon has holes: draw it as several polygons without holes");
    };
    let corners = ring.iter().map(|position| match position[..] {
        [x_m, y_m, ..] => Ok([x_m, y_m]),
        _ => bail!("a corner has fewer than two coordinates"),
    });
    let mut corners = corners.collect::<Result<Polygon>>()?;
    if corners.first() == corners.last() {
        corners.pop();
    }
    if corners.len() < 3 {
        bail!("a polygon has fewer than three corners");
    }
    Ok(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: &str = "[[[0, 0], [2, 0], [2, 1.5], [0, 1.5], [0, 0]]]";

    fn geometry(kind: &str, coordinates: &str) -> String {
        format!(r#"{{"type": "{kind}", "coordinates": {coordinates}}}"#)
    }

    #[test]
    fn polygons_are_found_in_every_wrapping_and_are_not_closed_twice() {
        let square = vec![[0.0, 0.0], [2.0, 0.0], [2.0, 1.5], [0.0, 1.5]];
        let bare = geometry("Polygon", SQUARE);
        let feature = format!(r#"{{"type": "Feature", "properties": null, "geometry": {bare}}}"#);
        let all = format!(r#"{{"type": "FeatureCollection", "features": [{feature}, {feature}]}}"#);
        let multi = geometry("MultiPolygon", &format!("[{SQUARE}]"));
        for (text, count) in [(&bare, 1), (&feature, 1), (&all, 2), (&multi, 1)] {
            assert_eq!(polygons(text).unwrap(), vec![square.clone(); count], "{text}");
        }
    }

    #[test]
    fn what_is_not_an_area_is_refused_with_its_name() {
        let hole = "[[[0,0],[3,0],[3,3],[0,0]], [[1,1],[2,1],[2,2],[1,1]]]";
        for (text, words) in [
            (geometry("LineString", "[[0,0],[1,1]]"), "a LineString is not an area"),
            (geometry("Polygon", hole), "has holes"),
            (geometry("Polygon", "[[[0,0],[1,1],[0,0]]]"), "fewer than three corners"),
            (geometry("Polygon", "[[[0],[1],[2],[0]]]"), "fewer than two coordinates"),
            ("{}".to_owned(), "without `type`"),
            ("[".to_owned(), "not JSON"),
        ] {
            let error = polygons(&text).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }

    #[test]
    fn a_policy_without_paths_and_a_corner_far_away_are_refused() {
        let close = |file: Option<&Path>, policy, config: &mut Config| {
            let areas = AreaArgs { keep_out: file.map(Path::to_owned), keep_in: None };
            areas.add_to(policy, config)
        };
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("closed.geojson");
        std::fs::write(&path, geometry("Polygon", SQUARE)).unwrap();
        let mut config = Config::default();
        close(Some(&path), PolicyKind::Active, &mut config).unwrap();
        assert_eq!(config.planning.keep_out_m.len(), 1);
        let none = dir.path().join("none.geojson");
        std::fs::write(&none, r#"{"type": "FeatureCollection", "features": []}"#).unwrap();
        let error = close(Some(&none), PolicyKind::Active, &mut Config::default()).unwrap_err();
        assert!(format!("{error:#}").contains("no polygon"), "{error:#}");
        let error = close(None, PolicyKind::Random, &mut config).unwrap_err().to_string();
        assert!(error.contains("`random` plans no paths"), "{error}");
        // Degrees times 1e5 are no metres of a home.
        std::fs::write(&path, geometry("Polygon", "[[[5e6,0],[5e6,1],[4e6,1],[5e6,0]]]")).unwrap();
        assert!(close(Some(&path), PolicyKind::Active, &mut Config::default()).is_err());
    }

    #[test]
    fn areas_to_keep_in_are_read_need_a_policy_with_paths_and_three_corners() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("room.geojson");
        std::fs::write(&path, geometry("Polygon", SQUARE)).unwrap();
        let areas = AreaArgs { keep_out: None, keep_in: Some(path) };
        let mut config = Config::default();
        areas.add_to(PolicyKind::Frontier, &mut config).unwrap();
        let planning = &config.planning;
        assert_eq!((planning.keep_in_m.len(), planning.keep_out_m.len()), (1, 0));
        let error = areas.add_to(PolicyKind::Forward, &mut Config::default()).unwrap_err();
        assert!(error.to_string().contains("leave the allowed ones"), "{error}");
        config.planning.keep_in_m.push(vec![[0.0, 0.0], [1.0, 0.0]]);
        let error = AreaArgs::default().add_to(PolicyKind::Frontier, &mut config).unwrap_err();
        assert!(error.to_string().contains("planning.keep_in_m"), "{error}");
    }

    #[test]
    fn a_run_that_would_begin_outside_of_its_areas_is_refused_with_the_key() {
        let around_m = |x_m: f64| {
            vec![[x_m - 1.0, -1.0], [x_m + 1.0, -1.0], [x_m + 1.0, 1.0], [x_m - 1.0, 1.0]]
        };
        let mut config = Config::default();
        allow_the_start(&config).unwrap();
        config.planning.keep_in_m = vec![around_m(0.0)];
        config.planning.keep_out_m = vec![around_m(5.0)];
        allow_the_start(&config).unwrap();
        config.planning.keep_in_m = vec![around_m(5.0)];
        let error = allow_the_start(&config).unwrap_err().to_string();
        assert!(error.contains("outside") && error.contains("--keep-in"), "{error}");
        config.planning.keep_out_m = vec![around_m(0.0)];
        let error = allow_the_start(&config).unwrap_err().to_string();
        assert!(error.contains("closed area") && error.contains("--keep-out"), "{error}");
    }
}
