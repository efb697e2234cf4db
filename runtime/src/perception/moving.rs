//! Things that move by themselves: where the picture moves as no still thing could, whatever its depth.
//!
//! A still point that the camera passes stays on its epipolar line. Dense flow to the picture before says where everything
//! really was; what is far off its line moved by itself, and neither parallax nor memory tells its depth. What moves along its
//! line is not found: it looks like another depth.

use hal::{CameraModel, Pose3};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::census::CensusImage;
use super::flow::FlowField;
use super::sweep::{CELL, homography, length};

/// Off its line by more than this, pixels: dense flow of this preset is seldom wrong by more where there is texture ...
const OFF_PX: f32 = 3.0;
/// ... or by so many times what most of the picture is off: then it is the pose that is wrong.
const OFF_OVER_MEDIAN: f32 = 6.0;
/// Half of the side of the square of cells of which most must be off: thin strips are edges that hide one another.
const SQUARE: isize = 2;
/// What surrounds moving cells moves, too, cells: flow is blurred.
const MARGIN: isize = 2;
/// When more of the picture moves than one part in this many, nothing tells what stands still: rather the pose is wrong.
const MOST: usize = 2;

/// Finds them from picture to picture.
#[derive(Debug)]
pub struct MovingThings {
    off_px: Vec<f32>,
    sorted: Vec<f32>,
    off: Vec<bool>,
    moving: Vec<bool>,
}

impl MovingThings {
    /// For pictures of this size.
    pub fn new(width: usize, height: usize) -> Self {
        let cells = (width / CELL) * (height / CELL);
        Self {
            off_px: vec![0.0; cells],
            sorted: Vec::with_capacity(cells),
            off: vec![false; cells],
            moving: vec![false; cells],
        }
    }

    /// Nothing moves.
    pub fn forget(&mut self) {
        self.moving.fill(false);
    }

    /// What the last [`look`](Self::look) returned.
    pub fn last(&self) -> &[bool] {
        &self.moving
    }

