//! A simulated camera behind a Unix socket, for programs that open `unix:/path`. The protocol is
//! that of [`drivers::v4l2::wire`].

use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::v4l2::node::{Filled, Interval, Layout};
use drivers::v4l2::wire::{self, InWords, Message};
use monotonic_clock::monotonic_ns;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
use rustix::io::{Errno, pwrite};
use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, accept_with, bind, listen, socket_with,
};

use super::device::Device;
use super::queue::FrameInfo;
use super::source::ImageSource;
use crate::{Seconds, holds};

/// Faults, at times in seconds since the camera was switched on.
#[derive(Debug, Clone, Default)]
pub struct VideoFaults {
    /// The socket is removed in this interval.
    pub unplugged: Option<Seconds>,
    /// The camera streams but sends no frames in this interval.
    pub silent: Option<Seconds>,
    /// Streaming fails in this interval.
    pub failed: Option<Seconds>,
    /// Fraction of frames that are counted but lost.
    pub drop_share: f64,
}

/// Longest wait, so that faults and the end are noticed soon enough.
const MAX_WAIT_NS: u64 = 20_000_000;

/// Serves one program at a time until `running` is false.
///
/// # Errors
/// Returns an error when the socket cannot be created.
pub fn serve(
    path: &Path,
    device: Device,
    faults: &VideoFaults,
    source: &mut dyn ImageSource,
    running: &AtomicBool,
) -> io::Result<()> {
    let start_ns = monotonic_ns();
    let mut camera =
        Camera { device, files: Vec::new(), sequence: 0, due_ns: 0, image: Vec::new() };
    let mut socket = Some(listen_at(path)?);
    let mut client: Option<OwnedFd> = None;
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    while running.load(Ordering::Relaxed) {
        let now_ns = monotonic_ns();
        let since_ns = now_ns - start_ns;
        if holds(faults.unplugged.as_ref(), since_ns) {
            socket = None;
            client = None;
            camera.close();
            _ = std::fs::remove_file(path);
        } else if socket.is_none() {
            socket = Some(listen_at(path)?);
        }
        if holds(faults.failed.as_ref(), since_ns) {
            camera.device.queue.fail();
        }
        if camera.device.queue.is_streaming() && now_ns >= camera.due_ns {
            let lost =
                rng.random::<f64>() < faults.drop_share || holds(faults.silent.as_ref(), since_ns);
            if let Some(client) = &client {
                // A client that has disconnected is detected below.
                _ = camera.take_frame(now_ns, lost, source, client);
            }
        }
        wait(socket.as_ref(), client.as_ref(), camera.wait_ns())?;
        if client.as_ref().is_some_and(|client| camera.answer_all(client).is_err()) {
            client = None;
            camera.close();
        }
        if client.is_none()
            && let Some(socket) = &socket
        {
            client = accept_with(socket, SocketFlags::CLOEXEC).ok();
        }
    }
    _ = std::fs::remove_file(path);
    Ok(())
}

fn listen_at(path: &Path) -> io::Result<OwnedFd> {
    // Removes the socket of an earlier camera that was killed.
    _ = std::fs::remove_file(path);
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
    bind(&socket, &SocketAddrUnix::new(path)?)?;
    listen(&socket, 1)?;
    Ok(socket)
}

fn wait(socket: Option<&OwnedFd>, client: Option<&OwnedFd>, wait_ns: u64) -> io::Result<()> {
    // A second client waits in the socket's queue until the first has disconnected.
    let waited_for = client.or(socket);
    let mut files: Vec<_> =
        waited_for.iter().map(|file| PollFd::new(*file, PollFlags::IN)).collect();
    let timeout = Timespec { tv_sec: 0, tv_nsec: wait_ns as i64 };
    match poll(&mut files, Some(&timeout)) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(errno) => Err(errno.into()),
    }
}

struct Camera {
    device: Device,
    files: Vec<OwnedFd>,
    sequence: u32,
    due_ns: u64,
    image: Vec<u8>,
}

impl Camera {
    fn close(&mut self) {
        self.device.close();
        self.files.clear();
        self.sequence = 0;
    }

    fn wait_ns(&self) -> u64 {
        let until_due_ns = self.due_ns.saturating_sub(monotonic_ns());
        if self.device.queue.is_streaming() { until_due_ns.min(MAX_WAIT_NS) } else { MAX_WAIT_NS }
    }

    fn interval_ns(&self) -> u64 {
        self.device.interval.ns().unwrap_or(MAX_WAIT_NS)
    }

