//! The exploration loop's devices on a real robot: the monotonic clock and the camera.

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use drivers::fault::{FaultyCamera, FaultyClock};
use drivers::v4l2::V4l2Camera;
use hal::{Camera, Clock, Frame, ImageView};
use monotonic_clock::MonotonicClock;
use runtime::imaging::{FrontEnd, YuvRange};
use runtime::session::Devices;

use crate::config::Config;

/// Clock and camera. Frames are converted to the size that perception works on.
pub struct LiveDevices {
    clock: FaultyClock<MonotonicClock>,
    camera: FaultyCamera<V4l2Camera>,
    front_end: FrontEnd,
    frame: Frame,
    rgb: Vec<u8>,
    problem: Option<String>,
}

impl LiveDevices {
    /// Devices that have not fetched a frame yet.
    ///
    /// # Errors
    /// When the camera's frames cannot be converted to those that perception works on.
    pub fn new(
        config: &Config,
        clock: FaultyClock<MonotonicClock>,
        camera: FaultyCamera<V4l2Camera>,
    ) -> Result<Self> {
        let source = *camera.model();
        let target = config.camera.model();
        let format = config.devices.camera.format.pixels();
        let front_end = FrontEnd::new(source, target, format, YuvRange::Limited).context(
            "[devices.lens] and [camera]: the camera's frames cannot be converted to those that perception works on",
        )?;
        let rgb = vec![0; 3 * target.width * target.height];
        Ok(Self { clock, camera, front_end, frame: Frame::empty(), rgb, problem: None })
    }

    /// The camera's state, and why its latest frame could not be used.
    #[must_use]
    pub fn camera(&self) -> (DeviceStatus, Option<&String>) {
        (self.camera.injector().status(self.camera.inner().status()), self.problem.as_ref())
    }

    fn convert(&mut self) -> Result<(), String> {
        let view = self.frame.view().map_err(|error| error.to_string())?;
        self.front_end.to_rgb(view, &mut self.rgb).map_err(|error| error.to_string())
    }
}

impl Clock for LiveDevices {
    fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.clock.sleep_until_ns(deadline_ns);
    }
}

impl Devices for LiveDevices {
    fn poll_frame(&mut self) -> Option<u64> {
        match self.camera.poll_frame(&mut self.frame) {
            Ok(false) => return None,
            Ok(true) => {}
            Err(error) => {
                self.problem = Some(error.to_string());
                return None;
            }
        }
        self.problem = self.convert().err();
        self.problem.is_none().then_some(self.frame.time_ns)
    }

    fn frame(&self) -> Option<ImageView<'_>> {
        let target = self.front_end.target();
        ImageView::rgb8(target.width, target.height, &self.rgb).ok()
    }
}
