//! Renders a view of a scene: `view SCENE OUT.png [X Y YAW_DEGREES]`. Colour above, depth below
//! (near is bright). Without a pose, the start pose of seed 0. `SCENE` is a glTF or OBJ file or
//! `builtin:NAME?seed=K`.

use std::error::Error;

use hal::{CameraModel, DepthMap, Pose2, camera_mount};
use simulator::render::Lighting;
use simulator::world::{OpenOptions, World};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [scene, out, pose @ ..] = arguments.as_slice() else {
        return Err("usage: view SCENE OUT.png [X Y YAW_DEGREES]".into());
    };
    let world = World::open(scene, &OpenOptions::default())?;
    let pose = match pose {
        [x, y, yaw] => Pose2::new(x.parse()?, y.parse()?, yaw.parse::<f64>()?.to_radians()),
        _ => world.floor_plan().start_pose(0),
    };
    let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
    let mut pixels = Vec::new();
    let mut depth = DepthMap::none(camera.width, camera.height);
    let t_world_camera = pose.to_pose3() * camera_mount(0.0, 0.8, 0.0);
    world.renderer().render(
        &camera,
        &t_world_camera,
        &[],
        &Lighting::default(),
        &mut pixels,
        &mut depth,
    );
    pixels.extend(depth.values().iter().flat_map(|d| [brightness(*d); 3]));
    let width = camera.width as u32;
    let height = 2 * camera.height as u32;
    let rendered =
        image::RgbImage::from_raw(width, height, pixels).ok_or("the image has another size")?;
    rendered.save(out)?;
    println!(
        "{out}: from ({:.2}, {:.2}), {:.0} degrees",
        pose.x_m,
        pose.y_m,
        pose.yaw_rad.to_degrees()
    );
    Ok(())
}

fn brightness(depth_m: f32) -> u8 {
    if depth_m > 0.0 { (255.0 / (1.0 + 0.5 * depth_m)) as u8 } else { 0 }
}
