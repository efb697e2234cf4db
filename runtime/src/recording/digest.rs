//! Digests of a run: two runs with the same digests have the same inputs and the same decisions.

use blake3::Hasher;
use hal::{DepthMap, ImageView, LaserScan, Pose2, Range, WheelFeedback};

use crate::imu::ImuInput;
use crate::outside_pose::OutsideInput;
use crate::tick::{Decision, SafetyReport, TickInput};

/// BLAKE3 over a run's inputs and over its decisions, in a canonical form that does not depend on the recording's
/// compression or on how it is divided into segments.
#[derive(Debug, Clone, Default)]
pub struct RunDigest {
    inputs: Hasher,
    decisions: Hasher,
}

impl RunDigest {
    /// The digest of a run without ticks.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds the input of the next tick.
    pub fn add_input(&mut self, input: &TickInput<'_>) {
        hash_input(&mut self.inputs, input);
    }

    /// Adds the decision of the next tick: its JSON, which holds every number exactly, with its length before it.
    pub fn add_decision(&mut self, decision: &Decision) {
        // Cannot fail: a `Decision` has neither maps with other keys than text nor serializers that fail. The length
        // that is hashed before the text would count an empty text as a tick as well.
        let json = serde_json::to_vec(decision).unwrap_or_default();
        self.decisions.update(&(json.len() as u64).to_le_bytes()).update(&json);
    }

    /// The digest of all inputs so far, in hex.
    #[must_use]
    pub fn inputs(&self) -> String {
        self.inputs.finalize().to_hex().to_string()
    }

    /// The digest of all decisions so far, in hex. This is the `digest` of a run's summary.
    #[must_use]
    pub fn decisions(&self) -> String {
        self.decisions.finalize().to_hex().to_string()
    }
}

/// First 8 bytes of the digest of one tick's input, little-endian.
#[must_use]
pub fn input_digest(input: &TickInput<'_>) -> u64 {
    let mut hasher = Hasher::new();
    hash_input(&mut hasher, input);
    let mut first = [0; 8];
    first.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
    u64::from_le_bytes(first)
}

/// All numbers are hashed in little-endian order, floats as their bits. A byte before every optional part says whether
/// the part is present.
fn hash_input(hasher: &mut Hasher, input: &TickInput<'_>) {
    hasher.update(&input.tick.to_le_bytes()).update(&input.time_ns.to_le_bytes());
    hash_wheel(hasher, &input.wheel);
    hasher.update(&[u8::from(input.scan.is_some())]);
    if let Some(scan) = input.scan {
        hash_scan(hasher, scan);
    }
    hasher.update(&[u8::from(input.frame.is_some())]);
    if let Some(frame) = input.frame {
        hash_frame(hasher, &frame);
    }
    hasher.update(&[u8::from(input.truth.is_some())]);
    if let Some(truth) = input.truth {
        hash_depth(hasher, truth);
    }
    hash_pose(hasher, &input.scan_odom);
    hash_safety(hasher, input.safety);
    // Recordings from before there were inertial measurement units keep their digests.
    if let Some(imu) = &input.imu {
        hash_imu(hasher, imu);
    }
    // Recordings from before there were poses from outside keep their digests.
    if let Some(OutsideInput { outside, wheel_odom }) = &input.outside {
        hasher.update(&outside.time_ns.to_le_bytes());
        hash_pose(hasher, &outside.pose);
        hash_pose(hasher, wheel_odom);
    }
    // Recordings from before there were tasks keep their digests.
    if let Some(task) = &input.task {
        // The text as it is recorded. Its numbers are exact.
        hasher.update(serde_json::to_string(task).unwrap_or_default().as_bytes());
    }
    for change in input.areas {
        hasher.update(serde_json::to_string(change).unwrap_or_default().as_bytes());
    }
    for order in input.orders {
        hasher.update(serde_json::to_string(order).unwrap_or_default().as_bytes());
    }
}

fn hash_safety(hasher: &mut Hasher, safety: &SafetyReport) {
    hasher.update(&[1, u8::from(safety.in_charge), u8::from(safety.blocked_m.is_some())]);
    for value in safety.blocked_m.into_iter().flatten() {
        hasher.update(&value.to_bits().to_le_bytes());
    }
    // Recordings from before places could be unseen keep their digests.
    for value in safety.unseen_m.into_iter().flatten() {
        hasher.update(b"unseen").update(&value.to_bits().to_le_bytes());
    }
    hasher.update(&(safety.events.len() as u64).to_le_bytes());
    for event in &safety.events {
        // The text as it is recorded. Its numbers are exact.
        hasher.update(serde_json::to_string(event).unwrap_or_default().as_bytes());
    }
    hasher.update(&(safety.sent.len() as u64).to_le_bytes());
    for sent in &safety.sent {
        // Counters are 32 bits wide; a stop has none.
        let counter = sent.counter.map_or(u64::MAX, u64::from);
        hasher.update(&sent.time_ns.to_le_bytes()).update(&counter.to_le_bytes());
        hasher.update(&sent.linear_mps.to_bits().to_le_bytes());
        hasher.update(&sent.angular_radps.to_bits().to_le_bytes());
    }
    hasher.update(&safety.sent_dropped.to_le_bytes());
}

