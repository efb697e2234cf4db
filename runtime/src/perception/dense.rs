//! Dense depth: coarse depth, completed by what was seen before, by the cells around, and by the scan of the safety LiDAR.
//!
//! Every cell of 4x4 pixels takes the more probable of coarse depth of this frame and the depth that the voxel map recalls
//! (`voxel_map.rs`); where both agree, the probability rises. A cell for which neither is more probable than 50 % is filled from the
//! cells around it (`fill.rs`). Last, a cell takes the wall or the floor that the scan promises (`walls.rs`) where that is more probable.
//! Where there is a scan, a small network then chooses among all four (`choice.rs`): the best depth that there is without a larger network.
//!
//! What a map may believe of it is in `map_depth.rs`.

use hal::{CameraModel, LaserScan, Pose2, Pose3};

use super::DepthEstimate;
use super::belief::{AGREEMENT, Belief};
use super::choice::{CANDIDATES, Cell, Choice, FEATURES};
use super::coarse::{CoarseDepth, SeenCells, shrink};
use super::confidence::{belief_features, logistic, logit};
use super::config::DenseConfig;
use super::fill::{Fill, Filled};
use super::surround::{Surround, Surroundings};
use super::upsample::Cells;
use super::voxel_map::{Seen, VoxelMap};
use super::wall_agreement::WallAgreement;
use super::walls::{Wall, Walls};
use crate::snapshot::remembers;

/// A cell with a lower probability than this is filled from the cells around it, and does not fill others.
const KNOWN: f32 = 0.5;
/// Every cell with depth has at least this probability: the upsampling leaves out what has less.
const LEAST: f32 = 0.02;

/// What a cell could have been, for the fit of the probabilities.
#[derive(Debug, Clone, Copy)]
pub struct Candidates {
    /// Coarse depth and its probability.
    pub coarse: (Belief, f32),
    /// Recalled depth, its neighbourhood and its probability.
    pub recalled: (Belief, Surround, f32),
    pub filled: Filled,
    /// What would be chosen without walls: inverse depth and its probability.
    pub without_walls: (f32, f32),
    /// What the scan tells, and the share of the cells around that agree with their walls.
    pub wall: (Wall, f32),
    /// What the choice was made from; `None` without one.
    pub choice: Option<Choosable>,
}

/// What the choice of a cell was made from.
#[derive(Debug, Clone, Copy)]
pub struct Choosable {
    /// Inverse depth of coarse, recalled and filled depth and of the wall or floor, 1/m; 0 where there is none.
    pub inverse_depth: [f32; CANDIDATES],
    /// The inputs of the network.
    pub features: [f32; FEATURES],
}

/// Where and when a frame was taken.
#[derive(Debug, Clone, Copy)]
pub struct Moment {
    /// Time of the frame, monotonic.
    pub time_ns: u64,
    /// Pose of the base at the exposure in `odom`.
    pub t_odom_base: Pose2,
    /// Pose of `odom` in `map`.
    pub t_map_odom: Pose2,
    /// The section of the path that the robot is in; a closed loop moves what was seen in a section together
    /// (`DenseDepth::correct`). `None`: the robot doubts its pose, and nothing is learnt.
    pub section: Option<u16>,
}

impl Moment {
    /// A frame of a camera that is not on a robot: there are no scans, and `odom` is `map`.
    pub const HANDHELD: Self = Self {
        time_ns: 0,
        t_odom_base: Pose2::IDENTITY,
        t_map_odom: Pose2::IDENTITY,
        section: Some(0),
    };
}

/// Completes coarse depth.
#[derive(Debug)]
pub struct DenseDepth {
    config: DenseConfig,
    /// The camera whose pixels are the cells.
    cells: CameraModel,
    voxels: VoxelMap,
    fill: Fill,
    walls: Walls,
    wall_agreement: WallAgreement,
    /// `t_map_camera` of the last frame that was learnt.
    learnt_at: Option<Pose3>,
    around_recalled: Surroundings,
    coarse: Vec<(Belief, f32)>,
    recalled: Vec<f32>,
    choice: Choice,
    /// Whether the depths of the last frame were chosen: it had a scan.
    has_choice: bool,
    joined: Vec<Belief>,
    confidence: Vec<f32>,
    /// What is chosen without walls: inverse depth and its probability.
    without_walls: Vec<(f32, f32)>,
    /// Probability of coarse depth where no wall contradicts it: what the voxel map learns.
    learnable: Vec<f32>,
    grey: Vec<u16>,
    /// The result before the choice.
    before_choice: DepthEstimate,
    estimate: DepthEstimate,
}

