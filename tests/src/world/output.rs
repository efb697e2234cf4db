//! A kernel camera that shows the frames that are written into its output: vivid in loopback.

use std::io::{Error, Write};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use hal::Clock;
use monotonic_clock::MonotonicClock;

use super::sensors::HomeCamera;
use crate::video::ImageSource;

/// A `v4l2-ctl` process that writes frames from its standard input into a V4L2 output.
pub(super) struct Output {
    writer: Child,
    node: String,
}

impl Output {
    /// Starts `v4l2-ctl`.
    ///
    /// # Errors
    /// Returns an error when `v4l2-ctl` is not installed.
    pub fn start(node: &str) -> Result<Self, Error> {
        // With two buffers, vivid shows one while the other is filled. More buffers would delay the
        // frames.
        let mut command = Command::new("v4l2-ctl");
        command.args(["-d", node, "--stream-out-mmap=2", "--stream-from=-"]);
        let writer =
            command.stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
        let writer = writer.map_err(|error| {
            Error::other(format!("cannot start `v4l2-ctl` for {node}: {error}"))
        })?;
        Ok(Self { writer, node: node.to_owned() })
    }

    /// Writes a frame in every period while `on`. Without new frames vivid repeats the last one,
    /// like a frozen camera.
    pub fn film(
        &mut self,
        mut camera: HomeCamera,
        period_ns: u64,
        running: &AtomicBool,
        on: &AtomicBool,
    ) {
        let Some(mut pipe) = self.writer.stdin.take() else { return };
        let width = camera.model.width;
        let height = camera.model.height;
        let mut yuyv = vec![0; 2 * width * height];
        let mut clock = MonotonicClock;
        let mut due_ns = clock.now_ns();
        while running.load(Ordering::Relaxed) {
            due_ns = (due_ns + period_ns).max(clock.now_ns());
            clock.sleep_until_ns(due_ns);
            if !on.load(Ordering::Relaxed) {
                continue;
            }
            camera.render(due_ns, width, height, &mut yuyv);
            if let Err(error) = pipe.write_all(&yuyv) {
                eprintln!("`v4l2-ctl` stopped writing frames to {}: {error}", self.node);
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
