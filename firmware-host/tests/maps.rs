//! Maps, closed areas and tasks, as a user has them: explore, save, explore again.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use firmware_host::config::Config;
use firmware_host::map::MapFile;
use firmware_host::recorded::Recorded;
use firmware_host::simulation::simulated_robot;
use hal::Pose2;
use runtime::recording::RecordedTick;
use simulator::{OpenOptions, SimulatedRobot, World};
use tempfile::TempDir;

const SMALL: &str = "[camera]\nwidth = 160\nheight = 64\n[map]\nside_cells = 500\n";
const SCENE: &str = "builtin:apartment?seed=1";

fn firmware_host(args: &[&str]) -> Output {
    Command::cargo_bin("firmware-host").unwrap().args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// A folder with a configuration, in which runs are made.
struct Home {
    dir: TempDir,
}

impl Home {
    fn new() -> Self {
        let dir = TempDir::new().unwrap();
        std::fs::write(dir.path().join("robot.toml"), SMALL).unwrap();
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_owned()
    }

    fn read(&self, folder: &str, file: &str) -> Vec<u8> {
        std::fs::read(self.path(folder).join(file)).unwrap()
    }

    fn explore(&self, name: &str, frames: &str, more: &[&str]) -> Output {
        self.explore_in(SCENE, name, frames, more)
    }

    fn explore_in(&self, scene: &str, name: &str, frames: &str, more: &[&str]) -> Output {
        let config = self.text("robot.toml");
        let out = self.text(name);
        let mut args = vec!["explore", "--scene", scene, "--seed", "5", "--odometry", "perfect"];
        args.extend(["--frames", frames, "--config", &config, "--out", &out]);
        args.extend(more);
        firmware_host(&args)
    }

    fn explored(&self, name: &str, frames: &str, more: &[&str]) -> serde_json::Value {
        let output = self.explore(name, frames, more);
        assert!(output.status.success(), "{}", text(&output.stderr));
        let summary = std::fs::read(self.path(name).join("summary.json")).unwrap();
        serde_json::from_slice(&summary).unwrap()
    }

    /// Where a run ended in the world, as the `--start` of the next one.
    fn end_of(&self, run: &str) -> String {
        let mut config = Config::load(&self.path("robot.toml")).unwrap();
        config.simulator.odometry = firmware_host::config::Odometry::Perfect;
        let world = World::open(SCENE, &OpenOptions::default()).unwrap();
        let robot = SimulatedRobot::new(world.into(), simulated_robot(&config, 5, None)).unwrap();
        let last = ticks(&self.path(run)).pop().unwrap();
        let Pose2 { x_m, y_m, yaw_rad } = robot.devices().truth.pose().compose(&last.wheel.odom);
        format!("{x_m},{y_m},{}", yaw_rad.to_degrees())
    }
}

fn ticks(run: &Path) -> Vec<RecordedTick> {
    Recorded::open(run).unwrap().ticks().map(Result::unwrap).collect()
}

fn replayed(run: &str) -> String {
    text(&firmware_host(&["replay", run]).stdout)
}

#[test]
fn a_home_that_was_saved_is_known_when_the_next_run_begins_and_that_run_replays() {
    let home = Home::new();
    let map = home.text("home.map");
    let first = home.explored("first", "120", &["--map", &map]);
    let saved = std::fs::read(&map).unwrap();
    let start = home.end_of("first");
    let next = ["--start", &start];
    // It is lost until it has recognized the place in views from several headings.
    let again = home.explored("again", "100", &[next[0], next[1], "--map", &map]);
    assert_eq!(again["lost"]["loaded"], 1, "{again}");
    assert!(coverage(&again) > 0.95 * coverage(&first), "{again} {first}");
    let found = ticks(&home.path("again")).pop().unwrap().decision.unwrap();
    assert_eq!(found.lost, None, "{again}");
    assert!(replayed(&home.text("again")).ends_with("replay: ticks=100 mismatches=0\n"));
    assert_ne!(std::fs::read(&map).unwrap(), saved, "the file holds the newer map");
    let previous = home.path("home.previous.map");
    assert_eq!(std::fs::read(previous).unwrap(), saved, "the map of before stays beside it");
}

fn coverage(summary: &serde_json::Value) -> f64 {
    summary["coverage"].as_f64().unwrap()
}

#[test]
fn the_map_of_a_recording_is_the_one_that_the_run_saved() {
    let home = Home::new();
    let map = home.text("home.map");
    home.explored("run", "40", &["--map", &map]);
    let run = home.text("run");
    let copy = home.text("copy.map");
    let saved = firmware_host(&["map", "save", &run, "--out", &copy]);
    assert!(saved.status.success(), "{}", text(&saved.stderr));
    assert!(state_in(&map) == state_in(&copy));
    let again = firmware_host(&["map", "save", &run, "--out", &copy]);
    assert!(!again.status.success() && text(&again.stderr).contains("exists already"));
}

fn state_in(map: &str) -> Vec<u8> {
    MapFile::read(Path::new(map)).unwrap().state
}

#[test]
fn a_map_is_shown_and_exported_for_other_programs() {
    let home = Home::new();
    let map = home.text("home.map");
    home.explored("run", "40", &["--map", &map]);
    let shown = text(&firmware_host(&["map", "show", &map]).stdout);
    for words in ["saved", "free floor", "submaps", "1081 beams, 270.0 degrees"] {
        assert!(shown.contains(words), "{shown}");
    }
    let folders = [("from_file", &map), ("from_run", &home.text("run"))];
    for (name, from) in folders {
        let out = home.text(name);
        let exported = firmware_host(&["map", "export", from, "--out", &out]);
        assert!(exported.status.success(), "{}", text(&exported.stderr));
    }
    for file in ["map.pgm", "map.yaml", "walls.geojson"] {
        assert!(home.read("from_file", file) == home.read("from_run", file), "{file}");
    }
    assert!(home.read("from_file", "map.png").len() > 1000);
    let pgm = home.read("from_file", "map.pgm");
    let header = text(&pgm[..pgm.iter().position(|byte| *byte == b'\n').unwrap() + 20]);
    let mut numbers = header.split_whitespace().skip(1).map(str::parse::<usize>);
    let [width, height] = [(); 2].map(|()| numbers.next().unwrap().unwrap());
    let pixels = &pgm[pgm.len() - width * height..];
    assert!(pixels.iter().all(|pixel| [0, 205, 254].contains(pixel)));
    let occupied = pixels.iter().filter(|pixel| **pixel == 0).count();
    let walls: serde_json::Value =
        serde_json::from_slice(&home.read("from_file", "walls.geojson")).unwrap();
    let features = walls["features"].as_array().unwrap();
    let cells = features.iter().map(|feature| feature["properties"]["cells"].as_u64().unwrap());
    assert_eq!(cells.sum::<u64>(), occupied as u64);
}

#[test]
fn a_damaged_map_and_one_of_another_robot_are_refused_and_stay_as_they_are() {
    let home = Home::new();
    let map = home.text("home.map");
    home.explored("run", "20", &["--map", &map]);
    let good = std::fs::read(&map).unwrap();
    let mut damaged = good.clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 1;
    std::fs::write(&map, &damaged).unwrap();
    refuses(&home, &map, "home.map is damaged");
    assert!(std::fs::read(&map).unwrap() == damaged);

    std::fs::write(&map, &good).unwrap();
    for (section, words) in [
        ("[lidar]\nforward_m = 0.07\n", "lidar.forward_m"),
        ("[lidar]\nheight_m = 0.31\n", "lidar.height_m"),
        ("[localization]\nsource = \"wheels\"\n", "localization.source"),
    ] {
        std::fs::write(home.path("robot.toml"), format!("{SMALL}{section}")).unwrap();
        refuses(&home, &map, words);
        assert!(std::fs::read(&map).unwrap() == good);
    }
}

fn refuses(home: &Home, map: &str, words: &str) {
    let output = home.explore("refused", "20", &["--map", map]);
    assert!(!output.status.success() && !home.path("refused").exists());
    assert!(text(&output.stderr).contains(words), "{}", text(&output.stderr));
}

#[test]
fn a_robot_stays_within_a_fence_and_the_fence_is_in_the_recording() {
    let home = Home::new();
    let inside_m = 0.9;
    // Four strips around the start.
    let strips = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]].map(|[x, y]: [f64; 2]| {
        let corners = [(inside_m, -1.1), (1.0, -1.1), (1.0, 1.1), (inside_m, 1.1)]
            .map(|(out, along): (f64, f64)| [x * out - y * along, y * out + x * along]);
        serde_json::json!([corners])
    });
    let fence = serde_json::json!({ "type": "MultiPolygon", "coordinates": strips });
    std::fs::write(home.path("fence.geojson"), fence.to_string()).unwrap();
    home.explored("free", "400", &[]);
    let free_m = farthest_m(&home, "free");
    assert!(free_m > inside_m, "{free_m} m without a fence");
    let path = home.text("fence.geojson");
    home.explored("fenced", "400", &["--keep-out", &path]);
    let fenced_m = farthest_m(&home, "fenced");
    assert!(fenced_m < inside_m, "{fenced_m} m with a fence");
    std::fs::remove_file(&path).unwrap();
    assert!(replayed(&home.text("fenced")).ends_with("mismatches=0\n"));
}

