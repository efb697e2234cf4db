//! The command line of `firmware-host model`.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::{Args, Subcommand};
use runtime::model_gate::{Examination, GateLimits, NearEvidence, Verdict};
use serde_json::json;
use signed_model::{Bundle, TrustedKeys};

use super::{ChildLimits, Gate, Outcome, Store, examine};
use crate::cli::values::whole_number;
use crate::config::Config;

/// Configuration file of the Debian package.
const PACKAGED_CONFIG: &str = "/etc/embodied-depth/robot.toml";

/// Arguments of `firmware-host model`.
#[derive(Debug, Args)]
pub struct ModelArgs {
    /// Configuration file [default: /etc/embodied-depth/robot.toml if it exists].
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Folder of the robot's models, the model store [default: models.store of the configuration].
    #[arg(long, global = true, value_name = "DIR")]
    pub store: Option<PathBuf>,
    /// Print one JSON object instead of text.
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: ModelCommand,
}

/// The subcommands of `firmware-host model`.
#[derive(Debug, Subcommand)]
pub enum ModelCommand {
    /// Compare a signed model with the current one and, if it is at least as good, make it the
    /// current one, on trial. Exits with 1 if the model is refused.
    Install(InstallArgs),
    /// List the installed models, and the history of installed, refused and rolled-back models.
    List,
    /// Check the signature of a model without running the model. Exits with 1 if it is not valid.
    Verify(VerifyArgs),
    /// Go back to the model before the current one, or to depth that needs no network if there is none.
    Rollback(RollbackArgs),
    /// Fails with a hint: signing keys are made on the workstation, and this program cannot sign.
    #[command(hide = true)]
    Keygen {
        /// Arguments, which are accepted and not used, so that every call shows the hint.
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<OsString>,
    },
    /// Run a model for the first time, in a process with resource limits. `install` starts this.
    #[command(hide = true)]
    Examine(ExamineArgs),
}

/// Arguments of `firmware-host model install`.
#[derive(Debug, Args)]
pub struct InstallArgs {
    /// Model file NAME.onnx with its signature NAME.onnx.minisig in the same folder, or `-` to read
    /// the stream of `push-model` from standard input.
    pub bundle: PathBuf,
    /// File with the trusted public keys [default: models.trusted_keys of the configuration].
    #[arg(long, value_name = "FILE")]
    pub trusted_keys: Option<PathBuf>,
    /// Recorded runs of this robot, or a folder with runs [default: models.recordings of the
    /// configuration]. May be repeated.
    #[arg(long, value_name = "DIR")]
    pub recordings: Vec<PathBuf>,
    /// Maximum number of held-out frames on which the model is evaluated.
    #[arg(long, value_name = "N", default_value_t = 300, allow_negative_numbers = true, value_parser = whole_number(1..=100_000))]
    pub frames: u64,
    /// Accept a first model even without enough held-out frames. Has no effect if a model is
    /// installed.
    #[arg(long)]
    pub unproven: bool,
    /// Examine the model even if it was installed before and rolled back.
    #[arg(long)]
    pub again: bool,
    /// Examine at normal instead of idle priority. This is faster, but takes processor time from a
    /// robot that is driving.
    #[arg(long)]
    pub normal_priority: bool,
}

/// Arguments of `firmware-host model verify`.
#[derive(Debug, Args)]
pub struct VerifyArgs {
    /// Model file NAME.onnx with its signature NAME.onnx.minisig in the same folder, or `-` to read
    /// the stream of `push-model` from standard input.
    pub bundle: PathBuf,
    /// File with the trusted public keys [default: models.trusted_keys of the configuration].
    #[arg(long, value_name = "FILE")]
    pub trusted_keys: Option<PathBuf>,
}

/// Arguments of `firmware-host model rollback`.
#[derive(Debug, Args)]
pub struct RollbackArgs {
    /// Reason, for the history.
    #[arg(long, value_name = "TEXT", default_value = "rolled back by an operator")]
    pub why: String,
}

/// Arguments of `firmware-host model examine`. The model to examine comes on standard input.
#[derive(Debug, Clone, Args)]
pub struct ExamineArgs {
    /// File of the model that the robot uses now.
    #[arg(long, value_name = "FILE")]
    pub resident: Option<PathBuf>,
    /// Recorded runs, or a folder with runs. May be repeated.
    #[arg(long, value_name = "DIR")]
    pub recordings: Vec<PathBuf>,
    /// Maximum number of held-out frames.
    #[arg(long, value_name = "N")]
    pub frames: usize,
    /// Limit of the address space, MiB.
    #[arg(long, value_name = "MIB")]
    pub memory_mib: u64,
    /// Limit of processor time, seconds.
    #[arg(long, value_name = "SECONDS")]
    pub cpu_s: u64,
    /// Run at idle priority.
    #[arg(long)]
    pub idle: bool,
    /// Set from `--config` of `model`.
    #[arg(skip)]
    pub config: Option<PathBuf>,
}

