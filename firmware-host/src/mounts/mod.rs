//! `firmware-host mounts`: where camera and LiDAR are, from a robot description (URDF).

mod urdf;

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use hal::{CameraMount, Pose3};
use nalgebra::Vector3;

use crate::cli::MountsArgs;
use crate::config::Config;
use urdf::{LinkPose, Urdf};

/// The usual name of a link on the floor below the robot. The printed comment says that it must be below the middle of the axle.
const FLOOR_LINK: &str = "base_footprint";
/// The robot takes the LiDAR's plane as level. At 1 degree it rises 7 cm in 4 m.
const LEVEL_DEG: f64 = 1.0;
/// The range of `lidar.yaw_deg`. A scanner that is turned further is described by `devices.lidar.zero_deg`.
const FORWARD_DEG: f64 = 45.0;

/// Prints the mounts as sections of the configuration.
///
/// # Errors
/// When the file is no URDF, a link is missing or cannot be chosen, or the robot cannot use a mount.
pub fn run(args: &MountsArgs) -> Result<()> {
    let urdf = Urdf::read(&args.urdf)?;
    print!("{}", sections(&urdf, args)?);
    Ok(())
}

fn sections(urdf: &Urdf, args: &MountsArgs) -> Result<String> {
    let base = base_link(urdf, args.base.as_deref())?;
    let camera = chosen(urdf, args.camera.as_deref(), "--camera", &["optical"])?;
    let lidar = chosen(urdf, args.lidar.as_deref(), "--lidar", &["laser", "lidar", "scan"])?;
    let text = format!(
        "# From {}, relative to `{base}`, which must be on the floor below the middle of the axle.\n{}\n{}",
        args.urdf.display(),
        camera_section(camera, &pose(urdf, base, camera)?),
        lidar_section(lidar, &pose(urdf, base, lidar)?)?
    );
    Config::parse(&text, Path::new("mounts")).context("the robot cannot use these mounts")?;
    Ok(text)
}

fn base_link<'a>(urdf: &'a Urdf, named: Option<&'a str>) -> Result<&'a str> {
    let found = urdf.links().find(|link| *link == FLOOR_LINK);
    named.or(found).with_context(|| {
        format!(
            "there is no link `{FLOOR_LINK}`; name the link on the floor below the middle of the axle by --base"
        )
    })
}

/// The link that was named, or the only one with one of these words in its name.
fn chosen<'a>(
    urdf: &'a Urdf,
    named: Option<&'a str>,
    option: &str,
    words: &[&str],
) -> Result<&'a str> {
    if let Some(named) = named {
        return Ok(named);
    }
    let candidates: Vec<&str> = urdf
        .links()
        .filter(|link| words.iter().any(|word| link.to_lowercase().contains(word)))
        .collect();
    match candidates[..] {
        [only] => Ok(only),
        [] => bail!("no link has `{}` in its name; name it by {option}", words.join("` or `")),
        _ => bail!("it may be one of these: {}; name it by {option}", candidates.join(", ")),
    }
}

fn pose(urdf: &Urdf, base: &str, link: &str) -> Result<Pose3> {
    let LinkPose { t_base_link, moving_joints } = urdf.pose(base, link)?;
    if !moving_joints.is_empty() {
        tracing::warn!(
            "`{link}` is behind joints that move ({}): this is its pose where they are at zero",
            moving_joints.join(", ")
        );
    }
    Ok(t_base_link)
}

fn camera_section(link: &str, t_base_link: &Pose3) -> String {
    let is_optical = link.to_lowercase().contains("optical");
    let (axes, t_base_camera) = if is_optical {
        ("", *t_base_link)
    } else {
        // From a link with x ahead and z up to the axes of an image.
        let forward = CameraMount::LEVEL.t_base_camera().rotation;
        (", whose x axis is taken for the optical axis", t_base_link * forward)
    };
    let mount = CameraMount::of(&t_base_camera);
    let keys = [
        ("height_m", mount.height_m),
        ("forward_m", mount.forward_m),
        ("left_m", mount.left_m),
        ("pitch_down_deg", mount.pitch_down_deg),
        ("roll_deg", mount.roll_deg),
        ("yaw_deg", mount.yaw_deg),
    ];
    format!("[camera]\n# Link `{link}`{axes}.\n{}", lines(&keys))
}