impl DenseDepth {
    /// Prepares to complete `coarse`, the depth of frames of `camera`. `t_base_camera` is the camera's mount on a robot that stands on
    /// a floor; without it, rows that were never seen have no depth, and scans are not used.
    #[must_use]
    pub fn new(
        config: DenseConfig,
        camera: &CameraModel,
        coarse: &CoarseDepth,
        t_base_camera: Option<&Pose3>,
    ) -> Self {
        let cells = *coarse.cell_camera();
        let count = cells.width * cells.height;
        let walls = t_base_camera.filter(|_| config.walls);
        Self {
            config,
            walls: walls.map_or_else(Walls::default, |mount| Walls::new(&cells, mount)),
            wall_agreement: WallAgreement::default(),
            voxels: VoxelMap::default(),
            fill: t_base_camera.map_or_else(Fill::default, |mount| Fill::on_a_floor(&cells, mount)),
            learnt_at: None,
            around_recalled: Surroundings::default(),
            coarse: vec![(Belief::default(), 0.0); count],
            recalled: vec![0.0; count],
            choice: Choice::default(),
            has_choice: false,
            joined: vec![Belief::default(); count],
            confidence: vec![0.0; count],
            without_walls: Vec::new(),
            learnable: vec![0.0; count],
            grey: vec![0; count],
            before_choice: DepthEstimate::none(camera.width, camera.height),
            estimate: DepthEstimate::none(camera.width, camera.height),
            cells,
        }
    }

    /// Uses `scan`, which was taken at `t_odom_laser`, for the frames of the next 0.3 s.
    pub fn see(&mut self, scan: &LaserScan, t_odom_laser: &Pose2) {
        self.walls.see(scan, t_odom_laser);
    }

    /// Completes the last frame of `coarse`, which must have been a frame with texture and was taken at `moment`.
    pub fn complete(&mut self, coarse: &CoarseDepth, moment: &Moment) {
        rayon::scope(|_| self.complete_in_pool(&coarse.seen(), moment));
    }

    fn complete_in_pool(&mut self, seen: &SeenCells<'_>, moment: &Moment) {
        let t_map_camera = moment.t_map_odom.to_pose3() * seen.pose;
        self.join_seen(seen, &t_map_camera);
        let walls = self.walls.project(&moment.t_odom_base, moment.time_ns);
        self.wall_agreement.update(walls, &self.joined, &self.confidence, self.cells.width);
        self.fill_holes(seen);
        let has_scan = self.walls.last().iter().any(|wall| wall.inverse_depth > 0.0);
        self.has_choice = self.config.choice && has_scan;
        self.join_walls();
        if self.has_choice {
            let cells = cells(&self.cells, &self.joined, &self.confidence, &self.grey);
            cells.upsample(seen.smooth, &mut self.before_choice);
            self.choose(seen);
        }
        if let Some(section) = moment.section {
            self.learn(seen, t_map_camera, section);
        }
        let cells = cells(&self.cells, &self.joined, &self.confidence, &self.grey);
        cells.upsample(seen.smooth, &mut self.estimate);
    }

    /// The result of the last [`complete`](Self::complete).
    #[must_use]
    pub fn last(&self) -> &DepthEstimate {
        &self.estimate
    }

    /// The result of the last [`complete`](Self::complete) by the logistic models alone: the same as [`last`](Self::last) where there
    /// was no choice.
    #[must_use]
    pub fn before_choice(&self) -> &DepthEstimate {
        if self.has_choice { &self.before_choice } else { &self.estimate }
    }

