//! From the robot to the view: frames with their length in front.
//!
//! | bytes | content |
//! |---|---|
//! | 4 | length of what follows, little-endian, at most [`MAX_BYTES`] |
//! | 1 | kind: 1 channels, 2 message, 3 answer |
//! | rest | channels and answer: JSON. Message: id of the channel (2), time in nanoseconds since 1970 (8), payload |

use serde::{Deserialize, Serialize};

/// The largest frame. A map of 1,000 m2 with cells of 5 cm has 2 MB.
pub const MAX_BYTES: usize = 16 << 20;

const CHANNELS: u8 = 1;
const MESSAGE: u8 = 2;
const ANSWER: u8 = 3;
/// Kind, channel and time of a message.
const MESSAGE_HEAD: usize = 1 + 2 + 8;

/// A channel in the terms of Foxglove's protocol.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Channel {
    /// Number that messages name.
    pub id: u16,
    /// Name, such as `/map`.
    pub topic: String,
    /// `protobuf` or `json`.
    pub encoding: String,
    /// Name of the schema, such as `foxglove.Grid`.
    pub schema_name: String,
    /// `protobuf` or `jsonschema`.
    pub schema_encoding: String,
    /// The schema; base64 for `protobuf`.
    pub schema: String,
}

/// What became of an order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Answer {
    /// The number that the order came with.
    pub id: u64,
    /// Whether the robot does it.
    pub accepted: bool,
    /// What happens now, or why not, as a sentence.
    pub text: String,
}

/// What the robot sends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Frame {
    /// Announces all channels, once, as the first frame.
    Channels(Vec<Channel>),
    /// A message of a channel.
    Message {
        /// Number of the channel.
        channel: u16,
        /// Time of the message, nanoseconds since 1970.
        time_ns: u64,
        /// The message in the channel's encoding.
        payload: Vec<u8>,
    },
    /// The answer to an order.
    Answer(Answer),
}

/// Why the bytes are not frames.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FrameError {
    /// The length is larger than a frame may be, or too small for its kind.
    #[error("a frame of {0} bytes is not a frame of the live view: 1 to {MAX_BYTES} are")]
    Length(usize),
    /// Another program, or another version of this one.
    #[error("frames of kind {0} are not known: is the live view of the robot's version?")]
    Kind(u8),
    /// JSON that is not what its kind demands.
    #[error("a frame does not hold what its kind demands: {0}")]
    Json(#[from] serde_json::Error),
}

impl Frame {
    /// The frame as bytes, with its length.
    ///
    /// # Errors
    /// A message that is too large.
    pub fn to_bytes(&self) -> Result<Vec<u8>, FrameError> {
        match self {
            Self::Channels(channels) => json_frame(CHANNELS, channels),
            Self::Answer(answer) => json_frame(ANSWER, answer),
            Self::Message { channel, time_ns, payload } => message(*channel, *time_ns, payload),
        }
    }

    fn parse(body: &[u8]) -> Result<Self, FrameError> {
        let Some((kind, rest)) = body.split_first() else { return Err(FrameError::Length(0)) };
        match *kind {
            CHANNELS => Ok(Self::Channels(serde_json::from_slice(rest)?)),
            ANSWER => Ok(Self::Answer(serde_json::from_slice(rest)?)),
            MESSAGE => {
                let short = FrameError::Length(body.len());
                let Some((channel, rest)) = rest.split_first_chunk() else { return Err(short) };
                let Some((time_ns, payload)) = rest.split_first_chunk() else { return Err(short) };
                Ok(Self::Message {
                    channel: u16::from_le_bytes(*channel),
                    time_ns: u64::from_le_bytes(*time_ns),
                    payload: payload.to_vec(),
                })
            }
            kind => Err(FrameError::Kind(kind)),
        }
    }
}

/// A message as bytes, from a payload that the caller keeps.
///
/// # Errors
/// A payload that is too large.
pub fn message(channel: u16, time_ns: u64, payload: &[u8]) -> Result<Vec<u8>, FrameError> {
    let mut bytes = begin(MESSAGE, MESSAGE_HEAD + payload.len())?;
    bytes.extend_from_slice(&channel.to_le_bytes());
    bytes.extend_from_slice(&time_ns.to_le_bytes());
    bytes.extend_from_slice(payload);
    Ok(bytes)
}