fn lidar_section(link: &str, t_base_link: &Pose3) -> Result<String> {
    let up = t_base_link.rotation * Vector3::z();
    let upside_down = up.z < 0.0;
    let level = if upside_down { -Vector3::z() } else { Vector3::z() };
    let tilt_deg = up.angle(&level).to_degrees();
    ensure!(
        tilt_deg <= LEVEL_DEG,
        "`{link}` is tilted by {tilt_deg:.1} degrees; the robot needs a LiDAR whose scan plane is level"
    );
    let place_m = t_base_link.translation.vector;
    let front = t_base_link.rotation * Vector3::x();
    let yaw_deg = front.y.atan2(front.x).to_degrees();
    let mut keys = vec![("height_m", place_m.z), ("forward_m", place_m.x), ("left_m", place_m.y)];
    if yaw_deg.abs() <= FORWARD_DEG {
        keys.push(("yaw_deg", yaw_deg));
    }
    let hangs = if upside_down { "\n[devices.lidar]\nupside_down = true\n" } else { "" };
    Ok(format!("[lidar]\n# Link `{link}`.\n{}{}{hangs}", lines(&keys), rotary_comment(yaw_deg)))
}

/// A URDF gives the direction of a link, and not that of the device's own zero.
fn rotary_comment(yaw_deg: f64) -> String {
    let opposite_deg = if yaw_deg > 0.0 { yaw_deg - 180.0 } else { yaw_deg + 180.0 };
    format!(
        "# For an RPLIDAR, LD06 or LD19, set yaw_deg = 0 here, and the direction by zero_deg of [devices.lidar]: {yaw_deg:.1}, the direction\n\
         # of the link's x axis, if x is the device's own zero; {opposite_deg:.1} for an RPLIDAR whose link is that of Slamtec's ROS driver, which\n\
         # turns its scans by 180 degrees. Check it in the live view: what stands ahead must be ahead.\n"
    )
}

