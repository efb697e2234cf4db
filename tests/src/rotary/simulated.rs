//! A simulated scanner on its transport, in a thread of its own.

use std::io;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use hal::Clock;
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use rand::RngExt;

use crate::hokuyo::WireFaults;
use crate::hokuyo::seeded;
use crate::port::{Connection, Endpoint};

/// Polling interval of the transport.
const POLL_NS: u64 = 500_000;

/// A scanner without a transport: bytes and times go in, messages come out.
pub trait Sensor: Send + 'static {
    /// Processes bytes from the host and appends the answers to `out`.
    fn receive(&mut self, bytes: &[u8], now_ns: u64, out: &mut Vec<Vec<u8>>);

    /// Appends the messages that are due at `now_ns` to `out`.
    fn update(&mut self, now_ns: u64, out: &mut Vec<Vec<u8>>);

    /// Restarts the scanner. It ignores input and sends nothing before `ready_ns`.
    fn reboot(&mut self, ready_ns: u64);
}

/// A running simulated scanner. Dropping it stops the thread and closes the transport.
pub struct SimulatedRotary<S: Sensor> {
    state: Arc<Mutex<State<S>>>,
    thread: Option<JoinHandle<()>>,
}

struct State<S> {
    sensor: S,
    endpoint: Endpoint,
    connection: Option<Connection>,
    wire: WireFaults,
    /// The only bit rate at which it communicates; `None` for any.
    baud: Option<u32>,
    stopped: bool,
}

impl<S: Sensor> SimulatedRotary<S> {
    /// Starts a scanner on a pty with a symbolic link at `link`.
    ///
    /// # Errors
    /// Returns an error when no pty is available or the link cannot be created.
    pub fn on_pty(link: &Path, sensor: S) -> io::Result<Self> {
        Self::start(Endpoint::Pty(link.to_owned()), sensor)
    }

    /// Starts a scanner on a serial port of this computer; its other end is connected to the host.
    ///
    /// # Errors
    /// Returns an error when the port cannot be opened.
    pub fn on_serial(path: &Path, sensor: S) -> io::Result<Self> {
        Self::start(Endpoint::Serial(path.to_owned()), sensor)
    }

    fn start(endpoint: Endpoint, sensor: S) -> io::Result<Self> {
        let connection = Connection::open(&endpoint)?;
        let state = Arc::new(Mutex::new(State {
            sensor,
            endpoint,
            connection: Some(connection),
            wire: WireFaults::default(),
            baud: None,
            stopped: false,
        }));
        let worker = state.clone();
        let thread = std::thread::Builder::new()
            .name("simulated-lidar".to_owned())
            .spawn(move || run(&worker))?;
        Ok(Self { state, thread: Some(thread) })
    }

    fn state(&self) -> MutexGuard<'_, State<S>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reads or changes the scanner's state.
    pub fn with<T>(&self, access: impl FnOnce(&mut S) -> T) -> T {
        access(&mut self.state().sensor)
    }

    /// Sets the faults of the transport.
    pub fn set_wire(&self, wire: WireFaults) {
        self.state().wire = wire;
    }

    /// Sets the only bit rate at which the scanner communicates.
    pub fn set_baud(&self, baud: u32) {
        self.state().baud = Some(baud);
    }

    /// Restarts the scanner. It is ready after `boot_ns`.
    pub fn reboot(&self, boot_ns: u64) {
        self.state().sensor.reboot(monotonic_ns() + boot_ns);
    }

    /// Unplugs the scanner: its path disappears.
    pub fn unplug(&self) {
        self.state().connection = None;
    }

    /// Plugs the scanner in again. It restarts at the same stable path.
    ///
    /// # Errors
    /// Returns the same errors as the constructor.
    pub fn plug_in(&self) -> io::Result<()> {
        let mut state = self.state();
        state.connection = Some(Connection::open(&state.endpoint)?);
        state.sensor.reboot(monotonic_ns());
        Ok(())
    }
}

impl<S: Sensor> Drop for SimulatedRotary<S> {
    fn drop(&mut self) {
        self.state().stopped = true;
        if let Some(thread) = self.thread.take() {
            _ = thread.join();
        }
    }
}

fn run<S: Sensor>(state: &Mutex<State<S>>) {
    let mut clock = MonotonicClock;
    let mut rng = seeded(1);
    let mut buffer = [0; 256];
    let mut messages = Vec::new();
    loop {
        let mut locked = state.lock().unwrap_or_else(PoisonError::into_inner);
        let state = &mut *locked;
        if state.stopped {
            state.connection = None;
            return;
        }
        let now_ns = monotonic_ns();
        let set_baud = state.connection.as_ref().and_then(Connection::baud);
        let is_understood = set_baud.is_none_or(|set| state.baud.is_none_or(|own| own == set));
        if let Some(connection) = &mut state.connection {
            let (count, _) = connection.read(&mut buffer);
            if is_understood && !state.wire.is_stalled {
                state.sensor.receive(&buffer[..count], now_ns, &mut messages);
            }
        }
        state.sensor.update(now_ns, &mut messages);
        for mut message in messages.drain(..) {
            if !is_understood {
                // At a wrong bit rate the host receives noise.
                message.iter_mut().for_each(|byte| *byte = rng.random());
            }
            state.wire.corrupt(&mut message, &mut rng);
            if let Some(connection) = &mut state.connection {
                connection.write(&message);
            }
        }
        drop(locked);
        clock.sleep_until_ns(now_ns + POLL_NS);
    }
}
