//! Draws the floor plans of scenes: `cargo run -p simulator --example floor_plan -- SCENE...
//! OUT_DIR`.
//!
//! White: free. Light grey: floor that the base covers. Grey: other floor. Black: obstacles. Blue:
//! no floor. Orange: free but unreachable. Red: ten start poses, with their headings.

use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use image::{Rgb, RgbImage};
use simulator::floor::FloorPlan;
use simulator::world::{OpenOptions, World};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some((out, scenes)) = arguments.split_last().filter(|(_, scenes)| !scenes.is_empty())
    else {
        eprintln!("usage: floor_plan SCENE... OUT_DIR");
        return ExitCode::from(2);
    };
    for spec in scenes {
        let began = Instant::now();
        let world = match World::open(spec, &OpenOptions::default()) {
            Ok(world) => world,
            Err(error) => {
                eprintln!("{error}");
                return ExitCode::FAILURE;
            }
        };
        let plan = world.floor_plan();
        let origin = world.origin();
        println!(
            "{spec}: {} triangles, floor at {:.3} m, {} x {} cells, reachable floor {:.1} m2, opened in {:.2} s",
            origin.triangles,
            origin.floor_m,
            plan.grid().width,
            plan.grid().height,
            plan.reachable_floor_m2(),
            began.elapsed().as_secs_f64()
        );
        let stem: String =
            spec.rsplit('/').next().unwrap_or(spec).replace([':', '?', '&', '='], "-");
        let path = Path::new(out).join(format!("{stem}.png"));
        if let Err(error) = draw(plan).save(&path) {
            eprintln!("cannot write {}: {error}", path.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn draw(plan: &FloorPlan) -> RgbImage {
    const ZOOM: u32 = 3;
    let grid = plan.grid();
    let width = grid.width as u32;
    let height = grid.height as u32;
    let mut image = RgbImage::from_fn(width * ZOOM, height * ZOOM, |x, y| {
        let cell = (height - 1 - y / ZOOM) * width + x / ZOOM;
        let [x, y] = grid.center(cell as usize);
        Rgb(if plan.is_blocked(x, y) {
            [0, 0, 0]
        } else if plan.is_reachable(x, y) {
            [255, 255, 255]
        } else if plan.is_free(x, y) {
            [255, 170, 60]
        } else if plan.is_reachable_floor(x, y) {
            [220, 220, 220]
        } else if plan.is_supported(x, y) {
            [150, 150, 150]
        } else {
            [70, 90, 160]
        })
    });
    for seed in 0..10 {
        let pose = plan.start_pose(seed);
        for step in 0..30 {
            let (x, y) = pose.transform(f64::from(step) * 0.02, 0.0);
            let column = ((x - grid.origin_m[0]) / grid.resolution_m * f64::from(ZOOM)) as u32;
            let row = (height * ZOOM).saturating_sub(
                ((y - grid.origin_m[1]) / grid.resolution_m * f64::from(ZOOM)) as u32 + 1,
            );
            let size = if step == 0 { 2 } else { 0 };
            for (dx, dy) in (0..=size).flat_map(|dx| (0..=size).map(move |dy| (dx, dy))) {
                if column + dx < image.width() && row + dy < image.height() {
                    image.put_pixel(column + dx, row + dy, Rgb([230, 0, 0]));
                }
            }
        }
    }
    image
}
