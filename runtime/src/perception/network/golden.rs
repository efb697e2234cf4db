//! The golden pair of a model's metadata: an input, and the network's output for it when it was exported (`tools/trainer`,
//! `golden.py`). It shows whether this file, library and processor compute the same before the robot uses the model.
//!
//! `golden_input` is base64 of bytes [channels, rows / 16, columns / 16]; each is 16x16 pixels of v / 255, of a cost volume
//! 4x4 cells. `golden_output` is base64 of little-endian 32-bit floats [rows / 16, columns / 16]: the output's first channel
//! at rows 16 i + 8 and columns 16 j + 8.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use super::NetworkError;
use super::bound::Port;

const BLOCK: usize = 16;
const INPUT: &str = "golden_input";
const OUTPUT: &str = "golden_output";

/// An input and its output, both on a grid of 16x16 pixels.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Golden {
    input: Vec<u8>,
    output: Vec<f32>,
    rows: usize,
    columns: usize,
}

impl Golden {
    /// Reads the pair for inputs of these shapes and frames of this size (columns, rows) from the metadata; `None` if there
    /// is none.
    pub fn read(
        metadata: &impl Fn(&str) -> Option<String>,
        ports: &[Port],
        (width, height): (usize, usize),
    ) -> Result<Option<Self>, NetworkError> {
        let (Some(input), Some(output)) = (metadata(INPUT), metadata(OUTPUT)) else {
            return Ok(None);
        };
        let rows = height / BLOCK;
        let columns = width / BLOCK;
        let channels: usize = ports.iter().map(|port| port.shape[1]).sum();
        let input = decoded(INPUT, &input, channels * rows * columns)?;
        let output = decoded(OUTPUT, &output, 4 * rows * columns)?;
        let output = output
            .chunks_exact(4)
            .map(|bytes| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]));
        Ok(Some(Self { input, output: output.collect(), rows, columns }))
    }

    /// Fills the planes of the input at `port`; `before` is the number of channels of the inputs before it.
    pub fn write(&self, port: &Port, before: usize, planes: &mut [f32]) {
        let [_, _, height, width] = port.shape;
        if height * width == 0 || self.rows * self.columns == 0 {
            return;
        }
        for (channel, plane) in planes.chunks_exact_mut(height * width).enumerate() {
            for (at, value) in plane.iter_mut().enumerate() {
                // Pixels beyond the last whole block belong to it.
                let row = (at / width * self.rows / height).min(self.rows - 1);
                let column = (at % width * self.columns / width).min(self.columns - 1);
                let index = ((before + channel) * self.rows + row) * self.columns + column;
                *value = self.input.get(index).map_or(0.0, |byte| f32::from(*byte) / 255.0);
            }
        }
    }

    /// Largest absolute difference from an output with `width` columns; infinite if a value of either is NaN.
    pub fn difference(&self, output: &[f32], width: usize) -> f32 {
        let expected = self.output.iter().enumerate().map(|(index, expected)| {
            let row = index / self.columns * BLOCK + BLOCK / 2;
            let column = index % self.columns * BLOCK + BLOCK / 2;
            (output.get(row * width + column).copied().unwrap_or(f32::NAN) - expected).abs()
        });
        expected.fold(0.0, |largest, difference| {
            if difference.is_nan() { f32::INFINITY } else { largest.max(difference) }
        })
    }
}

fn decoded(key: &'static str, text: &str, bytes: usize) -> Result<Vec<u8>, NetworkError> {
    let found = STANDARD.decode(text).ok().filter(|found| found.len() == bytes);
    found.ok_or_else(|| NetworkError::Metadata {
        key,
        value: text.chars().take(24).collect(),
        allowed: format!("base64 of {bytes} bytes, as `embodied-depth export` writes it"),
    })
}
