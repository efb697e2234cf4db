//! The reader thread: opens the port, collects revolutions, checks and publishes them, and reopens the
//! port when it is lost.

use std::sync::Arc;
use std::sync::atomic::Ordering::{Relaxed, Release};

use hal::LaserScan;
use triple_buffer::Input;

use super::device::{Device, WireError};
use super::settings::Settings;
use super::{Event, Revolution, RevolutionClock, RevolutionTime, RotaryError};
use crate::DeviceState;
use crate::scanner::{
    BlindError, End, Link, PollError, ReaderEnd, Received, Shared, Stop, keep_trying,
};
use monotonic_clock::monotonic_ns;

/// Time-out of the first scan, because the motor may have to start.
const FIRST_SCAN_NS: u64 = 5_000_000_000;
/// After this many periods without data, the scanner is set up again: it was restarted, or lost
/// without an error of the port.
const GIVE_UP_PERIODS: u64 = 10;
const READ_BYTES: usize = 1024;

pub(super) struct Reader {
    settings: Settings,
    port: Arc<str>,
    device: Box<dyn Device>,
    shared: Arc<Shared>,
    scans: Input<LaserScan>,
    stop: Stop,
}

impl Reader {
    pub(super) fn new(
        settings: Settings,
        port: Arc<str>,
        device: Box<dyn Device>,
        end: ReaderEnd,
    ) -> Self {
        let ReaderEnd { shared, scans, stop } = end;
        Self { settings, port, device, shared, scans, stop }
    }

    /// Runs until the driver is dropped.
    pub(super) fn run(mut self) {
        let shared = self.shared.clone();
        let stop = self.stop.clone();
        keep_trying(&shared, &stop, |was_alive| self.session(was_alive));
    }

    fn session(&mut self, was_alive: bool) -> End<RotaryError> {
        let Settings { port, baud, .. } = &self.settings;
        let link = match Link::open(port, *baud, &self.port, &self.stop) {
            Ok(link) => link,
            Err(error) => return error.into(),
        };
        match self.device.bring_up(&link) {
            Ok(identity) => self.shared.set_identity(identity),
            Err(end) => return end,
        }
        self.shared.set_state(DeviceState::Starting);
        let publisher = Publisher {
            shared: &self.shared,
            scans: &mut self.scans,
            settings: &self.settings,
            port: &self.port,
            revolution: Revolution::new(&self.settings.geometry, self.settings.mount),
            clock: RevolutionClock::new(self.settings.geometry.period_ns),
            good_in_a_row: 0,
            is_reopened: was_alive,
            data_ns: None,
        };
        let end = publisher.run(&link, &mut *self.device);
        self.device.shut_down(&link);
        end
    }
}

/// Makes scans of the measurements of one session.
struct Publisher<'a> {
    shared: &'a Shared,
    scans: &'a mut Input<LaserScan>,
    settings: &'a Settings,
    port: &'a Arc<str>,
    revolution: Revolution,
    clock: RevolutionClock,
    good_in_a_row: u32,
    is_reopened: bool,
    /// Arrival of the last measurement.
    data_ns: Option<u64>,
}

