//! The command line.

use std::path::{Path, PathBuf};

use clap::{CommandFactory, Parser, ValueEnum};
use clap_complete::Shell;
use segment_store::pull::Order;
use segment_store::source::is_store;

/// Copies recorded segments from one or more robots to this computer.
///
/// Each SOURCE is [user@]host:path (reached with the system's ssh), a directory, or an object store (s3://, gs://, az://). The
/// last argument, DEST, is a directory. It can also be an object store; the segments are then uploaded.
///
/// An interrupted transfer resumes at the byte where it stopped. Every segment is verified by its digest, and segments that are
/// already in DEST are not read again.
///
/// Exit codes: 0 all segments are in DEST; 1 an error that needs attention, or segments that the source cannot read; 2 invalid
/// arguments; 75 only the link failed, and the same command resumes the transfer.
#[derive(Debug, Parser)]
#[command(name = "pull-buffer", version, override_usage = "pull-buffer [OPTIONS] SOURCE... DEST")]
pub struct Options {
    /// Print a completion script for a shell: `source <(pull-buffer --completions bash)` completes in this shell.
    #[arg(long, value_name = "SHELL", exclusive = true)]
    pub completions: Option<Shell>,
    /// Print the man page: `pull-buffer --man | man -l -` shows it.
    #[arg(long, exclusive = true)]
    pub man: bool,
    /// One or more sources, then the destination.
    ///
    /// The segments of a source are written to DEST/NAME. NAME is the host or the last component of the directory or URL; write
    /// NAME=SOURCE to choose another one.
    #[arg(required = true, num_args = 2.., value_name = "SOURCE... DEST")]
    places: Vec<String>,
    /// Keep pulling new segments until interrupted.
    ///
    /// A segment is pulled when the robot has closed it, at most one minute after it was started.
    #[arg(long)]
    pub follow: bool,
    /// With --follow, list the segments of each source every NUM seconds.
    #[arg(long, default_value_t = 5, value_name = "NUM", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub every_s: u64,
    /// Print one JSON object per line to standard output.
    #[arg(long)]
    pub json: bool,
    /// Limit the transfer rate of each source, such as 5MB/s, 500k or 2MiB.
    #[arg(long, value_name = "RATE", value_parser = parse_rate)]
    pub limit: Option<u64>,
    /// The order in which segments are pulled.
    #[arg(long, value_enum, default_value_t = OrderArg::Oldest, value_name = "ORDER")]
    order: OrderArg,
    /// Also export every run in another format, to DEST/NAME/FORMAT/RUN.
    #[arg(long = "as", value_enum, conflicts_with = "follow", value_name = "FORMAT")]
    pub layout: Option<Layout>,
    /// Encrypt the segments that are uploaded to an object store.
    ///
    /// KEY is a public key of age (age1...), or a file with one in each line; `age-keygen -o key.txt` makes one. Can be given
    /// several times: the secret key of each alone decrypts the segments. Segments that are in the store already stay as they
    /// are.
    #[arg(long, value_name = "KEY")]
    pub encrypt_to: Vec<String>,
    /// Decrypt the segments that are pulled from an object store.
    ///
    /// FILE contains a secret key of age, as `age-keygen -o FILE` writes it. Can be given several times. Encrypted segments that
    /// no key decrypts are named and left out, and the exit code is 1.
    #[arg(long, value_name = "FILE")]
    pub identity: Vec<PathBuf>,
    /// Do not tell the robot which segments were copied.
    ///
    /// By default the robot writes a .pulled marker beside each copied segment, and its quota deletes marked segments first.
    #[arg(long)]
    pub no_mark: bool,
    /// The command that runs firmware-host on the robot.
    #[arg(
        long = "program",
        alias = "remote-command",
        default_value = "firmware-host",
        value_name = "COMMAND"
    )]
    pub remote_command: String,
    /// Pass an argument to ssh, such as --ssh=-p2222 or --ssh=-i/path/to/key. Can be given several times.
    #[arg(long = "ssh", alias = "ssh-option", value_name = "ARG", allow_hyphen_values = true)]
    pub ssh_options: Vec<String>,
    /// Treat the link as dead when nothing is received for NUM seconds.
    #[arg(long, default_value_t = 60, value_name = "NUM", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub stall_s: u64,
    /// Reconnect up to NUM times after the link broke. With --follow there is no limit.
    #[arg(long, default_value_t = 3, value_name = "NUM")]
    pub retries: u32,
}

impl Options {
    /// The completion script or the man page, if one was asked for.
    pub fn manual(&self) -> Option<Vec<u8>> {
        let mut command = Self::command();
        let mut text = Vec::new();
        if let Some(shell) = self.completions {
            clap_complete::generate(shell, &mut command, "pull-buffer", &mut text);
            return Some(text);
        }
        // Writing into memory does not fail.
        (self.man && clap_mangen::Man::new(command).render(&mut text).is_ok()).then_some(text)
    }

    pub fn sources(&self) -> &[String] {
        self.places.split_last().map_or(&[], |(_, sources)| sources)
    }

