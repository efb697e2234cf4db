//! Keyframes, and the selection of references by predicted parallax and overlap.

use hal::{CameraModel, Pose3};
use nalgebra::{Point3, Vector3};

use super::{CoarseConfig, census::CensusImage, sweep::MAX_REFERENCES};
use crate::snapshot::{SnapshotError, State};

/// An earlier frame and the pose at which it was taken.
#[derive(Debug, Clone)]
pub struct Keyframe {
    /// Pose of the frame, `t_odom_camera`.
    pub pose: Pose3,
    pub census: CensusImage,
}

/// A ring of earlier frames, oldest first.
#[derive(Debug, Default)]
pub struct Keyframes {
    ring: Vec<Keyframe>,
    spare: Vec<CensusImage>,
    predictions: Vec<Option<Prediction>>,
}

/// What determines whether a keyframe is usable as a reference.
#[derive(Debug, Clone, Copy)]
pub struct Requirements {
    /// Depth of the scene, metres.
    pub depth_m: f64,
    /// Jitter of rotations about each axis, radians.
    pub jitter_rad: f64,
}

/// Predicted parallax and overlap of a keyframe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Prediction {
    /// Mean parallax at the assumed depth, pixels of `camera`.
    pub parallax_px: f64,
    /// Share of the current image that the keyframe sees too.
    pub overlap: f64,
}

impl Keyframes {
    /// Removes all keyframes and keeps their allocations.
    pub fn forget(&mut self) {
        self.spare.extend(self.ring.drain(..).map(|keyframe| keyframe.census));
    }

    pub fn is_empty(&self) -> bool {
        self.ring.is_empty()
    }

    /// All keyframes, oldest first.
    pub fn all(&self) -> &[Keyframe] {
        &self.ring
    }

    /// Adds `census` as a keyframe if the camera has moved far enough since the last one, and leaves reusable memory in its
    /// place.
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

    /// Selects the references for a frame at `pose`: for every parallax of the configuration the keyframe that comes nearest
    /// to it. No keyframe is selected twice.
    pub fn choose(
        &mut self,
        pose: &Pose3,
        camera: &CameraModel,
        requirements: Requirements,
        config: &CoarseConfig,
    ) -> [Option<usize>; MAX_REFERENCES] {
        let Self { ring, predictions, .. } = self;
        predictions.clear();
        predictions.extend(
            ring.iter()
                .map(|keyframe| usable_prediction(keyframe, pose, camera, requirements, config)),
        );
        let mut chosen = [None; MAX_REFERENCES];
        for (place, desired_px) in config.parallax_px.iter().take(MAX_REFERENCES).enumerate() {
            let best = predictions
                .iter()
                .enumerate()
                .filter_map(|(index, prediction)| {
                    let parallax_px = prediction.as_ref()?.parallax_px;
                    Some((index, (parallax_px / desired_px).ln().abs()))
                })
                // Of equally good keyframes the newest is taken: it shares the most with this frame.
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

/// The prediction for a keyframe that satisfies all requirements.
fn usable_prediction(
    keyframe: &Keyframe,
    pose: &Pose3,
    camera: &CameraModel,
    Requirements { depth_m, jitter_rad }: Requirements,
    config: &CoarseConfig,
) -> Option<Prediction> {
    let t_reference_camera = keyframe.pose.inverse() * pose;
    let baseline_m = t_reference_camera.translation.vector.norm();
    if !(config.min_baseline_m..=config.max_baseline_m).contains(&baseline_m) {
        return None;
    }
    let prediction = predict(&t_reference_camera, camera, depth_m);
    let error_rad = config.turn_error_floor_rad.max(jitter_rad)
        + config.turn_error * t_reference_camera.rotation.angle();
    let needed_px = (config.parallax_over_error * error_rad * camera.fx).max(1.0);
    let usable = prediction.overlap >= config.min_overlap && prediction.parallax_px >= needed_px;
    usable.then_some(prediction)
}

/// Predicts parallax and overlap for a scene at `depth_m`, over a grid of 8x4 pixels.
#[must_use]
pub fn predict(t_reference_camera: &Pose3, camera: &CameraModel, depth_m: f64) -> Prediction {
    let mut seen = 0_u32;
    let mut total = 0_u32;
    let mut parallax_px = 0.0;
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
            let columns = 0.0..=camera.width as f64 - 1.0;
            let rows = 0.0..=camera.height as f64 - 1.0;
            if columns.contains(&near.0) && rows.contains(&near.1) {
                seen += 1;
                parallax_px += (far.0 - near.0).hypot(far.1 - near.1);
            }
        }
    }
    Prediction {
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

    const REQUIREMENTS: Requirements = Requirements { depth_m: 2.0, jitter_rad: 0.0 };

    fn camera() -> CameraModel {
        CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
    }

    #[test]
    fn a_sideways_step_has_a_parallax_of_f_b_over_z() {
        let prediction = predict(&at(0.1, 0.0), &camera(), 2.0);
        assert!((prediction.parallax_px - 160.0 * 0.1 / 2.0).abs() < 1e-9);
        assert!(prediction.overlap > 0.95);
    }

    #[test]
    fn a_rotation_has_no_parallax_and_less_overlap() {
        let prediction = predict(&at(0.0, 0.8), &camera(), 2.0);
        assert!(prediction.parallax_px < 1e-9 && prediction.overlap < 0.6);
    }

    #[test]
    fn references_are_selected_by_parallax_and_never_twice() {
        let mut keyframes = Keyframes::default();
        let config = CoarseConfig { parallax_px: vec![6.0, 12.0, 24.0], ..CoarseConfig::default() };
        for i in 0..20 {
            keyframes.offer(&at(0.05 * f64::from(i), 0.0), &mut CensusImage::default(), &config);
        }
        let chosen =
            keyframes.choose(&at(1.0, 0.0), &camera(), REQUIREMENTS, &config).map(Option::unwrap);
        for (index, desired_px) in chosen.iter().zip(&config.parallax_px) {
            let parallax_px = 80.0 * (1.0 - 0.05 * *index as f64);
            assert!((parallax_px - desired_px).abs() <= 2.5);
        }
    }

    #[test]
    fn a_keyframe_whose_parallax_is_within_the_jitter_is_no_reference() {
        let mut keyframes = Keyframes::default();
        let config = CoarseConfig::default();
        keyframes.offer(&at(0.0, 0.0), &mut CensusImage::default(), &config);
        // 160 px * 0.03 m / 2 m = 2.4 px; one mrad is 0.16 px.
        for (jitter_rad, expected) in [(0.002, Some(0)), (0.004, None)] {
            let requirements = Requirements { jitter_rad, ..REQUIREMENTS };
            let chosen = keyframes.choose(&at(0.03, 0.0), &camera(), requirements, &config);
            assert_eq!(chosen[0], expected);
        }
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
            keyframes.choose(&at(0.0, 0.0), &camera(), REQUIREMENTS, &config),
            [None; MAX_REFERENCES]
        );
        assert_eq!(
            keyframes.choose(&at(0.001, 0.1), &camera(), REQUIREMENTS, &config),
            [None; MAX_REFERENCES]
        );
    }
}
