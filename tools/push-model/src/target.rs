//! Parsing of the target that a model is sent to, and the command that runs its program.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};

/// A model store on this computer or on a robot.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
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

    /// The command that runs the robot's program: directly on this computer, or through ssh with these options.
    pub fn command(&self, program: &str, ssh_options: &[String]) -> Command {
        match self {
            Self::Local { .. } => Command::new(sibling_program(program)),
            Self::Remote { host, .. } => {
                let mut ssh = Command::new("ssh");
                ssh.args(ssh_options).arg("--").arg(host).arg(program);
                ssh
            }
        }
    }

    /// The arguments with which the robot's program installs a model, quoted for the shell of a remote robot.
    pub fn install_arguments(&self, gate: &[String]) -> Vec<String> {
        self.arguments(&["model", "install", "-"], gate)
    }

    /// The arguments with which the robot's program lists its models, quoted for the shell of a remote robot. Of the arguments for
    /// the gate, it takes those that say where the models are.
    pub fn list_arguments(&self, gate: &[String]) -> Vec<String> {
        self.arguments(&["model", "list"], &of_all_model_commands(gate))
    }

    fn arguments(&self, words: &[&str], more: &[String]) -> Vec<String> {
        let store = match self {
            Self::Local { store } => Some(store),
            Self::Remote { store, .. } => store.as_ref(),
        };
        let mut arguments: Vec<String> = words.iter().map(ToString::to_string).collect();
        arguments.extend(more.iter().map(|argument| self.quoted(argument)));
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

/// The program of this name in the directory of this program, if there is one; otherwise the name, to be found in `PATH`.
fn sibling_program(program: &str) -> PathBuf {
    let sibling = std::env::current_exe().ok().and_then(|this| Some(this.parent()?.join(program)));
    sibling.filter(|path| path.is_file()).unwrap_or_else(|| program.into())
}

/// The arguments that every `firmware-host model` command takes: `--config FILE` and `--store DIR`, also with `=`.
fn of_all_model_commands(gate: &[String]) -> Vec<String> {
    let mut found = Vec::new();
    let mut arguments = gate.iter();
    while let Some(argument) = arguments.next() {
        if argument.starts_with("--config=") || argument.starts_with("--store=") {
            found.push(argument.clone());
        } else if argument == "--config" || argument == "--store" {
            found.push(argument.clone());
            found.extend(arguments.next().cloned());
        }
    }
    found
}

/// Quotes text as one word for a POSIX shell.
fn quoted_for_shell(text: &str) -> String {
    format!("'{}'", text.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_of_the_store_that_the_model_is_installed_in() {
        let gate = ["--bound", "1.1", "--config", "/x.toml", "--store=/srv/m", "--config=/y.toml"];
        let gate: Vec<String> = gate.map(str::to_owned).to_vec();
        let target = Target::Local { store: "/m".into() };
        assert_eq!(
            target.list_arguments(&gate),
            [
                "model",
                "list",
                "--config",
                "/x.toml",
                "--store=/srv/m",
                "--config=/y.toml",
                "--store",
                "/m"
            ]
        );
    }

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
    fn a_list_takes_the_configuration_file_of_the_gate_and_nothing_else() {
        let target = Target::parse("robot:/models").unwrap();
        let gate = ["--config=/a b.toml", "--unproven"].map(str::to_owned);
        let line = target.list_arguments(&gate).join(" ");
        assert_eq!(line, "model list '--config=/a b.toml' --store '/models'");
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
