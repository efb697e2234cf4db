//! Seeded random faults of all devices, far more frequent than on a real robot.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::LiveWorld;
use crate::hokuyo::WireFaults;

/// Time without faults between two faults, seconds.
const QUIET_S: std::ops::Range<f64> = 6.0..14.0;

/// Faults and their durations, seconds. A motor controller that falls silent or restarts is not among
/// them, because it needs a person by design.
const KINDS: [(&str, std::ops::Range<f64>); 5] = [
    ("the scanner is unplugged", 0.5..3.0),
    ("the scanner restarts", 0.1..0.2),
    ("bits flip on the scanner's wire", 1.0..4.0),
    ("the scanner's motor stops", 0.5..2.0),
    ("the camera is unplugged", 0.5..4.0),
];

/// Injects one fault after another.
pub(super) struct RandomFaults {
    rng: Pcg64Mcg,
    due_s: f64,
    now: Option<(usize, f64)>,
    count: u64,
}

impl RandomFaults {
    pub fn new(seed: u64) -> Self {
        Self { rng: Pcg64Mcg::seed_from_u64(seed), due_s: 12.0, now: None, count: 0 }
    }

    /// Number of faults so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Begins and ends faults. Returns a message when something changed.
    pub fn update(&mut self, time_s: f64, world: &LiveWorld) -> std::io::Result<Option<String>> {
        match self.now {
            Some((kind, until_s)) if time_s >= until_s => {
                self.now = None;
                self.due_s = time_s + self.rng.random_range(QUIET_S);
                end(kind, world)?;
                Ok(Some(format!("over: {}", KINDS[kind].0)))
            }
            None if time_s >= self.due_s => {
                let kind = self.rng.random_range(0..KINDS.len());
                let (description, span) = &KINDS[kind];
                self.now = Some((kind, time_s + self.rng.random_range(span.clone())));
                self.count += 1;
                begin(kind, world);
                Ok(Some((*description).to_owned()))
            }
            _ => Ok(None),
        }
    }
}

fn begin(kind: usize, world: &LiveWorld) {
    let lidar = world.lidar();
    match kind {
        0 => lidar.unplug(),
        1 => lidar.reboot(1_000_000_000),
        2 => lidar.set_wire(WireFaults { flip_share: 0.3, ..WireFaults::default() }),
        3 => lidar.break_motor(true),
        _ => world.plug_camera(false),
    }
}

fn end(kind: usize, world: &LiveWorld) -> std::io::Result<()> {
    let lidar = world.lidar();
    match kind {
        0 => return lidar.plug_in(),
        2 => lidar.set_wire(WireFaults::default()),
        3 => lidar.break_motor(false),
        4 => world.plug_camera(true),
        // The restart ends automatically.
        _ => {}
    }
    Ok(())
}
