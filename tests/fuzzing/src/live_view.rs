use live_link::{Frame, FrameReader, Line, LineReader};
use live_view::access::Tokens;
use live_view::{protocol, publish};

/// Arbitrary bytes as what a client of the live view sends to the robot, as what the robot sends to the view, and as what a browser
/// sends to the view, as what it publishes, and as a file of tokens. What can be read comes back unchanged, and the pieces in which it comes do not matter.
pub fn live_view(bytes: &[u8]) {
    lines(bytes);
    frames(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = protocol::read_text(text);
        let _ = Tokens::parse(text);
    }
    // A number in JSON is finite, and so is an order that was read.
    if let Ok(live_link::Order::Drive { linear_mps, angular_radps }) = publish::order(bytes) {
        assert!(linear_mps.is_finite() && angular_radps.is_finite());
    }
    if let Ok(protocol::Request::Call(call)) = protocol::read_binary(bytes) {
        let _ = protocol::order_of(&call);
        let response = protocol::service_response(&call, false, "no");
        assert_eq!(&response[1..5], &call.service.to_le_bytes());
    }
}

fn lines(bytes: &[u8]) {
    let whole = LineReader::default().push(bytes);
    let mut reader = LineReader::default();
    let pieces: Vec<_> = bytes.chunks(7).flat_map(|piece| reader.push(piece)).collect();
    assert_eq!(whole.len(), pieces.len());
    for (one, other) in whole.iter().zip(&pieces) {
        assert_eq!(one.as_ref().ok(), other.as_ref().ok());
        if let Ok(line) = one {
            let written = line.to_bytes().expect("a line that was read can be written");
            let again = Line::parse(written.trim_ascii_end()).expect("a written line can be read");
            assert_eq!(*line, again);
        }
    }
}

fn frames(bytes: &[u8]) {
    let mut reader = FrameReader::default();
    reader.push(bytes);
    while let Ok(Some(frame)) = reader.next_frame() {
        let written = frame.to_bytes().expect("a frame that was read can be written");
        let mut reader = FrameReader::default();
        reader.push(&written);
        let again: Option<Frame> = reader.next_frame().expect("a written frame can be read");
        assert_eq!(again, Some(frame));
    }
}