impl Publisher<'_> {
    fn run(mut self, link: &Link, device: &mut dyn Device) -> End<RotaryError> {
        let begin_ns = monotonic_ns();
        let mut buffer = [0; READ_BYTES];
        let mut bytes = 0;
        loop {
            let received = match link.read(&mut buffer, self.deadline_ns(begin_ns)) {
                Ok(received) => received,
                Err(error) => return error.into(),
            };
            let now_ns = monotonic_ns();
            match received {
                Received::Stopped => return End::Stopped,
                Received::Nothing => {}
                Received::Bytes(count) => {
                    bytes += count;
                    for byte in buffer.iter().take(count) {
                        device.push(*byte, &mut |event| self.take(event, now_ns));
                    }
                }
            }
            if self.is_working() && now_ns > self.silent_at_ns(begin_ns) {
                self.good_in_a_row = 0;
                self.shared.set_state(DeviceState::Silent);
                self.shared.set_problem(self.silent().to_string());
            }
            if now_ns > self.give_up_at_ns(begin_ns) {
                return self.nothing(bytes).into();
            }
        }
    }

    fn deadline_ns(&self, begin_ns: u64) -> u64 {
        if self.is_working() { self.silent_at_ns(begin_ns) } else { self.give_up_at_ns(begin_ns) }
    }

    fn silent_at_ns(&self, begin_ns: u64) -> u64 {
        self.data_ns.unwrap_or(begin_ns) + 2 * self.settings.geometry.period_ns
    }

    fn give_up_at_ns(&self, begin_ns: u64) -> u64 {
        match self.data_ns {
            Some(data_ns) => data_ns + GIVE_UP_PERIODS * self.settings.geometry.period_ns,
            None => begin_ns + FIRST_SCAN_NS,
        }
    }

    fn is_working(&self) -> bool {
        self.shared.state() == DeviceState::Working
    }

    fn silent(&self) -> RotaryError {
        let limit_ms = 2 * self.settings.geometry.period_ns / 1_000_000;
        PollError::Silent { port: self.port.clone(), limit_ms }.into()
    }

    /// Why there are no measurements.
    fn nothing(&self, bytes: usize) -> RotaryError {
        let Settings { device, baud, .. } = *self.settings;
        let port = self.port.clone();
        match (self.data_ns, bytes) {
            (Some(_), _) => self.silent(),
            (None, 0) => RotaryError::NoData { port, device },
            (None, bytes) => RotaryError::OtherDevice { port, device, bytes, baud },
        }
    }

    fn take(&mut self, event: Event<WireError>, arrival_ns: u64) {
        match event {
            Event::Sample(sample) => {
                self.data_ns = Some(arrival_ns);
                if self.revolution.push(&sample, &mut self.scans.input_buffer_mut().ranges) {
                    self.end_revolution(arrival_ns);
                }
            }
            Event::Missing => {
                self.shared.lost.fetch_add(1, Relaxed);
            }
            Event::Refused(source) => {
                self.count_bad();
                let error = RotaryError::Protocol { port: self.port.clone(), source };
                self.shared.set_problem(error.to_string());
            }
        }
    }

    fn count_bad(&mut self) {
        self.shared.bad.fetch_add(1, Relaxed);
        if !self.is_working() {
            self.good_in_a_row = 0;
        }
    }

    fn end_revolution(&mut self, arrival_ns: u64) {
        match self.clock.end_revolution(arrival_ns) {
            RevolutionTime::Partial => self.good_in_a_row = 0,
            RevolutionTime::TooSlow { hz } => {
                let expected_hz = 1e9 / self.settings.geometry.period_ns as f64;
                self.refuse(&RotaryError::TooSlow { port: self.port.clone(), hz, expected_hz });
            }
            RevolutionTime::Whole { end_ns } => match self.blind() {
                Some(blind) => self.refuse(&blind),
                None => self.publish(end_ns, arrival_ns),
            },
        }
    }

    /// Drops the scan because of a fault of the scanner.
    fn refuse(&mut self, error: &RotaryError) {
        self.good_in_a_row = 0;
        self.shared.bad.fetch_add(1, Relaxed);
        self.shared.set_state(DeviceState::Faulty);
        self.shared.set_problem(error.to_string());
    }

    /// An error if no beam of the scan has a distance.
    fn blind(&mut self) -> Option<RotaryError> {
        let ranges = &self.scans.input_buffer_mut().ranges;
        BlindError::of(ranges, self.port).map(Into::into)
    }

    /// Publishes the scan, if enough scans in a row were good.
    fn publish(&mut self, end_ns: u64, arrival_ns: u64) {
        let scan = self.scans.input_buffer_mut();
        // The end is what is known, and what the age of a scan is reckoned from.
        scan.time_ns = end_ns.saturating_sub(self.settings.geometry.period_ns);
        self.shared.good.fetch_add(1, Relaxed);
        self.good_in_a_row = self.good_in_a_row.saturating_add(1);
        if self.good_in_a_row < self.settings.good_scans {
            return;
        }
        self.scans.publish();
        self.shared.last_good_ns.store(arrival_ns, Release);
        if std::mem::take(&mut self.is_reopened) {
            self.shared.reopened.fetch_add(1, Relaxed);
        }
        // The state is set last, because the polling side returns no scan before it is.
        self.shared.set_state(DeviceState::Working);
    }
}
