//! The command line.

use std::path::{Path, PathBuf};

use clap::{Parser, ValueEnum};
use segment_store::pull::Order;
use segment_store::source::is_store;

/// Brings what robots recorded to this computer: over the system's ssh, from a mounted directory or out of an object store. Goes
/// on at the byte where it was interrupted, verifies every segment by its digest, and never reads again what is here. Where DEST is
/// an object store, puts them there, from a robot's own directory or over ssh.
///
/// Exit codes: 0 everything is here; 1 something needs a person; 2 wrong arguments; 75 only the link failed, the same command
/// goes on from there.
#[derive(Debug, Parser)]
#[command(name = "pull-buffer", version, override_usage = "pull-buffer [OPTIONS] SOURCE... DEST")]
pub struct Options {
    /// One or more [user@]host:path, directories or object stores (s3://, gs://, az://), then the destination: a directory, or
    /// an object store. Each source goes into DEST/HOST (or DEST/ and the last part of the directory or address); NAME=SOURCE chooses another name.
    #[arg(required = true, num_args = 2.., value_name = "PLACE")]
    places: Vec<String>,
    /// Go on pulling what is recorded from now on, until interrupted. A segment comes when the robot has closed it, at most a
    /// minute after it began.
    #[arg(long)]
    pub follow: bool,
    /// Seconds between two looks with --follow.
    #[arg(long, default_value_t = 5, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub every_s: u64,
    /// One JSON object a line on stdout instead of words.
    #[arg(long)]
    pub json: bool,
    /// Not faster than this, each source: 5MB/s, 500k, 2MiB.
    #[arg(long, value_name = "RATE", value_parser = parse_rate)]
    pub limit: Option<u64>,
    /// What comes first.
    #[arg(long, value_enum, default_value_t = OrderArg::Oldest)]
    order: OrderArg,
    /// Also write every run in another layout, to DEST/HOST/LAYOUT/RUN.
    #[arg(long = "as", value_enum, conflicts_with = "follow", value_name = "LAYOUT")]
    pub layout: Option<Layout>,
    /// Do not tell the robot what is safe here, so that it does not delete it before the rest.
    #[arg(long)]
    pub no_mark: bool,
    /// firmware-host on the robot, when it is not in the path there.
    #[arg(long, default_value = "firmware-host", value_name = "COMMAND")]
    pub remote_command: String,
    /// An argument for ssh, as it is: --ssh-option=-p2222 --ssh-option=-i/path/to/key. May be given several times.
    #[arg(long = "ssh-option", value_name = "ARGUMENT", allow_hyphen_values = true)]
    pub ssh_options: Vec<String>,
    /// The link counts as dead when nothing comes for so many seconds.
    #[arg(long, default_value_t = 60, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..=3600))]
    pub stall_s: u64,
    /// How often a link that broke is made again, without --follow.
    #[arg(long, default_value_t = 3, value_name = "TIMES")]
    pub retries: u32,
}

impl Options {
    /// Everything but the last place.
    pub fn sources(&self) -> &[String] {
        self.places.split_last().map_or(&[], |(_, sources)| sources)
    }

    /// The last place.
    pub fn destination(&self) -> &Path {
        self.places.last().map_or(Path::new("."), Path::new)
    }

    /// The last place, when it is an object store.
    pub fn store(&self) -> Option<&str> {
        self.places.last().map(String::as_str).filter(|place| is_store(place))
    }

    /// Where a source's files go.
    pub fn directory_of(&self, name: &str) -> PathBuf {
        self.destination().join(name)
    }

    /// How the library wants it.
    pub fn pull(&self) -> segment_store::pull::Options {
        let order = match self.order {
            OrderArg::Oldest => Order::Oldest,
            OrderArg::Newest => Order::Newest,
            OrderArg::Valuable => Order::Valuable,
        };
        segment_store::pull::Options { order, limit: self.limit, no_mark: self.no_mark }
    }
}

/// What comes first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum OrderArg {
    /// As it was recorded.
    Oldest,
    /// The other way round.
    Newest,
    /// Segments that are marked to be kept, then those with the most events for their size.
    Valuable,
}

/// Layouts that can be written besides.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Layout {
    /// The TUM RGB-D benchmark's: rgb.txt, groundtruth.txt from odometry, dataset.toml.
    Tum,
    /// LeRobot's, version 3.0: Parquet with pictures, odometry and commands.
    #[cfg(feature = "lerobot")]
    Lerobot,
}

/// Bytes a second.
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
        _ => Err(format!("`{text}` is no rate from 1kB/s to 1000GB/s, such as 5MB/s or 500k")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Options::command().debug_assert();
    }

    #[test]
    fn rates_are_read_as_people_write_them() {
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
    fn the_last_place_is_the_destination() {
        let options = Options::parse_from(["pull-buffer", "a:/x", "b:/y", "dest"]);
        assert_eq!(
            (options.sources(), options.destination()),
            (&["a:/x".to_owned(), "b:/y".to_owned()][..], Path::new("dest"))
        );
        assert!(Options::try_parse_from(["pull-buffer", "only"]).is_err());
    }
}
