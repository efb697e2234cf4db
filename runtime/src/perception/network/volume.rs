//! Cost volume: the matching cost of the current frame with earlier frames over planes of depth, as an input of networks
//! (ManyDepth, Watson et al. 2021, section 3.1, with colours instead of features and with metric poses, so that the planes are
//! fixed).
//!
//! All computation is at a quarter of the image's size; a quarter-size pixel is the mean of 4x4 pixels, in 0..1. Plane i of n
//! lies at inverse depth `1/max + (1/min - 1/max) i / (n - 1)`: the last plane is the nearest. The value of a cell is
//! |current - earlier|, averaged over red, green, blue and the earlier frames that see the point. The earlier frame is sampled
//! bilinearly and scaled to the mean brightness of the current one (automatic exposure). Where no earlier frame sees the
//! point of a plane, the cell takes the largest cost of its pixel. Where no earlier frame sees any plane of a pixel, and
//! without an earlier frame, the cost is 0 everywhere: no evidence.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix3, Vector3};

use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Factor by which the volume's rows and columns are fewer than the image's.
pub(super) const REDUCTION: usize = 4;
/// Maximum number of earlier frames that one frame is compared with.
const REFERENCES: usize = 2;
/// Maximum number of keyframes.
const KEYFRAMES: usize = 8;
/// Distance from one keyframe to the next, metres: 8 of them reach half a metre back.
const KEYFRAME_STEP_M: f64 = 0.06;
/// Rotation from one keyframe to the next, radians.
const KEYFRAME_ROTATION_RAD: f64 = 0.1;
/// Desired baseline of a reference, metres (DeepVideoMVS, Duzceker et al. 2021, its optimal translation).
const BASELINE_M: f64 = 0.15;
/// Allowed baselines, metres: below, parallax is too small; above, the images overlap too little.
const BASELINES_M: (f64, f64) = (0.03, 0.6);
/// Maximum rotation of a reference, radians: beyond, the images overlap too little.
const MAX_ROTATION_RAD: f64 = 0.6;
/// Marks a cell that no earlier frame sees. Costs are 0 or more.
const UNSEEN: f32 = -1.0;

/// A quarter-size image: red, green, blue in 0..1, and 0, so that a pixel is one vector register.
#[derive(Debug, Clone, Default)]
struct SmallImage {
    pixels: Vec<[f32; 4]>,
    /// Mean over all pixels and colours.
    brightness: f32,
}

#[derive(Debug, Clone)]
struct Keyframe {
    /// Pose of the frame, `t_odom_camera`.
    pose: Pose3,
    image: SmallImage,
}

/// Computes cost volumes and keeps the keyframes that they need. Allocates nothing after construction.
#[derive(Debug)]
pub(super) struct CostVolume {
    /// The camera at a quarter of the image's size.
    camera: CameraModel,
    inverse_depth: Vec<f32>,
    image: SmallImage,
    /// The keyframes, oldest first.
    keyframes: Vec<Keyframe>,
    spare: Vec<SmallImage>,
    largest: Vec<f32>,
}

impl CostVolume {
    /// `camera`'s width and height are multiples of 4.
    pub fn new(camera: &CameraModel, planes: usize, (min_m, max_m): (f32, f32)) -> Self {
        let camera = camera.resized(camera.width / REDUCTION, camera.height / REDUCTION);
        let pixels = camera.width * camera.height;
        let empty = SmallImage { pixels: vec![[0.0; 4]; pixels], brightness: 0.0 };
        let far = 1.0 / max_m;
        let span = 1.0 / min_m - 1.0 / max_m;
        let steps = (planes.max(2) - 1) as f32;
        Self {
            camera,
            inverse_depth: (0..planes).map(|plane| far + span * plane as f32 / steps).collect(),
            image: empty.clone(),
            keyframes: Vec::with_capacity(KEYFRAMES),
            spare: vec![empty; KEYFRAMES],
            largest: vec![0.0; pixels],
        }
    }

    /// Computes the volume `[planes, rows, columns]` of one RGB8 frame, then adds the frame to the keyframes if it is far
    /// enough from the last one.
    pub fn compute(&mut self, rgb: &[u8], t_odom_camera: &Pose3, volume: &mut [f32]) {
        shrink(rgb, self.camera.width, &mut self.image);
        let references = choose(&self.keyframes, t_odom_camera);
        volume.fill(if references[0].is_some() { UNSEEN } else { 0.0 });
        for keyframe in
            references.into_iter().flatten().filter_map(|index| self.keyframes.get(index))
        {
            let warp = Warp::new(&self.camera, &(keyframe.pose.inverse() * t_odom_camera));
            compare(&self.camera, &self.image, &keyframe.image, &warp, &self.inverse_depth, volume);
        }
        fill_unseen(volume, &mut self.largest);
        self.add_keyframe(t_odom_camera);
    }

