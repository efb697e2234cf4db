//! Where a model is sent.

use anyhow::{Result, bail};

/// A store on this computer or on a robot.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Target {
    /// A folder.
    Local {
        /// The store.
        store: String,
    },
    /// A robot that ssh knows how to reach.
    Remote {
        /// `[user@]host`.
        host: String,
        /// The store, if it is not the one of the robot's configuration.
        store: Option<String>,
    },
}

impl Target {
    /// `[user@]host`, `[user@]host:STORE`, or a folder: something with a `/` before any `:`, or that begins with `.`.
    ///
    /// # Errors
    /// A host that ssh would take for an option.
    pub fn parse(text: &str) -> Result<Self> {
        let before_colon = text.split(':').next().unwrap_or_default();
        if text.starts_with('.') || before_colon.contains('/') {
            return Ok(Self::Local { store: text.to_owned() });
        }
        let (host, store) =
            text.split_once(':').map_or((text, None), |(host, store)| (host, Some(store)));
        if host.is_empty() || host.starts_with('-') || host.contains(char::is_whitespace) {
            bail!(
                "`{text}` is no target; give [user@]host, [user@]host:STORE, or a folder such as ./store"
            );
        }
        Ok(Self::Remote {
            host: host.to_owned(),
            store: store.filter(|store| !store.is_empty()).map(str::to_owned),
        })
    }

    /// Arguments of the robot's program, quoted where a shell reads them.
    pub fn install_arguments(&self, gate: &[String]) -> Vec<String> {
        let (store, quote): (_, fn(&str) -> String) = match self {
            Self::Local { store } => (Some(store), str::to_owned),
            Self::Remote { store, .. } => (store.as_ref(), quoted),
        };
        let mut arguments: Vec<String> = ["model", "install", "-"].map(str::to_owned).to_vec();
        arguments.extend(gate.iter().map(|argument| quote(argument)));
        if let Some(store) = store {
            arguments.extend(["--store".to_owned(), quote(store)]);
        }
        arguments
    }
}

/// One word for a POSIX shell, whatever is in it.
fn quoted(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hosts_folders_and_stores_are_told_apart() {
        let remote = |host: &str, store: Option<&str>| Target::Remote {
            host: host.into(),
            store: store.map(Into::into),
        };
        let local = |store: &str| Target::Local { store: store.into() };
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
    fn what_ssh_would_take_for_an_option_is_refused() {
        for text in ["-oProxyCommand=sh", "", ":x", "a b"] {
            assert!(Target::parse(text).is_err(), "{text}");
        }
    }

    #[test]
    fn a_robots_shell_gets_one_word_whatever_is_in_it() {
        let target = Target::parse("robot:/a b/$(reboot)'; x").unwrap();
        let arguments = target.install_arguments(&["--unproven".to_owned()]);
        let line = arguments.join(" ");
        assert_eq!(line, r"model install - '--unproven' --store '/a b/$(reboot)'\''; x'");
        // The shell's own opinion.
        let script = format!("printf '%s\\n' {line}");
        let shell = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
        let words = String::from_utf8(shell.stdout).unwrap();
        assert_eq!(words.lines().last(), Some("/a b/$(reboot)'; x"));
    }
}
