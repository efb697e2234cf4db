//! The side of the driver that the robot polls. It takes no lock and allocates nothing.

use std::sync::atomic::Ordering::Acquire;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use hal::{ErrorType, Imu, ImuSample};
use monotonic_clock::monotonic_ns;
use rustix::event::{EventfdFlags, eventfd};

use super::reader::Reader;
use super::{ImuConfig, ImuError, ImuPollError, ImuSetup, Roots, SampleCheck};
use crate::scanner::{Shared, Stop};
use crate::{DeviceState, DeviceStatus};

/// Number of samples that wait for the caller: two seconds at the highest rate.
pub const QUEUE: usize = 2000;

/// An inertial measurement unit. Dropping it ends its thread and stops the device.
#[derive(Debug)]
pub struct IioImu {
    samples: rtrb::Consumer<ImuSample>,
    device: Arc<str>,
    timeout_ms: u32,
    monitor: ImuMonitor,
    stop: Stop,
    reader: Option<JoinHandle<()>>,
}

/// Shows the unit's state to other threads.
#[derive(Debug, Clone)]
pub struct ImuMonitor {
    shared: Arc<Shared>,
    setup: Arc<Mutex<Option<ImuSetup>>>,
}

impl IioImu {
    /// Starts the driver; `None` if the configuration names no unit. It opens the unit automatically, now or when it appears.
    ///
    /// # Errors
    /// The configuration is not allowed, or the thread cannot be started.
    pub fn open(config: &ImuConfig) -> Result<Option<Self>, ImuError> {
        Self::open_in(config, Roots::default())
    }

    /// As [`open`](Self::open), with other folders than the kernel's, for tests.
    ///
    /// # Errors
    /// As [`open`](Self::open).
    pub fn open_in(config: &ImuConfig, roots: Roots) -> Result<Option<Self>, ImuError> {
        config.validate()?;
        if !config.is_used() {
            return Ok(None);
        }
        let (producer, samples) = rtrb::RingBuffer::new(QUEUE);
        let device: Arc<str> = config.device.as_str().into();
        let stop_event = eventfd(0, EventfdFlags::CLOEXEC)
            .map_err(|errno| ImuError::Thread { source: errno.into() })?;
        let stop: Stop = Arc::new(stop_event);
        let monitor = ImuMonitor { shared: Arc::default(), setup: Arc::default() };
        monitor.shared.set_state(DeviceState::Disconnected);
        let reader = Reader {
            config: config.clone(),
            device: Arc::clone(&device),
            roots,
            shared: Arc::clone(&monitor.shared),
            setup: Arc::clone(&monitor.setup),
            samples: producer,
            stop: Arc::clone(&stop),
            check: SampleCheck::default(),
        };
        let thread = std::thread::Builder::new()
            .name("imu".to_owned())
            .spawn(move || reader.run())
            .map_err(|source| ImuError::Thread { source })?;
        let timeout_ms = config.timeout_ms;
        Ok(Some(Self { samples, device, timeout_ms, monitor, stop, reader: Some(thread) }))
    }

    /// The unit's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.monitor.status()
    }

    /// A view of the unit for other threads.
    #[must_use]
    pub fn monitor(&self) -> ImuMonitor {
        self.monitor.clone()
    }

    /// Returns an error if samples do not arrive as they should. Also detects a thread that hangs.
    fn check_alive(&self) -> Result<(), ImuPollError> {
        let is_silent = match self.monitor.shared.state() {
            DeviceState::Starting | DeviceState::Disconnected => {
                return Err(ImuPollError::Disconnected { device: Arc::clone(&self.device) });
            }
            DeviceState::Faulty => {
                return Err(ImuPollError::Unsupported { device: Arc::clone(&self.device) });
            }
            DeviceState::Silent => true,
            DeviceState::Working => {
                let last_ns = self.monitor.shared.last_good_ns.load(Acquire);
                monotonic_ns().saturating_sub(last_ns) > u64::from(self.timeout_ms) * 1_000_000
            }
        };
        if is_silent {
            let limit_ms = self.timeout_ms;
            return Err(ImuPollError::Silent { device: Arc::clone(&self.device), limit_ms });
        }
        Ok(())
    }
}

impl ErrorType for IioImu {
    type Error = ImuPollError;
}

impl Imu for IioImu {
    fn poll_sample(&mut self) -> Result<Option<ImuSample>, ImuPollError> {
        // Samples from before a fault are returned before the fault, so that their rotation is not lost.
        match self.samples.pop() {
            Ok(sample) => Ok(Some(sample)),
            Err(_) => self.check_alive().map(|()| None),
        }
    }
}

impl Drop for IioImu {
    fn drop(&mut self) {
        _ = rustix::io::write(&*self.stop, &1_u64.to_ne_bytes());
        if let Some(reader) = self.reader.take() {
            _ = reader.join();
        }
    }
}

impl ImuMonitor {
    /// The unit's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.shared.status()
    }

    /// What the unit is and how it was set up; `None` before it was first opened.
    #[must_use]
    pub fn setup(&self) -> Option<ImuSetup> {
        self.setup.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// The last problem with its remedy, as a text for the operator. It remains after the problem is solved, which the state
    /// shows.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        self.shared.problem()
    }
}
