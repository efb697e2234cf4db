//! A simulated camera: formats, frame interval and controls around the queue. It has no transport:
//! [`FakeCamera`](super::FakeCamera) provides it in this process, [`serve`](super::serve) to
//! another one.

use drivers::v4l2::node::{Capability, Control, FourCc, Interval, Layout, NEXT_CONTROL};
use rustix::io::Errno;

use super::queue::Queue;

/// Properties and state of a simulated camera.
#[derive(Debug, Clone)]
pub struct Device {
    /// Whether the camera has the multi-planar interface instead of the single-planar one.
    pub multiplanar: bool,
    pub formats: Vec<FourCc>,
    /// Supported sizes. For another size the nearest in area is used.
    pub sizes: Vec<(u32, u32)>,
    /// Maximum frame rate, Hz.
    pub fastest: u32,
    /// Padding at the end of every row, bytes.
    pub row_padding: u32,
    /// Controls and their values.
    pub controls: Vec<(Control, i32)>,
    pub queue: Queue,
    pub layout: Layout,
    pub interval: Interval,
}

impl Default for Device {
    /// The properties of a typical USB camera.
    fn default() -> Self {
        Self {
            multiplanar: false,
            formats: vec![FourCc::YUYV, FourCc::MJPEG, FourCc::NV12, FourCc::RGB24],
            sizes: vec![(64, 48), (320, 240), (640, 192), (640, 480), (1280, 720)],
            fastest: 120,
            row_padding: 0,
            // Ids, names and ranges are those of uvcvideo.
            controls: vec![
                control(0x0098_090c, "White Balance, Automatic", 0, 1, 1, 1),
                control(0x0098_0913, "Gain", 0, 100, 5, 50),
                control(0x0098_091a, "White Balance Temperature", 2800, 6500, 1, 4600),
                control(0x009a_0901, "Auto Exposure", 0, 3, 1, 3),
                control(0x009a_0902, "Exposure Time, Absolute", 3, 2047, 1, 250),
            ],
            queue: Queue::default(),
            layout: Layout {
                width: 640,
                height: 480,
                format: FourCc::YUYV,
                stride: 1280,
                size: 614_400,
                planes: 1,
            },
            interval: Interval { numerator: 1, denominator: 30 },
        }
    }
}

fn control(
    id: u32,
    name: &str,
    minimum: i32,
    maximum: i32,
    step: i32,
    value: i32,
) -> (Control, i32) {
    (Control { id, name: name.to_owned(), minimum, maximum, step, disabled: false }, value)
}

impl Device {
    /// The answer to `VIDIOC_QUERYCAP`: what the device can do.
    #[must_use]
    pub fn capability(&self) -> Capability {
        Capability { capture: !self.multiplanar, capture_planes: self.multiplanar, streaming: true }
    }

    /// `VIDIOC_ENUM_FMT`.
    ///
    /// # Errors
    /// `EINVAL` past the last format.
    pub fn format(&self, index: u32) -> Result<FourCc, Errno> {
        self.formats.get(index as usize).copied().ok_or(Errno::INVAL)
    }

    /// `VIDIOC_S_FMT`: selects the nearest supported layout.
    ///
    /// # Errors
    /// `EBUSY` while there are buffers.
    pub fn set_layout(&mut self, requested: Layout) -> Result<Layout, Errno> {
        if self.queue.counts()[0] > 0 {
            return Err(Errno::BUSY);
        }
        let format = if self.formats.contains(&requested.format) {
            requested.format
        } else {
            self.formats[0]
        };
        let requested_area = pixels((requested.width, requested.height));
        let exact =
            self.sizes.iter().copied().find(|size| *size == (requested.width, requested.height));
        let nearest =
            self.sizes.iter().copied().min_by_key(|size| pixels(*size).abs_diff(requested_area));
        let (width, height) = exact.or(nearest).unwrap_or((640, 480));
        let (row, size) = match format {
            FourCc::YUYV => (2 * width + self.row_padding, (2 * width + self.row_padding) * height),
            FourCc::RGB24 => {
                (3 * width + self.row_padding, (3 * width + self.row_padding) * height)
            }
            FourCc::NV12 => (width + self.row_padding, (width + self.row_padding) * height * 3 / 2),
            _ => (0, 2 * width * height),
        };
        self.layout = Layout { width, height, format, stride: row, size, planes: 1 };
        Ok(self.layout)
    }

    /// `VIDIOC_S_PARM` and `VIDIOC_G_PARM`.
    pub fn interval(&mut self, requested: Option<Interval>) -> Interval {
        if let Some(requested) = requested {
            let fastest = Interval { numerator: 1, denominator: self.fastest };
            self.interval = if requested.ns() >= fastest.ns() { requested } else { fastest };
        }
        self.interval
    }

    /// `VIDIOC_QUERYCTRL`.
    ///
    /// # Errors
    /// `EINVAL` when there is no such control.
    pub fn control(&self, id: u32) -> Result<Control, Errno> {
        let next = id & NEXT_CONTROL != 0;
        let id = id & !NEXT_CONTROL;
        self.controls
            .iter()
            .map(|(control, _)| control)
            .find(|control| if next { control.id > id } else { control.id == id })
            .cloned()
            .ok_or(Errno::INVAL)
    }

    /// `VIDIOC_G_CTRL`.
    ///
    /// # Errors
    /// `EINVAL` when there is no such control.
    pub fn control_value(&self, id: u32) -> Result<i32, Errno> {
        self.controls
            .iter()
            .find(|(control, _)| control.id == id)
            .map(|(_, value)| *value)
            .ok_or(Errno::INVAL)
    }

    /// `VIDIOC_S_CTRL`: sets a control, rounded to a step as the kernel does.
    ///
    /// # Errors
    /// `EINVAL` when there is no such control, `ERANGE` when the value is out of range.
    pub fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno> {
        let (control, held) =
            self.controls.iter_mut().find(|(control, _)| control.id == id).ok_or(Errno::INVAL)?;
        if !(control.minimum..=control.maximum).contains(&value) {
            return Err(Errno::RANGE);
        }
        *held = value - (value - control.minimum) % control.step.max(1);
        Ok(())
    }

    /// Closes the device: ends the stream and frees the buffers.
    pub fn close(&mut self) {
        self.queue.stop();
        _ = self.queue.allocate(0);
    }
}

fn pixels((width, height): (u32, u32)) -> u64 {
    u64::from(width) * u64::from(height)
}
