//! A gyroscope that the kernel takes for a HID sensor: its driver hid-sensor-gyro-3d makes an IIO device of it. The sensor itself
//! is this program, through /dev/uhid.
//!
//! The numbers are from the HID Usage Tables (page 0x20, "Sensors") and from `linux/uhid.h`.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use monotonic_clock::monotonic_ns;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// The sensor sends at this rate whatever the kernel asks for.
const PERIOD_NS: u64 = 10_000_000;
/// One degree per second, with the digits that the kernel's driver has. It is the unit of a gyroscope whose descriptor names none.
pub const STEP_RADPS: f64 = 0.017_453_293;

/// Report 1, as a feature: how the sensor works. As an input: three values of 32 bits.
const DESCRIPTOR: &[u8] = &[
    0x05, 0x20, // Usage page: sensors
    0x09, 0x76, // Usage: gyrometer 3D
    0xa1, 0x00, // Collection: physical
    0x85, 0x01, // Report 1
    0x0a, 0x16, 0x03, // Usage: reporting state, one of six
    0x15, 0x00, 0x25, 0x05, 0x75, 0x08, 0x95, 0x01, // 0 to 5, 8 bits
    0xa1, 0x02, // Collection: logical
    0x0a, 0x40, 0x08, 0x0a, 0x41, 0x08, 0x0a, 0x42, 0x08, // No events, all events, ...
    0x0a, 0x43, 0x08, 0x0a, 0x44, 0x08, 0x0a, 0x45, 0x08, //
    0xb1, 0x00, // Feature: array
    0xc0, //
    0x0a, 0x19, 0x03, // Usage: power state, one of six
    0xa1, 0x02, // Collection: logical
    0x0a, 0x50, 0x08, 0x0a, 0x51, 0x08, 0x0a, 0x52, 0x08, // Undefined, full power, ...
    0x0a, 0x53, 0x08, 0x0a, 0x54, 0x08, 0x0a, 0x55, 0x08, //
    0xb1, 0x00, // Feature: array
    0xc0, //
    0x15, 0x00, 0x27, 0xff, 0xff, 0xff, 0x7f, 0x75, 0x20, // 0 to 2^31 - 1, 32 bits
    0x0a, 0x0e, 0x03, // Usage: report interval, milliseconds
    0xb1, 0x02, // Feature: variable
    0x0a, 0x56, 0x14, // Usage: change sensitivity of the angular velocity
    0xb1, 0x02, // Feature: variable
    0x17, 0x00, 0x00, 0x00, 0x80, // -2^31 to 2^31 - 1
    0x0a, 0x57, 0x04, 0x81, 0x02, // Usage: angular velocity about x; input
    0x0a, 0x58, 0x04, 0x81, 0x02, // y
    0x0a, 0x59, 0x04, 0x81, 0x02, // z
    0xc0,
];
/// Report number, states, interval (10 ms) and sensitivity.
const FEATURES: [u8; 11] = [1, 0, 0, 10, 0, 0, 0, 0, 0, 0, 0];
/// `sizeof(struct uhid_event)`.
const EVENT_BYTES: usize = 4380;
const DESTROY: u32 = 1;
const GET_REPORT: u32 = 9;
const GET_REPORT_REPLY: u32 = 10;
const CREATE: u32 = 11;
const INPUT: u32 = 12;
const SET_REPORT: u32 = 13;
const SET_REPORT_REPLY: u32 = 14;
const BUS_USB: u16 = 3;

/// A sensor that is plugged in. Dropping it unplugs it.
pub struct HidGyroscope {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<io::Result<()>>>,
}

#[derive(Default)]
struct Shared {
    ends: AtomicBool,
    is_paused: AtomicBool,
    /// When each sample was sent, by its index.
    sent_ns: Mutex<Vec<u64>>,
}

/// The values of the sample of this index, degrees per second. They stay below the driver's limit of 100 rad/s for 50 s.
pub fn raw(index: i32) -> [i32; 3] {
    [index, -index / 2, 1000 + index % 10]
}

