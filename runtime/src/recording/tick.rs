//! A tick of the loop that owns its data.

use hal::{DepthMap, ImageView, LaserScan, PixelFormat, Pose2, WheelFeedback};

use super::RecordingError;
use crate::imu::ImuInput;
use crate::operator::OperatorOrder;
use crate::outside_pose::OutsideInput;
use crate::task::{AreaChange, Task};
use crate::tick::{Decision, SafetyReport, TickInput};

/// An RGB8 image that owns its bytes.
#[derive(Debug, Clone, PartialEq)]
pub struct RgbImage {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Row-major, three bytes a pixel.
    pub rgb: Vec<u8>,
}

/// A [`TickInput`] that owns its parts, with the decision.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedTick {
    /// Counts up from 0.
    pub tick: u64,
    /// The tick's time, monotonic.
    pub time_ns: u64,
    /// Wheel feedback at the time of `frame`.
    pub wheel: WheelFeedback,
    /// The scan nearest to the frame in time, if it is a new one.
    pub scan: Option<LaserScan>,
    /// `t_odom_base` when the scanner was halfway through `scan`.
    pub scan_odom: Pose2,
    /// Rotation and tilt by the inertial measurement unit.
    pub imu: Option<ImuInput>,
    /// The newest pose that another program has sent since the previous tick.
    pub outside: Option<OutsideInput>,
    /// A new image, if one arrived.
    pub frame: Option<RgbImage>,
    /// Ground-truth depth of `frame`, with the depth source `truth`. Whole millimetres.
    pub truth: Option<DepthMap>,
    /// What the operator asked for.
    pub task: Option<Task>,
    /// Areas that the operator closed or opened.
    pub areas: Vec<AreaChange>,
    /// The orders that came since the previous tick.
    pub orders: Vec<OperatorOrder>,
    /// What the safety loop did since the previous tick, with every command that it sent.
    pub safety: SafetyReport,
    /// The decision; `None` in a tick that was recorded without one.
    pub decision: Option<Decision>,
    /// The loop's memory before this tick, from [`Robot::snapshot`](crate::robot::Robot::snapshot). The recorder adds one at
    /// intervals, so that a replay can begin there.
    pub snapshot: Option<Vec<u8>>,
}

impl RecordedTick {
    /// A tick with wheel feedback only.
    #[must_use]
    pub fn new(tick: u64, time_ns: u64) -> Self {
        Self {
            tick,
            time_ns,
            wheel: WheelFeedback { time_ns, ..WheelFeedback::default() },
            scan: None,
            scan_odom: Pose2::IDENTITY,
            imu: None,
            outside: None,
            frame: None,
            truth: None,
            task: None,
            areas: Vec::new(),
            orders: Vec::new(),
            safety: SafetyReport::default(),
            decision: None,
            snapshot: None,
        }
    }

    /// Copies the input of a tick.
    ///
    /// # Errors
    /// [`FrameFormat`](RecordingError::FrameFormat) for an image that is not RGB8.
    pub fn capture(
        input: &TickInput<'_>,
        decision: Option<Decision>,
    ) -> Result<Self, RecordingError> {
        let frame = input.frame.map(|view| match view.format() {
            PixelFormat::Rgb8 => Ok(RgbImage {
                width: view.width(),
                height: view.height(),
                rgb: view.data().to_vec(),
            }),
            format => Err(RecordingError::FrameFormat { tick: input.tick, format }),
        });
        Ok(Self {
            tick: input.tick,
            time_ns: input.time_ns,
            wheel: input.wheel,
            scan: input.scan.cloned(),
            scan_odom: input.scan_odom,
            imu: input.imu,
            outside: input.outside,
            frame: frame.transpose()?,
            truth: input.truth.cloned(),
            task: input.task,
            areas: input.areas.to_vec(),
            orders: input.orders.to_vec(),
            safety: input.safety.clone(),
            decision,
            snapshot: None,
        })
    }

    /// Where localization believed the robot to be, in `odom`: smooth, for what compares neighbouring frames. By wheel odometry
    /// alone where the tick has no decision.
    #[must_use]
    pub fn t_odom_base(&self) -> Pose2 {
        self.decision.as_ref().map_or(self.wheel.odom, |decision| decision.t_odom_base)
    }

    /// The same when the frame was exposed: the pose of the frame.
    #[must_use]
    pub fn t_odom_base_at_frame(&self) -> Pose2 {
        self.decision.as_ref().map_or(self.wheel.odom, |decision| decision.t_odom_base_at_frame)
    }

    /// Where localization believed the robot to be when the frame was exposed, in `map`.
    #[must_use]
    pub fn t_map_base_at_frame(&self) -> Pose2 {
        self.decision.as_ref().map_or(self.wheel.odom, Decision::t_map_base_at_frame)
    }

    /// Where localization believed the robot to be, in `map`: for what compares places. By wheel odometry alone where the tick
    /// has no decision.
    #[must_use]
    pub fn t_map_base(&self) -> Pose2 {
        self.decision.as_ref().map_or(self.wheel.odom, Decision::t_map_base)
    }

    /// The tick's input in the form that the loop takes.
    ///
    /// # Errors
    /// [`Frame`](RecordingError::Frame) when the image's bytes do not fit its size.
    pub fn input(&self) -> Result<TickInput<'_>, RecordingError> {
        let frame =
            self.frame.as_ref().map(|image| ImageView::rgb8(image.width, image.height, &image.rgb));
        Ok(TickInput {
            tick: self.tick,
            time_ns: self.time_ns,
            wheel: self.wheel,
            scan: self.scan.as_ref(),
            scan_odom: self.scan_odom,
            imu: self.imu,
            outside: self.outside,
            frame: frame
                .transpose()
                .map_err(|source| RecordingError::Frame { tick: self.tick, source })?,
            truth: self.truth.as_ref(),
            task: self.task,
            areas: &self.areas,
            orders: &self.orders,
            safety: &self.safety,
        })
    }
}
