//! A simulated scanner on its transport, in a thread of its own.

use std::io;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use drivers::scip::Model;
use hal::Clock;
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use rand::RngExt;

use super::faults::seeded;
use super::{Health, ScanSource, Sensor, WireFaults};
use crate::port::{Connection, Endpoint};

/// Polling interval of the transport.
const POLL_NS: u64 = 500_000;

/// A running simulated scanner. Dropping it stops the thread and closes the transport.
pub struct SimulatedHokuyo {
    state: Arc<Mutex<State>>,
    thread: Option<JoinHandle<()>>,
}

struct State {
    sensor: Sensor,
    endpoint: Endpoint,
    connection: Option<Connection>,
    wire: WireFaults,
    /// The only bit rate at which it communicates; `None` for any.
    baud: Option<u32>,
    scans: u64,
    stopped: bool,
}

impl SimulatedHokuyo {
    /// Starts a scanner on a pty with a symbolic link at `link`.
    ///
    /// # Errors
    /// Returns an error when no pty is available or the link cannot be created.
    pub fn on_pty(model: Model, link: &Path, source: Box<dyn ScanSource>) -> io::Result<Self> {
        Self::start(model, Endpoint::Pty(link.to_owned()), source)
    }

    /// Starts a scanner on a serial port of this computer; its other end is connected to the host.
    ///
    /// # Errors
    /// Returns an error when the port cannot be opened.
    pub fn on_serial(model: Model, path: &Path, source: Box<dyn ScanSource>) -> io::Result<Self> {
        Self::start(model, Endpoint::Serial(path.to_owned()), source)
    }

    /// Starts a scanner on a TCP port; port 0 selects a free port.
    ///
    /// # Errors
    /// Returns an error when the port is in use.
    pub fn on_tcp(
        model: Model,
        address: SocketAddr,
        source: Box<dyn ScanSource>,
    ) -> io::Result<Self> {
        Self::start(model, Endpoint::Tcp(address), source)
    }

    fn start(
        model: Model,
        mut endpoint: Endpoint,
        source: Box<dyn ScanSource>,
    ) -> io::Result<Self> {
        let connection = Connection::open(&endpoint)?;
        if let Some(address) = connection.address() {
            endpoint = Endpoint::Tcp(address);
        }
        let state = State {
            sensor: Sensor::new(model, source, monotonic_ns()),
            endpoint,
            connection: Some(connection),
            wire: WireFaults::default(),
            baud: None,
            scans: 0,
            stopped: false,
        };
        let state = Arc::new(Mutex::new(state));
        let worker = state.clone();
        let thread = std::thread::Builder::new()
            .name("simulated-hokuyo".to_owned())
            .spawn(move || run(&worker))?;
        Ok(Self { state, thread: Some(thread) })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Local address, on TCP.
    #[must_use]
    pub fn address(&self) -> Option<SocketAddr> {
        match self.state().endpoint {
            Endpoint::Tcp(address) => Some(address),
            Endpoint::Pty(_) | Endpoint::Serial(_) => None,
        }
    }

    /// Sets the faults of the transport.
    pub fn set_wire(&self, wire: WireFaults) {
        self.state().wire = wire;
    }

    /// Sets the internal state of health.
    pub fn set_health(&self, health: Health) {
        self.state().sensor.health = health;
    }

    /// Sets the rate error of its clock, parts per million.
    pub fn set_clock_ppm(&self, ppm: f64) {
        self.state().sensor.clock_ppm = ppm;
    }

    /// Gives every scan of this number a wrong time stamp; 0 ends it.
    pub fn set_wrong_stamp_every(&self, scans: u32) {
        self.state().sensor.wrong_stamp_every = scans;
    }

    /// Sets the only bit rate at which the scanner communicates.
    pub fn set_baud(&self, baud: u32) {
        self.state().baud = Some(baud);
    }

    /// Restarts the scanner. It is ready after `boot_ns`.
    pub fn reboot(&self, boot_ns: u64) {
        self.state().sensor.reboot(monotonic_ns() + boot_ns);
    }

    /// Unplugs the scanner: its path or port disappears.
    pub fn unplug(&self) {
        self.state().connection = None;
    }

    /// Plugs the scanner in again. It restarts at the same stable path or port.
    ///
    /// # Errors
    /// Returns the same errors as the constructor.
    pub fn plug_in(&self) -> io::Result<()> {
        let mut state = self.state();
        state.connection = Some(Connection::open(&state.endpoint)?);
        state.sensor.reboot(monotonic_ns());
        Ok(())
    }

    #[must_use]
    pub fn is_plugged_in(&self) -> bool {
        self.state().connection.is_some()
    }

    /// Number of scans sent so far, and whether the scanner is streaming.
    #[must_use]
    pub fn scans(&self) -> (u64, bool) {
        let state = self.state();
        (state.scans, state.sensor.is_streaming())
    }
}

impl Drop for SimulatedHokuyo {
    fn drop(&mut self) {
        self.state().stopped = true;
        if let Some(thread) = self.thread.take() {
            _ = thread.join();
        }
    }
}

fn run(state: &Mutex<State>) {
    let mut clock = MonotonicClock;
    let mut rng = seeded(1);
    let mut buffer = [0; 256];
    let mut answer = Vec::new();
    let mut scan = Vec::new();
    loop {
        let mut locked = state.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *locked;
        if state.stopped {
            state.connection = None;
            return;
        }
        let now_ns = monotonic_ns();
        answer.clear();
        scan.clear();
        let is_understood = state
            .connection
            .as_ref()
            .and_then(Connection::baud)
            .is_none_or(|set| state.baud.is_none_or(|own| own == set));
        if let Some(connection) = &mut state.connection {
            let (count, is_gone) = connection.read(&mut buffer);
            if is_gone {
                state.sensor.receive(b"\nQT\n", now_ns, &mut answer);
                answer.clear();
            }
            if is_understood && !state.wire.is_stalled {
                state.sensor.receive(&buffer[..count], now_ns, &mut answer);
            } else if count > 0 {
                // At a wrong bit rate both sides receive noise.
                answer.extend((0..count * 2).map(|_| rng.random::<u8>()));
            }
        }
        state.sensor.update(now_ns, &mut scan);
        if !scan.is_empty() {
            state.scans += 1;
        }
        for message in [&mut answer, &mut scan] {
            state.wire.corrupt(message, &mut rng);
            if let Some(connection) = &mut state.connection {
                connection.write(message);
            }
        }
        let until_ns = state.sensor.rotation_end_ns().min(now_ns + POLL_NS);
        drop(locked);
        clock.sleep_until_ns(until_ns);
    }
}