#[test]
fn a_robot_that_keeps_in_an_area_explores_it_ends_there_and_says_that_it_is_done() {
    let home = Home::new();
    let reach_m = 0.9;
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
        .map(|[x, y]: [f64; 2]| [reach_m * x, reach_m * y]);
    let area = serde_json::json!({ "type": "Polygon", "coordinates": [corners] });
    std::fs::write(home.path("area.geojson"), area.to_string()).unwrap();
    let path = home.text("area.geojson");
    let summary = home.explored("kept", "1500", &["--keep-in", &path, "--until-done"]);
    assert_eq!(summary["end_reason"], "explored", "{summary}");
    let kept_m = farthest_m(&home, "kept");
    assert!((0.3..reach_m).contains(&kept_m), "{kept_m} m");
    std::fs::remove_file(&path).unwrap();
    assert!(replayed(&home.text("kept")).ends_with("mismatches=0\n"));
}

fn farthest_m(home: &Home, name: &str) -> f64 {
    let poses = ticks(&home.path(name)).into_iter().map(|tick| tick.t_map_base());
    poses.map(|pose| pose.x_m.abs().max(pose.y_m.abs())).fold(0.0, f64::max)
}

#[test]
fn a_robot_drives_to_the_place_that_it_was_given_and_the_run_replays() {
    let home = Home::new();
    let summary = home.explored("run", "60", &["--go-to", "0.4,0.1"]);
    assert_eq!(summary["goals"]["chosen"]["task"], 1, "{summary}");
    assert_eq!(summary["goals"]["reached"], 1, "{summary}");
    let last = ticks(&home.path("run")).pop().unwrap().t_map_base();
    assert!(last.distance_m(&Pose2::new(0.4, 0.1, 0.0)) < 0.15, "{last:?}");
    assert!(replayed(&home.text("run")).ends_with("replay: ticks=60 mismatches=0\n"));
}