    /// What every cell could have been, row-major; `cargo xtask accuracy` fits the probabilities with it.
    pub fn candidates(&self) -> impl Iterator<Item = Candidates> {
        let recalled = self.voxels.last().iter().zip(self.around_recalled.last());
        let recalled =
            recalled.zip(&self.recalled).map(|((belief, around), p)| (*belief, *around, *p));
        let filled = self.fill.last().iter().copied();
        let walls =
            self.walls.last().iter().copied().zip(self.wall_agreement.last().iter().copied());
        let walls = walls.chain(std::iter::repeat(Default::default()));
        let first = self.coarse.iter().zip(recalled).zip(filled);
        let all = first.zip(&self.without_walls).zip(walls).enumerate();
        all.map(|(cell, ((((coarse, recalled), filled), without_walls), wall))| Candidates {
            coarse: *coarse,
            recalled,
            filled,
            without_walls: *without_walls,
            wall,
            choice: self.has_choice.then(|| Choosable {
                inverse_depth: self.choice.candidates()[cell],
                features: self.choice.features(cell, self.cells.width),
            }),
        })
    }

    /// Moves what was seen in each section after a loop was closed: `new = correction * old`, in the frame `map`.
    pub(crate) fn correct(&mut self, corrections: &[Pose2]) {
        self.voxels.correct(corrections);
        self.learnt_at = None;
    }

    /// Takes the more probable of coarse and recalled depth for every cell.
    fn join_seen(&mut self, seen: &SeenCells<'_>, t_map_camera: &Pose3) {
        let recalled = self.voxels.recall(t_map_camera, &self.cells);
        let around = self.around_recalled.update(recalled, self.cells.width);
        for cell in 0..self.joined.len() {
            let coarse = seen.beliefs.get(cell).copied().unwrap_or_default();
            let p_coarse = seen.confidence[cell];
            let old = recalled[cell];
            let p_old = if old.evidence > 0.0 {
                logistic(&self.config.recall_weights, &belief_features(&old, &around[cell]))
            } else {
                0.0
            };
            self.coarse[cell] = (coarse, p_coarse);
            self.learnable[cell] = p_coarse;
            self.recalled[cell] = p_old;
            let (belief, confidence) =
                if p_coarse >= p_old { (coarse, p_coarse) } else { (old, p_old) };
            let is_known = confidence >= KNOWN;
            let both = p_coarse > 0.0 && p_old > 0.0;
            self.joined[cell] = if is_known { belief } else { Belief::default() };
            self.confidence[cell] = match (is_known, both) {
                (false, _) => 0.0,
                (true, false) => confidence,
                (true, true) => {
                    let other = p_coarse.min(p_old);
                    let agree = agree(coarse.inverse_depth, old.inverse_depth);
                    logistic(&self.config.joint_weights, &joint_features(confidence, other, agree))
                }
            };
        }
    }

    /// Fills the cells that are not known.
    fn fill_holes(&mut self, seen: &SeenCells<'_>) {
        shrink(seen.smooth, self.estimate.depth.width(), self.cells.width, &mut self.grey);
        let filled = self.fill.fill(&self.joined, &self.grey, self.cells.width);
        for (cell, filled) in filled.iter().enumerate() {
            let is_known = self.confidence[cell] > 0.0;
            if is_known || filled.inverse_depth == 0.0 {
                continue;
            }
            self.joined[cell].inverse_depth = filled.inverse_depth;
            let confidence = logistic(&self.config.fill_weights, &filled.features());
            self.confidence[cell] = confidence.max(LEAST);
        }
    }

    /// Takes the wall or the floor that the scan promises for every cell for which it is more probable.
    fn join_walls(&mut self) {
        let known = self.joined.iter().map(|belief| belief.inverse_depth);
        self.without_walls.clear();
        self.without_walls.extend(known.zip(self.confidence.iter().copied()));
        let walls = self.walls.last().iter().zip(self.wall_agreement.last());
        let walls = walls.map(|(wall, share)| (*wall, *share)).enumerate();
        for (cell, wall) in walls.filter(|(_, (wall, _))| wall.inverse_depth > 0.0) {
            let p_wall = self.config.of_wall(&wall);
            let (old, p_old) = self.without_walls[cell];
            let wall = wall.0;
            let weights = match self.fill.last()[cell].is_seen() {
                true => &self.config.seen_wall_weights,
                false => &self.config.filled_wall_weights,
            };
            let agree_with_coarse = agree(self.coarse[cell].0.inverse_depth, wall.inverse_depth);
            let agree = agree(old, wall.inverse_depth);
            let features = joint_features(p_old.max(p_wall), p_old.min(p_wall), agree);
            self.confidence[cell] = logistic(weights, &features).max(LEAST);
            if p_wall > p_old {
                self.joined[cell].inverse_depth = wall.inverse_depth;
                // The blank wall of a kitchen would otherwise be recalled wherever coarse depth once found it by mistake.
                if !agree_with_coarse {
                    self.learnable[cell] = 0.0;
                }
            }
        }
    }

