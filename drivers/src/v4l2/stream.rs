//! One opened camera: its negotiated format and its queue of buffers.

use std::sync::Arc;

use hal::{ImageError, ImageView};
use rustix::io::Errno;

use super::config::{CameraDeviceConfig, CameraFormat, Setting};
use super::controls;
use super::error::V4l2Error;
use super::node::{FourCc, Interval, Layout, VideoNode, formats};

/// Number of buffers: one that is being filled, one that is being inspected, and two for a late
/// poll.
const BUFFERS: u32 = 4;

/// The assumed frame interval when neither the camera nor the configuration specifies one. It is
/// longer than that of any usable camera, so that a silence is not reported too early.
const UNKNOWN_INTERVAL_NS: u64 = 100_000_000;

/// A camera that is open and streams.
pub struct Stream {
    node: Box<dyn VideoNode>,
    layout: Layout,
    format: CameraFormat,
    interval_ns: u64,
    /// Time from the middle of the exposure to a timestamp at the start of the exposure, and to one
    /// at the end of the frame.
    stamp_offsets_ns: [i64; 2],
    buffers: u32,
    last_sequence: Option<u32>,
    position: u32,
}

/// A buffer that was dequeued and must be queued again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Taken {
    pub index: u32,
    /// Middle of the exposure, as far as it is known, on the monotonic clock.
    pub time_ns: u64,
    /// Counts the camera's frames since the start, from 1, including lost ones.
    pub position: u32,
    bytes_used: usize,
}

/// The result of emptying the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drained {
    /// The newest whole frame.
    pub newest: Option<Taken>,
    /// Number of older whole frames, which were queued again without being used.
    pub skipped: u64,
    /// Number of damaged frames.
    pub damaged: u64,
    /// Number of frames that never arrived according to the camera's counter.
    pub lost: u64,
}

impl Stream {
    /// Negotiates the configured format with a camera, and starts it.
    ///
    /// # Errors
    /// When the device is not a camera, or does not support the configuration.
    pub fn start(
        mut node: Box<dyn VideoNode>,
        config: &CameraDeviceConfig,
    ) -> Result<Self, V4l2Error> {
        let device: Arc<str> = config.device.as_str().into();

        let capability = node
            .capability()
            .map_err(|errno| V4l2Error::setup(&device, "querying its capabilities", errno))?;
        if !capability.is_camera() {
            return Err(V4l2Error::NotACamera { device: device.clone() });
        }
        let layout = negotiate_layout(node.as_mut(), config, &device)?;
        let interval_ns = negotiate_interval(node.as_mut(), config, &device)?;
        controls::apply(node.as_mut(), config, &device)?;
        let buffers = node
            .allocate(BUFFERS)
            .map_err(|errno| V4l2Error::setup(&device, "allocating buffers", errno))?;
        if buffers < 2 {
            return Err(V4l2Error::setup(&device, "allocating two buffers", Errno::NOMEM));
        }
        let half_exposure_ns = match config.exposure_us {
            Some(Setting::Manual(us)) => i64::from(us) * 500,
            _ => 0,
        };
        let latency_ns = (config.latency_ms * 1e6) as i64;
        let mut stream = Self {
            node,
            layout,
            format: config.format,
            interval_ns,
            stamp_offsets_ns: [latency_ns - half_exposure_ns, latency_ns + half_exposure_ns],
            buffers,
            last_sequence: None,
            position: 0,
        };
        stream
            .queue_all_and_start()
            .map_err(|errno| V4l2Error::setup(&device, "starting the stream", errno))?;
        Ok(stream)
    }

    /// Stops the stream and starts it again with the negotiated format.
    ///
    /// # Errors
    /// When the camera is gone or refuses. It must be reopened then.
    pub fn restart(&mut self) -> Result<(), Errno> {
        self.node.stop()?;
        self.last_sequence = None;
        self.position = 0;
        self.queue_all_and_start()
    }

    fn queue_all_and_start(&mut self) -> Result<(), Errno> {
        (0..self.buffers).try_for_each(|index| self.node.queue(index))?;
        self.node.start()
    }

    /// The negotiated size and format.
    #[must_use]
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Time between two frames.
    #[must_use]
    pub fn interval_ns(&self) -> u64 {
        self.interval_ns
    }

    /// The video node, for operations that this type does not offer.
    pub fn node(&mut self) -> &mut dyn VideoNode {
        self.node.as_mut()
    }

    /// Empties the queue of filled buffers and keeps the newest whole frame. Never blocks.
    ///
    /// # Errors
    /// `ENODEV` when the camera is gone, `EPROTO` when its timestamps are of an unknown clock. Any
    /// other error is a failed stream.
    pub fn newest(&mut self) -> Result<Drained, Errno> {
        let mut drained = Drained::default();
        // The limit of twice the queue's length ends the loop even for a camera that fills buffers
        // as fast as they are emptied.
        for _ in 0..2 * self.buffers {
            let filled = match self.node.dequeue() {
                Ok(filled) => filled,
                Err(Errno::AGAIN | Errno::INTR) => break,
                Err(errno) => return Err(errno),
            };
            let stamp_ns = filled.time_ns.ok_or(Errno::PROTO)?;
            let step = self.step(filled.sequence);
            drained.lost += u64::from(step - 1);
            self.position = self.position.wrapping_add(step);
            let [at_start_ns, at_end_ns] = self.stamp_offsets_ns;
            let time_ns = stamp_ns.saturating_add_signed(
                -(if filled.stamped_at_start { at_start_ns } else { at_end_ns }),
            );
            let taken = Taken {
                index: filled.index,
                time_ns,
                position: self.position,
                bytes_used: filled.bytes_used as usize,
            };
            if filled.damaged || self.view(&taken).is_err() {
                drained.damaged += 1;
                self.node.queue(filled.index)?;
            } else if let Some(older) = drained.newest.replace(taken) {
                drained.skipped += 1;
                self.node.queue(older.index)?;
            }
        }
        Ok(drained)
    }

