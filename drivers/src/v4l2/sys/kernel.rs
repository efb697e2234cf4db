//! A node of the kernel's: `/dev/video0` and its stable names under `/dev/v4l/`.

use std::os::fd::{AsFd, FromRawFd, OwnedFd};
use std::path::Path;

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::ioctl::{Getter, Opcode, Setter, Updater, ioctl};

use super::abi;
use super::mapping::Buffers;
use crate::v4l2::node::{Capability, Control, Filled, FourCc, Interval, Layout, VideoNode};

/// An open video device. Closing it stops the stream and frees the buffers.
#[derive(Debug)]
pub struct KernelNode {
    file: OwnedFd,
    kind: u32,
    buffers: Buffers,
}

/// A structure that is all zeros in the kernel's interface unless said otherwise.
macro_rules! zeroed {
    ($kind:ty { $($field:ident: $value:expr),* $(,)? }) => {{
        // SAFETY: the structures of `abi` are plain numbers and arrays of them; all zeros is a value of each.
        #[allow(unused_mut, reason = "unused where no field is set")]
        let mut value: $kind = unsafe { std::mem::zeroed() };
        $(value.$field = $value;)*
        value
    }};
}

impl KernelNode {
    /// Opens a device by its path.
    ///
    /// # Errors
    /// What `open` says: `ENOENT` when it is not there, `EACCES` without permission.
    pub fn open(path: &Path) -> Result<Self, Errno> {
        // Non-blocking: DQBUF answers EAGAIN instead of waiting.
        let file = rustix::fs::open(
            path,
            OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        Ok(Self { file, kind: abi::CAPTURE, buffers: Buffers::default() })
    }

    /// An ioctl that reads and writes a structure of `abi`.
    fn update<const CODE: Opcode, T>(&self, value: &mut T) -> Result<(), Errno> {
        loop {
            // SAFETY: private, and every call passes the structure whose size is part of `CODE`; `abi` checks these sizes.
            // Structures that contain an address are only passed by `buffer_call`.
            match unsafe { ioctl(&self.file, Updater::<CODE, T>::new(value)) } {
                Err(Errno::INTR) => {}
                outcome => return outcome,
            }
        }
    }

    /// An ioctl with a `v4l2_buffer`. Returns its first plane, which a single-planar node has in the buffer itself.
    fn buffer_call<const CODE: Opcode>(
        &self,
        buffer: &mut abi::Buffer,
    ) -> Result<abi::Plane, Errno> {
        let mut planes: [abi::Plane; 8] = Default::default();
        (buffer.kind, buffer.memory) = (self.kind, abi::MEMORY_MMAP);
        if self.kind == abi::CAPTURE {
            self.update::<CODE, _>(buffer)?;
            let (bytes_used, length, m) = (buffer.bytes_used, buffer.length, buffer.m);
            return Ok(abi::Plane { bytes_used, length, m, ..abi::Plane::default() });
        }
        // The kernel writes at most `length` planes to this address, which outlives the call.
        (buffer.m, buffer.length) = (planes.as_mut_ptr() as u64, planes.len() as u32);
        self.update::<CODE, _>(buffer)?;
        let [first, ..] = planes;
        Ok(first)
    }

    fn map(&mut self, index: u32) -> Result<(), Errno> {
        let plane =
            self.buffer_call::<{ abi::QUERYBUF }>(&mut zeroed!(abi::Buffer { index: index }))?;
        // The offset is 32 bits; what lies above it in the union is not the kernel's.
        self.buffers.map_device(self.file.as_fd(), plane.m & 0xffff_ffff, plane.length as usize)
    }

    fn simple<const CODE: Opcode>(&self) -> Result<(), Errno> {
        // SAFETY: STREAMON and STREAMOFF read one number, the kind of buffers.
        unsafe { ioctl(&self.file, Setter::<CODE, u32>::new(self.kind)) }
    }
}

impl VideoNode for KernelNode {
    fn capability(&mut self) -> Result<Capability, Errno> {
        // SAFETY: QUERYCAP writes a `Capability`.
        let found =
            unsafe { ioctl(&self.file, Getter::<{ abi::QUERYCAP }, abi::Capability>::new()) }?;
        let own = found.capabilities & abi::CAP_DEVICE_CAPS != 0;
        let flags = if own { found.device_caps } else { found.capabilities };
        let has = |flag| flags & flag != 0;
        let capability = Capability {
            capture: has(abi::CAP_CAPTURE),
            capture_planes: has(abi::CAP_CAPTURE_PLANES),
            streaming: has(abi::CAP_STREAMING),
        };
        self.kind = if capability.capture { abi::CAPTURE } else { abi::CAPTURE_PLANES };
        Ok(capability)
    }

    fn format(&mut self, index: u32) -> Result<FourCc, Errno> {
        let mut description = zeroed!(abi::FormatDescription { index: index, kind: self.kind });
        self.update::<{ abi::ENUM_FMT }, _>(&mut description)?;
        Ok(FourCc(description.format))
    }

