//! A camera of the kernel that shows what is written into its output: vivid with its loop closed.

use std::io::{Error, Write};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use hal::Clock;
use monotonic_clock::MonotonicClock;

use super::sight::HomePicture;
use crate::video::PictureSource;

/// `v4l2-ctl`, which writes pictures from its standard input into a V4L2 output.
pub(super) struct Output {
    writer: Child,
    node: String,
}

impl Output {
    /// Starts it.
    ///
    /// # Errors
    /// When it is not installed.
    pub fn start(node: &str) -> Result<Self, Error> {
        // With two buffers, vivid shows one while the other is filled: more would make pictures older.
        let mut command = Command::new("v4l2-ctl");
        command.args(["-d", node, "--stream-out-mmap=2", "--stream-from=-"]);
        let writer =
            command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let writer = writer.map_err(|error| {
            Error::other(format!("cannot start `v4l2-ctl` for {node}: {error}"))
        })?;
        Ok(Self { writer, node: node.to_owned() })
    }

    /// Writes a picture in every period while `on`. Without new ones vivid shows the last one again: a camera that is frozen.
    pub fn film(
        &mut self,
        mut eyes: HomePicture,
        period_ns: u64,
        running: &AtomicBool,
        on: &AtomicBool,
    ) {
        let Some(mut pipe) = self.writer.stdin.take() else { return };
        let (width, height) = (eyes.model.width, eyes.model.height);
        let mut picture = vec![0; 2 * width * height];
        let mut clock = MonotonicClock;
        let mut due_ns = clock.now_ns();
        while running.load(Ordering::Relaxed) {
            due_ns = (due_ns + period_ns).max(clock.now_ns());
            clock.sleep_until_ns(due_ns);
            if !on.load(Ordering::Relaxed) {
                continue;
            }
            eyes.picture(due_ns, width, height, &mut picture);
            if let Err(error) = pipe.write_all(&picture) {
                eprintln!("`v4l2-ctl` writes no more pictures to {}: {error}", self.node);
                return;
            }
        }
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        _ = self.writer.kill();
        _ = self.writer.wait();
    }
}
