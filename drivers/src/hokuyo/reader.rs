//! The reader thread: opens the port, reads and checks scans, and reopens the port when it is lost.

use std::sync::Arc;
use std::sync::atomic::Ordering::{Relaxed, Release};

use hal::LaserScan;
use triple_buffer::Input;

use super::session::{End, Session};
use super::{HokuyoConfig, HokuyoError};
use crate::DeviceState;
use crate::scanner::{
    BlindError, FIRST_WAIT_NS, Link, PollError, Received, Shared, Stop, keep_trying,
};
use crate::scip::{ClockSync, Command, Reply, Request, ScipError};
use monotonic_clock::monotonic_ns;

/// Time-out of the first scan, because the motor may have to start.
const FIRST_SCAN_NS: u64 = 3_000_000_000;
/// After this many periods without a valid scan, the scanner is set up again: it was restarted, or
/// lost without an error of the port.
const GIVE_UP_PERIODS: u64 = 10;
/// This many consecutive scans with impossible timestamps mean that the scanner was restarted.
const CLOCK_JUMPS: u32 = 3;

pub(super) struct Reader {
    pub(super) config: HokuyoConfig,
    pub(super) port: Arc<str>,
    pub(super) shared: Arc<Shared>,
    pub(super) scans: Input<LaserScan>,
    pub(super) stop: Stop,
}

impl Reader {
    /// Runs until the driver is dropped.
    pub(super) fn run(mut self) {
        let shared = self.shared.clone();
        let stop = self.stop.clone();
        keep_trying(&shared, &stop, |was_alive| self.session(was_alive));
    }

    fn session(&mut self, was_alive: bool) -> End {
        let link = match Link::open(&self.config.port, self.config.baud, &self.port, &self.stop) {
            Ok(link) => link,
            Err(error) => return error.into(),
        };
        let mut session = Session::new(link, &self.config, &self.port);
        let clock = match session.bring_up() {
            Ok((identity, clock)) => {
                self.shared.set_identity(identity);
                clock
            }
            Err(end) => return end,
        };
        self.shared.set_state(DeviceState::Starting);
        let end =
            Stream::new(&self.shared, &mut self.scans, &self.config, &self.port, clock, was_alive)
                .run(&mut session);
        // Switch the laser off. If the scanner no longer receives this, that is no loss.
        _ = session.link.write(Command::Quit.bytes(), monotonic_ns() + FIRST_WAIT_NS);
        end
    }
}

/// Processes the scans of one session.
struct Stream<'a> {
    shared: &'a Shared,
    scans: &'a mut Input<LaserScan>,
    config: &'a HokuyoConfig,
    port: &'a Arc<str>,
    request: Request,
    period_ns: u64,
    clock: Option<ClockSync>,
    clock_jumps: u32,
    last_stamp_ms: Option<u32>,
    bad_since: u64,
    good_in_a_row: u32,
    is_reopened: bool,
}

impl<'a> Stream<'a> {
    fn new(
        shared: &'a Shared,
        scans: &'a mut Input<LaserScan>,
        config: &'a HokuyoConfig,
        port: &'a Arc<str>,
        clock: Option<ClockSync>,
        is_reopened: bool,
    ) -> Self {
        Self {
            shared,
            scans,
            config,
            port,
            request: config.model.request(0),
            period_ns: config.model.geometry(false).period_ns,
            clock,
            clock_jumps: 0,
            last_stamp_ms: None,
            bad_since: 0,
            good_in_a_row: 0,
            is_reopened,
        }
    }

    fn run(mut self, session: &mut Session<'_>) -> End {
        let begin_ns = monotonic_ns();
        // Time of the last message of any kind, and of the last valid scan.
        let mut message_ns = begin_ns;
        let mut valid_ns = begin_ns;
        let mut give_up_ns = FIRST_SCAN_NS;
        loop {
            let silent_ns = message_ns + 2 * self.period_ns;
            let deadline_ns = if self.is_working() { silent_ns } else { valid_ns + give_up_ns };
            let received = match session.link.read(session.framer.free_space(), deadline_ns) {
                Ok(received) => received,
                Err(error) => return error.into(),
            };
            let now_ns = monotonic_ns();
            match received {
                Received::Stopped => return End::Stopped,
                Received::Nothing => {}
                Received::Bytes(count) => session.framer.received(count),
            }
            while let Some(message) = session.framer.message() {
                message_ns = now_ns;
                match self.take(message, now_ns) {
                    Ok(true) => {
                        valid_ns = now_ns;
                        give_up_ns = GIVE_UP_PERIODS * self.period_ns;
                    }
                    Ok(false) => {}
                    Err(Trouble::Status(status)) => {
                        self.shared.set_state(DeviceState::Faulty);
                        return session.explain(status);
                    }
                    Err(Trouble::ClockJumped) => {
                        return HokuyoError::ClockJumped { port: self.port.clone() }.into();
                    }
                }
            }
            if self.is_working() && now_ns > message_ns + 2 * self.period_ns {
                self.good_in_a_row = 0;
                self.shared.set_state(DeviceState::Silent);
                self.shared.set_problem(self.silent().to_string());
            }
            if now_ns > valid_ns + give_up_ns {
                return self.silent().into();
            }
        }
    }

