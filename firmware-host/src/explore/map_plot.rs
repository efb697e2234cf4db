//! `map.png` of a simulated run: the map beside the true home.

use std::path::Path;

use anyhow::Result;
use hal::Pose2;
use runtime::mapping::OccupancyGrid;
use simulator::floor::{FloorPlan, Grid};

use crate::evaluation::Evaluation;
use crate::report::map_image::{CellState, Cells, Goal, MapPlot, TrueHome};
use crate::report::percent;
use crate::report::summary::Summary;

/// Side of the cells in which the distance to true obstacles is drawn, metres.
const TRUTH_CELL_M: f64 = 0.025;
/// Distances to true obstacles are drawn up to this, metres.
const TRUTH_REACH_M: f64 = 0.15;

/// Draws the map in the world, with the start pose aligned.
pub(super) fn write(
    summary: &Summary,
    map: &OccupancyGrid,
    evaluation: &Evaluation,
    plan: &FloorPlan,
    out: &Path,
) -> Result<()> {
    let t_world_map = evaluation.t_world_map();
    let grid = plan.grid();
    let (width, cells) = resampled(map, &t_world_map, grid);
    let (truth_width, to_obstacle_m) = distances(plan);
    let poses = evaluation.poses();
    let truth: Vec<Pose2> = poses.iter().map(|pair| pair.truth).collect();
    let believed = evaluation.believed_path();
    let goals: Vec<Goal> = evaluation
        .goals()
        .iter()
        .map(|goal| Goal { at_m: moved(&t_world_map, goal.at_m), ..*goal })
        .collect();
    let trips: Vec<[f64; 2]> =
        evaluation.trips_m().iter().map(|trip| moved(&t_world_map, *trip)).collect();
    let origin_m = grid.origin_m;
    let reachable = reachable_cells(plan);
    let picture = MapPlot {
        title: &title(summary),
        figures: &figures(summary),
        map: Cells { width, cells: &cells, resolution_m: map.cell_m(), origin_m },
        trajectory: &believed,
        goals: &goals,
        trips: &trips,
        truth: Some(TrueHome {
            reachable: Cells {
                width: grid.width,
                cells: &reachable,
                resolution_m: grid.resolution_m,
                origin_m,
            },
            to_obstacle_m: Cells {
                width: truth_width,
                cells: &to_obstacle_m,
                resolution_m: TRUTH_CELL_M,
                origin_m,
            },
            trajectory: &truth,
        }),
    };
    Ok(picture.write(out)?)
}

fn moved(t_world_map: &Pose2, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
    t_world_map.transform(x_m, y_m).into()
}

/// The map in the world, in cells of its own size, over the area of the true home: number of columns
/// and cells.
pub(super) fn resampled(
    map: &OccupancyGrid,
    t_world_map: &Pose2,
    grid: &Grid,
) -> (usize, Vec<CellState>) {
    let t_map_world = t_world_map.inverse();
    let (width, centers) = raster(grid, map.cell_m());
    let cells = centers
        .map(|[x_m, y_m]| {
            let (x_m, y_m) = t_map_world.transform(x_m, y_m);
            map.state_at(x_m, y_m)
        })
        .collect();
    (width, cells)
}

/// Distance to the nearest true obstacle: number of columns and cells, metres.
fn distances(plan: &FloorPlan) -> (usize, Vec<f32>) {
    let (width, centers) = raster(plan.grid(), TRUTH_CELL_M);
    let cells = centers
        .map(|[x_m, y_m]| {
            let nearest = plan.nearest_surface(x_m, y_m, TRUTH_REACH_M);
            nearest.map_or(TRUTH_REACH_M, |(_, distance_m)| distance_m) as f32
        })
        .collect();
    (width, cells)
}

/// Centres of cells of another size over the area of a grid, row by row, and the number of columns.
fn raster(grid: &Grid, cell_m: f64) -> (usize, impl Iterator<Item = [f64; 2]> + use<>) {
    let columns = (grid.width as f64 * grid.resolution_m / cell_m).ceil() as usize;
    let rows = (grid.height as f64 * grid.resolution_m / cell_m).ceil() as usize;
    let [x_m, y_m] = grid.origin_m;
    let centers = (0..columns * rows).map(move |index| {
        [
            x_m + ((index % columns) as f64 + 0.5) * cell_m,
            y_m + ((index / columns) as f64 + 0.5) * cell_m,
        ]
    });
    (columns, centers)
}

/// The title of the plot: the run in one line.
pub(super) fn title(summary: &Summary) -> String {
    let scene = summary.scene.as_deref().unwrap_or_default();
    let policy = summary.policy.as_deref().unwrap_or_default();
    format!("{scene}, {policy}, {} frames (simulated)", summary.frames)
}

/// The accuracy of the map in one line.
fn figures(summary: &Summary) -> String {
    let mut parts = Vec::new();
    if let (Some(share), Some(area_m2)) = (summary.coverage, summary.reachable_m2) {
        parts.push(format!("{} of {area_m2:.1} m2 mapped", percent(share)));
    }
    if let Some(share) = summary.coverage_true {
        parts.push(format!("{} at its true place", percent(share)));
    }
    if let Some(error) = &summary.map_error_m {
        let [p50, p90] = [error.p50, error.p90].map(|metres| 100.0 * metres);
        parts.push(format!("obstacles within {p50:.1} cm (median), {p90:.1} cm (90 %)"));
    }
    if let Some(error) = &summary.pose_error {
        parts.push(format!("heading off by {:.1} degrees at the end", error.yaw_end_deg));
    }
    parts.join("; ")
}

/// Which cells of the plan's grid are reachable floor.
pub(super) fn reachable_cells(plan: &FloorPlan) -> Vec<bool> {
    let grid = plan.grid();
    let mut cells = vec![false; grid.cells()];
    for index in plan.reachable_floor().filter_map(|[x_m, y_m]| grid.index(x_m, y_m)) {
        cells[index] = true;
    }
    cells
}