    pub fn destination(&self) -> &Path {
        self.places.last().map_or(Path::new("."), Path::new)
    }

    /// The destination, if it is an object store.
    pub fn destination_store(&self) -> Option<&str> {
        self.places.last().map(String::as_str).filter(|place| is_store(place))
    }

    /// The directory that the segments of a source are written to.
    pub fn directory_of(&self, name: &str) -> PathBuf {
        self.destination().join(name)
    }

    pub fn pull_options(&self) -> segment_store::pull::Options {
        let order = match self.order {
            OrderArg::Oldest => Order::Oldest,
            OrderArg::Newest => Order::Newest,
            OrderArg::Valuable => Order::Valuable,
        };
        segment_store::pull::Options { order, limit: self.limit, no_mark: self.no_mark }
    }
}

/// The values of --order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum OrderArg {
    /// Oldest segments first.
    Oldest,
    /// Newest segments first.
    Newest,
    /// Segments with a .keep marker first, then those with the most events per byte.
    Valuable,
}

/// The values of --as.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Layout {
    /// The format of the TUM RGB-D benchmark, with localized poses of the camera.
    Tum,
    /// Refused with the command that writes LeRobot datasets.
    #[value(hide = true)]
    Lerobot,
}

/// Parses a rate in bytes per second.
fn parse_rate(text: &str) -> Result<u64, String> {
    let bare = text.trim().trim_end_matches("/s");
    let digits = bare.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(bare.len());
    let (number, unit) = bare.split_at(digits);
    let factor = match unit.trim().to_ascii_lowercase().as_str() {
        "" | "b" => 1.0,
        "k" | "kb" => 1e3,
        "m" | "mb" => 1e6,
        "g" | "gb" => 1e9,
        "kib" => 1024.0,
        "mib" => 1024.0 * 1024.0,
        "gib" => 1024.0 * 1024.0 * 1024.0,
        _ => f64::NAN,
    };
    match number.parse::<f64>().map(|number| number * factor) {
        Ok(rate) if (1000.0..1e12).contains(&rate) => Ok(rate as u64),
        _ => {
            Err(format!("`{text}` is not a rate between 1kB/s and 1000GB/s, such as 5MB/s or 500k"))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        Options::command().debug_assert();
    }

    #[test]
    fn completions_and_the_man_page_need_no_sources() {
        let script = Options::parse_from(["pull-buffer", "--completions", "bash"]).manual();
        assert!(String::from_utf8(script.unwrap()).unwrap().contains("--retries"));
        let page = Options::parse_from(["pull-buffer", "--man"]).manual();
        assert!(String::from_utf8(page.unwrap()).unwrap().contains("DEST"));
        assert!(Options::parse_from(["pull-buffer", "a:/x", "here"]).manual().is_none());
    }

    #[test]
    fn lerobot_is_refused_before_the_pull_with_the_command_that_writes_it() {
        let options = Options::parse_from(["pull-buffer", "a:/x", "here", "--as", "lerobot"]);
        let Some(Err(error)) = options.layout.map(Layout::check) else {
            panic!("it is not refused")
        };
        let command = "`embodied-depth convert DEST/NAME --as lerobot --out DIR`";
        assert!(error.to_string().contains(command), "{error}");
        let options = Options::parse_from(["pull-buffer", "a:/x", "here", "--as", "tum"]);
        assert!(matches!(options.layout.map(Layout::check), Some(Ok(()))));
    }

    #[test]
    fn rates_are_parsed_with_and_without_units() {
        for (text, rate) in [
            ("5MB/s", 5_000_000),
            ("500k", 500_000),
            ("2MiB", 2 << 20),
            ("1.5 MB/s", 1_500_000),
            ("12345", 12_345),
        ] {
            assert_eq!(parse_rate(text), Ok(rate), "{text}");
        }
        for bad in ["", "fast", "-5MB/s", "0", "5 parsecs", "nan", "1e99GB"] {
            assert!(parse_rate(bad).unwrap_err().contains("5MB/s"), "{bad}");
        }
    }

    #[test]
    fn ssh_and_program_have_the_names_of_push_model_and_their_old_names_still_work() {
        for [ssh, program] in [["--ssh", "--program"], ["--ssh-option", "--remote-command"]] {
            let ssh = format!("{ssh}=-p2222");
            let options =
                Options::parse_from(["pull-buffer", "a:/x", "here", &ssh, program, "/opt/robot"]);
            assert_eq!(options.ssh_options, ["-p2222"]);
            assert_eq!(options.remote_command, "/opt/robot");
        }
    }

    #[test]
    fn the_last_argument_is_the_destination() {
        let options = Options::parse_from(["pull-buffer", "a:/x", "b:/y", "dest"]);
        assert_eq!(
            (options.sources(), options.destination()),
            (&["a:/x".to_owned(), "b:/y".to_owned()][..], Path::new("dest"))
        );
        assert!(Options::try_parse_from(["pull-buffer", "only"]).is_err());
    }
}
