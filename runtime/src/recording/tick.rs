//! One turn of the loop with its own memory.

use hal::{DepthMap, ImageView, LaserScan, PixelFormat, Pose2, WheelFeedback};

use super::RecordingError;
use crate::tick::{Decision, SafetyReport, TickInput};

/// An RGB8 picture with its own memory.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Row-major, three bytes a pixel.
    pub rgb: Vec<u8>,
}

/// A [`TickInput`] that owns its parts, and what was decided on it.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedTick {
    /// Counts up from 0.
    pub tick: u64,
    /// The turn's time, monotonic.
    pub time_ns: u64,
    /// What the base measured.
    pub wheel: WheelFeedback,
    /// A new scan, if one came.
    pub scan: Option<LaserScan>,
    /// `t_odom_base` when the scanner was halfway through `scan`.
    pub scan_odom: Pose2,
    /// A new picture, if one came.
    pub frame: Option<Picture>,
    /// Ground-truth depth of `frame`, with the depth source `truth`. Whole millimetres.
    pub truth: Option<DepthMap>,
    /// What the safety loop did since the previous tick, with every command that it sent.
    pub safety: SafetyReport,
    /// What the loop decided.
    pub decision: Option<Decision>,
    /// What the loop remembered before this turn, [`Robot::snapshot`](crate::robot::Robot::snapshot): now and then, so that a
    /// replay need not begin at the run's beginning.
    pub snapshot: Option<Vec<u8>>,
}

impl RecordedTick {
    /// A turn in which only the wheels said something.
    #[must_use]
    pub fn new(tick: u64, time_ns: u64) -> Self {
        Self {
            tick,
            time_ns,
            wheel: WheelFeedback { time_ns, ..WheelFeedback::default() },
            scan: None,
            scan_odom: Pose2::IDENTITY,
            frame: None,
            truth: None,
            safety: SafetyReport::default(),
            decision: None,
            snapshot: None,
        }
    }

    /// Copies a turn.
    ///
    /// # Errors
    /// [`FrameFormat`](RecordingError::FrameFormat) for a picture that is not RGB8.
    pub fn capture(
        input: &TickInput<'_>,
        decision: Option<Decision>,
    ) -> Result<Self, RecordingError> {
        let frame = input.frame.map(|view| match view.format() {
            PixelFormat::Rgb8 => Ok(Picture {
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
            frame: frame.transpose()?,
            truth: input.truth.cloned(),
            safety: input.safety.clone(),
            decision,
            snapshot: None,
        })
    }

    /// The turn's input as the loop takes it.
    ///
    /// # Errors
    /// [`Frame`](RecordingError::Frame) when the picture's bytes do not fit its size.
    pub fn input(&self) -> Result<TickInput<'_>, RecordingError> {
        let frame = self
            .frame
            .as_ref()
            .map(|picture| ImageView::rgb8(picture.width, picture.height, &picture.rgb));
        Ok(TickInput {
            tick: self.tick,
            time_ns: self.time_ns,
            wheel: self.wheel,
            scan: self.scan.as_ref(),
            scan_odom: self.scan_odom,
            frame: frame
                .transpose()
                .map_err(|source| RecordingError::Frame { tick: self.tick, source })?,
            truth: self.truth.as_ref(),
            safety: &self.safety,
        })
    }
}
