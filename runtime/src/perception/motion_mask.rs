//! Motion mask: finds cells whose image motion no static point could have, at any depth.
//!
//! A static point stays on its epipolar line. Dense flow to the previous frame measures where every point was; a point far
//! off its line has moved, and neither parallax nor memory gives its depth. Motion along the line is not found: it looks like
//! another depth.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::census::CensusImage;
use super::flow::FlowField;
use super::sweep::{CELL, homography, length};

/// Minimum distance of a moving cell from its line, pixels: where there is texture, flow of this preset is seldom wrong by
/// more.
const OFF_PX: f32 = 3.0;
/// Minimum distance as a multiple of the median distance: if most cells are far off their lines, the pose is wrong.
const OFF_OVER_MEDIAN: f32 = 6.0;
/// Half of the side of the square of cells of which most must be off: thin strips are occlusion edges.
const SQUARE: isize = 2;
/// Distance around moving cells that is masked as well, cells, because flow is blurred.
const MARGIN: isize = 2;
/// When more than one part in this many of the image seems to move, the pose is wrong rather than the scene, and nothing is
/// masked.
const MOST: usize = 2;

/// Computes the mask from frame to frame.
#[derive(Debug)]
pub struct MotionMask {
    off_px: Vec<f32>,
    sorted: Vec<f32>,
    off: Vec<bool>,
    moving: Vec<bool>,
}

impl MotionMask {
    pub fn new(width: usize, height: usize) -> Self {
        let cells = (width / CELL) * (height / CELL);
        Self {
            off_px: vec![0.0; cells],
            sorted: Vec::with_capacity(cells),
            off: vec![false; cells],
            moving: vec![false; cells],
        }
    }

    /// Clears the mask: no cell moves.
    pub fn clear(&mut self) {
        self.moving.fill(false);
    }

    /// The result of the last [`update`](Self::update).
    pub fn cells(&self) -> &[bool] {
        &self.moving
    }

    /// Computes for every cell of 4x4 pixels, row-major, whether its content moved since the previous frame, to which
    /// `flow` leads. `camera` has its pixels at the positions of `image.smooth`; no point is nearer than `nearest_m`.
    pub fn update(
        &mut self,
        image: &CensusImage,
        flow: &FlowField,
        t_before_now: &Pose3,
        camera: &CameraModel,
        nearest_m: f64,
    ) -> &[bool] {
        self.moving.fill(false);
        let line = EpipolarSegment::new(t_before_now, camera, nearest_m);
        let columns = image.width / CELL;
        self.off_px.par_chunks_exact_mut(columns).enumerate().for_each(|(row, off_px)| {
            for (column, off_px) in off_px.iter_mut().enumerate() {
                let u = CELL * column + CELL / 2;
                let v = CELL * row + CELL / 2;
                let at = v * image.width + u;
                // Without texture, flow only follows its neighbours.
                let textured = image.descriptors[at] != 0;
                *off_px =
                    if textured { line.off_px(u as f32, v as f32, flow.values()[at]) } else { 0.0 };
            }
        });
        let least = OFF_PX.max(OFF_OVER_MEDIAN * self.median());
        self.off.iter_mut().zip(&self.off_px).for_each(|(off, off_px)| *off = *off_px > least);
        self.gather(columns);
        &self.moving
    }

    fn median(&mut self) -> f32 {
        self.sorted.clear();
        self.sorted.extend(self.off_px.iter().filter(|off_px| **off_px > 0.0));
        let middle = self.sorted.len() / 2;
        if self.sorted.is_empty() {
            0.0
        } else {
            *self.sorted.select_nth_unstable_by(middle, f32::total_cmp).1
        }
    }

    /// Keeps cells that most of their surroundings confirm, and adds a margin.
    fn gather(&mut self, columns: usize) {
        let rows = self.off.len() / columns;
        let enough = ((2 * SQUARE + 1) * (2 * SQUARE + 1)) as usize * 3 / 5;
        for index in 0..self.off.len() {
            let row = index / columns;
            let column = index % columns;
            if self.off[index]
                && square((row, column), (rows, columns), SQUARE)
                    .filter(|near| self.off[*near])
                    .count()
                    >= enough
            {
                square((row, column), (rows, columns), MARGIN)
                    .for_each(|near| self.moving[near] = true);
            }
        }
        if self.moving.iter().filter(|moving| **moving).count() * MOST > self.moving.len() {
            self.moving.fill(false);
        }
    }
}

/// Indices of the cells up to `reach` away from `at` (row, column) in a grid of `size` (rows, columns).
fn square(at: (usize, usize), size: (usize, usize), reach: isize) -> impl Iterator<Item = usize> {
    let columns = size.1;
    span(at.0, size.0, reach)
        .flat_map(move |y| span(at.1, columns, reach).map(move |x| y * columns + x))
}

fn span(at: usize, end: usize, reach: isize) -> std::ops::Range<usize> {
    at.saturating_add_signed(-reach)..(at.saturating_add_signed(reach) + 1).min(end)
}

/// The positions that static points behind a pixel can have in the previous frame.
struct EpipolarSegment {
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
    nearest: f32,
}

impl EpipolarSegment {
    fn new(t_before_now: &Pose3, camera: &CameraModel, nearest_m: f64) -> Self {
        let (rotation, translation) = homography(t_before_now, camera);
        Self { rotation, translation, nearest: (1.0 / nearest_m) as f32 }
    }

