//! The robot as its software sees it.

use std::sync::{Arc, Mutex};

use hal::{
    Base, Camera, CameraModel, Clock, DriveCommand, ErrorKind, ErrorType, Frame, LaserScan, Lidar, ScanGeometry,
};
use hal::{Twist2, WheelFeedback};

use super::body::Body;
use super::lock;

/// Handles to the devices of one robot.
#[derive(Debug)]
pub struct Devices {
    /// Renders when it is polled at a new time.
    pub camera: SimCamera,
    /// Has a scan when its period has passed.
    pub lidar: SimLidar,
    /// Moves while the clock runs.
    pub base: SimBase,
    /// The only thing that lets time pass.
    pub clock: SimClock,
}

impl Devices {
    pub(super) fn new(body: &Arc<Mutex<Body>>) -> Self {
        let (model, geometry) = {
            let body = lock(body);
            (body.options.camera, body.options.laser.geometry)
        };
        Self {
            camera: SimCamera { body: Arc::clone(body), model },
            lidar: SimLidar { body: Arc::clone(body), geometry },
            base: SimBase { body: Arc::clone(body) },
            clock: SimClock { body: Arc::clone(body) },
        }
    }
}

/// What a simulated device refuses.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// A command with a number that is none.
    #[error(
        "the drive command ({linear_mps} m/s, {angular_radps} rad/s) is not finite; the base keeps its last command"
    )]
    NotFinite {
        /// Wanted forward speed.
        linear_mps: f64,
        /// Wanted turn rate.
        angular_radps: f64,
    },
}

impl hal::Error for DeviceError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::NotFinite { .. } => ErrorKind::Rejected,
        }
    }
}

/// The camera. A frame shows the moment at which it is polled.
#[derive(Debug)]
pub struct SimCamera {
    body: Arc<Mutex<Body>>,
    model: CameraModel,
}

impl ErrorType for SimCamera {
    type Error = DeviceError;
}

impl Camera for SimCamera {
    fn model(&self) -> &CameraModel {
        &self.model
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, DeviceError> {
        Ok(lock(&self.body).photograph(frame))
    }
}

/// The laser scanner. A scan is taken at the moment at which it is polled, at most once a period.
#[derive(Debug)]
pub struct SimLidar {
    body: Arc<Mutex<Body>>,
    geometry: ScanGeometry,
}

impl ErrorType for SimLidar {
    type Error = DeviceError;
}

impl Lidar for SimLidar {
    fn geometry(&self) -> ScanGeometry {
        self.geometry
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, DeviceError> {
        Ok(lock(&self.body).scan(scan))
    }
}

/// The drive base. Reaches a commanded velocity at once and holds it until its watchdog stops it.
#[derive(Debug)]
pub struct SimBase {
    body: Arc<Mutex<Body>>,
}

impl ErrorType for SimBase {
    type Error = DeviceError;
}

impl Base for SimBase {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), DeviceError> {
        let Twist2 { linear_mps, angular_radps } = command.twist;
        if !command.twist.is_finite() {
            return Err(DeviceError::NotFinite { linear_mps, angular_radps });
        }
        lock(&self.body).command(command);
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DeviceError> {
        lock(&self.body).stop();
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, DeviceError> {
        Ok(lock(&self.body).feedback())
    }
}

/// Virtual time: sleeping computes what happens meanwhile and returns.
#[derive(Debug, Clone)]
pub struct SimClock {
    body: Arc<Mutex<Body>>,
}

impl Clock for SimClock {
    fn now_ns(&self) -> u64 {
        lock(&self.body).now_ns
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        lock(&self.body).advance_to(deadline_ns);
    }
}
