//! `firmware-host views`: renders a test set of a scene for the evaluation of depth networks.
//!
//! The views are uniformly distributed over the reachable floor and over headings. Each view comes
//! with the coarse and dense depth of a robot that has just arrived there. Three of four robots arrived by
//! driving, the fourth by rotating on the spot, which gives no parallax for coarse depth. No view
//! is part of any run.

use std::sync::Arc;

use anyhow::Result;
use hal::{DepthMap, ImageView, LaserScan, Pose2};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::perception::Moment;
use simulator::World;
use simulator::floor::FloorPlan;
use simulator::laser::{self, LaserModel};

use crate::cli::ViewsArgs;
use crate::config::Config;
use crate::dump::{Depths, Dump, Shot, View};
use crate::frame_depth::{self, FrameDepth};
use crate::report::progress::{Progress, Status};
use crate::simulation;

/// Number of steps before a view: up to 0.7 m of driving or 48 degrees of rotation.
const HISTORY_STEPS: usize = 24;
/// The paper's rotation step, whatever that of the robot is, so that views of all builds can be compared.
const ROTATION_DEG: f64 = 2.0;
/// Every third frame before a view is kept as well, for networks that match frames themselves.
/// These are eight frames, as many as the runtime stores.
const KEPT_EVERY: usize = 3;
/// Number of random paths that are tried to one view before another view is drawn.
const MAX_PATHS: usize = 20;
/// Every fourth view is reached by rotation only.
const ROTATION_EVERY: u64 = 4;

/// How the robot reaches a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Approach {
    Drive,
    Rotate,
}

impl Approach {
    fn name(self) -> &'static str {
        match self {
            Self::Drive => "drive",
            Self::Rotate => "turn",
        }
    }
}

/// Renders the views.
///
/// # Errors
/// If the scene or the configuration cannot be read, or the output folder cannot be written.
pub fn run(args: &ViewsArgs) -> Result<()> {
    let config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    let world = simulation::open(&args.scene, &args.scene_file, &config)?;
    let mut dump = Dump::create(&args.out, &config.camera.model())?;
    let mut rng = Pcg64Mcg::seed_from_u64(args.seed);
    let mut progress = Progress::start(args.count);
    for index in 0..args.count {
        let approach = if index % ROTATION_EVERY == ROTATION_EVERY - 1 {
            Approach::Rotate
        } else {
            Approach::Drive
        };
        let path = draw_path(world.floor_plan(), &config, approach, &mut rng);
        render(&world, &config, &path, approach, index, &mut rng, &mut dump)?;
        progress.frame(index + 1, &Status { coverage: None, doing: approach.name() });
    }
    progress.finish();
    dump.write_index()?;
    println!("{} views of {} in {}.", args.count, args.scene, args.out.display());
    Ok(())
}

/// Draws a view and a collision-free path to it: poses of `base_link` in the world, the view last.
fn draw_path(
    plan: &Arc<FloorPlan>,
    config: &Config,
    approach: Approach,
    rng: &mut Pcg64Mcg,
) -> Vec<Pose2> {
    loop {
        let view = plan.random_pose(rng.random());
        let attempts = if approach == Approach::Rotate { 1 } else { MAX_PATHS };
        for _ in 0..attempts {
            let path = path_to(&view, config, approach, rng);
            if path.iter().all(|pose| plan.is_reachable(pose.x_m, pose.y_m)) {
                return path;
            }
        }
    }
}

/// Builds a path backwards from the view: forward steps mixed with rotations to one side, or
/// rotations only.
fn path_to(view: &Pose2, config: &Config, approach: Approach, rng: &mut Pcg64Mcg) -> Vec<Pose2> {
    let side = if rng.random() { 1.0 } else { -1.0 };
    let rotation = Pose2::new(0.0, 0.0, side * ROTATION_DEG.to_radians());
    let forward = Pose2::new(config.base.forward_step_m, 0.0, 0.0);
    let rotation_share = match approach {
        Approach::Drive => rng.random_range(0.0..0.5),
        Approach::Rotate => 1.0,
    };
    let mut path = vec![*view];
    for _ in 0..HISTORY_STEPS {
        let step = if rng.random::<f64>() < rotation_share { rotation } else { forward };
        let after = path[path.len() - 1];
        path.push(after.compose(&step.inverse()));
    }
    path.reverse();
    path
}

