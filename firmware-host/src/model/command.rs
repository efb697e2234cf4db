//! The command line of models.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use runtime::model_gate::{Examination, GateLimits, Verdict};
use serde_json::json;
use signed_model::{Bundle, TrustedKeys};

use super::{ChildLimits, Gate, Outcome, Store, examine};
use crate::config::Config;

/// Where the packaged robot has its configuration.
const USUAL_CONFIG: &str = "/etc/embodied-depth/robot.toml";

/// Arguments of `model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    /// Configuration file [default: /etc/embodied-depth/robot.toml where there is one].
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Folder of the robot's models [default: `models.store`].
    #[arg(long, global = true, value_name = "DIR")]
    pub store: Option<PathBuf>,
    /// One JSON object instead of words.
    #[arg(long, global = true)]
    pub json: bool,
    /// What to do.
    #[command(subcommand)]
    pub command: ModelCommand,
}

/// What to do with models.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// Check a signed model against the current one and, when it is as good, make it the current one, on trial. Exits with 1
    /// when it is refused.
    Install(InstallArgs),
    /// Which models there are, and what became of all others.
    List,
    /// Check a bundle's signature, and run nothing.
    Verify(VerifyArgs),
    /// Go back to the model before the current one, or to coarse depth when there is none.
    Rollback(RollbackArgs),
    /// Fails with a hint: signing keys are made on the workstation, and this program cannot sign.
    #[command(hide = true)]
    Keygen {
        /// Ignored.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<OsString>,
    },
    /// What `install` starts to run a model for the first time.
    #[command(hide = true)]
    Examine(ExamineArgs),
}

/// Arguments of `model install`.
#[derive(Debug, Args)]
pub struct InstallArgs {
    /// NAME.onnx with NAME.onnx.minisig beside it, or `-`: the stream of `push-model` on standard input.
    pub bundle: PathBuf,
    /// Trusted public keys [default: `models.trusted_keys`].
    #[arg(long, value_name = "FILE")]
    pub trusted_keys: Option<PathBuf>,
    /// Recorded runs of this robot, or folders of such [default: `models.recordings`]. May be given more than once.
    #[arg(long, value_name = "DIR")]
    pub recordings: Vec<PathBuf>,
    /// Held-out pictures to judge by, at most.
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub frames: u64,
    /// Take a first model without enough held-out pictures. With a model installed it changes nothing.
    #[arg(long)]
    pub unproven: bool,
    /// Examine a model that was rolled back before once more.
    #[arg(long)]
    pub again: bool,
    /// Examine at normal instead of idle priority: sooner done, and in the way of a robot that drives meanwhile.
    #[arg(long)]
    pub normal_priority: bool,
}

/// Arguments of `model verify`.
#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// NAME.onnx with NAME.onnx.minisig beside it, or `-`.
    pub bundle: PathBuf,
    /// Trusted public keys [default: `models.trusted_keys`].
    #[arg(long, value_name = "FILE")]
    pub trusted_keys: Option<PathBuf>,
}

/// Arguments of `model rollback`.
#[derive(Debug, Args)]
pub struct RollbackArgs {
    /// Why, for the history.
    #[arg(long, default_value = "rolled back by an operator")]
    pub why: String,
}

/// Arguments of `model examine`. The model that nobody has run yet comes on standard input.
#[derive(Debug, Clone, Args)]
pub struct ExamineArgs {
    /// The model that drives.
    #[arg(long)]
    pub resident: Option<PathBuf>,
    /// Recorded runs.
    #[arg(long)]
    pub recordings: Vec<PathBuf>,
    /// Held-out pictures at most.
    #[arg(long)]
    pub frames: usize,
    /// Address space.
    #[arg(long)]
    pub memory_mib: u64,
    /// Processor time.
    #[arg(long)]
    pub cpu_s: u64,
    /// Whether only otherwise idle time is used.
    #[arg(long)]
    pub idle: bool,
    /// The configuration: `--config` of `model`.
    #[arg(skip)]
    pub config: Option<PathBuf>,
}

