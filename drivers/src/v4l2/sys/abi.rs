//! Structures and constants of `linux/videodev2.h` for 64-bit machines.

use rustix::ioctl::{Opcode, opcode};

#[cfg(not(target_pointer_width = "64"))]
compile_error!("the V4L2 structures here are those of 64-bit kernels");

/// Single-planar capture (`V4L2_BUF_TYPE_VIDEO_CAPTURE`).
pub const CAPTURE: u32 = 1;
/// Multi-planar capture (`V4L2_BUF_TYPE_VIDEO_CAPTURE_MPLANE`).
pub const CAPTURE_PLANES: u32 = 9;
/// Mapped buffers of the kernel driver (`V4L2_MEMORY_MMAP`).
pub const MEMORY_MMAP: u32 = 1;
/// Progressive frames, no interlaced fields (`V4L2_FIELD_NONE`).
pub const FIELD_NONE: u32 = 1;

pub const CAP_CAPTURE: u32 = 0x1;
pub const CAP_CAPTURE_PLANES: u32 = 0x1000;
pub const CAP_STREAMING: u32 = 0x0400_0000;
/// `device_caps` holds the capabilities of the node; `capabilities` holds those of all nodes of the
/// device.
pub const CAP_DEVICE_CAPS: u32 = 0x8000_0000;

/// The frame interval can be set (`V4L2_CAP_TIMEPERFRAME`).
pub const PARM_INTERVAL: u32 = 0x1000;

pub const FLAG_ERROR: u32 = 0x40;
pub const FLAG_CLOCK: u32 = 0xe000;
pub const FLAG_CLOCK_MONOTONIC: u32 = 0x2000;
pub const FLAG_STAMP: u32 = 0x7_0000;
pub const FLAG_STAMP_START: u32 = 0x1_0000;

pub const CONTROL_DISABLED: u32 = 0x1;

#[repr(C)]
pub struct Capability {
    pub driver: [u8; 16],
    pub card: [u8; 32],
    pub bus_info: [u8; 32],
    pub version: u32,
    pub capabilities: u32,
    pub device_caps: u32,
    pub reserved: [u32; 3],
}