    fn set_layout(&mut self, asked: Layout) -> Result<Layout, Errno> {
        let mut format = zeroed!(abi::Format { kind: self.kind });
        let (width, height, code) = (asked.width, asked.height, asked.format.0);
        if self.kind == abi::CAPTURE {
            format.fmt.pix = zeroed!(abi::PixFormat {
                width: width,
                height: height,
                format: code,
                field: abi::FIELD_NONE
            });
            self.update::<{ abi::S_FMT }, _>(&mut format)?;
            // SAFETY: `kind` says that the kernel filled this member, and every bit pattern is a value of it.
            let got = unsafe { format.fmt.pix };
            let (stride, size) = (got.bytes_per_line, got.size_image);
            return Ok(Layout {
                width: got.width,
                height: got.height,
                format: FourCc(got.format),
                stride,
                size,
                planes: 1,
            });
        }
        let mut wish = zeroed!(abi::PixFormatPlanes { width: width, height: height, format: code });
        (wish.field, wish.num_planes) = (abi::FIELD_NONE, 1);
        format.fmt.planes = wish;
        self.update::<{ abi::S_FMT }, _>(&mut format)?;
        // SAFETY: as above.
        let got = unsafe { format.fmt.planes };
        let (stride, size) = (got.planes[0].bytes_per_line, got.planes[0].size_image);
        let planes = u32::from(got.num_planes);
        Ok(Layout {
            width: got.width,
            height: got.height,
            format: FourCc(got.format),
            stride,
            size,
            planes,
        })
    }

    fn interval(&mut self, wish: Option<Interval>) -> Result<Interval, Errno> {
        let mut parameters = zeroed!(abi::StreamParameters { kind: self.kind });
        self.update::<{ abi::G_PARM }, _>(&mut parameters)?;
        if let Some(wish) = wish
            && parameters.capability & abi::PARM_INTERVAL != 0
        {
            (parameters.numerator, parameters.denominator) = (wish.numerator, wish.denominator);
            self.update::<{ abi::S_PARM }, _>(&mut parameters)?;
            self.update::<{ abi::G_PARM }, _>(&mut parameters)?;
        }
        Ok(Interval { numerator: parameters.numerator, denominator: parameters.denominator })
    }

    fn control(&mut self, id: u32) -> Result<Control, Errno> {
        let mut query = zeroed!(abi::QueryControl { id: id });
        self.update::<{ abi::QUERYCTRL }, _>(&mut query)?;
        let name = query.name.split(|byte| *byte == 0).next().unwrap_or_default();
        Ok(Control {
            id: query.id,
            name: String::from_utf8_lossy(name).into_owned(),
            minimum: query.minimum,
            maximum: query.maximum,
            step: query.step,
            disabled: query.flags & abi::CONTROL_DISABLED != 0,
        })
    }

    fn control_value(&mut self, id: u32) -> Result<i32, Errno> {
        let mut control = abi::ControlValue { id, value: 0 };
        self.update::<{ abi::G_CTRL }, _>(&mut control)?;
        Ok(control.value)
    }

    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno> {
        self.update::<{ abi::S_CTRL }, _>(&mut abi::ControlValue { id, value })
    }

    fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        self.buffers.clear();
        let mut request = zeroed!(abi::RequestBuffers {
            count: count,
            kind: self.kind,
            memory: abi::MEMORY_MMAP
        });
        self.update::<{ abi::REQBUFS }, _>(&mut request)?;
        for index in 0..request.count {
            self.map(index)?;
        }
        Ok(request.count)
    }

    fn queue(&mut self, index: u32) -> Result<(), Errno> {
        self.buffer_call::<{ abi::QBUF }>(&mut zeroed!(abi::Buffer { index: index }))?;
        self.buffers.lend(index);
        Ok(())
    }

    fn dequeue(&mut self) -> Result<Filled, Errno> {
        let mut buffer = zeroed!(abi::Buffer {});
        let plane = self.buffer_call::<{ abi::DQBUF }>(&mut buffer)?;
        self.buffers.take_back(buffer.index)?;
        let monotonic = buffer.flags & abi::FLAG_CLOCK == abi::FLAG_CLOCK_MONOTONIC;
        Ok(Filled {
            index: buffer.index,
            // Nobody but codecs puts the picture at an offset; a capture node that does is refused as damaged.
            bytes_used: plane.bytes_used,
            sequence: buffer.sequence,
            time_ns: if monotonic {
                nanoseconds(buffer.seconds, buffer.microseconds)
            } else {
                None
            },
            stamped_at_start: buffer.flags & abi::FLAG_STAMP == abi::FLAG_STAMP_START,
            damaged: buffer.flags & abi::FLAG_ERROR != 0 || plane.data_offset != 0,
        })
    }

    fn start(&mut self) -> Result<(), Errno> {
        self.simple::<{ abi::STREAMON }>()
    }

    fn stop(&mut self) -> Result<(), Errno> {
        self.simple::<{ abi::STREAMOFF }>()?;
        self.buffers.take_all_back();
        Ok(())
    }

    fn export(&mut self, index: u32) -> Result<OwnedFd, Errno> {
        let flags = (OFlags::CLOEXEC | OFlags::RDONLY).bits();
        let mut export = zeroed!(abi::ExportBuffer { kind: self.kind, index: index, flags: flags });
        self.update::<{ abi::EXPBUF }, _>(&mut export)?;
        // SAFETY: EXPBUF has succeeded, so `fd` is a new descriptor that nobody else knows.
        Ok(unsafe { OwnedFd::from_raw_fd(export.fd) })
    }

    fn bytes(&self, index: u32) -> &[u8] {
        self.buffers.bytes(index)
    }
}

/// `None` for a time that cannot be.
fn nanoseconds(seconds: i64, microseconds: i64) -> Option<u64> {
    let whole = u64::try_from(seconds).ok()?.checked_mul(1_000_000_000)?;
    whole.checked_add(u64::try_from(microseconds).ok()?.checked_mul(1_000)?)
}
