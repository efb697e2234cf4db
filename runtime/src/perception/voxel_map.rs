//! What was seen once: a sparse voxel map of surfaces, from which the depth of any view is recalled.
//!
//! Coarse depth needs parallax and forgets a cell within some fifty frames. The voxel map keeps each surface that was seen with
//! confidence: after a rotation on the spot, at standstill and behind a passing person, the depth of a pixel follows from the pose
//! alone.
//!
//! Voxels lie in the frame `map`, as it was when they were seen, together with the section of the path (one per submap of
//! localization). A closed loop moves whole sections ([`VoxelMap::correct`]) and touches no voxel.

use bytemuck::{Pod, Zeroable};
use hal::{CameraModel, Pose2, Pose3};

use super::belief::{AGREEMENT, Belief};
use super::surround::Surround;
use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Number of voxels that are kept: 2.5 MiB. A home of 100 m2 has about 400 m2 of surfaces, of which most are seen from 4 m and more.
const VOXELS: usize = 1 << 16;
/// A voxel may lie in any of this many neighbouring slots; when all are taken, the one that was seen longest ago is replaced.
const WAYS: usize = 4;
/// Edges of voxels, metres. A surface is kept in voxels that are at least as large as a cell of the image at its distance.
const EDGES_M: [f32; 4] = [0.05, 0.1, 0.2, 0.4];
/// Further observations of a voxel replace older ones, so that a thing that was moved is forgotten after some of them.
const MOST_OBSERVATIONS: f32 = 24.0;
/// Surfaces are not recalled beyond this distance, metres.
const FAR_M: f32 = 20.0;
/// Surfaces nearer than this are not recalled, metres: one voxel would fill the image.
const NEAR_M: f32 = 0.15;
/// Surfaces with a larger ratio of their distance from the optical axis to their depth are outside of any image: 160 degrees.
const WIDEST: f32 = 5.7;
/// A voxel covers at most this many cells to each side of its own.
const MOST_REACH: f32 = 3.0;
/// How far a voxel covers cells, in edges: the means of two neighbours may be almost two edges apart.
const COVERS: f32 = 0.75;

/// A piece of surface.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
struct Voxel {
    /// Section, level and place of the voxel in the grid; 0: the slot is empty.
    key: u64,
    /// Mean of the points seen in it, in the frame `map` of its section, metres.
    point_m: [f32; 3],
    /// Weight of that mean.
    weight: f32,
    /// Sum of the confidence of the observations that saw the surface, less that of the observations that saw through it.
    evidence: f32,
    /// Number of observations.
    observations: f32,
    /// The frame that saw it last.
    seen: u32,
    /// Keeps the size a multiple of 8.
    unused: u32,
}

/// The recalled depth of one cell.
#[derive(Debug, Clone, Copy, Default)]
struct Recalled {
    /// Inverse depth of the nearest surface, 1/m; 0: none.
    nearest: f32,
    /// Sums over all voxels that agree with it.
    weight: f32,
    weighted: f32,
    evidence: f32,
    observations: f32,
    /// Slot of the nearest voxel, plus 1.
    slot: u32,
}

/// The voxel map. Its memory is bounded and allocated once.
#[derive(Debug)]
pub struct VoxelMap {
    slots: Vec<Voxel>,
    /// For each section, how the map was moved since its voxels were seen.
    moved: Vec<Pose2>,
    /// Number of frames learnt from.
    frames: u32,
    views: Vec<View>,
    /// From the first half of the slots, later from all; and from the second half.
    recalled: [Vec<Recalled>; 2],
    beliefs: Vec<Belief>,
}

impl Default for VoxelMap {
    fn default() -> Self {
        Self {
            slots: vec![Voxel::zeroed(); VOXELS],
            moved: Vec::new(),
            frames: 0,
            views: Vec::new(),
            recalled: [Vec::new(), Vec::new()],
            beliefs: Vec::new(),
        }
    }
}

