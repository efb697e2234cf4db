//! The driver's part that only an RPLIDAR needs: its questions, its motor and its restarts.

use super::descriptor::{self, DESCRIPTOR_BYTES, Descriptor};
use super::{Decoder, Health, Info, Request, RplidarConfig};
use crate::rotary::{Device, Event, Place, RotaryError, RotaryLidar, Settings, WireError};
use crate::scanner::{End, FixedFramer, Identity, Link, LinkError, Received};
use monotonic_clock::monotonic_ns;

/// Time-out of an answer: 27 bytes take 3 ms at 115,200 bit/s.
const ANSWER_NS: u64 = 300_000_000;
/// How often a request is sent, because it may be lost in noise.
const TRIES: usize = 3;

/// Starts the driver. The scanner may be connected later.
///
/// # Errors
/// [`RotaryError::Config`] when the configuration is invalid; [`RotaryError::Link`] when the system
/// cannot create a thread or descriptor.
pub fn open(place: Place, config: &RplidarConfig) -> Result<RotaryLidar, RotaryError> {
    config.validate()?;
    let settings = Settings {
        port: place.port,
        device: config.model.spec().name,
        baud: config.baud(),
        geometry: place.mount.geometry(config.geometry()),
        mount: place.mount,
        good_scans: place.good_scans,
    };
    let port = settings.port.to_string().into();
    let decoder = Decoder::new(config.model.spec().range_m);
    RotaryLidar::start(settings, Box::new(Rplidar { config: config.clone(), port, decoder }))
}

struct Rplidar {
    config: RplidarConfig,
    port: std::sync::Arc<str>,
    decoder: Decoder,
}

impl Device for Rplidar {
    fn bring_up(&mut self, link: &Link) -> Result<Identity, End<RotaryError>> {
        send(link, Request::Stop)?;
        let info = Info::read(&self.ask(link, Request::Info, Descriptor::INFO)?);
        self.check_model(&info)?;
        let health = Health::read(&self.ask(link, Request::Health, Descriptor::HEALTH)?);
        if !health.is_usable() {
            // A restart ends a protection stop, if its reason is gone.
            send(link, Request::Reset)?;
            let health = health.to_string();
            return Err(RotaryError::Hardware { port: self.port.clone(), health }.into());
        }
        link.set_dtr(false);
        if let Some(request) = self.config.model.motor_request(self.config.rotation_hz()) {
            send(link, request)?;
        }
        self.decoder = Decoder::new(self.config.model.spec().range_m);
        send(link, self.config.model.scan_request(self.config.scan_mode))?;
        Ok(identity(&info, &self.config))
    }

    fn push(&mut self, byte: u8, sink: &mut dyn FnMut(Event<WireError>)) {
        self.decoder.push(byte, |event| sink(event.map_error(WireError::from)));
    }

    fn shut_down(&mut self, link: &Link) {
        // If the scanner no longer receives this, that is no loss.
        _ = send(link, Request::Stop);
        if let Some(request) = self.config.model.motor_stop_request() {
            _ = send(link, request);
        }
        link.set_dtr(true);
    }
}

impl Rplidar {
    fn check_model(&self, info: &Info) -> Result<(), RotaryError> {
        let spec = self.config.model.spec();
        if info.series() == spec.series {
            return Ok(());
        }
        Err(RotaryError::WrongModel {
            port: self.port.clone(),
            device: spec.name,
            found: info.model,
        })
    }

    /// Sends a request and waits for its answer. Skips everything else that arrives: noise and the
    /// last scan.
    fn ask<const N: usize>(
        &self,
        link: &Link,
        request: Request,
        expected: Descriptor,
    ) -> Result<[u8; N], End<RotaryError>> {
        let mut bytes = 0;
        for _ in 0..TRIES {
            send(link, request)?;
            if let Some(answer) = wait_for(link, expected, &mut bytes)? {
                return Ok(answer);
            }
        }
        let port = self.port.clone();
        let device = self.config.model.spec().name;
        Err(End::Failed(match bytes {
            0 => RotaryError::NoData { port, device },
            bytes => RotaryError::OtherDevice { port, device, bytes, baud: self.config.baud() },
        }))
    }
}

fn send(link: &Link, request: Request) -> Result<(), LinkError> {
    let (bytes, length) = request.encode();
    link.write(&bytes[..length], monotonic_ns() + ANSWER_NS)
}

/// Waits for an answer; `None` if it does not come in time. Adds the number of received bytes.
fn wait_for<const N: usize>(
    link: &Link,
    expected: Descriptor,
    bytes: &mut usize,
) -> Result<Option<[u8; N]>, End<RotaryError>> {
    let deadline_ns = monotonic_ns() + ANSWER_NS;
    let mut answer = AnswerReader::<N>::new(expected);
    let mut buffer = [0; 256];
    loop {
        let count = match link.read(&mut buffer, deadline_ns)? {
            Received::Stopped => return Err(End::Stopped),
            Received::Nothing => return Ok(None),
            Received::Bytes(count) => count,
        };
        *bytes += count;
        if let Some(found) = buffer.iter().take(count).find_map(|byte| answer.push(*byte)) {
            return Ok(Some(found));
        }
        if monotonic_ns() > deadline_ns {
            return Ok(None);
        }
    }
}

/// Finds the one answer that is expected among other bytes.
struct AnswerReader<const N: usize> {
    expected: Descriptor,
    head: FixedFramer<DESCRIPTOR_BYTES>,
    /// The answer's bytes so far, once its descriptor was found.
    body: Option<heapless::Vec<u8, N>>,
}

impl<const N: usize> AnswerReader<N> {
    fn new(expected: Descriptor) -> Self {
        Self { expected, head: FixedFramer::new(descriptor::may_begin), body: None }
    }

    fn push(&mut self, byte: u8) -> Option<[u8; N]> {
        if let Some(body) = &mut self.body {
            _ = body.push(byte);
            return body.as_slice().try_into().ok();
        }
        let expected = self.expected;
        let read = self.head.push(byte, |bytes| {
            Descriptor::read(bytes).filter(|found| *found == expected).ok_or(())
        });
        if let Some(Ok(_)) = read {
            self.body = Some(heapless::Vec::new());
        }
        None
    }
}

fn identity(info: &Info, config: &RplidarConfig) -> Identity {
    Identity {
        model: format!("{} (model number {:#04x})", config.model.spec().name, info.model),
        serial: info.serial_text(),
        firmware: format!("{}.{:02}", info.firmware.0, info.firmware.1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_found_behind_the_rest_of_a_scan() {
        let mut stream = vec![0xa5, 0x5a, 0xa5, 0x3e, 0x41];
        stream.extend(Descriptor::SCAN.write());
        stream.extend(Descriptor::HEALTH.write());
        stream.extend([2, 7, 0]);
        let mut reader = AnswerReader::<3>::new(Descriptor::HEALTH);
        let found: Vec<[u8; 3]> = stream.iter().filter_map(|byte| reader.push(*byte)).collect();
        assert_eq!(found, [[2, 7, 0]]);
    }
}
