//! Asks cameras what they offer, and listens on buses for motor controllers. No stream starts, and nothing is sent on a bus.

use drivers::can::sender::{Sender, sender};
use drivers::can::{BusEvent, CanBus, open_bus};
use drivers::v4l2::{self, CameraDeviceConfig, V4l2Error};
use hal::Clock;
use monotonic_clock::MonotonicClock;

use super::found::{Found, FoundBus, FoundCamera, FrameOffer};

/// Time for which a bus is listened to: heartbeats come every 100 ms, of some drives every second.
const LISTEN_NS: u64 = 1_200_000_000;
/// Time between two polls of a bus.
const POLL_NS: u64 = 5_000_000;

/// Completes what was found by what the devices say. Nodes that are no cameras are left out.
pub fn query_devices(found: &mut Found) {
    found.cameras.iter_mut().for_each(query_camera);
    found.cameras.retain(|camera| !matches!(camera.offer, Err(V4l2Error::NotACamera { .. })));
    listen(&mut found.buses);
}

fn query_camera(camera: &mut FoundCamera) {
    let config =
        CameraDeviceConfig { device: camera.device.clone(), ..CameraDeviceConfig::default() };
    camera.offer = v4l2::offer(&config).map(|offer| FrameOffer {
        formats: offer.formats.iter().map(ToString::to_string).collect(),
        format: offer.format,
        width: offer.size.0,
        height: offer.size.1,
        fps: offer.fps,
    });
}

fn listen(buses: &mut [FoundBus]) {
    let usable = buses.iter_mut().filter(|bus| bus.problem.is_none());
    let mut open: Vec<_> = usable.map(|bus| (open_bus(&bus.name), bus)).collect();
    if open.is_empty() {
        return;
    }
    let mut clock = MonotonicClock;
    let end_ns = clock.now_ns() + LISTEN_NS;
    while clock.now_ns() < end_ns {
        let now_ns = clock.now_ns();
        open.iter_mut().for_each(|(bus, found)| receive_all(bus, now_ns, &mut found.senders));
        clock.sleep_until_ns(now_ns + POLL_NS);
    }
}

/// Adds the controllers whose heartbeats have arrived, in the order of their nodes.
fn receive_all(bus: &mut impl CanBus, now_ns: u64, senders: &mut Vec<Sender>) {
    while let Some(received) = bus.receive(now_ns) {
        let BusEvent::Frame(frame) = received.event else { continue };
        let Some(new) = sender(&frame) else { continue };
        if let Err(place) = senders.binary_search(&new) {
            senders.insert(place, new);
        }
    }
}
