//! A strict model of the kernel's queue of video buffers (videobuf2), with the same states and the
//! same error codes.

use std::collections::VecDeque;

use rustix::io::Errno;

/// Metadata of a filled buffer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameInfo {
    pub bytes_used: u32,
    /// The camera's frame counter.
    pub sequence: u32,
    /// Timestamp; `None` for one of an unknown clock.
    pub time_ns: Option<u64>,
    /// The camera reports the frame as damaged.
    pub damaged: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Dequeued,
    Queued,
    Done,
}

/// The buffer queue.
#[derive(Debug, Clone, Default)]
pub struct Queue {
    buffers: Vec<State>,
    queued: VecDeque<u32>,
    done: VecDeque<(u32, FrameInfo)>,
    streaming: bool,
    failed: bool,
    misuses: u64,
}

/// Largest number of buffers in videobuf2.
const MAX_BUFFERS: u32 = 32;

impl Queue {
    /// `VIDIOC_REQBUFS`. A count of 0 frees all buffers.
    ///
    /// # Errors
    /// `EBUSY` while streaming.
    pub fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        if self.streaming {
            return self.misuse(Errno::BUSY);
        }
        let count = count.min(MAX_BUFFERS);
        *self = Self {
            buffers: vec![State::Dequeued; count as usize],
            misuses: self.misuses,
            ..Self::default()
        };
        Ok(count)
    }

    /// `VIDIOC_QBUF`.
    ///
    /// # Errors
    /// `EINVAL` for a buffer that does not exist or that the camera holds.
    pub fn queue(&mut self, index: u32) -> Result<(), Errno> {
        match self.buffers.get_mut(index as usize) {
            Some(state @ State::Dequeued) => {
                *state = State::Queued;
                self.queued.push_back(index);
                Ok(())
            }
            _ => self.misuse(Errno::INVAL),
        }
    }

    /// `VIDIOC_DQBUF` on a non-blocking node.
    ///
    /// # Errors
    /// `EINVAL` when not streaming, `EIO` after [`fail`](Self::fail), `EAGAIN` when no buffer is
    /// filled.
    pub fn dequeue(&mut self) -> Result<(u32, FrameInfo), Errno> {
        if !self.streaming {
            return self.misuse(Errno::INVAL);
        }
        if self.failed {
            return Err(Errno::IO);
        }
        let (index, info) = self.done.pop_front().ok_or(Errno::AGAIN)?;
        self.buffers[index as usize] = State::Dequeued;
        Ok((index, info))
    }

    /// `VIDIOC_STREAMON`.
    ///
    /// # Errors
    /// `EINVAL` without buffers.
    pub fn start(&mut self) -> Result<(), Errno> {
        if self.buffers.is_empty() {
            return self.misuse(Errno::INVAL);
        }
        self.streaming = true;
        Ok(())
    }

    /// `VIDIOC_STREAMOFF`: returns every buffer and clears a failure.
    pub fn stop(&mut self) {
        self.buffers.fill(State::Dequeued);
        self.queued.clear();
        self.done.clear();
        self.streaming = false;
        self.failed = false;
    }

    /// Fills the oldest queued buffer, if there is one, and returns its index.
    pub fn fill(&mut self, info: FrameInfo) -> Option<u32> {
        if !self.streaming || self.failed {
            return None;
        }
        let index = self.queued.pop_front()?;
        self.buffers[index as usize] = State::Done;
        self.done.push_back((index, info));
        Some(index)
    }

    /// Makes streaming fail permanently, like `vb2_queue_error`.
    pub fn fail(&mut self) {
        self.failed = true;
    }

    #[must_use]
    pub fn is_streaming(&self) -> bool {
        self.streaming
    }

    /// Number of calls that no correct program makes.
    #[must_use]
    pub fn misuses(&self) -> u64 {
        self.misuses
    }

    /// Number of buffers, and how many of them are queued, done and dequeued.
    #[must_use]
    pub fn counts(&self) -> [usize; 4] {
        [
            self.buffers.len(),
            self.count(State::Queued),
            self.count(State::Done),
            self.count(State::Dequeued),
        ]
    }

    fn count(&self, state: State) -> usize {
        self.buffers.iter().filter(|buffer| **buffer == state).count()
    }

    fn misuse<T>(&mut self, errno: Errno) -> Result<T, Errno> {
        self.misuses += 1;
        Err(errno)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const INFO: FrameInfo =
        FrameInfo { bytes_used: 8, sequence: 0, time_ns: Some(0), damaged: false };

    #[test]
    fn calls_in_a_wrong_order_get_the_kernels_error_codes() {
        let mut queue = Queue::default();
        assert_eq!(queue.start(), Err(Errno::INVAL), "no buffers");
        assert_eq!(queue.dequeue(), Err(Errno::INVAL), "not streaming");
        queue.allocate(2).unwrap();
        queue.queue(0).unwrap();
        assert_eq!(queue.queue(0), Err(Errno::INVAL), "queued already");
        assert_eq!(queue.queue(2), Err(Errno::INVAL), "no such buffer");
        queue.start().unwrap();
        assert_eq!(queue.allocate(0), Err(Errno::BUSY));
        assert_eq!(queue.dequeue(), Err(Errno::AGAIN));
        assert_eq!(queue.fill(INFO), Some(0));
        assert_eq!(queue.queue(0), Err(Errno::INVAL), "filled, and not taken yet");
        assert_eq!(queue.dequeue(), Ok((0, INFO)));
        queue.fail();
        assert_eq!(queue.dequeue(), Err(Errno::IO));
        queue.stop();
        assert_eq!(queue.counts(), [2, 0, 0, 2]);
    }

    proptest! {
        #[test]
        fn every_buffer_is_in_exactly_one_state_after_any_calls(calls in prop::collection::vec((0u8..7, 0u32..6), 0..200)) {
            let mut queue = Queue::default();
            for (call, index) in calls {
                let before = queue.clone();
                let outcome = match call {
                    0 => queue.allocate(index).map(|_| ()),
                    1 => queue.queue(index),
                    2 => queue.dequeue().map(|_| ()),
                    3 => queue.start(),
                    4 => { queue.stop(); Ok(()) }
                    5 => { queue.fill(INFO); Ok(()) }
                    _ => { queue.fail(); Ok(()) }
                };
                let [all, queued, done, dequeued] = queue.counts();
                prop_assert_eq!(all, queued + done + dequeued);
                prop_assert_eq!((queue.queued.len(), queue.done.len()), (queued, done));
                if outcome.is_err() {
                    prop_assert_eq!(before.counts(), queue.counts());
                }
            }
        }
    }
}
