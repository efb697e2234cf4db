//! Reading the level of a line: of the kernel's GPIO character device, or a file that simulates one.

use std::path::PathBuf;

use gpiocdev::line::{Bias, Value};
use gpiocdev::{Chip, Request};

use super::{Level, StopLineConfig, StopLineError};

/// A line that can be read. It may block for as long as its bus needs.
pub trait Line: Send {
    /// The level now.
    ///
    /// # Errors
    /// The line cannot be read: its chip is gone.
    fn read(&self) -> Result<Level, StopLineError>;
}

/// Opens the line of the configuration as an input.
///
/// # Errors
/// Chip or line are absent, or another program uses the line.
pub fn open_line(config: &StopLineConfig) -> Result<Box<dyn Line>, StopLineError> {
    if let Some(path) = config.chip.strip_prefix("file:") {
        return Ok(Box::new(SimulatedLine { path: path.into() }));
    }
    let StopLineConfig { chip, line, .. } = config;
    let device = Chip::from_path(chip)
        .map_err(|source| StopLineError::Chip { chip: chip.clone(), source })?;
    let info = match line.parse() {
        Ok(number) => device.line_info(number).ok(),
        Err(_) => device.find_line_info(line),
    };
    let info =
        info.ok_or_else(|| StopLineError::NoLine { chip: chip.clone(), line: line.clone() })?;
    // Against a broken wire. Chips without such resistors ignore it.
    let bias = match config.released_level {
        Level::Low => Bias::PullUp,
        Level::High => Bias::PullDown,
    };
    let request = Request::builder()
        .on_chip(chip)
        .with_line(info.offset)
        .as_input()
        .with_bias(bias)
        .with_consumer("embodied-depth")
        .request()
        .map_err(|source| StopLineError::Line { chip: chip.clone(), line: line.clone(), source })?;
    Ok(Box::new(GpioLine { request, chip: chip.clone(), line: line.clone() }))
}

/// A line of a chip.
#[derive(Debug)]
struct GpioLine {
    request: Request,
    chip: String,
    line: String,
}

impl Line for GpioLine {
    fn read(&self) -> Result<Level, StopLineError> {
        match self.request.lone_value() {
            Ok(Value::Active) => Ok(Level::High),
            Ok(Value::Inactive) => Ok(Level::Low),
            Err(source) => Err(StopLineError::Line {
                chip: self.chip.clone(),
                line: self.line.clone(),
                source,
            }),
        }
    }
}

/// A file that contains `0` (low) or `1` (high).
#[derive(Debug)]
struct SimulatedLine {
    path: PathBuf,
}

impl Line for SimulatedLine {
    fn read(&self) -> Result<Level, StopLineError> {
        let text =
            std::fs::read_to_string(&self.path).map_err(|error| self.error(error.to_string()))?;
        match text.trim() {
            "0" => Ok(Level::Low),
            "1" => Ok(Level::High),
            other => Err(self.error(format!("it contains `{other}`"))),
        }
    }
}

impl SimulatedLine {
    fn error(&self, what: String) -> StopLineError {
        StopLineError::File { path: self.path.display().to_string(), what }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chip_that_is_absent_and_a_file_that_is_no_chip_are_named() {
        for chip in ["/nonexistent/gpiochip7", "/dev/null"] {
            let config = StopLineConfig {
                chip: chip.to_owned(),
                line: "17".to_owned(),
                ..StopLineConfig::default()
            };
            let said = open_line(&config).err().map(|error| error.to_string()).unwrap();
            assert!(said.contains(chip) && said.contains("gpiodetect"), "{said}");
        }
    }
}
