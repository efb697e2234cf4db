//! The commands and answers before the first scan, and after a fault.

use std::sync::Arc;

use super::{HokuyoConfig, HokuyoError};
use crate::scanner::{Identity, Link, LinkError, Received};
use crate::scip::{
    Answer, ClockSync, Command, Framer, Parameters, ScipError, State, TimeProbe, Version,
};
use monotonic_clock::monotonic_ns;

/// Buffer size: two scans of the largest kind, since 1081 beams with intensities have 6.7 kB.
pub(super) const BUFFER: usize = 16 * 1024;
/// Time-out of an answer. The longest, 250 characters of `II`, takes 130 ms at 19,200 bit/s.
const ANSWER_NS: u64 = 300_000_000;
/// How often a command is sent, because it may be lost in noise.
const TRIES: usize = 3;
const PROBES: usize = 8;

/// The connection to one open scanner.
pub(super) struct Session<'a> {
    pub(super) link: Link,
    pub(super) framer: Box<Framer<BUFFER>>,
    pub(super) config: &'a HokuyoConfig,
    pub(super) port: &'a Arc<str>,
    /// The state that the scanner reported last, as its own text.
    reported: String,
}

/// Why a session ended or could not be started.
pub(super) type End = crate::scanner::End<HokuyoError>;

impl From<LinkError> for End {
    fn from(error: LinkError) -> Self {
        Self::Failed(error.into())
    }
}

impl<'a> Session<'a> {
    pub(super) fn new(link: Link, config: &'a HokuyoConfig, port: &'a Arc<str>) -> Self {
        Self { link, framer: Box::default(), config, port, reported: String::from("nothing") }
    }

    /// Sets the scanner up: stops a running measurement, switches to SCIP 2, reads the identity,
    /// compares the clocks and starts the scans. The clock is `None` when the scanner does not
    /// report its time.
    pub(super) fn bring_up(&mut self) -> Result<(Identity, Option<ClockSync>), End> {
        self.leave_scip_1()?;
        let (serial, firmware) = self.ask(Command::Version, |answer| {
            let version = Version::read(answer);
            let serial = version.serial.unwrap_or_default().to_owned();
            let firmware = version.firmware.unwrap_or_default().to_owned();
            Ok((serial, firmware))
        })?;
        let model = self.check_model()?;
        self.ask_state()?;
        let clock = self.compare_clocks()?;
        self.switch_on_laser()?;
        let (request, length) = self.config.model.request(0).encode();
        self.link.write(&request[..length], monotonic_ns() + ANSWER_NS)?;
        Ok((Identity { model, serial, firmware }, clock))
    }

    fn leave_scip_1(&mut self) -> Result<(), End> {
        if self.config.model.spec().starts_in_scip_1 {
            // A scanner that is in SCIP 2 already answers that the command is unknown.
            match self.ask(Command::Scip2, |_| Ok(())) {
                Ok(()) | Err(End::Failed(HokuyoError::Protocol { .. })) => {}
                Err(end) => return Err(end),
            }
        }
        match self.ask(Command::Quit, |_| Ok(())) {
            Err(End::Failed(HokuyoError::Protocol { source: ScipError::OldProtocol, .. })) => {
                self.ask(Command::Scip2, |answer| answer.done().map(|_| ()))?;
                self.ask(Command::Quit, |_| Ok(()))
            }
            other => other,
        }
    }

    fn check_model(&mut self) -> Result<String, End> {
        let configured = self.config.model;
        let found = self.ask(Command::Parameters, |answer| {
            let parameters = Parameters::read(answer)?;
            let model = parameters.model.split('(').next().unwrap_or_default().trim();
            let steps = format!(
                "{model}, steps {} to {} of {}",
                parameters.first_step, parameters.last_step, parameters.steps_per_turn
            );
            Ok(if configured.spec().matches(&parameters) {
                Ok(model.to_owned())
            } else {
                Err(steps)
            })
        })?;
        found.map_err(|found| {
            HokuyoError::WrongModel { port: self.port.clone(), configured, found }.into()
        })
    }