/// Renders the frames along the path and computes coarse and dense depth like the robot. Writes the last
/// frame with its depth, and some of the frames before it.
fn render(
    world: &World,
    config: &Config,
    path: &[Pose2],
    approach: Approach,
    index: u64,
    rng: &mut Pcg64Mcg,
    dump: &mut Dump,
) -> Result<()> {
    let camera = config.camera.model();
    let t_base_camera = config.camera.t_base_camera();
    let mut depth = FrameDepth::new(&config.coarse, &config.dense, camera, Some(&t_base_camera))?;
    // Random numbers of its own, so that the scanner does not change the views.
    let mut laser_rng = Pcg64Mcg::seed_from_u64(index);
    let mut scan = LaserScan::empty(LaserModel::UTM_30LX.geometry);
    let mut rgb = Vec::new();
    let mut truth = DepthMap::none(camera.width, camera.height);
    let light = config.simulator.nuisances.lighting(0);
    let view = Some(View { view: index, approach: approach.name() });
    for (step, pose) in path.iter().enumerate() {
        let t_world_camera = pose.to_pose3() * t_base_camera;
        let time_ns = (index * path.len() as u64 + step as u64) * config.base.tick_ns();
        world.renderer().render(&camera, &t_world_camera, &[], &light, &mut rgb, &mut truth);
        config.simulator.nuisances.add_sensor_noise(rng, &mut rgb);
        let t_world_laser = pose.to_pose3() * config.lidar.t_base_laser_3d();
        let renderer = world.renderer();
        let model = &LaserModel::UTM_30LX;
        laser::scan(renderer, |_| t_world_laser, &[], model, &mut laser_rng, time_ns, &mut scan);
        let shot = frame_depth::Shot {
            frame: ImageView::rgb8(camera.width, camera.height, &rgb)?,
            t_odom_camera: t_world_camera,
            scan: Some((&scan, Pose2::of_level(&t_world_laser))),
            moment: Moment { time_ns, t_odom_base: *pose, ..Moment::HANDHELD },
        };
        let _ = depth.estimate(&shot);
        depth.complete(&shot);
        let remaining = path.len() - 1 - step;
        if remaining.is_multiple_of(KEPT_EVERY) {
            let is_view = remaining == 0;
            let depths = Depths { coarse: depth.coarse(), dense: depth.dense() };
            let depths = if is_view { depths } else { Depths::default() };
            let truth = is_view.then_some(&truth);
            dump.add(&Shot { time_ns, t_world_camera, rgb: Some(&rgb), truth, view }, &depths)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driving_gives_parallax_rotating_does_not_and_both_end_at_the_view() {
        let config = Config::default();
        let view = Pose2::new(1.0, 2.0, 0.5);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for _ in 0..50 {
            let driven = path_to(&view, &config, Approach::Drive, &mut rng);
            let rotated = path_to(&view, &config, Approach::Rotate, &mut rng);
            assert_eq!((driven[HISTORY_STEPS], rotated[HISTORY_STEPS]), (view, view));
            assert!(driven[0].distance_m(&view) > 0.1, "{driven:?}");
            assert!(rotated[0].distance_m(&view) < 1e-9);
        }
    }

    #[test]
    fn no_path_passes_through_a_wall() {
        let world =
            World::open("builtin:apartment?seed=1", &simulator::OpenOptions::default()).unwrap();
        let plan = world.floor_plan();
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        for _ in 0..100 {
            let path = draw_path(plan, &Config::default(), Approach::Drive, &mut rng);
            assert!(path.iter().all(|pose| plan.is_reachable(pose.x_m, pose.y_m)));
        }
    }
}