/// The same configuration and scanner, so that only the robot can tell.
#[test]
fn in_the_map_of_another_home_the_robot_stays_lost_and_the_file_stays_as_it_is() {
    let home = Home::new();
    let map = home.text("home.map");
    home.explored("run", "120", &["--map", &map]);
    let saved = std::fs::read(&map).unwrap();
    for scene in ["builtin:house?seed=2", "builtin:office?seed=1"] {
        let output = home.explore_in(scene, "elsewhere", "300", &["--map", &map]);
        let said = text(&output.stderr);
        assert!(output.status.success() && said.contains("home.map stays as it was"), "{said}");
        assert!(said.contains("the robot was started in a saved map"), "{said}");
        let ticks = ticks(&home.path("elsewhere"));
        let is_lost = |tick: &RecordedTick| tick.decision.as_ref().unwrap().lost.is_some();
        assert!(ticks.len() == 300 && ticks.iter().all(is_lost));
        assert!(std::fs::read(&map).unwrap() == saved, "{scene}");
        std::fs::remove_dir_all(home.path("elsewhere")).unwrap();
    }
}

#[test]
fn in_the_map_of_another_home_the_robot_makes_one_of_its_own_and_saves_both_beside_the_file() {
    let home = Home::new();
    let map = home.text("home.map");
    home.explored("run", "120", &["--map", &map]);
    let saved = std::fs::read(&map).unwrap();
    let scene = "builtin:office?seed=1";
    let output = home.explore_in(scene, "elsewhere", "550", &["--map", &map]);
    let said = text(&output.stderr);
    assert!(output.status.success() && said.contains("home.map stays as it was"), "{said}");
    assert!(said.contains("home.separate.map"), "{said}");
    assert!(std::fs::read(&map).unwrap() == saved);
    let summary: serde_json::Value =
        serde_json::from_slice(&home.read("elsewhere", "summary.json")).unwrap();
    assert_eq!(summary["maps_begun"], 1);
    assert!(summary.get("maps_joined").is_none());
    // The recording replays, and a later run goes on with both maps.
    assert!(replayed(&home.text("elsewhere")).ends_with("mismatches=0\n"));
    let both = home.text("home.separate.map");
    let shown = text(&firmware_host(&["map", "show", &both]).stdout);
    assert!(shown.contains("maps        2, whose places"), "{shown}");
    let output = home.explore_in(scene, "again", "60", &["--map", &both]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let last = ticks(&home.path("again")).pop().unwrap();
    assert_eq!(last.decision.unwrap().lost, None, "it has found itself in the newer map");
    let shown = text(&firmware_host(&["map", "show", &both]).stdout);
    assert!(shown.contains("maps        2"), "{shown}");
    // Closed areas would have to belong to one of the two.
    std::fs::write(home.path("closed.geojson"), CLOSED).unwrap();
    let closed = home.text("closed.geojson");
    let refused = home.explore_in(scene, "no", "10", &["--map", &both, "--keep-out", &closed]);
    let said = text(&refused.stderr);
    assert!(!refused.status.success() && said.contains("holds 2 maps"), "{said}");
}

const CLOSED: &str = r#"{"type": "Polygon", "coordinates": [[[5, 5], [6, 5], [6, 6], [5, 5]]]}"#;
