//! Mapped buffers that the other side of a queue fills.

use std::os::fd::{AsFd, BorrowedFd};

use rustix::fs::{SealFlags, fcntl_get_seals, fstat};
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

/// The mapped buffers of a queue. Each is either owned by this process or lent to the side that
/// fills it. Only owned buffers can be read.
#[derive(Debug, Default)]
pub struct Buffers(Vec<Slot>);

#[derive(Debug)]
struct Slot {
    mapping: Mapping,
    lent: bool,
}

impl Buffers {
    /// Maps one more buffer of a video device. It is owned at first.
    ///
    /// # Errors
    /// Those of `mmap`.
    pub fn map_device(
        &mut self,
        device: BorrowedFd<'_>,
        offset: u64,
        length: usize,
    ) -> Result<(), Errno> {
        self.0.push(Slot { mapping: Mapping::new(device, offset, length)?, lent: false });
        Ok(())
    }

    /// Maps a memory file of another process as one more buffer.
    ///
    /// # Errors
    /// `EBADMSG` when the file is shorter than `length` or not sealed against shrinking: reading it
    /// could then end this process by SIGBUS.
    pub fn map_shared(&mut self, file: BorrowedFd<'_>, length: usize) -> Result<(), Errno> {
        let sealed = fcntl_get_seals(file)?.contains(SealFlags::SHRINK);
        if !sealed || fstat(file)?.st_size < length as i64 {
            return Err(Errno::BADMSG);
        }
        self.0.push(Slot { mapping: Mapping::new(file, 0, length)?, lent: false });
        Ok(())
    }

    /// Unmaps every buffer, lent ones as well.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Lends a buffer to the other side, which may fill it now.
    pub fn lend(&mut self, index: u32) {
        if let Some(slot) = self.0.get_mut(index as usize) {
            slot.lent = true;
        }
    }

    /// Takes a lent buffer back.
    ///
    /// # Errors
    /// `EBADMSG` when there is no such buffer.
    pub fn take_back(&mut self, index: u32) -> Result<(), Errno> {
        self.0.get_mut(index as usize).map(|slot| slot.lent = false).ok_or(Errno::BADMSG)
    }

    /// Takes every lent buffer back.
    pub fn take_all_back(&mut self) {
        self.0.iter_mut().for_each(|slot| slot.lent = false);
    }

    /// The bytes of a buffer; empty while it is lent.
    #[must_use]
    pub fn bytes(&self, index: u32) -> &[u8] {
        match self.0.get(index as usize) {
            Some(slot) if !slot.lent => slot.mapping.bytes(),
            _ => &[],
        }
    }
}

/// A read-only memory mapping.
#[derive(Debug)]
struct Mapping {
    start: *const u8,
    length: usize,
}

// SAFETY: the mapping belongs to this value alone, and is the same in every thread.
unsafe impl Send for Mapping {}

impl Mapping {
    fn new(file: impl AsFd, offset: u64, length: usize) -> Result<Self, Errno> {
        // SAFETY: the kernel chooses an address where nothing is; the mapping is only read and not
        // executable.
        let start = unsafe {
            mmap(std::ptr::null_mut(), length, ProtFlags::READ, MapFlags::SHARED, file, offset)
        }?;
        Ok(Self { start: start.cast_const().cast(), length })
    }

    /// Private to `Buffers`, which calls it only for buffers that are not lent.
    fn bytes(&self) -> &[u8] {
        // SAFETY: `start` and `length` are those of a mapping that lives as long as `self`. Its
        // file keeps its length: a device's memory does, also after an unplug, and a memory file is
        // sealed. The other side of the queue, be it the kernel or the simulated camera, writes
        // only to buffers that are lent to it, and lending ends this borrow.
        unsafe { std::slice::from_raw_parts(self.start, self.length) }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: `start` and `length` came from `mmap`, and every slice of it has borrowed `self`.
        // A failure leaves the memory mapped, which is harmless.
        _ = unsafe { munmap(self.start.cast_mut().cast(), self.length) };
    }
}
