//! Map updates, frontiers, and path searches. The peer for searches is the `pathfinding` crate on the same cells. The paper's
//! released Python code, on this kind of machine with 1000x1000 cells, takes 183 ms for a map update, 2,967 ms for a frontier
//! decision, 0.6 s for 3 m of A* and 12.2 s for 12 m.

use anyhow::{Context, Result};
use hal::{CameraModel, LaserScan, Pose2, Range, ScanGeometry, camera_mount};
use runtime::mapping::{Cell, CellBox, FrontierFinder, MapConfig, OccupancyGrid, Surfaces, Sweep};
use runtime::perception::DepthEstimate;
use runtime::planning::{Costmap, PlanConfig, Planner};

use crate::report::{Goal, Peer, Row, Timing, Unit, time, time_against};

const AREA: &str = "mapping";
const SIDE: i32 = 1000;

/// Measures all rows of this module.
///
/// # Errors
/// When a map refuses its synthetic input.
pub fn measure() -> Result<Vec<Row>> {
    let mut rows = map_updates()?;
    rows.extend(decisions()?);
    rows.extend(searches()?);
    Ok(rows)
}

fn row(
    name: &str,
    value: Timing,
    peer: Option<Timing>,
    goal_ms: Option<(f64, f64)>,
    note: &str,
) -> Row {
    Row {
        area: AREA,
        name: name.to_owned(),
        unit: Unit::Seconds,
        value,
        peer: peer.map(|timing| Peer { name: "pathfinding".to_owned(), median: timing.median }),
        goal: goal_ms.map(|(floor, target)| Goal { floor: floor * 1e-3, target: target * 1e-3 }),
        note: note.to_owned(),
    }
}

/// Depth of a corridor 1.6 m wide that ends at a wall 3 m ahead, seen along its axis.
fn corridor(camera: &CameraModel) -> DepthEstimate {
    let mut estimate = DepthEstimate::none(camera.width, camera.height);
    for v in 0..camera.height {
        for u in 0..camera.width {
            let ray = camera.ray(u as f64, v as f64);
            let floor = if ray.y > 0.0 { 0.8 / ray.y } else { f64::INFINITY };
            let depth = (0.8 / ray.x.abs()).min(floor).min(3.0);
            estimate.depth.values_mut()[v * camera.width + u] = depth as f32;
        }
    }
    estimate.confidence.fill(1.0);
    estimate
}

fn map_updates() -> Result<Vec<Row>> {
    let camera = CameraModel::pinhole(640, 192, core::f64::consts::FRAC_PI_2);
    let estimate = corridor(&camera);
    let geometry = ScanGeometry::UTM_30LX;
    let scan = LaserScan { time_ns: 0, geometry, ranges: vec![Range::Hit(2.5); geometry.beams] };
    let mut grid = OccupancyGrid::new(&MapConfig::default())?;
    let mut surfaces = Surfaces::default();
    let mut pose = Pose2::IDENTITY;
    let mut update = |with_scan: bool| -> Result<u64> {
        // The paper's robot moves 0.03 m or 2 degrees per frame.
        pose = pose.compose(&Pose2::new(0.03, 0.0, 0.035));
        grid.begin_update(&pose)?;
        if with_scan {
            surfaces.measure(&scan, &pose, &Pose2::IDENTITY);
        }
        let t_odom_camera = pose.to_pose3() * camera_mount(0.0, 0.8, 0.0);
        grid.integrate_depth(&estimate, &camera, &t_odom_camera, &surfaces)?;
        if with_scan {
            grid.integrate_scan(&scan, &Sweep::at_rest(pose))?;
        }
        grid.mark_standing(&pose, 0.12)?;
        grid.finish_update();
        Ok(grid.changes_digest())
    };
    update(true)?;
    let camera_only = time(300, || update(false).ok());
    let both = time(300, || update(true).ok());
    Ok(vec![
        row(
            "map update, depth 640x192",
            camera_only,
            None,
            Some((2.0, 0.3)),
            "decay, marking, clearing, digest",
        ),
        row("map update, depth and scan of 1081 beams", both, None, Some((2.0, 0.3)), ""),
    ])
}

/// A map with many round free areas, half of them connected, with unknown cells in between and walls across: much more frontier
/// than in a home.
fn explored() -> Result<OccupancyGrid> {
    let config = MapConfig { collision_width_m: 1.5, ..MapConfig::default() };
    let mut grid = OccupancyGrid::new(&config)?;
    for row in -6..6 {
        for column in -6..6 {
            let radius_m = if (row + column) % 2 == 0 { 1.5 } else { 1.0 };
            let pose = Pose2::new(
                f64::from(column) * 2.4 + 1.2,
                f64::from(row) * 2.4 + 1.2,
                f64::from(row),
            );
            grid.begin_update(&Pose2::IDENTITY)?;
            grid.mark_standing(&pose, radius_m)?;
            grid.mark_collision(&pose, 0.6)?;
            grid.finish_update();
        }
    }
    Ok(grid)
}

