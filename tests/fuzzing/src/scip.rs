use drivers::scip::{
    Answer, Command, Encoding, Framer, Mode, Parameters, RangeCodes, Reply, Request, State,
    Version, message_length,
};
use hal::Range;

const COMMANDS: [Command; 10] = [
    Command::Scip2,
    Command::Quit,
    Command::Reset,
    Command::LaserOn,
    Command::Version,
    Command::Parameters,
    Command::State,
    Command::TimeStart,
    Command::Time,
    Command::TimeEnd,
];

/// Arbitrary bytes from a scanner as input of the SCIP codec. Three bytes select the request and
/// how the remaining bytes are divided; the rest is the scanner's data.
pub fn scip(data: &[u8]) {
    let Some((&[options, beams, chunk_bytes], stream)) = data.split_first_chunk::<3>() else {
        return;
    };
    let encoding =
        [Encoding::Two, Encoding::Three, Encoding::ThreeWithIntensity][usize::from(options) % 3];
    let mode =
        if options & 0x80 == 0 { Mode::Continuous { skip: 0, scans: 0 } } else { Mode::Once };
    let request =
        Request { encoding, mode, first_step: 0, last_step: u16::from(beams), cluster: 1 };
    let mut framer = Framer::<4096>::default();
    let mut cut = 0;
    for chunk in stream.chunks(usize::from(chunk_bytes).max(1)) {
        framer.free_space()[..chunk.len()].copy_from_slice(chunk);
        framer.received(chunk.len());
        while let Some(message) = framer.message() {
            assert_eq!(message_length(message), Some(message.len()));
            cut += message.len();
            read_scan(message, &request);
            request.last_echo(message).into_iter().for_each(|rest| read_scan(rest, &request));
            COMMANDS.iter().for_each(|command| read_answer(message, *command));
        }
    }
    assert!(cut <= stream.len());
}

fn read_answer(message: &[u8], command: Command) {
    if let Ok(answer) = Answer::read(message, command) {
        _ = (
            answer.time_ms(),
            Version::read(&answer),
            Parameters::read(&answer),
            State::read(&answer),
        );
    }
}

fn read_scan(message: &[u8], request: &Request) {
    let codes = RangeCodes::UTM_30LX;
    let beams = request.beams();
    let strengths = if request.encoding == Encoding::ThreeWithIntensity { beams } else { 0 };
    let mut ranges = vec![Range::Error; beams];
    let mut intensities = vec![0; strengths];
    let read =
        Reply::read_with_intensities(message, request, &codes, &mut ranges, &mut intensities);
    let Ok(Reply::Scan { timestamp_ms }) = read else { return };
    let (time, values) =
        reference_decoder(message, request.encoding).expect("an accepted scan is valid");
    assert_eq!(time, timestamp_ms);
    let step = if strengths > 0 { 2 } else { 1 };
    assert_eq!(values.len(), beams * step);
    assert!(values.iter().step_by(step).map(|value| codes.range(*value)).eq(ranges));
    assert!(values.iter().skip(1).step_by(2).take(strengths).eq(&intensities));
}

/// A reference decoder that follows the specification character by character.
fn reference_decoder(message: &[u8], encoding: Encoding) -> Option<(u32, Vec<u32>)> {
    let lines: Vec<&[u8]> = message.strip_suffix(b"\n\n")?.split(|byte| *byte == b'\n').collect();
    let mut data = Vec::new();
    let mut time = 0;
    for (number, line) in lines.iter().enumerate().skip(1) {
        let (sum, content) = line.split_last()?;
        let total: u32 = content.iter().map(|byte| u32::from(*byte)).sum();
        (u32::from(*sum) == total % 64 + 0x30).then_some(())?;
        match number {
            1 => {}
            2 => time = number_of(content),
            _ => data.extend_from_slice(content),
        }
    }
    let width = if encoding == Encoding::Two { 2 } else { 3 };
    Some((time, data.chunks(width).map(number_of).collect()))
}

fn number_of(characters: &[u8]) -> u32 {
    characters.iter().fold(0, |number, byte| number * 64 + u32::from(*byte) - 0x30)
}
