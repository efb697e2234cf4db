//! Points that were followed from one frame to a later one.

use anyhow::Result;
use hal::{CameraModel, ImageView, Pose2, wrap_angle};
use runtime::perception::flow::{DenseFlow, FlowPreset};
use runtime::recording::RgbImage;

use super::klt::{Gray, corners, follow};

/// A pair ends when the robot has driven or rotated this far: far enough for parallax, near enough to find every point again.
const DISTANCE_M: f64 = 0.3;
pub(super) const ROTATION_RAD: f64 = 0.06;
/// An arc needs a longer rotation to show parallax.
pub(super) const ARC_RAD: f64 = 0.12;
/// A robot that drove less than this rotated on the spot, metres.
pub(super) const ON_THE_SPOT_M: f64 = 0.005;
/// A pair that lasts longer includes a stop, and begins again, seconds.
const LONGEST_S: f64 = 2.0;
/// One point is followed in each square of this side, pixels.
const CELL_PX: usize = 16;
/// A point that is followed there and back must come back within this distance, pixels.
const BACK_PX: f32 = 0.3;
/// Pairs with fewer points are left out.
const LEAST_MATCHES: usize = 20;

/// The same point in both frames of a pair, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Match {
    pub from: [f64; 2],
    pub to: [f64; 2],
}

/// Two frames with the points that both show.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FramePair {
    /// Stamps of the frames, seconds.
    pub from_s: f64,
    pub to_s: f64,
    pub matches: Vec<Match>,
}

/// A frame that later ones are compared with.
struct Kept {
    time_s: f64,
    odom: Pose2,
    image: RgbImage,
}

/// Compares each frame with one that was taken a little earlier from another place.
pub(super) struct FrameMatcher {
    flow: DenseFlow,
    kept: Option<Kept>,
    pub pairs: Vec<FramePair>,
}

impl FrameMatcher {
    /// A matcher for frames of `camera`.
    ///
    /// # Errors
    /// A camera that is too small for optical flow.
    pub fn new(camera: &CameraModel) -> Result<Self> {
        let flow = DenseFlow::new(FlowPreset::Fast, camera.width, camera.height)?;
        Ok(Self { flow, kept: None, pairs: Vec::new() })
    }

    fn compare(&mut self, kept: &Kept, time_s: f64, frame: &RgbImage) -> Result<()> {
        let RgbImage { width, height, .. } = *frame;
        let from = ImageView::rgb8(width, height, &kept.image.rgb)?;
        let to = ImageView::rgb8(width, height, &frame.rgb)?;
        let flow = self.flow.flow(from, to)?;
        let [from, to] = [&kept.image.rgb, &frame.rgb].map(|rgb| Gray::of_rgb(width, height, rgb));
        let mut matches = Vec::new();
        for [x, y] in corners(&from, CELL_PX) {
            let [dx, dy] = flow.values()[y as usize * width + x as usize];
            matches.extend(there_and_back(&from, &to, [x, y], [dx, dy]));
        }
        if matches.len() >= LEAST_MATCHES {
            self.pairs.push(FramePair { from_s: kept.time_s, to_s: time_s, matches });
        }
        Ok(())
    }
}

/// Follows a point, and its nearest whole pixel back.
fn there_and_back(from: &Gray, to: &Gray, at: [i32; 2], flow: [f32; 2]) -> Option<Match> {
    let begin = at.map(|coordinate| coordinate as f32);
    let there = follow(from, to, at, [begin[0] + flow[0], begin[1] + flow[1]])?;
    let whole = there.map(f32::round);
    let moved = [there[0] - begin[0], there[1] - begin[1]];
    let guess = [whole[0] - moved[0], whole[1] - moved[1]];
    let back = follow(to, from, whole.map(|coordinate| coordinate as i32), guess)?;
    let off = [back[0] + moved[0] - whole[0], back[1] + moved[1] - whole[1]];
    let is_same = off[0].hypot(off[1]) < BACK_PX;
    is_same.then(|| Match { from: begin.map(f64::from), to: there.map(f64::from) })
}