/// What a frame saw in its cells, row-major.
#[derive(Debug, Clone, Copy)]
pub struct Seen<'a> {
    pub beliefs: &'a [Belief],
    /// Probability that each belief is right.
    pub confidence: &'a [f32],
    /// The beliefs' neighbourhoods: cells at edges of objects have few that agree, and their points float in the air.
    pub around: &'a [Surround],
    /// Beliefs with a lower confidence are left out.
    pub min_confidence: f32,
}

/// A point that a frame saw.
#[derive(Debug, Clone, Copy)]
struct SeenPoint {
    /// In the frame `map` of its section, metres.
    point_m: [f32; 3],
    /// Its depth, metres.
    z: f32,
    /// Size of a cell of the image at this depth, metres.
    cell_m: f32,
    confidence: f32,
}

impl VoxelMap {
    /// Moves the voxels of each section by its correction, after a loop was closed.
    pub fn correct(&mut self, corrections: &[Pose2]) {
        for (section, correction) in corrections.iter().enumerate() {
            match self.moved.get_mut(section) {
                Some(moved) => *moved = correction.compose(moved),
                None => self.moved.push(*correction),
            }
        }
    }

    /// What the camera at `t_map_camera` should see, for every cell of `cells`, row-major: the mean of the nearest surface's
    /// voxels, with evidence and number of observations of the voxel that was seen most often.
    pub fn recall(&mut self, t_map_camera: &Pose3, cells: &CameraModel) -> &[Belief] {
        self.views.clear();
        for section in 0..=self.moved.len() {
            let moved = self.moved.get(section).copied().unwrap_or(Pose2::IDENTITY);
            self.views.push(View::new(&(t_map_camera.inverse() * moved.to_pose3())));
        }
        let views = &self.views;
        // Two halves on any number of threads, so that the sums are the same.
        let (first, second) = self.slots.split_at(VOXELS / 2);
        let [recalled, other] = &mut self.recalled;
        rayon::join(
            || splat_all(recalled, cells, views, first, 0),
            || splat_all(other, cells, views, second, first.len()),
        );
        recalled.iter_mut().zip(&*other).for_each(|(recalled, other)| recalled.merge(other));
        self.beliefs.clear();
        self.beliefs.extend(recalled.iter().map(Recalled::belief));
        &self.beliefs
    }

    /// The result of the last [`recall`](Self::recall).
    pub fn last(&self) -> &[Belief] {
        &self.beliefs
    }

    /// Adds what a frame saw, and weakens the voxels of the last [`recall`](Self::recall) that it saw through.
    pub fn learn(
        &mut self,
        seen: Seen<'_>,
        t_map_camera: &Pose3,
        cells: &CameraModel,
        section: u16,
    ) {
        self.frames += 1;
        let moved = self.moved.get(usize::from(section)).copied().unwrap_or(Pose2::IDENTITY);
        let back = View::new(&(moved.inverse().to_pose3() * t_map_camera));
        // Every second cell, and the others in the next frame: voxels are as large as cells.
        let odd = self.frames as usize % 2;
        for cell in (odd..seen.beliefs.len().min(self.recalled[0].len())).step_by(2) {
            let confidence = seen.confidence[cell];
            if confidence < seen.min_confidence || seen.around[cell].agreeing < 1.0 {
                continue;
            }
            let inverse_depth = seen.beliefs[cell].inverse_depth;
            self.weaken(cell, inverse_depth, confidence);
            let z = 1.0 / inverse_depth;
            if !(z > NEAR_M && z < FAR_M) {
                continue;
            }
            let x = ((cell % cells.width) as f32 - cells.cx as f32) / cells.fx as f32;
            let y = ((cell / cells.width) as f32 - cells.cy as f32) / cells.fy as f32;
            let point = SeenPoint {
                point_m: back.transform([x * z, y * z, z]),
                z,
                cell_m: z / cells.fx as f32,
                confidence,
            };
            self.add(point, section);
        }
    }

    /// The frame saw a surface farther than the recalled one.
    fn weaken(&mut self, cell: usize, inverse_depth: f32, confidence: f32) {
        let recalled = self.recalled[0][cell];
        if recalled.slot == 0 || inverse_depth * (1.0 + 2.0 * AGREEMENT) > recalled.nearest {
            return;
        }
        let voxel = &mut self.slots[recalled.slot as usize - 1];
        voxel.evidence -= confidence;
        voxel.observations += 1.0;
        if voxel.evidence <= 0.0 {
            *voxel = Voxel::zeroed();
        }
    }