    /// Chooses the depth of every cell anew, with what the scan promises.
    fn choose(&mut self, seen: &SeenCells<'_>) {
        let recalled = self.voxels.last();
        let around = self.around_recalled.last();
        let walls = self.walls.last();
        let agreement = self.wall_agreement.last();
        let cell = |cell: usize| Cell {
            coarse: (
                self.coarse[cell].0,
                seen.surroundings.get(cell).copied().unwrap_or_default(),
                self.coarse[cell].1,
            ),
            vote: seen.votes.get(cell).copied(),
            recalled: (recalled[cell], around[cell], self.recalled[cell]),
            filled: self.fill.last()[cell],
            sides: self.fill.sides(cell),
            wall: (walls[cell], agreement[cell]),
        };
        let chosen = self.choice.update(self.joined.len(), self.cells.width, cell);
        for (cell, chosen) in chosen.iter().enumerate() {
            self.joined[cell].inverse_depth = chosen.inverse_depth;
            let is_known = chosen.inverse_depth > 0.0;
            self.confidence[cell] = if is_known { chosen.probability.max(LEAST) } else { 0.0 };
        }
    }

    /// Puts a matched frame into the voxel map when the robot has moved.
    fn learn(&mut self, seen: &SeenCells<'_>, t_map_camera: Pose3, section: u16) {
        let has_moved = self.learnt_at.is_none_or(|at| {
            let step = at.inverse() * t_map_camera;
            step.translation.vector.norm() >= self.config.learn_step_m
        });
        if !has_moved || !seen.is_matched {
            return;
        }
        self.learnt_at = Some(t_map_camera);
        let seen = Seen {
            beliefs: seen.beliefs,
            confidence: &self.learnable,
            around: seen.surroundings,
            min_confidence: self.config.learn_confidence,
        };
        self.voxels.learn(seen, &t_map_camera, &self.cells, section);
    }
}

/// The cells of `camera` whose depths are upsampled.
fn cells<'a>(
    camera: &CameraModel,
    beliefs: &'a [Belief],
    confidence: &'a [f32],
    grey: &'a [u16],
) -> Cells<'a> {
    Cells { width: camera.width, beliefs, confidence, grey, min_confidence: LEAST }
}

impl DenseConfig {
    /// Probability of a wall or a floor that a scan promises, with the share of the cells around it that agree with theirs.
    #[must_use]
    pub fn of_wall(&self, (wall, share): &(Wall, f32)) -> f32 {
        logistic(&self.wall_weights, &wall.features(*share))
    }
}

/// Whether two inverse depths are of one surface.
#[must_use]
pub fn agree(a: f32, b: f32) -> bool {
    (a - b).abs() <= AGREEMENT * a.max(b)
}

/// The features of the probability of a depth for which there is a second, less probable one: a constant, the logit of both, once
/// for a second one that agrees and once for one that does not, and the agreement.
#[must_use]
pub fn joint_features(confidence: f32, other: f32, agree: bool) -> [f32; 5] {
    let other = logit(other);
    let [for_it, against] = if agree { [other, 0.0] } else { [0.0, other] };
    [1.0, logit(confidence), for_it, against, f32::from(u8::from(agree))]
}

