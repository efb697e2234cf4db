//! How a simulated camera in another process is spoken to: V4L2's operations as messages of 64 bytes over a Unix socket that
//! keeps them apart (`SOCK_SEQPACKET`), pictures in memory files that come along with the messages.
//!
//! Every request is answered by a message with the same operation, but for [`QUEUE`], which is not answered: like a real
//! node, the camera hands out filled buffers by itself, as [`FILLED`]. A [`FILLED`] with an error number is what the next
//! `VIDIOC_DQBUF` shall return.

use std::io::{IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, recvmsg, sendmsg,
};

use super::node::{Capability, Control, Filled, FourCc, Interval, Layout};

/// `VIDIOC_QUERYCAP`.
pub const CAPABILITY: u32 = 0;
/// `VIDIOC_ENUM_FMT`.
pub const FORMAT: u32 = 2;
/// `VIDIOC_S_FMT`.
pub const SET_LAYOUT: u32 = 5;
/// `VIDIOC_REQBUFS`.
pub const ALLOCATE: u32 = 8;
/// `VIDIOC_QUERYBUF`; the answer carries the memory file.
pub const BUFFER: u32 = 9;
/// `VIDIOC_QBUF`, not answered.
pub const QUEUE: u32 = 15;
/// `VIDIOC_DQBUF`, only ever sent by the camera.
pub const FILLED: u32 = 17;
/// `VIDIOC_STREAMON`.
pub const START: u32 = 18;
/// `VIDIOC_STREAMOFF`.
pub const STOP: u32 = 19;
/// `VIDIOC_G_PARM`, and `VIDIOC_S_PARM` where the first word is 1.
pub const INTERVAL: u32 = 22;
/// `VIDIOC_G_CTRL`.
pub const CONTROL_VALUE: u32 = 27;
/// `VIDIOC_S_CTRL`.
pub const SET_CONTROL: u32 = 28;
/// `VIDIOC_QUERYCTRL`.
pub const CONTROL: u32 = 36;

/// Words of a message after its operation and error number.
pub type Words = [u32; 14];

const BYTES: usize = 64;

/// One request, answer or filled buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Message {
    /// One of the numbers above.
    pub operation: u32,
    /// 0, or the error number of an answer.
    pub errno: i32,
    /// What the operation needs or says.
    pub words: Words,
}

impl Message {
    /// A message without an error; missing words are 0, those past the 14th are left out.
    #[must_use]
    pub fn new(operation: u32, words: &[u32]) -> Self {
        let mut all = Words::default();
        all.iter_mut().zip(words).for_each(|(to, from)| *to = *from);
        Self { operation, errno: 0, words: all }
    }

    /// A message that says no.
    #[must_use]
    pub fn error(operation: u32, errno: Errno) -> Self {
        Self { operation, errno: errno.raw_os_error(), words: Words::default() }
    }

    /// The words of a message that says yes.
    ///
    /// # Errors
    /// The error number that it carries.
    pub fn outcome(self) -> Result<Words, Errno> {
        if self.errno == 0 { Ok(self.words) } else { Err(Errno::from_raw_os_error(self.errno)) }
    }

    /// Sends it, with a file where there is one.
    ///
    /// # Errors
    /// `ENODEV` when the other side is gone.
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
        sendmsg(socket, &[IoSlice::new(&bytes)], &mut extra, SendFlags::NOSIGNAL).map_err(gone)?;
        Ok(())
    }

    /// The next message and the file that came with it; with `wait`, as long as the socket's time limit allows.
    ///
    /// # Errors
    /// `EAGAIN` when there is none, `ENODEV` when the other side is gone, `EBADMSG` when it sends something else.
    pub fn receive(socket: impl AsFd, wait: bool) -> Result<(Self, Option<OwnedFd>), Errno> {
        let mut bytes = [0; BYTES];
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
        let mut extra = RecvAncillaryBuffer::new(&mut space);
        let flags =
            RecvFlags::CMSG_CLOEXEC | if wait { RecvFlags::empty() } else { RecvFlags::DONTWAIT };
        let got =
            recvmsg(socket, &mut [IoSliceMut::new(&mut bytes)], &mut extra, flags).map_err(gone)?;
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
        let (operation, errno) =
            (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0).cast_signed());
        Ok((
            Self { operation, errno, words: std::array::from_fn(|_| numbers.next().unwrap_or(0)) },
            file,
        ))
    }
}

/// A closed socket is an unplugged camera.
fn gone(errno: Errno) -> Errno {
    match errno {
        Errno::PIPE | Errno::CONNRESET | Errno::NOTCONN => Errno::NODEV,
        other => other,
    }
}

/// Data that travels in a message's words.
pub trait InWords: Sized {
    /// The words, at most 14.
    fn to_words(&self) -> Vec<u32>;
    /// Back again.
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
        let (high, low) = ((time_ns >> 32) as u32, time_ns as u32);
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

    fn there_and_back<T: InWords>(value: &T) -> T {
        T::from_words(&Message::new(0, &value.to_words()).words)
    }

    #[test]
    fn everything_that_travels_arrives_as_it_was_sent() {
        let control = Control {
            id: 7,
            name: "Exposure, Absolute".into(),
            minimum: -3,
            maximum: 9,
            step: 2,
            disabled: true,
        };
        assert_eq!(there_and_back(&control), control);
        let filled = Filled {
            index: 3,
            bytes_used: 9,
            sequence: u32::MAX,
            time_ns: Some(u64::MAX - 5),
            stamped_at_start: true,
            damaged: false,
        };
        assert_eq!(there_and_back(&filled), filled);
        assert_eq!(there_and_back(&Filled { time_ns: None, ..filled }).time_ns, None);
        let layout =
            Layout { width: 1, height: 2, format: FourCc::NV12, stride: 3, size: 4, planes: 5 };
        assert_eq!(there_and_back(&layout), layout);
    }

    #[test]
    fn a_message_crosses_a_socket_whole_and_a_closed_socket_is_an_unplugged_camera() {
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