    fn add(&mut self, point: SeenPoint, section: u16) {
        let SeenPoint { point_m, z, cell_m, confidence } = point;
        let [.., largest] = EDGES_M;
        let (level, edge_m) = EDGES_M
            .into_iter()
            .enumerate()
            .find(|(_, edge_m)| *edge_m >= cell_m)
            .unwrap_or((EDGES_M.len() - 1, largest));
        let place = point_m.map(|value| (value / edge_m).floor() as i32);
        let key = key_of(place, level as u64, section);
        let first = (hash(key) as usize % (VOXELS / WAYS)) * WAYS;
        let ways = &mut self.slots[first..first + WAYS];
        let found = ways.iter().position(|voxel| voxel.key == key);
        let slot = found.unwrap_or_else(|| {
            let oldest = ways.iter().enumerate().min_by_key(|(_, voxel)| voxel.seen);
            oldest.map_or(0, |(slot, _)| slot)
        });
        let voxel = &mut ways[slot];
        if found.is_none() {
            *voxel = Voxel { key, ..Voxel::zeroed() };
        }
        // The error of a depth grows with its square.
        let weight = confidence / (z * z * z * z);
        voxel.weight += weight;
        for (mean, value) in voxel.point_m.iter_mut().zip(point_m) {
            *mean += (value - *mean) * weight / voxel.weight;
        }
        // Several cells of one frame are one observation.
        if voxel.seen == self.frames && found.is_some() {
            return;
        }
        voxel.seen = self.frames;
        voxel.evidence += confidence;
        voxel.observations += 1.0;
        if voxel.observations > MOST_OBSERVATIONS {
            let keep = MOST_OBSERVATIONS / voxel.observations;
            voxel.observations *= keep;
            voxel.evidence *= keep;
            voxel.weight *= keep;
        }
    }
}

impl Recalled {
    fn belief(&self) -> Belief {
        if self.slot == 0 {
            return Belief::default();
        }
        Belief {
            inverse_depth: self.weighted / self.weight,
            evidence: self.evidence,
            votes: self.observations,
            offset: [0.0; 2],
        }
    }
}

/// A transform in single precision.
#[derive(Debug)]
struct View {
    rows: [[f32; 4]; 3],
}

impl View {
    fn new(pose: &Pose3) -> Self {
        let matrix = pose.to_homogeneous();
        let rows = [0, 1, 2].map(|row| [0, 1, 2, 3].map(|column| matrix[(row, column)] as f32));
        Self { rows }
    }

    #[inline(always)]
    fn transform(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        self.rows.map(|row| row[0] * x + row[1] * y + row[2] * z + row[3])
    }
}

/// Writes the voxels of `slots`, the first of which has index `from`, into all cells.
fn splat_all(
    recalled: &mut Vec<Recalled>,
    cells: &CameraModel,
    views: &[View],
    slots: &[Voxel],
    from: usize,
) {
    recalled.clear();
    recalled.resize(cells.width * cells.height, Recalled::default());
    let last = views.len() - 1;
    for (slot, voxel) in slots.iter().enumerate().filter(|(_, voxel)| voxel.key != 0) {
        let [x, y, z] = views[section_of(voxel.key).min(last)].transform(voxel.point_m);
        if z > NEAR_M && z < FAR_M && x.abs() < WIDEST * z {
            splat(recalled, cells, voxel, from + slot, [x / z, y / z, 1.0 / z]);
        }
    }
}

