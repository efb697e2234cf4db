use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::MessageHeader;
use runtime::recording::RecordingReader;

/// The channels that a replay reads, and one unknown channel.
const TOPICS: [&str; 8] = [
    "/robot/header",
    "/robot/tick",
    "/scan",
    "/camera/image",
    "/camera/truth_depth",
    "/robot/decision",
    "/robot/snapshot",
    "/map",
];

/// Arbitrary bytes as a recording, and as the messages of a recording. Ticks are returned in order
/// and can be converted to inputs.
///
/// Checksums would keep a fuzzer from reaching the contents of an MCAP file, so this function
/// writes correct ones. The input consists of messages: one byte for the channel, two for the
/// length (little-endian), and the data.
pub fn recording(bytes: &[u8]) {
    read(bytes);
    read(&with_checksums(bytes, &TOPICS));
}

fn read(bytes: &[u8]) {
    let Ok(reader) = RecordingReader::open(bytes) else { return };
    let mut last = None;
    for tick in reader.map_while(Result::ok) {
        assert!(last < Some(tick.tick), "{} after {last:?}", tick.tick);
        last = Some(tick.tick);
        let _ = tick.input();
    }
}

/// A segment with the messages that `bytes` consists of.
pub(crate) fn with_checksums(mut bytes: &[u8], topics: &[&str]) -> Vec<u8> {
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .create(Cursor::new(Vec::new()))
        .expect("writing to memory succeeds");
    let channels: Vec<u16> = topics
        .iter()
        .map(|topic| writer.add_channel(0, topic, "", &BTreeMap::new()))
        .collect::<Result<_, _>>()
        .expect("few channels");
    while let Some((&[channel, low, high], rest)) = bytes.split_first_chunk() {
        let (data, rest) =
            rest.split_at(usize::from(u16::from_le_bytes([low, high])).min(rest.len()));
        let channel_id = channels[usize::from(channel) % channels.len()];
        let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, data).expect("writing to memory succeeds");
        bytes = rest;
    }
    writer.finish().expect("writing to memory succeeds");
    writer.into_inner().into_inner()
}
