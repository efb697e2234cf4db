//! `firmware-host views`: a test set of a scene, for networks that were trained in it or elsewhere.
//!
//! Views are uniform over the reachable floor and over headings. A view comes with the coarse depth that a robot would have
//! that has just come there; three of four came by driving, the fourth by turning on the spot, where coarse depth has no
//! parallax to work with. No view is a picture of any run.

use std::sync::Arc;

use anyhow::Result;
use hal::{DepthMap, ImageView, Pose2};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use runtime::perception::CoarseDepth;
use simulator::World;
use simulator::floor::FloorPlan;

use crate::cli::ViewsArgs;
use crate::config::Config;
use crate::dump::{Dump, Shot, View};
use crate::report::progress::{Progress, Status};
use crate::setup;

/// Steps of the robot before a view: up to 0.7 m of way, or 48 degrees of turning, with the paper's steps.
const HISTORY_STEPS: usize = 24;
/// Every so many steps, the picture is kept as well, for networks that match pictures themselves: eight of them, as many as the
/// runtime remembers.
const KEPT_EVERY: usize = 3;
/// Ways that are tried to one place before another place is drawn.
const WAYS: usize = 20;
/// Every so many views, the robot came by turning.
const TURN_EVERY: u64 = 4;

/// How the robot came to a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Approach {
    Drive,
    Turn,
}

impl Approach {
    fn name(self) -> &'static str {
        match self {
            Self::Drive => "drive",
            Self::Turn => "turn",
        }
    }
}

/// Renders the views.
///
/// # Errors
/// A scene, configuration or folder that cannot be used.
pub fn run(args: &ViewsArgs) -> Result<()> {
    let config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    let world = World::open(&args.scene, &setup::open_options(&args.scene_file, &config))?;
    let mut dump = Dump::create(&args.out, &config.camera.model())?;
    let mut rng = Pcg64Mcg::seed_from_u64(args.seed);
    let mut progress = Progress::start(args.count);
    for index in 0..args.count {
        let approach =
            if index % TURN_EVERY == TURN_EVERY - 1 { Approach::Turn } else { Approach::Drive };
        let way = draw_way(world.floor_plan(), &config, approach, &mut rng);
        take(&world, &config, &way, approach, index, &mut rng, &mut dump)?;
        progress.frame(index + 1, &Status { coverage: None, doing: approach.name() });
    }
    progress.finish();
    dump.write_index()?;
    println!("{} views of {} in {}.", args.count, args.scene, args.out.display());
    Ok(())
}

/// Poses of `base_link` in the world, the view's own last.
fn draw_way(
    plan: &Arc<FloorPlan>,
    config: &Config,
    approach: Approach,
    rng: &mut Pcg64Mcg,
) -> Vec<Pose2> {
    loop {
        let view = plan.random_pose(rng.random());
        let ways = if approach == Approach::Turn { 1 } else { WAYS };
        for _ in 0..ways {
            let way = way_to(&view, config, approach, rng);
            if way.iter().all(|pose| plan.is_reachable(pose.x_m, pose.y_m)) {
                return way;
            }
        }
    }
}

/// Backwards from the view: an arc of forward steps with turns to one side in between, or only turns.
fn way_to(view: &Pose2, config: &Config, approach: Approach, rng: &mut Pcg64Mcg) -> Vec<Pose2> {
    let side = if rng.random() { 1.0 } else { -1.0 };
    let turn = Pose2::new(0.0, 0.0, side * config.base.turn_step_deg.to_radians());
    let forward = Pose2::new(config.base.forward_step_m, 0.0, 0.0);
    let turning_share = match approach {
        Approach::Drive => rng.random_range(0.0..0.5),
        Approach::Turn => 1.0,
    };
    let mut way = vec![*view];
    for _ in 0..HISTORY_STEPS {
        let step = if rng.random::<f64>() < turning_share { turn } else { forward };
        let after = way[way.len() - 1];
        way.push(after.compose(&step.inverse()));
    }
    way.reverse();
    way
}

/// Looks along the way as the robot would; keeps the last picture with its depth, and some before it.
fn take(
    world: &World,
    config: &Config,
    way: &[Pose2],
    approach: Approach,
    index: u64,
    rng: &mut Pcg64Mcg,
    dump: &mut Dump,
) -> Result<()> {
    let camera = config.camera.model();
    let mut coarse = CoarseDepth::new(config.coarse.clone(), camera)?;
    let (mut rgb, mut truth) = (Vec::new(), DepthMap::none(camera.width, camera.height));
    let light = config.simulator.nuisances.lighting(0);
    let view = Some(View { view: index, approach: approach.name() });
    for (step, pose) in way.iter().enumerate() {
        let t_world_camera = pose.to_pose3() * config.camera.mount();
        world.renderer().render(&camera, &t_world_camera, &[], &light, &mut rgb, &mut truth);
        config.simulator.nuisances.add_sensor_noise(rng, &mut rgb);
        let estimate = coarse
            .estimate(ImageView::rgb8(camera.width, camera.height, &rgb)?, &t_world_camera)
            .ok();
        let to_go = way.len() - 1 - step;
        if to_go.is_multiple_of(KEPT_EVERY) {
            let time_ns = (index * way.len() as u64 + step as u64) * config.base.tick_ns();
            let (truth, estimate) =
                if to_go == 0 { (Some(&truth), estimate) } else { (None, None) };
            dump.add(&Shot { time_ns, t_world_camera, rgb: Some(&rgb), truth, view }, estimate)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_driven_way_has_parallax_a_turned_one_none_and_both_end_at_the_view() {
        let (config, view) = (Config::default(), Pose2::new(1.0, 2.0, 0.5));
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        for _ in 0..50 {
            let driven = way_to(&view, &config, Approach::Drive, &mut rng);
            let turned = way_to(&view, &config, Approach::Turn, &mut rng);
            let distance = |way: &[Pose2]| (way[0].x_m - view.x_m).hypot(way[0].y_m - view.y_m);
            assert_eq!((driven[HISTORY_STEPS], turned[HISTORY_STEPS]), (view, view));
            assert!(distance(&driven) > 0.1, "{}", distance(&driven));
            assert!(distance(&turned) < 1e-9);
        }
    }

    #[test]
    fn the_robot_never_comes_through_a_wall() {
        let world =
            World::open("builtin:apartment?seed=1", &simulator::OpenOptions::default()).unwrap();
        let plan = world.floor_plan();
        let mut rng = Pcg64Mcg::seed_from_u64(2);
        for _ in 0..100 {
            let way = draw_way(plan, &Config::default(), Approach::Drive, &mut rng);
            assert!(way.iter().all(|pose| plan.is_reachable(pose.x_m, pose.y_m)));
        }
    }
}