/// Writes a voxel into the cells that it covers. `place` is its direction (x/z, y/z) and inverse depth.
#[inline(always)]
fn splat(
    recalled: &mut [Recalled],
    cells: &CameraModel,
    voxel: &Voxel,
    slot: usize,
    [x, y, w]: [f32; 3],
) {
    let u = cells.fx as f32 * x + cells.cx as f32;
    let v = cells.fy as f32 * y + cells.cy as f32;
    let edge_m = EDGES_M[level_of(voxel.key)];
    let reach = (COVERS * edge_m * cells.fx as f32 * w).min(MOST_REACH);
    let columns = covered(u, reach, cells.width);
    for row in covered(v, reach, cells.height) {
        for column in columns.clone() {
            recalled[row * cells.width + column].add(voxel, slot, w);
        }
    }
}

/// The cells of a line of `count` whose middles are within `reach` of `center`.
#[inline(always)]
fn covered(center: f32, reach: f32, count: usize) -> std::ops::Range<usize> {
    // Casts of negative numbers saturate at 0.
    let first = (center - reach).ceil() as usize;
    let end = (center + reach + 1.0).floor() as usize;
    first..end.min(count)
}

impl Recalled {
    /// Adds what the other half of the voxels shows.
    fn merge(&mut self, other: &Self) {
        if self.nearest > other.nearest * (1.0 + AGREEMENT) {
            return;
        }
        if other.nearest > self.nearest * (1.0 + AGREEMENT) {
            *self = *other;
            return;
        }
        if other.nearest > self.nearest {
            self.nearest = other.nearest;
            self.slot = other.slot;
        }
        self.weight += other.weight;
        self.weighted += other.weighted;
        if other.observations > self.observations {
            self.observations = other.observations;
            self.evidence = other.evidence;
        }
    }

    #[inline(always)]
    fn add(&mut self, voxel: &Voxel, slot: usize, inverse_depth: f32) {
        if self.nearest > inverse_depth * (1.0 + AGREEMENT) {
            return;
        }
        if inverse_depth > self.nearest * (1.0 + AGREEMENT) {
            *self = Self::default();
        }
        if inverse_depth > self.nearest {
            self.nearest = inverse_depth;
            self.slot = slot as u32 + 1;
        }
        self.weight += voxel.weight;
        self.weighted += voxel.weight * inverse_depth;
        if voxel.observations > self.observations {
            self.observations = voxel.observations;
            self.evidence = voxel.evidence;
        }
    }
}

/// A key has 12 bits of section, 2 of level, 17 of x and y each and 14 of z, and a bit that is always set.
fn key_of([x, y, z]: [i32; 3], level: u64, section: u16) -> u64 {
    let place = low_bits(x, 17) | low_bits(y, 17) << 17 | low_bits(z, 14) << 34;
    place | level << 48 | u64::from(section & 0xFFF) << 50 | 1 << 63
}

fn low_bits(value: i32, count: u32) -> u64 {
    u64::from(value as u32) & ((1 << count) - 1)
}

fn section_of(key: u64) -> usize {
    (key >> 50) as usize & 0xFFF
}

/// An index of [`EDGES_M`].
fn level_of(key: u64) -> usize {
    (key >> 48) as usize & 3
}