fn json_frame(kind: u8, content: &impl Serialize) -> Result<Vec<u8>, FrameError> {
    let json = serde_json::to_vec(content)?;
    let mut bytes = begin(kind, 1 + json.len())?;
    bytes.extend_from_slice(&json);
    Ok(bytes)
}

/// Length and kind.
fn begin(kind: u8, length: usize) -> Result<Vec<u8>, FrameError> {
    let number = u32::try_from(length).ok().filter(|_| length <= MAX_BYTES);
    let number = number.ok_or(FrameError::Length(length))?;
    let mut bytes = Vec::with_capacity(4 + length);
    bytes.extend_from_slice(&number.to_le_bytes());
    bytes.push(kind);
    Ok(bytes)
}

/// Finds frames in a stream that comes in pieces.
#[derive(Debug, Default)]
pub struct FrameReader {
    bytes: Vec<u8>,
}

impl FrameReader {
    /// Appends a piece of the stream.
    pub fn push(&mut self, piece: &[u8]) {
        self.bytes.extend_from_slice(piece);
    }

    /// The next frame; `None` until more bytes come. After an error the stream is of no use.
    ///
    /// # Errors
    /// Bytes that are no frame.
    pub fn next_frame(&mut self) -> Result<Option<Frame>, FrameError> {
        let Some((head, rest)) = self.bytes.split_first_chunk() else { return Ok(None) };
        let length = u32::from_le_bytes(*head) as usize;
        if length == 0 || length > MAX_BYTES {
            return Err(FrameError::Length(length));
        }
        let Some(body) = rest.get(..length) else { return Ok(None) };
        let frame = Frame::parse(body)?;
        self.bytes.drain(..4 + length);
        Ok(Some(frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_frame() -> impl Strategy<Value = Frame> {
        prop_oneof![
            (any::<u16>(), any::<u64>(), any::<Vec<u8>>()).prop_map(
                |(channel, time_ns, payload)| Frame::Message { channel, time_ns, payload }
            ),
            (any::<u64>(), any::<bool>(), any::<String>())
                .prop_map(|(id, accepted, text)| Frame::Answer(Answer { id, accepted, text })),
            (any::<u16>(), any::<String>(), any::<String>()).prop_map(|(id, topic, schema)| {
                Frame::Channels(vec![Channel {
                    id,
                    topic,
                    encoding: "json".to_owned(),
                    schema_name: "robot.Now".to_owned(),
                    schema_encoding: "jsonschema".to_owned(),
                    schema,
                }])
            }),
        ]
    }

    proptest! {
        #[test]
        fn frames_come_back_however_the_stream_is_cut(
            frames in prop::collection::vec(any_frame(), 0..6),
            piece in 1usize..40,
        ) {
            let stream: Vec<u8> =
                frames.iter().flat_map(|frame| frame.to_bytes().unwrap()).collect();
            let mut reader = FrameReader::default();
            let mut read = Vec::new();
            for piece in stream.chunks(piece) {
                reader.push(piece);
                while let Some(frame) = reader.next_frame().unwrap() {
                    read.push(frame);
                }
            }
            prop_assert_eq!(read, frames);
        }

        #[test]
        fn rubbish_is_an_error_or_waits_for_more(bytes in any::<Vec<u8>>()) {
            let mut reader = FrameReader::default();
            reader.push(&bytes);
            while let Ok(Some(_)) = reader.next_frame() {}
        }
    }

    #[test]
    fn a_length_that_no_frame_has_is_refused_before_its_bytes_come() {
        let mut reader = FrameReader::default();
        reader.push(&u32::MAX.to_le_bytes());
        assert!(matches!(reader.next_frame(), Err(FrameError::Length(_))));
        assert!(message(0, 0, &vec![0; MAX_BYTES]).is_err());
    }
}
