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
use super::sweep::nearest;
use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Number of voxels that are kept: 2.6 MiB. A home of 100 m2 has about 400 m2 of surfaces, of which most are seen from 4 m and more.
const VOXELS: usize = 1 << 16;
/// A voxel may lie in any of this many neighbouring slots; when all are taken, the one that was seen longest ago is replaced.
const WAYS: usize = 4;
/// Edge of the smallest voxel, metres. The edge doubles with every doubling of the distance beyond [`FINE_M`], so that a voxel has
/// about the size of a cell of the image.
const EDGE_M: f32 = 0.05;
/// Surfaces nearer than this are kept in the smallest voxels, metres.
const FINE_M: f32 = 3.0;
/// Number of sizes of voxels.
const LEVELS: u32 = 4;
/// Further looks at a voxel replace older ones, so that a thing that was moved is forgotten after some looks.
const MOST_LOOKS: f32 = 24.0;
/// Surfaces are not recalled beyond this distance, metres.
const FAR_M: f32 = 20.0;
/// Surfaces nearer than this are not recalled, metres: one voxel would fill the image.
const NEAR_M: f32 = 0.15;
/// A voxel covers at most this many cells to each side of its own.
const MOST_REACH: i32 = 3;

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
    /// Sum of the confidence of the looks that saw the surface, less that of the looks that saw through it.
    evidence: f32,
    /// Number of looks.
    looks: f32,
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
    looks: f32,
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
    recalled: Vec<Recalled>,
    beliefs: Vec<Belief>,
}

impl Default for VoxelMap {
    fn default() -> Self {
        Self {
            slots: vec![Voxel::zeroed(); VOXELS],
            moved: Vec::new(),
            frames: 0,
            recalled: Vec::new(),
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
    /// voxels. Confidence and age are those of the looks that saw it.
    pub fn recall(&mut self, t_map_camera: &Pose3, cells: &CameraModel) -> &[Belief] {
        self.recalled.clear();
        self.recalled.resize(cells.width * cells.height, Recalled::default());
        let views: Vec<View> = (0..=self.moved.len())
            .map(|section| {
                let moved = self.moved.get(section).copied().unwrap_or(Pose2::IDENTITY);
                View::new(&(t_map_camera.inverse() * moved.to_pose3()))
            })
            .collect();
        let last = views.len() - 1;
        for (slot, voxel) in self.slots.iter().enumerate().filter(|(_, voxel)| voxel.key != 0) {
            let view = &views[section_of(voxel.key).min(last)];
            let [x, y, z] = view.transform(voxel.point_m);
            if z > NEAR_M && z < FAR_M {
                splat(&mut self.recalled, cells, voxel, slot, [x / z, y / z, 1.0 / z]);
            }
        }
        self.beliefs.clear();
        self.beliefs.extend(self.recalled.iter().map(Recalled::belief));
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
        for cell in 0..seen.beliefs.len().min(self.recalled.len()) {
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
            self.add(back.transform([x * z, y * z, z]), z, confidence, section);
        }
    }

    /// The frame saw a surface farther than the recalled one.
    fn weaken(&mut self, cell: usize, inverse_depth: f32, confidence: f32) {
        let recalled = self.recalled[cell];
        if recalled.slot == 0 || inverse_depth * (1.0 + 2.0 * AGREEMENT) > recalled.nearest {
            return;
        }
        let voxel = &mut self.slots[recalled.slot as usize - 1];
        voxel.evidence -= confidence;
        voxel.looks += 1.0;
        if voxel.evidence <= 0.0 {
            *voxel = Voxel::zeroed();
        }
    }

    fn add(&mut self, point_m: [f32; 3], z: f32, confidence: f32, section: u16) {
        let level = ((z / FINE_M).max(1.0).log2().ceil() as u32).min(LEVELS - 1);
        let edge_m = EDGE_M * (1 << level) as f32;
        let key = key_of(point_m.map(|value| (value / edge_m).floor() as i32), level, section);
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
        // Several cells of one frame are one look.
        if voxel.seen == self.frames && found.is_some() {
            return;
        }
        voxel.seen = self.frames;
        voxel.evidence += confidence;
        voxel.looks += 1.0;
        if voxel.looks > MOST_LOOKS {
            let keep = MOST_LOOKS / voxel.looks;
            voxel.looks *= keep;
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
            votes: self.looks,
            offset: [0.0; 2],
        }
    }
}

/// A transform in single precision.
struct View {
    rows: [[f32; 4]; 3],
}

impl View {
    fn new(pose: &Pose3) -> Self {
        let matrix = pose.to_homogeneous();
        let row = |row: usize| [0, 1, 2, 3].map(|column| matrix[(row, column)] as f32);
        Self { rows: [row(0), row(1), row(2)] }
    }

    #[inline(always)]
    fn transform(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        self.rows.map(|row| row[0] * x + row[1] * y + row[2] * z + row[3])
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
    let edge_m = EDGE_M * (1 << level_of(voxel.key)) as f32;
    let reach = (0.5 * edge_m * cells.fx as f32 * w) as i32;
    let reach = reach.min(MOST_REACH);
    let column = nearest(u);
    let row = nearest(v);
    let width = cells.width as i32;
    let height = cells.height as i32;
    if column + reach < 0 || column - reach >= width || row + reach < 0 || row - reach >= height {
        return;
    }
    for row in (row - reach).max(0)..=(row + reach).min(height - 1) {
        for column in (column - reach).max(0)..=(column + reach).min(width - 1) {
            recalled[(row * width + column) as usize].add(voxel, slot, w);
        }
    }
}

impl Recalled {
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
        if voxel.looks > self.looks {
            self.looks = voxel.looks;
            self.evidence = voxel.evidence;
        }
    }
}

/// A key has 12 bits of section, 3 of level, 17 of x and y each and 14 of z, and a bit that is always set.
fn key_of([x, y, z]: [i32; 3], level: u32, section: u16) -> u64 {
    let bits = |value: i32, bits: u32| u64::from(value as u32) & ((1 << bits) - 1);
    let place = bits(x, 17) | bits(y, 17) << 17 | bits(z, 14) << 34;
    place | u64::from(level) << 48 | u64::from(section & 0xFFF) << 51 | 1 << 63
}

fn section_of(key: u64) -> usize {
    (key >> 51) as usize & 0xFFF
}

fn level_of(key: u64) -> u32 {
    (key >> 48) as u32 & 7
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