/// Lines of TOML, rounded to a tenth of a millimetre and of a millidegree.
fn lines(keys: &[(&str, f64)]) -> String {
    keys.iter()
        .map(|(key, value)| {
            // Adding 0 makes -0 positive.
            let value = (value * 1e4).round() / 1e4 + 0.0;
            format!("{key} = {value:?}\n")
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot whose camera and LiDAR have these origins in its `base_link`, which is 5 cm above the floor.
    fn robot(camera: &str, lidar: &str) -> String {
        let links = ["base_footprint", "base_link", "camera_link", "camera_optical_frame", "laser"];
        let links = links.map(|name| format!("<link name=\"{name}\"/>")).concat();
        let joints = [
            joint("base_footprint", "base_link", "xyz=\"0 0 0.05\""),
            joint("base_link", "camera_link", camera),
            joint("camera_link", "camera_optical_frame", "rpy=\"-1.5707963 0 -1.5707963\""),
            joint("base_link", "laser", lidar),
        ];
        format!("<robot name=\"r\">{links}{}</robot>", joints.concat())
    }

    fn joint(parent: &str, child: &str, origin: &str) -> String {
        format!(
            "<joint name=\"{child}_joint\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"{child}\"/>\
             <origin {origin}/></joint>"
        )
    }

    const CAMERA: &str = "xyz=\"0.1 -0.02 0.7\" rpy=\"0 0.2792527 0\"";
    const LIDAR: &str = "xyz=\"0.05 0 0.1\"";

    fn mounts(urdf: &str, camera: Option<&str>) -> Result<String> {
        let folder = tempfile::tempdir()?;
        let path = folder.path().join("robot.urdf");
        std::fs::write(&path, urdf)?;
        let camera = camera.map(ToOwned::to_owned);
        let args = MountsArgs { urdf: path.clone(), base: None, camera, lidar: None };
        sections(&Urdf::read(&path)?, &args)
    }

    fn config(urdf: &str, camera: Option<&str>) -> Config {
        Config::parse(&mounts(urdf, camera).unwrap(), Path::new("mounts")).unwrap()
    }

    #[test]
    fn mounts_are_those_of_the_urdf_from_the_floor_up() {
        let config = config(&robot(CAMERA, LIDAR), None);
        let camera = config.camera;
        assert_eq!([camera.height_m, camera.forward_m, camera.left_m], [0.75, 0.1, -0.02]);
        assert_eq!([camera.pitch_down_deg, camera.roll_deg, camera.yaw_deg], [16.0, 0.0, 0.0]);
        let lidar = config.lidar;
        assert_eq!(
            [lidar.height_m, lidar.forward_m, lidar.left_m, lidar.yaw_deg],
            [0.15, 0.05, 0.0, 0.0]
        );
    }

    #[test]
    fn a_link_of_the_cameras_body_gives_the_same_as_its_optical_frame() {
        let urdf = robot(CAMERA, LIDAR);
        assert_eq!(config(&urdf, Some("camera_link")).camera, config(&urdf, None).camera);
    }

    #[test]
    fn a_lidar_that_is_turned_far_gets_no_yaw_but_both_directions_that_its_zero_may_have() {
        let turned = robot(CAMERA, &format!("{LIDAR} rpy=\"0 0 -1.5707963\""));
        assert_eq!(config(&turned, None).lidar.yaw_deg, 0.0);
        let said = mounts(&turned, None).unwrap();
        assert!(!said.contains("yaw_deg = -90"), "{said}");
        assert!(
            said.contains("zero_deg of [devices.lidar]: -90.0,")
                && said.contains("; 90.0 for an RPLIDAR"),
            "{said}"
        );
    }

    #[test]
    fn a_lidar_that_hangs_upside_down_says_so_and_points_where_its_link_points() {
        let hanging = format!("{LIDAR} rpy=\"3.1415927 0 0.5235988\"");
        let config = config(&robot(CAMERA, &hanging), None);
        assert!(config.devices.lidar.upside_down);
        assert_eq!(config.lidar.yaw_deg, 30.0);
    }

    #[test]
    fn a_camera_that_is_rolled_and_looks_aside_has_the_angles_of_the_urdf() {
        let aside = "xyz=\"0 0 0.5\" rpy=\"0.0872665 0.1745329 0.3490659\"";
        let camera = config(&robot(aside, LIDAR), None).camera;
        assert_eq!([camera.roll_deg, camera.pitch_down_deg, camera.yaw_deg], [5.0, 10.0, 20.0]);
    }

    #[test]
    fn what_the_robot_cannot_use_is_refused_with_the_reason() {
        let tilted = robot(CAMERA, "rpy=\"0 0.1 0\"");
        assert!(error(&tilted).contains("`laser` is tilted by 5.7 degrees"));
        let high = robot("xyz=\"0 0 9\"", LIDAR);
        assert!(error(&high).contains("camera.height_m"), "{}", error(&high));
        let two = robot(CAMERA, LIDAR).replace("camera_link", "left_optical");
        assert!(error(&two).contains("camera_optical_frame, left_optical; name it by --camera"));
        let afloat = robot(CAMERA, LIDAR).replace("base_footprint", "base");
        assert!(error(&afloat).contains("by --base"));
    }

    fn error(urdf: &str) -> String {
        format!("{:#}", mounts(urdf, None).unwrap_err())
    }
}
