//! The protocol between this driver and a simulated camera in another process: V4L2's operations as
//! messages of 64 bytes over a Unix socket that preserves message boundaries (`SOCK_SEQPACKET`).
//! Frames are in memory files that are passed along with the messages.
//!
//! Every request except [`QUEUE`] has a response with the same operation. Like a real node, the
//! camera sends filled buffers without a request, as [`FILLED`]. A [`FILLED`] with an error number
//! is the result of the next `VIDIOC_DQBUF`.

use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, recvmsg, sendmsg,
};

use super::node::{Capability, Control, Filled, FourCc, Interval, Layout};

/// The operation `VIDIOC_QUERYCAP`.
pub const CAPABILITY: u32 = 0;
/// The operation `VIDIOC_ENUM_FMT`.
pub const FORMAT: u32 = 2;
/// The operation `VIDIOC_S_FMT`.
pub const SET_LAYOUT: u32 = 5;
/// The operation `VIDIOC_REQBUFS`.
pub const ALLOCATE: u32 = 8;
/// `VIDIOC_QUERYBUF`. The response carries the memory file.
pub const BUFFER: u32 = 9;
/// `VIDIOC_QBUF`, which has no response.
pub const QUEUE: u32 = 15;
/// `VIDIOC_DQBUF`, which only the camera sends.
pub const FILLED: u32 = 17;
/// The operation `VIDIOC_STREAMON`.
pub const START: u32 = 18;
/// The operation `VIDIOC_STREAMOFF`.
pub const STOP: u32 = 19;
/// `VIDIOC_G_PARM`, or `VIDIOC_S_PARM` if the first word is 1.
pub const INTERVAL: u32 = 22;
/// The operation `VIDIOC_G_CTRL`.
pub const CONTROL_VALUE: u32 = 27;
/// The operation `VIDIOC_S_CTRL`.
pub const SET_CONTROL: u32 = 28;
/// The operation `VIDIOC_QUERYCTRL`.
pub const CONTROL: u32 = 36;

/// The words of a message after its operation and error number.
pub type Words = [u32; 14];

const BYTES: usize = 64;

/// A request, a response or a filled buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message {
    /// One of the operation numbers of this module.
    pub operation: u32,
    /// 0, or the error number of a failed operation.
    pub errno: i32,
    /// The arguments or results of the operation.
    pub words: Words,
}

impl Message {
    /// A message without an error. Missing words are 0; words after the 14th are dropped.
    #[must_use]
    pub fn new(operation: u32, words: &[u32]) -> Self {
        let mut all = Words::default();
        all.iter_mut().zip(words).for_each(|(to, from)| *to = *from);
        Self { operation, errno: 0, words: all }
    }

    /// The response to an operation that failed.
    #[must_use]
    pub fn error(operation: u32, errno: Errno) -> Self {
        Self { operation, errno: errno.raw_os_error(), words: Words::default() }
    }

    /// The words of a message without an error.
    ///
    /// # Errors
    /// The error number of the message.
    pub fn outcome(self) -> Result<Words, Errno> {
        if self.errno == 0 { Ok(self.words) } else { Err(Errno::from_raw_os_error(self.errno)) }
    }

    /// Sends the message, along with a file if there is one.
    ///
    /// # Errors
    /// `ENODEV` when the other side closed the socket.
    pub fn send(self, socket: impl AsFd, file: Option<BorrowedFd<'_>>) -> Result<(), Errno> {
        let mut bytes = [0; BYTES];
        let header = [self.operation, self.errno.cast_unsigned()];
        for (to, word) in bytes.chunks_exact_mut(4).zip(header.iter().chain(&self.words)) {
            to.copy_from_slice(&word.to_le_bytes());
        }
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut extra = SendAncillaryBuffer::new(&mut space);
        let files: Vec<_> = file.into_iter().collect();
        if !files.is_empty() && !extra.push(SendAncillaryMessage::ScmRights(&files)) {
            return Err(Errno::NOMEM);
        }
        sendmsg(socket, &[IoSlice::new(&bytes)], &mut extra, SendFlags::NOSIGNAL)
            .map_err(closed_is_unplugged)?;
        Ok(())
    }

    /// Receives the next message and the file passed along with it. With `wait`, blocks up to the
    /// time-out of the socket.
    ///
    /// # Errors
    /// `EAGAIN` when there is no message, `ENODEV` when the other side closed the socket, `EBADMSG`
    /// when a message has another length.
    pub fn receive(socket: impl AsFd, wait: bool) -> Result<(Self, Option<OwnedFd>), Errno> {
        let mut bytes = [0; BYTES];
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut extra = RecvAncillaryBuffer::new(&mut space);
        let flags =
            RecvFlags::CMSG_CLOEXEC | if wait { RecvFlags::empty() } else { RecvFlags::DONTWAIT };
        let got = recvmsg(socket, &mut [IoSliceMut::new(&mut bytes)], &mut extra, flags)
            .map_err(closed_is_unplugged)?;
        let file = extra.drain().find_map(|message| match message {
            RecvAncillaryMessage::ScmRights(mut files) => files.next(),
            _ => None,
        });
        match got.bytes {
            0 => return Err(Errno::NODEV),
            BYTES => {}
            _ => return Err(Errno::BADMSG),
        }
        let mut numbers = bytes
            .chunks_exact(4)
            .map(|word| word.iter().rev().fold(0, |sum, byte| sum << 8 | u32::from(*byte)));
        let operation = numbers.next().unwrap_or(0);
        let errno = numbers.next().unwrap_or(0).cast_signed();
        let words = std::array::from_fn(|_| numbers.next().unwrap_or(0));
        Ok((Self { operation, errno, words }, file))
    }
}