/// Mixes the bits of a key (the finalizer of SplitMix64, Steele et al. 2014).
fn hash(key: u64) -> u64 {
    let mixed = (key ^ (key >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    mixed ^ (mixed >> 31)
}

impl State for VoxelMap {
    fn write(&self, to: &mut Vec<u8>) {
        let taken = self.slots.iter().enumerate().filter(|(_, voxel)| voxel.key != 0);
        let (places, voxels): (Vec<u32>, Vec<Voxel>) =
            taken.map(|(place, voxel)| (place as u32, *voxel)).unzip();
        write_bulk(&places, to);
        write_bulk(&voxels, to);
        self.moved.write(to);
        self.frames.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let mut places: Vec<u32> = Vec::new();
        let mut voxels: Vec<Voxel> = Vec::new();
        read_bulk(&mut places, VOXELS, from)?;
        read_bulk(&mut voxels, VOXELS, from)?;
        if places.len() != voxels.len() {
            return Err(SnapshotError::Damaged("voxels without a place".to_owned()));
        }
        self.slots.fill(Voxel::zeroed());
        for (place, voxel) in places.into_iter().zip(voxels) {
            let slot = self.slots.get_mut(place as usize);
            *slot.ok_or_else(|| SnapshotError::Damaged(format!("voxel {place} of {VOXELS}")))? =
                voxel;
        }
        self.moved.read(from)?;
        self.frames.read(from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SURE: Surround = Surround { confidence: 0.9, agreeing: 1.0 };

    fn cells() -> CameraModel {
        CameraModel::pinhole(80, 24, std::f64::consts::FRAC_PI_2)
    }

    /// A camera in `map` at a height of 0.8 m that points along x.
    fn camera_at(x_m: f64, y_m: f64, yaw_rad: f64) -> Pose3 {
        let axes = nalgebra::Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let optical = nalgebra::UnitQuaternion::from_matrix(&axes);
        let mount = Pose3::from_parts(nalgebra::Translation3::new(0.0, 0.0, 0.8), optical);
        Pose2 { x_m, y_m, yaw_rad }.to_pose3() * mount
    }

    /// What a camera sees of the wall x = `wall_m`.
    fn wall(t_map_camera: &Pose3, wall_m: f64) -> Vec<Belief> {
        let cells = cells();
        let seen = (0..cells.width * cells.height).map(|cell| {
            let u = (cell % cells.width) as f64;
            let v = (cell / cells.width) as f64;
            let ray = t_map_camera.rotation * cells.ray(u, v);
            let z = (wall_m - t_map_camera.translation.x) / ray.x;
            Belief { inverse_depth: (1.0 / z) as f32, evidence: 3.0, votes: 3.5, offset: [0.0; 2] }
        });
        seen.collect()
    }

    fn observe(map: &mut VoxelMap, t_map_camera: &Pose3, wall_m: f64, section: u16) {
        map.recall(t_map_camera, &cells());
        let beliefs = wall(t_map_camera, wall_m);
        let confidence = vec![0.9; beliefs.len()];
        let around = vec![SURE; beliefs.len()];
        let seen = Seen {
            beliefs: &beliefs,
            confidence: &confidence,
            around: &around,
            min_confidence: 0.7,
        };
        map.learn(seen, t_map_camera, &cells(), section);
    }

    /// Share of the cells whose recalled depth is within 5 % of the wall's, and of those without any.
    fn right_and_empty(map: &mut VoxelMap, t_map_camera: &Pose3, wall_m: f64) -> (f64, f64) {
        let truth = wall(t_map_camera, wall_m);
        let recalled = map.recall(t_map_camera, &cells());
        let pairs = recalled.iter().zip(&truth);
        let right = pairs.filter(|(found, truth)| {
            (found.inverse_depth / truth.inverse_depth - 1.0).abs() < 0.05
        });
        let empty = recalled.iter().filter(|found| found.evidence == 0.0).count();
        (right.count() as f64 / truth.len() as f64, empty as f64 / truth.len() as f64)
    }

    #[test]
    fn a_wall_that_was_seen_is_recalled_from_another_place_and_direction() {
        let mut map = VoxelMap::default();
        for step in 0..6 {
            observe(&mut map, &camera_at(0.1 * f64::from(step), 0.0, 0.0), 3.0, 0);
        }
        let (right, _) = right_and_empty(&mut map, &camera_at(0.4, 0.3, -0.1), 3.0);
        assert!(right > 0.85, "{right}");
        let (_, empty) = right_and_empty(&mut map, &camera_at(0.0, 0.0, 3.0), 3.0);
        assert_eq!(empty, 1.0);
    }

    #[test]
    fn a_near_wall_hides_a_far_one() {
        let mut map = VoxelMap::default();
        for step in 0..4 {
            observe(&mut map, &camera_at(2.0 + 0.1 * f64::from(step), 0.0, 0.0), 5.0, 0);
        }
        for step in 0..4 {
            observe(&mut map, &camera_at(0.1 * f64::from(step), 0.0, 0.0), 1.5, 0);
        }
        let (right, _) = right_and_empty(&mut map, &camera_at(0.0, 0.0, 0.0), 1.5);
        assert!(right > 0.9, "{right}");
    }

    #[test]
    fn a_wall_that_is_gone_is_forgotten_after_as_many_frames_as_saw_it() {
        let mut map = VoxelMap::default();
        let here = camera_at(0.0, 0.0, 0.0);
        for _ in 0..4 {
            observe(&mut map, &here, 1.5, 0);
        }
        assert!(right_and_empty(&mut map, &here, 1.5).0 > 0.9);
        // The map learns half of the cells of a frame.
        for _ in 0..20 {
            observe(&mut map, &here, 4.0, 0);
        }
        let (old, _) = right_and_empty(&mut map, &here, 1.5);
        let (new, _) = right_and_empty(&mut map, &here, 4.0);
        assert!(old < 0.02 && new > 0.9, "{old} {new}");
    }

    #[test]
    fn a_closed_loop_moves_the_sections_that_it_corrects_and_no_others() {
        let mut map = VoxelMap::default();
        // The map learns half of the cells of a frame.
        for _ in 0..3 {
            observe(&mut map, &camera_at(0.0, 0.0, 0.0), 3.0, 0);
        }
        for _ in 0..3 {
            observe(&mut map, &camera_at(0.0, 0.0, std::f64::consts::PI), -3.0, 1);
        }
        let half_a_meter = Pose2 { x_m: 0.5, y_m: 0.0, yaw_rad: 0.0 };
        map.correct(&[half_a_meter]);
        let (moved, _) = right_and_empty(&mut map, &camera_at(0.5, 0.0, 0.0), 3.5);
        let (stayed, _) =
            right_and_empty(&mut map, &camera_at(0.0, 0.0, std::f64::consts::PI), -3.0);
        assert!(moved > 0.9 && stayed > 0.9, "{moved} {stayed}");
    }

    #[test]
    fn what_is_seen_in_a_moved_section_stays_where_it_is_seen() {
        let mut map = VoxelMap::default();
        map.correct(&[Pose2 { x_m: 0.5, y_m: -0.2, yaw_rad: 0.3 }]);
        let here = camera_at(1.0, 0.2, 0.1);
        for _ in 0..3 {
            observe(&mut map, &here, 3.0, 0);
        }
        let (right, _) = right_and_empty(&mut map, &here, 3.0);
        assert!(right > 0.9, "{right}");
    }

    #[test]
    fn memory_is_bounded_and_the_surfaces_seen_last_are_kept() {
        let mut map = VoxelMap::default();
        for step in 0..400 {
            observe(&mut map, &camera_at(0.0, 2.0 * f64::from(step), 0.0), 2.5, 0);
        }
        assert_eq!(map.slots.len(), VOXELS);
        let (right, _) = right_and_empty(&mut map, &camera_at(0.0, 798.0, 0.0), 2.5);
        assert!(right > 0.4, "{right}");
    }

    #[test]
    fn a_restored_map_recalls_the_same_bits_and_a_cut_one_is_refused() {
        let mut map = VoxelMap::default();
        observe(&mut map, &camera_at(0.0, 0.0, 0.0), 3.0, 0);
        map.correct(&[Pose2 { x_m: 0.1, y_m: 0.0, yaw_rad: 0.0 }]);
        let mut bytes = Vec::new();
        map.write(&mut bytes);
        let mut restored = VoxelMap::default();
        restored.read(&mut bytes.as_slice()).unwrap();
        let here = camera_at(0.2, 0.1, 0.1);
        let expected = map.recall(&here, &cells()).to_vec();
        assert_eq!(restored.recall(&here, &cells()), expected);
        for cut in [0, 7, bytes.len() / 2, bytes.len() - 1] {
            assert!(VoxelMap::default().read(&mut &bytes[..cut]).is_err());
        }
    }

    #[test]
    fn recalled_depth_is_the_same_on_any_number_of_threads() {
        let recalled = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut map = VoxelMap::default();
                for step in 0..5 {
                    observe(&mut map, &camera_at(0.1 * f64::from(step), 0.0, 0.05), 3.0, 0);
                }
                map.recall(&camera_at(0.2, 0.0, 0.0), &cells()).to_vec()
            })
        });
        assert_eq!(recalled[0], recalled[1]);
        assert_eq!(recalled[0], recalled[2]);
    }
}
