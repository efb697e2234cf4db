//! Configuration of the emergency stop's line, and what can be wrong with it.

use serde::{Deserialize, Serialize};

/// Level of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Level {
    #[default]
    Low,
    High,
}

hal::choices!(Level: "low", "high");

hal::settings! {
    /// An emergency stop whose normally closed contact is wired to an input of the computer (GPIO). It is optional, and a press
    /// needs a person, as that of the safety board does.
    pub struct StopLineConfig {
        /// GPIO chip, such as `/dev/gpiochip0`, or `file:PATH` for a simulated line. Empty: there is no such input.
        chip: String = String::new();
        /// Name of the line (`gpioinfo` lists them) or its number on the chip.
        line: String = String::new();
        /// Level of the line while the stop is released: `"low"` if its contact connects the line to ground (active low), `"high"` if it
        /// connects to the supply. The kernel is asked to pull the line to the other level, so that a broken wire is a press.
        released_level: Level = Level::Low;
        /// A change of the line counts after it has lasted this long, because contacts bounce.
        debounce_ms: u32 = 10, in 0..=50, unit "ms", source "contacts of stop buttons bounce for up to 5 ms";
    }
}

/// Why the emergency stop's line cannot be used or read.
#[derive(Debug, thiserror::Error)]
pub enum StopLineError {
    /// A value of the configuration is not allowed.
    #[error("emergency stop: {what}")]
    Config {
        /// The value, and what is allowed.
        what: String,
    },
    /// The chip is absent or may not be opened.
    #[error(
        "emergency stop: the GPIO chip {chip} cannot be opened ({source}): `gpiodetect` lists the chips, and the user must be in \
         the chip's group (often `gpio`)"
    )]
    Chip { chip: String, source: gpiocdev::Error },
    /// The chip has no such line.
    #[error("emergency stop: {chip} has no line `{line}`: `gpioinfo` lists the lines of all chips")]
    NoLine { chip: String, line: String },
    /// The kernel refuses the line or a reading of it.
    #[error(
        "emergency stop: line `{line}` of {chip} cannot be read ({source}): `gpioinfo` shows whether another program uses it"
    )]
    Line { chip: String, line: String, source: gpiocdev::Error },
    /// The file of a simulated line.
    #[error("emergency stop: the simulated line {path} must contain 0 or 1: {what}")]
    File { path: String, what: String },
    /// The thread that reads the line cannot be started.
    #[error("emergency stop: its thread cannot be started: {source}")]
    Thread { source: std::io::Error },
}

impl StopLineConfig {
    /// Whether the robot has this input.
    #[must_use]
    pub fn is_used(&self) -> bool {
        !self.chip.is_empty()
    }

    /// Checks every value, and the values together.
    ///
    /// # Errors
    /// [`StopLineError::Config`] with the first value that is not allowed.
    pub fn validate(&self) -> Result<(), StopLineError> {
        self.check_ranges().map_err(|error| StopLineError::Config { what: error.to_string() })?;
        let what = if !self.is_used() && !self.line.is_empty() {
            format!(
                "`line = \"{}\"` has no chip: set `chip`, such as \"/dev/gpiochip0\"",
                self.line
            )
        } else if self.is_used() && !self.is_simulated() && self.line.is_empty() {
            format!("`chip = \"{}\"` has no line: set `line` to its name or number", self.chip)
        } else {
            return Ok(());
        };
        Err(StopLineError::Config { what })
    }

    fn is_simulated(&self) -> bool {
        self.chip.starts_with("file:")
    }

    /// Chip and line, as messages name them.
    #[must_use]
    pub fn place(&self) -> String {
        format!("{} {}", self.chip, self.line).trim_end().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(chip: &str, line: &str) -> StopLineConfig {
        StopLineConfig { chip: chip.to_owned(), line: line.to_owned(), ..StopLineConfig::default() }
    }

    #[test]
    fn a_chip_needs_a_line_and_a_line_needs_a_chip() {
        for (chip, line, refusal) in [
            ("", "", None),
            ("/dev/gpiochip0", "17", None),
            ("file:/tmp/stop", "", None),
            ("/dev/gpiochip0", "", Some("set `line`")),
            ("", "GPIO17", Some("`line = \"GPIO17\"` has no chip")),
        ] {
            let said = config(chip, line).validate().err().map(|error| error.to_string());
            match refusal {
                None => assert_eq!(said, None, "{chip} {line}"),
                Some(part) => {
                    let said = said.unwrap();
                    assert!(said.contains(part), "{said}");
                }
            }
        }
        let slow = StopLineConfig { debounce_ms: 51, ..config("/dev/gpiochip0", "17") };
        assert!(slow.validate().unwrap_err().to_string().contains("0 to 50 ms"));
    }
}