impl HidGyroscope {
    /// Plugs the sensor in. It sends samples at once.
    pub fn plug_in() -> io::Result<Self> {
        let mut file = OpenOptions::new().read(true).write(true).open("/dev/uhid")?;
        file.write_all(&create())?;
        let shared = Arc::new(Shared::default());
        let sensor = Sensor { file, features: FEATURES.to_vec(), shared: Arc::clone(&shared) };
        let thread =
            std::thread::Builder::new().name("gyroscope".to_owned()).spawn(move || sensor.run())?;
        Ok(Self { shared, thread: Some(thread) })
    }

    /// Lets the sensor stop sending, or send again.
    pub fn set_paused(&self, is_paused: bool) {
        self.shared.is_paused.store(is_paused, Ordering::Release);
    }

    /// When the sample of this index was sent.
    pub fn sent_ns(&self, index: i32) -> Option<u64> {
        let sent = self.shared.sent_ns.lock().unwrap_or_else(PoisonError::into_inner);
        sent.get(usize::try_from(index).ok()?).copied()
    }
}

impl Drop for HidGyroscope {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        if let Some(Ok(Err(error))) = self.thread.take().map(JoinHandle::join) {
            eprintln!("the simulated gyroscope failed: {error}");
        }
    }
}

/// What the sensor's thread owns.
struct Sensor {
    file: File,
    features: Vec<u8>,
    shared: Arc<Shared>,
}

impl Sensor {
    /// Answers the kernel and sends samples until the sensor is unplugged.
    fn run(mut self) -> io::Result<()> {
        let mut next_ns = monotonic_ns();
        while !self.shared.ends.load(Ordering::Acquire) {
            if self.wait(next_ns)? {
                self.answer()?;
            }
            if monotonic_ns() >= next_ns {
                next_ns += PERIOD_NS;
                self.send()?;
            }
        }
        self.file.write_all(&DESTROY.to_le_bytes())
    }

    /// Returns whether the kernel asks something before this time.
    fn wait(&self, until_ns: u64) -> io::Result<bool> {
        let left_ns = until_ns.saturating_sub(monotonic_ns());
        let timeout = Timespec { tv_sec: 0, tv_nsec: left_ns as i64 };
        let mut fds = [PollFd::new(&self.file, PollFlags::IN)];
        Ok(poll(&mut fds, Some(&timeout))? > 0)
    }

    fn answer(&mut self) -> io::Result<()> {
        let mut event = [0; EVENT_BYTES];
        let count = self.file.read(&mut event)?;
        let event = &event[..count];
        let word = |at: usize| event.get(at..at + 4).unwrap_or_default();
        let kind = word(0).try_into().map_or(0, u32::from_le_bytes);
        let id = word(4);
        let reply = match kind {
            // struct uhid_get_report_reply_req: id, error, size, data.
            GET_REPORT => {
                let size = (self.features.len() as u16).to_le_bytes();
                [&GET_REPORT_REPLY.to_le_bytes(), id, &[0; 2], &size, &self.features].concat()
            }
            // struct uhid_set_report_req: id, report, type, size, data.
            SET_REPORT => {
                if let Some(data) = event.get(12..12 + FEATURES.len()) {
                    self.features = data.to_vec();
                }
                [&SET_REPORT_REPLY.to_le_bytes(), id, &[0; 2]].concat()
            }
            _ => return Ok(()),
        };
        self.file.write_all(&reply)
    }

    fn send(&mut self) -> io::Result<()> {
        if self.shared.is_paused.load(Ordering::Acquire) {
            return Ok(());
        }
        let mut sent = self.shared.sent_ns.lock().unwrap_or_else(PoisonError::into_inner);
        let values = raw(sent.len() as i32).map(i32::to_le_bytes).concat();
        let size = (1 + values.len() as u16).to_le_bytes();
        let event = [&INPUT.to_le_bytes()[..], &size, &[1], &values].concat();
        sent.push(monotonic_ns());
        self.file.write_all(&event)
    }
}

/// struct uhid_create2_req: name, two more names, size of the descriptor, bus, four numbers, descriptor.
fn create() -> Vec<u8> {
    let mut event = CREATE.to_le_bytes().to_vec();
    let mut names = [0; 256];
    let name = b"rig gyroscope";
    names[..name.len()].copy_from_slice(name);
    event.extend(names);
    event.extend((DESCRIPTOR.len() as u16).to_le_bytes());
    event.extend(BUS_USB.to_le_bytes());
    event.extend([0; 16]);
    event.extend(DESCRIPTOR);
    event
}
