//! A video node of the kernel: `/dev/video0` and its stable names under `/dev/v4l/`.

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

/// Makes a structure of the kernel's interface whose fields are zero except for the given ones.
macro_rules! zeroed {
    ($kind:ty { $($field:ident: $value:expr),* $(,)? }) => {{
        // SAFETY: the structures of `abi` are plain numbers and arrays of them; all zeros is a
        // value of each.
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
    /// Those of `open`: `ENOENT` when the device does not exist, `EACCES` without permission.
    pub fn open(path: &Path) -> Result<Self, Errno> {
        // Non-blocking, so that DQBUF returns EAGAIN instead of waiting.
        let file = rustix::fs::open(
            path,
            OFlags::RDWR | OFlags::NONBLOCK | OFlags::CLOEXEC,
            Mode::empty(),
        )?;
        Ok(Self { file, kind: abi::CAPTURE, buffers: Buffers::default() })
    }

    /// Calls an ioctl that reads and writes a structure of `abi`.
    fn update<const CODE: Opcode, T>(&self, value: &mut T) -> Result<(), Errno> {
        loop {
            // SAFETY: private, and every call passes the structure whose size is part of `CODE`;
            // `abi` checks these sizes. Structures that contain an address are only passed by
            // `buffer_call`.
            match unsafe { ioctl(&self.file, Updater::<CODE, T>::new(value)) } {
                Err(Errno::INTR) => {}
                outcome => return outcome,
            }
        }
    }

    /// Calls an ioctl with a `v4l2_buffer`. Returns its first plane, which a single-planar node
    /// stores in the buffer itself.
    fn buffer_call<const CODE: Opcode>(
        &self,
        buffer: &mut abi::Buffer,
    ) -> Result<abi::Plane, Errno> {
        let mut planes: [abi::Plane; 8] = Default::default();
        buffer.kind = self.kind;
        buffer.memory = abi::MEMORY_MMAP;
        if self.kind == abi::CAPTURE {
            self.update::<CODE, _>(buffer)?;
            return Ok(abi::Plane {
                bytes_used: buffer.bytes_used,
                length: buffer.length,
                m: buffer.m,
                ..abi::Plane::default()
            });
        }
        // The kernel writes at most `length` planes to this address, which outlives the call.
        buffer.m = planes.as_mut_ptr() as u64;
        buffer.length = planes.len() as u32;
        self.update::<CODE, _>(buffer)?;
        let [first, ..] = planes;
        Ok(first)
    }

    fn map(&mut self, index: u32) -> Result<(), Errno> {
        let plane =
            self.buffer_call::<{ abi::QUERYBUF }>(&mut zeroed!(abi::Buffer { index: index }))?;
        // The offset has 32 bits; the kernel does not write the upper half of the union.
        self.buffers.map_device(self.file.as_fd(), plane.m & 0xffff_ffff, plane.length as usize)
    }

    /// Calls an ioctl that takes only the kind of buffers.
    fn switch_stream<const CODE: Opcode>(&self) -> Result<(), Errno> {
        // SAFETY: STREAMON and STREAMOFF read one number, the kind of buffers.
        unsafe { ioctl(&self.file, Setter::<CODE, u32>::new(self.kind)) }
    }
}

impl VideoNode for KernelNode {
    fn capability(&mut self) -> Result<Capability, Errno> {
        // SAFETY: QUERYCAP writes a `Capability`.
        let found =
            unsafe { ioctl(&self.file, Getter::<{ abi::QUERYCAP }, abi::Capability>::new()) }?;
        let has_own_flags = found.capabilities & abi::CAP_DEVICE_CAPS != 0;
        let flags = if has_own_flags { found.device_caps } else { found.capabilities };
        let capability = Capability {
            capture: flags & abi::CAP_CAPTURE != 0,
            capture_planes: flags & abi::CAP_CAPTURE_PLANES != 0,
            streaming: flags & abi::CAP_STREAMING != 0,
        };
        self.kind = if capability.capture { abi::CAPTURE } else { abi::CAPTURE_PLANES };
        Ok(capability)
    }

    fn format(&mut self, index: u32) -> Result<FourCc, Errno> {
        let mut description = zeroed!(abi::FormatDescription { index: index, kind: self.kind });
        self.update::<{ abi::ENUM_FMT }, _>(&mut description)?;
        Ok(FourCc(description.format))
    }

    fn set_layout(&mut self, requested: Layout) -> Result<Layout, Errno> {
        let mut format = zeroed!(abi::Format { kind: self.kind });
        let width = requested.width;
        let height = requested.height;
        let code = requested.format.0;
        if self.kind == abi::CAPTURE {
            format.fmt.pix = zeroed!(abi::PixFormat {
                width: width,
                height: height,
                format: code,
                field: abi::FIELD_NONE
            });
            self.update::<{ abi::S_FMT }, _>(&mut format)?;
            // SAFETY: `kind` says that the kernel filled this member, and every bit pattern is a
            // value of it.
            let got = unsafe { format.fmt.pix };
            return Ok(Layout {
                width: got.width,
                height: got.height,
                format: FourCc(got.format),
                stride: got.bytes_per_line,
                size: got.size_image,
                planes: 1,
            });
        }
        let mut planes =
            zeroed!(abi::PixFormatPlanes { width: width, height: height, format: code });
        planes.field = abi::FIELD_NONE;
        planes.num_planes = 1;
        format.fmt.planes = planes;
        self.update::<{ abi::S_FMT }, _>(&mut format)?;
        // SAFETY: as above.
        let got = unsafe { format.fmt.planes };
        Ok(Layout {
            width: got.width,
            height: got.height,
            format: FourCc(got.format),
            stride: got.planes[0].bytes_per_line,
            size: got.planes[0].size_image,
            planes: u32::from(got.num_planes),
        })
    }

    fn interval(&mut self, desired: Option<Interval>) -> Result<Interval, Errno> {
        let mut parameters = zeroed!(abi::StreamParameters { kind: self.kind });
        self.update::<{ abi::G_PARM }, _>(&mut parameters)?;
        if let Some(desired) = desired
            && parameters.capability & abi::PARM_INTERVAL != 0
        {
            parameters.numerator = desired.numerator;
            parameters.denominator = desired.denominator;
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
            // Only codecs store the frame at an offset; such a frame of a capture node is refused
            // as damaged.
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
        self.switch_stream::<{ abi::STREAMON }>()
    }

    fn stop(&mut self) -> Result<(), Errno> {
        self.switch_stream::<{ abi::STREAMOFF }>()?;
        self.buffers.take_all_back();
        Ok(())
    }

    fn export(&mut self, index: u32) -> Result<OwnedFd, Errno> {
        let flags = (OFlags::CLOEXEC | OFlags::RDONLY).bits();
        let mut export = zeroed!(abi::ExportBuffer { kind: self.kind, index: index, flags: flags });
        self.update::<{ abi::EXPBUF }, _>(&mut export)?;
        // SAFETY: EXPBUF has succeeded, so `fd` is a new descriptor that nothing else uses.
        Ok(unsafe { OwnedFd::from_raw_fd(export.fd) })
    }

    fn bytes(&self, index: u32) -> &[u8] {
        self.buffers.bytes(index)
    }
}

/// `None` for a time that is negative or too large.
fn nanoseconds(seconds: i64, microseconds: i64) -> Option<u64> {
    let whole = u64::try_from(seconds).ok()?.checked_mul(1_000_000_000)?;
    whole.checked_add(u64::try_from(microseconds).ok()?.checked_mul(1_000)?)
}
