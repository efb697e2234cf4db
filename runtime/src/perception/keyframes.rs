//! Which earlier pictures to compare with: those that promise parallax and still see the same things.

use hal::{CameraModel, Pose3};
use nalgebra::{Point3, Vector3};

use super::{CoarseConfig, census::CensusImage, sweep::MAX_REFERENCES};
use crate::snapshot::{SnapshotError, State};

/// An earlier picture and where it was taken.
#[derive(Debug, Clone)]
pub struct Keyframe {
    /// `t_odom_camera`.
    pub pose: Pose3,
    /// The picture.
    pub census: CensusImage,
}

/// A ring of earlier pictures, oldest first.
#[derive(Debug, Default)]
pub struct Keyframes {
    ring: Vec<Keyframe>,
    spare: Vec<CensusImage>,
    promises: Vec<Option<Promise>>,
}

/// What references are wanted for.
#[derive(Debug, Clone, Copy)]
pub struct Wanted {
    /// Depth of the scene, metres.
    pub depth_m: f64,
    /// What rotations jitter by, radians.
    pub jitter_rad: f64,
}

/// What an earlier picture promises.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Promise {
    /// Mean parallax at the assumed depth, pixels of `camera`.
    pub parallax_px: f64,
    /// Share of the picture that the earlier one sees too.
    pub overlap: f64,
}

impl Keyframes {
    /// Forgets everything, keeps the memory.
    pub fn forget(&mut self) {
        self.spare.extend(self.ring.drain(..).map(|keyframe| keyframe.census));
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.ring.is_empty()
    }

    /// All, oldest first.
    pub fn all(&self) -> &[Keyframe] {
        &self.ring
    }

    /// Keeps `census` if the camera has moved on since the last keyframe; leaves reusable memory in its place.
    pub fn offer(&mut self, pose: &Pose3, census: &mut CensusImage, config: &CoarseConfig) {
        if let Some(last) = self.ring.last() {
            let step = last.pose.inverse() * pose;
            let moved = step.translation.vector.norm() >= config.keyframe_step_m;
            if !moved && step.rotation.angle() < config.keyframe_turn_rad {
                return;
            }
        }
        if self.ring.len() >= config.keyframes {
            self.spare.push(self.ring.remove(0).census);
        }
        let mut kept = std::mem::replace(census, self.spare.pop().unwrap_or_default());
        census.take_scratch(&mut kept);
        self.ring.push(Keyframe { pose: *pose, census: kept });
    }

    /// The references for a picture at `pose`: for every wanted parallax the keyframe that comes nearest to it. Nearest
    /// parallax first, no keyframe twice.
    pub fn choose(
        &mut self,
        pose: &Pose3,
        camera: &CameraModel,
        wanted: Wanted,
        config: &CoarseConfig,
    ) -> [Option<usize>; MAX_REFERENCES] {
        let Self { ring, promises, .. } = self;
        promises.clear();
        promises.extend(
            ring.iter().map(|keyframe| promise_within(keyframe, pose, camera, wanted, config)),
        );
        let mut chosen = [None; MAX_REFERENCES];
        for (place, wanted) in config.parallax_px.iter().take(MAX_REFERENCES).enumerate() {
            let cost = |promise: &Promise| (promise.parallax_px / wanted).ln().abs();
            let best = promises
                .iter()
                .enumerate()
                .filter_map(|(index, promise)| promise.as_ref().map(|p| (index, cost(p))))
                // The newest of equals: it shares the most with this picture.
                .min_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)))
                .map(|(index, _)| index);
            if !chosen.contains(&best) {
                chosen[place] = best;
            }
        }
        chosen
    }
}