    /// Distance between the previous position of the pixel at (u, v), according to its flow, and the positions that a static
    /// point could have had.
    fn off_px(&self, u: f32, v: f32, flow: [f32; 2]) -> f32 {
        let far = self.rotation * Vector3::new(u, v, 1.0);
        let near = far + self.translation * self.nearest;
        // A point behind the previous camera: the line continues to the edge of the image and beyond.
        let near = if near.z > 0.1 * far.z {
            near
        } else {
            far + self.translation * (-0.9 * far.z / self.translation.z)
        };
        let x0 = far.x / far.z;
        let y0 = far.y / far.z;
        let dx = near.x / near.z - x0;
        let dy = near.y / near.z - y0;
        let x = u + flow[0] - x0;
        let y = v + flow[1] - y0;
        let along = ((x * dx + y * dy) / (dx * dx + dy * dy).max(1e-6)).clamp(0.0, 1.0);
        length(x - along * dx, y - along * dy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::frame_motion::FrameMotion;
    use crate::perception::test_scene::{pose, render};
    use hal::{ImageView, PixelFormat};

    const NEAREST_M: f64 = 0.3;

    fn camera() -> CameraModel {
        CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
    }

    /// Adds a block of 64x48 pixels with its own texture, `down` pixels below its first position.
    fn with_block(mut image: Vec<u8>, down: usize) -> Vec<u8> {
        for (y, row) in image.chunks_exact_mut(320).skip(20 + down).take(48).enumerate() {
            for (x, value) in row[120..184].iter_mut().enumerate() {
                let x = x as f64;
                let y = y as f64;
                *value =
                    (128.0 + 60.0 * (0.5 * x + 0.2 * y).sin() * (0.45 * y - 0.15 * x).cos()) as u8;
            }
        }
        image
    }

    struct Finder {
        motion: FrameMotion,
        mask: MotionMask,
        before: Pose3,
    }

    impl Finder {
        fn new() -> Self {
            let motion = FrameMotion::new(320, 96).unwrap();
            Self { motion, mask: MotionMask::new(320, 96), before: Pose3::identity() }
        }

        fn update(&mut self, image: &[u8], at: &Pose3) -> Vec<bool> {
            let mut census = CensusImage::default();
            assert!(census.compute(ImageView::new(320, 96, PixelFormat::Gray8, image).unwrap()));
            let t_before_now = std::mem::replace(&mut self.before, *at).inverse() * at;
            let Some(flow) = self.motion.update(&census) else { return vec![false; 80 * 24] };
            self.mask
                .update(
                    &census,
                    flow,
                    &t_before_now,
                    &camera().cropped(0.5, 0.5, 320, 96),
                    NEAREST_M,
                )
                .to_vec()
        }
    }

    fn count(moving: &[bool]) -> usize {
        moving.iter().filter(|moving| **moving).count()
    }

    #[test]
    fn nothing_is_masked_in_a_static_scene_however_the_camera_moves() {
        let paths: [fn(f64) -> Pose3; 3] = [
            |i| pose([0.03 * i, 0.0, 0.0], 0.0),
            |i| pose([0.0, 0.0, 0.03 * i], 0.0),
            |i| pose([0.01 * i, 0.0, 0.02 * i], 0.03 * i),
        ];
        for path in paths {
            let mut finder = Finder::new();
            for i in 0..6 {
                let at = path(f64::from(i));
                assert_eq!(count(&finder.update(&render(&camera(), &at, 1.0, 0.0), &at)), 0);
            }
        }
    }

    #[test]
    fn a_block_that_moves_across_its_lines_is_found_and_nothing_else() {
        let mut finder = Finder::new();
        let mut moving = Vec::new();
        for i in 0_u8..3 {
            let at = pose([0.03 * f64::from(i), 0.0, 0.0], 0.0);
            moving = finder
                .update(&with_block(render(&camera(), &at, 1.0, 0.0), 6 * usize::from(i)), &at);
        }
        // The block is at columns 30 to 45 and rows 8 to 19 of the cells.
        // Flow is blurred by its patches, 8 cells wide.
        let inside = (8..20).flat_map(|row| (30..46).map(move |column| 80 * row + column));
        let found = inside.filter(|index| moving[*index]).count();
        assert!(found > 16 * 12 * 3 / 4, "{found}");
        let far_from_block = (0..moving.len()).filter(|index| !(22..54).contains(&(index % 80)));
        assert_eq!(far_from_block.filter(|index| moving[*index]).count(), 0);
    }

    #[test]
    fn a_wrong_rotation_masks_nothing() {
        let mut finder = Finder::new();
        let first = pose([0.0; 3], 0.0);
        let second = pose([0.03, 0.0, 0.0], 0.0);
        finder.update(&render(&camera(), &first, 1.0, 0.0), &first);
        // Nearly two degrees: everything is five pixels off.
        let wrong = pose([0.03, 0.0, 0.0], 0.03);
        assert_eq!(count(&finder.update(&render(&camera(), &second, 1.0, 0.0), &wrong)), 0);
    }

    #[test]
    fn the_first_image_and_the_first_after_forgetting_show_no_motion() {
        let mut finder = Finder::new();
        let at = pose([0.0; 3], 0.0);
        let image = render(&camera(), &at, 1.0, 0.0);
        assert_eq!(count(&finder.update(&with_block(image.clone(), 0), &at)), 0);
        finder.motion.forget();
        assert_eq!(count(&finder.update(&with_block(image, 8), &at)), 0);
    }
}