/// Converts the errors of a closed socket to that of an unplugged camera.
fn closed_is_unplugged(errno: Errno) -> Errno {
    match errno {
        Errno::PIPE | Errno::CONNRESET | Errno::NOTCONN => Errno::NODEV,
        other => other,
    }
}

/// Data that can be encoded in the words of a message.
pub trait InWords: Sized {
    fn to_words(&self) -> Vec<u32>;
    fn from_words(words: &Words) -> Self;
}

impl InWords for Capability {
    fn to_words(&self) -> Vec<u32> {
        [self.capture, self.capture_planes, self.streaming].map(u32::from).to_vec()
    }

    fn from_words(words: &Words) -> Self {
        Self { capture: words[0] != 0, capture_planes: words[1] != 0, streaming: words[2] != 0 }
    }
}

impl InWords for Layout {
    fn to_words(&self) -> Vec<u32> {
        vec![self.width, self.height, self.format.0, self.stride, self.size, self.planes]
    }

    fn from_words(words: &Words) -> Self {
        let [width, height, format, stride, size, planes, ..] = *words;
        Self { width, height, format: FourCc(format), stride, size, planes }
    }
}

impl InWords for Interval {
    fn to_words(&self) -> Vec<u32> {
        vec![self.numerator, self.denominator]
    }

    fn from_words(words: &Words) -> Self {
        Self { numerator: words[0], denominator: words[1] }
    }
}

impl InWords for Control {
    fn to_words(&self) -> Vec<u32> {
        let numbers = [self.minimum, self.maximum, self.step].map(i32::cast_unsigned);
        let mut name = [0; 32];
        name.iter_mut().zip(self.name.bytes()).for_each(|(to, from)| *to = from);
        let mut words = vec![self.id, numbers[0], numbers[1], numbers[2], u32::from(self.disabled)];
        words.extend(
            name.chunks_exact(4)
                .map(|four| four.iter().rev().fold(0, |sum, byte| sum << 8 | u32::from(*byte))),
        );
        words
    }

    fn from_words(words: &Words) -> Self {
        let [id, minimum, maximum, step, disabled, name @ ..] = *words;
        let name: Vec<u8> =
            name.iter().flat_map(|word| word.to_le_bytes()).take_while(|byte| *byte != 0).collect();
        Self {
            id,
            name: String::from_utf8_lossy(&name).into_owned(),
            minimum: minimum.cast_signed(),
            maximum: maximum.cast_signed(),
            step: step.cast_signed(),
            disabled: disabled != 0,
        }
    }
}

impl InWords for Filled {
    fn to_words(&self) -> Vec<u32> {
        let time_ns = self.time_ns.unwrap_or(0);
        let flags = [self.time_ns.is_some(), self.stamped_at_start, self.damaged].map(u32::from);
        let high = (time_ns >> 32) as u32;
        let low = time_ns as u32;
        vec![self.index, self.bytes_used, self.sequence, high, low, flags[0], flags[1], flags[2]]
    }

    fn from_words(words: &Words) -> Self {
        let [index, bytes_used, sequence, high, low, stamped, at_start, damaged, ..] = *words;
        Self {
            index,
            bytes_used,
            sequence,
            time_ns: (stamped != 0).then_some(u64::from(high) << 32 | u64::from(low)),
            stamped_at_start: at_start != 0,
            damaged: damaged != 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round_trip<T: InWords>(value: &T) -> T {
        T::from_words(&Message::new(0, &value.to_words()).words)
    }

    #[test]
    fn every_type_is_decoded_as_it_was_encoded() {
        let control = Control {
            id: 7,
            name: "Exposure, Absolute".into(),
            minimum: -3,
            maximum: 9,
            step: 2,
            disabled: true,
        };
        assert_eq!(round_trip(&control), control);
        let filled = Filled {
            index: 3,
            bytes_used: 9,
            sequence: u32::MAX,
            time_ns: Some(u64::MAX - 5),
            stamped_at_start: true,
            damaged: false,
        };
        assert_eq!(round_trip(&filled), filled);
        assert_eq!(round_trip(&Filled { time_ns: None, ..filled }).time_ns, None);
        let layout =
            Layout { width: 1, height: 2, format: FourCc::NV12, stride: 3, size: 4, planes: 5 };
        assert_eq!(round_trip(&layout), layout);
    }

    #[test]
    fn a_message_arrives_with_its_file_and_a_closed_socket_is_an_unplugged_camera() {
        let (ours, theirs) = pair();
        let sent = Message {
            operation: 5,
            errno: -3,
            words: std::array::from_fn(|index| index as u32 * 0x1234_5678),
        };
        sent.send(&ours, Some(ours.as_fd())).unwrap();
        let (received, file) = Message::receive(&theirs, false).unwrap();
        assert_eq!((received, file.is_some()), (sent, true));
        assert_eq!(Message::receive(&theirs, false).unwrap_err(), Errno::AGAIN);
        drop((ours, file));
        assert_eq!(Message::receive(&theirs, false).unwrap_err(), Errno::NODEV);
        assert_eq!(sent.send(&theirs, None).unwrap_err(), Errno::NODEV);
    }

    fn pair() -> (OwnedFd, OwnedFd) {
        use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};
        socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).unwrap()
    }
}