    /// The number of frames since the last one. A counter that decreases was restarted.
    fn step(&mut self, sequence: u32) -> u32 {
        let step = self.last_sequence.map_or(1, |last| sequence.wrapping_sub(last));
        self.last_sequence = Some(sequence);
        if (1..=u32::MAX / 2).contains(&step) { step } else { 1 }
    }

    /// The frame in a dequeued buffer.
    ///
    /// # Errors
    /// When the bytes are not a frame of the negotiated size.
    pub fn view(&self, taken: &Taken) -> Result<ImageView<'_>, ImageError> {
        let width = self.layout.width as usize;
        let height = self.layout.height as usize;
        let filled = self.node.bytes(taken.index);
        let filled = filled.get(..taken.bytes_used).unwrap_or_default();
        let pixels = self.format.pixels();
        let data = match pixels.bytes(width, height) {
            // Some kernel drivers include the padding at the end in the number of bytes.
            Some(bytes) => filled.get(..bytes).unwrap_or(filled),
            None if is_whole_jpeg(filled) => filled,
            None => {
                return Err(ImageError::Length {
                    expected: self.layout.size as usize,
                    actual: filled.len(),
                });
            }
        };
        ImageView::new(width, height, pixels, data)
    }

    /// Queues a dequeued buffer again.
    ///
    /// # Errors
    /// As [`newest`](Self::newest).
    pub fn give_back(&mut self, taken: Taken) -> Result<(), Errno> {
        self.node.queue(taken.index)
    }

    /// Exports each buffer as a dma-buf.
    ///
    /// # Errors
    /// `ENOTTY` when the kernel driver cannot export buffers.
    pub fn export(&mut self) -> Result<Vec<std::os::fd::OwnedFd>, Errno> {
        (0..self.buffers).map(|index| self.node.export(index)).collect()
    }
}

/// Whether the bytes start with SOI and end with EOI (ITU-T T.81, B.1.1.3). Cameras pad the file
/// with zeros.
fn is_whole_jpeg(bytes: &[u8]) -> bool {
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let file = &bytes[..end];
    file.len() > 4 && file.starts_with(&[0xff, 0xd8]) && file.ends_with(&[0xff, 0xd9])
}

fn negotiate_layout(
    node: &mut dyn VideoNode,
    config: &CameraDeviceConfig,
    device: &Arc<str>,
) -> Result<Layout, V4l2Error> {
    let offered =
        formats(node).map_err(|errno| V4l2Error::setup(device, "listing its formats", errno))?;
    let names = config.format.names();
    let Some(format) = names.iter().copied().find(|name| offered.contains(name)) else {
        let asked = names.first().copied().unwrap_or(FourCc::YUYV);
        let offered = offered.iter().map(FourCc::to_string).collect::<Vec<_>>().join(", ");
        return Err(V4l2Error::Format { device: device.clone(), asked, offered });
    };
    let width = config.width;
    let height = config.height;
    let asked = Layout { width, height, format, stride: 0, size: 0, planes: 1 };
    let got = node
        .set_layout(asked)
        .map_err(|errno| V4l2Error::setup(device, "setting its format", errno))?;
    let same = (got.width, got.height, got.format) == (width, height, format);
    let rows_fit =
        config.format == CameraFormat::Mjpeg || got.stride == config.format.row_bytes(width);
    if same && got.planes == 1 && rows_fit {
        return Ok(got);
    }
    let difference = match (got.planes, rows_fit) {
        (2.., _) => format!(" in {} separate planes", got.planes),
        (_, false) if same => format!(" with rows of {} bytes", got.stride),
        _ => String::new(),
    };
    Err(V4l2Error::Layout {
        device: device.clone(),
        asked: describe(&asked),
        got: describe(&got) + &difference,
    })
}

fn describe(layout: &Layout) -> String {
    format!("{}x{} {}", layout.width, layout.height, layout.format)
}

fn negotiate_interval(
    node: &mut dyn VideoNode,
    config: &CameraDeviceConfig,
    device: &Arc<str>,
) -> Result<u64, V4l2Error> {
    // Rates are compared in thousandths: 29.97 Hz is an interval of 1000/29970 s.
    let desired = config
        .fps
        .map(|fps| Interval { numerator: 1000, denominator: (fps * 1000.0).round() as u32 });
    let got = match node.interval(desired) {
        Ok(interval) => interval.ns(),
        Err(Errno::NOTTY | Errno::INVAL) => None,
        Err(errno) => return Err(V4l2Error::setup(device, "setting its frame interval", errno)),
    };
    match (got, desired.and_then(Interval::ns)) {
        // A tolerance of 5 % accepts 29.97 instead of 30, but not 25.
        (Some(got), Some(desired)) if got.abs_diff(desired) > desired / 20 => {
            let asked_fps = 1e9 / desired as f64;
            let got_fps = 1e9 / got as f64;
            Err(V4l2Error::Rate { device: device.clone(), asked_fps, got_fps })
        }
        (got, desired) => Ok(got.or(desired).unwrap_or(UNKNOWN_INTERVAL_NS)),
    }
}