    /// For every cell of 4x4 pixels, row-major, whether the thing in it moved since the picture before, to which `flow` leads.
    /// `camera` describes the positions of `picture.smooth`; nothing is nearer than `nearest_m`.
    pub fn look(
        &mut self,
        picture: &CensusImage,
        flow: &FlowField,
        t_before_now: &Pose3,
        camera: &CameraModel,
        nearest_m: f64,
    ) -> &[bool] {
        self.moving.fill(false);
        let line = Line::new(t_before_now, camera, nearest_m);
        let columns = picture.width / CELL;
        self.off_px.par_chunks_exact_mut(columns).enumerate().for_each(|(row, off_px)| {
            for (column, off_px) in off_px.iter_mut().enumerate() {
                let (u, v) = (CELL * column + CELL / 2, CELL * row + CELL / 2);
                let at = v * picture.width + u;
                // Without texture, flow is what the neighbours do.
                let textured = picture.descriptors[at] != 0;
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

    /// From single cells to things.
    fn gather(&mut self, columns: usize) {
        let rows = self.off.len() / columns;
        let around = |row: usize, column: usize, reach: isize| {
            let span = move |at: usize, end: usize| {
                at.saturating_add_signed(-reach)..(at.saturating_add_signed(reach) + 1).min(end)
            };
            span(row, rows).flat_map(move |y| span(column, columns).map(move |x| y * columns + x))
        };
        let enough = ((2 * SQUARE + 1) * (2 * SQUARE + 1)) as usize * 3 / 5;
        for index in 0..self.off.len() {
            let (row, column) = (index / columns, index % columns);
            if self.off[index]
                && around(row, column, SQUARE).filter(|near| self.off[*near]).count() >= enough
            {
                around(row, column, MARGIN).for_each(|near| self.moving[near] = true);
            }
        }
        if self.moving.iter().filter(|moving| **moving).count() * MOST > self.moving.len() {
            self.moving.fill(false);
        }
    }
}

/// Where the still points behind a pixel can be in the picture before.
struct Line {
    rotation: Matrix3<f32>,
    translation: Vector3<f32>,
    nearest: f32,
}

impl Line {
    fn new(t_before_now: &Pose3, camera: &CameraModel, nearest_m: f64) -> Self {
        let (rotation, translation) = homography(t_before_now, camera);
        Self { rotation, translation, nearest: (1.0 / nearest_m) as f32 }
    }

    /// Distance of where the pixel at (u, v) was, by its flow, from where a still one could have been.
    fn off_px(&self, u: f32, v: f32, flow: [f32; 2]) -> f32 {
        let far = self.rotation * Vector3::new(u, v, 1.0);
        let near = far + self.translation * self.nearest;
        // Nearer than the camera itself: the line goes on to the edge of the picture and beyond.
        let near = if near.z > 0.1 * far.z {
            near
        } else {
            far + self.translation * (-0.9 * far.z / self.translation.z)
        };
        let (x0, y0) = (far.x / far.z, far.y / far.z);
        let (dx, dy) = (near.x / near.z - x0, near.y / near.z - y0);
        let (x, y) = (u + flow[0] - x0, v + flow[1] - y0);
        let along = ((x * dx + y * dy) / (dx * dx + dy * dy).max(1e-6)).clamp(0.0, 1.0);
        length(x - along * dx, y - along * dy)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::motion::PictureMotion;
    use crate::perception::test_scene::{pose, render};
    use hal::{ImageView, PixelFormat};

    const NEAREST_M: f64 = 0.3;

    fn camera() -> CameraModel {
        CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
    }

    /// A block of 64x48 pixels of its own texture, which is `down` pixels below its place.
    fn with_block(mut picture: Vec<u8>, down: usize) -> Vec<u8> {
        for (y, row) in picture.chunks_exact_mut(320).skip(20 + down).take(48).enumerate() {
            for (x, value) in row[120..184].iter_mut().enumerate() {
                let (x, y) = (x as f64, y as f64);
                *value =
                    (128.0 + 60.0 * (0.5 * x + 0.2 * y).sin() * (0.45 * y - 0.15 * x).cos()) as u8;
            }
        }
        picture
    }

    /// What finds them, and the pose before.
    struct Finder {
        motion: PictureMotion,
        moving: MovingThings,
        before: Pose3,
    }

    impl Finder {
        fn new() -> Self {
            let motion = PictureMotion::new(320, 96).unwrap();
            Self { motion, moving: MovingThings::new(320, 96), before: Pose3::identity() }
        }

        fn look(&mut self, picture: &[u8], at: &Pose3) -> Vec<bool> {
            let mut census = CensusImage::default();
            assert!(census.compute(ImageView::new(320, 96, PixelFormat::Gray8, picture).unwrap()));
            let t_before_now = std::mem::replace(&mut self.before, *at).inverse() * at;
            let Some(flow) = self.motion.follow(&census) else { return vec![false; 80 * 24] };
            self.moving
                .look(&census, flow, &t_before_now, &camera().cropped(0.5, 0.5, 320, 96), NEAREST_M)
                .to_vec()
        }
    }

    fn count(moving: &[bool]) -> usize {
        moving.iter().filter(|moving| **moving).count()
    }

    #[test]
    fn nothing_moves_in_a_still_world_however_the_camera_does() {
        let paths: [fn(f64) -> Pose3; 3] = [
            |i| pose([0.03 * i, 0.0, 0.0], 0.0),
            |i| pose([0.0, 0.0, 0.03 * i], 0.0),
            |i| pose([0.01 * i, 0.0, 0.02 * i], 0.03 * i),
        ];
        for path in paths {
            let mut finder = Finder::new();
            for i in 0..6 {
                let at = path(f64::from(i));
                assert_eq!(count(&finder.look(&render(&camera(), &at, 1.0, 0.0), &at)), 0);
            }
        }
    }

    #[test]
    fn a_block_that_moves_across_its_lines_is_found_and_nothing_else() {
        let mut finder = Finder::new();
        let mut moving = Vec::new();
        for i in 0_u8..3 {
            let at = pose([0.03 * f64::from(i), 0.0, 0.0], 0.0);
            moving =
                finder.look(&with_block(render(&camera(), &at, 1.0, 0.0), 6 * usize::from(i)), &at);
        }
        // The block is at columns 30 to 45 and rows 8 to 19 of the cells.
        let in_block =
            |index: &usize| (30..46).contains(&(index % 80)) && (8..20).contains(&(index / 80));
        // Flow is blurred by its patches, 8 cells wide.
        let near_block = |index: &usize| (22..54).contains(&(index % 80));
        let found = (0..moving.len()).filter(|index| moving[*index] && in_block(index)).count();
        assert!(found > 16 * 12 * 3 / 4, "{found}");
        assert_eq!((0..moving.len()).find(|index| moving[*index] && !near_block(index)), None);
    }

    #[test]
    fn a_wrong_rotation_moves_nothing() {
        let mut finder = Finder::new();
        let (first, second) = (pose([0.0; 3], 0.0), pose([0.03, 0.0, 0.0], 0.0));
        finder.look(&render(&camera(), &first, 1.0, 0.0), &first);
        // Nearly two degrees: everything is five pixels off.
        let wrong = pose([0.03, 0.0, 0.0], 0.03);
        assert_eq!(count(&finder.look(&render(&camera(), &second, 1.0, 0.0), &wrong)), 0);
    }

    #[test]
    fn the_first_picture_and_the_first_after_forgetting_show_no_motion() {
        let mut finder = Finder::new();
        let at = pose([0.0; 3], 0.0);
        let picture = render(&camera(), &at, 1.0, 0.0);
        assert_eq!(count(&finder.look(&with_block(picture.clone(), 0), &at)), 0);
        finder.motion.forget();
        assert_eq!(count(&finder.look(&with_block(picture, 8), &at)), 0);
    }
}
