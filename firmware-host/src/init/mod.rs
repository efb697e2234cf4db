//! `firmware-host init`: from a box of parts to a configuration.
//!
//! | module | what it does |
//! |---|---|
//! | `search` | finds devices by their names, without opening any |
//! | `query` | asks cameras what they offer, and listens which motor controllers send on a bus |
//! | `found` | what was found, in words |
//! | `questions` | what is asked, and which keys an answer sets |
//! | `answers` | what is an answer; files of answers |
//! | `endpoints` | what has to be known of an ODrive's firmware |
//! | `dialogue` | asks a person |
//! | `robot_file` | writes the answers as a configuration |
//! | `turn_wheels` | turns each wheel, and concludes from what a person sees |

mod answers;
mod dialogue;
mod endpoints;
mod found;
mod query;
mod questions;
mod robot_file;
mod search;
mod turn_wheels;

use std::io::{BufReader, IsTerminal, stdin};
use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use rustix::fs::{Access, access};

use crate::check;
use crate::cli::{CheckArgs, InitArgs};
use crate::config::{Commissioning, Config};
use crate::output::Output;
use crate::report::atomic::{self, write_atomically};
use crate::report::fit;
use answers::Answers;
use dialogue::Dialogue;
use found::Found;
use search::Places;
use turn_wheels::Correction;

/// Finds devices, asks, writes the configuration and checks it.
///
/// # Errors
/// The file exists, no questions can be asked, an answer in a file is not allowed, or the file cannot be written.
pub fn run(args: &InitArgs) -> Result<ExitCode> {
    let is_terminal = stdin().is_terminal();
    if !args.print_answers {
        refuse_early(args, is_terminal)?;
    }
    let places = Places { root: "/".into(), simulated: args.simulated.clone() };
    let mut found = places.search();
    query::query_devices(&mut found);
    if args.print_answers {
        print!("{}", answers::template(&found));
        return Ok(ExitCode::SUCCESS);
    }
    let mut input = BufReader::new(stdin());
    let mut output = Output;
    let mut dialogue = Dialogue::new(&mut input, &mut output, fit::columns());
    let before = file_before(&args.out)?;
    let answers = ask(args, &found, &mut dialogue)?;
    let write = |correction: &Correction| {
        let text = robot_file::text(&answers, &found, correction, before.as_ref());
        write_atomically(&args.out, text.as_bytes())
            .with_context(|| format!("cannot write {}", args.out.display()))
    };
    write(&Correction::default())?;
    dialogue.say(&format!("\nWrote {}.\n", args.out.display()))?;
    let config = Some(args.out.clone());
    let verdict = check::run(&CheckArgs { config, devices: true, drive: false, yes: false })?;
    if args.turn_wheels {
        let base = Config::load(&args.out)?.devices.base;
        turn_wheels::run(&mut dialogue, &base, &write)?;
    }
    // A file that cannot be loaded has failed the check above.
    let commissioning = Config::load(&args.out).map(|config| config.run.commissioning);
    let next = next_command(verdict == ExitCode::SUCCESS, commissioning.unwrap_or_default());
    dialogue.say(&format!("\n{next} --config {}", args.out.display()))?;
    Ok(verdict)
}

fn next_command(devices_work: bool, commissioning: Commissioning) -> &'static str {
    match (devices_work, commissioning) {
        (false, _) => "Correct what is marked above, then: firmware-host check --devices",
        (true, Commissioning::Measured) => {
            "The devices work. Put the robot on the floor and measure it: firmware-host check --drive"
        }
        (true, _) => "The robot is ready: firmware-host run",
    }
}

/// Refuses what cannot succeed before the first question is asked.
fn refuse_early(args: &InitArgs, is_terminal: bool) -> Result<()> {
    if args.out.exists() && !args.force {
        bail!("{} exists: --force replaces it, --out FILE writes another file", args.out.display());
    }
    // The folder of the file that a link leads to.
    let out = atomic::target(&args.out)?;
    let folder = out.parent().filter(|folder| *folder != Path::new(""));
    let folder = folder.unwrap_or(Path::new("."));
    access(folder, Access::WRITE_OK).with_context(|| {
        format!("cannot write {}: choose another folder by --out, or use sudo", args.out.display())
    })?;
    if args.turn_wheels && !is_terminal {
        bail!(
            "--turn-wheels needs a person who sees the wheels, and standard input is not a terminal"
        );
    }
    if args.answers.is_none() && !is_terminal {
        bail!(
            "standard input is not a terminal, so no questions can be asked: give the answers by --answers FILE; \
             `firmware-host init --print-answers > answers.toml` writes some to begin with"
        );
    }
    Ok(())
}

fn ask(args: &InitArgs, found: &Found, dialogue: &mut Dialogue<'_>) -> Result<Answers> {
    dialogue.say("Found:")?;
    found.lines().iter().try_for_each(|line| dialogue.say(line))?;
    match &args.answers {
        Some(file) => answers::read(file, found),
        None => {
            dialogue.say(
                "\nEnter takes the value in brackets. Ctrl-C ends, and nothing is written. Lengths are in metres.",
            )?;
            dialogue.ask_all(found)
        }
    }
}

/// The file that is replaced.
fn file_before(path: &Path) -> Result<Option<toml::Table>> {
    if !path.exists() {
        return Ok(None);
    }
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("cannot read {}, which is to be replaced", path.display()))?;
    let table = text.parse().with_context(|| {
        format!("{} is to be replaced, but is not TOML: remove it", path.display())
    })?;
    Ok(Some(table))
}
