//! The simulated inertial measurement unit of a home, at a Unix socket.

use std::io::{ErrorKind, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::iio::wire;
use hal::{Clock, Imu, ImuSample};
use monotonic_clock::MonotonicClock;
use simulator::robot::SimImu;

/// Time between two polls: half a period of the unit.
const POLL_NS: u64 = 5_000_000;

/// Sends every sample to all programs that are connected.
pub struct ImuServer {
    pub path: PathBuf,
    pub imu: SimImu,
    /// Time 0 of the home on the monotonic clock.
    pub start_ns: u64,
    /// Whether the unit is plugged in. Otherwise there is no socket.
    pub plugged: Arc<AtomicBool>,
}

impl ImuServer {
    /// Serves until `running` is false.
    pub fn run(mut self, running: &AtomicBool) {
        let mut clock = MonotonicClock;
        let mut socket = None;
        while running.load(Ordering::Relaxed) {
            if !self.plugged.load(Ordering::Relaxed) {
                socket = None;
            } else if socket.is_none() {
                match Socket::bind(&self.path) {
                    Ok(bound) => socket = Some(bound),
                    Err(error) => {
                        eprintln!(
                            "the simulated IMU cannot listen at {}: {error}",
                            self.path.display()
                        );
                        return;
                    }
                }
            }
            // What is measured while no program is connected is lost.
            while let Ok(Some(sample)) = self.imu.poll_sample() {
                let sample = ImuSample { time_ns: self.start_ns + sample.time_ns, ..sample };
                if let Some(socket) = &mut socket {
                    socket.send(&sample);
                }
            }
            clock.sleep_until_ns(clock.now_ns() + POLL_NS);
        }
    }
}

/// A listening socket with its clients. Its file goes with it.
struct Socket {
    path: PathBuf,
    listener: UnixListener,
    clients: Vec<UnixStream>,
}

impl Socket {
    /// Replaces a file that an earlier program has left.
    fn bind(path: &PathBuf) -> std::io::Result<Self> {
        match std::fs::remove_file(path) {
            Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = UnixListener::bind(path)?;
        listener.set_nonblocking(true)?;
        Ok(Self { path: path.clone(), listener, clients: Vec::new() })
    }

    fn send(&mut self, sample: &ImuSample) {
        while let Ok((client, _)) = self.listener.accept() {
            // A program that does not read must not hold up the others.
            if client.set_nonblocking(true).is_ok() {
                self.clients.push(client);
            }
        }
        let record = wire::encode(sample);
        self.clients.retain_mut(|client| client.write_all(&record).is_ok());
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}
