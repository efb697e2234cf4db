//! The exploration loop's devices on a real robot: the monotonic clock, the camera, and an inertial measurement unit if there is one.

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use drivers::fault::{FaultyCamera, FaultyClock, FaultyImu};
use drivers::iio::IioImu;
use drivers::v4l2::V4l2Camera;
use hal::{Camera, Clock, Frame, ImageView, Imu, ImuSample};
use monotonic_clock::MonotonicClock;
use nalgebra::UnitQuaternion;
use runtime::imaging::{FrontEnd, YuvRange};
use runtime::session::Devices;

use crate::config::Config;

/// Clock, camera and inertial unit. Frames are converted to the size that perception works on, samples to the axes of `base_link`.
pub struct LiveDevices<C = FaultyCamera<V4l2Camera>> {
    clock: FaultyClock<MonotonicClock>,
    camera: C,
    front_end: FrontEnd,
    frame: Frame,
    rgb: Vec<u8>,
    problem: Option<String>,
    imu: Option<FaultyImu<IioImu>>,
    imu_rotation: UnitQuaternion<f64>,
}

impl LiveDevices {
    /// The camera's state, and why its latest frame could not be used.
    #[must_use]
    pub fn camera(&self) -> (DeviceStatus, Option<&String>) {
        (self.camera.injector().status(self.camera.inner().status()), self.problem.as_ref())
    }

    /// Whether the robot has an inertial measurement unit.
    #[must_use]
    pub fn has_imu(&self) -> bool {
        self.imu.is_some()
    }
}

impl<C: Camera> LiveDevices<C> {
    /// Devices that have not fetched a frame yet.
    ///
    /// # Errors
    /// When the camera's frames cannot be converted to those that perception works on.
    pub fn new(
        config: &Config,
        clock: FaultyClock<MonotonicClock>,
        camera: C,
        imu: Option<FaultyImu<IioImu>>,
    ) -> Result<Self> {
        let source = *camera.model();
        let target = config.camera.model();
        let format = config.devices.camera.format.pixels();
        let front_end = FrontEnd::new(source, target, format, YuvRange::Limited).context(
            "[devices.lens] and [camera]: the camera's frames cannot be converted to those that perception works on",
        )?;
        let rgb = vec![0; 3 * target.width * target.height];
        Ok(Self {
            clock,
            camera,
            front_end,
            frame: Frame::empty(),
            rgb,
            problem: None,
            imu,
            imu_rotation: config.devices.imu.mount().rotation(),
        })
    }

    fn convert(&mut self) -> Result<(), String> {
        let view = self.frame.view().map_err(|error| error.to_string())?;
        self.front_end.to_rgb(view, &mut self.rgb).map_err(|error| error.to_string())
    }
}

impl<C> Clock for LiveDevices<C> {
    fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.clock.sleep_until_ns(deadline_ns);
    }
}

impl<C: Camera> Devices for LiveDevices<C> {
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

    fn poll_imu(&mut self) -> Option<ImuSample> {
        // What is wrong with the unit is shown by its monitor.
        let sample = self.imu.as_mut()?.poll_sample().ok()??;
        Some(sample.rotated(&self.imu_rotation))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;
    use std::sync::Arc;

    use drivers::fault::Faults;
    use drivers::v4l2::{CameraFormat, V4l2Error};
    use hal::{CameraModel, ErrorType};

    /// The answer to a poll: the time and the bytes of a frame of 16x8 pixels, if there is one.
    type Answer = Result<Option<(u64, Vec<u8>)>, V4l2Error>;

    /// A camera that answers each poll with the next of its answers.
    struct Script {
        model: CameraModel,
        answers: VecDeque<Answer>,
    }

    impl ErrorType for Script {
        type Error = V4l2Error;
    }

    impl Camera for Script {
        fn model(&self) -> &CameraModel {
            &self.model
        }

        fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, V4l2Error> {
            let answer = self.answers.pop_front().unwrap()?;
            let Some((time_ns, data)) = answer else { return Ok(false) };
            *frame = Frame { time_ns, width: 16, height: 8, data, ..Frame::empty() };
            Ok(true)
        }
    }

    #[test]
    fn only_a_frame_that_came_and_could_be_converted_counts_as_new() {
        let mut config = Config::default();
        config.camera.width = 16;
        config.camera.height = 8;
        config.devices.camera.format = CameraFormat::Rgb24;
        let model = config.camera.model();
        let answers = [
            Ok(Some((1, vec![10; 3 * 16 * 8]))),
            Ok(None),
            Err(V4l2Error::Denied { device: "/dev/video0".into() }),
            Ok(Some((2, vec![20; 7]))),
            Ok(Some((3, vec![30; 3 * 16 * 8]))),
        ];
        let script = Script { model, answers: answers.into() };
        let faults = Faults::new(Vec::new(), 1, Arc::new(|| 0));
        let clock = FaultyClock::new(MonotonicClock, &faults);
        let mut devices = LiveDevices::new(&config, clock, script, None).unwrap();
        let mut problems = Vec::new();
        let times = [(); 5].map(|()| {
            let time_ns = devices.poll_frame();
            problems.push(devices.problem.is_some());
            time_ns
        });
        assert_eq!(times, [Some(1), None, None, None, Some(3)]);
        assert_eq!(problems, [false, false, true, true, false]);
        assert_eq!(devices.frame().unwrap().data()[0], 30);
    }
}