/// Does it.
///
/// # Errors
/// What keeps it from being done. A model that is refused is no error but exit code 1.
pub fn run(args: &ModelArgs) -> Result<ExitCode> {
    let config_path = args
        .config
        .clone()
        .or_else(|| Some(PathBuf::from(USUAL_CONFIG)).filter(|path| path.exists()));
    if let ModelCommand::Examine(examine) = &args.command {
        let examine = ExamineArgs { config: args.config.clone(), ..examine.clone() };
        return examine::run(&examine).map(|()| ExitCode::SUCCESS);
    }
    if let ModelCommand::Keygen { .. } = &args.command {
        bail!(
            "`model keygen` was removed: a signing key does not belong on a robot; run `push-model keygen FILE` on the workstation"
        );
    }
    let config = config_path.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    match &args.command {
        ModelCommand::Install(install) => self::install(args, install, config_path, &config),
        ModelCommand::List => list(&open(args, &config)?, args.json),
        ModelCommand::Verify(verify) => self::verify(args, verify, &config),
        ModelCommand::Rollback(rollback) => {
            roll_back(&mut open(args, &config)?, &rollback.why, args.json)
        }
        ModelCommand::Examine(_) | ModelCommand::Keygen { .. } => Ok(ExitCode::FAILURE),
    }
}

fn open(args: &ModelArgs, config: &Config) -> Result<Store> {
    let configured =
        || Some(PathBuf::from(&config.models.store)).filter(|path| !path.as_os_str().is_empty());
    match args.store.clone().or_else(configured) {
        Some(dir) => Ok(Store::open(&dir)?),
        None => bail!(
            "where are the models? give --store DIR, or set models.store in the configuration"
        ),
    }
}

fn read_bundle(path: &Path) -> Result<Bundle> {
    Ok(if path == Path::new("-") {
        Bundle::read_stream(std::io::stdin().lock())?
    } else {
        Bundle::read_files(path)?
    })
}

fn keys(given: Option<&PathBuf>, config: &Config) -> Result<TrustedKeys> {
    Ok(TrustedKeys::read(given.map_or(Path::new(&config.models.trusted_keys), PathBuf::as_path))?)
}

fn install(
    args: &ModelArgs,
    install: &InstallArgs,
    config_path: Option<PathBuf>,
    config: &Config,
) -> Result<ExitCode> {
    let mut store = open(args, config)?;
    let keys = keys(install.trusted_keys.as_ref(), config)?;
    let mut recordings = install.recordings.clone();
    if recordings.is_empty() && !config.models.recordings.is_empty() {
        recordings.push(PathBuf::from(&config.models.recordings));
    }
    let models = &config.models;
    let gate = Gate {
        program: std::env::current_exe()
            .context("cannot find this program to start it once more")?,
        config: config_path,
        recordings,
        frames: install.frames as usize,
        child: ChildLimits { memory_mib: models.gate_memory_mib, time_s: models.gate_timeout_s },
        limits: GateLimits { p99_ms: models.max_p99_ms, ..GateLimits::default() },
        unproven: install.unproven,
        again: install.again,
        idle: !install.normal_priority,
    };
    let patience = if gate.idle {
        "; at idle priority, which a busy computer makes wait (--normal-priority)"
    } else {
        ""
    };
    eprintln!("examining it by up to {} held-out pictures and by its speed{patience}", gate.frames);
    // A bundle that is not even one is refused like any other.
    let outcome = match read_bundle(&install.bundle) {
        Ok(bundle) => gate.install(&bundle, &keys, &mut store)?,
        Err(error) => return refused(args.json, &error.to_string(), "signature"),
    };
    match outcome {
        Outcome::Accepted { signed, examination, verdict } => {
            if args.json {
                let latency = examination.latency;
                println!(
                    "{}",
                    json!({"accepted": true, "name": signed.name, "digest": signed.digest, "verdict": verdict, "latency_ms": latency})
                );
            } else {
                println!(
                    "accepted: {} ({}), signed by {}",
                    signed.name,
                    short(&signed.digest),
                    signed.by
                );
                print_measured(&examination, &verdict);
                println!(
                    "It drives on trial from the robot's next look, within a second; `model list` tells how it ends."
                );
            }
            Ok(ExitCode::SUCCESS)
        }
        Outcome::Refused { why, .. } => refused(args.json, &why.to_string(), why.kind()),
    }
}