    fn take_frame(
        &mut self,
        now_ns: u64,
        lost: bool,
        source: &mut dyn ImageSource,
        client: &OwnedFd,
    ) -> Result<(), Errno> {
        // Frames are due on a fixed grid. A stopped process does not send the frames that it has
        // missed.
        self.due_ns = (self.due_ns + self.interval_ns()).max(now_ns);
        let layout = self.device.layout;
        let info = FrameInfo {
            bytes_used: layout.size,
            sequence: self.sequence,
            time_ns: Some(now_ns),
            damaged: false,
        };
        self.sequence = self.sequence.wrapping_add(1);
        if lost {
            return Ok(());
        }
        let Some(index) = self.device.queue.fill(info) else { return self.report_failure(client) };
        self.image.resize(layout.size as usize, 0);
        source.render(now_ns, layout.width as usize, layout.height as usize, &mut self.image);
        let file = self.files.get(index as usize).ok_or(Errno::INVAL)?;
        let mut written = 0;
        while written < self.image.len() {
            written += pwrite(file, &self.image[written..], written as u64)?;
        }
        let (index, info) = self.device.queue.dequeue()?;
        let FrameInfo { bytes_used, sequence, time_ns, damaged } = info;
        let filled =
            Filled { index, bytes_used, sequence, time_ns, stamped_at_start: true, damaged };
        Message::new(wire::FILLED, &filled.to_words()).send(client, None)
    }

    /// Without a free buffer there is nothing to report. When streaming has failed, the client must
    /// be informed.
    fn report_failure(&mut self, client: &OwnedFd) -> Result<(), Errno> {
        match self.device.queue.dequeue() {
            Err(errno) if errno != Errno::AGAIN => {
                Message::error(wire::FILLED, errno).send(client, None)
            }
            _ => Ok(()),
        }
    }

    fn answer_all(&mut self, client: &OwnedFd) -> Result<(), Errno> {
        loop {
            match Message::receive(client, false) {
                Ok((request, _)) => self.answer(request, client)?,
                Err(Errno::AGAIN) => return Ok(()),
                Err(errno) => return Err(errno),
            }
        }
    }

    fn answer(&mut self, request: Message, client: &OwnedFd) -> Result<(), Errno> {
        let operation = request.operation;
        if operation == wire::QUEUE {
            return match self.device.queue.queue(request.words[0]) {
                Ok(()) => Ok(()),
                Err(errno) => Message::error(wire::FILLED, errno).send(client, None),
            };
        }
        let answer = match self.outcome(request) {
            Ok(words) => Message::new(operation, &words),
            Err(errno) => Message::error(operation, errno),
        };
        let file = if operation == wire::BUFFER {
            self.files.get(request.words[0] as usize)
        } else {
            None
        };
        answer.send(client, file.map(AsFd::as_fd))
    }

    fn outcome(&mut self, request: Message) -> Result<Vec<u32>, Errno> {
        let words = &request.words;
        let device = &mut self.device;
        Ok(match request.operation {
            wire::CAPABILITY => device.capability().to_words(),
            wire::FORMAT => vec![device.format(words[0])?.0],
            wire::SET_LAYOUT => device.set_layout(Layout::from_words(words))?.to_words(),
            wire::INTERVAL => {
                let requested = Interval { numerator: words[1], denominator: words[2] };
                device.interval((words[0] != 0).then_some(requested)).to_words()
            }
            wire::CONTROL => device.control(words[0])?.to_words(),
            wire::CONTROL_VALUE => vec![device.control_value(words[0])?.cast_unsigned()],
            wire::SET_CONTROL => {
                device.set_control(words[0], words[1].cast_signed())?;
                vec![]
            }
            wire::ALLOCATE => {
                let count = device.queue.allocate(words[0])?;
                let size = u64::from(device.layout.size);
                self.files = (0..count).map(|_| memory(size)).collect::<Result<_, _>>()?;
                vec![count]
            }
            wire::BUFFER if (words[0] as usize) < self.files.len() => vec![device.layout.size],
            wire::START => {
                device.queue.start()?;
                self.due_ns = monotonic_ns() + self.interval_ns();
                vec![]
            }
            wire::STOP => {
                device.queue.stop();
                vec![]
            }
            _ => return Err(Errno::INVAL),
        })
    }
}

/// A sealed memory file: it cannot be truncated, so a client can map it safely.
fn memory(size: u64) -> Result<OwnedFd, Errno> {
    let file = memfd_create("camera", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    ftruncate(&file, size)?;
    fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW)?;
    Ok(file)
}
