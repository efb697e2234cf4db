//! Parsing of the target that a model is sent to.

use anyhow::{Result, bail};

/// A model store on this computer or on a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A directory on this computer.
    Local { store: String },
    /// A robot that is reached by ssh.
    Remote {
        /// The robot's computer as ssh takes it: `[user@]host`.
        host: String,
        /// The directory of the store, if it differs from the one in the robot's configuration.
        store: Option<String>,
    },
}

impl Target {
    /// Parses `[user@]host`, `[user@]host:STORE` or a directory. Text that starts with `.` or has a `/` before the first `:` is a
    /// directory.
    ///
    /// # Errors
    /// When the host is empty, contains white space, or would be parsed as an option by ssh.
    pub fn parse(text: &str) -> Result<Self> {
        let before_colon = text.split(':').next().unwrap_or_default();
        if text.starts_with('.') || before_colon.contains('/') {
            return Ok(Self::Local { store: text.to_owned() });
        }
        let (host, store) =
            text.split_once(':').map_or((text, None), |(host, store)| (host, Some(store)));
        if host.is_empty() || host.starts_with('-') || host.contains(char::is_whitespace) {
            bail!(
                "`{text}` is not a target; give [user@]host, [user@]host:STORE, or a directory such as ./store"
            );
        }
        Ok(Self::Remote {
            host: host.to_owned(),
            store: store.filter(|store| !store.is_empty()).map(str::to_owned),
        })
    }

    /// The arguments of the robot's program, quoted for the shell of a remote robot.
    pub fn install_arguments(&self, gate: &[String]) -> Vec<String> {
        let store = match self {
            Self::Local { store } => Some(store),
            Self::Remote { store, .. } => store.as_ref(),
        };
        let mut arguments: Vec<String> = ["model", "install", "-"].map(str::to_owned).to_vec();
        arguments.extend(gate.iter().map(|argument| self.quoted(argument)));
        if let Some(store) = store {
            arguments.extend(["--store".to_owned(), self.quoted(store)]);
        }
        arguments
    }

    fn quoted(&self, argument: &str) -> String {
        match self {
            Self::Local { .. } => argument.to_owned(),
            Self::Remote { .. } => quoted_for_shell(argument),
        }
    }
}

/// Quotes text as one word for a POSIX shell.
fn quoted_for_shell(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn remote(host: &str, store: Option<&str>) -> Target {
        Target::Remote { host: host.into(), store: store.map(Into::into) }
    }

    fn local(store: &str) -> Target {
        Target::Local { store: store.into() }
    }

    #[test]
    fn hosts_stores_and_directories_are_distinguished() {
        for (text, target) in [
            ("robot", remote("robot", None)),
            ("me@robot.local", remote("me@robot.local", None)),
            ("robot:/var/lib/models", remote("robot", Some("/var/lib/models"))),
            ("robot:", remote("robot", None)),
            ("./store", local("./store")),
            ("/srv/a:b", local("/srv/a:b")),
        ] {
            assert_eq!(Target::parse(text).unwrap(), target, "{text}");
        }
    }

    #[test]
    fn hosts_that_ssh_would_parse_as_options_are_refused() {
        for text in ["-oProxyCommand=sh", "", ":x", "a b"] {
            assert!(Target::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn arguments_are_quoted_as_one_word_for_the_robots_shell() {
        let target = Target::parse("robot:/a b/$(reboot)'; x").unwrap();
        let arguments = target.install_arguments(&["--unproven".to_owned()]);
        let line = arguments.join(" ");
        assert_eq!(line, r"model install - '--unproven' --store '/a b/$(reboot)'\''; x'");
        // Checked with a real shell.
        let script = format!("printf '%s\\n' {line}");
        let shell = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
        let words = String::from_utf8(shell.stdout).unwrap();
        assert_eq!(words.lines().last(), Some("/a b/$(reboot)'; x"));
    }
}