impl FrameMatcher {
    /// Takes the next frame, its time in seconds, and the pose by the wheels at that time.
    ///
    /// # Errors
    /// A frame of another size than the camera's.
    pub fn see(&mut self, time_s: f64, odom: &Pose2, frame: &RgbImage) -> Result<()> {
        let Some(kept) = self.kept.take() else {
            self.kept = Some(Kept { time_s, odom: *odom, image: frame.clone() });
            return Ok(());
        };
        let distance_m = kept.odom.distance_m(odom);
        let rotation_rad = wrap_angle(odom.yaw_rad - kept.odom.yaw_rad).abs();
        let is_arc = distance_m >= ON_THE_SPOT_M;
        let least_rad = if is_arc { ARC_RAD } else { ROTATION_RAD };
        let is_far = distance_m >= DISTANCE_M || rotation_rad >= least_rad;
        if is_far && time_s - kept.time_s <= LONGEST_S {
            self.compare(&kept, time_s, frame)?;
        }
        let ends = is_far || time_s - kept.time_s > LONGEST_S;
        self.kept = if ends {
            Some(Kept { time_s, odom: *odom, image: frame.clone() })
        } else {
            Some(kept)
        };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 96;

    /// Squares of random brightness, seen by a camera that has panned by `shift` pixels.
    fn squares(shift: usize) -> RgbImage {
        let brightness = |index: usize| {
            let square = ((index % WIDTH + shift) / 6 + 977 * (index / WIDTH / 6)) as u64 + 1;
            (square.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8
        };
        let rgb = (0..WIDTH * HEIGHT).flat_map(|index| [brightness(index); 3]).collect();
        RgbImage { width: WIDTH, height: HEIGHT, rgb }
    }

    /// The times between which points were followed, for frames at these poses, 0.1 s apart.
    fn pairs(poses: impl IntoIterator<Item = Pose2>) -> Vec<[f64; 2]> {
        let camera = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
        let mut matcher = FrameMatcher::new(&camera).unwrap();
        for (index, pose) in poses.into_iter().enumerate() {
            matcher.see(0.1 * index as f64, &pose, &squares(index)).unwrap();
        }
        matcher.pairs.iter().map(|pair| [pair.from_s, pair.to_s]).collect()
    }

    /// Lengths of the pairs in frames.
    fn lengths(pairs: &[[f64; 2]]) -> Vec<i64> {
        pairs.iter().map(|[from_s, to_s]| ((to_s - from_s) / 0.1).round() as i64).collect()
    }

    #[test]
    fn a_pair_on_a_straight_line_is_0_3_m_long() {
        let line = pairs((0..20).map(|index| Pose2::new(0.0501 * f64::from(index), 0.0, 0.0)));
        assert_eq!(lengths(&line), [6, 6, 6]);
    }

    #[test]
    fn a_pair_of_a_rotation_on_the_spot_is_half_as_long_as_that_of_an_arc() {
        let spot = pairs((0..25).map(|index| Pose2::new(0.0, 0.0, 0.0201 * f64::from(index))));
        assert_eq!(lengths(&spot), [3; 8]);
        let arc = pairs((0..25).map(|index| {
            let index = f64::from(index);
            Pose2::new(0.01 * index, 0.0, 0.0201 * index)
        }));
        assert_eq!(lengths(&arc), [6; 4]);
    }

    #[test]
    fn a_pair_does_not_last_over_a_stop() {
        let stops = (0..40).map(|index| match index {
            0..4 => Pose2::new(0.0501 * f64::from(index), 0.0, 0.0),
            4..30 => Pose2::new(0.0501 * 4.0, 0.0, 0.0),
            _ => Pose2::new(0.0501 * f64::from(index - 25), 0.0, 0.0),
        });
        let all = pairs(stops);
        assert!(all.iter().all(|[from_s, to_s]| to_s - from_s <= LONGEST_S), "{all:?}");
        assert!(all.iter().all(|[from_s, _]| *from_s >= 2.0), "{all:?}");
        assert!(!all.is_empty());
    }

    #[test]
    fn points_are_followed_to_where_the_image_moved() {
        let camera = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
        let mut matcher = FrameMatcher::new(&camera).unwrap();
        matcher.see(0.0, &Pose2::IDENTITY, &squares(0)).unwrap();
        matcher.see(0.1, &Pose2::new(0.4, 0.0, 0.0), &squares(3)).unwrap();
        let [pair] = matcher.pairs.as_slice() else { panic!("{}", matcher.pairs.len()) };
        for Match { from, to } in &pair.matches {
            let off = [to[0] - from[0] + 3.0, to[1] - from[1]];
            assert!(off[0].hypot(off[1]) < 0.1, "{from:?} {to:?}");
        }
    }
}
