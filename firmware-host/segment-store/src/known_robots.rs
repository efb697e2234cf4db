//! The robots whose segments are accepted: a text file with a robot in each line.

use std::collections::BTreeMap;

use crate::signature::is_key;

/// A line that names no robot.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "line {line}: {shown:?} is no robot; a line is a public key of 64 lower-case hexadecimal digits (`firmware-host identity` prints it) and a name without spaces"
)]
pub struct BadRobot {
    line: usize,
    shown: String,
}

/// Public keys of robots, and the names that the file gives them.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct KnownRobots {
    names: BTreeMap<String, String>,
}

impl KnownRobots {
    /// Reads lines of a public key and an optional name. Empty lines and lines that begin with `#` are ignored.
    ///
    /// # Errors
    /// For the first line of another form.
    pub fn parse(text: &str) -> Result<Self, BadRobot> {
        let mut names = BTreeMap::new();
        for (index, line) in text.lines().map(str::trim).enumerate() {
            if line.is_empty() || line.starts_with('#') {
                continue;
            }
            let mut words = line.split_whitespace();
            let key = words.next().filter(|key| is_key(key));
            let name = words.next().unwrap_or_default();
            match (key, words.next()) {
                (Some(key), None) => names.insert(key.to_owned(), name.to_owned()),
                _ => {
                    let shown = line.chars().take(100).collect();
                    return Err(BadRobot { line: index + 1, shown });
                }
            };
        }
        Ok(Self { names })
    }

    /// The name of the robot with this public key, or the first eight digits of the key if the file gives it none; `None` if the
    /// robot is not known.
    #[must_use]
    pub fn name_of(&self, key: &str) -> Option<&str> {
        let (key, name) = self.names.get_key_value(key)?;
        if name.is_empty() { key.get(..8) } else { Some(name) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn robots_are_known_by_their_keys_with_or_without_a_name() {
        let kitchen = "ab".repeat(32);
        let nameless = "01".repeat(32);
        let text = format!("# our robots\n\n{kitchen} kitchen\n  {nameless}\n  # more\n");
        let robots = KnownRobots::parse(&text).unwrap();
        assert_eq!(robots.name_of(&kitchen), Some("kitchen"));
        assert_eq!(robots.name_of(&nameless), Some("01010101"));
        assert_eq!(robots.name_of(&"cd".repeat(32)), None);
    }

    #[test]
    fn a_line_that_is_no_robot_is_refused_with_its_number() {
        let key = "ab".repeat(32);
        for bad in [
            "kitchen".to_owned(),
            format!("{key}0 kitchen"),
            format!("{key} a b"),
            key.to_uppercase(),
        ] {
            let error = KnownRobots::parse(&format!("# robots\n{bad}\n")).unwrap_err();
            assert!(error.to_string().starts_with("line 2: "), "{error}");
        }
    }
}
