use drivers::FixedFramer;
use drivers::ld06::{Decoder, PACKET_BYTES, Packet, may_begin};
use drivers::rotary::{Event, Mount, Revolution, circle};
use hal::Range;

/// Arbitrary bytes from an LD06 as input of its codec: the packets are those that a simple search
/// finds, and every measurement is finite and gets a beam.
pub fn ld06(data: &[u8]) {
    let mut framer = FixedFramer::<PACKET_BYTES>::new(may_begin);
    let mut found = Vec::new();
    let mut decoder = Decoder::new(15);
    let geometry = circle(450.0, (0.02, 12.0), 1);
    let mut revolution = Revolution::new(&geometry, Mount::default());
    let mut ranges = Vec::new();
    let mut samples = 0;
    let mut in_revolution = 0;
    for byte in data {
        found.extend(framer.push(*byte, Packet::read).and_then(Result::ok));
        decoder.push(*byte, |event| {
            let Event::Sample(sample) = event else { return };
            samples += 1;
            assert!((0.0..std::f64::consts::TAU).contains(&sample.clockwise_rad));
            in_revolution += 1;
            if revolution.push(&sample, &mut ranges) {
                check_revolution(&ranges, in_revolution);
                in_revolution = 1;
            }
        });
    }
    assert_eq!(found, simple_search(data));
    assert_eq!(samples, 12 * found.len());
}

/// A revolution has all beams, and none but those of its measurements.
fn check_revolution(ranges: &[Range], measurements: usize) {
    assert_eq!(ranges.len(), 400);
    assert!(ranges.iter().all(|range| range.hit_m().is_none_or(|m| (0.02..=12.0).contains(&m))));
    let measured = ranges.iter().filter(|range| **range != Range::Error).count();
    assert!(measured <= measurements && measurements > ranges.len() / 16);
}

/// The packets in the bytes, from the first to the last, none of which overlap.
fn simple_search(data: &[u8]) -> Vec<Packet> {
    let mut found = Vec::new();
    let mut at = 0;
    while let Some(window) = data.get(at..at + PACKET_BYTES) {
        let window = window.try_into().expect("the window has this length");
        match Packet::read(window).ok().filter(|_| may_begin(window)) {
            Some(packet) => {
                assert_eq!(packet.write(), *window, "a packet is written as it was read");
                found.push(packet);
                at += PACKET_BYTES;
            }
            None => at += 1,
        }
    }
    found
}