/// Runs a `model` command. A refused model is exit code 1, not an error.
///
/// # Errors
/// If the configuration, the store or the keys cannot be read, or the store cannot be written.
pub fn run(args: &ModelArgs) -> Result<ExitCode> {
    let config_path = args
        .config
        .clone()
        .or_else(|| Some(PathBuf::from(PACKAGED_CONFIG)).filter(|path| path.exists()));
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
        ModelCommand::List => list(&open_existing(args, &config)?, args.json, &config),
        ModelCommand::Verify(verify) => self::verify(args, verify, &config),
        ModelCommand::Rollback(rollback) => {
            roll_back(&mut open_existing(args, &config)?, &rollback.why, args.json)
        }
        ModelCommand::Examine(_) | ModelCommand::Keygen { .. } => Ok(ExitCode::FAILURE),
    }
}

/// The store. It is created if it is missing.
fn open(args: &ModelArgs, config: &Config) -> Result<Store> {
    Ok(Store::open(folder(args, config)?)?)
}

/// The store for a command that makes no sense without one.
fn open_existing(args: &ModelArgs, config: &Config) -> Result<Store> {
    let dir = folder(args, config)?;
    if !dir.is_dir() {
        bail!(
            "there is no model store at {}; `model install`, or a run with models.store, creates it",
            dir.display()
        );
    }
    Ok(Store::open(dir)?)
}

fn folder<'a>(args: &'a ModelArgs, config: &'a Config) -> Result<&'a Path> {
    match &args.store {
        Some(dir) => Ok(dir),
        None if !config.models.store.is_empty() => Ok(Path::new(&config.models.store)),
        None => bail!(
            "no model store is configured; give --store DIR, or set models.store in the configuration"
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
            .context("cannot find the path of this program, which runs the examination")?,
        config: config_path,
        recordings,
        frames: install.frames as usize,
        child: ChildLimits { memory_mib: models.gate_memory_mib, time_s: models.gate_timeout_s },
        limits: GateLimits {
            p99_ms: models.max_p99_ms,
            must_reach_dense: models.must_reach_dense,
            ..GateLimits::default()
        },
        unproven: install.unproven,
        again: install.again,
        idle: !install.normal_priority,
    };
    let priority = if gate.idle {
        "; this runs at idle priority and is slow on a busy computer (see --normal-priority)"
    } else {
        ""
    };
    eprintln!(
        "measuring the model's accuracy on up to {} held-out frames, and its speed{priority}",
        gate.frames
    );
    // A malformed bundle is a refused model, not an error of this program.
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
                    "A running robot switches to it within a second, on trial; `model list` shows how the trial \
                     ends."
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
    println!("  {} held-out frames of {} places", verdict.frames, verdict.places);
    for (others, other) in
        [(&verdict.compared, "current model"), (&verdict.beside_dense, "dense depth, no network")]
    {
        for (measure, paired) in others {
            println!(
                "  {}: {:.4}, {other} {:.4} (difference {:+.4} to {:+.4}, {:.1} %)",
                measure.name(),
                paired.candidate,
                paired.resident,
                paired.lower,
                paired.upper,
                100.0 * paired.coverage
            );
        }
    }
    for evidence in &verdict.near {
        let NearEvidence { what, frames, lost, .. } = evidence;
        match lost {
            Some(lost) => println!("  obstacles {what}: {lost:.3} lost ({frames} frames)"),
            None => println!("  obstacles {what}: cannot say, {frames} frames show any"),
        }
    }
    let latency = &examination.latency;
    println!(
        "  inference time p99 {:.1} ms ({} inferences); golden pair reproduced within {:.1e}",
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
            println!(
                "the current model is now {} ({})",
                store.history().name(digest),
                short(digest)
            );
        }
        (false, None) => {
            println!("no model is left: the robot now uses depth that needs no network");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Whether the robot would use an installed model: it came with the program, or a key that is trusted now has signed it.
fn is_trusted(store: &Store, digest: &str, model: &[u8], config: &Config) -> bool {
    match store.signature(digest) {
        Err(_) => false,
        Ok(None) => true,
        Ok(Some(signature)) => keys(None, config)
            .is_ok_and(|keys| signed_model::verify(model, &signature, &keys).is_ok()),
    }
}

fn list(store: &Store, as_json: bool, config: &Config) -> Result<ExitCode> {
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
            _ => "previous",
        };
        let damage = match store.read_model(digest) {
            Err(_) => ", DAMAGED",
            Ok(model) if !is_trusted(store, digest, &model, config) => ", NOT TRUSTED: not used",
            Ok(_) => "",
        };
        println!("{}  {}  {role}{damage}", short(digest), history.name(digest));
    }
    if state.models.is_empty() {
        println!("no model is installed: the robot uses depth that needs no network");
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

/// A Unix time as `2026-11-22 09:41:44`, UTC.
fn utc(unix_s: u64) -> String {
    match i64::try_from(unix_s).ok().and_then(|second| jiff::Timestamp::from_second(second).ok()) {
        Some(time) => time.strftime("%Y-%m-%d %H:%M:%S").to_string(),
        None => format!("second {unix_s}"),
    }
}

/// The first 12 digits, which are enough to compare two digests by eye.
fn short(digest: &str) -> &str {
    digest.get(..12).unwrap_or(digest)
}

#[cfg(test)]
mod tests {
    use super::utc;

    #[test]
    fn times_are_printed_as_dates_and_impossible_ones_as_a_number() {
        assert_eq!(utc(951_782_400), "2000-02-29 00:00:00");
        assert_eq!(utc(u64::MAX), "second 18446744073709551615");
    }
}
