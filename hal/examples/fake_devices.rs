//! A fake camera and a fake base, and a loop that polls both: the smallest complete use of `hal`.
//! Copy this file to start a driver for a new device.
//!
//! ```text
//! cargo run -p hal --example fake_devices
//! ```

use core::convert::Infallible;

use hal::{
    Base, Camera, CameraModel, Clock, DriveCommand, ErrorType, Frame, PixelFormat, Pose2, Twist2,
    VirtualClock, WheelFeedback,
};

const PERIOD_NS: u64 = 33_000_000;

/// A camera whose every frame is uniformly grey. A real driver fills a frame on a thread of its
/// own, so that `poll_frame` never waits for the device.
struct FakeCamera {
    model: CameraModel,
    sequence: u32,
}

// A device that cannot fail has no errors. A real driver uses its own error enum and implements
// `hal::Error` for it, so that callers can distinguish an unplugged device from a silent one.
impl ErrorType for FakeCamera {
    type Error = Infallible;
}

impl Camera for FakeCamera {
    fn model(&self) -> &CameraModel {
        &self.model
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, Infallible> {
        self.sequence += 1;
        frame.time_ns = u64::from(self.sequence) * PERIOD_NS;
        frame.sequence = self.sequence;
        frame.width = self.model.width;
        frame.height = self.model.height;
        frame.format = PixelFormat::Gray8;
        frame.data.clear();
        frame.data.resize(frame.width * frame.height, 128);
        Ok(true)
    }
}

/// A base that follows every command at once and without slip.
#[derive(Default)]
struct FakeBase {
    measured: WheelFeedback,
}

impl ErrorType for FakeBase {
    type Error = Infallible;
}

impl Base for FakeBase {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), Infallible> {
        self.measured.twist = command.twist;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Infallible> {
        self.measured.twist = Twist2::ZERO;
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Infallible> {
        let step: Pose2 = self.measured.twist.integrate(PERIOD_NS as f64 * 1e-9);
        self.measured.odom = self.measured.odom.compose(&step);
        self.measured.time_ns += PERIOD_NS;
        Ok(Some(self.measured))
    }
}

fn main() -> Result<(), Infallible> {
    let mut clock = VirtualClock::default();
    let mut camera = FakeCamera { model: CameraModel::pinhole(64, 48, 1.2), sequence: 0 };
    let mut base = FakeBase::default();
    let mut frame = Frame::empty();
    let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.5 };

    for counter in 1..=30 {
        clock.sleep_until_ns(u64::from(counter) * PERIOD_NS);
        base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 })?;
        if camera.poll_frame(&mut frame)? {
            println!("frame {}: {}x{} pixels", frame.sequence, frame.width, frame.height);
        }
        if let Some(measured) = base.poll_feedback()? {
            let Pose2 { x_m, y_m, yaw_rad } = measured.odom;
            println!("odometry: x {x_m:.2} m, y {y_m:.2} m, yaw {yaw_rad:.2} rad");
        }
    }
    base.stop()
}
