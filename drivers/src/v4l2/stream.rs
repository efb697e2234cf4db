//! One opened camera: what was agreed with it, and its queue of buffers.

use std::sync::Arc;

use hal::{ImageError, ImageView};
use rustix::io::Errno;

use super::config::{CameraDeviceConfig, CameraFormat, Setting};
use super::controls;
use super::error::V4l2Error;
use super::node::{FourCc, Interval, Layout, VideoNode, formats};

/// Buffers in the queue: one being filled, one being looked at, and two for a late look.
const BUFFERS: u32 = 4;

/// Taken for the time between pictures where neither the camera nor the configuration says: slower than any camera of use,
/// so that silence is not called too early.
const UNKNOWN_INTERVAL_NS: u64 = 100_000_000;

/// A camera that streams.
pub struct Stream {
    node: Box<dyn VideoNode>,
    layout: Layout,
    format: CameraFormat,
    interval_ns: u64,
    /// From the middle of the exposure to a stamp at its start, and to one at the picture's end.
    stamp_ns: [i64; 2],
    buffers: u32,
    last_sequence: Option<u32>,
    position: u32,
}

/// A buffer that was taken out of the queue and must go back into it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Taken {
    /// Which buffer.
    pub index: u32,
    /// Middle of the exposure as far as it is known, monotonic.
    pub time_ns: u64,
    /// Counts the camera's pictures since the start, from 1, also those that are missing.
    pub position: u32,
    bytes_used: usize,
}

/// What the queue held.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Drained {
    /// The newest whole picture.
    pub newest: Option<Taken>,
    /// Whole pictures before it, which went back unseen.
    pub skipped: u64,
    /// Pictures that were damaged.
    pub damaged: u64,
    /// Pictures that the camera counted and that never came.
    pub lost: u64,
}

impl Stream {
    /// Agrees with a camera on what is configured, and starts it.
    ///
    /// # Errors
    /// When it is no camera or cannot do what is configured.
    pub fn start(
        mut node: Box<dyn VideoNode>,
        config: &CameraDeviceConfig,
    ) -> Result<Self, V4l2Error> {
        let device: Arc<str> = config.device.as_str().into();
        let failed = |step, errno| V4l2Error::setup(&device, step, errno);
        let capability = node.capability().map_err(|errno| failed("asking what it is", errno))?;
        if !(capability.capture || capability.capture_planes) || !capability.streaming {
            return Err(V4l2Error::NotACamera { device: device.clone() });
        }
        let layout = agree_on_layout(node.as_mut(), config, &device)?;
        let interval_ns = agree_on_interval(node.as_mut(), config, &device)?;
        controls::apply(node.as_mut(), config, &device)?;
        let buffers =
            node.allocate(BUFFERS).map_err(|errno| failed("allocating buffers", errno))?;
        if buffers < 2 {
            return Err(failed("allocating two buffers", Errno::NOMEM));
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
            stamp_ns: [latency_ns - half_exposure_ns, latency_ns + half_exposure_ns],
            buffers,
            last_sequence: None,
            position: 0,
        };
        stream.queue_all_and_start().map_err(|errno| failed("starting the stream", errno))?;
        Ok(stream)
    }

    /// Stops and starts again with what was agreed.
    ///
    /// # Errors
    /// When the camera is gone or refuses; then only opening it again helps.
    pub fn restart(&mut self) -> Result<(), Errno> {
        self.node.stop()?;
        (self.last_sequence, self.position) = (None, 0);
        self.queue_all_and_start()
    }

    fn queue_all_and_start(&mut self) -> Result<(), Errno> {
        (0..self.buffers).try_for_each(|index| self.node.queue(index))?;
        self.node.start()
    }

    /// What was agreed.
    #[must_use]
    pub fn layout(&self) -> Layout {
        self.layout
    }

    /// Time between two pictures, nanoseconds.
    #[must_use]
    pub fn interval_ns(&self) -> u64 {
        self.interval_ns
    }

    /// The camera itself, for what this driver does not do.
    pub fn node(&mut self) -> &mut dyn VideoNode {
        self.node.as_mut()
    }