#[repr(C)]
pub struct FormatDescription {
    pub index: u32,
    pub kind: u32,
    pub flags: u32,
    pub description: [u8; 32],
    pub format: u32,
    pub mbus_code: u32,
    pub reserved: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub struct PixFormat {
    pub width: u32,
    pub height: u32,
    pub format: u32,
    pub field: u32,
    pub bytes_per_line: u32,
    pub size_image: u32,
    pub colorspace: u32,
    pub private: u32,
    pub flags: u32,
    pub encoding: u32,
    pub quantization: u32,
    pub transfer: u32,
}

#[repr(C)]
#[derive(Clone, Copy)]
pub struct PlaneFormat {
    pub size_image: u32,
    pub bytes_per_line: u32,
    pub reserved: [u16; 6],
}

#[repr(C)]
#[derive(Clone, Copy)]
pub struct PixFormatPlanes {
    pub width: u32,
    pub height: u32,
    pub format: u32,
    pub field: u32,
    pub colorspace: u32,
    pub planes: [PlaneFormat; 8],
    pub num_planes: u8,
    pub flags: u8,
    pub encoding: u8,
    pub quantization: u8,
    pub transfer: u8,
    pub reserved: [u8; 7],
}

/// The kernel's union has a member with a pointer, hence 8-byte alignment and four bytes of padding
/// after `kind`.
#[repr(C, align(8))]
#[derive(Clone, Copy)]
pub union FormatUnion {
    pub pix: PixFormat,
    pub planes: PixFormatPlanes,
    pub raw: [u8; 200],
}

#[repr(C)]
pub struct Format {
    pub kind: u32,
    pub fmt: FormatUnion,
}

/// `v4l2_streamparm` with `v4l2_captureparm` inside.
#[repr(C)]
pub struct StreamParameters {
    pub kind: u32,
    pub capability: u32,
    pub capture_mode: u32,
    pub numerator: u32,
    pub denominator: u32,
    pub rest: [u32; 46],
}

#[repr(C)]
pub struct QueryControl {
    pub id: u32,
    pub kind: u32,
    pub name: [u8; 32],
    pub minimum: i32,
    pub maximum: i32,
    pub step: i32,
    pub default: i32,
    pub flags: u32,
    pub reserved: [u32; 2],
}

#[repr(C)]
pub struct ControlValue {
    pub id: u32,
    pub value: i32,
}

#[repr(C)]
pub struct RequestBuffers {
    pub count: u32,
    pub kind: u32,
    pub memory: u32,
    pub capabilities: u32,
    pub flags: u32,
}

/// `m` is an offset for mapped memory; for multi-planar nodes the address of an array of [`Plane`].
#[repr(C)]
pub struct Buffer {
    pub index: u32,
    pub kind: u32,
    pub bytes_used: u32,
    pub flags: u32,
    pub field: u32,
    pub seconds: i64,
    pub microseconds: i64,
    pub timecode: [u32; 4],
    pub sequence: u32,
    pub memory: u32,
    pub m: u64,
    pub length: u32,
    pub reserved2: u32,
    pub request_fd: i32,
}

#[repr(C)]
#[derive(Default)]
pub struct Plane {
    pub bytes_used: u32,
    pub length: u32,
    pub m: u64,
    pub data_offset: u32,
    pub reserved: [u32; 11],
}

#[repr(C)]
pub struct ExportBuffer {
    pub kind: u32,
    pub index: u32,
    pub plane: u32,
    pub flags: u32,
    pub fd: i32,
    pub reserved: [u32; 11],
}

pub const QUERYCAP: Opcode = opcode::read::<Capability>(b'V', 0);
pub const ENUM_FMT: Opcode = opcode::read_write::<FormatDescription>(b'V', 2);
pub const S_FMT: Opcode = opcode::read_write::<Format>(b'V', 5);
pub const REQBUFS: Opcode = opcode::read_write::<RequestBuffers>(b'V', 8);
pub const QUERYBUF: Opcode = opcode::read_write::<Buffer>(b'V', 9);
pub const QBUF: Opcode = opcode::read_write::<Buffer>(b'V', 15);
pub const EXPBUF: Opcode = opcode::read_write::<ExportBuffer>(b'V', 16);
pub const DQBUF: Opcode = opcode::read_write::<Buffer>(b'V', 17);
pub const STREAMON: Opcode = opcode::write::<u32>(b'V', 18);
pub const STREAMOFF: Opcode = opcode::write::<u32>(b'V', 19);
pub const G_PARM: Opcode = opcode::read_write::<StreamParameters>(b'V', 21);
pub const S_PARM: Opcode = opcode::read_write::<StreamParameters>(b'V', 22);
pub const G_CTRL: Opcode = opcode::read_write::<ControlValue>(b'V', 27);
pub const S_CTRL: Opcode = opcode::read_write::<ControlValue>(b'V', 28);
pub const QUERYCTRL: Opcode = opcode::read_write::<QueryControl>(b'V', 36);

// The ioctl numbers contain the sizes of the structures. These are the numbers of a C compiler on
// x86-64 and aarch64.
const _: () = assert!(QUERYCAP == 0x8068_5600 && ENUM_FMT == 0xc040_5602 && S_FMT == 0xc0d0_5605);
const _: () = assert!(REQBUFS == 0xc014_5608 && QUERYBUF == 0xc058_5609 && EXPBUF == 0xc040_5610);
const _: () = assert!(QBUF == 0xc058_560f && DQBUF == 0xc058_5611 && STREAMON == 0x4004_5612);
const _: () = assert!(STREAMOFF == 0x4004_5613 && G_PARM == 0xc0cc_5615 && S_PARM == 0xc0cc_5616);
const _: () = assert!(G_CTRL == 0xc008_561b && S_CTRL == 0xc008_561c && QUERYCTRL == 0xc044_5624);
const _: () = assert!(size_of::<Plane>() == 64 && size_of::<PixFormatPlanes>() == 192);
const _: () =
    assert!(std::mem::offset_of!(Format, fmt) == 8 && std::mem::offset_of!(Buffer, m) == 64);