    fn add_keyframe(&mut self, pose: &Pose3) {
        if let Some(last) = self.keyframes.last() {
            let step = last.pose.inverse() * pose;
            if step.translation.vector.norm() < KEYFRAME_STEP_M
                && step.rotation.angle() < KEYFRAME_ROTATION_RAD
            {
                return;
            }
        }
        if self.keyframes.len() == KEYFRAMES {
            self.spare.push(self.keyframes.remove(0).image);
        }
        let image = std::mem::replace(&mut self.image, self.spare.pop().unwrap_or_default());
        self.keyframes.push(Keyframe { pose: *pose, image });
    }
}

impl State for CostVolume {
    fn write(&self, to: &mut Vec<u8>) {
        self.keyframes.len().write(to);
        for Keyframe { pose, image } in &self.keyframes {
            (*pose, image.brightness).write(to);
            write_bulk(&image.pixels, to);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let mut count = 0_usize;
        count.read(from)?;
        self.spare.extend(self.keyframes.drain(..).map(|keyframe| keyframe.image));
        let pixels = self.camera.width * self.camera.height;
        for _ in 0..count.min(KEYFRAMES) {
            let mut pose = (Pose3::identity(), 0.0);
            pose.read(from)?;
            let mut image = self.spare.pop().unwrap_or_default();
            read_bulk(&mut image.pixels, pixels, from)?;
            image.brightness = pose.1;
            self.keyframes.push(Keyframe { pose: pose.0, image });
        }
        let sound = self.keyframes.iter().all(|keyframe| keyframe.image.pixels.len() == pixels);
        if sound {
            Ok(())
        } else {
            Err(SnapshotError::Damaged("keyframes of another image size".to_owned()))
        }
    }
}

/// Computes the means of 4x4 pixels.
fn shrink(rgb: &[u8], width: usize, small: &mut SmallImage) {
    const SCALE: f32 = 1.0 / (255 * REDUCTION * REDUCTION) as f32;
    let stride = 3 * REDUCTION * width;
    let mut total = 0_u64;
    for (rows, out) in
        rgb.chunks_exact(stride * REDUCTION).zip(small.pixels.chunks_exact_mut(width))
    {
        for (u, out) in out.iter_mut().enumerate() {
            let mut sum = [0_u32; 3];
            for row in rows.chunks_exact(stride) {
                for pixel in row[3 * REDUCTION * u..][..3 * REDUCTION].chunks_exact(3) {
                    for (sum, &byte) in sum.iter_mut().zip(pixel) {
                        *sum += u32::from(byte);
                    }
                }
            }
            total += u64::from(sum[0] + sum[1] + sum[2]);
            *out = [sum[0] as f32 * SCALE, sum[1] as f32 * SCALE, sum[2] as f32 * SCALE, 0.0];
        }
    }
    small.brightness = total as f32 * SCALE / (3 * small.pixels.len()) as f32;
}

/// Selects the keyframes whose baseline comes nearest to [`BASELINE_M`]; of equally good ones, the newest.
fn choose(keyframes: &[Keyframe], pose: &Pose3) -> [Option<usize>; REFERENCES] {
    let mut best = [(f64::INFINITY, None); REFERENCES];
    for (index, keyframe) in keyframes.iter().enumerate().rev() {
        let step = keyframe.pose.inverse() * pose;
        let baseline = step.translation.vector.norm();
        let rotation = step.rotation.angle();
        if baseline < BASELINES_M.0 || baseline > BASELINES_M.1 || rotation > MAX_ROTATION_RAD {
            continue;
        }
        let cost = (baseline / BASELINE_M).ln().abs() + rotation / MAX_ROTATION_RAD;
        if cost < best[0].0 {
            best = [(cost, Some(index)), best[0]];
        } else if cost < best[1].0 {
            best[1] = (cost, Some(index));
        }
    }
    best.map(|(_, index)| index)
}

/// Maps pixel (u, v) at inverse depth w to `rotation (u, v, 1) + w translation` in the earlier frame, in homogeneous pixels.
struct Warp {
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
}

impl Warp {
    fn new(camera: &CameraModel, t_earlier_camera: &Pose3) -> Self {
        let k = Matrix3::new(camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0);
        let k_inverse = Matrix3::new(
            1.0 / camera.fx,
            0.0,
            -camera.cx / camera.fx,
            0.0,
            1.0 / camera.fy,
            -camera.cy / camera.fy,
            0.0,
            0.0,
            1.0,
        );
        let rotation = k * t_earlier_camera.rotation.to_rotation_matrix().matrix() * k_inverse;
        let translation = k * t_earlier_camera.translation.vector;
        Self { rotation: rotation.cast(), translation: translation.cast() }
    }
}

/// Adds the costs of one earlier frame to the volume: cells that no other frame has seen yet take its cost, others the mean of
/// both.
fn compare(
    camera: &CameraModel,
    this: &SmallImage,
    earlier: &SmallImage,
    warp: &Warp,
    inverse_depth: &[f32],
    volume: &mut [f32],
) {
    let width = camera.width;
    let height = camera.height;
    let right = (width - 1) as f32;
    let bottom = (height - 1) as f32;
    let gain = if earlier.brightness > 0.0 { this.brightness / earlier.brightness } else { 1.0 };
    for (plane, &inverse_depth) in volume.chunks_exact_mut(width * height).zip(inverse_depth) {
        for (v, (row, cells)) in
            this.pixels.chunks_exact(width).zip(plane.chunks_exact_mut(width)).enumerate()
        {
            let start =
                warp.rotation * Vector3::new(0.0, v as f32, 1.0) + warp.translation * inverse_depth;
            let step = warp.rotation.column(0);
            for (u, (colour, cell)) in row.iter().zip(cells).enumerate() {
                let u = u as f32;
                let z = 1.0 / (start.z + u * step.z);
                let x = (start.x + u * step.x) * z;
                let y = (start.y + u * step.y) * z;
                // NaN and points behind the camera are outside the image.
                if z > 0.0 && x >= 0.0 && x <= right && y >= 0.0 && y <= bottom {
                    let cost = difference(colour, &bilinear(&earlier.pixels, width, x, y), gain);
                    *cell = if *cell < 0.0 { cost } else { 0.5 * (*cell + cost) };
                }
            }
        }
    }
}

/// The colour at (x, y), which lies inside the image.
fn bilinear(pixels: &[[f32; 4]], width: usize, x: f32, y: f32) -> [f32; 4] {
    let left = (x as usize).min(width - 2);
    let top = (y as usize).min(pixels.len() / width - 2);
    let fx = x - left as f32;
    let fy = y - top as f32;
    let at = top * width + left;
    // Four values per pixel, so that each pixel is one load of a vector register.
    let upper = mix(pixels[at], pixels[at + 1], fx);
    let lower = mix(pixels[at + width], pixels[at + width + 1], fx);
    mix(upper, lower, fy)
}

fn mix(a: [f32; 4], b: [f32; 4], share: f32) -> [f32; 4] {
    [0, 1, 2, 3].map(|c| a[c] + share * (b[c] - a[c]))
}

fn difference(this: &[f32; 4], earlier: &[f32; 4], gain: f32) -> f32 {
    let d = [0, 1, 2, 3].map(|c| (this[c] - gain * earlier[c]).abs());
    ((d[0] + d[1]) + (d[2] + d[3])) * (1.0 / 3.0)
}

/// Cells that no earlier frame sees take the largest cost of their pixel, 0 where no plane is seen.
fn fill_unseen(volume: &mut [f32], largest: &mut [f32]) {
    largest.fill(0.0);
    for plane in volume.chunks_exact(largest.len()) {
        for (largest, cell) in largest.iter_mut().zip(plane) {
            *largest = largest.max(*cell);
        }
    }
    for plane in volume.chunks_exact_mut(largest.len()) {
        for (largest, cell) in largest.iter().zip(plane) {
            *cell = if *cell < 0.0 { *largest } else { *cell };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    const SIZE: (usize, usize) = (160, 96);
    const PLANES: usize = 24;
    const RANGE_M: (f32, f32) = (0.5, 10.0);

    fn camera() -> CameraModel {
        CameraModel::pinhole(SIZE.0, SIZE.1, FRAC_PI_2)
    }

    /// A wall across the optical axis at z = `depth_m`, seen from a camera that has moved by (x, y, z).
    fn wall(depth_m: f64, at: [f64; 3], gain: f64) -> Vec<u8> {
        let camera = camera();
        let colours = (0..SIZE.0 * SIZE.1).flat_map(|index| {
            let ray =
                camera.ray((index % SIZE.0) as f64, (index / SIZE.0) as f64) * (depth_m - at[2]);
            let x = (ray.x + at[0]) / depth_m;
            let y = (ray.y + at[1]) / depth_m;
            [7.0, 9.0, 11.0].map(|f| {
                (gain * (100.0 + 50.0 * (f * x).sin() + 40.0 * (f * 1.3 * y).cos())).round() as u8
            })
        });
        colours.collect()
    }

    fn volume() -> CostVolume {
        CostVolume::new(&camera(), PLANES, RANGE_M)
    }

    fn compute(volume: &mut CostVolume, image: &[u8], at: [f64; 3]) -> Vec<f32> {
        let mut out = vec![9.0; PLANES * SIZE.0 * SIZE.1 / REDUCTION / REDUCTION];
        volume.compute(image, &Pose3::translation(at[0], at[1], at[2]), &mut out);
        out
    }

    /// Plane of least cost of every pixel.
    fn winners(volume: &[f32]) -> Vec<usize> {
        let pixels = volume.len() / PLANES;
        (0..pixels)
            .map(|pixel| {
                let column: Vec<f32> = volume.iter().copied().skip(pixel).step_by(pixels).collect();
                (0..PLANES).min_by(|a, b| column[*a].total_cmp(&column[*b])).unwrap()
            })
            .collect()
    }

    #[test]
    fn the_cost_of_a_wall_is_least_at_its_own_plane() {
        for (plane, gain) in [(3, 1.0), (6, 1.0), (11, 1.0), (6, 1.15)] {
            let mut volume = volume();
            let depth_m = f64::from(1.0 / volume.inverse_depth[plane]);
            compute(&mut volume, &wall(depth_m, [-0.15, 0.0, 0.05], gain), [-0.15, 0.0, 0.05]);
            let costs = compute(&mut volume, &wall(depth_m, [0.0; 3], 1.0), [0.0; 3]);
            let winners = winners(&costs);
            // The right, upper and lower edge were not in view before.
            let seen = winners
                .iter()
                .enumerate()
                .filter(|(pixel, _)| pixel % 40 < 28 && (40..920).contains(pixel));
            let right = seen.clone().filter(|(_, winner)| winner.abs_diff(plane) <= 1).count();
            assert!(right * 100 >= seen.count() * 95, "plane {plane}, gain {gain}: {winners:?}");
        }
    }

    #[test]
    fn without_an_earlier_image_or_a_baseline_there_is_no_evidence() {
        let mut volume = volume();
        let image = wall(2.0, [0.0; 3], 1.0);
        for at in [[0.0; 3], [0.01, 0.0, 0.0], [5.0, 0.0, 0.0]] {
            assert!(compute(&mut volume, &image, at).iter().all(|cost| *cost == 0.0), "{at:?}");
        }
    }

    #[test]
    fn a_cell_that_was_never_in_view_takes_the_largest_cost_of_its_pixel() {
        let mut volume = volume();
        compute(&mut volume, &wall(2.0, [-0.2, 0.0, 0.0], 1.0), [-0.2, 0.0, 0.0]);
        let costs = compute(&mut volume, &wall(2.0, [0.0; 3], 1.0), [0.0; 3]);
        let pixels = costs.len() / PLANES;
        let [near_edge, edge] = [36, 39].map(|u| {
            (0..PLANES).map(|plane| costs[plane * pixels + 12 * 40 + u]).collect::<Vec<_>>()
        });
        // Near the right edge only far points were in view, at the edge none.
        let largest = near_edge.iter().copied().fold(0.0, f32::max);
        assert_eq!(near_edge[PLANES - 1].to_bits(), largest.to_bits(), "{near_edge:?}");
        assert!(near_edge.iter().any(|cost| *cost < largest));
        assert_eq!(edge, [0.0; PLANES]);
    }

    #[test]
    fn keyframes_are_limited_and_reach_far_enough_back() {
        let mut volume = volume();
        let image = wall(2.0, [0.0; 3], 1.0);
        for step in 0..100 {
            compute(&mut volume, &image, [0.03 * f64::from(step), 0.0, 0.0]);
        }
        assert_eq!(volume.keyframes.len(), KEYFRAMES);
        let chosen = choose(&volume.keyframes, &Pose3::translation(0.03 * 99.0, 0.0, 0.0));
        for index in chosen {
            let baseline = 0.03 * 99.0 - volume.keyframes[index.unwrap()].pose.translation.x;
            assert!((0.08..0.25).contains(&baseline), "{baseline}");
        }
    }

    proptest! {
        #[test]
        fn costs_are_between_0_and_1_wherever_the_camera_goes(
            bytes in proptest::collection::vec(any::<u8>(), 3 * SIZE.0), x in -0.4..0.4f64, z in -0.4..0.4f64, yaw in -0.5..0.5f64,
        ) {
            let mut volume = volume();
            let image = bytes.repeat(SIZE.1);
            compute(&mut volume, &image, [0.0; 3]);
            let pose = Pose3::new(Vector3::new(x, 0.02, z), Vector3::new(0.0, yaw, 0.0));
            let mut costs = vec![9.0; PLANES * 40 * 24];
            volume.compute(&image, &pose, &mut costs);
            prop_assert!(costs.iter().all(|cost| (0.0..=1.0 + 1e-5).contains(cost)));
        }
    }
}
