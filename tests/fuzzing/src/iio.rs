use drivers::iio::{
    Axis, Decoder, Element, ElementType, Layout, Records, SampleCheck, Triad, wire,
};
use hal::{ImuMount, ImuSample};

/// Time of reading, by which samples are judged.
const NOW_NS: u64 = 1 << 40;

/// Arbitrary bytes from an inertial measurement unit. The first line is the types of its channels, as sysfs shows them; the rest
/// is records of these channels, and of the protocol of a socket.
pub fn iio(data: &[u8]) {
    let mut parts = data.splitn(2, |byte| *byte == b'\n');
    let layout = layout(&String::from_utf8_lossy(parts.next().unwrap_or_default()));
    let records = parts.next().unwrap_or_default();
    of_kernel(&layout, records);
    of_socket(records);
}

/// The channels whose types can be read, in their order.
fn layout(types: &str) -> Layout {
    let mut elements = Vec::new();
    for text in types.split(' ') {
        let Ok(kind) = text.parse::<ElementType>() else { continue };
        let written = kind.to_string();
        assert_eq!(written.parse(), Ok(kind), "{text} is written as {written}");
        let index = elements.len() as u32;
        elements.push(Element { name: index.to_string(), index, kind });
    }
    let least: usize = elements.iter().map(|element| element.kind.bytes()).sum();
    let layout = Layout::new(elements);
    assert!(layout.record_bytes() >= least);
    layout
}

/// The first three channels are angular velocities, the next is the time, the next three are forces.
fn of_kernel(layout: &Layout, records: &[u8]) {
    let axis = |name: &str| Some(Axis { place: layout.place(name)?, offset: 0.5, scale: 1e-3 });
    let matrix = ImuMount::default().rotation().to_rotation_matrix().into_inner();
    let triad = |names: [&str; 3]| Triad { axes: names.map(axis), matrix };
    let force = layout.place("6").map(|_| triad(["4", "5", "6"]));
    let decoder = Decoder::new(layout, triad(["0", "1", "2"]), force, layout.place("3"));
    let mut check = SampleCheck::default();
    let mut last_ns = 0;
    in_pieces(decoder.record_bytes(), records, |record| {
        // A layout without channels has records without bytes, which are given as one byte.
        if decoder.record_bytes() > 0 {
            assert_eq!(record.len(), decoder.record_bytes());
        }
        let Some(sample) = decoder.decode(record, NOW_NS) else { return };
        assert!(sample.is_finite(), "whole numbers become finite ones");
        assert_eq!(sample.force_mps2.is_some(), layout.place("6").is_some());
        judge(&mut check, &sample, &mut last_ns);
    });
}

fn of_socket(records: &[u8]) {
    let mut check = SampleCheck::default();
    let mut last_ns = 0;
    in_pieces(wire::RECORD_BYTES, records, |record| {
        let sample = wire::decode(record.try_into().expect("a record has its length"));
        let again = wire::decode(&wire::encode(&sample));
        // NaN differs from itself.
        assert!(again == sample || !sample.is_finite());
        judge(&mut check, &sample, &mut last_ns);
    });
}

/// Passes the records in the bytes on, which arrive in two ways of cutting them.
fn in_pieces(record_bytes: usize, bytes: &[u8], mut take: impl FnMut(&[u8])) {
    let mut found = [Vec::new(), Vec::new()];
    for (piece, found) in [1, 7].into_iter().zip(&mut found) {
        let mut records = Records::new(record_bytes);
        for chunk in bytes.chunks(piece) {
            let free = records.free_space();
            let count = chunk.len().min(free.len());
            free[..count].copy_from_slice(&chunk[..count]);
            records.received(count, |record| found.push(record.to_vec()));
            assert!(!records.free_space().is_empty());
        }
    }
    assert_eq!(found[0], found[1], "the pieces do not matter");
    found[0].iter().for_each(|record| take(record));
}

/// An accepted sample is finite, slow enough, and not before the one before.
fn judge(check: &mut SampleCheck, sample: &ImuSample, last_ns: &mut u64) {
    if check.check(sample, NOW_NS).is_err() {
        return;
    }
    assert!(sample.is_finite());
    assert!(sample.angular_radps.iter().all(|radps| radps.abs() <= 100.0));
    assert!(sample.time_ns >= *last_ns && sample.time_ns < 2 * NOW_NS);
    *last_ns = sample.time_ns;
}
