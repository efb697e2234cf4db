//! A simulated scanner on its wires, in a thread of its own.

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
use super::port::{Place, Plug};
use super::{Health, ScanSource, Sensor, WireFaults};

/// How often it looks for bytes and orders.
const LOOK_NS: u64 = 500_000;

/// A simulated scanner. Dropping it pulls the plug.
pub struct SimulatedHokuyo {
    inside: Arc<Mutex<Inside>>,
    thread: Option<JoinHandle<()>>,
}

struct Inside {
    sensor: Sensor,
    place: Place,
    plug: Option<Plug>,
    wire: WireFaults,
    /// The only rate at which it understands the host, when it minds.
    baud: Option<u32>,
    scans: u64,
    is_over: bool,
}

impl SimulatedHokuyo {
    /// On a pty, found through a symbolic link at `link`.
    ///
    /// # Errors
    /// When the system has no pty or the link cannot be made.
    pub fn on_pty(model: Model, link: &Path, source: Box<dyn ScanSource>) -> io::Result<Self> {
        Self::start(model, Place::Pty(link.to_owned()), source)
    }

    /// On a serial port of this computer, whose other end the host has.
    ///
    /// # Errors
    /// When the port cannot be opened.
    pub fn on_serial(model: Model, path: &Path, source: Box<dyn ScanSource>) -> io::Result<Self> {
        Self::start(model, Place::Serial(path.to_owned()), source)
    }

    /// On a TCP port; port 0 takes a free one.
    ///
    /// # Errors
    /// When the port is taken.
    pub fn on_tcp(
        model: Model,
        address: SocketAddr,
        source: Box<dyn ScanSource>,
    ) -> io::Result<Self> {
        Self::start(model, Place::Tcp(address), source)
    }

    fn start(model: Model, mut place: Place, source: Box<dyn ScanSource>) -> io::Result<Self> {
        let plug = Plug::put_in(&place)?;
        if let Some(address) = plug.address() {
            place = Place::Tcp(address);
        }
        let inside = Inside {
            sensor: Sensor::new(model, source, monotonic_ns()),
            place,
            plug: Some(plug),
            wire: WireFaults::default(),
            baud: None,
            scans: 0,
            is_over: false,
        };
        let inside = Arc::new(Mutex::new(inside));
        let worker = inside.clone();
        let thread = std::thread::Builder::new()
            .name("simulated-hokuyo".to_owned())
            .spawn(move || work(&worker))?;
        Ok(Self { inside, thread: Some(thread) })
    }

    fn inside(&self) -> MutexGuard<'_, Inside> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where it listens, on TCP.
    #[must_use]
    pub fn address(&self) -> Option<SocketAddr> {
        match self.inside().place {
            Place::Tcp(address) => Some(address),
            Place::Pty(_) | Place::Serial(_) => None,
        }
    }

    /// Faults of the wire from now on.
    pub fn set_wire(&self, wire: WireFaults) {
        self.inside().wire = wire;
    }

    /// What is wrong inside from now on.
    pub fn set_health(&self, health: Health) {
        self.inside().sensor.health = health;
    }

    /// How much its clock runs fast from now on, parts per million.
    pub fn set_clock_ppm(&self, ppm: f64) {
        self.inside().sensor.clock_ppm = ppm;
    }

    /// The only bit rate at which it understands the host and is understood.
    pub fn set_baud(&self, baud: u32) {
        self.inside().baud = Some(baud);
    }

    /// Restarts; it is ready after so long.
    pub fn reboot(&self, boot_ns: u64) {
        self.inside().sensor.reboot(monotonic_ns() + boot_ns);
    }

    /// Pulls the plug: its path or port is gone.
    pub fn unplug(&self) {
        self.inside().plug = None;
    }

    /// Puts the plug back in: the device starts anew, at the same stable path or port.
    ///
    /// # Errors
    /// As when it was made.
    pub fn plug_in(&self) -> io::Result<()> {
        let mut inside = self.inside();
        inside.plug = Some(Plug::put_in(&inside.place)?);
        inside.sensor.reboot(monotonic_ns());
        Ok(())
    }

    /// Whether its plug is in.
    #[must_use]
    pub fn is_plugged_in(&self) -> bool {
        self.inside().plug.is_some()
    }

    /// Scans sent so far, and whether it is sending.
    #[must_use]
    pub fn scans(&self) -> (u64, bool) {
        let inside = self.inside();
        (inside.scans, inside.sensor.is_streaming())
    }
}

impl Drop for SimulatedHokuyo {
    fn drop(&mut self) {
        self.inside().is_over = true;
        if let Some(thread) = self.thread.take() {
            _ = thread.join();
        }
    }
}

fn work(inside: &Mutex<Inside>) {
    let mut clock = MonotonicClock;
    let mut rng = seeded(1);
    let (mut buffer, mut answer, mut scan) = ([0; 256], Vec::new(), Vec::new());
    loop {
        let mut locked = inside.lock().unwrap_or_else(PoisonError::into_inner);
        let one = &mut *locked;
        if one.is_over {
            one.plug = None;
            return;
        }
        let now_ns = monotonic_ns();
        answer.clear();
        scan.clear();
        let is_understood = one
            .plug
            .as_ref()
            .and_then(Plug::baud)
            .is_none_or(|set| one.baud.is_none_or(|own| own == set));
        if let Some(plug) = &mut one.plug {
            let (count, is_gone) = plug.read(&mut buffer);
            if is_gone {
                one.sensor.receive(b"\nQT\n", now_ns, &mut answer);
                answer.clear();
            }
            if is_understood && !one.wire.is_stalled {
                one.sensor.receive(&buffer[..count], now_ns, &mut answer);
            } else if count > 0 {
                // What the device makes of it comes back as another rate's noise.
                answer.extend((0..count * 2).map(|_| rng.random::<u8>()));
            }
        }
        one.sensor.turn(now_ns, &mut scan);
        if !scan.is_empty() {
            one.scans += 1;
        }
        for message in [&mut answer, &mut scan] {
            one.wire.spoil(message, &mut rng);
            if let Some(plug) = &mut one.plug {
                plug.write(message);
            }
        }
        let until_ns = one.sensor.turn_end_ns().min(now_ns + LOOK_NS);
        drop(locked);
        clock.sleep_until_ns(until_ns);
    }
}