    /// Requests the scanner's state, for the texts of faults.
    pub(super) fn ask_state(&mut self) -> Result<(), End> {
        self.reported = self.ask(Command::State, |answer| {
            let state = State::read(answer);
            let off = if state.laser_is_off() { "laser OFF, " } else { "" };
            Ok(format!("{off}{}", state.status.unwrap_or("nothing")))
        })?;
        Ok(())
    }

    fn compare_clocks(&mut self) -> Result<Option<ClockSync>, End> {
        // Status 02: the mode is active already.
        let has_started =
            self.ask(Command::TimeStart, |answer| Ok(matches!(&answer.status, b"00" | b"02")))?;
        if !has_started {
            return Ok(None);
        }
        let mut probes = Vec::with_capacity(PROBES);
        for _ in 0..PROBES {
            let sent_ns = monotonic_ns();
            match self.ask(Command::Time, |answer| answer.done()?.time_ms()) {
                Ok(sensor_ms) => {
                    probes.push(TimeProbe { sent_ns, received_ns: monotonic_ns(), sensor_ms });
                }
                Err(End::Failed(HokuyoError::Protocol { .. })) => {}
                Err(end) => return Err(end),
            }
        }
        self.ask(Command::TimeEnd, |_| Ok(()))?;
        Ok(ClockSync::from_probes(&probes))
    }

    fn switch_on_laser(&mut self) -> Result<(), End> {
        // Status 02: the laser is on already.
        match self.ask(Command::LaserOn, |answer| Ok(answer.status))? {
            [b'0', b'0' | b'2'] => Ok(()),
            status => Err(self.explain(status)),
        }
    }

    /// Makes the error for a status that ended the measurement. Requests the scanner's own text, if
    /// it still answers.
    pub(super) fn explain(&mut self, status: [u8; 2]) -> End {
        for asked in [self.ask(Command::Quit, |_| Ok(())), self.ask_state()] {
            if let Err(End::Stopped) = asked {
                return End::Stopped;
            }
        }
        let port = self.port.clone();
        let reported = self.reported.clone();
        if status == *b"10" {
            return HokuyoError::LaserOff { port, reported }.into();
        }
        HokuyoError::Hardware {
            port,
            status: status.iter().map(|byte| char::from(*byte)).collect(),
            reported,
        }
        .into()
    }

    /// Sends a command and waits for its answer. Skips everything else that arrives: noise and the
    /// last scans.
    fn ask<T>(
        &mut self,
        command: Command,
        parse: impl Fn(&Answer<'_>) -> Result<T, ScipError>,
    ) -> Result<T, End> {
        let mut bytes = 0;
        let mut wrong = None;
        for _ in 0..TRIES {
            let deadline_ns = monotonic_ns() + ANSWER_NS;
            self.link.write(command.bytes(), deadline_ns)?;
            loop {
                match self.link.read(self.framer.free_space(), deadline_ns)? {
                    Received::Stopped => return Err(End::Stopped),
                    Received::Nothing => break,
                    Received::Bytes(count) => {
                        self.framer.received(count);
                        bytes += count;
                    }
                }
                while let Some(message) = self.framer.message() {
                    match Answer::read(message, command).and_then(|answer| parse(&answer)) {
                        Ok(answer) => return Ok(answer),
                        Err(error @ (ScipError::OldProtocol | ScipError::Status { .. })) => {
                            return Err(HokuyoError::Protocol {
                                port: self.port.clone(),
                                source: error,
                            }
                            .into());
                        }
                        // A scan that was still being sent, or noise.
                        Err(ScipError::Echo) => {}
                        Err(error) => wrong = Some(error),
                    }
                }
                if monotonic_ns() > deadline_ns {
                    break;
                }
            }
        }
        let port = self.port.clone();
        let command = std::str::from_utf8(command.bytes()).unwrap_or_default().trim_end();
        Err(End::Failed(match wrong {
            Some(source) => HokuyoError::Protocol { port, source },
            None if bytes == 0 => HokuyoError::NoAnswer { port, command },
            None => HokuyoError::NotScip { port, command, bytes, baud: self.config.baud },
        }))
    }
}