fn hash_pose(hasher: &mut Hasher, pose: &Pose2) {
    for value in [pose.x_m, pose.y_m, pose.yaw_rad] {
        hasher.update(&value.to_bits().to_le_bytes());
    }
}

fn hash_imu(hasher: &mut Hasher, imu: &ImuInput) {
    hasher.update(b"imu").update(&imu.gaps.to_le_bytes());
    hasher.update(&imu.yaw_rad.to_bits().to_le_bytes());
    hasher.update(&imu.yaw_at_scan_rad.to_bits().to_le_bytes());
    if let Some(tilt_rad) = imu.tilt_rad {
        hasher.update(&tilt_rad.to_bits().to_le_bytes());
    }
}

fn hash_wheel(hasher: &mut Hasher, wheel: &WheelFeedback) {
    hasher.update(&wheel.time_ns.to_le_bytes());
    hash_pose(hasher, &wheel.odom);
    hasher.update(&wheel.twist.linear_mps.to_bits().to_le_bytes());
    hasher.update(&wheel.twist.angular_radps.to_bits().to_le_bytes());
    hasher.update(&[u8::from(wheel.contact) | u8::from(wheel.cliff) << 1]);
}

fn hash_scan(hasher: &mut Hasher, scan: &LaserScan) {
    let geometry = &scan.geometry;
    hasher.update(&scan.time_ns.to_le_bytes());
    hasher.update(&geometry.angle_min_rad.to_bits().to_le_bytes());
    hasher.update(&geometry.angle_increment_rad.to_bits().to_le_bytes());
    hasher.update(&(geometry.beams as u64).to_le_bytes());
    hasher.update(&geometry.range_min_m.to_bits().to_le_bytes());
    hasher.update(&geometry.range_max_m.to_bits().to_le_bytes());
    hasher.update(&geometry.period_ns.to_le_bytes());
    // Digests of recordings that are older than this property stay as they are.
    if geometry.clockwise {
        hasher.update(&[1]);
    }
    hasher.update(&(scan.ranges.len() as u64).to_le_bytes());
    for range in &scan.ranges {
        let (tag, bits) = match range {
            Range::Hit(distance_m) => (0u8, distance_m.to_bits()),
            Range::NoReturn => (1, 0),
            Range::TooNear => (2, 0),
            Range::Error => (3, 0),
        };
        hasher.update(&[tag]).update(&bits.to_le_bytes());
    }
}

fn hash_frame(hasher: &mut Hasher, frame: &ImageView<'_>) {
    hasher
        .update(&(frame.width() as u64).to_le_bytes())
        .update(&(frame.height() as u64).to_le_bytes());
    hasher.update(&(frame.data().len() as u64).to_le_bytes()).update(frame.data());
}

fn hash_depth(hasher: &mut Hasher, depth: &DepthMap) {
    hasher
        .update(&(depth.width() as u64).to_le_bytes())
        .update(&(depth.height() as u64).to_le_bytes());
    for row in depth.values().chunks(depth.width().max(1)) {
        let bytes: Vec<u8> = row.iter().flat_map(|value| value.to_bits().to_le_bytes()).collect();
        hasher.update(&bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::some_tick;
    use super::*;

    fn inputs(tick: &super::super::RecordedTick) -> String {
        let mut digest = RunDigest::new();
        digest.add_input(&tick.input().unwrap());
        digest.inputs()
    }

    #[test]
    fn one_changed_bit_anywhere_changes_the_digest() {
        let tick = some_tick(3);
        let original = inputs(&tick);
        assert_eq!(original, inputs(&tick.clone()));
        let mut changed = vec![tick.clone(); 5];
        changed[0].wheel.odom.x_m += 1e-9;
        changed[1].frame.as_mut().unwrap().rgb[7] ^= 1;
        changed[2].scan.as_mut().unwrap().ranges[1] = Range::Error;
        changed[3].truth.as_mut().unwrap().values_mut()[0] += 0.001;
        changed[4].scan = None;
        for tick in changed {
            assert_ne!(inputs(&tick), original);
        }
    }

    #[test]
    fn minus_zero_is_not_zero() {
        let mut tick = some_tick(3);
        tick.wheel.odom.x_m = 0.0;
        let zero = inputs(&tick);
        tick.wheel.odom.x_m = -0.0;
        assert_ne!(inputs(&tick), zero);
    }
}