    /// Empties the queue of filled buffers and keeps the newest whole one. Never waits.
    ///
    /// # Errors
    /// `ENODEV` when the camera is gone; anything else is a failed stream. `EPROTO` for time stamps of an unknown clock.
    pub fn newest(&mut self) -> Result<Drained, Errno> {
        let mut drained = Drained::default();
        // Twice the queue's length: a camera that fills as fast as we empty does not hold us here.
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
            let [at_start_ns, at_end_ns] = self.stamp_ns;
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

    /// How many pictures after the last one this is. A counter that goes back has been restarted.
    fn step(&mut self, sequence: u32) -> u32 {
        let step = self.last_sequence.map_or(1, |last| sequence.wrapping_sub(last));
        self.last_sequence = Some(sequence);
        if (1..=u32::MAX / 2).contains(&step) { step } else { 1 }
    }

    /// The picture in a buffer that was taken.
    ///
    /// # Errors
    /// When its bytes are not those of a picture of the agreed size.
    pub fn view(&self, taken: &Taken) -> Result<ImageView<'_>, ImageError> {
        let (width, height) = (self.layout.width as usize, self.layout.height as usize);
        let filled = self.node.bytes(taken.index);
        let filled = filled.get(..taken.bytes_used).unwrap_or_default();
        let pixels = self.format.pixels();
        let data = match pixels.bytes(width, height) {
            // Some drivers count their padding at the end as well.
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

    /// Puts a buffer back into the queue.
    ///
    /// # Errors
    /// As [`newest`](Self::newest).
    pub fn give_back(&mut self, taken: Taken) -> Result<(), Errno> {
        self.node.queue(taken.index)
    }

    /// Each buffer as a dma-buf.
    ///
    /// # Errors
    /// `ENOTTY` when the camera's driver cannot.
    pub fn export(&mut self) -> Result<Vec<std::os::fd::OwnedFd>, Errno> {
        (0..self.buffers).map(|index| self.node.export(index)).collect()
    }
}

/// Begins with SOI and ends with EOI (ITU-T T.81, B.1.1.3); cameras fill up with zeros behind it.
fn is_whole_jpeg(bytes: &[u8]) -> bool {
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
    let file = &bytes[..end];
    file.len() > 4 && file.starts_with(&[0xff, 0xd8]) && file.ends_with(&[0xff, 0xd9])
}

fn agree_on_layout(
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
    let (width, height) = (config.width, config.height);
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
    let text = |layout: &Layout| format!("{}x{} {}", layout.width, layout.height, layout.format);
    let more = match (got.planes, rows_fit) {
        (2.., _) => format!(" in {} separate planes", got.planes),
        (_, false) if same => format!(" with rows of {} bytes", got.stride),
        _ => String::new(),
    };
    Err(V4l2Error::Layout { device: device.clone(), asked: text(&asked), got: text(&got) + &more })
}

fn agree_on_interval(
    node: &mut dyn VideoNode,
    config: &CameraDeviceConfig,
    device: &Arc<str>,
) -> Result<u64, V4l2Error> {
    // Thousandths: 29.97 is 1000/29970.
    let wish = config
        .fps
        .map(|fps| Interval { numerator: 1000, denominator: (fps * 1000.0).round() as u32 });
    let got = match node.interval(wish) {
        Ok(interval) => interval.ns(),
        Err(Errno::NOTTY | Errno::INVAL) => None,
        Err(errno) => return Err(V4l2Error::setup(device, "setting its frame interval", errno)),
    };
    match (got, wish.and_then(Interval::ns)) {
        // 5 %: 29.97 is as good as 30, 25 is not.
        (Some(got), Some(wish)) if got.abs_diff(wish) > wish / 20 => {
            let (asked_fps, got_fps) = (1e9 / wish as f64, 1e9 / got as f64);
            Err(V4l2Error::Rate { device: device.clone(), asked_fps, got_fps })
        }
        (got, wish) => Ok(got.or(wish).unwrap_or(UNKNOWN_INTERVAL_NS)),
    }
}
