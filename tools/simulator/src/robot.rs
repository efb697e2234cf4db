//! A robot in a world, behind the hal traits, in virtual time.
//!
//! ```no_run
//! # use std::sync::Arc;
//! # use simulator::{robot::{RobotOptions, SimulatedRobot}, world::{OpenOptions, World}};
//! # use hal::{Base, Camera, Clock, DriveCommand, Frame, Twist2};
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! let world = Arc::new(World::open("builtin:house?seed=3", &OpenOptions::default())?);
//! let robot = SimulatedRobot::new(world, RobotOptions::default())?;
//! let (mut devices, truth) = (robot.devices(), robot.truth());
//! let twist = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
//! devices.base.drive(&DriveCommand { twist, counter: 0, plan_age_ns: 0 })?;
//! devices.clock.sleep_until_ns(100_000_000);
//! let mut frame = Frame::empty();
//! devices.camera.poll_frame(&mut frame)?;
//! println!("the robot is really at {:?}", truth.pose());
//! # Ok(())
//! # }
//! ```

mod body;
mod devices;
mod options;
#[cfg(test)]
mod tests;
mod truth;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

pub use devices::{DeviceError, Devices, SimBase, SimCamera, SimClock, SimLidar};
pub use options::RobotOptions;
pub use truth::Truth;

use self::body::Body;
use crate::error::SceneError;
use crate::world::World;

/// A robot in a world. Hands out its devices, and apart from them the truth.
///
/// The same world, options and calls give the same bytes, on any number of threads.
#[derive(Debug)]
pub struct SimulatedRobot {
    body: Arc<Mutex<Body>>,
}

impl SimulatedRobot {
    /// Puts a robot at `options.start`, or at a place that `options.seed` chooses, standing still at time 0.
    ///
    /// # Errors
    /// When an option is outside its range or the robot cannot stand at its start.
    pub fn new(world: Arc<World>, options: RobotOptions) -> Result<Self, SceneError> {
        Ok(Self { body: Arc::new(Mutex::new(Body::new(world, options)?)) })
    }

    /// The robot's devices. Several handles of one kind share its state: a frame is handed out once.
    #[must_use]
    pub fn devices(&self) -> Devices {
        Devices::new(&self.body)
    }

    /// What really happens. For evaluation, never for the robot.
    #[must_use]
    pub fn truth(&self) -> Truth {
        Truth::new(Arc::clone(&self.body))
    }
}

/// Nothing is left half-done by a panic in another thread: every method leaves a whole state behind.
fn lock(body: &Mutex<Body>) -> MutexGuard<'_, Body> {
    body.lock().unwrap_or_else(PoisonError::into_inner)
}