impl State for Keyframes {
    fn write(&self, to: &mut Vec<u8>) {
        self.ring.len().write(to);
        for keyframe in &self.ring {
            keyframe.pose.write(to);
            keyframe.census.write(to);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let mut count = 0_usize;
        count.read(from)?;
        self.forget();
        for _ in 0..count {
            let mut keyframe =
                Keyframe { pose: Pose3::identity(), census: self.spare.pop().unwrap_or_default() };
            keyframe.pose.read(from)?;
            keyframe.census.read(from)?;
            self.ring.push(keyframe);
        }
        Ok(())
    }
}

fn promise_within(
    keyframe: &Keyframe,
    pose: &Pose3,
    camera: &CameraModel,
    Wanted { depth_m, jitter_rad }: Wanted,
    config: &CoarseConfig,
) -> Option<Promise> {
    let t_reference_camera = keyframe.pose.inverse() * pose;
    let baseline_m = t_reference_camera.translation.vector.norm();
    if !(config.min_baseline_m..=config.max_baseline_m).contains(&baseline_m) {
        return None;
    }
    let promise = promise(&t_reference_camera, camera, depth_m);
    let error_rad = config.turn_error_floor_rad.max(jitter_rad)
        + config.turn_error * t_reference_camera.rotation.angle();
    let needed_px = (config.parallax_over_error * error_rad * camera.fx).max(1.0);
    (promise.overlap >= config.min_overlap && promise.parallax_px >= needed_px).then_some(promise)
}

/// What a reference promises for a scene at `depth_m`, over a grid of 8x4 pixels.
#[must_use]
pub fn promise(t_reference_camera: &Pose3, camera: &CameraModel, depth_m: f64) -> Promise {
    let (mut seen, mut total, mut parallax_px) = (0_u32, 0_u32, 0.0);
    for row in 0..4 {
        for column in 0..8 {
            total += 1;
            let u = (f64::from(column) + 0.5) / 8.0 * camera.width as f64 - 0.5;
            let v = (f64::from(row) + 0.5) / 4.0 * camera.height as f64 - 0.5;
            let turned: Vector3<f64> = t_reference_camera.rotation * camera.ray(u, v);
            let moved = t_reference_camera * Point3::from(camera.ray(u, v) * depth_m);
            let (Some(far), Some(near)) =
                (camera.project(&Point3::from(turned)), camera.project(&moved))
            else {
                continue;
            };
            let inside = |(u, v): (f64, f64)| {
                u >= 0.0
                    && v >= 0.0
                    && u <= camera.width as f64 - 1.0
                    && v <= camera.height as f64 - 1.0
            };
            if inside(near) {
                seen += 1;
                parallax_px += (far.0 - near.0).hypot(far.1 - near.1);
            }
        }
    }
    Promise {
        parallax_px: parallax_px / f64::from(seen.max(1)),
        overlap: f64::from(seen) / f64::from(total),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};

    fn at(x_m: f64, yaw_rad: f64) -> Pose3 {
        Pose3::from_parts(
            Translation3::new(x_m, 0.0, 0.0),
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad),
        )
    }

    const WANTED: Wanted = Wanted { depth_m: 2.0, jitter_rad: 0.0 };

    fn camera() -> CameraModel {
        CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
    }

    #[test]
    fn a_sideways_step_promises_f_b_over_z() {
        let promise = promise(&at(0.1, 0.0), &camera(), 2.0);
        assert!((promise.parallax_px - 160.0 * 0.1 / 2.0).abs() < 1e-9);
        assert!(promise.overlap > 0.95);
    }

    #[test]
    fn a_turn_promises_no_parallax_and_loses_overlap() {
        let promise = promise(&at(0.0, 0.8), &camera(), 2.0);
        assert!(promise.parallax_px < 1e-9 && promise.overlap < 0.6);
    }

    #[test]
    fn references_are_chosen_by_parallax_and_never_twice() {
        let mut keyframes = Keyframes::default();
        let config = CoarseConfig { parallax_px: vec![6.0, 12.0, 24.0], ..CoarseConfig::default() };
        for i in 0..20 {
            keyframes.offer(&at(0.05 * f64::from(i), 0.0), &mut CensusImage::default(), &config);
        }
        let chosen =
            keyframes.choose(&at(1.0, 0.0), &camera(), WANTED, &config).map(Option::unwrap);
        let parallax = |i: &usize| 80.0 * (1.0 - 0.05 * *i as f64);
        for (index, wanted) in chosen.iter().zip(&config.parallax_px) {
            assert!((parallax(index) - wanted).abs() <= 2.5);
        }
    }

    #[test]
    fn what_jitter_alone_could_fake_is_no_reference() {
        let mut keyframes = Keyframes::default();
        let config = CoarseConfig::default();
        keyframes.offer(&at(0.0, 0.0), &mut CensusImage::default(), &config);
        // 160 px * 0.03 m / 2 m = 2.4 px; one mrad is 0.16 px.
        let chosen = |keyframes: &mut Keyframes, jitter_rad| {
            keyframes.choose(&at(0.03, 0.0), &camera(), Wanted { jitter_rad, ..WANTED }, &config)[0]
        };
        assert_eq!(chosen(&mut keyframes, 0.002), Some(0));
        assert_eq!(chosen(&mut keyframes, 0.004), None);
    }

    #[test]
    fn standing_still_offers_one_keyframe_and_chooses_none() {
        let mut keyframes = Keyframes::default();
        let config = CoarseConfig::default();
        for _ in 0..5 {
            keyframes.offer(&at(0.0, 0.0), &mut CensusImage::default(), &config);
        }
        assert_eq!(keyframes.all().len(), 1);
        assert_eq!(
            keyframes.choose(&at(0.0, 0.0), &camera(), WANTED, &config),
            [None; MAX_REFERENCES]
        );
        assert_eq!(
            keyframes.choose(&at(0.001, 0.1), &camera(), WANTED, &config),
            [None; MAX_REFERENCES]
        );
    }
}
