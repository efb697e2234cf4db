use drivers::rotary::{Event, Mount, Revolution, circle};
use drivers::rplidar::{
    CAPSULE_BYTES, Capsule, Cell, DESCRIPTOR_BYTES, Decoder, Descriptor, Health, Info, Layout,
    MEASUREMENT_BYTES, Measurement, Request,
};

const RANGE_M: (f32, f32) = (0.15, 12.0);

/// Arbitrary bytes from an RPLIDAR, and from its host. The first byte selects the descriptor that
/// precedes the rest: none, or one of the three kinds of scans.
pub fn rplidar(data: &[u8]) {
    let Some((options, stream)) = data.split_first() else { return };
    let head = match options % 4 {
        0 => Vec::new(),
        1 => Descriptor::SCAN.write().to_vec(),
        2 => Descriptor::CAPSULES.write().to_vec(),
        _ => Descriptor::DENSE_CAPSULES.write().to_vec(),
    };
    decode(&head, stream);
    requests(stream);
    for window in stream.windows(CAPSULE_BYTES) {
        capsules(window.try_into().expect("the window has this length"));
    }
    if let Some(bytes) = stream.first_chunk::<MEASUREMENT_BYTES>()
        && let Ok(measurement) = Measurement::read(bytes)
    {
        assert_eq!(measurement.write(), *bytes);
    }
    if let Some(bytes) = stream.first_chunk::<DESCRIPTOR_BYTES>()
        && let Some(descriptor) = Descriptor::read(bytes)
    {
        assert_eq!(Descriptor::read(&descriptor.write()), Some(descriptor));
    }
    _ = stream.first_chunk().map(Info::read).map(|info| info.serial_text());
    _ = stream.first_chunk().map(Health::read).map(|health| health.to_string());
}

/// Every measurement is finite, within the scanner's limits, and gets a beam.
fn decode(head: &[u8], stream: &[u8]) {
    let mut decoder = Decoder::new(RANGE_M);
    let geometry = circle(727.0, RANGE_M, 1);
    let mut revolution = Revolution::new(&geometry, Mount::default());
    let mut ranges = Vec::new();
    let mut samples = 0;
    for byte in head.iter().chain(stream) {
        decoder.push(*byte, |event| {
            let Event::Sample(sample) = event else { return };
            samples += 1;
            assert!((0.0..std::f64::consts::TAU).contains(&sample.clockwise_rad));
            if revolution.push(&sample, &mut ranges) {
                assert_eq!(ranges.len(), geometry.beams);
                let limits = RANGE_M.0..=RANGE_M.1;
                assert!(
                    ranges.iter().all(|range| range.hit_m().is_none_or(|m| limits.contains(&m)))
                );
            }
        });
    }
    // A dense capsule of 84 bytes has 40 measurements, a standard measurement five bytes.
    assert!(2 * samples <= stream.len());
}

/// A capsule that is accepted is the same after reading and writing its parts.
fn capsules(bytes: &[u8; CAPSULE_BYTES]) {
    for layout in [Layout::Legacy, Layout::Dense] {
        let Ok(capsule) = Capsule::read(bytes, layout) else { continue };
        let cells: Vec<Cell> =
            (0..layout.measurements()).map(|index| capsule.cell(index)).collect();
        let start_q6 = capsule.start_angle_q6();
        let again = Capsule::from_cells(layout, start_q6, capsule.is_new_scan(), &cells);
        assert_eq!(again, capsule);
    }
}

/// Requests are consumed to the end, and an understood one is the same after encoding it.
fn requests(mut stream: &[u8]) {
    while let Some((request, used)) = Request::decode(stream) {
        assert!(used > 0);
        let (bytes, rest) = stream.split_at(used);
        if let Some(request) = request {
            let (encoded, length) = request.encode();
            assert_eq!(encoded[..length], *bytes);
        }
        stream = rest;
    }
}