fn decisions() -> Result<Vec<Row>> {
    let grid = explored()?;
    let mut finder = FrontierFinder::default();
    let mut found = Vec::new();
    let frontier = time(50, || {
        finder.find(&grid, FrontierFinder::MIN_CELLS, &mut found);
        found.len()
    });
    let mut costmap = Costmap::new(&PlanConfig::default())?;
    let update = time(20, || costmap.update(&grid));
    let mut planner = Planner::new(usize::MAX);
    let start =
        costmap.nearest_passable(Cell::new(0, 0), 3.0).context("no passable cell in the middle")?;
    let flood = time(10, || planner.flood(&costmap, start).is_ok());
    let cells = grid.known_box().map_or(0, |known| known.width() * known.height());
    let note = format!("{cells} cells, {} frontiers", found.len());
    Ok(vec![
        row("frontiers of 1000x1000 cells", frontier, None, Some((5.0, 1.0)), &note),
        row("costmap of 1000x1000 cells", update, None, None, "inflation of every obstacle"),
        row(
            "distances to all cells, 1000x1000 cells",
            flood,
            None,
            None,
            "one flood for all goals of a decision",
        ),
    ])
}

/// A square of weighted cells with a start and a goal.
struct Field {
    name: &'static str,
    weights: Vec<u8>,
    start: Cell,
    goal: Cell,
}

impl Field {
    fn new(
        name: &'static str,
        start: (i32, i32),
        goal: (i32, i32),
        weight: impl Fn(i32, i32) -> u8,
    ) -> Self {
        let weights = (0..SIDE * SIDE).map(|at| weight(at % SIDE, at / SIDE)).collect();
        Self { name, weights, start: Cell::new(start.0, start.1), goal: Cell::new(goal.0, goal.1) }
    }

    fn weight(&self, x: i32, y: i32) -> u32 {
        let inside = (0..SIDE).contains(&x) && (0..SIDE).contains(&y);
        if inside { u32::from(self.weights[(y * SIDE + x) as usize]) } else { 0 }
    }

    fn costmap(&self) -> Costmap {
        let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(SIDE - 1, SIDE - 1) };
        Costmap::from_weights(cells, 0.03, |cell| match self.weight(cell.x, cell.y) {
            0 => None,
            weight => Some(f64::from(weight)),
        })
    }

    /// The planner's rules for the peer: 8 neighbours, no cut corners, costs of 12 for a straight and 17 for a diagonal step.
    fn successors(&self, (x, y): (i32, i32)) -> impl Iterator<Item = ((i32, i32), u32)> {
        let around =
            (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).filter(|step| *step != (0, 0));
        around.filter_map(move |(dx, dy)| {
            let weight = self.weight(x + dx, y + dy);
            let open = weight > 0 && self.weight(x + dx, y) > 0 && self.weight(x, y + dy) > 0;
            let length = if dx != 0 && dy != 0 { 17 } else { 12 };
            open.then_some(((x + dx, y + dy), length * weight))
        })
    }

    fn peer(&self) -> Option<u32> {
        let goal = (self.goal.x, self.goal.y);
        let start = (self.start.x, self.start.y);
        pathfinding::prelude::astar(
            &start,
            |at| self.successors(*at),
            |at| distance(*at, goal),
            |at| *at == goal,
        )
        .map(|(_, cost)| cost)
    }
}

/// Cost of the shortest path on a grid without obstacles.
fn distance(from: (i32, i32), to: (i32, i32)) -> u32 {
    let dx = from.0.abs_diff(to.0);
    let dy = from.1.abs_diff(to.1);
    12 * dx.max(dy) + 5 * dx.min(dy)
}

/// Weight of a cell without obstacles.
fn free(_: i32, _: i32) -> u8 {
    1
}

/// A wall directly in front of the goal that is open only at its far end: the search visits nearly every cell.
fn trap(x: i32, y: i32) -> u8 {
    u8::from(x != 980 || y > 990)
}

/// Corridors 6 cells wide, joined at alternating ends.
fn corridors(x: i32, y: i32) -> u8 {
    let opening = if y / 7 % 2 == 0 { x > 990 } else { x < 9 };
    u8::from(y % 7 != 6 || opening)
}

/// Blocks with inflated cost around them, as in the costmap of a cluttered home.
fn clutter(x: i32, y: i32) -> u8 {
    let dx = (x % 40 - 20).abs();
    let dy = (y % 40 - 20).abs();
    match dx.max(dy) {
        0..6 => 0,
        near @ 6..14 => (15 - near) as u8 / 2 + 1,
        _ => 1,
    }
}

fn fields() -> Vec<Field> {
    vec![
        Field::new("A* over 3 m among furniture", (400, 400), (500, 403), clutter),
        Field::new("A* across 1000x1000 free cells", (3, 3), (990, 700), free),
        Field::new("A* across 1000x1000 cells of furniture", (3, 3), (985, 991), clutter),
        Field::new("A* into a trap of 1000x1000 cells", (10, 10), (995, 10), trap),
        Field::new("A* through corridors, 1000x1000 cells", (3, 3), (500, 990), corridors),
    ]
}

fn searches() -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for field in fields() {
        let costmap = field.costmap();
        let mut planner = Planner::new(usize::MAX);
        let path = planner.plan(&costmap, field.start, field.goal).context(field.name)?;
        let note = format!("{} cells long", path.len());
        let (ours, peer) = time_against(
            5,
            || planner.plan(&costmap, field.start, field.goal).map(<[Cell]>::len).ok(),
            || field.peer(),
        );
        rows.push(row(field.name, ours, Some(peer), Some((15.0, 5.0)), &note));
    }
    Ok(rows)
}
