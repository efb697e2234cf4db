//! What the exploration loop copies of a tick for the live view: only what is subscribed, and only as often as is allowed.

use std::sync::Arc;
use std::time::Instant;

use hal::{DepthMap, LaserScan, Pose2};
use runtime::event::Event;
use runtime::recording::{MapView, RgbImage};
use runtime::robot::Robot;
use runtime::tick::{Decision, TickInput};

use super::channels::Topic;
use super::hub::Hub;
use super::keep_out_scene::Areas;
use super::rate::Pulse;
use super::words::Now;
use crate::config::LiveSection;
use crate::report::map_view::map_view;
use crate::run::status::unix_s;

/// The path changes rarely, and clients that connect late need it.
const PATH_HZ: f64 = 5.0;
/// The closed areas, likewise. A change is shown at once.
const AREAS_HZ: f64 = 1.0;

/// A tick, as far as some client wants it.
#[derive(Debug, Default)]
pub struct TickCopy {
    /// Nanoseconds since 1970.
    pub time_ns: u64,
    pub now: Now,
    pub t_odom_base: Pose2,
    pub t_map_odom: Pose2,
    pub goal_m: Option<[f64; 2]>,
    pub scan: Option<LaserScan>,
    pub path_m: Option<Vec<[f64; 2]>>,
    pub map: Option<MapView>,
    pub areas: Option<Areas>,
    pub frame: Option<RgbImage>,
    pub depth: Option<DepthMap>,
    pub events: Vec<Event>,
}

/// Makes the copies.
pub struct Copies {
    hub: Arc<Hub>,
    scan: Pulse,
    path: Pulse,
    map: Pulse,
    areas: Pulse,
    camera: Pulse,
    depth: Pulse,
    /// The run's clock at 0, in nanoseconds since 1970. A simulation has a clock of its own.
    epoch_ns: Option<u64>,
}

impl Copies {
    /// At the rates of the configuration.
    pub fn new(config: &LiveSection, hub: Arc<Hub>) -> Self {
        Self {
            hub,
            scan: Pulse::of_hz(config.scan_hz),
            path: Pulse::of_hz(PATH_HZ),
            map: Pulse::of_hz(config.map_hz),
            areas: Pulse::of_hz(AREAS_HZ),
            camera: Pulse::of_hz(config.camera_hz),
            depth: Pulse::of_hz(config.depth_hz),
            epoch_ns: None,
        }
    }

    /// Copies a tick.
    pub fn of(
        &mut self,
        robot: &Robot,
        input: &TickInput<'_>,
        decision: &Decision,
        now: Now,
    ) -> TickCopy {
        let at = Instant::now();
        let time_ns = *self
            .epoch_ns
            .get_or_insert_with(|| ((unix_s() * 1e9) as u64).saturating_sub(input.time_ns))
            + input.time_ns;
        let mut copy = TickCopy {
            time_ns,
            now,
            t_odom_base: decision.t_odom_base,
            t_map_odom: decision.t_map_odom,
            goal_m: decision.goal_m,
            ..TickCopy::default()
        };
        if self.hub.wants(Topic::Scan) && self.scan.is_due(at) {
            copy.scan = input.scan.cloned();
        }
        if self.hub.wants(Topic::Path) && self.path.is_due(at) {
            let is_driving = robot.explorer().goal().is_some();
            let corners_m = if is_driving { robot.explorer().path_m() } else { &[] };
            copy.path_m = Some(corners_m.to_vec());
        }
        if self.hub.wants(Topic::Map) && (self.hub.is_fresh(Topic::Map) || self.map.is_due(at)) {
            copy.map = map_view(robot.map());
        }
        if self.hub.wants(Topic::KeepOut)
            && (self.hub.is_fresh(Topic::KeepOut)
                || !input.areas.is_empty()
                || self.areas.is_due(at))
        {
            copy.areas = Some(Areas::of(robot.explorer().keep_out()));
        }
        if let Some(view) = input.frame.filter(|_| self.hub.wants(Topic::Camera))
            && self.camera.is_due(at)
        {
            let rgb = view.data().to_vec();
            copy.frame = Some(RgbImage { width: view.width(), height: view.height(), rgb });
        }
        if self.hub.wants(Topic::Depth) && robot.can_show_depth() && self.depth.is_due(at) {
            copy.depth = robot.shown_depth();
        }
        if self.hub.wants(Topic::Events) {
            copy.events.clone_from(&decision.events);
        }
        copy
    }
}