fn refused(as_json: bool, why: &str, kind: &str) -> Result<ExitCode> {
    if as_json {
        println!("{}", json!({"accepted": false, "kind": kind, "why": why}));
    } else {
        println!("refused ({kind}): {why}");
    }
    Ok(ExitCode::FAILURE)
}

fn print_measured(examination: &Examination, verdict: &Verdict) {
    println!("  {} held-out pictures of {} places", verdict.pictures, verdict.places);
    for (measure, paired) in &verdict.compared {
        let (candidate, resident) = (paired.candidate, paired.resident);
        let (lower, upper) = (paired.lower, paired.upper);
        println!(
            "  {}: {candidate:.4}, before {resident:.4} (difference {lower:+.4} to {upper:+.4})",
            measure.name()
        );
    }
    let latency = &examination.latency;
    println!(
        "  p99 {:.1} ms over {} inferences; golden pair within {:.1e}",
        latency.p99_ms, latency.runs, examination.golden_difference
    );
}

fn verify(args: &ModelArgs, verify: &VerifyArgs, config: &Config) -> Result<ExitCode> {
    let keys = keys(verify.trusted_keys.as_ref(), config)?;
    let read = read_bundle(&verify.bundle)
        .and_then(|bundle| Ok(signed_model::verify(&bundle.model, &bundle.signature, &keys)?));
    match read {
        Ok(signed) if args.json => {
            println!(
                "{}",
                json!({"verified": true, "name": signed.name, "digest": signed.digest, "by": signed.by})
            );
            Ok(ExitCode::SUCCESS)
        }
        Ok(signed) => {
            println!("{} ({}) is signed by {}", signed.name, signed.digest, signed.by);
            Ok(ExitCode::SUCCESS)
        }
        Err(error) => refused(args.json, &error.to_string(), "signature"),
    }
}

fn roll_back(store: &mut Store, why: &str, as_json: bool) -> Result<ExitCode> {
    let state = store.roll_back(why)?;
    match (as_json, state.current()) {
        (true, current) => println!("{}", json!({"current": current})),
        (false, Some(digest)) => {
            println!("{} ({}) drives from now on", store.history().name(digest), short(digest));
        }
        (false, None) => {
            println!("no model is left: the robot drives with coarse depth from now on");
        }
    }
    Ok(ExitCode::SUCCESS)
}

fn list(store: &Store, as_json: bool) -> Result<ExitCode> {
    let state = store.state();
    let history = store.history();
    if as_json {
        let state = state.map_err(|error| error.to_string());
        println!(
            "{}",
            json!({"state": state.as_ref().ok(), "problem": state.as_ref().err(), "history": history.entries})
        );
        return Ok(if state.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    let state = state?;
    for (place, digest) in state.models.iter().enumerate() {
        let role = match place {
            0 if state.trial_starts.is_some() => "current, on trial",
            0 => "current",
            _ => "to go back to",
        };
        let whole = if store.read_model(digest).is_ok() { "" } else { ", DAMAGED" };
        println!("{}  {}  {role}{whole}", short(digest), history.name(digest));
    }
    if state.models.is_empty() {
        println!("no model: the robot drives with coarse depth");
    }
    for entry in &history.entries {
        let what = serde_json::to_value(entry.what).unwrap_or_default();
        println!(
            "  {} {} {} {} {}",
            utc(entry.unix_s),
            what.as_str().unwrap_or_default(),
            short(&entry.digest),
            entry.name,
            entry.why
        );
    }
    Ok(ExitCode::SUCCESS)
}

/// `2026-11-22 09:41:44`, UTC.
fn utc(unix_s: u64) -> String {
    match i64::try_from(unix_s).ok().and_then(|second| jiff::Timestamp::from_second(second).ok()) {
        Some(time) => time.strftime("%Y-%m-%d %H:%M:%S").to_string(),
        None => format!("second {unix_s}"),
    }
}

/// As people compare digests.
fn short(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

#[cfg(test)]
mod tests {
    use super::utc;

    #[test]
    fn times_are_told_as_dates_and_nonsense_as_it_is() {
        assert_eq!(utc(951_782_400), "2000-02-29 00:00:00");
        assert_eq!(utc(u64::MAX), "second 18446744073709551615");
    }
}
