//! A strict model of the kernel's queue of video buffers (videobuf2): the same states, the same refusals.

use std::collections::VecDeque;

use rustix::io::Errno;

/// What is known of a filled buffer besides its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shot {
    /// Bytes of the picture.
    pub bytes_used: u32,
    /// The camera's count.
    pub sequence: u32,
    /// Stamp; `None` is one of an unknown clock.
    pub time_ns: Option<u64>,
    /// The camera says that it is damaged.
    pub damaged: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Dequeued,
    Queued,
    Done,
}

/// The queue.
#[derive(Debug, Clone, Default)]
pub struct Queue {
    buffers: Vec<State>,
    queued: VecDeque<u32>,
    done: VecDeque<(u32, Shot)>,
    streaming: bool,
    failed: bool,
    misuses: u64,
}

/// videobuf2's own limit.
const MOST_BUFFERS: u32 = 32;

impl Queue {
    /// `VIDIOC_REQBUFS`. 0 frees all.
    ///
    /// # Errors
    /// `EBUSY` while streaming.
    pub fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        if self.streaming {
            return self.misuse(Errno::BUSY);
        }
        let count = count.min(MOST_BUFFERS);
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
    /// `EINVAL` for a buffer that is not there or that the camera has.
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

    /// `VIDIOC_DQBUF` of a node that does not wait.
    ///
    /// # Errors
    /// `EINVAL` when not streaming, `EIO` after [`fail`](Self::fail), `EAGAIN` when none is filled.
    pub fn dequeue(&mut self) -> Result<(u32, Shot), Errno> {
        if !self.streaming {
            return self.misuse(Errno::INVAL);
        }
        if self.failed {
            return Err(Errno::IO);
        }
        let (index, shot) = self.done.pop_front().ok_or(Errno::AGAIN)?;
        self.buffers[index as usize] = State::Dequeued;
        Ok((index, shot))
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

    /// `VIDIOC_STREAMOFF`: every buffer comes back, and a failure is forgotten.
    pub fn stop(&mut self) {
        self.buffers.fill(State::Dequeued);
        self.queued.clear();
        self.done.clear();
        (self.streaming, self.failed) = (false, false);
    }

    /// The camera fills the oldest queued buffer, if there is one: which.
    pub fn fill(&mut self, shot: Shot) -> Option<u32> {
        if !self.streaming || self.failed {
            return None;
        }
        let index = self.queued.pop_front()?;
        self.buffers[index as usize] = State::Done;
        self.done.push_back((index, shot));
        Some(index)
    }

    /// Streaming fails for good, as `vb2_queue_error`.
    pub fn fail(&mut self) {
        self.failed = true;
    }

    /// Whether the camera runs.
    #[must_use]
    pub fn is_streaming(&self) -> bool {
        self.streaming
    }

    /// Calls that no correct program makes.
    #[must_use]
    pub fn misuses(&self) -> u64 {
        self.misuses
    }

    /// Buffers, and how many of them are queued, done and dequeued.
    #[must_use]
    pub fn counts(&self) -> [usize; 4] {
        let count = |wanted| self.buffers.iter().filter(|state| **state == wanted).count();
        [self.buffers.len(), count(State::Queued), count(State::Done), count(State::Dequeued)]
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

    const SHOT: Shot = Shot { bytes_used: 8, sequence: 0, time_ns: Some(0), damaged: false };

    #[test]
    fn a_wrong_order_of_calls_is_refused_as_the_kernel_refuses_it() {
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
        assert_eq!(queue.fill(SHOT), Some(0));
        assert_eq!(queue.queue(0), Err(Errno::INVAL), "filled, and not taken yet");
        assert_eq!(queue.dequeue(), Ok((0, SHOT)));
        queue.fail();
        assert_eq!(queue.dequeue(), Err(Errno::IO));
        queue.stop();
        assert_eq!(queue.counts(), [2, 0, 0, 2]);
    }

    proptest! {
        #[test]
        fn every_buffer_is_in_exactly_one_place_after_any_calls(calls in prop::collection::vec((0u8..7, 0u32..6), 0..200)) {
            let mut queue = Queue::default();
            for (call, index) in calls {
                let before = queue.clone();
                let outcome = match call {
                    0 => queue.allocate(index).map(|_| ()),
                    1 => queue.queue(index),
                    2 => queue.dequeue().map(|_| ()),
                    3 => queue.start(),
                    4 => { queue.stop(); Ok(()) }
                    5 => { queue.fill(SHOT); Ok(()) }
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