remembers!(DenseDepth: voxels, fill, walls, wall_agreement, learnt_at);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::CoarseConfig;
    use crate::perception::test_scene::{depth_m, pose, render};
    use hal::{ImageView, PixelFormat, Range, ScanGeometry, camera_mount};

    fn camera() -> CameraModel {
        CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2)
    }

    struct Robot {
        coarse: CoarseDepth,
        dense: DenseDepth,
        section: Option<u16>,
    }

    impl Robot {
        /// A camera that is not on a robot.
        fn new() -> Self {
            let coarse = CoarseDepth::new(CoarseConfig::default(), camera()).unwrap();
            let dense = DenseDepth::new(DenseConfig::default(), &camera(), &coarse, None);
            Self { coarse, dense, section: Some(0) }
        }

        /// A camera on a robot whose scanner is below it and sees a wall that crosses the optical axis at `wall_m`, with the slope
        /// of the test scene.
        fn with_scanner(config: DenseConfig, wall_m: f64) -> Self {
            let coarse = CoarseDepth::new(CoarseConfig::default(), camera()).unwrap();
            let mount = camera_mount(0.0, 0.8, 0.0);
            let mut dense = DenseDepth::new(config, &camera(), &coarse, Some(&mount));
            let geometry = ScanGeometry::UTM_30LX;
            let mut scan = LaserScan::empty(geometry);
            scan.ranges = (0..geometry.beams)
                .map(|beam| {
                    let angle = geometry.angle_rad(beam);
                    // The test scene's x points to the right, the scanner's y to the left.
                    let range_m = wall_m / (angle.cos() + 0.3 * angle.sin());
                    if angle.abs() < 1.2 { Range::Hit(range_m as f32) } else { Range::NoReturn }
                })
                .collect();
            dense.see(&scan, &Pose2::IDENTITY);
            Self { coarse, dense, section: Some(0) }
        }

        /// Estimates the depth of a frame that was taken at this pose. Returns whether it had coarse depth.
        fn process(&mut self, at: &Pose3) -> bool {
            let image = render(&camera(), at, 1.0, 0.0);
            let frame = ImageView::new(320, 96, PixelFormat::Gray8, &image).unwrap();
            let has_coarse = self.coarse.estimate(frame, at).is_ok();
            let moment = Moment { section: self.section, ..Moment::HANDHELD };
            self.dense.complete(&self.coarse, &moment);
            has_coarse
        }

        /// Share of all pixels that are right within 25 %.
        fn right(&self, at: &Pose3) -> f64 {
            let values = self.dense.last().depth.values();
            let right = values.iter().enumerate().filter(|(index, depth)| {
                let truth = depth_m(&camera(), at, (index % 320) as f64, (index / 320) as f64);
                let ratio = f64::from(**depth) / truth;
                ratio > 0.8 && ratio < 1.25
            });
            right.count() as f64 / values.len() as f64
        }
    }

    fn drive(robot: &mut Robot) {
        for step in 0..16 {
            robot.process(&pose([0.03 * f64::from(step), 0.0, 0.0], 0.0));
        }
    }

    #[test]
    fn every_pixel_has_depth_once_something_was_seen_and_each_has_a_probability() {
        let mut robot = Robot::new();
        drive(&mut robot);
        let estimate = robot.dense.last();
        assert!(estimate.depth.values().iter().all(|depth| *depth > 0.0 && depth.is_finite()));
        assert!(estimate.confidence.iter().all(|p| *p > 0.0 && *p < 1.0));
        let right = robot.right(&pose([0.45, 0.0, 0.0], 0.0));
        assert!(right > 0.97, "{right}");
    }

    #[test]
    fn a_view_that_was_seen_before_is_recalled_after_coarse_depth_has_forgotten_it() {
        let mut robot = Robot::new();
        drive(&mut robot);
        // Twice to the side and back on the spot: coarse depth has forgotten, and no keyframe of the drive is left.
        let steps = (1..=16).chain((0..16).rev());
        for step in steps.clone().chain(steps) {
            robot.process(&turned(0.06 * f64::from(step)));
        }
        robot.process(&turned(0.0));
        let cells: Vec<Candidates> = robot.dense.candidates().collect();
        let recalled =
            cells.iter().filter(|cell| cell.recalled.2 > cell.coarse.1.max(KNOWN)).count();
        assert!(recalled * 2 > cells.len(), "{recalled}");
        let right = robot.right(&turned(0.0));
        assert!(right > 0.95, "{right}");
    }

    fn turned(yaw: f64) -> Pose3 {
        pose([0.45, 0.0, 0.0], yaw)
    }

    #[test]
    fn a_robot_that_doubts_its_pose_learns_nothing() {
        let mut robot = Robot::new();
        robot.section = None;
        drive(&mut robot);
        let recalled = robot.dense.candidates().filter(|cell| cell.recalled.2 > 0.0).count();
        assert_eq!(recalled, 0);
    }

    #[test]
    fn a_first_frame_has_no_depth_of_any_kind() {
        let mut robot = Robot::new();
        assert!(!robot.process(&pose([0.0; 3], 0.0)));
        assert!(robot.dense.last().confidence.iter().all(|p| *p == 0.0));
        assert!(robot.dense.last().depth.values().iter().all(|depth| *depth == 0.0));
    }

    #[test]
    fn a_robot_that_has_not_moved_has_the_depth_of_the_walls_that_its_scanner_sees() {
        let at = pose([0.0; 3], 0.0);
        let mut robot = Robot::with_scanner(DenseConfig::default(), 2.5);
        assert!(!robot.process(&at));
        assert!(robot.right(&at) > 0.99, "{}", robot.right(&at));
        assert!(robot.dense.last().confidence.iter().all(|p| *p > 0.5));
        let mut without =
            Robot::with_scanner(DenseConfig { walls: false, ..DenseConfig::default() }, 2.5);
        without.process(&at);
        assert!(without.dense.last().confidence.iter().all(|p| *p < 0.5));
    }

    #[test]
    fn depth_that_was_seen_wins_against_a_wall_behind_it() {
        // The scanner sees a wall at 4 m below a surface at 2.5 m.
        let mut robot = Robot::with_scanner(DenseConfig::default(), 4.0);
        drive(&mut robot);
        let right = robot.right(&pose([0.45, 0.0, 0.0], 0.0));
        assert!(right > 0.95, "{right}");
    }

    fn without_choice() -> DenseConfig {
        DenseConfig { choice: false, ..DenseConfig::default() }
    }

    #[test]
    fn the_choice_leaves_depth_that_was_seen_before_a_wall_and_takes_the_wall_before_anything_was_seen()
     {
        let mut robot = Robot::with_scanner(DenseConfig::default(), 4.0);
        drive(&mut robot);
        let right = robot.right(&pose([0.45, 0.0, 0.0], 0.0));
        assert!(right > 0.95, "{right}");
        let at = pose([0.0; 3], 0.0);
        let mut robot = Robot::with_scanner(DenseConfig::default(), 2.5);
        assert!(!robot.process(&at));
        assert!(robot.right(&at) > 0.95, "{}", robot.right(&at));
    }

    #[test]
    fn without_a_scan_there_is_no_choice() {
        let mut robot = Robot::with_scanner(DenseConfig::default(), 2.5);
        robot.dense.walls = Walls::default();
        let mut without = Robot::with_scanner(without_choice(), 2.5);
        without.dense.walls = Walls::default();
        drive(&mut robot);
        drive(&mut without);
        assert!(robot.dense.candidates().all(|cell| cell.choice.is_none()));
        assert_eq!(robot.dense.last(), without.dense.last());
        assert_eq!(robot.dense.before_choice(), robot.dense.last());
    }

    #[test]
    fn depth_before_the_choice_is_that_of_a_robot_without_it() {
        // Nothing was learnt yet, so that both recall the same.
        let at = pose([0.0; 3], 0.0);
        let mut robot = Robot::with_scanner(DenseConfig::default(), 2.5);
        let mut without = Robot::with_scanner(without_choice(), 2.5);
        robot.process(&at);
        without.process(&at);
        assert_eq!(robot.dense.before_choice(), without.dense.last());
        assert_ne!(robot.dense.last(), without.dense.last());
    }

    #[test]
    fn agreement_of_coarse_and_recalled_depth_raises_the_probability_and_contradiction_lowers_it() {
        let weights = DenseConfig::default().joint_weights;
        let [agreeing, contradicting] =
            [true, false].map(|agree| logistic(&weights, &joint_features(0.8, 0.7, agree)));
        assert!(agreeing > 0.8 && contradicting < 0.8, "{agreeing} {contradicting}");
    }
}