    fn is_working(&self) -> bool {
        self.shared.state() == DeviceState::Working
    }

    fn silent(&self) -> HokuyoError {
        let limit_ms = 2 * self.period_ns / 1_000_000;
        PollError::Silent { port: self.port.clone(), limit_ms }.into()
    }

    /// Processes a message. Returns true when it was a valid scan.
    fn take(&mut self, message: &[u8], arrival_ns: u64) -> Result<bool, Trouble> {
        let scan = self.scans.input_buffer_mut();
        let codes = &self.config.model.spec().codes;
        let mut reply = Reply::read(message, &self.request, codes, &mut scan.ranges);
        if matches!(reply, Err(error) if !matches!(error, ScipError::Status { .. }))
            && let Some(rest) =
                self.request.last_echo(message).filter(|rest| rest.len() < message.len())
        {
            // Noise or a truncated scan precedes a complete one.
            self.count_bad();
            reply =
                Reply::read(rest, &self.request, codes, &mut self.scans.input_buffer_mut().ranges);
        }
        match reply {
            Ok(Reply::Accepted) => Ok(false),
            Ok(Reply::Scan { timestamp_ms }) => self.scan(timestamp_ms, arrival_ns),
            Err(ScipError::Status { status })
                if hal::Error::kind(&ScipError::Status { status }) == hal::ErrorKind::Fault =>
            {
                Err(Trouble::Status(status))
            }
            Err(ScipError::Status { status: status @ [b'1', b'0'] }) => {
                Err(Trouble::Status(status))
            }
            Err(error) => {
                self.count_bad();
                self.shared.set_problem(
                    HokuyoError::Protocol { port: self.port.clone(), source: error }.to_string(),
                );
                Ok(false)
            }
        }
    }

    fn count_bad(&mut self) {
        self.shared.bad.fetch_add(1, Relaxed);
        self.bad_since += 1;
        if !self.is_working() {
            self.good_in_a_row = 0;
        }
    }

    fn scan(&mut self, stamp_ms: u32, arrival_ns: u64) -> Result<bool, Trouble> {
        let period_ns = self.period_ns;
        let clock =
            self.clock.get_or_insert_with(|| ClockSync::from_scan(stamp_ms, arrival_ns, period_ns));
        // A scan is sent when it is complete, one period after its start. A busy computer reads it
        // later.
        let Some(time_ns) = clock.scan_start_ns(stamp_ms, arrival_ns, GIVE_UP_PERIODS * period_ns)
        else {
            self.count_bad();
            self.clock_jumps += 1;
            return if self.clock_jumps < CLOCK_JUMPS {
                Ok(false)
            } else {
                Err(Trouble::ClockJumped)
            };
        };
        self.clock_jumps = 0;
        self.count_lost(stamp_ms);
        if let Some(blind) = self.blind() {
            self.good_in_a_row = 0;
            self.shared.bad.fetch_add(1, Relaxed);
            self.shared.set_state(DeviceState::Faulty);
            self.shared.set_problem(blind.to_string());
            return Ok(true);
        }
        self.publish(time_ns, arrival_ns);
        Ok(true)
    }

    /// Counts lost scans from the gaps between the scanner's timestamps, without those that failed
    /// their checks.
    fn count_lost(&mut self, stamp_ms: u32) {
        let period_ms = self.period_ns / 1_000_000;
        if let Some(last_ms) = self.last_stamp_ms.replace(stamp_ms) {
            let passed_ms = u64::from(stamp_ms.wrapping_sub(last_ms) & 0xff_ffff);
            let missing = ((passed_ms + period_ms / 2) / period_ms)
                .saturating_sub(1)
                .saturating_sub(self.bad_since);
            self.shared.lost.fetch_add(missing, Relaxed);
        }
        self.bad_since = 0;
    }

    /// An error if no beam of the scan has a distance.
    fn blind(&mut self) -> Option<HokuyoError> {
        let ranges = &self.scans.input_buffer_mut().ranges;
        BlindError::of(ranges, self.port).map(Into::into)
    }

    /// Publishes the scan, if enough scans in a row were good.
    fn publish(&mut self, time_ns: u64, arrival_ns: u64) {
        let scan = self.scans.input_buffer_mut();
        scan.time_ns = time_ns;
        if self.config.upside_down {
            scan.ranges.reverse();
        }
        self.shared.good.fetch_add(1, Relaxed);
        self.good_in_a_row = self.good_in_a_row.saturating_add(1);
        if self.good_in_a_row < self.config.good_scans {
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

/// Why the session has to end.
enum Trouble {
    Status([u8; 2]),
    ClockJumped,
}
