//! What camera and LiDAR leave unseen in front of the robot, from their mounts and the lens.

use crate::config::Config;

/// The camera's lowest ray in the middle of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    camera_height_m: f64,
    camera_forward_m: f64,
    lidar_height_m: f64,
    pitch_down_deg: f64,
    /// Half of the image's vertical field of view.
    half_fov_deg: f64,
    drop_range_m: f64,
}

impl View {
    pub fn new(config: &Config) -> Self {
        let camera = config.camera.model();
        let below_axis = (camera.height as f64 - 0.5 - camera.cy) / camera.fy;
        Self {
            camera_height_m: config.camera.height_m,
            camera_forward_m: config.camera.forward_m,
            lidar_height_m: config.lidar.height_m,
            pitch_down_deg: config.camera.pitch_down_deg,
            half_fov_deg: below_axis.atan().to_degrees(),
            drop_range_m: f64::from(config.map.drop_range_m),
        }
    }

    /// Distance from the robot's centre to the nearest floor in the image at a pitch, metres; `None`
    /// if the image shows no floor.
    fn nearest_floor_m(&self, pitch_down_deg: f64) -> Option<f64> {
        let lowest_deg = self.half_fov_deg + pitch_down_deg;
        if lowest_deg <= 0.0 {
            return None;
        }
        // A ray that goes straight down or back shows the floor under the camera.
        let ahead_m = self.camera_height_m / lowest_deg.min(90.0).to_radians().tan();
        Some(self.camera_forward_m + ahead_m)
    }

    /// The largest pitch at which the horizon is still in the image, degrees: with more, obstacles
    /// that are as high as the camera leave the image above.
    fn advised_pitch_deg(&self) -> f64 {
        self.half_fov_deg.floor()
    }

    /// What is not seen, and a pitch that shows more, as sentences.
    pub fn sentences(&self) -> Vec<String> {
        let Self { camera_height_m, lidar_height_m, pitch_down_deg, .. } = *self;
        let mount = format!("{camera_height_m:.2} m high and {pitch_down_deg:.0} degrees down");
        let unseen = match self.nearest_floor_m(pitch_down_deg) {
            Some(nearest_m) => format!(
                "the camera, {mount}, sees the floor from {nearest_m:.2} m ahead on; nearer than that, no sensor sees \
                 things lower than the LiDAR's {lidar_height_m:.2} m, nor stairs down"
            ),
            None => format!(
                "the camera, {mount}, sees no floor: no sensor sees things lower than the LiDAR's \
                 {lidar_height_m:.2} m, nor stairs down"
            ),
        };
        let nearest_m = self.nearest_floor_m(pitch_down_deg);
        let drops = nearest_m.filter(|nearest_m| self.drop_range_m <= *nearest_m).map(|_| {
            format!(
                "map.drop_range_m = {} ends before the nearest floor in the image: no stairs down are marked in the map",
                self.drop_range_m
            )
        });
        let advised_deg = self.advised_pitch_deg();
        let advised_m = self.nearest_floor_m(advised_deg).filter(|_| pitch_down_deg < advised_deg);
        let advice = advised_m.map(|nearest_m| {
            format!(
                "camera.pitch_down_deg = {advised_deg:.0} shows the floor from {nearest_m:.2} m on, and still the horizon"
            )
        });
        std::iter::once(unseen).chain(drops).chain(advice).collect()
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;

    /// The paper's mount, which is a preset.
    fn level() -> Config {
        let text = include_str!("../../presets/level-camera.toml");
        Config::parse(text, Path::new("level-camera.toml")).unwrap()
    }

    #[test]
    fn the_default_mount_sees_the_floor_from_nearer_and_needs_no_advice() {
        let text = View::new(&Config::default()).sentences().join("\n");
        assert!(text.contains("16 degrees down, sees the floor from 1.25 m"), "{text}");
        assert!(!text.contains("camera.pitch_down_deg ="), "{text}");
    }

    #[test]
    fn the_papers_mount_sees_no_floor_within_two_and_a_half_metres_and_a_pitch_is_advised() {
        let text = View::new(&level()).sentences().join("\n");
        // A camera of 640 by 192 pixels and 90 degrees sees 96 / 320 below its axis: 0.8 m / 0.3.
        assert!(
            text.contains("0.80 m high and 0 degrees down, sees the floor from 2.67 m"),
            "{text}"
        );
        assert!(text.contains("lower than the LiDAR's 0.18 m, nor stairs down"), "{text}");
        // 16.7 + 16 degrees down: 0.8 m / tan(32.7 degrees).
        assert!(text.contains("camera.pitch_down_deg = 16 shows the floor from 1.25 m"), "{text}");
    }

    #[test]
    fn marks_of_stairs_that_end_before_the_nearest_floor_are_none() {
        assert!(!warns_that_no_stairs_are_marked(&Config::default()));
        let mut config = level();
        assert!(!warns_that_no_stairs_are_marked(&config));
        config.map.drop_range_m = 2.0;
        assert!(warns_that_no_stairs_are_marked(&config));
    }

    fn warns_that_no_stairs_are_marked(config: &Config) -> bool {
        let text = View::new(config).sentences().join("\n");
        text.contains("no stairs down are marked in the map")
    }

    #[test]
    fn a_camera_that_looks_down_needs_no_advice_and_one_that_looks_up_sees_no_floor() {
        let mut config = Config::default();
        config.camera.pitch_down_deg = 30.0;
        let down = View::new(&config).sentences();
        assert!(down.len() == 1 && down[0].contains("from 0.75 m"), "{down:?}");
        config.camera.pitch_down_deg = -20.0;
        assert!(View::new(&config).sentences()[0].contains("sees no floor"));
    }
}
